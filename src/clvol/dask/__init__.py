"""Arrays of dask, an extra: the functions of clvol that take them, `pyramid`, and `reach`.

>>> import clvol, dask.array
>>> volume = dask.array.from_zarr("scan.zarr")
>>> clvol.resample(volume, spacing=2.0, anti_aliasing="least-squares")  # an array of dask; nothing has been read

`prefilter`, `resample` and `magnify` are those of clvol, and SciPy's functions those of `clvol.ndimage`: for an array of dask their
result is one.

Each block of a result reads the samples in the support of its own, and around them the margin that the prefilter needs until less
than rounding is left (`reach`): 14 for cubic splines in single precision, 24 in double. At the array's own edges blocks end by the
boundary rule, as the whole array does. A process looks its OpenCL device up when it computes its first block, and computes one at a
time.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from clvol.base.errors import MissingDependencyError

try:
    import dask.array  # noqa: F401  # all modules here stand on it
except ImportError as missing:
    raise MissingDependencyError('clvol.dask needs dask: pip install "clvol[dask]"') from missing

from clvol.dask.pyramids import pyramid
from clvol.filter.margin import reach
from clvol.spline.field import magnify, prefilter, resample

if TYPE_CHECKING:
    from clvol.ndimage import (
        affine_transform,
        geometric_transform,
        map_coordinates,
        rotate,
        shift,
        spline_filter,
        spline_filter1d,
        zoom,
    )

__all__ = [
    "affine_transform",
    "geometric_transform",
    "magnify",
    "map_coordinates",
    "prefilter",
    "pyramid",
    "reach",
    "resample",
    "rotate",
    "shift",
    "spline_filter",
    "spline_filter1d",
    "zoom",
]


def __getattr__(name: str) -> Any:
    """SciPy's functions, which `clvol.ndimage` defines for all arrays; it imports this package."""
    if name in __all__:
        return getattr(import_module("clvol.ndimage"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
