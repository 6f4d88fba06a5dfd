"""What a picture shows: media, the lights on them, what is behind them, and the box that is cut out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base.checks import instance
from clvol.base.color import color_of
from clvol.base.errors import GeometryError, OptionError
from clvol.base.uniform import FLOAT, INT, REACH, Block, Values
from clvol.filter.boundary import DEFAULT_BOUNDARY, Boundary, as_boundary
from clvol.filter.filter import Filter
from clvol.filter.table import as_filter
from clvol.scene.light import KIT, Light, Material, as_lights
from clvol.scene.transfer import TransferFunction
from clvol.volume.stored import AS_THEY_ARE, Stored
from clvol.volume.volume import Volume, as_volume

__all__ = ["CLIP", "ROUNDING", "Medium", "Scene", "as_scene", "clip_block"]

ROUNDING = 2.0**-19
"""Gradients up to this share of the function's value a voxel are rounding, and give no normal. In constant volumes they reach
a third of it with every filter written in fractions: the prefilter and the sum over taps round by a few units in the last place.
Those fitted by polynomials of degree 12 exceed it up to eight times."""

CLIP = Block("clip_block", low=(FLOAT, 3), high=(FLOAT, 3), clipped=INT)
_MAX_ANISOTROPY = 1e6  # of spacings: what float32 carries

Box = tuple[Sequence[float], Sequence[float]]


@dataclass(frozen=True, eq=False)
class Medium:
    """A volume, how it is reconstructed between its samples, and how its matter looks.

    Parameters
    ----------
    volume : Volume or array-like, 3-D
        The samples.
    transfer : TransferFunction, optional
        From values to colours and opacities; by default what the mode of the picture shows most volumes with.
    material : Material
        How its matter answers light.
    filter : str or Filter, optional
        How it is reconstructed between its samples; by default as suits the mode of the picture: "bspline3(auto)", or "bspline3"
        in modes that show extremes (`Mode.picture_filter`).
    boundary : str or Boundary
        What lies past its outer samples. The domain is drawn as far as half a voxel past them; under "constant" and "overlap",
        where another function begins at them, just to them.

    Raises
    ------
    OptionError
        The volume does not have three axes, or no filter or boundary has this name.
    GeometryError
        Its spacings differ by a factor of more than 10⁶, or lie outside 10⁻³⁰ to 10³⁰, or an axis has more than 2¹⁸ samples:
        float32 could not tell samples apart. (`clvol.sample` and `Field` count in double where the device can. Whether spacings
        that differ by less are too unequal for a picture depends on the view: see `Renderer.render`.)
    """

    volume: Volume
    transfer: TransferFunction | None = None
    material: Material = Material()  # noqa: RUF009  # frozen
    filter: Filter | None = None
    boundary: Boundary = DEFAULT_BOUNDARY  # type: ignore[assignment]  # __post_init__ looks names up

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

    def __post_init__(self) -> None:
        object.__setattr__(self, "volume", as_volume(self.volume))
        if self.filter is not None:
            object.__setattr__(self, "filter", as_filter(self.filter))
        object.__setattr__(self, "boundary", as_boundary(self.boundary))
        if self.transfer is not None:
            instance("transfer", self.transfer, TransferFunction)
        instance("material", self.material, Material)
        if self.volume.ndim != 3:
            raise OptionError(f"rendering takes a volume with 3 axes; got shape {self.volume.shape}")
        low, high = min(self.volume.spacing), max(self.volume.spacing)
        if high > _MAX_ANISOTROPY * low or not 1e-30 <= low <= high <= 1e30:
            raise GeometryError(
                "rendering takes spacings from 1e-30 to 1e30 that differ by a factor of up to "
                f"{_MAX_ANISOTROPY:g}; got {self.volume.spacing}"
            )
        if max(self.volume.size) > REACH:
            raise GeometryError(
                f"rendering takes axes of up to {REACH} samples, where float32 holds positions within 1/16 of a voxel; got shape "
                f"{self.volume.shape}: draw parts of it (Volume.crop), or take values by clvol.sample"
            )

    def block(self, stored: Stored = AS_THEY_ARE) -> Values:
        """What kernels read: the domain, its map to the world and back, for gradients, and what these are rounded by."""
        volume = self.volume
        low, high = (float(v) for v in stored(volume.value_range))
        unit, inverse = volume.mean_spacing, volume.world_to_index_matrix
        # Gradients are in a unit in which float32 holds their squares, from 2¹³ times the largest value a voxel, more than any
        # filter gives, down to 2⁻¹¹² of it: one voxel may be 1e30 times as bright as all that is to be seen.
        largest = max(high - low, high, -low)
        gradient = inverse / max(1e-5 * largest / unit, 1e-36 * float(np.abs(inverse).max()))
        steepest = float(np.linalg.norm(gradient, 2))
        exponent = min(50 - math.log2(steepest * max(largest, 1e-100)), 120 - math.log2(steepest))  # a power of two rounds nothing
        gradient, steepest = gradient * 2.0 ** math.floor(exponent), steepest * 2.0 ** math.floor(exponent)
        return self.BLOCK(
            index_to_world=volume.index_to_world_matrix.ravel() / unit,
            gradient=gradient.ravel(),
            center=(np.asarray(volume.size) - 1) / 2,
            low=-self.boundary.edge,
            high=np.asarray(volume.size) - 1 + self.boundary.edge,
            unit=unit,
            rounding=ROUNDING * steepest,
        )


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything that a picture shows.

    Parameters
    ----------
    media : Medium, Volume, array-like, or a sequence of these
        What there is to see; so far one medium. (A Field goes to a `Renderer` as it is.)
    lights : Light or sequence of Light
        Up to 4; by default a key, a fill and a headlight, which move with the camera (`clvol.scene.light.KIT`).
    background : three numbers, a name, or None
        Behind the media. None leaves the picture transparent; its colours are then not premultiplied.
    clip : (low, high), optional
        A box of world coordinates (x, y, z) outside which nothing is drawn.

    Raises
    ------
    OptionError
        No medium or several, something that is no light, more than 4 lights, or a background that is no colour.
    GeometryError
        A box that is none.
    """

    media: tuple[Medium, ...]
    lights: tuple[Light, ...] = KIT
    background: tuple[float, float, float] | None = (0.0, 0.0, 0.0)
    clip: Box | None = None

    def __post_init__(self) -> None:
        media: Any = self.media
        if not isinstance(media, (list, tuple)) or (media and not any(isinstance(m, (Medium, Volume, np.ndarray)) for m in media)):
            media = (media,)  # a volume or an array, perhaps as nested lists
        if len(media) != 1:
            raise OptionError(f"a scene must have one medium, no more so far; got {len(media)}")
        media = (as_medium(media[0]),)
        object.__setattr__(self, "media", media)
        object.__setattr__(self, "lights", as_lights(self.lights))
        if self.background is not None:
            object.__setattr__(self, "background", color_of("background", self.background))
        if self.clip is not None:
            object.__setattr__(self, "clip", _box(self.clip))


