"""What kernels need to know of a filter and of a boundary rule, as `#define`s."""

from __future__ import annotations

import numpy as np

from clvol.boundary import Boundary
from clvol.filter import Filter
from clvol.program import literal

__all__ = ["boundary_defines", "filter_defines", "row_reach", "row_width"]


def row_width(filter: Filter) -> int:
    """The width of the vectors that a row of taps is loaded in: 1, 2, 4 or 8."""
    return min(8, int(1 << (filter.support - 1).bit_length()))


def row_reach(filter: Filter) -> int:
    """How many coefficients the vectors of one row cover: the taps, rounded up."""
    return -(-filter.support // row_width(filter)) * row_width(filter)


def filter_defines(filter: Filter) -> dict[str, str | int | float]:
    """What filter.cl and cell.cl need to know of a filter."""
    width, reach = row_width(filter), row_reach(filter)
    columns = np.zeros((filter.degree + 1, reach))
    columns[:, : filter.support] = filter.matrix.T
    vector = "float" if width == 1 else f"float{width}"
    rows = [
        "{" + ",".join(f"({vector})({','.join(map(literal, part))})" for part in np.split(column, reach // width)) + "}"
        for column in columns
    ]
    return {
        "TAPS": filter.support,
        "DEGREE": filter.degree,
        "ROW": width,
        "CHUNKS": reach // width,
        "FILTER_COLUMNS": "{" + ",".join(rows) + "}",
        "FILTER_TAPS": "{" + ",".join("{" + ",".join(map(literal, tap)) + "}" for tap in filter.matrix) + "}",
        "LEFT": filter.support / 2 - 1,
        "GRID_SCALE": filter.scale,
    }


def boundary_defines(boundary: Boundary) -> dict[str, str | int | float]:
    """What boundary.cl needs to know of a rule."""
    return {
        "BOUNDARY_PERIODIC": int(boundary.period is not None),
        "BOUNDARY_FOLDED": int(boundary.fold is not None),
        "BOUNDARY_FOLD": boundary.fold or 0,
    }
