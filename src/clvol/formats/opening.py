"""`open` reads the metadata of a volume now, and its samples on demand."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike

from clvol.base.checks import as_path, suggests_options
from clvol.base.errors import DataError, FormatError, GeometryError, OptionError
from clvol.bricks.source import LazyVolume
from clvol.formats import FORMATS, Format, Limits, allowed, called, format_of, options_of, zarr
from clvol.formats._choice import Choice, Pick
from clvol.formats._errors import foreign_errors
from clvol.formats.reading import LabelSource, misplaced, replacing, sorted_out
from clvol.formats.zarr.addresses import said, shown
from clvol.interop.kinds import Content
from clvol.volume.provenance import note
from clvol.volume.volume import Volume
from clvol.volume.volumes import Leading

__all__ = ["WholeOnlyError", "open", "opened", "opened_if"]

_OFF = 1.5  # samples between the ends of a level and of the finest: shapes are rounded, and many writers put the first samples of
# all levels at one place, though they are means


@suggests_options
def open(  # noqa: A001  # as files are opened: clvol.open
    path: str | os.PathLike[str],
    *,
    volume: int | None = None,
    time: int | None = None,
    channel: int | str | None = None,
    position: int | None = None,
    series: int | str | None = None,
    level: int | None = None,
    shape: Sequence[int] | None = None,
    dtype: DTypeLike | None = None,
    spacing: Sequence[float] | None = None,
    origin: Sequence[float] | None = None,
    direction: ArrayLike | None = None,
    labels: LabelSource | None = None,
    byte_order: str | None = None,
    offset: int = 0,
    missing: float | None = None,
    storage_options: Mapping[str, Any] | None = None,
    trusted: bool = False,
    limits: Limits | None = None,
) -> LazyVolume:
    """Open a volume to read it part by part: one larger than memory, or a remote one.

    Parameters
    ----------
    path : path-like or address
        Zarr 2 and 3 and OME-Zarr (a folder or ``.zarr.zip``), TIFF, HDF5, netCDF, MINC and Imaris; NIfTI, Analyze, NRRD,
        MetaImage, MRC, binary ``.vtk``, ``.npy`` and raw samples that are not packed. Or the
        address of a Zarr store: ``s3://...`` and ``https://...`` (extra ``s3``), ``memory://...`` and others that fsspec supports.
        The query of an HTTP address (after ``?``, such as a token) goes with every request.
    volume, time, channel, position, series, shape, dtype, byte_order, offset : optional
        As of `clvol.read`.
    level : int, optional
        The first of the stored levels, by default 0, the largest. The coarser ones become `LazyVolume.levels`.
    spacing, origin, direction : optional
        Replace the file's geometry of the largest level; the others move with it.
    labels : bool, path-like or mapping, optional
        As of `clvol.read`.
    missing : float, optional
        Replaces samples that are NaN or infinite, which otherwise are an error when they are read.
    storage_options : mapping, optional
        For an address, as of ``fsspec.open``: ``{"anon": True}`` for public buckets of S3. Messages do not show them; a pickle has
        them, for it opens the store again. Timeouts are options too: for S3
        ``{"config_kwargs": {"connect_timeout": 2, "read_timeout": 5, "retries": {"max_attempts": 1}}}``, in seconds.
    trusted : bool, optional
        Whether the file is trusted. The metadata of an untrusted one are first read in a child process, within `limits`: if they
        crash or hang a library, that is an error. Samples are always decoded in this process, by zarr, tifffile and h5py: use
        `clvol.read` for strangers' files.
    limits : Limits, optional
        For reading the metadata.

    Returns
    -------
    LazyVolume
        With all stored levels, and the `Bounds` that `clvol.pyramid` wrote.

    Warns
    -----
    ClvolWarning
        As of `clvol.read`.

    Raises
    ------
    FormatError
        As of `clvol.read`; the format can only be read whole; the store holds no samples; levels do not lie at one place.
    DataError, GeometryError, OptionError, MissingDependencyError
        As of `clvol.read`.

    Notes
    -----
    A part that cannot be read raises a `FormatError` that names its samples, and for Zarr the chunk. A chunk that is not stored has
    the array's fill value, as Zarr defines it; without a fill value it is an error. So is a file that changes after it was opened,
    or a chunk, as far as times of files and folders show it; the metadata of a remote store are compared every ten seconds, and
    when a chunk is missing. "Stores larger than memory" in the documentation lists which changes are noticed.

    Examples
    --------
    >>> volume = clvol.open("brain.ome.zarr")
    >>> part = volume.read((0, 0, 0), (64, 64, 64))
    >>> volume = clvol.open("s3://bucket/cells.zarr", channel="DAPI", storage_options={"anon": True})
    """
    arguments = {name: value for name, value in locals().items() if name != "path"}
    choices, given, replaced = sorted_out(arguments)
    again = arguments | {"labels": replaced.get("labels")}  # not the path of a table, which may be relative
    choice = Choice(choices)
    held_to = allowed(trusted, limits)
    if isinstance(path, str) and "://" in path:
        chosen = next(one for one in FORMATS if one.read is zarr.read)
        options = options_of(chosen, Path(path), given)
        name = shown(path)
        if "::" not in path and name.lower().endswith(tuple(suffix for row in FORMATS for suffix in row.suffixes)):
            raise FormatError(f"{name} must be a Zarr store, for these alone are read by their address; download the file first")
        with foreign_errors(f"open {name}", partial(said, address=path, options=storage_options)):
            contents = zarr.lazily(path, _Once(choice.given), **options, storage_options=storage_options)
        lazy = opened(name, contents, replaced, missing).reopened_by(partial(open, path, **again))
        note(lazy, name, arguments)
        return lazy
    if storage_options is not None:
        raise OptionError(f"storage_options are for addresses, as s3://bucket/cells.zarr; got the path {path}")
    file = as_path(path)
    chosen = format_of(file)
    options = options_of(chosen, file, given)
    lazily = chosen.lazily
    if lazily is None:
        raise _whole_only(file, chosen)
    if held_to is not None and chosen.native:
        called(chosen.name, chosen.native, file, held_to, _look, lazily, file, choice, options)
    with foreign_errors(f"open {file}"):
        contents = lazily(file, _Once(choice.given), **options)
    if not contents:
        raise _whole_only(file, chosen)
    lazy = opened(str(file), contents, replaced, missing).reopened_by(partial(open, file.absolute(), **again))
    note(lazy, file, arguments)
    return lazy


def opened_if(path: str | os.PathLike[str], wanted: Callable[[LazyVolume], bool], **options: Any) -> LazyVolume | None:
    """The opened volume, if it is remote or `wanted` returns True for it; else None, and `clvol.read` should read it.

    None also if it cannot be opened: `clvol.read` reads it, or says what is wrong.
    """
    if "://" in str(path):
        return open(path, **options)
    if not format_of(as_path(path)).lazily:
        return None
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        try:
            lazy = open(path, **options)
        except (DataError, FormatError, GeometryError):
            return None
    if not wanted(lazy):
        return None
    for one in warned:
        warnings.warn_explicit(one.message, one.category, one.filename, one.lineno)
    return lazy


def _look(lazily: Callable[..., list[Content]], path: Path, choice: Choice, options: Mapping[str, Any]) -> None:
    """Read the metadata once, in a child process."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the second reading, in this process, will warn
        lazily(path, choice, **options)


