"""Options of pictures, each declared once, and the look that they resolve to."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from types import EllipsisType
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypeAlias, TypedDict, get_args

import numpy as np

from clvol.base import memory
from clvol.base.checks import instance, number, one_of, whole
from clvol.base.errors import OptionError
from clvol.base.kept import Once, Same
from clvol.filter.table import PICTURE_FILTER
from clvol.march.pixels import DEFAULT_PIXEL_FILTER, as_pixel_filter
from clvol.scene.camera import Camera
from clvol.scene.clip import cuts_of
from clvol.scene.fit import fitted, usual_camera
from clvol.scene.light import casts, usual_lights
from clvol.scene.look import graded, look
from clvol.scene.mode import BY_LABEL, as_mode, colored_by, require_heard, tolerance_of, virtual_samples
from clvol.scene.preset import as_preset
from clvol.scene.scene import Medium
from clvol.scene.transfer import FACTORS, WORDS, is_curve
from clvol.volume.histogram import matter_of
from clvol.volume.provenance import sum_of
from clvol.volume.smoothing import filter_for

if TYPE_CHECKING:  # clusters need dask
    from numpy.typing import ArrayLike

    from clvol.dask.cluster import ClusterLike
    from clvol.device import Device
    from clvol.filter.boundary import Boundary
    from clvol.filter.filter import Filter
    from clvol.scene.camera import Viewpoint
    from clvol.scene.clip import Clip
    from clvol.scene.light import Light, Material
    from clvol.scene.mode import Mode
    from clvol.scene.scene import Medium, Scene
    from clvol.scene.transfer import TransferFunction
    from clvol.volume.volume import Volume

__all__ = [
    "KEYWORDS",
    "MERGES",
    "OF_SCENE",
    "OUTPUTS",
    "WORDS",
    "BatchOptions",
    "FieldOptions",
    "Fineness",
    "FurnitureOptions",
    "LookOptions",
    "Merge",
    "ModeOptions",
    "Output",
    "PanelOptions",
    "PictureOptions",
    "Previewed",
    "RefineOptions",
    "RenderOptions",
    "RendererOptions",
    "ResolvedLook",
    "ViewOptions",
    "as_outputs",
    "chosen_mode",
    "covering",
    "require_one_step",
    "require_room",
    "step_times",
    "transfer_of",
    "unheard",
]

Merge: TypeAlias = Literal["order", "tree"]
MERGES: tuple[Merge, ...] = ("order", "tree")
"""How the workers of a cluster combine rays."""

Output: TypeAlias = Literal["rgba", "depth", "normal", "position", "visited", "value", "uncertainty", "pose"]

OUTPUTS: tuple[Output, ...] = ("rgba", "depth", "normal", "position", "visited")
"""Outputs of every mode."""
_ALL_OUTPUTS = get_args(Output)
_MAX_SIZE = 1 << 15  # pixels
_STEP = 0.5  # voxels
OF_SCENE = ("lights", "shadow", "shadow_rays", "occlusion", "linear_light")
"""What a picture has in place of its scene's, None for that."""


# -- options, as documented by `Renderer.render` -------------------------------------------------------------------------------


