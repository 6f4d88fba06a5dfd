"""Images of ITK: of SimpleITK, read and made, and of ITK's own Python, read."""

from __future__ import annotations

import math
import sys
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clvol.base import memory
from clvol.base.arrays import as_array
from clvol.base.errors import DataError, MissingDependencyError
from clvol.base.units import millimetres
from clvol.interop.kinds import Content, Kind, channels_and_frames, held_as, interleaved, leading_counts

if TYPE_CHECKING:
    from clvol.volume.volume import Volume
    from clvol.volume.volumes import Leading

__all__ = ["ITK", "SIMPLEITK", "describe_simpleitk", "from_simpleitk", "simpleitk", "to_simpleitk"]

_DTYPES = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "uint64", "int64", "float32", "float64")


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
        raise MissingDependencyError('medical files need SimpleITK: pip install "clvol[medical]"') from error
    return SimpleITK


def _leading(about: dict[str, Any], frames: int, channels: int, dtype: np.dtype[Any]) -> None:
    """Add the arguments of `Leading` for an image of more than one volume or more than one value per voxel."""
    axes, counts = (("volume",), (frames,)) if frames > 1 else ((), ())
    if channels > 1:
        about["leading"] = interleaved(channels, dtype, len(about["spacing"]), axes, counts)
    elif axes:
        about["leading"] = {"axes": axes, "counts": counts}


# -- SimpleITK -------------------------------------------------------------------------------------------------------


def describe_simpleitk(image: Any, units: str = "mm") -> dict[str, Any]:
    """All that `from_simpleitk` returns of an image but its samples."""
    rank, size, kind = image.GetDimension(), image.GetSize(), image.GetPixelIDTypeAsString()
    d = min(rank, 3)
    about: dict[str, Any] = {
        "spacing": image.GetSpacing()[:d],
        "origin": image.GetOrigin()[:d],
        "direction": np.reshape(image.GetDirection(), (rank, rank))[:d, :d],
        "units": units,
        "space": "LPS",
    }
    frames = math.prod(size[3:])
    if frames > 1 and rank == 4 and (step := image.GetSpacing()[3]) != 1:
        about["header"] = {"time_step": step}
    dtype = np.dtype("uint8" if "8-bit unsigned" in kind else "float32" if "float" in kind else "int32")
    _leading(about, frames, image.GetNumberOfComponentsPerPixel(), dtype)
    return about


def from_simpleitk(image: Any, units: str = "mm", *, copy: bool = True) -> Content:
    """Samples and geometry of a SimpleITK image, without trailing axes of one sample.

    Lengths are in millimetres, ITK's convention, unless the header of its file gives other `units`. Samples that are not copied
    live as long as the image.
    """
    about = describe_simpleitk(image, units)
    library = simpleitk()  # np.asarray would give a flat float64 array
    data = library.GetArrayFromImage(image) if copy else library.GetArrayViewFromImage(image)
    d = len(about["spacing"])
    if image.GetNumberOfComponentsPerPixel() > 1:
        data = np.moveaxis(data, -1, data.ndim - 1 - d)
    return data.reshape(leading_counts(about) + data.shape[data.ndim - d :]), about


SIMPLEITK = Kind(
    lambda source: hasattr(source, "GetPixelIDTypeAsString") and hasattr(source, "GetDirection"),
    describe_simpleitk,
    lambda image: tuple(int(n) for n in image.GetSize()[:3][::-1]),
    lambda image: from_simpleitk(image)[0],
)


def to_simpleitk(data: NDArray[Any], grid: Volume, leading: Leading | None = None) -> Any:
    """A SimpleITK image of samples [..., z, y, x]: channels become values per voxel, another leading axis the fourth axis.

    Raises
    ------
    DataError
        A dtype that ITK does not have, or more leading axes than channels and one other.
    GeometryError
        Units that are no length.
    MissingDependencyError
        SimpleITK is not installed.
    """
    sitk = simpleitk()
    mm = millimetres(grid.units)
    spacing, origin, direction = np.multiply(grid.spacing, mm), np.multiply(grid.origin, mm), grid.direction
    channels, frames = channels_and_frames(leading, "an image of ITK")
    array = held_as(data, _DTYPES)
    if channels is not None:
        array = np.ascontiguousarray(np.moveaxis(array, channels, -1))
    if frames is not None:
        if len(grid.spacing) == 2:  # else the frames would be its slices
            array = array[:, None]
            spacing, origin, direction = np.append(spacing, 1.0), np.append(origin, 0.0), _embedded(direction)
        spacing, origin = np.append(spacing, grid.header.get("time_step") or 1.0), np.append(origin, 0.0)
        direction = _embedded(direction)
    image = sitk.GetImageFromArray(array, isVector=channels is not None)
    image.SetSpacing(spacing.tolist())
    image.SetOrigin(origin.tolist())
    image.SetDirection(direction.ravel().tolist())
    return image


def _embedded(direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Directions in one dimension more, with an axis along that."""
    wider = np.eye(len(direction) + 1)
    wider[:-1, :-1] = direction
    return wider


# -- ITK -------------------------------------------------------------------------------------------------------------


def _itk_size(image: Any) -> list[int]:
    size = image.GetBufferedRegion().GetSize()
    return [int(size[i]) for i in range(int(image.GetImageDimension()))]


def _describe_itk(image: Any) -> dict[str, Any]:
    """As of SimpleITK's images: lengths in millimetres, in LPS."""
    size = _itk_size(image)
    if 0 in size:
        raise DataError("an image of ITK must be loaded; its buffer is empty: call Update() of the filter that makes it")
    rank, index = len(size), image.GetBufferedRegion().GetIndex()
    if rank < 2:
        raise DataError(f"data must have 2 or 3 axes; got an image of ITK with {rank}")
    d = min(rank, 3)
    spacing = [float(image.GetSpacing()[i]) for i in range(rank)]
    first = image.TransformIndexToPhysicalPoint([int(index[i]) for i in range(rank)])  # a buffered region may begin elsewhere
    direction = np.array([[float(image.GetDirection()(i, j)) for j in range(rank)] for i in range(rank)])
    about: dict[str, Any] = {
        "spacing": spacing[:d],
        "origin": [float(first[i]) for i in range(d)],
        "direction": direction[:d, :d],
        "units": "mm",
        "space": "LPS",
    }
    _leading(about, math.prod(size[3:]), int(image.GetNumberOfComponentsPerPixel()), np.dtype(image.dtype))
    return about


def _itk_shape(image: Any) -> tuple[int, ...]:
    return tuple(_itk_size(image)[:3][::-1])


def _itk_samples(image: Any) -> NDArray[Any]:
    """A copy: ITK's own views of an image do not keep it alive."""
    about, shape = _describe_itk(image), _itk_shape(image)
    channels = int(image.GetNumberOfComponentsPerPixel())
    memory.require(math.prod(_itk_size(image)) * channels * np.dtype(image.dtype).itemsize, "a copy of an image of ITK")
    itk = sys.modules.get(type(image).__module__.partition(".")[0])
    data = as_array(image) if itk is None else itk.array_from_image(image)
    if channels > 1:
        data = np.moveaxis(data, -1, data.ndim - 1 - len(shape))
    return data.reshape(*leading_counts(about), *shape)


ITK = Kind(
    lambda source: (
        hasattr(source, "GetImageDimension") and hasattr(source, "GetBufferedRegion") and hasattr(source, "GetDirection")
    ),
    _describe_itk,
    _itk_shape,
    _itk_samples,
)
