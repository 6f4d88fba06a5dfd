"""What the sessions of a view share: its volumes, their renderers on the device, and what follows from both."""

from __future__ import annotations

import contextlib
import re
import threading
from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any, Unpack

import numpy as np

from clvol.base.errors import ClvolError, OptionError
from clvol.device import Device
from clvol.filter.boundary import boundaries
from clvol.filter.table import filters
from clvol.formats.table import FORMATS
from clvol.march.options import ViewOptions, unheard
from clvol.march.slices import window_of_slices
from clvol.scene.camera import Camera
from clvol.scene.clip import joined
from clvol.scene.fit import Seen, box_around, fitted
from clvol.scene.joint import TransferFunction2D
from clvol.scene.look import look
from clvol.scene.mode import BY_DISTANCE, CURVATURES, Mode, as_mode, colored_by, mode_options, modes, tolerance_of
from clvol.scene.preset import label_color, presets
from clvol.scene.scene import Medium
from clvol.scene.transfer import TransferFunction
from clvol.view import media
from clvol.view.audience import Audience
from clvol.view.catalog import Catalog, Which, labelled
from clvol.view.events import KEYS
from clvol.view.finer import Finer, Wanted
from clvol.view.layers import Layers
from clvol.view.opening import Viewable, first_state, opened
from clvol.view.panes import PaneSize, SlicePane, camera_of, triple
from clvol.view.renderers import Renderers
from clvol.view.state import MOST_POINTS, WORDS, State, plain
from clvol.volume.smoothing import filter_for, settled
from clvol.volume.volume import Volume

__all__ = ["Resident", "stem", "targeted"]

_BINS = 256
_SAMPLED = 1 << 19  # samples of a histogram
_COLOR_MAPS = (
    "gray", "bone", "hot", "viridis", "magma", "inferno", "plasma", "cividis", "turbo", "coolwarm", "cool", "copper", "pink",
    "twilight", "cubehelix", "rainbow", "red", "green", "blue", "cyan", "magenta", "yellow",
)  # fmt: skip
_KINDS = ("color", "surfaces")  # controls of their own
_CHOICES: Mapping[str, list[str]] = {"method": ["exact", "stepped"], "color_by": ["none", *CURVATURES, BY_DISTANCE]}
_RANGES: Mapping[str, list[float]] = {
    "termination": [0, 0.5],
    "tolerance": [0.001, 1],
    "attenuation": [0, 40],
    "mu_water": [0.001, 0.1],
    "virtual": [0, 16],
}
_SCALES: Mapping[str, dict[str, Any]] = {"virtual": {"step": 1}, "tolerance": {"scale": "log"}, "mu_water": {"scale": "log"}}
_KEPT = 64  # descriptions of volumes
_LONGEST = 80  # characters of a name of files
_BESIDE = ("gradient", "rays", "pixel_filter", "skipping")  # passed on, and in no state


