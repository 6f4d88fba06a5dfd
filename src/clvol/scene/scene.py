"""The content of a picture: media, lights, background and what is cut away."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import InitVar, dataclass, replace
from importlib import import_module
from types import MappingProxyType
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base.arrays import reals
from clvol.base.checks import flag, if_image, instance, number, one_of, suggests_options, warn
from clvol.base.color import color_of
from clvol.base.errors import DataError, GeometryError, OptionError
from clvol.base.uniform import FLOAT, REACH, Block, Values
from clvol.filter.boundary import UNSAID_BOUNDARY, Boundary, as_boundary
from clvol.filter.filter import Filter
from clvol.filter.table import as_filter
from clvol.interop.dispatch import is_in_parts
from clvol.scene.clip import Box, Clip, as_clip, joined
from clvol.scene.factor import as_factors
from clvol.scene.light import KIT, Light, Material, as_lights
from clvol.scene.mode import Mode, Regions, Surfaces
from clvol.scene.transfer import FACTORS, WORDS, TransferFunction, is_curve
from clvol.volume.provenance import note_masked
from clvol.volume.stored import AS_THEY_ARE, Stored
from clvol.volume.volume import Volume, as_volume, masked
from clvol.volume.volumes import Volumes

__all__ = ["MOST_MEDIA", "ROUNDING", "Box", "Medium", "Scene", "as_scene"]

ROUNDING = 2.0**-19
"""Largest gradient that counts as rounding error and gives no normal, as a fraction of the function's value per voxel. In
constant volumes, all filters with exact fractions reach a third of it: the prefilter and the sum over taps round by a few units
in the last place. Filters fitted by polynomials of degree 12 exceed it up to eight times."""

_MAX_ANISOTROPY = 1e6  # largest ratio of spacings, the limit of float32

MOST_MEDIA = 8
_MIXES = ("add", "over")


@suggests_options
@dataclass(frozen=True, eq=False)
class Medium:
    """A volume with its reconstruction between samples and the look of its matter.

    Parameters
    ----------
    volume : Volume, LazyVolume or array-like, 3-D
        The samples; a LazyVolume is read by bricks.
    transfer : TransferFunction, optional
        From values to colours and opacities; default: chosen by the mode of the picture.
    material : Material
        How its matter reflects light.
    filter : str or Filter, optional
        Reconstruction filter; the default depends on the mode of the picture: "bspline3(auto)", or "bspline3"
        in modes that show extremes (`Mode.picture_filter`).
    visible : bool
        Whether pictures show it; the look of all others does not depend on it.
    mask : array-like, shape of the volume, optional
        Where the medium is: labels, of which `where` names those that show it; or of bool, True where its samples are missing.
        Missing samples are transparent, as where they are NaN.
    where : label or sequence of labels, optional
        The labels of `mask` in which the medium is shown.
    boundary : str or Boundary
        Boundary rule outside its samples, by default "mirror", and "nearest" for regions of labels: with `smooth`, and in mode
        "regions". The domain ends half a voxel outside the outer samples, or at the outer samples for "constant" and "overlap",
        where the function changes there.
    clip : (low, high), Plane, Corner, or a list of these, optional
        What is cut away of this medium alone, beside what `Scene.clip` cuts away of all, and in the same terms. A face shows the
        slice of what is cut there; media that go on in front of it or behind it stay as they are.
    preset, window, cmap, opacity : optional
        The transfer function in words instead, as of `clvol.render`, each mode's own.
    gradient_opacity, curvature_opacity : float, or sequence of (number, factor), optional
        Factors of the transfer function's opacity, as of `clvol.render`: for "composite".
    surfaces : sequence of (value, color, opacity) or str, optional
        Isosurfaces instead of its matter, as of `clvol.Surfaces`, in and among the other media of a "composite"; within a step they
        mix with matter.
    color_by : Medium, Volume, array-like or callable, optional
        What has the colours of its matter, of the faces of cuts through it, and of its surfaces, in "composite", "isosurface" and
        "surfaces": another volume, on a grid of its own, such as a statistical map, a distance or labels. Of a medium the transfer
        function says which colours, and its opacity how far they cover the medium's own. By default values cover all, in viridis;
        labels and presets cover what they show. Where that volume ends, or its samples are missing, the medium has its own
        colours, and so have caps. An array has the medium's grid. A function gives the values at points (n, 3) of the world, and is
        taken at the medium's samples, slice by slice.
    smooth : bool
        Of labels: their regions with smooth boundaries instead of their samples, as of `clvol.Regions`, in and among the other
        media of a "composite". Each has the colour of the transfer function, and stops the share of light that is its opacity
        where a ray enters it, or on the face of a cut; within a step it mixes with matter. `filter` is that of the boundaries, by
        default "bspline5-approx". Slices show the same boundaries, of labels in memory.

    Raises
    ------
    OptionError
        The volume does not have three axes, the filter or boundary is unknown, or there are words beside a transfer function;
        `color_by` is read by bricks, or has cuts or surfaces; `smooth` is beside a mask, surfaces or `color_by`.
    DataError
        A function returned no number for each point; an array of `color_by` has another shape.
    GeometryError
        `clip` is none of these, or has more than 64 planes or 8 corners, those of the scene included.
        Its spacings differ by a factor of more than 10⁶ or are outside 10⁻³⁰ to 10³⁰, or an axis has more than 2¹⁸ samples:
        float32 cannot distinguish samples. (`clvol.sample` and `Field` use double precision if the device supports it. Whether
        less unequal spacings are a problem depends on the view: see `Renderer.render`.)

    Examples
    --------
    >>> import clvol
    >>> ball = clvol.Medium(clvol.phantoms.sphere(24), filter="bspline5", cmap="magma")
    >>> clvol.render(clvol.Scene(ball, background="white"), size=(48, 48)).shape
    (48, 48, 4)
    """

    volume: Volume
    transfer: TransferFunction | None = None
    material: Material = Material()  # noqa: RUF009  # frozen
    filter: Filter | None = None
    boundary: Boundary = UNSAID_BOUNDARY
    visible: bool = True
    clip: Clip | None = None
    preset: str | None = None
    window: tuple[float, float] | None = None
    cmap: str | None = None
    opacity: float | Sequence[tuple[float, float]] | None = None
    gradient_opacity: float | Sequence[tuple[float, float]] | None = None
    curvature_opacity: Sequence[tuple[float, float]] | None = None
    surfaces: Sequence[tuple[float | str, Sequence[float] | str, float]] | str | None = None
    color_by: Medium | None = None
    smooth: bool = False
    mask: InitVar[ArrayLike | None] = None
    where: InitVar[ArrayLike | None] = None

    BLOCK: ClassVar[Block] = Block(
        "geometry_block",
        index_to_world=(FLOAT, 9),
        gradient=(FLOAT, 9),
        center=(FLOAT, 3),
        low=(FLOAT, 3),
        high=(FLOAT, 3),
        unit=FLOAT,
        rounding=FLOAT,
    )

    def __post_init__(self, mask: ArrayLike | None, where: ArrayLike | None) -> None:
        lazy = is_in_parts(self.volume)
        volume = self.volume if lazy else as_volume(self.volume)
        if mask is not None or where is not None:
            outside, plain = _outside(mask, where), volume
            volume = import_module("clvol.bricks.continued").holed(volume, outside) if lazy else masked(volume, outside)
            note_masked(volume, plain, mask, where)
        object.__setattr__(self, "volume", volume)
        instance("visible", self.visible, bool, np.bool_)
        if self.filter is not None:
            object.__setattr__(self, "filter", as_filter(self.filter))
        object.__setattr__(self, "boundary", as_boundary(self.boundary))
        if self.transfer is not None:
            instance("transfer", self.transfer, TransferFunction)
            if self.words:
                raise OptionError(f"transfer must be left out where {' and '.join(self.words)} say what it is; got both")
        instance("material", self.material, Material)
        for name, given in self.factors.items():
            if is_curve(given) or name == "curvature_opacity":
                object.__setattr__(self, name, as_factors(name, given))
            else:
                object.__setattr__(self, name, number(name, given, minimum=0, maximum=1))
        if self.surfaces is not None:
            object.__setattr__(self, "surfaces", Surfaces(self.surfaces).surfaces)
            if self.transfer is not None or self.words or self.factors:
                given = " and ".join({**self.words, **self.factors} or ("transfer",))
                raise OptionError(f"surfaces of a medium have colours of their own: {given} must be left out")
        if self.clip is not None:
            object.__setattr__(self, "clip", as_clip(self.clip))
        if self.volume.ndim != 3:
            raise OptionError(f"rendering takes a volume with 3 axes; got shape {self.volume.shape}{if_image(self.volume.shape)}")
        low, high = min(self.volume.spacing), max(self.volume.spacing)
        if high > _MAX_ANISOTROPY * low or not 1e-30 <= low <= high <= 1e30:
            raise GeometryError(
                "rendering takes spacings from 1e-30 to 1e30 that differ by a factor of up to "
                f"{_MAX_ANISOTROPY:g}; got {self.volume.spacing}"
            )
        if max(self.volume.size) > REACH:
            raise GeometryError(
                f"rendering takes axes of up to {REACH} samples, where float32 is accurate to 1/16 of a voxel; got shape "
                f"{self.volume.shape}: render parts of it (Volume.crop), or use clvol.sample"
            )
        if self.color_by is not None:
            object.__setattr__(self, "color_by", _coloring(self.color_by, self.volume))
        instance("smooth", self.smooth, bool, np.bool_)
        if self.smooth:
            each = *(("surfaces", self.surfaces), ("color_by", self.color_by), ("mask", mask)), *self.factors.items()
            if own := [name for name, value in each if value is not None]:
                raise OptionError(f"smooth shows the regions of labels, in colours of their own, and takes no {' and '.join(own)}")

    @property
    def words(self) -> dict[str, Any]:
        """The transfer function in words: arguments of `clvol.scene.look.look`; nothing where it is not given in words."""
        return {name: value for name in WORDS if (value := getattr(self, name)) is not None}

    @property
    def factors(self) -> dict[str, Any]:
        """Factors of opacity that are given: arguments of `clvol.scene.look.graded`."""
        return {name: value for name in FACTORS if (value := getattr(self, name)) is not None}

    @property
    def beyond_words(self) -> tuple[str, ...]:
        """What it has that is no option of a picture: cuts, surfaces and smooth boundaries of its own, and what colours it."""
        return tuple(name for name in ("clip", "surfaces", "smooth", "color_by") if getattr(self, name))

    def shown_in(self, mode: Mode) -> Mode:
        """The mode in which a picture draws it; `OptionError` if that shows nothing of its surfaces or smooth boundaries."""
        if (self.surfaces and mode.regions) or ((self.surfaces or self.smooth) and mode.shows != "matter"):
            own = "surfaces" if self.surfaces else "smooth boundaries"
            raise OptionError(f"{own} of a medium change nothing in {mode.name}: they are for composite; leave them out")
        if self.surfaces:
            return Surfaces(self.surfaces, mode.shaded)
        return Regions(mode.shaded) if self.smooth else mode

    def with_transfer(self, transfer: TransferFunction | None) -> Medium:
        """The same with a transfer function, instead of its own or of words, and of factors."""
        none: dict[str, Any] = dict.fromkeys((*WORDS, *FACTORS))
        return replace(self, transfer=transfer, **none)

    def with_look(self, other: Medium) -> Medium | None:
        """The same with the look of another medium of this function, as it is here or was given; None if that is of another."""
        given = vars(self.volume).get("_of", self) if is_in_parts(other.volume) else self
        if other.volume is not given.volume or other.reconstruction != given.reconstruction:
            return None
        return other if given is self else replace(other, volume=self.volume, filter=self.filter, boundary=self.boundary)

    @property
    def reconstruction(self) -> tuple[Filter | None, Boundary, bool, bool]:
        """How its functions are made of samples."""
        return self.filter, self.boundary, self.boundary.given, self.smooth  # in place of a default, regions have a rule of theirs

    @property
    def domain(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The corners of the domain, in samples."""
        last = np.asarray(self.volume.size, np.float64) - 1
        return np.full(3, -self.boundary.edge), last + self.boundary.edge

    def block(self, stored: Stored = AS_THEY_ARE, unit: float | None = None) -> Values:
        """The block for kernels: the domain, its map to the world and back for gradients, and the rounding error of gradients.

        `unit` is their unit of length in world units; by default the mean spacing.
        """
        volume = self.volume
        unit, (first, last) = unit or volume.mean_spacing, self.domain
        scale = self.gradient_scale(stored, unit)
        return self.BLOCK(
            index_to_world=volume.index_to_world_matrix.ravel() / unit,
            gradient=(volume.world_to_index_matrix * scale).ravel(),
            center=(np.asarray(volume.size) - 1) / 2,
            low=first,
            high=last,
            unit=unit,
            rounding=ROUNDING * scale * float(np.linalg.norm(volume.world_to_index_matrix, 2)),
        )

    def gradient_scale(self, stored: Stored, unit: float) -> float:
        """What kernels multiply gradients by, which are in stored units per world unit."""
        low, high = (float(v) for v in stored(self.volume.value_range))
        inverse = self.volume.world_to_index_matrix
        # The unit of gradients lets float32 hold their squares, from 2¹³ times the largest value per voxel, more than any
        # filter gives, down to 2⁻¹¹² of it: one voxel may be 1e30 times as bright as all visible matter.
        largest = max(high - low, high, -low)
        scale = 1 / max(1e-5 * largest / unit, 1e-36 * float(np.abs(inverse).max()))
        steepest = scale * float(np.linalg.norm(inverse, 2))
        exponent = min(50 - math.log2(steepest * max(largest, 1e-100)), 120 - math.log2(steepest))  # a power of two is exact
        return float(scale * 2.0 ** math.floor(exponent))


