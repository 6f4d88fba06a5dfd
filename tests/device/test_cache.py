"""Built kernels on disk: a loaded kernel is the one that was stored, whatever happened to the files."""

from __future__ import annotations

import os
import platform
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from clvol.base.errors import ClvolWarning, DeviceError
from clvol.device import Device, as_device, cache, probe
from clvol.device.cache import Store
from clvol.device.runtimes import pocl
from clvol.device.runtimes.pocl import KernelCache

linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="PoCL by pip is for Linux")

# A kernel that builds instantly.
TINY = """
import numpy as np
from clvol.device import as_device
device = as_device()
values = np.zeros(64, np.float32)
with device.buffers.lent(values, write=True) as buffer:
    made = {"tiny.cl": "kernel void tiny(global float *a) { size_t i = get_global_id(0); a[i] = i * i + 0.5f; }"}
    device.build("tiny.cl", {}, generated=made).kernel("tiny")(device.queue, (64,), None, buffer)
print("right" if (values == np.arange(64) ** 2 + 0.5).all() else values)
"""
SAMPLE = "import clvol; print(clvol.sample([[1.0, 2.0], [3.0, 4.0]], [[0.5, 0.5]], 'linear')[0])"


def python(code: str, folder: Path, timeout: float = 120) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "POCL_CACHE_DIR": str(folder)}
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=timeout, check=False, env=environment
    )