class Resident:
    """A scene and the device that draws it; parameters and errors are those of `clvol.view.View`.

    Nothing is computed on a device before the first picture.
    """

    def __init__(
        self,
        scene: Viewable,
        *,
        device: Device | str | int | None = None,
        source: str | None = None,
        name: str | None = None,
        finer: Finer | None = None,
        limits: Mapping[str, Any] | None = None,
        **options: Unpack[ViewOptions],
    ) -> None:
        found = opened(scene, device, source, finer, {**options})
        self.limits = dict(limits or {})
        self.finer, self.device, self.source, given = found.finer, found.device, found.source, found.options
        several = () if found.scene is None or len(found.scene.media) == 1 else found.scene.media
        self.catalog = Catalog(found.volume, found.volumes, lambda: self.renderers.in_use(), several)
        self.renderers = Renderers(self.catalog, self.device, found.coefficients, found.scene, self._learn, self.limits)
        self.name = name or (found.volume.name or "volume" if found.volumes is None else "volumes")
        self.mix = "add" if found.scene is None else found.scene.mix
        self.beyond = () if found.scene is None else found.scene.media[0].beyond_words
        """What the first medium has that no state holds."""
        self._colored = found.scene is not None and any(one.color_by is not None for one in found.scene.media)
        self.beside: dict[str, Any] = {name: given.pop(name) for name in _BESIDE if name in given}
        """Arguments of `clvol.render` that are not part of a state."""
        self.initial = first_state(found.volume, given)
        self.audience = Audience(lambda: self.initial)
        self.layers = Layers(self, found.scene)
        self._describing = threading.Lock()  # not the other lock: the description does not wait for what takes longer
        self._knowing = threading.RLock()  # what takes long is computed once, however many ask
        self._descriptions: dict[tuple[object, int], dict[str, Any]] = {}
        self.catalog.require(self.initial)
        if any(value is not None for value in self.initial.words.values()):
            self.transfer(self.initial)  # which only the volume can refuse
        self._require_heard_light()

    @property
    def volume(self) -> Volume:
        """The one that is shown first; all have its grid."""
        return self.catalog.volume

    def forget(self) -> None:
        """Make everything on the device anew for the next pictures: it failed."""
        self.renderers.forget()
        if self.finer is not None:
            self.finer.close()

    def close(self) -> None:
        """Free the device's memory; a later picture takes it again."""
        self.renderers.close()
        if self.finer is not None:
            self.finer.close()

    # -- what is drawn -----------------------------------------------------------------------------------------

    def arguments(self, state: State, *, bare: bool = False) -> dict[str, Any]:
        """Arguments of `Renderer.render` for the volume's picture in a state, except its size and outputs.

        A state keeps what only another mode or filter would show; a picture does not take it. `bare` leaves out what stands around.
        """
        given: dict[str, Any] = {"camera": camera_of(state), "mode": state.mode, "step": state.step, **self.beside}
        volume = self.catalog.volume_of(state)
        given_by_words = self._own_transfer(state) is None and labelled(volume, state) is volume
        words: dict[str, Any] = state.words if given_by_words else {"transfer": self.transfer(state)}
        words |= {name: getattr(state, name) for name in ("material", "lights", "clip")}
        of_light = "gradient_opacity", "shadow", "shadow_rays", "occlusion", "linear_light"
        words |= {name: getattr(state, name) or None for name in of_light}
        if state.cuts:
            words["clip"] = [*([state.clip] if state.clip else []), *state.cuts]
        given |= {name: value for name, value in words.items() if value is not None}
        given["background"] = state.background
        given |= {} if bare else state.furniture.given
        if self.catalog.media and (state.media or not as_mode(state.mode, state.options).grades):
            given["media"] = media.of_state(self.catalog.media, state)
        own = {name: tuple(v) if isinstance(v, list) else v for name, v in state.options.items()}
        return self._heard(state, given | own)

    def settled_arguments(self, state: State, aspect: float) -> dict[str, Any]:
        """`arguments` and what else follows from the resident samples, so that others show the same matter in the same place."""
        mode, transfer = self.mode(state), self.transfer(state)
        camera = self.placed(state, aspect)
        options = {f.name: getattr(mode, f.name) for f in fields(mode)}
        given = {name: value for name, value in self.arguments(state).items() if name not in WORDS}
        return self._heard(state, given | options | {
            "camera": camera if camera.radius is not None else replace(camera, radius=self.volume.radius),
            "transfer": transfer if transfer.unit_distance else replace(transfer, unit_distance=self.volume.mean_spacing),
        })  # fmt: skip

    def _heard(self, state: State, given: dict[str, Any]) -> dict[str, Any]:
        """The arguments that change something in the mode and with the filter of a state."""
        mode = as_mode(state.mode, state.options)
        left_out = (mode.unheard.keys() | unheard(mode, given)) - ({"color_bar"} if self._colored else set())
        row = filter_for(self.catalog.volume_of(state), state.filter, mode.picture_filter)
        if not row.has_gradient:
            left_out |= {"gradient", "virtual"}
        several = len(self.catalog.media) > 1
        left_out |= {"gradient_opacity"} if self._ungraded else set()
        transfer = given.get("transfer")
        if transfer and transfer.graded and not mode.grades:
            given = given | {"transfer": media.ungraded(transfer)}
        graded = "gradient_opacity" in given.keys() - left_out or (transfer and transfer.graded) or self._others_graded
        if graded or self._smooth:
            left_out |= {"shadow", "occlusion"}
        if several or "shadow" not in given.keys() - left_out:
            left_out |= {"shadow_rays"}
        if several or graded:
            left_out |= {"virtual"}
        if tolerance_of(mode) is not None:
            left_out |= {"step"}
        if (state.clip is None and not state.cuts) or (not several and {"surfaces", "smooth"} & set(self.beyond)):
            left_out |= {"cap"}
        return {name: value for name, value in given.items() if name not in left_out}

    def finer_picture(self, state: State, shown: PaneSize, name: str, size: tuple[int, int]) -> Wanted | None:
        """The picture of a pane by bricks; None if the resident samples show as much, or are all there are."""
        if self.finer is None or self.catalog.media:
            return None
        if name == "3d":
            given = self.settled_arguments(state, size[0] / size[1])
            return self.finer.wanted(state, size, given)
        pane = SlicePane.of(state, self.volume, "xyz".index(name), shown)
        return self.finer.wanted_slice(state, pane, size, state.slice_window or window_of_slices(self.volume))

    def mode(self, state: State) -> Mode:
        """The mode with its options as they are settled for the volume."""
        return as_mode(state.mode, state.options).settled(self.catalog.volume_of(state))

    def transfer(self, state: State) -> TransferFunction:
        """The transfer function of the volume's picture."""
        return self._own_transfer(state) or look(labelled(self.catalog.volume_of(state), state), self.mode(state), **state.words)

    def _own_transfer(self, state: State) -> TransferFunction | None:
        """That of the state, if what is shown takes one of its kind."""
        joint = isinstance(state.transfer, TransferFunction2D)
        return None if joint and (self._ungraded or not as_mode(state.mode).grades) else state.transfer

    @property
    def _ungraded(self) -> bool:
        """Whether the first medium's opacity depends on no gradient."""
        return bool(self.volume.is_labels or {"surfaces", "smooth"} & set(self.beyond))

    @property
    def _others_graded(self) -> bool:
        return any(one.factors or (one.transfer and one.transfer.graded) for one in self.catalog.media[1:])

    @property
    def _smooth(self) -> bool:
        return "smooth" in self.beyond or any(medium.smooth for medium in self.catalog.media)

    def _require_heard_light(self) -> None:
        """Raise `OptionError` for shadows of the first state that its picture would lack: light is stopped by values alone."""
        state, dark = self.initial, [name for name in ("shadow", "occlusion") if getattr(self.initial, name)]
        if dark and (mode := as_mode(state.mode, state.options)).shaded:
            given = self.arguments(state)
            graded = mode.grades and (given.get("gradient_opacity") or getattr(given.get("transfer"), "graded", 0))
            if graded or self._others_graded or self._smooth:
                what = "smooth surfaces of labels" if self._smooth and not graded else "opacity by the gradient or by curvature"
                raise OptionError(f"{' and '.join(dark)} must be left out beside {what}: light is stopped by values alone")

    def placed(self, state: State, aspect: float) -> Camera:
        """The camera with its target, as a picture of this aspect ratio has it."""
        volume = self.catalog.volume_of(state)
        first, *others = media.of_state(self.catalog.media, state) or (None,)
        seen = [self._seen(other, state) for other in others if other.visible]
        if first is None or first.visible or not seen:
            seen = [(volume, self.mode(state), self.transfer(state), state.clip), *seen]
        camera = state.furniture.in_view(camera_of(state), *box_around((one, clip) for one, _, _, clip in seen), aspect)
        camera = fitted(camera, *seen[0], aspect, others=seen[1:])
        return targeted(camera, self.volume)

    def _seen(self, other: Medium, state: State) -> Seen:
        """What of another medium a camera is fitted to."""
        mode = as_mode(state.mode, state.options).settled(other.volume)
        return other.volume, mode, other.transfer or look(other.volume, mode, **other.words), joined(state.clip, other.clip)

    def filter_name(self, state: State, filter: str | None) -> str:
        """The full name of a filter, with its smoothing as it is settled for the volume."""
        volume = self.catalog.volume_of(state)
        return settled(filter_for(volume, filter, self.mode(state).picture_filter), volume).name

    # -- for clients -------------------------------------------------------------------------------------------

    def effective(self, state: State) -> dict[str, Any]:
        """What applies where the state leaves it open: for a panel. The first time this takes long."""
        with self._knowing:
            which = self.catalog.which(state)
            volume = self.catalog.volume_at(which)
            found: dict[str, Any] = {
                "transfer": self._transfer_shown(state),
                "window": list(state.slice_window or window_of_slices(volume)),
                "filter": self.filter_name(state, state.filter),
                "crosshair": list(state.crosshair or map(float, self.volume.center)),
            }
            mode = self.mode(state)
            self.catalog.mark_known(which)
        found["options"] = {f.name: plain(getattr(mode, f.name)) for f in fields(mode)}
        return found

    def _learn(self, which: Which) -> None:
        """Compute what takes long; waits for a session that computes the same."""
        with contextlib.suppress(ClvolError):  # of the first state, which may not be what is drawn
            self.effective(self.catalog.state_of(which, self.initial))

    def _transfer_shown(self, state: State) -> dict[str, Any]:
        """The transfer function as a panel edits it; without points if there are more than a state may have, as of labels.

        Of labels it is that of all: one that is hidden now has its own colour when it comes back.
        """
        shown = self.transfer(replace(state, labels=None)).json()
        return shown if len(shown.get("points", ())) <= MOST_POINTS else shown | {"points": []}

    def info(self, state: State | None = None) -> dict[str, Any]:
        """The description of the volume, which is sent first and when another one is shown."""
        state = self.initial if state is None else state
        with self._describing:
            place = self.catalog.which(state).place
            key = place, self.layers.version
            if key not in self._descriptions:
                volume = self.catalog.volume_at(Which(place))
                described = _description(volume, self.name, self.catalog.axes(), self.catalog.labels(state))
                described["media"] = media.described(self.catalog.media, self.layers.names)
                described["stem"] = stem(self.name)
                described["stops_light"] = not (self._others_graded or self._smooth)
                while len(self._descriptions) >= _KEPT:
                    del self._descriptions[next(iter(self._descriptions))]
                self._descriptions[key] = described
            return self._descriptions[key]


