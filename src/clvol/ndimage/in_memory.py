"""Plans evaluated on an array in memory."""

from __future__ import annotations

from dataclasses import replace

from numpy.typing import ArrayLike

from clvol.base.errors import DataError, OptionError, OutOfMemoryError
from clvol.device import as_device
from clvol.ndimage.antialiasing import low_passed, nearest_splines
from clvol.ndimage.arguments import Array, as_array, as_output, require_finite
from clvol.ndimage.passes import affinely, along_axes, at_points, filtered, mapped
from clvol.ndimage.plan import Affine, Coefficients, Grid, Mapped, Plan, Points, Substrate

__all__ = ["InMemory"]


class InMemory(Substrate):
    """An array of numbers, or what can be made into one."""

    def __init__(self, input: ArrayLike) -> None:
        self.data = as_array(input)
        self.shape, self.dtype = self.data.shape, self.data.dtype

    def evaluate(self, plan: Plan) -> Array:
        """The result of a plan; by bricks, with a warning, where memory does not hold the coefficients of the array."""
        spline = plan.spline
        if spline.device is not None:
            plan = replace(plan, spline=replace(spline, device=as_device(spline.device)))
        require_finite(self.data, spline.nan)
        try:
            return plan.on(self)
        except OutOfMemoryError as refused:
            from clvol.ndimage.by_bricks import instead

            try:
                return instead(self.data, plan, refused)
            except (OptionError, DataError, OutOfMemoryError):  # by bricks neither
                raise refused from None

    def grid(self, plan: Grid) -> Array:
        """The spline on a grid along the axes."""
        data, result, spline = self.data, self._result(plan, plan.copied), plan.spline
        if plan.copied:
            result[...] = data
        elif plan.nearest and data.size and result.size:
            nearest_splines(data, {axis: p for axis, p in enumerate(plan.positions) if p is not None}, result, spline)
        else:
            data = low_passed(data, plan.sigma, spline) if plan.sigma else data
            along_axes(data, plan.positions, result, spline)
        return result

    def affine(self, plan: Affine) -> Array:
        """The spline on a grid that a matrix places."""
        result = self._result(plan)
        affinely(self.data, plan.axes, plan.matrix, plan.offset, result, plan.spline)
        return result

    def points(self, plan: Points) -> Array:
        """The spline at points."""
        result = self._result(plan)
        at_points(self.data, plan.axes, plan.coordinates, result, plan.spline)
        return result

    def mapped(self, plan: Mapped) -> Array:
        """The spline where a function of the index says."""
        result = self._result(plan)
        mapped(self.data, plan, result, plan.spline)
        return result

    def coefficients(self, plan: Coefficients) -> Array:
        """Spline coefficients."""
        result = self._result(plan, not plan.axes)
        if plan.axes:
            filtered(self.data, plan.axes, result, plan.spline)
        else:
            result[...] = self.data
        return result

    def _result(self, plan: Plan, copied: bool = False) -> Array:
        return as_output(plan.output, self.dtype, plan.shape, copied=copied)
