"""The min-max pyramid: bounds of the reconstructed function over blocks of cells, for empty-space skipping.

The host side of minmax.cl. In a cell the function is a polynomial along each axis, whose Bernstein coefficients are
weighted sums of the cell's taps; the function lies in their convex hull (section 4.1 of the paper, for any filter of the
table). Blocks of the finest level have an edge of `BLOCK` samples, and of each next level twice that.
"""

from __future__ import annotations

import itertools
import math
import threading
from collections.abc import Callable
from fractions import Fraction
from functools import lru_cache
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clvol.base.uniform import FLOAT, INT, Block
from clvol.device.program import LANES
from clvol.spline.build import literals, spared_taps
from clvol.spline.evaluator import DIRECT
from clvol.spline.lease import release

if TYPE_CHECKING:
    from clvol.base.uniform import Values
    from clvol.filter.filter import Filter
    from clvol.spline.build import DefineDict
    from clvol.spline.coefficients import Coefficients
    from clvol.spline.evaluator import Evaluator
    from clvol.volume.volume import Volume

__all__ = ["BLOCK", "MAX_LEVELS", "MAX_SIDES", "MINMAX", "Cell", "MinMax", "bernstein", "bytes_beside", "minmax_block"]

Cell: TypeAlias = tuple[int, int, int]

BLOCK = 4  # samples along an edge of a finest block
MAX_LEVELS = 12
MAX_SIDES = 8  # values, of side_cells
MINMAX = Block(
    "minmax_block",
    margin=FLOAT,
    skipping=INT,
    levels=INT,
    blocks=(INT, 3),
    level_at=(INT, MAX_LEVELS),
    slopes_at=INT,  # where bounds of slopes begin; 0: there are none
    slope_scale=FLOAT,
)
_HULL_TAPS, _HULL_DEGREE = 6, 5  # wider filters would have thousands of control points for each cell
_EPSILON = 2.0**-23
_PAD_LIMIT = 0.01
_TINIEST = 2.0**-126  # the smallest normal float32; devices may flush smaller numbers to zero
_BLOCKS_A_LAUNCH = 1 << 15  # so that a launch takes less than a quarter of a second


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
def _defines(filter: Filter, blur: float, names: bool) -> DefineDict:
    """The `#define`s of minmax.cl for a filter evaluated at positions with errors up to `blur`; or for `names`, never blended."""
    taps, degree = filter.support, filter.degree
    weights = filter.weights(np.linspace(0, 1, 4097))
    sums = weights.sum(0)
    lebesgue, low, high = float(np.abs(weights).sum(0).max()), float(sums.min()), float(sums.max())
    if not (filter.exact and filter.sums_to_one):
        # a thousandth covers the maxima between the 4097 points
        lebesgue, low, high = 1.001 * lebesgue, low - 0.001 * abs(low), high + 0.001 * abs(high)
    products = [a * b * c for a, b, c in itertools.combinations_with_replacement((low, high), 3)]
    rows = bernstein(filter)
    # Rounding, relative to the largest tap. A weight is a sum of degree + 1 products, so its error is their size times
    # degree + 2 roundings. A value sums taps times weights along three axes with a rounding a tap; along each axis the
    # error of the weights is multiplied by the largest sum of the weights of the other two. A control point likewise. Along a ray
    # a weight's coefficients take three sums of as many terms, and each of theirs sums all taps times degree + 1 twice.
    size = float(np.abs(filter.matrix).sum())
    hull = float(np.abs(rows).sum(-1).max())
    point = 3 * ((degree + 2) * size + taps + 2) * lebesgue**2 + 3 * (taps + 2) * hull**3
    along = 3 * (3 * degree + 2) * size * hull**2 + (taps + 2 * taps * (degree + 1) + 2) * hull**3
    pad = _EPSILON * max(point, along + 3 * (taps + 2) * hull**3)
    if pad > _PAD_LIMIT:
        pad = 1e38  # the weights are mostly rounding errors: no bounds
    shared = degree > 0 and np.allclose(np.append(rows[-1], 0), np.insert(rows[0], 0, 0), rtol=0, atol=1e-12)
    return {
        "BLOCK": BLOCK * filter.scale,
        "TAPS": taps,
        "HULL": int(taps <= _HULL_TAPS and degree <= _HULL_DEGREE and not names),
        "NAMES": int(names),
        "SPARED": spared_taps(filter) if names else 0,
        "CONTROLS": degree + 1,
        "SHARED": int(shared),
        "BERNSTEIN": literals(rows),
        "SUM_LOW": min(products),
        "SUM_HIGH": max(products),
        "LEBESGUE": lebesgue**3,
        "PAD_SIZE": pad,
        "PAD_SPREAD": 3 * blur * lebesgue**2,
        "STEEP_PAD": 6.0 * max(1, degree),  # differences of two control points, and gradients as sums of taps
        "PAD_TINY": _TINIEST * 4 * (taps + 2) * (1 + lebesgue + lebesgue**2 + hull + hull**2),
        "LANES": LANES,
        "COORD_DOUBLE": 0,
    }


