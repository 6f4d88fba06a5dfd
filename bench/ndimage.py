"""`clvol.ndimage` beside SciPy and others, call by call, each with its goal.

    python -m bench.ndimage [--quick] [--long] [--only WORD] [--markdown] [--output FILE]

Every call is the same text for both modules. Rows are timed as in `python -m bench` (alternating, medians) and can be compared
by `python -m bench.compare OLD.json NEW.json`. About two minutes on two idle cores. `--long` also measures SciPy and
scikit-image on the largest array, a quarter of an hour each (otherwise a smaller array is measured and its time scaled, as the
table states), and uses a series of 100 images, not 8.
"""

from __future__ import annotations

import argparse
import datetime as dt
import importlib
import json
import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy import ndimage as scipy_ndimage

import clvol
from bench import fresh, peers
from bench.__main__ import add_rooflines
from bench.cases import MAGNIFY, PREFILTER, VALUE, Skip, Work, measure
from bench.machine import Cost, available_memory, describe, measure_limits
from bench.peers import Peer
from clvol import ndimage
from clvol.device import as_device

__all__ = ["Aim", "Row", "rows", "table_in_markdown"]

RESULTS = Path(__file__).parent / "results" / "ndimage"
FORMAT = 2
BUSY = 0.5  # Times measured at a higher initial load are unreliable
NEEDS = {"scikit-image": "skimage", "SimpleITK": "SimpleITK", "torch": "torch", "torch-interpol": "interpol", "numba": "numba"}

Array = NDArray[Any]
Call = Callable[[Any], Any]  # of `clvol.ndimage` or `scipy.ndimage`

# What one sample of a cubic result takes at the least, float32; positions of points are float64.
GRID = Cost(bytes=8, loads=VALUE.loads, multiply_adds=VALUE.multiply_adds)
POINT = Cost(bytes=3 * 8 + 8, loads=VALUE.loads, multiply_adds=VALUE.multiply_adds)


@dataclass(frozen=True)
class Aim:
    """The goal of a row.

    Attributes
    ----------
    times : float, optional
        Speed relative to SciPy, at least.
    seconds : float, optional
        At most.
    """

    times: float | None = None
    seconds: float | None = None

    def __str__(self) -> str:
        return ", ".join(
            text
            for text in (f"≥ {self.times:g} ×" if self.times else "", f"≤ {_seconds(self.seconds)}" if self.seconds else "")
            if text
        )

    def reached(self, row: dict[str, Any]) -> bool:
        """Whether a measured row reaches its goal."""
        fast = self.times is None or row["times_as_fast_as"].get("SciPy", self.times) >= self.times
        return fast and (self.seconds is None or row["seconds"]["clvol"] <= self.seconds)


@dataclass(frozen=True)
class Row:
    """One row of the table: its name, its goal, how to prepare it."""

    name: str
    aim: Aim
    prepare: Callable[[], Work | dict[str, Any]]


