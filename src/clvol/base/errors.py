"""Every error that clvol raises on purpose: one base, one subclass per cause.

Each subclass is also the standard exception that a caller would expect, so both
``except clvol.ClvolError`` and ``except ValueError`` catch a bad argument.
"""

from __future__ import annotations

import numpy as np

__all__ = [
    "AxisError",
    "ChunkError",
    "ClusterError",
    "ClvolError",
    "ClvolWarning",
    "DataError",
    "DeviceError",
    "DtypeError",
    "FormatError",
    "GeometryError",
    "MissingDependencyError",
    "MissingSampleError",
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
    """clvol made a choice for the caller; the message says which, and how to choose otherwise."""


class OptionError(ClvolError, ValueError):
    """An option or argument is not allowed."""


class DataError(ClvolError, ValueError):
    """The samples cannot be used: wrong rank or dtype, empty, NaN or infinite."""


class MissingSampleError(DataError):
    """A sample is NaN or infinite where all must be there; pictures leave such samples out."""


class GeometryError(ClvolError, ValueError):
    """Spacing, direction, origin, camera or box do not describe a valid geometry."""


class FormatError(ClvolError, OSError):
    """A file has an unknown format, is damaged, or cannot hold the data to write."""


class ChunkError(FormatError):
    """A chunk of a stored array is damaged; others can be read."""


class MissingDependencyError(ClvolError, ImportError):
    """An optional package is needed; the message names the extra that installs it."""


class DeviceError(ClvolError, RuntimeError):
    """No usable OpenCL device, or the device failed; the message says what to install."""


class OutOfMemoryError(DeviceError, MemoryError):
    """The request does not fit into the memory of the device or the machine."""


class ClusterError(ClvolError, ConnectionError):
    """A scheduler or its workers are unreachable, gone, or run another version; or a task kills every worker."""


# Each error of `clvol.ndimage` is also the exception that SciPy raises in the same case.


class RefusedError(OptionError, RuntimeError):
    """An argument for which SciPy raises `RuntimeError`: an order, a mode, a shape, a length."""


class OptionTypeError(OptionError, TypeError):
    """An argument of the wrong type."""


class NotFiniteError(OptionError, OverflowError):
    """A number that must be finite is not, or is too large for float64."""


class AxisError(OptionError, np.exceptions.AxisError):
    """The array has no such axis."""


class DtypeError(DataError, RuntimeError, TypeError):
    """The sample type is not supported: objects, strings, dates, numbers of more than 64 bits."""


class UnsupportedError(OptionError, NotImplementedError):
    """SciPy supports this, clvol does not."""
