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

if TYPE_CHECKING:  # each name as itself, so that type checkers take it for public
    from clvol import analysis as analysis
    from clvol import device as device
    from clvol import figures as figures
    from clvol import formats as formats
    from clvol import images as images
    from clvol import labels as labels
    from clvol import ndimage as ndimage
    from clvol import noise as noise
    from clvol import phantoms as phantoms
    from clvol import reference as reference
    from clvol import reports as reports
    from clvol import view as view
    from clvol.base.errors import ClusterError as ClusterError
    from clvol.base.errors import ClvolError as ClvolError
    from clvol.base.errors import ClvolWarning as ClvolWarning
    from clvol.base.errors import DataError as DataError
    from clvol.base.errors import DeviceError as DeviceError
    from clvol.base.errors import FormatError as FormatError
    from clvol.base.errors import GeometryError as GeometryError
    from clvol.base.errors import MissingDependencyError as MissingDependencyError
    from clvol.base.errors import OptionError as OptionError
    from clvol.base.errors import OutOfMemoryError as OutOfMemoryError
    from clvol.bricks.field import BrickedField as BrickedField
    from clvol.bricks.source import LazyVolume as LazyVolume
    from clvol.device import Device as Device
    from clvol.device import devices as devices
    from clvol.filter.boundary import Boundary as Boundary
    from clvol.filter.boundary import boundaries as boundaries
    from clvol.filter.filter import Filter as Filter
    from clvol.filter.make import bc as bc
    from clvol.filter.make import bspline as bspline
    from clvol.filter.make import from_callable as from_callable
    from clvol.filter.make import from_pieces as from_pieces
    from clvol.filter.make import lanczos as lanczos
    from clvol.filter.make import moms3 as moms3
    from clvol.filter.make import quasi as quasi
    from clvol.filter.make import sinc as sinc
    from clvol.filter.make import wide as wide
    from clvol.filter.response import frequency_response as frequency_response
    from clvol.filter.response import prefilter_response as prefilter_response
    from clvol.filter.table import filters as filters
    from clvol.filter.table import register_filter as register_filter
    from clvol.formats import read as read
    from clvol.formats import read_all as read_all
    from clvol.formats import write as write
    from clvol.formats.opening import open as open  # noqa: A004  # as files are opened: clvol.open
    from clvol.formats.pyramid import pyramid as pyramid
    from clvol.formats.transforms import read_transform as read_transform
    from clvol.interfaces.batches import batch as batch
    from clvol.interfaces.interpolator import Interpolator as Interpolator
    from clvol.interfaces.mesh import Mesh as Mesh
    from clvol.interfaces.mesh import mesh as mesh
    from clvol.interfaces.movie import movie as movie
    from clvol.interfaces.orthogonal import orthogonal as orthogonal
    from clvol.interfaces.page import save_html as save_html
    from clvol.interfaces.radiograph import Radiograph as Radiograph
    from clvol.interfaces.resize import resize as resize
    from clvol.march.refine import Refined as Refined
    from clvol.march.renderer import Output as Output
    from clvol.march.renderer import Renderer as Renderer
    from clvol.march.renderer import render as render
    from clvol.march.slices import slice as slice  # noqa: A004  # as planes are shown: clvol.slice
    from clvol.scene.camera import Camera as Camera
    from clvol.scene.clip import Corner as Corner
    from clvol.scene.clip import Plane as Plane
    from clvol.scene.joint import TransferFunction2D as TransferFunction2D
    from clvol.scene.light import Light as Light
    from clvol.scene.light import Material as Material
    from clvol.scene.mode import Attenuated as Attenuated
    from clvol.scene.mode import Composite as Composite
    from clvol.scene.mode import Integral as Integral
    from clvol.scene.mode import Isosurface as Isosurface
    from clvol.scene.mode import Mean as Mean
    from clvol.scene.mode import Minip as Minip
    from clvol.scene.mode import Mip as Mip
    from clvol.scene.mode import Mode as Mode
    from clvol.scene.mode import Regions as Regions
    from clvol.scene.mode import Surfaces as Surfaces
    from clvol.scene.mode import modes as modes
    from clvol.scene.preset import presets as presets
    from clvol.scene.scene import Medium as Medium
    from clvol.scene.scene import Scene as Scene
    from clvol.scene.transfer import TransferFunction as TransferFunction
    from clvol.scene.written import read_transfer as read_transfer
    from clvol.show.picture import Picture as Picture
    from clvol.show.picture import save as save
    from clvol.show.picture import show as show
    from clvol.spline.field import Field as Field
    from clvol.spline.field import magnify as magnify
    from clvol.spline.field import prefilter as prefilter
    from clvol.spline.field import resample as resample
    from clvol.spline.field import sample as sample
    from clvol.spline.joint import joint_histogram as joint_histogram
    from clvol.spline.scatter import adjoint as adjoint
    from clvol.spline.scores import resample_scores as resample_scores
    from clvol.spline.vectors import VectorField as VectorField
    from clvol.spline.warp import Warped as Warped
    from clvol.spline.warp import resample_series as resample_series
    from clvol.spline.warp import warp as warp
    from clvol.volume.missing import Missing as Missing
    from clvol.volume.transform import AffineTransform as AffineTransform
    from clvol.volume.transform import BSplineTransform as BSplineTransform
    from clvol.volume.transform import DisplacementField as DisplacementField
    from clvol.volume.volume import Volume as Volume
    from clvol.volume.volumes import Volumes as Volumes

