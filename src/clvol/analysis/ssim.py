"""The structural similarity of Wang et al. (2004), of images and volumes."""

from __future__ import annotations

from numpy.typing import ArrayLike

__all__ = ["ssim"]


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
        Of the window, in samples.

    Returns
    -------
    float

    Raises
    ------
    DataError
        Shapes differ, or a value is not finite.
    OptionError
        The range is not positive: `b` is constant, and none was given.
    """
    raise NotImplementedError
