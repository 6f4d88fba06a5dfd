"""`clvol.ndimage` beside SciPy from one sample on: ratios of times by function, size, order and mode.

    python -m bench.small [--quick] [--only WORD] [--markdown] [--small {scipy,opencl}]

A ratio is SciPy's time by clvol's: below 1 clvol is slower. Calls alternate in short batches, and the median of the batches' ratios
counts, so that a busy machine lengthens both. The table has the lowest ratio of all modes and orders for each function and size,
and names them. `--small opencl` measures what the same calls take on the device.
"""

from __future__ import annotations

import argparse
import itertools
import statistics
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy import ndimage as scipy_ndimage

from clvol import ndimage
from clvol.ndimage.arguments import MODES

__all__ = ["Cell", "cells", "ratio"]

Array = NDArray[Any]
Call = Callable[[Any], Any]  # of `clvol.ndimage` or `scipy.ndimage`

SIDES = {1: (1, 4, 16, 64, 256, 512), 2: (1, 4, 16, 64, 128, 256), 3: (1, 4, 8, 16, 24, 32)}
"""Samples along each axis, by the number of axes."""
_LARGE = 1 << 12  # samples from which not every order and mode is measured
_BATCH = 1e-3  # seconds that a batch of SciPy's calls takes, at least
_TOLERATED = 0.9


class Cell(NamedTuple):
    """A call of one function: the array's axes and samples along each, the order, the mode."""

    function: str
    ndim: int
    side: int
    order: int
    mode: str

    def call(self) -> Call:
        """The call, of either module."""
        rng = np.random.default_rng(self.side)
        data = rng.standard_normal((self.side,) * self.ndim)
        options: dict[str, Any] = {"order": self.order, "mode": self.mode}
        at: dict[str, tuple[Any, ...]] = {
            "map_coordinates": (rng.uniform(0, self.side - 1, (self.ndim, *data.shape)),),
            "one point": (rng.uniform(0, self.side - 1, (self.ndim, 1)),),
            "affine_transform": (np.eye(self.ndim) * 0.97 + 0.01, 0.1),
            "shift": (0.3,),
            "zoom": (1.5,),
            "rotate": (10.0,),
            "geometric_transform": (lambda index: tuple(0.9 * i for i in index),),
        }
        name = {"one point": "map_coordinates"}.get(self.function, self.function)
        return lambda module: getattr(module, name)(data, *at.get(self.function, ()), **options)


_FUNCTIONS = (
    "spline_filter1d",
    "spline_filter",
    "map_coordinates",
    "one point",
    "affine_transform",
    "shift",
    "zoom",
    "rotate",
    "geometric_transform",
)


def cells(*, quick: bool) -> Iterator[Cell]:
    """All calls, those of one function and size together."""
    for function, ndim in itertools.product(_FUNCTIONS, SIDES):
        for side in SIDES[ndim][: 3 if quick else None]:
            large = side**ndim >= _LARGE
            orders = (1, 3) if quick else (1, 3) if large else range(6)
            modes = ("mirror", "reflect") if quick else ("mirror", "constant") if large else MODES
            for order, mode in itertools.product(orders, modes):
                if order >= (function == "spline_filter") * 2 and ndim >= (function == "rotate") * 2:
                    yield Cell(function, ndim, side, order, mode)


def ratio(call: Call, small: str, batches: int) -> tuple[float, float, float]:
    """SciPy's time by clvol's, and the seconds that a call of each takes."""
    ours = partial(call, ndimage if small == "scipy" else _OnDevice())
    theirs = partial(call, scipy_ndimage)
    ours(), theirs()
    start = time.perf_counter()
    theirs()
    ours()
    count = max(1, round(_BATCH / (time.perf_counter() - start)))
    pairs = [(_seconds(theirs, count), _seconds(ours, count)) for _ in range(batches)]
    return (
        statistics.median(them / us for them, us in pairs),
        statistics.median(them for them, _ in pairs),
        statistics.median(us for _, us in pairs),
    )


class _OnDevice:
    """`clvol.ndimage` without SciPy."""

    def __getattr__(self, name: str) -> Call:
        return partial(getattr(ndimage, name), small="opencl")


def _seconds(call: Callable[[], Any], count: int) -> float:
    start = time.perf_counter()
    for _ in range(count):
        call()
    return (time.perf_counter() - start) / count


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--quick", action="store_true", help="smaller work: a check that all of it runs")
    arguments.add_argument("--only", default="", metavar="WORD", help="only functions whose name holds this")
    arguments.add_argument("--markdown", action="store_true", help="print the table in Markdown")
    arguments.add_argument("--small", choices=("scipy", "opencl"), default="scipy", help="what computes small calls")
    options = arguments.parse_args()
    batches = 3 if options.quick else 9
    worst: dict[tuple[str, int, int], tuple[float, float, float, Cell]] = {}
    below = 0
    for cell in cells(quick=options.quick):
        if options.only in cell.function:
            found = ratio(cell.call(), options.small, batches)
            if found[0] < _TOLERATED:  # once more: another program may have interfered
                found = max(found, ratio(cell.call(), options.small, 3 * batches))
            below += found[0] < _TOLERATED
            key = cell[:3]
            worst[key] = min(worst.get(key, (np.inf, 0.0, 0.0, cell)), (*found, cell))
    _print(worst, markdown=options.markdown)
    print(f"{below} calls below {_TOLERATED}; the lowest: {min(worst.values())}")


def _print(worst: dict[tuple[str, int, int], tuple[float, float, float, Cell]], *, markdown: bool) -> None:
    """The lowest ratio of each function and size."""
    rows = [
        (
            function,
            f"{side}{'' if ndim == 1 else '²³'[ndim - 2]}",
            f"{low:.2f}",
            f"{1e6 * theirs:.0f}",
            f"{1e6 * ours:.0f}",
            f"{cell.order} {cell.mode}",
        )
        for (function, ndim, side), (low, theirs, ours, cell) in worst.items()
    ]
    head = ("function", "samples", "lowest ratio", "SciPy, µs", "clvol, µs", "order, mode")
    if markdown:
        print("\n".join("| " + " | ".join(row) + " |" for row in (head, ("---",) * len(head), *rows)))
        return
    table = Table(*head)
    for row in rows:
        table.add_row(*row)
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
