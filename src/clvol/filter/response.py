"""Frequency responses of the filters (eqs 14 to 18), derived from their taps.

Frequencies are in radians per sample of the volume: π is its Nyquist frequency, and an ideal
filter is 1 below it and 0 above.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base.arrays import reals
from clvol.base.errors import OptionError
from clvol.filter.filter import Filter
from clvol.filter.table import as_filter

__all__ = ["frequency_response", "prefilter_response"]

Array: TypeAlias = NDArray[np.float64]
_MAX_OMEGA = 2000  # radians per sample; the number of quadrature nodes grows with it, and their time with its cube
_CHUNK = 1 << 20  # cosines in memory at once


def frequency_response(filter: str | Filter, omega: ArrayLike) -> Array:
    """The response of the whole reconstruction along one axis, including the prefilter.

    Parameters
    ----------
    filter : str or Filter
        Any filter of the table.
    omega : array-like
        Angular frequency in radians per sample, within ±2000.

    Returns
    -------
    ndarray of float64, the shape of `omega`
        B(ω) for a filter without a prefilter, eq. (15) for B-splines; S(ω) B(ω) for one
        with a prefilter, eq. (17); H(ω) for a hybrid, eq. (18).

    Notes
    -----
    The kernel is integrated piece by piece with enough Gauss–Legendre nodes for float64. A kernel of
    the table is even, so its transform is real; for other kernels, this is the even part.

    A hybrid samples one spline at steps of ``1 / s``, a digital filter, and reconstructs the result with
    another kernel of ``1 / s`` the width: the product of S(ω), the sum over j of ``k(j / s) cos(ω j / s)``
    and ``B(ω / s) / s``.

    Examples
    --------
    >>> import clvol, numpy as np
    >>> round(float(clvol.frequency_response("linear", np.pi)), 3)  # at half of the sampling frequency
    0.405
    """
    chosen, w = as_filter(filter), _frequencies(omega)
    if np.abs(w).max(initial=0.0) > _MAX_OMEGA:
        raise OptionError(f"omega must be within ±{_MAX_OMEGA}; got {float(np.abs(w).max()):g}")
    response = _kernel_response(chosen, w / chosen.scale) * prefilter_response(chosen, w)
    if chosen.magnified_by is not None:
        by, s = chosen.magnified_by, chosen.scale
        j = np.arange(-s * by.support, s * by.support + 1)
        digital = np.zeros_like(w)
        for place, value in zip(j / s, by(j / s), strict=True):
            if value:
                digital += value * np.cos(w * place)
        response = response * digital / s
    return response


def prefilter_response(filter: str | Filter, omega: ArrayLike) -> Array:
    """The response S(ω) of the prefilter (equation 16): 1 without one, the magnifying filter's for a hybrid.

    A smoothing spline adds λ (2 - 2 cos ω)ᵐ to the denominator.

    Parameters
    ----------
    filter : str or Filter
        Any filter of the table.
    omega : array-like
        Angular frequency in radians per sample.

    Returns
    -------
    ndarray of float64, the shape of `omega`
    """
    chosen, w = as_filter(filter), _frequencies(omega)
    chosen = chosen.magnified_by or chosen
    undone = chosen.undone
    return 1 / sum((2 * b * np.cos(k * w) for k, b in enumerate(undone) if k), np.full_like(w, undone[0]))


def _frequencies(omega: ArrayLike) -> Array:
    w = reals("omega", omega)
    if not np.isfinite(w).all():
        raise OptionError("omega must be finite")
    return w


def _kernel_response(filter: Filter, omega: Array) -> Array:
    """The Fourier integral of the kernel: B(ω), eq. (15) for B-splines."""
    flat = omega.ravel()
    # n nodes are exact to degree 2n - 1: the polynomial's degree, plus what the cosine needs on a unit interval
    count = filter.degree + 16 + int(np.abs(flat).max(initial=0.0))
    nodes, lengths = np.polynomial.legendre.leggauss(count)
    t = (nodes + 1) / 2
    value = (filter.weights(t) * (lengths / 2)).ravel()
    place = (t + filter.support / 2 - 1 - np.arange(filter.support)[:, None]).ravel()
    result = np.empty_like(flat)
    step = max(1, _CHUNK // place.size)
    for first in range(0, flat.size, step):
        result[first : first + step] = np.cos(flat[first : first + step, None] * place) @ value
    return result.reshape(omega.shape)
