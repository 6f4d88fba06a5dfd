"""Missing samples: where they are, what replaces them, and which results they affect."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base import memory
from clvol.base.checks import number, one_of, suggests_options
from clvol.base.errors import DataError

if TYPE_CHECKING:
    from clvol.filter.filter import Filter

__all__ = ["EXTRAPOLATED", "Missing", "NanRule", "as_missing", "extrapolated", "filled_smoothly", "require_mask", "touching"]

NanRule: TypeAlias = Literal["error", "propagate", "local"]

_BAND: Final = 4  # samples from the nearest valid one: deeper ones affect the edge of a hole by 1/200 after a cubic prefilter
_EXACT: Final = 1e-200  # squared residual, in units of the largest sample, below which its products underflow
_EACH: Final = 4  # peak number of copies of the samples ...
_EACH_MISSING: Final = 100  # ... bytes per missing sample ...
_EACH_UNKNOWN: Final = 900  # ... and bytes per unknown of the linear system
_WINDOW: Final = 3  # samples to either side from which a plane is fitted, with the weights of a Gaussian of one sample; ...
_FLATTER: Final = 1e-3  # ... slopes that the samples hardly determine are kept small by this share of the total weight
_MEANS: Final = 2  # windows further out in which means are taken: behind them a cubic prefilter leaves 7e-6 of a step
EXTRAPOLATED: Final = _WINDOW * (1 + _MEANS)
"""How far from a sample the extrapolation depends on it."""
_BLOCK: Final = 64  # samples along an edge of those extrapolated at a time
_STEPS: Final = 20  # steps of conjugate gradients; the start is close: holes of 9 samples are within 2 % of the minimum


@suggests_options
@dataclass(frozen=True, eq=False)
class Missing:
    """How to treat samples that are NaN or infinite, or excluded by a mask.

    Parameters
    ----------
    rule : {"error", "propagate", "local"}
        - "error": raise an error.
        - "propagate": every result computed from one is NaN, as in arithmetic, whatever its weight. A prefilter
          computes each coefficient from all samples, so that a single missing sample makes every result NaN.
        - "local": missing samples are first replaced by a smooth fill, and only results whose kernel has a nonzero
          weight on one are NaN. All others equal those of the filled volume, bit for bit.
    mask : array-like of bool, optional
        Shape of the samples, True where one is missing, as in `numpy.ma`. Integers need a mask; floating samples that
        are not finite are missing as well.
    most : float
        For "local": the largest share of missing samples in a kernel whose result is kept, from the fill; 0 keeps no affected
        result, 1 every result. The share is the mean of the linearly interpolated mask over a box around the point, one
        sample narrower than the kernel: 1/2 along the edge of a large hole, 1/27 in the middle of a single sample for a cubic.

    Raises
    ------
    OptionError
        The rule is unknown, or the share is outside 0 to 1.
    DataError
        The mask is not boolean.

    Notes
    -----
    The fill minimises the sum of squared second differences along the axes, as a smoothing spline does, by 20 steps of
    conjugate gradients from linearly interpolated means of the valid samples in blocks of 2, 4, 8, ... . Missing samples more than
    4 samples from a valid one keep the start. Next to holes of 1, 3 and 9 samples, the rms error of a cubic spline outside the
    hole is 3e-7, 3e-6 and 2e-5 of the range of a smooth phantom (of the spline itself: 2e-6), and 1e-4, 3e-4 and 6e-4 for the
    Marschner-Lobb signal (of the spline itself: 2e-3).

    *In pictures* (`Renderer`, `render`, slices of `View`) missing samples are transparent, in every mode. A place is missing
    where the mask, 1 at missing samples and 0 at others, interpolated linearly between them, is more than 1/2: about half a
    voxel beyond the last sample that there is. For filters of one tap ("nearest") it is where the nearest sample is missing.
    Up to there the function is extrapolated: missing samples have the values of planes of least squares through the samples
    at most 3 away, so that no rim appears, and a linear function stays one. Surfaces are those of this function, without the
    parts at missing places: the edge of what is missing is no surface. Means are over what there is. Histograms, automatic
    isovalues and windows, estimates of noise and fitted cameras know the samples alone that are not missing. (Measured on
    balls of values with radii of 3 to 10 voxels: the outline is wrong in half as many pixels as with whole voxels, 2 to 3 %
    against 5 to 6 %; the edge lies 0.2 voxels off, in the median, against 0.3.) A `Field` with the rule "local" is drawn with
    its own fill, and cut in the same way, whatever share it allows; with a share of 1 nothing of it is missing. Volumes that
    are read by parts (`LazyVolume`) are drawn likewise, and samples of damaged chunks are missing in them: a `ClvolWarning` names
    the chunk. A mask of theirs excludes a sample of a lower resolution (`levels`) if it excludes any of those that it stands for.

    Examples
    --------
    >>> import clvol, numpy as np
    >>> samples = np.ones((8, 8, 8))
    >>> samples[4, 4, 4] = np.nan
    >>> with clvol.Field(samples, nan=clvol.Missing("local")) as field:
    ...     np.isnan(field([(1, 1, 1), (4, 4, 4)])).tolist()
    [False, True]
    """

    rule: NanRule = "local"
    mask: ArrayLike | None = None
    most: float = 0.0

    def __post_init__(self) -> None:
        if not isinstance(self.rule, str) or self.rule not in ("error", "propagate", "local"):
            raise one_of("nan", self.rule, ("error", "propagate", "local"))
        object.__setattr__(self, "most", number("most", self.most, minimum=0, maximum=1))
        if self.mask is not None:
            mask = np.asarray(self.mask)
            require_mask(mask.dtype, mask.shape, mask.shape)
            object.__setattr__(self, "mask", mask)

    def of(self, data: NDArray[Any]) -> NDArray[np.bool_] | None:
        """Mask of missing samples; None if there are none, or if the rule is "error".

        Raises
        ------
        DataError
            The shape of the mask differs from that of the samples, or the rule is "error" and the mask excludes some.
        """
        missing = None
        if self.mask is not None:
            missing = np.asarray(self.mask)
            require_mask(missing.dtype, missing.shape, data.shape)
        if self.rule == "error":
            if missing is not None and missing.any():
                raise DataError('the mask excludes samples, which nan="error" does not allow; nan may be "propagate" or "local"')
            return None
        if data.dtype.kind == "f":
            memory.require(2 * data.size, f"which of {data.size} samples are missing")
            kind = np.float64 if data.dtype.itemsize > 8 else data.dtype
            with np.errstate(over="ignore"):  # longdouble has a larger range than float64
                lost = ~np.isfinite(data.astype(kind, copy=False))
            missing = lost if missing is None else missing | lost
        return missing if missing is not None and missing.any() else None

    def filled(self, data: NDArray[Any], missing: NDArray[np.bool_]) -> NDArray[Any]:
        """Replace missing samples by the fill, or by any valid sample if no result shows it."""
        if self.rule == "local":
            return filled_smoothly(data, missing)
        valid = data[np.unravel_index(missing.argmin(), data.shape)]
        return np.where(missing, np.zeros_like(valid) if missing.all() else valid, data)


def require_mask(dtype: np.dtype[Any], shape: tuple[int, ...], of: tuple[int, ...]) -> None:
    """Raise `DataError` unless a mask is boolean and has the shape of the samples."""
    if dtype.kind != "b":
        raise DataError(f"mask must be boolean, True where a sample is missing; got {dtype}")
    if tuple(shape) != of:
        raise DataError(f"mask must have the shape of the samples, {of}; got {tuple(shape)}")


def as_missing(nan: str | Missing) -> Missing:
    """The treatment of a rule's name."""
    return nan if isinstance(nan, Missing) else Missing(nan)  # type: ignore[arg-type]  # checked by Missing


