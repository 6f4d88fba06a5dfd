"""What volumes have in common whether their samples are in memory or read by parts: where these lie, and pictures of them.

This is the only conversion between index space and world space.
"""

from __future__ import annotations

from functools import cached_property
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base.arrays import reals
from clvol.base.errors import OptionError
from clvol.base.frames import in_frame

if TYPE_CHECKING:
    from clvol.volume.volume import Volume

__all__ = ["Gridded"]


class Gridded:
    """Samples on a regular grid in the world."""

    in_parts: ClassVar[bool] = False
    """Whether samples are read part by part, when they are needed."""

    if TYPE_CHECKING:  # what each kind of volume has

        @property
        def grid(self) -> Volume: ...

        @property
        def shape(self) -> tuple[int, ...]: ...

    @property
    def ndim(self) -> int:
        """2 for images, 3 for volumes."""
        return len(self.shape)

    @property
    def size(self) -> tuple[int, ...]:
        """Samples along x, y(, z), in the order of the geometry: `shape` reversed."""
        return self.shape[::-1]

    @cached_property
    def index_to_world_matrix(self) -> NDArray[np.float64]:
        """``world = M @ index + origin``; shape (d, d), index in (x, y, z)."""
        return np.asarray(self.grid.direction * np.asarray(self.grid.spacing))

    @cached_property
    def world_to_index_matrix(self) -> NDArray[np.float64]:
        """``index = M @ (world - origin)``; shape (d, d)."""
        return np.linalg.inv(self.index_to_world_matrix).astype(np.float64)

    def index_to_world(self, index: ArrayLike, frame: str = "LPS") -> NDArray[np.float64]:
        """World positions of index positions; shape (..., d), both in (x, y, z), the world's in a `frame` of `FRAMES`."""
        with np.errstate(over="ignore", invalid="ignore"):  # positions may be infinite
            world = _points(self, "index", index) @ self.index_to_world_matrix.T + np.asarray(self.grid.origin)
        return in_frame(world, frame, self.grid.space)

    def world_to_index(self, world: ArrayLike, frame: str = "LPS") -> NDArray[np.float64]:
        """Index positions of world positions; shape (..., d), both in (x, y, z), the world's in a `frame` of `FRAMES`."""
        points = in_frame(_points(self, "world", world), frame, self.grid.space)
        with np.errstate(over="ignore", invalid="ignore"):
            return np.asarray((points - np.asarray(self.grid.origin)) @ self.world_to_index_matrix.T)

    @cached_property
    def mean_spacing(self) -> float:
        """The mean spacing in world units: the unit of length in kernels."""
        return float(np.mean(self.grid.spacing))

    @cached_property
    def corners(self) -> NDArray[np.float64]:
        """World positions of the domain's corners, half a voxel outside the outer samples; (2**d, d)."""
        low, high = -0.5, np.asarray(self.size) - 0.5
        steps = np.stack(np.meshgrid(*[[0.0, 1.0]] * self.ndim, indexing="ij"), -1).reshape(-1, self.ndim)
        return self.index_to_world(low + steps * (high - low))

    @cached_property
    def center(self) -> NDArray[np.float64]:
        """World position of the middle of the domain; shape (d,)."""
        return self.index_to_world((np.asarray(self.size) - 1) / 2)

    @cached_property
    def radius(self) -> float:
        """Radius of the sphere around the domain, in world units."""
        return float(np.linalg.norm(self.corners - self.center, axis=1).max())

    # -- pictures: the renderer is floors above, and imported when it is first used ------------

    def render(self, *arguments: Any, **options: Any) -> Any:
        """One picture: ``clvol.render(volume, camera, mode, size, step, **options)``, whose arguments it takes.

        Returns
        -------
        Picture, or dict of str to Picture
            As `clvol.render`.

        Raises
        ------
        ClvolError
            As by `clvol.render`.

        Examples
        --------
        >>> import clvol
        >>> volume = clvol.phantoms.marschner_lobb(16)
        >>> volume.render(clvol.Camera.orbit(40, 10), "mip", (30, 20)).shape
        (20, 30, 4)
        """
        return import_module("clvol.march.renderer").render(self, *arguments, **options)

    def plot(self, *arguments: Any, **options: Any) -> None:
        """Render a picture and show it: ``clvol.show(volume.render(...))``, in a notebook below the cell.

        Raises
        ------
        ClvolError
            As by `clvol.render` and `clvol.show`.
        """
        import_module("clvol.show.picture").show(self.render(*arguments, **options))


def _points(grid: Gridded, what: str, points: ArrayLike) -> NDArray[np.float64]:
    array = reals(what, points, f"numbers of shape (..., {grid.ndim})")
    if array.ndim == 0 or array.shape[-1] != grid.ndim:
        raise OptionError(f"{what} must have shape (..., {grid.ndim}); got {array.shape}")
    return array
