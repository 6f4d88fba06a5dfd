"""All that is to be known of clvol on a GPU, in minutes and one table: whether results are right, and what cubic ones cost.

    python -m bench.gpu [--quick] [--only-parity] [--output FILE.json]

Needs the checkout and pyopencl, no compiler and no vendor's library but the driver. Without a GPU it says so and takes the
default device, with smaller pictures. Columns: the filters beside the reference (`bench.parity`), their greatest and RMS error and
what is tolerated, for the one that comes nearest to it; then medians of runs that alternate, with the cubic B-spline and
trilinear, each route by itself. Points: a million at random. After the table, `bench` without its peers, if there is time.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from bench import scene
from bench.cases import camera
from bench.machine import describe
from bench.parity import ROUTES, Row, planned, rows
from clvol.base.errors import ClvolError
from clvol.device import Device, devices
from clvol.march.renderer import Renderer
from clvol.scene.transfer import TransferFunction
from clvol.volume.volume import Volume
from tests.march.looks import suited

_NVIDIA = "libnvidia-opencl.so.1"
_VENDORS = Path("/etc/OpenCL/vendors")
_MINUTES = 8.0
_AIM = 1.5  # cubic : trilinear
_ROUNDS = 5
_PATIENCE = 2.0  # seconds: what takes longer is not repeated
_FILTERS = "bspline3", "linear"
_RAMP = TransferFunction.ramp((0.0, 2300.0))
_SURFACES = (700.0, "tan", 0.3), (scene.BONE, "white", 1.0)


@contextlib.contextmanager
def nvidia_announced() -> Iterator[None]:
    """Containers are given NVIDIA's driver without the file that tells OpenCL's loader of it."""
    try:
        ctypes.CDLL(_NVIDIA)
        found = [file.read_text(encoding="utf-8") for file in _VENDORS.glob("*.icd")]
    except OSError:
        found = [_NVIDIA]
    if os.environ.get("OCL_ICD_VENDORS") or any("nvidia" in text for text in found):
        yield
        return
    with tempfile.TemporaryDirectory() as folder:
        for i, text in enumerate([_NVIDIA, *found]):
            Path(folder, f"{i}.icd").write_text(text, encoding="utf-8")
        os.environ["OCL_ICD_VENDORS"] = folder
        yield


class Times:
    """Milliseconds of the cubic B-spline and of trilinear interpolation, on one volume."""

    def __init__(self, device: Device, *, quick: bool) -> None:
        self._side, self._count = (64, 1 << 16) if quick else (256, 1 << 20)
        self._size = (128, 128) if quick else (512, 512)
        volume = Volume(scene.head(self._side, device))
        self._renderers = [Renderer(volume, name, device=device) for name in _FILTERS]
        self._at = volume.index_to_world(np.random.default_rng(0).uniform(2, self._side - 3, (self._count, 3)))
        self._device = device
        self.what = f"{self._size[0]}² of {self._side}³, {self._count:,} points"

    def of(self, route: str, work: str) -> tuple[float, ...] | str:
        """Both; the reason if one of them fails."""
        with self._device.limited(**ROUTES[route]):
            try:
                taken: list[list[float]] = [[], []]
                for turn in range(_ROUNDS + 1):
                    for renderer, seconds in zip(self._renderers, taken, strict=True):
                        begun = time.perf_counter()
                        self._work(renderer, work)
                        seconds += [time.perf_counter() - begun] if turn else []  # the first builds kernels
                    if sum(map(sum, taken)) > _PATIENCE:
                        break
            except ClvolError as error:
                return str(error)
        return tuple(1e3 * statistics.median(seconds) for seconds in taken)

    def _work(self, renderer: Renderer, work: str) -> None:
        field = renderer.field
        points: dict[str, Callable[[Any], object]] = {"value": field, "gradient": field.gradient, "curvature": field.hessian}
        if work in points:
            points[work](self._at)
            return
        look: dict[str, Any] = {"isovalue": scene.BONE, "surfaces": _SURFACES, "transfer": _RAMP, "rays": 1}
        if work == "composite":
            look["transfer"] = scene.TRANSLUCENT
        if work == "minip":
            del look["transfer"]  # its own, which shows what is low
        renderer.render(camera(), work, self._size, **suited(work, look))


def table_of(measured: list[tuple[Row, tuple[float, ...]]], what: str) -> Table:
    table = Table("route", "work", "filters", "max", "RMS", "tolerance", "of", "cubic", "trilinear", "ratio", box=None, title=what)
    for row, times in measured:
        ratio = ""
        if times:
            ratio = f"[{'green' if times[0] <= _AIM * times[1] else 'yellow'}]{times[0] / times[1]:.2f}[/]"
        counted = f"{row.count}" if not row.failed else f"[red]{row.count - len(row.failed)} of {row.count}[/]"
        errors = (f"{value:.1e}" for value in (row.most, row.rms, row.tolerance))
        table.add_row(row.route, row.work, counted, *errors, row.worst, *([f"{t:.2f} ms" for t in times] or ["", ""]), ratio)
    return table


def main() -> None:
    """Compare, measure, and print; the exit status is 1 if a result is wrong."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--quick", action="store_true", help="smaller work: the default without a GPU")
    arguments.add_argument("--only-parity", action="store_true", help="no times, and no `bench`")
    arguments.add_argument("--output", type=Path, help="write the rows as JSON, with the machine")
    options = arguments.parse_args()
    console, begun = Console(width=150), time.monotonic()
    with nvidia_announced():
        found = devices()
        if not found:
            sys.exit("no OpenCL device was found: 'clvol doctor' says why")
        device = next((one for one in found if one.kind == "gpu" and not one.is_llvmpipe), found[0])
        gpu = device.kind == "gpu" and not device.is_llvmpipe
        quick = options.quick or not gpu
        version = str(device.handle.version).strip()
        console.print(f"{device.name}, {version}, driver {device.handle.driver_version}, sampler of {device.sampler_bits:.1f} bits")
        if not gpu:
            console.print("[yellow]No GPU was found: this is the default device, and the work smaller[/yellow]")
        times = None if options.only_parity else Times(device, quick=quick)

        def told(what: str) -> None:
            console.print(f"[dim]{time.monotonic() - begun:4.0f} s  {what}[/dim]")

        taken: dict[tuple[str, str], tuple[float, ...] | str] = {}
        for route, work in planned(device) if times else ():
            assert times is not None
            taken[route, work] = times.of(route, work)
            told(f"{route}: {work}, measured")
        if device.is_pocl and device.handle.driver_version.startswith("3."):
            # to optimise hundreds of kernels that run once takes longest, and changes no bit; newer ones make wrong kernels then
            os.environ.setdefault("POCL_EXTRA_BUILD_FLAGS", "-cl-opt-disable")
        measured = []
        for row in rows(device):
            ms = taken.get((row.route, row.work), ())
            row.failed += [f"not measured: {ms}"] if isinstance(ms, str) else []
            measured.append((row, () if isinstance(ms, str) else ms))
            told(f"{row.route}: {row.work}, compared")
        console.print(table_of(measured, times.what if times else ""))
        wrong = [f"{row.route}, {row.work}: {why}" for row, _ in measured for why in row.failed]
        for line in wrong:
            console.print(f"[red]{line}[/red]", markup=True, highlight=False)
        if options.output:
            records = [{**asdict(row), "milliseconds": dict(zip(_FILTERS, ms, strict=False))} for row, ms in measured]
            report = {"machine": describe(device), "quick": quick, "rows": records}
            options.output.write_text(json.dumps(report, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        left = 60 * _MINUTES - (time.monotonic() - begun)
        if times and (left > 60 or not gpu):
            command = [sys.executable, "-m", "bench", "--alone", "--no-huge", *(["--quick"] if quick else [])]
            os.environ.pop("POCL_EXTRA_BUILD_FLAGS", None)
            with contextlib.suppress(subprocess.TimeoutExpired):  # what it measured by then is printed
                subprocess.run(command, check=False, timeout=left if gpu else None, env={**os.environ, "CLVOL_DEVICE": device.name})
        console.print(f"{(time.monotonic() - begun) / 60:.1f} minutes; {len(wrong)} wrong")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
