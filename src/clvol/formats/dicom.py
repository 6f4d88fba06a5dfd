"""DICOM: a folder of slices, or a file of one or many, by way of SimpleITK (and GDCM inside it)."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import DataError, FormatError, OptionError
from clvol.formats import _itk
from clvol.formats._choice import Choice, Pick, Series, chosen_series
from clvol.formats._elements import check_samples
from clvol.formats._errors import foreign_errors
from clvol.formats.guarded.limits import announce
from clvol.formats.guarded.messages import copied
from clvol.interop.itk import describe_simpleitk, simpleitk
from clvol.interop.kinds import Content
from clvol.volume.volumes import Leading

__all__ = ["SUFFIXES", "is_file", "is_folder", "read", "series_of"]

SUFFIXES = (".dcm", ".dicom", ".ima")
"""That DICOM files often have; many have none."""

_IO = "GDCMImageIO"
# (0002,0002) says what kind of object a file holds. Without slices are directories, waveforms, presentation
# states, registrations and segmentations, reports, documents and treatment plans.
_KIND = re.compile(rb"\x02\x00\x02\x00UI..1\.2\.840\.10008\.([0-9.]+)", re.DOTALL)
_NO_SLICES = ("1.3.10", *(f"5.1.4.1.1.{group}" for group in ("9.", "11.", "66", "88.", "104.", "481.")))
_STACKED = ("CT", "MR", "PT")  # modalities whose slices make volumes
_LARGEST_TURN = 1e-2  # between directions of slices that are parallel; some files give three digits
_LARGEST_SHIFT = 0.05  # of the distance between slices; ITK only warns, whatever is missing
_MODALITY, _DESCRIPTION, _NUMBER, _INSTANCE, _FRAME_TIME = "0008|0060", "0008|103e", "0020|0011", "0020|0013", "0018|1063"
_CENTER, _WIDTH, _POSITION = "0028|1050", "0028|1051", "0020|0032"
_ORIENTATION, _PIXELS = "0020|0037", "0028|0030"
_TAGS = (_MODALITY, _DESCRIPTION, _NUMBER, _INSTANCE, _FRAME_TIME, _CENTER, _WIDTH, _ORIENTATION)

Points = NDArray[np.float64]


@dataclass(frozen=True)
class _Slice:
    """What the header of a file says: where its first sample lies, texts by their tags, and the bytes of its samples."""

    path: str
    origin: tuple[float, ...]
    channels: int
    texts: dict[str, str]
    bytes: int

    def number(self, tag: str) -> float:
        """The first of the numbers of a tag, NaN if there is none."""
        try:
            return float(self.texts.get(tag, "").split("\\")[0])
        except ValueError:
            return math.nan


def is_file(path: Path) -> bool:
    """Whether a file says that it is DICOM."""
    with path.open("rb") as stream:
        return stream.read(132)[128:] == b"DICM"


def is_folder(path: Path) -> bool:
    """Whether a folder holds DICOM files itself, not in folders below."""
    return any(file.suffix.lower() in SUFFIXES or is_file(file) for file in _files(path))


def _files(path: Path) -> list[Path]:
    """Those in a folder that may be slices, by their names; systems leave hidden files beside them, such as ._1.dcm."""
    return sorted(file for file in path.iterdir() if not file.name.startswith(".") and file.is_file())


def series_of(path: Path) -> tuple[Series, ...]:
    """The series in a folder, by their numbers; none of a file, which holds one."""
    if not path.is_dir():
        return ()
    with _itk.quiet(), foreign_errors(f"read {path}", _itk.reason):
        return _listed(_found(path))


def read(path: Path, choose: Choice, series: int | str | None = None) -> Content:
    """The slices of one series, ordered by where they lie in the patient and not by their names; or those of one file."""
    with _itk.quiet(), foreign_errors(f"read {path}", _itk.reason):
        if path.is_dir():
            files = _series(path, series)
            slices = [_header(file) for file in files]
            return _read_files(path, slices, choose) if len(files) > 1 else _read_file(Path(files[0]), choose, alone=True)
        if series is not None:
            raise OptionError(f"series is for a folder of DICOM files; {path.name} is one file")
        return _read_file(path, choose)


# -- a folder ----------------------------------------------------------------------------------------------------


def _found(path: Path) -> dict[str, list[str]]:
    """The files of each series in a folder, the series by their numbers."""
    reader = simpleitk().ImageSeriesReader
    files = {uid: list(reader.GetGDCMSeriesFileNames(str(path), uid)) for uid in reader.GetGDCMSeriesIDs(str(path))}
    _refuse_damaged(path, {Path(file).name for names in files.values() for file in names})
    if not files:
        raise FormatError(f"{path} must be a folder that holds DICOM files itself (not in folders below); found none")
    if len(files) > 1:
        number = {uid: _header(names[0]).number(_NUMBER) for uid, names in files.items()}
        files = dict(sorted(files.items(), key=lambda item: (math.inf if math.isnan(n := number[item[0]]) else n, item[0])))
    return files


def _series(path: Path, choice: int | str | None) -> list[str]:
    """The files of the series that is chosen, by its number in the listing or its id."""
    files = _found(path)
    chosen = list(files)[chosen_series(path.name, _listed(files), choice, what="series", first=False)]
    if not chosen and len(files) > 1:  # for GDCM no id means any series
        raise FormatError(f"{path} holds slices without a series id beside other series: part them into folders")
    return files[chosen]


def _listed(files: Mapping[str, list[str]]) -> tuple[Series, ...]:
    return tuple(Series(uid, _text(_header(names[0]), len(names))) for uid, names in files.items())


def _refuse_damaged(path: Path, sound: set[str]) -> None:
    """Raise if a file looks like a slice and is not among the `sound` ones: GDCM passes over what it cannot read."""
    for file in _files(path):
        if file.name in sound:
            continue
        with file.open("rb") as stream:
            head = stream.read(1024)
        found = _KIND.search(head)
        slices = found is None or not found[1].decode().startswith(_NO_SLICES)
        if slices and (head[128:132] == b"DICM" or file.suffix.lower() == ".dcm"):
            raise FormatError(f"{path} must hold sound DICOM files; {file.name} is damaged or cut short")


def _read_files(path: Path, slices: Sequence[_Slice], choose: Choice) -> Content:
    """Volumes of files with a slice each."""
    _require_parallel(path, slices)
    origins = np.array([one.origin for one in slices])
    order, guessed = _order(origins, np.array([one.number(_INSTANCE) for one in slices]))
    middle = slices[len(slices) // 2]
    pick = choose(path.name, _leading(order, middle.channels), guessed)
    wanted = _wanted(order, pick)
    announce(path.name, sum(slices[int(n)].bytes for n in wanted.ravel()))
    reader = simpleitk().ImageSeriesReader()
    reader.SetImageIO(_IO)
    reader.SetFileNames([slices[int(n)].path for n in wanted.ravel()])
    image = reader.Execute()
    samples = simpleitk().GetArrayViewFromImage(image)
    if len(samples) != wanted.size:
        raise DataError(f"{path} must hold one slice a file; found {len(samples)} slices in {wanted.size} files")
    geometry = describe_simpleitk(image) | _about(middle)
    _place(path, geometry, origins[order[0]])
    return _taken(samples.reshape(*wanted.shape, *samples.shape[1:]), middle.channels, pick), _merged(geometry, pick)


def _require_parallel(path: Path, slices: Sequence[_Slice]) -> None:
    """Raise if slices are turned against each other: GDCM does not look, and a series of localizers has three planes."""
    planes: list[tuple[NDArray[np.float64], int]] = []
    for one in slices:
        try:
            turn = np.array([float(part) for part in one.texts.get(_ORIENTATION, "").split("\\")])
        except ValueError:
            continue
        if turn.shape != (6,):  # it does not say
            continue
        at = next((n for n, (known, _) in enumerate(planes) if np.allclose(known, turn, rtol=0, atol=_LARGEST_TURN)), None)
        if at is None:
            planes.append((turn, 1))
        else:
            planes[at] = turn, planes[at][1] + 1
    if len(planes) > 1:
        counts = ", ".join(str(count) for _, count in planes)
        raise FormatError(
            f"{path} must hold one stack of parallel slices; these lie in {len(planes)} orientations ({counts} slices), "
            "as localizers do: part them into folders, or read one file"
        )


# -- a file ------------------------------------------------------------------------------------------------------


def _read_file(path: Path, choose: Choice, alone: bool = False) -> Content:
    """A slice, or the many frames of an enhanced object or of a film; `alone`: as the caller knows it to be."""
    head = _header(str(path))
    announce(path.name, head.bytes)
    image = simpleitk().ReadImage(head.path, imageIO=_IO)
    samples = simpleitk().GetArrayViewFromImage(image)
    frames = samples.shape[0]
    content = path.read_bytes() if frames > 1 else b""
    geometry = describe_simpleitk(image) | _about(head, content)
    origins, order, guessed = _positions(content, frames), np.arange(frames)[None], ""
    if frames == 1 and not alone and head.texts.get(_MODALITY) in _STACKED and (more := _beside(path)):
        guessed = f"it is one slice, and {more} more DICOM files lie beside it: give the folder to read a volume of all"
    film = frames > 1 and origins is None and not math.isnan(head.number(_FRAME_TIME))
    if film:
        order = order.T
        geometry["header"] |= {"time_step": head.number(_FRAME_TIME), "time_unit": "msec"}
    elif origins is not None:
        order, guessed = _order(origins, np.arange(frames, dtype=np.float64))
        _lay(geometry, content)
        if order.shape[1] > 1:
            _place(path, geometry, origins[order[0]])
    elif frames > 1:
        guessed = f"it does not say where its {frames} frames lie, they were taken for slices"
    pick = choose(path.name, _leading(order, head.channels, "time" if film else "volume"), guessed)
    return _taken(samples[_wanted(order, pick)], head.channels, pick), _merged(geometry, pick)


def _beside(path: Path) -> int:
    """How many other files of a folder may be slices."""
    return sum(file != path and file.suffix == path.suffix and is_file(file) for file in _files(path.parent))


def _positions(content: bytes, frames: int) -> Points | None:
    """Where each of the frames of an enhanced object lies; ITK gives the first alone."""
    texts = _texts(content, _POSITION)
    places = [[float(part) for part in text.split("\\")] for text in texts]
    return np.array(places) if frames > 1 and len(places) == frames and all(len(place) == 3 for place in places) else None


def _lay(geometry: dict[str, Any], content: bytes) -> None:
    """Set spacing and direction within the frames: GDCM finds neither where frames are not in the order of their places."""
    rows = [float(part) for part in _texts(content, _PIXELS, "nan")[0].split("\\")]
    turn = [float(part) for part in _texts(content, _ORIENTATION, "nan")[0].split("\\")]
    if len(rows) == 2:
        geometry["spacing"] = (rows[1], rows[0], geometry["spacing"][2])
    if len(turn) == 6:
        x, y = np.array(turn).reshape(2, 3)
        geometry["direction"] = np.column_stack([x, y, np.cross(x, y)])


def _texts(content: bytes, tag: str, *otherwise: str) -> list[str]:
    """The numbers of a tag wherever they stand, in sequences too; `otherwise` if nowhere."""
    group, element = (int(part, 16).to_bytes(2, "little") for part in tag.split("|"))
    start = re.escape(group + element) + rb"(?:DS(..)|(..)\0\0)"  # with its type before the length, or without
    texts = []
    for found in re.finditer(start, content, re.DOTALL):
        length = int.from_bytes(found[1] or found[2], "little")
        text = content[found.end() : found.end() + length].decode("latin-1").strip(" \0")
        if re.fullmatch(r"[\d.eE+\-\\ ]+", text):
            texts.append(text)
    return texts or list(otherwise)


# -- what both share ----------------------------------------------------------------------------------------------


def _header(file: str) -> _Slice:
    check_samples(Path(file))
    reader = simpleitk().ImageFileReader()
    reader.SetImageIO(_IO)
    reader.SetFileName(file)
    reader.ReadImageInformation()
    texts = {tag: reader.GetMetaData(tag).strip() for tag in _TAGS if reader.HasMetaDataKey(tag)}
    channels = reader.GetNumberOfComponents()
    bits = re.search(r"(\d+)-bit", simpleitk().GetPixelIDValueAsString(reader.GetPixelID()))
    size = math.prod(reader.GetSize()) * channels * int(bits[1] if bits else 64) // 8
    return _Slice(file, tuple(reader.GetOrigin()[:3]), channels, texts, size)


def _about(head: _Slice, content: bytes = b"") -> dict[str, Any]:
    """Arguments of `Volume`: the name, and the window that the source shows it in."""
    center, width = head.number(_CENTER), head.number(_WIDTH)
    if content and math.isnan(center * width):  # of the frames of an enhanced object
        center, width = (float(_texts(content, tag, "nan")[0].split("\\")[0]) for tag in (_CENTER, _WIDTH))
    about: dict[str, Any] = {"header": {"modality": head.texts.get(_MODALITY, "")}}
    if description := head.texts.get(_DESCRIPTION):
        about["name"] = description.encode("utf-8", "surrogateescape").decode("utf-8", "replace")
    if width > 0 and math.isfinite(center) and math.isfinite(width):
        about["window"] = (center - width / 2, center + width / 2)
    return about


def _text(head: _Slice, count: int) -> str:
    """What is said of a series, for listings."""
    parts = (head.texts.get(_MODALITY, ""), _about(head).get("name", ""), f"{count} file{'s' if count > 1 else ''}")
    return ", ".join(part for part in parts if part)


def _order(origins: Points, numbers: NDArray[np.float64]) -> tuple[NDArray[np.intp], str]:
    """Which slices make the volumes, shape (volumes, slices), by where they lie; and what was guessed for that.

    Where several lie in each place, the first of each is of the first volume, by their `numbers`.
    """
    away = origins - origins[0]
    extent = np.linalg.norm(away, axis=1)
    alike = np.arange(len(origins))[None]
    if not extent.any():
        return alike, ""
    along = away @ away[extent.argmax()] * (1 if (away[-1] @ away[extent.argmax()]) >= 0 else -1)
    along /= extent.max()
    rows = np.lexsort((np.nan_to_num(numbers), np.round(along / extent.max(), 6)))
    place = np.cumsum(np.diff(along[rows], prepend=along[rows[0]]) > extent.max() / (10 * len(origins)))
    counts = np.bincount(place)
    if counts.min() != counts.max():
        return alike, ""  # the gaps tell
    order = rows.reshape(len(counts), -1).T
    return order, "" if len(order) == 1 else f"the {len(order)} images of each place were taken for volumes, by their numbers"


def _leading(order: NDArray[np.intp], channels: int, axis: str = "volume") -> Leading:
    axes, counts = ((axis,), (len(order),)) if len(order) > 1 else ((), ())
    return Leading.of_rgb(channels, axes, counts) if channels > 1 else Leading(axes, counts)


def _wanted(order: NDArray[np.intp], pick: Pick) -> NDArray[np.intp]:
    """Which slices are read: shape (slices,) or (volumes, slices)."""
    return np.asarray(order[pick.index[0]] if len(order) > 1 else order[0])


def _taken(samples: NDArray[Any], channels: int, pick: Pick) -> NDArray[Any]:
    """Of samples [..., z, y, x] or [..., z, y, x, channel]."""
    if channels > 1:
        lead = samples.ndim - 4
        samples = np.moveaxis(samples, -1, lead)[(slice(None),) * lead + (pick.index[-1],)]
    return pick.finish(copied(samples))


def _merged(geometry: dict[str, Any], pick: Pick) -> dict[str, Any]:
    """What is known of a volume; the name of a channel stands behind that of its series."""
    names = [about["name"] for about in (geometry, pick.about) if "name" in about]
    merged = {name: value for name, value in (geometry | pick.about).items() if name != "name"}
    if names and "leading" not in pick.about:
        merged["name"] = ", ".join(names)
    if "leading" not in pick.about:
        merged.pop("leading", None)
    return merged


def _place(path: Path, geometry: dict[str, Any], origins: Points) -> None:
    """Set origin, spacing and direction across the slices from where the slices lie, and refuse gaps.

    ITK takes the slices to lie straight behind each other; a tilted gantry shifts each a little.
    """
    step = (origins[-1] - origins[0]) / (len(origins) - 1)
    distance = float(np.linalg.norm(step))
    shift = np.linalg.norm(origins - origins[0] - np.arange(len(origins))[:, None] * step, axis=1)
    if not (origins != origins[0]).any():  # pictures without a place: only the caller knows their distance
        geometry["spacing"] = (*geometry["spacing"][:2], math.nan)
    elif shift.max() > _LARGEST_SHIFT * distance:
        gaps = np.linalg.norm(np.diff(origins, axis=0), axis=1)
        raise FormatError(
            f"{path} must hold one stack of evenly spaced slices; they lie {gaps.min():g} to {gaps.max():g} mm apart: "
            "slices are missing, or the series holds several images of some places"
        )
    else:
        direction = np.array(geometry["direction"])
        direction[:, 2] = step / distance
        geometry["direction"], geometry["spacing"] = direction, (*geometry["spacing"][:2], distance)
        geometry["origin"] = tuple(origins[0])
