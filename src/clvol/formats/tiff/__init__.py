"""TIFF files of microscopes: OME, ImageJ and plain stacks are read, OME is written; by way of tifffile."""

from __future__ import annotations

import itertools
import math
import operator
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import ChunkError, DataError, FormatError, MissingDependencyError
from clvol.base.units import METRES, in_one_unit, unit_name
from clvol.bricks.sliced import FlatFile, Index, Watched, Window
from clvol.formats._choice import Choice, Series, chosen_level, chosen_series
from clvol.formats._files import damaged_chunk, require_default, sample_count, scaled, storable
from clvol.formats._layout import Layout, lay_out, scaled_part
from clvol.formats.guarded.messages import as_stored, empty
from clvol.formats.tiff.about import DTYPES, WHITE, About, imagej, ome, ome_color
from clvol.formats.tiff.file import check_order, check_samples, decoding, opened, strict, tifffile
from clvol.interop.kinds import Content
from clvol.volume.volume import Volume
from clvol.volume.volumes import Leading, Volumes

__all__ = ["lazily", "read", "series", "write"]

_OME_NAMES = {"": "pixel", "angstrom": "Å", "um": "µm", "inch": "in"}
_MEANINGS = {"T": "time", "C": "channel", "S": "channel", "Z": "z", "Y": "y", "X": "x", "R": "position"}  # of tifffile's letters
_OTHERS = {"A": "angle", "P": "phase", "H": "lifetime", "E": "wavelength", "L": "exposure", "V": "event"}  # Q, I: unknown
_IN_COLOUR = (2, 6)  # photometric interpretations: RGB, YCbCr
_NATIVE = "<" if sys.byteorder == "little" else ">"


def read(path: Path, choose: Choice, series: int | str | None = None, level: int = 0) -> Content:
    """Samples of one image, with metadata of OME or ImageJ; only pages with chosen samples are decoded.

    A plain TIFF file has spacing 1: its resolution is meant for printing, and has no z.
    """
    with opened(path) as file:
        number = chosen_series(path.name, _images(path.name, file), series)
        chosen_level(path.name, [one.shape for one in file.series[number].levels], level)
        return _content(path, file, number, level, choose, _load)


def lazily(path: Path, choose: Choice, series: int | str | None = None, level: int = 0) -> list[Content]:
    """Windows of one image in all its sizes from `level` on; its pages are checked, no samples are read yet.

    Contiguous samples are read from the file, others by strips and tiles, by way of zarr.
    """
    with opened(path, stay=True) as file:  # as long as it is read from
        number = chosen_series(path.name, _images(path.name, file), series)
        sizes = [one.shape for one in file.series[number].levels]
        first = chosen_level(path.name, sizes, level)
        return [_content(path, file, number, k, choose, _part_of) for k in range(first, len(sizes))]


def series(path: Path) -> tuple[Series, ...]:
    """The images of a file."""
    with opened(path) as file:
        return _images(path.name, file)


def write(what: Volume | Volumes, path: Path) -> None:
    """Write OME-TIFF: times (also volumes of a series), and channels with names and colours; neither origin nor direction."""
    if isinstance(what, Volumes):
        grid, leading, before = what.grid, what.leading, what.leading.axes
    else:
        grid, before = what, ()
        leading = Leading(("channel",), (1,), {"channel": (grid.name,)} if grid.name else {}, (grid.color,))
    require_default(grid, ("origin", "direction"), ".nrrd, .mha, .nii and .npz")
    name = unit_name(grid.units)
    if name and name not in METRES:
        raise FormatError(f"OME-TIFF must have a unit of {', '.join(METRES)}; got {grid.units!r}: .npz holds any")
    letters = {"time": "T", "channel": "C", "volume": "C" if "volume" in leading.names else "T"}
    axes = [letters.get(axis, "?") for axis in before]
    if "?" in axes or len(set(axes)) < len(axes):
        raise FormatError(f"OME-TIFF holds times and channels; got {leading}: write one file for each")
    data, order = np.asarray(what), sorted(range(len(axes)), key=lambda i: "TC".index(axes[i]))
    data = data.transpose([*order, *range(len(axes), data.ndim)])
    axes = [*(axes[i] for i in order), *"ZYX"[3 - grid.ndim :]]
    if leading.rgb:
        data = np.moveaxis(data, axes.index("C"), -1)
        axes = [axis for axis in axes if axis != "C"] + ["S"]
    metadata: dict[str, Any] = {"axes": "".join(axes)}
    for axis, spacing in zip("XYZ", grid.spacing, strict=False):  # Z for volumes only, so that an image stays one
        metadata |= {f"PhysicalSize{axis}": spacing, f"PhysicalSize{axis}Unit": _OME_NAMES.get(name, name)}
    if not leading.rgb:
        named = leading.names.get("channel") or leading.names.get("volume")
        colors = [ome_color(color or WHITE) for color in leading.colors] if any(leading.colors) else []
        metadata["Channel"] = ({"Name": list(named)} if named else {}) | ({"Color": colors} if colors else {})
    # Without `photometric` a stack of three or four slices would be read as colours.
    photometric = "rgb" if leading.rgb else "minisblack"
    tifffile().imwrite(path, storable(data, DTYPES), ome=True, photometric=photometric, metadata=metadata)


