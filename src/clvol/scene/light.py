"""Lights, and how surfaces reflect them (Blinn-Phong)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from clvol.base.arrays import reals
from clvol.base.checks import number, one_of, suggests_options
from clvol.base.color import color_of
from clvol.base.errors import GeometryError, OptionError
from clvol.base.srgb import as_light
from clvol.base.uniform import FLOAT, INT, Block, Values
from clvol.scene.camera import Viewpoint

__all__ = ["HEADLIGHT", "KIT", "LIGHTS", "MAX_LIGHTS", "Light", "Material", "as_lights", "casts", "lights_block", "usual_lights"]

MAX_LIGHTS = 4
_FRAMES = ("world", "camera")
LIGHTS = Block(  # those with directions: direction, colour, number; the sum of the headlights, and the number of one
    "lights_block", each=(FLOAT, 7 * MAX_LIGHTS), directed=INT, ahead=(FLOAT, 3), headlight=INT
)


@suggests_options
@dataclass(frozen=True)
class Light:
    """A directional light.

    Parameters
    ----------
    direction : sequence of float, optional
        Direction *towards* the light. None: a headlight, along each ray.
    color : sequence of float
        Red, green, blue of the light; 1 is full intensity.
    frame : {"world", "camera"}
        Frame of the direction, if there is one: (x, y, z) of the world; or right, up and towards the viewer in the picture, for a
        light that moves with the camera.

    Examples
    --------
    >>> import clvol
    >>> from_the_right = clvol.Light(direction=(1, 0, 0), frame="camera")  # lights=[from_the_right] of render
    """

    direction: tuple[float, float, float] | None = None
    color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    frame: Literal["world", "camera"] = "world"

    def __post_init__(self) -> None:
        if self.direction is not None:
            what, rule = "a light's direction", "three finite numbers, not all zero"
            vector = reals(what, self.direction, rule, GeometryError)
            length = math.hypot(*map(float, vector)) if vector.shape == (3,) else 0.0
            if not (math.isfinite(length) and length > 0):
                raise GeometryError(f"{what} must be {rule}; got {self.direction!r}")
            if abs(length - 1) < 1e-15:  # normalized again it might differ in the last bit
                length = 1.0
            object.__setattr__(self, "direction", tuple(float(v) / length for v in vector))
        object.__setattr__(self, "color", color_of("a light's color", self.color))
        if not isinstance(self.frame, str) or self.frame not in _FRAMES:
            raise one_of("a light's frame", self.frame, _FRAMES)
        if self.direction is None and self.frame != "world":
            raise OptionError(
                "a light's frame changes nothing without a direction: a headlight shines along each ray; leave it out"
            )

    def placed(self, view: Viewpoint) -> Light:
        """The same light in a picture's world."""
        if self.direction is None or self.frame == "world":
            return self
        right, up, back = self.direction
        x, y, z = (float(v) for v in right * view.right + up * view.up - back * view.forward)
        return Light((x, y, z), self.color)


@suggests_options
@dataclass(frozen=True)
class Material:
    """How a surface reflects light: ambient, diffuse and specular coefficients, and shininess.

    Surfaces are two-sided: the normal faces the viewer.

    Notes
    -----
    ``ambient`` is how bright a white surface is without any light, and ``ambient + diffuse`` in the full light of one, both as they
    are shown. In linear light (`clvol.Scene`) these two stay, and what lies between is brighter.
    """

    ambient: float = 0.25
    diffuse: float = 0.75
    specular: float = 0.2
    shininess: float = 30.0

    BLOCK: ClassVar[Block] = Block(
        "material_block", ambient=FLOAT, diffuse=FLOAT, specular=FLOAT, shininess=FLOAT, whole_shininess=INT, min_shine=FLOAT
    )

    def __post_init__(self) -> None:
        for what in ("ambient", "diffuse", "specular", "shininess"):
            object.__setattr__(self, what, number(what, getattr(self, what), minimum=0))

    def block(self, *, linear: bool = False) -> Values:
        """The block for kernels: the exponent also as an integer, if it is one, and the smallest cosine whose power counts.

        `linear`: for colours in linear light.
        """
        dark, full = self.ambient, self.ambient + self.diffuse
        ambient, diffuse = (as_light(dark), as_light(full) - as_light(dark)) if linear else (dark, self.diffuse)
        exponent = self.shininess
        whole = int(exponent) if float(exponent).is_integer() and exponent < 1 << 20 else 0
        return self.BLOCK(
            ambient=ambient,
            diffuse=diffuse,
            specular=self.specular,
            shininess=exponent,
            whole_shininess=whole,
            min_shine=2.0 ** (-60 / max(exponent, 1e-3)),  # powers below 2**-60 count as 0
        )


def as_lights(choice: Light | Sequence[Light]) -> tuple[Light, ...]:
    """One light or several; `OptionError` for anything else, or more than `MAX_LIGHTS`."""
    lights = (choice,) if isinstance(choice, Light) else choice
    if not isinstance(lights, Sequence) or not all(isinstance(light, Light) for light in lights):
        raise OptionError(f"lights must be a Light or a sequence of them; got {choice!r}")
    if len(lights) > MAX_LIGHTS:
        raise OptionError(f"there may be up to {MAX_LIGHTS} lights; got {len(lights)}")
    return tuple(lights)


def casts(lights: Light | Sequence[Light]) -> bool:
    """Whether some light casts shadows: a headlight stands where they are seen from."""
    return any(light.direction is not None for light in as_lights(lights))


def lights_block(lights: Sequence[Light], view: Viewpoint) -> Values:
    """What kernels read of the lights, up to `MAX_LIGHTS`, in a view; they are numbered from 1."""
    each, headlights = np.zeros((MAX_LIGHTS, 7)), [(n, light) for n, light in enumerate(lights, 1) if light.direction is None]
    directed = [(n, light.placed(view)) for n, light in enumerate(lights, 1) if light.direction is not None]
    for row, (n, light) in zip(each, directed, strict=False):
        row[:] = [*(light.direction or ()), *light.color, n]
    return LIGHTS(
        each=each.ravel(),
        directed=len(directed),
        ahead=np.sum([light.color for _, light in headlights], axis=0) if headlights else 0.0,
        headlight=headlights[0][0] if headlights else 0,
    )


HEADLIGHT = Light()

KIT = (
    Light((-0.45, 0.55, 0.75), (0.67, 0.67, 0.67), "camera"),
    Light((0.6, -0.6, 0.5), (0.25, 0.25, 0.25), "camera"),
    Light(None, (0.35, 0.35, 0.35)),
)
"""Default lights of pictures, as in photography and `vtkLightKit`: the key light from above the viewer's left
shoulder models the form, the weaker fill light from below on the right softens its shadows, and the headlight keeps all of it
visible. No normal receives more light than from one headlight of full intensity."""

_LINEAR_KIT = tuple(Light(light.direction, (share,) * 3, light.frame) for light, share in zip(KIT, (0.81, 0.1, 0.2), strict=True))
"""The same in linear light, where the weaker lights would leave less form: pictures are about as bright as with the others."""


def usual_lights(lights: tuple[Light, ...], *, linear: bool) -> tuple[Light, ...]:
    """The lights of a picture, given those of its scene: the default ones are weighted otherwise in linear light."""
    return _LINEAR_KIT if linear and lights == KIT else lights
