"""A volume larger than memory: a level of it is resident, and pixels that show more are refined by bricks."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import clvol
from clvol import LazyVolume, OptionError, OutOfMemoryError, Volume
from clvol.base import memory
from clvol.bricks.source import needed_by
from clvol.device import Device
from clvol.show.picture import to_bytes
from clvol.view import State, View
from clvol.view.finer import resident_level
from tests.view.clients import Client, decoded

SIZE = 120, 90
SIDE = 120


class Waves:
    """A ball with surface waves too short for the coarser levels, computed on read; it counts reads."""

    dtype = np.dtype(np.float32)
    chunks = (32, 32, 32)

    def __init__(self, side: int) -> None:
        self.shape = (side, side, side)
        self.read = 0
        self.broken = False

    def __getitem__(self, index: Any) -> NDArray[Any]:
        if self.broken:
            raise OSError("the disk is gone")
        side = self.shape[0]
        z, y, x = ((axis.astype(np.float32) + 0.5) * (2 / side) - 1 for axis in np.ogrid[index])
        value = 100 * (0.8 - np.sqrt(x * x + y * y + z * z)) + np.sin(90 * x) * np.sin(90 * y) * np.sin(90 * z)
        self.read += value.size
        return np.asarray(value, np.float32)


def stored(samples: Waves) -> LazyVolume:
    """With two smaller sizes."""
    levels = []
    for factor in (2, 4):
        side = SIDE // factor
        own = Waves(side)
        levels.append(LazyVolume(own, spacing=(factor,) * 3, origin=((factor - 1) / 2,) * 3))
    return LazyVolume(samples, levels=levels)


@pytest.fixture
def samples() -> Waves:
    return Waves(SIDE)


@pytest.fixture
def view(samples: Waves, device: Device, monkeypatch: pytest.MonkeyPatch) -> Iterator[View]:
    """A view whose smallest level alone is resident, with an automatic isovalue."""
    lazy = stored(samples)
    with monkeypatch.context() as patch:
        patch.setattr(memory, "available", lambda: 2 * needed_by(lazy.levels[-1]))
        made = View(lazy, device=device, mode="isosurface", isovalue=20)
    yield made
    made.close()


def drawn(text: str, volume: Volume | LazyVolume) -> NDArray[np.uint8]:
    """The output of the copied program."""
    names: dict[str, Any] = {"volume": volume}
    exec(text, names)
    return to_bytes(names["picture"])


def test_the_largest_level_that_fits_is_resident(samples: Waves, monkeypatch: pytest.MonkeyPatch) -> None:
    lazy = stored(samples)
    sizes = lazy, *lazy.levels
    for level, size in enumerate(sizes):
        monkeypatch.setattr(memory, "available", lambda size=size: 2 * needed_by(size))
        assert resident_level(lazy) == level
    monkeypatch.setattr(memory, "available", lambda: needed_by(sizes[-1]))  # not half of it, but all
    assert resident_level(lazy) == len(lazy.levels)


def test_volumes_that_fit_at_no_level_are_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    samples = Waves(600)
    lazy = LazyVolume(samples, limits=(-100, 80))
    monkeypatch.setattr(memory, "available", lambda: 1000)
    with pytest.raises(OutOfMemoryError, match=r"its smallest size, .600, 600, 600., takes 1648 MiB: clvol.pyramid"):
        View(lazy)
    assert samples.read < samples.shape[0] ** 3 // 20  # for its automatic options


def test_options_are_rejected_before_everything_is_read() -> None:
    samples = Waves(200)
    with pytest.raises(OptionError, match="nonsense"):
        View(LazyVolume(samples), nonsense=1)
    assert samples.read < 200**3


def test_a_multi_resolution_label_map_is_not_refined(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another level may have labels other than the resident ones, which are counted, coloured and hidden."""
    data = np.zeros((32, 32, 32), np.uint8)
    data[8:24, 8:24, 8:24] = 3
    small = LazyVolume(data[::2, ::2, ::2], spacing=(2, 2, 2), origin=(0.5,) * 3, labels=True)
    lazy = LazyVolume(data, labels=True, levels=[small])
    with monkeypatch.context() as patch:
        patch.setattr(memory, "available", lambda: 2 * needed_by(small))
        assert resident_level(lazy) == 1
        view = View(lazy, device=device)
    assert view.resident.finer is None
    assert view.volume.is_labels
    assert view.volume.shape == small.shape
    client = Client(view)
    client.set(labels={"hidden": [3]}, camera__zoom=6.0)
    client.resize(*SIZE)
    _, pixels = client.still()
    assert not pixels.any()
    assert not [message for message in client.of("status") if message["kind"] == "error"]
    client.close()
    view.close()


