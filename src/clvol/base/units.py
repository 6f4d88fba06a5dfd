"""Units of length: their names, which every format spells differently, and their ratios."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from clvol.base.checks import warn
from clvol.base.errors import FormatError, GeometryError

__all__ = ["METRES", "axes_unit", "in_one_unit", "millimetres", "ome_unit", "one_unit", "scale", "unit_name"]

METRES = {
    "pm": 1e-12,
    "angstrom": 1e-10,
    "nm": 1e-9,
    "um": 1e-6,
    "mm": 1e-3,
    "cm": 1e-2,
    "dm": 1e-1,
    "m": 1.0,
    "km": 1e3,
    "inch": 0.0254,
    "ft": 0.3048,
}
"""Metres per unit, by its name in `Volume.units`."""

_OF_OME = {
    "pm": "picometer",
    "angstrom": "angstrom",
    "nm": "nanometer",
    "um": "micrometer",
    "mm": "millimeter",
    "cm": "centimeter",
    "dm": "decimeter",
    "m": "meter",
    "km": "kilometer",
    "inch": "inch",
    "ft": "foot",
}
_SPELLINGS = {name: (word, word.replace("meter", "metre")) for name, word in _OF_OME.items()} | {
    "um": ("micrometer", "micrometre", "micron", "µm", "μm", "\\u00b5m"),  # the micro sign and the Greek mu
    "angstrom": ("angstrom", "ångström", "ångstrom", "å"),
    "inch": ("inch", "in", "inches"),
    "ft": ("foot", "feet"),
    "": ("pixel", "voxel", "reference frame", "dimensionless"),
}
_NAMES = {spelling: name for name, spellings in _SPELLINGS.items() for spelling in spellings}


def unit_name(text: str) -> str:
    """The name in `Volume.units` of a unit in any spelling; "" for pixels."""
    word = text.strip()
    low = word.lower()
    return _NAMES.get(low, _NAMES.get(low.removesuffix("s"), word))


def ome_unit(name: str) -> str:
    """The unit's name in UDUNITS-2, which OME-Zarr uses."""
    return _OF_OME.get(unit_name(name), name)


def one_unit(source: str, units: Sequence[str]) -> str:
    """The common unit of a file's axes, of which some may have none; "" if none has one. `FormatError` if they differ."""
    names = {unit_name(unit) for unit in units} - {""}
    if len(names) > 1:
        raise FormatError(f"{source} must have one unit along all axes; got {sorted(names)}")
    return names.pop() if names else ""


def axes_unit(units: Sequence[str]) -> str:
    """The common unit of an image's axes; "" if they differ and one is no length. `GeometryError` if all are, and they differ."""
    known = {unit_name(unit) for unit in units}
    if len(known) > 1 and known <= METRES.keys():
        raise GeometryError(f"all axes must be in one unit of length; got {', '.join(units)}")
    return known.pop() if len(known) == 1 else ""


def scale(unit: str, to: str) -> float:
    """Units `to` per `unit`; NaN if either is not a known length."""
    return 1.0 if unit == to else METRES.get(unit, math.nan) / METRES.get(to, math.nan)


def in_one_unit(source: str, units: Mapping[str, str]) -> tuple[str, dict[str, float]]:
    """One unit for the axes of `source`, from a unit for each, and the factors to it. Axes without a unit have that of the others.

    Axes whose units cannot be converted, as degrees or pixels beside metres, have no unit, and factors of 1; a warning says so.
    """
    names = {axis: unit_name(unit) or ("pixel" if unit else "") for axis, unit in units.items()}
    unit = next(filter(None, names.values()), "")
    factors = {axis: scale(name or unit, unit) for axis, name in names.items()}
    if not any(map(math.isnan, factors.values())):
        return unit_name(unit), factors
    if not METRES.keys().isdisjoint(names.values()):
        listed = ", ".join(f"{axis} in {name}" for axis, name in names.items() if name)
        warn(f"{source} has axes of different units ({listed}), which were taken as they are: spacing= replaces them")
    return "", dict.fromkeys(names, 1.0)


def millimetres(unit: str) -> float:
    """Millimetres per unit; no unit means millimetres. `GeometryError` if it is not a length."""
    if unit and unit not in METRES:
        raise GeometryError(f"units must be a length, {', '.join(METRES)}, for a library that measures in mm; got {unit!r}")
    return scale(unit or "mm", "mm")
