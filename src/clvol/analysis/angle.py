"""The angle between gradients and true ones: one definition, wherever a "mean angle" is printed."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from clvol.base.arrays import Array, reals
from clvol.base.checks import number
from clvol.base.errors import OptionError

__all__ = ["angle_weights", "angles", "mean_angle", "weighted_quantile"]

_LEAST = 0.01  # of the largest true gradient: below it no direction can be seen
_NOISE = 5.0  # standard deviations: the length of three noisy components exceeds it once in 65 000 places


def mean_angle(gradients: ArrayLike, truth: ArrayLike, sigma: float = 0.0, *, faces: bool = False) -> float | None:
    """The mean angle in degrees between gradients and the true ones.

    The mean of `angles`, weighted by `angle_weights`: where the true gradient is known without noise it is the plain mean
    over the places at which that gradient is at least a hundredth of the largest; where it is a noisy one (that of a scan),
    only places at which it stands out of the noise count, and the more the further it does. So an angle is not that of
    the empty space around an object.

    Parameters
    ----------
    gradients, truth : array-like, shape (..., d)
        Finite gradients, or normals; lengths of `truth` are compared, those of `gradients` do not matter.
    sigma : float
        Standard deviation of the noise of each component of `truth`; 0 for a known function.
    faces : bool
        Take a direction and its opposite as one, as surfaces do that are lit on both faces.

    Returns
    -------
    float or None
        None if no true gradient counts.

    Raises
    ------
    OptionError
        Shapes that differ, or `sigma` negative or not finite.
    """
    weights = angle_weights(truth, sigma)
    between = angles(gradients, truth, faces=faces)
    total = float(weights.sum())
    return float((weights * between).sum() / total) if total > 0 else None


def angles(gradients: ArrayLike, truth: ArrayLike, *, faces: bool = False) -> Array:
    """Degrees between gradients and true ones, shape (...); a gradient of length zero has no direction and counts as 90°.

    Parameters
    ----------
    gradients, truth : array-like, shape (..., d)
    faces : bool
        Take a direction and its opposite as one.

    Raises
    ------
    OptionError
        Shapes that differ.
    """
    a, b = _directions(gradients), _directions(truth)
    if a.shape != b.shape:
        raise OptionError(f"gradients must have the shape of the true ones, {b.shape}; got {a.shape}")
    cosine = (a * b).sum(-1)
    return np.asarray(np.degrees(np.arccos(np.clip(np.abs(cosine) if faces else cosine, -1, 1))))


def angle_weights(truth: ArrayLike, sigma: float = 0.0) -> Array:
    """How much the angle at each place counts, 0 to 1, from the lengths of the true gradients (..., d); shape (...).

    ``1 - (5 sigma / |g|)²``, but 0 where that is negative, and 0 where ``|g|`` is less than a hundredth of the largest or no
    gradient at all. Without noise it is 1 for all others. The form is that of an empirical Wiener gain: the part of |g|²
    that is surely none of the noise's.

    Raises
    ------
    OptionError
        `sigma` is negative or not finite.
    """
    sigma = number("sigma", sigma, minimum=0)
    true = reals("truth", truth)
    largest = float(np.abs(true).max(initial=0.0))
    if largest == 0:
        return np.zeros(true.shape[:-1])
    lengths = np.linalg.norm(true / largest, axis=-1)  # so that no square over- or underflows
    with np.errstate(divide="ignore"):
        gain = 1 - (_NOISE * (sigma / largest) / lengths) ** 2 if sigma else np.ones_like(lengths)
    return np.where(lengths >= _LEAST * lengths.max(), np.maximum(gain, 0.0), 0.0)


def weighted_quantile(values: Array, weights: Array, share: float) -> float:
    """The quantile of values that count by their weights; with equal weights that of `numpy.quantile`."""
    counted = weights > 0
    order = np.argsort(values[counted])
    ordered, heavy = values[counted][order], weights[counted][order]
    # where each value stands between the first (0) and the last (1): half of it and half of the next one apart
    place = np.concatenate([[0.0], np.cumsum((heavy[1:] + heavy[:-1]) / 2)])
    return float(np.interp(share * place[-1], place, ordered))


def _directions(vectors: ArrayLike) -> Array:
    """Unit vectors; zeros stay zeros."""
    given = reals("gradients", vectors)
    lengths = np.abs(given).max(-1, keepdims=True)
    given = np.divide(given, lengths, out=np.zeros_like(given), where=lengths > 0)
    lengths = np.linalg.norm(given, axis=-1, keepdims=True)
    return np.asarray(np.divide(given, lengths, out=np.zeros_like(given), where=lengths > 0))
