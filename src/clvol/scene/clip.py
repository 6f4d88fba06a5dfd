"""Planes of the world."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, TypeAlias

from clvol.base.errors import GeometryError

__all__ = ["Plane"]

Triple: TypeAlias = tuple[float, float, float]


@dataclass(frozen=True)
class Plane:
    """A plane of the world, such as that of a slice.

    Parameters
    ----------
    normal : three numbers
        Direction (x, y, z) in the world, of any length but 0. A slice is seen from the side that it points to.
    point : three numbers
        A point of the plane in world coordinates (x, y, z).

    Raises
    ------
    GeometryError
        The normal has no direction, or a number is not finite.
    """

    normal: Triple
    point: Triple

    def __post_init__(self) -> None:
        normal, point = (_numbers(f"a plane's {name}", getattr(self, name)) for name in ("normal", "point"))
        largest = max(map(abs, normal))
        if not largest > 0:
            raise GeometryError(f"a plane's normal must have a direction, so one of its numbers must not be 0; got {self.normal!r}")
        length = math.hypot(*(v / largest for v in normal))
        object.__setattr__(self, "normal", tuple(v / largest / length for v in normal))
        object.__setattr__(self, "point", point)


def _numbers(what: str, value: Any) -> Triple:
    try:
        numbers = tuple(float(v) for v in value)
    except (TypeError, ValueError):
        numbers = ()
    if len(numbers) != 3 or not all(map(math.isfinite, numbers)):
        raise GeometryError(f"{what} must be three finite numbers (x, y, z); got {value!r}")
    return numbers
