"""Warnings of pictures that show nothing, or all samples alike, with the range of the samples."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.checks import warn
from clvol.march.bands import narrow_bands, with_virtual
from clvol.march.options import WORDS, Fineness, chosen_mode
from clvol.march.recipe import look_of
from clvol.scene.clip import Cuts, cuts_of
from clvol.scene.mode import virtual_samples

if TYPE_CHECKING:
    from clvol.march.options import ResolvedLook
    from clvol.march.renderer import Renderer
    from clvol.march.source import Source
    from clvol.scene.camera import Camera
    from clvol.scene.mode import Mode
    from clvol.show.picture import Picture
    from clvol.volume.volume import Volume

__all__ = ["warn_if_empty", "warn_of_refined"]

_POINTS = 33  # along each axis, at which it is asked whether cuts keep anything
_STEP = 16  # pixels between those that are looked at first
_CHOICES = ("transfer", "isovalue", *WORDS)


def warn_if_empty(
    look: ResolvedLook, fine: Fineness, source: Source, options: Mapping[str, Any], rgba: NDArray[np.floating[Any]]
) -> None:
    """Warn if a picture shows nothing of what is drawn, cannot tell its samples apart, or misses a band of values between them.

    `options` were given for the picture, and so was `fine`: bands are not missed where a tolerance chooses the step.
    """
    limits, given = source.limits, any(options.get(name) is not None for name in _CHOICES)
    alike = (_alike(one, one.preview.limits, given) for one in (look, *look.others)) if look.others else ()
    if found := next(filter(None, alike), ""):
        warn(f"of a medium of the scene: {found}")
    reason = look.once(("alike", limits, given), lambda: _alike(look, limits, given))
    if not reason and _is_empty(look, rgba):
        reason = _unseen(look, source)
    for one in () if reason else (look, *look.others):
        if said := _beyond(one):
            warn(said)
    missed = (one.once(("missed", fine.step), partial(_missed, one, fine.step)) for one in (look, *look.others))
    if reason or (fine.tolerance is None and (reason := next(filter(None, missed), ""))):
        warn(reason)


def warn_of_refined(
    renderer: Renderer, picture: Picture, camera: Camera | None, mode: str | Mode, step: float | None = None, **options: Any
) -> None:
    """Warn of the last picture by `Renderer.refine` as `render` warns of its own."""
    source, chosen = renderer._source, chosen_mode(mode, options)
    fine = Fineness.of(chosen, picture.shape[1::-1], step, options)  # type: ignore[arg-type]
    look = with_virtual(look_of(source, camera, chosen, options), source, fine, step)  # type: ignore[arg-type]  # by name
    warn_if_empty(look, fine, source, options, picture if picture.furnished is None else picture.furnished.bare)


def _alike(look: ResolvedLook, limits: tuple[float, float] | None, given: bool) -> str:
    """That all samples look the same, if they do; "" for surfaces and integrals, which show where they are.

    `given`: an option says how samples look.
    """
    if limits is None or look.scene.media[0].color_by is not None or look.mode.shows == "integral":
        return ""
    low, high = limits
    if low == high:
        chosen = look.scene.media[0].transfer is not None or given
        return "" if chosen else f"the picture shows no structure: all samples are {low:g}"
    mode, transfer = look.mode, look.transfer
    if mode.isovalues or (mode.ramp < 1 and high > transfer.value_range[0]):  # which shows smaller values, too
        return ""
    first, last = transfer.value_range
    if mode.shows == "matter" and not transfer.opacity_within(low, high):
        return (
            f"nothing is seen: all samples, from {low:g} to {high:g}, are transparent; opacity changes from {first:g} to {last:g}"
        )
    points = np.array([low, high, *(value for value, _ in (*transfer.colors, *transfer.opacities))])
    every, seen = (transfer(values)[:, : 4 if mode.shows == "matter" else 3] for values in (points, np.clip(points, low, high)))
    if (every == every[0]).all() or (seen != seen[0]).any():
        return ""
    return f"all samples, from {low:g} to {high:g}, are of one colour: the transfer function changes from {first:g} to {last:g}"


def _beyond(look: ResolvedLook) -> str:
    """Which of several surfaces are outside the samples, if these are known."""
    values, volume = look.mode.isovalues, look.scene.media[0].volume
    if look.mode.name != "surfaces" or look.preview is not volume:
        return ""
    low, high = volume.value_range
    out = [f"{value:g}" for value in values if not low <= value <= high]
    return f"no surface is seen of {' and '.join(out)}: samples are from {low:g} to {high:g}" if out else ""


def _unseen(look: ResolvedLook, source: Source) -> str:
    """Why nothing is seen."""
    if look.others:
        return f"nothing is seen of the {1 + len(look.others)} media: all that the picture shows has the colour of the background"
    limits, row = source.limits, source.filter_of(look.mode)
    volume, surfaces = look.scene.media[0].volume, look.mode.isovalues
    cuts, (low, high) = cuts_of(look.clip), (volume.corners.min(0), volume.corners.max(0))
    if cuts.box is not None and _outside(cuts.box, volume):
        return f"nothing is seen: clip lies outside the volume, which spans {_point(low)} to {_point(high)}"
    if cuts != Cuts() and not _some_kept(cuts, volume):
        return f"nothing is seen: clip cuts away the whole volume, which spans {_point(low)} to {_point(high)}"
    if limits is not None and surfaces and not any(limits[0] <= surface <= limits[1] for surface in surfaces):
        which = " and ".join(f"{surface:g}" for surface in surfaces)
        some = "isovalue {} is" if len(surfaces) == 1 else "isovalues {} are"
        span = f"from {limits[0]:g} to {limits[1]:g}"
        return f"nothing is seen: {some.format(which)} outside the samples, which are {span}"
    values = "" if limits is None else f", whose samples are from {limits[0]:g} to {limits[1]:g}"
    values += f", smoothed by {row.name}" if row.smoothing else ""
    return f"nothing is seen of the volume{values}: all that the picture shows has the colour of the background"


def _missed(look: ResolvedLook, step: float) -> str:
    """That values change by more from sample to sample of a ray than a band of opacity is wide: it is stippled then."""
    for first, last, change in narrow_bands(look, step):
        wide, change = last - first, change / max(1, virtual_samples(look.mode))
        if wide < change:
            return (
                f"the band of opacity from {first:.4g} to {last:.4g} is narrower than what values change by from sample to sample "
                f"of a ray, {change:.2g}, and may be stippled: step={0.5 * step * wide / change:.1g} or a tolerance, such as "
                f"tolerance=0.01, shows it whole"
            )
    return ""


def _is_empty(look: ResolvedLook, rgba: NDArray[np.floating[Any]]) -> bool:
    """Whether a picture is all background; few pixels of one that is not are looked at."""
    background = look.scene.background

    def plain(pixels: NDArray[np.floating[Any]]) -> bool:
        if not pixels[..., 3].any():
            return True
        return background is not None and bool((pixels[..., :3] == np.asarray(background, pixels.dtype)).all())

    return plain(rgba[::_STEP, ::_STEP]) and plain(rgba)


def _outside(clip: Any, volume: Volume) -> bool:
    """Whether a box in the world lies beside the volume, along an axis of the world or of the volume."""
    low, high = map(np.asarray, clip)
    first, last = volume.corners.min(0), volume.corners.max(0)
    low, high = np.clip(low, first - 1, last + 1), np.clip(high, first - 1, last + 1)  # of infinite boxes too
    corners = np.stack(np.meshgrid(*np.stack([low, high], -1), indexing="ij"), -1).reshape(-1, 3)
    index = volume.world_to_index(corners)
    beside = (high <= first) | (low >= last) | (index.max(0) <= -0.5) | (index.min(0) >= np.asarray(volume.size) - 0.5)
    return bool(beside.any())


def _some_kept(cuts: Cuts, volume: Volume) -> bool:
    """Whether cuts keep some of a grid of points that spans the domain of a volume."""
    ends = [np.linspace(-0.5, n - 0.5, min(n + 1, _POINTS)) for n in volume.size]
    index = np.stack(np.meshgrid(*ends, indexing="ij"), -1)
    return bool(cuts.keep(volume.index_to_world(index)).any())


def _point(values: NDArray[np.float64]) -> str:
    return f"({', '.join(f'{value:.6g}' for value in values)})"
