"""The look of a volume's values in a mode: combines the default with the given options, in one place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clvol.base.arrays import reals
from clvol.base.checks import number
from clvol.base.errors import OptionError
from clvol.scene.mode import Mode, as_mode
from clvol.scene.preset import as_preset, unit_of
from clvol.scene.transfer import TransferFunction, is_curve
from clvol.volume.histogram import slopes_of
from clvol.volume.volume import Volume, as_volume

__all__ = ["graded", "look", "seen_through"]

_EVEN = 4  # power by which even matter fades: the opacities of many samples add up, and half of each would hardly be seen


def look(
    volume: Volume | ArrayLike,
    mode: str | Mode | type[Mode],
    *,
    preset: str | None = None,
    window: tuple[float, float] | None = None,
    cmap: str | None = None,
    opacity: float | Sequence[tuple[float, float]] | None = None,
) -> TransferFunction:
    """The transfer function of a volume in a mode; the default is that of the mode.

    Parameters
    ----------
    volume : Volume or array-like
    mode : str, Mode or class of Mode
    preset : str, optional
        The name of a row of `clvol.presets`: colours and opacities for one kind of data. Projections show its
        range; means only that of one in Hounsfield units, and else their own.
    window : (center, width), optional
        The value in the middle of what is told apart, and how wide that is, in units of the data, as radiologists say it: from
        transparent to the brightest, from black to white. It replaces `Volume.clim`, the two ends.
    cmap : str, optional
        Replaces the colours by a colour map of the `cmap` package; opacities stay.
    opacity : float, or sequence of (value, opacity), optional
        A number, 0 or more, scales the opacities, clipped to 1; points replace them. Colours stay.

    Raises
    ------
    OptionError
        A name is unknown, or a value is not allowed.

    Warns
    -----
    ClvolWarning
        The preset is in Hounsfield units, and the data cannot be.
    """
    volume = as_volume(volume)
    chosen, ends = as_mode(mode), None if window is None else _ends(window)
    if preset is None:
        transfer = chosen.transfer(volume) if ends is None else chosen.transfer_within(volume, ends)
    else:
        row = as_preset(preset)
        if chosen.shows == "matter" or row.unit == "labels":
            transfer = TransferFunction(*row.points(volume, ends), unit_of(volume))
        elif (chosen.shows == "mean" and row.unit == "matter") or chosen.shows == "integral":  # which reach no such values
            transfer = chosen.transfer_within(volume, ends)
        else:
            transfer = chosen.transfer_within(volume, ends or row.span(volume))
    if cmap is not None:
        values = [value for value, _ in transfer.colors]
        colored = TransferFunction.from_cmap(cmap, (values[0], values[-1]))
        transfer = replace(transfer, colors=colored.colors)
    return transfer if opacity is None else seen_through(transfer, opacity)


def seen_through(transfer: TransferFunction, opacity: object) -> TransferFunction:
    """A copy whose opacities are scaled by a number, or replaced by pairs of value and opacity."""
    if is_curve(opacity):
        return transfer.with_opacity(opacity)  # type: ignore[arg-type]  # __post_init__ checks it
    factor = number("opacity", opacity, minimum=0)
    return transfer.with_opacity([(value, min(1.0, factor * share)) for value, share in transfer.opacities])


def graded(
    transfer: TransferFunction,
    volume: Volume,
    *,
    gradient_opacity: float | Sequence[tuple[float, float]] | None = None,
    curvature_opacity: Sequence[tuple[float, float]] | None = None,
) -> TransferFunction:
    """A copy whose opacity has factors by the gradient, and by curvature, in place of its own; None and 0 leave them as they are.

    Of one number, 0 to 1, the factor rises with the magnitude of the gradient: from the fourth power of what is left of 1, where
    matter is even, to 1 at its boundaries, as `clvol.volume.histogram.slopes_of` finds both.
    """
    changes: dict[str, Any] = {}
    if gradient_opacity is not None and is_curve(gradient_opacity):
        changes["gradient_opacity"] = gradient_opacity
    elif gradient_opacity is not None:
        share = number("gradient_opacity", gradient_opacity, minimum=0, maximum=1)
        even, steep = slopes_of(volume)
        if share:
            changes["gradient_opacity"] = ((even, (1 - share) ** _EVEN), (steep, 1.0))
    if curvature_opacity is not None:
        changes["curvature_opacity"] = curvature_opacity
    return replace(transfer, **changes) if changes else transfer


def _ends(window: object) -> tuple[float, float]:
    rule = "two finite numbers, (center, width), the width positive"
    values = reals("window", window, rule)
    if values.shape != (2,) or not np.isfinite(values).all() or values[1] <= 0:
        raise OptionError(f"window must be {rule}; got {window!r}")
    center, width = (float(value) for value in values)
    low, high = center - width / 2, center + width / 2
    if not (np.isfinite([low, high]).all() and low < high):
        raise OptionError(f"window must be {rule}, and wide enough to tell its ends apart; got {window!r}")
    return low, high
