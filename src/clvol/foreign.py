"""Other libraries' images: those of SimpleITK and nibabel, and arrays of xarray, read with all that they say, and made."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import DataError, GeometryError, MissingDependencyError

__all__ = [
    "METRES",
    "NIFTI_MILLIMETRES",
    "Content",
    "Grid",
    "Placement",
    "Several",
    "affine_parts",
    "from_nibabel",
    "from_ras",
    "from_simpleitk",
    "held_as",
    "interleaved",
    "is_ours",
    "nibabel",
    "nibabel_says",
    "nifti_says",
    "same_place",
    "simpleitk",
    "simpleitk_says",
    "to_nibabel",
    "to_simpleitk",
    "to_xarray",
    "xarray_says",
]

METRES = {"nm": 1e-9, "um": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0, "inch": 0.0254}
"""Of the units of length that clvol knows by their one name."""

NIFTI_MILLIMETRES = {0: 1.0, 1: 1e3, 2: 1.0, 3: 1e-3}
"""Of the unit of length that NIfTI's ``xyzt_units & 7`` stands for: none, m, mm and µm."""

_TIME_UNITS = {
    0: "unknown",
    8: "sec",
    16: "msec",
    24: "usec",
    32: "hz",
    40: "ppm",
    48: "rads",
}  # xyzt_units & 56, by nibabel's names
_TIMES = ("sec", "msec", "usec")
_LABELS, _VECTORS, _TIME_SERIES = 1002, (1006, 1007), 2001  # NIfTI's intent codes
_SHAPES = {_LABELS, *_VECTORS, 1008, _TIME_SERIES, 2003, 2004}  # what the samples themselves show, and may have changed since
_LONGEST = np.iinfo(np.int16).max  # axis of NIfTI-1
_TOLERANCE = 1e-4  # NIfTI keeps geometry in float32; anything worse was lost, not rounded
_FLAT = 1e-4  # files keep directions in float32
_RAS = np.array([-1.0, -1.0, 1.0])

_ITK_DTYPES = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "uint64", "int64", "float32", "float64")
_NIFTI_DTYPES = _ITK_DTYPES
_PLACE = {"size", "spacing", "origin", "direction"}  # attributes of a DataArray that this module made
_WIDER = {"bool": "uint8", "float16": "float32"}  # the next type that holds every value

Content: TypeAlias = tuple[NDArray[Any], dict[str, Any]]
"""Samples [z, y, x], and those keyword arguments of `Volume` that their source knows: spacing, origin, direction, units, ...
Of several volumes, samples [..., z, y, x], and the arguments of `Leading` under the key "leading"."""

Placement: TypeAlias = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
"""Spacing, origin and direction (columns) of three index axes in the world."""


class Grid(Protocol):
    """What a `clvol.Volume` says of its samples; the class itself stands on this module."""

    @property
    def spacing(self) -> tuple[float, ...]: ...
    @property
    def origin(self) -> tuple[float, ...]: ...
    @property
    def direction(self) -> NDArray[np.float64]: ...
    @property
    def units(self) -> str: ...
    @property
    def space(self) -> str: ...
    @property
    def name(self) -> str: ...
    @property
    def window(self) -> tuple[float, float] | None: ...
    @property
    def labels(self) -> bool | Mapping[int, str] | None: ...
    @property
    def header(self) -> Mapping[str, Any]: ...


class Several(Protocol):
    """What a `clvol.volume.volumes.Leading` says of the axes before z, y and x; the class itself stands on this module."""

    @property
    def axes(self) -> tuple[str, ...]: ...
    @property
    def counts(self) -> tuple[int, ...]: ...
    @property
    def names(self) -> Mapping[str, tuple[str, ...]]: ...
    @property
    def vector(self) -> bool: ...
    @property
    def rgb(self) -> bool: ...


