"""SciPy's interpolation of arrays, on OpenCL: ``from clvol import ndimage`` in place of ``from scipy import ndimage``.

`spline_filter1d`, `spline_filter`, `map_coordinates`, `affine_transform`, `zoom`, `shift`, `rotate` and `geometric_transform` have
SciPy's signatures and rules, and a few more keywords (`precision`, `device`, `nan`, `progress`, `small`, `chunks`). What they
cannot do they refuse. Small arrays, for which a kernel's start would take longest, SciPy computes, unless ``small="opencl"``. All
other names of `scipy.ndimage` (`gaussian_filter`, `label`, ...) are SciPy's own functions, which this module looks up there.

``order="labels"`` is for label maps: whole numbers are kept, never blended, and their boundaries are smooth, as by `clvol.resample`
with ``smooth=True``: an element gets the label whose indicator is largest there, reconstructed by unprefiltered quintic B-splines,
also along axes that do not change. It takes arrays of up to three axes, in memory or of dask; `cval` is a label.

The input is one of

- an array, or what can be made into one. Where its coefficients do not fit in memory, it is evaluated by bricks, with a
  `ClvolWarning`;
- a `LazyVolume` or a `BrickedField`, which is read brick by brick, in single precision. Values differ by less than 10⁻⁶ of the
  samples' range (order 5: 4 · 10⁻⁶) from those computed in memory;
- an array of dask, and so is the result, which is evaluated block by block. `output` is then a dtype, `nan` not "local", and
  `progress` is dask's own. Without a prefilter (orders 0 and 1, or ``prefilter=False``) the result is bit for bit that in memory,
  of calls that are not small, but for the last bits of positions: where a matrix mixes axes, and within a margin of the seam under
  "grid-wrap". (Samples far from zero compared with their range are computed in double precision; each block decides that for
  itself.) With a prefilter, coefficients differ as those of `clvol.prefilter` do, and integers cut off from them by 1 where a
  coefficient is that near to one.

`patched` puts the functions into SciPy's place for programs that cannot be changed, as does ``python -m clvol.ndimage script.py``.
"""

from __future__ import annotations

from typing import Any

from clvol.ndimage.interpolation import (
    affine_transform,
    geometric_transform,
    map_coordinates,
    rotate,
    shift,
    spline_filter,
    spline_filter1d,
    zoom,
)
from clvol.ndimage.patch import Report, patched

__all__ = [
    "Report",
    "affine_transform",
    "geometric_transform",
    "map_coordinates",
    "patched",
    "rotate",
    "shift",
    "spline_filter",
    "spline_filter1d",
    "zoom",
]


def __getattr__(name: str) -> Any:
    if not name.startswith("_"):
        from scipy import ndimage

        if name in ndimage.__all__:
            return getattr(ndimage, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    from scipy import ndimage

    return sorted({*globals(), *ndimage.__all__})
