"""Choosing a device, and machines that lack something: an error that says what to do, never a hang or an abort."""

from __future__ import annotations

import gc
import os
import shutil
import subprocess
import sys
import threading
import time
import warnings
import weakref
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from clvol.base.errors import ClvolWarning, DeviceError, OptionError, OutOfMemoryError
from clvol.device import Device, Limits, as_device, choose, devices
from clvol.device.launches import Launches
from clvol.device.opencl import opencl
from clvol.spline.field import sample

USE = """
import sys
from clvol.base.errors import ClvolError
from clvol import sample
try:
    value = sample([[1.0, 2.0], [3.0, 4.0]], [[0.5, 0.5]], "linear")
    print("value", value[0])
except ClvolError as error:
    print(type(error).__name__, error)
"""


def python(code: str, timeout: float = 120, **changes: str | None) -> subprocess.CompletedProcess[str]:
    """Run `code` in its own process, with environment variables set, or removed where None."""
    environment = {**os.environ, **{k: v for k, v in changes.items() if v is not None}}
    for name, value in changes.items():
        if value is None:
            environment.pop(name, None)
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=timeout, check=False, env=environment
    )


def uses_pocl(device: Device) -> bool:
    return device.is_pocl and as_device() is device


def test_llvmpipe_comes_last(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """Even where it calls itself a GPU: it compiles some kernels for minutes."""
    mesa = SimpleNamespace(int_ptr=-1, available=True, compiler_available=True, name="llvmpipe (LLVM 15.0.6, 256 bits)")
    mesa.type, mesa.platform = opencl().device_type.GPU, SimpleNamespace(name="rusticl")
    platforms = [SimpleNamespace(get_devices=lambda handle=handle: [handle]) for handle in (mesa, device.handle)]
    monkeypatch.setattr(choose, "opencl", lambda: SimpleNamespace(get_platforms=lambda: platforms, Error=RuntimeError))
    monkeypatch.setattr(choose, "_devices", dict(choose._devices))
    monkeypatch.setattr(Device, "fault", "")
    assert [found.name for found in devices()] == [device.name, mesa.name]


def test_no_linker_is_an_error_not_an_abort(device: Device, tmp_path: Path) -> None:
    """PoCL would abort the process; the error says what to install."""
    if not uses_pocl(device):
        pytest.skip("PoCL is not the default device")
    done = python(USE, PATH=str(tmp_path), XDG_CACHE_HOME=str(tmp_path), POCL_CACHE_DIR=str(tmp_path))  # nothing is built yet
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("DeviceError PoCL needs the linker 'ld'"), done.stdout
    assert "binutils" in done.stdout


def test_a_failing_linker_is_an_error_not_an_abort(device: Device, tmp_path: Path) -> None:
    if not uses_pocl(device):
        pytest.skip("PoCL is not the default device")
    linker = tmp_path / "ld"
    linker.write_text("#!/bin/sh\nexit 1\n")
    linker.chmod(0o755)
    done = python(USE, PATH=f"{tmp_path}:{os.environ['PATH']}", XDG_CACHE_HOME=str(tmp_path), POCL_CACHE_DIR=str(tmp_path))
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("DeviceError PoCL needs the linker to finish a kernel"), done.stdout
    assert f"{linker} fails in" in done.stdout
    assert "binutils" in done.stdout


@pytest.mark.one_in(4)
@pytest.mark.parametrize("home", ["/dev/null", "/nonexistent/home", "read-only", None])
def test_an_unwritable_home_is_no_error(device: Device, home: str | None, tmp_path: Path) -> None:
    if home == "read-only":
        tmp_path.chmod(0o500)  # root may still write there
        home = str(tmp_path)
    done = python(USE, HOME=home, XDG_CACHE_HOME=None, POCL_CACHE_DIR=None, PYOPENCL_NO_CACHE=None)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("value 2.5"), done.stdout + done.stderr
    assert device is not None


FORK = """
import gc, os
import numpy as np
from clvol.device import as_device, devices
from clvol.base.errors import DeviceError
from clvol import sample
points = ([[1.0, 2.0], [3.0, 4.0]], [[0.5, 0.5]], "linear")
device = as_device()
sample(*points)
values, buffer, volume = np.zeros(4, np.float32), device.buffers.allocate(64), device.buffers.allocate(64 << 20)
child = os.fork()
if child == 0:
    refused = 0
    calls = (
        lambda: sample(*points, device=device),
        lambda: sample(*points),
        lambda: device.build("base/sampler.cl", {"COORD_DOUBLE": 0}),
        lambda: device.buffers.allocate(64),
        lambda: device.buffers.upload(values),
        lambda: device.buffers.download(buffer, values),
        lambda: device.buffers.clear(buffer, 0, 1),
        lambda: device.buffers.lent(values, write=True).__enter__(),
        lambda: device.buffers.mapped(buffer, (4,), write=True).__enter__(),
        device.finish,
        device.require_usable,
        as_device,
        devices,
    )
    for call in calls:
        try:
            call()
        except DeviceError as error:
            refused += "fork" in str(error)
    del buffer, volume, calls, call
    gc.collect()  # what kernels worked in goes without a wait for them, which would have no end here
    os._exit(refused == 13)
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), sample(*points)[0])
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_use_after_a_fork_is_an_error_not_a_hang(device: Device) -> None:
    assert device is not None
    done = python(FORK, timeout=60)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["1", "2.5"], done.stdout


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_fork_before_the_first_use_is_allowed(device: Device) -> None:
    assert device is not None
    done = python(
        "import os, clvol as s\nchild = os.fork()\n"
        "value = s.sample([[1.0, 2.0], [3.0, 4.0]], [[0.5, 0.5]], 'linear')[0]\n"
        "if child == 0: os._exit(int(value * 2))\n"
        "print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), value)",
        timeout=60,
    )
    assert done.stdout.split() == ["5", "2.5"], done.stdout + done.stderr


def test_choosing(device: Device) -> None:
    found = devices()
    assert as_device(device) is device
    assert device in found
    assert devices()[0] is found[0]
    assert as_device(found.index(device)) is device
    assert as_device(str(found.index(device))) is device
    assert as_device(device.kind).kind == device.kind
    assert as_device(device.name).name == device.name
    assert as_device(device.platform.upper()[:8]).platform[:8] == device.platform[:8]
    assert device.name in repr(device)


def test_unknown_devices_are_rejected_and_known_ones_listed(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    for bad in ("no such device", len(devices()), "99", -1):
        with pytest.raises(OptionError, match="device must be one of 'cpu', 'gpu'") as caught:
            as_device(bad)
        assert device.name in str(caught.value)
    absent = next(kind for kind in ("gpu", "accelerator") if kind not in {one.kind for one in devices()})
    with pytest.raises(OptionError, match=f"device '{absent}' needs a device of that kind with an OpenCL driver; found are 0 "):
        as_device(absent)
    monkeypatch.setenv("CLVOL_DEVICE", "no such device")
    with pytest.raises(OptionError):
        as_device()
    monkeypatch.setenv("CLVOL_DEVICE", device.name)
    assert as_device().name == device.name


def test_quirks_are_handled(device: Device) -> None:
    assert device.kind in ("cpu", "gpu", "accelerator")
    for value in (device.has_double, device.has_images, device.is_pocl, device.shares_memory):
        assert isinstance(value, bool)
    assert device.image_limit > 0 or not device.has_images


def test_memory_is_checked_before_it_is_touched(device: Device) -> None:
    for size in (2**60, int(device.handle.global_mem_size)):
        with pytest.raises(OutOfMemoryError, match="MiB"):
            device.buffers.allocate(size)
    with pytest.raises(MemoryError):
        sample(np.broadcast_to(np.uint8(1), (40_000,) * 3), [[0.0, 0, 0]], device=device, precision="double")  # no bricks


def test_buffers_round_trip(device: Device) -> None:
    data = np.asfortranarray(np.random.default_rng(0).normal(size=(3, 5)).astype(np.float32))
    back = np.empty((3, 5), np.float32)
    device.buffers.download(device.buffers.upload(data), back)
    np.testing.assert_array_equal(back, data)
    buffer = device.buffers.allocate(60)
    with device.buffers.mapped(buffer, (3, 5), write=True) as mapped:
        mapped[...] = data
    with device.buffers.mapped(buffer, (3, 5), write=False) as mapped:
        np.testing.assert_array_equal(mapped, data)


def test_large_buffers_start_on_a_huge_page_and_round_trip(device: Device) -> None:
    buffer = device.buffers.allocate(4 * (1 << 21) + 4)
    with device.buffers.mapped(buffer, ((1 << 21) + 1,), write=True) as values:
        if device.kind == "cpu" and sys.platform == "linux":
            assert values.ctypes.data % (1 << 21) == 0
        values[:] = np.arange(values.size)
    with device.buffers.mapped(buffer, ((1 << 21) + 1,), write=False) as values:
        np.testing.assert_array_equal(values, np.arange(values.size))
    buffer.release()


@pytest.mark.parametrize("skipped", [0, 1, 5, 40])
def test_borrowed_memory_is_aligned_for_zero_copy(device: Device, skipped: int) -> None:
    data = np.arange(skipped + 24, dtype=np.float32)[skipped:].reshape(2, 3, 4)
    for array in (data, data[::-1, :, 1:]):
        with device.buffers.lent_span(array, write=False) as (buffer, start, strides):
            held = np.empty(buffer.size // 4, np.float32)
            device.buffers.download(buffer, held)
            places = start + np.einsum("i,izyx->zyx", strides[2::-1], np.indices(array.shape))
            np.testing.assert_array_equal(held[places], array)
            if device.shares_memory:
                address = buffer.get_host_array((1,), np.float32).ctypes.data
                assert address % (device.handle.mem_base_addr_align // 8) == 0


def test_runtime_errors_become_clvol_errors(device: Device) -> None:
    import pyopencl

    with pytest.raises(DeviceError, match="failed"), device.errors:
        raise pyopencl.LogicError("clSomething failed: INVALID_VALUE")
    with pytest.raises(OutOfMemoryError), device.errors:
        raise pyopencl.MemoryError("clSomething failed: MEM_OBJECT_ALLOCATION_FAILURE")


def test_build_errors_name_file_and_line(device: Device) -> None:
    with pytest.raises(DeviceError, match=r"filter\.cl"):
        device.build("spline/points.cl", {"COORD_DOUBLE": 0, "DERIVATIVE": 0})


def test_without_a_device_the_error_says_what_to_install(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    import pyopencl

    def refuse() -> list[object]:
        raise pyopencl.LogicError("clGetPlatformIDs failed: PLATFORM_NOT_FOUND_KHR")

    assert device is not None
    for answer in (list, refuse):
        monkeypatch.setattr(pyopencl, "get_platforms", answer)
        with pytest.raises(DeviceError, match=r"no OpenCL device was found.*clvol\[pocl\]"):
            as_device()


def test_limits_hold_for_a_block(device: Device) -> None:
    before = device.limits
    assert before == Limits()
    with device.limited(launch_taps=1, sorting=True):
        assert (device.limits.launch_taps, device.limits.sorting) == (1, True)
        assert device.limits.launch_voxels == before.launch_voxels
        with device.limited(sorting=False):
            assert (device.limits.launch_taps, device.limits.sorting) == (1, False)
        assert device.limits.sorting is True
    assert device.limits is before


def test_limits_are_restored_after_an_error(device: Device) -> None:
    before = device.limits
    with pytest.raises(KeyboardInterrupt), device.limited(sorted_bytes=1):
        raise KeyboardInterrupt
    assert device.limits is before


def test_unknown_limits_are_rejected(device: Device) -> None:
    before = device.limits
    with pytest.raises(TypeError, match="no_such_limit"), device.limited(no_such_limit=1):
        pass
    assert device.limits is before


def test_clear_sets_numbers_to_zero(device: Device) -> None:
    buffer = device.buffers.allocate(40)
    with device.buffers.mapped(buffer, (10,), write=True) as values:
        values[:] = 1
    device.buffers.clear(buffer, 3, 4)
    got = np.empty(10, np.float32)
    device.buffers.download(buffer, got)
    assert got.tolist() == [1] * 3 + [0] * 4 + [1] * 3


def test_the_linker_is_present_if_pocl_is(device: Device) -> None:
    if device.is_pocl:
        assert shutil.which("ld")


def test_limits_are_per_thread(device: Device) -> None:
    """However blocks overlap, each thread gets its own limits back."""
    usual, entered, leave = device.limits, threading.Event(), threading.Event()

    def other() -> None:
        assert device.limits == usual
        with device.limited(launch_taps=7):
            entered.set()
            leave.wait(10)
        assert device.limits == usual

    with device.limited(launch_taps=1):
        thread = threading.Thread(target=other)
        thread.start()
        assert entered.wait(10)
        assert device.limits.launch_taps == 1
    leave.set()
    thread.join()
    assert device.limits == usual


def test_concurrent_first_uses_share_a_context_and_a_queue(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """With two contexts, buffers of one and the queue of another, nothing works for the rest of the process."""
    import pyopencl

    fresh, begun, made = Device(device.handle), threading.Barrier(8), []
    make = pyopencl.Context

    def slow(*arguments: object) -> object:
        time.sleep(0.05)
        made.append(make(*arguments))
        return made[-1]

    def work() -> None:
        begun.wait(10)
        queues.append(fresh.queue)

    queues: list[object] = []
    monkeypatch.setattr(pyopencl, "Context", slow)
    # as in Python 3.12 and later, whose cached_property has no lock
    monkeypatch.setattr("functools.cached_property.__get__", unlocked, raising=True)
    threads = [threading.Thread(target=work) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30)
    assert len(made) == 1
    assert len(queues) == 8
    assert len(set(map(id, queues))) == 1
    assert fresh.context is made[0]


def unlocked(self: Any, instance: Any, _: object = None) -> Any:
    if instance is None:
        return self
    if self.attrname not in instance.__dict__:
        instance.__dict__[self.attrname] = self.func(instance)
    return instance.__dict__[self.attrname]


def test_a_vanished_device_is_an_error_then_and_later(device: Device) -> None:
    import pyopencl

    class Vanished:
        def finish(self) -> None:
            raise pyopencl.LogicError("clFinish failed: DEVICE_NOT_AVAILABLE")

    lost = Device(device.handle)
    lost.context  # noqa: B018
    lost.__dict__["queue"] = Vanished()
    values = np.ones(4, np.float32)
    with pytest.raises(DeviceError, match=r"is gone.*DEVICE_NOT_AVAILABLE.*start the program again"):
        lost.finish()
    for use in (
        lost.finish,
        lost.require_usable,
        lambda: lost.buffers.allocate(64),
        lambda: lost.buffers.upload(values),
        lambda: lost.build("base/sampler.cl", {"COORD_DOUBLE": 0}),
        lambda: lost.buffers.lent(values, write=True).__enter__(),
        lambda: sample([[1.0, 2.0], [3.0, 4.0]], [[0.5, 0.5]], "linear", device=lost),
    ):
        with pytest.raises(DeviceError, match="is gone"):
            use()
    assert sample([[1.0, 2.0], [3.0, 4.0]], [[0.5, 0.5]], "linear", device=device)[0] == 2.5


def test_exhausted_resources_are_an_error_and_the_device_stays_usable(device: Device) -> None:
    import pyopencl

    class Full:
        def finish(self) -> None:
            raise pyopencl.MemoryError("clFinish failed: OUT_OF_RESOURCES")

    queue = device.queue
    device.__dict__["queue"] = Full()
    try:
        with pytest.raises(OutOfMemoryError, match="OUT_OF_RESOURCES"):
            device.finish()
    finally:
        device.__dict__["queue"] = queue
    device.finish()


def test_a_new_default_device_is_reported_once(device: Device, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("CLVOL_DEVICE", raising=False)
    choose._last_default.cache_clear()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            first = as_device()  # the record is empty
            as_device()
            as_device(device)
        (tmp_path / "clvol/default-device").write_text("Old (Old Platform)")
        choose._last_default.cache_clear()
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            as_device(first.name)  # it was chosen
        with pytest.warns(ClvolWarning, match=r"the default is .*: Old \(Old Platform\), the default before, is gone"):
            assert as_device() is first
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            as_device()
        other = Device(first.handle)
        other.__dict__.update(name="New", platform="New Platform")
        monkeypatch.setattr(choose, "devices", lambda: [other, first])
        with pytest.warns(ClvolWarning, match=r"is number 1 now; CLVOL_DEVICE=.* chooses it"):
            assert as_device() is other
    finally:
        choose._last_default.cache_clear()


@pytest.mark.parametrize("failing", ["before", "within"])
def test_borrowed_memory_lives_until_kernels_finish(device: Device, failing: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """However the block exits, even by an interrupt in its last lines."""
    values, finished = np.zeros(8, np.float32), []
    queue = device.queue

    class Told:
        def finish(self) -> None:
            queue.finish()
            finished.append(kept() is not None)

        def __getattr__(self, name: str) -> Any:
            return getattr(queue, name)

    kept = weakref.ref(values)
    monkeypatch.setitem(device.__dict__, "queue", Told())
    if failing == "before":

        def interrupt(_: Launches) -> None:
            raise KeyboardInterrupt

        monkeypatch.setattr(Launches, "settle", interrupt)
    try:
        with device.buffers.lent(values, write=True) as buffer:
            if failing == "within":
                raise KeyboardInterrupt
    except KeyboardInterrupt:
        del values, buffer
    gc.collect()
    assert finished
    assert all(finished)
    assert kept() is None
    assert not any(owner() is None for owner, _ in device.launches._held.values())