class MinMax:
    """The min-max pyramid of a 3-D volume's coefficients, on their device.

    Texture units are less exact than arithmetic, so bounds for an evaluator that uses them are wider. `part` is the first cell
    and past the last, along x, y and z; a cell is numbered by the index of its first tap among the stored coefficients.

    `buffer` holds (min, max) as float2 for every block, [z, y, x], the finest level first; `offsets` are the starts of the levels
    in it, in blocks. `blocks` are those along (x, y, z) on the finest level; halved, rounded up, on each next level. `first` is
    the first cell. `names`: bounds are of the names among the taps, exactly. `slopes`: behind all levels are the same levels of
    (min, max) of the magnitudes of gradients times the volume's mean spacing, from `slopes_at` on; 0 if the filter or the evaluator
    gives no bounds of them.
    """

    def __init__(
        self,
        coefficients: Coefficients,
        evaluator: Evaluator,
        part: tuple[Cell, Cell] | None = None,
        *,
        names: bool = False,
        slopes: bool = False,
    ) -> None:
        self.coefficients = coefficients
        device, scale, support = coefficients.device, coefficients.filter.scale, coefficients.filter.support
        blur = 0.0
        if evaluator.paired:
            # paired fetches round positions; a texture unit, to some bits of a texel
            blur = max(coefficients.shape) * 2.0**-22 + (2.0**-device.sampler_bits if evaluator.image else 0.0)
        cells = BLOCK * scale
        past = tuple(n - support + 1 for n in coefficients.shape[::-1])
        self.first, past = part or ((0, 0, 0), (past[0], past[1], past[2]))
        x, y, z = (max(1, -(-(b - a) // cells)) for a, b in zip(self.first, past, strict=True))
        sizes = [(x, y, z)]
        while max(sizes[-1]) > 1 and len(sizes) < MAX_LEVELS:
            x_, y_, z_ = sizes[-1]
            sizes.append((-(-x_ // 2), -(-y_ // 2), -(-z_ // 2)))
        self.blocks, self._coarsest = sizes[0], sizes[-1]
        counts = [math.prod(size) for size in sizes]
        self.offsets = tuple(int(n) for n in np.cumsum([0, *counts[:-1]]))
        defines = _defines(coefficients.filter, blur, names)
        self._hull = bool(defines["HULL"])
        self.slopes_at = sum(counts) if slopes and self._hull and coefficients.filter.degree > 0 and not evaluator.paired else 0
        self.buffer = device.buffers.allocate(8 * (sum(counts) + self.slopes_at))
        self._built = device.build("spline/slopes.cl" if self.slopes_at else "spline/minmax.cl", defines)
        self._lock = threading.RLock()  # a signal handler may re-enter
        self._sides: tuple[tuple[float, ...], Any] | None = None
        try:
            self._over_blocks("minmax_cells", self.buffer)
            if self.slopes_at:
                self._over_blocks("slope_cells", self.buffer, np.int32(self.slopes_at), _metric(coefficients))
            for begin in {0, self.slopes_at}:
                levels = [np.array([*size, begin + at], np.int32) for size, at in zip(sizes, self.offsets, strict=True)]
                with device.errors:
                    merge = self._built.kernel("minmax_blocks")
                    for finer, coarser in itertools.pairwise(levels):
                        merge(device.queue, tuple(int(n) for n in coarser[1:3]), device.alone(2), self.buffer, finer, coarser)
            device.finish()
        except BaseException:
            self.release()
            raise

    def extremes(self) -> tuple[float, float]:
        """Bounds of all values, in stored units."""
        count = self.offsets[-1] + math.prod(self._coarsest)
        with self.coefficients.device.buffers.mapped(self.buffer, (count, 2), write=False) as ends:
            coarsest = ends[self.offsets[-1] :]
            return float(coarsest[:, 0].min()), float(coarsest[:, 1].max())

    def sides(self, values: tuple[float, ...], progress: Callable[[float], object] | None = None) -> Any:
        """Whether the function may have one of up to `MAX_SIDES` values in each cell, and whether it is above the first, in the
        format of sides.cl: 16 bytes for 64 cells.

        The result is cached until other values are requested. `progress` is called with the fraction done, and may raise.
        """
        with self._lock:
            if self._sides is None or self._sides[0] != values:
                self._sides = None  # not two at a time
                self._sides = (values, self._sides_of(values, progress))
            return self._sides[1]

    def _sides_of(self, values: tuple[float, ...], progress: Callable[[float], object] | None) -> Any:
        coefficients, device = self.coefficients, self.coefficients.device
        buffer = device.buffers.allocate(2 * math.prod(self.blocks) * (BLOCK * coefficients.filter.scale) ** 3 // 8)
        sought = np.zeros(MAX_SIDES, np.float32)
        sought[: len(values)] = values
        self._over_blocks("side_cells", self.buffer, sought, np.int32(len(values)), buffer, progress=progress)
        return buffer

    def _over_blocks(self, name: str, *arguments: Any, progress: Callable[[float], object] | None = None) -> None:
        """Run a kernel over all blocks of the finest level, in short launches."""
        coefficients, device, (x, y, z) = self.coefficients, self.coefficients.device, self.blocks
        cells = BLOCK * coefficients.filter.scale
        across = -(-x // (LANES // cells)) if self._hull else x  # work-items along x
        deep = max(1, _BLOCKS_A_LAUNCH // (x * y))
        with device.errors:
            kernel = self._built.kernel(name)
            for first in range(0, z, deep):
                kernel(
                    device.queue,
                    (across, y, min(deep, z - first)),
                    (1, 1, 1),
                    coefficients.argument(DIRECT),
                    coefficients.extent,
                    np.array([*self.first, 0], np.int32),
                    np.array([*self.blocks, first], np.int32),
                    *arguments,
                )
                device.finish()
                if progress:
                    progress(min(1.0, (first + deep) / z))

    def release(self) -> None:
        """Free the device's memory."""
        with self._lock:
            memory = self.buffer, self._sides and self._sides[1]
            self.buffer = self._sides = None
        release(self.coefficients.device, *memory)


def _metric(coefficients: Coefficients) -> NDArray[np.float32]:
    """The products of gradients along the axes of the stored grid, xx, yy, zz, and the magnitudes of xy, xz, yz, of `MinMax`."""
    volume = coefficients.volume
    across = volume.world_to_index_matrix * (volume.mean_spacing * coefficients.filter.scale)
    products = across @ across.T
    aside = np.abs([products[0, 1], products[0, 2], products[1, 2]])
    return np.array([*np.diag(products), *aside, 0, 0], np.float32)


def bytes_beside(shape: tuple[int, ...]) -> int:
    """An upper bound of the bytes of a pyramid without slopes for `shape` stored coefficients, and of the sides of a surface."""
    cells = math.prod(shape)
    return cells * 8 // BLOCK**3 * 8 // 7 + cells // 4


def minmax_block(minmax: MinMax | None, volume: Volume, rounding: float, slope: float = 0.0) -> Values:
    """The ray loop's parameters of a volume's pyramid; without one it skips nothing. Positions err by less than `rounding`.

    `slope` is what the loop multiplies gradients by, which are in stored units per world unit.
    """
    if minmax is None:
        return np.zeros((), MINMAX.dtype)
    level_at = np.zeros(MAX_LEVELS, np.int32)
    level_at[: len(minmax.offsets)] = minmax.offsets
    # rounding errors of positions are up to a few millionths of the volume's size; the rest is reserve
    margin = max(0.01 + 1e-6 * max(volume.size), rounding)
    return MINMAX(
        margin=margin,
        skipping=1,
        levels=len(minmax.offsets),
        blocks=minmax.blocks,
        level_at=level_at,
        slopes_at=minmax.slopes_at,
        slope_scale=slope / volume.mean_spacing,
    )
