"""Every error that clvol raises on purpose: one base, one subclass per cause.

Each subclass is also the standard exception that a caller would expect, so both
``except clvol.ClvolError`` and ``except ValueError`` catch a bad argument.
"""

from __future__ import annotations

import numpy as np

__all__ = [
    "AxisError",
    "ClusterError",
    "ClvolError",
    "ClvolWarning",
    "DataError",
    "DeviceError",
    "DtypeError",
    "FormatError",
    "GeometryError",
    "MissingDependencyError",
    "NotFiniteError",
    "OptionError",
    "OptionTypeError",
    "OutOfMemoryError",
    "RefusedError",
    "UnsupportedError",
]


class ClvolError(Exception):
    """Base of every error raised by clvol."""


class ClvolWarning(UserWarning):
    """Something was chosen that the caller may want otherwise; the message says what, and how to choose."""


class OptionError(ClvolError, ValueError):
    """An option or argument lies outside what is allowed."""


class DataError(ClvolError, ValueError):
    """The samples cannot be used: wrong rank or dtype, empty, NaN or infinite."""


class GeometryError(ClvolError, ValueError):
    """Spacing, direction, origin, camera or box do not describe a valid geometry."""


class FormatError(ClvolError, OSError):
    """A file is of no known format, damaged, or cannot hold what is to be written."""


class MissingDependencyError(ClvolError, ImportError):
    """An optional package is needed; the message says which extra brings it."""


class DeviceError(ClvolError, RuntimeError):
    """No usable OpenCL device, or the device failed; the message says what to install."""


class OutOfMemoryError(DeviceError, MemoryError):
    """The device, or the machine, cannot hold what was requested."""


class ClusterError(ClvolError, ConnectionError):
    """A scheduler or its workers cannot be reached, are gone, or are of another version; or work ends every worker."""


# What `clvol.ndimage` raises is also the exception that SciPy raises for the same.


class RefusedError(OptionError, RuntimeError):
    """An argument that SciPy refuses with a `RuntimeError`: an order, a mode, a shape, a length."""


class OptionTypeError(OptionError, TypeError):
    """An argument of the wrong type."""


class NotFiniteError(OptionError, OverflowError):
    """A number that must be finite is not, or is too large for float64."""


class AxisError(OptionError, np.exceptions.AxisError):
    """The array has no such axis."""


class DtypeError(DataError, RuntimeError, TypeError):
    """The samples are of a type that is not computed with: objects, strings, dates, numbers of more than 64 bits."""


class UnsupportedError(OptionError, NotImplementedError):
    """SciPy computes this, clvol does not."""
