"""Angles between gradients: closed forms, and empty space, which must not count."""

from __future__ import annotations

import numpy as np
import pytest

from clvol.analysis.angle import angle_weights, angles, mean_angle, weighted_quantile
from clvol.base.errors import OptionError


def test_angles_match_plane_geometry() -> None:
    turn = np.radians([0.0, 1e-9, 30.0, 90.0, 135.0, 180.0])
    drawn = np.stack([np.cos(turn), np.sin(turn)], -1) * 7e-200
    np.testing.assert_allclose(angles(drawn, np.broadcast_to([2e150, 0.0], drawn.shape)), np.degrees(turn), atol=1e-6)
    np.testing.assert_allclose(angles(drawn, np.broadcast_to([1.0, 0.0], drawn.shape), faces=True)[3:], [90, 45, 0], atol=1e-6)
    assert angles([[0.0, 0.0, 0.0]], [[1.0, 2.0, 3.0]]).tolist() == [90.0]


def test_without_noise_the_mean_covers_all_nonzero_gradients() -> None:
    true = np.array([[1.0, 0.0], [0.02, 0.0], [0.009, 0.0], [0.0, 0.0]])
    drawn = np.array([[0.0, 1.0], [1.0, 1.0], [0.0, 1.0], [0.0, 1.0]])
    assert angle_weights(true).tolist() == [1, 1, 0, 0]
    assert mean_angle(drawn, true) == pytest.approx((90 + 45) / 2)
    assert mean_angle(drawn[3:], true[3:]) is None


def test_empty_space_does_not_count() -> None:
    """An edge known within 1° in 99 % of air, where the true gradient is noise."""
    rng = np.random.default_rng(0)
    sigma, places = 0.05, 200_000
    edge = np.arange(places) < places // 100
    true = np.where(edge[:, None], [3.0, 0.0, 0.0], 0.0) + rng.normal(0, sigma, (places, 3))
    drawn = np.where(edge[:, None], [np.cos(0.02), np.sin(0.02), 0.0], rng.normal(0, sigma, (places, 3)))
    assert mean_angle(drawn, true) == pytest.approx(85, abs=8)  # a plain mean sees only air
    assert mean_angle(drawn, true, sigma) == pytest.approx(1.8, abs=0.3)
    noise = mean_angle(drawn[~edge], true[~edge], sigma)
    assert noise is None or (angle_weights(true[~edge], sigma) > 0).sum() < 10


def test_weights_rise_above_the_noise() -> None:
    weights = angle_weights(np.array([[1.0], [2.0], [10.0], [100.0]]), 0.3)
    np.testing.assert_allclose(weights, [0, 1 - (1.5 / 2) ** 2, 1 - 0.15**2, 1 - 0.015**2], rtol=1e-12)


def test_quantiles_of_equal_weights_are_the_usual_ones() -> None:
    values = np.random.default_rng(1).normal(size=501)
    for share in (0.0, 0.25, 0.5, 0.95, 1.0):
        assert weighted_quantile(values, np.full(501, 0.3), share) == pytest.approx(np.quantile(values, share), rel=1e-12)
    assert weighted_quantile(np.array([1.0, 5.0]), np.array([0.0, 2.0]), 0.5) == 5.0


def test_input_without_an_angle_is_rejected() -> None:
    with pytest.raises(OptionError, match=r"shape of the true ones, \(1, 3\); got \(2, 3\)"):
        angles(np.ones((2, 3)), np.ones((1, 3)))
    for bad in (-1, np.nan, "a"):
        with pytest.raises(OptionError, match="sigma must be"):
            angle_weights(np.ones((1, 3)), bad)