class WholeOnlyError(FormatError):
    """A file that can only be read whole."""


def _whole_only(path: Path, chosen: Format) -> WholeOnlyError:
    return WholeOnlyError(
        f"{path} must be of a format that is read part by part, and not packed as a whole; it is read as: {chosen.name}: "
        "clvol.read reads it whole, "
        "clvol.pyramid makes a Zarr store of it"
    )


@dataclass(frozen=True)
class _Once(Choice):
    """Makes the same choice for all levels, and warns once."""

    _picked: list[tuple[Leading, Pick]] = field(default_factory=list)

    def __call__(self, source: str, leading: Leading, guessed: str = "") -> Pick:
        if not self._picked:
            self._picked.append((leading, super().__call__(source, leading, guessed)))
        first, pick = self._picked[0]
        if (first.axes, first.counts) != (leading.axes, leading.counts):
            raise FormatError(f"{source} must hold the same volumes in all sizes; it holds {first} in one, {leading} in another")
        return pick


def opened(name: str, contents: Sequence[Content], replaced: dict[str, Any], missing: float | None) -> LazyVolume:
    """A lazy volume from the contents of its levels."""
    unplaced = ""
    try:
        volumes: list[LazyVolume] = []
        for number, (data, about) in enumerate(contents):
            known = {key: value for key, value in about.items() if key != "header"}
            beside = {key: known.pop(key, None) for key in ("bounds", "statistics")}
            unplaced = known.pop("unplaced", "")
            if len(data.shape) == 2:
                raise DataError(
                    f"{name} holds an image of shape {data.shape}: clvol.read reads images, clvol.images resamples them"
                )
            own = replaced
            if number and own:
                moved = own.keys() - {"labels"}
                own = {**own, **(_moved(contents[0][1], known, volumes[0].grid) if moved else {})}
            coarser = LazyVolume(data, **replacing(own, known), missing=missing, **beside)
            if volumes:
                _require_one_place(name, number, volumes[0], coarser)
            volumes.append(coarser)
        return volumes[0].with_levels(volumes[1:])
    except DataError as error:
        raise DataError(f"{name}: {error}") from error
    except GeometryError as error:
        raise misplaced(name, error, "" if "spacing" in replaced else unplaced) from error


def _moved(base: Mapping[str, Any], about: Mapping[str, Any], moved: Volume) -> dict[str, Any]:
    """Geometry of a level after the largest was moved."""
    grid = {key: base[key] for key in ("spacing", "origin", "direction") if key in base}
    with np.errstate(all="ignore"):
        ratio = np.divide(about["spacing"], base["spacing"]) if "spacing" in base else np.ones(3)
    if not np.isfinite(ratio).all():
        raise GeometryError("the sizes must have spacings, by which they lie in one place; got none")
    first = Volume(moved.data, **grid).world_to_index(about.get("origin", (0.0, 0.0, 0.0)))
    return {
        "spacing": tuple(float(s * r) for s, r in zip(moved.spacing, ratio, strict=True)),
        "origin": tuple(float(x) for x in moved.index_to_world(first)),
        "direction": moved.direction,
    }


def _require_one_place(name: str, number: int, finest: LazyVolume, level: LazyVolume) -> None:
    """Raise unless a level covers about the same box as the finest."""
    first = finest.grid.world_to_index(level.grid.index_to_world(np.array([[-0.5] * 3, [n - 0.5 for n in level.size]])))
    expected = np.array([[-0.5] * 3, [n - 0.5 for n in finest.size]])
    step = np.divide(level.spacing, finest.spacing)
    if not (np.abs(first - expected) <= _OFF * np.maximum(step, 1)).all():
        raise FormatError(
            f"{name} must have its sizes in one place; level {number}, of {' × '.join(map(str, level.size))} samples that lie "
            f"{', '.join(f'{s:g}' for s in level.spacing)} apart, does not lie where level 0 does, of "
            f"{' × '.join(map(str, finest.size))} that lie {', '.join(f'{s:g}' for s in finest.spacing)} apart"
        )