def held_as(data: NDArray[Any], dtypes: Iterable[str], error: Callable[[str], Exception] = DataError) -> NDArray[Any]:
    """`data` in native byte order and C order, as one of `dtypes` that holds every value; else `error` of the rule is raised."""
    name = data.dtype.name
    name = name if name in dtypes else _WIDER.get(name, name)
    if name not in dtypes:
        raise error(f"samples must be {', '.join(dtypes)} here; got {data.dtype}: convert them or write .npz")
    return np.ascontiguousarray(data, dtype=name)


# -- SimpleITK ---------------------------------------------------------------------------------------------------


def from_simpleitk(image: Any, units: str = "mm", *, copy: bool = True) -> Content:
    """Samples and geometry of a SimpleITK image, without trailing axes of one sample.

    Lengths are in millimetres, as ITK has them by convention, unless the header of its file gives other `units`. Samples that are
    no `copy` live as long as the image.
    """
    about = simpleitk_says(image, units)
    library = simpleitk()  # np.asarray would give a flat float64 array
    data = library.GetArrayFromImage(image) if copy else library.GetArrayViewFromImage(image)
    d, counts = len(about["spacing"]), about["leading"]["counts"] if "leading" in about else ()
    if image.GetNumberOfComponentsPerPixel() > 1:
        data = np.moveaxis(data, -1, data.ndim - 1 - d)
    return data.reshape(counts + data.shape[data.ndim - d :]), about


def simpleitk_says(image: Any, units: str = "mm") -> dict[str, Any]:
    """All that `from_simpleitk` gives of an image but its samples."""
    rank, channels, size = image.GetDimension(), image.GetNumberOfComponentsPerPixel(), image.GetSize()
    d = min(rank, 3)
    about: dict[str, Any] = {
        "spacing": image.GetSpacing()[:d],
        "origin": image.GetOrigin()[:d],
        "direction": np.reshape(image.GetDirection(), (rank, rank))[:d, :d],
        "units": units,
        "space": "LPS",
    }
    frames = math.prod(size[3:])
    axes, counts = (("volume",), (frames,)) if frames > 1 else ((), ())
    if frames > 1 and rank == 4 and (step := image.GetSpacing()[3]) != 1:
        about["header"] = {"time_step": step}
    if channels > 1:
        about["leading"] = interleaved(channels, image.GetPixelIDTypeAsString(), d, axes, counts)
    elif axes:
        about["leading"] = {"axes": axes, "counts": counts}
    return about


def interleaved(channels: int, kind: str, d: int, axes: tuple[str, ...] = (), counts: tuple[int, ...] = ()) -> dict[str, Any]:
    """Arguments of `Leading` for several values per voxel of which is only known how many there are, and of what type.

    Three or four bytes are a colour, as many floating numbers as the image has axes a vector, and all else channels.
    """
    rgb = "8-bit unsigned" in kind and channels in (3, 4)
    vector = "float" in kind and channels == d
    return {"axes": (*axes, "channel"), "counts": (*counts, channels), "rgb": rgb, "vector": vector}


def to_simpleitk(data: NDArray[Any], grid: Grid, leading: Several | None = None) -> Any:
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
    mm = _millimetres(grid.units)
    spacing, origin, direction = np.multiply(grid.spacing, mm), np.multiply(grid.origin, mm), grid.direction
    channels, frames = _parted(leading, "an image of ITK")
    array = held_as(data, _ITK_DTYPES)
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


# -- nibabel, and the headers of NIfTI -----------------------------------------------------------------------------


def from_nibabel(image: Any) -> Content:
    """Samples and geometry of a nibabel image, in millimetres: its arrays are [x, y, z] in a RAS world, ours [z, y, x] in LPS.

    Where the image measures in metres or micrometres (``xyzt_units`` of NIfTI), its affine does too.

    Raises
    ------
    DataError
        Fewer than two axes.
    GeometryError
        The affine is singular or not finite; the unit of length is unknown; an image of two axes lies across the world's
        xy plane.
    """
    about = nibabel_says(image)
    data = np.asanyarray(image.dataobj)
    channels = len(data.dtype.names or ())
    if channels:  # red, green, blue, and alpha
        data = np.ascontiguousarray(data).view(np.uint8).reshape(*data.shape, channels)
        data = np.moveaxis(data, -1, min(data.ndim - 1, 3))  # behind x, y and z, so that it comes last of the leading axes
    counts = about["leading"]["counts"] if "leading" in about else ()
    d = len(about["spacing"])
    return data.reshape(data.shape[:d] + counts[::-1], order="F").T, about


