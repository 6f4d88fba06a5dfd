"""Phantoms sample their documented functions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clvol import phantoms
from clvol.base.errors import OptionError, OutOfMemoryError
from clvol.phantoms import by_name, marschner_lobb, marschner_lobb_function, marschner_lobb_gradient
from clvol.volume.volume import Volume
from tests.cases import BAD_COUNTS, BAD_NUMBERS, BAD_REALS, BAD_WHOLE, every


def sample_positions(volume: Volume) -> np.ndarray:
    z, y, x = np.indices(volume.shape)
    return volume.index_to_world(np.stack([x, y, z], -1))


def test_marschner_lobb_samples_its_function_on_the_cube() -> None:
    volume = marschner_lobb((7, 8, 9), 0.3, 5)
    points = sample_positions(volume)
    assert points.min() == -1
    assert points.max() == pytest.approx(1, abs=1e-15)
    wanted = marschner_lobb_function(points, 0.3, 5)
    assert volume.data.dtype == np.float32
    np.testing.assert_allclose(volume.data, wanted, atol=1e-6)
    assert marschner_lobb().shape == (41, 41, 41)
    assert marschner_lobb(41).spacing == pytest.approx((0.05,) * 3)


def test_marschner_lobb_by_hand() -> None:
    """z has the term in sin(πz/2); on the axis the wave is cos(2π f) = 1."""
    np.testing.assert_allclose(marschner_lobb_function([[0, 0, 0], [0, 0, 1], [0, 0, -1]]), [0.6, 0.2, 1.0], atol=1e-12)
    np.testing.assert_allclose(marschner_lobb_function([1, 0, 0]), 0.6, atol=1e-12)  # cos(πr/2) = 0
    rng = np.random.default_rng(0)
    p = rng.uniform(-1, 1, (10_000, 3))
    value = marschner_lobb_function(p)
    assert 0 <= value.min() <= value.max() <= 1
    np.testing.assert_allclose(value, marschner_lobb_function(p * [-1, 1, 1]))
    np.testing.assert_allclose(value, marschner_lobb_function(p[:, [1, 0, 2]]))


def test_marschner_lobb_gradient_is_the_numeric_one() -> None:
    p, h = np.random.default_rng(1).uniform(-0.99, 0.99, (500, 3)), 1e-6
    numeric = np.stack([(marschner_lobb_function(p + h * e) - marschner_lobb_function(p - h * e)) / (2 * h) for e in np.eye(3)], -1)
    np.testing.assert_allclose(marschner_lobb_gradient(p), numeric, atol=1e-7)
    on_axis = marschner_lobb_gradient([[0.0, 0.0, 0.3]])
    assert np.isfinite(on_axis).all()
    assert not on_axis[0, :2].any()


def test_sphere_is_one_half_on_the_sphere() -> None:
    volume = phantoms.sphere((9, 10, 11), 0.6)
    r = np.linalg.norm(sample_positions(volume), axis=-1)
    np.testing.assert_allclose(volume.data, 0.5 + (0.36 - r**2) / 1.2, atol=1e-6)
    np.testing.assert_array_equal(volume.data > 0.5, r < 0.6)
    near = np.abs(r - 0.6) < 0.1
    np.testing.assert_allclose(volume.data[near] - 0.5, (0.6 - r)[near], atol=0.01)


def test_polynomial_is_its_function() -> None:
    volume = phantoms.polynomial((5, 6, 7), degree=2, seed=3)
    np.testing.assert_allclose(volume.data, phantoms.polynomial_function(sample_positions(volume), 2, 3), atol=1e-5)
    assert not np.array_equal(volume.data, phantoms.polynomial((5, 6, 7), degree=2, seed=4).data)
    c = np.zeros((2, 3, 4))
    c[1, 2, 3] = 2
    p = np.random.default_rng(0).uniform(-1, 1, (20, 3))
    x, y, z = p.T
    np.testing.assert_allclose(phantoms.polynomial_function(p, coefficients=c), 2 * x * y**2 * z**3)


def test_checker_alternates() -> None:
    data = phantoms.checker((4, 6, 8), 4).data
    assert data[0, 0].tolist() == [0, 0, 1, 1, 0, 0, 1, 1]
    assert data[2, 0, 0] == data[0, 2, 0] == 1 - data[0, 0, 0]
    assert phantoms.checker(3, 2).data.sum() == 13


def test_box_is_hard_edged() -> None:
    volume = phantoms.box((21, 21, 21))
    p = sample_positions(volume)
    assert set(np.unique(volume.data)) == {0, 1}
    assert volume.data[10, 10, 10] == 1
    assert not volume.data[(np.abs(p) > 0.61).any(-1)].any()
    assert not volume.data[np.linalg.norm(p - 0.6, axis=-1) < 0.49].any()
    assert volume.data[(np.abs(p) < 0.59).all(-1) & (np.linalg.norm(p - 0.6, axis=-1) > 0.51)].all()


@pytest.mark.parametrize("name", phantoms.names())
def test_by_name(name: str) -> None:
    assert by_name(f"{name}:5").shape == (5, 5, 5)
    volume = by_name(f" {name}:4,5,6 ")
    assert volume.shape == (4, 5, 6)
    assert volume.data.dtype == np.float32
    assert np.isfinite(volume.data).all()
    assert by_name(name).ndim == 3


def test_names_are_complete() -> None:
    assert phantoms.names() == ["marschner-lobb", "sphere", "polynomial", "checker", "box"]


@pytest.mark.parametrize("size", [1, *BAD_COUNTS, (4, 4), (4, 4, 4, 4), (4, 4, 0), (4, 4, 2.5), (4, True, 4)], ids=repr)
@pytest.mark.parametrize("name", phantoms.names())
def test_bad_sizes_are_rejected(name: str, size: object) -> None:
    make = getattr(phantoms, name.replace("-", "_"))
    if name == "checker" and type(size) is int and size == 1:
        assert make(1).shape == (1, 1, 1)
        return
    with pytest.raises(OptionError, match="size must be"):
        make(size)


@pytest.mark.parametrize("bad", ["", "cube", "sphere:", "sphere:x", "sphere:4,4", "sphere:0", "Sphere", 3])
def test_bad_names_are_rejected(bad: object) -> None:
    with pytest.raises(OptionError):
        by_name(bad)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "call",
    [
        lambda: marschner_lobb(4, alpha=-1),
        lambda: marschner_lobb_function([1, 2]),
        lambda: marschner_lobb_gradient(3.0),
        lambda: phantoms.sphere(4, 0),
        lambda: phantoms.polynomial(4, degree=10),
        lambda: phantoms.polynomial(4, degree=1.5),
        lambda: phantoms.polynomial(4, coefficients=[1, 2]),
        lambda: phantoms.polynomial(4, coefficients=[[[np.nan]]]),
        lambda: phantoms.polynomial(4, seed=-1),
        lambda: phantoms.polynomial(4, coefficients="a"),
        lambda: phantoms.checker(4, 3),
    ],
)
def test_bad_parameters_are_rejected(call) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(OptionError):
        call()


@pytest.mark.parametrize(
    ("call", "bad"),
    every(
        alpha=(lambda v: marschner_lobb(4, alpha=v), BAD_NUMBERS),
        f_m=(lambda v: marschner_lobb(4, f_m=v), BAD_NUMBERS),
        radius=(lambda v: phantoms.sphere(4, v), BAD_NUMBERS),
        seed=(lambda v: phantoms.polynomial(4, seed=v), BAD_WHOLE),
        period=(lambda v: phantoms.checker(4, v), BAD_COUNTS),
        points=(marschner_lobb_function, BAD_REALS),
    ),
)
def test_bad_values_are_rejected(call: Any, bad: Any) -> None:
    with pytest.raises(OptionError):
        call(bad)


@pytest.mark.parametrize("size", [10**5, 10**7, 10**30, (10**5, 10**5, 10**5)])
@pytest.mark.parametrize("name", phantoms.names())
def test_sizes_beyond_memory_are_rejected(name: str, size: object) -> None:
    with pytest.raises(OutOfMemoryError, match="out of memory: size must give at most"):
        getattr(phantoms, name.replace("-", "_"))(size)


def test_phantoms_that_do_not_fit_are_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise MemoryError("1 GiB")

    monkeypatch.setattr(phantoms, "marschner_lobb_function", full)
    with pytest.raises(OutOfMemoryError, match=r"out of memory: a phantom must fit .*1 GiB"):
        marschner_lobb(4)
