"""What the sessions of one view share: the volume, its renderers on the device, and what is known of both."""

from __future__ import annotations

import contextlib
import itertools
import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, NamedTuple, Unpack

import numpy as np
from numpy.typing import ArrayLike

from clvol import labels
from clvol.base import memory
from clvol.base.checks import instance
from clvol.base.errors import ClvolError, DataError, OptionError, OutOfMemoryError
from clvol.bricks.source import LazyVolume
from clvol.device import Device
from clvol.filter.boundary import boundaries
from clvol.filter.table import filters
from clvol.march.options import KEYWORDS, ViewOptions
from clvol.march.renderer import Renderer
from clvol.scene.camera import Camera
from clvol.scene.fit import fitted
from clvol.scene.look import look
from clvol.scene.mode import Mode, as_mode, mode_options, modes
from clvol.scene.palette import label_color
from clvol.scene.preset import presets
from clvol.scene.scene import Medium, Scene
from clvol.scene.transfer import TransferFunction
from clvol.spline.field import Field
from clvol.view.events import KEYS
from clvol.view.finer import Finer, Wanted, at_hand
from clvol.view.panes import PaneSize, SlicePane, camera_of, vertical
from clvol.view.slices import window_of_slices
from clvol.view.state import MOST_POINTS, CameraState, LabelState, State, transfer_json
from clvol.volume.smoothing import filter_for, settled
from clvol.volume.volume import Volume, as_volume
from clvol.volume.volumes import Volumes

__all__ = ["Resident", "Which", "targeted"]

_LARGE = 1 << 22  # samples of a volume whose coefficients take longer than a picture
_LARGE_LABELS = 1 << 25  # likewise where some labels are hidden, and nothing is solved
_KEPT = 2  # renderers that nobody uses: one to come back to
_SHARE = 4  # of the memory that is left: what the renderers of several volumes take together that nobody uses
_VIEWED = 64  # volumes of which it stays known what was found out
_LISTED = 200  # labels that a client is told of at once
_LONGEST = 200  # characters by which they are looked for
_BINS = 256
_LOOKED_AT = 1 << 19  # samples of a histogram
_BESIDE = ("gradient", "samples", "pixel_filter", "skipping")  # passed on, and in no state
_OF_SAMPLES = ("preset", "window", "cmap", "opacity")  # what only samples in memory decide
_STATED = ("step", "transfer", "preset", "window", "cmap", "opacity", "material", "lights", "background", "clip")
_COLOR_MAPS = (
    "gray", "bone", "hot", "viridis", "magma", "inferno", "plasma", "cividis", "turbo", "coolwarm", "cool", "copper", "pink",
    "twilight", "cubehelix", "rainbow",
)  # fmt: skip


class Which(NamedTuple):
    """What a picture is of: the place along each leading axis of several volumes, and which labels are seen."""

    place: tuple[int | str, ...] = ()
    labels: LabelState | None = None


_Key = tuple[str | None, str, Which]
"""Of a renderer: filter, boundary, volume."""


class _Listing:
    """The labels of a volume, at hand for every message that names some and for every search."""

    def __init__(self, volume: Volume) -> None:
        self.numbers = labels.numbers_of(volume)
        names = volume.labels if isinstance(volume.labels, dict) else {}
        self._names = {number: name.casefold() for number, name in names.items()}

    @cached_property
    def texts(self) -> list[str]:
        """Of each label its number, and its name in lower case, by which it is looked for."""
        names = self._names
        return [f"{n}\n{names[n]}" if n in names else str(n) for n in map(int, self.numbers.tolist())]

    def place(self, text: str) -> int | None:
        """Where the label stands whose number is written so."""
        if not text.removeprefix("-").isdecimal():
            return None
        at = int(np.searchsorted(self.numbers, float(text)))
        return at if at < self.numbers.size and str(int(self.numbers[at])) == text else None


@dataclass
class _Viewed:
    """A volume, once it is made, and whether it was found out what takes long of it."""

    volume: Volume | None = None
    known: bool = False
    making: threading.Lock = field(default_factory=threading.Lock)
    listing: _Listing | None = None


@dataclass
class _Entry:
    """A renderer, who uses it, and when it was last used."""

    making: threading.Lock = field(default_factory=threading.Lock)
    renderer: Renderer | None = None
    users: int = 0
    used: int = 0


