"""Processors unknown to PoCL's compiler, on a record like PoCL's."""

from __future__ import annotations

import ctypes
import platform
import sys
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from clvol.device import Device
from clvol.device.runtimes import processor

pytestmark = pytest.mark.skipif(
    not sys.platform.startswith("linux") or platform.machine() != "x86_64", reason="PoCL names processors elsewhere"
)

VERSION = "OpenCL 3.0 PoCL 3.0-rc2  Linux, Release, RELOC, LLVM 14.0.6, SLEEF, DISTRO, POCL_DEBUG"
TRIPLES = ("x86_64-unknown-linux-gnu", "x86_64-pc-linux-gnu", "x86_64-redhat-linux-gnu", "x86_64-alpine-linux-musl")
HASWELL = "sse2 cx16 popcnt avx avx2 abm f16c fma bmi1 bmi2 movbe"
AVX512 = "avx512f avx512cd avx512bw avx512dq avx512vl"


@dataclass
class Record:
    """A device like PoCL's, whose record is ours."""

    texts: dict[int, bytes]
    version: str = VERSION
    name: str = "pthread-A processor"
    vendor: str = "AuthenticAMD"
    driver_version: str = "3.0-rc2"
    profile: str = "FULL_PROFILE"
    words: Any = field(default_factory=lambda: (ctypes.c_char_p * 256)())

    def __post_init__(self) -> None:
        landmarks = {552: self.name, 560: self.vendor, 568: self.driver_version, 576: self.profile}
        for at, text in ({at: text.encode() for at, text in landmarks.items()} | self.texts).items():
            self.words[at // 8] = text
        ctypes.c_uint64.from_address(self.int_ptr).value = 12345  # no pointer

    @property
    def int_ptr(self) -> int:
        return ctypes.addressof(self.words)

    @property
    def platform(self) -> SimpleNamespace:
        return SimpleNamespace(version=self.version)


def flags(monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    """Pretend that the processor has these flags."""
    read = Path.read_text

    def instead(path: Path, **options: Any) -> str:
        return f"processor: 0\nflags\t\t: {text}\n" if path == Path("/proc/cpuinfo") else read(path, **options)

    monkeypatch.setattr(Path, "read_text", instead)


@pytest.mark.parametrize("triple", TRIPLES)
def test_an_unknown_processor_gets_the_name_of_a_compatible_one(monkeypatch: pytest.MonkeyPatch, triple: str) -> None:
    flags(monkeypatch, HASWELL)
    made = Record({632: triple.encode(), 640: b"generic"})
    said = processor.name_processor(made)
    assert said.startswith("for haswell: PoCL 3.0 does not know this processor, and clvol named it")
    assert made.words[80] == b"haswell"
    assert processor.name_processor(made) == "for haswell"  # it has a name now


TRIPLE = TRIPLES[0].encode()


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (Record({632: TRIPLE, 640: b"znver3"}), "for znver3"),
        (Record({632: TRIPLE, 640: b"generic"}, version=VERSION.replace("3.0-rc2", "3.1")), ""),
        (Record({632: TRIPLE, 640: b"generic"}, version=VERSION.replace("3.0-rc2", "6.0")), ""),
        (Record({632: TRIPLE, 640: b"generic"}, version=VERSION.replace("DISTRO, ", "")), ""),
        (Record({632: b"aarch64-unknown-linux-gnu", 640: b"generic"}), "unknown"),
        (Record({640: TRIPLE, 648: b"generic"}), "unknown"),
        (Record({632: TRIPLE, 640: b"generic", 800: TRIPLE}), "unknown"),
        (Record({632: TRIPLE, 640: b"generic", 568: b"3.1"}), "unknown"),
        (Record({632: TRIPLE}), "for "),
    ],
    ids=["has a name", "3.1", "6.0", "other libraries", "ARM", "elsewhere", "two triples", "another text", "no name"],
)
def test_other_records_are_unchanged(monkeypatch: pytest.MonkeyPatch, made: Record, said: str) -> None:
    flags(monkeypatch, HASWELL)
    before = bytes(made.words)
    assert said in processor.name_processor(made)
    assert bool(said) == bool(processor.name_processor(made))
    assert bytes(made.words) == before


@pytest.mark.parametrize(
    ("has", "name"),
    [
        ("sse2", "x86-64"),
        ("sse2 ssse3 sse4_1 cx16 popcnt avx f16c", "ivybridge"),
        (HASWELL, "haswell"),
        (HASWELL.replace("movbe", AVX512), "ivybridge"),
        (f"{HASWELL} {AVX512}", "skylake-avx512"),
        ("fpu", "no processor"),
    ],
)
def test_flags_choose_the_best_supported_name(monkeypatch: pytest.MonkeyPatch, has: str, name: str) -> None:
    flags(monkeypatch, has)
    assert processor.name_processor(Record({632: TRIPLE, 640: b"generic"})).startswith(f"for {name}: ")


def test_registers_that_stay_unused_are_mentioned(monkeypatch: pytest.MonkeyPatch) -> None:
    flags(monkeypatch, f"{HASWELL} {AVX512}")
    assert "without AVX-512" in processor.name_processor(Record({632: TRIPLE, 640: b"znver3"}))
    assert processor.name_processor(Record({632: TRIPLE, 640: b"sapphirerapids"})) == "for sapphirerapids"


def test_the_layout_is_that_of_this_machine(device: Device) -> None:
    if "PoCL 3.0" not in device.handle.platform.version or device.kind != "cpu":
        pytest.skip("another runtime")
    assert device.compiled_for.startswith("for ")
    assert "unknown" not in device.compiled_for