class LookOptions(TypedDict, total=False):
    """What a picture shows, and how. An option that changes nothing in the mode is refused.

    Attributes
    ----------
    transfer, material
        In place of the medium's. A transfer function that neither gives is the mode's: from the histogram for "composite", a grey
        ramp for projections.
    preset, window, cmap, opacity
        A transfer function by words: the kind of data (`clvol.presets`), the values from black to white as (center, width), the
        name of a colour map, and how opaque: a factor, or pairs of a value and an opacity. Each changes what it names of the
        mode's own look, and may be given with the others, but not beside `transfer`. Surfaces have none of them, projections
        no opacity.
    gradient_opacity : float, or sequence of (magnitude, factor)
        Opacity by the gradient, too, so that boundaries stand out from even matter: of "composite". With a number, 0
        to 1, opacity is less where the function is flat, by the factor (1 - number)⁴, and with 1 only edges are seen; what is flat
        and what is an edge is found from the samples. Points are factors of opacity, 0 to 1, by the magnitude of the gradient, in
        units of the data per world unit. They stand beside any transfer function, and multiply its opacity.
    curvature_opacity : sequence of (curvature, factor)
        The same by how isosurfaces bend: by the larger magnitude of the principal curvatures, per world unit.
    lights, background, clip
        In place of the scene's: see `Scene`. Ellipsis stands for the scene's own background or cuts, None for none.
    shadow, occlusion
        How dark shadows are, and places that matter surrounds, 0 to 1, in place of the scene's: see `Scene`.
    shadow_rays
        Whether shadows of exact surfaces are exact, too, in place of the scene's: see `Scene`.
    linear_light
        Whether colours are computed in linear light, in place of the scene's: see `Scene`. Modes that show single values have
        their colours as they are.
    media
        In place of the scene's media, in their order: the same volumes, filters and boundaries (`Renderer.scene` has them), with
        other looks, as ``replace(medium, visible=False)`` gives.
    gradient : {"analytic", "central"}
        "analytic" is the exact derivative of the function drawn. "central" takes differences of one voxel to either side, as many
        other programs do; with `hybrid` one voxel of the magnified grid, half of the volume's. `nearest` has no useful derivative
        and is always shaded by central differences: there is no choice.
    """

    transfer: TransferFunction | None
    preset: str | None
    window: tuple[float, float] | None
    cmap: str | None
    opacity: float | Sequence[tuple[float, float]] | None
    gradient_opacity: float | Sequence[tuple[float, float]] | None
    curvature_opacity: Sequence[tuple[float, float]] | None
    material: Material | None
    lights: Light | Sequence[Light] | None
    background: Sequence[float] | str | EllipsisType | None
    clip: Clip | EllipsisType | None
    shadow: float | None
    shadow_rays: bool | None
    occlusion: float | None
    linear_light: bool | None
    media: Sequence[Medium] | None
    gradient: Literal["analytic", "central"]


class ModeOptions(TypedDict, total=False):
    """Options of the built-in modes; the fields of each mode's class. A mode of your own takes its options when it is made."""

    shading: bool
    termination: float
    isovalue: float | str | None
    color: Sequence[float] | str
    surfaces: Sequence[tuple[float | str, Sequence[float] | str, float]] | str | None
    color_by: Literal["k1", "k2", "mean curvature", "gaussian curvature", "distance", "label"] | None
    outline: float
    method: Literal["exact", "stepped"]
    tolerance: float | None
    attenuation: float
    mu_water: float | None
    virtual: int
    cap: bool | Sequence[float] | str | None


class FurnitureOptions(TypedDict, total=False):
    """What stands around a picture; nothing by default (``pip install "clvol[figures]"``).

    Attributes
    ----------
    color_bar : bool
        The colours of the transfer function with their values, and in "composite" the curve of its opacity; of labels their names.
        A surface has one colour, and no bar.
    scale_bar : bool
        A bar of a round length, in the volume's units. In perspective it is true at the depth of the camera's target alone.
    axes : bool
        Ticks with the world's coordinates on the outline of the box around the volume (or `clip`), and their grid on the planes at
        its back. The volume lies over that grid as far as it is opaque; projections are opaque. A camera whose place is left open
        has the whole box in view.
    box : bool
        The edges of this box.
    letters : bool
        The sides of a patient (`Volume.space` is "LPS") at the picture's edges: L and R, A and P, S and I.
    cube : bool
        A small cube that is turned like the world, with these letters, or with x, y and z.
    title : str
        Above.
    time_stamp : str or float
        At the upper left; a number is in seconds.
    theme : {"screen", "print"}
        "print" is on white, unless `background` is given. Lines and letters are black or white, whichever differs more from the
        background, with an edge of the other.
    """

    color_bar: bool
    scale_bar: bool
    axes: bool
    box: bool
    letters: bool
    cube: bool
    title: str
    time_stamp: str | float
    theme: Literal["screen", "print"]


