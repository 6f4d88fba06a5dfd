"""Functions that are known, resampled by clvol and others: errors beside speed.

    python -m bench.truth [--quick] [--markdown]

Arrays of float32 are turned, and magnified 1.7 times with the outer samples in place, from array to array, with cubic
splines where a program has them. Processor time, of all of its threads, for each sample of the result: programs alternate,
and medians count. Errors are RMS against the function itself, as shares of its range, at least eight samples from the edges, where
the programs' rules differ. "calling thread" is the share of the processor time that the thread which called took: all of it where a
program has one.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

import clvol
from bench import peers
from bench.peers import Grid
from clvol import ndimage

__all__ = ["Found", "works"]

Array = NDArray[np.float64]
Function = Callable[[Array], Array]  # of positions of shape (axes, ...) in samples

_FACTOR = 1.7
_EDGE = 8
_REPEATS = 5
_DEGREES = 4, 7, 10


class Found(NamedTuple):
    """Of one program: nanoseconds of processors for a sample, the calling thread's share of them, errors by functions' names."""

    nanoseconds: float
    calling: float
    errors: dict[str, float]


def marschner_lobb(at: Array, n: int) -> Array:
    """The test signal on [-1, 1]³, with the waves that n samples along each axis just hold, as 41 do those that are usual."""
    return clvol.phantoms.marschner_lobb_function(np.moveaxis(2 * at[::-1] / (n - 1) - 1, 0, -1), f_m=6 * (n - 1) / 40)


def zone_plate(at: Array, n: int) -> Array:
    """Rings of up to 0.25 cycles a sample half way along the edges."""
    squares = ((at - (n - 1) / 2) ** 2).sum(0)
    return np.asarray(0.5 + 0.5 * np.cos(np.pi * 0.5 * squares / n))


def waves(at: Array, n: int) -> Array:  # noqa: ARG001
    """Plane waves of random directions, of up to 0.25 cycles a sample."""
    rng = np.random.default_rng(5)
    axes = len(at)
    total = np.zeros(at.shape[1:])
    for _ in range(24):
        direction = rng.standard_normal(axes)
        frequency = 0.25 * rng.uniform() ** (1 / axes) * direction / np.linalg.norm(direction)
        total += np.cos(2 * np.pi * np.tensordot(frequency, at, 1) + rng.uniform(0, 2 * np.pi))
    return total


def works(*, quick: bool) -> Iterator[tuple[str, Grid, dict[str, Function]]]:
    """What is done, to what kind of array, and the functions that are sampled."""
    for axes, n, functions in (
        (3, 24 if quick else 96, {"Marschner–Lobb": marschner_lobb, "waves": waves}),
        (2, 96 if quick else 1024, {"zone plate": zone_plate, "waves": waves}),
    ):
        matrix = Rotation.from_euler("xyz", _DEGREES, degrees=True).as_matrix()
        if axes == 2:
            matrix = Rotation.from_euler("z", 30, degrees=True).as_matrix()[:2, :2]
        middle = np.full(axes, (n - 1) / 2)
        m = round(_FACTOR * n)
        data, size = np.zeros((n,) * axes, np.float32), f"{n}{'²³'[axes - 2]}"
        bound: dict[str, Function] = {name: partial(function, n=n) for name, function in functions.items()}
        yield f"turned, {size}", Grid(data, matrix, middle - matrix @ middle, n), bound
        yield f"× {_FACTOR}, {size}", Grid(data, np.eye(axes) * (n - 1) / (m - 1), np.zeros(axes), m), bound


def measure(work: Grid, functions: dict[str, Function]) -> dict[str, Found]:
    """Every program's speed and errors."""
    axes, n = work.data.ndim, len(work.data)
    places = np.tensordot(work.matrix, np.indices((work.m,) * axes), 1) + work.offset.reshape(-1, *(1,) * axes)
    inside = ((places >= _EDGE) & (places <= n - 1 - _EDGE)).all(0)
    runs: dict[str, Callable[[], Any]] = {
        "clvol": partial(_ours, work),
        **{name: peer.run for name, peer in peers.of("grid", work).items()},
    }
    errors: dict[str, dict[str, float]] = {name: {} for name in runs}
    for function, of in functions.items():
        work.data[...] = of(np.indices(work.data.shape).astype(float))
        truth = of(places[:, inside])
        for name, run in runs.items():
            errors[name][function] = float(np.sqrt(np.mean((run()[inside] - truth) ** 2)) / np.ptp(truth))
    taken: dict[str, list[tuple[float, float]]] = {name: [] for name in runs}
    for _ in range(_REPEATS):
        for name, run in runs.items():
            begun = time.process_time(), time.thread_time()
            run()
            taken[name].append((time.process_time() - begun[0], time.thread_time() - begun[1]))
    medians = {name: [statistics.median(times) for times in zip(*each, strict=True)] for name, each in taken.items()}
    return {name: Found(1e9 * every / work.m**axes, one / every, errors[name]) for name, (every, one) in medians.items()}


def _ours(work: Grid) -> Any:
    if np.count_nonzero(work.matrix) == len(work.matrix):
        return ndimage.zoom(work.data, work.m / len(work.data), mode="mirror")
    return ndimage.affine_transform(work.data, work.matrix, work.offset, mode="mirror")


def main() -> None:
    """Measure, and print a table."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--quick", action="store_true", help="smaller work: a check that all of it runs")
    arguments.add_argument("--markdown", action="store_true", help="print the table in Markdown")
    options = arguments.parse_args()
    console = Console(width=130, stderr=options.markdown)
    for name in ("splineops", "torch"):
        if name in peers.missing():
            console.print(f"[yellow]without {name}: {peers.missing()[name]}[/yellow]")
    head = ("work", "by", "calling thread", "CPU ns a sample", "clvol's speed by its", "RMS errors")
    rows = []
    for what, work, functions in works(quick=options.quick):
        found = measure(work, functions)
        for name, one in found.items():
            errors = ", ".join(f"{function} {error:.2g}" for function, error in one.errors.items())
            ratio = one.nanoseconds / found["clvol"].nanoseconds
            rows.append((what, name, f"{one.calling:.0%}", f"{one.nanoseconds:.3g}", f"{ratio:.2g} ×", errors))
    if options.markdown:
        print("\n".join("| " + " | ".join(row) + " |" for row in (head, ("---",) * len(head), *rows)))
        return
    table = Table(*head, box=None)
    for row in rows:
        table.add_row(*row)
    console.print(table)


if __name__ == "__main__":
    main()
