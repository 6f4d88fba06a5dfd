"""Ctrl-C at any moment: prompt exit, a correct next result to the last bit, and freed memory."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clvol.device import Device
from clvol.spline.coefficients import _slabs
from clvol.spline.field import Field

pytestmark = pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no timers here")

# Interrupts at random moments of work of all kinds; after each the same work must give what it gave before.
# Python's handler runs at SIGALRM, as it does at Ctrl-C: latencies are from the signal to the end of the statement.
WORK = """
import json, random, signal, sys, time
import numpy as np, clvol, clvol.ndimage
from clvol.device import as_device
samples, count, seed = (int(text) for text in sys.argv[1:])
random.seed(seed)
data = np.random.default_rng(0).random((samples,) * 3, np.float32)
points = np.random.default_rng(1).uniform(0, samples - 1, (20_000, 3))
turn = np.array([[0.8, -0.6, 0, 5], [0.6, 0.8, 0, 2], [0, 0, 1, 0], [0, 0, 0, 1]])
def renderer():
    with clvol.Renderer(data, "bspline3") as made:
        return np.concatenate([made.render(mode=mode, size=(64, 64), **more) for mode, more in looks])
looks = [("composite", {}), ("isosurface", {"isovalue": 0.9}), ("mip", {})]
works = [
    lambda: clvol.sample(data, points),
    lambda: clvol.sample(data[::-1].astype(">f4").T, points, derivative=1),
    lambda: clvol.resample(data, shape=(samples + 7,) * 3).data,
    lambda: clvol.resample(data, like=clvol.Volume(data), transform=turn).data,
    lambda: clvol.ndimage.zoom(data.astype(np.uint8), 1.5),
    renderer,
]
expected, usual = [work() for work in works], []
for work in works:
    started = time.perf_counter(); work(); usual.append(time.perf_counter() - started)
def resident():
    try:
        return int(open("/proc/self/statm").read().split()[1]) * 4096
    except OSError:
        return 0
before, latencies = 0, []
signal.signal(signal.SIGALRM, signal.default_int_handler)
for number in range(count):
    kind = number % len(works)
    delay = random.uniform(1e-4, 1.1 * usual[kind])
    try:
        due = time.perf_counter() + delay
        signal.setitimer(signal.ITIMER_REAL, delay)
        result = works[kind]()
        signal.setitimer(signal.ITIMER_REAL, 0)
    except KeyboardInterrupt:
        latencies.append(time.perf_counter() - due)
    if number == count // 3:
        before = resident()
    again = (kind + number) % len(works)
    assert np.array_equal(works[again](), expected[again]), (kind, again)
as_device().finish()
print(json.dumps({"latencies": sorted(latencies), "grown": resident() - before}))
"""


def interrupted(samples: int, count: int, seed: int) -> dict[str, Any]:
    command = [sys.executable, "-X", "faulthandler", "-c", WORK, *map(str, (samples, count, seed))]
    done = subprocess.run(command, capture_output=True, encoding="utf-8", timeout=900, check=False)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_interrupts_of_all_operations(device: Device) -> None:
    assert device is not None
    found = interrupted(24, 24, 1)
    assert len(found["latencies"]) >= 6
    assert found["grown"] < 64 << 20


@pytest.mark.thorough
def test_hundreds_of_interrupts_of_all_operations(device: Device, capsys: pytest.CaptureFixture[str]) -> None:
    assert device is not None
    found = interrupted(160, 300, 2)
    latencies = found["latencies"]
    with capsys.disabled():
        print(
            f"\n{len(latencies)} interrupts: median {np.median(latencies):.3f} s, longest {latencies[-1]:.3f} s, "
            f"memory grown by {found['grown'] / 2**20:.0f} MiB"
        )
    assert len(latencies) >= 150
    assert latencies[-1] < 1.0
    assert found["grown"] < 64 << 20


MAKING = """
import sys, numpy as np, clvol
data = np.random.default_rng(0).random((200, 200, 200), np.float32)
clvol.Field(data, "bspline3").close()  # kernels are built
print("ready", flush=True)
while True:
    field = clvol.Field(data, "bspline3")
