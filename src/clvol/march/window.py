"""The part of a volume whose coefficients are resident, a brick: the host side of window.cl, and which rays meet it."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clvol.base.uniform import copied
from clvol.spline.minmax import minmax_block

if TYPE_CHECKING:
    from clvol.base.uniform import Values
    from clvol.bricks.field import BrickedField
    from clvol.bricks.grid import Brick
    from clvol.bricks.residents import Resident
    from clvol.bricks.source import Index
    from clvol.march.frame import Frame
    from clvol.scene.camera import Viewpoint
    from clvol.spline.minmax import MinMax
    from clvol.volume.volume import Volume

__all__ = ["Area", "boxes_of", "brick_inputs", "front_to_back", "may_matter", "pixels_of", "pyramid_of", "set_ends", "share_of"]

Area: TypeAlias = tuple[int, int, int, int]
"""x, y, width and height in pixels."""


def front_to_back(field: BrickedField, view: Viewpoint, box: tuple[Index, Index] | None = None) -> list[Brick]:
    """The bricks of a field, or of a box of them, in an order in which none is behind one that comes later.

    Along each axis they are ordered outwards from the eye, or along the view. The axes may then be nested in any order; an axis
    along which chunks are no longer than bricks is first, so that chunks are decompressed for one layer of bricks at a time.
    """
    grid, inverse = field.volume.grid, field.volume.grid.world_to_index_matrix
    ways = []
    for axis, (first, past) in enumerate(zip(*(box or ((0, 0, 0), field.bricks.counts)), strict=True)):
        if view.orthographic:
            forwards = float((inverse @ view.forward)[axis]) >= 0
            ways.append(list(range(first, past)) if forwards else list(range(first, past))[::-1])
            continue
        eye = (float(view.eye_in(grid)[axis]) - field.bricks.offset) / field.edge
        nearest = min(max(math.floor(eye), first), past - 1)
        ways.append([*range(nearest, past), *range(first, nearest)[::-1]])  # neighbours, which share chunks, are successive
    x, y, z = ways
    along = np.abs(inverse @ view.forward)
    order = sorted(range(3), key=lambda axis: (field.long_chunks[axis], -along[axis], -axis))
    lists = [(x, y, z)[axis] for axis in order]
    places = (dict(zip(order, at, strict=True)) for at in itertools.product(*lists))
    return [field.bricks[at[0], at[1], at[2]] for at in places]


def may_matter(frame: Frame, field: BrickedField, brick: Brick, *, skipping: bool) -> bool:
    """Whether some value in a brick may be visible, by its known bounds."""
    if not (skipping and frame.mode.skips):
        return True
    ends = field.bounds.of(brick)
    return ends is None or frame.mode.interval_matters(*ends, frame.transfer)


def pyramid_of(frame: Frame, field: BrickedField, own: Resident, *, skipping: bool) -> MinMax | None:
    """Minima and maxima in a resident brick, if empty space is skipped."""
    return field.bounds.pyramid(own, frame.evaluator) if skipping and frame.mode.skips else None


def share_of(field: BrickedField) -> float:
    """Of a ray's samples those in a brick, at most."""
    return max(min(1.0, field.edge / n) for n in field.volume.size)


def set_ends(values: Values, brick: Brick, frame: Frame) -> None:
    """Set the kernels' parameters of where a brick is in a frame's block."""
    window = values["window"]
    window["low"], window["high"], window["margin"] = brick.low, brick.high, frame.margin


def brick_inputs(
    frame: Frame, own: Resident, minmax: MinMax | None, brick: Brick, field: BrickedField, table: Any
) -> tuple[Any, ...]:
    """The first arguments of kernels that march rays through a resident brick: as of `Inputs.of_rays`."""
    values, made = copied(frame.values), own.coefficients
    _set_window(values, own, minmax, brick, field)
    set_ends(values, brick, frame)
    values["minmax"] = minmax_block(minmax, field.volume.grid, frame.margin)
    missing = nothing = table  # any buffer: it is not read
    if frame.gaps is not None:
        missing, values["gaps"] = frame.gaps.part(brick.low, brick.high, frame.stride)
    sides = minmax.sides(sought) if minmax is not None and (sought := frame.sought) is not None else nothing
    bounds = nothing if minmax is None else minmax.buffer
    block = frame.device.buffers.upload(values[None])
    return made.argument(frame.evaluator), made.extent, bounds, sides, missing, block, table


def _set_window(values: Values, own: Resident, minmax: MinMax | None, brick: Brick, field: BrickedField) -> None:
    """Set the kernels' parameters of the resident part in a frame's block."""
    stored_from = [first * field.filter.scale for first in brick.first]
    z, y, x = own.coefficients.shape
    cells_from, cells_to = field.bricks.cells(brick)
    first = (0, 0, 0) if minmax is None else minmax.first
    window = values["window"]
    window["cells_from"], window["cells_to"] = cells_from, cells_to
    window["stored_from"] = stored_from
    window["stored_to"] = [first + n for first, n in zip(stored_from, (x, y, z), strict=True)]
    window["blocks_from"] = [a + b for a, b in zip(stored_from, first, strict=True)]
    window["whole"] = field.coefficients.extent[:3]


def boxes_of(places: NDArray[np.float32], down: int, across: int) -> NDArray[np.float32]:
    """The box of a picture in which the rays of each tile of a list are: left, top, right, bottom; (rows, columns, 4)."""
    rows, columns = -(-places.shape[0] // down), -(-places.shape[1] // across)
    boxes = np.empty((rows, columns, 4), np.float32)
    for i in range(rows):
        for j in range(columns):
            tile = places[i * down : (i + 1) * down, j * across : (j + 1) * across].reshape(-1, 2)
            boxes[i, j] = (*tile.min(0), *tile.max(0))
    return boxes


def pixels_of(brick: Brick, view: Viewpoint, grid: Volume, width: int, height: int, beside: int) -> Area:
    """The pixels (left, top, right, bottom) between which rays lie that meet a brick; all of them if it reaches behind the eye."""
    low = np.maximum(np.asarray(brick.low), -0.5) - 1
    high = np.minimum(np.asarray(brick.high), np.asarray(grid.size) - 0.5) + 1
    corners = low + np.array(list(itertools.product((0, 1), repeat=3))) * (high - low)
    away = grid.index_to_world(corners) - view.eye
    ahead = away @ view.forward
    spread = np.ones(8)
    if not view.orthographic:
        if ahead.min() <= 1e-3 * grid.mean_spacing:
            return 0, 0, width, height
        spread = ahead
    x = (away @ view.right / (spread * view.half_height * width / height) + 1) / 2 * width
    y = (1 - away @ view.up / (spread * view.half_height)) / 2 * height
    left, top = (max(0, math.floor(min(float(v.min()), 1e9)) - 1 - beside) for v in (x, y))
    right, bottom = (min(n, math.ceil(max(float(v.max()), -1e9)) + 2 + beside) for v, n in ((x, width), (y, height)))
    return left, top, right, bottom
