"""Processors newer than PoCL's compiler, which does not know their names.

LLVM calls them "generic", a name that its x86-64 compiler then refuses: no kernel builds, for instance on Zen 5 with PoCL 3.0,
which ``clvol[pocl]`` installs (https://github.com/pocl/pocl/issues/1049). No option or environment variable of PoCL changes the
name, but its device record does: this writes the name of a processor with a subset of the features into it.

Imports nothing of clvol, so that `clvol.device.probe` can run it in another process.
"""

from __future__ import annotations

import ctypes
import platform
import sys
from pathlib import Path

__all__ = ["name_processor"]

# Processors for which PoCL has a kernel library, the best last, and the flags of /proc/cpuinfo that each needs.
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
_RECORD = 2048  # bytes of the record that are searched
_NAMES = {name: ctypes.create_string_buffer(name) for name, _ in _KNOWN}  # kept alive: PoCL keeps their addresses


def name_processor(address: int) -> str | None:
    """Name a processor that PoCL calls "generic", given the address of its device record (``pyopencl.Device.int_ptr``).

    Returns the name; None if PoCL has one already, or none fits.
    """
    if not sys.platform.startswith("linux") or platform.machine() not in ("x86_64", "AMD64"):
        return None
    readable = _readable()
    before = b""
    for place in range(address, address + _RECORD, ctypes.sizeof(ctypes.c_void_p)):
        if not _lies_in(readable, place):
            return None
        text = _text(readable, ctypes.c_uint64.from_address(place).value)
        if text == b"generic\0" and before == b"x86_64-u":  # it follows the target triple
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
    """The first eight bytes at an address; none if it cannot be read."""
    return ctypes.string_at(place, 8) if _lies_in(readable, place) else b""
