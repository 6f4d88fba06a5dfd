"""The renderers of a view on the device, shared by its sessions: made for a first picture, closed when memory is needed."""

from __future__ import annotations

import contextlib
import itertools
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

from clvol.base import memory
from clvol.base.errors import OutOfMemoryError
from clvol.bricks.field import BrickedField
from clvol.device import Device
from clvol.filter.boundary import DEFAULT_BOUNDARY, Boundary, chosen_boundary
from clvol.march.renderer import Renderer
from clvol.march.slices import has_smooth_labels
from clvol.scene.mode import as_mode
from clvol.scene.scene import Scene
from clvol.scene.transfer import FACTORS, WORDS
from clvol.spline.field import Field
from clvol.spline.regions import Regions
from clvol.view.catalog import Catalog, Which

__all__ = ["Renderers", "on_slices", "own_arguments", "rule_of"]

_LARGE = 1 << 22  # samples of a volume whose coefficients take longer than a picture
_LARGE_LABELS = 1 << 25  # likewise where some labels are hidden, and nothing is prefiltered
_KEPT = 2  # idle renderers: one to come back to
_SHARE = 4  # idle renderers of several volumes take at most 1 / this of the memory that is available

_Key: TypeAlias = tuple[str | None, str, Which]
"""Filter, boundary, volume."""


@dataclass
class _Entry:
    """A renderer, its users, and when it was last used."""

    making: threading.Lock = field(default_factory=threading.Lock)
    renderer: Renderer | None = None
    users: int = 0
    used: int = 0


class _OfScene(Renderer):
    """A renderer of several media, whose pictures take the look of the first in words, as those of one medium do."""

    def render(self, *arguments: Any, **options: Any) -> Any:
        return super().render(*arguments, **self._of_first(options))

    def refine(self, *arguments: Any, **options: Any) -> Any:
        return super().refine(*arguments, **self._of_first(options))

    def _of_first(self, options: dict[str, Any]) -> dict[str, Any]:
        own = {name: options.pop(name) for name in ("transfer", *WORDS, *FACTORS, "material") if name in options}
        first, *others = options.get("media", self.scene.media)
        looked = replace(self.scene.media[0], **own, visible=first.visible)
        return options | {"media": (looked, *others)}


def own_arguments(renderer: Renderer, given: dict[str, Any]) -> dict[str, Any]:
    """Arguments of a view's picture as functions beside the renderer take them: of several media the look is the first's."""
    return renderer._of_first({**given}) if isinstance(renderer, _OfScene) else given


def on_slices(renderer: Renderer, mode: str, number: int = 0) -> Field | BrickedField | Regions:
    """The function that slices show of a medium beside a picture in a mode: smooth regions beside those."""
    medium, regions = renderer.scene.media[number], as_mode(mode).regions
    part = renderer._source.part(medium)
    return part.regions() if (has_smooth_labels(medium, None, regions) if number else regions) else part.field


def rule_of(boundary: str) -> Boundary:
    """The boundary rule of a state, where the default is not told from one that was given: regions of labels have theirs then."""
    return chosen_boundary(None if boundary == DEFAULT_BOUNDARY else boundary)


