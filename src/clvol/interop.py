"""Reading other libraries' objects: SimpleITK and nibabel images, tensors, and arrays of any kind; and writing into these."""

from __future__ import annotations

import sys
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from clvol.errors import ClvolError, DataError, GeometryError, MissingDependencyError, OptionError

__all__ = [
    "NIFTI_MILLIMETRES",
    "Content",
    "Placement",
    "affine_parts",
    "as_array",
    "as_output",
    "from_nibabel",
    "from_ras",
    "from_simpleitk",
    "memory_of",
    "read_array",
    "simpleitk",
]

NIFTI_MILLIMETRES = {0: 1.0, 1: 1e3, 2: 1.0, 3: 1e-3}
"""Of the unit of length that NIfTI's ``xyzt_units & 7`` stands for: none, m, mm and µm."""

_FLAT = 1e-4  # files keep directions in float32
_ON_HOST = {1, 3, 11, 13}  # DLPack's types of device whose memory the host can read: its own, pinned, and managed
_TO_HOST = {"torch": "tensor.cpu()", "cupy": "array.get()", "jax": "jax.device_get(array)", "jaxlib": "jax.device_get(array)"}

Content: TypeAlias = tuple[NDArray[Any], dict[str, Any]]
"""Samples [z, y, x], and those keyword arguments of `Volume` that their source knows: spacing, origin, direction, units."""

Placement: TypeAlias = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
"""Spacing, origin and direction (columns) of three index axes in the world."""


@runtime_checkable
class _Gridded(Protocol):
    """What a `clvol.Volume` has; the class itself stands on this module."""

    data: NDArray[Any]
    spacing: tuple[float, ...]
    origin: tuple[float, ...]
    direction: NDArray[np.float64]
    units: str


def read_array(source: Any) -> Content:
    """The samples of `source`, and the geometry that its kind of object carries.

    Raises
    ------
    DataError
        Ragged or masked data, data in the memory of a device, several values per voxel, or a number of axes that the kind of
        object does not allow.
    GeometryError
        The affine of a nibabel image is singular or not finite, or its unit of length unknown.
    """
    if hasattr(source, "GetSpacing") and hasattr(source, "GetDirection"):
        return from_simpleitk(source)
    if hasattr(source, "affine") and hasattr(source, "dataobj"):
        return from_nibabel(source)
    if not isinstance(source, np.ndarray) and isinstance(source, _Gridded):  # asked for `data`, an array of dates raises
        return as_array(source.data), {name: getattr(source, name) for name in ("spacing", "origin", "direction", "units")}
    return as_array(source), {}


def as_array(
    source: Any, what: str = "data", error: type[ClvolError] = DataError, rule: str = "a regular array of numbers"
) -> NDArray[Any]:
    """An array of whatever has `__array__`, `__array_interface__`, `__dlpack__` or a buffer, and of nested sequences.

    Its memory is shared, not copied, where the object's protocol allows it. Tensors of PyTorch are detached from their graph;
    bfloat16, which NumPy does not have, becomes float32, which holds it exactly.

    Parameters
    ----------
    source : object
        In the host's memory.
    what : str
        What messages call it.
    error : type
        The class of what is raised.
    rule : str
        What messages say that it must be.

    Raises
    ------
    ClvolError
        It lies in the memory of a device, is ragged, sparse, or has masked elements.
    """
    if type(source) is np.ndarray:
        return source
    if np.ma.is_masked(source):
        raise error(f"{what} must be {rule} with no masked element; replace them with .filled(value) of the masked array")
    if not _on_host(source):
        advice = _TO_HOST.get(type(source).__module__.partition(".")[0], "with what its library has for that")
        kind = f"{type(source).__module__}.{type(source).__qualname__}"
        raise error(f"{what} must lie in the host's memory; got a {kind} on a device: copy it to the host first, {advice}")
    try:
        if _is_tensor(source):
            return _of_tensor(source)
        reads = hasattr(source, "__array__") or hasattr(source, "__array_interface__") or not hasattr(source, "__dlpack__")
        array = np.asarray(source) if reads else np.from_dlpack(source)
    except (TypeError, ValueError, RuntimeError, BufferError) as reason:
        raise error(f"{what} must be {rule}; got one that NumPy cannot read: {reason}") from None
    return array.astype(np.float32) if array.dtype.name == "bfloat16" else array


def as_output(out: Any, shape: tuple[int, ...], what: str = "out") -> NDArray[Any]:
    """The memory of an object as an array that results are to be written into.

    Parameters
    ----------
    out : object
        What `as_array` reads without a copy: an array of NumPy with any strides, a tensor of PyTorch on the host, ...
    shape : tuple of int
        Of the results.
    what : str
        What messages call it.

    Raises
    ------
    OptionError
        It has another shape, is neither float32 nor float64, may only be read, has to be copied to become an array, or is a
        tensor that requires a gradient.
    """
    array = memory_of(out, what)
    if array.dtype.kind != "f" or array.dtype.itemsize not in (4, 8):
        raise OptionError(f"{what} must be float32 or float64; got {array.dtype}")
    if array.shape != shape:
        raise OptionError(f"{what} must have shape {shape}; got {array.shape}")
    if not array.flags.writeable:
        raise OptionError(f"{what} must be an array that can be written into; got {type(out).__qualname__} that may only be read")
    return array


def memory_of(out: Any, what: str) -> NDArray[Any]:
    """The memory of an object as an array of NumPy, as `as_output` has it, of any type and shape, if only to be read.

    Raises
    ------
    OptionError
        It has to be copied to become an array, or is a tensor that requires a gradient.
    """
    if type(out) is np.ndarray:
        return out
    if getattr(out, "requires_grad", False):
        raise OptionError(f"{what} must not require a gradient, which writing into it would not follow; give {what}.detach()")
    array = as_array(out, what, OptionError)
    if array.size and not np.may_share_memory(array, as_array(out, what, OptionError)):
        raise OptionError(
            f"{what} must be an array that can be written into; got {type(out).__qualname__}, of which NumPy makes a copy"
        )
    return array


