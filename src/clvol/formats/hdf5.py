"""Arrays in HDF5 files (simulations, netCDF-4, ilastik, Fiji), and images of ITK and VTK in HDF5, by h5py."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import ChunkError, DataError, FormatError, MissingDependencyError
from clvol.bricks.sliced import Index, Watched, Window
from clvol.formats._choice import Choice, Series, chosen_series
from clvol.formats._files import bytes_at, damaged_chunk, sample_count, unplaced_by
from clvol.formats._layout import Layout, Line, by_names, decoded, lay_out
from clvol.formats.guarded.limits import announce
from clvol.interop.kinds import Content
from clvol.volume.volumes import Leading

__all__ = ["is_file", "lazily", "loaded", "member", "opened", "part_of", "read", "series"]

_CACHED = 1 << 20  # bytes of HDF5's chunk cache, by default 1 MiB, from 2.0 on 8. Larger chunks are not read as a whole
_SIGNATURE = b"\x89HDF\r\n\x1a\n"  # at the start, or behind a block of the user's of 512, 1024, ... bytes
_INSTEAD = "clvol.LazyVolume(dataset) takes what h5py makes of it, if you trust it"
_LISTED = 5  # links in a message
_NO_VARIABLE = "This is a netCDF dimension but not a netCDF variable"  # NAME of a scale that holds no coordinates


def is_file(path: Path) -> bool:
    """Whether a file has the signature of HDF5."""
    size, at = path.stat().st_size, 0
    with path.open("rb") as stream:
        while at < size:
            stream.seek(at)
            if stream.read(len(_SIGNATURE)) == _SIGNATURE:
                return True
            at = 2 * at or 512
    return False


def read(path: Path, choose: Choice, series: int | str | None = None) -> Content:
    """The chosen volumes of one array: the only one with three axes or more, else the only one with two.

    Names of axes are taken from vigra's ``axistags``, ``axes``, or the labels and scales of dimensions; spacing from
    ``element_size_um``, the tags, or evenly spaced scales; all of it from ITK's files.
    """
    with opened(path) as file:
        return _content(path, file, choose, series, loaded)


def lazily(path: Path, choose: Choice, series: int | str | None = None) -> list[Content]:
    """As `read`, but samples are read on demand."""
    return [_content(path, opened(path), choose, series, lambda source, array, index: part_of(path, source, array, index))]


def _content(path: Path, file: Any, choose: Choice, series: int | str | None, load: Callable[..., Any]) -> Content:
    """The chosen volumes; `load` returns the samples of an array at an index."""
    arrays = _arrays(file)
    listed = [_listed(array) for array in arrays]
    if not arrays:
        raise DataError(f"{path.name} must hold an array of numbers with two axes or more; it holds none{_links(file)}")
    deep = sum(array.ndim > 2 for array in arrays)
    array = arrays[chosen_series(path.name, listed, series, what="arrays", main=deep or None, first=False)]
    if _is_of_itk(array):
        return _itk(path.name, array, choose, load)
    if _is_of_vtk(array):
        return _vtk(path.name, array, choose, load)
    words, lines, units = _axes(array)
    data, known = by_names(
        path.name,
        words,
        array,
        choose,
        load,
        lambda layout: (
            {axis: lines[i] for i, axis in enumerate(layout.axes) if i in lines},
            {axis: units[i] for i, axis in enumerate(layout.axes) if i in units},
        ),
    )
    space = {"space": "image"} if "um" in units.values() else {}
    return data, {"name": array.name.rpartition("/")[2]} | space | known


def series(path: Path) -> tuple[Series, ...]:
    """The arrays of numbers with two axes or more, by their paths in the file; those with two come last."""
    with opened(path) as file:
        return tuple(_listed(array) for array in _arrays(file))


def opened(path: Path) -> Any:
    """The file, opened by h5py."""
    try:
        import h5py
    except ImportError as error:
        raise MissingDependencyError('HDF5 files need h5py: pip install "clvol[hdf5]"') from error
    return h5py.File(path, "r", locking="best-effort", rdcc_nbytes=_CACHED)


def member(group: Any, name: str) -> Any:
    """A member of a group. A `FormatError` if there is none, or if it is a link, which may lead to another file or in a circle."""
    import h5py

    link = group.get(name, getlink=True)
    if not isinstance(link, h5py.HardLink):
        what = "nothing" if link is None else f"a link to {getattr(link, 'filename', '')}{link.path}"
        raise FormatError(f"{group.name} must hold {name!r} itself; it has {what}")
    return group[name]


def loaded(source: str, array: Any, index: Index = ()) -> NDArray[Any]:
    """Samples of an array, which must be in this file. Chunks that are not stored have the array's fill value."""
    _require_own(source, array)
    announce(source, max(sample_count(array.chunks or ()) * array.dtype.itemsize, bytes_at(array.shape, index, array.dtype)))
    return _samples(source, array, index)