@lru_cache(maxsize=64)
def touching(filter: Filter, rule: NanRule) -> Filter:
    """The filter that gives the share of missing samples when applied to a mask, 1 where one is missing.

    It has the support of `filter`. For "local" it averages the linear interpolation over a box, one sample narrower; its
    weights are positive wherever a kernel of this support can be nonzero. For "propagate" all weights are equal.
    """
    from clvol.filter.filter import MAX_TAPS, Filter  # the import takes 0.1 s, which processes that read files can save

    by = filter.magnified_by
    taps = filter.support if by is None else min(MAX_TAPS, by.support + -(-filter.support // filter.scale))
    if rule == "propagate" or taps == 1:
        return Filter("taps", ((Fraction(1, taps),),) * taps)
    one = Fraction(1, taps - 1)
    return Filter("touching", ((one, -one), *((one, Fraction(0)),) * (taps - 2), (Fraction(0), one)))


# -- the fill ------------------------------------------------------------------------------------------------------


def filled_smoothly(data: NDArray[Any], missing: NDArray[np.bool_], *, roughly: bool = False) -> NDArray[np.floating[Any]]:
    """A copy with missing samples replaced by the fill of `Missing`; 0 if all are missing.

    Parameters
    ----------
    data : ndarray
        Of any number of axes.
    missing : ndarray of bool, the shape of `data`
        True where a sample is missing, whatever value `data` has there.
    roughly : bool
        Keep the start, the interpolated means of blocks: fast, and without the noise of an extrapolation.

    Returns
    -------
    ndarray of the dtype of `data`; float32 for integers of 8 and 16 bits, and float64 for wider ones
    """
    kind = data.dtype if data.dtype.kind == "f" else np.dtype(np.float32 if data.dtype.itemsize < 4 else np.float64)
    memory.require(
        _EACH * kind.itemsize * data.size + _EACH_MISSING * int(np.count_nonzero(missing)), f"the fill of {data.size} samples"
    )
    result = np.where(missing, 0, data).astype(kind)
    if missing.all():
        return result
    # scale by powers of two, so that squares fit into float64
    exponent = int(np.frexp(max(float(result.max()), -float(result.min())))[1])
    at = np.nonzero(missing)
    start = _block_means(np.ldexp(result, -exponent), missing, at)
    result[at] = np.ldexp(start, exponent)
    if roughly:
        return result
    band = _near_valid(missing)
    unknown = np.flatnonzero(band)
    memory.require(_EACH_UNKNOWN * unknown.size, f"the fill of {unknown.size} samples beside others")
    smooth = _least_bent(result, unknown, exponent, start[band[at]])
    result.reshape(-1)[unknown] = np.ldexp(smooth, exponent)
    return result


def _near_valid(missing: NDArray[np.bool_]) -> NDArray[np.bool_]:
    from scipy import ndimage

    if not _in_pairs(np.logical_and, missing).any():  # no hole is deep
        return missing
    deep = ndimage.minimum_filter(missing.view(np.uint8), 2 * _BAND + 1, mode="nearest")
    return np.asarray(missing & (deep == 0))


def _in_pairs(combine: np.ufunc, data: NDArray[Any]) -> NDArray[Any]:
    """Combine blocks of two along each axis; the last block of an odd axis has one sample."""
    for axis in range(data.ndim):
        lines = np.moveaxis(data, axis, 0)
        first = lines[::2].copy()
        pairs = first[: len(lines) // 2]
        combine(pairs, lines[1::2], out=pairs)
        data = np.moveaxis(first, 0, axis)
    return data


def _block_means(
    data: NDArray[np.floating[Any]], missing: NDArray[np.bool_], at: tuple[NDArray[np.intp], ...]
) -> NDArray[np.float64]:
    """Replace missing samples, which are 0, by linearly interpolated block means of valid ones; blocks grow until they have one."""
    from scipy import ndimage

    counts = _in_pairs(np.add, (~missing).astype(np.uint8))
    means = _in_pairs(np.add, data) / np.maximum(counts, 1).astype(data.dtype)
    empty = counts == 0
    if empty.any():
        means[empty] = _block_means(means, empty, np.nonzero(empty))
    middles = (np.stack(at) - 0.5) / 2
    return np.asarray(ndimage.map_coordinates(means, middles, np.float64, order=1, mode="nearest"))


def _least_bent(data: NDArray[Any], unknown: NDArray[np.intp], exponent: int, start: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values at flat indices, in units of a power of two, that minimise the sum of squared second differences."""
    from scipy import sparse

    flat, count = data.reshape(-1), unknown.size
    rows, columns, weights, given, total = [], [], [], [], 0
    stride = 1
    for n in data.shape[::-1]:
        first = np.unique(np.concatenate([unknown - j * stride for j in range(3)]))  # a difference has three samples
        place = first // stride % n
        first = first[(first >= 0) & (place + 2 < n)]
        index = first[:, None] + stride * np.arange(3)
        column = np.searchsorted(unknown, index)
        free = unknown[np.minimum(column, count - 1)] == index
        weight = np.broadcast_to([1.0, -2.0, 1.0], index.shape)
        rows.append(np.broadcast_to(total + np.arange(first.size)[:, None], index.shape)[free])
        columns.append(column[free])
        weights.append(weight[free])
        given.append(-(np.where(free, 0, np.ldexp(flat[index].astype(np.float64), -exponent)) * weight).sum(1))
        total += first.size
        stride *= n
    differences = sparse.csr_array((np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns))), shape=(total, count))
    across = differences.T.tocsr()
    result = start.copy()
    residual = across @ (np.concatenate(given) - differences @ result)
    direction, size = residual, float((residual * residual).sum())
    for _ in range(_STEPS):
        if size < _EXACT:
            break
        bent = across @ (differences @ direction)
        step = size / float((direction * bent).sum())
        result += step * direction
        residual = residual - step * bent
        before, size = size, float((residual * residual).sum())
        direction = residual + size / before * direction
    return result


# -- the extrapolation of pictures ---------------------------------------------------------------------------------


def extrapolated(data: NDArray[Any], missing: NDArray[np.bool_], middle: float) -> NDArray[np.floating[Any]]:
    """A copy with missing samples replaced by planes through those around them: the function of pictures up to its edge.

    A sample is the value there of the plane of least squares through valid samples at most 3 away along each axis; further out it
    is the weighted mean of those filled before, and more than 9 from any it is `middle`. So it depends on samples within
    `EXTRAPOLATED` alone, and is the same in any part of the array that holds these. A linear function is continued almost
    exactly: on a ball of 16 samples to 3e-4 of its range, and its slopes to 3 %, where the fill of `Missing` bends: 15e-4 and 25 %.

    Parameters
    ----------
    data : ndarray
        Of any number of axes.
    missing : ndarray of bool, the shape of `data`
    middle : float
        A value amid those of `data`.

    Returns
    -------
    ndarray of the dtype of `data`, which is floating
    """
    memory.require(2 * (data.nbytes + data.size), f"the extrapolation of {data.size} samples")
    result, known = np.where(missing, np.array(middle, data.dtype), data), ~missing
    for plane in (True, *(False,) * _MEANS):
        if known.all():
            break
        before, there = result.copy(), known.copy()
        for corner in itertools.product(*(range(0, n, _BLOCK) for n in data.shape)):
            block = tuple(slice(first, min(first + _BLOCK, n)) for first, n in zip(corner, data.shape, strict=True))
            around = tuple(slice(max(0, one.start - _WINDOW), one.stop + _WINDOW) for one in block)
            if known[block].all() or not there[around].any():
                continue
            inner = tuple(slice(b.start - a.start, b.stop - a.start) for a, b in zip(around, block, strict=True))
            at, values = _fitted(before[around], there[around], inner, middle, plane=plane)
            result[block][at], known[block][at] = values, True
    return result


def _fitted(
    data: NDArray[Any], there: NDArray[np.bool_], inner: tuple[slice, ...], middle: float, *, plane: bool
) -> tuple[tuple[NDArray[np.intp], ...], NDArray[np.float64]]:
    """Where an inner part has samples that are not there but near others, and the value of the fit at each."""
    unit = np.eye(data.ndim, dtype=int)
    terms = [(0,) * data.ndim, *(tuple(row) for row in unit[: data.ndim * plane].tolist())]
    pairs = list(itertools.combinations_with_replacement(range(len(terms)), 2))
    powers = [tuple(a + b for a, b in zip(terms[i], terms[j], strict=True)) for i, j in pairs]
    weights = _moments(there.astype(np.float64), powers)
    sums = _moments(np.where(there, data.astype(np.float64) - middle, 0), terms)
    total = weights[0][inner]
    at = np.nonzero((total > 0) & ~there[inner])
    matrix, right = np.empty((at[0].size, len(terms), len(terms))), np.stack([one[inner][at] for one in sums], -1)
    for (i, j), one in zip(pairs, weights, strict=True):
        matrix[:, i, j] = matrix[:, j, i] = one[inner][at]
    slopes = np.arange(1, len(terms))
    matrix[:, slopes, slopes] += _FLATTER * total[at][:, None]
    return at, np.asarray(np.linalg.solve(matrix, right[..., None])[:, 0, 0] + middle, np.float64)


def _moments(array: NDArray[np.float64], wanted: list[tuple[int, ...]]) -> list[NDArray[np.float64]]:
    """Sums over the window around each sample, weighted by a Gaussian and by powers of the distances along the axes."""
    from scipy import ndimage

    away = np.arange(-_WINDOW, _WINDOW + 1)
    made: dict[tuple[int, ...], NDArray[np.float64]] = {(): array}
    for powers in wanted:
        for axis, power in enumerate(powers):
            if powers[: axis + 1] not in made:
                taps = np.exp(-(away**2) / 2) * away**power
                made[powers[: axis + 1]] = ndimage.correlate1d(made[powers[:axis]], taps, axis, mode="constant")
    return [made[powers] for powers in wanted]