def _is_tensor(source: object) -> bool:
    """Whether it is a tensor of PyTorch, which needs no import to know."""
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(source, torch.Tensor)


def _on_host(source: Any) -> bool:
    if _is_tensor(source):
        return bool(source.device.type == "cpu")
    if hasattr(source, "__dlpack_device__"):
        try:
            return int(source.__dlpack_device__()[0]) in _ON_HOST
        except (BufferError, RuntimeError, TypeError, ValueError):  # one that says nothing, such as an array in shards
            pass
    return hasattr(source, "__array_interface__") or not hasattr(source, "__cuda_array_interface__")


def _of_tensor(tensor: Any) -> NDArray[Any]:
    """The memory of a tensor of PyTorch on the host."""
    plain = tensor.detach().resolve_conj().resolve_neg()
    return np.asarray((plain.float() if str(plain.dtype) == "torch.bfloat16" else plain).numpy())


def from_simpleitk(image: Any, units: str = "") -> Content:
    """Samples, geometry and `units` of a SimpleITK image, without trailing axes of one sample.

    The rule for units: an image in memory has none, because SimpleITK keeps none. A reader of files passes the unit that
    its format or header fixes (millimetres for NIfTI, MetaImage and DICOM).

    Raises
    ------
    DataError
        Several values per voxel, or more than three axes.
    """
    rank, channels, size = image.GetDimension(), image.GetNumberOfComponentsPerPixel(), image.GetSize()
    if channels != 1:
        raise DataError(f"data must have one value per voxel; got {channels}: split the image into its channels")
    if any(n != 1 for n in size[3:]):
        raise DataError(f"data must have 2 or 3 axes; got {size} samples: split the image into its frames")
    d = min(rank, 3)
    data = simpleitk().GetArrayFromImage(image)  # np.asarray would give a flat float64 array
    geometry = {
        "spacing": image.GetSpacing()[:d],
        "origin": image.GetOrigin()[:d],
        "direction": np.reshape(image.GetDirection(), (rank, rank))[:d, :d],
        "units": units,
    }
    return data.reshape(data.shape[rank - d :]), geometry


def from_nibabel(image: Any) -> Content:
    """Samples and geometry of a nibabel image, in millimetres: its arrays are [x, y, z] in a RAS world, ours [z, y, x] in LPS.

    Where the image measures in metres or micrometres (``xyzt_units`` of NIfTI), its affine does too.

    Raises
    ------
    DataError
        A number of axes other than 2 and 3, not counting trailing axes of one sample.
    GeometryError
        The affine is singular or not finite; the unit of length is unknown; an image of two axes lies across the world's
        xy plane.
    """
    data = np.asanyarray(image.dataobj)
    d = min(data.ndim, 3)
    if d < 2 or any(n != 1 for n in data.shape[3:]):
        raise DataError(f"data must have 2 or 3 axes; got a nibabel image of shape {data.shape}")
    affine = np.asarray(image.affine, dtype=np.float64)
    if not np.isfinite(affine).all() or (np.linalg.norm(affine[:3, :3], axis=0) == 0).any():
        raise GeometryError(f"the image's affine must be finite and not singular; got {image.affine!r}")
    # the name that get_xyzt_units has for a unit of time, in the same number, may be missing, and says nothing about space
    unit = int(image.header["xyzt_units"]) & 7 if hasattr(image.header, "get_xyzt_units") else 0
    if unit not in NIFTI_MILLIMETRES:
        raise GeometryError(f"the image must measure in m, mm or µm (xyzt_units 1, 2 or 3, or 0 for none); its header says {unit}")
    geometry = from_ras(affine_parts(affine[:3, :3], affine[:3, 3]), d, NIFTI_MILLIMETRES[unit])
    return data.reshape(data.shape[:d]).T, geometry


def affine_parts(matrix: NDArray[np.float64], origin: NDArray[np.float64]) -> Placement:
    """Of an affine map from indices; an axis that it gives no length has the direction NaN."""
    spacing = np.linalg.norm(matrix, axis=0)
    with np.errstate(invalid="ignore"):
        return spacing, origin, matrix / spacing


def from_ras(placement: Placement, d: int, unit: float) -> dict[str, Any]:
    """Geometry in millimetres and ITK's LPS of a grid of `d` axes that is placed in a RAS world, in units of `unit` mm.

    Raises
    ------
    GeometryError
        An image of two axes lies across the world's xy plane, in which a `Volume` keeps images.
    """
    spacing, origin, direction = placement
    turn = np.array([-1.0, -1.0, 1.0])
    if d == 2 and np.abs(direction[2, :2]).max() > _FLAT:
        raise GeometryError(f"an image of two axes must lie in the xy plane; its axes run along {direction[:, :2].T.tolist()}")
    return {
        "spacing": spacing[:d] * unit,
        "origin": (turn * origin)[:d] * unit + 0.0,  # -0 becomes 0
        "direction": (turn[:, None] * direction)[:d, :d] + 0.0,
        "units": "mm",
    }


def simpleitk() -> Any:
    """The SimpleITK module; its import is slow and waits until it is needed.

    Raises
    ------
    MissingDependencyError
        SimpleITK is not installed.
    """
    try:
        import SimpleITK
    except ImportError as error:
        raise MissingDependencyError("medical files need SimpleITK: pip install clvol[medical]") from error
    return SimpleITK