@suggests_options
@dataclass(frozen=True, eq=False)
class Scene:
    """The content of a picture.

    Parameters
    ----------
    media : Medium, Volume, LazyVolume, array-like, a sequence of these, or Volumes
        The media to render, 1 to 8, on one grid or on several; or the channels of `Volumes`, each in its colour. (Give a Field
        directly to a `Renderer`.)
    lights : Light or sequence of Light
        Up to 4; default: key light, fill light and headlight, which move with the camera (`clvol.scene.light.KIT`).
    background : three numbers, a name, or None
        Colour behind the media. None: transparent, with colours that are not premultiplied.
    clip : (low, high), Plane, Corner, or a list of these, optional
        What is cut away, in world coordinates (x, y, z): all outside a box, the half that a `Plane` points to, the inside of a
        `Corner`; of a list, all that any of them cuts away. The camera is fitted to what is in the box; planes and corners do
        not move it, and change no pixel whose ray misses what they cut away. Matter that is lit shows its slice on the faces of
        a cut, unlit, and surfaces may have caps there: `cap` of the modes "composite" and "isosurface".
    shadow : float
        How dark shadows are, 0 to 1: how much of the light that matter stops on its way from each light is missing in
        "composite", "isosurface" and "surfaces". The shadows of lights that move with the camera would move too, so with shadows
        these stand where they are in the volume's usual view; a headlight casts none.
    shadow_rays : bool
        Whether `shadow` of "isosurface" and "surfaces" is exact: a ray from each place that is seen goes towards each light and
        finds the surfaces that it crosses. Edges are sharp, and what is thin casts a thin shadow; else shadows are soft, of about
        80 cells along each axis. Of one medium in memory; occlusion stays soft.
    occlusion : float
        How dark ambient light and headlights are where matter is around, 0 to 1: how much of the light from all directions that
        matter stops is missing. Half of them are open above a flat surface, where nothing is missing.
    linear_light : bool
        Whether the colours of what is lit, and of what lies behind each other, are computed in linear light and shown in sRGB, in
        "composite", "surfaces" and "regions", and "isosurface" with shading. Colours that are given are as they are shown; False
        computes with those numbers as they are.
    mix : {"add", "over"}
        How the projections of several media go together. "add": their colours add up, as those of a microscope's channels do.
        "over": each covers those after it in the list as far as it is bright.

    Raises
    ------
    OptionError
        There is no medium or more than 8, an entry of `lights` is not a light, there are more than 4, `background` is not a
        colour, or there is no shadow whose rays would be cast.
    GeometryError
        `clip` is none of these, or has more than 64 planes or 8 corners. Media are in worlds of
        different orientation, as those of a patient and of a stack of images, or their units differ.

    Warns
    -----
    ClvolWarning
        A medium overlaps no other, or DICOM says that media are in different frames of reference.

    Notes
    -----
    In "composite" the media share the samples of each ray: their extinctions add, colours are weighted by extinction, and one
    exponential of the sum says how much light is left, so that the order of the list does not change a bit. Samples lie on planes
    of the finest grid; steps count its voxels. An opacity without a `unit_distance` is that of one voxel of its own grid.
    "isosurface" shows the nearest surface of all; projections are mixed.

    Examples
    --------
    >>> import numpy as np, clvol
    >>> x, y, z = np.mgrid[-1:1:24j, -1:1:24j, -1:1:24j]
    >>> ball = clvol.Volume(1 - np.sqrt(x**2 + y**2 + z**2))
    >>> shell = clvol.Medium(ball, clvol.TransferFunction([(0, "white")], [(0.1, 0), (0.3, 0.1), (0.5, 0)]))
    >>> core = clvol.Medium(ball, clvol.TransferFunction([(0, "red")], [(0.6, 0), (0.7, 0.8)]))
    >>> clvol.render(clvol.Scene([shell, core]), size=(64, 48)).shape
    (48, 64, 4)
    """

    media: tuple[Medium, ...]
    lights: tuple[Light, ...] = KIT
    background: tuple[float, float, float] | None = (0.0, 0.0, 0.0)
    clip: Clip | None = None
    shadow: float = 0.0
    shadow_rays: bool = False
    occlusion: float = 0.0
    linear_light: bool = False
    mix: Literal["add", "over"] = "add"

    def __post_init__(self) -> None:
        media: Any = channels(self.media) if isinstance(self.media, Volumes) else self.media
        if not isinstance(media, (list, tuple)) or (
            media and not any(isinstance(m, (Medium, Volume, np.ndarray)) or is_in_parts(m) for m in media)
        ):
            media = (media,)  # a volume or an array, possibly nested lists
        if not 1 <= len(media) <= MOST_MEDIA:
            raise OptionError(f"a scene must have 1 to {MOST_MEDIA} media; got {len(media)}")
        media = tuple(map(as_medium, media))
        _require_one_world({f"medium {k}": medium.volume.grid for k, medium in enumerate(media)})
        for k, medium in enumerate(media):
            _require_colors_there(k, medium)
        if self.mix not in _MIXES:
            raise one_of("mix", self.mix, _MIXES)
        object.__setattr__(self, "media", media)
        object.__setattr__(self, "lights", as_lights(self.lights))
        for name in ("shadow", "occlusion"):
            object.__setattr__(self, name, number(name, getattr(self, name), minimum=0, maximum=1))
        for name in ("shadow_rays", "linear_light"):
            object.__setattr__(self, name, flag(name, getattr(self, name)))
        if self.shadow_rays and not self.shadow:
            raise OptionError("shadow_rays changes nothing without shadow, which says how dark shadows are; got shadow=0")
        if self.background is not None:
            object.__setattr__(self, "background", color_of("background", self.background))
        if self.clip is not None:
            object.__setattr__(self, "clip", as_clip(self.clip))
        for medium in media:
            self.clip_of(medium)  # no more cuts than a picture may have

    @property
    def grid(self) -> Volume:
        """The grid of the first medium."""
        return self.media[0].volume.grid

    @property
    def name(self) -> str:
        """The name of the first medium's volume."""
        return self.media[0].volume.name

    @property
    def in_memory(self) -> bool:
        """Whether a pickle holds samples of a medium."""
        return self.nbytes > 0

    @property
    def nbytes(self) -> int:
        """Bytes of the samples that a pickle holds, each volume once."""
        media = (*self.media, *(medium.color_by for medium in self.media if medium.color_by))
        return sum(volume.nbytes for volume in {id(one.volume): one.volume for one in media}.values() if volume.in_memory)

    def preview(self) -> Volume:
        """Samples of the first medium, from which looks are chosen."""
        return self.media[0].volume.preview()

    def for_tasks(self) -> Scene:
        """The scene as sent to tasks of a cluster: see `LazyVolume.for_tasks`."""
        return self.of_media([replace(medium, volume=medium.volume.for_tasks()) for medium in self.media])

    def with_looks(self, media: Sequence[Medium]) -> Scene:
        """The same with other looks of its media; `OptionError` if these are of other volumes, or reconstructed otherwise."""
        rule = "the scene's, in their order, with its volumes, filters, boundaries and smooth"
        if not isinstance(media, (list, tuple)) or len(media) != len(self.media):
            raise OptionError(f"media must be {rule}; got {media!r:.200}")
        seen = []
        for k, (own, other) in enumerate(zip(self.media, media, strict=True)):
            instance("each of media", other, Medium)
            if (medium := own.with_look(other)) is None:
                raise OptionError(f"media must be {rule}; number {k} has others")
            seen.append(medium)
        made = self.of_media(seen)
        for k, medium in enumerate(seen):
            made.clip_of(medium)
            _require_colors_there(k, medium)
        return made

    def of_media(self, media: Sequence[Medium]) -> Scene:
        """The same of media that are where its own are: what is checked of a scene does not change."""
        made: Scene = object.__new__(Scene)
        vars(made).update(vars(self), media=tuple(media))
        return made

    def clip_of(self, medium: Medium) -> Clip | None:
        """What is cut away of one of its media: by the scene, and by the medium itself."""
        return joined(self.clip, medium.clip)


