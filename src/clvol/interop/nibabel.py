"""Images of nibabel, and the headers of NIfTI, read and made."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import DataError, GeometryError, MissingDependencyError
from clvol.base.frames import Placement, affine_parts, from_ras, ras_affine
from clvol.base.units import millimetres
from clvol.interop.kinds import Content, Kind, channels_and_frames, held_as, leading_counts

if TYPE_CHECKING:
    from clvol.volume.volume import Volume
    from clvol.volume.volumes import Leading

__all__ = [
    "CIFTI",
    "NIBABEL",
    "NIFTI_MILLIMETRES",
    "NO_VOLUME",
    "describe_nibabel",
    "describe_nifti",
    "nibabel",
    "same_place",
    "to_nibabel",
]

NIFTI_MILLIMETRES = {0: 1.0, 1: 1e3, 2: 1.0, 3: 1e-3}
"""Millimetres of the unit of length that NIfTI's ``xyzt_units & 7`` stands for: none, m, mm and µm."""

CIFTI = range(3000, 3100)
"""NIfTI's intent codes of CIFTI-2."""

NO_VOLUME = (
    "must hold a volume; it is CIFTI-2: values at vertices of a surface and at some voxels, with the axes of a matrix. nibabel "
    "reads it, and `wb_command -cifti-separate FILE COLUMN -volume-all OUT.nii.gz` makes a volume of its voxels"
)
"""What messages say of CIFTI-2."""

_TIME_UNITS = {0: "unknown", 8: "sec", 16: "msec", 24: "usec", 32: "hz", 40: "ppm", 48: "rads"}
"""nibabel's names of ``xyzt_units & 56``."""
_TIMES = ("sec", "msec", "usec")
_LABELS, _VECTORS, _TIME_SERIES = 1002, (1006, 1007), 2001  # NIfTI's intent codes
_SHAPES = {_LABELS, *_VECTORS, 1008, _TIME_SERIES, 2003, 2004}  # what samples show, and may have changed since
_LONGEST = np.iinfo(np.int16).max  # axis of NIfTI-1
_MOST_MOVED = 1e-3  # voxels, by the rounding of a header; NIfTI-1 keeps geometry in float32
_DTYPES = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "uint64", "int64", "float32", "float64")


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
        raise MissingDependencyError('NIfTI and MGH files need nibabel: pip install "clvol[medical]"') from error
    return nibabel


def describe_nibabel(image: Any) -> dict[str, Any]:
    """The geometry of a nibabel image and what its header says, as arguments of `Volume`.

    Its arrays are [x, y, z] in a RAS world, ours [z, y, x] in LPS. Lengths become millimetres; the affine is in the unit of the
    image (``xyzt_units`` of NIfTI).

    Raises
    ------
    DataError
        Fewer than two axes; CIFTI-2.
    GeometryError
        The affine is singular or not finite; the unit of length is unknown; an image of two axes lies across the world's
        xy plane.
    """
    shape = tuple(int(n) for n in image.shape)
    d = min(len(shape), 3)
    if d < 2:
        raise DataError(f"data must have 2 or 3 axes; got a nibabel image of shape {shape}")
    if not hasattr(image, "affine"):
        raise DataError(f"the nibabel image {NO_VOLUME}")
    affine = np.asarray(image.affine, dtype=np.float64)
    if not np.isfinite(affine).all() or (np.linalg.norm(affine[:3, :3], axis=0) == 0).any():
        raise GeometryError(f"the image's affine must be finite and not singular; got {image.affine!r}")
    # not get_xyzt_units, which fails if it has no name for the unit of time
    is_nifti = hasattr(image.header, "get_xyzt_units")
    unit = int(image.header["xyzt_units"]) & 7 if is_nifti else 0
    if unit not in NIFTI_MILLIMETRES:
        raise GeometryError(f"the image must measure in m, mm or µm (xyzt_units 1, 2 or 3, or 0 for none); its header says {unit}")
    about = from_ras(affine_parts(affine[:3, :3], affine[:3, 3]), d, NIFTI_MILLIMETRES[unit])
    if is_nifti:
        about |= describe_nifti(image.header, shape, len(image.get_data_dtype().names or ()))
        about["header"] |= _qform_code(image)
    elif (frames := math.prod(shape[3:])) > 1:
        about["leading"] = {"axes": ("volume",), "counts": (frames,)}
    return about


def from_nibabel(image: Any) -> Content:
    """Samples of a nibabel image, and what `describe_nibabel` returns."""
    about = describe_nibabel(image)
    data = np.asanyarray(image.dataobj)
    channels = len(data.dtype.names or ())
    if channels:  # red, green, blue, and alpha
        data = np.ascontiguousarray(data).view(np.uint8).reshape(*data.shape, channels)
        data = np.moveaxis(data, -1, min(data.ndim - 1, 3))  # after x, y and z, to be the last leading axis
    d = len(about["spacing"])
    return data.reshape(data.shape[:d] + leading_counts(about)[::-1], order="F").T, about


NIBABEL = Kind(
    lambda source: hasattr(source, "header") and hasattr(source, "dataobj"),
    describe_nibabel,
    lambda image: tuple(int(n) for n in image.shape[:3][::-1]),
    lambda image: from_nibabel(image)[0],
)


