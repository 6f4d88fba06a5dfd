"""Units of length: their names, which every format spells differently, and their ratios."""

from __future__ import annotations

import math
from collections.abc import Sequence

from clvol.base.errors import FormatError, GeometryError

__all__ = ["METRES", "axes_unit", "millimetres", "ome_unit", "one_unit", "scale", "unit_name"]

METRES = {"angstrom": 1e-10, "nm": 1e-9, "um": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0, "inch": 0.0254}
"""Metres per unit, by its name in `Volume.units`."""

_SPELLINGS = {
    "um": ("µm", "μm", "micron", "microns", "micrometer", "micrometre", "\\u00b5m"),  # the micro sign and the Greek mu
    "angstrom": ("å", "angstroms", "ångström", "ångströms"),
    "nm": ("nanometer", "nanometre"),
    "mm": ("millimeter", "millimetre"),
    "cm": ("centimeter", "centimetre"),
    "m": ("meter", "metre"),
    "inch": ("in", "inches"),
    "": ("pixel", "pixels", "voxel", "voxels", "reference frame", "dimensionless"),
}
_NAMES = {spelling: name for name, spellings in _SPELLINGS.items() for spelling in spellings}
_OF_OME = {"um": "micrometer", "nm": "nanometer", "mm": "millimeter", "cm": "centimeter", "m": "meter", "inch": "inch"}


def unit_name(text: str) -> str:
    """The name in `Volume.units` of a unit in any spelling; "" for pixels."""
    word = text.strip()
    return _NAMES.get(word.lower(), word)


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


def millimetres(unit: str) -> float:
    """Millimetres per unit; no unit means millimetres. `GeometryError` if it is not a length."""
    if unit and unit not in METRES:
        raise GeometryError(f"units must be a length, {', '.join(METRES)}, for a library that measures in mm; got {unit!r}")
    return scale(unit or "mm", "mm")