def nibabel_says(image: Any) -> dict[str, Any]:
    """All that `from_nibabel` gives of an image but its samples; the same errors."""
    shape = tuple(int(n) for n in image.shape)
    d = min(len(shape), 3)
    if d < 2:
        raise DataError(f"data must have 2 or 3 axes; got a nibabel image of shape {shape}")
    affine = np.asarray(image.affine, dtype=np.float64)
    if not np.isfinite(affine).all() or (np.linalg.norm(affine[:3, :3], axis=0) == 0).any():
        raise GeometryError(f"the image's affine must be finite and not singular; got {image.affine!r}")
    # the name that get_xyzt_units has for a unit of time, in the same number, may be missing, and says nothing about space
    is_nifti = hasattr(image.header, "get_xyzt_units")
    unit = int(image.header["xyzt_units"]) & 7 if is_nifti else 0
    if unit not in NIFTI_MILLIMETRES:
        raise GeometryError(f"the image must measure in m, mm or µm (xyzt_units 1, 2 or 3, or 0 for none); its header says {unit}")
    about = from_ras(affine_parts(affine[:3, :3], affine[:3, 3]), d, NIFTI_MILLIMETRES[unit])
    if is_nifti:
        about |= nifti_says(image.header, shape, len(image.get_data_dtype().names or ()))
        about["header"] |= _one_code(image)
    elif (frames := math.prod(shape[3:])) > 1:
        about["leading"] = {"axes": ("volume",), "counts": (frames,)}
    return about


def _one_code(image: Any) -> dict[str, int]:
    """The code that the qform gets where it lies elsewhere than the sform, see `same_place`; none where the two agree."""
    code = int(image.header["sform_code"])
    try:
        qform = image.header.get_qform(coded=True)[0] if code else None
    except ValueError:  # no quaternion
        return {"qform_code": code}
    if qform is None or same_place(*(affine_parts(affine[:3, :3], affine[:3, 3]) for affine in (image.header.get_sform(), qform))):
        return {}
    return {"qform_code": code}


def same_place(sform: Placement, qform: Placement) -> bool:
    """Whether the two placements of a NIfTI file are one, as far as float32 holds them.

    Volumes lie where the sform says, and both are written so. What the qform's code says (a scanner's world, say) would then be
    false of a sform elsewhere (in a template's), whose code is given to both.
    """
    near = 0.01 * float(sform[0].min())
    moved = np.abs(sform[2] * sform[0] - qform[2] * qform[0]).max() * 10
    return bool(max(moved, np.abs(sform[1] - qform[1]).max()) <= near)


