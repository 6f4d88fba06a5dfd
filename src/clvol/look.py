"""What a volume's values look like in a mode: its default, or what is asked for instead, put together in one place."""

from __future__ import annotations

from collections.abc import Sequence

from clvol.mode import Mode, as_mode
from clvol.transfer import TransferFunction
from clvol.volume import Volume

__all__ = ["look"]


def look(
    volume: Volume,
    mode: str | Mode | type[Mode],
    *,
    preset: str | None = None,
    window: tuple[float, float] | None = None,
    cmap: str | None = None,
    opacity: float | Sequence[tuple[float, float]] | None = None,
) -> TransferFunction:
    """The transfer function of a volume in a mode, where nothing is given the mode's own.

    Parameters
    ----------
    volume : Volume
    mode : str, Mode or class of Mode
    preset : str, optional
        The name of a row of `clvol.presets`: colours and opacities for one kind of data.
    window : (center, width), optional
        The value in the middle of what is told apart, and how wide that is, in units of the data, as radiologists say it.
        (`Volume.window`, which this replaces, is the two ends.)
    cmap : str, optional
        Colours by the name of a map of the `cmap` package, instead of the others; opacities stay.
    opacity : float, or sequence of (value, opacity), optional
        A number scales the opacities; points replace them. Colours stay.
    """
    transfer = as_mode(mode).transfer(volume)
    return transfer
