"""Presets: named looks, one row each, with colours and opacities for a kind of data.

CT presets are in Hounsfield units: air is -1000, water 0, and bone about 200 and above. The others are relative to a
volume's matter: 0 is where it starts to show, 1 its brightest value (`clvol.volume.histogram`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from clvol.base.checks import one_of, warn
from clvol.base.errors import OptionError
from clvol.base.shown import Named
from clvol.scene.palette import Colors, Opacities, of_labels, shades
from clvol.volume.histogram import matter_of, may_be_hounsfield
from clvol.volume.volume import Volume

__all__ = ["Preset", "PresetTable", "as_preset", "presets"]

_GREEN = (0.25, 0.95, 0.40)


@dataclass(frozen=True)
class Preset:
    """A named look.

    Parameters
    ----------
    name, description : str
    unit : {"HU", "matter", "labels"}
        Unit of the values below: Hounsfield units, relative to the volume's matter, or "labels", which has no values.
    colors, opacities : tuple of (value, color), tuple of (value, opacity)
        Without colours they are shades of the volume's own `color`, or of green.
    clim : (float, float)
        What projections show from black to white.
    """

    name: str
    description: str
    unit: Literal["HU", "matter", "labels"]
    colors: Colors = ()
    opacities: Opacities = ()
    clim: tuple[float, float] = (0.0, 1.0)

    def points(self, volume: Volume, clim: tuple[float, float] | None = None) -> tuple[Colors, Opacities]:
        """The colours and opacities for a volume, in units of its data; moved from its own `clim` to the one given, if any.

        Raises
        ------
        OptionError
            `clim` is given for labels.

        Warns
        -----
        ClvolWarning
            The preset is in Hounsfield units, but the data cannot be: its points are then spread over the volume's matter.
        """
        if self.unit == "labels":
            if clim is not None:
                given = (clim[0] + clim[1]) / 2, clim[1] - clim[0]
                raise OptionError(f"window must not be given for the preset 'labels', whose colours are one for each; got {given}")
            return of_labels(volume)
        colors = self.colors
        if not colors:
            own = shades(_GREEN if volume.color is None else volume.color)
            colors = tuple((i / (len(own) - 1), color) for i, color in enumerate(own))
        first, last = self._placed(volume, clim)
        low, high = self.clim

        def value(point: float) -> float:
            return first + (last - first) * (point - low) / (high - low)

        ends = slice(None, None, 1 if first < last else -1)
        return tuple((value(p), c) for p, c in colors)[ends], tuple((value(p), a) for p, a in self.opacities)[ends]

    def span(self, volume: Volume) -> tuple[float, float]:
        """Its `clim` for a volume, in units of the data and in ascending order; warns as `points` does."""
        first, last = sorted(self._placed(volume, None))
        return first, last

    def _placed(self, volume: Volume, clim: tuple[float, float] | None) -> tuple[float, float]:
        """Where the ends of its `clim` lie."""
        if clim is not None:
            return clim
        if self.unit == "HU" and may_be_hounsfield(volume):
            return self.clim
        matter = matter_of(volume)
        low, high = self.clim
        if self.unit == "HU":
            least, most = volume.value_range
            warn(
                f"preset {self.name!r} is in Hounsfield units, in which air is -1000 and water 0, and samples from {least:g} to "
                f"{most:g} are not: its points were spread over the matter; window=(center, width) sets the range"
            )
            low, high = 0.0, 1.0
        foot, top = (matter.foot, matter.top) if matter.top > matter.foot else (matter.foot - 0.5, matter.foot + 0.5)
        return matter.value(foot + low * (top - foot)), matter.value(foot + high * (top - foot))


_ROWS = (
    Preset(
        "ct-bone",
        "CT: bone, and metal",
        "HU",
        ((150, (0.58, 0.25, 0.15)), (300, (0.86, 0.62, 0.42)), (600, (0.96, 0.88, 0.74)), (1500, (1.0, 1.0, 0.98))),
        ((150, 0.0), (300, 0.15), (600, 0.50), (1500, 0.90)),
        (150, 1500),
    ),
    Preset(
        "ct-soft-tissue",
        "CT: muscle and organs behind faint fat, and bone",
        "HU",
        (
            (-160, (0.80, 0.62, 0.34)),
            (-60, (0.94, 0.80, 0.52)),
            (20, (0.80, 0.36, 0.28)),
            (90, (0.90, 0.50, 0.38)),
            (240, (0.99, 0.93, 0.83)),
        ),
        ((-160, 0.0), (-60, 0.01), (20, 0.10), (90, 0.25), (240, 0.70)),
        (-160, 240),
    ),
    Preset(
        "ct-lung",
        "CT: the surface of lungs and airways",
        "HU",
        ((-900, (0.35, 0.55, 0.80)), (-700, (0.62, 0.76, 0.92)), (-450, (0.97, 0.80, 0.74)), (-300, (1.0, 0.94, 0.90))),
        ((-900, 0.0), (-700, 0.06), (-550, 0.35), (-400, 0.35), (-300, 0.0)),
        (-1350, 150),
    ),
    Preset(
        "ct-skin",
        "CT: the skin, against the air",
        "HU",
        ((-500, (0.70, 0.42, 0.32)), (-200, (0.90, 0.66, 0.54)), (100, (0.98, 0.84, 0.74)), (1000, (1.0, 1.0, 0.98))),
        ((-500, 0.0), (-300, 0.20), (-100, 0.80), (100, 0.95)),
        (-500, 500),
    ),
    Preset(
        "ct-angiography",
        "CT: vessels with contrast medium, and bone",
        "HU",
        ((100, (0.55, 0.08, 0.06)), (250, (0.90, 0.28, 0.16)), (400, (0.99, 0.72, 0.48)), (700, (1.0, 0.96, 0.88))),
        ((100, 0.0), (180, 0.12), (300, 0.55), (700, 0.85)),
        (0, 600),
    ),
    Preset(
        "mr-default",
        "MR: all tissue in neutral tones",
        "matter",
        ((0.0, (0.48, 0.42, 0.40)), (0.2, (0.74, 0.66, 0.61)), (0.5, (0.92, 0.88, 0.84)), (1.0, (1.0, 1.0, 1.0))),
        ((0.0, 0.0), (0.15, 0.05), (0.4, 0.30), (1.0, 0.80)),
    ),
    Preset(
        "mr-angiography",
        "MR: the brightest, such as flowing blood; also for the mode mip",
        "matter",
        ((0.35, (0.60, 0.10, 0.07)), (0.6, (0.95, 0.40, 0.22)), (1.0, (1.0, 0.95, 0.85))),
        ((0.35, 0.0), (0.55, 0.15), (0.75, 0.60), (1.0, 0.95)),
        (0.1, 1.0),
    ),
    Preset(
        "fluorescence",
        "microscopy: light that adds up, in the channel's colour",
        "matter",
        (),
        ((0.0, 0.0), (0.15, 0.06), (0.5, 0.30), (1.0, 0.80)),
    ),
    Preset(
        "x-ray",
        "transparent throughout; also for the mode mean",
        "matter",
        ((0.0, (0.55, 0.62, 0.70)), (1.0, (1.0, 1.0, 1.0))),
        ((0.0, 0.0), (0.3, 0.01), (1.0, 0.08)),
    ),
    Preset("labels", "each label in its colour, opaque; nothing for the background", "labels"),
)
_TABLE = {row.name: row for row in _ROWS}


class PresetTable(Named[Preset]):
    """Presets by name, shown as a table."""

    HEADER = ("preset", "for", "unit")

    def rows(self) -> list[tuple[str, ...]]:
        """One tuple of strings per preset, in the order of `HEADER`."""
        return [(name, row.description, row.unit) for name, row in self.items()]


def presets() -> PresetTable:
    """The presets by name, with their uses when shown."""
    return PresetTable(_TABLE)


def as_preset(name: str) -> Preset:
    """The preset of a name."""
    if not isinstance(name, str) or name not in _TABLE:
        raise one_of("preset", name, _TABLE)
    return _TABLE[name]
