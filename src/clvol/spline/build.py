"""What the kernels of the spline need to know, as `#define`s: of a filter, a boundary rule, points, an evaluator."""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from clvol.boundary import Boundary
from clvol.device import Device
from clvol.filter import Filter
from clvol.program import literal
from clvol.spline.evaluator import Evaluator

__all__ = [
    "DefineDict",
    "along_defines",
    "boundary_defines",
    "evaluator_defines",
    "filter_defines",
    "literals",
    "point_defines",
    "row_reach",
    "row_width",
]

DefineDict: TypeAlias = dict[str, str | int | float]


def row_width(filter: Filter) -> int:
    """The width of the vectors that a row of taps is loaded in: 1, 2, 4 or 8."""
    return min(8, int(1 << (filter.support - 1).bit_length()))


def row_reach(filter: Filter) -> int:
    """How many coefficients the vectors of one row cover: the taps, rounded up."""
    return -(-filter.support // row_width(filter)) * row_width(filter)


def literals(table: np.ndarray[tuple[int, int], np.dtype[np.float64]]) -> str:
    """A two-dimensional array as OpenCL C initialises one."""
    return "{" + ",".join("{" + ",".join(map(literal, row)) + "}" for row in table.tolist()) + "}"


def filter_defines(filter: Filter) -> DefineDict:
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
        "FILTER_TAPS": literals(filter.matrix),
        "LEFT": filter.support / 2 - 1,
        "GRID_SCALE": filter.scale,
    }


def along_defines(filter: Filter) -> DefineDict:
    """What along.cl, bernstein.cl and walk.cl need to know of a filter: the function along a line in a cell."""
    n = filter.degree
    pascal = np.array([[math.comb(n - m, j - m) if j >= m else 0 for j in range(n + 1)] for m in range(n + 1)], np.float64)
    along = 3 * n
    return {
        "PASCAL": literals(pascal),
        "BERNSTEIN_DEGREE": along,
        "BERNSTEIN_CHOOSE": "{" + ",".join(literal(float(math.comb(along, j))) for j in range(along + 1)) + "}",
        "JUMPS": int(filter.continuity < 0),
    }


def boundary_defines(boundary: Boundary) -> DefineDict:
    """What boundary.cl needs to know of a rule."""
    return {
        "BOUNDARY_PERIODIC": int(boundary.period is not None),
        "BOUNDARY_FOLDED": int(boundary.fold is not None),
        "BOUNDARY_FOLD": boundary.fold or 0,
    }


def evaluator_defines(evaluator: Evaluator, filter: Filter, dimensions: int, device: Device) -> DefineDict:
    """What fetch.cl, taps.cl and pairs.cl need to know.

    A filter whose weights change sign within a pair of taps is evaluated by direct taps; so is its gradient if the
    derivatives of its weights do.
    """
    paired = evaluator.paired and filter.pairable(0)
    return {
        "DIMENSIONS": dimensions,
        "FETCH_IMAGE": int(evaluator.image),
        "PAIRED_VALUE": int(paired),
        "PAIRED_GRADIENT": int(paired and filter.pairable(1)),
        "COORD_DOUBLE": int(device.has_double),
    }


def point_defines(kind: type[np.generic]) -> DefineDict:
    """What position.cl needs to know of points of this type."""
    return {"POINT": "double" if kind == np.float64 else "float", "POINT_BITS": 8 * np.dtype(kind).itemsize}
