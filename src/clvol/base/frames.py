"""World frames: a patient's LPS and RAS, and affine maps from indices to the world."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clvol.base.checks import one_of
from clvol.base.errors import GeometryError, OptionError

__all__ = ["FRAMES", "SPACES", "Placement", "affine_parts", "flipped", "from_ras", "in_frame", "ras_affine"]

FRAMES = ("LPS", "RAS")
"""Frames of a patient's points: LPS as in ITK and DICOM; RAS as in nibabel and NIfTI, where x points right and y points to
the front. A world without a patient has one frame, which is called "LPS" as well, the default."""

SPACES = {
    "LPS": "a patient: x points to the left, y to the back, z to the head",
    "image": "a stack of images: y points down, and z away from the viewer, as in microscopy programs",
    "": "unspecified: z points up",
}
"""Kinds of world. They set the orientation of pictures, and change no number."""

Placement: TypeAlias = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
"""Spacing, origin and direction (columns) of index axes in the world."""

_FLAT = 1e-4  # largest z of a 2-d image's directions, which files store in float32


def flipped(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vectors, shape (..., d), from LPS to RAS or back: negates x and y. -0 becomes 0."""
    other = vectors.copy()
    other[..., :2] *= -1
    other += 0.0
    return other


def in_frame(points: NDArray[np.float64], frame: str, space: str) -> NDArray[np.float64]:
    """Convert points (..., d), x first, between a volume's world and a frame of its patient, in either direction.

    "LPS" is the volume's world, whatever it is: the points are unchanged. "RAS" negates x and y; it is an `OptionError` for a
    world whose `space` is not "LPS", which has no patient.
    """
    if not isinstance(frame, str) or frame not in FRAMES:
        raise one_of("frame", frame, FRAMES)
    if frame == "LPS":
        return points
    if space != "LPS":
        raise OptionError(
            f'frame="RAS" is for volumes of a patient, whose space is "LPS"; got one whose space is {space!r}: '
            'leave frame out, or say Volume(..., space="LPS")'
        )
    return flipped(points)


def affine_parts(matrix: NDArray[np.float64], origin: NDArray[np.float64]) -> Placement:
    """The placement of an affine map of indices; the direction of an axis of length zero is NaN."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):  # `Volume` rejects values that are not finite
        spacing = np.linalg.norm(matrix, axis=0)
        return spacing, origin, matrix / spacing


def from_ras(placement: Placement, d: int, unit: float) -> dict[str, Any]:
    """`Volume` arguments, in LPS and millimetres, for a grid of `d` axes placed in a RAS world whose unit is `unit` mm.

    `GeometryError` for a 2-d image that is not parallel to the world's xy plane, as `Volume` requires.
    """
    spacing, origin, direction = placement
    if d == 2 and np.abs(direction[2, :2]).max() > _FLAT:
        raise GeometryError(f"an image of two axes must be in the xy plane; its axes point along {direction[:, :2].T.tolist()}")
    return {
        "spacing": spacing[:d] * unit,
        "origin": flipped(origin)[:d] * unit,
        "direction": flipped(direction.T).T[:d, :d],
        "units": "mm",
        "space": "LPS",
    }


def ras_affine(spacing: NDArray[np.float64], origin: NDArray[np.float64], direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """The affine map from indices to RAS, shape (4, 4), of a placement in LPS."""
    d = len(spacing)
    affine = np.eye(4)
    affine[:d, :d] = direction * spacing
    affine[:d, 3] = origin
    return flipped(affine.T).T
