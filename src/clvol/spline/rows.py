"""Parts of sums along an axis, and the samples that they read."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clvol.spline.reduce import Sums

__all__ = ["GAP", "Rows", "Runs", "gathered", "runs_of"]

Runs: TypeAlias = tuple[tuple[int, int], ...]
"""Ranges of an axis, as (first, past the last)."""

GAP = 32  # samples; smaller gaps are read too


@dataclass(frozen=True, eq=False)
class Rows:
    """Some rows of the sums along an axis, or of an unchanged axis, and the samples that they read.

    Attributes
    ----------
    first, last : int
        The rows, `last` excluded.
    runs : Runs
        The samples that they read.
    sums : Sums or None
        The same sums over these samples, concatenated; None for an unchanged axis.
    """

    first: int
    last: int
    runs: Runs
    sums: Sums | None

    @classmethod
    def of(cls, sums: Sums | None, first: int, last: int, beside: tuple[int, int] = (0, 0)) -> Rows:
        """The rows from `first` to before `last`; their runs also include the range `beside`."""
        if sums is None:
            return cls(first, last, ((first, last),), None)
        places = sums.places[first:last]
        within = np.concatenate([places[places < sums.n], np.arange(*beside)])
        runs = runs_of(within if within.size else np.zeros(1, np.int32))  # sums of just the constant read any sample
        taken = np.concatenate([np.arange(a, b) for a, b in runs])
        local = np.where(places < sums.n, np.searchsorted(taken, places), taken.size).astype(np.int32)
        return cls(first, last, runs, Sums(taken.size, local, sums.weights[first:last]))

    @property
    def count(self) -> int:
        """The number of samples read."""
        return sum(b - a for a, b in self.runs)


def runs_of(places: NDArray[Any]) -> Runs:
    """The ranges that contain `places`, and small gaps between them."""
    sorted_places = np.unique(places)
    ends = np.flatnonzero(np.diff(sorted_places) > GAP)
    firsts, lasts = sorted_places[np.concatenate([[0], ends + 1])], sorted_places[np.append(ends, sorted_places.size - 1)]
    return tuple((int(a), int(b) + 1) for a, b in zip(firsts, lasts, strict=True))


def gathered(read: Callable[[tuple[slice, slice, slice]], NDArray[Any]], runs: Sequence[Runs]) -> NDArray[Any]:
    """Read the samples in runs along z, y and x into one array."""
    z, y, x = runs
    parts = [
        [
            np.concatenate([read((slice(*k), slice(*j), slice(*i))) for i in x], 2)
            if len(x) > 1
            else read((slice(*k), slice(*j), slice(*x[0])))
            for j in y
        ]
        for k in z
    ]
    rows = [part[0] if len(part) == 1 else np.concatenate(part, 1) for part in parts]
    return rows[0] if len(rows) == 1 else np.concatenate(rows, 0)
