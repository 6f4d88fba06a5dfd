"""Movies: a volume that turns, a series that plays, options that change from key frame to key frame."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, Unpack

import numpy as np

from clvol.base.checks import as_path, did_you_mean, number, warn, whole
from clvol.base.errors import DataError, OptionError
from clvol.base.files import require_empty, require_folder, staged, staged_folder
from clvol.base.progress import Progress, require_callback
from clvol.bricks.source import LazyVolume, by_bricks
from clvol.filter.filter import Filter
from clvol.formats import leading_of, read, read_all
from clvol.formats.opening import open as open_volume
from clvol.formats.opening import opened_if
from clvol.interfaces.batches import Shot, frames, needs_whole
from clvol.march.choose import as_drawn, without_masked
from clvol.march.function import row_for
from clvol.march.options import KEYWORDS, WORDS, BatchOptions, FieldOptions, ResolvedLook, as_size, chosen_mode, transfer_of
from clvol.scene.camera import Camera
from clvol.scene.fit import usual_camera
from clvol.scene.keyframes import Keyframes
from clvol.scene.look import graded, look
from clvol.scene.mode import DEFAULT_MODE, Mode, as_mode
from clvol.scene.scene import Medium, Scene, as_scene, channels
from clvol.scene.transfer import FACTORS
from clvol.show import movies
from clvol.volume.smoothing import settled
from clvol.volume.volume import Volume
from clvol.volume.volumes import Leading, Volumes

if TYPE_CHECKING:  # clusters need dask
    from clvol.dask.cluster import ClusterLike

__all__ = ["Movie", "MovieOptions", "movie", "places_of", "pooled", "series_of"]

Drawable: TypeAlias = Volume | LazyVolume
Played: TypeAlias = Volume | LazyVolume | Scene

_SECONDS = 5.0
_MOST_FRAMES = 10_000
_POOLED = 1 << 24  # samples of a series from which its look is chosen
_FIXED = ("size", "outputs", "progress", *FieldOptions.__annotations__)  # options that no key frame changes
_ALONG = ("time", "volume")  # axes of a series


@dataclass(frozen=True)
class Movie:
    """A movie that was written.

    Attributes
    ----------
    path : Path
        Its file or folder.
    frames : int
        Number of pictures.
    fps : float
        Pictures per second, as the format can store them.
    times : int
        Number of volumes that it shows.
    filter : Filter or None
        How these are reconstructed; None: by the bounds in the store, or as the media of a scene say.
    """

    path: Path
    frames: int
    fps: float
    times: int
    filter: Filter | None


class MovieOptions(BatchOptions, total=False):
    """Options of `clvol.movie`, beside those of each picture.

    Attributes
    ----------
    frames : int
        Number of pictures, 2 to 10000.
    seconds : float
        Duration; 5 by default.
    fps : float
        Pictures per second, 0.1 to 1000; 25 by default. A series with a camera at rest shows each volume once, and then takes 5
        seconds at 1 to 25 pictures a second, or what `seconds` or `fps` says. Otherwise there are as many pictures as `seconds` and
        `fps` give, or `frames`, and picture i of n shows volume ``floor(i m / n)`` of m.
    turns : float
        Full turns of the camera about the vertical; a negative number turns the other way. Picture i of n is at i / n of them, so
        that whole turns loop. By default one volume turns once, and a series and key frames do not.
    reading : mapping
        Options of `clvol.read` for a path: ``{"time": 3}`` chooses one volume, which then turns.
    cluster : distributed.Client, str or int
        As of `clvol.batch`: each picture is a task.
    progress : callable
        Called with the fraction done.
    limits : mapping
        Limits of whichever device draws, as of `Device.limited`.
    """

    frames: int | None
    seconds: float | None
    fps: float | None
    turns: float | None
    reading: Mapping[str, Any] | None
    cluster: ClusterLike | None
    progress: Progress | None
    limits: Mapping[str, Any] | None


def movie(
    source: Any,
    output: str | os.PathLike[str],
    keyframes: Mapping[float, Mapping[str, Any]] | None = None,
    **options: Unpack[MovieOptions],
) -> Movie:
    """Write a movie: one volume turns, a series plays in time, and key frames change any option of the pictures.

    Parameters
    ----------
    source : path, Volume, LazyVolume, Volumes, Scene, Medium, array-like with 3 or 4 axes, or a sequence of these
        A scene turns, with the filters of its media. Several volumes of one shape are a series, which plays: those of a file along
        its times, or else its volumes, and an array along its first axis. All pictures have one transfer function, isovalue, filter
        and place of the camera, chosen from all volumes where they are left open (the smoothing from the first). So have scenes
        that play, for each of their media; isovalues that are left open among several media are each picture's own. Of Volumes
        all channels are shown, each in its colour.
    output : path-like
        ``.mp4`` (H.264), ``.webm`` (VP9), ``.gif``, ``.webp``, ``.zip`` of PNG files, or a new folder for them, a name without
        suffix. It appears when it is complete: an error, or Ctrl-C, leaves nothing.
    keyframes : mapping, optional
        Options by moment, from 0, the first picture, to 1, the last: ``{0: {"isovalue": 100}, 1: {"isovalue": 900}}``. Those of
        `Renderer.render`, which change linearly (see `clvol.scene.keyframes.Keyframes`), with ``camera``, which takes the shortest
        turn. An option between two moments that do not name it is interpolated between those that do.
    **options
        Those of `MovieOptions` (`frames`, `seconds`, `fps`, `turns`, `cluster`, `progress`), and those of `clvol.render`.

    Returns
    -------
    Movie

    Raises
    ------
    OptionError
        The number of pictures is not 2 to 10000, an option is unknown or out of range, is in a key frame and beside it, or cannot
        be interpolated; a picture has no such size in this format.
    FormatError
        The suffix is unknown, a folder is not empty, or nothing can be written there.
    MissingDependencyError
        The format needs an encoder; the message names the extra.
    DataError
        The volumes of a series differ in shape.
    ClvolError
        As by `clvol.render`.

    Notes
    -----
    A camera that is left open (``fit="matter"``) is fitted once, to all that is visible at any time and at any key frame.

    Examples
    --------
    >>> import clvol, pathlib, tempfile
    >>> folder = pathlib.Path(tempfile.mkdtemp())
    >>> ball = clvol.phantoms.marschner_lobb(24)
    >>> clvol.movie(ball, folder / "turn.gif", frames=3, mode="mip", size=(40, 30)).frames
    3
    >>> keys = {0: {"isovalue": 0.3}, 1: {"isovalue": 0.7}}
    >>> made = clvol.movie(ball, folder / "rise.webp", keys, frames=4, mode="isosurface", size=(40, 30))
    >>> made.frames, made.fps, made.path.name
    (4, 25.0, 'rise.webp')
    """
    given: dict[str, Any] = {**options}
    own = {name: given.pop(name, None) for name in _OWN}
    path = as_path(output)
    form = movies.form_of(path)
    if form == movies.FOLDER:
        require_empty(path)
    require_folder(path)
    movies.require_encoder(form)
    require_callback("progress", own["progress"])
    keys = None if keyframes is None else Keyframes(keyframes)
    turns = None if own["turns"] is None else number("turns", own["turns"])
    _require_options(given, keys, turns, source)
    size = as_size(given.pop("size", (512, 512)))
    movies.require_room(form, 1, size)
    limits = dict(own["limits"] or {})
    mask = given.pop("mask", None)
    if isinstance(source, Volumes) and source.colors:
        words = {name: given.pop(name) for name in ("filter", "boundary") if given.get(name) is not None}
        source = [Scene(channels(source, at, **words)) for at in places_of(source.leading)]
    volumes = [without_masked(one, mask) for one in _volumes(source, dict(own["reading"] or {}), limits)]
    turns = (1.0 if len(volumes) == 1 and keys is None else 0.0) if turns is None else turns
    count, fps = _timing(own, len(volumes), moves=bool(turns) or keys is not None)
    movies.require_room(form, count, size)

    mode = as_mode(given.get("mode", DEFAULT_MODE))
    series = _Series(volumes)
    row = given.pop("filter", None) if series.scenes else _row(volumes[0], given.pop("filter", None), mode)
    given = {name: value for name, value in given.items() if value is not None or name in ("background", "clip")}
    shared = {name: given.pop(name) for name in FieldOptions.__annotations__ if name in given} | {"filter": row, "size": size}
    shots = _shots(series, keys, turns, count, given, size[0] / size[1])
    drawn = frames(shots, cluster=own["cluster"], progress=own["progress"], limits=limits, **shared)
    with staged_folder(path) if form == movies.FOLDER else staged(path, f".{form}") as written, closing(drawn):
        movies.write(drawn, written, form, fps)
    return Movie(path, count, movies.rate(form, fps), len(volumes), row)


def _row(volume: Drawable, row: str | Filter | None, mode: Mode) -> Filter | None:
    """The filter of a series, with the smoothing of its first volume; None: by the bounds in the store."""
    found = row_for(volume, row, mode.picture_filter)
    return None if found is None else settled(found, volume.part())


_OWN = tuple(MovieOptions.__annotations__.keys() - BatchOptions.__annotations__.keys())


def _require_options(given: Mapping[str, Any], keys: Keyframes | None, turns: float | None, source: object) -> None:
    """Raise `OptionError` for options that are unknown, or change nothing, at any moment."""
    if given.get("outputs", "rgba") != "rgba":
        raise OptionError(f"outputs of a movie must be 'rgba'; got {given['outputs']!r}")
    named = () if keys is None else keys.names
    for name in named:
        if name in _FIXED:
            raise OptionError(f"{name} must be the same in all pictures: give it beside the key frames")
        if name in given:
            raise OptionError(f"{name} must be given in key frames or beside them; got both")
    if turns and "camera" in named:
        raise OptionError(f"turns must be left out where key frames have a camera; got {turns:g}")
    of_picture = {name: value for name, value in given.items() if name not in FieldOptions.__annotations__}
    for moment in (0.0,) if keys is None else keys.at:
        at = of_picture | ({} if keys is None else keys.options(moment))
        for name in at:
            if name in _OWN:
                raise OptionError(f"{name} is of the whole movie{did_you_mean(name, KEYWORDS)}: give it beside the key frames")
        chosen_mode(at.pop("mode", DEFAULT_MODE), at, others=(*_OWN, *FieldOptions.__annotations__), scene=source)


def _timing(own: Mapping[str, Any], times: int, *, moves: bool) -> tuple[int, float]:
    """The number of pictures, and how many of them a second has."""
    seconds = None if own["seconds"] is None else number("seconds", own["seconds"], above=0)
    fps = None if own["fps"] is None else number("fps", own["fps"], minimum=0.1, maximum=1000)
    count = own["frames"]
    if count is None and times > 1 and not moves and (seconds is None or fps is None):
        count = times
    if count is None:
        asked = (_SECONDS if seconds is None else seconds) * (movies.PER_SECOND if fps is None else fps)
        if not 2 <= round(asked) <= _MOST_FRAMES:
            raise OptionError(f"a movie must have 2 to {_MOST_FRAMES} pictures; its seconds times its fps are {asked:.0f}")
        count = round(asked)
    count = whole("frames", count, 2, _MOST_FRAMES)
    if seconds is not None and fps is not None and abs(seconds * fps - count) > 1:
        raise OptionError(f"frames must be left out, or be seconds times fps, {seconds * fps:g}; got {count}")
    if fps is None and seconds is not None:
        fps = number("pictures per second", count / seconds, minimum=0.1, maximum=1000)
    elif fps is None:
        fps = min(max(count / _SECONDS, 1.0), movies.PER_SECOND) if times > 1 and not moves else float(movies.PER_SECOND)
    return count, fps


# -- which volumes ---------------------------------------------------------------------------------------------


def _volumes(source: Any, reading: dict[str, Any], limits: Mapping[str, Any]) -> list[Played]:
    """The volumes or scenes of a movie, one or more, of one shape."""
    found: list[Played]
    if isinstance(source, (str, os.PathLike)):
        found = [*series_of(source, limits, **reading)]
    elif reading:
        raise OptionError(f"reading is for a path; got {', '.join(reading)} beside a {type(source).__name__}")
    elif isinstance(source, Volumes) or getattr(source, "ndim", 3) == 4:
        found = [*_of_volumes(source if isinstance(source, Volumes) else Volumes(source), "the source")]
    elif not isinstance(source, (list, tuple)):
        found = [as_drawn(source)]
    else:
        found = [one for each in source for one in _volumes(each, {}, limits)]
        if any(isinstance(one, Scene) for one in found):
            found = [as_scene(one) for one in found]
    if not found:
        raise DataError("a movie must show at least one volume; got none")
    shapes = [[volume.shape for volume in _volumes_of(one)] for one in found]
    for one, shape in zip(found, shapes, strict=True):
        if shape != shapes[0] or one.grid.ndim != 3:
            first, other = (" with ".join(map(str, each)) for each in (shapes[0], shape))
            raise DataError(f"volumes of a movie, or media of its scenes, must have 3 axes and one shape; got {first} and {other}")
    return found


def _volumes_of(played: Played) -> list[Any]:
    return [medium.volume for medium in played.media] if isinstance(played, Scene) else [played]


def places_of(leading: Leading) -> list[dict[str, int]]:
    """The places along time, or else along the axis "volume", that a movie plays; one for neither."""
    counts = dict(zip(leading.axes, leading.counts, strict=True))
    axis = next((axis for axis in _ALONG if counts.get(axis, 1) > 1), None)
    return [{}] if axis is None else [{axis: place} for place in range(counts[axis])]


def series_of(path: str | os.PathLike[str], limits: Mapping[str, Any] | None = None, **reading: Any) -> list[Drawable]:
    """The volumes of a file along its times, or else its volumes; one, if it has no more or `reading` chooses it.

    They are read by bricks as in `clvol.batch`. Of other axes the first place is taken, or the computed channel, with a warning.
    """
    if "://" in str(path):
        return [open_volume(path, **reading)]
    about = {name: reading[name] for name in ("series", "level", "trusted") if name in reading}
    leading = leading_of(path, **about)
    counts = dict(zip(leading.axes, leading.counts, strict=True))
    axis = next((axis for axis in _ALONG if counts.get(axis, 1) > 1), None)
    several = reading.get("level") is None and not needs_whole(limits or {})
    if axis is None or {*_ALONG} & reading.keys():
        return [opened_if(path, partial(by_bricks, several=several), **reading) or read(path, **reading)]
    lazy = opened_if(path, partial(by_bricks, several=several), **(reading | {axis: 0}))
    if lazy is not None:
        return [lazy, *(open_volume(path, **(reading | {axis: i})) for i in range(1, counts[axis]))]
    raw = {"shape", "dtype", "byte_order", "offset"} & reading.keys()
    return [read(path, **reading)] if raw else _of_volumes(read_all(path, **reading), str(path))


def _of_volumes(volumes: Volumes, name: str) -> list[Drawable]:
    """Volumes along time, or else along the axis "volume"; the first along others."""
    leading: Leading = volumes.leading
    counts, places = dict(zip(leading.axes, leading.counts, strict=True)), places_of(leading)
    others = {other: leading.first(other) for other in leading.axes if other not in places[0]}
    if left := [f"{other} {at}" for other, at in others.items() if counts[other] > 1 and not isinstance(at, str)]:
        warn(f"{name} holds {leading}; the movie shows {', '.join(left)}")
    return [volumes.pick(**place, **others) for place in places]


# -- what they show --------------------------------------------------------------------------------------------


def pooled(volumes: Sequence[Drawable]) -> Volume:
    """Samples of all volumes of a series, behind each other along z, from which one look for all of them is chosen."""
    some = [volume.preview() for volume in volumes]
    if len(some) == 1:
        return some[0]
    step = max(1, math.ceil((len(some) * some[0].data.size / _POOLED) ** (1 / 3)))
    clims = {one.clim for one in some}
    clim = None if None in clims else (min(low for low, _ in clims), max(high for _, high in clims))  # type: ignore[misc]  # no None
    return replace(some[0], data=np.concatenate([one.data[::step, ::step, ::step] for one in some]), clim=clim)


class _Series:
    """Volumes or scenes that play, which show each of their parts alike."""

    def __init__(self, played: Sequence[Played]) -> None:
        self.played, self.scenes = played, [one for one in played if isinstance(one, Scene)]
        columns: Any = zip(*map(_volumes_of, played), strict=True)
        self._pooled = [pooled(column) for column in columns] if len(played) > 1 else []
        self._alike: dict[str, list[Scene]] = {}

    def shown(self, options: Mapping[str, Any]) -> tuple[Sequence[Played], dict[str, Any]]:
        """What plays, and the options, with what was left open chosen from all of it."""
        if not self._pooled:
            return self.played, dict(options)
        single = len(self._pooled) == 1
        if not self.scenes:
            return self.played, _shown(self._pooled[0], options)
        mode = as_mode(options.get("mode", DEFAULT_MODE), {name: v for name, v in options.items() if name not in KEYWORDS})
        if mode.name not in self._alike:
            self._alike[mode.name] = self._made_alike(mode)
        own = {name: factor for name, factor in self.scenes[0].media[0].factors.items() if options.get(name) is None}
        if single and any(options.get(word) is not None for word in (*WORDS, *FACTORS)):  # which are of the only medium
            return self._alike[mode.name], _shown(self._pooled[0], {**options, **own})
        rest = {name: value for name, value in options.items() if name in KEYWORDS}
        return self._alike[mode.name], rest | {"mode": mode.settled(self._pooled[0]) if single else mode}

    def _made_alike(self, mode: Mode) -> list[Scene]:
        """The scenes, whose media have one transfer function and one filter at all times."""
        first = self.scenes[0].media
        rows = [_row(medium.volume, medium.filter, mode) for medium in first]

        def alike(medium: Medium, samples: Volume, row: Filter | None) -> Medium:
            if not medium.surfaces and "transfer" not in mode.unheard:
                own = medium.transfer or look(samples, mode, **medium.words)
                medium = medium.with_transfer(graded(own, samples, **medium.factors) if mode.grades else own)
            return replace(medium, filter=row)

        return [
            scene.of_media([alike(*each) for each in zip(scene.media, self._pooled, rows, strict=True)]) for scene in self.scenes
        ]


def _shots(
    series: _Series, keys: Keyframes | None, turns: float, count: int, given: Mapping[str, Any], aspect: float
) -> list[Shot]:
    """The pictures of a movie, each with its volume and its options."""

    def shown_at(moment: float) -> tuple[Sequence[Played], dict[str, Any]]:
        return series.shown(dict(given) | ({} if keys is None else keys.options(moment)))

    moments = [0.0] if keys is None else [*keys.at]
    place = _place([shown_at(moment) for moment in moments], aspect)
    shots = []
    for i in range(count):
        played, options = shown_at(i / (count - 1) if keys is not None else 0.0)
        volume = played[i * len(played) // count]
        camera = options.get("camera") or usual_camera(volume.grid)
        options["camera"] = _turned(replace(camera, **place), 360 * turns * i / count, volume)
        shots.append(Shot(volume, options))
    return shots


def _shown(samples: Volume, options: Mapping[str, Any]) -> dict[str, Any]:
    """The options with the mode settled, and the transfer function chosen, for the samples of a whole series."""
    settled = (*WORDS, *FACTORS, "mode", "transfer")
    rest = {name: value for name, value in options.items() if name in KEYWORDS and name not in settled}
    own = {name: value for name, value in options.items() if name not in KEYWORDS}
    mode: Mode = as_mode(options.get("mode", DEFAULT_MODE), own).settled(samples)
    if "transfer" not in mode.unheard:
        rest["transfer"] = transfer_of(samples, mode, options) or mode.transfer(samples)
    factors = {name: options.get(name) for name in FACTORS}
    if mode.grades and not samples.is_labels:
        rest["transfer"] = graded(rest["transfer"], samples, **factors)
    else:
        rest |= factors  # which are refused
    return rest | {"mode": mode}


class _Some(NamedTuple):
    """A medium of few samples, from which its look is chosen."""

    preview: Volume


def _place(looks: Sequence[tuple[Sequence[Played], Mapping[str, Any]]], aspect: float) -> dict[str, Any]:
    """Target and radius of a camera that sees what any volume shows in any look; nothing for a placed camera, or one look."""
    cameras = [options.get("camera") or usual_camera(played[0].grid) for played, options in looks]
    known = ("position", "target", "distance", "radius")
    if len(looks) * len(looks[0][0]) == 1 or any(getattr(one, what) is not None for one in cameras for what in known):
        return {}
    if cameras[0].fit != "matter":
        return {}
    placed = []
    for (played, given), camera in zip(looks, cameras, strict=True):
        options = {name: value for name, value in given.items() if name not in ("camera", "mode")}
        for one in played:
            scene = as_scene(one)
            mode = chosen_mode(given.get("mode", DEFAULT_MODE), options, scene=scene)
            found = ResolvedLook.of(scene, lambda medium: _Some(medium.volume.preview()), camera, mode, options)  # type: ignore[arg-type]  # by name
            placed.append(found.placed(aspect).camera)
    centers = np.array([one.target for one in placed])
    center = (centers.min(0) + centers.max(0)) / 2
    reach = max(float(np.linalg.norm(c - center)) + (one.radius or 0.0) for c, one in zip(centers, placed, strict=True))
    return {"target": tuple(center.tolist()), "radius": reach}


def _turned(camera: Camera, degrees: float, volume: Played) -> Camera:
    """The camera, turned about the vertical through its target."""
    from scipy.spatial.transform import Rotation  # which takes long to import

    if not degrees:
        return camera
    vertical = np.array([0.0, 0.0, 1.0]) if camera.upright else np.asarray(camera.up) / math.hypot(*camera.up)
    turn = Rotation.from_rotvec(math.radians(degrees) * vertical)
    up = tuple(turn.apply(camera.up).tolist())
    if camera.position is None:
        return replace(camera, up=up, direction=tuple(turn.apply(camera.direction).tolist()))
    target = volume.grid.center if camera.target is None else np.asarray(camera.target)
    return replace(camera, up=up, position=tuple((target + turn.apply(np.asarray(camera.position) - target)).tolist()))
