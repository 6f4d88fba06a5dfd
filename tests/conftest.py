"""Fixtures for all test files."""

from __future__ import annotations

import contextlib
import os
import zlib
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest
from hypothesis import settings

from clvol.base.errors import DeviceError
from clvol.device import Device, devices
from clvol.filter.table import filters, register_filter, unregister_filter
from tests.declared import declare_few

# Files with few, slow tests
_LONG = {
    f"test_{name}.py"
    for name in ("guarded", "sanitized", "fuzz", "scipy", "docs", "examples", "page", "browser", "readme", "bench")
}

# One cache of built kernels for all workers, subprocesses and later runs, also those in other clones and with another HOME:
# PoCL's own. (PoCL and NVIDIA's driver cache by themselves, so pyopencl keeps no cache for them. PoCL reads the variable when
# pyopencl is first imported, later than here.)
if not os.environ.get("POCL_CACHE_DIR"):
    kernels = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "pocl" / "kcache"
    with contextlib.suppress(OSError):  # clvol finds a temporary folder
        kernels.mkdir(parents=True, exist_ok=True)
        os.environ["POCL_CACHE_DIR"] = str(kernels)

# Optimising a kernel takes longer than drawing a small picture without, and changes no bit (device/test_program.py). PoCL reads
# this at each build, also in subprocesses. `POCL_EXTRA_BUILD_FLAGS= pytest` tests what users build. That is of pip's PoCL 3.0:
# PoCL 6.0 and 7.1 make wrong kernels then.
if find_spec("pocl_binary_distribution") and not os.environ.get("CLVOL_TEST_THOROUGH"):
    os.environ.setdefault("POCL_EXTRA_BUILD_FLAGS", "-cl-opt-disable")
declare_few()

# the same examples in every run of the continuous integration; new ones on a developer's machine
settings.register_profile("ci", derandomize=True, deadline=None)
if os.environ.get("CI"):
    settings.load_profile("ci")


def _found() -> list[Device]:
    try:
        found = devices()
    except DeviceError:
        return []
    wanted = os.environ.get("CLVOL_TEST_DEVICE", "").lower()  # part of a platform's name, where there are several
    found = [device for device in found if wanted in device.platform.lower()]
    return [device for device in found if _usable(device)] or found


def _usable(device: Device) -> bool:
    """PoCL is not usable where it cannot link; that is no failure if another runtime exists."""
    try:
        device.require_usable()
    except DeviceError:
        return False
    return True


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Of a test that is marked ``one_in(n)``, all but one in n of its cases are thorough.

    A test that is asked for by its whole name always runs. Where several processes share the files, the longest come first.
    """
    if hasattr(config, "workerinput"):
        items.sort(key=lambda item: item.path.name not in _LONG)
    families: dict[object, list[pytest.Item]] = {}
    for item in items:
        if item.get_closest_marker("one_in"):
            on = getattr(item, "callspec", None) and item.callspec.params.get("device")  # type: ignore[attr-defined]  # a function's
            families.setdefault((item.parent, getattr(item, "originalname", item.name), on), []).append(item)
    for family in families.values():
        marker = family[0].get_closest_marker("one_in")
        assert marker is not None  # the condition above
        # by the case's id, so that a new case does not change the whole selection
        kept = sorted(family, key=lambda item: zlib.crc32(item.name.encode()))[: -(-len(family) // marker.args[0])]
        for item in family:
            if item not in kept:
                item.add_marker(pytest.mark.thorough)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """A test that takes `device` runs on every OpenCL device found."""
    if "device" in metafunc.fixturenames:
        found = _found()
        ids = [f"{d.platform} {d.name}".replace("::", ":") for d in found] or ["no device"]
        metafunc.parametrize("device", found or [None], ids=ids, indirect=True, scope="session")


@pytest.fixture(scope="session")
def device(request: pytest.FixtureRequest) -> Device:
    """An OpenCL device; a machine without one fails, so that a green run always means that kernels ran."""
    if request.param is None:
        if os.environ.get("CLVOL_ALLOW_NO_DEVICE") == "1":
            pytest.skip("no OpenCL device, and CLVOL_ALLOW_NO_DEVICE=1")
        pytest.fail('no OpenCL device was found: pip install "clvol[intel]" or clvol[pocl], or set CLVOL_ALLOW_NO_DEVICE=1 to skip')
    found: Device = request.param
    found.require_usable()
    return found


@pytest.fixture
def own_table() -> Iterator[None]:
    """The test may change the table of filters, which is put back."""
    before = filters()
    yield
    for name in filters():
        unregister_filter(name)
    for one in before.values():
        register_filter(one)
