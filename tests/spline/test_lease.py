"""Closing during a computation: it completes, later calls are rejected, and the last use frees the memory."""

from __future__ import annotations

import gc
import threading
import weakref
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import clvol
from clvol.base.errors import OptionError
from clvol.device import Device
from clvol.device.opencl import opencl
from clvol.march.renderer import Renderer
from clvol.spline.coefficients import Coefficients
from clvol.spline.field import Field
from clvol.spline.lease import Lease
from clvol.spline.minmax import MinMax

DATA = np.random.default_rng(5).random((104, 104, 104), np.float32)  # of more than 4 MiB, which go back to the system at once
POINTS = np.random.default_rng(6).uniform(0, 103, (1 << 18, 3)).astype(np.float32)
VIEW: dict[str, Any] = {"mode": "mip", "size": (64, 48), "rays": 4}


@pytest.fixture
def lease() -> tuple[Lease, list[str]]:
    made, freed = Lease("it was closed"), list[str]()
    made.frees(lambda: freed.append("memory"))
    return made, freed


def test_the_last_user_frees(lease: tuple[Lease, list[str]]) -> None:
    made, freed = lease
    with made.held():
        made.close()
        with made.held():  # part of the same use
            pass
        assert (made.closed, freed) == (True, [])
    assert freed == ["memory"]
    made.close()
    with pytest.raises(OptionError, match="it was closed"), made.held():
        pytest.fail("refused")
    assert freed == ["memory"]


def test_other_threads_are_rejected_during_the_last_use(lease: tuple[Lease, list[str]]) -> None:
    made, freed = lease
    refused: list[OptionError] = []

    def come() -> None:
        try:
            with made.held():
                pass
        except OptionError as error:
            refused.append(error)

    with made.held():
        made.close()
        thread = threading.Thread(target=come)
        thread.start()
        thread.join()
        assert (len(refused), freed) == (1, [])
    assert freed == ["memory"]


def test_errors_within_a_use_end_it(lease: tuple[Lease, list[str]]) -> None:
    made, freed = lease
    with pytest.raises(KeyboardInterrupt), made.held():
        raise KeyboardInterrupt
    made.close()
    assert freed == ["memory"]


def test_buffers_added_after_closing_are_freed(lease: tuple[Lease, list[str]]) -> None:
    made, freed = lease
    with made.held():
        made.close()
        made.frees(lambda: freed.append("late"))
    assert freed == ["late", "memory"]


def closing(close: Callable[[], None], *, in_thread: bool) -> Callable[[float], None]:
    """A progress callback that closes on its first call, perhaps in another thread, and waits until it is done."""

    def report(_: float) -> None:
        if in_thread:
            thread = threading.Thread(target=close)
            thread.start()
            thread.join(30)
            assert not thread.is_alive(), "close waited for whoever waits for it"
        else:
            close()

    return report


@pytest.mark.one_in(2)
@pytest.mark.parametrize("in_thread", [False, True], ids=["callback", "thread"])
def test_a_renderer_closed_during_a_picture(device: Device, in_thread: bool) -> None:
    with Renderer(DATA, "bspline3", device=device) as other:
        expected = other.render(**VIEW)
    renderer = Renderer(DATA, "bspline3", device=device)
    picture = renderer.render(progress=closing(renderer.close, in_thread=in_thread), **VIEW)
    np.testing.assert_array_equal(picture, expected)
    assert renderer.field.coefficients.buffer is None
    assert all(minmax.buffer is None for minmax in renderer._source.pyramids.values())
    with pytest.raises(OptionError, match="released"):
        renderer.render(**VIEW)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("in_thread", [False, True], ids=["callback", "thread"])
def test_a_field_closed_during_rendering_and_sampling(device: Device, in_thread: bool) -> None:
    field = Field(DATA, device=device)
    expected, values = Renderer(field).render(**VIEW), field(POINTS)
    with Renderer(field) as first, Renderer(field) as second:
        picture = first.render(progress=closing(field.close, in_thread=in_thread), **VIEW)
        np.testing.assert_array_equal(picture, expected)
        assert field.coefficients.buffer is None
        with pytest.raises(OptionError, match="the field was closed"):
            second.render(**VIEW)
    field = Field(DATA, device=device)
    with device.limited(launch_taps=1 << 20):
        np.testing.assert_array_equal(field(POINTS, progress=closing(field.close, in_thread=in_thread)), values)
    assert (field.closed, field.coefficients.buffer) == (True, None)


