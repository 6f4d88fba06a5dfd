"""Lights, and how a surface answers them (Blinn-Phong)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from clvol.checks import number, reals
from clvol.color import color_of
from clvol.errors import GeometryError

__all__ = ["HEADLIGHT", "MAX_LIGHTS", "Light", "Material"]

MAX_LIGHTS = 4


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

    def __post_init__(self) -> None:
        for what in ("ambient", "diffuse", "specular", "shininess"):
            object.__setattr__(self, what, number(what, getattr(self, what), least=0))


HEADLIGHT = Light()
