"""Analyze 7.5 (``.hdr`` and ``.img`` without NIfTI's magic), and SPM's with an origin, a scale or a ``.mat`` file, by nibabel."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from clvol.bricks.sliced import FlatFile, Index, Window
from clvol.formats._choice import Choice
from clvol.formats._files import bytes_at, require_bytes
from clvol.formats._layout import Layout, scaled_part
from clvol.formats.guarded.limits import announce
from clvol.interop.kinds import Content
from clvol.interop.nibabel import describe_nibabel, nibabel
from clvol.volume.volumes import Leading

__all__ = ["is_file", "lazily", "read"]

_LENGTH = 348  # of the header, which begins with this number
_NIFTI = (b"ni1\0", b"n+1\0")


def is_file(path: Path) -> bool:
    """Whether a file, or the ``.hdr`` beside it, is a header of Analyze and not of NIfTI."""
    names = (path, *(path.with_suffix(suffix) for suffix in (".hdr", ".HDR")))
    header = next((name for name in names if name.suffix.lower() == ".hdr" and name.is_file()), None)
    if header is None or path.suffix.lower() not in (".hdr", ".img"):
        return False
    with header.open("rb") as stream:
        head = stream.read(_LENGTH)
    if len(head) < _LENGTH or _LENGTH.to_bytes(4, "little") not in (head[:4], head[3::-1]):
        return False
    return all(sum(a == b for a, b in zip(head[-4:], magic, strict=True)) < 2 for magic in _NIFTI)  # nor NIfTI's, damaged


def read(path: Path, choose: Choice) -> Content:
    """Samples of the chosen volumes, scaled as the header says, and geometry as nibabel finds it, in ITK's LPS frame."""
    ((data, about),) = lazily(path, choose)
    announce(path.name, bytes_at(data.shape, (), data.dtype))
    return data[...], about


def lazily(path: Path, choose: Choice) -> list[Content]:
    """As `read`, but samples are read on demand."""
    image = nibabel().Spm2AnalyzeImage.from_filename(path)
    samples, dtype = image.dataobj, image.get_data_dtype()
    with np.errstate(all="ignore"):  # `Volume` refuses a geometry that is not finite
        about = describe_nibabel(image)
    colours = len(dtype.names or ())
    d = min(len(samples.shape), 3)
    frames = int(np.prod(samples.shape[3:], dtype=object))
    names = ("volume" if frames > 1 else "", *"zyx"[-d:], "channel" if colours else "")
    shape = (frames, *(int(n) for n in samples.shape[d - 1 :: -1]), max(1, colours))
    stored = np.dtype("u1") if colours else dtype
    file = Path(image.file_map["image"].filename)
    start = int(samples.offset)
    require_bytes(file.name, file.stat().st_size - start, shape, stored)
    flat = FlatFile(file, shape, stored, start)
    layout = Layout(names, shape)
    leading = layout.channels_of(stored) if colours else Leading(layout.leading, layout.counts)

    def part(index: Index) -> Any:
        return scaled_part(Window(flat, shape, stored, None, index), float(samples.slope), float(samples.inter))

    about.pop("leading", None)
    data, known = layout.chosen(path.name, choose, part, leading)
    return [(data, about | known)]
