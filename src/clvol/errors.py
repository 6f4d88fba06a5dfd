"""Every error that clvol raises on purpose: one base, one subclass per cause.

Each subclass is also the standard exception that a caller would expect, so both
``except clvol.ClvolError`` and ``except ValueError`` catch a bad argument.
"""

from __future__ import annotations

from clvol.moved import forwarding

__all__ = [
    "ClvolError",
    "DataError",
    "DeviceError",
    "FormatError",
    "GeometryError",
    "MissingDependencyError",
    "OptionError",
    "OutOfMemoryError",
]


class ClvolError(Exception):
    """Base of every error raised by clvol."""


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


_CHECKS = ("as_path", "enough_memory", "number", "one_of", "reals", "require_room", "several", "whole")
__getattr__ = forwarding(__name__, dict.fromkeys(_CHECKS, "clvol.checks"))
