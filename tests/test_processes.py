"""Other processes: pickles, spawned workers, and the error in a child that was forked too late."""

from __future__ import annotations

import copy
import importlib
import importlib.util
import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clvol
from clvol.base.errors import OptionError
from clvol.device import Device
from clvol.filter.boundary import as_boundary
from clvol.filter.table import as_filter
from clvol.march.renderer import Renderer
from clvol.scene.light import Light, Material
from clvol.scene.mode import as_mode
from clvol.scene.scene import Medium, Scene
from clvol.scene.transfer import TransferFunction
from clvol.spline.field import Field
from clvol.volume.volume import Volume

ROOT = Path(__file__).resolve().parents[1]
DATA = np.random.default_rng(3).random((12, 11, 10), np.float32)
VOLUME = Volume(DATA, (1, 2, 3), (5, 6, 7), units="mm")
POINTS = np.array([[8.0, 9.0, 12.0], [10.25, 20.5, 30.125]])
AGAIN: dict[str, Callable[[Any], Any]] = {
    "pickle": lambda one: pickle.loads(pickle.dumps(one)),
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
}


@pytest.mark.parametrize("way", AGAIN)
@pytest.mark.parametrize(
    "one",
    [
        clvol.Camera.orbit(10, 20, fov=50),
        TransferFunction.ramp((0.0, 1.0), "orange"),
        Light((0, 0, 1.0)),
        Material(),
        as_mode("isosurface", {"method": "stepped", "isovalue": 0.5}),
        as_mode("composite", {"termination": 0.25}),
        as_filter("bspline3(0.5)"),
        as_filter("bspline5"),
        as_boundary("grid-constant(7)"),
    ],
    ids=lambda one: type(one).__name__,
)
def test_pickled_values_are_equal(one: object, way: str) -> None:
    back = AGAIN[way](one)
    assert (back, type(back)) == (one, type(one))


def test_pickled_volumes_and_scenes_are_equal(device: Device) -> None:
    scene = Scene(Medium(VOLUME, TransferFunction.ramp((0.0, 1.0)), filter="bspline3"), background="white")
    back = pickle.loads(pickle.dumps(scene))
    np.testing.assert_array_equal(back.media[0].volume.data, DATA)
    with Renderer(scene, device=device) as here, Renderer(back, device=device) as there:
        np.testing.assert_array_equal(here.render(size=(16, 16)), there.render(size=(16, 16)))


def test_hashes_of_filters_are_those_of_the_process() -> None:
    """A filter that has cached its hash must be found in tables of a process with another hash seed."""
    row = as_filter("bspline3")
    hash(row)
    script = (
        "import pickle, sys; from clvol.filter.table import as_filter\n"
        "row = pickle.loads(sys.stdin.buffer.read()); assert {as_filter('bspline3'): 1}[row] == 1"
    )
    environment = {**os.environ, "PYTHONHASHSEED": "7"}
    subprocess.run([sys.executable, "-c", script], input=pickle.dumps(row), env=environment, check=True, timeout=60)


@pytest.mark.parametrize("way", AGAIN)
def test_fields_renderers_and_interpolators_are_rebuilt(device: Device, way: str) -> None:
    data = np.where(DATA > 0.99, np.nan, DATA)
    with Field(data, "bspline3", "reflect", device, nan="local") as field, AGAIN[way](field) as back:
        assert (back.filter, back.boundary, back.device) == (field.filter, field.boundary, device)
        assert (back.missing.rule, back.missing.most, back.precision) == ("local", field.missing.most, "single")
        assert back.coefficients is not field.coefficients
        np.testing.assert_array_equal(back(POINTS), field(POINTS))
    with Field(VOLUME, "bspline3", device=device) as field:
        for renderer in (Renderer(VOLUME, "bspline3", device=device), Renderer(field)):
            with renderer, AGAIN[way](renderer) as again:
                np.testing.assert_array_equal(again.render(size=(16, 16)), renderer.render(size=(16, 16)))
    with (
        clvol.Interpolator((range(12), range(11), range(10)), DATA, bounds_error=False, device=device) as at,
        AGAIN[way](at) as other,
    ):
        np.testing.assert_array_equal(other(POINTS[:, ::-1]), at(POINTS[:, ::-1]))


def test_closed_ones_are_rejected(device: Device) -> None:
    field, renderer = Field(DATA, device=device), Renderer(DATA, "bspline3", device=device)
    for one in (field, renderer):
        one.close()
        with pytest.raises(OptionError, match="closed"):
            pickle.dumps(one)


