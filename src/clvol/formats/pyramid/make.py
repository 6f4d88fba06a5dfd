"""`pyramid` writes a volume of any size as an OME-Zarr store of several sizes, with bounds of its function."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base.checks import as_path, flag, if_image, one_of, several, suggests_options, whole
from clvol.base.errors import DataError, MissingDependencyError, OptionError
from clvol.base.files import full_disk, require_suffix
from clvol.base.rounding import wide
from clvol.base.units import ome_unit
from clvol.bricks.chunks import UNPACKING, Chunks, lines_of, stored_in_one
from clvol.bricks.source import LazyVolume, Sliced, memory_for
from clvol.device import Device, as_device
from clvol.filter.boundary import Boundary, as_boundary
from clvol.filter.filter import Filter
from clvol.filter.table import PICTURE_FILTER
from clvol.formats import read as read_whole
from clvol.formats._bounds import BLOCK, KEY, SAMPLES, VERSION
from clvol.formats._errors import foreign_errors
from clvol.formats.opening import WholeOnlyError
from clvol.formats.opening import open as open_lazily
from clvol.formats.pyramid.blocks import Bricks, coarser, outwards, require_bounded
from clvol.formats.pyramid.journal import Journal, require_apart, said_of
from clvol.formats.pyramid.reduce import Reduction
from clvol.formats.zarr.addresses import shown
from clvol.noise import estimate
from clvol.spline.levels import FIXED, METHODS, Level, Method, filter_at, levels_of, require_reducible, sums_for
from clvol.volume.label_table import LabelTable
from clvol.volume.smoothing import filter_for, settled
from clvol.volume.statistics import Statistics
from clvol.volume.volume import Volume, as_volume, table_of

__all__ = ["COMPRESSORS", "VERSIONS", "pyramid"]

VERSIONS = ("0.4", "0.5")
COMPRESSORS = ("lz4", "zstd", "none")
_STATISTICS = 128 << 20  # bytes that estimating the noise takes
_RUNS = 1024  # runs of successive labels that are kept
_SUFFIXES = (".zarr",)
_CHUNK = 64
_BLOCKS = 32  # blocks of bounds along an edge of a chunk
_FEW = 8  # blocks along an axis at which coarsening of bounds stops
_OF_SOURCE = 3  # a third of the budget caches chunks of the source; half of that is for those being read
_LARGE = 16  # chunks of the source that take a 16th of the budget to unpack are cached
_COST = {"reduce": 1.0, "bounds": 2.0}  # work per sample, about, for the progress


@suggests_options
def pyramid(
    source: LazyVolume | Volume | str | os.PathLike[str] | ArrayLike,
    path: str | os.PathLike[str],
    *,
    filter: str | Filter | None = None,
    boundary: str | Boundary = "mirror",
    method: Method | None = None,
    levels: int | None = None,
    chunks: int | Sequence[int] = _CHUNK,
    shards: int | Sequence[int] | None = None,
    compressor: Literal["lz4", "zstd", "none"] = "lz4",
    bounds: bool = True,
    version: Literal["0.4", "0.5"] = "0.5",
    memory: int | None = None,
    overwrite: bool = False,
    device: Device | str | int | None = None,
    progress: Callable[[float], object] | None = None,
) -> LazyVolume:
    """Write a volume as an OME-Zarr store of several sizes, with bounds of its function.

    The volume is read by parts, each sample about once. The store appears when it is complete. If the process is killed or
    interrupted before, the same call resumes.

    Parameters
    ----------
    source : LazyVolume, Volume, path or array-like
        The volume; from `clvol.open` if it is larger than memory, as a path is opened if its format allows it.
    path : path-like
        A folder that does not exist yet, ``*.zarr``.
    filter : str or Filter, optional
        Of the function that the smaller sizes approximate, and that is bounded. Default: that of pictures, "bspline3(auto)", its λ
        chosen by the noise of the whole volume; "nearest" for labels.
    boundary : str or Boundary
        How samples continue outside.
    method : {"least-squares", "average", "nearest"}, optional
        How a size follows from the one before. "least-squares": the spline nearest to it, in the mean square; "average": means of
        two samples along each axis; "nearest": every second sample, the default for labels, which are never blended.
    levels : int, optional
        Number of sizes, with the volume's own; by default until no axis has more samples than a chunk. The axes with the smallest
        spacing are halved first.
    chunks, shards : int or sequence of int
        Samples along x, y and z in a chunk, and in a file (Zarr 3, version "0.5" only).
    compressor : {"lz4", "zstd", "none"}
        By Blosc, with a shuffle that suits samples. "zstd" makes stores about a tenth smaller, and takes twice the time.
    bounds : bool
        Whether to store minima and maxima of the function in blocks of 8³ cells, and in coarser ones. Renderers do not read what
        these exclude, and `LazyVolume.limits` are exact.
    version : {"0.4", "0.5"}
        Of OME-Zarr: 0.4 is Zarr 2, 0.5 is Zarr 3.
    memory : int, optional
        Bytes of memory beyond what Python takes. Default: 2 GiB or half of the memory available, whichever is less, but enough to
        unpack a chunk of the source. Below some 200 MiB no statistics for automatic looks are stored.
    overwrite : bool
        Whether to replace what is at `path`, and what another unfinished call left beside it.
    device : Device, str or int, optional
        See `as_device`.
    progress : callable, optional
        Called with the fraction done.

    Returns
    -------
    LazyVolume
        The store, opened.

    Raises
    ------
    FormatError
        `path` exists, or another call left an unfinished store beside it; `path` lies in the source, or holds it; samples cannot be
        read or written.
    OptionError
        An argument is not allowed; the budget is too small (the message says for what); the filter is a hybrid, or its translates
        are linearly dependent; the boundary rule does not continue the samples.
    DataError
        The source is no volume, or samples are NaN or infinite (see `LazyVolume`: ``missing=``).
    MissingDependencyError
        zarr is not installed.

    Notes
    -----
    Smaller sizes keep the dtype: whole numbers are rounded and clipped. Their filter is `filter` without smoothing, for the noise
    went with the first size. Samples are the same to the last bit whatever `memory` and the chunks.

    Examples
    --------
    >>> clvol.pyramid(clvol.open("scan.tif"), "scan.zarr")
    >>> volume = clvol.open("scan.zarr")
    >>> volume.bounds.within((0, 0, 0), (64, 64, 64))
    """
    if isinstance(path, str) and "://" in path:
        raise OptionError(
            f"pyramids are written to a folder, from which fsspec, or a tool of the server's, copies them; got {shown(path)}"
        )
    target = as_path(path)
    require_suffix(target, _SUFFIXES, "pyramids")
    given, target = _lazy(source), target.resolve()
    require_apart(given, target)
    room = _room(memory, given)
    volume, cache = _kept(given, room)
    storage = _Storage.of(chunks, shards, compressor, version)
    if method is not None and method not in METHODS:
        raise one_of("method", method, METHODS)
    rule, part, labels = as_boundary(boundary), volume.part(), volume.is_labels
    row = filter_for(part, filter, PICTURE_FILTER)
    if not row.settled:
        row = settled(row, _with_noise(volume))
    how: Method = method or ("nearest" if labels else "least-squares")
    if flag("bounds", bounds):
        require_bounded(row, rule)
    require_reducible(how, row, rule)
    count = None if levels is None else whole("levels", levels, 1)
    sizes = levels_of(volume.size, volume.spacing, count, max(storage.chunks))
    plan = _Plan(row, rule, how, sizes, storage, bounds, as_device(device), labels)
    if plan.bounds:
        Bricks.edge_for(plan.filter, room)

    def why(error: Exception) -> str:
        return full_disk(error, target.parent) or str(error)

    with foreign_errors(f"write {path}", why), Journal(target, plan.command(volume), flag("overwrite", overwrite)) as journal:
        if not journal.finished:
            _Writing(volume, plan, journal, room, progress, cache).run()
            journal.complete()
        elif progress is not None:
            progress(1.0)
    return open_lazily(target, trusted=True)


def _lazy(source: Any) -> LazyVolume:
    if isinstance(source, LazyVolume):
        return source
    if isinstance(source, (str, os.PathLike)):
        try:
            return open_lazily(source)
        except WholeOnlyError:
            return _lazy(read_whole(source))
    if not isinstance(source, Volume) and isinstance(source, Sliced) and not isinstance(source, np.ndarray):
        return LazyVolume(source)
    volume = as_volume(source)
    if volume.ndim != 3:
        raise DataError(f"a pyramid is made of a volume with 3 axes; got shape {volume.shape}{if_image(volume.shape)}")
    known = ("spacing", "origin", "direction", "units", "space", "name", "color", "clim", "labels")
    return LazyVolume(volume.data, **{name: getattr(volume, name) for name in known})


def _kept(volume: LazyVolume, room: int) -> tuple[LazyVolume, Chunks | None]:
    """The volume, with a cache where reading a chunk again is expensive: dask computes it, and a large one is unpacked."""
    one, lines, most = stored_in_one(volume.data), lines_of(volume.data), room // _OF_SOURCE // 2
    computed = hasattr(volume.data, "__dask_graph__")
    if lines is None or not (computed or _LARGE * UNPACKING * one > room):
        return volume, None
    if computed and one <= most:
        one = 0  # it fits into the half for chunks being read

    def read(at: tuple[slice, slice, slice]) -> NDArray[Any]:
        z, y, x = at
        return volume.read((x.start, y.start, z.start), (x.stop, y.stop, z.stop))

    cache = Chunks(read, lines, volume.dtype, most, one=one, source=volume.data)
    made = volume.with_levels(())
    made.data = cache
    return made, cache


def _with_noise(volume: LazyVolume) -> Volume:
    """Samples of the middle, with the noise of the whole volume, by which smoothing is chosen."""
    part = replace(volume.part())
    vars(part)["noise"] = estimate(cast(Any, _Slices(volume)))
    return part


@dataclass(frozen=True)
class _Slices:
    """The samples of a volume by slices, for `estimate`."""

    volume: LazyVolume
    ndim: int = 3

    @property
    def shape(self) -> tuple[int, ...]:
        return self.volume.shape

    def __getitem__(self, place: tuple[slice, slice, slice]) -> NDArray[Any]:
        return self.volume.at(place)


def _room(memory: int | None, volume: LazyVolume) -> int:
    """`memory` without what Zarr and the device take uncounted."""
    if memory is not None and whole("memory", memory, 1) <= FIXED:
        raise OptionError(f"memory must be more than {FIXED >> 20} MiB; got {memory >> 20} MiB")
    given = memory_for(volume, memory)
    return given - FIXED if memory is not None else max(FIXED, given - FIXED)


# -- the plan ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Plan:
    """All that decides what is written."""

    filter: Filter
    boundary: Boundary
    method: Method
    levels: list[Level]
    storage: _Storage
    bounds: bool
    device: Device
    labels: bool

    def filter_at(self, number: int) -> Filter:
        """The filter of a size: smoothing for the first, interpolating for the others."""
        return filter_at(self.filter, number)

    def command(self, volume: LazyVolume) -> dict[str, Any]:
        """What must be the same for another process to resume."""
        grid = volume.grid
        return {
            "version": f"{VERSION}, {self.storage.version}",
            "source": said_of(volume),
            "grid": [*grid.spacing, *grid.origin, *grid.direction.ravel().tolist(), grid.units, volume.missing],
            "filter": self.filter.name,
            "boundary": self.boundary.name,
            "method": self.method,
            "levels": [level.size for level in self.levels],
            "chunks": self.storage.chunks,
            "shards": self.storage.shards,
            "compressor": self.storage.compressor,
            "bounds": self.bounds,
        }


@dataclass(frozen=True)
class _Storage:
    """How arrays are stored."""

    chunks: tuple[int, int, int]
    shards: tuple[int, int, int] | None
    compressor: str
    version: str

    @classmethod
    def of(cls, chunks: int | Sequence[int], shards: int | Sequence[int] | None, compressor: str, version: str) -> _Storage:
        for name, value, allowed in (("compressor", compressor, COMPRESSORS), ("version", version, VERSIONS)):
            if value not in allowed:
                raise one_of(name, value, allowed)
        edges = _edges("chunks", chunks)
        together = None if shards is None else _edges("shards", shards)
        if together is not None and (version == "0.4" or any(s % c for s, c in zip(together, edges, strict=True))):
            raise OptionError(
                f"shards must be whole numbers of chunks along each axis, in version '0.5'; "
                f"got {together} of {edges}, version {version!r}"
            )
        return cls(edges, together, compressor, version)

    @property
    def format(self) -> Literal[2, 3]:
        """Of Zarr."""
        return 3 if self.version == "0.5" else 2

    def options(self, shape: Sequence[int], dtype: np.dtype[Any]) -> dict[str, Any]:
        """Arguments of zarr's `create_array`, of an array [z, y, x, ...]."""
        more = tuple(shape[3:])
        chunks = (*(min(c, n) for c, n in zip(self.chunks[::-1], shape[:3], strict=True)), *more)
        options: dict[str, Any] = {"shape": tuple(shape), "dtype": dtype, "chunks": chunks, "compressors": self._codec(dtype)}
        if self.format == 2:
            return options | {"chunk_key_encoding": {"name": "v2", "separator": "/"}}
        options["dimension_names"] = ["z", "y", "x", *("bound" for _ in more)]
        if self.shards is not None:  # no larger than the whole chunks that hold the array
            options["shards"] = tuple(
                min(s, -(-n // c) * c) // c * c for s, c, n in zip(self.shards[::-1], chunks[:3], shape[:3], strict=True)
            )
        return options

    def _codec(self, dtype: np.dtype[Any]) -> Any:
        if self.compressor == "none":
            return None
        shuffle = "bitshuffle" if dtype.kind in "iu" and dtype.itemsize < 8 else "shuffle"
        level = 1 if self.compressor == "zstd" else 5
        if self.format == 3:
            from zarr.codecs import BloscCodec

            how: Any = {"cname": self.compressor, "shuffle": shuffle}
            return BloscCodec(**how, clevel=level, typesize=dtype.itemsize)
        from numcodecs import Blosc

        return Blosc(cname=self.compressor, clevel=level, shuffle={"shuffle": 1, "bitshuffle": 2}[shuffle])


def _edges(what: str, given: int | Sequence[int]) -> tuple[int, int, int]:
    edges = [given] * 3 if isinstance(given, (int, np.integer)) else several(what, given, "one whole number, or three", 3)
    if len(edges) != 3:
        raise OptionError(f"{what} must be one whole number, or three along x, y and z; got {given!r}")
    x, y, z = (whole(f"each number of {what}", edge, 1, 1 << 14) for edge in edges)
    return x, y, z


# -- writing -----------------------------------------------------------------------------------------------------------


class _Writing:
    """Writes what a plan says, part by part."""

    def __init__(
        self,
        volume: LazyVolume,
        plan: _Plan,
        journal: Journal,
        room: int,
        progress: Callable[[float], object] | None,
        cache: Chunks | None,
    ) -> None:
        try:
            import zarr
        except ImportError as error:
            raise MissingDependencyError('pyramids are Zarr stores, which need zarr: pip install "clvol[microscopy]"') from error
        self._zarr = zarr
        self._volume, self._plan, self._journal, self._room, self._progress = volume, plan, journal, room, progress
        self._cache, self._read_out = cache, False
        self._spent = 0.0
        sizes = [math.prod(level.size) for level in plan.levels]
        self._all = _COST["reduce"] * sum(sizes[:-1] or sizes) + _COST["bounds"] * sum(sizes) * plan.bounds
        self.dtype = volume.dtype.newbyteorder("=")

    def run(self) -> None:
        """Write all parts that are not done yet."""
        storage = self._plan.storage
        root = self._zarr.open_group(self._journal.store, mode="a", zarr_format=storage.format)
        arrays = [self._array(root, str(i), level.shape, self.dtype, storage) for i, level in enumerate(self._plan.levels)]
        reads: list[Callable[[Any], NDArray[Any]]] = [self._of_source, *(array.__getitem__ for array in arrays[1:])]
        if len(arrays) == 1:
            self._copy(arrays[0])
        for number in range(1, len(arrays)):
            self._reduce(number, reads[number - 1], arrays)
        if self._plan.bounds:
            for number, array in enumerate(arrays):
                self._bound(root, number, array)
        for i, array in enumerate(arrays):
            self._keep_one_chunk(str(i), array)
        self._describe(root)

    def _of_source(self, at: tuple[slice, slice, slice]) -> NDArray[Any]:
        z, y, x = at
        part = self._volume.read((x.start, y.start, z.start), (x.stop, y.stop, z.stop))
        return part.astype(self.dtype, copy=False)

    def _array(self, group: Any, name: str, shape: Sequence[int], dtype: np.dtype[Any], storage: _Storage, fill: float = 0) -> Any:
        """An array of the store, created if necessary; `fill` is the value of chunks that are not stored."""
        return group[name] if name in group else group.create_array(name, fill_value=fill, **storage.options(shape, dtype))

    def _advance(self, cost: float) -> None:
        self._spent += cost
        if self._progress is not None:
            self._progress(min(1.0, self._spent / self._all))

    # -- sizes -----------------------------------------------------------------------------------------------------

    def _reduce(self, number: int, read: Callable[[Any], NDArray[Any]], arrays: Sequence[Any]) -> None:
        plan = self._plan
        finer, level = plan.levels[number - 1 : number + 1]
        row = plan.filter_at(number - 1)
        kind: type[np.generic] = np.float64 if wide(self.dtype) and plan.device.has_double else np.float32
        x, y, z = (
            sums_for(plan.method, row.along(axis), plan.boundary, step, n, kind == np.float64)
            for axis, (step, n) in enumerate(zip(level.steps, finer.size, strict=True))
        )
        stored = plan.storage.shards or plan.storage.chunks
        deep = min(stored[2], finer.size[2])
        chunks = self._volume.chunks if number == 1 else None
        if chunks is not None and chunks[2] > deep:  # unpack each chunk of the source once
            deep *= -(-chunks[2] // deep)
        units = (stored[0], stored[1], stored[2])
        what = read, finer, level, (x, y, z), self.dtype, kind, units, deep
        reduction = self._within(lambda room: Reduction(*what, room, plan.device, plan.boundary.cval, self._unpacking))
        copy = arrays[0].__setitem__ if number == 1 else None
        for tile in reduction.tiles():
            blocks = reduction.blocks()
            share = (tile.x[1] - tile.x[0]) * (tile.y[1] - tile.y[0]) / (level.size[0] * level.size[1])
            cost = _COST["reduce"] * math.prod(finer.size) * share / len(blocks)
            names = [f"{number}/{tile.x[0]}-{tile.x[1]}/{tile.y[0]}-{tile.y[1]}/{first}-{last}" for first, last in blocks]
            left = next((k for k, name in enumerate(names) if name not in self._journal), len(names))
            self._advance(cost * left)
            for name, (place, made) in zip(names[left:], reduction.run(tile, blocks[left:], copy), strict=False):
                arrays[number][place] = made
                self._journal.done(name)
                self._advance(cost)
        if self._cache is not None:  # the source is not read again
            self._cache.close()
            self._read_out = True

    @property
    def _unpacking(self) -> int:
        """Bytes for unpacking a large chunk of the source."""
        return self._cache.unpacking_of_one if self._cache is not None and not self._read_out else 0

    @property
    def _held(self) -> int:
        """Bytes for chunks of the source: cached ones, and those being read."""
        return 2 * self._cache.most + self._unpacking if self._cache is not None else 0

    def _within(self, make: Callable[[int], Reduction]) -> Reduction:
        """What `make` returns for the room that the cache leaves; the cache is given up if that is too little."""
        held = self._held
        try:
            return make(self._room - held)
        except OptionError:
            if self._cache is None or not held:
                raise
            self._cache.close()
            return make(self._room - self._unpacking)

    def _copy(self, array: Any) -> None:
        """Copy the source, if it is the only size, in whole chunks."""
        stored = array.shards or array.chunks
        room = self._room - self._held
        several = max(1, int((room / (4 * self.dtype.itemsize * math.prod(stored))) ** (1 / 3)))
        spans = [range(0, n, several * edge) for n, edge in zip(array.shape, stored, strict=True)]
        for z in spans[0]:
            for y in spans[1]:
                for x in spans[2]:
                    name = f"0/{x}/{y}/{z}"
                    ends = [min(a + one.step, n) for a, one, n in zip((z, y, x), spans, array.shape, strict=True)]
                    place = slice(z, ends[0]), slice(y, ends[1]), slice(x, ends[2])
                    if name not in self._journal:
                        array[place] = self._of_source(place)
                        self._journal.done(name)
                    self._advance(_COST["reduce"] * math.prod(one.stop - one.start for one in place))
        if self._cache is not None:
            self._cache.close()

    # -- bounds ----------------------------------------------------------------------------------------------------

    def _bound(self, root: Any, number: int, read: Any) -> None:
        """Write the bounds of a size."""
        plan, level = self._plan, self._plan.levels[number]
        row = plan.filter_at(number)
        edge = Bricks.edge_for(row, self._room)
        lines = lines_of(read)
        assert lines is not None  # it is an array of Zarr
        cached = Chunks(read.__getitem__, lines, read.dtype, self._room - Bricks.bytes_of(row, edge))
        bricks = Bricks(cached.__getitem__, level.size, row, plan.boundary, edge, plan.device)
        dtype = np.dtype(np.float64 if wide(self.dtype) else np.float32)
        shape = (*bricks.count[::-1], 2)
        group = root
        for name in (KEY, "bounds", str(number)):  # zarr would create them with the array; if killed in between, never
            group = group.require_group(name)
        blocks = self._array(root, f"{KEY}/bounds/{number}/0", shape, dtype, self._for_bounds(bricks.edge), fill=np.nan)
        places = list(bricks.places())
        for place in places:
            name = f"bounds/{number}/" + "/".join(f"{a}-{b}" for a, b in place)
            if name not in self._journal:
                values, (low, high) = bricks.bounds(place)
                blocks[tuple(slice(a, b) for a, b in place[::-1])] = outwards(values, dtype)
                self._journal.done(name, low=low, high=high)
            self._advance(_COST["bounds"] * math.prod(level.size) / len(places))
        self._coarsen(root, number, blocks)

    def _for_bounds(self, edge: int) -> _Storage:
        return replace(self._plan.storage, chunks=(edge,) * 3, shards=None)

    def _coarsen(self, root: Any, number: int, blocks: Any) -> None:
        """Write bounds of coarser blocks, each of 2³ of those before; a few slices of blocks at a time."""
        step = 1
        while max(blocks.shape[:3]) > _FEW:
            shape = (*(-(-n // 2) for n in blocks.shape[:3]), 2)
            edge = blocks.chunks[0]
            made = self._array(root, f"{KEY}/bounds/{number}/{step}", shape, blocks.dtype, self._for_bounds(_BLOCKS), fill=np.nan)
            name = f"bounds/{number}/coarser {step}"
            if name not in self._journal:
                deep = max(edge, made.chunks[0])
                for first in range(0, shape[0], deep):
                    made[first : first + deep] = coarser(np.asarray(blocks[2 * first : 2 * (first + deep)]))
                self._journal.done(name)
            blocks, step = made, step + 1

    def _keep_one_chunk(self, name: str, array: Any) -> None:
        """Store a chunk of an array of zeros, to distinguish it from an array that was not copied."""
        folder = self._journal.store / name
        if all(entry.name in ("zarr.json", ".zarray", ".zattrs") for entry in os.scandir(folder)):
            stored = array.with_config({"write_empty_chunks": True})
            stored[tuple(slice(0, edge) for edge in array.shards or array.chunks)] = 0

    # -- metadata --------------------------------------------------------------------------------------------------

    def _describe(self, root: Any) -> None:
        plan, grid = self._plan, self._volume.grid
        unit = ome_unit(grid.units)
        axes = [{"name": axis, "type": "space"} | ({"unit": unit} if unit else {}) for axis in "zyx"]
        straight = np.array_equal(grid.direction, np.eye(3))
        first = np.asarray(grid.origin) if straight else np.linalg.solve(grid.direction, grid.origin)
        datasets = []
        for number, level in enumerate(plan.levels):
            spacing = np.multiply(grid.spacing, level.factors)
            origin = first + np.multiply(grid.spacing, level.offset)
            steps = [
                {"type": "scale", "scale": spacing[::-1].tolist()},
                {"type": "translation", "translation": origin[::-1].tolist()},
            ]
            datasets.append({"path": str(number), "coordinateTransformations": steps})
        how = {
            "least-squares": f"least-squares spline, {plan.filter.name}",
            "average": "mean of 2",
            "nearest": "every second sample",
        }
        multiscales: dict[str, Any] = {"name": grid.name, "axes": axes, "datasets": datasets, "type": how[plan.method]}
        if plan.storage.version == "0.4":
            multiscales["version"] = "0.4"
        ome: dict[str, Any] = {"multiscales": [multiscales]} | ({"version": "0.5"} if plan.storage.version == "0.5" else {})
        ranges = [self._range_of(number) for number in range(len(plan.levels))]
        if plan.labels:
            ome["image-label"] = _label(grid, plan.storage.version)
        elif grid.name or grid.color or grid.clim:
            ome["omero"] = _omero(grid, ranges[0], self.dtype)
        own: dict[str, Any] = {"version": VERSION, "method": plan.method}
        if not straight:
            own["direction"] = grid.direction.tolist()
        if grid.space:
            own["space"] = grid.space
        if self._room >= _STATISTICS and (kept := self._statistics(root, ranges[0])) is not None:
            own["statistics"] = kept
        own["levels"] = [self._level(root, number, found) for number, found in enumerate(ranges)]
        root.attrs.update(({"ome": ome} if plan.storage.version == "0.5" else ome) | {KEY: own})

    def _statistics(self, root: Any, value_range: tuple[float, float] | None) -> dict[str, Any] | None:
        """What automatic looks follow from; None of labels that are too many and too scattered. Writes the samples it has."""
        array, labels = root["0"], self._plan.labels
        found = Statistics.of(array, value_range or _range_of(array), _parts_of(array), labels=labels)
        about = found.json()
        if labels and len(about["labels"]["runs"]) > _RUNS:
            return None
        root.require_group(KEY)  # as of bounds
        made = self._array(root, SAMPLES, found.samples.shape, array.dtype, self._for_bounds(max(found.samples.shape)))
        made[...] = found.samples
        return about

    def _range_of(self, number: int) -> tuple[float, float] | None:
        found = [facts for facts in self._journal.facts(f"bounds/{number}/") if facts]
        return (min(one["low"] for one in found), max(one["high"] for one in found)) if found else None

    def _level(self, root: Any, number: int, value_range: tuple[float, float] | None) -> dict[str, Any]:
        row, plan = self._plan.filter_at(number), self._plan
        about: dict[str, Any] = {"path": str(number), "filter": row.name, "boundary": plan.boundary.name}
        if value_range is not None:
            about["value_range"] = list(value_range)
        if plan.bounds:
            group = root[f"{KEY}/bounds/{number}"]
            about |= {"block": BLOCK, "bounds": [f"{KEY}/bounds/{number}/{i}" for i in range(len(list(group.array_keys())))]}
        return about


def _parts_of(array: Any) -> Iterator[tuple[tuple[slice, ...], NDArray[Any]]]:
    """Samples of an array of Zarr by chunks, and their places."""
    lines, whole = lines_of(array), tuple(slice(0, n) for n in array.shape)
    assert lines is not None  # it is an array of Zarr
    for box in Chunks(array.__getitem__, lines, array.dtype, 0).parts(whole):
        yield box, array[box]


def _range_of(array: Any) -> tuple[float, float]:
    """The smallest and the largest sample of an array of Zarr."""
    ends = [(float(part.min()), float(part.max())) for _, part in _parts_of(array)]
    return min(low for low, _ in ends), max(high for _, high in ends)


def _label(grid: Volume, version: str) -> dict[str, Any]:
    """OME-Zarr's metadata of labels."""
    table = table_of(grid)
    about: dict[str, Any] = {"version": version} if version == "0.4" else {}
    if table:
        about["properties"] = [{"label-value": label, "name": name} for label, name in table.items()]
        about["colors"] = [{"label-value": label, **_rgba(table, label)} for label in table]
    return about


def _rgba(table: LabelTable, label: int) -> dict[str, list[int]]:
    """The colour of a label with its opacity, in eight bits; nothing without a colour."""
    color = table.colors.get(label)
    return {} if color is None else {"rgba": [round(255 * part) for part in (*color, table.opacities.get(label, 1.0))]}


def _omero(grid: Volume, value_range: tuple[float, float] | None, dtype: np.dtype[Any]) -> dict[str, Any]:
    """OME-Zarr's metadata of the only channel."""
    kind = np.iinfo(dtype) if dtype.kind in "iu" else None
    low, high = value_range or ((float(kind.min), float(kind.max)) if kind else (0.0, 1.0))
    start, end = grid.clim or (low, high)
    color = "".join(f"{round(255 * part):02X}" for part in grid.color or (1.0, 1.0, 1.0))
    window = {"min": min(low, start), "max": max(high, end), "start": start, "end": end}
    return {"channels": [{"label": grid.name, "color": color, "window": window, "active": True}]}
