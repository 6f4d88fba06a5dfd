"""Shared by the examples of docs/scipy.md: choice of module, timing, the maximum difference from SciPy; a phantom."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

import clvol

Array = NDArray[Any]
Results = dict[str, Array]
Work = Callable[[Any], Results]  # of a module with the functions of `scipy.ndimage`


def options_for(text: str | None, output: str) -> argparse.ArgumentParser:
    """A parser of ``--with`` and ``--output``."""
    parser = argparse.ArgumentParser(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--with", dest="module", choices=("clvol", "scipy"), default="clvol", help="whose ndimage computes")
    parser.add_argument("--output", default=output, help="the picture to write")
    return parser


def timed(module: str, work: Work) -> Results:
    """The results of `module`.ndimage; prints seconds and, for clvol, the maximum differences from SciPy."""
    theirs, their_seconds = _timed(work, "scipy")
    print(f"scipy.ndimage: {their_seconds:.3f} s")
    if module == "scipy":
        return theirs
    work(import_module("clvol.ndimage"))  # builds the kernels, once per installation
    results, seconds = _timed(work, module)
    print(f"clvol.ndimage: {seconds:.3f} s, {their_seconds / seconds:.1f} times as fast")
    for name, result in results.items():
        apart = np.abs(result.astype(np.float64) - theirs[name])
        if result.dtype.kind == "f":
            print(f"{name}: differ by at most {apart.max() / float(np.ptp(theirs[name])):.1e} of the range")
        else:
            print(f"{name}: differ by at most {apart.max():.0f}, in {np.count_nonzero(apart)} of {apart.size} samples")
    return results


def _timed(work: Work, module: str) -> tuple[Results, float]:
    """The minimum of three runs."""
    ndimage, times = import_module(f"{module}.ndimage"), []
    for _ in range(3):
        started = time.perf_counter()
        results = work(ndimage)
        times.append(time.perf_counter() - started)
    return results, min(times)


def save(panels: list[Array], output: str, times: int = 1) -> None:
    """Write pictures of one height side by side, values 0 to 1, each pixel repeated n times; print the file's name."""
    panels = [np.clip(panel, 0, 1).repeat(times, 0).repeat(times, 1) for panel in panels]
    gap = np.ones((panels[0].shape[0], 6, *panels[0].shape[2:]))
    try:
        print(clvol.save(np.concatenate([part for panel in panels for part in (panel, gap)][:-1], 1), output))
    except clvol.ClvolError as error:
        raise SystemExit(f"{type(error).__name__}: {error}") from None


def head(z: Array, y: Array, x: Array) -> Array:
    """A phantom of a head at positions in centimetres: scalp, skull, folded cortex, white matter, ventricles; 0 to 1."""

    def ellipsoid(a: float, b: float, c: float, edge: float = 0.12, at: tuple[float, float, float] = (0, 0, 0)) -> Array:
        radius = np.sqrt(((z - at[0]) / a) ** 2 + ((y - at[1]) / b) ** 2 + ((x - at[2]) / c) ** 2)
        return np.asarray(1 / (1 + np.exp(np.clip((radius - 1) * min(a, b, c) / edge * 4, -60, 60))))

    folds = np.sin(2.6 * x + 1.3 * np.sin(1.1 * y)) * np.sin(2.3 * y + 1.1 * np.sin(1.2 * z)) * np.cos(2.2 * z)
    depth = 1 - np.sqrt((z / 6.2) ** 2 + (y / 7.6) ** 2 + (x / 6.0) ** 2)
    white = 1 / (1 + np.exp(np.clip(-(depth - 0.15 + 0.16 * folds) * 60, -60, 60)))
    brain = ellipsoid(6.2, 7.6, 6.0)
    ventricles = ellipsoid(1.1, 2.4, 0.5, at=(0.6, 0, 0.8)) + ellipsoid(1.1, 2.4, 0.5, at=(0.6, 0, -0.8))
    scalp = ellipsoid(7.5, 9.0, 7.3) - ellipsoid(7.0, 8.5, 6.8)
    return np.asarray(0.75 * scalp + brain * (0.5 + 0.4 * white - 0.75 * np.minimum(1, ventricles)))
