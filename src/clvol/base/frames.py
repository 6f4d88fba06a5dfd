"""World frames: the LPS and RAS of a patient, and affine maps from indices into the world."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clvol.base.checks import one_of
from clvol.base.errors import GeometryError, OptionError

__all__ = ["FRAMES", "Placement", "affine_parts", "flipped", "from_ras", "in_frame", "ras_affine"]

FRAMES = ("LPS", "RAS")
"""The frames of a patient's points: that of ITK and DICOM, and that of nibabel and NIfTI, in which x runs to the right and y to
the front. A world that is no patient's has one frame, its own, which is called "LPS" too, for it is the default."""

Placement: TypeAlias = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
"""Spacing, origin and direction (columns) of index axes in the world."""

_FLAT = 1e-4  # largest z of the directions of an image of two axes: files keep them in float32


def flipped(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vectors, shape (..., d), from LPS to RAS or back: x and y change their sign. -0 becomes 0."""
    other = vectors.copy()
    other[..., :2] *= -1
    other += 0.0
    return other


def in_frame(points: NDArray[np.float64], frame: str, space: str) -> NDArray[np.float64]:
    """Points between a volume's world and a frame of its patient; the same for both ways.

    Parameters
    ----------
    points : array of float64, shape (..., d)
        In (x, y, z).
    frame : {"LPS", "RAS"}
        "LPS": the volume's world, whatever it is; the points are returned as they are. "RAS": x and y change their sign.
    space : str
        `Volume.space`; only "LPS" has a RAS.

    Raises
    ------
    OptionError
        `frame` is neither, or the world is no patient's.
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
    """The placement that an affine map of indices gives; the direction of an axis of no length is NaN."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):  # a volume refuses what is not finite
        spacing = np.linalg.norm(matrix, axis=0)
        return spacing, origin, matrix / spacing


def from_ras(placement: Placement, d: int, unit: float) -> dict[str, Any]:
    """The geometry in LPS and millimetres, as arguments of `Volume`, of a grid of `d` axes in a RAS world in units of `unit` mm.

    Raises
    ------
    GeometryError
        An image of two axes lies across the world's xy plane, in which a `Volume` keeps images.
    """
    spacing, origin, direction = placement
    if d == 2 and np.abs(direction[2, :2]).max() > _FLAT:
        raise GeometryError(f"an image of two axes must lie in the xy plane; its axes run along {direction[:, :2].T.tolist()}")
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
