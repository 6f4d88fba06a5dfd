"""Kernel sources: splicing, line numbers, what the compiler says, and what the sources may not hold."""

from __future__ import annotations

import re
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clvol import program
from clvol.device import Device
from clvol.errors import DeviceError
from clvol.filter import as_filter, filters
from clvol.march.frame import frame_block
from clvol.mode import modes
from clvol.spline import build

KERNELS = [
    "march/draw.cl",
    "march/split.cl",
    "spline/points.cl",
    "spline/sort.cl",
    "spline/prefilter.cl",
    "spline/coefficients.cl",
    "spline/minmax.cl",
    "spline/resample.cl",
]
FOLDER = program.folder()
EVERY = sorted(str(p.relative_to(FOLDER)) for p in FOLDER.rglob("*.cl"))
GENERATED = {"frame.cl": frame_block(modes()["mip"].BLOCK)[1]}


def spliced(name: str) -> str:
    return program.source(name, {"mode.cl": "modes/mip.cl"}, GENERATED)


def numbered(text: str) -> list[tuple[str, int, str]]:
    """Each line with the file and number that a compiler would give it."""
    result, file, line = [], "", 1
    for content in text.splitlines():
        if match := re.fullmatch(r'#line (\d+) "(.+)"', content):
            line, file = int(match[1]), match[2]
        else:
            result.append((file, line, content))
            line += 1
    return result


def without_comments(text: str) -> str:
    return re.sub(r"//[^\n]*|/\*.*?\*/", "", text, flags=re.DOTALL)


@pytest.mark.parametrize("name", KERNELS)
def test_every_line_keeps_its_file_and_number(name: str) -> None:
    lines = numbered(spliced(name))
    assert len(lines) > 15
    files = {file for file, _, _ in lines}
    assert {name, "base/platform.cl"} <= files
    texts = {f: (GENERATED.get(f) or (FOLDER / f).read_text(encoding="utf-8")).splitlines() for f in files}
    for file, line, content in lines:
        if content:
            original = texts[file][line - 1]
            assert content == original or (original.startswith("#include") and not content)
    # and nothing is lost
    for file, text in texts.items():
        wanted = [line for line in text if line.strip() and not line.startswith("#include")]
        assert [content for f, _, content in lines if f == file and content.strip()] == wanted


@pytest.mark.parametrize("name", KERNELS)
def test_includes_are_spliced_once(name: str) -> None:
    text = spliced(name)
    assert "#include" not in text
    starts = re.findall(r'#line 1 "(.+)"', text)
    assert len(starts) == len(set(starts))


def test_an_include_seen_before_leaves_no_gap() -> None:
    made = {"a.cl": '#include "b.cl"\nint one;\n#include "b.cl"\n\nint four;\n', "b.cl": "int b;\n"}
    lines = numbered(program.source("a.cl", generated=made))
    assert [line for line in lines if line[2]] == [("b.cl", 1, "int b;"), ("a.cl", 2, "int one;"), ("a.cl", 5, "int four;")]


def test_a_mode_takes_its_place() -> None:
    for mode in modes().values():
        text = program.source("march/draw.cl", {"mode.cl": mode.file}, GENERATED)
        assert f'#line 1 "{mode.file}"' in text
        assert all(other.file == mode.file or f'"{other.file}"' not in text for other in modes().values())


def test_a_build_error_names_file_and_line(device: Device) -> None:
    spoilt = "kernel void spoilt(global int *a) { a[0] = nonsense; }\n"
    broken = 'kernel void fine(global int *a) { a[0] = 1; }\n\n#include "base/platform.cl"\n\n' + spoilt
    with pytest.raises(DeviceError, match="nonsense") as raised:
        device.build("broken.cl", {"COORD_DOUBLE": 0}, generated={"broken.cl": broken})
    if device.is_pocl:
        assert re.search(r"broken\.cl:5:\d+", str(raised.value))
    # the device goes on working
    device.build("whole.cl", {"COORD_DOUBLE": 0}, generated={"whole.cl": broken.replace("nonsense", "2")}).kernel("spoilt")


@pytest.mark.parametrize("name", EVERY)
def test_no_kernel_uses_what_a_runtime_cannot_compile(name: str) -> None:
    text = without_comments((FOLDER / name).read_text(encoding="utf-8"))
    assert "16" not in re.findall(r"\b(?:float|double|int|uint|vload|vstore)(\d+)\b", text)  # PoCL 3.0 aborts on float16
    for before in text.split("#define LANES 16")[:-1]:
        assert "__AVX512F__" in before.splitlines()[-2]
    assert not re.search(r"\bfma\s*\(", text)
    assert "printf" not in text


@pytest.mark.parametrize("name", EVERY)
def test_sources_are_tidy(name: str) -> None:
    text = (FOLDER / name).read_text(encoding="utf-8")
    assert text.startswith("//")  # what the file is for
    assert text.endswith("\n")
    assert "\t" not in text
    assert "\r" not in text
    assert all(line == line.rstrip() for line in text.splitlines())


def test_vectors_are_no_wider_than_eight() -> None:
    for row in filters().values():
        width = build.row_width(row)
        assert width in (1, 2, 4, 8)
        assert row.support <= build.row_reach(row) < row.support + width


@pytest.mark.parametrize("name", filters())
def test_defines_hold_the_filter_as_float32(name: str) -> None:
    row = as_filter(name)
    defines = build.filter_defines(row)
    numbers = np.array([np.float32(v) for v in re.findall(r"(-?\d[\d.]*(?:e[+-]?\d+)?)f", str(defines["FILTER_COLUMNS"]))])
    numbers = numbers.reshape(row.degree + 1, build.row_reach(row))
    np.testing.assert_array_equal(numbers[:, : row.support], row.matrix.T.astype(np.float32))
    assert not numbers[:, row.support :].any()
    assert defines["LEFT"] == row.support / 2 - 1


def test_programs_are_built_once_and_kernels_belong_to_threads(device: Device) -> None:
    made = {"once.cl": "kernel void once(global int *a) { a[0] = 1; }\n"}
    first = device.build("once.cl", {"A": 1}, generated=made)
    assert device.build("once.cl", {"A": 1}, generated=made) is first
    assert device.build("once.cl", {"A": 2}, generated=made) is not first
    kernels: list[Any] = [first.kernel("once")]
    thread = threading.Thread(target=lambda: kernels.append(first.kernel("once")))
    thread.start()
    thread.join()
    assert kernels[0] is first.kernel("once")
    assert kernels[0] is not kernels[1]
    with pytest.raises(DeviceError):
        first.kernel("twice")


def test_floating_literals() -> None:
    assert [program.literal(v) for v in (1.0, 0.5, -2.0)] == ["1.0f", "0.5f", "-2.0f"]
    assert [program.literal(v) for v in (1e-9, 1e30)] == ["9.99999972e-10f", "1.00000002e+30f"]


def test_the_kernels_are_found() -> None:
    assert Path(FOLDER / "march/draw.cl").is_file()
