"""TIFF files of microscopes: OME, ImageJ and plain stacks are read, OME is written; by way of tifffile."""

from __future__ import annotations

import html
import io
import itertools
import logging
import math
import operator
import re
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import DataError, FormatError, MissingDependencyError
from clvol.base.units import METRES, scale, unit_name
from clvol.bricks.sliced import FlatFile, Index, Watched, Window
from clvol.formats._choice import Choice, Series, chosen_level, chosen_series
from clvol.formats._directories import Directory, directories, segments
from clvol.formats._files import damaged_chunk, inflated_size, require_default, sample_count, scaled, storable, xz_size
from clvol.formats._layout import Layout, lay_out
from clvol.formats.guarded.limits import announce
from clvol.formats.guarded.messages import as_stored, empty
from clvol.interop.kinds import Content
from clvol.volume.volume import Volume
from clvol.volume.volumes import Leading, Volumes

__all__ = ["lazily", "read", "series", "write", "write_several"]

_DTYPES = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "float32", "float64")  # those of OME
_OME_DTYPES = {name: name for name in _DTYPES if not name.startswith("float")} | {"float": "float32", "double": "float64"}
_OME_NAMES = {"": "pixel", "um": "µm", "inch": "in"}
_MEANINGS = {"T": "time", "C": "channel", "S": "channel", "Z": "z", "Y": "y", "X": "x", "R": "position"}  # of tifffile's letters
_OTHERS = {"A": "angle", "P": "phase", "H": "lifetime", "E": "wavelength", "L": "exposure", "V": "event"}  # Q, I: nothing is known
_IN_COLOUR = (2, 6)  # photometric interpretations: RGB, YCbCr
_PLACE = re.compile(r"^\s*((?:[czt]:\d+/\d+\s*)+)(?:-\s*)?")  # with which ImageJ's labels of slices begin
_WHITE = (1.0, 1.0, 1.0)
_DECLARED = re.compile(r"<!(DOCTYPE|ENTITY)")
_NAMED = re.compile(r"""FileName\s*=\s*(?:"([^"]*)"|'([^']*)')""")
_DEFLATED = (8, 32946)
_LZMA = (34925, 34926)
_LOSSLESS = (*_DEFLATED, 5, 32773, 50000)  # and LZW, PackBits, Zstandard
_NATIVE = "<" if sys.byteorder == "little" else ">"
_MOST_STORED, _HEAD = 2, 4096  # bytes that a codec may need at most for one of samples, and for itself
_HEADER = 8  # bytes before anything else in a file; tifffile takes a place of 0 for one that is not stored

Colors = tuple[tuple[float, float, float] | None, ...]


@dataclass(frozen=True)
class _About:
    """What metadata say of one image: spacing by axis, NaN where it is unknown; channels; what samples stand for."""

    spacing: dict[str, float] = field(default_factory=dict)
    units: str = ""
    deep: bool = False  # one slice has a thickness
    names: tuple[str, ...] = ()
    colors: Colors = ()
    windows: tuple[tuple[float, float], ...] = ()
    slope: float = 1.0
    offset: float = 0.0


def read(path: Path, choose: Choice, series: int | str | None = None, level: int = 0) -> Content:
    """Samples of one image, and what OME or ImageJ say of them; only pages that hold what is chosen are decoded.

    A plain TIFF file has spacing 1: its resolution is meant for printing, and there is none along z.
    """
    with _opened(path) as file:
        number = chosen_series(path.name, _images(path.name, file), series)
        chosen_level(path.name, [one.shape for one in file.series[number].levels], level)
        return _content(path, file, number, level, choose, _load)


def lazily(path: Path, choose: Choice, series: int | str | None = None, level: int = 0) -> list[Content]:
    """One image in all its sizes from `level` on, of which no samples are read yet; its pages are looked through.

    Samples that follow each other are read from where they lie, others by strips and tiles, by way of zarr.
    """
    library = _tifffile()
    _directories_of(path)
    with _strict():
        file = library.TiffFile(path)  # open for as long as it is read from
        _require_own_files(path, file)
        number = chosen_series(path.name, _images(path.name, file), series)
        sizes = [one.shape for one in file.series[number].levels]
        first = chosen_level(path.name, sizes, level)
        return [_content(path, file, number, k, choose, _window) for k in range(first, len(sizes))]


