"""View arrays and tensors of other libraries as NumPy arrays, without a copy where possible, for reading or writing."""

from __future__ import annotations

import math
import sys
from numbers import Real
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clvol.base import memory
from clvol.base.errors import ClvolError, DataError, OptionError

__all__ = ["Array", "as_array", "as_output", "is_triple", "memory_of", "reals"]

Array: TypeAlias = NDArray[np.float64]
_ON_HOST = {1, 3, 11, 13}  # DLPack device types whose memory the host can read: CPU, pinned and managed memory
_TO_HOST = {"torch": "tensor.cpu()", "cupy": "array.get()", "jax": "jax.device_get(array)", "jaxlib": "jax.device_get(array)"}


def as_array(
    source: Any, what: str = "data", error: type[ClvolError] = DataError, rule: str = "a regular array of numbers"
) -> NDArray[Any]:
    """Convert nested sequences and any object with `__array__`, `__array_interface__`, `__dlpack__` or a buffer to an array.

    The result shares the object's memory where its protocol allows it. PyTorch tensors are detached from their graph; bfloat16,
    which NumPy lacks, becomes float32 without loss. Raises `error`, which names `what` and states the `rule`, for an object that
    is on a device, ragged, sparse, or has masked elements.
    """
    if type(source) is np.ndarray:
        return source
    if type(source) is tuple and set(map(type, source)) == {float}:  # far sooner than by what follows
        return np.array(source)
    if np.ma.is_masked(source):
        raise error(f"{what} must be {rule} with no masked element; replace them with .filled(value) of the masked array")
    if not _on_host(source):
        advice = _TO_HOST.get(type(source).__module__.partition(".")[0], "with the function of its library")
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
    """Raise before reading an array that is not in memory (Zarr, dask, HDF5, or xarray of these) and does not fit."""
    module = type(source).__module__.partition(".")[0]
    if not hasattr(source, "shape") or not hasattr(source, "dtype"):
        if module == "zarr":
            raise error(
                f"{what} must be {rule}; got a {type(source).__qualname__} of zarr: give one of its arrays, "
                "or read it with clvol.read(path), which reads the OME-Zarr metadata"
            )
        return
    if module not in ("zarr", "dask", "h5py") and getattr(source, "chunks", None) is None:
        return
    shape = tuple(source.shape)
    if any(isinstance(n, float) and math.isnan(n) for n in shape):
        raise error(f"{what} must have a known shape; got {shape}: compute_chunk_sizes() of the dask array finds it")
    copies = 2 if hasattr(source, "__dask_graph__") else 1  # the blocks, and the assembled array
    memory.require(
        copies * math.prod(int(n) for n in shape) * np.dtype(source.dtype).itemsize,
        f"reading an array of {module} of shape {shape} whole",
    )


def as_output(out: Any, shape: tuple[int, ...], what: str = "out") -> NDArray[Any]:
    """View the memory of an object as an array to write results into.

    Parameters
    ----------
    out : object
        Anything `as_array` reads without a copy: a NumPy array with any strides, a PyTorch tensor on the host, ...
    shape : tuple of int
        Of the results.
    what : str
        Its name in messages.

    Raises
    ------
    OptionError
        It has another shape, is neither float32 nor float64, is read-only, cannot become an array without a copy, or is a
        tensor that requires a gradient.
    """
    array = memory_of(out, what)
    if array.dtype.kind != "f" or array.dtype.itemsize not in (4, 8):
        raise OptionError(f"{what} must be float32 or float64; got {array.dtype}")
    if array.shape != shape:
        raise OptionError(f"{what} must have shape {shape}; got {array.shape}")
    if not array.flags.writeable:
        raise OptionError(f"{what} must be an array that can be written into; got a read-only {type(out).__qualname__}")
    return array


def memory_of(out: Any, what: str) -> NDArray[Any]:
    """Like `as_output`, for any dtype and shape; read-only memory is allowed."""
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
    """Whether `source` is a PyTorch tensor. False while PyTorch is not imported."""
    tensor = getattr(sys.modules.get("torch"), "Tensor", None)  # missing while another thread imports it
    return tensor is not None and isinstance(source, tensor)


def _on_host(source: Any) -> bool:
    if _is_tensor(source):
        return bool(source.device.type == "cpu")
    if hasattr(source, "__dlpack_device__"):
        try:
            return int(source.__dlpack_device__()[0]) in _ON_HOST
        except (BufferError, RuntimeError, TypeError, ValueError):  # the device is unknown, as for a sharded array
            pass
    return hasattr(source, "__array_interface__") or not hasattr(source, "__cuda_array_interface__")


def _of_tensor(tensor: Any) -> NDArray[Any]:
    """The memory of a PyTorch tensor on the host."""
    plain = tensor.detach().resolve_conj().resolve_neg()
    return np.asarray((plain.float() if str(plain.dtype) == "torch.bfloat16" else plain).numpy())


def is_triple(value: object) -> bool:
    """Whether it is a tuple of three finite floats, as almost all that are asked about."""
    return type(value) is tuple and len(value) == 3 and set(map(type, value)) == {float} and all(map(math.isfinite, value))


def reals(what: str, value: object, rule: str = "real numbers", error: type[ClvolError] = OptionError) -> NDArray[np.float64]:
    """`value` as a float64 array, without a copy if it is one; raises `error` for strings, complex and masked numbers."""
    try:
        array = as_array(value, what, error, rule)
        if array.dtype == np.float64:
            return array
        known = array.dtype.kind in "biuf" or (array.dtype.kind == "O" and all(isinstance(v, Real) for v in array.flat))
        if known:
            memory.require(8 * array.size, f"{what} in float64, {array.size} numbers,")
            with np.errstate(over="ignore"):
                return array.astype(np.float64)
    except OverflowError:  # beyond float64
        pass
    raise error(f"{what} must be {rule}; got {value!r}")
