"""OME-Zarr images (0.4 and 0.5, and older ones), and plain arrays and groups of Zarr 2 and 3, in folders and ``.zip`` files."""

from __future__ import annotations

import base64
import re
import struct
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from clvol.base.errors import DataError, FormatError, MissingDependencyError
from clvol.formats._bounds import KEY, bounds_of, samples_of
from clvol.formats._choice import Choice, Series, chosen_level, chosen_series
from clvol.formats._layout import Layout, Line, Lines, by_names, decoded, shrunk
from clvol.formats.zarr import ome
from clvol.formats.zarr.addresses import shown
from clvol.formats.zarr.array import loaded, part_of, require_chunks
from clvol.formats.zarr.files import is_one
from clvol.interop.kinds import Content
from clvol.volume.statistics import Statistics

if TYPE_CHECKING:
    from clvol.formats.zarr._store import CheckedStore

__all__ = ["is_one", "lazily", "read", "series"]

Load: TypeAlias = Callable[..., Any]
"""From a name, an array and an index to its samples there, or a part of them."""


@dataclass(frozen=True)
class _Image:
    """A plain array, or a group with an image in several sizes, which `multiscales` describes."""

    id: str
    node: Any
    multiscales: Mapping[str, Any] | None = None
    labels: bool = False

    def level(self, level: int) -> Any:
        """The array of a size."""
        if self.multiscales is None:
            return self.node
        path = None
        try:
            path = self.multiscales["datasets"][level]["path"]
            array = self.node[path]
        except (IndexError, KeyError, TypeError):
            array = None
        if not hasattr(array, "shape"):  # a group has none
            name = self.node.store_path.store.name
            raise FormatError(f"{name} must hold an array for each of its sizes; that of size {level} has the path {path!r}")
        return array

    @property
    def sizes(self) -> list[tuple[int, ...]]:
        """The shape of each size."""
        return [self.level(i).shape for i in range(len(self.multiscales["datasets"]) if self.multiscales is not None else 1)]

    @property
    def series(self) -> Series:
        array = self.level(0)
        words = [str((self.multiscales or {}).get("name") or "")] if self.multiscales else [array.dtype.name]
        return Series(self.id, ", ".join(filter(None, [*words, "labels" * self.labels])), tuple(array.shape))


def read(path: Path, choose: Choice, series: int | str | None = None, level: int = 0) -> Content:
    """The chosen samples of one image or array; missing chunks have the array's fill value."""
    with _images(path) as images:
        image = _one_of(path.name, images, series)
        return _content(path.name, image, chosen_level(path.name, image.sizes, level), choose, loaded)


def lazily(
    source: Path | str,
    choose: Choice,
    series: int | str | None = None,
    level: int = 0,
    storage_options: Mapping[str, Any] | None = None,
) -> list[Content]:
    """Windows of an image in all its sizes from `level` on, the largest first; no samples are read yet.

    `source` may be an address (``s3://...``, ``https://...``), which fsspec understands with these `storage_options`.
    """
    store, inner = _opened(source, storage_options, watched=True)
    try:
        image = _one_of(store.name, _found(store, inner), series)
    except FileNotFoundError as error:
        if store.files is not None:
            raise
        raise FormatError(f"there is no Zarr array or group at {shown(str(source))}, or no such server or bucket") from error
    contents, sizes = [], image.sizes
    for number in range(chosen_level(store.name, sizes, level), len(sizes)):
        require_chunks(store.name, image.level(number))
        contents.append(_content(store.name, image, number, choose, part_of))
    if image.multiscales and not any(one.get("coordinateTransformations") for one in image.multiscales["datasets"]):
        contents = [shrunk(contents[0], content) for content in contents]  # before 0.4 shapes alone told how sizes are placed
    return contents


def series(path: Path) -> tuple[Series, ...]:
    """The images and arrays that there are, images before their labels."""
    with _images(path) as images:
        return tuple(image.series for image in images)


def _opened(source: Path | str, options: Mapping[str, Any] | None = None, watched: bool = False) -> tuple[CheckedStore, str]:
    """The store, and the path in it of the array or group."""
    try:
        import zarr  # noqa: F401  # a store imported before does not show that it is still there

        from clvol.formats.zarr._store import open_store
    except ImportError as error:
        raise MissingDependencyError('Zarr needs zarr: pip install "clvol[microscopy]"') from error
    return open_store(source, options, watched)


@contextmanager
def _images(path: Path) -> Iterator[list[_Image]]:
    store, inner = _opened(path)
    with closing(store):
        yield _found(store, inner)


def _found(store: CheckedStore, inner: str) -> list[_Image]:
    """The images of a store, before their labels."""
    import zarr

    with warnings.catch_warnings():  # about other files in the folders
        warnings.simplefilter("ignore")
        found = list(_below(zarr.open(store, path=inner, mode="r"), ""))
    if not found:
        raise DataError(f"{store.name} must hold an array of numbers with two axes or more; it holds none")
    return sorted(found, key=lambda image: image.labels)