def part_of(path: Path, source: str, array: Any, index: Index = ()) -> Window:
    """As `loaded`, but samples are read on demand; errors name the chunk."""
    _require_own(source, array)
    announce(source, sample_count(array.chunks or ()) * array.dtype.itemsize)

    chunk = sample_count(array.chunks or ()) * array.dtype.itemsize
    by_parts = chunk > _CACHED and not array.id.get_create_plist().get_nfilters()  # HDF5 reads parts of such a chunk
    return Window(
        Watched(path, source, partial(_samples, source, array)), array.shape, array.dtype, None if by_parts else array.chunks, index
    )


def _samples(source: str, array: Any, index: Index) -> NDArray[Any]:
    try:
        return np.asarray(array[index])
    except OSError as error:
        raise ChunkError(f"cannot read {_damaged(array, index)} of {array.name} in {source}: {error}") from error


def _damaged(array: Any, index: Index) -> str:
    """The first damaged chunk at an index, for messages."""
    if not array.chunks:
        return "the samples"
    at = damaged_chunk(array, index, array.chunks)
    return "the chunks" if at is None else f"chunk {at}"


def _require_own(source: str, array: Any) -> None:
    """Raise unless an array is stored in this file, in whole chunks."""
    elsewhere = array.external or (array.is_virtual and any(one.file_name != "." for one in array.virtual_sources()))
    if elsewhere:
        raise FormatError(f"{source} must hold its samples; those of {array.name} are in other files: {_INSTEAD}")
    stored = array.id.get_storage_size()
    if not stored and not array.is_virtual and array.shape:
        raise FormatError(f"{source} must hold samples of {array.name}; none were ever written")
    if array.chunks and not array.id.get_create_plist().get_nfilters():
        _check_chunks(source, array)


def _check_chunks(source: str, array: Any) -> None:
    """Raise if an uncompressed chunk has a wrong size: HDF5 would read what is missing from anywhere."""
    whole = sample_count(array.chunks) * array.dtype.itemsize
    wrong: list[int] = []

    def look(chunk: Any) -> None:
        if chunk.size != whole:
            wrong.append(chunk.size)

    array.id.chunk_iter(look)
    if wrong:
        raise FormatError(f"{source} must hold {whole} bytes of samples in each chunk of {array.name}; one has {wrong[0]}")


def _arrays(file: Any) -> list[Any]:
    found: list[Any] = []

    def look(_: str, node: Any) -> None:
        if (
            hasattr(node, "shape")
            and node.shape is not None
            and node.ndim >= 2
            and node.dtype.kind in "biuf"
            and 0 not in node.shape
        ):
            found.append(node)

    file.visititems(look)
    return sorted(found, key=lambda array: array.ndim == 2)


def _links(file: Any) -> str:
    """External links, for messages. They are not followed: they may lead to any file that the caller can read."""
    import h5py

    groups = [file]
    file.visititems(lambda _, item: groups.append(item) if isinstance(item, h5py.Group) else None)
    links = {f"{group.name.rstrip('/')}/{name}": group.get(name, getlink=True) for group in groups for name in group}
    found = [f"{at} leads to {one.path} in {one.filename}" for at, one in links.items() if isinstance(one, h5py.ExternalLink)]
    more = f" and {len(found) - _LISTED} others" if len(found) > _LISTED else ""
    return f"; {', '.join(found[:_LISTED])}{more}: clvol.open that file, or {_INSTEAD}" if found else ""


def _listed(array: Any) -> Series:
    return Series(array.name.lstrip("/"), array.dtype.name, tuple(array.shape))


