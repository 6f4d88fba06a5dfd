"""Many pictures: of many files, from many sides, by this process or a cluster, a task a picture."""

from __future__ import annotations

import itertools
import os
import uuid
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from string import Formatter
from typing import Any, Self

from clvol.base.checks import instance, whole
from clvol.base.errors import ClvolError, OptionError
from clvol.bricks.source import LazyVolume, by_bricks
from clvol.cluster import Cluster, ClusterLike, Turn, as_cluster
from clvol.formats import read
from clvol.formats.opening import opened_if
from clvol.march.launch import Progress
from clvol.march.renderer import Renderer, row_for
from clvol.scene.camera import Camera
from clvol.scene.mode import DEFAULT_MODE, as_mode
from clvol.show.picture import Picture, save
from clvol.volume.volume import Volume, as_volume

__all__ = ["Drawn", "batch", "frames", "needs_whole", "turned"]

_OF_RENDERER = ("filter", "boundary", "device", "budget")  # the other options are those of its pictures
_FIELDS = ("name", "number", "frame")
_EACH = 2  # frames of a movie for each worker that are being drawn, or wait for those before them


@dataclass(frozen=True)
class Drawn:
    """What became of a picture.

    Attributes
    ----------
    source : str
        The file, or the name of the volume.
    frame : int
        Which of the cameras, from 0.
    path : Path
        Where it is to be.
    error : ClvolError or None
        Why it is not there.
    """

    source: str
    frame: int
    path: Path
    error: ClvolError | None = None


def turned(frames: int, elevation: float = 20.0, **camera: Any) -> list[Camera]:
    """So many cameras on a whole turn around what is seen, at equal angles.

    Parameters
    ----------
    frames : int
        1 or more.
    elevation : float
        Degrees.
    **camera
        As of `Camera.orbit`; `azimuth` is the first one's.

    Raises
    ------
    OptionError
        `frames` is no whole number of at least 1, or a camera cannot be.
    """
    frames = whole("frames", frames, minimum=1)
    first = camera.pop("azimuth", 0.0)
    return [Camera.orbit(first + 360 * i / frames, elevation, **camera) for i in range(frames)]


