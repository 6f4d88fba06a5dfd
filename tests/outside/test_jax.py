"""JAX arrays: values compared with SciPy's, gradients with JAX's finite differences, transformed by jit, grad and vmap."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import ndimage

from clvol.base.errors import OptionError
from clvol.device import Device

jax = pytest.importorskip("jax")
import clvol.jax  # noqa: E402

HOW: dict[str, Any] = {"spacing": (0.8, 1.0, 1.3), "origin": (0.1, -0.2, 0.3)}


@pytest.fixture(autouse=True)
def _double() -> Iterator[None]:
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", False)


def problem(*, count: int = 7) -> tuple[Any, Any]:
    """Two functions' samples, and points inside and outside the domain, away from jumps of derivatives."""
    rng = np.random.default_rng(0)
    points = rng.integers(-3, 8, (count, 3)) + rng.uniform(0.1, 0.4, (count, 3))
    return jax.numpy.asarray(rng.normal(size=(2, 4, 5, 6))), jax.numpy.asarray(points)


def test_values_match_scipy(device: Device) -> None:
    values, points = problem(count=30)
    got = clvol.jax.sample(values, points.reshape(5, 6, 3), device=device)
    assert (got.shape, got.dtype) == ((2, 5, 6), np.float64)
    at = np.asarray(points)[:, ::-1].T
    expected = [ndimage.map_coordinates(np.asarray(v), at, order=3, mode="mirror") for v in values]
    assert_allclose(got.reshape(2, 30), expected, rtol=0, atol=1e-12)
    single = clvol.jax.sample(values.astype(np.float32), points, device=device)
    assert single.dtype == np.float32
    assert_allclose(single, expected, rtol=0, atol=2e-5)


def test_first_and_second_gradients_in_a_compiled_function(device: Device) -> None:
    from jax.test_util import check_grads

    sampled = jax.jit(lambda v, p: clvol.jax.sample(v, p, "bspline3", "wrap", device=device, **HOW))
    check_grads(sampled, problem(), order=2, modes=["rev"])


def test_many_at_once_are_each_as_alone(device: Device) -> None:
    values, points = problem()
    sampled = partial(clvol.jax.sample, device=device)
    slopes = jax.grad(lambda v, p: (sampled(v, p) ** 2).sum(), argnums=(0, 1))
    many_values, many_points = jax.numpy.stack([values, values + 1]), jax.numpy.stack([points, points + 0.1, points - 0.1])
    alone = [[sampled(v, p) for p in many_points] for v in many_values]
    nested = jax.vmap(jax.vmap(sampled, (None, 0)), (0, None))
    assert_allclose(nested(many_values, many_points), np.array(alone), rtol=0, atol=1e-14)
    by_values, by_points = jax.vmap(slopes)(many_values, many_points[:2])
    for v, p, of_values, of_points in zip(many_values, many_points, by_values, by_points, strict=False):
        assert_allclose(of_values, slopes(v, p)[0], rtol=0, atol=1e-12)
        assert_allclose(of_points, slopes(v, p)[1], rtol=0, atol=1e-12)


def test_filled_values_have_no_gradient(device: Device) -> None:
    values = problem()[0][:, 0]
    points = jax.numpy.asarray([[1.2, 0.3], [-0.6, 2.0], [5.4, 4.4], [np.nan, 1.0]])
    sampled = partial(clvol.jax.sample, fill=-7.0, device=device)
    assert (sampled(values, points)[:, 1::2] == -7).all()
    by_values, by_points = jax.grad(lambda v, p: sampled(v, p).sum(), argnums=(0, 1))(values, points)
    assert np.isfinite(by_values).all()
    assert ((by_points != 0).any(1) == np.array([True, False, True, False])).all()


def test_radiographs_are_differentiated_by_the_pose(device: Device) -> None:
    with clvol.Radiograph(clvol.phantoms.marschner_lobb(16), size=(12, 10), device=device) as radiograph:
        pose, weights = np.array([0.02, 0.0, -0.01, 0.02, 0.0, 0.01]), np.linspace(0, 1, 120).reshape(10, 12)
        picture, slopes = radiograph.gradient(pose)
        seen, by_pose = jax.value_and_grad(lambda six: (clvol.jax.radiograph(six, radiograph) * weights).sum())(pose)
        assert_allclose(seen, (picture * weights).sum(), rtol=1e-6)
        assert_allclose(by_pose, np.einsum("yx,yxk->k", weights, slopes), rtol=1e-6)
        assert_allclose(clvol.jax.radiograph(pose, radiograph), picture)
        with pytest.raises(OptionError, match=r"pose must have shape \(6,\); got \(5,\)"):
            clvol.jax.radiograph(pose[:5], radiograph)


def test_arguments_that_are_rejected() -> None:
    values, points = problem()
    with pytest.raises(OptionError, match="points must be an array of float32 or float64; got int64"):
        clvol.jax.sample(values, np.ones((2, 3), int))
    with pytest.raises(OptionError, match="values must have at least the 3 axes"):
        clvol.jax.sample(values[0, 0], points)
    with pytest.raises(TypeError, match="did you mean fill"):
        clvol.jax.sample(values, points, fil=0)  # type: ignore[call-arg]
    with pytest.raises(jax.errors.JaxRuntimeError, match="DataError: samples must be finite"):
        clvol.jax.sample(values * np.nan, points)


def test_importing_needs_no_jax() -> None:
    code = "import clvol.jax, sys; assert 'jax' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
