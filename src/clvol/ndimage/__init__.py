"""SciPy's interpolation of arrays, on OpenCL: ``from clvol import ndimage`` in place of ``from scipy import ndimage``.

`spline_filter1d`, `spline_filter`, `map_coordinates`, `affine_transform`, `zoom`, `shift`, `rotate` and `geometric_transform` have
SciPy's signatures and rules, and a few more keywords (`precision`, `device`, `nan`, `progress`). What they cannot do they refuse;
they never pass a call on to SciPy. All other names of `scipy.ndimage` (`gaussian_filter`, `label`, ...) are SciPy's own functions,
which this module looks up there: they do not interpolate and run as they always did.

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
