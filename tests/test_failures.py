"""Failing calls leave memory, descriptors and device buffers unchanged."""

# ruff: noqa: ARG005  # all calls get the same arguments

from __future__ import annotations

import gc
import itertools
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clvol
from clvol import images, ndimage, phantoms
from clvol.base.errors import ClvolError
from clvol.device import Device

DATA = np.random.default_rng(0).random((9, 10, 11), dtype=np.float32)
VOLUME = clvol.Volume(DATA)
HOLED = np.where(DATA > 0.9, np.nan, DATA)
POINTS = np.full((50, 3), 4.0)
HUGE = np.broadcast_to(np.float32(1), (1 << 13,) * 3)
FEW, MANY = 4, 1000  # calls of each kind
GROWS = 24 << 20  # bytes that n calls of all kinds may leave in allocator pools


class Stop(Exception):
    """Raised by a caller's callback."""


def stop(*_: object) -> None:
    raise Stop


def after(count: int) -> Callable[[float], None]:
    """A progress callback that interrupts, like Ctrl-C, on its `count`-th call."""
    calls = itertools.count(1)

    def told(_: float) -> None:
        if next(calls) >= count:
            raise KeyboardInterrupt

    return told


class Given:
    """The objects that calls are tried on."""

    def __init__(self, folder: Path, device: Device) -> None:
        self.device = device
        self.field = clvol.Field(VOLUME, device=device)
        self.renderer = clvol.Renderer(VOLUME, "bspline3", device=device)
        self.at = clvol.Interpolator((np.arange(9.0), np.arange(10.0), np.arange(11.0)), DATA, device=device)
        self.closed = clvol.Field(VOLUME, device=device)
        self.closed.close()
        self.folder = folder
        (folder / "cut.npy").write_bytes(b"\x93NUMPY\x01\x00v\x00{'descr': '<f4'")
        (folder / "text.nii").write_text("no image")
        np.save(folder / "flat.npy", np.zeros(4))

    def close(self) -> None:
        self.field.close()
        self.renderer.close()
        self.at.close()


