"""VTK's legacy files, written and read by VTK and PyVista."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import clvol
from clvol import formats
from clvol.base.errors import DataError, FormatError

pv = pytest.importorskip("pyvista")

RNG = np.random.default_rng(0)


def image() -> pv.ImageData:
    grid = pv.ImageData(dimensions=(6, 5, 4), spacing=(1, 2, 3), origin=(4, 5, 6))
    grid["heat"] = RNG.normal(size=120).astype("f4")
    grid["colour"] = RNG.integers(0, 256, (120, 3), np.uint8)
    grid["a flow"] = RNG.normal(size=(120, 3))
    grid.cell_data["count"] = RNG.integers(-9, 9, 60).astype("i2")
    grid.set_active_scalars("heat")
    return grid


@pytest.mark.parametrize("binary", [True, False], ids=["binary", "ascii"])
def test_equals_pyvista(tmp_path: Path, binary: bool) -> None:
    """Points and cells, scalars, colours and vectors; binary files are read in parts."""
    image().save(tmp_path / "v.vtk", binary=binary)
    truth = pv.read(tmp_path / "v.vtk")
    for name in ("heat", "count"):
        truth.set_active_scalars(name)
        expected, volume = clvol.Volume(truth), clvol.read(tmp_path / "v.vtk", series=name)
        np.testing.assert_array_equal(volume.data, expected.data)
        assert volume.data.dtype == expected.data.dtype
        assert (volume.spacing, volume.origin, volume.name) == (expected.spacing, expected.origin, name)
    for name, first in (("colour", "red"), ("a flow", "x")):
        volumes = clvol.read_all(tmp_path / "v.vtk", series=name)
        np.testing.assert_array_equal(volumes, np.moveaxis(truth[name].reshape(4, 5, 6, 3), -1, 0))
        assert volumes.names[0] == first
    assert {one.id for one in formats.series_of(tmp_path / "v.vtk")} == {"heat", "colour", "a flow", "count"}
    if binary:
        lazy = clvol.open(tmp_path / "v.vtk", series="heat")
        np.testing.assert_array_equal(lazy.read((1, 0, 2), (4, 5, 3)), truth["heat"].reshape(4, 5, 6)[2:3, 0:5, 1:4])


@pytest.mark.parametrize("dtype", ["i1", "u1", "i2", "u2", "i4", "u4", "i8", "f4", "f8"])
@pytest.mark.parametrize("binary", [True, False], ids=["binary", "ascii"])
def test_samples_of_every_type(tmp_path: Path, dtype: str, binary: bool) -> None:
    grid = pv.ImageData(dimensions=(3, 2, 2))
    limits = np.iinfo(dtype) if dtype[0] != "f" else np.finfo(np.float32)
    grid["v"] = np.array([limits.min, limits.max, *range(10)], dtype)
    grid.save(tmp_path / "v.vtk", binary=binary)
    expected = pv.read(tmp_path / "v.vtk")["v"].reshape(2, 2, 3)  # VTK rounds what it writes as text
    np.testing.assert_array_equal(clvol.read(tmp_path / "v.vtk").data, expected)


def test_by_hand(tmp_path: Path) -> None:
    """Other words in other cases, a table of colours, and no scalars but a field."""
    text = (
        "# vtk DataFile Version 2.0\nby hand\nascii\n\nDATASET structured_points\ndimensions 2 2 1\naspect_ratio .5 1 2\n"
        "ORIGIN 1e1 0 -1\nFIELD about 1\nTIME 1 1 double\n0.5\nPOINT_DATA 4\nSCALARS s%20t int 1\nlookup_table heat\n1 2\n3\n4\n"
        "LOOKUP_TABLE heat 2\n0 0 0 1\n1 1 1 1\nCOLOR_SCALARS c 3\n0 .5 1 0 0 0\n1 1 1 .25 .25 .25\n"
    )
    (tmp_path / "v.vtk").write_text(text)
    volume = clvol.read(tmp_path / "v.vtk")
    assert (volume.data.tolist(), volume.name) == ([[[1, 2], [3, 4]]], "s t")
    assert (volume.spacing, volume.origin) == ((0.5, 1, 2), (10, 0, -1))
    truth = pv.read(tmp_path / "v.vtk")
    colours = clvol.read_all(tmp_path / "v.vtk", series="c")
    np.testing.assert_array_equal(np.moveaxis(np.asarray(colours), 0, -1).reshape(4, 3), truth["c"])


@pytest.mark.parametrize("binary", [True, False], ids=["binary", "ascii"])
def test_damaged_files_raise(tmp_path: Path, binary: bool) -> None:
    """VTK reads a text that is cut short as if the rest were zeros."""
    grid = image()
    del grid.cell_data["count"], grid.point_data["colour"], grid.point_data["a flow"]
    grid.save(tmp_path / "v.vtk", binary=binary)
    whole = (tmp_path / "v.vtk").read_bytes()
    begin = whole.index(b"default\n") + 8
    for cut in (10, 60, begin, begin + 101, begin + 400):
        (tmp_path / "v.vtk").write_bytes(whole[:cut])
        with pytest.raises((FormatError, DataError)):
            clvol.read(tmp_path / "v.vtk")
    for old, new in ((b"DIMENSIONS 6 5 4", b"DIMENSIONS 6 5 9"), (b"POINT_DATA 120", b"POINT_DATA 119"), (b"float", b"string")):
        (tmp_path / "v.vtk").write_bytes(whole.replace(old, new))
        with pytest.raises(FormatError):
            clvol.read(tmp_path / "v.vtk")


@pytest.mark.parametrize("binary", [True, False], ids=["binary", "ascii"])
def test_strings_are_passed_over_and_bits_are_masks(tmp_path: Path, binary: bool) -> None:
    """Strings of each length of VTK's numbers before them, with line ends; the arrays around them are VTK's."""
    vtk = pytest.importorskip("vtk")
    grid, strings, bits = image(), vtk.vtkStringArray(), vtk.vtkBitArray()
    strings.SetName("note")
    for text in ("one\ntwo", "", "x" * 63, "y" * 64, "z" * 20000, "POINT_DATA 7\n", "caf\u00e9 %"):
        strings.InsertNextValue(text)
    grid.GetFieldData().AddArray(strings)
    names = vtk.vtkStringArray()
    names.SetName("names")
    bits.SetName("mask")
    for n in range(120):
        names.InsertNextValue(f"p {n}")
        bits.InsertNextValue(n % 7 % 3 == 0)
    for array in (names, bits):
        grid.GetPointData().AddArray(array)
    grid["after"] = np.arange(120, dtype="i2")
    writer = vtk.vtkDataSetWriter()
    writer.SetFileName(str(tmp_path / "v.vtk"))
    writer.SetInputData(grid)
    writer.SetFileType(2 if binary else 1)
    writer.Write()
    truth = pv.read(tmp_path / "v.vtk")  # of a text, with the digits it has
    for name in ("heat", "after"):
        np.testing.assert_array_equal(clvol.read(tmp_path / "v.vtk", series=name).data.ravel(), truth[name])
    mask = clvol.read(tmp_path / "v.vtk", series="mask").data
    np.testing.assert_array_equal(mask.ravel(), [bits.GetValue(n) for n in range(120)])
    if binary:
        cut = (tmp_path / "v.vtk").read_bytes()
        (tmp_path / "cut.vtk").write_bytes(cut[: cut.index(b"z" * 100) + 50])
        with pytest.raises(FormatError):
            clvol.read(tmp_path / "cut.vtk")


def test_meshes_are_rejected_with_a_route(tmp_path: Path) -> None:
    """The route that the message names works."""
    sphere = pv.Sphere()
    sphere.save(tmp_path / "v.vtk")
    with pytest.raises(DataError, match=r"is a DATASET POLYDATA: clvol\.Volume\(pyvista\.ImageData\(\.\.\.\)\.sample\("):
        clvol.read(tmp_path / "v.vtk")
    solid = pv.ImageData(dimensions=(9, 9, 9), spacing=(0.2,) * 3, origin=(-0.8,) * 3)
    solid["r"] = np.linalg.norm(solid.points, axis=1)
    solid.cast_to_unstructured_grid().save(tmp_path / "w.vtk")
    sampled = pv.ImageData(dimensions=(5, 5, 5), spacing=(0.1,) * 3).sample(pv.read(tmp_path / "w.vtk"))
    sampled.set_active_scalars("r")
    assert clvol.Volume(sampled).shape == (5, 5, 5)


@pytest.mark.parametrize("suffix", [".vtkhdf", ".hdf"])
def test_image_data_in_hdf5(tmp_path: Path, suffix: str) -> None:
    """With its geometry, which would be lost if it were any HDF5."""
    pytest.importorskip("h5py")
    vtkHDFWriter = getattr(pytest.importorskip("vtkmodules.vtkIOHDF"), "vtkHDFWriter", None)
    if vtkHDFWriter is None:
        pytest.skip("VTK before 9.4 writes no such files")

    grid = image()
    grid.direction_matrix = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    writer = vtkHDFWriter()
    writer.SetFileName(str(tmp_path / f"v{suffix}"))
    writer.SetInputData(grid)
    assert writer.Write()
    truth = pv.read(tmp_path / f"v{suffix}")
    for name, series in (("heat", "VTKHDF/PointData/heat"), ("count", "VTKHDF/CellData/count")):
        truth.set_active_scalars(name)
        expected, volume = clvol.Volume(truth), clvol.read(tmp_path / f"v{suffix}", series=series)
        np.testing.assert_array_equal(volume.data, expected.data)
        assert (volume.spacing, volume.name) == (expected.spacing, name)
        np.testing.assert_allclose(volume.origin, expected.origin)
        np.testing.assert_allclose(volume.direction, expected.direction)
    colours = clvol.read_all(tmp_path / f"v{suffix}", series="VTKHDF/PointData/colour")
    np.testing.assert_array_equal(colours, np.moveaxis(truth["colour"].reshape(4, 5, 6, 3), -1, 0))
