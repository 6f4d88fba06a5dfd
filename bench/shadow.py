"""What shadow and occlusion cost: sweeps of light, and pictures that read what they leave, beside those without in the same run.

    python -m bench.shadow [scan.nii.gz ...]

Frames of 512² of 256³ samples, medians over rounds that alternate, as a ratio (aimed at: 1.3); and once for each transfer function,
lights and cuts the sweeps of all lights and of the light from everywhere (0.3 s on two cores). Processor seconds say the same on a
machine that has other work. Isosurfaces also with rays to one light and to three. For scans, and for "folds", these surfaces,
instead
the RMS distance of what pictures read to ratio tracking from the same places, for key, fill and the light from everywhere; of
isosurfaces also that of what sweeps and rays leave at the surface itself to crossings counted from there.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

import clvol
from clvol.march.options import ResolvedLook
from clvol.march.shadow import ABOVE, BEYOND, FAR, OPAQUE, OPEN, Body, Cells, Lit, Matter, Shadows, everywhere
from clvol.march.source import InMemory
from clvol.march.tracking import tracked
from clvol.scene.clip import Cuts
from clvol.scene.light import KIT
from clvol.scene.mode import as_mode
from clvol.scene.scene import as_scene
from clvol.spline.evaluator import choose_evaluator
from clvol.spline.minmax import MinMax

_SIZE = 512, 512
_ROUNDS = 7
_EDGE = 256
_POINTS, _PATHS = 300, 1024
_SUNS = [clvol.Light(way, (0.4,) * 3) for way in ((-0.45, -0.75, 0.55), (0.6, -0.5, 0.6), (0.1, 0.2, 0.9))]
_OFF = 0.01  # samples off a surface, from where crossings are counted
_LOOKS: dict[str, dict[str, Any]] = {
    "opaque": {"mode": "composite"},
    "translucent": {"mode": "composite", "opacity": 0.05},
    "isosurface": {"mode": "isosurface"},
    "rays, 1 light": {"mode": "isosurface", "shadow_rays": True, "lights": _SUNS[0]},
    "rays, 3 lights": {"mode": "isosurface", "shadow_rays": True, "lights": _SUNS},
}


def taken(work: Callable[[], object]) -> tuple[float, float]:
    """Seconds, and those of all cores."""
    begun, before = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - begun, time.process_time() - before


def read(lit: Lit, points: NDArray[np.float64], channel: int) -> NDArray[np.float64]:
    """What is left of light at world points, blended as pictures do."""
    place = lit.cells.nodes.world_to_index(points) + BEYOND
    light = lit.light[channel // 4, ..., channel % 4]
    node = np.clip(place.astype(np.int64), 0, np.array(light.shape[::-1]) - 2)
    share, total = np.clip(place - node, 0, 1), np.zeros(len(points))
    for corner in np.ndindex(2, 2, 2):
        x, y, z = (node + corner).T
        total += np.where(corner, share, 1 - share).prod(1) * light[z, y, x]
    return total


def folds() -> clvol.Volume:
    """A computed ball of deep folds."""
    x, y, z = np.mgrid[-1 : 1 : _EDGE * 1j, -1 : 1 : _EDGE * 1j, -1 : 1 : _EDGE * 1j].astype(np.float32)
    return clvol.Volume(1 - np.sqrt(x**2 + y**2 + z**2) + 0.2 * np.sin(9 * x) * np.sin(8 * y) * np.sin(10 * z))


def errors(path: str, mode: str) -> None:
    """Print by how much shadows of a scan are off."""
    volume = folds() if path == "folds" else clvol.read(path)
    with clvol.Renderer(volume) as renderer:
        found = renderer.render(size=_SIZE, rays=1, mode=mode, outputs=["position", "normal"])
        row = renderer.filter_of(mode)
        lit_alone = [lit_by(renderer, number) for number in (0, 1)] if mode == "isosurface" else []
    with clvol.Field(volume, row) as field:
        source = InMemory(as_scene(clvol.Medium(volume, filter=row)), field, volume, (field,))
        look = ResolvedLook.of(source.scene, source.part, None, as_mode(mode), {"shadow": 1.0, "occlusion": 1.0})
        body, shadows = source.body(look, 0.0), Shadows(field.device)
        lit = shadows.of(look.scene, [volume], lambda _: [body])
        normals = found["normal"].reshape(-1, 3)
        seen = np.flatnonzero(np.isfinite(normals).all(1) & (np.abs(normals).max(1) > 0))
        seen = np.random.default_rng(1).choice(seen, _POINTS, replace=False)
        normals = normals[seen].astype(np.float64)
        places = found["position"].reshape(-1, 3)[seen]
        points = places + ABOVE * lit.cells.edge * normals
        pyramid = MinMax(field.coefficients, choose_evaluator(field.device, row))
        follow = partial(tracked, pyramid, body.matter, OPAQUE / lit.cells.edge)
        ways = [np.array(light.direction) for light in look.scene.lights if light.direction is not None]
        for channel, (name, way) in enumerate(zip(("key", "fill"), ways, strict=True)):
            facing = normals @ way > 0
            left, error = follow(points[facing], way, paths=_PATHS)
            report(path, mode, name, read(lit, points[facing], channel), left, error)
            if lit_alone:
                left, error = follow((places + _OFF * volume.mean_spacing * normals)[facing], way, paths=_PATHS)
                left = np.where(left < 2 ** (1 - OPAQUE), 0, left)
                report(path, "at surface", name, read(lit, points[facing], channel), left, error)
                found_by_rays = lit_alone[channel].reshape(-1)[seen][facing] / (normals @ way)[facing]
                report(path, "by rays", name, found_by_rays, left, error)
        around = np.repeat(points, len(everywhere()), 0), np.tile(everywhere(), (_POINTS, 1))
        left, _ = follow(*around, paths=_PATHS // 16, far=FAR * lit.cells.diagonal)
        open_to = np.minimum(left.reshape(_POINTS, -1).mean(1) / OPEN, 1)
        report(path, mode, "everywhere", read(lit, points, 2), open_to, np.zeros(1))
        pyramid.release()
        shadows.release()


def lit_by(renderer: clvol.Renderer, number: int) -> NDArray[np.float64]:
    """How bright a white surface is in one of the usual lights alone, with rays to it."""
    lights = [replace(light, color=(float(n == number),) * 3) for n, light in enumerate(KIT)]
    white: dict[str, Any] = {"color": "white", "material": clvol.Material(0, 1, 0), "lights": lights}
    picture = renderer.render(size=_SIZE, rays=1, mode="isosurface", shadow=1, shadow_rays=True, **white)
    return np.asarray(picture[..., 0], np.float64)


def report(path: str, mode: str, light: str, swept: NDArray[Any], left: NDArray[Any], error: NDArray[Any]) -> None:
    """Print a row: what is lit in the mean, the RMS and median distance, and the RMS of the tracking's own error."""
    apart = swept - left
    rms, own = (float(np.sqrt((one**2).mean())) for one in (apart, error))
    print(f"{path[-20:]:20} {mode:10} {light:10} {left.mean():6.2f} {rms:7.3f} {np.median(np.abs(apart)):7.3f} {own:7.4f}")