def nifti_says(header: Any, shape: Sequence[int], channels: int = 0) -> dict[str, Any]:
    """Arguments of `Volume` that a NIfTI header gives beside where the samples lie.

    Parameters
    ----------
    header : mapping-like
        A header of nibabel, or a record with the same fields.
    shape : sequence of int
        Samples along x, y, z, time, the fifth axis, ...
    channels : int
        Of a colour, where the samples are colours.
    """
    low, high, intent = float(header["cal_min"]), float(header["cal_max"]), int(header["intent_code"])
    time_unit = _TIME_UNITS.get(int(header["xyzt_units"]) & 56, "unknown")
    kept: dict[str, Any] = {"sform_code": int(header["sform_code"]), "qform_code": int(header["qform_code"])}
    for name in ("descrip", "aux_file", "intent_name"):
        if text := bytes(header[name]).partition(b"\0")[0].decode("utf-8", "replace"):
            kept[name] = text
    if intent:
        kept["intent_code"] = intent
        kept["intent_p"] = tuple(float(header[f"intent_p{n}"]) for n in (1, 2, 3))
    about: dict[str, Any] = {"space": "LPS", "header": kept}
    if low < high and math.isfinite(low) and math.isfinite(high):
        about["window"] = (low, high)
    if intent == _LABELS:
        about["labels"] = True
    if (frames := math.prod(shape[3:4])) > 1 and math.isfinite(step := float(header["pixdim"][4])):
        kept |= {"time_step": step, "time_unit": time_unit}
    times = "time" if time_unit in _TIMES or intent == _TIME_SERIES else "volume"
    parts = math.prod(shape[4:5])
    vector = intent in _VECTORS
    axes: tuple[tuple[str, int], ...]
    if math.prod(shape[5:]) > 1 or (channels and parts > 1):
        axes, vector = (("volume", math.prod(shape[3:])),), False
    elif vector and parts == 1 and 1 < frames <= 3:  # as some programs write what belongs on the fifth axis
        axes = (("channel", frames),)
    else:
        axes = (("channel", parts), (times, frames))
        vector = vector and parts > 1
    if channels:
        axes, vector = (*axes, ("channel", channels)), False
    axes = tuple((axis, n) for axis, n in axes if n > 1)
    if axes:
        names, counts = zip(*axes, strict=True)
        about["leading"] = {"axes": names, "counts": counts, "vector": vector, "rgb": bool(channels)}
    return about


def to_nibabel(data: NDArray[Any], grid: Grid, leading: Several | None = None) -> Any:
    """A nibabel image of NIfTI of samples [..., z, y, x], in RAS and mm: times are its fourth axis and channels the fifth.

    Bytes in three or four colours become colours. What `grid` keeps of a NIfTI header is written into this one: the codes of
    sform and qform, the intent with its parameters, texts and the step of time. The window becomes cal_min and cal_max.

    Raises
    ------
    DataError
        A dtype that NIfTI does not have, or more leading axes than channels and one other.
    GeometryError
        Units that are no length; a geometry that float32 does not hold.
    MissingDependencyError
        nibabel is not installed.
    """
    library = nibabel()
    array = held_as(data, _NIFTI_DTYPES)
    channels, frames = _parted(leading, "NIfTI")
    d = len(grid.spacing)
    if leading is not None:
        array = np.moveaxis(array, channels, 0) if channels is not None else array[None]
        array = array if frames is not None else array[:, None]
        array = array if d == 3 else array[:, :, None]
        if leading.rgb and array.dtype == np.uint8:
            colour = np.dtype([(name, "u1") for name in "RGBA"[: len(array)]])
            array = np.ascontiguousarray(np.moveaxis(array, 0, -1)).view(colour)[..., 0]
            array = array if frames is not None else array[0]
        elif channels is None:
            array = array[0]
    affine = _affine(grid)
    kind = library.Nifti1Image if max(array.shape) <= _LONGEST else library.Nifti2Image
    with np.errstate(over="ignore"):  # it is looked at below
        image = kind(array.T, affine, dtype=array.dtype)
    _tell(image, affine, grid, leading is not None and leading.vector, frames, leading)
    with np.errstate(over="ignore", invalid="ignore"):
        kept = image.header.get_best_affine()
        if not np.abs(kept - affine).max() <= _TOLERANCE * np.abs(affine).max():
            raise GeometryError(
                f"NIfTI holds a geometry in float32, and cannot hold {affine.tolist()}, it would become {kept.tolist()}"
            )
    return image