class _Bench:
    """Sizes and arrays; each method returns the rows of one kind of call."""

    def __init__(self, *, quick: bool, long: bool) -> None:
        self.repeats = 2 if quick else 5
        self.sides = (12, 16) if quick else (64, 128)
        self.filtered = (12, 16) if quick else (64, 128, 256)
        self.large = 24 if quick else 400
        self.few = self.large if long else 12 if quick else 64  # for peers that would take a quarter of an hour
        self.bold = (3, 9, 11, 9) if quick else (100 if long else 8, 97, 115, 97)
        self.generator = np.random.default_rng(12)

    def cube(self, n: int, kind: type[np.generic]) -> Array:
        return self.noise((n, n, n), kind)

    def noise(self, shape: tuple[int, ...], kind: type[np.generic]) -> Array:
        return self.generator.standard_normal(shape).astype(kind)

    def of(self, call: Call, others: dict[str, Peer] | None = None, samples: float = 0, cost: Cost | None = None) -> Work:
        theirs = {"SciPy": Peer(partial(call, scipy_ndimage)), **(others or {})}
        return Work(partial(call, ndimage), theirs, samples, "Msample/s", cost, self.repeats, _difference)

    # -- grids ---------------------------------------------------------------------------------------------------

    def zoom(self, n: int, kind: type[np.generic], order: int) -> Work:
        data = self.cube(n, kind)
        others: dict[str, Peer] = {}
        if order == 3 and n == self.sides[0] and _has("scikit-image"):
            transform = importlib.import_module("skimage.transform")
            others["scikit-image"] = Peer(lambda: transform.resize(data, (2 * n,) * 3, 3, anti_aliasing=False, clip=False))
        if kind is np.float32:
            steps = np.eye(3, 4) * (n - 1) / (2 * n - 1)
            others |= _itk_affine(data, steps, (2 * n,) * 3, order)
            if order == 1:
                others |= _torch_zoom(data)
            elif _has("torch-interpol"):
                interpol, tensor = importlib.import_module("interpol"), _tensor(data)
                options = {"interpolation": 3, "bound": "dct1", "prefilter": True}
                others["torch-interpol"] = Peer(lambda: interpol.resize(tensor, factor=2, **options).numpy()[0, 0])
        return self.of(lambda module: module.zoom(data, 2, order=order), others, 8 * n**3, _cost(MAGNIFY, kind, order))

    def affine(self, n: int, kind: type[np.generic], order: int) -> Work:
        data = self.cube(n, kind)
        matrix, offset = _turned(n)
        others: dict[str, Peer] = {}
        if kind is np.float32:
            table = np.column_stack([matrix[::-1, ::-1], offset[::-1]])
            others |= _itk_affine(data, table, data.shape, order)
            if order == 1:
                others |= _torch_affine(data, matrix, offset)
        cost = _cost(GRID, kind, order)
        return self.of(lambda module: module.affine_transform(data, matrix, offset, order=order), others, n**3, cost)

    def rotate(self, n: int, axes: tuple[int, int]) -> Work:
        data = self.cube(n, np.float32)
        return self.of(lambda module: module.rotate(data, 30, axes, reshape=False), None, n**3)

    # -- points --------------------------------------------------------------------------------------------------

    def points(self, n: int, kind: type[np.generic], order: int, *, random: bool) -> Work:
        data = self.cube(n, kind)
        if random:
            at = self.generator.uniform(0, n - 1, (3, n**3))
        else:
            matrix, offset = _turned(n)
            at = np.clip((matrix @ np.indices(data.shape).reshape(3, -1)) + offset[:, None], 0, n - 1)
        others: dict[str, Peer] = {}
        if kind is np.float32:
            backwards = np.ascontiguousarray(at[::-1].T, np.float32)
            if _has("numba") and n > 15:
                plain = importlib.import_module("bench.plain")
                if order == 3:
                    others["numba"] = Peer(lambda: plain.sample(plain.prefilter(data), backwards))
                else:
                    others["numba"] = Peer(lambda: plain.sample_linear(data, backwards))
            if order == 1 and _has("torch"):
                sample, tensor = importlib.import_module("torch.nn.functional").grid_sample, _tensor(data)
                grid = _torch().from_numpy(backwards * np.float32(2 / (n - 1)) - 1)[None, None, None]
                others["torch"] = Peer(lambda: sample(tensor, grid, align_corners=True).numpy().ravel())
            if order == 3 and _has("torch-interpol"):
                interpol, tensor = importlib.import_module("interpol"), _tensor(data)
                grid = _torch().from_numpy(np.ascontiguousarray(at.T, np.float32))[None, :, None, None]
                options = {"interpolation": 3, "bound": "dct1", "prefilter": True}
                others["torch-interpol"] = Peer(lambda: interpol.grid_pull(tensor, grid, **options).numpy().ravel())
        return self.of(lambda module: module.map_coordinates(data, at, order=order), others, n**3, _cost(POINT, kind, order))

    # -- coefficients --------------------------------------------------------------------------------------------

    def filter(self, n: int, kind: type[np.generic], *, given: bool) -> Work:
        data = self.cube(n, kind)
        targets: list[Any] = [np.empty_like(data), np.empty_like(data)] if given else [kind, kind]
        others: dict[str, Peer] = {}
        if kind is np.float32 and not given:
            if _has("numba") and n > 15:
                plain = importlib.import_module("bench.plain")
                others["numba"] = Peer(lambda: plain.prefilter(data))
            if _has("SimpleITK"):
                itk = importlib.import_module("SimpleITK")
                image = itk.GetImageFromArray(data)
                others["SimpleITK"] = Peer(lambda: itk.GetArrayFromImage(itk.BSplineDecomposition(image, 3)))

        def call(module: Any) -> Array:
            found: Array = module.spline_filter(data, 3, targets[module is ndimage])
            return found

        return self.of(call, others, n**3, _cost(PREFILTER, kind, 3))

    def magnify(self, n: int) -> Work:
        data = self.cube(n, np.float32)
        theirs = {"SciPy" if name == "scipy" else name: peer for name, peer in peers.of("magnify", data).items()}
        return Work(lambda: clvol.magnify(data, 2).data, theirs, float((2 * n) ** 3), "Msample/s", MAGNIFY, self.repeats, _inside)

    # -- few samples, and many -----------------------------------------------------------------------------------

    def small(self, shape: tuple[int, ...], name: str, order: int) -> Work:
        data = self.noise(shape, np.float32)
        at = np.indices(shape) + 0.3
        calls: dict[str, Call] = {
            "spline_filter": lambda module: module.spline_filter(data, order, np.float32),
            "zoom ×2": lambda module: module.zoom(data, 2, order=order),
            "shift": lambda module: module.shift(data, 0.3, order=order),
            "rotate": lambda module: module.rotate(data, 30, reshape=False, order=order),
            "map_coordinates": lambda module: module.map_coordinates(data, at, order=order),
        }
        work = self.of(calls[name])
        work.repeats = 10 * self.repeats
        return work

    def series(self, *, points: bool) -> Work:
        """A series of volumes, each slightly moved, as in motion correction."""
        frames, *shape = self.bold
        series, out = self.noise(self.bold, np.float32), np.empty(self.bold, np.float32)
        moves = [_motion(self.generator, tuple(shape)) for _ in range(frames)]
        at = np.indices(shape).reshape(3, -1) + 0.3 if points else None

        def one(module: Any, number: int) -> None:
            if at is not None:
                module.map_coordinates(series[number], at, out[number].reshape(-1), mode="nearest")
            else:
                module.affine_transform(series[number], *moves[number], output=out[number], mode="nearest")

        def call(module: Any) -> Array:
            if module is ndimage:  # whose kernels use all cores
                for number in range(frames):
                    one(module, number)
            else:
                with ThreadPoolExecutor(os.cpu_count()) as pool:
                    list(pool.map(partial(one, module), range(frames)))
            return out.copy()

        work = self.of(call, None, out.size)
        work.peers, work.repeats = {"SciPy, threads": work.peers["SciPy"]}, min(3, self.repeats)
        return work

    def largest(self) -> dict[str, Any]:
        """nnU-Net's default resampling, in new processes: seconds, and bytes beyond the input."""
        n, few = self.large, self.few
        wanted = 4 * ((2 * n) ** 3 + 2 * n**3)
        if 0 < available_memory() < 1.3 * wanted:
            raise Skip(f"it takes {wanted / 2**30:.1f} GiB; {available_memory() / 2**30:.1f} GiB are available")
        sizes = {"clvol": n, "SciPy": few}
        if _has("scikit-image"):
            sizes["scikit-image"] = few
        if _has("torch"):
            sizes["torch, trilinear"] = n
        seconds, memory = {}, {}
        for who, side in sizes.items():
            found = fresh.large(who, side)
            name = who if side == n else f"{who}, {side}³ × {(n / side) ** 3:.0f}"
            seconds[name], memory[name] = (float(found[what] * (n / side) ** 3) for what in ("seconds", "bytes"))
        return {"seconds": seconds, "bytes": memory, "least_bytes": wanted - 4 * n**3}


