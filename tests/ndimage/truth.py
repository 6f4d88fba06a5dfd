"""The truth for `clvol.ndimage`: SciPy in float64, with its prefilter's initial values corrected where they are wrong."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

MODES = ("mirror", "reflect", "grid-mirror", "wrap", "grid-wrap", "nearest", "constant", "grid-constant")
SINGLE = 2e-6
"""Of the range of the data times the prefilter's gain; `DOUBLE` too."""
DOUBLE = 1e-12
GAIN = (1, 1, 2, 3, 4.8, 7.5)
"""By order, of the prefilter along one axis at the highest frequency: the inverse of the B-spline's response there."""
Array = NDArray[Any]


def computed_in(data: Array, precision: str | None) -> str:
    """The precision that clvol documents."""
    small = data.dtype.kind == "b" or data.dtype.itemsize <= 2 or data.dtype.newbyteorder("=") in (np.float32, np.complex64)
    return precision or ("single" if small else "double")


def tolerance(data: Array, order: int, precision: str | None, resampled: int, cval: complex = 0) -> float:
    """The allowed difference of a result from the truth."""
    largest = max(float(np.abs(data.astype(np.complex128)).max(initial=0)), abs(cval))
    return float((SINGLE if computed_in(data, precision) == "single" else DOUBLE) * largest * GAIN[order] ** min(resampled, 3))


def truth(
    name: str, data: Array, *arguments: Any, order: int, mode: str, cval: complex = 0.0, prefilter: bool = True, **options: Any
) -> Array:
    """A SciPy function in float64, or by parts in complex128."""
    if data.dtype.kind == "c":
        options |= {"order": order, "mode": mode, "prefilter": prefilter}
        real = truth(name, data.real, *arguments, cval=np.real(cval), **options)
        return real + 1j * truth(name, data.imag, *arguments, cval=np.imag(cval), **options)
    source = data.astype(np.float64)
    if mode in ("reflect", "grid-mirror") and prefilter and order > 1:
        plane = (arguments[1] if len(arguments) > 1 else (1, 0)) if name == "rotate" else None
        source, prefilter = reflected(source, order, plane), False
    function = getattr(ndimage, name)
    result: Array = function(
        source, *arguments, output=np.float64, order=order, mode=mode, cval=cval, prefilter=prefilter, **options
    )
    return result


def reflected(data: Array, order: int, axes: Any = None, margin: int = 40) -> Array:
    """Coefficients under "reflect"; SciPy's are wrong by up to 0.4 % of the range on short axes."""
    for axis in range(data.ndim) if axes is None else axes:
        wide = np.pad(data, [(margin, margin) if k == axis else (0, 0) for k in range(data.ndim)], mode="symmetric")
        inner = tuple(slice(margin, -margin) if k == axis else slice(None) for k in range(data.ndim))
        data = ndimage.spline_filter1d(wide, order, axis)[inner]
    return data


def assert_holds(result: Array, exact: Array, allowed: float) -> None:
    """`result` is `exact` in its type: integers are rounded and clipped; 1 or more is true."""
    __tracebackhide__ = True
    assert result.shape == exact.shape
    if result.dtype.kind == "c":
        assert_holds(result.real, exact.real, allowed)
        assert_holds(result.imag, exact.imag, allowed)
        return
    if result.dtype.kind == "b":
        sure = (exact > -1) & (exact < 255) & (np.abs(exact - 1) > allowed)  # elsewhere C's conversion is not defined
        np.testing.assert_array_equal(result[sure], exact[sure] > 1)
        return
    if result.dtype.kind in "iu":
        limits = np.iinfo(result.dtype)
        exact = np.clip(exact, float(limits.min), float(limits.max))
        allowed += 0.5 * (1 + 1e-15)
    elif result.dtype.itemsize < 8:
        allowed += float(np.finfo(result.dtype).eps * np.abs(exact).max(initial=0))
    assert np.abs(result.astype(np.float64) - exact).max(initial=0) <= allowed
