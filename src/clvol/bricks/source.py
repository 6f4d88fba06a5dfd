"""Volumes that are read part by part, when their samples are needed: larger than memory, or far away."""

from __future__ import annotations

import itertools
import math
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from clvol.base import memory
from clvol.base.arrays import reals
from clvol.base.checks import if_image, number, suggests_options, warn, whole
from clvol.base.errors import ChunkError, ClvolError, DataError, FormatError, MissingSampleError, OptionError
from clvol.bricks.chunks import UNPACKING, Chunks, lines_of, stored_in_one
from clvol.bricks.sliced import mapped
from clvol.interop.images import read_grid
from clvol.interop.xarray_images import in_order, is_labelled
from clvol.noise import estimate
from clvol.volume.evenly import Evenly, remember_evenly
from clvol.volume.gridded import Gridded
from clvol.volume.volume import Volume

if TYPE_CHECKING:
    from clvol.bricks.continued import Absent
    from clvol.noise import Noise
    from clvol.volume.statistics import Statistics

__all__ = [
    "BUDGET",
    "Bounds",
    "LazyVolume",
    "Sliced",
    "by_bricks",
    "known_of",
    "may_be_read_ahead",
    "memory_for",
    "needed_by",
    "stored_at",
    "stored_lines",
    "too_large",
]

Index: TypeAlias = tuple[int, int, int]
"""Along x, y and z."""

Box: TypeAlias = tuple[slice, slice, slice]
"""Of an array, [z, y, x]."""

BUDGET = 2 << 30
"""Bytes that work by parts may take where nothing is said."""


class _Gap(NamedTuple):
    """A place, in the part that is read, where a damaged chunk leaves samples out."""

    place: Box
    error: ChunkError
    chunk: tuple[int, ...]


_Gaps: TypeAlias = list[_Gap]

_PREVIEWED = 1 << 21  # samples from which looks are decided, about
_PART = 128  # samples along an edge of the part whose noise is estimated
_CHUNKS_LOOKED_INTO = 6  # along an axis, where there is no smaller copy to look at
_SMALL = 1 << 26  # samples of which all are looked at for their range
_PIECE = 4 << 20  # bytes that are read at a time of what is looked at, unless a chunk has more
_DAMAGED = 64  # chunks that a library cannot read: then the error is not of a chunk
_LEFT_OUT = "pictures leave its samples out, and whatever else needs them is an error"
_ALONE = ("clvol", "h5py", "tensorstore", "zarr")  # whose arrays ask no cluster


@runtime_checkable
class Sliced(Protocol):
    """What samples can be read from: an array of Zarr, HDF5, dask or NumPy, or anything else with a shape and slices."""

    @property
    def shape(self) -> tuple[int, ...]: ...

    @property
    def dtype(self) -> Any: ...

    def __getitem__(self, index: Any, /) -> Any: ...


@runtime_checkable
class Bounds(Protocol):
    """Minima and maxima of the function that a filter makes of samples, kept beside them; see `clvol.pyramid`."""

    @property
    def filter(self) -> str:
        """The name of the filter whose function they bound."""

    @property
    def boundary(self) -> str:
        """The name of the boundary rule."""

    @property
    def value_range(self) -> tuple[float, float]:
        """The smallest and the largest sample."""

    def within(self, low: Index, high: Index) -> tuple[float, float]:
        """The smallest and the largest value in the cells between samples `low` and `high`, or bounds of these."""


class _Placed(Gridded):
    """What a volume says of itself beside its samples: what its grid does."""

    grid: Volume

    @property
    def spacing(self) -> tuple[float, ...]:
        """Between neighbouring samples along x, y and z."""
        return self.grid.spacing

    @property
    def origin(self) -> tuple[float, ...]:
        """World position of the sample with index 0, along x, y and z."""
        return self.grid.origin

    @property
    def direction(self) -> NDArray[np.float64]:
        """Unit vectors of the axes in the world, in columns; shape (3, 3)."""
        return self.grid.direction

    @property
    def units(self) -> str:
        """Of the world."""
        return self.grid.units

    @property
    def name(self) -> str:
        """Of the samples."""
        return self.grid.name


