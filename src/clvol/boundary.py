"""What lies past the edge: an index rule, and the prefilter that goes with it, as one thing.

The rule extends the *coefficients*: ``c[i]`` for an index outside ``0 .. n - 1`` is ``c[rule(i)]``,
or nothing. Everything else follows from it: the matrix of eq. (11) has row ``i`` and column
``rule(i + k)``, and the prefilter starts and ends its recursions such that it solves that matrix.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.checks import one_of

__all__ = ["DEFAULT_BOUNDARY", "Boundary", "as_boundary", "boundaries"]

DEFAULT_BOUNDARY = "mirror"


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
    """

    name: str
    period: tuple[int, int] | None
    fold: int | None
    description: str

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
    )
}


def boundaries() -> dict[str, Boundary]:
    """Every rule by name."""
    return dict(_TABLE)


def as_boundary(choice: str | Boundary) -> Boundary:
    """The rule for a name."""
    if isinstance(choice, Boundary):
        return choice
    if not isinstance(choice, str) or choice not in _TABLE:
        raise one_of("boundary", choice, _TABLE)
    return _TABLE[choice]