def _coloring(given: Any, volume: Volume) -> Medium:
    """What colours a medium of this volume."""
    if callable(given):
        if is_in_parts(volume):
            raise OptionError("color_by takes a function only for a volume in memory; sample it, and give the volume")
        y, x = np.indices(volume.shape[1:])
        slices = []
        for z in range(volume.shape[0]):
            points = volume.index_to_world(np.stack([x, y, np.full_like(x, z)], -1).reshape(-1, 3))
            values = reals("the values of color_by", given(points), "one for each point")
            if values.size != len(points):
                raise DataError(
                    f"the function of color_by must return one value for each of {len(points)} points; got {values.shape}"
                )
            slices.append(values.reshape(x.shape))
        given = np.stack(slices)
    if isinstance(given, (np.ndarray, list, tuple)):
        given = np.asarray(given)
        if given.shape != volume.shape:
            raise DataError(f"an array of color_by must have the medium's shape, {volume.shape}; got {given.shape}: give a Volume")
        given = Volume(given, **{name: getattr(volume, name) for name in ("spacing", "origin", "direction", "units", "space")})
    made = as_medium(given)
    if is_in_parts(made.volume):
        raise OptionError("color_by takes a volume in memory; got one that is read by bricks: give its whole()")
    if made.factors or (made.transfer is not None and made.transfer.graded):
        raise OptionError("color_by takes a medium whose opacity is by value alone, without gradient_opacity and the like")
    if made.beyond_words or not made.visible or made.material != Material():
        raise OptionError(
            "color_by takes a medium without clip, surfaces, smooth, material and color_by of its own, and a visible one"
        )
    return made


