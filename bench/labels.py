"""Labels with smooth boundaries: how far they are from the truth, and what 300 labels of 256³ take.

    python -m bench.labels [--quick]

Truth: shapes whose distance functions are known, sampled as labels (a sample has the label of its centre) with spacings 1, 1, 1 and
1, 1, 5 along x, y, z, then put on a grid four times as fine along each axis. "off" is the root mean square of the distance from the
truth of the boundary, in the smallest spacing: of points of the fine grid between two labels, halfway, so that the fine grid itself
has a share, which is printed; `bench.meshes` measures vertices and normals. Dice is that of the first label. "one-hot linear" is
`smooth=True` with `filter="linear"`, the same labels as with a volume for each; ITK's is `sitkLabelGaussian`, if SimpleITK
is installed.

Time: 300 regions of 256³, onto as many points half a sample beside, and turned; medians of five rounds after one that compiles.
Memory: the peak of a process of its own, of what it holds beside its libraries, relative to the labels and the result (Linux).
"""

from __future__ import annotations

import argparse
import importlib
import statistics
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

import clvol

Array: TypeAlias = NDArray[Any]
Distances: TypeAlias = Callable[[Array], list[Array]]  # of points (..., 3) from each label's surface, negative inside

SPACINGS = ((1.0, 1.0, 1.0), (1.0, 1.0, 5.0))
_FINER, _EDGE = 4, 40.0
_MIDDLE, _BESIDE = np.array([20.3, 19.8, 20.1]), np.array([8.0, 0, 0])


def _ball(centre: Array, radius: float) -> Callable[[Array], Array]:
    return lambda at: np.asarray(np.linalg.norm(at - centre, axis=-1) - radius)


def _torus(at: Array) -> Array:
    x, y, z = np.moveaxis(at - _MIDDLE, -1, 0)
    return np.asarray(np.hypot(np.hypot(x, z) - 11.2, y) - 4.7)


def _plane(azimuth: float, elevation: float) -> Distances:
    a, e = np.radians([azimuth, elevation])
    normal = np.array([np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e)])
    return lambda at: [(at - _MIDDLE) @ normal]


SHAPES: dict[str, Distances] = {
    "ball of radius 9.4": lambda at: [_ball(_MIDDLE, 9.4)(at)],
    "ball of radius 14": lambda at: [_ball(_MIDDLE, 14.0)(at)],
    "torus, 11.2 and 4.7": lambda at: [_torus(at)],
    "two balls that touch": lambda at: [_ball(_MIDDLE - _BESIDE, 8.0)(at), _ball(_MIDDLE + _BESIDE, 8.0)(at)],
    **{f"plane, {a}° and {e}°": _plane(a, e) for a, e in ((0, 7), (23, 0), (45, 35), (67, 80), (11, 51))},
}


def _labels(distances: list[Array]) -> Array:
    found = np.zeros(distances[0].shape, np.uint8)
    for label, distance in enumerate(distances, 1):
        found[distance < 0] = label
    return found


def _places(volume: clvol.Volume) -> Array:
    index = np.stack(np.meshgrid(*(np.arange(n) for n in volume.shape), indexing="ij"), -1)[..., ::-1]
    return np.asarray(volume.index_to_world(index))


