"""A call of `clvol.ndimage` in one form, and the interface of what evaluates it: in memory, by bricks, or as a graph of dask."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.checks import one_of
from clvol.ndimage.arguments import (
    NAN,
    AnyDevice,
    Array,
    Nan,
    Order,
    Progress,
    Spline,
    as_coordinates,
    as_cval,
    as_mode,
    as_order,
    as_precision,
    require_of_labels,
)
from clvol.spline.field import Precision

__all__ = ["Affine", "Coefficients", "Grid", "Mapped", "Plan", "Points", "Substrate"]

_Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Plan(ABC):
    """What to evaluate, its arguments checked: the function that was called, `output` as SciPy takes it, the result's shape."""

    function: str
    spline: Spline
    output: Any
    shape: tuple[int, ...]

    @abstractmethod
    def on(self, samples: Substrate) -> Array:
        """Evaluate it on a substrate."""


@dataclass(frozen=True, eq=False)
class Grid(Plan):
    """A grid along the axes, at positions in samples; None: those of the samples.

    A Gaussian of standard deviations `sigma`, in samples, precedes it. `nearest`: the result is the least-squares spline on this
    grid. `copied`: it is a copy of the samples.
    """

    positions: Sequence[_Floats | None]
    sigma: Mapping[int, float] = field(default_factory=dict)
    nearest: bool = False
    copied: bool = False

    def on(self, samples: Substrate) -> Array:
        return samples.grid(self)


@dataclass(frozen=True, eq=False)
class Affine(Plan):
    """A grid at ``matrix @ i + offset`` along some axes, ascending; the others are left as they are."""

    axes: Sequence[int]
    matrix: _Floats
    offset: _Floats

    def on(self, samples: Substrate) -> Array:
        return samples.affine(self)

    def of_all_axes(self, ndim: int) -> tuple[_Floats, _Floats]:
        """Matrix and offset of all `ndim` axes."""
        if len(self.axes) == ndim:
            return self.matrix, self.offset
        matrix, offset = np.eye(ndim), np.zeros(ndim)
        matrix[np.ix_(self.axes, self.axes)], offset[list(self.axes)] = self.matrix, self.offset
        return matrix, offset


@dataclass(frozen=True, eq=False)
class Points(Plan):
    """Points with coordinates along some axes, ascending; the other axes come first in the result."""

    axes: Sequence[int]
    coordinates: Any

    def on(self, samples: Substrate) -> Array:
        return samples.points(self)


@dataclass(frozen=True, eq=False)
class Mapped(Plan):
    """The positions that a function returns for each index of the result."""

    mapping: Callable[..., Sequence[float]]
    arguments: tuple[Any, ...]
    keywords: Mapping[str, Any]

    def on(self, samples: Substrate) -> Array:
        return samples.mapped(self)

    @property
    def at(self) -> Callable[[tuple[int, ...]], Sequence[float]]:
        """The position for an index."""
        extra = self.arguments or self.keywords
        return (lambda index: self.mapping(index, *self.arguments, **self.keywords)) if extra else self.mapping


@dataclass(frozen=True, eq=False)
class Coefficients(Plan):
    """The coefficients along some axes; along none they are a copy of the samples."""

    axes: Sequence[int]

    def on(self, samples: Substrate) -> Array:
        return samples.coefficients(self)


class Substrate(ABC):
    """The samples of an input, and how plans are evaluated on them. Results are arrays, of dask where the input is one.

    `precision` is the default of `spline`; None: by the dtype.
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    precision: Precision | None = None

    @property
    def ndim(self) -> int:
        """The number of axes."""
        return len(self.shape)

    def spline(
        self,
        order: Order,
        mode: str,
        cval: complex,
        prefilter: bool,
        precision: Precision | None,
        device: AnyDevice,
        nan: Nan,
        progress: Progress,
    ) -> Spline:
        """The options of a call, checked. The device is not looked up."""
        labels = isinstance(order, str) and order == "labels"
        if labels:
            require_of_labels(self.dtype, precision, nan)
        number, rule, outside = as_order(5 if labels else order), as_mode(mode), as_cval(cval, self.dtype.kind == "c")
        if nan not in NAN:
            raise one_of("nan", nan, NAN)
        chosen = as_precision(self.precision if precision is None else precision, self.dtype)
        return Spline(number, rule, outside, bool(prefilter) and not labels, chosen, device, progress, nan, labels)

    def as_coordinates(self, coordinates: Any, count: int) -> Any:
        """Positions along `count` axes, checked."""
        return as_coordinates(coordinates, count)

    def evaluate(self, plan: Plan) -> Array:
        """The result of a plan."""
        return plan.on(self)

    @abstractmethod
    def grid(self, plan: Grid) -> Array:
        """The spline on a grid along the axes."""

    @abstractmethod
    def affine(self, plan: Affine) -> Array:
        """The spline on a grid that a matrix places."""

    @abstractmethod
    def points(self, plan: Points) -> Array:
        """The spline at points."""

    @abstractmethod
    def mapped(self, plan: Mapped) -> Array:
        """The spline where a function of the index says."""

    @abstractmethod
    def coefficients(self, plan: Coefficients) -> Array:
        """Spline coefficients."""