def _window(name: str, file: Any, image: Any, index: Index) -> Window:
    """The samples of an image at an index of its axes, once its pages have been looked through."""
    path = Path(file.filehandle.path)
    _check_order(name, image)
    shape = tuple(n for _, n in _axes(image))
    _check_samples(name, list(image), image.keyframe, sample_count(shape), sample_count(image.keyframe.chunks))
    own = image.keyframe.parent.filehandle.path
    if (places := _places(image)) is not None:
        dtype = np.dtype(file.byteorder + image.dtype.char)
        return Window(FlatFile(Path(own), shape, dtype, places), shape, dtype, None, index)
    try:
        import zarr
    except ImportError as error:
        raise MissingDependencyError(
            "TIFF files of strips and tiles are read part by part by way of zarr: pip install clvol[microscopy]"
        ) from error
    array: Any = zarr.open(image.aszarr(level=0, squeeze=False), mode="r")
    if tuple(array.shape) != shape:
        raise FormatError(f"{name} must be read part by part as an array of shape {shape}; tifffile makes it {array.shape}")
    lock = threading.Lock()

    def read(index: Index) -> NDArray[Any]:
        assert not file.filehandle.closed  # it is held as long as this is
        with lock:
            try:
                with _strict():
                    return as_stored(np.asarray(array[index]))
            except MemoryError:
                raise
            except Exception as error:
                raise FormatError(
                    f"cannot read {_damaged(name, array, image, index)}: {str(error) or type(error).__name__}"
                ) from error

    return Window(Watched(path, name, read), shape, array.dtype, array.chunks, index)


def _places(image: Any) -> int | list[int] | None:
    """Where in a file the samples of an image lie as they are: all of them, or those of each page; None if they do not."""
    first, pages = image.keyframe, list(image)
    if image.transform is not None or not first.is_memmappable:
        return None
    if image.dataoffset is not None:
        return int(image.dataoffset)
    size = first.size * first.dtype.itemsize
    in_one = first.is_contiguous and len(pages) * first.size == sample_count(tuple(n for _, n in _axes(image)))
    if not in_one or any(page.parent is not first.parent or not _is_whole(page, size) for page in pages):
        return None
    return [int(page.dataoffsets[0]) for page in pages]


def _is_whole(page: Any, size: int) -> bool:
    """Whether the strips of a page follow each other, and are no longer than its samples."""
    ends = itertools.accumulate(page.databytecounts, initial=page.dataoffsets[0])
    return sum(page.databytecounts) == size and all(map(operator.eq, page.dataoffsets, ends))


