"""What lies past the edge, by `numpy.pad`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from clvol.boundary import DEFAULT_BOUNDARY, Boundary, as_boundary
from clvol.errors import OptionError

__all__ = ["extend", "period"]

_MODES: Final[dict[str, Any]] = {"mirror": "reflect", "reflect": "symmetric", "wrap": "wrap", "zero": "constant"}


def extend(data: NDArray[Any], width: int | Sequence[tuple[int, int]], boundary: str | Boundary = DEFAULT_BOUNDARY) -> NDArray[Any]:
    """`data` with more samples around it.

    Parameters
    ----------
    data : ndarray
        Of any number of axes, each at least 1 long.
    width : int or sequence of (int, int)
        Samples before and after, for every axis or for each.
    boundary : str or Boundary
        Mirror is NumPy's "reflect", reflect its "symmetric", wrap its "wrap" and zero its "constant".
    """
    widths = [(width, width)] * data.ndim if isinstance(width, int) else list(width)
    name = _name(boundary)
    for axis, (before, after) in enumerate(widths):
        one = [(0, 0)] * data.ndim
        one[axis] = (before, after)
        # reflecting a single sample about itself gives that sample again
        mode: Any = "edge" if name == "mirror" and data.shape[axis] == 1 else _MODES[name]
        data = np.pad(data, one, mode=mode)
    return data


def period(n: int, boundary: str | Boundary) -> int | None:
    """After how many samples the extension of an axis of `n` repeats; None if it never does."""
    name = _name(boundary)
    if name == "zero":
        return None
    return {"mirror": max(1, 2 * (n - 1)), "reflect": 2 * n, "wrap": n}[name]


def _name(boundary: str | Boundary) -> str:
    name = as_boundary(boundary).name
    if name not in _MODES:
        raise OptionError(f"the reference knows the boundaries {', '.join(_MODES)}; got {name!r}")
    return name