class RefineOptions(LookOptions, ModeOptions, FurnitureOptions, total=False):
    """Options of `Renderer.refine`.

    Attributes
    ----------
    rays : int or "auto"
        Rays a pixel, 1 to 4096. A single one goes through its middle. "auto", the default: one, and in modes that light what they
        show two more in pixels on edges, which differ from a neighbour by more than an eighth of full luminance. At most a 20th of
        the pixels that are not plain background have more (on processors a 64th, but for surfaces), which bounds the cost. All
        other pixels are those of ``rays=1``, bit for bit.
    pixel_filter : str or Filter
        What several rays sample: the picture under this filter of the table, which is as many pixels wide as it has taps. "linear",
        the default, leaves half of the aliasing of "nearest", the pixel's own square, from 16 rays on, and two thirds with fewer,
        and is less sharp; one with negative lobes, such as "mitchell", needs about 64 rays. Filters with a prefilter are refused,
        and so are all of one ray a pixel.
    skipping : bool
        Skip space in which the function's minimum and maximum say that nothing can be seen, as by default. No bit depends on it.
    lod : float or "auto"
        Of a `LazyVolume` with levels, and of no other volume: how many pixels a voxel of the level that is drawn may span, where
        the volume is nearest to the viewer. "auto", the default, is 1; 0 draws the finest level whatever the picture's size. Steps
        count its voxels.
    """

    rays: int | Literal["auto"]
    pixel_filter: str | Filter
    skipping: bool
    lod: float | Literal["auto"]


class PictureOptions(RefineOptions, total=False):
    """Options of `Renderer.render`.

    Attributes
    ----------
    sigma : float, optional
        Standard deviation of the samples' noise, in units of the data, for the output "uncertainty" and no other; it is then taken
        to be white. By default it is estimated, with its spectrum (`Volume.noise`).
    """

    sigma: float | None


class FieldOptions(TypedDict, total=False):
    """Options of a renderer's function: see `Renderer`."""

    filter: str | Filter | None
    boundary: str | Boundary | None
    device: Device | str | int | None
    memory: int | None
    mask: ArrayLike | None


class RendererOptions(FieldOptions, total=False):
    """Options of `Renderer`."""

    cluster: ClusterLike | None
    merge: Literal["order", "tree"]


class RenderOptions(PictureOptions, RendererOptions, total=False):
    """Options of `clvol.render`."""


class PanelOptions(RefineOptions, total=False):
    """Options of pictures by several filters, side by side in figures and reports."""

    camera: Camera | None
    mode: str | Mode
    step: float | None


class ViewOptions(PanelOptions, total=False):
    """Options of the first picture of a view."""

    layout: Literal["3d", "slice", "linked"]
    filter: str | Filter | None
    boundary: str | Boundary | None
    mask: ArrayLike | None


class BatchOptions(PanelOptions, PictureOptions, FieldOptions, total=False):
    """Options of each picture of `clvol.batch`."""

    size: tuple[int, int]
    outputs: Output


KEYWORDS = (
    *("camera", "mode", "size", "step", "outputs", "progress"),
    *(name for name in PictureOptions.__annotations__ if name not in ModeOptions.__annotations__),
)
"""Arguments of `Renderer.render`; all others are options of the mode."""


def chosen_mode(
    mode: str | Mode,
    options: Mapping[str, Any],
    outputs: Collection[str] = ("rgba",),
    others: Collection[str] = (),
    scene: object = None,
) -> Mode:
    """The mode with its options, which are all that are not options of a picture.

    `OptionError` names one that is unknown, or that changes nothing in these outputs of a scene; `others` may be meant by it.
    """
    of_mode = {name: value for name, value in options.items() if name not in KEYWORDS}
    if misplaced := of_mode.keys() & RendererOptions.__annotations__.keys():
        raise OptionError(f"{' and '.join(sorted(misplaced))} must be left to what draws the picture, such as Renderer(...)")
    chosen = as_mode(mode, of_mode, (*KEYWORDS, *others))
    colored = any(getattr(medium, "color_by", None) for medium in getattr(scene, "media", (scene,)))
    reasons = unheard(chosen, options, outputs, colored=colored)
    require_heard(chosen, reasons, reasons)
    return chosen


