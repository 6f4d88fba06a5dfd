"""The reference on a lattice, one axis at a time, compared with the reference point by point."""

from __future__ import annotations

import numpy as np
import pytest

from clvol import reference
from clvol.base.errors import ClvolError
from clvol.filter.table import filters
from tests.cases import RULES, SMOOTHED

DATA = np.random.default_rng(0).normal(size=(3, 8))
Y, X = np.array([-0.5, 0.2, 1.0, 2.5]), np.array([-0.5, 0.0, 3.3, 4.5, 6.9, 7.5])
POINTS = np.stack(np.meshgrid(Y, X, indexing="ij")[::-1], -1)


@pytest.mark.one_in(3)
@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("name", [*filters(), *SMOOTHED, "bspline3(0.1,0)"])
def test_it_is_sampling_at_each_point(name: str, rule: str) -> None:
    np.testing.assert_allclose(reference.lattice(DATA, [Y, X], name, rule), reference.sample(DATA, POINTS, name, rule), atol=1e-12)
    slopes = reference.sample(DATA, POINTS, name, rule, derivative=1)
    np.testing.assert_allclose(reference.lattice(DATA, [Y, X], name, rule, (0, 1)), slopes[..., 0], atol=1e-11)
    np.testing.assert_allclose(reference.lattice(DATA, [Y, X], name, rule, (1, 0)), slopes[..., 1], atol=1e-11)
    bends = reference.sample(DATA, POINTS, name, rule, derivative=2)
    np.testing.assert_allclose(reference.lattice(DATA, [Y, X], name, rule, (1, 1)), bends[..., 0, 1], atol=1e-10)


@pytest.mark.parametrize("shape", [(5,), (1, 4, 2)])
def test_any_number_of_axes(shape: tuple[int, ...]) -> None:
    data = np.random.default_rng(1).normal(size=shape)
    samples = [np.arange(n) for n in shape]
    np.testing.assert_allclose(reference.lattice(data, samples), data, atol=1e-12)


@pytest.mark.parametrize(
    "call",
    [
        lambda: reference.lattice(DATA, [Y]),
        lambda: reference.lattice(DATA, [Y, X], orders=[0]),
        lambda: reference.lattice(DATA, [Y, [8.0]]),
        lambda: reference.lattice(DATA, [Y, [[0.0]]]),
        lambda: reference.lattice(DATA, [Y, [np.nan]]),
        lambda: reference.lattice(DATA, [Y, X], orders=[0, 3]),
        lambda: reference.lattice([np.nan], [[0.0]]),
    ],
)
def test_bad_input_is_rejected(call) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ClvolError):
        call()
