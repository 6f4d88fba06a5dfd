"""The same mathematics in NumPy and float64, plain and slow: the reference for tests of the kernels.

Nothing here uses the taps of a filter, the recursions of the prefilter or the index arithmetic of
`clvol.filter.boundary`: kernels come from closed forms, coefficients from solving eq. (11), edges from `numpy.pad`. So a
mistake cannot be on both sides of a comparison.
"""

from __future__ import annotations

from clvol.reference.spline.boundary import extend
from clvol.reference.spline.chain import map_points
from clvol.reference.spline.filter import kernel
from clvol.reference.spline.points import magnify, resample, sample
from clvol.reference.spline.prefilter import prefilter, prefilter_fft
from clvol.reference.spline.reduce import nearest_spline
from clvol.reference.spline.regions import labels_at, labels_between
from clvol.reference.spline.resample import lattice

__all__ = [
    "extend",
    "kernel",
    "labels_at",
    "labels_between",
    "lattice",
    "magnify",
    "map_points",
    "nearest_spline",
    "prefilter",
    "prefilter_fft",
    "resample",
    "sample",
]