def unheard(
    mode: Mode, options: Mapping[str, Any], outputs: Collection[str] = ("rgba",), *, colored: bool = False
) -> dict[str, str]:
    """Those of a picture's options that change nothing in a mode and in these outputs, each with the reason.

    `colored`: another volume colours what the mode shows.
    """
    given = {name: value for name, value in options.items() if name in KEYWORDS and value is not None}
    found = {name: reason for name, reason in mode.unheard.items() if name in given}
    if {"normal", "uncertainty"} & set(outputs) or "gradient_opacity" in given.keys() - found:  # which are gradients in all modes
        found.pop("gradient", None)
    if colored:
        found.pop("color_bar", None)  # which shows those colours
    if "preset" in given.keys() - found:
        row = as_preset(given["preset"])
        if mode.shows != "matter" and row.unit != "labels" and "window" in given:
            found["preset"] = "window gives the values of black and white"
        elif mode.shows == "mean" and row.unit == "matter":
            found["preset"] = f"means do not reach the values of {row.name!r}"
    if "shadow" in given and "lights" in given and not casts(given["lights"]):
        found["shadow"] = "headlights cast none"
    if "pixel_filter" in given and not _of_several_rays(mode, given.get("rays", "auto")):
        found["pixel_filter"] = "there is one ray a pixel"
    if "rgba" not in outputs:
        found |= dict.fromkeys(given.keys() & FurnitureOptions.__annotations__, 'it is for the output "rgba"')
    if "sigma" in given and "uncertainty" not in outputs:
        found["sigma"] = 'it is for the output "uncertainty"'
    return found


def _of_several_rays(mode: Mode, rays: object) -> bool:
    """Whether a pixel may have more than one ray; only modes that light what they show take more on edges."""
    return mode.shaded if isinstance(rays, str) and rays == "auto" else rays != 1


def as_outputs(outputs: object) -> tuple[str, ...]:
    """The names of outputs, from one name or several."""
    if not isinstance(outputs, (str, Sequence)) or not outputs:
        raise one_of("outputs", outputs, _ALL_OUTPUTS)
    wanted = (outputs,) if isinstance(outputs, str) else tuple(outputs)
    for name in wanted:
        if name not in _ALL_OUTPUTS:
            raise one_of("outputs", name, _ALL_OUTPUTS)
    return wanted


# -- how finely -----------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Fineness:
    """How finely a picture is sampled."""

    size: tuple[int, int]  # width and height in pixels
    step: float  # most voxels between samples of a ray
    rays: int | Literal["auto"]  # a pixel
    filter: Filter  # what these sample
    lod: float  # pixels that a voxel of the drawn level may span
    tolerance: float | None = None  # of colours, which chooses the step

    @classmethod
    def of(cls, mode: Mode, size: tuple[int, int], step: float | None, options: RefineOptions) -> Fineness:
        """As the options say."""
        require_one_step(mode, step)
        rays, lod = options.get("rays", "auto"), options.get("lod", "auto")
        if rays != "auto":
            rays = whole("rays", rays, minimum=1, maximum=4096)
        elif not _of_several_rays(mode, rays):
            rays = 1
        return cls(
            as_size(size),
            _STEP if step is None else number("step", step, above=0),
            rays,
            as_pixel_filter(options.get("pixel_filter", DEFAULT_PIXEL_FILTER)),
            1.0 if isinstance(lod, str) and lod == "auto" else number("lod", lod, minimum=0),
            tolerance_of(mode),
        )


