"""Every error that clvol raises on purpose: one base, one subclass per cause.

Each subclass is also the standard exception that a caller would expect, so both
``except clvol.ClvolError`` and ``except ValueError`` catch a bad argument.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from numbers import Integral, Real

import numpy as np

__all__ = [
    "ClvolError",
    "DataError",
    "DeviceError",
    "FormatError",
    "GeometryError",
    "MissingDependencyError",
    "OptionError",
    "OutOfMemoryError",
    "number",
    "one_of",
    "whole",
]


class ClvolError(Exception):
    """Base of every error raised by clvol."""


class OptionError(ClvolError, ValueError):
    """An option or argument lies outside what is allowed."""


class DataError(ClvolError, ValueError):
    """The samples cannot be used: wrong rank or dtype, empty, NaN or infinite."""


class GeometryError(ClvolError, ValueError):
    """Spacing, direction, origin, camera or box describe no valid geometry."""


class FormatError(ClvolError, OSError):
    """A file is of no known format, damaged, or cannot hold what is to be written."""


class MissingDependencyError(ClvolError, ImportError):
    """An optional package is needed; the message says which extra brings it."""


class DeviceError(ClvolError, RuntimeError):
    """No usable OpenCL device, or the device failed; the message says what to install."""


class OutOfMemoryError(DeviceError, MemoryError):
    """The device, or the machine, cannot hold what was asked for."""


def one_of(what: str, value: object, allowed: Iterable[str]) -> OptionError:
    """The error for an unknown name: the rule, what is allowed, and what came."""
    return OptionError(f"{what} must be one of {', '.join(allowed)}; got {value!r}")


def number(
    what: str,
    value: object,
    *,
    above: float | None = None,
    least: float | None = None,
    below: float | None = None,
    most: float | None = None,
) -> float:
    """`value` as a float, if it is one finite real number within the bounds; else `OptionError`.

    Python's and NumPy's real scalars are taken, and arrays without axes; truth values and texts are not.
    """
    scalar = _scalar(value)
    try:
        result = float(scalar) if isinstance(scalar, Real) else math.nan
    except OverflowError:  # a whole number or fraction beyond float64
        result = math.inf
    bounds = {"greater than": above, "at least": least, "less than": below, "at most": most}
    within = (
        math.isfinite(result)
        and (above is None or result > above)
        and (least is None or result >= least)
        and (below is None or result < below)
        and (most is None or result <= most)
    )
    if not within:
        raise OptionError(f"{what} must be a finite number{_allowed(bounds)}; got {value!r}")
    return result


def whole(what: str, value: object, least: int | None = None, most: int | None = None) -> int:
    """`value` as an int, if it is one whole number within the bounds; else `OptionError`.

    Python's and NumPy's integers are taken, and arrays of them without axes; truth values and floats are not.
    """
    scalar = _scalar(value)
    result = int(scalar) if isinstance(scalar, Integral) else None
    if result is None or (least is not None and result < least) or (most is not None and result > most):
        bounds = {"at least": least, "at most": most}
        raise OptionError(f"{what} must be a whole number{_allowed(bounds)}; got {value!r}")
    return result


def _scalar(value: object) -> object:
    """`value`, or the one element of an array without axes; None for truth values."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    return None if isinstance(value, bool) else value  # numpy.bool is no number to the numbers module


def _allowed(bounds: dict[str, float | None]) -> str:
    texts = [f"{rule} {bound:g}" for rule, bound in bounds.items() if bound is not None]
    return ", " + " and ".join(texts) if texts else ""
