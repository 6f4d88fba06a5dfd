"""Many pictures, of many files and from many sides, drawn by this process or by a cluster, where each picture is a task."""

from __future__ import annotations

import itertools
import os
import uuid
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from string import Formatter
from typing import TYPE_CHECKING, Any, Unpack

from clvol.base.checks import instance, warned_once
from clvol.base.errors import ClvolError, OptionError
from clvol.base.progress import Progress, part_of
from clvol.bricks.source import LazyVolume, by_bricks
from clvol.formats import read
from clvol.formats.opening import opened_if
from clvol.march.choose import as_drawn, source_of
from clvol.march.options import BatchOptions, FieldOptions, as_outputs, chosen_mode
from clvol.march.renderer import Renderer
from clvol.scene.camera import Camera
from clvol.scene.mode import DEFAULT_MODE, as_mode
from clvol.scene.scene import Medium, Scene
from clvol.show.picture import Picture, save
from clvol.volume.volume import Volume

if TYPE_CHECKING:  # clusters need dask
    from clvol.dask.cluster import Cluster, ClusterLike

__all__ = ["Drawn", "Shot", "batch", "frames", "needs_whole"]

_OF_RENDERER = tuple(FieldOptions.__annotations__)  # the other options are those of a picture
_FIELDS = ("name", "number", "frame")
_QUEUED = 2  # frames of a movie for each worker that are submitted ahead


@dataclass(frozen=True)
class Drawn:
    """The outcome of one picture.

    Attributes
    ----------
    source : str
        The file, or the name of the volume.
    frame : int
        The camera's index.
    path : Path
        The picture's file.
    error : ClvolError or None
        Why it was not drawn.
    """

    source: str
    frame: int
    path: Path
    error: ClvolError | None = None


@dataclass(frozen=True)
class Shot:
    """A picture of a movie.

    Attributes
    ----------
    source : path, Volume, LazyVolume or Scene
        As of `batch`.
    changes : mapping
        Its own options, as of `Renderer.render`, such as its camera, beside those of all pictures.
    """

    source: Any
    changes: Mapping[str, Any] = field(default_factory=dict)


def batch(
    sources: Any,
    cameras: Camera | Sequence[Camera] | None = None,
    output: str | os.PathLike[str] = "{name}-{frame:04}.png",
    *,
    cluster: ClusterLike | None = None,
    reading: Mapping[str, Any] | Callable[[str], Volume | LazyVolume | Scene] | None = None,
    look: Callable[[Volume], Mapping[str, Any]] | None = None,
    progress: Progress | None = None,
    limits: Mapping[str, Any] | None = None,
    **options: Unpack[BatchOptions],
) -> list[Drawn]:
    """Draw many volumes or scenes from many sides, and write each picture as soon as it is drawn.

    If a file cannot be read or a picture cannot be drawn, the others are still drawn.

    Parameters
    ----------
    sources : path, Volume, LazyVolume, Scene, Medium or Volumes, or a sequence of these
        The process that draws a file reads it; by bricks, like 'clvol render', if it is stored in several sizes or does not fit
        into half of the available memory. Of Volumes all channels are drawn. The media of a scene have filters and boundaries of
        their own.
    cameras : Camera or sequence of Camera, optional
        Each takes one picture of each source; by default `Camera.orbit()`. See `Camera.turntable`.
    output : str
        The file of a picture: a pattern with ``{name}``, the name of the source without its suffix, and the indices ``{number}`` of
        the source and ``{frame}`` of the camera, with a format if needed, such as ``{frame:04}``.
    cluster : distributed.Client, str or int, optional
        As for `Renderer`. Each picture is a task, so a worker must have room for a whole volume. By default this process draws.
    reading : mapping or callable, optional
        Options of `clvol.read`, or a function that replaces it and returns a Volume, LazyVolume or Scene.
    look : callable, optional
        Returns further options for a volume, or for the first of a scene.
    progress : callable, optional
        Called with the fraction done.
    limits : mapping, optional
        Limits of whichever device draws, as of `Device.limited`.
    **options
        As of `clvol.render`.

    Returns
    -------
    list of Drawn
        One for each picture, those of the first source first.

    Raises
    ------
    OptionError
        Several pictures would have the same file, `output` has an unknown field, or `cameras` is empty.
    FormatError
        A picture cannot be written.
    ClusterError
        The scheduler or all of its workers are gone.

    Examples
    --------
    >>> import clvol
    >>> import tempfile, pathlib
    >>> folder = pathlib.Path(tempfile.mkdtemp())
    >>> ball = clvol.phantoms.marschner_lobb(24)
    >>> drawn = clvol.batch(ball, clvol.Camera.turntable(3), folder / "{frame}.png", mode="mip", size=(40, 40))
    >>> [one.path.name for one in drawn if one.error is None]
    ['0.png', '1.png', '2.png']
    """
    sources = _as_sources(sources)
    if look is None:
        own = {name: value for name, value in options.items() if name not in (*_OF_RENDERER, "mode", "size", "step", "outputs")}
        chosen_mode(
            options.get("mode", DEFAULT_MODE), own, as_outputs(options.get("outputs", "rgba")), _OF_RENDERER, [*sources, None][0]
        )
    views = [cameras] if cameras is None or isinstance(cameras, Camera) else list(cameras)
    if not views:
        raise OptionError("cameras must be one or more; got none")
    for view in views:
        if view is not None:
            instance("cameras", view, Camera)
    results = [
        Drawn(_name(source), frame, Path(_filled(str(output), _stem(source), number, frame)))
        for (number, source), frame in itertools.product(enumerate(sources), range(len(views)))
    ]
    _require_distinct(results)
    request = _Request(reading if callable(reading) else dict(reading or {}), look, {**options}, dict(limits or {}))
    with closing(_outcomes(sources, views, cluster, request)) as outcomes:
        for done, (number, outcome) in enumerate(outcomes, 1):
            if isinstance(outcome, ClvolError):
                results[number] = replace(results[number], error=outcome)
            else:
                path = results[number].path
                path.parent.mkdir(parents=True, exist_ok=True)
                save(outcome, path)
            if progress:
                progress(done / len(results))
    return results


