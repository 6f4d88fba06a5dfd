"""Gradient errors: the angle between the drawn normals and the true ones, in colour below each picture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from clvol import phantoms
from clvol.checks import whole
from clvol.device import Device
from clvol.figures.panels import BOX, CAMERA, ISOVALUE, LIGHTS, MATERIAL, SURFACE
from clvol.figures.style import LETTERS, Drawing, folded, new_figure, show, styled, title
from clvol.filter import Filter, as_filters
from clvol.march.renderer import Renderer

__all__ = ["draw"]

_SHOWN = ("linear", "bspline3-approx", "mitchell", "catmull-rom", "bspline3", "bspline5")
_MAX_ANGLE = 45.0  # degrees that the colours span
_MARGIN = 50  # this fraction of the height stays around what is visible
_WHITE = (1.0, 1.0, 1.0)


def draw(
    filters: Sequence[str | Filter] = _SHOWN,
    samples: int = 41,
    pixels: int = 320,
    device: Device | str | int | None = None,
    progress: Callable[[float], Any] | None = None,
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
    for done, row in enumerate(rows, 1):
        with Renderer(volume, row, device=device) as renderer:
            seen = renderer.render(
                CAMERA,
                "isosurface",
                (pixels, pixels),
                0.25,
                isovalue=ISOVALUE,
                color=SURFACE,
                lights=LIGHTS,
                material=MATERIAL,
                background=_WHITE,
                clip=BOX,
                outputs=("rgba", "normal", "position"),
            )
        pictures.append(seen["rgba"][..., :3])
        errors.append(_angles(seen["normal"], seen["position"]))
        there = errors[-1][np.isfinite(errors[-1])]
        mean = float(there.mean()) if there.size else None
        numbers.append({"filter": row.name, "analytic": row.has_gradient, "angle_mean": mean, "shown": int(there.size)})
        if progress is not None:
            progress(done / len(rows))
    shown = _filled(errors)
    with styled():
        share = (shown.stop - shown.start) / pixels
        figure = new_figure(2.1 * len(rows) + 0.9, 4.0 * share + 0.8)
        panels = figure.subplots(2, len(rows), squeeze=False)
        for column, (picture, angles, n) in enumerate(zip(pictures, errors, numbers, strict=True)):
            show(panels[0, column], picture[shown], folded(title(n["filter"])))
            note = "nothing shows" if n["angle_mean"] is None else f"mean {n['angle_mean']:.1f}°"
            drawn = show(panels[1, column], angles[shown], "", note, cmap="turbo", vmin=0, vmax=_MAX_ANGLE)
        figure.colorbar(drawn, ax=list(panels[1]), shrink=0.85, pad=0.01, extend="max", label="degrees to the true normal")
    lines = [f"{title(n['filter'])}: mean error of the normals {n['angle_mean']:.1f}°" for n in numbers if n["shown"]]
    return Drawing(figure, numbers, lines)


def _filled(errors: Sequence[Any]) -> slice:
    """The rows in which any of the pictures shows something, with a margin; all rows if none does."""
    size = errors[0].shape[0]
    rows = np.flatnonzero(np.isfinite(errors).any((0, 2)))
    if not rows.size:
        return slice(0, size)
    return slice(max(0, int(rows[0]) - size // _MARGIN), min(size, int(rows[-1]) + 1 + size // _MARGIN))


def _angles(normals: Any, positions: Any) -> Any:
    """Degrees between the drawn normals and the true gradient; NaN where nothing is drawn."""
    there = np.isfinite(normals).all(-1) & np.isfinite(positions).all(-1)
    true = phantoms.marschner_lobb_gradient(np.where(there[..., None], positions, 0.5).astype(np.float64))
    # both faces of a surface are lit alike: a normal and its opposite are the same
    cosine = np.abs((true * np.where(there[..., None], normals, 0)).sum(-1)) / np.linalg.norm(true, axis=-1)
    return np.where(there, np.degrees(np.arccos(np.clip(cosine, 0, 1))), np.nan)