def as_medium(choice: Medium | Volume | ArrayLike) -> Medium:
    """A medium itself, or one of a volume or an array."""
    return choice if isinstance(choice, Medium) else Medium(choice)  # type: ignore[arg-type]  # __post_init__ converts


def as_scene(choice: Scene | Medium | Volume | ArrayLike) -> Scene:
    """A scene itself, or one of a medium, a volume or an array."""
    return choice if isinstance(choice, Scene) else Scene((as_medium(choice),))


def clip_block(clip: Box | None, volume: Volume) -> Values:
    """What kernels read of a box: relative to the volume's origin, in mean spacings."""
    if clip is None:
        return CLIP(low=0.0, high=0.0, clipped=0)
    low, high = ((np.asarray(corner) - np.asarray(volume.origin)) / volume.mean_spacing for corner in clip)
    return CLIP(low=low, high=high, clipped=1)


def _box(clip: Box) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    try:
        low, high = (np.array([float(v) for v in corner]) for corner in clip)
    except (TypeError, ValueError):
        raise GeometryError(f"clip must be two corners (x, y, z); got {clip!r}") from None
    if low.shape != (3,) or high.shape != (3,) or np.isnan(low).any() or np.isnan(high).any() or (low >= high).any():
        raise GeometryError(
            f"clip must be two corners (x, y, z), each coordinate of the first less than of the second; got {clip!r}"
        )
    low.flags.writeable = high.flags.writeable = False
    return low, high
