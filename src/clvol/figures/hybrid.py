"""Figure 3 of the paper: the hybrid, which magnifies twice and then draws by trilinear fetches, against direct evaluation."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clvol import phantoms
from clvol.camera import Camera
from clvol.checks import whole
from clvol.device import Device
from clvol.errors import OptionError
from clvol.figures.panels import BOX, CAMERA, ISOVALUE, LIGHTS, MATERIAL, SURFACE
from clvol.figures.style import GREY, Drawing, colour, new_figure, plain, show, styled, title
from clvol.march.renderer import Renderer
from clvol.volume import Volume, as_volume

__all__ = ["draw"]

_FILTERS = ("bspline3", "hybrid", "linear")
_ROUNDS = 7  # frames of each that are timed
_WHITE = (1.0, 1.0, 1.0)


def draw(
    samples: int = 41,
    pixels: int = 400,
    scan: Volume | ArrayLike | None = None,
    device: Device | str | int | None = None,
    progress: Callable[[float], Any] | None = None,
) -> Drawing:
    """Figure 3: the same surface direct, by the hybrid, and by trilinear interpolation alone; differences; frame times.

    Parameters
    ----------
    samples : int
        Of the Marschner-Lobb function along each axis.
    pixels : int
        Width and height of each picture.
    scan : Volume or array-like, optional
        An object in place of that function.
    device, progress
        As for `clvol.render`.

    Raises
    ------
    OptionError
        The scan does not have 3 axes, or is constant and so has no surface.
    """
    pixels = whole("pixels", pixels, 1)
    volume = phantoms.marschner_lobb(samples) if scan is None else as_volume(scan)
    if volume.ndim != 3:
        raise OptionError(f"scan must have 3 axes; got shape {volume.shape}")
    low, high = volume.value_range
    if low == high:
        raise OptionError(f"scan must hold more than one value, since a surface is drawn; got {low:g} throughout")
    look: dict[str, Any] = {"camera": Camera.orbit(30, 20, zoom=1.3)}
    if scan is None:
        look = {"camera": CAMERA, "isovalue": ISOVALUE, "color": SURFACE, "lights": LIGHTS, "material": MATERIAL, "clip": BOX}
    look |= {"mode": "isosurface", "size": (pixels, pixels), "background": _WHITE}
    numbers: list[dict[str, Any]] = []
    with ExitStack() as stack:
        renderers = [stack.enter_context(Renderer(volume, name, device=device)) for name in _FILTERS]
        pictures = [r.render(**look)[..., :3].astype(np.float64) for r in renderers]  # builds the kernels, too
        shortest = [np.inf] * len(renderers)
        for done in range(1, _ROUNDS + 1):  # in turns, so that other load on the machine hits all of them alike
            for i, renderer in enumerate(renderers):
                started = time.perf_counter()
                renderer.render(**look)
                shortest[i] = min(shortest[i], time.perf_counter() - started)
            if progress is not None:
                progress(done / _ROUNDS)
    for renderer, picture, seconds in zip(renderers, pictures, shortest, strict=True):
        kept = int(np.prod([n * renderer.filter.scale for n in volume.shape])) * 4
        difference = float(np.sqrt(np.mean((picture - pictures[0]) ** 2)))
        numbers.append(
            {"filter": renderer.filter.name, "seconds": seconds, "coefficients_bytes": kept, "rms_difference": difference}
        )
    with styled():
        figure = _drawn(pictures, numbers)
    lines = [
        f"{title(n['filter'])}: {1000 * n['seconds']:.0f} ms a frame, {n['coefficients_bytes'] / 2**20:.2f} MiB of coefficients, "
        f"RMS difference to direct {n['rms_difference']:.4f}"
        for n in numbers
    ]
    return Drawing(figure, numbers, lines)


def _drawn(pictures: list[Any], numbers: list[dict[str, Any]]) -> Any:
    figure = new_figure(10.2, 7.1)
    panels = figure.subplots(2, 3)
    direct, hybrid, linear = pictures  # shown in the order of the paper, each difference below its picture
    headings = ("a)  hybrid: 8 taps, ×8 the memory", "b)  direct: 64 taps a sample", "trilinear alone: 8 taps")
    for axes, picture, heading in zip(panels[0], (hybrid, direct, linear), headings, strict=True):
        show(axes, picture, heading)
    differences = [np.abs(p - direct).mean(-1) for p in (hybrid, linear)]
    largest = max(float(np.quantile(d, 0.995)) for d in differences) or 1.0
    for axes, difference, n, name in zip(panels[1, ::2], differences, numbers[1:], ("hybrid", "trilinear"), strict=True):
        image = show(axes, difference, f"|{name} − direct|", f"RMS {n['rms_difference']:.4f}", cmap="Reds", vmin=0, vmax=largest)
    figure.colorbar(image, cax=panels[1, 2].inset_axes((1.04, 0.1, 0.05, 0.8)), label="difference of shade")
    middle = panels[1, 1]
    times, memory = middle.inset_axes((0.3, 0.62, 0.6, 0.3)), middle.inset_axes((0.3, 0.12, 0.6, 0.3))
    plain(middle)
    for axes, key, unit, heading in (
        (times, "seconds", 1e-3, "time of a frame, ms"),
        (memory, "coefficients_bytes", 2**20, "coefficients, MiB"),
    ):
        values = [n[key] / unit for n in numbers]
        axes.barh(range(3)[::-1], values, color=[colour(n["filter"]) for n in numbers], height=0.7)
        axes.set_yticks(range(3)[::-1], ["direct", "hybrid", "trilinear"])
        for place, value in zip(range(3)[::-1], values, strict=True):
            axes.text(value + 0.02 * max(values), place, f"{value:.3g}", va="center", fontsize=8.5)
        axes.set_xlim(0, 1.2 * max(values))
        axes.set_title(heading, fontsize=9, fontweight="normal", color=GREY)
        axes.set_xticks([])
        axes.tick_params(axis="y", length=0)
        axes.grid(visible=False)
        axes.spines["bottom"].set_visible(False)
    return figure
