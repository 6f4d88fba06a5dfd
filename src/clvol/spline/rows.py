"""Parts of sums along an axis: the samples that some of the sums take, wherever these are kept."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clvol.spline.reduce import Sums

__all__ = ["GAP", "Rows", "Runs", "gathered", "runs_of"]

Runs: TypeAlias = tuple[tuple[int, int], ...]
"""Samples of an axis, those from one to before another, and from a third on."""

GAP = 32  # samples that are read with those on both sides


@dataclass(frozen=True, eq=False)
class Rows:
    """Some rows of sums along an axis, or of an axis that stays, and what they are sums of.

    Attributes
    ----------
    first, last : int
        Of the rows.
    runs : Runs
        The samples that they take.
    sums : Sums or None
        Of these alone, brought together.
    """

    first: int
    last: int
    runs: Runs
    sums: Sums | None

    @classmethod
    def of(cls, sums: Sums | None, first: int, last: int, beside: tuple[int, int] = (0, 0)) -> Rows:
        """Those from `first` to before `last`; their runs hold the samples `beside` too, from one to before another."""
        if sums is None:
            return cls(first, last, ((first, last),), None)
        places = sums.places[first:last]
        within = np.concatenate([places[places < sums.n], np.arange(*beside)])
        runs = runs_of(within if within.size else np.zeros(1, np.int32))  # sums of nothing but a constant take any sample
        own = np.concatenate([np.arange(a, b) for a, b in runs])
        local = np.where(places < sums.n, np.searchsorted(own, places), own.size).astype(np.int32)
        return cls(first, last, runs, Sums(own.size, local, sums.weights[first:last]))

    @property
    def count(self) -> int:
        """Samples that are taken."""
        return sum(b - a for a, b in self.runs)


def runs_of(places: NDArray[Any]) -> Runs:
    """The samples at some places, and those in small gaps between them."""
    own = np.unique(places)
    ends = np.flatnonzero(np.diff(own) > GAP)
    firsts, lasts = own[np.concatenate([[0], ends + 1])], own[np.concatenate([ends, [own.size - 1]])]
    return tuple((int(a), int(b) + 1) for a, b in zip(firsts, lasts, strict=True))


def gathered(read: Callable[[tuple[slice, slice, slice]], NDArray[Any]], runs: Sequence[Runs]) -> NDArray[Any]:
    """The samples in runs along z, y and x, as one array."""
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
