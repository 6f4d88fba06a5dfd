"""What matter leaves of light along rays through the function itself: the host side of tracking.cl, which measures shadows."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import OptionError
from clvol.march.shadow import OPAQUE, exponent
from clvol.spline.evaluator import choose_evaluator
from clvol.spline.minmax import BLOCK

if TYPE_CHECKING:
    from clvol.march.shadow import Matter
    from clvol.scene.clip import Cuts
    from clvol.spline.coefficients import Coefficients
    from clvol.spline.minmax import MinMax

__all__ = ["tracked"]

_FINE = 1 / 16  # samples, of steps towards surfaces


def tracked(
    pyramid: MinMax,
    matter: Matter,
    most: float,
    points: NDArray[np.float64],
    directions: NDArray[np.float64],
    *,
    paths: int = 256,
    far: float = math.inf,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """What is left at world points, shape (N, 3), of light from unit directions, (N, 3) or (3,), and its standard errors; (N,).

    The means over random paths, which are the same in each run; of surfaces what crossings leave, without errors. Extinction is at
    most `most`, in base-2 exponents for each world unit; that of matter which is `far` away counts for 1/e. Of what the matter's
    cuts leave, rays are in one piece: `OptionError` for corners.
    """
    if matter.cuts.corners:
        raise OptionError(
            f"tracking takes cuts by a box and planes, which leave rays in one piece; got {len(matter.cuts.corners)} corners"
        )
    coefficients = pyramid.coefficients
    evaluator = choose_evaluator(coefficients.device, coefficients.filter)
    device, stored, sheets = coefficients.device, coefficients.stored, bool(matter.surfaces)
    values, numbers = np.array(matter.surfaces or matter.opacities, np.float64).T
    if sheets:
        numbers = np.minimum(exponent(numbers), OPAQUE)
    listed = np.stack([stored(values), numbers], -1).astype(np.float32)
    spacing = min(coefficients.volume.spacing)
    scale, fade = (_FINE * spacing if sheets else 1 / matter.unit), math.log2(math.e) / far
    defines = {
        **coefficients.defines(evaluator),
        "SHEETS": int(sheets),
        "BLOCK": BLOCK * coefficients.filter.scale,
        "COORD_DOUBLE": 0,
        "LANES": 1,
    }
    found = np.empty((len(points), 2), np.float32)
    with device.buffers.lent(found, write=True) as result, device.errors:
        device.build("march/tracking.cl", defines).kernel("track")(
            device.queue,
            (len(points),),
            device.alone(1),
            coefficients.argument(evaluator),
            coefficients.extent,
            device.buffers.upload(_bounds(pyramid, listed, matter, most)),
            np.array([*pyramid.blocks, 0], np.int32),
            device.buffers.upload(listed),
            np.int32(len(listed)),
            np.float32(scale),
            np.float32(most),
            np.float32(fade),
            np.int32(paths),
            device.buffers.upload(_rays(coefficients, points, directions, matter.cuts)),
            result,
        )
    mean, squares = found.T
    return mean, np.sqrt(np.maximum(squares - mean**2, 0) / paths)


def _bounds(pyramid: MinMax, listed: NDArray[np.float32], matter: Matter, most: float) -> NDArray[np.float32]:
    """The largest extinction in each finest block; of surfaces 1 where some may be."""
    count = math.prod(pyramid.blocks)
    with pyramid.coefficients.device.buffers.mapped(pyramid.buffer, (count, 2), write=False) as ends:
        low, high = ends.astype(np.float64).T
    nodes = [(low <= value) & (high >= value) for value in listed[:, 0]]
    if matter.surfaces:
        return np.asarray(np.any(nodes, 0), np.float32)
    at, opacities = listed.astype(np.float64).T
    largest = np.maximum(np.interp(low, at, opacities), np.interp(high, at, opacities))
    for within, opacity in zip(nodes, opacities, strict=True):
        np.maximum(largest, opacity, out=largest, where=within)
    return np.asarray(np.minimum(exponent(largest) / matter.unit, most), np.float32)


def _rays(
    coefficients: Coefficients, points: NDArray[np.float64], directions: NDArray[np.float64], cuts: Cuts
) -> NDArray[np.float32]:
    """Rays from where they enter what cuts leave of the domain to where they leave it; of those that miss it with a length of 0."""
    volume = coefficients.volume
    edge = coefficients.boundary.edge
    start, way = volume.world_to_index(points), np.broadcast_to(directions, points.shape) @ volume.world_to_index_matrix.T
    low, high = np.full(3, -edge), np.asarray(volume.size) - 1 + edge
    first, last = _between(start, way, low, high)
    if cuts.box is not None:
        first, last = _both((first, last), _between(points, np.broadcast_to(directions, points.shape), *map(np.asarray, cuts.box)))
    for plane in cuts.planes:
        normal = np.array(plane.normal)
        along = np.broadcast_to(directions, points.shape) @ normal
        beyond = ((points - plane.point) @ normal)[:, None]
        first, last = _both((first, last), _between(beyond, along[:, None], -math.inf, 0.0))
    first = np.maximum(first, 0)
    length = np.where(last > first, last - first, 0)
    enters = np.clip(start + np.where(length > 0, first, 0)[:, None] * way, low, high)
    rays = np.column_stack([enters, length, way, np.where(length > 0, first, 0)])
    return rays.astype(np.float32)


def _between(start: NDArray[np.float64], way: NDArray[np.float64], low: Any, high: Any) -> tuple[Any, Any]:
    """From where to where lines are between `low` and `high` along all axes, (N, axes)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ends: Any = np.stack([(low - start) / way, (high - start) / way])
    ends = np.where(way == 0, np.where((start >= low) & (start <= high), [[[-np.inf]], [[np.inf]]], np.inf), ends)
    return ends.min(0).max(1), ends.max(0).min(1)


def _both(one: tuple[Any, Any], other: tuple[Any, Any]) -> tuple[Any, Any]:
    """Where lines are in both intervals."""
    return np.maximum(one[0], other[0]), np.minimum(one[1], other[1])
