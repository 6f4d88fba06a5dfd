"""What lies past the edge: an index rule, and the prefilter that goes with it, as one thing.

The rule extends the *coefficients*: ``c[i]`` for an index outside ``0 .. n - 1`` is ``c[rule(i)]``,
or nothing. Everything else follows from it: the matrix of eq. (11) has row ``i`` and column
``rule(i + k)``, and the prefilter starts and ends its recursions such that it solves that matrix.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.checks import one_of, several, whole
from clvol.errors import OptionError

__all__ = ["DEFAULT_BOUNDARY", "Boundary", "as_boundary", "boundaries"]

DEFAULT_BOUNDARY = "mirror"

# Every rule of this kind that leaves the samples what they are and gives each index past the edge one of them, on axes of
# any length. Without a fold the period is n. A fold -s/2 must lie between the last sample before the volume and its first
# one, so s is 0 or 1; the other fold, half a period further, likewise between samples n - 1 and n: (period - s)/2 is n - 1 or
# n - 1/2.
_RULES = {(None, None), ((1, 0), None)} | {((2, s - 2 + half), s) for s in (0, 1) for half in (0, 1)}


@dataclass(frozen=True)
class Boundary:
    """One rule: indices repeat with a period, whose second half may be folded back.

    Parameters
    ----------
    name : str
        Its name in the table.
    period : tuple of int, optional
        ``(a, b)``: the period on an axis of ``n`` samples is ``a n + b``. None: nothing lies outside.
    fold : int, optional
        ``s``: index ``i`` equals index ``-s - i``, a reflection about ``-s/2``. None: no reflection.
    description : str
        What it means, for listings.

    Raises
    ------
    OptionError
        The rule does not say, on an axis of any length, which one of the samples an index past the edge stands for, or that
        none does. Those that do: no period and no fold; period (1, 0) and no fold; period (2, -2) or (2, -1) and fold 0;
        period (2, -1) or (2, 0) and fold 1.

    Notes
    -----
    The rule extends coefficients, and the domain ends half a voxel past the outer samples. In that outer half voxel "mirror"
    goes on as the function did inside, in the mirror; ITK and VTK keep the outer sample's value there for linear
    interpolation (they clamp), and so does "reflect". See the README.
    """

    name: str
    period: tuple[int, int] | None
    fold: int | None
    description: str
    outside: str = "rule"
    cval: float = 0.0

    def __post_init__(self) -> None:
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
    def repeats(self) -> bool:
        """Whether the coefficients repeat with the period, as far as one goes."""
        return self.period is not None and self.outside == "rule"

    @property
    def edge(self) -> float:
        """How far past the outer samples the function inside goes: half a sample, or nothing where another one begins there."""
        return 0.0 if self.outside in ("constant", "overlap") else 0.5

    def length(self, n: int) -> int:
        """The period in samples on an axis of `n`; at least 1, and 0 if the rule has none."""
        return max(1, self.period[0] * n + self.period[1]) if self.period else 0

    def index(self, i: ArrayLike, n: int) -> NDArray[np.int64]:
        """The index within ``0 .. n - 1`` that stands for `i`; -1 where nothing does."""
        i = np.asarray(i, dtype=np.int64)
        if not self.period:
            return np.where((i >= 0) & (i < n), i, -1)
        return self.folded(i, n)

    def folded(self, i: ArrayLike, n: int, scale: int = 1) -> NDArray[np.int64]:
        """The index that stands for `i` where the rule has a period, on a grid of `scale` coefficients a sample.

        It lies in ``0 .. scale * n - 1``, or next to it: a fold that lies between samples has coefficients of the finer
        grid in its middle, which stand for themselves and are stored in the halo. `boundary_index` in boundary.cl is the
        same rule for kernels.
        """
        period = scale * self.length(n)
        i = np.asarray(i, dtype=np.int64) % period
        return i if self.fold is None else np.asarray(np.minimum(i, period - scale * self.fold - i))

    def position(self, x: ArrayLike, n: int, margin: float) -> NDArray[np.float64]:
        """Positions in samples, brought to where their taps are cheap to find; the function there is the same.

        A position further out than one length of the axis comes to within one period. It is left alone nearer by, so
        that nothing is rounded there. Without a period it is clipped to `margin` samples past the ends, which must be
        so far out that all taps are zero. `boundary_position` in boundary.cl is the same rule for kernels.
        """
        x = np.asarray(x, dtype=np.float64)
        period = self.length(n)
        if not period:
            return np.asarray(np.clip(x, -margin, n + margin))
        far = (x < -n) | (x > 2 * n)
        return np.where(far, np.clip(x - period * np.floor(x / period), 0, period), x)

    def matrix(self, samples: ArrayLike, n: int) -> NDArray[np.float64]:
        """The matrix of eq. (11) on an axis of `n`, for a kernel with these samples at 0, 1, 2, ...; (n, n)."""
        b = np.asarray(samples, dtype=np.float64)
        result = np.zeros((n, n))
        rows = np.arange(n)
        for k in range(-b.size + 1, b.size):
            columns = self.index(rows + k, n)
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
        Boundary("nearest", (2, 0), 1, "the outer samples go on: a a a | a b c d | d d d", "clamp"),
        Boundary("constant", (2, -2), 0, "cval outside the outer samples: k k k | a b c d | k k k", "constant"),
        Boundary("grid-constant", (2, -2), 0, "samples are cval outside: k k k | a b c d | k k k", "grid-constant"),
        Boundary("overlap", (2, -2), 0, "repeated, the first sample upon the last: b c d | a b c d | b c d", "overlap"),
    )
}


def boundaries() -> dict[str, Boundary]:
    """Every rule by name."""
    return dict(_TABLE)


def as_boundary(choice: str | Boundary) -> Boundary:
    """The rule for a name."""
    if isinstance(choice, Boundary):
        return choice
    if isinstance(choice, str) and choice.endswith(")"):
        name, _, cval = choice[:-1].partition("(")
        if name in ("constant", "grid-constant"):
            return replace(_TABLE[name], name=choice, cval=float(cval))
    if not isinstance(choice, str) or choice not in _TABLE:
        raise one_of("boundary", choice, _TABLE)
    return _TABLE[choice]
