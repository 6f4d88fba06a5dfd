"""Lights, and how a surface answers them (Blinn-Phong)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from clvol.checks import number, reals
from clvol.color import color_of
from clvol.errors import GeometryError, OptionError
from clvol.uniform import FLOAT, INT, Block, Values

__all__ = ["HEADLIGHT", "LIGHTS", "MAX_LIGHTS", "Light", "Material", "lights_block"]

MAX_LIGHTS = 4
LIGHTS = Block("lights_block", each=(FLOAT, 8 * MAX_LIGHTS), count=INT)  # a direction, 1 for a headlight; a colour, nothing


@dataclass(frozen=True)
class Light:
    """A light so far away that it comes from one direction.

    Parameters
    ----------
    direction : sequence of float, optional
        World direction *towards* the light. None: a headlight, which shines along each ray.
    color : sequence of float
        Red, green, blue of the light; 1 is full.
    """

    direction: tuple[float, float, float] | None = None
    color: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        if self.direction is not None:
            what, rule = "a light's direction", "three finite numbers, not all zero"
            vector = reals(what, self.direction, rule, GeometryError)
            length = math.hypot(*map(float, vector)) if vector.shape == (3,) else 0.0
            if not (math.isfinite(length) and length > 0):
                raise GeometryError(f"{what} must be {rule}; got {self.direction!r}")
            object.__setattr__(self, "direction", tuple(float(v) / length for v in vector))
        object.__setattr__(self, "color", color_of("a light's color", self.color))


@dataclass(frozen=True)
class Material:
    """How a surface answers light: shares of ambient, diffuse and specular light, and shininess.

    Surfaces are two-sided: the normal is the one that faces the viewer.
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

    def block(self) -> Values:
        """What kernels read: the exponent also as a whole number, if it is one, and the smallest cosine whose power counts."""
        exponent = self.shininess
        whole = int(exponent) if float(exponent).is_integer() and exponent < 1 << 20 else 0
        return self.BLOCK(
            ambient=self.ambient,
            diffuse=self.diffuse,
            specular=self.specular,
            shininess=exponent,
            whole_shininess=whole,
            min_shine=2.0 ** (-60 / max(exponent, 1e-3)),  # powers below 2**-60 are as good as 0
        )


def lights_block(lights: Sequence[Light]) -> Values:
    """What kernels read of the lights; `OptionError` for more than `MAX_LIGHTS`."""
    if len(lights) > MAX_LIGHTS:
        raise OptionError(f"there may be up to {MAX_LIGHTS} lights; got {len(lights)}")
    each = np.zeros((MAX_LIGHTS, 8))
    for row, light in zip(each, lights, strict=False):
        row[:7] = [*(light.direction or (0, 0, 0)), float(light.direction is None), *light.color]
    return LIGHTS(each=each.ravel(), count=len(lights))


HEADLIGHT = Light()