def _outcomes(
    sources: Sequence[Any], views: Sequence[Camera | None], cluster: ClusterLike | None, request: _Request
) -> Generator[tuple[int, Picture | ClvolError], None, None]:
    """Each picture, or its error, with its index, in the order in which they are done."""
    if cluster is None:
        with closing(_LastRenderer()) as last:
            for number, (source, view) in enumerate(itertools.product(sources, views)):
                try:
                    yield number, last.drawn(source, request, _seen_by(view))
                except ClvolError as error:
                    yield number, error
        return
    with _workers_of(cluster) as (workers, token):
        sent = [_sent(workers, source) for source in sources]
        tasks = [workers.submit(_task, token, source, request, _seen_by(view)) for source, view in itertools.product(sent, views)]
        try:
            yield from workers.as_completed(tasks, keep_errors=True)
        finally:
            workers.cancel(tasks)


def frames(
    shots: Sequence[Shot],
    *,
    cluster: ClusterLike | None = None,
    progress: Progress | None = None,
    limits: Mapping[str, Any] | None = None,
    **options: Unpack[BatchOptions],
) -> Generator[Picture, None, None]:
    """Yield the pictures of a movie, in order, for example for `movies.write`.

    A renderer is kept from one picture to the next of the same source, and each warning comes once. The workers of a cluster hold
    only a few pictures at a time.

    Parameters
    ----------
    shots : sequence of Shot
        One for each picture.
    cluster : distributed.Client, str or int, optional
        As of `batch`.
    progress : callable, optional
        Called with the fraction done.
    limits : mapping, optional
        Limits of whichever device draws, as of `Device.limited`.
    **options
        As of `clvol.render`, of all pictures.

    Raises
    ------
    ClvolError
        As raised by `clvol.render`, when the picture is reached.
    ClusterError
        The scheduler or all of its workers are gone.
    """
    count, request, told = len(shots), _Request({}, None, {**options}, dict(limits or {})), set[str]()
    if cluster is None:
        with closing(_LastRenderer()) as last:
            for number, shot in enumerate(shots):
                part = part_of(progress, number / count, (number + 1) / count)
                with warned_once(told):
                    picture = last.drawn(shot.source, request, shot.changes, progress=part)
                yield picture
        return
    with _workers_of(cluster) as (workers, token):
        left, tasks = iter(shots), deque[Any]()
        last_source = sent = None
        try:
            for number in range(count):
                for shot in itertools.islice(left, max(1, _QUEUED * len(workers.workers) - len(tasks))):
                    if sent is None or shot.source is not last_source:
                        last_source, sent = shot.source, _sent(workers, shot.source)
                    tasks.append(workers.submit(_task, token, sent, request, shot.changes))
                ((_, picture),) = workers.as_completed([tasks[0]])
                tasks.popleft()
                if progress:
                    progress((number + 1) / count)
                yield picture
        finally:
            workers.cancel(tasks)


def _seen_by(camera: Camera | None) -> dict[str, Any]:
    """The option of a camera; none for the default one."""
    return {} if camera is None else {"camera": camera}


@contextmanager
def _workers_of(choice: ClusterLike) -> Iterator[tuple[Cluster, str]]:
    """A cluster, and a token for the renderers that its workers keep until the end of this batch."""
    from clvol.dask.cluster import as_cluster

    cluster = as_cluster(choice)
    try:
        yield cluster, uuid.uuid4().hex
    finally:
        cluster.run_on_all(_release)
        if cluster is not choice:
            cluster.close()


def _sent(cluster: Cluster, source: Any) -> Any:
    """A source as an argument of tasks: the absolute path of a file, or a volume that is sent once for all tasks."""
    if isinstance(source, (str, os.PathLike)):
        return str(Path(source).absolute()) if Path(source).exists() else source
    return cluster.scatter(source.for_tasks(), source.nbytes if source.in_memory else 0)


