"""What made a picture, with nothing left open: it is drawn again from it, to the bit, also from the text in its file."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

import clvol
from clvol.base import serial
from clvol.base.checks import instance
from clvol.base.errors import FormatError, OptionError
from clvol.base.srgb import on
from clvol.filter import boundary
from clvol.filter import filter as filters
from clvol.march.bands import with_virtual
from clvol.march.options import OF_SCENE, ResolvedLook
from clvol.march.refine import Refined
from clvol.scene import camera, clip, joint, light, mode, scene, transfer
from clvol.scene.fit import box_around
from clvol.scene.mode import BY_LABEL, colored_by
from clvol.show.furniture import Bar, Furnished, Furniture, Stage, furnished
from clvol.show.picture import as_pictures
from clvol.volume.histogram import label_numbers
from clvol.volume.provenance import facts_of, provenance_of, recognise
from clvol.volume.volume import Volume, table_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clvol.march.options import Fineness, RefineOptions
    from clvol.march.source import Source
    from clvol.show.picture import Picture

__all__ = ["CLASSES", "Recipe", "Staged", "grid_of", "look_of", "staged"]

VERSION = 1
"""Of the text; another is refused."""

_FORCED = ("evaluator", "fetch")  # limits of a device that change roundings


@dataclass(frozen=True, eq=False)
class Recipe:
    """What made a picture.

    Attributes
    ----------
    scene : Scene
        With all that was left open decided. Of a LazyVolume, and in another process, its volume is the grid alone.
    camera : Camera
        With the place that was fitted.
    mode : Mode
    size, step, rays, pixel_filter, lod, central
        How finely it was drawn.
    furniture : Furniture or None
    by_bricks : bool
    bricked : tuple of int
        Of several media the numbers of those that were read by bricks.
    limits : mapping
        Limits of the device that change roundings, where they were set.
    device : str
        Its name.
    """

    scene: scene.Scene
    camera: camera.Camera
    mode: mode.Mode
    size: tuple[int, int]
    step: float
    rays: int | Literal["auto"]
    pixel_filter: filters.Filter
    lod: float
    central: bool = False
    furniture: Furniture | None = None
    by_bricks: bool = False
    bricked: tuple[int, ...] = ()
    limits: Mapping[str, str] = field(default_factory=dict)
    device: str = ""

    def __post_init__(self) -> None:
        kinds = {
            "scene": scene.Scene,
            "camera": camera.Camera,
            "mode": mode.Mode,
            "pixel_filter": filters.Filter,
            "limits": Mapping,
        }
        for name, kind in kinds.items():
            instance(name, getattr(self, name), kind)
        if self.furniture is not None:
            instance("furniture", self.furniture, Furniture)
        if not (set(self.limits) <= set(_FORCED) and all(isinstance(value, str) for value in self.limits.values())):
            raise OptionError(f"limits must be {' and '.join(_FORCED)}, words; got {self.limits!r}")

    @property
    def options(self) -> dict[str, Any]:
        """Arguments of `clvol.render` beside the scene and the camera."""
        given: dict[str, Any] = {"mode": self.mode, "size": tuple(self.size), "step": self.step, "rays": self.rays}
        if self.rays != 1 and (self.rays != "auto" or self.mode.shaded):
            given["pixel_filter"] = self.pixel_filter
        if self.central:
            given["gradient"] = "central"
        if self.furniture:
            given |= self.furniture.given
        return given

    def options_of_lazy(self, several: bool) -> dict[str, Any]:
        """The same for a LazyVolume, which has no scene: with all that a scene has; and the size to draw, if it has `several`."""
        (medium,) = self.scene.media
        own = {name: getattr(self.scene, name) for name in (*OF_SCENE, "background", "clip")}
        own |= {"transfer": medium.transfer, "material": medium.material} | ({"lod": self.lod} if several else {})
        return self.options | {name: value for name, value in own.items() if name not in self.mode.unheard}

    def text(self, folder: Path | None) -> str | None:
        """The text of a file in a folder, to which paths of volumes are relative; None if a part is no clvol object."""

        def described(volume: Volume) -> dict[str, Any]:
            known = provenance_of(volume)
            return facts_of(volume, volume) | {"source": None if known is None else _relative(known, folder)}

        try:
            return serial.to_text(
                self, CLASSES, {Volume: described, joint.Image: joint.Image.json}, clvol=clvol.__version__, version=VERSION
            )
        except OptionError:
            return None

    @classmethod
    def of_text(cls, text: str) -> Recipe:
        """The recipe of a text, with grids in the place of volumes: `FormatError` if it is none, or of another version."""
        recipe = serial.from_text(text, CLASSES, {"Volume": grid_of, "Image": joint.Image.of_json}, version=VERSION)
        if not isinstance(recipe, Recipe):
            raise FormatError("it is no recipe of a picture")
        return recipe

    def __reduce__(self) -> tuple[Any, ...]:
        """A pickle holds no samples: of a volume only what is known of it."""
        text = self.text(None)
        return (type(None), ()) if text is None else (Recipe.of_text, (text,))


CLASSES = serial.dataclasses_of(scene, camera, clip, light, mode, transfer, joint, filters, boundary) | {
    "Furniture": Furniture,
    "Recipe": Recipe,
}
"""What a recipe's text may hold."""