def stem(name: str) -> str:
    """How names of saved files begin: as the volume's, without a file's suffix, of characters that files may have."""
    ends = [suffix for row in FORMATS for suffix in row.suffixes if name.lower().endswith(suffix)]
    name = name[: len(name) - max(map(len, ends), default=0)]
    return re.sub(r"[^\w.-]+", "-", name).strip("-.")[:_LONGEST] or "clvol"


def targeted(camera: Camera, volume: Volume) -> Camera:
    """The camera with its target: the volume's centre, if none is given."""
    return camera if camera.target is not None else replace(camera, target=triple(volume.center))


# -- the description of a volume, which a client gets first ----------------------------------------------------


def _description(volume: Volume, title: str, axes: list[dict[str, Any]], labels: tuple[list[list[Any]], int]) -> dict[str, Any]:
    """The `info` message of a volume; `axes` and `labels` are those of `Catalog`."""
    rows, count = labels
    return {
        "type": "info",
        "title": title,
        "volume": {
            "shape": list(volume.shape),
            "spacing": list(volume.spacing),
            "units": volume.units,
            "range": list(volume.value_range),
            "dtype": str(volume.data.dtype),
            "space": volume.space,
            "labels": bool(volume.is_labels),
            "bounds": [volume.corners.min(0).tolist(), volume.corners.max(0).tolist()],
            "center": volume.center.tolist(),
        },
        "axes": axes,
        "labels": {"count": count, "rows": rows} if volume.is_labels else None,
        "histogram": _histogram(volume),
        "modes": {name: _options(mode) for name, mode in modes().items()},
        "filters": [*filters(), "bspline3(auto)"],
        "boundaries": list(boundaries()),
        "presets": list(presets()),
        "colormaps": list(_COLOR_MAPS),
        "keys": dict(KEYS),
        "defaults": State().json(),
    }


