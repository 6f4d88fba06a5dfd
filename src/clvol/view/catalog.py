"""Which of several volumes a state shows, and which of its labels."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from clvol import labels
from clvol.base.errors import OptionError
from clvol.scene.preset import label_color
from clvol.scene.scene import Medium
from clvol.view import media
from clvol.view.state import LabelState, State
from clvol.volume.volume import Volume, table_of
from clvol.volume.volumes import Leading, Volumes

__all__ = ["Catalog", "Which", "labelled", "series_of"]

_KEPT = 64  # volumes that were shown and are remembered
_LISTED = 200  # labels that a client is sent at once
_LONGEST = 200  # characters of a search
_SECONDS = {"sec": 1.0, "msec": 1e-3, "usec": 1e-6}


class Which(NamedTuple):
    """What a picture shows: the place along each leading axis of several volumes, and which labels."""

    place: tuple[int | str, ...] = ()
    labels: LabelState | None = None


class _Listing:
    """The labels of a volume, for every message that names some and for every search."""

    def __init__(self, volume: Volume) -> None:
        self.numbers = labels.numbers_of(volume)
        self._names = {number: name.casefold() for number, name in table_of(volume).items()}

    @cached_property
    def _texts(self) -> list[str]:
        """The number of each label and its name in lower case."""
        names = self._names
        return [f"{n}\n{names[n]}" if n in names else str(n) for n in map(int, self.numbers.tolist())]

    def search(self, words: str) -> list[int]:
        """Positions of labels that contain the words; a label of exactly that number comes first."""
        found = [i for i, text in enumerate(self._texts) if words in text]
        exact = self._position(words)
        return found if exact is None else [exact, *(i for i in found if i != exact)]

    def _position(self, text: str) -> int | None:
        """Of the label with this number."""
        if not text.removeprefix("-").isdecimal():
            return None
        at = int(np.searchsorted(self.numbers, float(text)))
        return at if at < self.numbers.size and str(int(self.numbers[at])) == text else None


@dataclass
class _Viewed:
    """A volume that is or was shown, and what is known of it."""

    volume: Volume | None = None
    known: bool = False
    making: threading.Lock = field(default_factory=threading.Lock)
    listing: _Listing | None = None


class Catalog:
    """The volumes of a view, which are read when they are first shown; all have the grid of the first.

    `in_use` says what renderers exist of: those are not forgotten. `media` are all of a scene of several, as they were given.
    """

    def __init__(
        self, volume: Volume, volumes: Volumes | None, in_use: Callable[[], set[Which]], media: tuple[Medium, ...] = ()
    ) -> None:
        self.volume, self.volumes, self._in_use, self.media = volume, volumes, in_use, media
        self.first = Which(() if volumes is None else tuple(map(volumes.leading.first, volumes.leading.axes)))
        """What is shown first."""
        self._lock = threading.Lock()
        self._views: dict[Which, _Viewed] = {self.first: _Viewed(volume)}  # the most recently shown last

    def which(self, state: State) -> Which:
        """What a state shows; `OptionError` if there is no such axis, or no such place along it."""
        if self.volumes is None:
            if state.index:
                raise OptionError(f"index must be left out, for there is one volume; got {dict(state.index)!r}")
            place: tuple[int | str, ...] = ()
        else:
            leading = self.volumes.leading
            if unknown := [axis for axis in state.index if axis not in leading.axes]:
                raise OptionError(f"index must be of {', '.join(leading.axes)}; got {', '.join(unknown)}")
            place = tuple(self._along(axis, state.index.get(axis, leading.first(axis))) for axis in leading.axes)
        seen = state.labels
        if seen is not None and not self.volume_at(Which(place)).is_labels:
            seen = None  # they belong to another of the volumes
        return Which(place, seen)

    def key(self, state: State) -> tuple[str | None, str, Which]:
        """Of the renderer that draws a state: filter, boundary and volume."""
        return state.filter, state.boundary, self.which(state)

    def _along(self, axis: str, choice: int | str) -> int | str:
        assert self.volumes is not None  # or there were no axes
        leading = self.volumes.leading
        return choice if axis == "channel" and choice and choice == leading.computed else leading.place(axis, choice)

    def require(self, state: State) -> None:
        """Refuse what only the scene can refuse: another volume, labels that it has not, letters of no patient, other media."""
        place, seen = self.which(state)
        media.require(self.media, state)
        state.furniture.require_shown(self.volume.space)
        slices = state.slice
        if slices.contour and not self.volume.is_labels:
            raise OptionError(f"slice.contour must be 0, for the volume is no label map; got {slices.contour:g}")
        if slices.contour and (slices.contour < 1 or slices.thickness):
            raise OptionError(f"slice.contour must be from 1 to 16, and 0 of a slab; got {slices.contour:g}")
        if slices.thickness and slices.project == "mean" and self.volume.is_labels:
            raise OptionError("slice.project must be mip or minip of labels, because the mean of two is a third; got mean")
        rows = state.label_rows
        if (state.labels is not None or rows) and self.volumes is None:  # else another of them may have such labels
            if not self.volume.is_labels:
                raise OptionError(f"labels must be left out, for the volume is no label map; got {state.labels or rows!r:.200}")
            chosen = np.array([*rows, *((seen and (seen.hidden or seen.shown)) or ())], np.float64)
            numbers = self._listing(Which(place)).numbers
            if unknown := [int(n) for n in chosen[~labels.among(numbers, chosen)]]:
                raise OptionError(f"labels must be some of the volume's; got {', '.join(map(str, unknown[:8]))}, which it has not")

    def stepped(self, state: State, by: int) -> State:
        """The next volume or the one before: along time, or along the first axis that has several places."""
        if not (axes := self.axes()):
            return state
        axis = next((one for one in axes if one["plays"]), axes[0])
        places: list[int | str] = [axis["first"]] if axis["first"] else []
        places += range(axis["count"])
        now = places.index(self._along(axis["axis"], state.index.get(axis["axis"], axis["first"])))
        to = places[min(max(now + by, 0), len(places) - 1)]
        return state if to == places[now] else replace(state, index={**state.index, axis["axis"]: to})

    def state_of(self, which: Which, state: State) -> State:
        """A state that shows this volume and these labels, else as `state`."""
        axes = self.volumes.axes if self.volumes is not None else ()
        return replace(state, index=dict(zip(axes, which.place, strict=True)), labels=which.labels)

    def places(self, state: State) -> dict[str, int | str]:
        """The place along each leading axis that has several."""
        if self.volumes is None:
            return {}
        leading, place = self.volumes.leading, self.which(state).place
        named = zip(leading.axes, leading.counts, place, strict=True)
        return {axis: at for axis, count, at in named if count > 1 or isinstance(at, str)}

    def axes(self) -> list[dict[str, Any]]:
        """For a panel: the leading axes with more than one place, what each counts, names of its places, and which is played.

        Of time also the seconds from one place to the next, where the file has them.
        """
        if self.volumes is None:
            return []
        found: list[dict[str, Any]] = []
        played = series_of(self.volumes.leading)
        for axis, count in zip(self.volumes.axes, self.volumes.leading.counts, strict=True):
            first = self.volumes.leading.first(axis)
            if count > 1 or first:
                names = [name or str(i) for i, name in enumerate(self.volumes.leading.names.get(axis, ()))]
                found.append({"axis": axis, "count": count, "names": names[:_LISTED], "first": first, "plays": axis == played})
                if axis == "time" and (step := self._seconds()):
                    found[-1]["seconds"] = step
        return found

    def _seconds(self) -> float:
        """From one time to the next; 0 if that is not known."""
        about = self.volume.header
        return float(about.get("time_step", 0.0)) * _SECONDS.get(about.get("time_unit", ""), 0.0)

    def volume_of(self, state: State) -> Volume:
        """The volume that a state shows, with the labels that are seen."""
        return self.volume_at(self.which(state))

    def volume_at(self, which: Which) -> Volume:
        """A volume with the labels that are seen."""
        viewed = self._viewed(which)
        if viewed.volume is None:
            with viewed.making:  # once, and not under `_lock`: messages of other sessions do not wait for it
                if viewed.volume is None:
                    viewed.volume = self._read(which)
        return viewed.volume

    def _read(self, which: Which) -> Volume:
        if which.labels is not None:
            whole, chosen = self.volume_at(Which(which.place)), which.labels
            return labels.without(whole, chosen.hidden) if chosen.hidden is not None else labels.only(whole, chosen.shown or ())
        assert self.volumes is not None  # or it would be the first
        return self.volumes.pick(**dict(zip(self.volumes.axes, which.place, strict=True)))

    def _viewed(self, which: Which) -> _Viewed:
        with self._lock:
            found = self._views.pop(which, None) or _Viewed()
            self._views[which] = found
            kept = self._in_use() | {self.first}
            unused = [one for one, viewed in self._views.items() if one not in kept and not viewed.making.locked()]
            copies = [one for one in unused if one.labels is not None or any(isinstance(at, str) for at in one.place)]
            for old in {*unused[:-_KEPT], *copies[:-1]}:  # copies take memory
                del self._views[old]
            return found

    def _listing(self, which: Which) -> _Listing:
        volume, viewed = self.volume_at(which), self._viewed(which)
        with viewed.making:
            viewed.listing = viewed.listing or _Listing(volume)
        return viewed.listing

    def labels(self, state: State, words: str = "") -> tuple[list[list[Any]], int]:
        """Labels whose name or number contains the words, and how many there are.

        The first of them, each as its number, its name or "", and its colour and opacity, where the state changes neither.
        """
        if not isinstance(words, str) or len(words) > _LONGEST:
            raise OptionError(f"labels are searched by a text of up to {_LONGEST} characters; got {words!r:.60}")
        which = Which(self.which(state).place)
        volume = self.volume_at(which)
        if not volume.is_labels:
            return [], 0
        listing, words = self._listing(which), words.strip().casefold()
        found = listing.search(words) if words else range(listing.numbers.size)
        numbers = [int(listing.numbers[i]) for i in found[:_LISTED]]
        seen = table_of(volume).opacities
        return [[n, labels.name_of(volume, n), list(label_color(n, volume)), seen.get(n, 1.0)] for n in numbers], len(found)

    def known(self, which: Which) -> bool:
        """Whether what takes long to compute of a volume was computed once: see `mark_known`."""
        with self._lock:
            found = self._views.get(which)
            return found is not None and found.known

    def mark_known(self, which: Which) -> None:
        """Remember that it was."""
        self._viewed(which).known = True


def series_of(leading: Leading) -> str | None:
    """The axis along which volumes follow each other: time, or another one, but not channels."""
    several = [axis for axis, count in zip(leading.axes, leading.counts, strict=True) if count > 1]
    return "time" if "time" in several else next((axis for axis in several if axis != "channel"), None)


def labelled(volume: Volume, state: State) -> Volume:
    """The volume of a state, with the colours and opacities of labels that the state changes."""
    rows = state.label_rows
    return labels.with_table(volume, rows) if rows and volume.is_labels else volume