def grid_of(facts: Mapping[str, Any]) -> Volume:
    """A volume in the place of another, of zeros that take no memory; what is known of that one stays known."""
    zeros = np.broadcast_to(np.zeros((), facts["dtype"]), tuple(facts["shape"]))
    placed = {name: facts[name] for name in ("spacing", "origin", "direction", "units", "space")}
    volume = Volume(zeros, **placed)
    vars(volume)["_sum"] = facts["sum"]
    if facts.get("source") is not None:
        vars(volume)["_provenance"] = dict(facts["source"])
    return volume


def _relative(known: Mapping[str, Any], folder: Path | None) -> dict[str, Any]:
    """A path of a file as seen from a folder, and those of its mask and table of labels; absolute for no folder."""
    if "mask" in known:
        known = {**known, "mask": _relative(known["mask"], folder)}
    if isinstance(known.get("labels"), str):
        known = {**known, "labels": _seen_from(folder, known["labels"])}
    path = str(known["path"])
    return dict(known) if "://" in path or path.startswith("phantom:") else {**known, "path": _seen_from(folder, path)}


def _seen_from(folder: Path | None, path: str) -> str:
    absolute = os.path.abspath(path)  # noqa: PTH100  # links stay as they were given
    try:
        seen = absolute if folder is None else os.path.relpath(absolute, folder)
    except ValueError:  # another drive
        seen = absolute
    return Path(seen).as_posix()


# -- making it ------------------------------------------------------------------------------------------------------------------


class Staged(NamedTuple):
    """A look with its camera in place, and what stands around its picture."""

    look: ResolvedLook
    drawn: ResolvedLook  # the same, without a background where something lies behind
    furniture: Furniture | None
    fine: Fineness

    def refined(self, pictures: Iterator[Refined], source: Source) -> Iterator[Refined]:
        """Pictures that become finer; the last one with what stands around it, and with what made it."""
        for picture in pictures:
            made = picture
            if picture.final:
                shown = self.finished({"rgba": picture}, ("rgba",), source)["rgba"]
                made = Refined(shown, True, picture.step, picture.seconds)
                made.recipe, made.furnished = shown.recipe, shown.furnished
            elif self.drawn is not self.look:
                made = Refined(
                    on(self.look.scene.background, np.asarray(picture), linear=self.look.linear),
                    False,
                    picture.step,
                    picture.seconds,
                )
            yield made

    def finished(self, pictures: Mapping[str, NDArray[Any]], wanted: tuple[str, ...], source: Source) -> dict[str, Picture]:
        """The wanted pictures, with what stands around them, and with what made them."""
        found = {name: pictures[name] for name in wanted}
        around: Furnished | None = None
        if self.furniture and "rgba" in found:
            found["rgba"], around = furnished(found["rgba"], self.furniture, _stage(self.look, self.fine.size))
        shown, recipe = as_pictures(found), self.recipe(source)
        for name, picture in shown.items():
            picture.recipe, picture.furnished = recipe, around if name == "rgba" else None
        return shown

    def recipe(self, source: Source) -> Recipe:
        """What makes the picture."""
        look, fine = self.look, self.fine
        looks = look, *look.others
        settled = look.once("recipe", lambda: look.scene.of_media([_settled(one, source) for one in looks]))
        parts = [source.part(one.scene.media[0]) for one in looks]
        device = source.field.device
        forced = {name: value for name in _FORCED if (value := getattr(device.limits, name)) != "auto"}
        central = look.central and look.mode.shaded and source.filter_of(look.mode).has_gradient
        bricked = tuple(k for k, part in enumerate(parts) if part.by_bricks) if look.others else ()
        how = (fine.size, fine.step, fine.rays, fine.filter, fine.lod, central)
        recipe = Recipe(
            settled, look.camera, look.unsettled or look.mode, *how, self.furniture, source.by_bricks, bricked, forced, device.name
        )
        for one, part in zip(looks, parts, strict=True):
            if part.by_bricks and part.preview is not one.scene.media[0].volume:  # it is not in memory
                recognise(one.scene.media[0].volume, part.preview, part.field.volume)
        return recipe


