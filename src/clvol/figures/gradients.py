"""Gradient errors: the angle between the rendered and the true normals, in colour below each picture."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from clvol import phantoms
from clvol.analysis.angle import angles, mean_angle
from clvol.base.checks import whole
from clvol.base.progress import Progress, counted
from clvol.device import Device
from clvol.figures.panels import CAMERA, LOOK
from clvol.figures.style import GAP, LETTERS, LINE, Drawing, folded, placed, show, styled, tiles, title
from clvol.filter.filter import Filter
from clvol.filter.table import as_filters
from clvol.march.renderer import Renderer

__all__ = ["draw"]

_SHOWN = ("linear", "bspline3-approx", "mitchell", "catmull-rom", "bspline3", "bspline5")
_MAX_ANGLE = 45.0  # degrees that the colours span
_RAYS = 4  # rays for each pixel
_RIGHT = 130  # pixels for the colour scale
_MARGIN = 50  # 1 / 50 of the height is the margin around visible rows
_WHITE = (1.0, 1.0, 1.0)


def draw(
    filters: Sequence[str | Filter] = _SHOWN,
    samples: int = 41,
    pixels: int = 240,
    device: Device | str | int | None = None,
    progress: Progress | None = None,
) -> Drawing:
    """Pictures of the Marschner-Lobb function above, angles of their normals to the true ones below.

    Parameters
    ----------
    filters : sequence of str or Filter
        A column each.
    samples : int
        Of the function along each axis.
    pixels : int
        Width and height of each picture.
    device, progress
        As for `clvol.render`.
    """
    pixels, rows = whole("pixels", pixels, 1), as_filters(filters, len(LETTERS))
    volume = phantoms.marschner_lobb(samples)
    numbers: list[dict[str, Any]] = []
    pictures, errors = [], []
    look = {**LOOK, "background": _WHITE, "rays": _RAYS, "outputs": ("rgba", "normal", "position")}
    for row in counted(rows, progress):
        with Renderer(volume, row, device=device) as renderer:
            seen = renderer.render(CAMERA, "isosurface", (pixels, pixels), 0.25, **look)
        pictures.append(seen["rgba"][..., :3])
        errors.append(_angles(seen["normal"], seen["position"]))
        there = np.isfinite(errors[-1])
        true = phantoms.marschner_lobb_gradient(seen["position"][there].astype(np.float64))
        mean = mean_angle(seen["normal"][there], true, faces=True) if there.any() else None
        numbers.append({"filter": row.name, "analytic": row.has_gradient, "angle_mean": mean, "shown": int(there.sum())})
    shown = _filled(errors)
    with styled():
        size = (pixels, shown.stop - shown.start)
        figure, panels, times = tiles(2, len(rows), size, above=2, below=1, right=_RIGHT)
        for column, (picture, between, n) in enumerate(zip(pictures, errors, numbers, strict=True)):
            show(panels[0, column], picture[shown], folded(title(n["filter"]), times * pixels))
            note = "nothing shows" if n["angle_mean"] is None else f"mean {n['angle_mean']:.1f}°"
            drawn = show(panels[1, column], between[shown], "", note, cmap="turbo", vmin=0, vmax=_MAX_ANGLE)
        width, height = (round(figure.dpi * inches) for inches in figure.get_size_inches())
        high = times * size[1]
        scale = placed(figure, width - _RIGHT + GAP, height - GAP - LINE - high, 18, high)
        figure.colorbar(drawn, cax=scale, label="degrees to the\ntrue normal")
    lines = [f"{title(n['filter'])}: mean error of the normals {n['angle_mean']:.1f}°" for n in numbers if n["shown"]]
    return Drawing(figure, numbers, lines)


def _filled(errors: Sequence[Any]) -> slice:
    """The rows in which some picture is not empty, with a margin; all rows if all pictures are."""
    size = errors[0].shape[0]
    rows = np.flatnonzero(np.isfinite(errors).any((0, 2)))
    if not rows.size:
        return slice(0, size)
    return slice(max(0, int(rows[0]) - size // _MARGIN), min(size, int(rows[-1]) + 1 + size // _MARGIN))


def _angles(normals: Any, positions: Any) -> Any:
    """Degrees between the rendered normals and the true gradient; NaN without a surface."""
    there = np.isfinite(normals).all(-1) & np.isfinite(positions).all(-1)
    between = np.full(there.shape, np.nan)
    # lighting is two-sided
    between[there] = angles(normals[there], phantoms.marschner_lobb_gradient(positions[there].astype(np.float64)), faces=True)
    return between
