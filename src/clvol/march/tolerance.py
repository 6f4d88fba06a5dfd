"""The step that a tolerance allows: how far rays of a picture may advance between samples, told by small pictures of the same view.

A probe is the picture with few pixels and one ray each, drawn as the picture itself is: in memory, by bricks, of several media,
with shadows and cut faces. Probes have steps of 1, 1/2, 1/4, ... voxels. Each is compared with the finest so far. What that one is
still off by follows from the last two differences: they shrink by a ratio r from one to the next, and as what a step misses is not
what the next one misses, squares add up, to r² / (1 - r²) of the last. Once the root of both squares is below the tolerance for a
step, a longer one, between it and the step before, is tried: that of the line through their errors in logarithms. Steps that no
probe had are never taken: errors of edges and thin shells do not only grow with the step.

Few of the pixels may have most of the error. So three standard errors are added to the mean of the squares.

Errors are the root of the mean square of the differences of colours, 0..1 as they are shown, over the pixels that show more than
the background in either picture. Without a background they are of opacity too, and colours count as much as they are opaque.
What 1600 rays do not meet, they do not tell.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.checks import warn
from clvol.march.refine import Cancelled
from clvol.scene.mode import without_tolerance

if TYPE_CHECKING:
    from collections.abc import Sequence

    from clvol.base.progress import Progress
    from clvol.march.options import ResolvedLook
    from clvol.march.recipe import Staged
    from clvol.march.refine import Asked, Refined
    from clvol.march.source import Source

__all__ = ["difference", "refined", "with_step"]

_PIXELS = 1600  # of a probe
_HALVINGS = 6  # of the longest step, 1 voxel
_SAFETY = 1.25  # pictures have other rays than their probes, and each step another order
_STANDARD_ERRORS = 3.0
_LESS = 0.75  # of the tolerance, which a step between two probes is to have
_WORTH = 1.1  # times as long must such a step be, to be tried
_RATIOS = 0.25, 0.75  # of differences from one probe to the next: no better than second order, and slow where shells are thin
_SEEN = 1 / 512  # half a step of 8 bits

Colors = NDArray[np.float64]
"""Red, green, blue and opacity of pixels, premultiplied."""


def with_step(stage: Staged, source: Source, progress: Progress | None = None) -> Staged:
    """A stage whose step is what its tolerance allows, if it has one; `progress` is called while probes are drawn, and may raise.

    Warns if the finest step does not reach it.
    """
    tolerance, (width, height) = stage.fine.tolerance, stage.fine.size
    if tolerance is None:
        return stage
    look, drawn = (_without_tolerance(one) for one in (stage.look, stage.drawn))
    scale = min(1.0, math.sqrt(_PIXELS / (width * height)))
    small = max(1, round(scale * width)), max(1, round(scale * height))
    lod = stage.fine.lod * small[1] / height  # the level of the picture

    def probe(step: float) -> Colors:
        fine = replace(stage.fine, size=small, step=step, rays=1, lod=lod)
        return _premultiplied(source.draw(look, fine, False, progress)["rgba"])

    step, error = _allowed(tolerance, probe, np.array([*look.scene.background, 1.0] if look.scene.background else [0.0] * 4))
    if error > tolerance:
        off = f"with the shortest step, 1/64 voxel, colours are off by some {error:.2g}"
        warn(f"tolerance {tolerance:g} is not reached: {off}", f"tolerance {tolerance:g}")
    return stage._replace(look=look, drawn=drawn, fine=replace(stage.fine, step=step))


def refined(stage: Staged, source: Source, asked: Asked) -> Iterator[Refined]:
    """The pictures of `Renderer.refine`; probes come before the first."""
    if stage.fine.tolerance is None:
        return stage.refined(source.refine(stage.drawn, stage.fine, asked), source)
    return _probed(stage, source, asked)


def difference(first: NDArray[np.floating[Any]], second: NDArray[np.floating[Any]], background: Sequence[float] | None) -> float:
    """How far two pictures are apart: the error that a tolerance is for."""
    behind = np.array([*background, 1.0] if background else [0.0] * 4)
    return _difference(_premultiplied(first), _premultiplied(second), behind)


# -- inner -------------------------------------------------------------------------------------------------


def _probed(stage: Staged, source: Source, asked: Asked) -> Iterator[Refined]:
    try:
        with source.in_use():
            found = with_step(stage, source, asked.require_wanted)
    except Cancelled:
        return
    yield from found.refined(source.refine(found.drawn, found.fine, asked), source)


def _without_tolerance(look: ResolvedLook) -> ResolvedLook:
    given = None if look.unsettled is None else without_tolerance(look.unsettled)
    return replace(look, mode=without_tolerance(look.mode), unsettled=given, others=tuple(map(_without_tolerance, look.others)))


def _allowed(tolerance: float, probe: Callable[[float], Colors], behind: Colors) -> tuple[float, float]:
    """The longest step that a tolerance allows, and the error to expect."""
    probes, last = [probe(1.0)], math.inf
    for halvings in range(1, _HALVINGS + 1):
        probes.append(finest := probe(0.5**halvings))
        errors = [_difference(one, finest, behind, _STANDARD_ERRORS) for one in probes]
        change = errors[-2]
        ratio = min(max(change / last, _RATIOS[0]), _RATIOS[1]) if 0 < last < math.inf else _RATIOS[1]
        lacking = change * ratio / math.sqrt(1 - ratio**2)
        expected = [_SAFETY * math.hypot(error, lacking) for error in errors]
        last = change
        k = next((k for k, error in enumerate(expected) if error <= tolerance), None)
        if k is None or (k and halvings == 1):  # two probes show no ratio, and only suffice for the longest step
            continue
        step = _between(expected, k, tolerance)
        if step > _WORTH * 0.5**k:
            error = _SAFETY * math.hypot(_difference(probe(step), finest, behind, _STANDARD_ERRORS), lacking)
            if error <= tolerance:
                return step, error
        return 0.5**k, expected[k]
    return 0.5**_HALVINGS, expected[-1]


def _between(expected: Sequence[float], k: int, tolerance: float) -> float:
    """The step whose error should be a little within the tolerance: from that of number k, which is, to the one before."""
    if k == 0 or expected[k] == 0:
        return 0.5**k
    order = math.log2(expected[k - 1] / expected[k])
    return float(f"{0.5**k * max(1.0, _LESS * tolerance / expected[k]) ** (1 / order):.3g}")


def _premultiplied(picture: NDArray[np.floating[Any]]) -> Colors:
    colors = picture.astype(np.float64)
    colors[..., :3] *= colors[..., 3:]
    return colors


def _difference(first: Colors, second: Colors, behind: Colors, above: float = 0.0) -> float:
    """How far pictures are apart; by the mean of squares and this many of its standard errors `above`."""
    seen = np.maximum(np.abs(first - behind), np.abs(second - behind)).max(-1) > _SEEN
    channels = 3 if behind[3] else 4  # over a background all are opaque
    squares = np.square((first - second)[seen, :channels]).mean(-1)
    return math.sqrt(squares.mean() + above * squares.std() / math.sqrt(squares.size)) if squares.size else 0.0
