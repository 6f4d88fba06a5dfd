"""The planes on which a view is sampled.

The samples of a ray are where it crosses equally spaced planes perpendicular to one axis of the volume,
the axis most parallel to the view. In index space an axis of ``n`` samples spans ``[-1/2, n - 1/2]``;
it holds ``K`` planes at ``-1/2 + (k + 1/2) n / K``, with ``K`` the smallest number such that no ray advances
more than `step` voxels from one plane to the next. Rays that make an angle of more than 60° with the
axis would need planes too close: they step `step` voxels along themselves, from half a step past their
entry. A ray that meets no plane, or is shorter than half a step, has one sample in its middle.

Where planes of labels would lie on faces between voxels, rounding would decide at each pixel which of two labels it shows: all
planes then move by ``gcd(n, K) / (2 K)``, after which none is nearer to a face.
`reference/march/march.py` samples the same planes.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from clvol.base.errors import OptionError
from clvol.base.uniform import FLOAT, INT, Block
from clvol.base.vectors import length
from clvol.spline.minmax import BLOCK

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clvol.base.uniform import Values
    from clvol.scene.camera import Viewpoint
    from clvol.volume.volume import Volume

__all__ = ["OBLIQUE", "SEGMENT", "SLAB", "Planes"]

OBLIQUE = 0.5  # cosine between ray and axis below which a ray steps along itself
SLAB = 8  # most samples of a segment: a work-item holds a blended plane for each
SEGMENT = float(BLOCK)  # voxels that a segment crosses with dense samples: about one block of the pyramid
_MAX_PLANES = 1 << 20
_MAX_STEP = 1e30  # voxels; longer steps make no difference


class Planes:
    """The planes on which a view is sampled: see the module.

    `span` are the corners, in samples, of a box that the planes cross; they then lie where those of the volume alone would.

    A ray advances by at most `step` voxels between samples, and a segment of a ray crosses `segment` voxels at most. `count` planes
    lie `spacing` voxels apart along `axis` (0 for x); `oblique` says whether some rays step along themselves; the rounding error of
    positions is at most `margin` voxels.

    Raises
    ------
    OptionError
        There would be more than 2²⁰ planes, or samples on a ray.
    GeometryError
        The picture spans so many voxels that float32 does not carry them: `Viewpoint.reach`.
    """

    BLOCK: ClassVar[Block] = Block(
        "planes_block",
        first=FLOAT,
        last=FLOAT,
        spacing=FLOAT,
        stride=FLOAT,
        count=FLOAT,
        oblique=FLOAT,
        slab=FLOAT,
        margin=FLOAT,
        axis=INT,
    )

    def __init__(
        self,
        volume: Volume,
        view: Viewpoint,
        aspect: float,
        step: float,
        segment: float = SEGMENT,
        span: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None,
    ) -> None:
        self.step = step = min(step, _MAX_STEP)
        self._segment = segment
        inverse = volume.world_to_index_matrix
        forward = inverse @ view.forward
        self.axis = int(np.argmax(np.abs(forward)))
        corners = view.corner_rays(inverse, aspect)
        cosine = min(abs(float(d[self.axis])) / length(d) for d in corners)
        if any(d[self.axis] * forward[self.axis] < 0 for d in corners):
            cosine = 0.0  # so wide that some rays run backwards
        self._samples = volume.size[self.axis]
        self.margin = max(0.01, 2.0**-22 * view.reach(volume, aspect))
        self.oblique = cosine < OBLIQUE
        wanted = self._samples / (step * max(cosine, OBLIQUE))
        if wanted > _MAX_PLANES:
            raise OptionError(f"step must give no more than {_MAX_PLANES} planes; {step:g} would give {wanted:.3g}")
        if self.oblique and math.hypot(*volume.size) > _MAX_PLANES * step:
            raise OptionError(f"step must give no more than {_MAX_PLANES} samples a ray; got {step:g} for oblique rays")
        own = max(1, math.ceil(wanted - 1e-9))
        self.spacing = self._samples / own
        shared = math.gcd(self._samples, own)
        self._off = 0.5 * shared / own if volume.is_labels and self._samples // shared % 2 == 0 else 0.0
        low, high = (-0.5, self._samples - 0.5) if span is None else (float(corner[self.axis]) for corner in span)
        self._before = max(0, math.ceil((-0.5 - low) / self.spacing - 1e-9))
        self._behind = max(0, math.ceil((high - self._samples + 0.5) / self.spacing - 1e-9))
        self.count = self._before + own + self._behind
        longest = 0.0 if span is None else float(np.linalg.norm(span[1] - span[0])) / step
        self.most = max(self.count, math.ceil(longest) + 1 if self.oblique else 0)
        if self.most > _MAX_PLANES:
            raise OptionError(f"step must give no more than {_MAX_PLANES} samples a ray through all media; got {step:g}")

    def block(self) -> Values:
        """The kernels' parameters: the planes from both ends, and the samples of a segment."""
        return self.BLOCK(
            first=-0.5 + (0.5 - self._before) * self.spacing + self._off,
            last=self._samples - 0.5 + (self._behind - 0.5) * self.spacing + self._off,
            spacing=self.spacing,
            stride=self.step,
            count=self.count,
            oblique=OBLIQUE,
            slab=min(SLAB, max(1, int(self._segment / max(self.spacing, self.step)))),
            margin=self.margin,
            axis=self.axis,
        )
