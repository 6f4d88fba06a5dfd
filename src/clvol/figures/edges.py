"""Clouds and caves (section 3 of the paper): an object with hard edges after an ideal low-pass, and after a Gaussian one."""

from __future__ import annotations

from typing import Any

import numpy as np

from clvol.base.checks import whole
from clvol.base.progress import Progress, counted
from clvol.device import Device
from clvol.figures.panels import SHADED
from clvol.figures.style import Drawing, folded, show, styled, tiles, title
from clvol.filter.filter import Filter
from clvol.filter.table import as_filters
from clvol.march.renderer import Renderer
from clvol.scene.camera import Camera
from clvol.spline.field import sample
from clvol.volume.volume import Volume

__all__ = ["CLOUD", "LOWPASSES", "draw", "scanned", "strays"]

LOWPASSES = {"none": "point samples", "ideal": "ideal low-pass", "gaussian": "Gaussian low-pass"}
"""Low-passes of the object before it is sampled."""

CLOUD = 0.05
"""Share of the edge's height: the isovalue that shows clouds; 1 minus it shows caves."""

_HALF = 0.5  # of the cube's side, in the box [-1, 1)³
# the cube's axes differ from the grid's
_TURN = np.linalg.qr(np.array([[1.0, 0.35, 0.2], [-0.3, 1.0, 0.45], [0.15, -0.4, 1.0]])).Q
_SIGMA = 1.0  # samples
_LINES, _REACH, _PLACES = 3000, 7, 71  # samples that a line is long, places on it
_SEED = 1848  # Wilbraham
_CAMERA = Camera.orbit(28, 22, zoom=2.1, fit="volume")
_WHITE = (1.0, 1.0, 1.0)
_RAYS = 4


def scanned(samples: int, lowpass: str) -> Volume:
    """A rotated cube of ones in zeros, low-passed by one of `LOWPASSES` and sampled; periodic on [-1, 1)³.

    Its Fourier series is known: the ideal low-pass keeps the frequencies below Nyquist along each axis and nothing else, the
    Gaussian multiplies them by ``exp(-(ω σ)² / 2)`` with a standard deviation of one sample.
    """
    axis = np.arange(samples) * 2 / samples - 1
    spacing, place = (2 / samples,) * 3, (-1.0,) * 3
    if lowpass == "none":
        points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij")[::-1], -1)
        return Volume((np.abs(points @ _TURN).max(-1) < _HALF).astype(np.float64), spacing, place)
    k = np.fft.fftfreq(samples, 1 / samples)
    waves = np.stack(np.meshgrid(k, k, k, indexing="ij")[::-1], -1)
    spectrum = np.prod(_HALF * np.sinc(_HALF * (waves @ _TURN)), -1)
    spectrum[np.abs(waves).max(-1) >= samples / 2] = 0
    if lowpass == "gaussian":
        spectrum *= np.exp(-((2 * np.pi / samples * _SIGMA) ** 2) * (waves**2).sum(-1) / 2)
    centred = spectrum * np.prod(np.where(waves % 2 == 0, 1, -1), -1)  # the first sample is at -1
    return Volume(np.fft.ifftn(centred).real * samples**3, spacing, place)


def strays(volume: Volume, filter: Filter, device: Device | str | int | None = None) -> dict[str, float]:
    """The largest renewed rise of values on the way out of the cube ("cloud"), and renewed fall on the way in ("cave").

    They are measured on lines across its faces, from random places at least a tenth of an edge from the next edge, to 7 samples or
    two thirds of the way to the middle. Without ringing, values decrease all the way out, and both are 0.
    """
    random = np.random.default_rng(_SEED)
    start, axis = random.uniform(-0.8 * _HALF, 0.8 * _HALF, (_LINES, 3)), random.integers(0, 3, _LINES)
    normal = np.eye(3)[axis] * random.choice((-1, 1), _LINES)[:, None]
    start = np.where(normal != 0, _HALF * normal, start)
    way = np.linspace(0, min(_REACH * volume.spacing[0], 0.7 * _HALF), _PLACES)
    out, back = (
        sample(volume, (start[:, None] + sign * way[:, None] * normal[:, None]) @ _TURN.T, filter, "wrap", device=device)
        for sign in (1, -1)
    )
    rise = out - np.minimum.accumulate(out, 1)
    fall = np.maximum.accumulate(back, 1) - back
    return {"cloud": float(rise.max()), "cave": float(fall.max())}


def draw(
    samples: int = 40,
    pixels: int = 300,
    filters: tuple[str | Filter, ...] = ("nearest", "linear", "bspline3-approx", "mitchell", "bspline3"),
    device: Device | str | int | None = None,
    progress: Progress | None = None,
) -> Drawing:
    """A cube with hard edges, sampled in three ways: artefacts around it (above) and in its faces (below).

    Parameters
    ----------
    samples : int
        Samples along each axis of the box, which is twice as wide as the cube.
    pixels : int
        Width of each picture.
    filters : sequence of str or Filter
        The measured filters; the last one is drawn.
    device, progress
        As for `clvol.render`.
    """
    samples, pixels, rows = whole("samples", samples, 8), whole("pixels", pixels, 1), as_filters(filters)
    look = {**SHADED, "background": _WHITE, "rays": _RAYS}
    numbers: list[dict[str, Any]] = []
    with styled():
        figure, panels, times = tiles(2, len(LOWPASSES), (pixels, pixels), above=2, below=1, between=1)
        for above, below, (lowpass, words) in zip(*panels, counted([*LOWPASSES.items()], progress), strict=True):
            volume = scanned(samples, lowpass)
            numbers += [{"lowpass": lowpass, "filter": row.name, **strays(volume, row, device)} for row in rows]
            last = numbers[-1]
            with Renderer(volume, rows[-1], "wrap", device) as renderer:
                around, within = (
                    renderer.render(_CAMERA, "isosurface", (pixels, pixels), isovalue=value, **look)[..., :3]
                    for value in (CLOUD, 1 - CLOUD)
                )
            show(above, around, folded(words, times * pixels), f"value {CLOUD:g}: clouds rise {last['cloud']:.2f}")
            show(below, within, "", f"value {1 - CLOUD:g}: caves fall {last['cave']:.2f}")
    lines = [
        f"{LOWPASSES[n['lowpass']]}, {title(n['filter'])}: values rise again by {n['cloud']:.3f} outside, "
        f"fall by {n['cave']:.3f} inside"
        for n in numbers
    ]
    return Drawing(figure, numbers, lines)
