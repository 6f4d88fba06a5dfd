"""The margin that a block needs on each side: how far coefficients depend on samples."""

from __future__ import annotations

from typing import TypeAlias

from clvol.filter.filter import Filter
from clvol.filter.margin import reach
from clvol.spline.function import Precision

__all__ = ["Margin", "margin"]

Margin: TypeAlias = tuple[int, int]
"""Samples before and after."""


def margin(filter: Filter, precision: Precision) -> Margin:
    """How many samples before and after the one before a position its value depends on: its taps, and what these depend on."""
    low, high = _taps(filter)
    row = filter.magnified_by
    if row is not None:  # its taps lie between two samples
        (low, high), more = _taps(row), 1
    else:
        row, more = filter, 0
    depth = reach(row, precision) + more
    return low + depth, high + depth


def _taps(row: Filter) -> Margin:
    return (row.support - 1) // 2, (row.support + 1) // 2