FORKED = """
import gc, os, sys, time
import numpy as np, clvol, clvol.ndimage
from clvol.spline.scatter import adjoint
data, at = np.random.default_rng(0).random((20, 20, 20), np.float32), [[1.0, 2.0, 3.0]]
field, renderer, values = clvol.Field(data), clvol.Renderer(data, "bspline3"), clvol.Interpolator([range(20)] * 3, data)
calls = [
    lambda: field(at), lambda: field.gradient(at), lambda: field.resample(shape=(5, 5, 5)), lambda: field.magnify(2),
    lambda: renderer.render(size=(8, 8)), lambda: values(at), lambda: clvol.Field(data), lambda: clvol.Renderer(data),
    lambda: clvol.render(data, size=(8, 8)), lambda: clvol.sample(data, at), lambda: clvol.resample(data, shape=(5, 5, 5)),
    lambda: clvol.magnify(data), lambda: clvol.prefilter(data), lambda: clvol.warp(field, field.volume),
    lambda: clvol.ndimage.zoom(data, 2), lambda: adjoint([1.0], at, (5, 5, 5)), lambda: clvol.devices(),
]
before = field(at)
child = os.fork()
if child == 0:
    started = time.monotonic()
    for number, call in enumerate(calls):
        try:
            call()
        except clvol.ClvolError as error:
            assert "spawn" in str(error), (number, error)
        else:
            raise SystemExit(f"call {number} went through")
    assert time.monotonic() - started < 30, "not prompt"
    renderer.close()
    del field, values, renderer
    gc.collect()
    sys.exit(7)  # as a process ends that does not hurry
assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
assert (field(at) == before).all()
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_every_entry_point_raises_after_a_fork_and_the_child_exits(device: Device) -> None:
    assert device is not None
    done = subprocess.run([sys.executable, "-c", FORKED], capture_output=True, encoding="utf-8", timeout=120, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.skipif(not (ROOT / "examples").is_dir(), reason="examples are not beside the tests")
@pytest.mark.parametrize(
    "way",
    [
        "multiprocessing",
        pytest.param("concurrent.futures", marks=pytest.mark.thorough),
        pytest.param("joblib", marks=pytest.mark.thorough),
        pytest.param("torch", marks=pytest.mark.thorough),
    ],
)
def test_processes_render_what_this_one_renders(device: Device, way: str) -> None:
    assert device is not None
    if way in ("joblib", "torch") and importlib.util.find_spec(way) is None:
        pytest.skip(f"{way} is not installed")
    command = [sys.executable, str(ROOT / "examples" / "in_processes.py"), "--with", way]
    done = subprocess.run(command, capture_output=True, encoding="utf-8", timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == 3
    assert all(line.endswith("the same as in this process") for line in lines)


FIRST = """
import sys, threading
import numpy as np, clvol
data = np.random.default_rng(0).random((24, 24, 24), np.float32)
volume, points = clvol.Volume(data), np.random.default_rng(1).uniform(0, 23, (500, 3))
looks = [("mip", {}), ("isosurface", {"isovalue": 0.6}), ("isosurface", {"isovalue": 0.4})]
def draw(renderer):
    return [renderer.render(mode=mode, size=(40, 30), **more).tobytes() for mode, more in looks]
shared, results, errors = [], [], []
gate, made = threading.Barrier(6), threading.Lock()
def work(number):
    try:
        gate.wait()  # nothing of OpenCL was touched so far
        with made:
            if not shared:
                shared.extend((clvol.Field(volume), clvol.Renderer(volume)))
        own = clvol.sample(volume, points)
        field, renderer = shared
        order = draw(renderer), field(points).tobytes(), field.gradient(points).tobytes(), own.tobytes()
        results.append(order)
    except BaseException as error:
        errors.append(repr(error))
threads = [threading.Thread(target=work, args=(number,)) for number in range(6)]
[thread.start() for thread in threads]
[thread.join() for thread in threads]
assert not errors, errors
field, renderer = clvol.Field(volume), clvol.Renderer(volume)
serial = draw(renderer), field(points).tobytes(), field.gradient(points).tobytes(), clvol.sample(volume, points).tobytes()
assert len(results) == 6 and all(result == serial for result in results)
"""


def test_concurrent_first_uses_match_a_single_thread(device: Device) -> None:
    """The lazy attributes of one Renderer, Field and Volume are first used by all threads at once."""
    assert device is not None
    done = subprocess.run([sys.executable, "-c", FIRST], capture_output=True, encoding="utf-8", timeout=300, check=False)
    assert done.returncode == 0, done.stderr
