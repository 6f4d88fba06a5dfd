"""What matter leaves of light, in float64: along lines through the function itself, past its surfaces, and through cells of mean
extinction.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from clvol.base.arrays import Array
from clvol.filter.filter import Filter
from clvol.reference.march.rays import Rays, kept_parts
from clvol.reference.march.roots import crossings_by
from clvol.reference.spline.points import sample
from clvol.scene.clip import Cuts
from clvol.volume.volume import Volume

__all__ = ["extinction", "light_past", "light_through_cells", "light_to"]

_NO_CUTS = Cuts()
_LEVELS = 200  # of values between the corners of a part


def extinction(
    volume: Volume, filter: Filter, counts: tuple[int, ...], exponent: Callable[[Array], Array], parts: int = 2
) -> Array:
    """The mean of `exponent` of values in cells that divide the domain, [z, y, x].

    In each of `parts` of a cell along each axis values are spread evenly between the extremes of its corners: their mean is a sum
    over many levels.
    """
    axes = [(np.arange(n * parts + 1) * (size / (n * parts)) - 0.5) for n, size in zip(counts, volume.size, strict=True)]
    x, y, z = np.meshgrid(*axes[::-1], indexing="ij")[::-1]
    values = sample(volume, volume.index_to_world(np.stack([x, y, z], -1).reshape(-1, 3)), filter, "mirror").reshape(x.shape)
    corners = np.stack(
        [values[c : c - 1 or None, b : b - 1 or None, a : a - 1 or None] for a in (0, 1) for b in (0, 1) for c in (0, 1)]
    )
    low, high = corners.min(0), corners.max(0)
    means = sum(exponent(low + (k + 0.5) / _LEVELS * (high - low)) for k in range(_LEVELS)) / _LEVELS
    nx, ny, nz = counts
    return np.asarray(np.asarray(means).reshape(nz, parts, ny, parts, nx, parts).mean((1, 3, 5)))


def light_through_cells(extinction: Array, direction: Array) -> Array:
    """What is left of light from `direction`, in nodes (x, y, z) for each world unit, at the middles of cells, [z, y, x].

    Light goes along lines through the nodes of the plane where it enters, across the axis that it is most along: what is left
    of it at a node is blended from the four lines around. Each is followed here from its place beside the node; on it extinction,
    which is 0 beyond all nodes, is linear from plane to plane, and counts from the plane before.
    """
    axis = int(np.abs(direction).argmax())
    step, length, padded = direction / np.abs(direction[axis]), 1 / float(np.abs(direction[axis])), np.pad(extinction, 1)
    nodes = np.stack([*np.indices(extinction.shape)][::-1], -1).reshape(-1, 3)
    count = extinction.shape[2 - axis]
    planes = count - 1 - nodes[:, axis] if step[axis] > 0 else nodes[:, axis]  # from where light enters
    shares = np.delete((nodes + planes[:, None] * step) % 1, axis, 1)
    light = np.zeros(len(nodes))
    for corner in np.ndindex(2, 2):
        places = nodes + np.insert(corner - shares, axis, 0, 1)
        exponent = np.zeros(len(nodes))
        for m in range(1, count):
            at = np.clip(places + m * step + 1, 0, np.array(padded.shape[::-1]) - 1.0)
            whole = np.minimum(at.astype(np.int64), np.array(padded.shape[::-1]) - 2)
            for side in np.ndindex(2, 2, 2):
                i, j, k = (whole + side).T
                share = np.where(side, at - whole, 1 - (at - whole)).prod(1)
                exponent += (0.5 if m == 1 else 1.0) * (m <= planes) * length * share * padded[k, j, i]
        light += np.where(corner, shares, 1 - shares).prod(1) * np.exp2(-exponent)
    return np.asarray(light.reshape(extinction.shape))


def light_to(
    volume: Volume,
    filter: Filter,
    exponent: Callable[[Array], Array],
    points: Array,
    direction: Array,
    step: float,
    cuts: Cuts = _NO_CUTS,
) -> Array:
    """What is left of light from a unit direction at world points, (N, 3): of the function, in steps in world units."""
    total = np.zeros(len(points))
    for t in np.arange(step / 2, 2 * volume.radius, step):
        at = points + t * direction
        index = volume.world_to_index(at)
        inside = ((index >= -0.5) & (index <= np.array(volume.size) - 0.5)).all(-1) & cuts.keep(at)
        if inside.any():
            total[inside] += step * exponent(sample(volume, at[inside], filter, "mirror"))
    return np.asarray(np.exp2(-total))


def light_past(
    surfaces: Sequence[tuple[Callable[[Rays], Array], float]],
    volume: Volume,
    rays: Rays,
    cuts: Cuts,
    blocks: Callable[[Array], NDArray[np.bool_]] | None = None,
) -> Array:
    """What surfaces leave of light along rays to it; each is given by what finds the first crossings on rays, and an opacity.

    Of surfaces only what cuts keep is there. If they have caps, `blocks` tells at which places of the faces of cuts.
    """
    left = np.ones(len(rays.enter))
    for part, face in kept_parts(rays, cuts):
        for first, opacity in surfaces:
            for on, _ in crossings_by(first, volume, part):
                left[on] *= 1 - opacity
        if blocks is not None and face.any():
            left[face] *= ~blocks(part.at(part.enter[face], face))
    return left
