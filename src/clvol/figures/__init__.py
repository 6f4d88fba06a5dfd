"""The paper's figures and some more: the effects of each filter, drawn and measured.

>>> from clvol import figures
>>> figures.draw("2").save("figure2.png")
"""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from clvol.base.checks import enough_memory, one_of
from clvol.base.errors import OptionError
from clvol.figures.panels import FIGURE_6, SIX, Panel, compare, figure6
from clvol.figures.style import Drawing, require_matplotlib

__all__ = ["FIGURES", "FIGURE_6", "SIX", "Drawing", "Kind", "Panel", "compare", "draw", "figure6", "options_of"]


@dataclass(frozen=True)
class Kind:
    """A figure: the module whose `draw` makes it, its subject, and whether matplotlib draws it."""

    module: str
    what: str
    plotted: bool = True


FIGURES = {
    "1": Kind("pipeline", "where reconstruction happens: one ray, from samples to a pixel"),
    "2": Kind("responses", "frequency responses of the hybrid (18) and of direct evaluation (17)"),
    "3": Kind("hybrid", "hybrid against direct on an object: pictures, differences, frame times"),
    "4": Kind("errors", "mean square errors of the six reconstructions, 2-D and 3-D"),
    "5": Kind("images", "the six reconstructions in 2-D"),
    "6": Kind("panels", "the six reconstructions in 3-D", plotted=False),
    "impulse": Kind("impulse", "impulse responses"),
    "gradients": Kind("gradients", "angle between drawn and true normals, beside each picture"),
    "convergence": Kind("convergence", "error against sampling rate: the slope is the order"),
    "noise": Kind("noise", "errors against noise, and what lies between approximation and interpolation"),
    "slices": Kind("slices", "interpolation between slices that lie far apart"),
    "edges": Kind("edges", "clouds and caves: hard edges after an ideal low-pass and after a Gaussian one"),
    "reduction": Kind("reduction", "fewer samples: decimated, after a Gaussian, and by least squares"),
    "cost": Kind("cost", "error against time a sample: which filter should I use"),
}
"""Figures by name: those of the paper by number."""


def options_of(name: str) -> list[str]:
    """Names of the options that a figure takes."""
    return list(inspect.signature(_module(name).draw).parameters)


def draw(name: str, **options: Any) -> Drawing:
    """A figure.

    Parameters
    ----------
    name : str
        One of `FIGURES`.
    **options
        Those of the figure, `options_of`; all have defaults.

    Raises
    ------
    OptionError
        An unknown figure, or an option that it does not take.
    MissingDependencyError
        matplotlib is not installed; Figure 6 does not need it.
    OutOfMemoryError
        More samples or pixels than fit into memory.
    """
    known = options_of(name)
    for option in options:
        if option not in known:
            raise OptionError(f"options of figure {name} must be among {', '.join(known)}; got {option!r}")
    if FIGURES[name].plotted:
        require_matplotlib()
    with enough_memory(f"figure {name}"):
        drawing: Drawing = _module(name).draw(**options)
    return drawing


def _module(name: str) -> Any:
    if not isinstance(name, str) or name not in FIGURES:
        raise one_of("figure", name, FIGURES)
    return import_module(f"clvol.figures.{FIGURES[name].module}")