@suggests_options
class LazyVolume(_Placed):
    """A volume whose samples are read part by part, when they are needed.

    It takes the place of a `Volume` for `clvol.render`, `Renderer` and `BrickedField`, which read it by bricks,
    several at a time where several threads ask.

    Parameters
    ----------
    data : array-like, shape (nz, ny, nx)
        Anything with a shape, a dtype and slices: an array of Zarr, HDF5 (h5py), dask, or a memory map of NumPy. It is not copied.
        An array of xarray gives its coordinates, as to `Volume`. A pickle has the name of a mapped file, which whoever loads it
        reads.
    spacing, origin, direction, units, space, name, color, clim, labels : optional
        As of `Volume`.
    levels : sequence of LazyVolume, optional
        The same at lower resolutions, finer ones first: a pyramid without its base.
    limits : (float, float), optional
        The smallest and the largest sample, if these are known. Otherwise they are estimated from what is looked at.
    missing : float, optional
        What stands for samples that are NaN or infinite, or of damaged chunks; without it these are an error once they are read. (A
        picture leaves them out: see `Missing`.)
    bounds : Bounds, optional
        Minima and maxima of the function, if they are kept beside the samples.
    statistics : Statistics, optional
        What an automatic look follows from, if it is kept beside the samples: that of a picture is then that of the whole volume.
        Otherwise it is estimated from `preview` and `part`.

    Attributes
    ----------
    data : array-like
        As it was given.
    grid : Volume
        Where the samples lie. Its own are zeros that take no memory.
    levels : tuple of LazyVolume
        Lower resolutions.
    damaged : bool
        Whether a damaged chunk was met, which a `ClvolWarning` names. Looks, noise and limits are those of the others.

    Raises
    ------
    DataError
        `data` has no shape, dtype and slices, not three axes, an empty axis, 2⁶³ bytes or more, or holds no real numbers; a level
        is no LazyVolume, or one larger than that before.
    FormatError
        `data` does not say what it is: its file was closed.
    GeometryError, OptionError
        As of `Volume`.
    """

    in_parts: ClassVar[bool] = True
    grid: Volume
    where: NDArray[np.bool_] | Absent | None = None
    """Samples that pictures leave out: those that were missing before they were filled."""

    def __init__(
        self,
        data: Sliced,
        spacing: Sequence[float] = (),
        origin: Sequence[float] = (),
        direction: ArrayLike | None = None,
        units: str = "",
        space: str = "",
        name: str = "",
        *,
        color: tuple[float, float, float] | None = None,
        clim: tuple[float, float] | None = None,
        labels: bool | Mapping[int, str] | None = None,
        levels: Sequence[LazyVolume] = (),
        limits: tuple[float, float] | None = None,
        missing: float | None = None,
        bounds: Bounds | None = None,
        statistics: Statistics | None = None,
    ) -> None:
        known: dict[str, Any] = {}
        if is_labelled(data):
            data, known = in_order(data), read_grid(data)[1]
        shape, dtype = _described(data)
        self.data = data
        self.missing = None if missing is None else number("missing", missing)
        self.bounds = bounds
        self.statistics = statistics
        self.levels = tuple(levels)
        self._damage: dict[tuple[int, ...], str] = {}
        self._again: Callable[[], LazyVolume] | None = None
        self._for_tasks = False
        self._lock = threading.RLock()
        self._limits = None if limits is None else _ends(limits)
        self._given = limits is not None
        self._preview: Volume | None = None
        self._part: Volume | None = None
        given = {"spacing": tuple(spacing), "origin": tuple(origin), "units": units, "space": space, "name": name}
        known |= {key: value for key, value in given.items() if value}
        others = {"direction": direction, "color": color, "clim": clim, "labels": labels}
        known |= {key: value for key, value in others.items() if value is not None}
        self.grid = Volume(np.broadcast_to(np.zeros((), dtype), shape), **known)
        _require_smaller((self, *self.levels))

    def with_levels(self, levels: Sequence[LazyVolume]) -> LazyVolume:
        """The same with other lower resolutions, finer ones first.

        Raises
        ------
        DataError
            As of the class.
        """
        made = object.__new__(LazyVolume)
        made.__dict__.update(self.__dict__)
        made.levels, made._lock, made._preview = tuple(levels), threading.RLock(), None
        _require_smaller((made, *made.levels))
        return made

    def reopened_by(self, again: Callable[[], LazyVolume]) -> LazyVolume:
        """The same, which pickles as what opens it again, and so do its levels."""
        made = self.with_levels([_opened(level, partial(_level_of, again, i)) for i, level in enumerate(self.levels)])
        made._again = again
        return made

    def as_known(self, limits: tuple[float, float], labels: bool) -> LazyVolume:
        """The same, of which is known what was found elsewhere: its limits, and whether its samples are labels."""
        made = self.with_levels(self.levels)
        made._limits = limits
        if made.grid.labels is None:
            made.grid = replace(made.grid, labels=labels)
        return made

    def for_tasks(self) -> LazyVolume:
        """The same for tasks of a cluster of dask.

        These compute samples of an array of dask by themselves: left to the cluster, they would wait for tasks that wait for them.

        Raises
        ------
        DataError
            The array holds futures (`dask.persist`), which only the cluster can give.
        """
        _require_no_futures(self)
        made = self.with_levels([level.for_tasks() for level in self.levels])
        if hasattr(self.data, "for_tasks"):  # it reads other volumes
            made.data = self.data.for_tasks()
            made.where, made._again = getattr(made.data, "absent", None), None
        made._for_tasks = True
        return made

    @property
    def in_memory(self) -> bool:
        """Whether a pickle holds all samples: they lie in memory, not in a file that is opened again."""
        return self._again is None and isinstance(self.data, np.ndarray) and mapped(self.data) is None

    def __repr__(self) -> str:
        smaller = f", {len(self.levels)} smaller" if self.levels else ""
        units = f" {self.units}" if self.units else ""
        return f"<LazyVolume of shape {self.shape}, {self.dtype}, spacing {self.spacing}{units}{smaller}>"

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Of a file what opens it again; of an array what pickles that."""
        return super().__reduce_ex__(protocol) if self._again is None else (self._again, ())

    def __getstate__(self) -> dict[str, Any]:
        """What a pickle holds: no samples but what the array itself pickles, and of a file that is mapped its name."""
        state = {name: value for name, value in vars(self).items() if name not in ("_lock", "_preview", "_part")}
        data = mapped(self.data, flushed=True) or self.data
        return state | {"grid": replace(self.grid, data=np.zeros((1, 1, 1), self.dtype)), "data": data}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._lock, self._preview, self._part = threading.RLock(), None, None
        self.grid = replace(self.grid, data=np.broadcast_to(np.zeros((), self.grid.data.dtype), tuple(self.data.shape)))

    @property
    def shape(self) -> tuple[int, ...]:
        """Samples along z, y and x."""
        return self.grid.shape

    @property
    def dtype(self) -> np.dtype[Any]:
        """Of the samples."""
        return self.grid.data.dtype

    @property
    def nbytes(self) -> int:
        """Of all samples, once they are read."""
        return math.prod(self.shape) * self.dtype.itemsize

    @property
    def chunks(self) -> Index | None:
        """Samples along x, y and z that are stored together; None where any part is read as fast."""
        with _reading(f"the chunks of {_title(self)}"):
            stored = getattr(self.data, "chunksize", None) or getattr(self.data, "chunks", None)
        if stored is None or len(stored) != 3 or not all(isinstance(n, (int, np.integer)) and n > 0 for n in stored):
            return None
        x, y, z = (int(n) for n in stored[::-1])
        return x, y, z

    # -- samples ---------------------------------------------------------------------------------------------------------

    def read(self, low: Index, high: Index) -> NDArray[Any]:
        """The samples with index ``low <= index < high``, (x, y, z), as an array [z, y, x].

        Raises
        ------
        FormatError
            They cannot be read, or what comes has another shape or type than was said; the message names the part or chunk.
        DataError
            Some are NaN or infinite, and nothing stands for `missing` ones.
        """
        if not all(0 <= a < b <= n for a, b, n in zip(low, high, self.size, strict=True)):
            raise OptionError(f"read needs 0 <= low < high <= {self.size} along x, y, z; got {low} to {high}")
        z, y, x = (slice(a, b) for a, b in zip(low[::-1], high[::-1], strict=True))
        return self.at((z, y, x))

    def at(self, place: Box) -> NDArray[Any]:
        """As `read`, the samples at three slices within the volume, [z, y, x]."""
        try:
            return _samples_at(self, place)
        except ChunkError as error:
            return _filled_at(self, place, error)

    def as_is(self, place: Box) -> NDArray[Any]:
        """As `at`, with NaN and infinities that nothing stands for."""
        return self.at(place) if self.missing is not None else _samples_at(self, place, finite=False)

    # -- what is known of them -------------------------------------------------------------------------------------------

    def preview(self) -> Volume:
        """Few samples of all the volume, from which looks are decided: a lower resolution, or every n-th sample.

        About 2²¹ samples. Of a volume without levels few chunks are read, at equal distances.
        """
        with self._lock:
            if self._preview is None:
                small = next((one for one in (self, *self.levels) if math.prod(one.shape) <= 2 * _PREVIEWED), None)
                coarse = small or (self, *self.levels)[-1]
                self._preview = self._informed(_thinned(coarse) if small is None else _of_all(small))
                _remember_samples(self, self._preview)
            return self._preview

    def whole(self) -> Volume:
        """All samples, in memory.

        Raises
        ------
        OutOfMemoryError
            There is no room for them.
        """
        return replace(self.grid, data=self.at(_everything(self)))

    def part(self) -> Volume:
        """Neighbouring samples from the middle, from which is told how much noise there is, and whether they are labels."""
        with self._lock:
            if self._part is None:
                low = [max(0, (n - _PART) // 2) for n in self.size]
                high = [min(n, a + _PART) for a, n in zip(low, self.size, strict=True)]
                self._part = self._informed(_of_part(self, low, high))
            return self._part

    def _informed(self, some: Volume) -> Volume:
        """Some of the samples, with what is known of all."""
        return some if self.statistics is None else self.statistics.known_to(some)

    @property
    def limits(self) -> tuple[float, float]:
        """The smallest and the largest sample: as given, else of the bounds, else of those that were looked at."""
        with self._lock:
            if self._limits is None:
                self._limits = _limits_of(self)
            return self._limits

    @property
    def value_range(self) -> tuple[float, float]:
        """The smallest and the largest sample that are finite: `limits`, for all must be."""
        return self.limits

    @property
    def estimated(self) -> bool:
        """Whether `limits` are those of the samples that were looked at: others may lie beyond."""
        whole = math.prod(self.shape) <= 2 * _PREVIEWED or _few(self)
        return not (whole or self._given or self.bounds is not None or self.statistics is not None)

    @property
    def damaged(self) -> bool:
        """Whether a damaged chunk was met."""
        return bool(self._damage)

    @property
    def damages(self) -> tuple[str, ...]:
        """What is wrong with each damaged chunk that was met."""
        return tuple(self._damage.values())

    @property
    def noise(self) -> Noise:
        """Of all samples, if it is kept beside them, else of those in the middle; the spectrum is of the latter."""
        return _noise_of(self)

    @property
    def is_labels(self) -> bool:
        """Whether samples are names of regions: as `labels` says, else as those in the middle look."""
        return self.part().is_labels if self.grid.labels is None else bool(self.grid.is_labels)

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        raise DataError("a LazyVolume becomes no array by accident: take .whole().data for all samples, or read(low, high)")


def _samples_at(volume: LazyVolume, place: Box, *, finite: bool = True) -> NDArray[Any]:
    """As `LazyVolume.at`, but nothing stands for damaged chunks."""
    z, y, x = place
    words = f"samples [{z.start}:{z.stop}, {y.start}:{y.stop}, {x.start}:{x.stop}] of {_title(volume)}"
    expected = tuple(one.stop - one.start for one in place)
    memory.require(math.prod(expected) * volume.dtype.itemsize, words)
    with _reading(words):
        part = stored_at(volume, place)
    if part.shape != expected or part.dtype != volume.dtype:
        raise FormatError(
            f"cannot read {words}: they must be {volume.dtype} of shape {expected}; got {part.dtype} of shape {part.shape}"
        )
    return _finite(part, volume.missing, words, place) if finite else part


def stored_at(volume: LazyVolume, place: Box) -> NDArray[Any]:
    """The samples at a place as they are stored; whatever a library raises is not caught."""
    found = volume.data[place]
    if volume._for_tasks and _is_of_dask(found):
        found = found.compute(scheduler="synchronous")
    part = np.asarray(found)
    return part.astype(part.dtype.newbyteorder("="), copy=False)


def _filled_at(volume: LazyVolume, place: Box, error: ChunkError) -> NDArray[Any]:
    """As `LazyVolume.at`, where a chunk is damaged."""
    if volume.missing is None:
        raise ChunkError(f"{error}: LazyVolume(..., missing=value) replaces them") from error
    part, gaps = _piecewise(volume, partial(_samples_at, volume), [place], place)
    _note(volume, gaps, _LEFT_OUT if math.isnan(volume.missing) else f"{volume.missing:g} stands for their samples")
    for gap in gaps:
        part[gap.place] = volume.missing
    return part


@contextmanager
def _reading(what: str) -> Iterator[None]:
    """Turn whatever a library, a disk or a network raises into a `FormatError` that says what cannot be read."""
    try:
        yield
    except FormatError as error:
        raise type(error)(f"cannot read {what}: {error}") from error
    except (ClvolError, MemoryError):
        raise
    except Exception as error:
        raise ChunkError(f"cannot read {what}: {str(error) or type(error).__name__}") from error


def _title(volume: LazyVolume) -> str:
    return volume.name or "the volume"


def _described(data: Sliced) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape and dtype of what a volume is to be read from; an error if it can be none."""
    with _reading("shape and dtype of data"):
        if not isinstance(data, Sliced):
            raise DataError(f"data must have a shape, a dtype and slices; got {type(data).__name__}")
        shape, dtype = tuple(data.shape), np.dtype(data.dtype).newbyteorder("=")
    if len(shape) != 3 or any(n != n // 1 for n in shape):  # dask does not know all sizes: nan
        raise DataError(f"data must have 3 axes [z, y, x] of known sizes; got shape {shape}{if_image(shape)}")
    if dtype.kind not in "biuf":
        raise DataError(f"data must be boolean, integer or floating; got dtype {dtype}")
    if 0 in shape:
        raise DataError(f"every axis of data must hold at least one sample; got shape {shape}")
    if math.prod(map(int, shape)) * dtype.itemsize > sys.maxsize:  # of an array of NumPy, as `grid` has one
        raise DataError(f"data must take less than 2⁶³ bytes; got shape {shape} of {dtype}")
    return shape, dtype


def _require_smaller(sizes: Sequence[LazyVolume]) -> None:
    """Raise `DataError` unless each is a LazyVolume no larger than that before."""
    for finer, coarser in itertools.pairwise(sizes):
        if not isinstance(coarser, type(finer)):
            raise DataError(f"levels must be LazyVolumes; got {type(coarser).__name__}")
        if any(a < b for a, b in zip(finer.shape, coarser.shape, strict=True)):
            raise DataError(f"levels must become smaller; got shapes {finer.shape} and then {coarser.shape}")


def _require_no_futures(volume: LazyVolume) -> None:
    if not _is_of_dask(volume.data):
        return
    from distributed import futures_of

    if futures_of(volume.data):  # type: ignore[no-untyped-call]  # as distributed has it
        raise DataError(
            f"samples must be computed where a cluster's tasks read them; got {volume.name or 'a volume'}, an array of dask "
            "that holds futures of a cluster: give it as it was before persist(), or store it (to_zarr) and clvol.open that"
        )


def _finite(part: NDArray[Any], missing: float | None, words: str, place: Box) -> NDArray[Any]:
    """The samples at a place, with `missing` in place of those that are not finite."""
    if part.dtype.kind != "f" or (np.isfinite(part.min()) and np.isfinite(part.max())):
        return part
    if missing is None:
        bad = ~np.isfinite(part)
        at = np.unravel_index(int(np.argmax(bad)), part.shape)
        first = [int(i) + one.start for i, one in zip(at, place, strict=True)]
        raise MissingSampleError(
            f"samples must be finite; got {int(bad.sum())} NaN or infinite of {words}, the first at index "
            f"{first}: LazyVolume(..., missing=value) replaces them, and pictures leave them out"
        )
    return np.where(np.isfinite(part), part, part.dtype.type(missing))


def _pieces(volume: LazyVolume, place: Box) -> Iterator[Box]:
    """A part as boxes of few samples: of chunks, or of planes."""
    lines: Sequence[NDArray[np.int64]] | None = lines_of(volume.data)
    if lines is None:  # rows, or as many planes as are one piece
        _, y, x = place
        row = (x.stop - x.start) * volume.dtype.itemsize
        rows = max(1, min(_PIECE // row, y.stop - y.start))
        planes = max(1, _PIECE // (row * (y.stop - y.start)))
        steps = (planes, rows, x.stop)
        lines = [np.append(np.arange(one.start, one.stop, n), one.stop) for one, n in zip(place, steps, strict=True)]
    return Chunks(volume.at, lines, volume.dtype, 0, together=_PIECE).parts(place)  # type: ignore[return-value]  # three


def _intact(volume: LazyVolume, read: Callable[[Box], NDArray[Any]], box: Box, gaps: _Gaps) -> Iterator[tuple[Box, NDArray[Any]]]:
    """The samples of a box, of each chunk for itself if not all can be read; `gaps` gets the others."""
    try:
        samples = read(box)
    except ChunkError as error:
        lines = lines_of(volume.data)
        if lines is None or _too_many(volume, gaps, error):
            raise
        cuts = [
            np.unique([one.start, one.stop, *line[(line > one.start) & (line < one.stop)]])
            for one, line in zip(box, lines, strict=True)
        ]
        z, y, x = ([slice(int(a), int(b)) for a, b in itertools.pairwise(cut)] for cut in cuts)
        chunks = list(itertools.product(z, y, x))
        if len(chunks) == 1:
            gaps.append(_Gap(box, error, _chunk_at(lines, box)))
            return
    else:
        yield box, samples
        return
    for chunk in chunks:
        yield from _intact(volume, read, chunk, gaps)


def _too_many(volume: LazyVolume, gaps: _Gaps, error: ChunkError) -> bool:
    """Whether so many chunks fail, by what a library says, that its disk or server is out of reach; nothing stands for them."""
    return len(gaps) >= _DAMAGED and volume.missing is None and not isinstance(error.__cause__, ClvolError)


def _chunk_at(lines: Sequence[NDArray[np.int64]] | None, place: Box) -> tuple[int, ...]:
    """The chunk of a place in it: its number along each axis."""
    first = [one.start for one in place]
    return tuple(first if lines is None else [int(np.searchsorted(a, n, "right")) - 1 for a, n in zip(lines, first, strict=True)])


def _piecewise(
    volume: LazyVolume, read: Callable[[Box], NDArray[Any]], boxes: Iterable[Box], place: Box
) -> tuple[NDArray[Any], _Gaps]:
    """The samples of a part, read box by box, and where damaged chunks left gaps in it."""
    data = np.empty([one.stop - one.start for one in place], volume.dtype)
    gaps: _Gaps = []
    for box in boxes:
        for part, samples in _intact(volume, read, box, gaps):
            data[_from(part, place)] = samples
    return data, [gap._replace(place=_from(gap.place, place)) for gap in gaps]


def _note(volume: LazyVolume, gaps: _Gaps, instead: str) -> None:
    """Warn of damaged chunks that were not met before."""
    new = {gap.chunk: str(gap.error) for gap in gaps if gap.chunk not in volume._damage}
    volume._damage.update(new)
    if new:
        more = f", and {len(new) - 1} more chunks" if len(new) > 1 else ""
        warn(f"{next(iter(new.values()))}{more}; {instead}")


def _note_look(volume: LazyVolume, data: NDArray[Any], gaps: _Gaps) -> None:
    """The same for samples that are looked at; raise if there are none."""
    if sum(data[gap.place].size for gap in gaps) == data.size:
        raise gaps[0].error
    _note(volume, gaps, f"{_LEFT_OUT}; limits, noise and looks are those of the others")


def _from(box: Box, place: Box) -> Box:
    """A box, counted from where a place begins."""
    z, y, x = (slice(a.start - b.start, a.stop - b.start) for a, b in zip(box, place, strict=True))
    return z, y, x


def _bridged(data: NDArray[Any], gaps: _Gaps) -> NDArray[Any]:
    """The same with the nearest other sample in gaps."""
    if not gaps:
        return data
    from scipy.ndimage import distance_transform_edt  # slow to import, and rarely needed

    missing = np.zeros(data.shape, bool)
    for gap in gaps:
        missing[gap.place] = True
    return np.asarray(data[tuple(distance_transform_edt(missing, return_distances=False, return_indices=True))])


def _everything(volume: LazyVolume) -> Box:
    nz, ny, nx = volume.shape
    return slice(0, nz), slice(0, ny), slice(0, nx)


def _of_all(volume: LazyVolume) -> Volume:
    """All samples of a small volume."""
    place = _everything(volume)
    data, gaps = _piecewise(volume, volume.as_is, _pieces(volume, place), place)
    _note_look(volume, data, gaps)
    return replace(volume.grid, data=_bridged(data, gaps))


def _of_part(volume: LazyVolume, low: Sequence[int], high: Sequence[int]) -> Volume:
    """The samples of a part, or of a large box in it that no damaged chunk meets."""
    z, y, x = (slice(a, b) for a, b in zip(low[::-1], high[::-1], strict=True))
    data, gaps = _piecewise(volume, volume.as_is, _pieces(volume, (z, y, x)), (z, y, x))
    _note_look(volume, data, gaps)
    kept = [slice(0, n) for n in data.shape]
    for gap, *_ in gaps:
        if all(a.start < b.stop and b.start < a.stop for a, b in zip(gap, kept, strict=True)):
            sides = [
                [*kept[:axis], side, *kept[axis + 1 :]]
                for axis in range(3)
                for side in (slice(kept[axis].start, gap[axis].start), slice(gap[axis].stop, kept[axis].stop))
            ]
            kept = max(sides, key=lambda box: math.prod(max(0, one.stop - one.start) for one in box))
    if any(one.start >= one.stop for one in kept):
        raise gaps[0].error
    return replace(volume.grid, data=data[tuple(kept)])


def _remember_samples(volume: LazyVolume, preview: Volume) -> None:
    """Fit cameras to the samples that are kept for that, and not to those of a preview."""
    if volume.statistics is not None and volume.statistics.samples is not None:
        remember_evenly(preview, Evenly(np.asarray(volume.statistics.samples[:, :, :]), volume.grid))


def _noise_of(volume: LazyVolume) -> Noise:
    found = volume.part().noise
    if volume.statistics is None or volume.statistics.noise is None:
        return found
    return replace(found, spectrum=estimate(volume.part().data).spectrum)


def _thinned(volume: LazyVolume) -> Volume:
    """Samples at about equal distances, of a few chunks."""
    edge = (_PREVIEWED / math.prod(volume.shape)) ** (1 / 3)
    runs, steps = [], []
    for n, chunk in zip(volume.size, volume.chunks or (volume.size[0], 1, 1), strict=True):
        wanted = max(1, min(n, round(n * edge)))
        several = min(-(-n // chunk), _CHUNKS_LOOKED_INTO if volume.chunks else wanted)
        firsts = [int((k + 0.5) * -(-n // chunk) / several) * chunk for k in range(several)]
        each = max(1, wanted // several)
        step = -(-min(chunk, n) // each)
        runs.append([range(first, min(first + chunk, n), step) for first in firsts])
        steps.append(n / sum(map(len, runs[-1])))
    ends = [list(itertools.accumulate(map(len, axis), initial=0)) for axis in runs[::-1]]
    data, gaps = np.empty([axis[-1] for axis in ends], volume.dtype), _Gaps()
    planes, rows, columns = ([slice(a, b) for a, b in itertools.pairwise(axis)] for axis in ends)
    for target, (z, y, x) in zip(itertools.product(planes, rows, columns), itertools.product(*runs[::-1]), strict=True):
        place = slice(z[0], z[-1] + 1), slice(y[0], y[-1] + 1), slice(x[0], x[-1] + 1)
        try:
            part = volume.as_is(place)
            data[target] = part[:: z.step, :: y.step, :: x.step]
        except ChunkError as error:
            if _too_many(volume, gaps, error):
                raise
            gaps.append(_Gap(target, error, _chunk_at(lines_of(volume.data), place)))
    _note_look(volume, data, gaps)
    spacing = tuple(s * step for s, step in zip(volume.spacing, steps, strict=True))
    first = volume.index_to_world([(step - 1) / 2 for step in steps])  # of the same domain
    return replace(volume.grid, data=_bridged(data, gaps), spacing=spacing, origin=tuple(map(float, first)))


def _few(volume: LazyVolume) -> bool:
    """Whether all samples are looked at for their range."""
    return math.prod(volume.shape) <= _SMALL and volume.chunks is None


def known_of(volume: LazyVolume) -> Volume:
    """The grid, with what is known of the samples, which are none: their limits, whether they are labels."""
    low, high = volume.limits
    known = replace(volume.grid, labels=volume.is_labels if volume.grid.labels is None else volume.grid.labels)
    vars(known).update(limits=(low, high), value_range=(low, high))  # in place of what its own samples would give
    return known


def may_be_read_ahead(volume: LazyVolume) -> bool:
    """Whether threads may read ahead: in a cluster only what is known not to ask that, which must be done by the task."""
    known = volume._again is not None or isinstance(volume.data, np.ndarray) or _is_of_dask(volume.data)
    return known or not volume._for_tasks or type(volume.data).__module__.partition(".")[0] in _ALONE


def _limits_of(volume: LazyVolume) -> tuple[float, float]:
    """The smallest and the largest sample: of the bounds, else of those that are looked at."""
    if volume.bounds is not None:
        return volume.bounds.value_range
    if volume.statistics is not None:
        return volume.statistics.value_range
    if not _few(volume):
        return volume.preview().value_range
    ends = [volume.preview().value_range]  # some are finite
    for box in _pieces(volume, _everything(volume)):
        part = volume.as_is(box)
        low, high = float(part.min()), float(part.max())  # far faster than selecting finite samples
        if not (math.isfinite(low) and math.isfinite(high)):
            there = part[np.isfinite(part)]
            low, high = (float(there.min()), float(there.max())) if there.size else ends[0]
        ends.append((low, high))
    return min(low for low, _ in ends), max(high for _, high in ends)


def stored_lines(volume: LazyVolume) -> tuple[NDArray[np.int64], ...] | None:
    """Where chunks begin along z, y and x, and where the last one ends; None if there are none, or all is in memory."""
    with _reading(f"the chunks of {_title(volume)}"):
        return None if isinstance(volume.data, np.ndarray) else lines_of(volume.data)


def _is_of_dask(data: Any) -> bool:
    """Whether it is an array of dask, or holds one, as xarray's do."""
    graph = getattr(data, "__dask_graph__", None)
    return graph is not None and graph() is not None


def _opened(volume: LazyVolume, again: Callable[[], LazyVolume]) -> LazyVolume:
    made = volume.with_levels(volume.levels)
    made._again = again
    return made


def _level_of(again: Callable[[], LazyVolume], number: int) -> LazyVolume:
    return again().levels[number]


def _ends(limits: Any) -> tuple[float, float]:
    ends = reals("limits", limits, "the smallest and the largest sample")
    if ends.shape != (2,) or not np.isfinite(ends).all() or ends[0] > ends[1]:
        raise OptionError(f"limits must be the smallest and the largest sample, finite; got {limits!r}")
    return float(ends[0]), float(ends[1])


def memory_for(volume: LazyVolume, given: int | None, sharing: int = 1) -> int:
    """Bytes that work on a volume may take: as given, else 2 GiB, or half of the memory that is available if that is less.

    Where a chunk takes much of these to be unpacked they are more by that, up to all that is available. `sharing` is how many
    processes share them.

    Raises
    ------
    OptionError
        Chunks cannot be unpacked in so many; nothing has been read.
    """
    with _reading(f"the chunks of {_title(volume)}"):  # the largest of all sizes is unpacked as a whole
        one = max(stored_in_one(size.data) for size in (volume, *volume.levels))
    least = (UNPACKING + 1) * one  # what looks at it takes it as a whole
    if given is None:
        room = memory.available() // sharing
        budget = max(1, min(BUDGET // sharing, room // 2))
        if 2 * least > budget:
            budget = max(budget, min(budget + least, room))
    else:
        budget = whole("memory", given, 1)
    if least > max(budget, _PIECE):  # less does not count beside a brick
        raise OptionError(
            f"memory must be at least {least} bytes, which a chunk of {_title(volume)} takes that is unpacked as a "
            f"whole, to {one} bytes; got {budget}: clvol.pyramid, given that much once, makes a store of small chunks"
        )
    return budget


def needed_by(volume: LazyVolume) -> int:
    """Bytes of all samples, and of their coefficients."""
    return volume.nbytes + 4 * math.prod(volume.shape)


def too_large(volume: LazyVolume, room: float | None = None) -> bool:
    """Whether samples and coefficients need more than `room`, by default half of the memory that is available."""
    return needed_by(volume) > (memory.available() / 2 if room is None else room)


def by_bricks(volume: LazyVolume, *, several: bool = True, most: int | None = None) -> bool:
    """Whether pictures of what is stored are made by bricks, and not read as one: it has several sizes, or is too large.

    `several` says whether sizes count, none having been chosen; `most` is what bricks may take, in bytes.
    """
    return (several and bool(volume.levels)) or too_large(volume) or (most is not None and too_large(volume, most))