def rows(*, quick: bool = False, long: bool = False) -> Iterator[Row]:
    """Every row, in the order of the table."""
    bench = _Bench(quick=quick, long=long)
    single, double = np.float32, np.float64
    for n in bench.sides:
        yield Row(f"zoom ×2, {n}³", Aim(40), partial(bench.zoom, n, single, 3))
        yield Row(f"affine_transform, {n}³", Aim(40), partial(bench.affine, n, single, 3))
        for axes in ((1, 0), (2, 1)):
            yield Row(f"rotate, axes {axes}, {n}³", Aim(40), partial(bench.rotate, n, axes))
        for random in (True, False):
            what = f"map_coordinates, {n}³ {'random' if random else 'smooth'} points"
            yield Row(what, Aim(20), partial(bench.points, n, single, 3, random=random))
    for n in bench.sides:
        yield Row(f"order 1: zoom ×2, {n}³", Aim(8), partial(bench.zoom, n, single, 1))
        yield Row(f"order 1: affine_transform, {n}³", Aim(8), partial(bench.affine, n, single, 1))
        yield Row(f"order 1: map_coordinates, {n}³ smooth points", Aim(8), partial(bench.points, n, single, 1, random=False))
    for n in bench.sides:
        yield Row(f"float64: zoom ×2, {n}³", Aim(10), partial(bench.zoom, n, double, 3))
        yield Row(f"float64: affine_transform, {n}³", Aim(10), partial(bench.affine, n, double, 3))
        yield Row(f"float64: map_coordinates, {n}³ random points", Aim(10), partial(bench.points, n, double, 3, random=True))
        yield Row(f"float64: spline_filter, {n}³", Aim(10), partial(bench.filter, n, double, given=False))
    for n in bench.filtered:
        for given in (False, True):
            name = f"spline_filter, {n}³, {'output= given' if given else 'fresh result'}"
            yield Row(name, Aim(15), partial(bench.filter, n, single, given=given))
    yield Row(f"clvol.magnify ×2, {bench.sides[-1]}³", Aim(seconds=0.016), partial(bench.magnify, bench.sides[-1]))
    for label, shape in (("16³", (16,) * 3), ("256²", (256,) * 2)):
        for order in (2, 3):
            for name in ("spline_filter", "zoom ×2", "shift", "rotate", "map_coordinates"):
                aim = Aim(1, 5e-4 if label == "16³" else None)
                yield Row(f"{label}: {name}, order {order}", aim, partial(bench.small, shape, name, order))
    label = "{} × {}×{}×{}".format(*bench.bold)
    yield Row(f"series, {label}: affine_transform", Aim(), partial(bench.series, points=False))
    yield Row(f"series, {label}: map_coordinates", Aim(), partial(bench.series, points=True))
    yield Row(f"zoom ×2, {bench.large}³, in a new process", Aim(), bench.largest)


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--quick", action="store_true", help="tiny work: a check that all of it runs")
    arguments.add_argument("--long", action="store_true", help="measure SciPy and scikit-image on the largest array too")
    arguments.add_argument("--only", default="", metavar="WORD", help="only rows whose name holds this")
    arguments.add_argument("--markdown", action="store_true", help="print the table as Markdown")
    arguments.add_argument("--output", type=Path, help="default: bench/results/ndimage/<date>.json; not with --quick or --only")
    options = arguments.parse_args()
    console = Console(width=150, stderr=options.markdown)
    device = as_device()
    started, load = time.perf_counter(), [os.getloadavg()[0]]
    if load[0] > BUSY:
        console.print(f"[yellow]the machine is busy (load {load[0]:.1f}): times will be too long[/yellow]")
    limits = measure_limits(device)
    missing = [name for name in NEEDS if not _has(name)]
    if missing:
        console.print(f"[yellow]without {', '.join(missing)}[/yellow]")
    found = []
    for row in rows(quick=options.quick, long=options.long):
        if options.only in row.name:
            console.print(f"[dim]{row.name}[/dim]")
            found.append(_measured(replace(row, aim=Aim()) if options.quick else row))  # goals are for the full sizes
    load.append(os.getloadavg()[0])
    limits = limits.best(measure_limits(device))
    add_rooflines(found, limits)
    if options.markdown:
        print(table_in_markdown(found))
    else:
        console.print(_table(found))
    for one in found:
        for name, why in one.get("failed", {}).items():
            console.print(f"[yellow]{one['name']}: {name} failed: {why}[/yellow]")
    missed = [one["name"] for one in found if not one.get("reached", True)]
    console.print(
        f"{len(missed)} of {len(found)} rows are short of what is aimed at" + (f": {'; '.join(missed)}" if missed else "")
    )
    console.print(f"[dim]{time.perf_counter() - started:.0f} s, load {load[0]:.1f} before and {load[1]:.1f} at the end[/dim]")
    today = dt.datetime.now(tz=dt.UTC).date().isoformat()
    output = options.output or (None if options.quick or options.only else RESULTS / f"{today}.json")
    if output:
        report = {
            "format": FORMAT,
            "date": today,
            "quick": options.quick,
            "machine": {**describe(device), "load": load, "limits": asdict(limits)},
        }
        output.parent.mkdir(parents=True, exist_ok=True)
        output.write_text(json.dumps({**report, "results": found}, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        console.print(f"written: {output}")


def _measured(row: Row) -> dict[str, Any]:
    result: dict[str, Any] = {"name": row.name, "load": os.getloadavg()[0]}
    try:
        work = row.prepare()
    except Skip as reason:
        return {**result, "skipped": str(reason)}
    if isinstance(work, Work):
        measured = measure(work)
        result |= {"seconds": measured.seconds, "spread": measured.spread, "runs": measured.runs}
        result |= {"differs_by": measured.differs_by, "failed": measured.failed}
        if work.amount:
            result |= {"amount": work.amount, "rate": work.amount / measured.seconds["clvol"] / 1e6, "unit": work.unit}
        if work.cost is not None:
            result |= {"cost": asdict(work.cost)}
    else:
        result |= work
    ours = result["seconds"]["clvol"]
    result["times_as_fast_as"] = {who: taken / ours for who, taken in result["seconds"].items() if who != "clvol"}
    if str(row.aim):
        result |= {"aim": str(row.aim), "reached": row.aim.reached(result)}
    return result


def _cells(row: dict[str, Any]) -> list[str]:
    """Work, time, fraction of the limit, ratio to SciPy, goal, others."""
    if "skipped" in row:
        return [row["name"], "–", "", "–", "", row["skipped"]]
    ratios = dict(row["times_as_fast_as"])
    first = next(iter(ratios), None)
    beside = f"{_ratio(ratios.pop(first))} ×{first.removeprefix('SciPy')}" if first is not None else "–"
    others = [f"{who} {_ratio(ratio)} ×" for who, ratio in ratios.items()]
    if "bytes" in row:
        others += [f"memory beyond the input: {', '.join(f'{who} {size / 1e9:.2f} GB' for who, size in row['bytes'].items())}"]
    limit = f"{row['roofline']['share']:.0%} ({row['roofline']['of']})" if "roofline" in row else ""
    aim = row.get("aim", "") + ("" if row.get("reached", True) else ": missed")
    return [row["name"], _seconds(row["seconds"]["clvol"]), limit, beside, aim, "; ".join(others)]


_HEADS = ("work", "clvol", "of the limit", "times as fast as SciPy", "aim", "others, and how many times as fast as they")


def _table(found: list[dict[str, Any]]) -> Table:
    table = Table(*_HEADS, box=None)
    for row in found:
        cells = _cells(row)
        if not row.get("reached", True):
            cells[4] = f"[bold red]{cells[4]}[/bold red]"
        table.add_row(*cells)
    return table


def table_in_markdown(found: list[dict[str, Any]]) -> str:
    """The rows as a table of Markdown."""
    lines = [_HEADS, ("---",) * len(_HEADS), *map(_cells, found)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _seconds(value: float) -> str:
    return f"{value:.3g} s" if value >= 1 else f"{1e3 * value:.3g} ms"


def _ratio(value: float) -> str:
    return f"{value:.0f}" if value >= 9.95 else f"{value:.1f}" if value >= 0.95 else f"{value:.2f}"


# -- inner ------------------------------------------------------------------------------------------------------


def _has(name: str) -> bool:
    return find_spec(NEEDS[name]) is not None


def _cost(cost: Cost, kind: type[np.generic], order: int) -> Cost | None:
    """The cost where it is known: of cubics, in float32."""
    return cost if kind is np.float32 and order == 3 else None


def _turned(n: int) -> tuple[Array, Array]:
    """A matrix that rotates a cube by some degrees about three axes, and the offset that keeps its centre."""
    x, y, z = np.radians((7, 4, 10))
    about_x = np.array([[np.cos(x), -np.sin(x), 0], [np.sin(x), np.cos(x), 0], [0, 0, 1]])
    about_y = np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]])
    about_z = np.array([[1, 0, 0], [0, np.cos(z), -np.sin(z)], [0, np.sin(z), np.cos(z)]])
    matrix = about_x @ about_y @ about_z
    middle = np.full(3, (n - 1) / 2)
    return matrix, middle - matrix @ middle


