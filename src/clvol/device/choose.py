"""Choosing a device: all that there are, the preferred one first, and the one that a user names."""

from __future__ import annotations

import contextlib
import copyreg
import os
import threading
import warnings
from functools import lru_cache
from typing import Any

from clvol.base.checks import one_of
from clvol.base.errors import ClvolWarning, DeviceError, OptionError
from clvol.device import cache
from clvol.device.device import Device
from clvol.device.driver import require_unforked
from clvol.device.opencl import INSTALL, kept_out, opencl

__all__ = ["as_device", "devices"]

_KINDS = ("gpu", "cpu", "accelerator")  # in order of preference
_lock = threading.Lock()
_devices: dict[int, Device] = {}
_process: int | None = None  # that first queried OpenCL for its devices


def devices() -> list[Device]:
    """Every OpenCL device found, the default one first: GPUs, then the processor.

    Of several runtimes for the processor PoCL comes first, which is the fastest. Mesa's llvmpipe comes after
    all others, and unusable devices come last.

    Examples
    --------
    >>> import clvol
    >>> default = clvol.devices()[0]
    >>> picture = clvol.render(clvol.phantoms.sphere(24), mode="mip", size=(48, 48), device=default)
    """
    global _process
    require_unforked(_process)
    cl = opencl()
    _process = os.getpid()
    try:
        platforms = cl.get_platforms()
    except cl.Error:  # the loader reports an error if it finds no platform
        platforms = []
    found: list[Device] = []
    for platform in platforms:
        try:
            handles = platform.get_devices()
        except cl.Error:
            continue
        for handle in handles:
            if handle.available and handle.compiler_available:
                with _lock:
                    found.append(_devices.setdefault(handle.int_ptr, Device(handle)))

    def rank(device: Device) -> tuple[bool, bool, int, bool]:
        return len(found) > 1 and bool(device.fault), device.is_llvmpipe, _KINDS.index(device.kind), not device.is_pocl

    return sorted(found, key=rank)


def as_device(choice: Device | str | int | None = None) -> Device:
    """The device to compute on.

    Parameters
    ----------
    choice : Device, str, int or None
        A device; its number in ``clvol devices``; "cpu" or "gpu"; or a part of its name or its
        platform's. None takes the environment variable ``CLVOL_DEVICE``, else the first.

    Raises
    ------
    DeviceError
        No OpenCL platform or device, or it cannot be used; the message says what to install.
    OptionError
        No device matches.
    """
    if isinstance(choice, Device):
        return choice
    default = False
    if choice is None:
        choice = os.environ.get("CLVOL_DEVICE") or 0
        default = choice == 0
    found = devices()
    if not found:
        faults = "".join(f"; {library} is left out, a trial of it {why}" for library, why in kept_out().items())
        raise DeviceError(f"no OpenCL device was found{faults}. {INSTALL}. 'clvol doctor' says more")
    if default:
        _warn_of_change(found)
    text = str(choice).strip().lower()
    if text.isdecimal() and len(text) < 10:  # "²" is a digit, but no number
        if int(text) < len(found):
            return found[int(text)]
    else:
        for device in found:
            if text == device.kind or (text not in _KINDS and text in f"{device.platform} {device.name}".lower()):
                return device
    names = [f"{i} ({d.kind}: {d.name}, {d.platform})" for i, d in enumerate(found)]
    if text in _KINDS:
        raise OptionError(f"device {choice!r} needs a device of that kind with an OpenCL driver; found are {', '.join(names)}")
    raise one_of("device", choice, ["'cpu', 'gpu', or a part of a name", *names])


def _reduced(device: Device) -> tuple[Any, ...]:
    """Pickle a device by its name, and by its number among those of the same name."""
    alike = [other for other in devices() if repr(other) == repr(device)]
    return _unpickled, (device.platform, device.name, alike.index(device) if device in alike else 0)


def _unpickled(platform: str, name: str, number: int) -> Device:
    """A device pickled in another process; `OptionError` if there is none of that name."""
    alike = [device for device in devices() if (device.platform, device.name) == (platform, name)]
    return alike[min(number, len(alike) - 1)] if alike else as_device(f"{platform} {name}")


copyreg.pickle(Device, _reduced)


@lru_cache(maxsize=1)
def _last_default() -> str:
    """The default device when it was last used, in any process; "" if unknown."""
    folder = cache.folder()
    with contextlib.suppress(OSError, UnicodeDecodeError):
        return (folder / "default-device").read_text(encoding="utf-8") if folder else ""
    return ""


def _warn_of_change(found: list[Device]) -> None:
    """Warn if the default device differs from that of the process before, as after a platform was installed; note it."""
    names = [f"{device.name} ({device.platform})" for device in found]
    last = _last_default()
    if names[0] == last:
        return
    if last:
        rest = "gone"
        if last in names:
            number = names.index(last)
            rest = f"number {number} now; CLVOL_DEVICE={found[number].name!r} chooses it"
        message = f"devices are renumbered, and the default is {names[0]}: {last}, the default before, is {rest}"
        warnings.warn(message, ClvolWarning, stacklevel=3)
    folder = cache.folder()
    if folder:
        with contextlib.suppress(OSError):
            cache.replace(folder / "default-device", names[0].encode())
    _last_default.cache_clear()
