"""Draws, samples and resamples with every buffer between pages that nobody may touch: `python guarded.py start|end`.

A kernel that reads or writes past the start or the end of its buffers ends the process; test_guarded.py runs this.
"""

from __future__ import annotations

import ctypes
import itertools
import mmap
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

import clvol
from clvol import ndimage
from clvol.device import Device
from clvol.filter import filters
from clvol.mode import modes
from clvol.spline.field import Precision
from clvol.spline.reduce import AntiAliasing

BOTH: tuple[Precision, Precision] = ("single", "double")
GUARD = 64 << 20  # bytes before and after
LINE = 64  # what buffers are aligned to


def guarded(size: int, side: str) -> NDArray[np.uint8]:
    """Zeros that start, or end, where memory that can be used does. Kept for good."""
    library = ctypes.CDLL(None, use_errno=True)
    library.mmap.restype = ctypes.c_void_p
    library.mmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int, ctypes.c_int, ctypes.c_int, ctypes.c_long]
    library.mprotect.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
    room = -(-size // mmap.PAGESIZE) * mmap.PAGESIZE
    start = library.mmap(None, room + 2 * GUARD, 0, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS, -1, 0)
    if start in (None, ctypes.c_void_p(-1).value) or library.mprotect(start + GUARD, room, mmap.PROT_READ | mmap.PROT_WRITE):
        raise OSError(ctypes.get_errno(), "guarded memory")
    past = (room - size) // LINE * LINE if side == "end" else 0
    return np.frombuffer((ctypes.c_uint8 * size).from_address(start + GUARD + past), np.uint8)


def guard(side: str) -> None:
    """Makes every buffer of every device a guarded one."""

    def allocate(self: Device, size: int) -> Any:
        return cl.Buffer(self.context, cl.mem_flags.USE_HOST_PTR, hostbuf=guarded(max(int(size), 4), side))

    def upload(self: Device, array: NDArray[Any]) -> Any:
        memory = guarded(max(array.nbytes, 4), side)
        memory[: array.nbytes] = np.ascontiguousarray(array).reshape(-1).view(np.uint8)
        return cl.Buffer(self.context, cl.mem_flags.USE_HOST_PTR, hostbuf=memory)

    @contextmanager
    def lent(self: Device, array: NDArray[Any], *, write: bool) -> Iterator[Any]:
        memory = guarded(array.nbytes, side)
        memory[:] = array.reshape(-1).view(np.uint8)
        buffer = cl.Buffer(self.context, cl.mem_flags.USE_HOST_PTR, hostbuf=memory)
        yield buffer
        self.queue.finish()
        if write:
            array.reshape(-1).view(np.uint8)[:] = memory
        buffer.release()

    for name, method in {"allocate": allocate, "upload": upload, "lent": lent}.items():
        setattr(Device, name, method)


def both_precisions(small: NDArray[np.float32], rng: np.random.Generator) -> None:
    """Points that are sorted first, many of them far outside."""
    for precision, rule in zip(BOTH, ("constant(3)", "nearest"), strict=True):
        with clvol.Field(small, "bspline3", rule, precision=precision) as field, field.device.limited(sorting=True):
            for count in (1, 70, 600):
                points = rng.uniform(-40, 60, (count, 3))
                assert np.isfinite(field(points)).all()
                assert np.isfinite(field.gradient(points.astype(np.float32))).all()


def arrays(rng: np.random.Generator) -> None:
    """`clvol.ndimage`: lines, images and batches of them, points axis by axis, results of other types and strides, reductions."""
    kinds = list(zip(BOTH, (3, 5), (("constant", "nearest"), ("wrap", "grid-constant")), strict=True))
    for shape, (precision, order, rules) in itertools.product(((9,), (3, 17), (2, 3, 5), (3, 2, 5, 9)), kinds):
        data, batch = rng.standard_normal(shape), max(0, len(shape) - 2)
        for output in (np.float32, np.uint8, np.float64):
            zoomed = ndimage.zoom(data, [1] * batch + [1.7] * (len(shape) - batch), output, order, precision=precision)
            assert np.isfinite(zoomed).all()
        filtered = np.empty((*shape, 2), np.float32)[::-1, ..., 0]
        ndimage.spline_filter1d(data, order, -1, filtered, precision=precision)
        assert np.isfinite(filtered).all()
        if len(shape) < 4:
            points = rng.uniform(-9, 20, (len(shape), 13))
            for mode in rules:
                assert np.isfinite(ndimage.map_coordinates(data, points, order=order, mode=mode, precision=precision)).all()
    low_passes: tuple[AntiAliasing, AntiAliasing] = ("gaussian", "least-squares")
    for shape, kind in itertools.product(((5, 70), (70, 5), (4, 33, 6)), low_passes):
        image = rng.standard_normal(shape).astype(np.float32)
        assert np.isfinite(clvol.resize(image, [max(1, n // 2) for n in shape], anti_aliasing=kind)).all()


def chains(small: NDArray[np.float32], rng: np.random.Generator) -> None:
    """Grids of every filter that a chain takes, with points inside and outside; values, gradients, Jacobians."""
    for volume in (small, small[0]):
        d = volume.ndim
        like = clvol.Volume(np.zeros(volume.shape, np.float32), (1.3,) * d, (-4.0,) * d)
        shift = [rng.uniform(-2, 2, (*(3, 4, 5)[-d:], d)) for _ in range(2)]
        for precision, order, name in zip(BOTH, (2, 3), ("bspline5", "linear"), strict=True):
            grids = [
                clvol.BSplineTransform(np.pad(shift[0], [(1, 1)] * d + [(0, 0)]), (4.0,) * d, (-2.0,) * d, order=order),
                clvol.DisplacementField(shift[1], (5.0,) * d, filter=name),
            ]
            made = clvol.warp(volume, like, grids, derivative=1, wrt="fixed", jacobian=True, precision=precision)
            assert made.gradient is not None
            assert made.jacobian is not None
            assert all(np.isfinite(each).all() for each in (made.values.data, made.gradient, made.jacobian.data))


def adjoints(rng: np.random.Generator) -> None:
    """Points inside, just outside and far outside, where the rule brings them to the outermost places."""
    for name, precision in zip(("nearest", "linear", "bspline2", "bspline5"), BOTH * 2, strict=True):
        for shape in ((1, 1), (9, 7), (3, 8, 5)):
            points = np.concatenate([rng.uniform(-3, 12, (70, len(shape))), np.full((1, len(shape)), 99.0)])
            assert np.isfinite(clvol.adjoint(np.ones(71), points, shape, name, "zero", precision=precision)).all()


def main(side: str) -> None:
    guard(side)
    rng = np.random.default_rng(0)
    looks = [clvol.Camera.orbit(a, e) for a, e in ((0, 0), (90, 0), (0, 90), (180, -90), (270, 10), (35, -25))]
    for shape in ((40, 40, 40), (3, 50, 9), (1, 2, 33)):
        with clvol.Renderer(rng.standard_normal(shape).astype(np.float32)) as renderer:
            for camera, mode, step in itertools.product(looks, modes(), (0.4, 3, 8, 300)):
                picture = renderer.render(camera, mode, (33, 31), step)
                assert np.isfinite(picture).all()
    small = rng.standard_normal((7, 18, 21)).astype(np.float32)
    for name in filters():
        with clvol.Renderer(small, filter=name) as renderer:
            for mode in ("isosurface", "composite"):
                assert np.isfinite(renderer.render(looks[-1], mode, (17, 13), 0.7)).all()
        for count, derivative in itertools.product((1, 70, 600), (0, 1, 2)):
            points = rng.uniform(-3, 24, (count, 3))
            if name != "nearest" or derivative == 0:
                assert np.isfinite(clvol.sample(small, points, derivative=derivative, filter=name)).all()
        assert np.isfinite(clvol.magnify(small, 2, filter=name).data).all()
    both_precisions(small, rng)
    arrays(rng)
    chains(small, rng)
    adjoints(rng)
    print("done")


if __name__ == "__main__":
    main(sys.argv[1])
