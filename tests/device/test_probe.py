"""Runtimes that abort or hang: an error or a warning names them, and the process survives."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace

import pytest

from clvol.base.errors import DeviceError
from clvol.device import Device, driver, opencl, probe
from clvol.device.probe import Verdict
from clvol.device.runtimes import intel

USE = """
import sys, warnings
import clvol.device.probe
clvol.device.probe.SECONDS = 20
from clvol.base.errors import ClvolError
with warnings.catch_warnings(record=True) as told:
    warnings.simplefilter("always")
    try:
        from clvol.device import devices
        print("devices", len(devices()))
    except ClvolError as error:
        print(type(error).__name__, error)
print(*(warning.message for warning in told), sep="\\n")
"""
BODIES = {"aborts": "abort();", "never answers": "for (;;) sleep(1000);"}


@pytest.fixture
def notes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of verdicts, empty."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "clvol"


@pytest.mark.skipif(not sys.platform.startswith("linux") or not shutil.which("gcc"), reason="no gcc to make a driver with")
@pytest.mark.parametrize("does", ["aborts", pytest.param("never answers", marks=pytest.mark.thorough)])
def test_a_driver_that_aborts_is_excluded_and_named(device: Device, does: str, tmp_path: Path) -> None:
    code = f"#include <stdlib.h>\n#include <unistd.h>\n__attribute__((constructor)) static void begin(void) {{ {BODIES[does]} }}\n"
    library, folder = tmp_path / "libbad.so", tmp_path / "vendors"
    (tmp_path / "bad.c").write_text(code)
    subprocess.run(["gcc", "-shared", "-fPIC", "-o", library, tmp_path / "bad.c"], check=True)
    folder.mkdir()
    (folder / "bad.icd").write_text(f"{library}\n")
    environment = {**os.environ, "OCL_ICD_VENDORS": str(folder), "XDG_CACHE_HOME": str(tmp_path)}

    def use() -> tuple[list[str], float]:
        begin = time.perf_counter()
        done = subprocess.run(
            [sys.executable, "-c", USE], env=environment, capture_output=True, text=True, timeout=200, check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout.splitlines(), time.perf_counter() - begin

    first, seconds = use()
    # pip's PoCL is beside the loader, and still found; other runtimes are not
    assert first[0].startswith("devices ") or "no OpenCL device was found" in first[0]
    assert str(library) in "".join(first)
    assert ("ended by SIGABRT" if does == "aborts" else "gave no answer within 20 s") in "".join(first)
    again, later = use()
    assert again == first
    assert later < seconds  # it was noted
    assert device is not None


def test_a_verdict_is_stored_until_something_changes(notes: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    trials: list[Verdict] = []

    def trial() -> Verdict:
        trials.append(Verdict(devices={"a": ""}))
        return trials[-1]

    monkeypatch.setattr(probe, "_try", trial)
    assert probe.tried() == probe.tried() == Verdict(devices={"a": ""})
    assert len(trials) == 1
    monkeypatch.setenv("OCL_SOMETHING", "else")
    probe.tried()
    assert len(trials) == 2
    probe.forget()
    probe.tried()
    assert len(trials) == 3
    (old,) = [
        note
        for note in notes.glob("probe-*.json")
        if note.stat().st_mtime_ns == min(one.stat().st_mtime_ns for one in notes.glob("probe-*.json"))
    ]
    monkeypatch.delenv("OCL_SOMETHING")
    for spoilt in ("", "[1, 2]", '{"nonsense": 1}', "{", "\udcff"):
        old.write_text(spoilt, errors="surrogateescape")
        before = len(trials)
        assert probe.tried() == Verdict(devices={"a": ""})
        assert len(trials) == before + 1


def test_failures_are_retried_later(notes: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    trials = []
    monkeypatch.setattr(probe, "_try", lambda: trials.append(1) or Verdict(devices={"a": "ended by SIGABRT"}))
    probe.tried()
    assert probe.tried().devices == {"a": "ended by SIGABRT"}
    assert len(trials) == 1
    (note,) = notes.glob("probe-*.json")
    hour = time.time() - 3600
    os.utime(note, (hour, hour))
    probe.tried()
    assert len(trials) == 2
    note.write_text('{"libraries": {"libbad.so": "gave no answer"}}')
    os.utime(note, (hour, hour))
    assert probe.tried().libraries  # the note is of this very library, which takes long to try
    assert len(trials) == 2


def test_without_a_writable_folder_runtimes_are_still_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", os.devnull)
    monkeypatch.setattr(probe, "_try", lambda: Verdict(devices={"a": ""}))
    assert probe.tried().devices == {"a": ""}
    probe.forget()


def test_a_device_that_aborts_the_trial_is_named_and_the_next_is_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    """A trial that finds three devices: the second aborts, the third raises an error."""
    script = """
