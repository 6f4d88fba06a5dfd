"""Boundary rules by `numpy.pad`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import OptionError
from clvol.filter.boundary import DEFAULT_BOUNDARY, Boundary, as_boundary
from clvol.filter.filter import Filter

__all__ = ["extend", "pad", "padding", "period", "placed", "solved_by"]

# by base name: how coefficients are continued, and the rule at the ends of the prefilter
_RULES: Final[dict[str, tuple[Any, str]]] = {
    "mirror": ("reflect", "mirror"),
    "reflect": ("symmetric", "reflect"),
    "wrap": ("wrap", "wrap"),
    "zero": ("constant", "zero"),
    "nearest": ("edge", "reflect"),
    "constant": ("reflect", "mirror"),
    "grid-constant": ("constant", "mirror"),
    "overlap": ("reflect", "mirror"),
}
_DEEP: Final = 12  # samples, as in SciPy; a cubic's prefilter decays by 2e7 over them


def extend(data: NDArray[Any], width: int | Sequence[tuple[int, int]], boundary: str | Boundary = DEFAULT_BOUNDARY) -> NDArray[Any]:
    """Coefficients extended on all sides.

    Parameters
    ----------
    data : ndarray
        Coefficients with any number of axes, each at least 1 long.
    width : int or sequence of (int, int)
        Samples before and after, for every axis or for each.
    boundary : str or Boundary
        Mirror is NumPy's "reflect", and so are constant and overlap; reflect is its "symmetric", wrap its "wrap", nearest its
        "edge", and zero and grid-constant its "constant".
    """
    widths = [(width, width)] * data.ndim if isinstance(width, int) else list(width)
    mode, value = _RULES[_name(boundary)][0], as_boundary(boundary).cval
    for axis, (before, after) in enumerate(widths):
        one = [(0, 0)] * data.ndim
        one[axis] = (before, after)
        if mode == "constant":
            kind = data.dtype if value == 0 else np.result_type(data.dtype, np.float64)
            data = np.pad(data.astype(kind), one, constant_values=value)
        else:  # a single sample reflected about itself is the same sample
            data = np.pad(data, one, mode="edge" if mode == "reflect" and data.shape[axis] == 1 else mode)
    return data


def padding(filter: Filter, boundary: str | Boundary) -> int:
    """The number of samples added at each end before the prefilter."""
    if _name(boundary) not in ("nearest", "grid-constant"):
        return 0
    row = filter.magnified_by or filter
    return max(_DEEP, row.support) if row.prefilter else 0


def pad(samples: NDArray[np.float64], filter: Filter, boundary: str | Boundary) -> NDArray[np.float64]:
    """Samples padded with the outer ones, or the constant, as input of the prefilter."""
    width = padding(filter, boundary)
    if not width:
        return samples
    if _name(boundary) == "nearest":
        return np.pad(samples, width, mode="edge")
    return np.pad(samples, width, constant_values=as_boundary(boundary).cval)


def solved_by(boundary: str | Boundary) -> str:
    """The rule for the coefficients outside in eq. (11), after `pad`."""
    return _RULES[_name(boundary)][1]


def period(n: int, boundary: str | Boundary) -> int | None:
    """The period, in samples, of the function on an axis of `n` samples; None if it has none."""
    lengths = {"mirror": 2 * (n - 1), "reflect": 2 * n, "wrap": n, "overlap": n - 1}
    name = _name(boundary)
    return max(1, lengths[name]) if name in lengths else None


def placed(
    x: NDArray[np.float64], n: int, margin: int, pad: int, boundary: str | Boundary
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Positions in samples, moved to where the coefficients define the function, and a mask of those with the boundary's constant.

    The axis has `n` samples and `pad` more at each end. All taps of a position `margin` further out are past these, and from there
    on the function repeats with every sample.
    """
    name, last, at = _name(boundary), n - 1, x.copy()
    away = (x < 0) | (x > last)
    if name == "constant":
        return np.where(away, 0, x), away
    if name == "overlap":  # as in SciPy: from the left to the last sample, from the right to the first
        left, right, length = x < 0, x > last, max(last, 1)
        at[left] = length - np.mod(-x[left], length)
        at[right] = np.mod(x[right], length)
        at = np.clip(at, 0, length)
    elif (cycle := period(n, boundary)) is None:
        low, high = -pad - margin, last + pad + margin
        at = np.where(x < low, low - 1 + np.mod(x, 1), np.where(x > high, high + np.mod(x, 1), x))
    else:
        away = (x < -0.5) | (x > n - 0.5)
        at[away] = np.mod(x[away], cycle)
    return at, np.zeros(x.shape, bool)


def _name(boundary: str | Boundary) -> str:
    name = as_boundary(boundary).name.partition("(")[0]
    if name not in _RULES:
        raise OptionError(f"the reference knows the boundaries {', '.join(_RULES)}; got {name!r}")
    return name