def _content(path: Path, file: Any, number: int, level: int, choose: Choice, load: Callable[..., Any]) -> Content:
    """One size of an image; `load` reads its samples at an index."""
    levels = _whole(file)[number].levels
    image = levels[level]
    kind = file.series[number].kind.lower()  # as tifffile found it: what the file declares may not fit its pages
    about = (
        ome(path.name, file.ome_metadata, number, len(file.series), image.dtype)
        if kind == "ome"
        else imagej(path.name, file)
        if kind == "imagej"
        else About()
    )
    layout, leading = _laid_out(path.name, image, about, choose)
    if image.dtype is None or image.dtype.kind not in "biuf":
        raise DataError(f"{path.name} must hold real numbers; got dtype {image.dtype}")
    data: Any
    data, known = layout.chosen(path.name, choose, lambda index: load(path.name, file, image, index), leading)
    shrunk = {axis: n / m for (axis, m), (_, n) in zip(_axes(image), _axes(levels[0]), strict=True)}
    name = file.series[number].name if len(file.series) > 1 else ""
    shrunk = {axis: shrunk.get(axis.upper(), 1.0) for axis in "xyz"}
    axes = [axis for axis in "xyz" if axis in layout.axes]
    units, factors = in_one_unit(path.name, {axis: about.units.get(axis, "") for axis in axes})
    stated = {axis: about.spacing.get(axis, math.nan) for axis in axes}
    spacing = {axis: 1.0 if math.isnan(size) else size * factors[axis] for axis, size in stated.items()}
    geometry: dict[str, Any] = {
        "spacing": layout.of({axis: spacing[axis] * shrunk[axis] for axis in axes}),
        "units": units,
        "space": "image",
        "name": name,
        "unplaced": "; ".join(text for axis, text in about.wrong.items() if axis in axes),
    }
    if "channel" not in layout.axes and len(about.clims) == 1:
        geometry["clim"] = about.clims[0]
    if level:  # the first sample of a level lies at the centre of those it replaces
        geometry["origin"] = layout.of({axis: (shrunk[axis] - 1) / 2 * spacing[axis] for axis in axes})
    values: Any = scaled_part if isinstance(data, Window) else scaled
    return values(data, about.slope, about.offset), geometry | known


def _images(name: str, file: Any) -> tuple[Series, ...]:
    """The images that tifffile finds, identified by name if the names are unique."""
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
    """Letters and lengths of all axes, including those of length 1, which tifffile keeps apart until 2026.5."""
    both = hasattr(image, "get_axes")
    letters, shape = (image.get_axes(squeeze=False), image.get_shape(squeeze=False)) if both else (image.axes, image.shape)
    return list(zip(letters, shape, strict=True))


def _laid_out(name: str, image: Any, about: About, choose: Choice) -> tuple[Layout, Leading]:
    """Meaning of the axes of an image; pages of unknown meaning (I, Q) are slices."""
    pairs = _axes(image)
    words = [_MEANINGS.get(axis, _OTHERS.get(axis, "")) if axis != "S" or n > 1 else "" for axis, n in pairs]
    keep = [*("z",) * about.deep, *("channel",) * bool(about.names or any(about.colors))]
    layout = lay_out(name, words, [n for _, n in pairs], keep, choose.given)
    unnamed = [(n, meaning) for (_, n), word, meaning in zip(pairs, words, layout.axes, strict=True) if n > 1 and word != meaning]
    if [meaning for _, meaning in unnamed] == ["z"]:
        far = "" if "z" in about.spacing else ", 1 apart: spacing= replaces it"
        text = f"it does not say what its {unnamed[0][0]} pages are; they were taken for slices{far}"
        layout = Layout(layout.axes, layout.shape, text)
    layout = layout.saying_where_spacing_is_missing(about.spacing)
    if "channel" not in layout.axes:
        return layout, Leading(layout.leading, layout.counts)
    at = layout.axes.index("channel")
    count = layout.shape[at]
    if pairs[at][0] == "S" and image.keyframe.photometric in _IN_COLOUR and count in (3, 4):
        return layout, layout.in_colour
    names = about.names if len(about.names) == count else ()
    colors = about.colors if len(about.colors) == count else ()
    clims = about.clims if len(about.clims) == count else ()
    return layout, Leading(layout.leading, layout.counts, {"channel": names} if names else {}, colors, clims)