def require_one_step(mode: Mode, step: float | None) -> None:
    """Raise `OptionError` for a step beside a tolerance, which chooses it."""
    if step is not None and (tolerance := tolerance_of(mode)) is not None:
        raise OptionError(f"tolerance chooses the step, which must be left out beside it; got {tolerance:g} and step={step!r}")


def step_times(step: float | None, factor: float, mode: Mode) -> float | None:
    """A step of `factor` times as many voxels; None where a tolerance chooses steps."""
    return step if step is None and tolerance_of(mode) is not None else factor * (_STEP if step is None else step)


def as_size(size: tuple[int, int]) -> tuple[int, int]:
    """Width and height in pixels, checked."""
    try:
        width, height = size
    except (TypeError, ValueError):
        raise OptionError(f"size must be (width, height) in pixels; got {size!r}") from None
    return whole("width", width, minimum=1, maximum=_MAX_SIZE), whole("height", height, minimum=1, maximum=_MAX_SIZE)


def require_room(size: tuple[int, int], outputs: tuple[str, ...], *, edges: bool) -> None:
    """Raise `OutOfMemoryError` unless a picture, its guides and the arrays for its edges fit in memory."""
    width, height = size
    each = 16 + 60 * (outputs != ("rgba",)) + 32 * ("uncertainty" in outputs) + 48 * ("pose" in outputs) + 28 * edges
    memory.require(width * height * each, f"a picture of {width} × {height} pixels")


# -- what is seen ---------------------------------------------------------------------------------------------------------------


class Previewed(Protocol):
    """What has samples from which a look is chosen."""

    @property
    def preview(self) -> Volume: ...