def _tell(image: Any, affine: NDArray[np.float64], grid: Grid, vector: bool, frames: int | None, leading: Several | None) -> None:
    """Put into the header of a nibabel image what `nifti_says` takes from one."""
    header, kept = image.header, grid.header
    codes = [kept.get(name, 1) for name in ("sform_code", "qform_code")]
    if not any(codes) and not np.allclose(header.get_base_affine(), affine, rtol=1e-6):  # nowhere, yet it has a place
        codes = [1, 1]
    with np.errstate(over="ignore", invalid="ignore"):
        image.set_qform(affine, codes[1], update_affine=False)  # the image keeps its own in float64
        image.set_sform(affine, codes[0], update_affine=False)
    of_time = frames is not None and leading is not None and leading.axes[frames] == "time"
    unit = kept.get("time_unit", "sec" if of_time else "unknown")
    header.set_xyzt_units("mm", unit if frames is not None else "unknown")
    if frames is not None:
        header["pixdim"][4] = kept.get("time_step", 1.0)
    for name in ("descrip", "aux_file", "intent_name"):
        header[name] = str(kept.get(name, "")).encode()
    intent = kept.get("intent_code", 0)
    if vector:
        intent = intent if intent in _VECTORS else _VECTORS[-1]
    elif grid.labels:
        intent = _LABELS
    elif intent in _SHAPES:
        intent = 0
    header["intent_code"] = intent
    for n, value in enumerate(kept.get("intent_p", (0, 0, 0)) if intent else (0, 0, 0), 1):
        header[f"intent_p{n}"] = value
    header["cal_min"], header["cal_max"] = grid.window or (0, 0)


def nibabel() -> Any:
    """The nibabel module.

    Raises
    ------
    MissingDependencyError
        nibabel is not installed.
    """
    try:
        import nibabel
    except ImportError as error:
        raise MissingDependencyError("NIfTI and MGH files need nibabel: pip install clvol[medical]") from error
    return nibabel