def _options(mode: Mode) -> dict[str, Any]:
    says = mode_options(mode)
    settled = {"cap": mode.capped, "color_by": colored_by(mode) or "none"}  # "cap" may follow from another option
    return {f.name: _option(settled.get(f.name, getattr(mode, f.name)), f.name, says[f.name]) for f in fields(mode)}


def _option(default: Any, name: str, says: str) -> dict[str, Any]:
    kind = "flag" if isinstance(default, bool) else name if name in _KINDS else "choice" if name in _CHOICES else "number"
    option = {"kind": kind, "default": plain(default), "help": says}
    if name in _CHOICES:
        option["choices"] = _CHOICES[name]
    if name in _RANGES:
        option["range"] = _RANGES[name]
    return option | _SCALES.get(name, {})


def _histogram(volume: Volume) -> dict[str, list[Any]]:
    """Counts between edges, and of labels the number and the colour of each bar: those of the one it has most of."""
    low, high = volume.value_range
    stride = max(1, round(max(1.0, volume.data.size / _SAMPLED) ** (1 / 3)))
    some = volume.data[::stride, ::stride, ::stride].astype(np.float64).ravel()
    some = some[np.isfinite(some)]
    if not low < high:
        low, high = low - 0.5, high + 0.5
    whole = volume.data.dtype.kind in "biu" and high - low < _BINS
    span = (low - 0.5, high + 0.5) if whole else (low, high)  # a bin per value, centred on it
    bins = round(span[1] - span[0]) if whole else _BINS
    counts, edges = np.histogram(some, bins=bins, range=span)
    found: dict[str, list[Any]] = {"edges": edges.tolist(), "counts": counts.tolist()}
    if not volume.is_labels:
        return found
    labels: list[int | None] = [None] * bins
    numbers, often = np.unique(some, return_counts=True)
    background = 0 if 0 in numbers else numbers[often.argmax()] if numbers.size else 0
    for at in often.argsort(kind="stable"):
        if numbers[at] != background:
            labels[min(int(np.searchsorted(edges, numbers[at], "right")) - 1, bins - 1)] = int(numbers[at])
    colors = [None if label is None else [round(part, 4) for part in label_color(label, volume)] for label in labels]
    return found | {"labels": labels, "colors": colors}
