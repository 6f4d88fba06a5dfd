"""Single images (PNG, JPEG, BMP), and folders of slices, which may be TIFF files too.

Those with a palette hold its indices, which are labels or grey values: no colour is computed. So do TIFF files.
"""

from __future__ import annotations

import mmap
import re
import struct
import warnings
import zlib
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.checks import warn
from clvol.base.errors import DataError, FormatError
from clvol.formats import tiff
from clvol.formats._choice import Choice
from clvol.formats._files import sample_count
from clvol.formats.guarded.limits import announce
from clvol.formats.guarded.messages import empty
from clvol.formats.tiff.file import opened
from clvol.interop.kinds import Content
from clvol.volume.volumes import Leading

__all__ = ["SUFFIXES", "are_in", "read", "read_folder"]

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp")
"""Suffixes of the images that imageio reads."""

_KINDS = {suffix: {".jpeg": ".jpg", ".tiff": ".tif"}.get(suffix, suffix) for suffix in (*SUFFIXES, ".tif", ".tiff")}
_MODES = ("1", "L", "I", "F", "I;16", "I;16B", "I;16L", "LA", "RGB", "RGBA")  # Pillow's modes that need no conversion
_IHDR = struct.Struct(">IIBBBBB")  # width, height, bits, colours, compression, filter, whether it is interlaced
_PADDING = 4  # bytes that may follow the palette and the samples of a BMP image
_BMP = struct.Struct("<2s8xIIii2xHI12xI")  # start of the samples; length of the header, width, height, bits, packing, colours
_CHANNELS = {2: 3, 4: 2, 6: 4}  # channels of PNG's colour types; others have one
_ADAM7 = (
    (0, 0, 8, 8),
    (4, 0, 8, 8),
    (0, 4, 4, 8),
    (2, 0, 4, 4),
    (0, 2, 2, 4),
    (1, 0, 2, 2),
    (0, 1, 1, 2),
)  # first and step of x, y
_AT_ONCE = 1 << 20
_JPG = b"\xff\xd8"
_MARKER = re.compile(rb"\xff+[\x01\xc0-\xcf\xd9-\xfe]")  # of a segment, after fill bytes
_AFTER_SCAN = re.compile(rb"\xff+[^\x00\xff\xd0-\xd7]")  # a marker other than the zeros and restarts among samples
_END_OF_IMAGE, _SCAN, _NOTHING = 0xD9, 0xDA, 0x01
_PNG = b"\x89PNG\r\n\x1a\n"
_GREY = Leading(("channel",), (2,), {"channel": ("grey", "alpha")})


def read(path: Path, choose: Choice) -> Content:
    """One image, [y, x]: of a coloured one the luminance, or a channel."""
    samples, leading = _picture(path)
    pick = choose(path.name, leading)
    return pick.finish(samples[pick.index]), {"space": "image"} | pick.about


def are_in(path: Path) -> bool:
    """Whether a folder holds images."""
    return any(_is_slice(file) for file in path.iterdir())


def read_folder(path: Path, choose: Choice) -> Content:
    """The slices in a folder, in the natural order of their names: 9 before 10."""
    entries = list(path.iterdir())
    if gone := sorted(file.name for file in entries if _is_named_so(file) and not (file.is_file() or file.is_dir())):
        raise FormatError(f"{path} must hold files; {gone[0]} is a link that leads nowhere, or no file: a slice would be missing")
    files = sorted((file for file in entries if _is_slice(file)), key=_natural)
    kinds = Counter(_KINDS[file.suffix.lower()] for file in files)
    if len(kinds) > 1:
        found = ", ".join(f"{n} {kind}" for kind, n in kinds.most_common())
        raise FormatError(f"{path} must hold slices of one kind; found {found}: move one kind elsewhere")
    first, leading, geometry = _slice(files[0])
    between = f"{files[0].name} to {files[-1].name}" if len(files) > 1 else files[0].name
    guess = f"its {len(files)} images ({between}) were taken for slices in the order of their names, 1 apart: spacing= replaces it"
    pick = choose(path.name, leading, guess)
    taken = first[pick.index]
    announce(path.name, len(files) * taken.nbytes)
    data = empty((*taken.shape[:-2], len(files), *taken.shape[-2:]), first.dtype)
    palette = _palette(files[0])
    for i, file in enumerate(files):
        samples = _slice(file)[0] if i else first
        if samples.shape != first.shape or samples.dtype != first.dtype:
            got = [f"{f.name}: {s.shape} of {s.dtype}" for f, s in ((files[0], first), (file, samples))]
            raise DataError(f"{path} must hold slices of one shape and dtype; got {' and '.join(got)}")
        data[..., i, :, :] = samples[pick.index]
        used = 1 + int(min(first.max(), samples.max())) if len(palette) else 0
        if not np.array_equal(palette[:used], _palette(file)[:used] if used else palette[:0]):
            warn(f"{path} holds slices of several palettes, {files[0].name} and {file.name}: their indices may differ in meaning")
            palette = palette[:0]
    geometry["spacing"] = (*geometry.get("spacing", (1.0, 1.0)), 1.0)
    return pick.finish(data), geometry | pick.about


