"""What the sessions of one view share: the volume, its renderers on the device, and what is known of both."""

from __future__ import annotations

import contextlib
import inspect
import itertools
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clvol.boundary import boundaries
from clvol.camera import Camera
from clvol.checks import instance
from clvol.device import Device
from clvol.errors import ClvolError, DataError, OptionError, OutOfMemoryError
from clvol.filter import filters
from clvol.fit import fitted
from clvol.lazy import LazyVolume
from clvol.look import look
from clvol.march.renderer import Renderer
from clvol.mode import Mode, as_mode, mode_options, modes
from clvol.preset import presets
from clvol.scene import Medium, Scene
from clvol.smoothing import filter_for, settled
from clvol.spline.field import Field
from clvol.transfer import TransferFunction
from clvol.view.events import KEYS
from clvol.view.finer import Finer, at_hand
from clvol.view.panes import camera_of, vertical
from clvol.view.slices import window_of_slices
from clvol.view.state import MOST_POINTS, CameraState, State, transfer_json
from clvol.volume import Volume, as_volume

__all__ = ["Resident", "targeted"]

_LARGE = 1 << 22  # samples of a volume whose coefficients take longer than a picture
_KEPT = 2  # renderers that nobody uses: one to come back to
_BINS = 256
_LOOKED_AT = 1 << 19  # samples of a histogram
_BESIDE = ("gradient", "samples", "pixel_filter", "skipping", "evaluator", "fetch")  # passed on, and in no state
_OF_SAMPLES = ("preset", "window", "cmap", "opacity", "evaluator", "fetch")  # what only samples at hand decide, or have
_STATED = ("step", "transfer", "preset", "window", "cmap", "opacity", "material", "lights", "background", "clip")
_COLOR_MAPS = (
    "gray", "bone", "hot", "viridis", "magma", "inferno", "plasma", "cividis", "turbo", "coolwarm", "cool", "copper", "pink",
    "twilight", "cubehelix", "rainbow",
)  # fmt: skip


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
    scene : Volume, LazyVolume, Scene, Medium, Field or array-like, 3-D
        Of a `LazyVolume` the largest size is at hand that fits into half of the memory that is available, with its coefficients; a
        picture at rest whose pixels are finer is drawn by bricks.
    device : Device, str or int, optional
    source : str, optional
        Python text by which copied programs get the volume, such as ``clvol.read("scan.nii.gz")``.
    title : str, optional
        For people; by default the volume's name.
    finer : Finer, optional
        All sizes of what is stored, where `scene` is one that was read of it.
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
        scene: Scene | Medium | Volume | LazyVolume | Field | ArrayLike,
        *,
        device: Device | str | int | None = None,
        source: str | None = None,
        title: str | None = None,
        finer: Finer | None = None,
        **options: Any,
    ) -> None:
        if isinstance(scene, LazyVolume):
            level = at_hand(scene)
            if level:
                finer = Finer(scene, level, device, source)
            source = source and f"{source}{f'.levels[{level - 1}]' if level else ''}.whole()"
            scene = (scene, *scene.levels)[level].whole()
        self.finer = finer
        """All sizes of the volume, of which one is at hand; None where that is all there is."""
        self._field: Field | None = None
        self.device = device
        given = dict(options)
        if isinstance(scene, Field):
            if "filter" in given or "boundary" in given or device is not None:
                raise OptionError("filter, boundary and device must be left to the field; got them beside it")
            self._field, self.device = scene, scene.device
            scene = Medium(scene.coefficients.volume, filter=scene.filter, boundary=scene.boundary)
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
        self.source = source
        self.title = title or volume.name or "volume"
        if medium is not None and not (given.keys() & {"filter", "boundary"}):
            given["filter"], given["boundary"] = medium.filter, medium.boundary
        if medium is not None:
            given.setdefault("material", medium.material)
            if medium.transfer is not None and not given.keys() & {"transfer", "preset", "window", "cmap", "opacity"}:
                given["transfer"] = medium.transfer
        if own is not None:
            for name in ("lights", "background", "clip"):
                given.setdefault(name, getattr(own, name))
        self.beside: dict[str, Any] = {name: given.pop(name) for name in _BESIDE if name in given}
        """Arguments of `clvol.render` that no state has."""
        self.initial = _initial(volume, given)
        self._lock = threading.Lock()
        self._describing = threading.Lock()
        self._knowing = threading.RLock()  # what takes long to find out of the volume is found once, however many ask
        self._counter = itertools.count(1)
        self._entries: dict[tuple[str | None, str], _Entry] = {}
        self._makers: dict[tuple[str | None, str], threading.Thread] = {}
        self._made_for: tuple[str | None, str] | None = None  # what a maker was last asked for
        self._one_by_one = threading.Lock()
        self._closed = 0  # how often
        self.known = False
        """Whether `effective` was found once: what takes long of it depends on the volume alone."""
        self._info: dict[str, Any] | None = None
        if any(
            getattr(self.initial, name) is not None for name in ("preset", "window", "cmap", "opacity")
        ):  # what only the volume can refuse
            self.transfer(self.initial)

    # -- on the device -----------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def renderer(self, filter: str | None, boundary: str) -> Iterator[Renderer]:
        """The renderer of a filter, made for its first picture; the last two stay when nobody uses them."""
        key = filter, boundary
        with self._lock:
            entry = self._entries.setdefault(key, _Entry())
            entry.users += 1
            entry.used = next(self._counter)
        try:
            with entry.making:
                if entry.renderer is None:
                    entry.renderer = self._made(filter, boundary)
                    with contextlib.suppress(ClvolError):  # of that state, which need not be what is drawn
                        self.effective(self.initial)  # waits for a session that finds out the same
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

    def soon(self, filter: str | None, boundary: str) -> bool:
        """Whether the renderer of a filter is there, or the volume so small that it is made at once."""
        with self._lock:
            entry = self._entries.get((filter, boundary))
        made = entry is not None and entry.renderer is not None
        return made or self._field is not None or self.volume.data.size < _LARGE

    def maker(self, filter: str | None, boundary: str) -> threading.Thread:
        """A thread that makes the renderer of a filter, for a session that shows something else meanwhile.

        They work one after the other, and leave undone what another filter was asked for instead of: whoever draws makes it then.
        """
        key, closed = (filter, boundary), self._closed

        def make() -> None:
            try:
                with self._one_by_one:
                    if self._made_for == key and self._closed == closed:
                        with contextlib.suppress(Exception), self.renderer(filter, boundary):  # who draws with it is told
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

    def _made(self, filter: str | None, boundary: str) -> Renderer:
        own = self._field
        if own is not None and filter == own.filter.name and boundary == own.boundary.name:
            return Renderer(own)
        try:
            return Renderer(self.volume, filter, boundary, self.device)
        except OutOfMemoryError:
            self._free(0)
            return Renderer(self.volume, filter, boundary, self.device)

    def _free(self, kept: int) -> None:
        """Close all renderers that nobody uses, but the last few."""
        with self._lock:
            idle = sorted((e.used, key) for key, e in self._entries.items() if not e.users and e.renderer is not None)
            gone = [self._entries.pop(key) for _, key in (idle[: len(idle) - kept] if kept else idle)]
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

    def mode(self, state: State) -> Mode:
        """The mode with its options, as it is settled for the volume."""
        return as_mode(state.mode, state.options).settled(self.volume)

    def transfer(self, state: State) -> TransferFunction:
        """The transfer function of the volume's picture."""
        if state.transfer is not None:
            return state.transfer
        return look(self.volume, self.mode(state), preset=state.preset, window=state.window, cmap=state.cmap, opacity=state.opacity)

    def placed(self, state: State, aspect: float) -> Camera:
        """The camera with its target, as a picture of this aspect has it."""
        camera = fitted(camera_of(state), self.volume, self.mode(state), self.transfer(state), state.clip, aspect)
        return targeted(camera, self.volume)

    def filter_name(self, state: State, filter: str | None) -> str:
        """The filter of the volume's picture by its full name, with its smoothing as it is for the volume."""
        return settled(filter_for(self.volume, filter, self.mode(state).picture_filter), self.volume).name

    def effective(self, state: State) -> dict[str, Any]:
        """What applies where the state leaves it open: for a panel."""
        with self._knowing:
            found: dict[str, Any] = {
                "transfer": self._transfer_shown(state),
                "window": list(state.window or window_of_slices(self.volume)),
                "filter": self.filter_name(state, state.filter),
                "crosshair": list(state.crosshair or map(float, self.volume.center)),
            }
            mode = self.mode(state)
            self.known = True
        found["options"] = {f.name: _json_value(getattr(mode, f.name)) for f in fields(mode)}
        return found

    def _transfer_shown(self, state: State) -> dict[str, Any]:
        """The transfer function as a panel edits it; without points where there are more than a state may have, as of labels."""
        made = transfer_json(self.transfer(state))
        return made if len(made["points"]) <= MOST_POINTS else made | {"points": []}

    def info(self) -> dict[str, Any]:
        """What a client is told first."""
        with self._describing:  # not the other lock: whoever is told first does not wait for what takes longer
            return self._info_found()

    def _info_found(self) -> dict[str, Any]:
        if self._info is None:
            volume = self.volume
            low, high = volume.value_range
            counts, edges = _histogram(volume)
            self._info = {
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
                "histogram": {"edges": edges, "counts": counts},
                "modes": {name: _described(mode) for name, mode in modes().items()},
                "filters": [*filters(), "bspline3(auto)"],
                "boundaries": list(boundaries()),
                "presets": list(presets()),
                "colormaps": list(_COLOR_MAPS),
                "keys": dict(KEYS),
            }
        return self._info