@dataclass(frozen=True)
class ResolvedLook:
    """What a picture shows, with everything resolved except its fineness."""

    camera: Camera
    mode: Mode  # settled for the volume
    scene: Scene  # with the picture's transfer function, material, lights, background and cuts, where these were given
    transfer: TransferFunction
    central: bool  # gradients are central differences
    skipping: bool
    preview: Volume  # samples to which the camera is fitted
    others: tuple[ResolvedLook, ...] = ()  # of the scene's other visible media; the grid of the first one leads
    unsettled: Mode | None = None  # the mode of several, which is settled for each, or in which one shows surfaces or regions
    once: Once[Any] = field(default_factory=Once, init=False, repr=False, compare=False)  # what is known of it from any place ...
    there: Once[Any] = field(default_factory=partial(Once, 4), init=False, repr=False, compare=False)  # ... and from the last ones

    @classmethod
    def of(
        cls, scene: Scene, part_of: Callable[[Medium], Previewed], camera: Camera | None, mode: Mode, options: RefineOptions
    ) -> ResolvedLook:
        """The look of a scene; options left open are chosen from the previews of its parts.

        Of several media it is the look of the first in an order that does not depend on the scene's.
        """
        if (media := options.get("media")) is not None:
            scene = scene.with_looks(media)
        clip = options.get("clip", ...)
        cut = (scene.clip if clip is ... else clip) is not None or any(one.visible and one.clip is not None for one in scene.media)
        if getattr(mode, "cap", None) is not getattr(type(mode), "cap", None):
            if not cut:
                require_heard(mode, ("cap",), {"cap": "nothing is cut away by clip"})
            if not any(one.shown_in(mode) is mode for one in scene.media):
                require_heard(mode, ("cap",), {"cap": "faces are as surfaces and smooth boundaries of media have them"})
        between = {"virtual": virtual_samples(mode), "tolerance": tolerance_of(mode)}
        if any(between.values()) and not any(one.shown_in(mode) is mode for one in scene.media):
            given = [name for name, value in between.items() if value]
            require_heard(mode, given, dict.fromkeys(given, "surfaces and smooth boundaries lie wherever they are between samples"))
        if len(scene.media) > 1:
            return cls._of_several(scene, part_of, camera, mode, options)
        return cls._of_one(scene, part_of, camera, mode, options)

    @classmethod
    def _of_one(
        cls,
        scene: Scene,
        part_of: Callable[[Medium], Previewed],
        camera: Camera | None,
        mode: Mode,
        options: RefineOptions,
        leading: Volume | None = None,
    ) -> ResolvedLook:
        """The look of one medium; of several by the light around the `leading` one."""
        skipping, gradient = options.get("skipping", True), options.get("gradient", "analytic")
        instance("skipping", skipping, bool, np.bool_)
        if gradient not in ("analytic", "central"):
            raise one_of("gradient", gradient, ("analytic", "central"))
        (medium,) = scene.media
        preview = part_of(medium).preview
        camera = usual_camera(preview) if camera is None else camera
        instance("camera", camera, Camera)
        shown = medium.shown_in(mode)
        if medium.color_by is not None:
            if mode.shows not in ("matter", "surface"):
                raise OptionError(
                    f"color_by of a medium changes nothing in {mode.name}: it is for matter and surfaces; leave it out"
                )
            if colored_by(mode) not in ("", BY_LABEL):
                raise OptionError(f"color_by must be left to the medium, which has one, or to {mode.name}; got both")
            scene = scene.of_media([medium := replace(medium, color_by=_settled_colors(medium.color_by))])
        words = medium.words if options.get("transfer") is None and not any(map(options.get, WORDS)) else {}
        scene = _changed(scene, transfer_of(preview, mode, {**options, **words}), options)
        if shown.regions and leading is None:
            require_heard(shown, [name for name in ("shadow", "occlusion") if getattr(scene, name)])
        linear = scene.linear_light and "linear_light" not in mode.unheard
        scene = replace(scene, lights=usual_lights(scene.lights, linear=linear))
        if scene.shadow and mode.shaded:
            scene = _with_still_lights(scene, leading or preview)
        transfer = scene.media[0].transfer or mode.transfer(preview)
        factors: dict[str, Any] = medium.factors
        factors |= {name: given for name in FACTORS if (given := options.get(name)) is not None}
        factors = {name: given for name, given in factors.items() if is_curve(given) or given != 0}
        if transfer.graded or factors:
            _require_gradable(shown, medium, scene, transfer, factors)
            transfer = graded(transfer, preview, **factors)
        given = None if shown is mode else mode
        seen = shown.settled(preview), scene, transfer
        return cls(camera, *seen, gradient == "central", bool(skipping), preview, unsettled=given)

    @classmethod
    def _of_several(
        cls, scene: Scene, part_of: Callable[[Medium], Previewed], camera: Camera | None, mode: Mode, options: RefineOptions
    ) -> ResolvedLook:
        own = [name for name in ("transfer", *WORDS, *FACTORS, "material") if options.get(name) is not None]
        if own:
            raise OptionError(f"{' and '.join(own)} must be left to the media of a scene of several: Medium(..., {own[0]}=...)")
        if mode.shows in ("matter", "surface") and scene.mix != "add":
            raise OptionError(f'mix="{scene.mix}" changes nothing in {mode.name}: it is for projections')
        media = [medium for medium in scene.media if medium.visible]
        if not media:
            raise OptionError(f"a picture must show a medium; none of the scene's {len(scene.media)} is visible")
        finest = min(
            (part_of(one).preview for one in media), key=lambda volume: (volume.mean_spacing, *volume.size, *volume.origin)
        )
        looks = [cls._of_one(replace(scene, media=(one,)), part_of, camera, mode, options, finest) for one in media]
        if all(look.mode.regions for look in looks):
            require_heard(looks[0].mode, [name for name in ("shadow", "occlusion") if getattr(looks[0].scene, name)])
        if any(look.sends_rays for look in looks):
            raise OptionError("shadow_rays must be left out in a scene of several media: rays cross the surfaces of one")
        if mode.shows == "matter":
            looks.sort(key=lambda look: _rank(look.scene.media[0], look.transfer, look.preview))
        return replace(looks[0], others=tuple(looks[1:]), unsettled=mode)

    @property
    def sends_rays(self) -> bool:
        """Whether rays from its surfaces to the lights find its shadows."""
        return self.scene.shadow_rays and "shadow_rays" not in self.mode.unheard

    @property
    def swept(self) -> Scene:
        """The scene with the shadows that sweeps through cells find: none where rays do."""
        return replace(self.scene, shadow=0.0, shadow_rays=False) if self.sends_rays else self.scene

    @property
    def clip(self) -> Clip | None:
        """What is cut away of its medium."""
        return self.scene.clip_of(self.scene.media[0])

    def seen_by(self, camera: Camera) -> ResolvedLook:
        """The same from another place."""
        made = replace(self, camera=camera)
        for name in ("once", "there"):
            object.__setattr__(made, name, getattr(self, name))
        return made

    def placed(self, aspect: float) -> ResolvedLook:
        """The same with the camera fitted to a picture of this aspect, if its position was left open."""
        return self.there((Same(self.camera), aspect), lambda: self._placed(aspect))  # type: ignore[no-any-return]

    def _placed(self, aspect: float) -> ResolvedLook:
        camera, others = self.camera, tuple((look.preview, look.mode, look.transfer, look.clip) for look in self.others)
        if others:
            camera = camera.in_world(max((self.preview, *(one.preview for one in self.others)), key=lambda volume: volume.space))
        camera = fitted(camera, self.preview, self.mode, self.transfer, self.clip, aspect, others=others)
        return self if camera is self.camera else self.seen_by(camera)

    @property
    def linear(self) -> bool:
        """Whether its colours are computed in linear light."""
        return self.scene.linear_light and "linear_light" not in (self.unsettled or self.mode).unheard

    def over_nothing(self) -> ResolvedLook:
        """The same without a background."""
        return replace(self, scene=replace(self.scene, background=None))

    def view(self, size: tuple[int, int]) -> Viewpoint:
        """From where a picture of this size is seen."""
        aspect = size[0] / size[1]
        return self.placed(aspect).camera.view(self.scene.media[0].volume, aspect)

    def of_values(self, volume: Volume) -> ResolvedLook:
        """The same look for the volume whose values the coefficients are of: where samples are missing, the filled one."""
        (medium,) = self.scene.media
        if volume is medium.volume:
            return self
        return replace(self, scene=replace(self.scene, media=(replace(medium, volume=volume),)))

    def of_level(self, volume: Volume, boundary: Boundary) -> ResolvedLook:
        """The same look for another level of the volume, so that all levels show the same matter in the same place.

        The unit length of opacities, and the box that a camera is fitted to, are the finest level's unless given.
        """
        (medium,) = self.scene.media
        finest, camera, transfer = medium.volume, self.camera, self.transfer
        if transfer.unit_distance is None:
            transfer = replace(transfer, unit_distance=finest.mean_spacing)
        if camera.fit == "volume" or any(v is not None for v in (camera.position, camera.target, camera.distance, camera.radius)):
            x, y, z = (float(v) for v in finest.center)
            target, radius = camera.target or (x, y, z), finest.radius if camera.radius is None else camera.radius
            camera = replace(camera, target=target, radius=radius)
        seen = replace(medium, volume=volume, boundary=boundary)
        return replace(self, scene=replace(self.scene, media=(seen,)), camera=camera, transfer=transfer)


