"""A folder of DICOM slices, by way of SimpleITK (and GDCM inside it)."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from clvol.errors import DataError, FormatError, OptionError
from clvol.formats import _itk
from clvol.formats._files import foreign_errors
from clvol.interop import Content, from_simpleitk, simpleitk

__all__ = ["read"]

_IO = "GDCMImageIO"
# (0002,0002) says what kind of object a file holds. Without slices are directories, waveforms, presentation
# states, registrations and segmentations, reports, documents and treatment plans.
_KIND = re.compile(rb"\x02\x00\x02\x00UI..1\.2\.840\.10008\.([0-9.]+)", re.DOTALL)
_NO_SLICES = ("1.3.10", *(f"5.1.4.1.1.{group}" for group in ("9.", "11.", "66", "88.", "104.", "481.")))
_LARGEST_SHIFT = 0.05  # of the distance between slices; ITK only warns, whatever is missing


def read(path: Path, series: str | None = None) -> Content:
    """The slices of one series, ordered by where they lie in the patient and not by their names."""
    sitk = simpleitk()
    with _itk.quiet(), foreign_errors(f"read {path}", _itk.reason):
        ids = sitk.ImageSeriesReader.GetGDCMSeriesIDs(str(path))
        files_of = {uid: sitk.ImageSeriesReader.GetGDCMSeriesFileNames(str(path), uid) for uid in ids}
        _refuse_damaged(path, {Path(file).name for files in files_of.values() for file in files})
        files = files_of[_choose(path, ids, series)]
        origins = np.array([_origin(sitk, file) for file in files])
        reader = sitk.ImageSeriesReader()
        reader.SetImageIO(_IO)
        reader.SetFileNames(files)
        data, geometry = from_simpleitk(reader.Execute(), "mm")
    if len(files) > 1:
        _stack(path, data, geometry, origins)
    return data, geometry


def _choose(path: Path, ids: Sequence[str], series: str | None) -> str:
    if not ids:
        raise FormatError(f"{path} must be a folder that holds DICOM files itself (not in folders below); found none")
    if series is None and len(ids) > 1:
        raise FormatError(f"{path} holds {len(ids)} series, choose one by series=: {', '.join(map(repr, ids))}")
    if series is not None and series not in ids:
        raise OptionError(f"series must be one of {', '.join(map(repr, ids))}; got {series!r}")
    chosen = ids[0] if series is None else series
    if not chosen and len(ids) > 1:  # for GDCM no id means any series
        raise FormatError(f"{path} holds slices without a series id beside other series: part them into folders")
    return chosen


def _refuse_damaged(path: Path, sound: set[str]) -> None:
    """Raise if a file looks like a slice and is not among the `sound` ones: GDCM passes over what it cannot read."""
    for file in sorted(path.iterdir()):
        if file.name in sound or not file.is_file():
            continue
        with file.open("rb") as stream:
            head = stream.read(1024)
        found = _KIND.search(head)
        slices = found is None or not found[1].decode().startswith(_NO_SLICES)
        if slices and (head[128:132] == b"DICM" or file.suffix.lower() == ".dcm"):
            raise FormatError(f"{path} must hold sound DICOM files; {file.name} is damaged or cut short")


def _origin(sitk: Any, file: str) -> tuple[float, ...]:
    """World position of the first sample of one slice."""
    reader = sitk.ImageFileReader()
    reader.SetImageIO(_IO)
    reader.SetFileName(file)
    reader.ReadImageInformation()
    return tuple(reader.GetOrigin()[:3])


def _stack(path: Path, data: Any, geometry: dict[str, Any], origins: Any) -> None:
    """Set spacing and direction across the slices from where the slices lie, and refuse gaps.

    ITK takes the slices to lie straight behind each other; a tilted gantry shifts each a little.
    """
    if data.shape[0] != len(origins):
        raise DataError(f"{path} must hold one slice a file; found {data.shape[0]} slices in {len(origins)} files")
    step = (origins[-1] - origins[0]) / (len(origins) - 1)
    distance = float(np.linalg.norm(step))
    shift = np.linalg.norm(origins - origins[0] - np.arange(len(origins))[:, None] * step, axis=1)
    if not (origins != origins[0]).any():  # pictures without a place: only the caller knows their distance
        geometry["spacing"] = (*geometry["spacing"][:2], math.nan)
    elif shift.max() > _LARGEST_SHIFT * distance:
        gaps = np.linalg.norm(np.diff(origins, axis=0), axis=1)
        raise FormatError(
            f"{path} must hold one stack of evenly spaced slices; they lie {gaps.min():g} to {gaps.max():g} mm apart: "
            "slices are missing, or the series holds several images of one place"
        )
    else:
        direction = np.array(geometry["direction"])
        direction[:, 2] = step / distance
        geometry["direction"], geometry["spacing"] = direction, (*geometry["spacing"][:2], distance)