def _require_colors_there(number: int, medium: Medium) -> None:
    """Raise or warn if what colours a medium is not where that is."""
    if medium.color_by is not None:
        _require_one_world({f"color_by of medium {number}": medium.color_by.volume, f"medium {number}": medium.volume.grid}, said=1)


def _require_one_world(named: Mapping[str, Volume], said: int | None = None) -> None:
    """Raise if coordinates of volumes cannot be compared; warn if it seems that they are not meant to be, of the first ones."""
    volumes = list(named.values())
    for what, names in (("world", {one.space for one in volumes}), ("unit", {one.units for one in volumes})):
        if len(names - {""}) > 1:
            raise GeometryError(f"the media of a scene must be in one {what}; got volumes in {' and '.join(sorted(names - {''}))}")
    frames = {str(one.header.get("frame_of_reference", "")) for one in volumes} - {""}
    if len(frames) > 1:
        warn(
            f"the media of a scene are in {len(frames)} DICOM frames of reference, whose coordinates are not related "
            f"unless the volumes were registered: {' and '.join(sorted(frames))}"
        )
    ends = [(one.corners.min(0), one.corners.max(0)) for one in volumes]
    for k, (low, high) in enumerate(ends[:said] if len(ends) > 1 else ()):
        if not any((low < b).all() and (a < high).all() for n, (a, b) in enumerate(ends) if n != k):
            spans = " to ".join(f"({', '.join(f'{v:.6g}' for v in corner)})" for corner in (low, high))
            warn(f"{list(named)[k]} of a scene overlaps no other: it spans {spans}")


