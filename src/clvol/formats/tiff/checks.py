"""Checks of strips and tiles before they are decoded: tifffile would give zeros or other numbers for damaged ones."""

from __future__ import annotations

import io
import operator
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from clvol.base.errors import FormatError
from clvol.formats._directories import segments
from clvol.formats._files import inflated_size, xz_size
from clvol.formats.guarded.limits import announce
from clvol.formats.tiff.file import directories_of, tifffile

__all__ = ["check_order", "check_samples"]

_DEFLATED = (8, 32946)
_LZMA = (34925, 34926)
_LOSSLESS = (*_DEFLATED, 5, 32773, 50000)  # and LZW, PackBits, Zstandard
_MOST_STORED, _HEAD = 2, 4096  # bytes that a codec needs at most for one of samples, and for its header
_HEADER = 8  # bytes before anything else in a file; tifffile uses the offset 0 for a segment that is not stored


def check_samples(name: str, pages: Sequence[Any], keyframe: Any, count: int, read: int | None = None) -> None:
    """Raise if samples lie past the end of the file, or a slice is missing or stored in another way than tifffile assumes.

    Nothing is allocated before that. Of `count` samples only `read` may be read at a time.
    """
    files = {page.parent.filehandle.path: page.parent.filehandle.size for page in pages if page is not None}
    walked = {file: directories_of(Path(file)) for file in files}
    first = walked.get(keyframe.parent.filehandle.path, {}).get(keyframe.offset)
    sizes = segments(first) if first is not None and not keyframe.parent.is_stk else None  # a page of STK holds several slices
    for page in pages:
        if page is None:
            raise FormatError(f"{name} must hold all of its slices; some are missing")
        handle = page.parent.filehandle
        if len(page.dataoffsets) != len(page.databytecounts):
            found = f"{len(page.dataoffsets)} places and {len(page.databytecounts)} lengths"
            raise FormatError(f"{name} must have a place and a length for each strip or tile; one page has {found}")
        ends = map(operator.add, page.dataoffsets, page.databytecounts)
        if max(ends, default=sys.maxsize) > handle.size or min(page.databytecounts) < 1 or min(page.dataoffsets) < _HEADER:
            raise FormatError(f"{name} must hold the samples of every slice; some lie before or past the samples of the file")
        own = walked[handle.path].get(page.offset, first)  # pages of ImageJ and others may have no directory
        if own is not first and first is not None and own is not None and own != first:
            found = ", ".join(f"tag {tag}: {first[tag]} and {own[tag]}" for tag in own if own[tag] != first[tag])
            raise FormatError(f"{name} must have pages of one shape and type; it has {found}")
        if sizes is not None:
            _check_lengths(name, page.databytecounts, sizes, keyframe.compression != 1)
    stored = sum(files.values())
    if keyframe.compression == 1 and count * int(np.min(keyframe.bitspersample)) > 8 * stored:
        raise FormatError(f"{name} must hold {count} samples of {keyframe.dtype}; it has {stored} bytes")
    announce(name, (count if read is None else read) * keyframe.dtype.itemsize, stored)
    if sizes is not None and keyframe.compression in _LOSSLESS:
        _check_unpacked(name, keyframe, sizes)
    if sizes is not None and keyframe.compression in _LZMA:
        for page in pages:
            _check_ends(name, page, sizes)


def check_order(name: str, image: Any) -> None:
    """Raise if an image is read contiguously, as ImageJ's are, but the directories of its pages have other offsets."""
    if image.dataoffset is None:
        return
    for number, page in enumerate(image):
        expected = image.dataoffset + number * image.keyframe.nbytes
        if page is not None and page.dataoffsets and page.dataoffsets[0] != expected:
            raise FormatError(
                f"{name} must have slices that follow each other; slice {number} is at {page.dataoffsets[0]}, not at {expected}"
            )


def _check_lengths(name: str, lengths: Sequence[int], sizes: tuple[int, int, int, int], packed: bool) -> None:
    """Raise if strips or tiles of a page have other lengths than the fields of its directory imply."""
    per_plane, planes, full, last = sizes
    if len(lengths) != per_plane * planes:
        raise FormatError(f"{name} must have {per_plane * planes} strips or tiles in each page; one has {len(lengths)}")
    if packed:
        wrong = [found for found in lengths if found > _MOST_STORED * full + _HEAD]
    else:  # the last strip may be padded
        wrong = [found for i, found in enumerate(lengths) if found != full and (found != last or (i + 1) % per_plane)]
    if wrong:
        raise FormatError(f"{name} must hold {full} bytes of samples in each strip or tile; one has {wrong[0]}")


def _check_unpacked(name: str, keyframe: Any, sizes: tuple[int, int, int, int]) -> None:
    """Raise if the first segment decodes to another length than its fields imply: tifffile would drop the excess."""
    per_plane, _, full, last = sizes
    handle = keyframe.parent.filehandle
    handle.seek(keyframe.dataoffsets[0])
    content = handle.read(keyframe.databytecounts[0])
    if keyframe.compression in _DEFLATED:
        found = inflated_size(io.BytesIO(content), len(content), full)
    else:
        found = len(tifffile().TIFF.DECOMPRESSORS[keyframe.compression](content))
    if found not in ((full, last) if per_plane == 1 else (full,)):
        raise FormatError(f"{name} must hold {full} bytes of samples in each strip or tile; found {found}")


def _check_ends(name: str, page: Any, sizes: tuple[int, int, int, int]) -> None:
    """Raise if a segment in XZ is truncated or declares another length: its checksum is not read once all samples are decoded."""
    per_plane, _, full, last = sizes
    for number, (offset, length) in enumerate(zip(page.dataoffsets, page.databytecounts, strict=True), 1):
        found = xz_size(page.parent.filehandle, offset, length)
        if found != full and (found != last or number % per_plane):
            raise FormatError(
                f"{name} must hold {full} bytes of samples in each strip or tile; one in XZ says that it holds {found}"
            )