"""


def signalled(code: list[str], seconds: float, *, ready: bool) -> tuple[int, str, float]:
    """A process that gets SIGINT after a delay, counted from its ready message if there is one: exit status and time to exit."""
    process = subprocess.Popen([sys.executable, *code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, encoding="utf-8")
    try:
        if ready:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
        time.sleep(seconds)
        process.send_signal(signal.SIGINT)
        sent = time.perf_counter()
        _, said = process.communicate(timeout=60)
        return process.returncode, said, time.perf_counter() - sent
    finally:
        process.kill()


@pytest.mark.thorough
def test_fresh_processes_interrupted_while_computing_coefficients(device: Device, capsys: pytest.CaptureFixture[str]) -> None:
    """If they do not catch it they exit as Python does, without a crash at exit."""
    assert device is not None
    random.seed(3)
    ends = [signalled(["-X", "faulthandler", "-c", MAKING], random.uniform(0, 0.5), ready=True) for _ in range(30)]
    with capsys.disabled():
        print(f"\n{len(ends)} processes, gone after {max(end[2] for end in ends):.2f} s at most")
    assert all(code == -signal.SIGINT and said.endswith("KeyboardInterrupt\n") for code, said, _ in ends), Counter(ends)


@pytest.mark.thorough
def test_interrupts_while_importing(capsys: pytest.CaptureFixture[str]) -> None:
    random.seed(4)
    started = time.perf_counter()
    subprocess.run([sys.executable, "-c", "import clvol"], check=True, timeout=60)
    usual = time.perf_counter() - started
    codes = Counter[int]()
    for _ in range(60):
        code, said, _ = signalled(["-X", "faulthandler", "-c", "import clvol"], random.uniform(0.05, usual), ready=False)
        codes[code] += 1
        assert code in (0, -signal.SIGINT, 1), said
        assert code == 0 or not said or "KeyboardInterrupt" in said  # nothing is said before Python itself has begun
        assert "Fatal" not in said
    with capsys.disabled():
        print(f"\nhow imports ended: {dict(codes)}")


IMPORTED_AGAIN = """
import random, signal, sys, time
import numpy, scipy, scipy.ndimage, imageio.v3, cmap, pyopencl
random.seed(int(sys.argv[1]))
signal.signal(signal.SIGALRM, signal.default_int_handler)
started = time.perf_counter(); interrupted = 0
signal.setitimer(signal.ITIMER_REAL, random.uniform(0.001, 0.25))
try:
    import clvol
    import clvol.reports
except KeyboardInterrupt:
    interrupted = 1
signal.setitimer(signal.ITIMER_REAL, 0)
import clvol, clvol.reports
picture = clvol.render(clvol.phantoms.marschner_lobb(16), mode="mip", size=(16, 16))
import hashlib
print(interrupted, hashlib.sha256(numpy.asarray(picture).tobytes()).hexdigest())
"""


@pytest.mark.thorough
def test_an_interrupted_import_can_be_repeated(device: Device) -> None:
    assert device is not None
    said = [
        subprocess.run(
            [sys.executable, "-c", IMPORTED_AGAIN, str(seed)], capture_output=True, encoding="utf-8", timeout=120, check=True
        ).stdout.split()
        for seed in range(20)
    ]
    assert len({digest for _, digest in said}) == 1
    assert sum(int(number) for number, _ in said) >= 5


@pytest.mark.skipif(os.name != "posix", reason="signals as POSIX has them")
def test_the_command_exits_with_one_line_even_during_imports(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A library that it imports is replaced by one that waits."""
    (tmp_path / "numpy.py").write_text("import time; print('ready', flush=True); time.sleep(30)\n")
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    code, said, seconds = signalled(["-m", "clvol", "--version"], 0.2, ready=True)
    assert (code, said) == (130, "clvol: interrupted\n")
    assert seconds < 10