def _motion(generator: np.random.Generator, shape: tuple[int, ...]) -> tuple[Array, Array]:
    """A small rotation about the centre and a small shift."""
    a, b, c = generator.normal(0, 0.01, 3)
    matrix = np.array([[1, -c, b], [c, 1, -a], [-b, a, 1]])
    middle = (np.asarray(shape) - 1) / 2
    return matrix, middle - matrix @ middle + generator.normal(0, 0.5, 3)


def _torch() -> Any:
    return importlib.import_module("torch")


def _tensor(data: Array) -> Any:
    return _torch().from_numpy(data)[None, None]


def _torch_zoom(data: Array) -> dict[str, Peer]:
    if not _has("torch"):
        return {}
    interpolate, tensor = importlib.import_module("torch.nn.functional").interpolate, _tensor(data)
    return {"torch": Peer(lambda: interpolate(tensor, scale_factor=2, mode="trilinear", align_corners=True).numpy()[0, 0])}


def _torch_affine(data: Array, matrix: Array, offset: Array) -> dict[str, Peer]:
    """A cube on a rotated grid."""
    if not _has("torch"):
        return {}
    sample, tensor = importlib.import_module("torch.nn.functional").grid_sample, _tensor(data)
    grid = peers.torch_grid(matrix, offset, len(data))
    return {"torch": Peer(lambda: sample(tensor, grid(), align_corners=True).numpy()[0, 0])}


def _itk_affine(data: Array, table: Array, shape: tuple[int, ...], order: int) -> dict[str, Peer]:
    if not _has("SimpleITK"):
        return {}
    itk = importlib.import_module("SimpleITK")
    image, interpolator = itk.GetImageFromArray(data), itk.sitkBSpline3 if order == 3 else itk.sitkLinear
    return {"SimpleITK": Peer(lambda: peers.itk_resampled(image, shape[::-1], table, interpolator))}


def _difference(ours: Array, theirs: Array) -> float:
    """The maximum difference relative to the range; infinite for different shapes."""
    if ours.shape != theirs.shape:
        return float("inf")
    return float(np.abs(ours - theirs).max() / np.ptp(ours))


def _inside(ours: Array, theirs: Array) -> float:
    """Where boundary rules no longer matter."""
    edge = min(32, len(ours) // 3)
    inner = (slice(edge, -edge),) * ours.ndim
    return _difference(ours[inner], theirs[inner])


if __name__ == "__main__":
    main()
