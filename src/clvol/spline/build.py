"""`#define`s for the kernels of the spline: a filter, a boundary rule, points, an evaluator."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from clvol.device.program import literal

if TYPE_CHECKING:
    from clvol.device import Device
    from clvol.filter.boundary import Boundary
    from clvol.filter.filter import Filter
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
    "scalar_defines",
    "spared_taps",
]

DefineDict: TypeAlias = dict[str, str | int | float]

_MAJORITY = 0.51  # of weights, with reserve for their rounding


def row_width(filter: Filter, functions: int = 1) -> int:
    """The width of the vectors for a row of the taps of so many functions: 1, 2, 4 or 8."""
    return min(8, int(1 << (functions * filter.support - 1).bit_length()))


def row_reach(filter: Filter, functions: int = 1) -> int:
    """The number of taps of a function that a whole number of these vectors holds, at least the filter's."""
    width = row_width(filter, functions)
    return -(-filter.support // width) * width


def literals(table: np.ndarray[tuple[int, int], np.dtype[np.float64]], write: Callable[[float], str] = literal) -> str:
    """A two-dimensional array as an OpenCL C initializer."""
    return "{" + ",".join("{" + ",".join(map(write, row)) + "}" for row in table.tolist()) + "}"


def filter_defines(filter: Filter, kind: type[np.generic] = np.float32, functions: int = 1) -> DefineDict:
    """The `#define`s of filter.cl and cell.cl for a filter and coefficients of this type, of so many functions side by side."""
    return _filter_defines(filter, kind == np.float64, functions)


@lru_cache(maxsize=256)
def _filter_defines(filter: Filter, double: bool, functions: int) -> DefineDict:
    width, reach = row_width(filter, functions), row_reach(filter, functions)
    columns = np.zeros((filter.degree + 1, reach))
    columns[:, : filter.support] = filter.matrix.T
    number, write = ("double", repr) if double else ("float", literal)
    vector = number if width == 1 else f"{number}{width}"
    rows = [
        "{" + ",".join(f"({vector})({','.join(map(write, part.tolist()))})" for part in np.split(column, reach // width)) + "}"
        for column in columns
    ]
    return {
        "TAPS": filter.support,
        "DEGREE": filter.degree,
        "ROW": width,
        "CHUNKS": reach // width,
        "FILTER_COLUMNS": "{" + ",".join(rows) + "}",
        "FILTER_TAPS": literals(filter.matrix, write),
        "LEFT": filter.support / 2 - 1,
        "GRID_SCALE": filter.scale,
        **({"SCALAR_DOUBLE": 1} if double else {}),
    }


@lru_cache(maxsize=256)
def spared_taps(filter: Filter) -> int:
    """How many outer taps on each side the others of three axes always outvote, with reserve for the rounding of weights."""
    weights = filter.weights(np.linspace(0, 1, 4097))
    most = (filter.support - 1) // 2
    return max(n for n in range(most + 1) if n == 0 or weights[n:-n].sum(0).min() ** 3 > _MAJORITY)


def scalar_defines(kind: type[np.generic]) -> DefineDict:
    """The `#define`s of platform.cl for the type of coefficients; none for float32."""
    return {"SCALAR_DOUBLE": 1} if kind == np.float64 else {}


def along_defines(filter: Filter) -> DefineDict:
    """The `#define`s of along.cl, bernstein.cl and walk.cl for a filter: the function along a line in a cell."""
    n = filter.degree
    pascal = np.array([[math.comb(n - m, j - m) if j >= m else 0 for j in range(n + 1)] for m in range(n + 1)], np.float64)
    along = 3 * n
    return {
        "PASCAL": literals(pascal),
        "BERNSTEIN_DEGREE": along,
        "BERNSTEIN_CHOOSE": "{" + ",".join(literal(float(math.comb(along, j))) for j in range(along + 1)) + "}",
        "JUMPS": int(filter.continuity < 0),
    }


_BOUNDARIES = {"rule": "REPEATED", "constant": "CONSTANT", "overlap": "OVERLAP", "clamp": "ENDING", "grid-constant": "ENDING"}


def boundary_defines(boundary: Boundary, pad: int = 0, reach: int = 0) -> DefineDict:
    """The `#define`s of boundary.cl for a rule; padding and reach are those of the coefficients."""
    return {
        "BOUNDARY": _BOUNDARIES[boundary.outside] if boundary.period else "ENDING",
        "BOUNDARY_FOLDED": int(boundary.fold is not None),
        "BOUNDARY_FOLD": boundary.fold or 0,
        "BOUNDARY_PAD": pad,
        "BOUNDARY_REACH": reach,
    }


def evaluator_defines(evaluator: Evaluator, filter: Filter, dimensions: int, device: Device) -> DefineDict:
    """The `#define`s of fetch.cl, taps.cl and pairs.cl.

    A filter whose weights change sign within a pair of taps is evaluated by direct taps, and so is its gradient if the
    derivatives of the weights change sign.
    """
    paired = evaluator.paired and filter.pairable(0)
    return {
        "DIMENSIONS": dimensions,
        "FETCH_IMAGE": int(evaluator.image),
        "PAIRED_VALUE": int(paired),
        "PAIRED_GRADIENT": int(paired and filter.pairable(1)),
        "COORD_DOUBLE": int(device.has_double),
    }


def point_defines(kind: type[np.generic], *, planar: bool = False, indices: bool = False) -> DefineDict:
    """The `#define`s of position.cl for points of this type."""
    return {
        "POINT": "double" if kind == np.float64 else "float",
        "POINT_BITS": 8 * np.dtype(kind).itemsize,
        "PLANAR": int(planar),
        "INDICES": int(indices),
    }
