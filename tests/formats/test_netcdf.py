"""netCDF-3 written by SciPy and by xarray, and HDF5 and netCDF found by their signatures."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from scipy.io import netcdf_file

import clvol
from clvol import formats
from clvol.base.errors import DataError, FormatError, GeometryError

DATA = np.arange(3 * 4 * 5 * 6).reshape(3, 4, 5, 6)


def written(path: Path, dtype: str = "i2", *, records: bool = False, version: int = 1) -> Path:
    """Times of a volume, and an image beside it, whose records are interleaved if time is unlimited."""
    with netcdf_file(path, "w", version=version) as file:
        for name, n in zip(("time", "z", "lat", "lon"), DATA.shape, strict=True):
            file.createDimension(name, None if records and name == "time" else n)
        for name, values, unit in (("z", (0, 2, 4, 6), "mm"), ("lat", (9, 8, 7, 6, 5), "mm"), ("lon", np.arange(6) / 2 + 3, "mm")):
            line = file.createVariable(name, "f8", (name,))
            line[:] = values
            line.units = unit
        odd = file.createVariable("odd", "b", ("time", "lat", "lon"))
        odd[:] = DATA[:, 0].astype("i1")
        heat = file.createVariable("heat", dtype, ("time", "z", "lat", "lon"))
        heat[:] = DATA.astype(dtype)
        heat.scale_factor, heat.add_offset, heat._FillValue = 0.5, 3.0, np.array(7, dtype)
        file.createVariable("label", "c", ("lon",))[:] = b"abcdef"
    return path


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("records", [False, True], ids=["fixed", "records"])
@pytest.mark.parametrize("dtype", ["i2", "f4"])
def test_equals_xarray(tmp_path: Path, dtype: str, records: bool, version: int) -> None:
    """Values, missing ones and coordinates are those that xarray finds."""
    xarray = pytest.importorskip("xarray")
    path = written(tmp_path / "v.nc", dtype, records=records, version=version)
    with xarray.open_dataset(path, engine="scipy") as truth:
        heat = truth.heat.values
        volumes = clvol.read_all(path, series="heat")
        np.testing.assert_array_equal(volumes, heat)
        lazy = clvol.open(path, series="heat", time=1)
        np.testing.assert_array_equal(lazy.read((0, 0, 0), (6, 5, 4)), heat[1])
        np.testing.assert_array_equal(clvol.read(path, series="odd", time=2).data, truth.odd.values[2])
    grid = volumes.grid
    assert (volumes.axes, grid.spacing, grid.origin, grid.units, grid.name) == (("time",), (0.5, 1, 2), (3, 9, 0), "mm", "heat")
    assert np.diag(grid.direction).tolist() == [1, -1, 1]
    assert {one.id for one in formats.series_of(path)} == {"heat", "odd"}


def test_uneven_coordinates_are_unknown(tmp_path: Path) -> None:
    with netcdf_file(tmp_path / "v.nc", "w") as file:
        for name, n in (("z", 3), ("y", 4), ("x", 5)):
            file.createDimension(name, n)
        file.createVariable("z", "f8", ("z",))[:] = (0, 1, 3)
        file.createVariable("v", "f4", ("z", "y", "x"))[:] = DATA[0, :3, :4, :5]
    with pytest.raises(GeometryError):
        clvol.read(tmp_path / "v.nc")
    np.testing.assert_array_equal(clvol.read(tmp_path / "v.nc", spacing=(1, 1, 2)).data, DATA[0, :3, :4, :5])


def test_damaged_files_raise(tmp_path: Path) -> None:
    whole = written(tmp_path / "v.nc").read_bytes()
    for name, content in (
        ("cut", whole[:-900]),
        ("head", whole[:50]),
        ("five", b"CDF\5" + whole[4:]),
        ("zeros", b"CDF\1" + bytes(99)),
    ):
        (tmp_path / f"{name}.nc").write_bytes(content)
        with pytest.raises((FormatError, DataError)):
            clvol.read(tmp_path / f"{name}.nc", series="heat")
    with pytest.raises(FormatError, match=r"CDF-1, CDF-2.*nccopy"):
        clvol.read(tmp_path / "five.nc")


@pytest.mark.parametrize("name", ["v.mat", "v", "v.h5.bak", "v.dcm"])
@pytest.mark.parametrize("userblock", [0, 1024])
def test_hdf5_under_any_name(tmp_path: Path, name: str, userblock: int) -> None:
    """By its signature, which may follow a block of the user's, as in files of MATLAB."""
    h5py = pytest.importorskip("h5py")
    stream = io.BytesIO()
    with h5py.File(stream, "w", userblock_size=userblock) as file:
        file["a"] = DATA[0]
    (tmp_path / name).write_bytes(stream.getvalue())
    np.testing.assert_array_equal(clvol.read(tmp_path / name).data, DATA[0])


@pytest.mark.parametrize("name", ["v.h5", "v", "v.cdf"])
def test_netcdf_3_under_any_name(tmp_path: Path, name: str) -> None:
    written(tmp_path / "v.nc").rename(tmp_path / name)
    assert clvol.read(tmp_path / name, series="odd", time=0).shape == (5, 6)
