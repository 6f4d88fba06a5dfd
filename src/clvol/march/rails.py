"""Where rays take their samples: on planes of one grid, which several media share.

The media of a picture take their samples at the same places of each ray, where their extinctions add. The planes are those of the
first one (`clvol.march.planes`), where they would lie without the others, and more of them across a box that holds all.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from clvol.base.uniform import FLOAT, INT, Block
from clvol.march.planes import SEGMENT, Planes
from clvol.scene.camera import Viewpoint

if TYPE_CHECKING:
    from clvol.base.uniform import Values
    from clvol.scene.scene import Medium
    from clvol.volume.volume import Volume

__all__ = ["RAILS", "Rails"]

_ASTRAY = 1e-3  # voxels, by which planes of another grid may stray from its own

RAILS = Block(
    "rails_block",
    **Viewpoint.BLOCK.fields,  # in the grid that leads
    low=(FLOAT, 3),
    high=(FLOAT, 3),
    aligned=INT,  # whether planes of that grid lie across the same axis of this one, at scale * position + shift
    scale=FLOAT,
    shift=FLOAT,
)


@dataclass(frozen=True)
class Rails:
    """The planes of a picture's samples, of the grid of `volume`; the box from `low` to `high`, in its samples, holds all media."""

    volume: Volume
    planes: Planes
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    several: bool

    @classmethod
    def along(cls, volume: Volume, planes: Planes) -> Rails:
        """The rails of one medium."""
        return cls(volume, planes, np.zeros(3), np.zeros(3), several=False)

    @classmethod
    def across(cls, media: Sequence[Medium], view: Viewpoint, aspect: float, step: float) -> Rails:
        """The rails of several media, of which the first leads."""
        volume = media[0].volume
        corners = np.concatenate([volume.world_to_index(one.volume.index_to_world(_corners(one))) for one in media])
        low, high = corners.min(0), corners.max(0)
        return cls(volume, Planes(volume, view, aspect, step, SEGMENT, (low, high)), low, high, several=True)

    def block(self, volume: Volume, view: Viewpoint, width: int, height: int, aspect: float) -> Values:
        """The kernels' parameters for a medium; of one alone they are not read."""
        if not self.several:
            return np.zeros((), RAILS.dtype)
        axis = self.planes.axis
        matrix = volume.world_to_index_matrix @ self.volume.index_to_world_matrix
        scales = np.diag(matrix)
        stray = np.abs(matrix - np.diag(scales)) @ np.abs(self.high - self.low)
        shift = volume.world_to_index(self.volume.index_to_world(np.zeros(3)))[axis]
        camera = view.block(self.volume, width, height, aspect)
        return RAILS(
            **{name: camera[name] for name in Viewpoint.BLOCK.fields},
            low=self.low,
            high=self.high,
            aligned=bool((scales > 0).all() and (stray < _ASTRAY).all()),
            scale=scales[axis],
            shift=shift,
        )

    def margin(self, volume: Volume, view: Viewpoint, aspect: float) -> float:
        """The rounding error of positions in a medium's samples, at most."""
        if volume is self.volume:
            return self.planes.margin
        return max(self.planes.margin, 2.0**-22 * view.reach(volume, aspect))

    def stride(self, volume: Volume) -> float:
        """The most of a medium's samples that a ray advances at a step, along one axis."""
        if volume is self.volume:
            return self.planes.step
        return self.planes.step * max(self.volume.spacing) / min(volume.spacing)


def _corners(medium: Medium) -> NDArray[np.float64]:
    low, high = medium.domain
    return np.where(list(itertools.product((False, True), repeat=3)), high, low)
