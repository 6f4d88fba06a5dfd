"""How values are stored on a device: shifted by an offset and scaled by a power of two where float32 or float64 needs it.

Filters are linear and, if their weights sum to one, reproduce constants. So subtracting a constant from the samples
subtracts it from the function; it is added back in float64. Scaling by a power of two is exact.
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

__all__ = ["AS_THEY_ARE", "RENUMBER", "Stored", "differences", "is_far", "names_beyond", "too_large_names", "wide_enough"]

_FAR = 8  # distance from zero, in ranges of the samples, that needs an offset: the float32 error is then 1e-6 of the range
_ROUNDING = 1e-12
_PROBES = 8  # samples inspected along each axis, at least

RENUMBER = "renumber them, as numpy.unique(data, return_inverse=True) does"

Reals = NDArray[np.float32] | NDArray[np.float64]


@dataclass(frozen=True)
class _Limits:
    """What a type can store."""

    digits: int
    exponents: int  # samples of 2**-this to 2**this are unscaled: their digits stay above the subnormals, and sums finite
    room: int  # exponents that a prefilter may use; the rest is for filters and derivatives
    largest: float  # about the largest number


_LIMITS: dict[type[np.generic], _Limits] = {np.float32: _Limits(24, 90, 120, 3e38), np.float64: _Limits(53, 940, 1016, 1.7e308)}


@dataclass(frozen=True)
class Stored:
    """The map between values and stored values: ``(value - offset) * 2**-exponent``, in float32 or float64.

    Parameters
    ----------
    offset : float
        Subtracted from values; 0 for most data.
    exponent : int
        Exponent of the power of two; 0 for most data.
    """

    offset: float = 0.0
    exponent: int = 0

    @classmethod
    def of(cls, volume: Volume, filter: Filter, boundary: Boundary, kind: type[np.generic] = np.float32) -> Stored:
        """The map for a volume of finite samples, stored as numbers of `kind`.

        Samples further from zero than 8 times their range get an offset near the middle of the range, if
        the filter's weights sum to one. Equal samples that `kind` can hold need none. If the largest magnitude is then outside
        2**-90..2**90 (2**-940..2**940 in float64), or the gain of the prefilter would overflow, an exponent scales it to 1/2..1.
        A constant outside is moved with the samples, by an offset that keeps it exact.
        """
        beyond, base = boundary.beyond, filter.magnified_by or filter
        # a constant outside is that of coefficients, which is moved as values are if the kernel's samples sum to one
        movable = filter.sums_to_one and (
            beyond is None or (math.isfinite(beyond) and abs(base.weights(0.0).sum() - 1) < _ROUNDING)
        )
        if volume.data.dtype.kind in "biu":
            # the type bounds their magnitude, so inspect the samples only if they may need an offset
            if not movable or not _may_be_far(volume.data):
                return AS_THEY_ARE
            least, most = (int(v) for v in volume.limits)
            offset = float(_whole_offset(least, most, kind))
            if offset and beyond is not None:
                offset = _with_exact(float(round(beyond)), offset, kind)
            return cls(offset) if offset and offset.is_integer() else AS_THEY_ARE
        low, high = (float(v) for v in volume.limits)
        start = _offset(low, high, kind) if movable else 0.0
        ends = [low - start, high - start]
        if movable and beyond is not None:
            start = _with_exact(beyond, start, kind) if start else 0.0
            ends = [low - start, high - start, beyond - start]
        exponent = math.frexp(max(map(abs, ends)))[1]
        limits = _LIMITS[kind]
        within = -limits.exponents <= exponent <= min(limits.exponents, limits.room - _gain_exponent(base))
        return cls(start, 0 if within else exponent)

    @property
    def identity(self) -> bool:
        """Whether values are stored unchanged."""
        return self == AS_THEY_ARE

    def alters(self, derivative: int) -> bool:
        """Whether values, or derivatives of this order, differ from those that kernels compute from stored values."""
        return not self.identity if derivative == 0 else self.exponent != 0

    # -- values of the data's units -> stored ones -----------------------------------------------------------------

    def held(self, values: ArrayLike, kind: type[np.generic] = np.float32) -> NDArray[np.float64]:
        """`values`, clipped to what numbers of `kind` can store; no sample comes near these limits."""
        largest = _LIMITS[kind].largest
        low, high = (self.values(np.array(end, kind)) for end in (-largest, largest))
        return np.clip(np.asarray(values, dtype=np.float64), low, high)

    def __call__(self, values: ArrayLike, kind: type[np.generic] = np.float32) -> NDArray[np.float64]:
        """`values` in stored units, in float64, clipped as in `held`."""
        return np.asarray(np.ldexp(self.held(values, kind), -self.exponent) - math.ldexp(self.offset, -self.exponent))

    def samples(self, data: NDArray[Any]) -> NDArray[Any]:
        """Samples of a volume in stored units, not yet rounded; integers are subtracted exactly."""
        if self.identity:
            return data
        if data.dtype.kind in "biu":
            return differences(data, int(self.offset))
        wide = np.result_type(data.dtype, np.float64).type
        return np.asarray(np.ldexp(data.astype(wide) - wide(self.offset), -self.exponent))

    # -- and back --------------------------------------------------------------------------------------------------

    def values(self, stored: Reals, gain: float = 1.0) -> Reals:
        """Convert stored values back, in float64 unless unchanged; `gain` is the factor on a constant."""
        if self.identity:
            return stored
        with np.errstate(over="ignore"):
            values = self._scaled(stored)
            values += gain * self.offset
            return values

    def derivatives(self, stored: Reals) -> Reals:
        """Convert derivatives of stored values back, in float64 unless unchanged."""
        return self._scaled(stored) if self.alters(1) else stored

    def _scaled(self, stored: Reals) -> NDArray[np.float64]:
        with np.errstate(over="ignore"):
            values = np.asarray(stored.astype(np.float64))
            np.ldexp(values, self.exponent, out=values)
            return values


AS_THEY_ARE = Stored()
"""Values are stored unchanged."""


def differences(data: NDArray[Any], whole: int) -> NDArray[np.int64]:
    """Integers minus an integer, exactly, as int64. The differences must fit into int64, the integers need not."""
    return np.asarray(data.astype(np.int64) - np.array([whole % (1 << 64)], np.uint64).view(np.int64))  # modulo 2⁶⁴


def _gain_exponent(filter: Filter) -> int:
    """Exponent of a power of two that bounds all values between samples within ±1 and coefficients, along three axes."""
    if not filter.prefilter:
        return 0
    gains = [math.log2(abs(row.undone[-1])) + 2 * float(np.log2(1 - np.abs(row.poles)).sum()) for row in filter.along_axes]
    return math.ceil(-3 * min(gains))


def _may_be_far(data: NDArray[Any]) -> bool:
    """Whether integers may be far from zero: some of them, and therefore all, are more than ``_FAR - 1`` ranges away."""
    some = data[tuple(slice(None, None, max(1, n // _PROBES)) for n in data.shape)]
    low, high = int(some.min()), int(some.max())
    return (low > 0 or high < 0) and min(abs(low), abs(high)) > (_FAR - 1) * (high - low)


def _whole_offset(low: int, high: int, kind: type[np.generic]) -> int:
    """An offset for integers from `low` to `high`, exact in float64, or 0."""
    span, middle = high - low, (low + high) // 2
    if max(-low, high) <= _FAR * span or (low == high and int(float(kind(low))) == low):
        return 0
    quantum = 1 << max(0, span.bit_length() - 1, middle.bit_length() - 53)
    return (middle + quantum // 2) // quantum * quantum


def _offset(low: float, high: float, kind: type[np.generic]) -> float:
    """An offset for samples from `low` to `high`, or 0.

    It has no digits below the largest power of two in the range, so that short numbers have short differences: tenths
    or integers stay so. Differences are exact in float64, because the offset is close to all samples (Sterbenz).
    """
    span = high - low
    with np.errstate(over="ignore"):
        if not is_far(low, high) or (span == 0 and float(kind(low)) == low):
            return 0.0
    if span == 0:
        return low
    quantum = math.frexp(span)[1] - 1
    return math.ldexp(round(math.ldexp(low + span / 2, -quantum)), quantum)


def _with_exact(beyond: float, offset: float, kind: type[np.generic]) -> float:
    """The offset next to `offset` with which numbers of `kind` hold the constant outside exactly."""
    apart = beyond - offset
    last = math.frexp(apart)[1] - _LIMITS[kind].digits
    return beyond - math.ldexp(round(math.ldexp(apart, -last)), last)


def is_far(low: float, high: float) -> bool:
    """Whether samples from `low` to `high` lie far from zero compared with their range."""
    return not low <= 0 <= high and max(-low, high) > _FAR * (high - low)


# -- whether float32 is enough -----------------------------------------------------------------------------------------


def wide_enough(kind: type[np.generic], volume: Volume, filter: Filter, boundary: Boundary) -> type[np.generic]:
    """`kind`, or float64 where a float32 Field would store the samples with an offset or a power of two."""
    return kind if Stored.of(volume, filter, boundary).identity else np.float64


def names_beyond(bits: int, volume: Volume, row: Filter) -> bool:
    """Whether labels, which this filter does not change, need more than `bits` bits: 24 in float32, 53 in float64."""
    if row.support > 1 or volume.data.dtype.kind not in "iu" or volume.data.dtype.itemsize <= bits // 8 or not volume.is_labels:
        return False
    return max(abs(int(v)) for v in volume.limits) > 1 << bits


def too_large_names(low: int, high: int) -> str:
    """What is wrong with labels from `low` to `high` that float32 does not tell apart."""
    return f"labels must be whole numbers that float32 holds to be drawn, up to 2**24; got {low} to {high}: {RENUMBER}"
