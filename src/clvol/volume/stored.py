"""How values are stored on a device: in float32, less an offset and a power of two where float32 would lose them.

Filters are linear and, where their weights sum to one, give a constant back. So the function of samples less a constant is
the function less that constant, which is added again in float64; a power of two rounds nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.filter.boundary import Boundary
from clvol.filter.filter import Filter
from clvol.volume.volume import Volume

__all__ = ["AS_THEY_ARE", "RENUMBER", "Stored", "differences", "names_beyond", "wide_enough"]

_FAR = 8  # times their range from zero samples lie that are stored less an offset: float32 then errs by 1e-6 of the range
_EXPONENTS = 90  # samples of 2**-90 to 2**90 are stored unscaled: their 24 digits end above 2**-126, and sums fit below 2**128
_ROOM = 120  # of the exponents that float32 has, what a prefilter may use: filters and derivatives gain a little more
_PROBES = 8  # along each axis, at least, where an axis has them
_LARGEST = 3e38  # in stored units: about what float32 holds

RENUMBER = "renumber them, as numpy.unique(data, return_inverse=True) does"

Reals = NDArray[np.float32] | NDArray[np.float64]


@dataclass(frozen=True)
class Stored:
    """The map between values and what stands for them: ``(value - offset) * 2**-exponent``, in float32.

    Parameters
    ----------
    offset : float
        What is taken off; 0 for most data.
    exponent : int
        Of the power of two; 0 for most data.
    """

    offset: float = 0.0
    exponent: int = 0

    @classmethod
    def of(cls, volume: Volume, filter: Filter, boundary: Boundary) -> Stored:
        """What suits a volume's samples, which are finite.

        An offset, about the middle of the range, is taken off samples that lie further than 8 times their range from zero, if
        the filter's weights sum to one and the boundary rule puts no values of its own outside. Samples that float32 holds and
        that are all the same need none. An exponent brings the largest magnitude that is left to 1/2..1 if it is beyond
        2**-90..2**90, or if a filter's prefilter gains so much that it would overflow.
        """
        movable = filter.sums_to_one and boundary.period is not None and boundary.outside != "grid-constant"
        if volume.data.dtype.kind in "biu":
            # the type bounds their magnitude; so samples are looked at only where an offset may come out
            if not movable or not _may_be_far(volume.data):
                return AS_THEY_ARE
            least, most = (int(v) for v in volume.limits)
            offset = _whole_offset(least, most)
            return cls(float(offset)) if offset else AS_THEY_ARE
        low, high = (float(v) for v in volume.limits)
        start = _offset(low, high) if movable else 0.0
        exponent = math.frexp(max(abs(low - start), abs(high - start)))[1]
        within = -_EXPONENTS <= exponent <= min(_EXPONENTS, _ROOM - _gain_exponent(filter.magnified_by or filter))
        return cls(start, 0 if within else exponent)

    @property
    def identity(self) -> bool:
        """Whether values are stored as they are."""
        return self == AS_THEY_ARE

    def alters(self, derivative: int) -> bool:
        """Whether values, or derivatives of this order, differ from what kernels make of stored ones."""
        return not self.identity if derivative == 0 else self.exponent != 0

    # -- values of the data's units -> stored ones -----------------------------------------------------------------

    def held(self, values: ArrayLike) -> NDArray[np.float64]:
        """`values`, or the nearest that float32 holds once they are stored: no sample comes near those."""
        low, high = (self.values(np.array(end, np.float32)) for end in (-_LARGEST, _LARGEST))
        return np.clip(np.asarray(values, dtype=np.float64), low, high)

    def __call__(self, values: ArrayLike) -> NDArray[np.float64]:
        """`values` in stored units, in float64; those beyond what float32 holds as `held` gives them."""
        return np.asarray(np.ldexp(self.held(values), -self.exponent) - math.ldexp(self.offset, -self.exponent))

    def samples(self, data: NDArray[Any]) -> NDArray[Any]:
        """Samples of a volume in stored units, still to be rounded to float32; integers are subtracted as integers."""
        if self.identity:
            return data
        if data.dtype.kind in "biu":
            return differences(data, int(self.offset))
        wide = np.result_type(data.dtype, np.float64).type
        return np.asarray(np.ldexp(data.astype(wide) - wide(self.offset), -self.exponent))

    # -- and back --------------------------------------------------------------------------------------------------

    def values(self, stored: NDArray[np.float32], gain: float = 1.0) -> Reals:
        """The values that stored ones stand for, in float64 unless they are the same; `gain`: what becomes of a 1 in them."""
        if self.identity:
            return stored
        with np.errstate(over="ignore"):
            values = self._scaled(stored)
            values += gain * self.offset
            return values

    def derivatives(self, stored: NDArray[np.float32]) -> Reals:
        """Derivatives of the values, given those of stored ones: in float64 unless they are the same."""
        return self._scaled(stored) if self.alters(1) else stored

    def _scaled(self, stored: NDArray[np.float32]) -> NDArray[np.float64]:
        with np.errstate(over="ignore"):
            values = np.asarray(stored.astype(np.float64))
            np.ldexp(values, self.exponent, out=values)
            return values


AS_THEY_ARE = Stored()
"""Values are stored unchanged."""


def differences(data: NDArray[Any], whole: int) -> NDArray[np.int64]:
    """Integers less a whole number, exactly, as int64; they must fit, but the integers themselves need not."""
    return np.asarray(data.astype(np.int64) - np.array([whole % (1 << 64)], np.uint64).view(np.int64))  # modulo 2⁶⁴


def _gain_exponent(filter: Filter) -> int:
    """Of a power of two that no number exceeds on the way from samples within ±1 to coefficients, along three axes."""
    if not filter.prefilter:
        return 0
    rows = [filter.along(axis) for axis in range(len(filter.smoothing) if isinstance(filter.smoothing, tuple) else 1)]
    gains = [math.log2(abs(row.undone[-1])) + 2 * float(np.log2(1 - np.abs(row.poles)).sum()) for row in rows]
    return math.ceil(-3 * min(gains))


def _may_be_far(data: NDArray[Any]) -> bool:
    """Whether integers could lie far from zero: some of them, and then all, lie more than ``_FAR - 1`` ranges away."""
    some = data[tuple(slice(None, None, max(1, n // _PROBES)) for n in data.shape)]
    low, high = int(some.min()), int(some.max())
    return (low > 0 or high < 0) and min(abs(low), abs(high)) > (_FAR - 1) * (high - low)


def _whole_offset(low: int, high: int) -> int:
    """An offset for integers from `low` to `high`, which float64 holds, or 0."""
    span, middle = high - low, (low + high) // 2
    if max(-low, high) <= _FAR * span or (low == high and int(np.float32(low)) == low):
        return 0
    quantum = 1 << max(0, span.bit_length() - 1, middle.bit_length() - 53)
    return (middle + quantum // 2) // quantum * quantum


def _offset(low: float, high: float) -> float:
    """An offset for samples from `low` to `high`, or 0.

    It has no digits below the largest power of two in the range, so that the differences of short numbers are short: data in
    tenths or whole numbers stay so. Differences are exact in float64, for the offset is near to all samples (Sterbenz).
    """
    if low <= 0 <= high:
        return 0.0
    span = high - low
    with np.errstate(over="ignore"):
        if max(-low, high) <= _FAR * span or (span == 0 and float(np.float32(low)) == low):
            return 0.0
    if span == 0:
        return low
    quantum = math.frexp(span)[1] - 1
    return math.ldexp(round(math.ldexp(low + span / 2, -quantum)), quantum)


# -- whether float32 is enough -----------------------------------------------------------------------------------------


def wide_enough(kind: type[np.generic], volume: Volume, filter: Filter, boundary: Boundary) -> type[np.generic]:
    """`kind`, or float64 where a Field of float32 would take an offset or a power of two off the samples."""
    return kind if Stored.of(volume, filter, boundary).identity else np.float64


def names_beyond(bits: int, volume: Volume, row: Filter) -> bool:
    """Whether labels, which this filter leaves as they are, need more than `bits` bits: 24 in float32, 53 in float64."""
    if row.support > 1 or volume.data.dtype.kind not in "iu" or volume.data.dtype.itemsize <= bits // 8 or not volume.is_labels:
        return False
    return max(abs(int(v)) for v in volume.limits) > 1 << bits
