"""Analyze 7.5 (``.hdr`` and ``.img`` without NIfTI's magic, also packed by gzip), and SPM's with an origin, a scale or a ``.mat``
file, by nibabel.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from clvol.base.errors import FormatError
from clvol.bricks.sliced import FlatFile, Index, Window
from clvol.formats._choice import Choice
from clvol.formats._files import bytes_at, gunzipped_size, packed, paired, require_bytes, sample_count, unpacked
from clvol.formats._layout import Layout, scaled_part
from clvol.formats.guarded.limits import announce
from clvol.interop.kinds import Content
from clvol.interop.nibabel import describe_nibabel, nibabel
from clvol.volume.volumes import Leading

__all__ = ["SUFFIXES", "is_file", "lazily", "read"]

SUFFIXES = (".hdr", ".img", ".hdr.gz", ".img.gz")
"""Suffixes of the files of a pair, of NIfTI too."""

_LENGTH = 348  # of the header, which begins with this number
_NIFTI = (b"ni1\0", b"n+1\0")


def is_file(path: Path) -> bool:
    """Whether a file, or the ``.hdr`` beside it, is a header of Analyze and not of NIfTI."""
    header = paired(path, ".hdr") if path.name.lower().endswith(SUFFIXES) else None
    if header is None:
        return False
    with unpacked(header) as stream:
        head = stream.read(_LENGTH)
    if len(head) < _LENGTH or _LENGTH.to_bytes(4, "little") not in (head[:4], head[3::-1]):
        return False
    return all(sum(a == b for a, b in zip(head[-4:], magic, strict=True)) < 2 for magic in _NIFTI)  # nor NIfTI's, damaged


def read(path: Path, choose: Choice) -> Content:
    """Samples of the chosen volumes, scaled as the header says, and geometry as nibabel finds it, in ITK's LPS frame."""
    data, about = _content(path, choose)
    announce(path.name, bytes_at(data.shape, (), data.dtype))
    return data[...], about


def lazily(path: Path, choose: Choice) -> list[Content]:
    """As `read`, but samples are read on demand; empty for packed ones, which have no random access."""
    samples = paired(path, ".img")
    return [] if samples and packed(samples) else [_content(path, choose)]


def _content(path: Path, choose: Choice) -> Content:
    kind = nibabel().Spm2AnalyzeImage
    files = {name: file for name, suffix in kind.files_types if (file := paired(path, suffix))}
    if missing := {"header", "image"} - files.keys():
        raise FormatError(f"{path.name} must have its {' and its '.join(sorted(missing))} beside it, which is not there")
    names = {"mat": path.with_suffix(".mat")} | files  # SPM's matrix need not be there
    image = kind.from_file_map(kind.make_file_map({name: str(file) for name, file in names.items()}))
    samples, dtype = image.dataobj, image.get_data_dtype()
    with np.errstate(all="ignore"):  # `Volume` refuses a geometry that is not finite
        about = describe_nibabel(image)
    colours = len(dtype.names or ())
    d = min(len(samples.shape), 3)
    frames = int(np.prod(samples.shape[3:], dtype=object))
    axes = ("volume" if frames > 1 else "", *"zyx"[-d:], "channel" if colours else "")
    shape = (frames, *(int(n) for n in samples.shape[d - 1 :: -1]), max(1, colours))
    stored = np.dtype("u1") if colours else dtype
    file = files["image"]
    start, needed = int(samples.offset), sample_count(shape) * stored.itemsize
    with file.open("rb") as stream:
        found = gunzipped_size(stream, start + needed) if packed(file) else file.stat().st_size
    require_bytes(file.name, found - start, shape, stored)
    flat: Any = FlatFile(file, shape, stored, start)
    if packed(file):
        announce(file.name, needed)
        with unpacked(file) as unzipped:
            unzipped.seek(start)
            flat = (
                np.frombuffer(unzipped.read(needed), stored).reshape(shape).astype(stored.newbyteorder("="), copy=False).__getitem__
            )
    layout = Layout(axes, shape)
    leading = layout.channels_of(stored) if colours else Leading(layout.leading, layout.counts)

    def part(index: Index) -> Any:
        return scaled_part(Window(flat, shape, stored, None, index), float(samples.slope), float(samples.inter))

    about.pop("leading", None)
    data, known = layout.chosen(path.name, choose, part, leading)
    return data, about | known
