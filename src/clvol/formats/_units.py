"""Names of length units, which every format spells in its own way."""

from __future__ import annotations

import math
from collections.abc import Sequence

from clvol.base.errors import FormatError
from clvol.foreign import METRES

__all__ = ["METRES", "ome_unit", "one_unit", "scale", "unit_name"]

_SPELLINGS = {
    "um": ("µm", "μm", "micron", "microns", "micrometer", "micrometre", "\\u00b5m"),  # the micro sign and the Greek mu
    "nm": ("nanometer", "nanometre"),
    "mm": ("millimeter", "millimetre"),
    "cm": ("centimeter", "centimetre"),
    "m": ("meter", "metre"),
    "inch": ("in", "inches"),
    "": ("pixel", "pixels", "voxel", "voxels", "reference frame"),
}
_NAMES = {spelling: name for name, spellings in _SPELLINGS.items() for spelling in spellings}


def unit_name(text: str) -> str:
    """The one name that `Volume.units` uses for what `text` spells; "" for counts of pixels."""
    word = text.strip()
    return _NAMES.get(word.lower(), word)


_OF_OME = {"um": "micrometer", "nm": "nanometer", "mm": "millimeter", "cm": "centimeter", "m": "meter", "inch": "inch"}


def ome_unit(name: str) -> str:
    """The name of UDUNITS-2, which OME-Zarr has, for a unit."""
    return _OF_OME.get(unit_name(name), name)


def one_unit(source: str, units: Sequence[str]) -> str:
    """The unit that all of `units` name, "" if they name none."""
    names = {unit_name(unit) for unit in units} - {""}
    if len(names) > 1:
        raise FormatError(f"{source} must have one unit along all axes; got {sorted(names)}")
    return names.pop() if names else ""


def scale(unit: str, to: str) -> float:
    """How many of unit `to` one `unit` is; NaN if either is not a known length."""
    return 1.0 if unit == to else METRES.get(unit, math.nan) / METRES.get(to, math.nan)
