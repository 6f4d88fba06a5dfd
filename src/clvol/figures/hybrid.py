"""Figure 3 of the paper: the hybrid, which magnifies by two and then samples by trilinear fetches, against direct evaluation."""

from __future__ import annotations

import time
from contextlib import ExitStack
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol import phantoms
from clvol.analysis.angle import mean_angle
from clvol.base.checks import whole
from clvol.base.errors import OptionError
from clvol.base.progress import Progress, counted
from clvol.device import Device
from clvol.figures.panels import CAMERA, LOOK, exact, shading_gradients
from clvol.figures.style import GAP, GREY, LINE, Drawing, colour, placed, show, styled, tiles, title
from clvol.march.renderer import Renderer
from clvol.scene.camera import Camera
from clvol.volume.volume import Volume, as_volume

__all__ = ["draw"]

_GRADIENTS: dict[str, Literal["analytic", "central"]] = {"hybrid": "central", "bspline3": "analytic", "linear": "central"}
"""Each method and the gradient that shades it; programs that sample by trilinear fetches use differences of voxels."""

_HEADINGS = {"hybrid": "a)  hybrid\n8 taps, ×8 memory", "bspline3": "b)  direct\n64 taps", "linear": "trilinear alone\n8 taps"}
_NAMES = {"hybrid": "hybrid", "bspline3": "direct", "linear": "trilinear"}
_RAYS = 4  # rays for each pixel of the pictures; timed frames have one
_ROUNDS = 15  # timed frames of each method
_RIGHT = 125  # pixels for the scale of differences
_WHITE = (1.0, 1.0, 1.0)


