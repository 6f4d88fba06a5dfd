"""Reading other libraries' objects: their images and layers, tensors, and arrays of any kind; and writing into these."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable
from functools import wraps
from importlib import import_module
from typing import Any, ParamSpec, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from clvol.base import memory
from clvol.base.errors import ClvolError, DataError, OptionError, OutOfMemoryError
from clvol.foreign import Content, from_nibabel, from_simpleitk, is_ours, nibabel_says, simpleitk_says, xarray_says
from clvol.foreign_images import is_labelled, kind_of

__all__ = [
    "Content",
    "as_array",
    "as_output",
    "is_image",
    "is_in_parts",
    "is_lazy",
    "lazily",
    "memory_of",
    "read_array",
    "read_grid",
    "read_several",
]

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

_ON_HOST = {1, 3, 11, 13}  # DLPack's types of device whose memory the host can read: its own, pinned, and managed
_TO_HOST = {"torch": "tensor.cpu()", "cupy": "array.get()", "jax": "jax.device_get(array)", "jaxlib": "jax.device_get(array)"}

_OWN = ("spacing", "origin", "direction", "units", "space", "name", "color", "window", "labels", "header")


@runtime_checkable
class _Gridded(Protocol):
    """What a `clvol.Volume` has; the class itself stands on this module."""

    data: NDArray[Any]
    spacing: tuple[float, ...]
    origin: tuple[float, ...]
    direction: NDArray[np.float64]
    units: str


def read_array(source: Any, *, placed: bool = True) -> Content:
    """The samples of one volume, and what its kind of object says of them.

    Parameters
    ----------
    source : object
    placed : bool
        Whether it matters where the samples lie; if not, coordinates of xarray are not looked at.

    Raises
    ------
    DataError
        Ragged or masked data, data in the memory of a device, an image that holds several volumes or values per voxel, too
        few axes, or the name of a file.
    GeometryError
        The affine of a nibabel image is singular or not finite, or its unit of length unknown; coordinates of xarray are not
        evenly spaced.
    """
    if isinstance(source, (str, os.PathLike)):
        raise DataError(f"data must be an array, an image or a Volume; got {os.fspath(source)!r}: clvol.read(path) reads a file")
    if (leading := getattr(source, "leading", None)) is not None:
        raise DataError(f"data must be one volume; got Volumes of {leading}: take one, as volumes[0], or each of them in turn")
    about = simpleitk_says(source) if _is_simpleitk(source) else nibabel_says(source) if _is_nibabel(source) else {}
    about = xarray_says(source) if is_ours(source) else about
    labelled = is_labelled(source) and not is_ours(source)
    if (kind := kind_of(source)) is not None and not about and not (labelled and not placed):
        about = kind.says(source)
    if "leading" in about:
        counts = " × ".join(f"{n} {axis}s" for axis, n in zip(about["leading"]["axes"], about["leading"]["counts"], strict=True))
        raise DataError(f"data must be one volume; got an image of {counts}: take one as clvol.Volumes(image)[k]")
    if labelled:  # of one volume, however its first dimension is called
        return as_array(source), about
    return read_several(source)


def read_several(source: Any) -> Content:
    """As `read_array`, and images that hold several volumes; those have the arguments of `Leading` under the key "leading"."""
    if _is_simpleitk(source):
        return from_simpleitk(source)
    if _is_nibabel(source):
        return from_nibabel(source)
    if is_ours(source):
        return as_array(source), xarray_says(source)
    kind = kind_of(source)
    if kind is not None and not (is_labelled(source) and source.ndim < 4):  # the first of three dimensions may count volumes
        about = kind.says(source)
        return kind.samples(source, as_array), about
    if not isinstance(source, np.ndarray) and isinstance(source, _Gridded):  # asked for `data`, an array of dates raises
        return as_array(source.data), {name: getattr(source, name) for name in _OWN if hasattr(source, name)}
    return as_array(source), {}


def read_grid(source: Any) -> Content:
    """As `read_array`, and images that hold several volumes too, but without samples: in their place are zeros, of no memory."""
    if _is_simpleitk(source):
        about, size = simpleitk_says(source), source.GetSize()
    elif _is_nibabel(source):
        about, size = nibabel_says(source), source.shape
    elif is_ours(source):
        about, size = xarray_says(source), source.shape[::-1]
    elif (kind := kind_of(source)) is not None:
        about, size = kind.says(source), kind.shape(source)[::-1]
    else:
        return read_array(source)
    about.pop("leading", None)
    shape = tuple(int(n) for n in size[: len(about["spacing"])])[::-1]
    return np.broadcast_to(np.float32(0), shape), about


def is_image(source: Any) -> bool:
    """Whether it is another library's image of one volume or several, or an array that `clvol.foreign.to_xarray` made."""
    return _is_simpleitk(source) or _is_nibabel(source) or is_ours(source) or kind_of(source) is not None


