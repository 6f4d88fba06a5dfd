"""The samples of frames: decoded by pydicom, or by GDCM (in SimpleITK) where pydicom has no decoder; each by its own scale.

Source: DICOM PS3.5, annex A (transfer syntaxes); PS3.3, C.11.1 (modality LUT).
"""

from __future__ import annotations

import tempfile
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.checks import warn
from clvol.base.errors import FormatError
from clvol.formats import _itk
from clvol.formats._errors import foreign_errors
from clvol.formats._files import scaled
from clvol.formats.dicom.header import ROOT, Frame, has_palette, opened, pydicom
from clvol.formats.guarded.messages import empty
from clvol.interop.itk import simpleitk

__all__ = ["decoded", "samples_of"]

_UNDEFINED = 0xFFFFFFFF  # length of what a mark ends
_PIXELS = 0x7FE0  # group of the samples


def samples_of(frames: Sequence[Frame]) -> NDArray[Any]:
    """The values of frames, [frame, y, x] or [frame, y, x, channel], each by its own scale, in a dtype that holds all."""
    known = {frame.dtype for frame in frames if frame.dtype is not None}
    result: NDArray[Any] | None = None
    places: dict[Path, dict[int, list[int]]] = defaultdict(lambda: defaultdict(list))
    for n, frame in enumerate(frames):
        places[frame.path][frame.index].append(n)
    for path, at in places.items():
        indices = sorted(at)
        for index, (stored, header) in zip(indices, decoded(path, indices), strict=True):
            for n in at[index]:
                values = _values(frames[n], stored[frames[n].tile], header)
                if result is None:
                    dtype = np.result_type(*known) if known else values.dtype
                    result = empty((len(frames), *values.shape), dtype if _holds(dtype, values) else _smallest(values))
                if not _holds(result.dtype, values):
                    wider = empty(result.shape, np.result_type(result.dtype, _smallest(values)))
                    np.copyto(wider, result)
                    result = wider
                result[n] = values
    assert result is not None  # there are frames
    return result


def _holds(dtype: np.dtype[Any], values: NDArray[Any]) -> bool:
    """Whether a dtype holds values: headers may promise fewer bits than there are, and do not say what tables and floats hold."""
    if dtype.kind in "iu" and values.dtype.kind in "iu":
        return bool(np.iinfo(dtype).min <= values.min() and values.max() <= np.iinfo(dtype).max)
    return np.can_cast(values.dtype, dtype) or dtype == np.float64


def _smallest(values: NDArray[Any]) -> np.dtype[Any]:
    if values.dtype.kind not in "iu":
        return values.dtype
    return np.result_type(np.min_scalar_type(int(values.min())), np.min_scalar_type(int(values.max())))


def decoded(path: Path, indices: Sequence[int]) -> Iterator[tuple[NDArray[Any], Any]]:
    """Stored samples of frames of a file, in ascending order, each with all elements of the file."""
    with foreign_errors(f"read {path}: {path.name} is damaged or cut short", _itk.reason), opened(path) as stream:
        whole = pydicom().dcmread(stream, force=True)
        _require_whole(path, list(whole.values()), stream)
        if "TransferSyntaxUID" not in whole.file_meta:
            implicit, little = whole.original_encoding
            whole.file_meta.TransferSyntaxUID = ROOT + ("1.2" if implicit else "1.2.1" if little else "1.2.2")
        if not whole.file_meta.TransferSyntaxUID.is_encapsulated and "PixelData" in whole:
            needed, found = pydicom().pixels.utils.get_expected_length(whole), len(whole.PixelData)
            if found >= needed + max(2, needed // max(1, int(whole.get("NumberOfFrames") or 1))):
                raise FormatError(
                    f"{path.name} is damaged: its frames take {needed} bytes, it holds {found}, one frame more or several"
                )
        frames = pydicom().pixels.iter_pixels(whole, indices=list(indices))
        if whole.get("BitsAllocated") == 1 and whole.Rows * whole.Columns % 8:  # frames that share bytes: iter_pixels mistakes them
            every = pydicom().pixels.pixel_array(whole).reshape(-1, whole.Rows, whole.Columns)
            frames = (every[index] for index in indices)
        try:
            yield next(frames), whole
        except (RuntimeError, NotImplementedError):  # none of pydicom's decoders reads it
            if not whole.file_meta.TransferSyntaxUID.is_encapsulated:
                raise
            every = _by_gdcm(whole)
            frames = (every[index] for index in indices)
        for frame in frames:
            yield frame, whole


def _require_whole(path: Path, elements: Sequence[Any], content: Any) -> None:
    """Raise if an element up to the samples is cut short, or if what follows them is neither elements nor padding."""
    behind = next((n + 1 for n, raw in enumerate(elements) if raw.tag.group == _PIXELS), len(elements))
    for raw in elements[:behind]:
        if raw.is_raw and raw.length != _UNDEFINED and len(raw.value or b"") < raw.length:
            found = len(raw.value or b"")
            raise FormatError(f"{path.name} is damaged or cut short: {raw.tag} has {raw.length} bytes, of which {found} are there")
    if any(raw.tag.group < _PIXELS for raw in elements[behind:]):
        pixels = elements[behind - 1]
        padding = set(content[pixels.value_tell + pixels.length :]) if pixels.length != _UNDEFINED else ()
        if len(padding) != 1:
            raise FormatError(f"{path.name} is damaged: what follows its samples is neither elements nor padding")
        warn(f"{path.name} has padding after its samples, which was ignored")


def _by_gdcm(whole: Any) -> NDArray[Any]:
    """Stored samples of all frames: GDCM reads a copy without the elements that it would apply."""
    bare = pydicom().Dataset()
    bare.update({e.tag: e for e in whole if (e.tag.group == 0x0028 and e.tag.element < 0x1000) or e.tag.group == 0x7FE0})
    bare.SOPClassUID, bare.SOPInstanceUID = ROOT + "5.1.4.1.1.7", "1.2.3"
    if bare.get("SamplesPerPixel") == 1:
        bare.PhotometricInterpretation = "MONOCHROME2"
    bare.file_meta = whole.file_meta
    bare.file_meta.MediaStorageSOPClassUID, bare.file_meta.MediaStorageSOPInstanceUID = bare.SOPClassUID, bare.SOPInstanceUID
    with tempfile.TemporaryDirectory() as folder, _itk.quiet():
        file = str(Path(folder) / "bare.dcm")
        bare.save_as(file, enforce_file_format=True)
        return np.asarray(simpleitk().GetArrayFromImage(simpleitk().ReadImage(file, imageIO="GDCMImageIO")))


def _values(frame: Frame, stored: NDArray[Any], header: Any) -> NDArray[Any]:
    """What stored samples stand for: rescaled, or from the lookup table of the modality or of the colours."""
    pixels = pydicom().pixels
    if has_palette(header):
        return np.asarray(pixels.apply_color_lut(stored, header))[..., :3]
    if frame.scale is None:
        return np.asarray(pixels.apply_modality_lut(stored, header))
    if stored.dtype.kind in "iu" and frame.dtype != np.float64:
        return stored if frame.scale == (1, 0) else stored.astype(np.int64) * int(frame.scale[0]) + int(frame.scale[1])
    return scaled(stored, *frame.scale)