CALLS: list[Callable[[Given], Any]] = [
    # invalid requests
    lambda g: clvol.Volume(np.zeros((2, 2, 2, 2))),
    lambda g: clvol.Volume(DATA, (1, 2)),
    lambda g: clvol.Volume(DATA, direction=np.zeros((3, 3))),
    lambda g: clvol.Volumes([VOLUME, clvol.Volume(DATA[1:])]),
    lambda g: clvol.Field(VOLUME, "no filter", device=g.device),
    lambda g: clvol.Field(VOLUME, boundary="no rule", device=g.device),
    lambda g: clvol.Field(VOLUME, device="no device"),
    lambda g: g.field(POINTS[:, :2]),
    lambda g: g.field(POINTS, out=np.empty(3)),
    lambda g: g.field.resample((2, 2)),
    lambda g: g.field.resample((2, 2, 2), dtype="U1"),
    lambda g: g.field.magnify(0),
    lambda g: clvol.sample(VOLUME, POINTS, derivative=3, device=g.device),
    lambda g: clvol.resample(VOLUME, (3, 3, 3), like=VOLUME, device=g.device),
    lambda g: clvol.resample(VOLUME, (3, 3, 3), anti_aliasing="none", device=g.device),
    lambda g: clvol.warp(VOLUME, VOLUME, wrt="both", device=g.device),
    lambda g: clvol.resample_series([VOLUME], [None, None], device=g.device),
    lambda g: clvol.adjoint(np.full(50, np.nan), POINTS, (4, 4, 4), device=g.device),
    lambda g: clvol.resize(DATA, (2, 2, 0), device=g.device),
    lambda g: images.rotate(DATA[0], np.nan, device=g.device),
    lambda g: ndimage.zoom(DATA, 2, order=9, device=g.device),
    lambda g: ndimage.affine_transform(DATA, np.eye(5), device=g.device),
    lambda g: ndimage.geometric_transform(DATA[0, :3, :3], lambda i: "ab", device=g.device),
    lambda g: ndimage.map_coordinates(DATA, POINTS[:, :2].T, device=g.device),
    lambda g: g.renderer.render(mode="no mode"),
    lambda g: g.renderer.render(size=(0, 4)),
    lambda g: g.renderer.render(step=-1),
    lambda g: g.renderer.render(preset="no preset"),
    lambda g: g.renderer.render(mode="mip", outputs="uncertainty"),
    lambda g: clvol.render(VOLUME, camera="front", device=g.device),
    lambda g: g.at((50.0, 0.0, 0.0)),
    lambda g: phantoms.by_name("sphere:²"),
    lambda g: clvol.read(g.folder / "none.npy"),
    lambda g: clvol.read(g.folder / "cut.npy"),
    lambda g: clvol.read(g.folder / "flat.npy"),
    lambda g: clvol.read(g.folder / "text.nii"),
    lambda g: clvol.write(VOLUME, g.folder / "no folder" / "a.npz"),
    lambda g: clvol.write(VOLUME, g.folder / "a.unknown"),
    lambda g: clvol.save(np.zeros((4, 4, 9)), g.folder / "a.png"),
    # invalid samples
    lambda g: clvol.Field(HOLED, device=g.device),
    lambda g: clvol.render(np.full_like(DATA, np.nan), device=g.device),
    lambda g: clvol.prefilter(HOLED, device=g.device),
    lambda g: clvol.resize(HOLED, (4, 4, 4), order=3, device=g.device),
    lambda g: ndimage.spline_filter(HOLED, nan="error", device=g.device),
    lambda g: clvol.resample(HOLED, (5, 5, 5), nan="local", dtype="uint8", device=g.device),
    # too large
    lambda g: clvol.Field(HUGE, device=g.device),
    lambda g: clvol.Field(HUGE[0, :1], "hybrid", device=g.device) and clvol.Field(HUGE, "hybrid", device=g.device),
    lambda g: g.field.resample((1 << 13,) * 3),
    lambda g: clvol.resample(VOLUME, (1 << 20,) * 3, device=g.device),
    lambda g: ndimage.zoom(DATA, 5000, device=g.device),
    lambda g: clvol.resize(DATA, (1 << 14,) * 3, device=g.device),
    lambda g: phantoms.sphere(1 << 13),
    # closed
    lambda g: g.closed(POINTS),
    lambda g: g.closed.resample((2, 2, 2)),
    lambda g: clvol.Renderer(g.closed),
    # interrupted, or the caller's callback fails
    lambda g: g.field(POINTS, progress=stop),
    lambda g: g.field.resample((20, 20, 20), progress=after(1)),
    lambda g: clvol.resample(VOLUME, (20, 20, 20), device=g.device, progress=after(1)),
    lambda g: clvol.warp(VOLUME, VOLUME, device=g.device, progress=stop),
    lambda g: ndimage.zoom(DATA, 2, device=g.device, progress=after(1)),
    lambda g: ndimage.geometric_transform(DATA, stop, device=g.device),
    lambda g: g.renderer.render(mode="mip", size=(16, 16), progress=after(1)),
    lambda g: clvol.render(VOLUME, mode="mip", filter="bspline3", size=(16, 16), device=g.device, progress=stop),
    lambda g: g.at(POINTS, progress=stop),
]


def held() -> tuple[int, int]:
    """Bytes in memory, and open descriptors."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE"), len(list(Path("/proc/self/fd").iterdir()))


def live(monkeypatch: pytest.MonkeyPatch) -> Callable[[], int]:
    """The number of live buffers among those created from now on."""
    import weakref

    import pyopencl as cl

    known: weakref.WeakSet[Any] = weakref.WeakSet()

    class Counted(cl.Buffer):  # type: ignore[misc]  # pyopencl has no types
        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            known.add(self)

    monkeypatch.setattr(cl, "Buffer", Counted)

    def count() -> int:
        gc.collect()
        return sum(bool(_size(one)) for one in known)

    return count


def _size(buffer: Any) -> int:
    try:
        return int(buffer.size)
    except Exception:  # it was released
        return 0


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="memory and descriptors are read from /proc")
@pytest.mark.parametrize("count", [FEW, pytest.param(MANY, marks=pytest.mark.thorough)])
def test_failing_calls_leak_nothing(count: int, tmp_path: Path, device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    given = Given(tmp_path, device)

    def fail(times: int) -> None:
        for call in CALLS:
            for _ in range(times):
                with pytest.raises((ClvolError, Stop, KeyboardInterrupt, OSError)):
                    call(given)

    try:
        alive = live(monkeypatch)
        fail(2)  # kernels are built, tables made
        before, begun = held(), alive()
        fail(count)
        after_, ended = held(), alive()
        kept = device.buffers.allocate(64)
        assert alive() == ended + 1  # they are counted
        kept.release()
    finally:
        given.close()
    assert after_[1] <= before[1]
    assert ended <= begun
    assert after_[0] - before[0] < GROWS