def _axes(array: Any) -> tuple[list[str], dict[int, Line], dict[int, str]]:
    """Name of each axis or ""; coordinates and unit of axes where they are known."""
    attributes, count = array.attrs, array.ndim
    words = _texts(attributes.get("axes", ()), count) or [str(dimension.label) for dimension in array.dims]
    lines: dict[int, Line] = {}
    units: dict[int, str] = {}
    for i, dimension in enumerate(array.dims):
        scales = [scale for scale in dimension.values() if scale.shape == (array.shape[i],)]
        if not scales:
            continue
        words[i] = _text(scales[0].attrs.get("axis")) or words[i] or scales[0].name.rpartition("/")[2]
        if not _text(scales[0].attrs.get("NAME")).startswith(_NO_VARIABLE):
            lines[i] = decoded(loaded(array.name, scales[0]), dict(scales[0].attrs))
            units[i] = _text(scales[0].attrs.get("units"))
    for i, tag in enumerate(_tags(attributes.get("axistags"), count)):
        words[i] = str(tag.get("key", ""))
        if tag.get("resolution"):
            lines[i] = (0.0, float(tag["resolution"]))
    size = np.ravel(attributes.get("element_size_um", ()))
    if len(size) == 3 and size.dtype.kind in "iuf":  # along z, y and x, whatever precedes them
        at = [words.index(axis) if axis in words else count - 3 + k for k, axis in enumerate("zyx")]
        for i, step in zip(at, size, strict=True):
            if i >= 0:
                lines[i], units[i] = (0.0, float(step)), "um"
    return words, lines, units


def _text(value: Any) -> str:
    value = np.ravel(value)[0] if np.size(value) == 1 else value
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value if isinstance(value, str) else ""


def _texts(value: Any, count: int) -> list[str]:
    """A word per axis, from an array of words or the letters of one word; empty if the number is wrong."""
    words = list(_text(value)) if isinstance(value, (str, bytes)) else [_text(one) for one in np.ravel(value)]
    return words if len(words) == count else []


def _tags(value: Any, count: int) -> list[Mapping[str, Any]]:
    """Vigra's axis tags, which ilastik writes."""
    text = _text(value)
    tags = json.loads(text).get("axes", []) if text else []
    return tags if len(tags) == count else []


def _is_of_itk(array: Any) -> bool:
    return array.name.rpartition("/")[2] == "VoxelData" and all(
        name in array.parent for name in ("Origin", "Spacing", "Directions")
    )


def _itk(source: str, array: Any, choose: Choice, load: Callable[..., Any]) -> Content:
    """ITK's image: the rows of ``Directions`` are the directions of its axes, x first; components are the last axis."""
    about = {
        name: np.asarray(loaded(source, member(array.parent, name)), np.float64) for name in ("Spacing", "Origin", "Directions")
    }
    d = len(about["Spacing"])
    words = [*"zyx"[3 - d :], *("channel",) * (array.ndim - d)] if d in (2, 3) else []
    layout: Layout = lay_out(source, words, array.shape)
    leading = Leading(layout.leading, layout.counts, vector="channel" in layout.leading and array.dtype.kind == "f")
    data, chosen = layout.chosen(source, choose, lambda index: load(source, array, index), leading)
    known = {"spacing": about["Spacing"], "origin": about["Origin"], "direction": about["Directions"].T, "space": "LPS"}
    return data, known | unplaced_by("its Spacing", about["Spacing"]) | chosen


def _is_of_vtk(array: Any) -> bool:
    grid = array.parent.parent
    return grid.name == "/VTKHDF" and _text(grid.attrs.get("Type")) == "ImageData"


def _vtk(source: str, array: Any, choose: Choice, load: Callable[..., Any]) -> Content:
    """VTK's image data: an array at the points or in the cells; components are the last axis."""
    about = array.parent.parent.attrs
    spacing, origin = (np.asarray(about.get(name, default), np.float64) for name, default in (("Spacing", 1.0), ("Origin", 0.0)))
    direction = np.reshape(about.get("Direction", np.eye(3)), (3, 3)).astype(np.float64)
    low, high = np.reshape(about["WholeExtent"], (3, 2)).T
    first = low + (0.5 * (high > low) if array.parent.name.endswith("CellData") else 0.0)
    layout: Layout = lay_out(source, [*"zyx", *("channel",) * (array.ndim - 3)], array.shape)
    leading = layout.channels_of(array.dtype)
    data, chosen = layout.chosen(source, choose, lambda index: load(source, array, index), leading)
    geometry = {"spacing": spacing, "origin": origin + direction @ (first * spacing), "direction": direction}
    return data, geometry | unplaced_by("its Spacing", spacing) | {"name": array.name.rpartition("/")[2]} | chosen