def test_pixels_without_finer_detail_read_nothing(view: View, client: Client, samples: Waves) -> None:
    assert view.volume.shape == (SIDE // 4,) * 3
    read = samples.read  # which decided its look
    client.resize(16, 16)
    client.still()
    assert len(client.of("status")) == 0
    assert samples.read == read


@pytest.mark.one_in(3)
@pytest.mark.parametrize("mode", ["isosurface", "composite", "mip"])
def test_a_still_picture_uses_the_level_that_it_resolves(view: View, client: Client, samples: Waves, mode: str) -> None:
    assert view.resident.finer is not None
    client.set(mode=mode, options={})
    client.set(camera__zoom=6.0)
    client.resize(*SIZE)
    _, pixels = client.still()
    assert samples.read > 0
    frames = client.of("frame")
    assert not frames[0]["final"]
    assert "finer samples" in " ".join(message["text"] for message in client.of("status"))
    assert client.of("status")[-1]["text"] == ""
    program = client.session.python()
    assert "LazyVolume" in program
    np.testing.assert_array_equal(pixels, drawn(program, view.resident.finer.stored)[..., :3])


def test_it_shows_the_same_matter_in_the_same_place(client: Client) -> None:
    """Unlit, since fine waves change shading: the same amount of matter in the same place."""
    client.set(mode="composite", options={"shading": False})
    client.set(camera__zoom=1.4)
    client.resize(200, 200)
    _, pixels = client.still()
    coarse = [(m, d) for m, d in client.got if m["type"] == "frame" and not m["final"] and m["width"] == 200]
    assert coarse
    before = decoded(coarse[-1][1]).astype(float).mean(-1)
    after = pixels.astype(float).mean(-1)
    assert np.abs(after - before).mean() < 0.04 * after.max()
    assert before.mean() == pytest.approx(after.mean(), rel=0.1)  # opacity counts for lengths, not for voxels


def test_slices_too(view: View, client: Client, samples: Waves) -> None:
    assert view.resident.finer is not None
    client.set(layout="slice", active="z")
    client.set(slice__zoom=4.0)
    client.resize(*SIZE)
    _, pixels = client.still("z")
    assert samples.read > 0
    program = client.session.python()
    np.testing.assert_array_equal(pixels, drawn(program, view.resident.finer.stored)[..., :3])


def test_a_store_that_became_unreadable(client: Client, samples: Waves) -> None:
    """The error is reported, the resident level stays, and the next view is rendered."""
    samples.broken = True
    client.set(camera__zoom=6.0)
    client.resize(*SIZE)
    client.wait(lambda m: m["type"] == "status" and m["kind"] == "error" and "the disk is gone" in m["text"])
    assert client.of("frame")
    client.forget()
    client.set(camera__zoom=1.0)
    client.resize(16, 16)
    client.still()


def test_a_drag_does_not_wait_for_bricks(view: View, client: Client, samples: Waves) -> None:
    client.set(camera__zoom=6.0)
    client.resize(*SIZE)
    client.still()
    assert view.resident.finer is not None
    view.resident.finer.close()  # they are read again
    slow = type(samples).__getitem__

    def late(self: Waves, index: Any) -> NDArray[Any]:
        time.sleep(1.5)
        return slow(self, index)

    client.forget()
    type(samples).__getitem__ = late  # type: ignore[method-assign]
    try:
        client.event("pointer_down", x=60, y=45, button=1)
        client.event("pointer_move", x=90, y=45, button=1)
        client.event("pointer_up", x=90, y=45, button=1)
        client.wait(lambda m: m["type"] == "status" and "finer samples" in m["text"])
        client.forget()
        began = time.monotonic()
        client.event("pointer_down", x=64, y=45, button=1)
        client.event("pointer_move", x=20, y=45, button=1)
        client.wait(lambda m: m["type"] == "frame")
        assert time.monotonic() - began < 1.2  # less than a brick takes
    finally:
        type(samples).__getitem__ = slow  # type: ignore[method-assign]


def test_levels_of_a_renderer(view: View, device: Device) -> None:
    assert view.resident.finer is not None
    lazy = view.resident.finer.stored
    with clvol.Renderer(lazy, "linear", device=device) as renderer:
        point = lazy.grid.center[None] + 3.3
        assert renderer.field_of_level(1)(point) == pytest.approx(clvol.Field(lazy.levels[0].whole(), "linear")(point), rel=1e-5)
        with pytest.raises(OptionError, match="level must be"):
            renderer.field_of_level(3)
    with (
        clvol.Renderer(lazy.levels[-1].whole(), "linear", device=device) as renderer,
        pytest.raises(OptionError, match="by bricks"),
    ):
        renderer.field_of_level(0)


def noisy(side: int, sigma: float, seed: int = 0) -> NDArray[Any]:
    """A ball in noise, which "bspline3(auto)" smooths by how much of it there is."""
    z, y, x = ((axis + 0.5) * (2 / side) - 1 for axis in np.ogrid[:side, :side, :side])
    ball = 100 / (1 + np.exp(30 * (np.sqrt(x * x + y * y + z * z) - 0.6)))
    return (ball + np.random.default_rng(seed).normal(0, sigma, ball.shape)).astype(np.float32)


def test_an_intermediate_level_matches_the_copied_program(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """Noise differs per level; one filter serves all."""
    levels = [LazyVolume(noisy(96 // n, 12 / n**1.5), spacing=(n,) * 3, origin=((n - 1) / 2,) * 3) for n in (2, 4)]
    lazy = LazyVolume(noisy(96, 12), levels=levels)
    with monkeypatch.context() as patch:
        patch.setattr(memory, "available", lambda: 2 * needed_by(levels[-1]))
        view = View(lazy, device=device, mode="isosurface", isovalue=50)
    client = Client(view)
    try:
        client.resize(30, 30)
        _, pixels = client.still()
        assert view.resident.finer is not None
        renderer = view.resident.finer._renderer
        assert renderer is not None
        assert renderer.shown.volume.size == (48, 48, 48)
        np.testing.assert_array_equal(pixels, drawn(client.session.python(), lazy)[..., :3])
    finally:
        client.close()
        view.close()


def test_what_is_resident_uses_the_filter_of_its_bounds(device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clvol.pyramid(Volume(noisy(64, 0)), tmp_path / "ball.zarr", filter="catmull-rom", boundary="wrap", chunks=16)
    lazy = clvol.open(tmp_path / "ball.zarr")
    with monkeypatch.context() as patch:
        patch.setattr(memory, "available", lambda: 2 * needed_by(lazy.levels[0]))
        view = View(lazy, device=device, mode="mip", source=f"clvol.open({str(tmp_path / 'ball.zarr')!r})")
    client = Client(view)
    try:
        client.resize(*SIZE)
        _, pixels = client.still()
        assert (view.state.filter, view.state.boundary) == ("catmull-rom", "wrap")
        program = client.session.python()
        np.testing.assert_array_equal(pixels, drawn(program, lazy)[..., :3])
        text = client.session.toml()
        assert "ball.zarr" in text
        assert "level" not in text
        assert "lod = " in text
        program = view.python(SIZE)
        np.testing.assert_array_equal(to_bytes(view.picture(SIZE)), drawn(program, lazy))
    finally:
        client.close()
        view.close()


def test_clients_render_by_bricks_one_at_a_time(view: View, monkeypatch: pytest.MonkeyPatch) -> None:
    """Bricks of two pictures at different levels would take the budget twice."""
    drawing, together = threading.Semaphore(1), [False]
    render = clvol.Renderer.render

    def watched(self: clvol.Renderer, *given: Any, **named: Any) -> Any:
        if self.field is not getattr(view.resident.finer and view.resident.finer._renderer, "field", None):
            return render(self, *given, **named)
        alone = drawing.acquire(blocking=False)
        together[0] |= not alone
        time.sleep(0.3)
        made = render(self, *given, **named)
        if alone:
            drawing.release()
        return made

    monkeypatch.setattr(clvol.Renderer, "render", watched)
    clients = [Client(view), Client(view)]
    try:
        for client, zoom in zip(clients, (8.0, 4.0), strict=True):
            client.set(camera__zoom=zoom)
            client.resize(*SIZE)
        for client in clients:
            client.still()
        assert not together[0]
    finally:
        for client in clients:
            client.close()


def test_facts_do_not_wait_for_bricks(client: Client, samples: Waves, monkeypatch: pytest.MonkeyPatch) -> None:
    go = threading.Event()
    read = type(samples).__getitem__

    def late(self: Waves, index: Any) -> NDArray[Any]:
        go.wait(60)
        return read(self, index)

    monkeypatch.setattr(Waves, "__getitem__", late)
    client.set(camera__zoom=6.0)
    client.resize(*SIZE)
    client.wait(lambda m: m["type"] == "state" and "effective" in m)
    go.set()
    client.still()


def test_nothing_is_left_of_a_client_that_left_while_reading_bricks(
    view: View, samples: Waves, monkeypatch: pytest.MonkeyPatch
) -> None:
    go, reading = threading.Event(), threading.Event()
    read = type(samples).__getitem__

    def late(self: Waves, index: Any) -> NDArray[Any]:
        reading.set()
        go.wait(60)
        return read(self, index)

    monkeypatch.setattr(Waves, "__getitem__", late)
    for _ in range(4):
        client = Client(view)
        client.set(camera__zoom=6.0)
        client.resize(*SIZE)
        client.wait(lambda m: m["type"] == "status" and "finer samples" in m["text"])
        assert reading.wait(60)
        client.close()
    readers = [thread for thread in threading.enumerate() if thread.name == "clvol view: bricks"]
    view.close()  # does not wait
    go.set()
    for thread in readers:
        thread.join(60)
        assert not thread.is_alive()
    assert view.resident.finer is not None
    assert view.resident.finer._renderer is None


def test_a_state_outside_the_volume_is_rejected(view: View) -> None:
    with pytest.raises(OptionError, match="index"):
        view.state = State(index={"time": 3})