def draw(
    samples: int = 41,
    pixels: int = 300,
    scan: Volume | ArrayLike | None = None,
    device: Device | str | int | None = None,
    progress: Progress | None = None,
) -> Drawing:
    """Figure 3: the same surface by the hybrid, by direct evaluation, and by trilinear interpolation; errors and frame times.

    The hybrid and trilinear interpolation are shaded by central differences of their voxels, direct evaluation by its exact
    derivative.

    Parameters
    ----------
    samples : int
        Of the Marschner-Lobb function along each axis.
    pixels : int
        Width and height of each picture.
    scan : Volume or array-like, optional
        An object in place of that function. Its truth is unknown: the others are compared with the direct picture.
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
    look = {"camera": CAMERA, **LOOK} if scan is None else {"camera": Camera.orbit(30, 20)}
    look |= {"mode": "isosurface", "size": (pixels, pixels), "background": _WHITE}
    with ExitStack() as stack:
        renderers = [stack.enter_context(Renderer(volume, name, device=device)) for name in _GRADIENTS]
        pairs = list(zip(renderers, _GRADIENTS.values(), strict=True))
        pictures = {r.filter.name: r.render(**look, gradient=g, rays=_RAYS)[..., :3].astype(np.float64) for r, g in pairs}
        taken: list[list[float]] = [[] for _ in pairs]
        for _ in counted(range(_ROUNDS), progress):  # interleaved, so that other load affects all methods equally
            for mine, (renderer, gradient) in zip(taken, pairs, strict=True):
                started = time.perf_counter()
                renderer.render(**look, gradient=gradient, rays=1)
                mine.append(time.perf_counter() - started)
    surface = None
    if scan is None:
        surface, picture = exact(volume, CAMERA, pixels, _RAYS, _WHITE)
        pictures["exact"] = picture[..., :3].astype(np.float64)
    truth = pictures["bspline3" if surface is None else "exact"]
    numbers: list[dict[str, Any]] = []
    for (renderer, gradient), seconds in zip(pairs, taken, strict=True):
        row = renderer.filter
        angle = None
        if surface is not None and surface.size:
            drawn = shading_gradients(volume, surface, row, device, gradient)
            angle = mean_angle(drawn, phantoms.marschner_lobb_gradient(surface), faces=True)
        quarter, median, three_quarters = (float(q) for q in np.quantile(seconds, (0.25, 0.5, 0.75)))
        numbers.append(
            {
                "filter": row.name,
                "gradient": gradient,
                "seconds": median,
                "seconds_quartiles": [quarter, three_quarters],
                "coefficients_bytes": int(np.prod([n * row.scale for n in volume.shape])) * 4,
                "compared_with": "direct" if surface is None else "the function itself",
                "rms_difference": float(np.sqrt(np.mean((pictures[row.name] - truth) ** 2))),
                "angle_mean": angle,
            }
        )
    with styled():
        figure = _drawn(pictures, truth, numbers)
    return Drawing(figure, numbers, [_line(n) for n in numbers])


def _line(n: dict[str, Any]) -> str:
    median, low, high = (1000 * seconds for seconds in (n["seconds"], *n["seconds_quartiles"]))
    normals = "" if n["angle_mean"] is None else f", normals {n['angle_mean']:.1f}°"
    return (
        f"{title(n['filter'])}: {median:.3g} ms a frame (half of them {low:.3g} to {high:.3g}), "
        f"{n['coefficients_bytes'] / 2**20:.2f} MiB of coefficients, "
        f"RMS difference of shade to {n['compared_with']} {n['rms_difference']:.4f}{normals}"
    )


def _drawn(pictures: dict[str, NDArray[np.float64]], truth: NDArray[np.float64], numbers: list[dict[str, Any]]) -> Any:
    pixels = truth.shape[0]
    figure, panels, times = tiles(2, 4, (pixels, pixels), above=2, below=1, between=1, right=_RIGHT)
    against = numbers[0]["compared_with"]
    differences = {n["filter"]: np.abs(pictures[n["filter"]] - truth).mean(-1) for n in numbers}
    largest = max(float(np.quantile(d, 0.98)) for d in differences.values()) or 1.0
    for column, n in enumerate(numbers):
        name = n["filter"]
        shaded = "analytic gradient" if n["gradient"] == "analytic" else "central differences"
        show(panels[0, column], pictures[name], _HEADINGS[name], shaded)
        measured = f"RMS {n['rms_difference']:.4f}" + ("" if n["angle_mean"] is None else f", normals {n['angle_mean']:.1f}°")
        image = show(panels[1, column], differences[name], "", measured, cmap="Reds", vmin=0, vmax=largest)
    if "exact" in pictures:
        show(panels[0, 3], pictures["exact"], title("exact"))
    size, (left, top) = times * pixels, (figure.dpi * figure.get_size_inches()).round().astype(int)
    x, y = left - _RIGHT - size, top - LINE - GAP - size
    scale = placed(figure, left - _RIGHT + 10, y, 18, size)
    figure.colorbar(image, cax=scale, label=f"difference of shade\nto {against}")
    bars = [placed(figure, x + size // 4, y + size * k // 20, size // 2, size * 7 // 20) for k in (2, 12)]
    names = [_NAMES[n["filter"]] for n in numbers]
    for axes, key, unit, heading in (
        (bars[0], "seconds", 1e-3, "time of a frame, ms"),
        (bars[1], "coefficients_bytes", 2**20, "coefficients, MiB"),
    ):
        values = [n[key] / unit for n in numbers]
        axes.barh(range(3)[::-1], values, color=[colour(n["filter"]) for n in numbers], height=0.7)
        ends = values
        if key == "seconds":
            quartiles = np.array([n["seconds_quartiles"] for n in numbers]) / unit
            axes.hlines(range(3)[::-1], *quartiles.T, color=GREY, linewidth=2)
            ends = list(quartiles[:, 1])
        axes.set_yticks(range(3)[::-1], names)
        for place, value, end in zip(range(3)[::-1], values, ends, strict=True):
            axes.text(end + 0.03 * max(ends), place, f"{value:.3g}", va="center", fontsize=8.5)
        axes.set_xlim(0, 1.25 * max(ends))
        axes.set_title(heading, fontsize=9, fontweight="normal", color=GREY)
        axes.set_xticks([])
        axes.tick_params(axis="y", length=0)
        axes.grid(visible=False)
        axes.spines["bottom"].set_visible(False)
    return figure