def _qform_code(image: Any) -> dict[str, int]:
    """The sform's code for the qform as well, if their placements differ (see `same_place`); nothing if they agree."""
    code = int(image.header["sform_code"])
    try:
        qform = image.header.get_qform(coded=True)[0] if code else None
    except ValueError:  # no quaternion
        return {"qform_code": code}
    if qform is None or same_place(*(affine_parts(affine[:3, :3], affine[:3, 3]) for affine in (image.header.get_sform(), qform))):
        return {}
    return {"qform_code": code}


def same_place(sform: Placement, qform: Placement) -> bool:
    """Whether the two placements of a NIfTI file agree, to the precision of float32.

    Volumes are placed by the sform, and both are written with its placement. The qform's code (a scanner's world, say) would then
    be false if the sform lies elsewhere (in a template's world), and both get the sform's code.
    """
    near = 0.01 * float(sform[0].min())
    moved = np.abs(sform[2] * sform[0] - qform[2] * qform[0]).max() * 10
    return bool(max(moved, np.abs(sform[1] - qform[1]).max()) <= near)


def describe_nifti(header: Any, shape: Sequence[int], channels: int = 0) -> dict[str, Any]:
    """Arguments of `Volume` that a NIfTI header gives, except the geometry.

    Parameters
    ----------
    header : mapping-like
        A header of nibabel, or a record with the same fields.
    shape : sequence of int
        Samples along x, y, z, time, the fifth axis, ...
    channels : int
        Of each sample, if they are colours.
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
        about["clim"] = (low, high)
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
    elif vector and parts == 1 and 1 < frames <= 3:  # some programs write components here, not along the fifth axis
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


def to_nibabel(data: NDArray[Any], grid: Volume, leading: Leading | None = None) -> Any:
    """A nibabel image of NIfTI of samples [..., z, y, x], in RAS and mm: times are its fourth axis and channels the fifth.

    It is NIfTI-2 where NIfTI-1, whose geometry is in float32, would move a sample by more than a thousandth of a voxel, and for
    axes of more than 32767 samples. Three or four channels of bytes that are colours become RGB(A). What `grid` keeps of a NIfTI
    header is written: the codes of sform and qform, the intent with its parameters, texts and the time step. `clim` becomes
    cal_min and cal_max.

    Raises
    ------
    DataError
        A dtype that NIfTI does not have, or more leading axes than channels and one other.
    GeometryError
        Units that are no length; a geometry that NIfTI does not hold.
    MissingDependencyError
        nibabel is not installed.
    """
    library = nibabel()
    array = held_as(data, _DTYPES)
    channels, frames = channels_and_frames(leading, "NIfTI")
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
    mm = millimetres(grid.units)
    affine = ras_affine(np.multiply(grid.spacing, mm), np.multiply(grid.origin, mm), grid.direction)
    for kind in (library.Nifti1Image, library.Nifti2Image)[max(array.shape) > _LONGEST :]:
        with np.errstate(over="ignore", invalid="ignore"):
            image = kind(array.T, affine, dtype=array.dtype)
            _write_header(image, affine, grid, frames, leading)
            moved = _moved(image, affine)
        if moved <= _MOST_MOVED:
            return image
        if not math.isfinite(moved):
            break
    kept = image.header.get_best_affine()
    raise GeometryError(f"NIfTI holds a geometry in float32, and cannot hold {affine.tolist()}, it would become {kept.tolist()}")


def _moved(image: Any, affine: NDArray[np.float64]) -> float:
    """Voxels by which the header of an image moves a corner of the grid."""
    last = np.array([*image.shape[:3], 1, 1])[:3] - 1
    corners = np.array([[*np.multiply(corner, last), 1] for corner in np.ndindex(2, 2, 2)]).T
    return float(np.abs(np.linalg.solve(affine, (image.header.get_best_affine() - affine) @ corners)).max())


def _write_header(image: Any, affine: NDArray[np.float64], grid: Volume, frames: int | None, leading: Leading | None) -> None:
    """Write what `describe_nifti` reads into the header of a nibabel image."""
    header, kept = image.header, grid.header
    codes = [kept.get(name, 1) for name in ("sform_code", "qform_code")]
    if not any(codes) and not np.allclose(header.get_base_affine(), affine, rtol=1e-6):  # codes of no place, for a geometry
        codes = [1, 1]
    with np.errstate(over="ignore", invalid="ignore"):
        image.set_qform(affine, codes[1], update_affine=False)  # the image keeps the affine in float64
        image.set_sform(affine, codes[0], update_affine=False)
    of_time = frames is not None and leading is not None and leading.axes[frames] == "time"
    unit = kept.get("time_unit", "sec" if of_time else "unknown")
    header.set_xyzt_units("mm", unit if frames is not None else "unknown")
    if frames is not None:
        header["pixdim"][4] = kept.get("time_step", 1.0)
    for name in ("descrip", "aux_file", "intent_name"):
        header[name] = str(kept.get(name, "")).encode()
    intent = kept.get("intent_code", 0)
    if leading is not None and leading.vector:
        intent = intent if intent in _VECTORS else _VECTORS[-1]
    elif grid.labels:
        intent = _LABELS
    elif intent in _SHAPES:
        intent = 0
    header["intent_code"] = intent
    for n, value in enumerate(kept.get("intent_p", (0, 0, 0)) if intent else (0, 0, 0), 1):
        header[f"intent_p{n}"] = value
    header["cal_min"], header["cal_max"] = grid.clim or (0, 0)