class Resident:
    """A volume to be looked at; nothing is computed on a device before the first picture.

    Parameters
    ----------
    scene : Volume, LazyVolume, Volumes, Scene, Medium, Field or array-like, 3-D
        Of a `LazyVolume` the largest size is at hand that fits into half of the memory that is available, with its coefficients; a
        picture at rest whose pixels are finer is drawn by bricks. Of several volumes one is shown at a time: that of a state's
        `index`.
    device : Device, str or int, optional
    source : str, optional
        Python text by which copied programs get the volume, such as ``clvol.read("scan.nii.gz")``; of several, such as
        ``clvol.read_all("cells.tif")``.
    title : str, optional
        For people; by default the volume's name.
    finer : Finer, optional
        All sizes of what is stored, where `scene` is one that was read of it.
    limits : mapping, optional
        Limits of the device while it draws, as of `Device.limited`.
    **options
        Those of `clvol.render` but `size`, `outputs`, `sigma` and `progress`: what is shown first.

    Raises
    ------
    OptionError
        An unknown option, or a value that is not allowed.
    DataError
        The data are no volume.
    """

    def __init__(
        self,
        scene: Scene | Medium | Volume | LazyVolume | Volumes | Field | ArrayLike,
        *,
        device: Device | str | int | None = None,
        source: str | None = None,
        title: str | None = None,
        finer: Finer | None = None,
        limits: Mapping[str, Any] | None = None,
        **options: Unpack[ViewOptions],
    ) -> None:
        if isinstance(scene, LazyVolume):
            _initial(scene.preview(), {**options})  # what is wrong with them is told before all samples are read
            level = at_hand(scene)
            if level:
                finer = Finer(scene, level, source, device)
            source = source and f"{source}{f'.levels[{level - 1}]' if level else ''}.whole()"
            scene = (scene, *scene.levels)[level].whole()
        self.finer = finer
        """All sizes of the volume, of which one is at hand; None where that is all there is."""
        self._field: Field | None = None
        self.device = device
        self.limits = dict(limits or {})
        given: dict[str, Any] = {**options}
        if isinstance(scene, Field):
            if "filter" in given or "boundary" in given or device is not None:
                raise OptionError("filter, boundary and device must be left to the field; got them beside it")
            self._field, self.device = scene, scene.device
            scene = Medium(scene.coefficients.volume, filter=scene.filter, boundary=scene.boundary)
        self.volumes = scene if isinstance(scene, Volumes) else None
        """All volumes, where there are several."""
        if self.volumes is not None:
            leading = self.volumes.leading
            self._first = Which(tuple(map(leading.first, leading.axes)))
            scene = self.volumes.first
        else:
            self._first = Which()
        own = scene if isinstance(scene, Scene) else None
        if own is not None:
            medium = own.media[0]
        elif isinstance(scene, Medium):
            medium = scene
        else:
            medium = None
        volume = as_volume(scene) if medium is None else medium.volume  # type: ignore[arg-type]  # what is left
        if volume.is_labels:  # whose colours are of the labels at hand
            self.finer = None
        if volume.ndim != 3:
            raise DataError(f"a view takes a volume of 3 axes [z, y, x]; got shape {volume.shape}")
        self.volume = volume
        """The one that is shown first; all have its grid."""
        self.source = source
        self.title = title or (volume.name or "volume" if self.volumes is None else "volumes")
        if medium is not None and not (given.keys() & {"filter", "boundary"}):
            given["filter"], given["boundary"] = medium.filter, medium.boundary
        if medium is not None:
            given.setdefault("material", medium.material)
            if medium.transfer is not None and not given.keys() & {"transfer", "preset", "window", "cmap", "opacity"}:
                given["transfer"] = medium.transfer
        if own is not None:
            for name in ("lights", "background", "clip"):
                given.setdefault(name, getattr(own, name))
        if finer is not None and finer.stored.bounds is not None:  # so that bounds are of use, and what is at hand looks the same
            given["filter"] = given.get("filter") or finer.stored.bounds.filter
            given["boundary"] = given.get("boundary") or finer.stored.bounds.boundary
        self.beside: dict[str, Any] = {name: given.pop(name) for name in _BESIDE if name in given}
        """Arguments of `clvol.render` that no state has."""
        self.initial = _initial(volume, given)
        self._lock = threading.Lock()
        self._describing = threading.Lock()
        self._knowing = threading.RLock()  # what takes long to find out of the volume is found once, however many ask
        self._counter = itertools.count(1)
        self._entries: dict[_Key, _Entry] = {}
        self._makers: dict[_Key, threading.Thread] = {}
        self._made_for: _Key | None = None  # what a maker was last asked for
        self._one_by_one = threading.Lock()
        self._closed = 0  # how often
        self._choosing = threading.RLock()
        self._views: dict[Which, _Viewed] = {self._first: _Viewed(volume)}  # what was looked at last is last
        self._infos: dict[tuple[int | str, ...], dict[str, Any]] = {}
        if any(
            getattr(self.initial, name) is not None for name in ("preset", "window", "cmap", "opacity")
        ):  # what only the volume can refuse
            self.transfer(self.initial)

    # -- which volume ------------------------------------------------------------------------------------------

    def which(self, state: State) -> Which:
        """What a state shows.

        Raises
        ------
        OptionError
            There is no such axis, or no such place along it.
        """
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
            seen = None  # they are of another of the volumes
        return Which(place, seen)

    def _along(self, axis: str, choice: int | str) -> int | str:
        assert self.volumes is not None  # or there were no axes
        leading = self.volumes.leading
        return choice if axis == "channel" and choice and choice == leading.computed else leading.place(axis, choice)

    def require(self, state: State) -> None:
        """Raise what only the volume can refuse of a state: `OptionError` or another `ClvolError`."""
        place, seen = self.which(state)
        if state.labels is not None and self.volumes is None:  # else another of them may have such labels
            if seen is None:
                raise OptionError(f"labels must be left out, for the volume is no label map; got {state.labels!r:.200}")
            chosen = np.array(state.labels.hidden or state.labels.shown or (), np.float64)
            numbers = self._listing(Which(place)).numbers
            if unknown := [int(n) for n in chosen[~labels.among(numbers, chosen)]]:
                raise OptionError(f"labels must be some of the volume's; got {', '.join(map(str, unknown[:8]))}, which it has not")

    def stepped(self, state: State, by: int) -> State:
        """The next one of several volumes, or the one before: along time, or along the first axis that has several places."""
        if not (axes := self._axes()):
            return state
        axis = next((one for one in axes if one["axis"] == "time"), axes[0])
        places: list[int | str] = [axis["first"]] if axis["first"] else []
        places += range(axis["count"])
        now = places.index(self._along(axis["axis"], state.index.get(axis["axis"], axis["first"])))  # of a name its number
        to = places[min(max(now + by, 0), len(places) - 1)]
        return state if to == places[now] else replace(state, index={**state.index, axis["axis"]: to})

    def volume_of(self, state: State) -> Volume:
        """The volume that a state shows, with the labels that are seen."""
        return self.volume_at(self.which(state))

    def volume_at(self, which: Which) -> Volume:
        """The same, by what a state shows."""
        viewed = self._viewed(which)
        if viewed.volume is None:
            with viewed.making:  # made once, and not under `_choosing`: other sessions' messages do not wait for it
                if viewed.volume is None:
                    viewed.volume = self._taken(which)
        return viewed.volume

    def _taken(self, which: Which) -> Volume:
        if which.labels is None:
            return self._at(which.place)
        return _seen(self.volume_at(Which(which.place)), which.labels)

    def _listing(self, which: Which) -> _Listing:
        """The labels of all of a volume, found once."""
        volume, viewed = self.volume_at(which), self._viewed(which)
        with viewed.making:
            if viewed.listing is None:
                viewed.listing = _Listing(volume)
        return viewed.listing

    def knows(self, state: State) -> bool:
        """Whether `effective` was found once for the state's volume: what takes long of it depends on that alone."""
        which = self.which(state)
        with self._choosing:
            found = self._views.get(which)
            return found is not None and found.known

    def _at(self, place: tuple[int | str, ...]) -> Volume:
        assert self.volumes is not None  # or there were no places
        return self.volumes.pick(**dict(zip(self.volumes.axes, place, strict=True)))

    def _viewed(self, which: Which) -> _Viewed:
        with self._choosing:
            found = self._views.pop(which, None) or _Viewed()
            self._views[which] = found
            with self._lock:
                used = {key[2] for key in self._entries}
            unused = [
                one for one, viewed in self._views.items() if one not in used and one != self._first and not viewed.making.locked()
            ]
            own = [one for one in unused if one.labels is not None or any(isinstance(at, str) for at in one.place)]
            for old in {*unused[:-_VIEWED], *own[:-1]}:  # those with samples of their own take memory
                del self._views[old]
            return found

    # -- on the device -----------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def renderer(self, filter: str | None, boundary: str, which: Which | None = None) -> Iterator[Renderer]:
        """The renderer of a filter, made for its first picture; the last two stay when nobody uses them.

        Of several volumes more of them stay, while they take no more than a quarter of the memory that is left.

        Parameters
        ----------
        filter, boundary : str
        which : Which, optional
            Of a state; by default the first volume, all of it.
        """
        key = filter, boundary, which or self._first
        with self._lock:
            entry = self._entries.setdefault(key, _Entry())
            entry.users += 1
            entry.used = next(self._counter)
        try:
            with entry.making:
                if entry.renderer is None:
                    entry.renderer = self._made(key)
                    with contextlib.suppress(ClvolError):  # of that state, which need not be what is drawn
                        self.effective(self._first_of(key[2]))  # waits for a session that finds out the same
            with entry.renderer.device.limited(**self.limits) if self.limits else contextlib.nullcontext():
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

    def _first_of(self, which: Which) -> State:
        """The state that is shown first, of another volume."""
        axes = self.volumes.axes if self.volumes is not None else ()
        return replace(self.initial, index=dict(zip(axes, which.place, strict=True)), labels=which.labels)

    def soon(self, filter: str | None, boundary: str, which: Which | None = None) -> bool:
        """Whether the renderer of a filter is there, or the volume so small that it is made at once."""
        which = which or self._first
        with self._lock:
            entry = self._entries.get((filter, boundary, which))
        made = entry is not None and entry.renderer is not None
        large = _LARGE_LABELS if which.labels is not None and filter in (None, "nearest") else _LARGE
        return made or (self._field is not None and which == self._first) or self.volume.data.size < large

    def maker(self, filter: str | None, boundary: str, which: Which | None = None) -> threading.Thread:
        """A thread that makes the renderer of a filter, for a session that shows something else meanwhile.

        They work one after the other, and leave undone what another filter was asked for instead of: whoever draws makes it then.
        """
        key, closed = (filter, boundary, which or self._first), self._closed

        def make() -> None:
            try:
                with self._one_by_one:
                    if self._made_for == key and self._closed == closed:
                        with contextlib.suppress(Exception), self.renderer(*key):  # who draws with it is told
                            pass
            finally:
                with self._lock:
                    del self._makers[key]
            if self._closed != closed:
                self._free(0)

        with self._lock:
            self._made_for = key
            if key not in self._makers:
                self._makers[key] = threading.Thread(target=make, name="clvol view: coefficients", daemon=True)
                self._makers[key].start()
            return self._makers[key]

    def _made(self, key: _Key) -> Renderer:
        own = self._field
        if own is not None and key == (own.filter.name, own.boundary.name, self._first):
            return Renderer(own)
        row, boundary, which = key
        volume = self.volume_at(which)
        try:
            return Renderer(volume, row, boundary, self.device)
        except OutOfMemoryError:
            self._free(0)
            return Renderer(volume, row, boundary, self.device)

    def _free(self, kept: int) -> None:
        """Close all renderers that nobody uses, but the last few; of several volumes as many as there is room for."""
        with self._lock:
            idle = {key: e.renderer for key, e in self._entries.items() if not e.users and e.renderer is not None}
            latest = sorted(idle, key=lambda key: -self._entries[key].used)
            room = memory.available() // _SHARE if self.volumes is not None and kept else 0
            taken = list(itertools.accumulate(idle[key].field.nbytes for key in latest))
            gone = [self._entries.pop(key) for i, key in enumerate(latest) if i >= kept and taken[i] > room]
        for entry in gone:
            if entry.renderer is not None:
                entry.renderer.close()

    def forget(self) -> None:
        """Renderers are made anew for the next pictures: the device failed."""
        with self._lock:
            gone, self._entries = list(self._entries.values()), {}
        for entry in gone:
            if entry.users:
                continue  # another client's picture: who draws it last closes it
            if entry.renderer is not None:
                with contextlib.suppress(Exception):  # of a device that failed
                    entry.renderer.close()
        if self.finer is not None:
            self.finer.close()

    def close(self) -> None:
        """Free the device's memory; a later picture takes it again."""
        self._closed += 1
        self._free(0)
        if self.finer is not None:
            self.finer.close()

    # -- what is drawn -----------------------------------------------------------------------------------------

    def arguments(self, state: State) -> dict[str, Any]:
        """Arguments of `Renderer.render` for the volume's picture in a state, but its size and outputs."""
        made: dict[str, Any] = {"camera": camera_of(state), "mode": state.mode, "step": state.step, **self.beside}
        if state.transfer is not None:
            made["transfer"] = state.transfer
        else:
            words = {name: getattr(state, name) for name in ("preset", "window", "cmap", "opacity")}
            made |= {name: value for name, value in words.items() if value is not None}
        for name in ("material", "lights", "clip"):
            if getattr(state, name) is not None:
                made[name] = getattr(state, name)
        made["background"] = state.background
        return made | {name: tuple(v) if isinstance(v, list) else v for name, v in state.options.items()}

    def seen(self, state: State, aspect: float) -> dict[str, Any]:
        """`arguments`, saying what else follows from the samples at hand: by them others show the same matter in the same place."""
        mode, transfer = self.mode(state), self.transfer(state)
        camera = self.placed(state, aspect)
        options = {f.name: getattr(mode, f.name) for f in fields(mode)}
        given = {name: value for name, value in self.arguments(state).items() if name not in _OF_SAMPLES}
        return given | options | {
            "camera": camera if camera.radius is not None else replace(camera, radius=self.volume.radius),
            "transfer": transfer if transfer.unit_distance else replace(transfer, unit_distance=self.volume.mean_spacing),
        }  # fmt: skip

    def finer_than_at_hand(self, state: State, shown: PaneSize, name: str, size: tuple[int, int]) -> Wanted | None:
        """The picture of a pane by bricks; None if what is at hand shows as much, or is all there is."""
        if self.finer is None:
            return None
        if name == "3d":
            return self.finer.wanted(state, size, self.seen(state, size[0] / size[1]))
        pane = SlicePane.of(state, self.volume, "xyz".index(name), shown)
        return self.finer.wanted_slice(state, pane, size, state.window or window_of_slices(self.volume))

    def mode(self, state: State) -> Mode:
        """The mode with its options, as it is settled for the volume."""
        return as_mode(state.mode, state.options).settled(self.volume_of(state))

    def transfer(self, state: State) -> TransferFunction:
        """The transfer function of the volume's picture."""
        if state.transfer is not None:
            return state.transfer
        words = {name: getattr(state, name) for name in ("preset", "window", "cmap", "opacity")}
        return look(self.volume_of(state), self.mode(state), **words)

    def placed(self, state: State, aspect: float) -> Camera:
        """The camera with its target, as a picture of this aspect has it."""
        volume = self.volume_of(state)
        camera = fitted(camera_of(state), volume, self.mode(state), self.transfer(state), state.clip, aspect)
        return targeted(camera, self.volume)

    def filter_name(self, state: State, filter: str | None) -> str:
        """The filter of the volume's picture by its full name, with its smoothing as it is for the volume."""
        volume = self.volume_of(state)
        return settled(filter_for(volume, filter, self.mode(state).picture_filter), volume).name

    def effective(self, state: State) -> dict[str, Any]:
        """What applies where the state leaves it open: for a panel."""
        with self._knowing:
            which = self.which(state)
            viewed, volume = self._viewed(which), self.volume_at(which)
            found: dict[str, Any] = {
                "transfer": self._transfer_shown(state),
                "window": list(state.window or window_of_slices(volume)),
                "filter": self.filter_name(state, state.filter),
                "crosshair": list(state.crosshair or map(float, self.volume.center)),
            }
            mode = self.mode(state)
            viewed.known = True
        found["options"] = {f.name: _json_value(getattr(mode, f.name)) for f in fields(mode)}
        return found

    def _transfer_shown(self, state: State) -> dict[str, Any]:
        """The transfer function as a panel edits it; without points where there are more than a state may have, as of labels.

        Of labels it is that of all: one that is hidden now has its own colour when it comes back.
        """
        made = transfer_json(self.transfer(replace(state, labels=None)))
        return made if len(made["points"]) <= MOST_POINTS else made | {"points": []}

    def labels(self, state: State, words: str = "") -> tuple[list[list[Any]], int]:
        """The first of the labels of a state's volume of which the name or the number has these words, and how many have.

        Each is its number, its name or "", and its colour.
        """
        if not isinstance(words, str) or len(words) > _LONGEST:
            raise OptionError(f"labels are looked for by a text of up to {_LONGEST} characters; got {words!r:.60}")
        which = Which(self.which(state).place)
        volume = self.volume_at(which)
        if not volume.is_labels:
            return [], 0
        listing, sought = self._listing(which), words.strip().casefold()
        places: Sequence[int] = range(listing.numbers.size)
        if sought:
            places = [i for i, text in enumerate(listing.texts) if sought in text]
            own = listing.place(sought)
            if own is not None:  # the one of exactly that number first
                places = [own, *(i for i in places if i != own)]
        numbers = [int(listing.numbers[i]) for i in places[:_LISTED]]
        return [[n, labels.name_of(volume, n), list(label_color(n))] for n in numbers], len(places)

    def info(self, state: State | None = None) -> dict[str, Any]:
        """What a client is told first, and again of another volume."""
        state = self.initial if state is None else state
        with self._describing:  # not the other lock: whoever is told first does not wait for what takes longer
            return self._info_found(state)

    def _info_found(self, state: State) -> dict[str, Any]:
        place = self.which(state).place
        if place not in self._infos:
            volume = self.volume_at(Which(place))
            low, high = volume.value_range
            counts, edges = _histogram(volume)
            rows, count = self.labels(state)
            while len(self._infos) >= _VIEWED:
                del self._infos[next(iter(self._infos))]
            self._infos[place] = {
                "type": "info",
                "title": self.title,
                "volume": {
                    "shape": list(volume.shape),
                    "spacing": list(volume.spacing),
                    "units": volume.units,
                    "range": [low, high],
                    "dtype": str(volume.data.dtype),
                    "space": volume.space,
                    "labels": bool(volume.is_labels),
                    "bounds": [volume.corners.min(0).tolist(), volume.corners.max(0).tolist()],
                    "center": volume.center.tolist(),
                },
                "axes": self._axes(),
                "labels": {"count": count, "rows": rows} if volume.is_labels else None,
                "histogram": {"edges": edges, "counts": counts},
                "modes": {name: _described(mode) for name, mode in modes().items()},
                "filters": [*filters(), "bspline3(auto)"],
                "boundaries": list(boundaries()),
                "presets": list(presets()),
                "colormaps": list(_COLOR_MAPS),
                "keys": dict(KEYS),
            }
        return self._infos[place]

    def _axes(self) -> list[dict[str, Any]]:
        """The leading axes of several volumes that have more than one place: what each counts, and the names of its places."""
        if self.volumes is None:
            return []
        found: list[dict[str, Any]] = []
        for axis, count in zip(self.volumes.axes, self.volumes.leading.counts, strict=True):
            first = self.volumes.leading.first(axis)
            if count > 1 or first:
                names = [name or str(i) for i, name in enumerate(self.volumes.leading.names.get(axis, ()))]
                found.append({"axis": axis, "count": count, "names": names[:_LISTED], "first": first})
        return found