def _damaged(name: str, array: Any, image: Any, index: Index) -> str:
    """The first strip or tile at an index that cannot be read by itself, its page and its file."""
    with _strict():
        at = damaged_chunk(array, index)
    if at is None:
        return f"strips or tiles of {name}"
    counts = [-(-n // edge) for n, edge in zip(array.shape, array.chunks, strict=True)]
    number, segment = divmod(int(np.ravel_multi_index(at, counts)), math.prod(counts) // len(image))
    page, kind = image[number], "tile" if image.keyframe.is_tiled else "strip"
    return f"{kind} {segment} of page {page.index} of {page.parent.filehandle.name}"


def _content(path: Path, file: Any, number: int, level: int, choose: Choice, load: Callable[..., Any]) -> Content:
    """One size of an image, whose samples `load` gives at an index."""
    levels = _whole(file)[number].levels
    image = levels[level]
    kind = file.series[number].kind.lower()  # not what the file says it is: that may not fit its pages
    about = (
        _ome(file.ome_metadata, number, len(file.series), image.dtype)
        if kind == "ome"
        else _imagej(file)
        if kind == "imagej"
        else _About()
    )
    layout, leading = _laid_out(path.name, image, about, choose)
    if image.dtype is None or image.dtype.kind not in "biuf":
        raise DataError(f"{path.name} must hold real numbers; got dtype {image.dtype}")
    data: Any
    data, known = layout.chosen(path.name, choose, lambda index: load(path.name, file, image, index), leading)
    shrunk = {axis: n / m for (axis, m), (_, n) in zip(_axes(image), _axes(levels[0]), strict=True)}
    name = file.series[number].name if len(file.series) > 1 else ""
    shrunk = {axis: shrunk.get(axis.upper(), 1.0) for axis in "xyz"}
    spacing = {axis: about.spacing.get(axis, 1.0) for axis in "xyz"}
    geometry: dict[str, Any] = {
        "spacing": layout.of({axis: spacing[axis] * shrunk[axis] for axis in "xyz"}),
        "units": about.units,
        "space": "image",
        "name": name,
    }
    if "channel" not in layout.axes and len(about.windows) == 1:
        geometry["window"] = about.windows[0]
    if level:  # the first sample of a level lies amid those that it stands for
        geometry["origin"] = layout.of({axis: (shrunk[axis] - 1) / 2 * spacing[axis] for axis in "xyz"})
    if isinstance(data, Window) and (about.slope, about.offset) != (1, 0):
        data = data.mapped(lambda part: scaled(part, about.slope, about.offset))
    if isinstance(data, Window):
        lazy: Any = data
        return lazy, geometry | known
    return scaled(data, about.slope, about.offset), geometry | known


def series(path: Path) -> tuple[Series, ...]:
    """The images of a file."""
    with _opened(path) as file:
        return _images(path.name, file)


def write(volume: Volume, path: Path) -> None:
    """Write samples, spacing, units, name and colour, as OME-TIFF; it has no place for origin and direction."""
    leading = Leading(("channel",), (1,), {"channel": (volume.name,)} if volume.name else {}, (volume.color,))
    _write(path, volume, volume.data, "ZYX"[3 - volume.ndim :], leading)


def write_several(volumes: Volumes, path: Path) -> None:
    """Write several as one OME-TIFF image: times, and channels with names and colours; volumes of a series count as times."""
    grid, leading, data = volumes.grid, volumes.leading, np.asarray(volumes)
    letters = {"time": "T", "channel": "C", "volume": "C" if "volume" in leading.names else "T"}
    axes = "".join(letters.get(axis, "?") for axis in leading.axes)
    if "?" in axes or len(set(axes)) < len(axes):
        raise FormatError(f"OME-TIFF holds times and channels; got {leading}: write one file for each")
    if "volume" in leading.names:
        leading = Leading(leading.axes, leading.counts, {"channel" if k == "volume" else k: v for k, v in leading.names.items()})
    order = sorted(range(len(axes)), key=lambda i: "TC".index(axes[i]))
    data = data.transpose([*order, *range(len(axes), data.ndim)])
    axes = "".join(axes[i] for i in order)
    spatial = "ZYX"[3 - grid.ndim :]
    if leading.rgb:
        data, axes = np.moveaxis(data, len(axes) - 1, -1), axes[:-1] + spatial + "S"
    else:
        axes += spatial
    _write(path, grid, data, axes, leading)


def _write(path: Path, grid: Volume, data: NDArray[Any], axes: str, leading: Leading) -> None:
    require_default(grid, ("origin", "direction"), ".nrrd, .mha, .nii and .npz")
    name = unit_name(grid.units)
    if name and name not in METRES:
        raise FormatError(f"OME-TIFF must have a unit of {', '.join(METRES)}; got {grid.units!r}: .npz holds any")
    unit = _OME_NAMES.get(name, name)
    metadata: dict[str, Any] = {"axes": axes}
    for axis, spacing in zip("XYZ", grid.spacing, strict=False):  # Z only for volumes: thus an image stays an image
        metadata |= {f"PhysicalSize{axis}": spacing, f"PhysicalSize{axis}Unit": unit}
    if not leading.rgb:
        names = {"Name": list(names)} if (names := leading.names.get("channel")) else {}
        colors = {"Color": [_signed(color or _WHITE) for color in leading.colors]} if any(leading.colors) else {}
        metadata["Channel"] = names | colors
    # Without the photometric a stack of three or four slices would be taken for colours.
    photometric = "rgb" if leading.rgb else "minisblack"
    _tifffile().imwrite(path, storable(data, _DTYPES), ome=True, photometric=photometric, metadata=metadata)


def _signed(color: tuple[float, float, float]) -> int:
    """A colour as OME has it: red, green, blue and alpha, of 8 bits each, in one signed number."""
    r, g, b = (round(255 * part) for part in color)
    return int(np.array((r << 24) | (g << 16) | (b << 8) | 255, np.uint32).view(np.int32))


def _tifffile() -> Any:
    try:
        import tifffile
    except ImportError as error:
        raise MissingDependencyError("TIFF files need tifffile: pip install clvol[microscopy]") from error
    return tifffile


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """The file as tifffile has it, whose directories were found sound. What tifffile only logs is raised."""
    library = _tifffile()
    _directories_of(path)
    with _strict(), library.TiffFile(path) as file:
        _require_own_files(path, file)
        yield file


def _directories_of(path: Path) -> dict[int, Directory]:
    with path.open("rb") as stream:
        return directories(stream, path.stat().st_size, path.name)


def _require_own_files(path: Path, file: Any) -> None:
    """Raise before tifffile follows what an OME-XML names: it would wait for a pipe, and read a file from anywhere."""
    text = file.ome_metadata or ""
    if _DECLARED.search(text):
        raise FormatError(f"{path.name} must have OME-XML without declarations of a document type or of entities")
    for name in (html.unescape(a or b) for a, b in _NAMED.findall(text)):  # "&#47;" too
        if re.search(r"[/\\]", name) or name in ("", ".."):
            raise FormatError(f"{path.name} must name the other files of its set, beside it; got {name[:80]!r}")
        other = path.with_name(name)
        if other.exists() and (not other.is_file() or other.resolve().parent != path.resolve().parent):
            raise FormatError(f"{path.name} must name files that lie beside it; {name[:80]!r} is elsewhere, or no file")


_listening = threading.local()


class _Overheard:
    """Of a `logging.Logger`: what one thread wants to hear is raised there, whatever the program has set or switched off."""

    def isEnabledFor(self, level: int) -> bool:  # logging's name
        heard = getattr(_listening, "heard", None) is not None and level >= logging.WARNING
        return heard or super().isEnabledFor(level)  # type: ignore[misc]  # of the class that it is mixed into

    def handle(self, record: logging.LogRecord) -> None:
        heard: list[FormatError] | None = getattr(_listening, "heard", None)
        if heard is None:
            super().handle(record)  # type: ignore[misc]
        elif record.levelno >= logging.WARNING:
            error = FormatError(
                f"the file is damaged or unusual: {record.getMessage()}; "
                "if you trust what tifffile makes of it, give its array to clvol.Volume"
            )
            heard.append(error)
            raise error


@contextmanager
def _strict() -> Iterator[None]:
    """Raise what tifffile only logs: it reads on past damage, and leaves out slices or zeroes them."""
    logger = logging.getLogger("tifffile")
    if not isinstance(logger, _Overheard):  # for good: to change it back would deafen other threads
        logger.__class__ = type("Overheard", (_Overheard, type(logger)), {})
    before = getattr(_listening, "heard", None)
    heard: list[FormatError] = []
    _listening.heard = heard
    try:
        yield
    finally:
        _listening.heard = before
    if heard:  # and tifffile caught it
        raise heard[0]


def _images(name: str, file: Any) -> tuple[Series, ...]:
    """The images that tifffile finds, by their names where these tell them apart."""
    if not file.series:
        raise FormatError(f"{name} must hold an image; it holds none")
    names = [str(one.name or "") for one in file.series]
    apart = all(names) and len(set(names)) == len(names) and not any(n.isdecimal() for n in names)
    return tuple(
        Series(
            names[i] if apart else str(i), one.axes if apart else ", ".join(filter(None, (names[i], one.axes))), tuple(one.shape)
        )
        for i, one in enumerate(file.series)
    )


def _whole(file: Any) -> Sequence[Any]:
    """The images of a file, with all of their axes."""
    images = file.series
    found: Sequence[Any] = images(squeeze=False) if callable(images) else images
    return found


def _axes(image: Any) -> list[tuple[str, int]]:
    """Letters and lengths of all axes, those of one sample too; until 2026.5 tifffile's images had them beside the others."""
    both = hasattr(image, "get_axes")
    letters, shape = (image.get_axes(squeeze=False), image.get_shape(squeeze=False)) if both else (image.axes, image.shape)
    return list(zip(letters, shape, strict=True))


def _laid_out(name: str, image: Any, about: _About, choose: Choice) -> tuple[Layout, Leading]:
    """What the axes of an image count; pages that are not named (I, Q) are slices."""
    pairs = _axes(image)
    words = [_MEANINGS.get(axis, _OTHERS.get(axis, "")) if axis != "S" or n > 1 else "" for axis, n in pairs]
    keep = [*("z",) * about.deep, *("channel",) * bool(about.names or any(about.colors))]
    layout = lay_out(name, words, [n for _, n in pairs], keep, choose.given)
    unnamed = [(n, meaning) for (_, n), word, meaning in zip(pairs, words, layout.axes, strict=True) if n > 1 and word != meaning]
    if [meaning for _, meaning in unnamed] == ["z"]:
        far = "" if "z" in about.spacing else ", 1 apart: spacing= replaces it"
        text = f"it does not say what its {unnamed[0][0]} pages are; they were taken for slices{far}"
        layout = Layout(layout.axes, layout.shape, text)
    if "channel" not in layout.axes:
        return layout, Leading(layout.leading, layout.counts)
    at = layout.axes.index("channel")
    count = layout.shape[at]
    if pairs[at][0] == "S" and image.keyframe.photometric in _IN_COLOUR and count in (3, 4):
        return layout, layout.in_colour
    names = about.names if len(about.names) == count else ()
    colors = about.colors if len(about.colors) == count else ()
    windows = about.windows if len(about.windows) == count else ()
    return layout, Leading(layout.leading, layout.counts, {"channel": names} if names else {}, colors, windows)


def _load(name: str, file: Any, image: Any, index: tuple[int | slice, ...]) -> NDArray[Any]:
    """The samples of an image at an index of its axes; pages without any of them are not touched."""
    _check_order(name, image)
    shape = tuple(n for _, n in _axes(image))
    split = next((k for k in range(len(shape)) if sample_count(shape[k:]) == image.keyframe.size), None)
    if image.transform is None and split is not None and sample_count(shape[:split]) == len(image):
        numbers = np.arange(len(image)).reshape(shape[:split])[index[:split]]
        keys = [int(n) for n in np.ravel(numbers)]
        _check_samples(name, [image[key] for key in keys], image.keyframe, len(keys) * image.keyframe.size)
        if file.byteorder == _NATIVE and (mapped := _mapped(file, image, shape)) is not None:
            return as_stored(mapped[index])
        into = empty((len(keys), image.keyframe.size), image.dtype)
        samples = file.asarray(key=keys, series=image, out=into).reshape(np.shape(numbers) + tuple(shape[split:]))
        return np.asarray(samples[(slice(None),) * np.ndim(numbers) + index[split:]])
    _check_samples(name, list(image), image.keyframe, sample_count(shape))
    if (mapped := _mapped(file, image, shape)) is not None:
        return as_stored(mapped[index])
    return np.asarray(image.asarray(out=empty(shape, image.dtype)).reshape(shape)[index])


def _mapped(file: Any, image: Any, shape: tuple[int, ...]) -> NDArray[Any] | None:
    """All samples of an image, where they follow each other in the file, as they are."""
    if image.dataoffset is None or image.transform is not None or not image.keyframe.is_memmappable:
        return None
    found: NDArray[Any] = file.filehandle.memmap_array(file.byteorder + image.dtype.char, shape, image.dataoffset)
    return found


def _check_samples(name: str, pages: Sequence[Any], keyframe: Any, count: int, read: int | None = None) -> None:
    """Raise if samples lie past the end of the file, a slice is missing or stored otherwise than tifffile takes it: it would give
    zeros, or other numbers. Nothing is allocated before that. Of `count` samples only some may be `read` at a time.
    """
    files = {page.parent.filehandle.path: page.parent.filehandle.size for page in pages if page is not None}
    walked = {file: _directories_of(Path(file)) for file in files}
    first = walked.get(keyframe.parent.filehandle.path, {}).get(keyframe.offset)
    sizes = segments(first) if first is not None and not keyframe.parent.is_stk else None  # whose pages hold several slices
    for page in pages:
        if page is None:
            raise FormatError(f"{name} must hold all of its slices; some are missing")
        handle = page.parent.filehandle
        if len(page.dataoffsets) != len(page.databytecounts):
            told = f"{len(page.dataoffsets)} places and {len(page.databytecounts)} lengths"
            raise FormatError(f"{name} must have a place and a length for each strip or tile; one page has {told}")
        ends = map(operator.add, page.dataoffsets, page.databytecounts)
        if max(ends, default=sys.maxsize) > handle.size or min(page.databytecounts) < 1 or min(page.dataoffsets) < _HEADER:
            raise FormatError(f"{name} must hold the samples of every slice; some lie before or past the samples of the file")
        own = walked[handle.path].get(page.offset, first)  # pages of ImageJ and others may have no directory
        if own is not first and first is not None and own is not None and own != first:
            told = ", ".join(f"tag {tag}: {first[tag]} and {own[tag]}" for tag in own if own[tag] != first[tag])
            raise FormatError(f"{name} must have pages of one shape and type; it has {told}")
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


def _check_order(name: str, image: Any) -> None:
    """Raise if an image is read from one place on, as ImageJ's are, and the directories of its pages name others."""
    if image.dataoffset is None:
        return
    for number, page in enumerate(image):
        expected = image.dataoffset + number * image.keyframe.nbytes
        if page is not None and page.dataoffsets and page.dataoffsets[0] != expected:
            raise FormatError(
                f"{name} must have slices that follow each other; slice {number} is at {page.dataoffsets[0]}, not at {expected}"
            )


def _check_lengths(name: str, lengths: Sequence[int], sizes: tuple[int, int, int, int], packed: bool) -> None:
    """Raise if the strips or tiles of a page have other bytes than the fields of its directory say."""
    per_plane, planes, full, last = sizes
    if len(lengths) != per_plane * planes:
        raise FormatError(f"{name} must have {per_plane * planes} strips or tiles in each page; one has {len(lengths)}")
    if packed:
        wrong = [found for found in lengths if found > _MOST_STORED * full + _HEAD]
    else:  # a last strip may be filled up
        wrong = [found for i, found in enumerate(lengths) if found != full and (found != last or (i + 1) % per_plane)]
    if wrong:
        raise FormatError(f"{name} must hold {full} bytes of samples in each strip or tile; one has {wrong[0]}")


def _check_unpacked(name: str, keyframe: Any, sizes: tuple[int, int, int, int]) -> None:
    """Raise if a segment holds other bytes than its fields say: those that are too many are left out by tifffile."""
    per_plane, _, full, last = sizes
    handle = keyframe.parent.filehandle
    handle.seek(keyframe.dataoffsets[0])
    content = handle.read(keyframe.databytecounts[0])
    if keyframe.compression in _DEFLATED:
        found = inflated_size(io.BytesIO(content), len(content), full)
    else:
        found = len(_tifffile().TIFF.DECOMPRESSORS[keyframe.compression](content))
    if found not in ((full, last) if per_plane == 1 else (full,)):
        raise FormatError(f"{name} must hold {full} bytes of samples in each strip or tile; found {found}")


def _check_ends(name: str, page: Any, sizes: tuple[int, int, int, int]) -> None:
    """Raise if a segment in XZ is cut short, or says that it holds other bytes: where all samples are there, its checksum is not
    looked at.
    """
    per_plane, _, full, last = sizes
    for number, (offset, length) in enumerate(zip(page.dataoffsets, page.databytecounts, strict=True), 1):
        found = xz_size(page.parent.filehandle, offset, length)
        if found != full and (found != last or number % per_plane):
            raise FormatError(
                f"{name} must hold {full} bytes of samples in each strip or tile; one in XZ says that it holds {found}"
            )


def _ome(description: str, number: int, count: int, dtype: np.dtype[Any] | None) -> _About:
    """What OME-XML says of one image of those that have samples, which are of `dtype`."""

    def below(element: ET.Element, tag: str) -> list[ET.Element]:
        return [child for child in element if child.tag.rpartition("}")[2] == tag]

    images = [pixels for image in below(ET.fromstring(description), "Image") for pixels in below(image, "Pixels")]
    with_samples = [pixels for pixels in images if below(pixels, "TiffData")]
    images = images if len(images) == count else with_samples
    if len(images) != count:
        raise FormatError(f"OME-XML must have an element Pixels for each of {count} images; it has {len(images)}")
    pixels = images[number]
    said = pixels.get("Type", "")
    if dtype is not None and said in _OME_DTYPES and dtype.name != _OME_DTYPES[said]:
        raise FormatError(f"OME-XML must have samples of the type that its TIFF file has, {dtype.name}; it says {said}")
    channels = below(pixels, "Channel")
    names = tuple(channel.get("Name", "") for channel in channels)
    colors = tuple(_color(channel.get("Color")) for channel in channels)
    about = _About(names=names if any(names) else (), colors=_telling(colors))
    sizes = {axis: pixels.get(f"PhysicalSize{axis.upper()}") for axis in "xyz"}
    if not any(sizes.values()):
        return about
    units = {axis: unit_name(pixels.get(f"PhysicalSize{axis.upper()}Unit", "µm")) for axis in "xyz"}
    spacing = {axis: float(size) * scale(units[axis], units["x"]) if size else math.nan for axis, size in sizes.items()}
    return replace(about, spacing=spacing, units=units["x"], deep=bool(sizes["z"]))


def _telling(colors: Colors) -> Colors:
    """None at all where all are white, the default of programs, which says nothing."""
    return colors if any(color not in (None, _WHITE) for color in colors) else ()


def _color(text: str | None) -> tuple[float, float, float] | None:
    if text is None:
        return None
    number = int(text)
    r, g, b = ((number >> shift & 255) / 255 for shift in (24, 16, 8))
    return r, g, b


def _imagej(file: Any) -> _About:
    """What ImageJ says: samples a unit in the tags of TIFF, slices in its own text, with the channels' tables and labels."""
    metadata, tags = file.imagej_metadata or {}, file.pages.first.tags
    spacing = {}
    for axis in "xy":
        samples, unit = tags[tag].value if (tag := f"{axis.upper()}Resolution") in tags else (1, 1)
        spacing[axis] = unit / samples if samples else math.nan
    if "spacing" in metadata:
        spacing["z"] = abs(float(metadata["spacing"]))
    channels = int(metadata.get("channels", 1))
    counts = {what: int(metadata[what]) for what in ("channels", "slices", "frames") if what in metadata}
    if counts and math.prod(counts.values()) < int(metadata.get("images", 1)):
        told = " × ".join(f"{n} {what}" for what, n in counts.items())
        raise FormatError(f"{file.filename} must say of each of its {metadata['images']} images where it belongs; it has {told}")
    slope, offset = 1.0, 0.0
    if metadata.get("cf") == 0:  # a straight line; signed samples are stored with c0 = -32768
        slope, offset = float(metadata.get("c1", 1)), float(metadata.get("c0", 0))
    ranges = [float(v) for v in metadata.get("Ranges", (metadata.get("min", 0), metadata.get("max", 0)))]
    windows = tuple((slope * a + offset, slope * b + offset) for a, b in zip(ranges[::2], ranges[1::2], strict=False))
    colors = tuple(_top_of(table) for table in metadata.get("LUTs", ()))
    return _About(
        spacing,
        unit_name(str(metadata.get("unit", ""))),
        names=_names(metadata.get("Labels", ()), channels),
        colors=_telling(colors),
        windows=windows if all(-math.inf < a < b < math.inf for a, b in windows) else (),
        slope=slope,
        offset=offset,
    )


def _top_of(table: NDArray[Any]) -> tuple[float, float, float] | None:
    """The colour of a table that leads to it from black in a straight line, as those of channels do."""
    table = np.asarray(table, np.float64)
    if table.shape != (3, 256):
        return None
    top = table[:, -1]
    straight = np.abs(table - top[:, None] * np.linspace(0, 1, 256)).max() <= 2
    r, g, b = top / 255
    return (r, g, b) if straight and top.any() else None


def _names(labels: Sequence[str], channels: int) -> tuple[str, ...]:
    """Names of channels, where the labels of slices, whose channels vary fastest, are the same for all slices of a channel."""
    if channels < 2 or not labels or len(labels) % channels:
        return ()
    cut = [_PLACE.sub("", str(label or "")).strip() for label in labels]
    names = tuple(cut[:channels])
    same = all(cut[i] == names[i % channels] for i in range(len(cut)))
    return names if same and len(set(names)) == channels else ()