def flip(data: bytes) -> bytes:
    return data[: len(data) // 2] + bytes([data[len(data) // 2] ^ 1]) + data[len(data) // 2 + 1 :]


DAMAGE = {
    "garbage": lambda data: bytes(len(data)),
    "bit": flip,
    "short": lambda data: data[: len(data) // 2],
    "empty": lambda _: b"",
}


def test_the_least_recently_used_kernels_are_evicted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "_MOST", 10_000)
    monkeypatch.setattr(cache, "_LOOK", 1_000)
    store = Store(tmp_path)
    for number in range(40):
        store.write(f"{number:02} key", "a", bytes(900))
        store.write(f"{number:02} key", "b", bytes(100))
        for place in tmp_path.glob(f"*/{number:02} key"):
            os.utime(place, (number, number))
        if number:
            assert store.read("00 key")  # is used
    held = sum(file.stat().st_size for file in tmp_path.glob("*/*/*"))
    assert 7_000 < held < 12_000
    assert store.read("00 key")
    assert store.read("39 key")


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="no owners here")
def test_a_folder_of_another_user_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert cache.fault(tmp_path / "own") is None
    assert (tmp_path / "own").stat().st_mode & 0o777 == 0o700
    (tmp_path / "open").mkdir()
    (tmp_path / "open").chmod(0o777)
    assert "everybody may write" in str(cache.fault(tmp_path / "open"))
    os.chown(tmp_path / "own", 12345, -1) if os.getuid() == 0 else None
    monkeypatch.setattr(os, "getuid", lambda: 54321)
    assert "another user" in str(cache.fault(tmp_path / "own"))


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_file_is_set_aside(damage: str, tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.write("key", "AB/CD/program.bc", b"program")
    store.write("key", "AB/CD/k/1-1-1/k.so", bytes(range(256)))
    store.write("other", "AB/CD/program.bc", b"another")
    assert Store(tmp_path).read("key") == {"AB/CD/program.bc": b"program", "AB/CD/k/1-1-1/k.so": bytes(range(256))}
    (file,) = tmp_path.glob("*/key/*k.so")
    spoilt = DAMAGE[damage](file.read_bytes())
    file.write_bytes(spoilt)
    assert list(store.read("key")) == ["AB/CD/program.bc"]
    assert not file.exists()
    assert (tmp_path / "damaged").read_bytes() == spoilt
    store.write("key", "AB/CD/k/1-1-1/k.so", b"anew")
    assert store.read("key")["AB/CD/k/1-1-1/k.so"] == b"anew"
    assert store.read("other") == {"AB/CD/program.bc": b"another"}


def test_a_file_is_only_read_under_its_name_and_key(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.write("key", "a", b"content")
    (file,) = tmp_path.glob("*/key/a")
    for other in (file.with_name("b"), tmp_path / "el/else/a"):
        other.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(file, other)
    assert store.read("key") == {"a": b"content"}
    assert store.read("else") == {}


def test_an_unwritable_store_is_empty(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    store = Store(tmp_path / "file")
    store.write("key", "a", b"content")
    assert store.read("key") == {}


@linux
def test_temporary_folders_are_removed_with_their_processes(tmp_path: Path) -> None:
    mine = KernelCache(tmp_path)
    dead, elsewhere, forgotten = (mine.folder.with_name(f"{name}-dead") for name in (platform.node(), "another", "third"))
    for folder in (dead, elsewhere, forgotten):
        (folder / "AB").mkdir(parents=True)
        (folder / "lock").touch()
    os.utime(forgotten / "lock", (0, 0))
    other = KernelCache(tmp_path)
    assert not dead.exists()
    assert elsewhere.exists()  # its process may run on a machine whose locks are invisible here
    assert not forgotten.exists()
    assert mine.folder.is_dir()
    for one in (mine, other):
        one._close()
        assert not one.folder.exists()


@linux
def test_a_built_kernel_is_found_while_another_thread_tests_the_linker(tmp_path: Path) -> None:
    kernels = KernelCache(tmp_path)
    (kernels.folder / "AB" / "CDEF").mkdir(parents=True)
    done = threading.Event()

    def tries() -> None:
        while not done.is_set():
            with tempfile.TemporaryDirectory(dir=kernels.folder, prefix="trial-"):
                pass

    with ThreadPoolExecutor(2) as others:
        for _ in range(2):
            others.submit(tries)
        try:
            for _ in range(1000):
                (kernels.folder / "AB" / "CDEF" / "last_accessed").touch()
                assert kernels.built() == "AB/CDEF"
        finally:
            done.set()


def test_disk_space_and_the_linker_are_tested_before_a_build(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import resource

    if shutil.which("ld") is None:
        pytest.skip("there is no linker")
    kernels = KernelCache(tmp_path)
    kernels.require_room()
    assert {file.name for file in kernels.folder.iterdir()} == {"lock"}
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20, before[1]))  # as a disk with no more room
    try:
        with pytest.raises(DeviceError, match="no room for 3 MiB") as raised:
            kernels.require_room()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert "binutils" not in str(raised.value)
    linker = tmp_path / "ld"
    linker.write_text("#!/bin/sh\necho out of order >&2\nexit 1\n")
    linker.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(DeviceError, match=rf"linker.* {linker} fails in .*out of order"):
        kernels.require_room()
    linker.unlink()
    with pytest.raises(DeviceError, match="none on PATH"):
        kernels.require_room()
    kernels.needs_linker = False
    kernels.require_room()
    monkeypatch.undo()
    kernels.folder = tmp_path / "gone"
    with pytest.raises(DeviceError, match="no room"):
        kernels.require_room()


@linux
def test_an_unwritable_folder_is_reported_and_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("POCL_CACHE_DIR", os.devnull)
    monkeypatch.delenv("POCL_KERNEL_CACHE", raising=False)
    with pytest.warns(ClvolWarning, match=f"POCL_CACHE_DIR names {os.devnull}, which cannot be written"):
        kernels = pocl.open_cache()
    assert kernels is not None
    assert tmp_path in kernels.folder.parents
    monkeypatch.delenv("POCL_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", os.devnull)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        temporary = pocl.open_cache()
    assert temporary is not None
    temporary._close()
    assert not temporary.folder.parents[1].exists()
    monkeypatch.setattr(pocl.tempfile, "tempdir", os.devnull)
    with pytest.raises(DeviceError, match="no folder can be written to build kernels in"):
        pocl.open_cache()


def test_a_missing_home_is_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """`Path.home` raises if a user has neither HOME nor an entry in the system's table."""

    def nobody() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", nobody)
    assert cache.folder() is None


@linux
@pytest.mark.parametrize("damage", ["bit", *(pytest.param(d, marks=pytest.mark.thorough) for d in ("garbage", "short", "empty"))])
def test_damaged_kernels_are_rebuilt(device: Device, damage: str, tmp_path: Path) -> None:
    """PoCL would run them: a bus error, an illegal instruction, an abort."""
    if not (device.is_pocl and as_device() is device):
        pytest.skip("PoCL is not the default device")
    assert python(TINY, tmp_path).stdout == "right\n"
    files = [file for file in (tmp_path / "clvol/store").glob("*/*/*") if not file.name.startswith(".")]
    assert {file.suffix for file in files} == {".bc", ".so"}
    sound = {file: file.read_bytes() for file in files}
    for file in files:
        file.write_bytes(DAMAGE[damage](file.read_bytes()))
    done = python(TINY, tmp_path)
    assert done.stdout == "right\n", done.stderr
    assert {file: len(file.read_bytes()) for file in files} == {file: len(data) for file, data in sound.items()}
    assert (tmp_path / "clvol/store/damaged").is_file()
    times = {file: file.stat().st_mtime_ns for file in files}
    assert python(TINY, tmp_path).stdout == "right\n"  # from the store
    assert times == {file: file.stat().st_mtime_ns for file in files}


@linux
@pytest.mark.thorough
def test_six_processes_on_a_cold_cache_compute_the_same(device: Device, tmp_path: Path) -> None:
    code = (
        "import clvol, hashlib; v = clvol.phantoms.sphere(12, radius=0.4)\n"
        "print(hashlib.sha256(clvol.render(v, size=(24, 24)).tobytes()).hexdigest())"
    )
    environment = {**os.environ, "POCL_CACHE_DIR": str(tmp_path)}
    running = [subprocess.Popen([sys.executable, "-c", code], env=environment, stdout=subprocess.PIPE, text=True) for _ in range(6)]
    told = [process.communicate(timeout=600)[0] for process in running]
    assert len(set(told)) == 1
    assert len(told[0]) == 65
    assert python(code, tmp_path).stdout == told[0]
    assert not list((tmp_path / "clvol/running").iterdir())
    assert device is not None


@linux
@pytest.mark.thorough
def test_a_process_killed_during_a_build_damages_nothing(device: Device, tmp_path: Path) -> None:
    environment = {**os.environ, "POCL_CACHE_DIR": str(tmp_path)}
    for pause in (1.0, 1.5, 2.0, 2.5, 3.0, 4.0):
        process = subprocess.Popen([sys.executable, "-c", SAMPLE], env=environment)
        time.sleep(pause)
        process.send_signal(signal.SIGKILL)
        process.wait()
    done = python(SAMPLE, tmp_path)
    assert done.stdout == "2.5\n", done.stderr
    assert not list((tmp_path / "clvol/running").iterdir())
    assert not list((tmp_path / "clvol/store").glob("damaged"))
    assert device is not None


def full(monkeypatch: pytest.MonkeyPatch, *folders: Path) -> None:
    """Have the disks of folders be full."""
    usage = shutil.disk_usage

    def of(path: Path) -> Any:
        return usage(path)._replace(free=0 if any(path.is_relative_to(one) for one in folders) else 1 << 30)

    monkeypatch.setattr(shutil, "disk_usage", of)


@linux
def test_kernels_are_built_elsewhere_if_the_disk_of_the_cache_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It was an error, although a temporary folder had room."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("POCL_CACHE_DIR", raising=False)
    kept = pocl.open_cache()
    assert kept is not None
    kept.store.write("key", "name", b"content")
    full(monkeypatch, tmp_path / "cache")
    with pytest.warns(ClvolWarning, match="cache/clvol/kernels is full: kernels are built in .*, and not kept"):
        other = pocl.open_cache()
    assert other is not None
    assert not other.folder.is_relative_to(tmp_path)
    assert other.store.read("key") == {"name": b"content"}
    other._close()
    assert not other.folder.parent.exists()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "cache"))
    with pytest.raises(DeviceError, match=r"is full .*; make room, or let POCL_CACHE_DIR or TMPDIR name a folder"):
        pocl.open_cache()
    monkeypatch.setenv("POCL_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "other"))
    with pytest.warns(ClvolWarning, match="POCL_CACHE_DIR names .*, whose disk is full; kernels are kept elsewhere"):
        last = pocl.open_cache()
    assert last is not None
    assert last.folder.is_relative_to(tmp_path / "other")


@linux
def test_a_trial_is_not_made_on_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """PoCL aborted there, and the advice was to install binutils."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    full(monkeypatch, tmp_path)
    monkeypatch.setattr(probe, "_TRIAL", "this is another one, whose verdict is unknown")
    assert probe.tried() == probe.Verdict()
    assert not list((tmp_path / "cache/clvol").glob("probe-*"))
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    full(monkeypatch, tmp_path / "temporary")
    assert probe._roomy() == tmp_path / "cache/clvol"
