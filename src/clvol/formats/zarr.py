"""OME-Zarr images (0.4 and 0.5, and older ones), and plain arrays and groups of Zarr 2 and 3, in folders and ``.zip`` files."""

from __future__ import annotations

import math
import re
import warnings
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.errors import DataError, FormatError, MissingDependencyError
from clvol.formats._choice import Choice, Series, chosen_level, chosen_series
from clvol.formats._files import bytes_at, require_members, sample_count
from clvol.formats._layout import Layout, decoded, lay_out, place, uniform, unnamed
from clvol.formats._limits import announce, announce_parts
from clvol.interop import Content
from clvol.volumes import Leading

__all__ = ["is_one", "read", "series"]

_METADATA = ("zarr.json", ".zgroup", ".zarray")
_OLD_AXES = "tczyx"  # of OME-Zarr 0.1 and 0.2, which name none


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
        return self.node[self.multiscales["datasets"][level]["path"]]

    @property
    def series(self) -> Series:
        array = self.level(0)
        words = [str((self.multiscales or {}).get("name") or "")] if self.multiscales else [array.dtype.name]
        return Series(self.id, ", ".join(filter(None, [*words, "labels" * self.labels])), tuple(array.shape))


def is_one(path: Path) -> bool:
    """Whether a folder is a Zarr array or group."""
    return any((path / name).is_file() for name in _METADATA)


def read(path: Path, choose: Choice, series: int | str | None = None, level: int = 0) -> Content:
    """The chunks of one image or array that hold what is chosen; chunks that are not stored have the array's fill value."""
    with _images(path) as images:
        main = [image for image in images if not image.labels]
        listed = [image.series for image in images]
        ome = any(image.multiscales for image in main)
        what = "images" if ome else "arrays"
        image = images[chosen_series(path.name, listed, series, what=what, main=len(main), first=ome)]
        if image.multiscales is None:
            chosen_level(path.name, [image.node.shape], level)
            return _plain(path.name, image, choose)
        sizes = [image.level(i).shape for i in range(len(image.multiscales["datasets"]))]
        return _multiscale(path.name, image, chosen_level(path.name, sizes, level), choose)


def series(path: Path) -> tuple[Series, ...]:
    """The images and arrays that there are, images before their labels."""
    with _images(path) as images:
        return tuple(image.series for image in images)


@contextmanager
def _images(path: Path) -> Iterator[list[_Image]]:
    try:
        import zarr
        from zarr.storage import LocalStore, ZipStore
    except ImportError as error:
        raise MissingDependencyError("Zarr needs zarr: pip install clvol[microscopy]") from error
    root = path.resolve()

    class OwnFiles(LocalStore):
        """The files below the folder: zarr takes what is no file for a chunk that is not stored, and waits for pipes."""

        async def get(self, key: str, *args: Any, **options: Any) -> Any:
            _require_own_file(root, key)
            return await super().get(key, *args, **options)

        def get_sync(self, key: str, *args: Any, **options: Any) -> Any:
            _require_own_file(root, key)
            return super().get_sync(key, *args, **options)

    folder = path.is_dir()
    inner = "" if folder else _inside(path)
    with closing(OwnFiles(path, read_only=True) if folder else ZipStore(path, mode="r")) as store:
        with warnings.catch_warnings():  # what else lies in the folders
            warnings.simplefilter("ignore")
            found = list(_below(zarr.open(store, path=inner, mode="r"), ""))
        if not found:
            raise DataError(f"{path.name} must hold an array of numbers with two axes or more; it holds none")
        yield sorted(found, key=lambda image: image.labels)


def _require_own_file(root: Path, key: str) -> None:
    """Raise if what the store would read for a key is there, but is no file of its own with something in it."""
    file = root / key
    if not file.exists() and not file.is_symlink():
        return
    if not file.is_file() or not file.resolve().is_relative_to(root):
        raise FormatError(f"{root.name} must hold files of its own; {key} is none, or leads elsewhere")
    if file.stat().st_size == 0:
        raise FormatError(f"{root.name} must hold whole chunks; {key} is empty")


def _inside(path: Path) -> str:
    """Where an archive has its array or group: at its root, or in a folder that was packed."""
    with zipfile.ZipFile(path) as archive:
        require_members(path.name, archive, replaced=True)
        found = [name for name in archive.namelist() if name.rpartition("/")[2] in _METADATA]
    if not found:
        raise FormatError(f"{path.name} must hold a Zarr array or group; unpack archives of other files, and read what they hold")
    return min(found, key=lambda name: name.count("/")).rpartition("/")[0]


def _below(node: Any, path: str, labels: bool = False) -> Iterator[_Image]:
    """The images in `node` and the groups below, in the natural order of their names."""
    if hasattr(node, "shape"):
        if node.ndim >= 2 and node.dtype.kind in "biuf":
            yield _Image(path or ".", node, None, labels)
        return
    about = _ome(node)
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


def _ome(node: Any) -> dict[str, Any]:
    """The metadata of OME: in 0.5 below a key of their own, before among others."""
    attributes: dict[str, Any] = dict(node.attrs)
    return dict(attributes.get("ome", attributes))