def _settled(look: ResolvedLook, source: Source) -> scene.Medium:
    """The medium of a look, with its filter, boundary and transfer function."""
    (medium,) = look.scene.media
    part = source.part(medium)
    row = medium.filter if part.by_bricks else part.filter_of(look.mode)  # each size of a LazyVolume may have its own
    shown = medium.transfer if "transfer" in look.mode.unheard else look.transfer
    return replace(medium.with_transfer(shown), filter=row, boundary=part.field.boundary)


def look_of(source: Source, seen_by: camera.Camera | None, shown_in: mode.Mode, options: RefineOptions) -> ResolvedLook:
    """The look of a source's scene from a camera, in a mode with these options, made once for all cameras."""
    instance("camera", seen_by, camera.Camera, type(None))
    found = source.looks.of(
        lambda: ResolvedLook.of(source.scene, source.part, seen_by, shown_in, options), shown_in, options, seen_by is None
    )
    return found if seen_by is None or seen_by is found.camera else found.seen_by(seen_by)


def staged(
    source: Source, camera: camera.Camera | None, mode: mode.Mode, fine: Fineness, options: RefineOptions, step: float | None
) -> Staged:
    """A look with its camera in place; with the box in view, if there is one and the place was left open; on white for print;
    with the virtual samples that narrow bands need, if no `step` was asked for.

    `OptionError` if what is wanted around the picture does not apply to it, `MissingDependencyError` without matplotlib.
    """
    look = with_virtual(look_of(source, camera, mode, options), source, fine, step)
    around: Mapping[str, Any] = options
    given = {name: around[name] for name in Furniture.__dataclass_fields__ if around.get(name) is not None}
    furniture = Furniture(**given) if given else None
    aspect = fine.size[0] / fine.size[1]
    if furniture is None:
        look = look.placed(aspect)
        return Staged(look, look, None, fine)
    furniture.require_shown(look.scene.media[0].volume.space)
    if furniture.theme == "print" and options.get("background", ...) is ...:
        look = replace(look, scene=replace(look.scene, background=(1.0, 1.0, 1.0)))
    look = replace(look, camera=furniture.in_view(look.camera, *_box(look), aspect)).placed(aspect)
    return Staged(look, look.over_nothing() if furniture.behind else look, furniture or None, fine)


def _stage(look: ResolvedLook, size: tuple[int, int]) -> Stage:
    """Where the furniture of a picture stands."""
    width, height = size
    volume, (low, high) = look.scene.media[0].volume, _box(look)
    target = look.camera.target
    focus = volume.center if target is None else np.asarray(target)
    view = look.camera.view(volume, width / height)
    return Stage(
        view, (width, height), low, high, focus, volume.units, volume.space, _bars(look), look.scene.background, look.linear
    )


def _box(look: ResolvedLook) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The corners of the box, along the world's axes, in which all that is seen lies."""
    return box_around((one.scene.media[0].volume, one.clip) for one in (look, *look.others))


def _bars(look: ResolvedLook) -> tuple[Bar, ...]:
    """What colour bars show of the media; of those that show surfaces, which are in colours of values."""
    looks = look, *look.others
    if (look.unsettled or look.mode).shows == "surface" and any(one.scene.media[0].color_by for one in looks):
        looks = tuple(one for one in looks if one.scene.media[0].color_by)
    return tuple(map(_bar, looks))


def _bar(look: ResolvedLook) -> Bar:
    volume, other = look.preview, look.scene.media[0].color_by
    if other is not None:
        volume = other.volume
    labels: Mapping[int, str] | None = None
    if volume.is_labels:
        labels = {label: table_of(volume).get(label, "") for label in map(int, label_numbers(volume)[1].tolist())}
    if other is not None and other.transfer is not None:
        return Bar(other.transfer, False, volume.name, labels)
    return Bar(look.transfer, look.mode.shows == "matter", colored_by(look.mode).replace(BY_LABEL, "") or volume.name, labels)