import json, os, sys
def say(*words): print("clvol:" + json.dumps(words), flush=True)
first = int(sys.argv[2])
print("a driver's own words")
say("begun")
say("platform", "P")
say("found", ["one", "two", "three"])
for i in range(first, 3):
    say("trying", i)
    if i == 1:
        os.abort()
    say(*(("fails", i, "INVALID_BINARY") if i == 2 else ("works", i)))
"""
    monkeypatch.setattr(probe, "_TRIAL", script)
    verdict = probe._try()
    assert verdict.devices == {"one": "", "two": "ended by SIGABRT", "three": "failed: INVALID_BINARY"}
    assert not verdict.sound


def test_a_loader_that_aborts_the_trial_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(intel, "vendors", lambda: None)
    monkeypatch.setattr(probe, "SECONDS", 1.0)
    begun = "print('clvol:[\"begun\"]', flush=True)\n"
    for script, words in (
        ("import os\nos.abort()", "ended by SIGABRT"),
        ("import sys\nsys.exit('no such thing')", r"ended with status 1 \(no such thing\)"),
        ('print(\'clvol:["platform", "P"]\', flush=True)\nimport time\ntime.sleep(60)', r"gave no answer within 1 s \(at P\)"),
    ):
        monkeypatch.setattr(probe, "_TRIAL", begun + script)
        verdict = probe._try()
        monkeypatch.setattr(opencl, "_verdict", lambda verdict=verdict: verdict)
        monkeypatch.setattr(opencl, "_module", None)
        with pytest.raises(DeviceError, match=rf"cannot be loaded: a trial in another process {words}"):
            opencl.opencl()


def test_a_device_that_failed_its_trial_is_rejected_and_listed_last(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    fresh = Device(device.handle)
    monkeypatch.setattr("clvol.device.driver.why_not", lambda _: "ended by SIGSEGV")
    with pytest.raises(DeviceError, match="a trial of it in another process ended by SIGSEGV"):
        fresh.context  # noqa: B018
    with pytest.raises(DeviceError, match="SIGSEGV"):
        fresh.build("base/sampler.cl", {"COORD_DOUBLE": 0})


def test_nothing_is_tried_in_embedded_python(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(probe, "_try", lambda: pytest.fail("it was"))
    monkeypatch.setattr(sys, "executable", "")
    assert probe.tried() == Verdict()


@pytest.mark.skipif(os.name != "posix", reason="other programs are at hand there")
@pytest.mark.parametrize("program", ["true", "false", "no such program"])
def test_a_trial_that_did_not_start_gives_no_verdict(program: str, notes: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In embedded Python, `sys.executable` may be the other program."""
    monkeypatch.setattr(sys, "executable", shutil.which(program) or program)
    assert probe.tried() == Verdict()
    assert not list(notes.glob("probe-*.json"))


def test_few_verdicts_are_stored(notes: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(probe, "_try", lambda: Verdict(devices={"a": ""}))
    for i in range(20):
        monkeypatch.setenv("OCL_SOMETHING", str(i))
        probe.tried()
    found = list(notes.glob("probe-*.json"))
    assert len(found) == 16
    assert all(json.loads(note.read_text())["devices"] == {"a": ""} for note in found)


def test_pocl_needs_no_linker_where_a_trial_worked_without(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """PoCL 3.0 aborts where there is none, 7.1 leaves zeros, and later ones link in their own process."""
    kernels = SimpleNamespace(needs_linker=True)
    monkeypatch.setattr(Device, "is_pocl", True)
    monkeypatch.setattr(driver, "kernel_cache", lambda: kernels)
    monkeypatch.setattr(shutil, "which", lambda _: None)
    for verdict, needs in ((Verdict(), True), (Verdict(devices={probe.identity(device.handle): ""}), False)):
        monkeypatch.setattr(opencl, "_verdict", lru_cache(lambda verdict=verdict: verdict))
        assert Device(device.handle).fault == ""
        assert kernels.needs_linker is needs


def test_a_kernel_that_leaves_no_result_fails_its_trial(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(probe, "_TRIAL", probe._TRIAL.replace("a[0] = 1;", ""))
    failures: dict[int, str] = {}
    probe._run(0, (), failures)
    assert set(failures.values()) == {"failed: a kernel ran without a result"}
    assert device is not None