__version__ = "0.2.0"

_PLACES = {  # where each name is from; a test holds it to what is imported above
    "base.errors": "ClusterError ClvolError ClvolWarning DataError DeviceError FormatError GeometryError MissingDependencyError "
    "OptionError OutOfMemoryError",
    "bricks.field": "BrickedField",
    "bricks.source": "LazyVolume",
    "device": "Device devices",
    "filter.boundary": "Boundary boundaries",
    "filter.filter": "Filter",
    "filter.make": "bc bspline from_callable from_pieces lanczos moms3 quasi sinc wide",
    "filter.response": "frequency_response prefilter_response",
    "filter.table": "filters register_filter",
    "formats": "read read_all write",
    "formats.opening": "open",
    "formats.pyramid": "pyramid",
    "formats.transforms": "read_transform",
    "interfaces.batches": "batch",
    "interfaces.interpolator": "Interpolator",
    "interfaces.mesh": "Mesh mesh",
    "interfaces.movie": "movie",
    "interfaces.orthogonal": "orthogonal",
    "interfaces.page": "save_html",
    "interfaces.radiograph": "Radiograph",
    "interfaces.resize": "resize",
    "march.refine": "Refined",
    "march.renderer": "Output Renderer render",
    "march.slices": "slice",
    "scene.camera": "Camera",
    "scene.clip": "Corner Plane",
    "scene.joint": "TransferFunction2D",
    "scene.light": "Light Material",
    "scene.mode": "Attenuated Composite Integral Isosurface Mean Minip Mip Mode Regions Surfaces modes",
    "scene.preset": "presets",
    "scene.scene": "Medium Scene",
    "scene.transfer": "TransferFunction",
    "scene.written": "read_transfer",
    "show.picture": "Picture save show",
    "spline.field": "Field magnify prefilter resample sample",
    "spline.joint": "joint_histogram",
    "spline.scatter": "adjoint",
    "spline.scores": "resample_scores",
    "spline.vectors": "VectorField",
    "spline.warp": "Warped resample_series warp",
    "volume.missing": "Missing",
    "volume.transform": "AffineTransform BSplineTransform DisplacementField",
    "volume.volume": "Volume",
    "volume.volumes": "Volumes",
}
_PLACE = {name: place for place, names in _PLACES.items() for name in names.split()}
_MODULES = ("images", "ndimage", "phantoms")  # of `__all__`
_PARTS = (*_MODULES, "analysis", "device", "figures", "formats", "labels", "noise", "reference", "reports", "view")
# With what they need.
_OPTIONAL = {
    "dask": "dask",
    "jax": "JAX",
    "monai": "MONAI",
    "nitransforms": "NiTransforms",
    "nnunet": "nnU-Net",
    "torch": "torch",
    "torchio": "TorchIO",
    "xarray": "xarray",
}

__all__ = [*sorted([*_PLACE, *_MODULES])]


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
    return sorted({"__version__", *__all__, *_PARTS, *(_OPTIONAL.keys() & globals().keys())})
