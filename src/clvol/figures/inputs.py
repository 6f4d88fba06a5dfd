"""Inputs of the figures: known functions, a photograph, hard edges."""

from __future__ import annotations

import numpy as np

from clvol.base.arrays import Array
from clvol.base.checks import whole
from clvol.volume.volume import Volume

__all__ = ["photograph", "rings", "zone_plate", "zone_plate_image"]

_LUMA = (0.299, 0.587, 0.114)
_REACH = 0.75  # share of the Nyquist frequency at distance 1 from the zone plate's centre


def rings(points: Array) -> Array:
    """The Marschner–Lobb function on the plane z = 0, at points (N, 2)."""
    from clvol.phantoms import marschner_lobb_function

    return marschner_lobb_function(np.concatenate([points, np.zeros((*points.shape[:-1], 1))], -1))


def zone_plate(points: Array, size: int) -> Array:
    """``(1 + cos(a r²)) / 2`` at points (N, d): with `size` samples along [-1, 1], three quarters of Nyquist at r = 1."""
    rate = _REACH * np.pi * (size - 1) / 4  # the phase's slope is 2 a r, a sample 2 / (size - 1)
    return np.asarray((1 + np.cos(rate * (points**2).sum(-1))) / 2)


def zone_plate_image(pixels: int, size: int) -> Array:
    """The zone plate on [-1, 1]², in a picture."""
    x = np.linspace(-1, 1, pixels)
    return zone_plate(np.stack(np.meshgrid(x, x), -1), size)


def photograph(size: int = 512) -> tuple[Volume, str]:
    """A grey picture, 0 to 1, of at most `size` pixels along each side, and its name.

    It is the public-domain portrait that comes with matplotlib; without it, a drawing of disks, bars and a gradient.
    """
    size = whole("size of a photograph", size, 16)
    try:
        import imageio.v3 as iio
        from matplotlib.cbook import get_sample_data

        grey = np.asarray(iio.imread(get_sample_data("grace_hopper.jpg", asfileobj=False)), np.float64) @ _LUMA / 255
    except OSError:  # some distributions omit matplotlib's sample data
        return Volume(_drawn(size)), "generated picture"
    top = (grey.shape[0] - min(grey.shape)) // 8  # the face, not the chest
    square = grey[top : top + min(grey.shape), : min(grey.shape)]
    first = max(0, (len(square) - size) // 2)
    return Volume(square[first : first + size, first : first + size]), "photograph"


def _drawn(size: int) -> Array:
    """Edges at all angles, thin lines, and smooth shading."""
    y, x = np.meshgrid(*(np.linspace(-1, 1, size),) * 2, indexing="ij")
    r, angle = np.hypot(x, y), np.arctan2(y, x)
    picture = 0.35 + 0.25 * y
    picture = np.where(r < 0.8, 0.5 + 0.5 * np.sign(np.sin(18 * angle)), picture)
    picture = np.where(r < 0.35, 0.8 - 0.6 * (x - 0.1) ** 2 - r, picture)
    return np.asarray(np.where(np.abs(x + y - 1.2) < 0.01, 1.0, picture))
