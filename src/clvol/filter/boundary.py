"""Boundary rules: what the function is outside the volume, as an index rule together with its prefilter.

The rule extends the *coefficients*: ``c[i]`` for an index outside ``0 .. n - 1`` is ``c[rule(i)]``,
or zero. Everything else follows: the matrix of eq. (11) has row ``i`` and column
``rule(i + k)``, and the prefilter starts and ends its recursions so that it solves that matrix.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base.checks import one_of, several, whole
from clvol.base.errors import OptionError
from clvol.base.shown import Named

__all__ = [
    "DEFAULT_BOUNDARY",
    "REGION_BOUNDARY",
    "UNSAID_BOUNDARY",
    "Boundary",
    "BoundaryTable",
    "Outside",
    "as_boundary",
    "boundaries",
    "chosen_boundary",
    "is_given",
]

DEFAULT_BOUNDARY = "mirror"
REGION_BOUNDARY = (
    "nearest"  # where regions of labels meet the faces: mirrored about outer samples, a ball that is cut would widen again
)

Outside: TypeAlias = Literal["rule", "clamp", "constant", "grid-constant", "overlap"]
_OUTSIDE = ("rule", "clamp", "constant", "grid-constant", "overlap")
_PAD = 12  # samples of padding that scipy.ndimage adds where a rule has no exact prefilter

# Every rule of this kind that keeps the samples unchanged and maps each outside index to one of them, on axes of
# any length. Without a fold the period is n. A fold -s/2 must be between index -1 and index 0, so s is 0 or 1; the
# other fold, half a period further, must be between indices n - 1 and n: (period - s)/2 is n - 1 or
# n - 1/2.
_RULES = {(None, None), ((1, 0), None)} | {((2, s - 2 + half), s) for s in (0, 1) for half in (0, 1)}


@dataclass(frozen=True)
class Boundary:
    """A boundary rule: indices repeat with a period, whose second half may be folded back.

    Parameters
    ----------
    name : str
        Its name in the table.
    period : tuple of int, optional
        ``(a, b)``: the period on an axis of ``n`` samples is ``a n + b``. None: zero outside.
    fold : int, optional
        ``s``: index ``i`` equals index ``-s - i``, a reflection about ``-s/2``. None: no reflection.
    description : str
        Its meaning, for listings.
    outside : {"rule", "clamp", "constant", "grid-constant", "overlap"}
        The function outside. "rule": the index rule extends the coefficients. The others match `scipy.ndimage`; their period
        and fold only set the ends of the prefilter's recursions. "clamp": the outer samples are repeated, some of them before
        the prefilter; "grid-constant": `cval` is repeated likewise; "constant": `cval` outside the outer samples; "overlap": the
        function between the outer samples is repeated, so that the last sample coincides with the first.
    cval : float
        The value outside for "constant" and "grid-constant"; may be NaN.
    given : bool
        False for a default, in place of which labels with smooth boundaries have "nearest".

    Raises
    ------
    OptionError
        The rule does not map every outside index to one sample, or to none, on axes of any length. The rules that do: no
        period and no fold; period (1, 0) and no fold; period (2, -2) or (2, -1) and fold 0; period (2, -1) or (2, 0) and
        fold 1.

    Notes
    -----
    The rule extends coefficients, and the domain ends half a voxel outside the outer samples. In that half voxel "mirror"
    reflects the function inside; ITK and VTK clamp to the outer sample's value there for linear interpolation, and
    so does "reflect". See the README.
    """

    name: str
    period: tuple[int, int] | None
    fold: int | None
    description: str
    outside: Outside = "rule"
    cval: float = 0.0
    given: bool = field(default=True, compare=False, repr=False)

    def __post_init__(self) -> None:
        if self.outside not in _OUTSIDE:
            raise one_of("a boundary's outside", self.outside, _OUTSIDE)
        try:
            if isinstance(self.cval, (bool, str)) or not isinstance(self.cval, (int, float, np.integer, np.floating)):
                raise TypeError
            object.__setattr__(self, "cval", float(self.cval))
        except (TypeError, OverflowError):
            raise OptionError(f"a boundary's cval must be a number that float64 holds; got {self.cval!r}") from None
        if self.outside != "rule" and self.period is None:
            raise OptionError(f"a boundary whose outside is {self.outside!r} must have a period for its prefilter; got None")
        for what in ("name", "description"):
            if not isinstance(getattr(self, what), str):
                raise OptionError(f"a boundary's {what} must be a string; got {getattr(self, what)!r}")
        if self.period is not None:
            rule = "two whole numbers (a, b), or None"
            given = [whole("each number of a boundary's period", v) for v in several("a boundary's period", self.period, rule, 2)]
            object.__setattr__(self, "period", tuple(given))
        if self.fold is not None:
            object.__setattr__(self, "fold", whole("a boundary's fold", self.fold))
        if (self.period, self.fold) not in _RULES:
            allowed = ", ".join(f"{period} and {fold}" for period, fold in sorted(_RULES, key=str))
            raise OptionError(
                "a boundary's period and fold must give every index one of the samples, and each sample its own, on axes of any "
                f"length: {allowed}; got {self.period} and {self.fold}"
            )

    @property
    def ends(self) -> Boundary:
        """The rule that ends the prefilter's recursions: period and fold only."""
        return replace(self, name="", description="", outside="rule", cval=0.0)

    @property
    def repeats(self) -> bool:
        """Whether the coefficients repeat with the period without limit."""
        return self.period is not None and self.outside == "rule"

    @property
    def beyond(self) -> float | None:
        """The coefficient outside, where it is the same everywhere."""
        return 0.0 if self.period is None else self.cval if self.outside == "grid-constant" else None

    @property
    def edge(self) -> float:
        """Distance from the outer samples to the edge of the domain: half a sample, or 0 where the function changes there."""
        return 0.0 if self.outside in ("constant", "overlap") else 0.5

    def padding(self, prefilter: bool, support: int) -> int:
        """Samples of padding on each side of an axis before the prefilter."""
        return max(_PAD, support) if prefilter and self.outside in ("clamp", "grid-constant") else 0

    def reach(self, support: int) -> int:
        """Distance from the padded samples beyond which the function is constant."""
        return support // 2 + 1 if self.outside in ("clamp", "grid-constant") or self.period is None else 0

    def length(self, n: int) -> int:
        """The period on an axis of `n` samples, at least 1; 0 if the rule has none."""
        return max(1, self.period[0] * n + self.period[1]) if self.period else 0

    def index(self, i: ArrayLike, n: int, pad: int = 0) -> NDArray[np.int64]:
        """Map index `i` into ``0 .. n - 1`` or the padding around it; -pad - 1 where there is no coefficient."""
        i = np.asarray(i, dtype=np.int64)
        if self.outside == "clamp":
            return np.asarray(np.clip(i, -pad, n - 1 + pad))
        if not self.period or self.outside == "grid-constant":
            return np.asarray(np.where((i >= -pad) & (i < n + pad), i, -pad - 1))
        return self.folded(i, n)

    def folded(self, i: ArrayLike, n: int) -> NDArray[np.int64]:
        """Map index `i` into ``0 .. n - 1`` by period and fold only, as the prefilter's recursions do at their ends."""
        i = np.asarray(i, dtype=np.int64)
        if not self.period:
            return np.asarray(np.where((i >= 0) & (i < n), i, -1))
        period = self.length(n)
        i = i % period
        return i if self.fold is None else np.asarray(np.minimum(i, period - self.fold - i))

    def position(self, x: ArrayLike, n: int, pad: int = 0, reach: int = 0) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Map `x` to positions of the same value whose taps are all stored; returns them and the sign of derivatives there.

        The sign is -1 where the axis is reflected, 1 elsewhere. "constant" leaves outside positions unchanged: their value
        is known. `boundary_position` in boundary.cl is the same rule for kernels; both match `scipy.ndimage` to the
        last bit.
        """
        x, last = np.asarray(x, dtype=np.float64), n - 1
        forward = np.ones(x.shape)
        if self.outside in ("clamp", "grid-constant") or not self.period:
            low, high = -(pad + reach), last + pad + reach  # all coefficients further out are equal
            rest = x - np.floor(x)
            return np.asarray(np.where(x < low, low - 1 + rest, np.where(x > high, high + rest, x))), forward
        if self.outside == "constant":
            return x, forward
        before, after = x < 0, x > last
        folded = np.zeros(x.shape, np.bool_)
        if self.outside == "overlap":
            length = max(last, 1)
            low, high = x + length * (np.floor(-x / length) + 1), x - length * np.floor(x / length)
        else:
            period = self.length(n)
            high = x - period * np.floor(x / period)
            if self.fold is None:
                low = x + period * (np.floor(np.maximum(-1 - x, 0) / period) + 1)
            else:
                low = x + period * np.floor(-x / period)
                folded = np.where(before, low > -0.5 * period, after & (high >= n))
                low = np.where(low > -0.5 * period, -low - self.fold, low + period)
                high = np.where(high >= n, period - high - self.fold, high)
        brought = np.clip(np.where(before, low, np.where(after, high, x)), -1, n)
        return np.asarray(brought), np.asarray(np.where(folded, -1.0, forward))

    def matrix(self, samples: ArrayLike, n: int) -> NDArray[np.float64]:
        """The matrix of eq. (11) on an axis of `n`, for a kernel with these samples at 0, 1, 2, ...; (n, n)."""
        b = np.asarray(samples, dtype=np.float64)
        result = np.zeros((n, n))
        rows = np.arange(n)
        for k in range(-b.size + 1, b.size):
            columns = self.folded(rows + k, n)
            known = columns >= 0
            np.add.at(result, (rows[known], columns[known]), b[abs(k)])
        return result


_TABLE = {
    row.name: row
    for row in (
        Boundary("mirror", (2, -2), 0, "reflected about the outer samples: d c b | a b c d | c b a"),
        Boundary("reflect", (2, 0), 1, "reflected about the volume's faces: c b a | a b c d | d c b"),
        Boundary("wrap", (1, 0), None, "repeated, the paper's closed curve (eq. 11): b c d | a b c d | a b c"),
        Boundary("zero", None, None, "coefficients are zero outside: 0 0 0 | a b c d | 0 0 0"),
        Boundary("nearest", (2, 0), 1, "outer samples are repeated: a a a | a b c d | d d d", "clamp"),
        Boundary("constant", (2, -2), 0, "one value outside, 0 or constant(v): v v v | a b c d | v v v", "constant"),
        Boundary("grid-constant", (2, -2), 0, "samples of one value outside, 0 or grid-constant(v)", "grid-constant"),
        Boundary("overlap", (2, -2), 0, "repeated, the last sample coincides with the first: b c d | a b c d | b c d", "overlap"),
    )
}
_WITH_VALUE = re.compile(r"(constant|grid-constant)\(([^()]+)\)")


class BoundaryTable(Named[Boundary]):
    """Boundary rules by name, shown as a table."""

    HEADER = ("boundary", "outside the outer samples")

    def rows(self) -> list[tuple[str, ...]]:
        """One tuple of strings per rule, in the order of `HEADER`."""
        return [(name, rule.description) for name, rule in self.items()]


def boundaries() -> BoundaryTable:
    """The boundary rules by name, with their meanings when shown.

    Examples
    --------
    >>> import clvol
    >>> "mirror" in clvol.boundaries()
    True
    """
    return BoundaryTable(_TABLE)


def as_boundary(choice: str | Boundary) -> Boundary:
    """The boundary rule of a name; "constant(v)" and "grid-constant(v)" set the value v outside."""
    if isinstance(choice, Boundary):
        return choice
    if isinstance(choice, str) and (given := _WITH_VALUE.fullmatch(choice)):
        try:
            return replace(_TABLE[given[1]], name=choice, cval=float(given[2]))
        except ValueError:
            raise OptionError(f"the value of a boundary must be a number, as in {given[1]}(5); got {choice!r}") from None
    if not isinstance(choice, str) or choice not in _TABLE:
        raise one_of("boundary", choice, _TABLE)
    return _TABLE[choice]


def is_given(choice: str | Boundary | None) -> bool:
    """Whether a rule was chosen, and is no default."""
    return choice.given if isinstance(choice, Boundary) else choice is not None


UNSAID_BOUNDARY = replace(as_boundary(DEFAULT_BOUNDARY), given=False)


def chosen_boundary(choice: str | Boundary | None) -> Boundary:
    """The rule of a choice, or for None the default, in place of which labels with smooth boundaries have theirs."""
    return UNSAID_BOUNDARY if choice is None else as_boundary(choice)
