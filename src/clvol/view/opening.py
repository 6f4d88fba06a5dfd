"""What a view is opened with: the scene taken apart, and the first state."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from clvol.base.checks import if_image, instance
from clvol.base.color import color_of
from clvol.base.errors import ChunkError, DataError, GeometryError, MissingSampleError, OptionError
from clvol.bricks.continued import holed
from clvol.bricks.source import LazyVolume
from clvol.device import Device
from clvol.interop.dispatch import is_in_parts
from clvol.march.choose import without_masked
from clvol.march.options import KEYWORDS, FurnitureOptions, require_one_step
from clvol.scene.camera import Camera
from clvol.scene.clip import as_clip, cuts_of
from clvol.scene.factor import as_factors
from clvol.scene.fit import usual_camera
from clvol.scene.look import look
from clvol.scene.mode import as_mode, modes
from clvol.scene.scene import Medium, Scene
from clvol.scene.transfer import FACTORS, is_curve
from clvol.show.furniture import Furniture
from clvol.spline.field import Field
from clvol.view.finer import Finer, resident_level
from clvol.view.panes import triple, vertical
from clvol.view.state import WORDS, CameraState, State, plain
from clvol.volume.volume import Volume, as_volume
from clvol.volume.volumes import Volumes

__all__ = ["Opened", "Viewable", "first_state", "in_memory", "opened"]

Viewable: TypeAlias = Scene | Medium | Volume | LazyVolume | Volumes | Field | ArrayLike
_OF_LIGHT = ("shadow", "shadow_rays", "occlusion", "linear_light")
_STATED = ("layout", "step", "transfer", *WORDS, *FACTORS, "material", "lights", *_OF_LIGHT, "background", "clip")


class Opened(NamedTuple):
    """A scene, taken apart."""

    volume: Volume  # the one that is shown first
    volumes: Volumes | None  # all, if there are several
    coefficients: Field | None  # of the volume, if they exist already
    finer: Finer | None  # all sizes of a volume of which only one is in memory
    device: Device | str | int | None
    source: str | None
    options: dict[str, Any]  # of `clvol.render`, that the scene or the caller gives
    scene: Scene | None  # of several media, of which the volume is the first's, or of one with a look that no state holds


def opened(
    scene: Viewable, device: Device | str | int | None, source: str | None, finer: Finer | None, options: dict[str, Any]
) -> Opened:
    """Take a scene apart; of a `LazyVolume` the largest size that fits is read, with NaN for what cannot be read."""
    theme = options.pop("theme", None)
    if theme is not None and Furniture(theme=theme).theme == "print":
        options = {"background": "white"} | options
    if (mask := options.pop("mask", None)) is not None:
        if isinstance(scene, Volumes):
            raise OptionError("mask takes one volume; got several, of which a view shows one at a time")
        scene, source = without_masked(scene, mask), None  # which no text of a file tells
    if isinstance(scene, LazyVolume):
        first_state(scene.preview(), dict(options))  # refuses wrong options before all samples are read
        level = resident_level(scene)
        if level:
            finer = Finer(scene, level, source, device)
        source = source and f"{source}{f'.levels[{level - 1}]' if level else ''}.whole()"
        one = (scene, *scene.levels)[level]
        try:
            scene = one.whole()
        except (ChunkError, MissingSampleError):
            scene = holed(one).whole()
    coefficients, several = None, None
    if isinstance(scene, Field):
        if "filter" in options or "boundary" in options or device is not None:
            raise OptionError("filter, boundary and device must be left to the field; got them beside it")
        coefficients, device = scene, scene.device
        scene = Medium(scene.coefficients.volume, filter=scene.filter, boundary=scene.boundary)
    volumes = scene if isinstance(scene, Volumes) else None
    if isinstance(scene, Medium) and scene.beyond_words:
        scene = Scene((scene,))
    if isinstance(scene, Scene):
        if any(is_in_parts(medium.volume) for medium in scene.media):
            scene, source = replace(scene, media=tuple(map(in_memory, scene.media))), None
        options = {name: getattr(scene, name) for name in ("lights", "background", "clip", *_OF_LIGHT)} | options
        scene = replace(scene, shadow=0.0, shadow_rays=False, occlusion=0.0, linear_light=False)  # the state has them
        several = scene if len(scene.media) > 1 or scene.media[0].beyond_words else None
        scene = scene.media[0]
    if isinstance(scene, Medium):
        options = _of_medium(scene, options)
        volume = scene.volume
    else:
        volume = as_volume(scene if volumes is None else volumes.first)
    if volume.ndim != 3:
        raise DataError(f"a view takes a volume of 3 axes [z, y, x]; got shape {volume.shape}{if_image(volume.shape)}")
    if finer is not None and (bounds := finer.stored.bounds) is not None:  # so that bounds are used, and all sizes look the same
        options |= {name: options.get(name) or getattr(bounds, name) for name in ("filter", "boundary")}
    if volume.is_labels:  # whose colours depend on the labels that are resident
        finer = None
    return Opened(volume, volumes, coefficients, finer, device, source, options, several)


def in_memory(medium: Medium) -> Medium:
    """A medium in memory: of a volume that is read by parts the largest size that fits."""
    volume: Any = medium.volume
    if not is_in_parts(volume):
        return medium
    return replace(medium, volume=(volume, *volume.levels)[resident_level(volume)].whole())


def _of_medium(medium: Medium, options: dict[str, Any]) -> dict[str, Any]:
    """The options, and what the medium has beside its volume."""
    given = {"material": medium.material} | medium.factors | options
    if not given.keys() & {"filter", "boundary"}:
        given |= {"filter": medium.filter, "boundary": medium.boundary}
    if not given.keys() & {"transfer", *WORDS}:
        given |= medium.words if medium.transfer is None else {"transfer": medium.transfer}
    return given


def first_state(volume: Volume, given: dict[str, Any]) -> State:
    """The state that shows what `clvol.render` draws with these options; raises `OptionError` like that."""
    camera, mode = given.pop("camera", None), given.pop("mode", None)
    for name in ("size", "outputs", "sigma", "progress"):
        if name in given:
            raise OptionError(f"{name} is no option of a view: its hosts decide it")
    row, boundary = given.pop("filter", None), given.pop("boundary", None)
    values = {name: given.pop(name) for name in _STATED if name in given}
    around = {name: given.pop(name) for name in FurnitureOptions.__annotations__ if name in given}
    chosen = as_mode("composite" if mode is None else mode, given, (*KEYWORDS, "filter", "boundary", "device"))
    if chosen.name not in modes():
        raise OptionError(f"mode must be one of {', '.join(modes())} in a view; got {chosen.name!r}")
    require_one_step(chosen, values.get("step"))
    default = type(chosen)()
    options = {f.name: getattr(chosen, f.name) for f in fields(chosen) if getattr(chosen, f.name) != getattr(default, f.name)}
    if is_curve(values.get("opacity")):
        values["transfer"] = look(volume, chosen, **{name: values.pop(name, None) for name in WORDS})
    if isinstance(values.get("background"), str):
        values["background"] = color_of("background", values["background"])
    if values.get("clip") is not None:
        try:
            cuts = cuts_of(as_clip(values["clip"]))
        except GeometryError as error:
            raise OptionError(str(error)) from None
        values |= {"clip": cuts.box, "cuts": (*cuts.planes, *cuts.corners)}
    factors = {name: values.pop(name) for name in FACTORS if is_curve(values.get(name))}
    if (bent := values.pop("curvature_opacity", None)) is not None:
        factors["curvature_opacity"] = as_factors("curvature_opacity", bent)
    if factors:
        transfer = values.get("transfer") or look(volume, chosen, **{name: values.pop(name, None) for name in WORDS})
        values["transfer"] = replace(transfer, **factors)
    for name in (*FACTORS, *_OF_LIGHT):
        if values.get(name) is None:
            values.pop(name, None)
    Scene((Medium(volume),), **{name: values[name] for name in _OF_LIGHT if name in values})  # refuses what changes nothing
    lights = values.get("lights")
    if lights is not None and not isinstance(lights, (list, tuple)):
        values["lights"] = (lights,)
    if camera is not None:
        instance("camera", camera, Camera)
    scan = volume.space == "LPS" and min(volume.size) > 1  # which is read by its slices
    values.setdefault("layout", "linked" if scan else "3d")
    return State(
        camera=_camera_state(volume, camera or usual_camera(volume)),
        mode=chosen.name,
        options={name: plain(value) for name, value in options.items()},
        furniture=Furniture(**{name: value for name, value in around.items() if value is not None}),
        filter=None if row is None else getattr(row, "name", row),
        boundary="mirror" if boundary is None else getattr(boundary, "name", boundary),
        **values,
    )


def _camera_state(volume: Volume, camera: Camera) -> CameraState:
    view = camera.view(volume)
    forward, up = view.forward, vertical(volume)
    level = abs(float(view.right @ up)) < 1e-9 and float(view.up @ up) > 1e-6
    distance, target = camera.distance, camera.target
    if camera.position is not None:
        aim = volume.center if target is None else np.asarray(target)
        distance, target = float(np.linalg.norm(aim - view.eye)), triple(aim)
    return CameraState(
        target=target,
        direction=triple(forward),
        up=triple(up if level else view.up),
        distance=distance,
        radius=camera.radius,
        zoom=camera.zoom,
        projection=camera.projection,
        fov=camera.fov,
        fit=camera.fit,
    )
