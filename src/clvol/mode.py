"""Render modes: one row here, one file in ``cl/modes/``, one gather in ``reference/march.py``."""

from __future__ import annotations

from dataclasses import dataclass

from clvol.checks import one_of

__all__ = ["DEFAULT_MODE", "Mode", "as_mode", "modes"]

DEFAULT_MODE = "composite"


@dataclass(frozen=True)
class Mode:
    """One way to make a pixel of what a ray meets.

    Parameters
    ----------
    name : str
        The name by which it is asked for; its kernel file is ``modes/<name>.cl``.
    description : str
        What it shows, for listings.
    endpoints : bool
        Whether it also wants the function where the ray enters and leaves the volume, a thousandth
        of a step inside.
    automatic : bool
        Whether the default transfer function is one of opacities; else it is a grey ramp.
    skips : bool
        Whether values can be of no matter to it, so that space is skipped.
    ramp : float
        The share of the volume's range of values over which that ramp runs from black to white.
    """

    name: str
    description: str
    endpoints: bool = False
    automatic: bool = False
    skips: bool = True
    ramp: float = 1.0

    @property
    def file(self) -> str:
        return f"modes/{self.name}.cl"


_TABLE = {
    row.name: row
    for row in (
        Mode("composite", "emission and absorption, front to back", automatic=True),
        Mode("isosurface", "the first surface of one value, shaded", endpoints=True),
        Mode("mip", "the greatest value along the ray"),
        Mode("minip", "the least value along the ray"),
        Mode("mean", "the mean value along the ray, as an x-ray", skips=False, ramp=0.5),  # means seldom reach the greatest value
    )
}


def modes() -> dict[str, Mode]:
    """Every mode by name."""
    return dict(_TABLE)


def as_mode(choice: str | Mode) -> Mode:
    """The row for a name."""
    if isinstance(choice, Mode):
        return choice
    if not isinstance(choice, str) or choice not in _TABLE:
        raise one_of("mode", choice, _TABLE)
    return _TABLE[choice]
