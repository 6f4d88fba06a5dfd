"""Arrays of dask, lazily, an extra: `prefilter`, `resample`, `magnify`, and SciPy's functions of `clvol.ndimage`.

>>> import clvol, dask.array
>>> volume = dask.array.from_zarr("scan.zarr")
>>> clvol.resample(volume, spacing=2.0, anti_aliasing="least-squares")  # an array of dask; nothing has been read

`clvol.prefilter`, `clvol.resample`, `clvol.magnify` and the functions of `clvol.ndimage` hand arrays of dask to those here, so what
goes in as dask comes out as dask. These have two parameters more: `chunks`, those of the result, and for volumes `dimensions`, how
many of the last axes are those of a volume, each index of the others being a volume of its own.

Each block of a result takes the samples that it needs: those that its values are made of, and as many around them as the prefilter
reaches until less than rounding is left (`reach`): 12 for cubic splines in single precision, 24 in double. At the array's own edges
blocks end by the boundary rule, as the whole array does. A process finds its OpenCL device when it computes its first block, and
computes one block at a time.
"""

from __future__ import annotations

from clvol.base.errors import MissingDependencyError

try:
    import dask.array  # noqa: F401  # all modules here stand on it
except ImportError as missing:
    raise MissingDependencyError("clvol.dask needs dask: pip install clvol[dask]") from missing

from clvol.dask.filtering import prefilter, spline_filter, spline_filter1d
from clvol.dask.grids import affine_transform, rotate, shift, zoom
from clvol.dask.margins import reach
from clvol.dask.points import geometric_transform, map_coordinates
from clvol.dask.pyramids import pyramid
from clvol.dask.volumes import magnify, resample

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