def _is_simpleitk(source: Any) -> bool:
    return hasattr(source, "GetPixelIDTypeAsString") and hasattr(source, "GetDirection")


def _is_nibabel(source: Any) -> bool:
    return hasattr(source, "affine") and hasattr(source, "dataobj")


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
    _require_room(source, what, error, rule)
    try:
        if _is_tensor(source):
            return _of_tensor(source)
        reads = hasattr(source, "__array__") or hasattr(source, "__array_interface__") or not hasattr(source, "__dlpack__")
        array = np.asarray(source) if reads else np.from_dlpack(source)
    except (TypeError, ValueError, RuntimeError, BufferError) as reason:
        raise error(f"{what} must be {rule}; got one that NumPy cannot read: {reason}") from None
    return array.astype(np.float32) if array.dtype.name == "bfloat16" else array


def _require_room(source: Any, what: str, error: type[ClvolError], rule: str) -> None:
    """Raise before an array that is not in memory is read or computed whole: of Zarr, dask and HDF5, and of xarray over these."""
    module = type(source).__module__.partition(".")[0]
    if not hasattr(source, "shape") or not hasattr(source, "dtype"):
        if module == "zarr":
            raise error(
                f"{what} must be {rule}; got a {type(source).__qualname__} of zarr: give one of its arrays, "
                "or read it with clvol.read(path), which knows what OME-Zarr says"
            )
        return
    if module not in ("zarr", "dask", "h5py") and getattr(source, "chunks", None) is None:
        return
    shape = tuple(source.shape)
    if any(isinstance(n, float) and math.isnan(n) for n in shape):
        raise error(f"{what} must have a known shape; got {shape}: compute_chunk_sizes() of the dask array finds it")
    copies = 2 if hasattr(source, "__dask_graph__") else 1  # its blocks, and the array that they are put into
    memory.require(
        copies * math.prod(int(n) for n in shape) * np.dtype(source.dtype).itemsize,
        f"reading an array of {module} of shape {shape} whole",
    )


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
    tensor = getattr(sys.modules.get("torch"), "Tensor", None)  # none either while another thread is importing it
    return tensor is not None and isinstance(source, tensor)


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


def is_lazy(source: object) -> bool:
    """Whether it is an array of dask, which needs no import to know."""
    kind = getattr(sys.modules.get("dask.array"), "Array", None)  # none either while another thread is importing it
    return kind is not None and isinstance(source, kind)


def is_in_parts(source: object) -> bool:
    """Whether it is a LazyVolume or a BrickedField, which stand on this module."""
    names = (("clvol.bricks.source", "LazyVolume"), ("clvol.spline.bricked", "BrickedField"))
    kinds = tuple(kind for module, name in names if (kind := getattr(sys.modules.get(module), name, None)) is not None)
    return isinstance(source, kinds)


def lazily(
    *names: str, dask: bool = True, instead: bool = False
) -> Callable[[Callable[Arguments, Result]], Callable[Arguments, Result]]:
    """A function that hands what is not in memory to others of its name.

    An array of dask goes to that in `clvol.dask`, whose result is an array of dask too; what `is_in_parts` to that in the module
    `parts` of the function's package.

    Parameters
    ----------
    *names : str
        The function's first parameters, as far as arrays of dask are looked for among them; only the first may be in parts.
    dask : bool
        Whether there is one for arrays of dask.
    instead : bool
        Whether what is in memory goes to the module `parts` too, if there is no room for what is made of it as a whole.
    """

    def decorator(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
        parts = function.__module__.rpartition(".")[0] + ".parts"

        def other(module: str) -> Callable[Arguments, Result]:
            found: Callable[Arguments, Result] = getattr(import_module(module), function.__name__)
            return found

        @wraps(function)
        def either(*arguments: Arguments.args, **options: Arguments.kwargs) -> Result:
            if dask and any(map(is_lazy, (*arguments[: len(names)], *(options.get(name) for name in names)))):
                return other("clvol.dask")(*arguments, **options)
            if is_in_parts(arguments[0] if arguments else options.get(names[0])):
                return other(parts)(*arguments, **options)
            if not instead:
                return function(*arguments, **options)
            try:
                return function(*arguments, **options)
            except OutOfMemoryError as refused:
                try:
                    return other(parts)(*arguments, **options)
                except (OptionError, DataError, OutOfMemoryError):  # nor is there another way
                    raise refused from None

        return either

    return decorator