def affine_parts(matrix: NDArray[np.float64], origin: NDArray[np.float64]) -> Placement:
    """Of an affine map from indices; an axis that it gives no length has the direction NaN."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):  # a volume refuses what is not finite
        spacing = np.linalg.norm(matrix, axis=0)
        return spacing, origin, matrix / spacing


def from_ras(placement: Placement, d: int, unit: float) -> dict[str, Any]:
    """Geometry in millimetres and ITK's LPS of a grid of `d` axes that is placed in a RAS world, in units of `unit` mm.

    Raises
    ------
    GeometryError
        An image of two axes lies across the world's xy plane, in which a `Volume` keeps images.
    """
    spacing, origin, direction = placement
    if d == 2 and np.abs(direction[2, :2]).max() > _FLAT:
        raise GeometryError(f"an image of two axes must lie in the xy plane; its axes run along {direction[:, :2].T.tolist()}")
    return {
        "spacing": spacing[:d] * unit,
        "origin": (_RAS * origin)[:d] * unit + 0.0,  # -0 becomes 0
        "direction": (_RAS[:, None] * direction)[:d, :d] + 0.0,
        "units": "mm",
        "space": "LPS",
    }


def _affine(grid: Grid) -> NDArray[np.float64]:
    """From indices to RAS in millimetres, shape (4, 4)."""
    d, mm = len(grid.spacing), _millimetres(grid.units)
    affine = np.eye(4)
    affine[:d, :d] = grid.direction * np.multiply(grid.spacing, mm)
    affine[:d, 3] = np.multiply(grid.origin, mm)
    affine[:2] *= -1
    return affine + 0.0


# -- xarray ------------------------------------------------------------------------------------------------------


def to_xarray(data: NDArray[Any], grid: Grid, leading: Several | None = None) -> Any:
    """A DataArray of samples [..., z, y, x], with coordinates in world units where the axes run along the world's.

    The attributes hold the geometry in any case, x first, and what else the volume says of itself.

    Raises
    ------
    MissingDependencyError
        xarray is not installed.
    """
    try:
        import xarray
    except ImportError as error:
        raise MissingDependencyError("to_xarray needs xarray: pip install clvol[xarray]") from error
    d = len(grid.spacing)
    dims = (*(leading.axes if leading else ()), *"zyx"[3 - d :])
    coords: dict[str, Any] = {axis: list(names) for axis, names in (leading.names if leading else {}).items()}
    if not np.any(grid.direction - np.diag(np.diag(grid.direction))):
        for axis, name in enumerate("xyz"[:d]):
            step = grid.direction[axis, axis] * grid.spacing[axis]
            places = grid.origin[axis] + step * np.arange(data.shape[-1 - axis])
            coords[name] = (name, places, {"units": grid.units} if grid.units else {})
    attrs: dict[str, Any] = {
        "size": list(data.shape[: -1 - d : -1]),
        "spacing": list(grid.spacing),
        "origin": list(grid.origin),
        "direction": grid.direction.tolist(),
        "world_units": grid.units,
        "space": grid.space,
    }
    if grid.window is not None:
        attrs["window"] = list(grid.window)
    return xarray.DataArray(data, coords, dims, name=(grid.name or None) if leading is None else None, attrs=attrs)


def is_ours(array: Any) -> bool:
    """Whether it is a DataArray that `to_xarray` made, or one made of that, with y and x as its last dimensions."""
    attrs = getattr(array, "attrs", None)
    return isinstance(attrs, Mapping) and attrs.keys() >= _PLACE and getattr(array, "dims", ())[-2:] == ("y", "x")


def xarray_says(array: Any) -> dict[str, Any]:
    """Arguments of `Volume` of a DataArray that `is_ours`; coordinates are believed before attributes, which outlive cuts.

    Raises
    ------
    GeometryError
        Coordinates that are not evenly spaced; or the array was cut and has no coordinates, so that nothing says where it lies.
    """
    d = 3 if array.dims[-3:] == ("z", "y", "x") else 2
    attrs = array.attrs
    spacing, origin, direction = (np.array(attrs[name], np.float64) for name in ("spacing", "origin", "direction"))
    size = array.shape[: -1 - d : -1]
    if not all(name in array.coords for name in "xyz"[:d]):
        if tuple(attrs["size"]) != size:
            raise GeometryError(
                f"the array was cut or joined, and nothing says where it lies; it had {attrs['size']} samples, now {size}"
            )
    else:
        spacing, origin, direction = spacing[:d], origin[:d], np.diag(np.sign(np.diag(direction)[:d]))
        for axis, name in enumerate("xyz"[:d]):
            places = np.asarray(array.coords[name], np.float64)
            origin[axis] = places[0]
            if len(steps := np.diff(places)):
                if not np.allclose(steps, steps.mean(), rtol=1e-4, atol=0):
                    raise GeometryError(
                        f"coordinates must be evenly spaced; those of {name} are {steps.min():g} to {steps.max():g} apart"
                    )
                spacing[axis], direction[axis, axis] = abs(steps.mean()), np.sign(steps.mean())
    about: dict[str, Any] = {
        "spacing": spacing,
        "origin": origin,
        "direction": direction,
        "units": attrs.get("world_units", ""),
        "space": attrs.get("space", ""),
    }
    if "window" in attrs:
        about["window"] = tuple(attrs["window"])
    if array.name:
        about["name"] = str(array.name)
    if axes := array.dims[: array.ndim - d]:
        named = {axis: tuple(map(str, array.coords[axis].values)) for axis in axes if axis in array.coords}
        about["leading"] = {"axes": axes, "counts": array.shape[: array.ndim - d], "names": named}
    return about


# -- what they share ---------------------------------------------------------------------------------------------


def _millimetres(units: str) -> float:
    """Of one of `units`; none are taken for millimetres."""
    if not units:
        return 1.0
    if units not in METRES:
        raise GeometryError(f"units must be a length, {', '.join(METRES)}, for a library that measures in mm; got {units!r}")
    return 1.0 if units == "mm" else METRES[units] / METRES["mm"]


def _parted(leading: Several | None, what: str) -> tuple[int | None, int | None]:
    """Which of the leading axes is that of channels, and which the other one."""
    if leading is None:
        return None, None
    others = [n for n, axis in enumerate(leading.axes) if axis != "channel"]
    if len(others) > 1:
        raise DataError(f"{what} must have no leading axis but channels and one other; got {leading}: choose with pick")
    return (leading.axes.index("channel") if "channel" in leading.axes else None), (others[0] if others else None)


def _embedded(direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of one dimension more, whose axis is along the new one."""
    wider = np.eye(len(direction) + 1)
    wider[:-1, :-1] = direction
    return wider