def _is_slice(file: Path) -> bool:
    return _is_named_so(file) and file.is_file()


def _is_named_so(file: Path) -> bool:
    # hidden files such as ._1.tif may lie beside images
    return file.suffix.lower() in _KINDS and not file.name.startswith(".")


def _natural(file: Path) -> tuple[list[Any], str]:
    return [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", file.name.lower())], file.name


def _slice(path: Path) -> tuple[NDArray[Any], Leading, dict[str, Any]]:
    """Samples [y, x] or [channel, y, x] of one image, their leading axes, and arguments of `Volume`."""
    if _KINDS[path.suffix.lower()] != ".tif":
        return *_picture(path), {"space": "image"}
    samples, geometry = tiff.read(path, Choice(whole=True))
    leading = geometry.pop("leading", Leading())
    if leading.axes not in ((), ("channel",)) or samples.ndim - len(leading.axes) != 2:
        raise DataError(
            f"{path.parent} must hold one slice a file; {path.name} holds {leading} of shape {samples.shape}: read it by itself"
        )
    return samples, leading, {key: geometry[key] for key in ("spacing", "units", "space", "unplaced")}


def _picture(path: Path) -> tuple[NDArray[Any], Leading]:
    """Samples [y, x] or [channel, y, x], read by imageio: indices of a palette as they are, other colour models as RGB."""
    import imageio.v3 as iio

    if path.suffix.lower() == ".png":
        _check_png(path)
    elif path.suffix.lower() == ".bmp":
        _check_bmp(path)
    else:
        _check_jpg(path)
    try:
        # Pillow warns that images of 90 megapixels are large
        with warnings.catch_warnings(action="ignore"), iio.imopen(path, "r", plugin="pillow") as file:
            about = file.properties(index=0)
            announce(path.name, sample_count(about.shape) * about.dtype.itemsize)
            mode = file.metadata(index=0)["mode"]
            samples = np.asarray(file.read(index=0, **({} if mode in _MODES else {"mode": "P" if mode == "P" else "RGB"})))
    except (OSError, SyntaxError, ValueError) as error:  # imageio's message is about plug-ins
        raise FormatError(f"cannot read {path}: it is damaged, or no image that imageio reads") from error
    if samples.ndim == 2:
        return samples, Leading()
    channels = samples.shape[-1]
    return np.moveaxis(samples, -1, 0), _GREY if channels == 2 else Leading.of_rgb(channels)


def _palette(path: Path) -> NDArray[Any]:
    """Red, green and blue of each index of an image with a palette, shape (indices, 3); else of none."""
    from PIL import Image

    kind, colours = _KINDS[path.suffix.lower()], None
    if kind == ".tif":
        with opened(path) as file:
            colours = file.pages[0].colormap
            return np.zeros((0, 3)) if colours is None else np.asarray(colours).T
    if kind in (".png", ".bmp"):
        with Image.open(path) as image:
            colours = image.getpalette()
    return np.reshape(colours or [], (-1, 3))


def _check_png(path: Path) -> None:
    """Raise if a chunk is missing or has a wrong checksum, or rows are missing, which Pillow would fill with 0."""
    end, found, needed, packed = path.stat().st_size, 0, 0, zlib.decompressobj()
    with path.open("rb") as stream:
        if stream.read(len(_PNG)) != _PNG:  # Pillow goes by content, not by name
            return
        name = b""
        while name != b"IEND":
            length, name = struct.unpack(">I4s", stream.read(8).rjust(8, b"\xff"))
            if not name.isalpha():  # of ASCII
                raise FormatError(f"cannot read {path}: it is damaged, a part of it is called {name!r}")
            if stream.tell() + length + 4 > end:
                raise FormatError(f"cannot read {path}: it is damaged, or no image that imageio reads; it ends too early")
            checksum = zlib.crc32(name)
            while length:
                part = stream.read(min(length, _AT_ONCE))
                checksum, length = zlib.crc32(part, checksum), length - len(part)
                if name == b"IHDR" and len(part) == _IHDR.size:
                    header = _IHDR.unpack(part)
                    if needed or header[4:6] != (0, 0) or header[6] > 1:  # Pillow does not check
                        raise FormatError(f"cannot read {path}: it is damaged, it has two headers, or one that no PNG image has")
                    needed = _unpacked(*header)
                while name == b"IDAT" and part and found <= needed:
                    found += len(packed.decompress(part, _AT_ONCE))
                    part = packed.unconsumed_tail
            if stream.read(4) != checksum.to_bytes(4, "big"):
                raise FormatError(f"cannot read {path}: it is damaged, its part {name!r} has another checksum")
    if found < needed or not needed or not packed.eof:
        raise FormatError(f"cannot read {path}: it must hold {needed} bytes of unpacked rows; found {found}")


def _check_bmp(path: Path) -> None:
    """Raise if the samples do not follow the palette, or do not end with the file: Pillow would allocate memory for them first."""
    with path.open("rb") as stream:
        head = stream.read(_BMP.size)
    if len(head) < _BMP.size or not head.startswith(b"BM"):
        return
    _, start, size, width, height, bits, packing, colours = _BMP.unpack(head)
    if size != 40:  # other versions have other fields, or profiles after the samples
        return
    palette = 4 * (colours or 1 << bits) if bits <= 8 else 0
    head_end = 14 + size + palette + (12 if packing == 3 else 0)  # with masks of the colours
    if not 0 <= start - head_end <= _PADDING:
        raise FormatError(
            f"cannot read {path}: it is damaged: its header and palette end at byte {head_end}, its samples begin at {start}"
        )
    end, stored = start + (width * bits + 31) // 32 * 4 * abs(height), path.stat().st_size
    if packing == 0 and not end <= stored <= end + _PADDING:
        raise FormatError(f"cannot read {path}: it is damaged: its samples end at byte {end} of {stored}")


def _check_jpg(path: Path) -> None:
    """Raise unless segments follow each other up to the end of the image: Pillow skips gaps, and with them tables."""
    with path.open("rb") as stream:
        if stream.read(2) != _JPG or path.stat().st_size < 4:  # Pillow goes by content, not by name
            return
        with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as content:
            at, kind = len(_JPG), 0
            while kind != _END_OF_IMAGE:
                match = _MARKER.match(content, at)
                if match is None:
                    raise FormatError(f"cannot read {path}: it is damaged or cut short: no segment of it begins at byte {at}")
                at, kind = match.end(), content[match.end() - 1]
                if kind in (_END_OF_IMAGE, _NOTHING):
                    continue
                at += int.from_bytes(content[at : at + 2].rjust(2, b"\0"), "big")
                if kind == _SCAN:
                    after = _AFTER_SCAN.search(content, at)
                    at = after.start() if after else len(content)


def _unpacked(width: int, height: int, depth: int, color: int, _: int, __: int, interlaced: int) -> int:
    """Bytes of the rows of a PNG image, each with a byte for its filter; in seven passes if it is interlaced."""
    bits = depth * _CHANNELS.get(color, 1)
    sizes = [(-(-(width - x) // dx), -(-(height - y) // dy)) for x, y, dx, dy in _ADAM7] if interlaced else [(width, height)]
    return sum(h * (1 + -(-w * bits // 8)) for w, h in sizes if w > 0 and h > 0)
