"""A plugin for pytest that puts clvol under `scipy.ndimage`, so that SciPy's own tests of interpolation test clvol.

``python -m pytest -p scipy_shim --pyargs scipy.ndimage.tests.test_interpolation`` with this folder on the path. What is
replaced is what SciPy has in C: the prefilter (`clvol.prefilter`) and the sum of weighted coefficients at positions
(`clvol.sample` with a filter that has no prefilter). The Python around them stays SciPy's. A comparison of floating numbers
that fails is repeated with the tolerance of float32, which is what clvol computes in.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import _interpolation

import clvol

FLOAT32 = 4e-6
"""Of the largest number compared, or of 1: prefilters gain, and the tests have numbers of the order of ten."""

# SciPy's modes by their codes. The rule for coefficients past the edge is clvol's boundary of this name; where SciPy has no exact
# rule it filters, and takes taps, under "mirror".
NEAREST, WRAP, REFLECT, MIRROR, CONSTANT, GRID_WRAP, GRID_CONSTANT = range(7)
BOUNDARY = {NEAREST: "reflect", WRAP: "mirror", REFLECT: "reflect", MIRROR: "mirror", CONSTANT: "mirror", GRID_WRAP: "wrap"}
BOUNDARY |= {GRID_CONSTANT: "mirror"}
CODES = {"nearest": NEAREST, "wrap": WRAP, "reflect": REFLECT, "grid-mirror": REFLECT, "mirror": MIRROR, "constant": CONSTANT}
CODES |= {"grid-wrap": GRID_WRAP, "grid-constant": GRID_CONSTANT}
Array = NDArray[Any]


def evaluated_by(order: int) -> str:
    """The filter that weighs coefficients by the B-spline of this order."""
    return {0: "nearest", 1: "linear"}.get(order, f"bspline{order}-approx")


def spline_filter(data: Array, order: int = 3, output: Any = np.float64, mode: str = "mirror") -> Array:
    """Under `map_coordinates` and its kin: coefficients along all axes."""
    if data.ndim == 0 or data.ndim > 3:
        return ORIGINAL_FILTER(data, order, output, mode)
    return clvol.prefilter(data, f"bspline{order}", BOUNDARY[CODES[mode]]).astype(output)


class OnDevice:
    """What `scipy.ndimage._interpolation` calls in C."""

    def __getattr__(self, name: str) -> Any:
        return getattr(ORIGINAL_C, name)

    @staticmethod
    def spline_filter1d(data: Array, order: int, axis: int, output: Array, mode: int) -> None:
        lines = np.moveaxis(data, axis, -1)
        filtered = np.empty(lines.shape)
        for index in np.ndindex(lines.shape[:-1]):
            filtered[index] = clvol.prefilter(lines[index], f"bspline{order}", BOUNDARY[mode])
        output[...] = np.moveaxis(filtered, -1, axis)

    @staticmethod
    def geometric_transform(
        coefficients: Array,
        mapping: Callable[..., Any] | None,
        coordinates: Array | None,
        matrix: Array | None,
        offset: Array | None,
        output: Array,
        order: int,
        mode: int,
        cval: float,
        npad: int,
        extra_arguments: tuple[Any, ...] | None,
        extra_keywords: dict[str, Any] | None,
    ) -> None:
        if coordinates is not None:
            positions = np.asarray(coordinates, np.float64)
        elif mapping is not None:
            arguments, keywords = extra_arguments or (), extra_keywords or {}
            mapped = [mapping(index, *arguments, **keywords) for index in np.ndindex(output.shape)]
            positions = np.array(mapped, np.float64).reshape((*output.shape, -1))
            positions = np.moveaxis(positions, -1, 0)
        else:
            grid = np.indices(output.shape, np.float64)
            # summed up in this order, as in C: a position that is rounded to just outside is outside
            positions = np.stack(
                [sum(row[k] * grid[k] for k in range(len(row))) + o for row, o in zip(matrix, offset, strict=True)]
            )
        store(output, evaluate(coefficients, positions + npad, order, mode, cval))

    @staticmethod
    def zoom_shift(
        coefficients: Array,
        zoom: Array | None,
        shift: Array | None,
        output: Array,
        order: int,
        mode: int,
        cval: float,
        npad: int,
        grid_mode: bool,
    ) -> None:
        positions = np.indices(output.shape, np.float64)
        for axis, along in enumerate(positions):
            if shift is not None:
                along += shift[axis]
            if zoom is not None and grid_mode:
                along[...] = (along + 0.5) * zoom[axis] - 0.5
            elif zoom is not None:
                along *= zoom[axis]
        store(output, evaluate(coefficients, positions + npad, order, mode, cval))


def evaluate(coefficients: Array, positions: Array, order: int, mode: int, cval: float) -> Array:
    """The spline of these coefficients at positions in array order, shape (d, ...); float64."""
    positions = np.array(positions)
    outside = np.zeros(positions.shape[1:], bool)
    for along, n in zip(positions, coefficients.shape, strict=True):
        if mode == CONSTANT:
            outside |= (along < 0) | (along > n - 1)
            np.clip(along, 0, n - 1, out=along)
        elif mode == WRAP:  # the last sample is the first one again
            beyond = (along < 0) | (along > n - 1)
            along[beyond] %= max(n - 1, 1) if n > 1 else np.inf
        elif mode == NEAREST:
            np.clip(along, 0, n - 1, out=along)
        elif mode == GRID_CONSTANT:  # no further than all taps are outside
            np.clip(along, -order - 1, n + order, out=along)
    if mode in (NEAREST, GRID_CONSTANT):
        margin = 2 * order + 3
        extension = {"mode": "edge"} if mode == NEAREST else {"mode": "constant", "constant_values": cval}
        coefficients = np.pad(np.asarray(coefficients, np.float64), margin, **extension)
        positions += margin
    if coefficients.ndim == 1:
        coefficients, positions = coefficients[None], np.stack([np.zeros_like(positions[0]), positions[0]])
    points = np.moveaxis(positions[::-1], 0, -1)
    values = clvol.sample(coefficients, points, evaluated_by(order), BOUNDARY[mode]).astype(np.float64)
    return np.where(outside, cval, values)


def store(output: Array, values: Array) -> None:
    """In the type of `output`: whole numbers are rounded, halves away from zero, and clipped."""
    if output.dtype.kind in "iu":
        limits = np.iinfo(output.dtype)
        values = np.clip(np.trunc(values + np.copysign(0.5, values)), limits.min, limits.max)
    output[...] = values.astype(output.dtype)


def tolerant(check: Callable[..., None]) -> Callable[..., None]:
    """An assertion on arrays that, where it fails, compares floating numbers with the tolerance of float32."""

    @wraps(check)
    def checked(actual: Any, desired: Any, *args: Any, **options: Any) -> None:
        __tracebackhide__ = True
        try:
            check(actual, desired, *args, **options)
        except AssertionError:
            got, want = np.asarray(actual), np.asarray(desired)
            if got.dtype.kind not in "fc" or got.shape != want.shape:
                raise
            if check.__name__.startswith("xp_") and options.get("check_dtype", True) and got.dtype != want.dtype:
                raise
            np.testing.assert_allclose(got, want, rtol=0, atol=FLOAT32 * max(1.0, float(np.abs(want).max(initial=0))))

    return checked


ORIGINAL_C: ModuleType = _interpolation._nd_image
ORIGINAL_FILTER = _interpolation.spline_filter


def pytest_configure() -> None:
    _interpolation._nd_image = OnDevice()
    _interpolation.spline_filter = spline_filter


def pytest_collection_finish(session: pytest.Session) -> None:
    for module in {item.module for item in session.items if isinstance(item, pytest.Function)}:
        for name, value in vars(module).items():
            if callable(value) and name.startswith(("assert_a", "assert_equal", "xp_assert")):
                setattr(module, name, tolerant(value))
        if hasattr(module, "eps"):  # what SciPy's tests add to a limit of 24
            module.eps = 24 * FLOAT32
