"""The layers of a view: its own medium, and others that come and go while clients look."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Protocol
from weakref import WeakSet

import numpy as np
from numpy.typing import ArrayLike

from clvol.base.errors import OptionError
from clvol.interop.dispatch import is_in_parts
from clvol.scene.scene import Medium, Scene, as_scene
from clvol.view.opening import in_memory
from clvol.view.state import History, MediumState, State
from clvol.volume.volume import Volume
from clvol.volume.volumes import Volumes

if TYPE_CHECKING:
    from clvol.bricks.source import LazyVolume
    from clvol.view.resident import Resident

__all__ = ["Layers", "follow"]

_COLOR_MAPS = ("hot", "cool", "viridis", "magma", "green", "red", "blue")  # of values that are added one after the other
_COVERING = 0.5  # opacity of labels that are added


class _Watcher(Protocol):
    def wake(self) -> None: ...


class _Follower(Protocol):
    layers: Layers
    followed: int
    history: History


class Layers:
    """The media that a view shows, in their order; `len`, indices and iteration give them as they were given.

    The first is the view's own, which the panel edits, and stays. A layer that is added is shown in all sessions; each of them
    hides and shows it, and changes its look. To add and to remove one is no step of undo.
    """

    def __init__(self, resident: Resident, scene: Scene | None) -> None:
        self._resident, self._first = resident, resident.name if scene is None else ""
        self._lock = threading.Lock()
        first = Medium(resident.volume) if scene is None else scene.media[0]
        self._alone = None if scene is None or not first.beyond_words else replace(scene, media=(first,))
        self._scene = Scene((first,)) if scene is None else scene
        self._sources: list[str | None] = [None] * len(self._scene.media)
        self._watchers: WeakSet[_Watcher] = WeakSet()
        self.changes: list[int | str] = []
        """What has changed, in this order: the number of a layer that was removed, or the name of one that came last."""

    def __len__(self) -> int:
        return len(self._scene.media)

    def __iter__(self) -> Iterator[Medium]:
        return iter(self._scene.media)

    def __getitem__(self, number: int) -> Medium:
        return self._scene.media[number]

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {', '.join(self.names)}>"

    @property
    def names(self) -> list[str]:
        """What people know them by."""
        names = [one.volume.name or f"medium {number}" for number, one in enumerate(self, 1)]
        return [self[0].volume.name or self._first or names[0], *names[1:]]

    def add(
        self,
        data: Volume | LazyVolume | Medium | Volumes | ArrayLike,
        *,
        name: str | None = None,
        source: str | None = None,
        **words: Any,
    ) -> Medium:
        """Show another volume with the first: a segmentation, an overlay, another channel; of a file's channels all.

        Parameters
        ----------
        data : Volume, LazyVolume, Medium, Volumes or array-like, 3-D
            Of a LazyVolume the largest size that fits. An array has the grid of the first volume, and its shape.
        name : str, optional
            By which the panel lists it; by default the volume's.
        source : str, optional
            Python text by which copied programs get the volume, such as ``clvol.read("labels.nii.gz")``.
        **words
            As of `Medium`: `cmap`, `window`, `opacity`, `filter`, ... By default labels have their colours and half of the opacity,
            and values a colour map that the other layers have not.

        Returns
        -------
        Medium
            The layer, for `remove`; of several the last.

        Raises
        ------
        OptionError
            There would be more than 8, or a word is unknown or not allowed.
        DataError
            The data are no volume.
        GeometryError
            It is in another world than the first volume.
        """
        media = self._made(data, name, words)
        with self._lock:
            told = [_source(source, medium) for medium in media] if len(media) == 1 else [None] * len(media)
            self._put((*self._scene.media, *media), [*self._sources, *told], *(one.volume.name for one in media))
        return media[-1]

    def remove(self, layer: Medium | int) -> None:
        """Show a layer no more.

        Parameters
        ----------
        layer : Medium or int
            What `add` returned, or its number; the first, 0, stays.

        Raises
        ------
        OptionError
            There is no such layer, or it is the first.
        """
        with self._lock:
            media = self._scene.media
            found = [k for k, one in enumerate(media) if (one is layer if isinstance(layer, Medium) else k == layer)]
            if not found or isinstance(layer, bool) or found == [0]:
                raise OptionError(f"layer must be one of those added, 1 to {len(media) - 1}; got {layer!r:.200}")
            (gone,) = found
            self._put((*media[:gone], *media[gone + 1 :]), [*self._sources[:gone], *self._sources[gone + 1 :]], gone)

    def watch(self, watcher: _Watcher) -> None:
        """Have something woken when layers change; it is not kept alive."""
        self._watchers.add(watcher)

    @property
    def version(self) -> int:
        """How often they were changed."""
        return len(self.changes)

    @property
    def sources(self) -> tuple[str, ...] | None:
        """Python texts of all media but the first, if each is known."""
        told = [one for one in self._sources[1:] if one is not None]
        return tuple(told) if len(told) == len(self._sources) - 1 else None

    def _made(self, data: Any, name: str | None, words: dict[str, Any]) -> tuple[Medium, ...]:
        first = self._resident.volume
        if not (isinstance(data, (Volume, Medium, Volumes)) or is_in_parts(data)):
            data = replace(first, data=_samples(data, first), labels=None, name="")
        media = tuple(map(in_memory, as_scene(data).media))
        if name is not None:
            media = tuple(replace(one, volume=replace(one.volume, name=name)) for one in media)
        return tuple(replace(one, **(self._usual(one, k) | words)) for k, one in enumerate(media))

    def _usual(self, medium: Medium, more: int) -> dict[str, Any]:
        """The look of a layer that has none."""
        if medium.transfer is not None or medium.words or medium.surfaces:
            return {}
        if medium.volume.is_labels:
            return {"opacity": _COVERING}
        used = [one.cmap for one in self]
        free = [name for name in _COLOR_MAPS if name not in used] or list(_COLOR_MAPS)
        return {} if medium.volume.color is not None else {"cmap": free[more % len(free)]}

    def _put(self, media: tuple[Medium, ...], sources: list[str | None], *changes: int | str) -> None:
        resident, scene = self._resident, replace(self._scene, media=media)
        initial = _followed(resident.initial, changes)
        self._scene, self._sources = scene, sources  # from here on nothing fails
        resident.catalog.media = media if len(media) > 1 else ()
        resident.renderers.show(scene if len(media) > 1 else self._alone)
        resident.initial = initial
        self.changes += changes
        for watcher in list(self._watchers):
            watcher.wake()


def follow(control: _Follower) -> None:
    """Have a client's states, with all steps of undo, be of the layers that there are now."""
    changes = control.layers.changes[control.followed :]
    control.followed += len(changes)
    if changes:
        control.history = control.history.mapped(lambda state: _followed(state, changes))


def _followed(state: State, changes: Sequence[int | str]) -> State:
    media = list(state.media)
    for change in changes if media else ():
        if isinstance(change, str):
            media.append(MediumState(name=change or None))
        else:
            del media[change]
    return replace(state, media=tuple(media if len(media) > 1 else ()))


def _samples(data: Any, first: Volume) -> Any:
    samples = np.asarray(data)
    if samples.shape != first.shape:
        raise OptionError(f"an array as a layer must have the shape of the first volume, {first.shape}; got {samples.shape}")
    return samples


def _source(text: str | None, medium: Medium) -> str | None:
    """The Python text of a medium, if all that it has is words."""
    plain = medium.transfer is None and medium.filter is None and not medium.beyond_words and not medium.factors
    if text is None or not plain:
        return None
    return f"clvol.Medium({', '.join([text, *(f'{name}={value!r}' for name, value in medium.words.items())])})"