def test_an_interpolator_closed_during_evaluation(device: Device) -> None:
    grid = (range(9), range(8), range(7))
    data = np.random.default_rng(1).random((9, 8, 7, 3), np.float32)
    at = np.array([[4.0, 3.5, 2.25], [1.0, 1.5, 6.0]])
    expected = clvol.Interpolator(grid, data, device=device)(at)
    one = clvol.Interpolator(grid, data, device=device)
    np.testing.assert_array_equal(one(at, progress=closing(one.close, in_thread=True)), expected)
    assert all(field.closed for fields in one._fields for field in fields)
    with pytest.raises(OptionError, match="released"):
        one(at)


def test_closing_at_any_time_while_threads_render(device: Device) -> None:
    with Renderer(DATA, "bspline3", device=device) as other:
        expected = other.render(**VIEW)
    for wait in (0.0, 0.03):
        renderer, pictures, errors = Renderer(DATA, "bspline3", device=device), [], []

        def draw(renderer: Renderer = renderer, pictures: list[Any] = pictures, errors: list[Exception] = errors) -> None:
            try:
                while True:
                    pictures.append(renderer.render(**VIEW))
            except OptionError as error:
                errors.append(error)

        threads = [threading.Thread(target=draw) for _ in range(2)]
        for thread in threads:
            thread.start()
        threads[0].join(wait)
        renderer.close()
        for thread in threads:
            thread.join(60)
        assert len(errors) == 2
        assert renderer.field.coefficients.buffer is None
        for picture in pictures:
            np.testing.assert_array_equal(picture, expected)


def test_an_unreferenced_field_is_freed(device: Device) -> None:
    gc.disable()
    try:
        field = Field(DATA[:9, :9, :9], device=device)
        renderer = Renderer(DATA[:9, :9, :9], "bspline3", device=device)
        kept = [weakref.ref(field), weakref.ref(renderer)]
        del field, renderer
        assert [one() for one in kept] == [None, None]
    finally:
        gc.enable()


class Watched:
    """A buffer that records whether kernels had finished when it was freed."""

    def __init__(self, buffer: Any, last: Any) -> None:
        self.buffer, self.last, self.idle = buffer, last, list[bool]()

    def release(self) -> None:
        self.idle.append(self.last.command_execution_status == opencl().command_execution_status.COMPLETE)
        self.buffer.release()


@pytest.mark.parametrize("error", [KeyboardInterrupt, MemoryError])
def test_an_error_frees_no_memory_of_a_running_kernel(
    device: Device, monkeypatch: pytest.MonkeyPatch, error: type[BaseException]
) -> None:
    watched: list[Watched] = []

    def interrupted(self: Coefficients, _: int = 0) -> None:
        """The last step of computing coefficients, while the prefilter still runs."""
        watched.append(Watched(self.buffer, opencl().enqueue_marker(self.device.queue)))
        self.buffer = watched[-1]
        self.device.queue.flush()
        raise error

    monkeypatch.setattr(Coefficients, "fill_halo", interrupted)
    with pytest.raises(error):
        Field(np.tile(DATA, (2, 2, 1)), device=device)
    assert [one.idle for one in watched] == [[True]]


def test_an_interrupt_of_bounds_leaves_no_memory(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[MinMax] = []

    def interrupted(self: MinMax, *_: object) -> None:
        made.append(self)
        raise KeyboardInterrupt

    with Renderer(DATA[:20, :20, :20], "bspline3", device=device) as renderer:
        with monkeypatch.context() as patched:
            patched.setattr(MinMax, "_over_blocks", interrupted)
            with pytest.raises(KeyboardInterrupt):
                renderer.render(**VIEW)
        assert [one.buffer for one in made] == [None]
        with Renderer(DATA[:20, :20, :20], "bspline3", device=device) as other:
            np.testing.assert_array_equal(renderer.render(**VIEW), other.render(**VIEW))