def _load(name: str, file: Any, image: Any, index: tuple[int | slice, ...]) -> NDArray[Any]:
    """The samples of an image at an index of its axes; reads only pages that hold some of them."""
    check_order(name, image)
    shape = tuple(n for _, n in _axes(image))
    split = next((k for k in range(len(shape)) if sample_count(shape[k:]) == image.keyframe.size), None)
    if image.transform is None and split is not None and sample_count(shape[:split]) == len(image):
        numbers = np.arange(len(image)).reshape(shape[:split])[index[:split]]
        keys = [int(n) for n in np.ravel(numbers)]
        check_samples(name, [image[key] for key in keys], image.keyframe, len(keys) * image.keyframe.size)
        if file.byteorder == _NATIVE and (mapped := _mapped(file, image, shape)) is not None:
            return as_stored(mapped[index])
        into = empty((len(keys), image.keyframe.size), image.dtype)
        with decoding(name, [image[key] for key in keys]):
            samples = file.asarray(key=keys, series=image, out=into).reshape(np.shape(numbers) + tuple(shape[split:]))
        return np.asarray(samples[(slice(None),) * np.ndim(numbers) + index[split:]])
    check_samples(name, list(image), image.keyframe, sample_count(shape))
    if (mapped := _mapped(file, image, shape)) is not None:
        return as_stored(mapped[index])
    with decoding(name, list(image)):
        return np.asarray(image.asarray(out=empty(shape, image.dtype)).reshape(shape)[index])


def _mapped(file: Any, image: Any, shape: tuple[int, ...]) -> NDArray[Any] | None:
    """All samples of an image, mapped, if they are contiguous and uncompressed; else None."""
    if image.dataoffset is None or image.transform is not None or not image.keyframe.is_memmappable:
        return None
    found: NDArray[Any] = file.filehandle.memmap_array(file.byteorder + image.dtype.char, shape, image.dataoffset)
    return found


def _part_of(name: str, file: Any, image: Any, index: Index) -> Window:
    """A part of an image at an index of its axes, after its pages are checked."""
    path = Path(file.filehandle.path)
    check_order(name, image)
    shape = tuple(n for _, n in _axes(image))
    check_samples(name, list(image), image.keyframe, sample_count(shape), sample_count(image.keyframe.chunks))
    own = image.keyframe.parent.filehandle.path
    if (places := _places(image)) is not None:
        dtype = np.dtype(file.byteorder + image.dtype.char)
        return Window(FlatFile(Path(own), shape, dtype, places), shape, dtype, None, index)
    try:
        import zarr
    except ImportError as error:
        raise MissingDependencyError(
            'TIFF files of strips and tiles are read part by part by way of zarr: pip install "clvol[microscopy]"'
        ) from error
    array: Any = zarr.open(image.aszarr(level=0, squeeze=False), mode="r")
    if tuple(array.shape) != shape:
        raise FormatError(f"{name} must be read part by part as an array of shape {shape}; tifffile makes it {array.shape}")
    lock = threading.Lock()

    def read(index: Index) -> NDArray[Any]:
        assert not file.filehandle.closed  # this closure keeps it open
        with lock:
            try:
                with strict(name):
                    return as_stored(np.asarray(array[index]))
            except MemoryError:
                raise
            except Exception as error:
                raise ChunkError(
                    f"cannot read {_damaged(name, array, image, index)}: it is damaged, its codec says: {error}"
                ) from error

    return Window(Watched(path, name, read), shape, array.dtype, array.chunks, index)


def _places(image: Any) -> int | list[int] | None:
    """Offsets of uncompressed samples: of the image, or of each page; None if they are encoded or scattered."""
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
    """Whether the strips of a page are contiguous, and as long as its samples."""
    ends = itertools.accumulate(page.databytecounts, initial=page.dataoffsets[0])
    return sum(page.databytecounts) == size and all(map(operator.eq, page.dataoffsets, ends))


def _damaged(name: str, array: Any, image: Any, index: Index) -> str:
    """The first strip or tile at an index that cannot be read, with its page and file."""
    with strict(name):
        at = damaged_chunk(array, index, array.chunks)
    if at is None:
        return f"strips or tiles of {name}"
    counts = [-(-n // edge) for n, edge in zip(array.shape, array.chunks, strict=True)]
    number, segment = divmod(int(np.ravel_multi_index(at, counts)), math.prod(counts) // len(image))
    page, kind = image[number], "tile" if image.keyframe.is_tiled else "strip"
    return f"{kind} {segment} of page {page.index} of {page.parent.filehandle.name}"