@pytest.mark.skipif(os.name != "posix", reason="signals as POSIX has them")
@pytest.mark.parametrize(("arguments", "said"), [("filters", ""), ("--wrong", "clvol: unknown command")])
def test_the_command_prints_one_line_even_while_it_exits(tmp_path: Path, arguments: str, said: str) -> None:
    """A function that runs at exit waits; Python's own words, or none, came from there, and a second line after an error."""
    code = (
        "import sys; sys.orig_argv = ['python', '-m', 'clvol']; import clvol, atexit, time; from clvol.cli import main\n"
        "atexit.register(lambda: (print('ready', flush=True), time.sleep(30)))\n"
        "sys.stdout = open(sys.argv[2], 'w')\n"
        "atexit.register(lambda: setattr(sys, 'stdout', sys.__stdout__))\n"
        "main([sys.argv[1]])"
    )
    code, printed, seconds = signalled(["-c", code, arguments, str(tmp_path / "printed")], 0.1, ready=True)
    assert (code, printed.count("\n")) == (2 if said else 130, 1)
    assert printed.startswith(said or "clvol: interrupted")
    assert seconds < 10


LATE = """
import sys; sys.orig_argv = ["python", "-m", "clvol"]; import clvol, time
from clvol.cli import main
class Last:  # kept by a module, which goes last
    def __del__(self, write=sys.__stdout__.write, flush=sys.__stdout__.flush, sleep=time.sleep):
        write("ready\\n"); flush(); sleep(2)
sys.modules["sys"].kept = Last()
sys.stdout = open(sys.argv[1], "w")
main(["--version"])
"""


@pytest.mark.skipif(os.name != "posix", reason="signals as POSIX has them")
def test_an_interrupt_after_the_last_line_changes_nothing(tmp_path: Path) -> None:
    """Python restores the system's handler as it takes the interpreter down, which ended it by the signal, without a word."""
    code, said, _ = signalled(["-c", LATE, str(tmp_path / "printed")], 0.1, ready=True)
    assert (code, said) == (0, "")


IMPORTING = """
import os, signal, sys, types
from importlib.machinery import ModuleSpec
from clvol.base.errors import DeviceError
class Finder:  # of a library whose import is interrupted
    def find_spec(self, name, path=None, target=None):
        return ModuleSpec(name, self) if name == "pyopencl" else None
    def create_module(self, spec):
        return None
    def exec_module(self, module):
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            os.abort()  # as C++ does that an exception leaves
        raise ImportError("none")
sys.meta_path.insert(0, Finder())
from clvol.device import opencl
opencl._verdict = lambda: types.SimpleNamespace(unloadable="", libraries={})
opencl.opencl()
"""


@pytest.mark.skipif(os.name != "posix", reason="signals as POSIX has them")
def test_an_interrupt_while_pyopencl_is_imported_does_not_abort() -> None:
    done = subprocess.run([sys.executable, "-c", IMPORTING], capture_output=True, encoding="utf-8", timeout=60, check=False)
    assert (done.returncode, done.stderr.splitlines()[-1]) == (-signal.SIGINT, "KeyboardInterrupt")


# -- launches are short, so that Ctrl-C works between them -------------------------------------------


def test_the_prefilter_waits_between_launches(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    data, waits = np.random.default_rng(2).random((24, 20, 16), np.float32), list[int]()
    with Field(data, "bspline3", device=device) as field:
        expected = field.magnify(2).data
    finish = device.finish
    monkeypatch.setattr(device, "finish", lambda: (waits.append(1), finish())[1])
    Field(data, "bspline3", device=device).close()
    few = len(waits)
    with device.limited(launch_voxels=1000), Field(data, "bspline3", device=device) as field:
        assert len(waits) - few > few + 24 // max(2, device.units)
        np.testing.assert_array_equal(field.magnify(2).data, expected)


@pytest.mark.parametrize("order", ["C", "F", "between"])
def test_numpy_copies_in_parts(device: Device, order: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Samples in a byte order that kernels cannot read."""
    shape = (40, 30, 50)
    data = np.arange(np.prod(shape)).reshape(shape).astype(">i4")
    laid = {"C": data, "F": np.asfortranarray(data), "between": np.ascontiguousarray(data.transpose(1, 0, 2)).transpose(1, 0, 2)}[
        order
    ]
    monkeypatch.setattr("clvol.spline.coefficients._COPIED", 4000)
    parts = _slabs(laid)
    assert 2 <= len(parts) <= 17
    seen = np.zeros(shape, int)
    for part in parts:
        seen[part] += 1
    assert (seen == 1).all()
    with Field(laid, "linear", device=device) as field, Field(data.astype(np.int32), "linear", device=device) as same:
        assert field.coefficients.buffer is not None
        np.testing.assert_array_equal(field.magnify(1).data, same.magnify(1).data)
