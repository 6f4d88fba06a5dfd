"""The exact sinc: of samples that repeat with a period it is a finite sum, the Dirichlet kernel, and the FFT gives it.

Samples are continued by the boundary rule to one period, whose trigonometric polynomial of least degree is taken. An
even period's Nyquist term is halved between ±π, which keeps results real: ``cos(pi x)`` there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.boundary import DEFAULT_BOUNDARY, Boundary
from clvol.filters import Filter
from clvol.volume import Volume

__all__ = ["SincVolume", "dirichlet_kernel", "dirichlet_magnify", "dirichlet_sample", "sinc_volume"]

Array: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True)
class SincVolume:
    """A volume magnified by the exact sinc, and how far a spline through it is from the exact sinc.

    Attributes
    ----------
    volume : Volume
        float64; give it to `clvol.render` or `clvol.sample` with `filter` and `boundary`.
    filter, boundary : str
        With which the residual was measured.
    rms, maximum : float
        Difference of the spline to the exact sinc at random points of the domain, in the data's units.
    """

    volume: Volume
    filter: str
    boundary: str
    rms: float
    maximum: float


def dirichlet_kernel(x: ArrayLike, n: int, derivative: int = 0) -> Array:
    """The periodic sinc of period `n`: ``sin(pi x) / (n sin(pi x / n))`` for odd n, ``/ (n tan(pi x / n))`` for even.

    Parameters
    ----------
    x : array-like
        Distance in samples.
    n : int
        Period in samples, at least 1.
    derivative : {0, 1}

    Returns
    -------
    ndarray of float64, the shape of `x`
    """
    raise NotImplementedError


def dirichlet_magnify(data: ArrayLike, factor: int = 2, boundary: str | Boundary = DEFAULT_BOUNDARY) -> Array:
    """Samples of the exact sinc on a finer grid, by the FFT.

    Parameters
    ----------
    data : array-like, 1 to 3 axes
        Finite samples.
    factor : int
        At least 1.
    boundary : str or Boundary
        "wrap": sample j of ``factor n`` lies at ``j / factor``. "mirror": so does sample j of ``factor (n - 1) + 1``,
        the last on the last. "reflect": sample j of ``factor n`` lies at ``(j + 1/2) / factor - 1/2``. Thus the finer
        grid continues under the same rule.

    Returns
    -------
    ndarray of float64

    Raises
    ------
    DataError, OptionError
        "zero" has no period.
    """
    raise NotImplementedError


def dirichlet_sample(
    volume: Volume | ArrayLike, points: ArrayLike, boundary: str | Boundary = DEFAULT_BOUNDARY, derivative: int = 0
) -> Array:
    """The exact sinc, or its gradient, at any points: for reference, since each takes all samples.

    Parameters
    ----------
    volume : Volume or array-like
        1, 2 or 3 axes; an array has spacing 1 and origin 0.
    points : array-like, shape (..., d)
        World positions (x, y, z).
    boundary : str or Boundary
        "mirror", "reflect" or "wrap".
    derivative : {0, 1}

    Returns
    -------
    ndarray of float64, shape (...) or (..., d)

    Raises
    ------
    DataError, OptionError
    """
    raise NotImplementedError


def sinc_volume(
    volume: Volume | ArrayLike, factor: int = 4, filter: str | Filter = "bspline3", boundary: str | Boundary = DEFAULT_BOUNDARY,
    points: int = 2000,
) -> SincVolume:  # fmt: skip
    """The exact sinc as a volume that can be rendered: FFT magnification, to be followed by spline interpolation.

    Panel a) of Figure 6. The spline's error is stated: it falls with ``factor**4`` for ``bspline3``.

    Parameters
    ----------
    volume : Volume or array-like
        2-D or 3-D samples.
    factor : int
        Of the magnification: at least 1; memory grows with its cube.
    filter, boundary : str, Filter, Boundary
        As the result will be rendered.
    points : int
        At how many random points of the domain the residual is measured.

    Raises
    ------
    DataError, OptionError
    """
    raise NotImplementedError
