"""One volume, many processes: OpenCL works in spawned processes, not in those forked after it was used.

Volumes, cameras, transfer functions and fields can be pickled; a field recomputes its coefficients in the process that gets it,
so each process should get it once, as the workers' initializer does here.

python examples/in_processes.py --with multiprocessing
python examples/in_processes.py --with concurrent.futures
python examples/in_processes.py --with joblib
python examples/in_processes.py --with torch
"""

from __future__ import annotations

import argparse
import hashlib
import multiprocessing
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np

import clvol
from clvol.phantoms import marschner_lobb

_field: clvol.Field | None = None  # set in each worker


def keep(field: clvol.Field) -> None:
    """A worker's initializer: keep the field, whose coefficients were computed when it was unpickled."""
    global _field
    _field = field


def picture_of(azimuth: float) -> str:
    """A picture from one side, as a short text."""
    assert _field is not None
    return letters(clvol.render(_field, clvol.Camera.orbit(azimuth), "mip", size=(48, 48)))


def picture_with(field: clvol.Field, azimuth: float) -> str:
    """The same with the field sent with every task: joblib pickles it each time."""
    with field:
        return letters(clvol.render(field, clvol.Camera.orbit(azimuth), "mip", size=(48, 48)))


def letters(picture: Any) -> str:
    return hashlib.sha256(np.ascontiguousarray(picture).tobytes()).hexdigest()[:12]


class Views:
    """A PyTorch data set: each worker of a DataLoader gets a copy, and creates the field at the first item."""

    def __init__(self, volume: clvol.Volume, azimuths: Iterable[float]) -> None:
        self.volume, self.azimuths = volume, tuple(azimuths)

    def __len__(self) -> int:
        return len(self.azimuths)

    def __getitem__(self, i: int) -> str:
        if _field is None:
            keep(clvol.Field(self.volume))
        return picture_of(self.azimuths[i])


def drawn(way: str, volume: clvol.Volume, azimuths: list[float], workers: int) -> list[str]:
    """Pictures by workers of one kind."""
    field, spawn = clvol.Field(volume), multiprocessing.get_context("spawn")  # "forkserver" does as well
    if way == "multiprocessing":
        with spawn.Pool(workers, keep, (field,)) as pool:
            return pool.map(picture_of, azimuths)
    if way == "concurrent.futures":
        with ProcessPoolExecutor(workers, spawn, keep, (field,)) as executor:
            return list(executor.map(picture_of, azimuths))
    if way == "joblib":
        joblib = installed("joblib")
        return list(joblib.Parallel(workers)(joblib.delayed(picture_with)(field, azimuth) for azimuth in azimuths))  # by loky
    installed("torch")
    from torch.utils.data import DataLoader

    loader: Any = DataLoader(Views(volume, azimuths), batch_size=None, num_workers=workers, multiprocessing_context="spawn")
    return list(loader)


def installed(name: str) -> Any:
    try:
        return __import__(name)
    except ImportError:
        raise SystemExit(f"{name} is not installed: pip install {name}") from None


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--with", dest="way", choices=("multiprocessing", "concurrent.futures", "joblib", "torch"), required=True)
    options.add_argument("--workers", type=int, default=2)
    given = options.parse_args()
    volume, azimuths = marschner_lobb(24), [0.0, 45.0, 90.0]
    pictures = drawn(given.way, volume, azimuths, given.workers)
    with clvol.Field(volume) as field:
        keep(field)
        here = [picture_of(azimuth) for azimuth in azimuths]
    for azimuth, picture, own in zip(azimuths, pictures, here, strict=True):
        print(f"{azimuth:g}°: {picture}, {'the same as' if picture == own else 'other than'} in this process")


if __name__ == "__main__":
    main()