def _multiscale(source: str, image: _Image, level: int, choose: Choice) -> Content:
    multiscales = image.multiscales
    assert multiscales is not None
    array, about = image.level(level), _ome(image.node)
    given = multiscales.get("axes") or list(_OLD_AXES[-array.ndim :])
    axes = [axis if isinstance(axis, dict) else {"name": axis} for axis in given]
    words = [axis["type"] if axis.get("type") in ("time", "channel") else axis["name"] for axis in axes]
    channels = about.get("omero", {}).get("channels", [])
    layout = lay_out(source, words, array.shape, ("channel",) if channels else ())
    factors, shifts = [1.0] * array.ndim, [0.0] * array.ndim
    for step in (
        *multiscales["datasets"][level].get("coordinateTransformations", ()),
        *multiscales.get("coordinateTransformations", ()),
    ):
        if step["type"] == "scale" and len(step.get("scale", ())) == array.ndim:
            factors = [a * b for a, b in zip(factors, step["scale"], strict=True)]
            shifts = [a * b for a, b in zip(shifts, step["scale"], strict=True)]
        elif step["type"] == "translation" and len(step.get("translation", ())) == array.ndim:
            shifts = [a + b for a, b in zip(shifts, step["translation"], strict=True)]
        elif step["type"] != "identity":
            raise FormatError(f"{source} must place its axes by a scale and a translation of {array.ndim} numbers; got {step}")
    lines = {axis: (float(shift), float(factor)) for axis, factor, shift in zip(layout.axes, factors, shifts, strict=True)}
    units = {axis: str(one.get("unit") or "") for axis, one in zip(layout.axes, axes, strict=True)}
    known: dict[str, Any] = {"space": "image"} | place(layout, lines, units)
    if image.labels:
        known["labels"] = _labels(about) or True
    data, chosen = layout.chosen(source, choose, lambda index: _loaded(source, array, index), _leading(layout, channels))
    return data, known | chosen


def _leading(layout: Layout, channels: list[Mapping[str, Any]]) -> Leading:
    """With what `omero` says of the channels: names, colours in hexadecimal, and windows."""
    if "channel" not in layout.axes or len(channels) != layout.shape[layout.axes.index("channel")]:
        return Leading(layout.leading, layout.counts)
    names = tuple(str(channel.get("label") or "") for channel in channels)
    colors = tuple(_color(channel.get("color")) for channel in channels)
    ends = [(window.get("start"), window.get("end")) for window in (channel.get("window") or {} for channel in channels)]
    windows = tuple(
        (float(a), float(b)) if a is not None and b is not None and -math.inf < a < b < math.inf else None for a, b in ends
    )
    return Leading(
        layout.leading,
        layout.counts,
        {"channel": names} if any(names) else {},
        colors if any(color not in (None, (1.0, 1.0, 1.0)) for color in colors) else (),
        windows if any(windows) else (),
    )


def _color(text: str | None) -> tuple[float, float, float] | None:
    if not isinstance(text, str) or not re.fullmatch(r"#?[0-9a-fA-F]{6}([0-9a-fA-F]{2})?", text):
        return None
    r, g, b = (int(text.removeprefix("#")[i : i + 2], 16) / 255 for i in (0, 2, 4))
    return r, g, b


def _loaded(source: str, array: Any, index: tuple[int | slice, ...] = ()) -> NDArray[Any]:
    """Samples of an array. Chunks that are not stored have its fill value, as Zarr has it; those that are must be whole."""
    chunk = sample_count(array.shards or array.chunks) * array.dtype.itemsize
    announce(source, max(chunk, bytes_at(array.shape, index, array.dtype)))
    taken = [len(range(n)[at]) if isinstance(at, slice) else 1 for n, at in zip(array.shape, index, strict=False)]
    counts = [*taken, *array.shape[len(taken) :]]
    announce_parts(source, sample_count([-(-n // m) for n, m in zip(counts, array.shards or array.chunks, strict=True)]))
    return np.asarray(array[index])


def _labels(about: Mapping[str, Any]) -> dict[int, str]:
    """What the label values stand for, where their properties have a name."""
    names = {}
    for one in about.get("image-label", {}).get("properties", ()):
        name = next((one[key] for key in ("name", "class", "label") if isinstance(one.get(key), str)), None)
        if name is not None and "label-value" in one:
            names[int(one["label-value"])] = name
    return names


def _plain(source: str, image: _Image, choose: Choice) -> Content:
    """An array as it is; its axes by names, if it has them, and their coordinates, as xarray stores these."""
    array = image.node
    words = [str(name or "") for name in _dimensions(array)]
    named = any(words)
    words = words if named else unnamed(array.shape, array.dtype)
    layout = lay_out(source, words, array.shape, asked=choose.given)
    lines, units = {}, {}
    for axis, word in zip(layout.axes, words, strict=True):
        values = _beside(image, word) if axis in ("x", "y", "z") and word else None
        if values is not None and values.shape == (layout.shape[layout.axes.index(axis)],):
            lines[axis] = uniform(_loaded(source, values)) or (0.0, float("nan") if values.shape[0] > 1 else 1.0)
            units[axis] = str(values.attrs.get("units", ""))
    leading = layout.channels_of(array.dtype) if words[-1:] == ["channel"] and not named else None
    data, chosen = layout.chosen(source, choose, lambda index: decoded(_loaded(source, array, index), dict(array.attrs)), leading)
    return data, {"name": image.id.rpartition("/")[2].strip(".")} | place(layout, lines, units) | chosen


def _dimensions(array: Any) -> list[str]:
    """Names of the axes, which Zarr 3 has, and xarray gave those of Zarr 2."""
    names = getattr(array.metadata, "dimension_names", None) or array.attrs.get("_ARRAY_DIMENSIONS")
    return list(names) if names is not None and len(names) == array.ndim else [""] * array.ndim


def _beside(image: _Image, name: str) -> Any:
    """The array of this name that lies beside an image: the coordinates of an axis."""
    import zarr

    parent = image.node.store_path.store, image.node.path.rpartition("/")[0]
    try:
        return zarr.open_array(parent[0], path=f"{parent[1]}/{name}".lstrip("/"), mode="r")
    except (FileNotFoundError, KeyError):
        return None
