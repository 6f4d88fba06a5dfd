"""Folders of DICOM files: the series in one, or, where it holds no images itself, in the folders below it."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Iterator
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any

from clvol.base.checks import warn
from clvol.base.errors import FormatError
from clvol.formats._choice import Series, chosen_series
from clvol.formats.dicom.header import SUFFIXES, has_pictures, names_of, numbers_of, read_header
from clvol.formats.dicom.stack import finite

__all__ = ["files_in", "files_of", "is_above", "is_file", "is_folder", "series_in"]

_LISTED = (
    "SOPClassUID",
    "SeriesInstanceUID",
    "SeriesNumber",
    "Modality",
    "SeriesDescription",
    "SpecificCharacterSet",
    "Rows",
    "Columns",
)
_DEEPEST = 5  # folders below one another that are looked through: of a patient, a study, a series, and what a disc has above them
_MOST = 500  # folders in all


def is_file(path: Path) -> bool:
    """Whether a file says that it is DICOM."""
    with path.open("rb") as stream:
        return stream.read(132)[128:] == b"DICM"


def is_folder(path: Path) -> bool:
    """Whether a folder holds DICOM files itself, not in folders below."""
    return any(_may_be_slice(file) for file in files_in(path))


def is_above(path: Path) -> bool:
    """Whether a folder below this one holds DICOM files."""
    for folder in islice(_below(path), _MOST):
        with suppress(OSError):  # what may not be read is none of them
            if is_folder(folder):
                return True
    return False


def files_in(path: Path) -> list[Path]:
    """Those in a folder that may be slices, by their names; systems leave hidden files beside them, such as ._1.dcm."""
    return sorted(file for file in path.iterdir() if not file.name.startswith(".") and file.is_file())


def _may_be_slice(file: Path) -> bool:
    return file.suffix.lower() in SUFFIXES or is_file(file)


def _below(path: Path) -> Iterator[Path]:
    """Folders below one, the nearest first."""
    waiting = deque([(path, 0)])
    while waiting:
        folder, depth = waiting.popleft()
        if depth:
            yield folder
        if depth < _DEEPEST:
            with suppress(OSError):
                inner = (one for one in folder.iterdir() if not one.name.startswith(".") and one.is_dir() and not one.is_symlink())
                waiting.extend((one, depth + 1) for one in sorted(inner))


def series_in(path: Path) -> dict[Series, list[Path]]:
    """The files of each series in a folder, the series by their numbers; where it has none, of those in each folder below."""
    if not (found := _of(path)):
        folders = list(islice(_below(path), _MOST + 1))
        if len(folders) > _MOST:
            raise FormatError(
                f"{path} must hold DICOM images, or have at most {_MOST} folders below it, to be looked through: give one of them"
            )
        found = {(folder, uid): more for folder in folders for (_, uid), more in _of(folder).items()}
    if not found:
        raise FormatError(f"{path} must be a folder that holds DICOM files, itself or in folders below; found none with pictures")
    uids = [uid for _, uid in found]
    named = {}
    for (folder, uid), (header, files) in found.items():
        where = "" if folder == path else folder.relative_to(path).as_posix()
        text = ", ".join(filter(None, (*names_of(header), f"{len(files)} file{'s' * (len(files) > 1)}", where and f"in {where}")))
        unique = uid if uids.count(uid) == 1 else f"{where}/{uid}"
        named[Series(unique or where, text)] = files
    return named


def _of(path: Path) -> dict[tuple[Path, str], tuple[Any, list[Path]]]:
    """The first header and the files of each series in a folder itself."""
    files: dict[str, list[Path]] = defaultdict(list)
    firsts: dict[str, Any] = {}
    for file in files_in(path):
        if _may_be_slice(file):
            header = read_header(file, *_LISTED)
            if has_pictures(header):
                if "Rows" not in header or "Columns" not in header:
                    raise FormatError(f"{path} must hold sound DICOM files; {file.name} is damaged or cut short")
                uid = str(header.get("SeriesInstanceUID") or "")
                files[uid].append(file)
                firsts.setdefault(uid, header)
    order = sorted(files, key=lambda uid: (finite(numbers_of(firsts[uid], "SeriesNumber")[:1]), uid))
    return {(path, uid): (firsts[uid], files[uid]) for uid in order}


def files_of(path: Path, choice: int | str | None) -> list[Path]:
    """The files of the series that is chosen, by its number in the listing or its id."""
    found = series_in(path)
    chosen = list(found)[chosen_series(path.name, list(found), choice, what="series", first=False)]
    files = found[chosen]
    if not chosen.id and len(found) > 1:
        raise FormatError(f"{path} holds slices without a series id beside other series: part them into folders")
    if files[0].parent != path and choice is None:
        warn(f"{path.name} holds no DICOM images itself; the series in {files[0].parent.relative_to(path).as_posix()} was read")
    return files
