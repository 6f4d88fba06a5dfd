"""Kernel sources: includes, line numbers, compiler messages, and constructs that are not allowed."""

from __future__ import annotations

import gc
import os
import re
import signal
import subprocess
import sys
import threading
import time
import weakref
from collections import OrderedDict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clvol
from clvol.base.errors import DeviceError
from clvol.device import Device, launches, program
from clvol.device.opencl import kernel_cache
from clvol.filter.table import as_filter, filters
from clvol.march.frame import frame_block
from clvol.scene.mode import modes
from clvol.spline import build

KERNELS = [
    "march/bricks.cl",
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
    """Each line with the file and number that a compiler would report."""
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
def test_includes_are_inserted_once(name: str) -> None:
    text = spliced(name)
    assert "#include" not in text
    starts = re.findall(r'#line 1 "(.+)"', text)
    assert len(starts) == len(set(starts))


def test_a_repeated_include_leaves_no_gap() -> None:
    made = {"a.cl": '#include "b.cl"\nint one;\n#include "b.cl"\n\nint four;\n', "b.cl": "int b;\n"}
    lines = numbered(program.source("a.cl", generated=made))
    assert [line for line in lines if line[2]] == [("b.cl", 1, "int b;"), ("a.cl", 2, "int one;"), ("a.cl", 5, "int four;")]


def test_a_mode_replaces_the_placeholder() -> None:
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
def test_no_kernel_uses_constructs_that_a_runtime_cannot_compile(name: str) -> None:
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


def test_programs_are_built_once_and_kernels_are_per_thread(device: Device) -> None:
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
    with pytest.raises(DeviceError, match=r"cannot create the kernel 'twice': .*INVALID_KERNEL_NAME"):
        first.kernel("twice")


def test_kernels_that_are_not_optimised_give_the_same_bits(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """The suite's own are built so (conftest.py), and users' are not."""
    pictures = []
    for flags in ("", "-cl-opt-disable"):
        monkeypatch.setenv("POCL_EXTRA_BUILD_FLAGS", flags)
        with clvol.Renderer(clvol.phantoms.marschner_lobb(16), device=Device(device.handle)) as renderer:  # of no program yet
            pictures.append(renderer.render(clvol.Camera.orbit(25, 35, fit="volume"), "composite", size=(40, 32)))
    assert np.ptp(pictures[0]) > 0.5
    np.testing.assert_array_equal(*pictures)


def test_floating_literals() -> None:
    assert [program.literal(v) for v in (1.0, 0.5, -2.0)] == ["1.0f", "0.5f", "-2.0f"]
    assert [program.literal(v) for v in (1e-9, 1e30)] == ["9.99999972e-10f", "1.00000002e+30f"]


def test_the_kernels_are_installed() -> None:
    assert Path(FOLDER / "march/draw.cl").is_file()


@pytest.fixture
def interrupt_in() -> Iterator[Callable[[float], None]]:
    """Ctrl-C after the given number of seconds, within the test."""
    before = signal.signal(signal.SIGALRM, signal.default_int_handler)
    yield lambda seconds: signal.setitimer(signal.ITIMER_REAL, seconds) and None
    signal.setitimer(signal.ITIMER_REAL, 0)
    signal.signal(signal.SIGALRM, before)


def tiny(device: Device, number: int) -> program.Program:
    text = f"kernel void tiny(global float *a) {{ a[get_global_id(0)] = {number}; }}\n"
    return device.build("tiny.cl", {"NUMBER": number}, generated={"tiny.cl": text})


def test_group_size_does_not_depend_on_shape(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """PoCL builds a kernel once per group size, and again for launches that start at 0."""
    if device.kind != "cpu":
        pytest.skip("other devices choose their groups themselves")
    seen: dict[str, set[Any]] = {}
    prepare = program.Variants.prepare

    def noted(self: program.Variants, name: str, size: Any, local: Any, offset: Any) -> None:
        seen.setdefault(name, set()).add((local, offset is not None and any(offset)))
        prepare(self, name, size, local, offset)

    monkeypatch.setattr(program.Variants, "prepare", noted)
    for shape in ((5, 6, 7), (9, 20, 33), (40, 17, 24)):
        data = np.random.default_rng(0).random(shape, np.float32)
        with clvol.Renderer(data, "bspline3", device=device) as renderer:
            renderer.render(mode="isosurface", isovalue=0.5, size=(19, 70))
        clvol.sample(data, np.zeros((200, 3)), "bspline3", device=device)
    assert {"fill_halo", "minmax_blocks", "draw"} <= seen.keys()
    assert {name: sizes for name, sizes in seen.items() if len(sizes) > 1 or (None, False) in sizes} == {}


def test_unused_programs_are_evicted(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("clvol.device.device._KEPT", 2)
    monkeypatch.setattr(device.programs, "_built", OrderedDict())
    first, second = tiny(device, 1), tiny(device, 2)
    kernel, freed = first.kernel("tiny"), [weakref.ref(first), weakref.ref(second.kernel("tiny"))]
    del second
    tiny(device, 1)  # was used most recently, so the other is evicted
    tiny(device, 3)
    assert tiny(device, 1) is first
    assert freed[1]() is None
    tiny(device, 4)
    tiny(device, 5)
    assert len(device.programs._built) == 2
    del first
    assert freed[0]() is None  # neither keeps the other alive
    values = np.zeros(8, np.float32)
    with device.buffers.lent(values, write=True) as buffer:
        kernel(device.queue, (8,), None, buffer)
    assert values.tolist() == [1] * 8


def test_threads_build_a_program_once(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    builds, given, begun = [], [], threading.Barrier(4)
    build = program.build

    def slow(*arguments: Any) -> program.Program:
        builds.append(arguments)
        time.sleep(0.1)
        return build(*arguments)

    def work() -> None:
        begun.wait(10)
        given.append(tiny(device, 6))

    monkeypatch.setattr(program, "build", slow)
    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert len(builds) == 1
    assert len(given) == 4
    assert len(set(map(id, given))) == 1


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no timers here")
def test_ctrl_c_works_during_a_build_and_the_program_is_kept(
    device: Device, interrupt_in: Callable[[float], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    builds, go_on = [], threading.Event()
    build = program.build

    def slow(*arguments: Any) -> program.Program:
        builds.append(arguments)
        go_on.wait(30)
        return build(*arguments)

    device.context  # noqa: B018
    monkeypatch.setattr(program, "build", slow)
    interrupt_in(0.3)
    begin = time.perf_counter()
    with pytest.raises(KeyboardInterrupt):
        tiny(device, 7)
    assert time.perf_counter() - begin < 1.3
    go_on.set()
    assert tiny(device, 7).kernel("tiny")
    assert len(builds) == 1
    assert not device.programs._building


def test_programs_are_built_where_no_thread_can_start(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """For example at interpreter shutdown in Python 3.12, or in a container that allows no more threads."""

    def no(*_: Any) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(launches._thread, "start_new_thread", no)
    values = np.zeros(8, np.float32)
    with device.buffers.lent(values, write=True) as buffer:
        tiny(device, 10).kernel("tiny")(device.queue, (8,), None, buffer)
    assert values.tolist() == [10] * 8
    assert not device.programs._building
    with pytest.raises(DeviceError):
        device.build("spoilt.cl", {}, generated={"spoilt.cl": "nonsense"})
    assert not device.programs._building


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no timers here")
def test_ctrl_c_works_while_the_runtime_finishes_a_kernel(
    device: Device, interrupt_in: Callable[[float], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """PoCL does this at the first launch; the kernel's memory lives until it is done."""
    queue, go_on = device.queue, threading.Event()

    class Slow:
        def finish(self) -> None:
            go_on.wait(30)
            queue.finish()

        def __getattr__(self, name: str) -> Any:
            return getattr(queue, name)

    kernel = tiny(device, 8).kernel("tiny")
    monkeypatch.setitem(device.__dict__, "queue", Slow())
    monkeypatch.setattr(launches.Launches, "_soon_done", lambda *_: False)
    values = np.zeros(8, np.float32)
    held = weakref.ref(values)
    interrupt_in(0.3)
    begin = time.perf_counter()
    try:
        with device.buffers.lent(values, write=True) as buffer:
            kernel(queue, (8,), None, buffer)
    except KeyboardInterrupt:
        assert time.perf_counter() - begin < 1.3
    else:
        pytest.fail("it was not heard")
    del buffer, values
    gc.collect()
    assert held() is not None
    go_on.set()
    monkeypatch.undo()
    device.finish()
    for _ in range(100):  # the thread that waits for the kernel lets go
        if held() is None:
            break
        time.sleep(0.05)
    assert held() is None


def test_a_linker_failing_later_is_an_error_not_an_abort(device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if not device.is_pocl or kernel_cache() is None:
        pytest.skip("not PoCL")
    linker = tmp_path / "ld"
    linker.write_text("#!/bin/sh\nexit 1\n")
    linker.chmod(0o755)
    unique = time.time_ns()
    built, values = tiny(device, unique), np.zeros(8, np.float32)
    for path in (f"{tmp_path}{os.pathsep}{os.environ['PATH']}", "/nonexistent"):
        with monkeypatch.context() as patched:
            patched.setenv("PATH", path)
            with pytest.raises(DeviceError, match="linker"):
                tiny(device, unique + 1)
            with pytest.raises(DeviceError, match="linker"), device.buffers.lent(values, write=True) as buffer:
                built.kernel("tiny")(device.queue, (8,), None, buffer)
    with device.buffers.lent(values, write=True) as buffer:
        built.kernel("tiny")(device.queue, (8,), None, buffer)
    assert values.tolist() == [np.float32(unique)] * 8


def test_a_failing_pyopencl_cache_is_reported(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    import sqlite3

    import pyopencl

    def fail(*_: Any) -> None:
        raise sqlite3.OperationalError("attempt to write a readonly database")

    built = tiny(device, 9)
    monkeypatch.setattr(pyopencl, "Kernel", fail)
    with pytest.raises(DeviceError, match=r"pyopencl cannot use its cache .*readonly database.*PYOPENCL_NO_CACHE"):
        built.kernel("tiny")


EXIT = """
import os, signal, sys, threading, time
import clvol
from clvol.device import as_device
as_device().queue
threading.Timer({pause}, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
begin = time.perf_counter()
try:
    clvol.render(clvol.phantoms.sphere(12, radius=0.4), size=(24, 24))
except KeyboardInterrupt:
    print("out", time.perf_counter() - begin - {pause} < 1)
"""


@pytest.mark.thorough
@pytest.mark.skipif(not hasattr(os, "fork"), reason="signals are others here")
@pytest.mark.parametrize("pause", [0.1, 0.5, 1, 2, 3, 5, 7])
def test_exiting_during_a_build_is_no_crash(device: Device, pause: float, tmp_path: Path) -> None:
    environment = {**os.environ, "POCL_CACHE_DIR": str(tmp_path)}
    code = EXIT.format(pause=pause)
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=120, check=False)
    # Python remembers an interrupt that passed through `exec`, as in the making of a dataclass, and ends as if nobody had caught it
    assert done.returncode in (0, -signal.SIGINT), done.stderr
    assert done.stdout in ("out True\n", "")
    assert device is not None


@pytest.mark.thorough
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_memory_is_flat_over_many_programs(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("clvol.device.device._KEPT", 20)
    values, resident = np.zeros(64, np.float32), []
    for number in range(100, 300):
        with device.buffers.lent(values, write=True) as buffer:
            tiny(device, number).kernel("tiny")(device.queue, (64,), None, buffer)
        assert values[0] == number
        if number % 100 == 49:
            resident.append(int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE"))
    assert resident[1] - resident[0] < 20 << 20


def test_a_build_disturbed_by_a_signal_is_repeated(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """LLVM removes its output on SIGINT, whichever handler is set."""
    cl = program.opencl()
    build, calls = cl.Program.build, []

    def hindered(self: Any, *given: Any, **options: Any) -> Any:
        calls.append(1)
        if len(calls) == 1:
            raise cl.RuntimeError("error: unable to rename temporary 'a.cl.tmp' to output file 'a.cl': 'No such file or directory'")
        return build(self, *given, **options)

    monkeypatch.setattr(cl.Program, "build", hindered)
    if not (device.is_pocl and device.has_images):
        pytest.skip("other runtimes build otherwise, and PoCL 7.1 builds no kernel of images")
    made = device.build("base/sampler.cl", {"COORD_DOUBLE": 0, "SOME": 7})
    assert len(calls) == 2
    assert made.kernel("sample_ramp") is not None


def test_compilers_print_nothing_on_standard_error(device: Device, capfd: pytest.CaptureFixture[str]) -> None:
    """clang counted its warnings there: "13 warnings generated." on first use."""
    text = "kernel void a(global int *x) { x[0] = 1; }\n#warning of ours\n"
    device.require_usable()
    program._compiled(device.context, text)
    assert capfd.readouterr().err == ""


FAILING = """
import sys; sys.orig_argv = ["python", "-m", "clvol"]
from clvol.base.interrupted import only_our_lines
from clvol.device import as_device, program
only_our_lines()
device = as_device()
device.require_usable()
try:
    program._compiled(device.context, "kernel void a(global int *x) { x[0] = nothing; }")
except Exception as error:
    print("ours:", "nothing" in str(error), file=sys.stderr)
"""


def test_a_compiler_that_fails_adds_no_line_to_those_of_the_command(device: Device) -> None:
    """Interrupted, clang said "1 error generated." beside the command's line."""
    assert device is not None
    done = subprocess.run([sys.executable, "-c", FAILING], capture_output=True, encoding="utf-8", timeout=120, check=True)
    assert done.stderr == "ours: True\n"
