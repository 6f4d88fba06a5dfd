"""Renders and samples a fixed set of cases, and compares it with that of another commit.

    python -m bench.snapshot OUT.npz            # with this commit's clvol
    python -m bench.snapshot OLD.npz NEW.npz    # differences, to the last bit

Every mode meets every filter in both lane widths; every mode and filter meets every evaluator; the boundary rule rotates so
that each meets every mode, filter and evaluator. Points, grids and prefilters are sampled likewise.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import clvol
from clvol.base.errors import DeviceError
from clvol.device import as_device

__all__ = ["compare", "make"]

Arrays = dict[str, NDArray[Any]]
SIZE = (37, 33)
STEP = 0.43
OUTPUTS: tuple[Any, ...] = ("rgba", "depth", "normal", "position", "visited")
EVALUATORS: tuple[tuple[Any, Any], ...] = (
    ("taps", "buffer"),
    ("eight-fetch", "buffer"),
    ("eight-fetch", "image"),
    ("taps", "image"),
)
# planes shared by 16 × 16 rays in the widest vectors; by an odd number of rows, hence in eights; and ray by ray
TILES = {"wide": (16, 16, 8, True), "eights": (16, 15, 8, True), "rays": (1, 1, 1, False)}
TRANSFER = clvol.TransferFunction(
    ((0.0, (0.1, 0.2, 0.9)), (0.3, (0.9, 0.1, 0.2)), (0.6, (0.2, 0.8, 0.3)), (1.0, (1.0, 1.0, 0.9))),
    ((0.3, 0.0), (0.5, 0.2), (1.0, 0.7)),
)
OPTIONS: dict[str, dict[str, Any]] = {
    "composite": {"transfer": TRANSFER, "background": None},
    "isosurface": {"isovalue": 0.52, "color": (0.4, 0.7, 0.9)},
    "mip": {"transfer": TRANSFER},
    "minip": {"transfer": TRANSFER, "background": "white"},
    "mean": {},
    "attenuated": {"transfer": TRANSFER, "attenuation": 1.5},
}


def volume(shape: tuple[int, ...] = (13, 15, 14)) -> clvol.Volume:
    """Smooth noise over 0..1 with sheared axes and unequal spacings."""
    noise = clvol.Volume(np.random.default_rng(7).random(shape)).gaussian(0.8).data
    data = ((noise - noise.min()) / np.ptp(noise)).astype(np.float32)
    d = len(shape)
    direction = np.array([[0.8, -0.6, 0.1], [0.6, 0.8, 0.2], [0.0, 0.0, 1.0]])[:d, :d]
    direction /= np.linalg.norm(direction, axis=0)
    return clvol.Volume(data, (1.0, 0.8, 1.3)[:d], (5.0, -3.0, 2.0)[:d], direction)


def make() -> Arrays:
    """Every array of the set by name."""
    arrays: Arrays = {}
    device = as_device()
    rules = itertools.cycle(clvol.boundaries())
    block = volume()

    def draw(name: str, filter: str, mode: str, tile: str | None = None, **options: Any) -> None:
        rule = next(rules)
        lit = mode in ("composite", "isosurface") and options.get("shading", True)
        options = {
            "camera": clvol.Camera.orbit(33, 21, fit="volume"),
            "step": STEP,
            "rays": 1,
            **({"lights": clvol.Light()} if lit else {}),
            **OPTIONS[mode],
            **options,
        }
        with device.limited(tile=TILES[tile] if tile else None):
            try:
                made = clvol.render(block, mode=mode, filter=filter, boundary=rule, size=SIZE, outputs=OUTPUTS, **options)
            except DeviceError as error:
                print(f"without {name}: {error}", file=sys.stderr)
                return
        arrays.update({f"{name}, {rule}, {output}": made[output] for output in OUTPUTS})

    modes = [mode for mode in clvol.modes() if mode in OPTIONS]
    for mode, row in itertools.product(modes, clvol.filters()):
        for tile in ("wide", "eights"):
            draw(f"{mode}, {row}, {tile}", row, mode, tile)
        next(rules)  # so that rules and filters combine differently
    for mode, tile, flags in itertools.product(modes, TILES, range(3)):
        look: dict[str, Any] = {"gradient": "central"} if flags == 1 else {}
        if flags == 2 and mode in ("composite", "isosurface"):
            look["shading"] = False
        draw(f"{mode}, bspline3, {tile}, {look}", "bspline3", mode, tile, **look)
        draw(f"{mode}, bspline3, {tile}, {look}, all samples", "bspline3", mode, tile, skipping=False, **look)
    for mode, (evaluator, fetch) in itertools.product(modes, EVALUATORS):
        with device.limited(evaluator=evaluator, fetch=fetch):
            draw(f"{mode}, {evaluator} from {fetch}", "bspline3", mode)
    for row, (evaluator, fetch) in itertools.product(clvol.filters(), EVALUATORS):
        with device.limited(evaluator=evaluator, fetch=fetch):
            draw(f"composite, {row}, {evaluator} from {fetch}", row, "composite")
    for mode, tile in itertools.product(modes, TILES):
        for k, (azimuth, elevation) in enumerate(((100, 10), (20, -75), (200, 5), (-50, 40))):
            more = ({}, {"rays": 3}, {"clip": ((7.0, -2.0, 4.0), (14.0, 6.0, 15.0))}, {"step": 1.7})[k]
            camera = clvol.Camera.orbit(
                azimuth, elevation, projection=("perspective", "orthographic")[k % 2], fov=(30, 30, 110, 30)[k], fit="volume"
            )
            draw(f"{mode}, bspline3, {tile}, view {k}", "bspline3", mode, tile, **{"camera": camera, **more})
    light = clvol.Light((0.3, -1.0, 0.5), (0.9, 0.8, 0.4))
    for mode in ("composite", "isosurface"):
        draw(f"{mode}, two lights", "bspline3", mode, lights=(clvol.Light(), light), material=clvol.Material(0.1, 0.6, 0.4, 12.5))

    rng = np.random.default_rng(3)
    for d, row in itertools.product((3, 2), clvol.filters()):
        samples = volume((13, 15, 14)[:d])
        low, high = samples.corners.min(0) - 4, samples.corners.max(0) + 4
        points = rng.uniform(low, high, (700, d))
        for derivative, (evaluator, fetch) in itertools.product((0, 1, 2), EVALUATORS):
            rule = next(rules)
            key = f"points, {d}-D, {row}, {rule}, derivative {derivative}, {evaluator} from {fetch}"
            try:
                with as_device(None).limited(evaluator=evaluator, fetch=fetch):
                    arrays[key] = clvol.sample(samples, points, row, rule, derivative)
            except DeviceError as error:
                print(f"without {key}: {error}", file=sys.stderr)
        next(rules)
    for d, row, rule in itertools.product((3, 2), clvol.filters(), clvol.boundaries()):
        samples = volume((13, 15, 14)[:d])
        arrays[f"prefilter, {d}-D, {row}, {rule}"] = clvol.prefilter(samples.data, row, rule)
        arrays[f"magnified, {d}-D, {row}, {rule}"] = clvol.magnify(samples, 3, row, rule).data
        arrays[f"resampled, {d}-D, {row}, {rule}"] = clvol.resample(samples, (9, 20, 11)[:d], None, None, row, rule).data
        turned = clvol.Volume(np.broadcast_to(np.float32(0), (9, 8, 10)[:d]), (0.7,) * d, tuple(samples.center - 2))
        arrays[f"turned, {d}-D, {row}, {rule}"] = clvol.resample(samples, like=turned, filter=row, boundary=rule, fill=-1).data
    for shape in ((1, 1, 1), (1, 9, 9), (2, 1, 40), (40, 3, 2)):
        small = np.random.default_rng(5).random(shape).astype(np.float32)
        for mode in modes:
            options: dict[str, Any] = {"camera": clvol.Camera.orbit(fit="volume"), "lights": clvol.Light(), "rays": 1}
            options |= {"isovalue": 0.5} if mode == "isosurface" else {}
            made = clvol.render(small, mode=mode, size=SIZE, outputs=OUTPUTS, **options)
            arrays.update({f"{mode}, shape {shape}, {output}": made[output] for output in OUTPUTS})
    large = np.random.default_rng(6).random((130, 128, 129)).astype(np.float32)
    at = np.random.default_rng(8).uniform(0, 127, (1 << 17, 3))
    for derivative in (0, 1):
        arrays[f"points in no order, derivative {derivative}"] = clvol.sample(large, at, derivative=derivative)
    return arrays


def compare(old: Arrays, new: Arrays) -> list[str]:
    """A line for each array that differs in any bit (NaN in the same place is equal), or that only one set has."""
    lines = []
    for name in old.keys() | new.keys():
        if name not in old or name not in new:
            lines.append(f"only in {'new' if name in new else 'old'}: {name}")
        elif old[name].shape != new[name].shape or old[name].dtype != new[name].dtype:
            lines.append(f"{name}: {old[name].dtype} {old[name].shape} became {new[name].dtype} {new[name].shape}")
        elif old[name].tobytes() != new[name].tobytes() and not np.array_equal(old[name], new[name], equal_nan=True):
            both = np.isfinite(old[name]) & np.isfinite(new[name])
            off = np.abs(old[name][both].astype(np.float64) - new[name][both])
            changed = int((old[name] != new[name]).sum() - (np.isnan(old[name]) & np.isnan(new[name])).sum())
            lines.append(f"{name}: {changed} of {old[name].size} differ, by up to {off.max(initial=0):.3g}")
    return sorted(lines)


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m bench.snapshot", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("first", type=Path)
    parser.add_argument("second", type=Path, nargs="?")
    options = parser.parse_args()
    if options.second is None:
        started = time.perf_counter()
        arrays = make()
        np.savez(options.first, **arrays)  # type: ignore[arg-type]  # names are no keywords
        print(f"{len(arrays)} arrays in {time.perf_counter() - started:.0f} s: {options.first}")
        return 0
    with np.load(options.first) as old, np.load(options.second) as new:
        lines = compare(dict(old), dict(new))
        print("\n".join(lines) or f"all {len(old.files)} arrays are the same to the last bit")
    return bool(lines)


if __name__ == "__main__":
    sys.exit(main())
