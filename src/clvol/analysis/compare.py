"""The error of what one is looking at: reconstruction filters measured against a known function, or against held-back samples."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.analysis.table import Table, column
from clvol.boundary import DEFAULT_BOUNDARY, Boundary
from clvol.device import Device
from clvol.filters import Filter
from clvol.volume import Volume

__all__ = ["COMPARED", "EXACT_SINC", "ErrorRow", "ErrorTable", "compare"]

Array: TypeAlias = NDArray[np.float64]
Function: TypeAlias = Callable[[Array], ArrayLike]

EXACT_SINC: Final = "exact-sinc"
"""Where filters are compared, this name stands for the exact sinc of `clvol.analysis.dirichlet_sample`."""

COMPARED: Final = (
    EXACT_SINC, "nearest", "bspline3-approx", "linear", "mitchell", "catmull-rom", "bspline2", "bspline3", "omoms3", "bspline4",
    "bspline5", "hybrid",
)  # fmt: skip
"""What `compare` compares unless told otherwise."""


@dataclass(frozen=True)
class ErrorRow:
    """What was measured of one filter; None where it does not exist.

    Attributes
    ----------
    filter : str
        Name of the filter.
    rms, maximum : float
        Root mean square and greatest error of the values, in the data's units.
    psnr : float or None
        ``20 log10(range / rms)`` in decibels, with the range of the samples; None for constant data or no error.
    ssim : float or None
        Structural similarity (`ssim`) on a lattice; None for constant data.
    gradient_rms : float or None
        Root mean square length of the gradient's error, per world unit; None if the filter has no gradient.
    angle_mean, angle_median, angle_95 : float or None
        Of the angle between the gradient and the true one in degrees: mean, median, 95th percentile, where the true
        one is not zero; a gradient of length zero counts as 90°.
    overshoot : float
        How far the values leave the range of the samples, in the data's units; 0 if they do not.
    seconds : float or None
        Time per million samples, without the prefilter; None if it was not asked for or the filter is not evaluated
        point by point.
    """

    filter: str = column("filter")
    rms: float = column("RMS error", ".3g")
    maximum: float = column("max error", ".3g")
    psnr: float | None = column("PSNR (dB)", ".2f")
    ssim: float | None = column("SSIM", ".4f")
    gradient_rms: float | None = column("gradient RMS", ".3g")
    angle_mean: float | None = column("mean angle (°)", ".2f")
    angle_median: float | None = column("median angle (°)", ".2f")
    angle_95: float | None = column("95 % angle (°)", ".2f")
    overshoot: float = column("overshoot", ".3g")
    seconds: float | None = column("s / million", ".3g")


class ErrorTable(Table[ErrorRow]):
    """A row for each filter, in the order asked for, and what was compared with what.

    Attributes
    ----------
    samples : Volume
        What the filters reconstructed from: samples of the function, or the decimated volume.
    against : str
        What they were compared with, in words.
    points : int
        At how many positions.
    value_range : (float, float)
        Least and greatest sample: what `psnr`, `ssim` and `overshoot` refer to.
    boundary : str
        The boundary rule.
    evaluated_on, timed_on : str
        "NumPy, float64", or the name of the device; `timed_on` is empty if nothing was timed.
    """

    samples: Volume
    against: str
    points: int
    value_range: tuple[float, float]
    boundary: str
    evaluated_on: str
    timed_on: str

    def best(self, key: str = "rms") -> ErrorRow:
        """The row with the least `key` (the greatest for "psnr" and "ssim"), of those that have it."""
        raise NotImplementedError


def compare(
    source: Volume | ArrayLike | Function, filters: Sequence[str | Filter] = COMPARED, *, truth: Function | None = None,
    gradient: Function | None = None, size: int | Sequence[int] = 41, domain: tuple[float, float] = (-1.0, 1.0),
    dimensions: int = 3, boundary: str | Boundary = DEFAULT_BOUNDARY, factor: int = 2,
    lowpass: Literal["gaussian", "none"] = "gaussian", margin: float = 4.0, points: int = 200_000, seed: int = 0, timing: bool = True,
    device: Device | str | int | None = None, progress: Callable[[float], Any] | None = None,
) -> ErrorTable:  # fmt: skip
    """Measure what each filter makes of data whose truth is known.

    A function, or a volume with its `truth`, is compared at uniform random points of the world. Of a volume alone the
    truth is held back: it is low-passed, every `factor`-th sample is kept, and what is reconstructed from these is
    compared with the original samples, as in Figure 4 of the paper; the true gradient is then that of the
    quintic spline through the original.

    Parameters
    ----------
    source : callable, Volume or array-like
        A function of positions (N, d), x first, that gives (N,) values; or 2-D or 3-D samples.
    filters : sequence of str or Filter
        One row each; "exact-sinc" is the exact sinc (not under boundary "zero").
    truth : callable, optional
        The function that the volume samples.
    gradient : callable, optional
        Its gradient, (N, d) at (N, d); by default taken from the function by sixth-order differences.
    size, domain, dimensions
        For a function: samples along each axis (or (nz, ny, nx)), of which the outer ones lie on the faces of
        ``[low, high]**dimensions``.
    boundary : str or Boundary
        As for `clvol.sample`.
    factor : int
        Of the decimation, at least 2.
    lowpass : {"gaussian", "none"}
        Before the decimation: a Gaussian of standard deviation ``factor / 2`` samples, or nothing.
    margin : float
        Samples (of those reconstructed from) along each face in which nothing is compared, since there the boundary
        rule speaks; less where an axis is shorter than four times as much.
    points : int
        How many random positions, or random samples of a decimated volume's gradient, are compared.
    seed : int
        Of the random positions.
    timing : bool
        Measure the time per million samples: on the device, the default one if none is named, else in NumPy.
    device : Device, str or int, optional
        Take the values from this device, in float32; by default they are float64 by `clvol.reference`.
    progress : callable, optional
        Called with the fraction done.

    Returns
    -------
    ErrorTable

    Raises
    ------
    OptionError
        An unknown name, a number outside its bounds, a function that fails or gives other than finite numbers.
    DataError
        NaN or infinite samples.
    """
    raise NotImplementedError