def _seen(volume: Volume, chosen: LabelState) -> Volume:
    if chosen.hidden is not None:
        return labels.without(volume, chosen.hidden)
    return labels.only(volume, chosen.shown or ())


def targeted(camera: Camera, volume: Volume) -> Camera:
    """The camera with its target: the volume's centre, where none is given."""
    if camera.target is not None:
        return camera
    x, y, z = (float(v) for v in volume.center)
    return replace(camera, target=(x, y, z))


def _initial(volume: Volume, given: dict[str, Any]) -> State:
    """The first state, from arguments of `clvol.render`."""
    camera, mode = given.pop("camera", None), given.pop("mode", None)
    for name in ("size", "outputs", "sigma", "progress"):
        if name in given:
            raise OptionError(f"{name} is no option of a view: its hosts decide it")
    row, boundary = given.pop("filter", None), given.pop("boundary", None)
    values = {name: given.pop(name) for name in _STATED if name in given}
    chosen = as_mode("composite" if mode is None else mode, given, (*KEYWORDS, "filter", "boundary", "device"))
    if chosen.name not in modes():
        raise OptionError(f"mode must be one of {', '.join(modes())} in a view; got {chosen.name!r}")
    default = type(chosen)()
    options = {f.name: getattr(chosen, f.name) for f in fields(chosen) if getattr(chosen, f.name) != getattr(default, f.name)}
    if "opacity" in values and values["opacity"] is not None and np.ndim(np.asarray(values["opacity"], dtype=object)) > 0:
        words = {name: values.pop(name, None) for name in ("preset", "window", "cmap", "opacity")}
        values["transfer"] = look(volume, chosen, **words)
    if "background" in values and isinstance(values["background"], str):
        from clvol.base.color import color_of

        values["background"] = color_of("background", values["background"])
    lights = values.get("lights")
    if lights is not None and not isinstance(lights, (list, tuple)):
        values["lights"] = (lights,)
    if camera is not None:
        instance("camera", camera, Camera)
    return State(
        camera=_camera_state(volume, camera or Camera.orbit()),
        mode=chosen.name,
        options={name: _json_value(value) for name, value in options.items()},
        filter=None if row is None else getattr(row, "name", row),
        boundary="mirror" if boundary is None else getattr(boundary, "name", boundary),
        **values,
    )