class Renderers:
    """A cache of renderers by filter, boundary and volume.

    `given` are coefficients that the first volume already has; `scene` holds more media, which are drawn with it; `ready` is called
    with what a new renderer shows; `limits` are those of the device while it draws.
    """

    def __init__(
        self,
        catalog: Catalog,
        device: Device | str | int | None,
        given: Field | None,
        scene: Scene | None,
        ready: Callable[[Which], None],
        limits: Mapping[str, Any],
    ) -> None:
        self._limits = limits
        self._catalog, self._device, self._field, self._scene, self._ready = catalog, device, given, scene, ready
        self._lock = threading.Lock()
        self._counter = itertools.count(1)
        self._entries: dict[_Key, _Entry] = {}
        self._threads: dict[_Key, threading.Thread] = {}
        self._prepared_last: _Key | None = None
        self._one_by_one = threading.Lock()
        self._closed = 0  # how often

    @contextlib.contextmanager
    def renderer(self, filter: str | None, boundary: str, which: Which | None = None) -> Iterator[Renderer]:
        """The renderer of a filter, made if there is none; the last two stay when they are idle.

        Of several volumes more stay, while they take no more than a quarter of the memory that is available. `which` is by default
        the first volume with all labels.
        """
        key = filter, boundary, which or self._catalog.first
        with self._lock:
            entry = self._entries.setdefault(key, _Entry())
            entry.users += 1
            entry.used = next(self._counter)
        try:
            with entry.making:
                if entry.renderer is None:
                    entry.renderer = self._made(key)
                    self._ready(key[2])
            with entry.renderer.device.limited(**self._limits) if self._limits else contextlib.nullcontext():
                yield entry.renderer
        finally:
            with self._lock:
                entry.users -= 1
                known = self._entries.get(key) is entry
                if entry.renderer is None and not entry.users and known:
                    del self._entries[key]
                left = entry.renderer if not (known or entry.users) else None
            if left is not None:  # forgotten meanwhile
                with contextlib.suppress(Exception):
                    left.close()
            self._free(_KEPT)

    def soon(self, filter: str | None, boundary: str, which: Which | None = None) -> bool:
        """Whether the renderer of a filter exists, or the volume is so small that it is made at once."""
        which = which or self._catalog.first
        with self._lock:
            entry = self._entries.get((filter, boundary, which))
        made = entry is not None and entry.renderer is not None
        large = _LARGE_LABELS if which.labels is not None and filter in (None, "nearest") else _LARGE
        return made or (self._field is not None and which == self._catalog.first) or self._catalog.volume.data.size < large

    def prepare(self, filter: str | None, boundary: str, which: Which | None = None) -> threading.Thread:
        """A thread that makes the renderer of a filter, while a session shows something else.

        They work one after the other, and skip what is no longer the last that was asked for: who draws it makes it then.
        """
        key, closed = (filter, boundary, which or self._catalog.first), self._closed

        def make() -> None:
            try:
                with self._one_by_one:
                    if self._prepared_last == key and self._closed == closed:
                        with contextlib.suppress(Exception), self.renderer(*key):  # who draws with it reports it
                            pass
            finally:
                with self._lock:
                    del self._threads[key]
            if self._closed != closed:
                self._free(0)

        with self._lock:
            self._prepared_last = key
            if key not in self._threads:
                self._threads[key] = threading.Thread(target=make, name="clvol view: coefficients", daemon=True)
                self._threads[key].start()
            return self._threads[key]

    def in_use(self) -> set[Which]:
        """What renderers exist of."""
        with self._lock:
            return {which for _, _, which in self._entries}

    def _made(self, key: _Key) -> Renderer:
        given = self._field
        if given is not None and self._scene is None and key == (given.filter.name, given.boundary.name, self._catalog.first):
            return Renderer(given)
        row, name, which = key
        boundary = rule_of(name)
        volume = self._catalog.volume_at(which)

        def made() -> Renderer:
            if self._scene is None:
                return Renderer(volume, row, boundary, self._device)
            first = replace(self._scene.media[0].with_transfer(None), volume=volume, filter=row, boundary=boundary)  # type: ignore[arg-type]  # a name
            return _OfScene(replace(self._scene, media=(first, *self._scene.media[1:])), device=self._device)

        try:
            return made()
        except OutOfMemoryError:
            self._free(0)
            return made()

    def _free(self, kept: int) -> None:
        """Close idle renderers, but the last few; of several volumes as many stay as there is room for."""
        with self._lock:
            idle = {key: e.renderer for key, e in self._entries.items() if not e.users and e.renderer is not None}
            latest = sorted(idle, key=lambda key: -self._entries[key].used)
            room = memory.available() // _SHARE if self._catalog.volumes is not None and kept else 0
            taken = list(itertools.accumulate(idle[key].field.nbytes for key in latest))
            gone = [key for i, key in enumerate(latest) if i >= kept and taken[i] > room]
            for key in gone:
                del self._entries[key]
        for key in gone:
            idle[key].close()

    def show(self, scene: Scene | None) -> None:
        """Draw other media with the first."""
        self._scene = scene
        self.forget()

    def forget(self) -> None:
        """Drop all renderers, because the device failed or others are wanted; those in use are closed by their last user."""
        with self._lock:
            gone, self._entries = list(self._entries.values()), {}
        for entry in gone:
            if not entry.users and entry.renderer is not None:
                with contextlib.suppress(Exception):  # of a device that failed
                    entry.renderer.close()

    def close(self) -> None:
        """Free the device's memory; a later picture takes it again."""
        self._closed += 1
        self._free(0)
