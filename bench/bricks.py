"""Pictures of a stored volume by bricks within a memory budget, beside reading all of it; and bricks beside one piece.

    python -m bench.bricks [--size 1024] [--memory 2048] [--piece 512] [--folder DIR] [--json FILE]

The volume is uint16 from a formula, shells with bumps on background noise, written by `clvol.pyramid`. All rows are timed in
this run, after kernels are built: the first picture (the coarsest level), that of the level that suits the picture's size, and
that of the finest level, with the number of bricks read, and the time to read all samples once. The files were just written:
reads come from the system's cache as far as it reaches. An existing store in the folder is reused.
"""

from __future__ import annotations

import argparse
import json
import resource
import tempfile
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import clvol
from clvol.bricks.field import BrickedField

_CAMERA = clvol.Camera.orbit(30, 20, fit="volume")
_SIZE = 512, 512
_ISOVALUE = 30000.0
_VEIL = clvol.TransferFunction(((20000, (0.2, 0.3, 1)), (60000, (1, 0.8, 0.4))), ((24000, 0), (60000, 0.08)))
_VEILED: dict[str, Any] = {"transfer": _VEIL}


class Shells:
    """The volume, computed on read."""

    dtype = np.dtype(np.uint16)
    chunks = (64, 64, 64)

    def __init__(self, size: int) -> None:
        self.shape = (size, size, size)

    def __getitem__(self, index: Any) -> np.ndarray[Any, Any]:
        n = self.shape[0]
        z, y, x = np.ogrid[index]
        x, y, z = (((axis.astype(np.float32) + 0.5) / n) * 2 - 1 for axis in (x, y, z))
        r = np.sqrt(x * x + y * y + z * z)
        bumps = np.sin(21 * x) * np.sin(19 * y) * np.sin(23 * z)
        value = 55000 * np.exp(-(((r - 0.62 - 0.03 * bumps) / 0.05) ** 2)) + 40000 * np.exp(-(((r - 0.25) / 0.03) ** 2))
        noise = np.random.default_rng(zlib.crc32(str(index).encode())).integers(0, 900, value.shape)
        made: np.ndarray[Any, Any] = (value + noise).astype(np.uint16)
        return made


def timed(work: Any, *arguments: Any, **options: Any) -> tuple[float, Any]:
    start = time.perf_counter()
    result = work(*arguments, **options)
    return time.perf_counter() - start, result


def out_of_core(store: Path, memory: int) -> list[dict[str, Any]]:
    """Pictures of the store, each by a renderer that has read nothing yet."""
    rows = []
    for mode, options in (("isosurface", {"isovalue": _ISOVALUE}), ("composite", _VEILED)):
        for lod in (None, 1.0, 0.0):
            seconds, opened = timed(clvol.open, store, trusted=True)
            with BrickedField(opened, memory=memory) as field, clvol.Renderer(field) as renderer:
                if lod is None:  # the first that refine gives
                    some, picture = timed(next, renderer.refine(_CAMERA, mode, _SIZE, **options))
                else:
                    some, picture = timed(renderer.render, _CAMERA, mode, _SIZE, lod=lod, **options)
                used = [field, *renderer.levels]
                drawn = [one for one in used if one.reads.bricks]
                rows.append(
                    {
                        "picture": f"{mode}, {'first' if lod is None else 'lod 1' if lod else 'finest'}",
                        "seconds": seconds + some,
                        "bricks": sum(one.reads.bricks for one in drawn),
                        "of": sum(len(one.bricks) for one in drawn),
                        "samples": sum(one.reads.samples for one in used),
                        "on device MB": sum(one.nbytes for one in used) / 1e6,
                    }
                )
                picture.save(store.with_name(f"{mode}-{lod}.png"))
    return rows


def reading(store: Path) -> dict[str, Any]:
    """All samples once, brick by brick."""
    volume = clvol.open(store, trusted=True)
    nx, ny, nz = volume.size

    def read() -> int:
        return sum(
            volume.read((x, y, z), (min(x + 256, nx), min(y + 256, ny), min(z + 256, nz))).size
            for z in range(0, nz, 256)
            for y in range(0, ny, 256)
            for x in range(0, nx, 256)
        )

    seconds, count = timed(read)
    return {"picture": "reading all, no picture", "seconds": seconds, "samples": count, "MB/s": 2 * count / seconds / 1e6}


def in_pieces(size: int) -> list[dict[str, Any]]:
    """Coefficients and a picture from samples in memory: one brick, 2³ bricks and one piece, alternating; and a second picture."""
    volume = clvol.Volume(Shells(size)[:size, :size, :size])
    lazy = clvol.LazyVolume(volume.data, limits=volume.value_range, labels=False)
    kinds: dict[str, Callable[[], Any]] = {
        "one piece": lambda: clvol.Field(volume, "bspline3"),
        "one brick": lambda: BrickedField(lazy, "bspline3", memory=4 << 30),  # which it is by default, if it fits
        "bricks": lambda: BrickedField(lazy, "bspline3", memory=4 << 30, edge=max(8, size // 2)),
    }
    rows = []
    for mode, options in (("isosurface", {"isovalue": _ISOVALUE}), ("composite", _VEILED), ("mip", _VEILED)):
        first: dict[str, list[float]] = {name: [] for name in kinds}
        again: dict[str, list[float]] = {name: [] for name in kinds}
        for _ in range(4):
            for name, make in kinds.items():
                start = time.perf_counter()
                with make() as field, clvol.Renderer(field) as renderer:
                    renderer.render(_CAMERA, mode, _SIZE, **options)
                    first[name].append(time.perf_counter() - start)
                    again[name].append(timed(renderer.render, _CAMERA, mode, _SIZE, **options)[0])
        medians = {name: float(np.median(some[1:])) for name, some in first.items()}  # kernels are built in the first round
        later = {f"{name}, again": float(np.median(some)) for name, some in again.items()}
        ratios = {}
        for name in ("one brick", "bricks"):
            ratios[f"{name}, ratio"] = medians[name] / medians["one piece"]
            ratios[f"{name}, ratio again"] = later[f"{name}, again"] / later["one piece, again"]
        rows.append({"picture": f"{mode} of {size}³", **medians, **later, **ratios})
    return rows


def tell(row: dict[str, Any]) -> None:
    words = (f"{name} {value:.4g}" if isinstance(value, float) else f"{name} {value}" for name, value in row.items())
    print("  ".join(words), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=1024)
    parser.add_argument("--memory", type=int, default=2048, help="MiB for the bricks")
    parser.add_argument("--piece", type=int, default=512, help="samples along an edge of the volume that is drawn whole too")
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as own:
        folder = arguments.folder or Path(own)
        found: dict[str, Any] = {}
        if arguments.piece:
            found["pieces"] = in_pieces(arguments.piece)
            for row in found["pieces"]:
                tell(row)
        store = folder / f"shells-{arguments.size}.zarr"
        if not store.exists():
            seconds, _ = timed(clvol.pyramid, clvol.LazyVolume(Shells(arguments.size)), store, filter="bspline3")
            print(f"store written in {seconds:.0f} s", flush=True)
        small = folder / "warm.zarr"
        if not small.exists():
            clvol.pyramid(clvol.LazyVolume(Shells(96)), small, filter="bspline3")
        out_of_core(small, arguments.memory << 20)  # kernels are built
        found["pictures"] = [*out_of_core(store, arguments.memory << 20), reading(store)]
        for row in found["pictures"]:
            tell(row)
        found["peak MB"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
        print(f"peak of the process {found['peak MB']:.0f} MB")
        if arguments.json:
            arguments.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
