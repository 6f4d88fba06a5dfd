"""Third-party arrays: pictures and samples match those of the same samples in memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clvol
from clvol.bricks.field import BrickedField

z, y, x = np.ogrid[:38, :44, :52]
DATA = (2000 + 900 * np.sin(x / 4) * np.cos(y / 5) * np.sin(z / 6)).astype(np.uint16)
CHUNKS = (16, 44, 20)
AT = np.random.default_rng(1).uniform(2, 35, (300, 3))
GRID = (20, 20, 20)
LOOK: dict[str, Any] = {"camera": clvol.Camera.orbit(30, 20), "size": (20, 20), "rays": 1}


class Plain:
    """Only a shape, a dtype and slicing."""

    def __init__(self, data: Any) -> None:
        self.data, self.shape, self.dtype = data, data.shape, data.dtype

    def __getitem__(self, index: Any) -> Any:
        return self.data[index]


def mapped(path: Path, order: Any = "C", kind: str = "<u2") -> np.memmap[Any, Any]:
    made = np.memmap(path / "samples.raw", kind, "w+", shape=DATA.shape, order=order)
    made[...] = DATA
    made.flush()
    return np.memmap(path / "samples.raw", kind, "r", shape=DATA.shape, order=order)


def in_hdf5(path: Path, chunks: tuple[int, ...] | None) -> Any:
    h5py = pytest.importorskip("h5py")
    file = h5py.File(path / "samples.h5", "w")
    return file.create_dataset("samples", data=DATA, chunks=chunks, compression="gzip" if chunks else None)


def in_zarr(path: Path, version: Any) -> Any:
    zarr = pytest.importorskip("zarr")
    made = zarr.create_array(path / "samples.zarr", shape=DATA.shape, chunks=CHUNKS, dtype=DATA.dtype, zarr_format=version)
    made[...] = DATA
    return made


def in_dask(chunks: Any) -> Any:
    return pytest.importorskip("dask.array").from_array(DATA, chunks=chunks)


SOURCES: dict[str, Callable[[Path], Any]] = {
    "memmap": mapped,
    "big-endian memmap": lambda path: mapped(path, kind=">u2"),
    "Fortran's order": lambda path: mapped(path, order="F"),
    "HDF5, chunked": lambda path: in_hdf5(path, CHUNKS),
    "HDF5": lambda path: in_hdf5(path, None),
    "Zarr 2": lambda path: in_zarr(path, 2),
    "Zarr 3": lambda path: in_zarr(path, 3),
    "dask": lambda _: in_dask(CHUNKS),
    "dask, odd chunks": lambda _: in_dask(((5, 33), (44,), (1, 30, 21))),
    "anything": lambda _: Plain(DATA),
}


@pytest.fixture(params=SOURCES)
def source(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Any]:
    made = SOURCES[request.param](tmp_path)
    yield made
    if (file := getattr(made, "file", None)) is not None:
        file.close()


def of(source: Any) -> dict[str, Any]:
    """Results by bricks for an array."""
    with BrickedField(source, edge=16, memory=8 << 20) as field, clvol.Renderer(field) as renderer:
        pictures = {mode: renderer.render(mode=mode, **LOOK) for mode in ("isosurface", "composite")}
        return {"points": field(AT), "grid": field.resample(GRID).data, **pictures}


@cache
def truth() -> dict[str, Any]:
    return {
        **of(DATA),
        "whole picture": clvol.render(DATA, mode="mip", filter="linear", **LOOK),
        "whole grid": clvol.resample(DATA, GRID, filter="linear").data,
    }


def test_pictures_and_samples_match_those_in_memory(source: Any) -> None:
    expected = truth()
    for name, found in of(source).items():
        np.testing.assert_array_equal(found, expected[name], name)
    lazy = clvol.LazyVolume(source)
    others = [lazy] if isinstance(source, Plain) else [lazy, source]  # these become arrays too
    for one in others:
        np.testing.assert_array_equal(clvol.render(one, mode="mip", filter="linear", **LOOK), expected["whole picture"])
        found = clvol.resample(one, GRID, filter="linear")
        np.testing.assert_array_equal(np.asarray(getattr(found, "data", found)), expected["whole grid"])