def _camera_state(volume: Volume, camera: Camera) -> CameraState:
    view = camera.view(volume)
    forward, up = view.forward, vertical(volume)
    level = abs(float(view.right @ up)) < 1e-9 and float(view.up @ up) > 1e-6
    distance, target, radius = camera.distance, camera.target, camera.radius
    if camera.position is not None:
        aim = volume.center if target is None else np.asarray(target)
        distance, target = float(np.linalg.norm(aim - view.eye)), tuple(map(float, aim))  # type: ignore[assignment]  # three
    return CameraState(
        target=target,
        direction=tuple(map(float, forward)),  # type: ignore[arg-type]  # three
        up=tuple(map(float, up if level else view.up)),  # type: ignore[arg-type]
        distance=distance,
        radius=radius,
        zoom=camera.zoom,
        projection=camera.projection,
        fov=camera.fov,
        fit=camera.fit,
    )


def _json_value(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def _described(mode: Mode) -> dict[str, Any]:
    says = mode_options(mode)
    return {f.name: _option(getattr(mode, f.name), f.name, says[f.name]) for f in fields(mode)}


_CHOICES: Mapping[str, list[str]] = {"method": ["exact", "stepped"]}
_RANGES: Mapping[str, list[float]] = {"termination": [0, 0.5], "tolerance": [0, 1], "attenuation": [0, 40]}


def _option(default: Any, name: str, says: str) -> dict[str, Any]:
    kind = "flag" if isinstance(default, bool) else "color" if name == "color" else "choice" if name in _CHOICES else "number"
    made = {"kind": kind, "default": _json_value(default), "help": says}
    if name in _CHOICES:
        made["choices"] = _CHOICES[name]
    if name in _RANGES:
        made["range"] = _RANGES[name]
    return made


def _histogram(volume: Volume) -> tuple[list[int], list[float]]:
    low, high = volume.value_range
    each = max(1, round(max(1.0, volume.data.size / _LOOKED_AT) ** (1 / 3)))
    some = volume.data[::each, ::each, ::each].astype(np.float64).ravel()
    some = some[np.isfinite(some)]
    if not low < high:
        low, high = low - 0.5, high + 0.5
    whole = volume.data.dtype.kind in "biu" and high - low < _BINS
    span = (low - 0.5, high + 0.5) if whole else (low, high)  # a bin each, in the middle of which the value lies
    bins = round(span[1] - span[0]) if whole else _BINS
    counts, edges = np.histogram(some, bins=bins, range=span)
    return [int(n) for n in counts], [float(e) for e in edges]
