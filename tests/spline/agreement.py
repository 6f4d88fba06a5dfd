"""How far values, gradients and Hessians by the kernels may be from the reference's, and where they are compared.

Without pytest, for `bench.parity` too.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clvol import reference
from clvol.device import Device
from clvol.filter.table import as_filter
from clvol.spline.field import sample
from clvol.volume.volume import Volume

# Greatest error allowed, in units of the greatest coefficient (and, for derivatives, of the reciprocal
# spacing and its square: the least is 0.7). Measured on PoCL, buffers: values 3.2e-7, gradients 9e-7,
# Hessians 3.2e-6; images: values 6e-7, gradients 7e-7, as their sampler rounds its positions.
VALUES = 5e-6
TOLERANCE = {0: VALUES, 1: 5e-6, 2: 1.5e-5}
# A texture unit has few bits of fraction (device.sampler_bits): it errs by that of the differences it blends.


def direction(d: int) -> NDArray[np.float64]:
    """Oblique and left-handed in 3-D, and no proper rotation: a transposed matrix would be detected."""
    return np.linalg.qr(np.random.default_rng(d).normal(size=(d, d)))[0]


def volume_of(shape: tuple[int, ...], seed: int = 0) -> Volume:
    d = len(shape)
    data = np.random.default_rng(seed).normal(size=shape).astype(np.float32)
    return Volume(data, (0.7, 1.3, 2.1)[:d], (3.0, -5.0, 7.0)[:d], direction(d))


def points_of(volume: Volume, seed: int = 0) -> NDArray[np.float64]:
    """Index positions within, outside near and far, and just inside and outside the faces; none at a knot."""
    rng, size, d = np.random.default_rng(seed), np.array(volume.size), volume.ndim
    within = rng.uniform(-0.5, size - 0.5, (120, d))
    near = rng.uniform(-2 * size - 12, 3 * size + 12, (120, d))
    face = within[:40].copy()
    face[np.arange(40), rng.integers(0, d, 40)] = -0.5
    face[20:] = size - 1 - face[20:]
    face += rng.choice([-1e-5, 1e-5], face.shape)
    index: NDArray[np.float64] = np.concatenate([within, near, face])
    index += 1e-3 * (np.abs(2 * index - np.round(2 * index)) < 1e-6)  # half samples are knots of odd filters
    return index


def allowed(device: Device, name: str, path: tuple[str, str], derivative: int) -> float:
    row = as_filter(name)
    # a derivative of a polynomial on [0, 1] may be 2 n² times as great (Markov), and so may a fit's error
    tolerance: float = TOLERANCE[derivative] + 2 * row.fit_error * (2 * row.degree**2) ** derivative
    if path in (("eight-fetch", "image"), ("paired", "image")) and row.pairable(0) and derivative < 2:
        tolerance += 4 * 2.0 ** -float(device.sampler_bits)
    return tolerance


def errors(
    device: Device, volume: Volume, points: NDArray[np.float64], name: str, rule: str, derivative: int, path: tuple[str, str]
) -> NDArray[np.float64]:
    """Differences to the reference, in the units of `TOLERANCE`."""
    with device.limited(evaluator=path[0], fetch=path[1]):
        got = sample(volume, points, name, rule, derivative, device=device)
    wanted = reference.sample(volume, points, name, rule, derivative)
    assert got.shape == wanted.shape == points.shape[:-1] + (volume.ndim,) * derivative
    assert got.dtype == np.float32
    largest = float(np.abs(reference.prefilter(volume.data, name, rule)).max())
    return np.abs(got - wanted) / (largest / min(volume.spacing) ** derivative)
