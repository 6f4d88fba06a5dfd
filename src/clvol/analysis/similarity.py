"""The structural similarity of Wang et al. (2004), of images and volumes."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from clvol.base.arrays import Array, reals
from clvol.base.checks import number
from clvol.base.errors import DataError

__all__ = ["ssim"]

_K1, _K2 = 0.01, 0.03
_MAX_SIGMA = 1000  # samples
_CUT = 3.5  # standard deviations: 5 samples on either side for the usual 1.5


def ssim(a: ArrayLike, b: ArrayLike, data_range: float | None = None, sigma: float = 1.5) -> float:
    """Mean structural similarity of two images or volumes; 1 if they are equal.

    Z. Wang, A. C. Bovik, H. R. Sheikh and E. P. Simoncelli, *Image quality assessment: from error visibility to
    structural similarity*, IEEE Trans. Image Processing 13 (2004): K1 = 0.01, K2 = 0.03, a Gaussian window of standard
    deviation 1.5 cut to 11 samples along each axis, with the mean over all positions at which the window lies within
    the data (the whole, mirrored at its edges, where it is smaller than the window).

    Parameters
    ----------
    a, b : array-like of one shape, 1 to 3 axes
        Finite numbers.
    data_range : float, optional
        Of the values, positive; by default that of `b`, the reference.
    sigma : float
        Of the window, in samples; at most 1000.

    Returns
    -------
    float

    Raises
    ------
    DataError
        Shapes differ, or a value is not finite.
    OptionError
        `data_range` or `sigma` lies outside its bounds, or `b` is constant and no range was given.

    References
    ----------
    - Z. Wang, A. C. Bovik, H. R. Sheikh and E. P. Simoncelli, "Image quality assessment: from error visibility to
      structural similarity", IEEE Transactions on Image Processing 13(4), 2004, 600–612.
    """
    from scipy import ndimage

    x, y = reals("a", a, error=DataError), reals("b", b, error=DataError)
    if x.shape != y.shape or not 1 <= x.ndim <= 3 or x.size == 0:
        raise DataError(f"a and b must have one shape of 1 to 3 axes; got {x.shape} and {y.shape}")
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise DataError("a and b must be finite")
    sigma = number("sigma", sigma, above=0, maximum=_MAX_SIGMA)
    span = number("data_range", float(np.ptp(y)) if data_range is None else data_range, above=0)
    unit = max(span, float(np.abs(x).max()), float(np.abs(y).max()))  # so that no square that matters over- or underflows
    x, y, span = x / unit, y / unit, span / unit
    c1, c2 = (_K1 * span) ** 2, (_K2 * span) ** 2
    reach = int(_CUT * sigma + 0.5)
    inner = tuple(slice(reach, n - reach) if n > 2 * reach else slice(None) for n in x.shape)

    def mean(values: Array) -> Array:
        return np.asarray(ndimage.gaussian_filter(values, sigma, truncate=_CUT, mode="mirror")[inner])

    level = y.mean()  # near zero, variances lose no digits
    x, y = x - level, y - level
    mx, my = mean(x), mean(y)
    vx, vy, covariance = mean(x * x) - mx * mx, mean(y * y) - my * my, mean(x * y) - mx * my
    mx, my = mx + level, my + level
    bound = (mx * mx + my * my + c1) * (vx + vy + c2)
    similar = np.divide((2 * mx * my + c1) * (2 * covariance + c2), bound, out=np.ones_like(bound), where=bound != 0)
    return float(similar.mean())