def _off(labels: Array, distances: list[Array], smallest: float) -> float:
    """The RMS distance of the boundary of labels, away from the volume's faces."""
    inner = (slice(4 * _FINER // 2, -4 * _FINER // 2),) * 3
    squares, count = 0.0, 0
    for axis in range(3):
        low, high = (np.moveaxis(labels[inner], axis, 0)[part] for part in (slice(None, -1), slice(1, None)))
        where = low != high
        nearest = np.min(
            [np.abs(np.moveaxis(d[inner], axis, 0)[:-1] + np.moveaxis(d[inner], axis, 0)[1:]) / 2 for d in distances], 0
        )
        squares, count = squares + float((nearest[where] ** 2).sum()), count + int(where.sum())
    return float(np.sqrt(squares / max(count, 1))) / smallest


def sampled(distances_at: Distances, spacing: tuple[float, float, float]) -> clvol.Volume:
    """A shape as labels."""
    grid = clvol.Volume(np.broadcast_to(np.float32(0), tuple(round(_EDGE / s) for s in spacing[::-1])), spacing)
    return clvol.Volume(_labels(distances_at(_places(grid))), spacing, labels=True)


def _dice(labels: Array, truth: Array) -> float:
    one, other = labels == 1, truth == 1
    return float(2 * (one & other).sum() / (one.sum() + other.sum()))


def _ways(volume: clvol.Volume, grid: clvol.Volume) -> dict[str, Callable[[], Array]]:
    def smooth(filter: str) -> Callable[[], Array]:
        return lambda: clvol.resample(volume, like=grid, filter=filter, smooth=True).data

    found: dict[str, Callable[[], Array]] = {
        "nearest": lambda: clvol.resample(volume, like=grid, filter="nearest").data,
        "one-hot linear": smooth("linear"),
        "smooth, cubic": smooth("bspline3-approx"),
        "smooth, quintic": smooth("bspline5-approx"),
        "smooth, wide(2)": smooth("wide(2)"),
    }
    if find_spec("SimpleITK"):
        itk: Any = importlib.import_module("SimpleITK")
        like = clvol.Volume(np.zeros(grid.shape, np.uint8), grid.spacing, grid.origin, grid.direction)
        made = (volume.to_sitk(), like.to_sitk(), itk.Transform(), itk.sitkLabelGaussian, 0)
        found["ITK LabelGaussian"] = lambda: np.asarray(itk.GetArrayFromImage(itk.Resample(*made)))
    return found


def accuracy(spacing: tuple[float, float, float], shapes: dict[str, Distances]) -> None:
    """Print the table of one spacing."""
    print(f"\nspacing {spacing}: off, in the smallest spacing (Dice)")
    for name, distances_at in shapes.items():
        volume = sampled(distances_at, spacing)
        fine = clvol.resample(volume, tuple(_FINER * n for n in volume.shape), filter="nearest")
        distances = distances_at(_places(fine))
        truth = _labels(distances)
        cells = []
        for way, make in {**_ways(volume, fine), "truth on this grid": lambda: truth}.items():  # noqa: B023  # called at once
            labels = make()  # type: ignore[no-untyped-call]  # SimpleITK's function has no types
            cells.append(f"{way} {_off(labels, distances, min(spacing)):.3f} ({_dice(labels, truth):.4f})")
        print(f"  {name:24} " + "   ".join(cells))


def regions(n: int, count: int) -> Array:
    """The Voronoi regions of random points."""
    from scipy.spatial import cKDTree

    tree = cKDTree(np.random.default_rng(0).uniform(0, n, (count, 3)))
    found = np.empty((n, n, n), np.uint16)
    for k, plane in enumerate(found):
        y, x = np.mgrid[:n, :n]
        plane[...] = 1 + tree.query(np.stack([np.full_like(x, k), y, x], -1))[1]
    return found


def _grids(n: int) -> dict[str, clvol.Volume]:
    still = np.broadcast_to(np.float32(0), (n, n, n))
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    start = tuple(((n - 1) / 2 - turn @ np.full(3, (n - 1) / 2)).tolist())
    return {
        "along the axes": clvol.Volume(still, (1, 1, 1), (0.5, 0.5, 0.5)),
        "turned": clvol.Volume(still, (1, 1, 1), start, turn),
    }


def _growth(path: Path, name: str, row: str) -> float:
    """The peak of this process while labels are resampled, in bytes of the labels and the result together."""
    data: Array = np.load(path)
    volume, grid = clvol.Volume(data, labels=True), _grids(len(data))[name]
    small = clvol.Volume(data[:8, :8, :8].copy(), labels=True)
    clvol.resample(small, like=grid.crop((0, 0, 0), (8, 8, 8)), filter=row, smooth=True)  # compiled, and the runtime loaded
    Path("/proc/self/clear_refs").write_text("5")  # the peak starts anew
    before = _status("VmRSS")
    clvol.resample(volume, like=grid, filter=row, smooth=True)
    return (data.nbytes + _status("VmHWM") - before) / (2 * data.nbytes)


def _status(entry: str) -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(1024 * int(line.split()[1]) for line in lines if line.startswith(entry))


def speed(n: int, count: int, rounds: int) -> None:
    """Print what many labels take."""
    data = regions(n, count)
    volume = clvol.Volume(data, labels=True)
    print(f"\n{count} labels of {n}³")
    with TemporaryDirectory() as folder:
        path = Path(folder) / "labels.npy"
        np.save(path, data)
        for name, grid in _grids(n).items():
            for row in ("linear", "bspline3-approx", "bspline5-approx"):
                seconds = []
                for _ in range(1 + rounds):
                    begun = time.perf_counter()
                    clvol.resample(volume, like=grid, filter=row, smooth=True)
                    seconds.append(time.perf_counter() - begun)
                with ProcessPoolExecutor(1, get_context("spawn")) as pool:
                    peak = pool.submit(_growth, path, name, row).result()
                print(f"  {name:16} {row:16} {statistics.median(seconds[1:]):6.2f} s   peak {peak:.2f} × labels and result")


def main() -> None:
    """Measure, and print the tables."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--quick", action="store_true", help="smaller work: a check that all of it runs")
    quick = arguments.parse_args().quick
    shapes = dict(list(SHAPES.items())[:1]) if quick else SHAPES
    for spacing in SPACINGS:
        accuracy(spacing, shapes)
    speed(*((24, 10, 1) if quick else (256, 300, 5)))


if __name__ == "__main__":
    main()
