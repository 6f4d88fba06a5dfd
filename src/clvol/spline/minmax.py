"""Least and greatest values of the reconstructed function over blocks of cells: what space skipping rests on.

The host side of bounds.cl and skip.cl. In a cell the function is, along each axis, a polynomial whose Bernstein
coefficients are weighted sums of the cell's taps; it lies in their convex hull (section 4.1 of the paper, put to
work for any filter of the table). The finest level holds blocks of `BLOCK` samples along an edge, each next one
blocks of twice that.
"""

from __future__ import annotations

import itertools
import math
from fractions import Fraction
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from clvol.filter import Filter
from clvol.program import LANES
from clvol.spline.coefficients import Coefficients
from clvol.spline.evaluator import Evaluator
from clvol.uniform import FLOAT, INT, Block, Values
from clvol.volume import Volume

__all__ = ["BLOCK", "MAX_LEVELS", "MINMAX", "Bounds", "bernstein", "minmax_block"]

BLOCK = 4  # samples along an edge of the finest blocks
MAX_LEVELS = 12
MINMAX = Block("minmax_block", margin=FLOAT, skipping=INT, levels=INT, blocks=(INT, 3), level_at=(INT, MAX_LEVELS))
_HULL_TAPS, _HULL_DEGREE = 6, 5  # of wider filters there would be thousands of control points a cell
_EPSILON = 2.0**-23
_PAD_LIMIT = 0.01
_BLOCKS_A_LAUNCH = 1 << 15  # a launch should not run longer than a quarter of a second


@lru_cache(maxsize=256)
def bernstein(filter: Filter) -> NDArray[np.float64]:
    """Weights of the taps in each Bernstein coefficient of a cell, along one axis; shape (degree + 1, taps).

    A polynomial ``sum a[k] t**k`` on 0..1 has the Bernstein coefficients ``sum over k <= j of a[k] C(j, k) / C(n, k)``.
    """
    n = filter.degree
    shares = [[Fraction(math.comb(j, k), math.comb(n, k)) for k in range(n + 1)] for j in range(n + 1)]
    rows = [[sum(s * a for s, a in zip(row, tap, strict=True)) for tap in filter.taps] for row in shares]
    return np.array(rows, dtype=np.float64)


@lru_cache(maxsize=256)
def _defines(filter: Filter, blur: float) -> dict[str, str | int | float]:
    """What bounds.cl needs to know of a filter, evaluated with sampler positions off by up to `blur`."""
    taps, degree = filter.support, filter.degree
    weights = filter.weights(np.linspace(0, 1, 4097))
    sums = weights.sum(0)
    lebesgue, least, greatest = float(np.abs(weights).sum(0).max()), float(sums.min()), float(sums.max())
    if not (filter.exact and filter.sums_to_one):
        # a thousandth covers what lies between 4097 points
        lebesgue, least, greatest = 1.001 * lebesgue, least - 0.001 * abs(least), greatest + 0.001 * abs(greatest)
    products = [a * b * c for a, b, c in itertools.combinations_with_replacement((least, greatest), 3)]
    rows = bernstein(filter)
    # Rounding, relative to the greatest tap. A weight is a sum of degree + 1 products, which errs by their sizes and
    # by degree + 2 roundings; a value sums taps times weights along three axes, with a rounding a tap: along each the
    # error of the weights is multiplied by what the weights of the other two may sum to. A control point likewise.
    size = float(np.abs(filter.matrix).sum())
    hull = float(np.abs(rows).sum(-1).max())
    pad = _EPSILON * (3 * ((degree + 2) * size + taps + 2) * lebesgue**2 + 3 * (taps + 2) * hull**3)
    if pad > _PAD_LIMIT:
        pad = 1e38  # weights that are mostly rounding: bounds without end
    shared = degree > 0 and np.allclose(np.append(rows[-1], 0), np.insert(rows[0], 0, 0), rtol=0, atol=1e-12)
    return {
        "BLOCK": BLOCK * filter.scale,
        "TAPS": taps,
        "HULL": int(taps <= _HULL_TAPS and degree <= _HULL_DEGREE),
        "CONTROLS": degree + 1,
        "SHARED": int(shared),
        "BERNSTEIN": "{" + ",".join("{" + ",".join(f"{w:.9e}f" for w in row) + "}" for row in rows) + "}",
        "SUM_LOW": min(products),
        "SUM_HIGH": max(products),
        "LEBESGUE": lebesgue**3,
        "PAD_SIZE": pad,
        "PAD_SPREAD": 3 * blur * lebesgue**2,
        "LANES": LANES,
        "COORD_DOUBLE": 0,
    }