def main() -> None:
    """Measure, and print tables."""
    for path in sys.argv[1:]:
        for mode in ("composite", "isosurface"):
            errors(path, mode)
    if sys.argv[1:]:
        return
    volume = folds()
    with clvol.Renderer(volume, "bspline3") as renderer:

        def picture(dark: int, look: dict[str, Any]) -> None:
            own = {name: value for name, value in look.items() if dark or name != "shadow_rays"}
            renderer.render(size=_SIZE, rays=1, shadow=dark, occlusion=dark * ("shadow_rays" not in look), **own)

        for name, look in _LOOKS.items():
            rounds = [[taken(partial(picture, dark, look)) for dark in (0, 1)] for _ in range(_ROUNDS + 1)][1:]
            for kind, what in enumerate(("s", "processor s")):
                plain, shadowed = (statistics.median(one[dark][kind] for one in rounds) for dark in (0, 1))
                print(f"{name:12} {plain:8.3f} {shadowed:8.3f} {what:12} {shadowed / plain:6.2f}")
    with clvol.Field(volume, "bspline3") as field:
        shadows, cells = Shadows(field.device), Cells.over([volume])
        ways = tuple(light.direction for light in KIT if light.direction is not None)
        body = Body.of(field.coefficients, Matter(((0.2, 0.0), (0.5, 0.3)), 1.0, (), Cuts()))
        for what, rounds_of in (("first", 1), ("again", _ROUNDS)):
            sweeps = [taken(partial(shadows.light, cells, [body], ways, occlusion=True)) for _ in range(rounds_of)]
            wall, processor = map(statistics.median, zip(*sweeps, strict=True))
            print(f"{what:12} {wall:8.3f} s {processor:8.3f} processor s")
        shadows.release()


if __name__ == "__main__":
    main()