def as_slice(image: Volume) -> Volume:
    """An image as a volume of one slice, whose voxels are as thick as they are wide."""
    direction = np.eye(3)
    direction[:2, :2] = image.direction
    place = {"spacing": (*image.spacing, image.mean_spacing), "origin": (*image.origin, 0.0), "direction": direction}
    return replace(image, data=image.data[None], space=image.space or "image", **place)  # type: ignore[arg-type]  # of three axes


def as_medium(choice: Medium | Volume | ArrayLike) -> Medium:
    """A medium, or a medium from a volume or an array."""
    return choice if isinstance(choice, Medium) else Medium(choice)  # type: ignore[arg-type]  # __post_init__ converts


def as_scene(choice: Scene | Medium | Volume | Volumes | ArrayLike) -> Scene:
    """A scene, or a scene from a medium, a volume, the channels of several, or an array."""
    if isinstance(choice, Volumes):
        return Scene(channels(choice))
    return choice if isinstance(choice, Scene) else Scene((as_medium(choice),))


def channels(volumes: Volumes, at: Mapping[str, int] = MappingProxyType({}), /, **words: Any) -> tuple[Medium, ...]:
    """The media of a microscope's channels, each in its colour; `words` are further arguments of `Medium`.

    `at` is a place along axes other than "channel"; along those without one the first is taken, with a warning.
    """
    counts = dict(zip(volumes.axes, volumes.leading.counts, strict=True))
    others = {axis: n for axis, n in counts.items() if axis not in ("channel", *at) and n > 1}
    if not volumes.colors:
        held = f"{len(volumes)} volume" if not others else " of ".join(f"{n} {axis}s" for axis, n in others.items())
        raise DataError(f"data must be one volume or the channels of one; got Volumes of {held}: take one, as volumes[0]")
    if others:
        left = " and ".join(f"{n} {axis}s" for axis, n in others.items())
        warn(f"data holds {left}; the first of them is shown: choose by time= and the like when it is read")
    first = {axis: at.get(axis, volumes.leading.first(axis)) for axis in volumes.axes if axis != "channel"}
    each = [volumes.pick(**first, channel=k) for k in range(counts["channel"])]
    if each[0].ndim == 2:
        each = [as_slice(volume) for volume in each]
    shown = list(zip(each, volumes.colors, strict=True))
    if volumes.leading.rgb:  # without alpha, and as bright as they are beside each other
        shown, kind = shown[:3], np.asarray(volumes).dtype
        top = float(np.iinfo(kind).max if kind.kind == "u" else max(volume.limits[1] for volume, _ in shown))
        shown = [(replace(volume, clim=(0.0, top) if top > 0 else None), color) for volume, color in shown]
    return tuple(Medium(replace(volume, color=color), **words) for volume, color in shown)


def _outside(mask: ArrayLike | None, where: ArrayLike | None) -> NDArray[np.bool_]:
    """Where a medium's samples are missing."""
    if mask is None:
        raise OptionError(f"where names labels of a mask; got where={where!r} and no mask")
    labels = np.asarray(mask.data if isinstance(mask, Volume) else mask)
    if where is None:
        if labels.dtype != np.bool_:
            raise OptionError(f"a mask of labels takes where=, those that show the medium; got {labels.dtype} and no where")
        return labels
    wanted = np.atleast_1d(np.asarray(where))
    absent = [label for label in wanted.tolist() if not (labels == label).any()]
    if absent:
        raise OptionError(f"where must name labels of the mask, which has {_some(np.unique(labels))}; got {absent}")
    return ~np.isin(labels, wanted)


def _some(labels: NDArray[Any]) -> str:
    named = ", ".join(f"{label:g}" for label in labels[:8])
    return f"{named}, ... ({len(labels)} in all)" if len(labels) > 8 else named
