"""DICOM: a folder of slices, or a file of one or many frames, each by its own header.

Source: DICOM PS3.3, A.51 and C.8.20 (segmentations).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from clvol.base.errors import FormatError, OptionError
from clvol.formats._choice import Choice, Pick, Series
from clvol.formats._errors import foreign_errors
from clvol.formats.dicom.folders import files_in, files_of, is_above, is_file, is_folder, series_in
from clvol.formats.dicom.header import ROOT, SUFFIXES, Frame, frames_of, leniently, names_of, numbers_of, read_header
from clvol.formats.dicom.samples import decoded, samples_of
from clvol.formats.dicom.stack import finite, geometry_of, grid_of, order_of, require_alike, spread_out
from clvol.formats.guarded.limits import announce
from clvol.formats.guarded.messages import empty
from clvol.interop.kinds import Content
from clvol.volume.volumes import Leading

__all__ = ["SUFFIXES", "is_above", "is_file", "is_folder", "read", "series_of"]

_SEGMENTATION = ROOT + "5.1.4.1.1.66.4"
_STACKED = ("CT", "MR", "PT")  # modalities whose slices make volumes


def series_of(path: Path) -> tuple[Series, ...]:
    """The series in a folder or in those below it, by their numbers; none of a file, which holds one."""
    if not path.is_dir():
        return ()
    with foreign_errors(f"read {path}"), leniently(path):
        return tuple(series_in(path))


def read(path: Path, choose: Choice, series: int | str | None = None) -> Content:
    """The slices of one series, ordered by where they lie in the patient and not by their names; or those of one file."""
    with foreign_errors(f"read {path}"), leniently(path):
        if path.is_dir():
            files = files_of(path, series)
            return _volumes(path, files, choose, alone=len(files) == 1)
        if series is not None:
            raise OptionError(f"series is for a folder of DICOM files; {path.name} is one file")
        return _volumes(path, [path], choose)


def _volumes(path: Path, files: Sequence[Path], choose: Choice, alone: bool = False) -> Content:
    """The volumes of a series; `alone`: a folder in which no other file lies beside one slice."""
    first = read_header(files[0])
    frames = [frame for n, file in enumerate(files) for frame in frames_of(file, read_header(file) if n else first)]
    require_alike(path, frames)
    if first.get("SOPClassUID") == _SEGMENTATION:
        return _segments(path, files, first, frames, choose)
    frames, where = spread_out(frames)
    placed = all(frame.position for frame in frames)
    film = _film(first) if len(files) == 1 and len(frames) > 1 and not placed else None
    leading, guessed = Leading(), ""
    about: dict[str, Any] = {"header": {"modality": names_of(first)[0]}}
    if "SegmentSequence" in first:
        about["labels"] = _segment_names(first)
    if frame := str(first.get("FrameOfReferenceUID") or "").strip():
        about["header"]["frame_of_reference"] = frame
    if first.get("PhotometricInterpretation") == "MONOCHROME1":  # shown inverted
        about["header"]["photometric"] = "MONOCHROME1"
    if film is not None:
        order = np.arange(len(frames))[:, None]
        leading = Leading(("time",), (len(frames),))
        if film > 0:
            about["header"] |= {"time_step": film, "time_unit": "msec"}
    elif placed:
        order, leading, guessed, more = order_of(path, frames)
        guessed = guessed or where
        about["header"] |= more
    else:
        order = np.lexsort(([frame.index for frame in frames], finite([frame.number for frame in frames])))[None]
        if len(files) > 1 and len(frames) > len(files):
            raise FormatError(f"{path} holds {len(files)} files of several frames, which do not say where these lie: read one file")
        if len(files) == 1 and len(frames) > 1:
            guessed = f"it does not say where its {len(frames)} frames lie, they were taken for slices"
        elif len({frame.number for frame in frames}) < len(frames):
            guessed = (
                f"its {len(frames)} files say neither where they lie nor their numbers; they were taken in the order of their names"
            )
    if len(frames) == 1 and not alone and names_of(first)[0] in _STACKED and (more_files := _beside(path)):
        guessed = f"it is one slice, and {more_files} more DICOM files lie beside it: give the folder to read a volume of all"
    middle = frames[int(order[0][len(order[0]) // 2])]
    channels = middle.kind[2]
    if channels > 1:
        leading = Leading((*leading.axes, "channel"), (*leading.counts, channels), leading.names, rgb=channels in (3, 4))
    about |= geometry_of(path, [frames[int(n)] for n in order[0]], film is not None)
    pick = choose(path.name, leading, guessed)
    wanted = order[pick.index[0]] if len(order) > 1 else order[0]
    samples = samples_of([frames[int(n)] for n in np.ravel(wanted)])
    samples = samples.reshape(*wanted.shape, *samples.shape[1:])
    if channels > 1:
        lead = samples.ndim - 4
        samples = np.moveaxis(samples, -1, lead)[(slice(None),) * lead + (pick.index[-1],)]
    return pick.finish(samples), _merged(about | _about(first, middle), pick)


def _film(header: Any) -> float | None:
    """Milliseconds from frame to frame of a film, 0 if they are uneven; None if it is none."""
    if times := numbers_of(header, "FrameTime"):
        return times[0] if times[0] > 0 else 0.0
    if times := numbers_of(header, "FrameTimeVector"):
        return float(times[-1]) if len(set(times[1:])) == 1 else 0.0
    for name in ("CineRate", "RecommendedDisplayFrameRate"):
        if (rate := numbers_of(header, name)) and rate[0] > 0:
            return 1000 / rate[0]
    return None


def _beside(path: Path) -> int:
    """How many other files of a folder may be slices."""
    return sum(file != path and file.suffix == path.suffix and is_file(file) for file in files_in(path.parent))


def _about(header: Any, middle: Frame) -> dict[str, Any]:
    about: dict[str, Any] = {}
    if description := names_of(header)[1]:
        about["name"] = description
    if middle.clim is not None:
        about["clim"] = middle.clim
    return about


def _merged(geometry: dict[str, Any], pick: Pick) -> dict[str, Any]:
    """What is known of a volume; the name of a channel stands behind that of its series."""
    names = [about["name"] for about in (geometry, pick.about) if "name" in about]
    merged = {name: value for name, value in (geometry | pick.about).items() if name != "name"}
    if names and "leading" not in pick.about:
        merged["name"] = ", ".join(names)
    return merged


def _segments(path: Path, files: Sequence[Path], header: Any, frames: Sequence[Frame], choose: Choice) -> Content:
    """A segmentation: labels with names; or if segments overlap or are fractions, a channel for each.

    There are no frames where nothing of a segment lies.
    """
    if len(files) > 1:
        raise FormatError(f"{path} holds {len(files)} segmentations: read one file")
    names = _segment_names(header)
    numbers = [int((frame.keys.get("segment") or (next(iter(names)),))[0]) for frame in frames]
    stack, at = grid_of(frames)
    about = {"header": {"modality": "SEG"}} | _about(header, frames[0]) | geometry_of(path, stack)
    labels = empty((len(stack), *frames[0].kind[:2]), np.min_scalar_type(max(names)))
    labels[...] = 0
    fractions = header.get("SegmentationType") == "FRACTIONAL"
    apart = not fractions
    for number, place, (stored, _) in zip(numbers, at, decoded(files[0], range(len(frames) * apart)), strict=False):
        apart = apart and not labels[place][stored > 0].any()
        labels[place][stored > 0] = number
    if apart:
        pick = choose(path.name, Leading())
        return pick.finish(labels), _merged(about | {"labels": names}, pick)
    largest = (numbers_of(header, "MaximumFractionalValue") or (255.0,))[0] if fractions else 1
    pick = choose(path.name, Leading(("channel",), (len(names),), {"channel": tuple(names.values())}))
    wanted = [*names][pick.index[0]] if isinstance(pick.index[0], slice) else [[*names][pick.index[0]]]
    announce(path.name, len(wanted) * labels.size * (4 if fractions else 1))
    parts = empty((len(wanted), *labels.shape), np.float32 if fractions else np.uint8)
    parts[...] = 0
    for number, place, (stored, _) in zip(numbers, at, decoded(files[0], range(len(frames))), strict=True):
        if number in wanted:
            parts[wanted.index(number), place] = stored / largest if fractions else stored
    return pick.finish(parts if isinstance(pick.index[0], slice) else parts[0]), _merged(about, pick)


def _segment_names(header: Any) -> dict[int, str]:
    return {int(numbers_of(one, "SegmentNumber")[0]): str(one.get("SegmentLabel") or "") for one in header.SegmentSequence}