def targeted(camera: Camera, volume: Volume) -> Camera:
    """The camera with its target: the volume's centre, where none is given."""
    if camera.target is not None:
        return camera
    x, y, z = (float(v) for v in volume.center)
    return replace(camera, target=(x, y, z))


def _initial(volume: Volume, given: dict[str, Any]) -> State:
    """The first state, from arguments of `clvol.render`."""
    known = tuple(name for name in inspect.signature(Renderer.render).parameters if name not in ("self", "options"))
    camera, mode = given.pop("camera", None), given.pop("mode", None)
    for name in ("size", "outputs", "sigma", "progress"):
        if name in given:
            raise OptionError(f"{name} is no option of a view: its hosts decide it")
    row, boundary = given.pop("filter", None), given.pop("boundary", None)
    values = {name: given.pop(name) for name in _STATED if name in given}
    chosen = as_mode("composite" if mode is None else mode, given, (*known, "filter", "boundary", "device"))
    if chosen.name not in modes():
        raise OptionError(f"mode must be one of {', '.join(modes())} in a view; got {chosen.name!r}")
    default = type(chosen)()
    options = {f.name: getattr(chosen, f.name) for f in fields(chosen) if getattr(chosen, f.name) != getattr(default, f.name)}
    if "opacity" in values and values["opacity"] is not None and np.ndim(np.asarray(values["opacity"], dtype=object)) > 0:
        words = {name: values.pop(name, None) for name in ("preset", "window", "cmap", "opacity")}
        values["transfer"] = look(volume, chosen, **words)
    if "background" in values and isinstance(values["background"], str):
        from clvol.color import color_of

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
