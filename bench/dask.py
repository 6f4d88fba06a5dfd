"""`clvol.dask` beside dask-image and ome-zarr, on a local Zarr array larger than its chunks, with the disk's own rates.

    python -m bench.dask [--side N] [--dtype KIND] [--workers N] [--chunk N] [--repeats N] [--only PART]
                         [--library NAME] [--volume DIR] [--folder DIR] [--json FILE]

Prefilters a volume (`clvol.prefilter`; `dask_image.ndinterp.spline_filter`) and halves it (`clvol.resample`, cubic and by least
squares; `dask_image.ndinterp.affine_transform`, which takes no low-pass; ome-zarr's `resize`, linear after a Gaussian, of each
chunk for itself), from Zarr to Zarr, in worker processes with one thread each. Calls take turns (ours, theirs, ours, ...), after
one of each for a corner of the volume that is not counted; medians are compared. MB/s are those of the input's bytes. The volume
is made by a formula, a chunk at a time, and what is written is deleted, but for a `--volume`, which is taken again if it is there.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import clvol
from bench.pyramid import disk

__all__ = ["waves"]


def waves(block_info: Any = None) -> NDArray[Any]:
    """A chunk of the volume: waves of several lengths, in 0 to 4000."""
    where = block_info[None]
    z, y, x = (np.arange(low, high, dtype=np.float32) for low, high in where["array-location"])
    rays = np.sin(0.11 * z)[:, None, None] * np.sin(0.07 * y)[:, None] * np.sin(0.05 * x)
    fine = np.sin(0.9 * z)[:, None, None] + np.sin(1.1 * y)[:, None] + np.sin(1.3 * x)
    return np.asarray(2000 + 1500 * rays + 160 * fine).astype(where["dtype"])


def calls(source: Any, side: int, chunk: int) -> dict[str, dict[str, Callable[[], Any]]]:
    """The measured lazy arrays, by work and library."""
    half = (side // 2,) * 3
    floating = source.astype(np.float32)
    found: dict[str, dict[str, Callable[[], Any]]] = {
        "prefilter, cubic": {"clvol": partial(clvol.prefilter, source)},
        "halve, cubic": {"clvol": lambda: clvol.resample(source, half, boundary="nearest", dtype="same")},
        "halve, low-pass": {"clvol": lambda: clvol.resample(source, half, anti_aliasing="least-squares", dtype="same")},
        "copy": {"dask": lambda: source},
    }
    if find_spec("dask_image"):
        from dask_image import ndinterp

        found["prefilter, cubic"]["dask-image"] = lambda: ndinterp.spline_filter(floating, output=np.float32, mode="mirror")
        found["halve, cubic"]["dask-image"] = lambda: ndinterp.affine_transform(
            source, np.full(3, 2.0), np.full(3, 0.5), output_shape=half, output_chunks=(chunk,) * 3, order=3, mode="nearest"
        )
    if find_spec("ome_zarr"):
        from ome_zarr.dask_utils import resize

        low_pass = {"order": 1, "mode": "reflect", "anti_aliasing": True, "preserve_range": True}  # as in its pyramids
        found["halve, low-pass"]["ome-zarr"] = lambda: resize(source, half, **low_pass)
    return found


def make(volume: Path, side: int, chunk: int, dtype: str) -> None:
    """Write the volume."""
    import dask.array as da

    start = time.perf_counter()
    chunks = da.core.normalize_chunks(chunk, (side,) * 3)
    made = da.map_blocks(waves, chunks=chunks, dtype=dtype, meta=np.empty((0,) * 3, dtype))
    made.to_zarr(str(volume), compute=True)
    stored = sum(file.stat().st_size for file in volume.rglob("*") if file.is_file())
    print(f"made in {time.perf_counter() - start:.0f} s; {stored / 1e6:.0f} MB are stored", flush=True)


def peak() -> int:
    """The peak memory of this process, in bytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def measured(
    folder: Path, source: Any, side: int, chunk: int, repeats: int, only: str, library: str, client: Any
) -> Iterator[dict[str, Any]]:
    """A row per call: median seconds, and the peak memory of a worker so far."""
    corner = min(side, 2 * chunk)
    small = calls(source[:corner, :corner, :corner], corner, chunk)
    for name, all_of_them in calls(source, side, chunk).items():
        if only not in name:
            continue
        row = {one: call for one, call in all_of_them.items() if library in one}
        times: dict[str, list[float]] = {one: [] for one in row}
        peaks = dict.fromkeys(row, 0)
        for turn in range(repeats + 1):
            for one, call in row.items():
                start = time.perf_counter()
                (call if turn else small[name][one])().to_zarr(str(folder / "result.zarr"), compute=True, overwrite=True)
                if turn:
                    times[one].append(time.perf_counter() - start)
                    peaks[one] = max(client.run(peak).values())
                shutil.rmtree(folder / "result.zarr")
        for one, taken in times.items():
            yield {"work": name, "library": one, "seconds": statistics.median(taken), "peak": peaks[one]}


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--side", type=int, default=512, help="samples along each axis")
    options.add_argument("--dtype", default="uint16")
    options.add_argument("--workers", type=int, default=2)
    options.add_argument("--chunk", type=int, default=128)
    options.add_argument("--repeats", type=int, default=3)
    options.add_argument("--only", default="", help="part of the names of what is measured")
    options.add_argument("--library", default="", help="part of the names of those that are measured")
    options.add_argument("--volume", type=Path, help="where the volume is kept")
    options.add_argument("--folder", type=Path, help="where arrays are written; by default a temporary folder")
    options.add_argument("--json", type=Path, help="where rows are written too")
    given = options.parse_args()
    import dask.array as da
    import distributed

    folder = Path(tempfile.mkdtemp(dir=given.folder))
    cores = os.cpu_count() or 1
    threads = str(max(1, cores // given.workers))  # of a worker's OpenCL, so that all of them use each core once
    try:
        size = given.side**3 * np.dtype(given.dtype).itemsize
        rates = disk(folder, min(size, 4 << 30))
        title = f"{given.side}³ {given.dtype}, chunks of {given.chunk}³, {given.workers} workers, {cores} cores"
        print(f"{title}; the disk: writes {rates['write']:.0f} MB/s, reads {rates['read']:.0f} MB/s", flush=True)
        rows = []
        with (
            distributed.LocalCluster(
                n_workers=given.workers, threads_per_worker=1, dashboard_address=None, env={"POCL_MAX_PTHREAD_COUNT": threads}
            ) as cluster,
            distributed.Client(cluster) as client,
        ):
            volume = given.volume or folder / "volume.zarr"
            if not volume.exists():
                make(volume, given.side, given.chunk, given.dtype)
            source = da.from_zarr(str(volume))
            for row in measured(folder, source, given.side, given.chunk, given.repeats, given.only, given.library, client):
                rows.append(row | {"MB/s": size / row["seconds"] / 1e6})
                print(
                    f"{row['work']}, {row['library']}: {row['seconds']:.2f} s, {rows[-1]['MB/s']:.0f} MB/s, "
                    f"a worker has had {row['peak'] / 1e9:.2f} GB",
                    flush=True,
                )
        if given.json:
            given.json.write_text(json.dumps({"what": title, "disk": rates, "rows": rows}, indent=1) + "\n", encoding="utf-8")
    finally:
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
