"""Volume rendering and reconstruction with B-splines, on OpenCL.

>>> import clvol
>>> volume = clvol.read("scan.nii.gz")
>>> picture = clvol.render(volume)                                    # (height, width, 4), float32
>>> values = clvol.sample(volume, points)                             # at world positions (x, y, z)
>>> gradients = clvol.sample(volume, points, derivative=1)            # exact, per world unit

Importing it takes no time and needs no OpenCL: its parts are imported when they are first used, and a device is looked for when
something is computed on one.
"""

from __future__ import annotations

from clvol.base import interrupted as interrupted  # before all that takes long to import

# isort: split
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from clvol import images, ndimage, phantoms
    from clvol.base.errors import (
        ClusterError,
        ClvolError,
        ClvolWarning,
        DataError,
        DeviceError,
        FormatError,
        GeometryError,
        MissingDependencyError,
        OptionError,
        OutOfMemoryError,
    )
    from clvol.bricks.field import BrickedField
    from clvol.bricks.source import LazyVolume
    from clvol.device import Device, devices
    from clvol.filter.boundary import Boundary, boundaries
    from clvol.filter.filter import Filter
    from clvol.filter.make import bc, bspline, from_callable, from_pieces, lanczos, moms3, quasi, sinc
    from clvol.filter.response import frequency_response, prefilter_response
    from clvol.filter.table import filters, register_filter
    from clvol.formats import read, read_all, write
    from clvol.formats.opening import open  # noqa: A004  # as files are opened: clvol.open
    from clvol.formats.pyramid import pyramid
    from clvol.formats.transforms import read_transform
    from clvol.interfaces.batches import batch
    from clvol.interfaces.interpolator import Interpolator
    from clvol.interfaces.resize import resize
    from clvol.march.refine import Refined
    from clvol.march.renderer import Output, Renderer, render
    from clvol.scene.camera import Camera
    from clvol.scene.light import Light, Material
    from clvol.scene.mode import Attenuated, Composite, Isosurface, Mean, Minip, Mip, Mode, modes
    from clvol.scene.preset import presets
    from clvol.scene.scene import Medium, Scene
    from clvol.scene.transfer import TransferFunction
    from clvol.show.picture import Picture, save, show
    from clvol.spline.field import Field, magnify, prefilter, resample, sample
    from clvol.spline.scatter import adjoint
    from clvol.spline.warp import Warped, resample_series, warp
    from clvol.volume.missing import Missing
    from clvol.volume.transform import AffineTransform, BSplineTransform, DisplacementField
    from clvol.volume.volume import Volume
    from clvol.volume.volumes import Volumes

__version__ = "0.1.0"

__all__ = [
    "AffineTransform",
    "Attenuated",
    "BSplineTransform",
    "Boundary",
    "BrickedField",
    "Camera",
    "ClusterError",
    "ClvolError",
    "ClvolWarning",
    "Composite",
    "DataError",
    "Device",
    "DeviceError",
    "DisplacementField",
    "Field",
    "Filter",
    "FormatError",
    "GeometryError",
    "Interpolator",
    "Isosurface",
    "LazyVolume",
    "Light",
    "Material",
    "Mean",
    "Medium",
    "Minip",
    "Mip",
    "Missing",
    "MissingDependencyError",
    "Mode",
    "OptionError",
    "OutOfMemoryError",
    "Output",
    "Picture",
    "Refined",
    "Renderer",
    "Scene",
    "TransferFunction",
    "Volume",
    "Volumes",
    "Warped",
    "adjoint",
    "batch",
    "bc",
    "boundaries",
    "bspline",
    "devices",
    "filters",
    "frequency_response",
    "from_callable",
    "from_pieces",
    "images",
    "lanczos",
    "magnify",
    "modes",
    "moms3",
    "ndimage",
    "open",
    "phantoms",
    "prefilter",
    "prefilter_response",
    "presets",
    "pyramid",
    "quasi",
    "read",
    "read_all",
    "read_transform",
    "register_filter",
    "render",
    "resample",
    "resample_series",
    "resize",
    "sample",
    "save",
    "show",
    "sinc",
    "warp",
    "write",
]

_PLACES = {  # where each name is from; a test holds it to what is imported above
    "base.errors": "ClusterError ClvolError ClvolWarning DataError DeviceError FormatError GeometryError MissingDependencyError "
    "OptionError OutOfMemoryError",
    "bricks.field": "BrickedField",
    "bricks.source": "LazyVolume",
    "device": "Device devices",
    "filter.boundary": "Boundary boundaries",
    "filter.filter": "Filter",
    "filter.make": "bc bspline from_callable from_pieces lanczos moms3 quasi sinc",
    "filter.response": "frequency_response prefilter_response",
    "filter.table": "filters register_filter",
    "formats": "read read_all write",
    "formats.opening": "open",
    "formats.pyramid": "pyramid",
    "formats.transforms": "read_transform",
    "interfaces.batches": "batch",
    "interfaces.interpolator": "Interpolator",
    "interfaces.resize": "resize",
    "march.refine": "Refined",
    "march.renderer": "Output Renderer render",
    "scene.camera": "Camera",
    "scene.light": "Light Material",
    "scene.mode": "Attenuated Composite Isosurface Mean Minip Mip Mode modes",
    "scene.preset": "presets",
    "scene.scene": "Medium Scene",
    "scene.transfer": "TransferFunction",
    "show.picture": "Picture save show",
    "spline.field": "Field magnify prefilter resample sample",
    "spline.scatter": "adjoint",
    "spline.warp": "Warped resample_series warp",
    "volume.missing": "Missing",
    "volume.transform": "AffineTransform BSplineTransform DisplacementField",
    "volume.volume": "Volume",
    "volume.volumes": "Volumes",
}
_PLACE = {name: place for place, names in _PLACES.items() for name in names.split()}
_PARTS = (
    "analysis",
    "device",
    "figures",
    "formats",
    "images",
    "labels",
    "ndimage",
    "noise",
    "phantoms",
    "reference",
    "reports",
    "view",
)
_OPTIONAL = {"dask": "dask", "torch": "torch", "xarray": "xarray"}  # with what they need


def __getattr__(name: str) -> Any:
    if name in _PLACE:
        value = getattr(import_module(f"clvol.{_PLACE[name]}"), name)
        globals()[name] = value
        return value
    if name in _PARTS:
        return import_module(f"clvol.{name}")
    hint = f"; it needs {_OPTIONAL[name]}: import clvol.{name} first" if name in _OPTIONAL else ""
    raise AttributeError(f"module 'clvol' has no attribute {name!r}{hint}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, *_PARTS})
