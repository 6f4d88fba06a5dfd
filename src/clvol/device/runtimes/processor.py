"""Processors newer than PoCL's compiler, which does not know their names.

LLVM calls them "generic", a name that its x86-64 compiler then refuses: no kernel builds, for instance on Zen 5 with PoCL 3.0,
which ``clvol[pocl]`` installs (https://github.com/pocl/pocl/issues/1049). No option or environment variable of that PoCL changes
the name (``POCL_LLVM_CPU_NAME`` came later), but its device record does: this writes the name of a processor with a subset of the
features into it. Where anything differs from the record of PoCL 3.0, nothing is written; nor over any name but "generic".

Imports nothing of clvol, so that `clvol.device.probe` can run it in another process.
"""

from __future__ import annotations

import ctypes
import platform
import re
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

__all__ = ["name_processor"]

# Processors for which PoCL has a kernel library, the best last, and the flags of /proc/cpuinfo that each needs: all that LLVM
# emits instructions of without being asked.
_HASWELL = {"avx", "avx2", "cx16", "popcnt", "abm", "f16c", "fma", "bmi1", "bmi2", "movbe"}
_AVX512 = {"avx512f", "avx512cd", "avx512bw", "avx512dq", "avx512vl"}
_KNOWN = (
    (b"x86-64", {"sse2"}),
    (b"core2", {"sse2", "ssse3", "cx16"}),
    (b"penryn", {"sse2", "sse4_1", "cx16"}),
    (b"sandybridge", {"sse2", "avx", "cx16", "popcnt"}),
    (b"ivybridge", {"sse2", "avx", "cx16", "popcnt", "f16c"}),
    (b"bdver1", {"sse2", "avx", "cx16", "popcnt", "xop", "fma4", "abm"}),
    (b"haswell", _HASWELL),
    (b"skylake-avx512", _HASWELL | _AVX512),
)
_VERSION = re.compile(r"OpenCL 3\.0 PoCL 3\.0[- ].*\bDISTRO\b.*")  # built with the kernel libraries of all these processors
_TRIPLE = re.compile(rb"x86_64-\w+-linux-\w+")  # what it compiles for, whoever built it
_GENERIC = b"generic"
# The record: bytes that are searched, where the triple is, before the name, and where the texts that OpenCL reports too.
_RECORD, _AT = 2048, 632
_LANDMARKS = (("name", 552), ("vendor", 560), ("driver_version", 568), ("profile", 576))
_WORD = ctypes.sizeof(ctypes.c_void_p)
_LONGEST = 256  # bytes of a text
_NAMES = {name: ctypes.create_string_buffer(name) for name, _ in _KNOWN}  # kept alive: PoCL keeps their addresses


def name_processor(device: Any) -> str:
    """Name a processor that PoCL 3.0 calls "generic", given its ``pyopencl.Device``, and say what it compiles for.

    Returns "" for other runtimes, of which nothing is read.
    """
    if not (
        sys.platform.startswith("linux") and platform.machine() == "x86_64" and _VERSION.fullmatch(device.platform.version.strip())
    ):
        return ""
    readable, address = _readable(), device.int_ptr
    texts = {at: _pointed(readable, address + at) for at in range(0, _RECORD, _WORD)}
    known = all(texts[at] == getattr(device, what).encode() for what, at in _LANDMARKS)
    if not known or [at for at, text in texts.items() if _TRIPLE.fullmatch(text)] != [_AT]:
        return "for which processor is unknown: its record is not that of PoCL 3.0, and was left as it is"
    name, flags = texts[_AT + _WORD], _flags()
    if name == _GENERIC:
        best = next((best for best, needed in reversed(_KNOWN) if needed <= flags), None)
        if best is None:
            return "for no processor: PoCL 3.0 does not know this one, and no name that it knows fits"
        ctypes.c_uint64.from_address(address + _AT + _WORD).value = ctypes.addressof(_NAMES[best])
        return f"for {best.decode()}: PoCL 3.0 does not know this processor, and clvol named it in PoCL's device record"
    text = f"for {name.decode(errors='replace')}"
    if name.startswith(b"znver") and flags >= _AVX512:  # LLVM 14 takes Zen 4 for Zen 3
        text += ", without AVX-512, which this processor has: PoCL 6 and newer use it"
    return text


def _flags() -> set[str]:
    """The flags of the processor; none if they cannot be read."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("flags"):
                return set(line.partition(":")[2].split())
    return set()


def _readable() -> list[tuple[int, int]]:
    """The addresses of this process that can be read; none if that cannot be read."""
    found = []
    with suppress(OSError):
        for line in Path("/proc/self/maps").read_text(encoding="utf-8").splitlines():
            span, rights = line.split(maxsplit=2)[:2]
            if "r" in rights:
                low, _, high = span.partition("-")
                found.append((int(low, 16), int(high, 16)))
    return found


def _pointed(readable: list[tuple[int, int]], place: int) -> bytes:
    """The text that a word points to; none if either cannot be read."""
    if _left(readable, place) < _WORD:
        return b""
    start = ctypes.c_uint64.from_address(place).value
    return ctypes.string_at(start, min(_left(readable, start), _LONGEST)).partition(b"\0")[0]


def _left(readable: list[tuple[int, int]], place: int) -> int:
    """How many bytes can be read from an address on."""
    return next((high - place for low, high in readable if low <= place < high), 0)