@dataclass(frozen=True)
class _Request:
    """How each source is read and drawn: the options of `batch`, as an argument of tasks too."""

    reading: Any
    look: Callable[[Volume], Mapping[str, Any]] | None
    options: dict[str, Any]
    limits: dict[str, Any]

    def read(self, path: str) -> Volume | LazyVolume | Scene:
        """The file, by bricks if it is large."""
        how = self.reading
        if callable(how):
            return how(path)  # type: ignore[no-any-return]  # it is the caller's
        several = how.get("level") is None and not needs_whole(self.limits, self.options.get("outputs", "rgba"))
        return opened_if(path, partial(by_bricks, several=several), **how) or read(path, **how)


def needs_whole(limits: Mapping[str, Any], outputs: Any = "rgba") -> bool:
    """Whether pictures need the whole volume on the device: bricks support direct taps only, and no uncertainty."""
    taps = limits.get("evaluator", "auto") in ("auto", "taps") and limits.get("fetch") != "image"
    return not taps or "uncertainty" in outputs


class _LastRenderer:
    """Keeps the renderer of the last source for the next picture."""

    def __init__(self) -> None:
        self._key: Any = None
        self._volume: Any = None
        self._options: dict[str, Any] = {}
        self._renderer: Renderer | None = None

    def close(self) -> None:
        """Close the renderer, if there is one."""
        if self._renderer is not None:
            self._renderer.close()
        self._key = self._volume = self._renderer = None

    def _of(self, token: str, source: Any, request: _Request) -> tuple[Renderer, dict[str, Any]]:
        """The renderer of a source, and the options of its pictures."""
        named = isinstance(source, (str, os.PathLike))
        key = (token, str(source) if named else id(source))
        if self._renderer is None or key != self._key:  # the volume is referenced, so its id stays unique
            self.close()
            volume = request.read(str(source)) if named else source
            volume = volume.for_tasks() if token else volume
            options = request.options | ({} if request.look is None else dict(request.look(volume.preview())))
            given = {name: options.pop(name) for name in _OF_RENDERER if name in options}
            found = source_of(volume, **given, usual=as_mode(options.get("mode", DEFAULT_MODE)).picture_filter)
            self._renderer, self._options, self._volume, self._key = Renderer(found), options, volume, key
        return self._renderer, self._options

    def drawn(
        self, source: Any, request: _Request, changes: Mapping[str, Any], token: str = "", progress: Progress | None = None
    ) -> Picture:
        """A picture, with `changes` to the options; `token` identifies the batch, since a file may change between batches."""
        renderer, options = self._of(token, source, request)
        options = options | dict(changes)
        with renderer.device.limited(**request.limits):
            return renderer.render(**options, progress=progress)  # type: ignore[no-any-return]  # its options are the caller's


_worker = _LastRenderer()


def _task(token: str, source: Any, request: _Request, changes: Mapping[str, Any]) -> Any:
    with _worker_lock():
        return _worker.drawn(source, request, changes, token)


def _release() -> None:
    """Close this worker's renderer."""
    with _worker_lock():
        _worker.close()


@cache
def _worker_lock() -> Any:
    """The lock of `_worker`."""
    from clvol.dask.cluster import WorkerLock

    return WorkerLock()


def _as_sources(sources: Any) -> list[Any]:
    """A list of paths and volumes, from one or several."""
    if isinstance(sources, (str, os.PathLike, Medium, Scene)) or hasattr(sources, "shape"):
        sources = [sources]
    try:
        many = list(sources)
    except TypeError:
        raise OptionError(f"sources must be files or volumes; got {sources!r}") from None
    return [one if isinstance(one, (str, os.PathLike)) else as_drawn(one) for one in many]


def _name(source: Any) -> str:
    return str(source) if isinstance(source, (str, os.PathLike)) else source.name or "volume"


def _stem(source: Any) -> str:
    """The name of a source, without the folder and suffixes of a file."""
    name = Path(_name(source).rstrip("/")).name
    for suffix in (".gz", ".zip"):
        name = name.removesuffix(suffix)
    return (Path(name).stem if isinstance(source, (str, os.PathLike)) else name).replace(":", "-")


def _filled(pattern: str, name: str, number: int, frame: int) -> str:
    try:
        asked = {field.partition(".")[0].partition("[")[0] for _, field, _, _ in Formatter().parse(pattern) if field is not None}
        if not asked <= set(_FIELDS):
            raise KeyError
        return pattern.format(name=name, number=number, frame=frame)
    except (KeyError, ValueError, IndexError, AttributeError):
        raise OptionError(f"output must be a pattern with {{name}}, {{number}} and {{frame}}; got {pattern!r}") from None


def _require_distinct(pictures: Sequence[Drawn]) -> None:
    found: dict[Path, Drawn] = {}
    for one in pictures:
        if other := found.get(one.path):
            raise OptionError(
                f"output must give each picture a different name by {{name}}, {{number}} and {{frame}}; {one.path} would be frame "
                f"{other.frame} of {other.source} and frame {one.frame} of {one.source}"
            )
        found[one.path] = one
