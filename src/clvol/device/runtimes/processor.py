"""Processors that PoCL's compiler does not know by name, because they are newer than it.

LLVM calls them "generic", and its compiler then refuses that name for x86-64: no kernel builds on such a processor, Zen 5 for
PoCL 3.0 (https://github.com/pocl/pocl/issues/1049). No option or environment variable of PoCL says otherwise; its record of the
device does. This writes the name there of a processor that can do no more than this one.

Imports nothing of clvol, so that the probe of `clvol.device` can run it in a process of its own.
"""

from __future__ import annotations

import ctypes
import platform
import sys
from pathlib import Path

__all__ = ["name_processor"]

# What PoCL builds its own library for, the best last, and what of /proc/cpuinfo it takes to be that.
_KNOWN = (
    (b"x86-64", {"sse2"}),
    (b"core2", {"sse2", "ssse3", "cx16"}),
    (b"penryn", {"sse2", "sse4_1", "cx16"}),
    (b"sandybridge", {"sse2", "avx", "cx16", "popcnt"}),
    (b"ivybridge", {"sse2", "avx", "cx16", "popcnt", "f16c"}),
    (b"bdver1", {"sse2", "avx", "cx16", "popcnt", "xop", "fma4"}),
    (b"haswell", {"avx", "avx2", "cx16", "popcnt", "abm", "f16c", "fma", "bmi1", "bmi2"}),
    (b"skylake-avx512", {"avx512f", "avx512cd", "avx512bw", "avx512dq", "avx512vl", "bmi2", "fma"}),
)
_RECORD = 2048  # bytes of PoCL's record that are searched
_NAMES = {name: ctypes.create_string_buffer(name) for name, _ in _KNOWN}  # PoCL keeps their addresses


def name_processor(address: int) -> str | None:
    """Give PoCL the name of a processor like this one, if it has none.

    Parameters
    ----------
    address : int
        Of PoCL's record of a device, ``pyopencl.Device.int_ptr``.

    Returns
    -------
    str or None
        The name; None if PoCL has one already, or none is known here.
    """
    if not sys.platform.startswith("linux") or platform.machine() not in ("x86_64", "AMD64"):
        return None
    readable = _readable()
    before = b""
    for place in range(address, address + _RECORD, ctypes.sizeof(ctypes.c_void_p)):
        if not _lies_in(readable, place):
            return None
        text = _text(readable, ctypes.c_uint64.from_address(place).value)
        if text == b"generic\0" and before == b"x86_64-u":  # it follows the name of the platform
            name = _like_this()
            if name is not None:
                ctypes.c_uint64.from_address(place).value = ctypes.addressof(_NAMES[name])
            return name.decode() if name else None
        before = text
    return None


def _like_this() -> bytes | None:
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
        if line.startswith("flags"):
            flags = set(line.partition(":")[2].split())
            return next((name for name, needed in reversed(_KNOWN) if needed <= flags), None)
    return None


def _readable() -> list[tuple[int, int]]:
    found = []
    for line in Path("/proc/self/maps").read_text(encoding="utf-8").splitlines():
        span, rights = line.split(maxsplit=2)[:2]
        if "r" in rights:
            low, _, high = span.partition("-")
            found.append((int(low, 16), int(high, 16)))
    return found


def _lies_in(readable: list[tuple[int, int]], place: int) -> bool:
    return any(low <= place and place + 8 <= high for low, high in readable)


def _text(readable: list[tuple[int, int]], place: int) -> bytes:
    """The first eight bytes there, or none where nothing may be read."""
    return ctypes.string_at(place, 8) if _lies_in(readable, place) else b""