def _rank(medium: Medium, transfer: TransferFunction, preview: Volume) -> tuple[Any, ...]:
    """A key by which media are in one order, whatever their list's: the finest grid is first."""
    volume = medium.volume
    place = volume.mean_spacing, volume.spacing, volume.size, volume.origin, tuple(np.ravel(volume.direction))
    own = medium.material, *medium.reconstruction, cuts_of(medium.clip), medium.surfaces
    other = medium.color_by
    by = _rank(other, other.transfer, other.volume) if other and other.transfer else ()
    look = repr((transfer, transfer.opacities, *own, by))
    return place, look, sum_of(preview)


def transfer_of(preview: Volume, mode: Mode, options: Mapping[str, Any]) -> TransferFunction | None:
    """The transfer function that is given, by itself or by words, if any is."""
    transfer = options.get("transfer")
    words: dict[str, Any] = {name: options.get(name) for name in WORDS}
    given = [name for name, value in words.items() if value is not None]
    if given and transfer is not None:
        raise OptionError(f"transfer must be left out where {' and '.join(given)} say what it is; got both")
    return look(preview, mode, **words) if given else transfer


def _require_gradable(mode: Mode, medium: Medium, scene: Scene, transfer: TransferFunction, factors: Mapping[str, Any]) -> None:
    """Raise `OptionError` if a medium's opacity cannot depend on more than the value."""
    what = " and ".join(factors) or ("gradient_opacity", "curvature_opacity", "a TransferFunction2D")[min(transfer.graded // 2, 2)]
    if not mode.grades:
        raise OptionError(f"{what} changes nothing in {mode.name}: it is of matter, in composite; leave it out")
    if virtual_samples(mode):
        raise OptionError(f"virtual must be 0 beside {what}, which is of true gradients; leave it out")
    if medium.volume.is_labels:
        raise OptionError(f"{what} changes nothing of labels: they are names, which have no slopes; leave it out")
    if mode.shaded and (dark := [name for name in ("shadow", "occlusion") if getattr(scene, name)]):
        raise OptionError(f"{' and '.join(dark)} must be left out beside {what}: light is stopped by values alone")


def _with_still_lights(scene: Scene, preview: Volume) -> Scene:
    """The scene with lights of the world, for those that move with the camera as in the usual view, so that shadows stay."""
    if not casts(scene.lights):
        raise OptionError("shadow changes nothing where no light has a direction: headlights cast none; leave it out")
    view = usual_camera(preview).view(preview, 1.0)
    return replace(scene, lights=tuple(light.placed(view) for light in scene.lights))


def _settled_colors(medium: Medium) -> Medium:
    """What colours a medium with all that was left open decided: its filter, and its transfer function.

    Values are shown in viridis; those to both sides of a background in blue and red. Labels have colours of their own; a preset
    covers all that it shows.
    """
    volume, transfer, words = medium.volume, medium.transfer, medium.words
    if transfer is None and not volume.is_labels and "preset" not in words:
        signed = matter_of(volume).signed
        transfer = look(volume, "isosurface", **({"cmap": "matplotlib:coolwarm" if signed else "viridis"} | words))
    elif transfer is None:
        transfer = covering(volume, words)
    return Medium(volume, transfer, filter=filter_for(volume, medium.filter, PICTURE_FILTER), boundary=medium.boundary)


def covering(volume: Volume, words: Mapping[str, Any]) -> TransferFunction:
    """The look of a volume as colours of something else: what it shows as a little of matter covers."""
    opacity: Any = words.get("opacity", 1.0)
    transfer = look(volume, "composite", **{name: value for name, value in words.items() if name != "opacity"})
    if np.ndim(opacity):
        return transfer.with_opacity(opacity)
    faintest = min((share for _, share in transfer.opacities if share > 0), default=1.0)
    return transfer.with_opacity([(value, min(1.0, opacity * min(1.0, share / faintest))) for value, share in transfer.opacities])


def _changed(scene: Scene, transfer: TransferFunction | None, options: RefineOptions) -> Scene:
    """The scene with what is given in place of its own."""
    (medium,) = scene.media
    changes: dict[str, Any] = {name: value for name in ("background", "clip") if (value := options.get(name, ...)) is not ...}
    changes |= {name: value for name in OF_SCENE if (value := options.get(name)) is not None}
    if changes.get("shadow") == 0:
        changes.setdefault("shadow_rays", False)  # the scene's, of shadows that are left out
    if (material := options.get("material")) is not None:
        medium = replace(medium, material=material)
    if transfer is not None:
        medium = medium.with_transfer(transfer)
    if medium is not scene.media[0]:
        changes["media"] = (medium,)
    return replace(scene, **changes) if changes else scene