def batch(
    sources: Any,
    cameras: Camera | Sequence[Camera] | None = None,
    output: str | os.PathLike[str] = "{name}-{frame:04}.png",
    *,
    cluster: ClusterLike | None = None,
    reading: Mapping[str, Any] | Callable[[str], Volume | LazyVolume] | None = None,
    look: Callable[[Volume], Mapping[str, Any]] | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> list[Drawn]:
    """Pictures of many volumes from many sides, each a file that is written as soon as it is drawn.

    A file that cannot be read, or a picture that cannot be drawn, leaves the others as they are.

    Parameters
    ----------
    sources : path, Volume or LazyVolume, or a sequence of these
        Files are read by whoever draws them; what is stored in several sizes or does not fit into half of the memory that is
        available by bricks, as by 'clvol render'.
    cameras : Camera or sequence of Camera, optional
        One picture of each source by each; by default one by `Camera.orbit()`. See `turned`.
    output : str
        Where pictures go: a name with ``{name}``, that of the source without its suffix, ``{number}``, which source it is, and
        ``{frame}``, which camera, both from 0 and with a format, such as ``{frame:04}``.
    cluster : distributed.Client, str or int, optional
        Who draws: as of `Renderer`. Each picture is a task, so a worker must have room for a whole volume. By default this process.
    reading : mapping or callable, optional
        Options of `clvol.read`, or what reads a file in its place, as a Volume or LazyVolume.
    look : callable, optional
        Gives further options for each volume.
    progress : callable, optional
        Called with the fraction done.
    **options
        As of `clvol.render`.

    Returns
    -------
    list of Drawn
        Of each picture, sources first: where it is, or why it is not.

    Raises
    ------
    OptionError
        Several pictures would go to one file, `output` asks for what there is not, or `cameras` has none.
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
    >>> drawn = clvol.batch(ball, clvol.turned(3), folder / "{frame}.png", mode="mip", size=(40, 40))
    >>> [one.path.name for one in drawn if one.error is None]
    ['0.png', '1.png', '2.png']
    """
    many = _several(sources)
    views = [cameras] if cameras is None or isinstance(cameras, Camera) else list(cameras)
    if not views:
        raise OptionError("cameras must be one or more; got none")
    for view in views:
        if view is not None:
            instance("cameras", view, Camera)
    wanted = [
        Drawn(_name(source), frame, Path(_filled(str(output), _stem(source), number, frame)))
        for (number, source), frame in itertools.product(enumerate(many), range(len(views)))
    ]
    _require_apart(wanted)
    done = itertools.count(1)
    results: list[Drawn] = list(wanted)
    how = reading if callable(reading) else dict(reading or {})

    def keep(number: int, result: Picture | ClvolError) -> None:
        one = wanted[number]
        if isinstance(result, ClvolError):
            results[number] = Drawn(one.source, one.frame, one.path, result)
        else:
            one.path.parent.mkdir(parents=True, exist_ok=True)
            save(result, one.path)
        if progress:
            progress(next(done) / len(wanted))

    if cluster is None:
        with _Held() as held:
            for number, (source, view) in enumerate(itertools.product(many, views)):
                try:
                    picture = _drawn(held, source, how, view, look, options)
                except ClvolError as error:
                    picture = error
                keep(number, picture)
        return results
    with _together(cluster) as (own, token):
        at_hand = [_at_hand(own, source) for source in many]
        tasks = [own.submit(_task, token, source, how, view, look, options) for source, view in itertools.product(at_hand, views)]
        try:
            for number, result in own.done(tasks, keeping=True):
                keep(number, result)
        finally:
            own.cancel(tasks)
    return results


def frames(
    source: Any,
    cameras: Sequence[Camera | None],
    *,
    cluster: ClusterLike | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> Generator[Picture, None, None]:
    """Pictures of a volume one after the other, such as for `movies.write`.

    Of those that a cluster draws few are waiting at any time, in the memory of its workers.

    Parameters
    ----------
    source : path, Volume or LazyVolume
        As of `batch`.
    cameras : sequence of Camera or None
        One for each picture; None is the default one.
    cluster : distributed.Client, str or int, optional
        Who draws, a task a picture. By default this process.
    progress : callable, optional
        Called with the fraction done.
    **options
        As of `clvol.render`.

    Raises
    ------
    OptionError
        `source` is several, or `cameras` are not all cameras.
    ClvolError
        As of `clvol.render`, at the picture that cannot be drawn.
    ClusterError
        The scheduler or all of its workers are gone.
    """
    sources, count = _several(source), len(cameras)
    if len(sources) != 1:
        raise OptionError(f"source must be one volume; got {len(sources)}: clvol.batch takes several")
    for camera in cameras:
        if camera is not None and not isinstance(camera, Camera):
            raise OptionError(f"cameras must be of Camera, or None for the default one; got {type(camera).__qualname__}")
    return _frames(sources[0], cameras, count, cluster, progress, options)


def _frames(
    one: Any,
    cameras: Sequence[Camera | None],
    count: int,
    cluster: ClusterLike | None,
    progress: Progress | None,
    options: dict[str, Any],
) -> Generator[Picture, None, None]:
    """Those of a volume, one after the other."""
    if cluster is None:
        with _Held() as held:
            for number, camera in enumerate(cameras):
                told = progress and partial(_within, progress, number, count)
                yield _drawn(held, one, {}, camera, None, options | {"progress": told})
        return
    with _together(cluster) as (own, token):
        at_hand, left = _at_hand(own, one), iter(cameras)
        tasks: deque[Any] = deque()
        try:
            for number in range(count):
                for camera in itertools.islice(left, max(1, _EACH * len(own.workers) - len(tasks))):
                    tasks.append(own.submit(_task, token, at_hand, {}, camera, None, options))
                ((_, picture),) = own.done([tasks[0]])
                tasks.popleft()
                if progress:
                    progress((number + 1) / count)
                yield picture
        finally:
            own.cancel(tasks)


def _within(progress: Progress, number: int, count: int, done: float) -> None:
    """So much of a picture of several is done."""
    progress((number + done) / count)


@contextmanager
def _together(choice: ClusterLike) -> Iterator[tuple[Cluster, str]]:
    """A cluster and a token for what its workers hold meanwhile."""
    cluster = as_cluster(choice)
    try:
        yield cluster, uuid.uuid4().hex
    finally:
        cluster.tell(_let_go)
        if cluster is not choice:
            cluster.close()


def _at_hand(cluster: Cluster, source: Any) -> Any:
    """What a task takes for a source: a file by its name, a volume once for all tasks."""
    if isinstance(source, Volume):
        return cluster.shared(source, source.data.nbytes)
    if isinstance(source, LazyVolume):
        return cluster.shared(source.for_tasks(), source.nbytes if source.in_memory else 0)
    return _absolute(source)


def needs_whole(evaluator: str = "auto", fetch: str = "auto", outputs: Any = "rgba", **_: Any) -> bool:
    """Whether these options of `clvol.render` are of volumes that are read whole, as long as they fit."""
    return evaluator not in ("auto", "taps") or fetch == "image" or "uncertainty" in outputs


def _read(path: str, how: Any, options: Mapping[str, Any]) -> Volume | LazyVolume:
    """A file as it is drawn."""
    if callable(how):
        return how(path)  # type: ignore[no-any-return]  # it is the caller's
    several = how.get("level") is None and not needs_whole(**options)
    return opened_if(path, partial(by_bricks, several=several), **how) or read(path, **how)


class _Held:
    """The renderer of the source that was drawn last."""

    def __init__(self) -> None:
        self.turn = Turn()
        self._key: Any = None
        self._volume: Any = None
        self._renderer: Renderer | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.let_go()

    def let_go(self) -> None:
        """Free what is held."""
        if self._renderer is not None:
            self._renderer.close()
        self._key = self._volume = self._renderer = None

    def of(self, token: str, source: Any, how: Any, options: Mapping[str, Any]) -> tuple[Renderer, Any]:
        """The renderer of a source, and what it draws."""
        named = isinstance(source, (str, os.PathLike))
        key = (token, str(source) if named else id(source))
        if key != self._key:  # what is held keeps its id
            self.let_go()
            volume = _read(str(source), how, options) if named else source
            if token and isinstance(volume, LazyVolume):
                volume = volume.for_tasks()
            given = {name: options[name] for name in _OF_RENDERER if options.get(name) is not None}
            if isinstance(volume, LazyVolume):
                usual = as_mode(options.get("mode", DEFAULT_MODE)).picture_filter
                given["filter"] = row_for(volume, given.get("filter"), usual)
            self._renderer, self._volume, self._key = Renderer(volume, **given), volume, key
        assert self._renderer is not None
        return self._renderer, self._volume


def _drawn(held: _Held, source: Any, how: Any, view: Camera | None, look: Any, options: dict[str, Any], token: str = "") -> Any:
    """A picture of the batch with this token."""
    rest = {name: value for name, value in options.items() if name not in _OF_RENDERER}
    with held.turn:
        renderer, volume = held.of(token, source, how, options)
        seen = volume.sketch() if isinstance(volume, LazyVolume) else volume
        further = {} if look is None else dict(look(seen))
        if view is not None:
            further["camera"] = view
        return renderer.render(**(rest | further))


_worker = _Held()


def _task(token: str, source: Any, how: Any, view: Camera | None, look: Any, options: dict[str, Any]) -> Any:
    return _drawn(_worker, source, how, view, look, options, token)


def _let_go() -> None:
    """A batch is done: a file that it drew may be another one by the next."""
    with _worker.turn:
        _worker.let_go()


def _several(sources: Any) -> list[Any]:
    """Paths and volumes, whether one was given or several."""
    if isinstance(sources, (str, os.PathLike, Volume, LazyVolume)) or hasattr(sources, "shape"):
        sources = [sources]
    try:
        many = list(sources)
    except TypeError:
        raise OptionError(f"sources must be files or volumes; got {sources!r}") from None
    return [one if isinstance(one, (str, os.PathLike, LazyVolume)) else as_volume(one) for one in many]


def _absolute(source: Any) -> Any:
    """A file as it is called whatever folder a worker is in."""
    named = isinstance(source, (str, os.PathLike)) and Path(source).exists()
    return str(Path(source).absolute()) if named else source


def _name(source: Any) -> str:
    return str(source) if isinstance(source, (str, os.PathLike)) else source.name or "volume"


def _stem(source: Any) -> str:
    """The name of a file without its suffixes."""
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
        raise OptionError(f"output must be a name with {{name}}, {{number}} and {{frame}}; got {pattern!r}") from None


def _require_apart(wanted: Sequence[Drawn]) -> None:
    found: dict[Path, Drawn] = {}
    for one in wanted:
        if other := found.get(one.path):
            raise OptionError(
                f"output must tell pictures apart by {{name}}, {{number}} and {{frame}}; {one.path} would be frame {other.frame} "
                f"of {other.source} and frame {one.frame} of {one.source}"
            )
        found[one.path] = one