def _below(node: Any, path: str, labels: bool = False) -> Iterator[_Image]:
    """The images in `node` and the groups below, in the natural order of their names."""
    if hasattr(node, "shape"):
        if node.ndim >= 2 and node.dtype.kind in "biuf":
            yield _Image(path or ".", node, None, labels)
        return
    about = ome.metadata_of(dict(node.attrs))
    multiscales = about.get("multiscales")
    if multiscales:
        yield _Image(path or ".", node, multiscales[0], labels or "image-label" in about)
        if "labels" in node:
            yield from _below(node["labels"], f"{path}/labels".lstrip("/"), labels=True)
        return
    for name, member in sorted(node.members(), key=lambda pair: _natural(pair[0])):
        yield from _below(member, f"{path}/{name}".lstrip("/"), labels)


def _natural(name: str) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", name)]


def _one_of(name: str, images: list[_Image], series: int | str | None) -> _Image:
    main = [image for image in images if not image.labels]
    any_ome = any(image.multiscales for image in main)
    what = "images" if any_ome else "arrays"
    return images[chosen_series(name, [image.series for image in images], series, what=what, main=len(main), first=any_ome)]


def _content(source: str, image: _Image, level: int, choose: Choice, load: Load) -> Content:
    return _plain(source, image, choose, load) if image.multiscales is None else _multiscale(source, image, level, choose, load)


def _multiscale(source: str, image: _Image, level: int, choose: Choice, load: Load) -> Content:
    assert image.multiscales is not None
    array, attributes = image.level(level), dict(image.node.attrs)
    keep = () if load is loaded else ("z",)  # lazy volumes have three axes
    layout, leading, known = ome.described(source, attributes, image.multiscales, level, array.shape, keep)
    if image.labels:
        known["labels"] = ome.labels_of(attributes) or True
    if attributes.get(KEY) and layout.axes == ("z", "y", "x") and load is not loaded:
        about, path = attributes[KEY], image.multiscales["datasets"][level]["path"]
        known["bounds"] = bounds_of(image.node, about, path, array.shape[::-1], lambda one: part_of(source, one))
        if level == 0 and isinstance(about.get("statistics"), Mapping):
            samples = samples_of(image.node, array.shape, lambda one: part_of(source, one))
            known["statistics"] = Statistics.from_json(about["statistics"], samples)
    data, chosen = layout.chosen(source, choose, lambda index: load(source, array, index), leading)
    return data, known | chosen


def _plain(source: str, image: _Image, choose: Choice, load: Load) -> Content:
    """An array as it is; its axes by name and coordinate, if it has them, as xarray stores these."""
    words = _dimensions(image.node)

    def lines_of(layout: Layout) -> Lines:
        lines: dict[str, Line] = {}
        units: dict[str, str] = {}
        for axis, word, n in zip(layout.axes, words, layout.shape, strict=True):
            values = _beside(image, word) if axis in ("x", "y", "z") and word else None
            if values is not None and values.shape == (n,):
                lines[axis] = decoded(loaded(source, values), _attributes(values))
                units[axis] = str(values.attrs.get("units", ""))
        return lines, units

    data, known = by_names(source, words, image.node, choose, load, lines_of, _attributes)
    return data, {"name": image.id.rpartition("/")[2].strip(".")} | known


def _dimensions(array: Any) -> list[str]:
    """Names of the axes: a field of Zarr 3, an attribute that xarray adds in Zarr 2."""
    names = getattr(array.metadata, "dimension_names", None) or array.attrs.get("_ARRAY_DIMENSIONS")
    return [str(name or "") for name in names] if names is not None and len(names) == array.ndim else [""] * array.ndim


def _attributes(array: Any) -> dict[str, Any]:
    """Those by which samples are decoded, with the missing value where xarray keeps it.

    In Zarr 3 that is float64 in base64; in Zarr 2 the fill value itself, of which 0 is every other writer's default.
    """
    attributes = dict(array.attrs)
    stored, fill = attributes.get("_FillValue"), array.metadata.fill_value
    if isinstance(stored, str) and array.dtype.kind == "f":
        with suppress(ValueError, struct.error):  # of other writers
            attributes["_FillValue"] = struct.unpack("<d", base64.b64decode(stored, validate=True))[0]
    elif stored is None and array.metadata.zarr_format == 2 and "_ARRAY_DIMENSIONS" in attributes and fill:
        attributes["_FillValue"] = fill
    return attributes


def _beside(image: _Image, name: str) -> Any:
    """The array of this name beside an image: the coordinates of an axis."""
    import zarr

    store, group = image.node.store_path.store, image.node.path.rpartition("/")[0]
    try:
        return zarr.open_array(store, path=f"{group}/{name}".lstrip("/"), mode="r")
    except (FileNotFoundError, KeyError):
        return None