class Bounds:
    """The hierarchy of bounds of a volume's coefficients, on their device.

    Parameters
    ----------
    held : Coefficients
        Of a volume with 3 axes.
    path : Evaluator
        How they will be evaluated: a texture unit is less exact than arithmetic.

    Attributes
    ----------
    buffer : Buffer
        (least, greatest) as float2 for every block, [z, y, x], the finest level first.
    blocks : tuple of int
        Blocks along (x, y, z) on the finest level; halved, rounded up, on each next one.
    offsets : tuple of int
        Where each level begins.
    """

    def __init__(self, held: Coefficients, path: Evaluator) -> None:
        self.held = held
        device = held.device
        coefficients = held.argument(Evaluator(eight_fetch=False, image=False))
        blur = 0.0
        if path.eight_fetch:
            # pairs of taps are read at a position that is rounded, in a texture unit to some bits of a texel
            blur = max(held.shape) * 2.0**-22 + (2.0**-device.sampler_bits if path.image else 0.0)
        cells = BLOCK * held.filter.scale
        z, y, x = (max(1, -(-(n - held.filter.support + 1) // cells)) for n in held.shape)
        sizes = [(x, y, z)]
        while max(sizes[-1]) > 1 and len(sizes) < MAX_LEVELS:
            sizes.append(tuple(-(-n // 2) for n in sizes[-1]))  # type: ignore[arg-type]  # of three, as the last
        self.blocks = sizes[0]
        counts = [math.prod(size) for size in sizes]
        self.offsets = tuple(int(n) for n in np.cumsum([0, *counts[:-1]]))
        self.buffer = device.allocate(8 * sum(counts))
        defines = _defines(held.filter, blur)
        built = device.build("spline/minmax.cl", defines)
        levels = [np.array([*size, at], np.int32) for size, at in zip(sizes, self.offsets, strict=True)]
        across = -(-x // (8 // cells)) if defines["HULL"] else x  # work-items along x
        deep = max(1, _BLOCKS_A_LAUNCH // (x * y))
        with device.errors:
            bound = built.kernel("bound_cells")
            for first in range(0, z, deep):
                bound(
                    device.queue,
                    (across, y, min(deep, z - first)),
                    (1, 1, 1),
                    coefficients,
                    held.extent,
                    levels[0],
                    self.buffer,
                    global_offset=(0, 0, first),
                )
                device.finish()
            merge = built.kernel("bound_blocks")
            for finer, coarser in itertools.pairwise(levels):
                merge(device.queue, tuple(int(n) for n in coarser[:3]), None, self.buffer, finer, coarser)
        device.finish()

    def release(self) -> None:
        """Free the device's memory."""
        self.buffer.release()


def minmax_block(minmax: Bounds | None, volume: Volume) -> Values:
    """What the ray loop reads of the pyramid of a volume; without one it skips nothing."""
    if minmax is None:
        return MINMAX(margin=0.0, skipping=0, levels=0, blocks=0, level_at=0)
    level_at = np.zeros(MAX_LEVELS, np.int32)
    level_at[: len(minmax.offsets)] = minmax.offsets
    # positions are rounded by up to a few millionths of the volume's size; the rest is reserve
    margin = 0.01 + 1e-6 * max(volume.size)
    return MINMAX(margin=margin, skipping=1, levels=len(minmax.offsets), blocks=minmax.blocks, level_at=level_at)
