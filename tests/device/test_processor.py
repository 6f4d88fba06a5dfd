"""Processors unknown to PoCL's compiler, on a record like PoCL's."""

from __future__ import annotations

import ctypes
import platform
import sys

import pytest

from clvol.device.runtimes import processor

pytestmark = pytest.mark.skipif(
    not sys.platform.startswith("linux") or platform.machine() != "x86_64", reason="PoCL names processors elsewhere"
)


def record(*texts: bytes) -> tuple[ctypes.Array[ctypes.c_char_p], int]:
    """Pointers to strings among words that are not pointers, the length to search, and its start."""
    made = (ctypes.c_char_p * 512)()
    for i, text in enumerate(texts):
        made[80 + i] = text
    address = ctypes.addressof(made)
    ctypes.c_uint64.from_address(address).value = 12345
    return made, address


def test_an_unknown_processor_gets_the_name_of_a_compatible_one() -> None:
    made, address = record(b"x86_64-unknown-linux-gnu", b"generic")
    name = processor.name_processor(address)
    assert name in ("x86-64", "core2", "penryn", "sandybridge", "ivybridge", "bdver1", "haswell", "skylake-avx512")
    assert made[81] == name.encode()
    assert processor.name_processor(address) is None  # it has a name now


@pytest.mark.parametrize(
    "texts", [(b"x86_64-unknown-linux-gnu", b"znver3"), (b"aarch64-unknown-linux-gnu", b"generic"), (b"generic",), ()], ids=repr
)
def test_other_records_are_unchanged(texts: tuple[bytes, ...]) -> None:
    made, address = record(*texts)
    before = bytes(made)
    assert processor.name_processor(address) is None
    assert bytes(made) == before


def test_flags_choose_the_best_supported_name(monkeypatch: pytest.MonkeyPatch) -> None:
    def of(flags: str) -> bytes | None:
        monkeypatch.setattr("pathlib.Path.read_text", lambda *_, **__: f"processor: 0\nflags\t\t: {flags}\n")
        return processor._like_this()

    assert of("sse2") == b"x86-64"
    assert of("sse2 ssse3 sse4_1 cx16 popcnt avx f16c") == b"ivybridge"
    assert of("sse2 cx16 popcnt avx avx2 abm f16c fma bmi1 bmi2") == b"haswell"
    assert of("sse2 avx2 fma bmi2 avx512f avx512cd avx512bw avx512dq avx512vl") == b"skylake-avx512"
    assert of("fpu") is None
