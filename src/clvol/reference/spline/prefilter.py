"""From samples to coefficients: eq. (11) solved as a system, or eqs (13) and (16) by the FFT."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from clvol.base.arrays import Array
from clvol.base.errors import DataError, OptionError
from clvol.filter.boundary import DEFAULT_BOUNDARY, Boundary
from clvol.filter.filter import Filter
from clvol.filter.table import DEFAULT_FILTER, as_filter
from clvol.reference.spline.boundary import extend, pad, padding, solved_by
from clvol.reference.spline.filter import kernel

__all__ = ["kernel_samples", "padded_coefficients", "prefilter", "prefilter_fft"]


def kernel_samples(filter: str | Filter) -> Array:
    """The kernel at 0, 1, 2, ... up to the last that is not zero: the entries of eq. (11)."""
    chosen = as_filter(filter)
    b = kernel(chosen, np.arange((chosen.support + 1) // 2 + 1))
    return b[: int(np.flatnonzero(np.abs(b) > 1e-12)[-1]) + 1]


def prefilter(data: ArrayLike, filter: str | Filter = DEFAULT_FILTER, boundary: str | Boundary = DEFAULT_BOUNDARY) -> Array:
    """Spline coefficients by solving eq. (11) along every axis; the samples for a filter without a prefilter.

    Parameters
    ----------
    data : array-like
        Samples with any number of axes.
    filter : str or Filter
        For a hybrid, the filter that magnifies is used.
    boundary : str or Boundary
        Determines the coefficients outside, hence the matrix's corners, or the samples outside, before the prefilter.
    """
    result, chosen = _arguments(data, filter)
    return _inner(_solved(result, chosen, boundary), padding(chosen, boundary))


def padded_coefficients(data: ArrayLike, filter: str | Filter, boundary: str | Boundary) -> Array:
    """The coefficients of `prefilter`, including those of the boundary rule's padding."""
    return np.ascontiguousarray(_solved(*_arguments(data, filter), boundary))


def prefilter_fft(data: ArrayLike, filter: str | Filter = DEFAULT_FILTER, boundary: str | Boundary = DEFAULT_BOUNDARY) -> Array:
    """The same by division in the frequency domain, eq. (13), by the response of eq. (16).

    An axis is first extended to one full period of the prefilter's boundary rule. "zero" has none.
    """
    rule = solved_by(boundary)
    if rule == "zero":
        raise OptionError("boundary must be one whose prefilter has a period; got 'zero'")
    result, chosen = _arguments(data, filter)
    result = pad(result, chosen, boundary)
    if chosen.prefilter:
        for axis in range(result.ndim):
            b = _denominator(chosen, result.ndim - 1 - axis)
            lines = np.moveaxis(result, axis, -1)
            n = lines.shape[-1]
            if rule == "mirror":
                cycle = np.concatenate([lines, lines[..., -2:0:-1]], -1)
            elif rule == "reflect":
                cycle = np.concatenate([lines, lines[..., ::-1]], -1)
            else:
                cycle = lines
            omega = 2 * np.pi * np.fft.fftfreq(cycle.shape[-1])
            response = b[0] + 2 * sum(v * np.cos(k * omega) for k, v in enumerate(b) if k)
            solved = np.fft.ifft(np.fft.fft(cycle) / response).real
            result = np.moveaxis(solved[..., :n], -1, axis)
    return _inner(result, padding(chosen, boundary))


def _solved(samples: Array, filter: Filter, boundary: str | Boundary) -> Array:
    """The coefficients of padded samples."""
    result = pad(samples, filter, boundary)
    if filter.prefilter:
        for axis in range(result.ndim):
            lines = np.moveaxis(result, axis, 0)
            b = _denominator(filter, result.ndim - 1 - axis)
            solved = _solve(lines.reshape(lines.shape[0], -1), b, solved_by(boundary))
            result = np.moveaxis(solved.reshape(lines.shape), 0, axis)
    return result


def _inner(padded: Array, width: int) -> Array:
    return np.ascontiguousarray(padded[tuple(slice(width, n - width) for n in padded.shape)])


def _denominator(filter: Filter, axis: int) -> Array:
    """The sequence that a prefilter inverts along an axis (x is 0), at 0, 1, 2, ...: kernel samples plus smoothing."""
    b, smoothing = kernel_samples(filter), filter.smoothing
    if isinstance(smoothing, tuple):
        smoothing = smoothing[axis]
    if isinstance(smoothing, str) or filter.length is not None:
        raise OptionError(
            f"the smoothing of {filter.name!r} is decided for a volume: clvol.volume.smoothing.settled(filter, volume)"
        )
    if not smoothing:
        return b
    penalty = np.ones(1)
    for _ in range(filter.penalty):
        penalty = np.convolve(penalty, [-1, 2, -1])  # second differences, negative: 2 - 2 cos ω
    half = smoothing * penalty[filter.penalty :]
    result = np.zeros(max(b.size, half.size))
    result[: b.size] = b
    result[: half.size] += half
    return result


def _arguments(data: ArrayLike, filter: str | Filter) -> tuple[Array, Filter]:
    samples = np.asarray(data)
    if samples.ndim == 0 or 0 in samples.shape or samples.dtype.kind not in "biuf":
        raise DataError(f"data must be numbers along 1 axis or more; got {samples.dtype} of shape {samples.shape}")
    samples = samples.astype(np.float64)
    if not np.isfinite(samples).all():
        raise DataError("samples must be finite")
    chosen = as_filter(filter)
    return samples, chosen.magnified_by or chosen


def _solve(lines: Array, b: Array, boundary: str | Boundary) -> Array:
    """Eq. (11) for columns of `lines`: a band, and for the closed curve two corners."""
    n, k = lines.shape[0], b.size - 1
    # the coefficient at each neighbour of a row: the extension of 1, 2, ..., n, with 0 for none
    column = extend(np.arange(1, n + 1), k, boundary) - 1
    entries = [(i, int(column[i + k + j]), b[abs(j)]) for j in range(-k, k + 1) for i in range(n)]
    if n <= 4 * k + 2:  # the corners meet the band
        matrix = np.zeros((n, n))
        for i, j, v in entries:
            if j >= 0:
                matrix[i, j] += v
        return np.asarray(np.linalg.solve(matrix, lines), dtype=np.float64)
    band, corner = np.zeros((2 * k + 1, n)), np.zeros((n, n if k else 0))
    corner_rows = [*range(k), *range(n - k, n)]
    for i, j, v in entries:
        if j < 0:
            continue
        if abs(i - j) <= k:
            band[k + i - j, j] += v
        else:
            corner[i, j] += v
    solved: Array = np.asarray(linalg.solve_banded((k, k), band, lines, check_finite=False), dtype=np.float64)
    if not corner.any():
        return solved
    # Woodbury: (B + E C)^-1 p = B^-1 p - B^-1 E (1 + C B^-1 E)^-1 C B^-1 p, E: the corners' rows
    some = corner[corner_rows]
    spread = linalg.solve_banded((k, k), band, np.eye(n)[:, corner_rows])
    inner = np.linalg.solve(np.eye(2 * k) + some @ spread, some @ solved)
    return np.asarray(solved - spread @ inner)
