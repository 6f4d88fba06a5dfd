"""Image data written by VTK."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clvol
from clvol import ClvolWarning, formats
from clvol.base.errors import ClvolError, DataError, FormatError, MissingDependencyError

pytest.importorskip("vtkmodules")

from vtkmodules.util.numpy_support import numpy_to_vtk
from vtkmodules.vtkCommonDataModel import vtkImageData
from vtkmodules.vtkIOXML import vtkXMLImageDataWriter

DATA = np.arange(24, dtype=np.float32).reshape(2, 3, 4)
DIRECTION = (0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0)


def written(
    path: Path, *, mode: str = "Appended", compressor: str = "ZLib", active: str = "", encoded: bool = True, **arrays: np.ndarray
) -> Any:
    """An image of 4 × 3 × 2 points whose extent begins at 5, 0, 0; arrays of six values belong to cells."""
    image = vtkImageData()
    image.SetExtent(5, 8, 0, 2, 0, 1)
    image.SetSpacing(0.5, 2, 3)
    image.SetOrigin(10, 20, 30)
    image.SetDirectionMatrix(*DIRECTION)
    for name, values in arrays.items():
        of_cells = values.shape[0] == 6
        array = numpy_to_vtk(values if of_cells else values.reshape(24, -1), deep=True)
        array.SetName(name)
        (image.GetCellData() if of_cells else image.GetPointData()).AddArray(array)
    if active:
        image.GetPointData().SetActiveScalars(active)
    writer = vtkXMLImageDataWriter()
    getattr(writer, f"SetDataModeTo{mode}")()
    getattr(writer, f"SetCompressorTypeTo{compressor}")()
    writer.SetEncodeAppendedData(encoded)
    writer.SetFileName(str(path))
    writer.SetInputData(image)
    assert writer.Write()
    return image


@pytest.mark.parametrize("encoded", [True, False])
@pytest.mark.parametrize("compressor", ["None", "ZLib", "LZ4", "LZMA"])
@pytest.mark.parametrize("mode", ["Ascii", "Binary", "Appended"])
def test_points(tmp_path: Path, mode: str, compressor: str, encoded: bool) -> None:
    image = written(tmp_path / "v.vti", mode=mode, compressor=compressor, encoded=encoded, density=DATA)
    volume = clvol.read(tmp_path / "v.vti")
    np.testing.assert_array_equal(volume.data, DATA)
    assert (volume.data.dtype, volume.name, volume.space) == (np.float32, "density", "")
    for z, y, x in ((0, 0, 0), (1, 2, 3)):
        there = image.GetPoint(int(DATA[z, y, x]))
        np.testing.assert_allclose(volume.index_to_world([x, y, z]), there)


def test_blocks_and_big_endian(tmp_path: Path) -> None:
    """As VTK splits large arrays, and as other machines store them."""
    image = vtkImageData()
    image.SetDimensions(40, 30, 20)
    data = np.random.default_rng(3).integers(-9, 9, (20, 30, 40)).astype(np.int16)
    array = numpy_to_vtk(data.ravel(), deep=True)
    array.SetName("a")
    image.GetPointData().AddArray(array)
    for bits, big, pieces in ((32, False, 1), (64, True, 1), (64, False, 3)):
        writer = vtkXMLImageDataWriter()
        writer.SetFileName(str(tmp_path / "v.vti"))
        writer.SetInputData(image)
        writer.SetBlockSize(4096)
        getattr(writer, f"SetHeaderTypeToUInt{bits}")()
        getattr(writer, f"SetByteOrderTo{'Big' if big else 'Little'}Endian")()
        writer.SetNumberOfPieces(pieces)
        assert writer.Write()
        np.testing.assert_array_equal(clvol.read(tmp_path / "v.vti").data, data)


def test_cells_lie_between_points(tmp_path: Path) -> None:
    image = written(tmp_path / "v.vti", porosity=np.arange(6, dtype=np.int16))
    volume = clvol.read(tmp_path / "v.vti")
    np.testing.assert_array_equal(volume.data, np.arange(6).reshape(1, 2, 3))
    bounds = np.reshape(image.GetCell(5).GetBounds(), (3, 2))
    np.testing.assert_allclose(volume.index_to_world([2, 1, 0]), bounds.mean(1))


def test_vectors(tmp_path: Path) -> None:
    flow = np.random.default_rng(2).normal(size=(2, 3, 4, 3))
    written(tmp_path / "v.vti", flow=flow)
    np.testing.assert_allclose(clvol.read(tmp_path / "v.vti").data, np.linalg.norm(flow, axis=-1))
    np.testing.assert_array_equal(clvol.read(tmp_path / "v.vti", channel=1).data, flow[..., 1])
    assert np.asarray(clvol.read_all(tmp_path / "v.vti")).shape == (3, 2, 3, 4)


def test_several_arrays(tmp_path: Path) -> None:
    written(tmp_path / "v.vti", a=DATA, b=DATA * 2, c=np.arange(6, dtype=np.uint8))
    with pytest.raises(
        DataError, match=r"3 arrays: 0: a \(float32, 2 × 3 × 4\), 1: b .*, 2: c \(uint8, in cells, 1 × 2 × 3\).*series="
    ):
        clvol.read(tmp_path / "v.vti")
    np.testing.assert_array_equal(clvol.read(tmp_path / "v.vti", series="b").data, DATA * 2)
    written(tmp_path / "w.vti", active="b", a=DATA, b=DATA * 2)
    with pytest.warns(ClvolWarning, match=r"0: b \(float32, 2 × 3 × 4\), 1: a .*the first was read"):
        np.testing.assert_array_equal(clvol.read(tmp_path / "w.vti").data, DATA * 2)
    assert [one.id for one in formats.series_of(tmp_path / "w.vti")] == ["b", "a"]


def test_damaged_files_raise(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    written(tmp_path / "v.vti", mode="Ascii", a=DATA)
    content = (tmp_path / "v.vti").read_bytes()
    changes = {
        "empty": b"",
        "text": b"1 2 3",
        "half": content[: len(content) // 2],
        "huge": content.replace(b"5 8 0 2 0 1", b"5 2000000008 0 2 0 1"),
        "less": content.replace(b"5 8 0 2 0 1", b"5 9 0 2 0 1"),
        "no extent": content.replace(b"WholeExtent", b"NoExtent"),
        "no array": content.replace(b"Float32", b"Floating"),
        "other grid": content.replace(b"ImageData", b"RectilinearGrid"),
    }
    for name, damaged in changes.items():
        (tmp_path / "w.vti").write_bytes(damaged)
        with pytest.raises(ClvolError, match=r"w\.vti"):
            print(name, repr(clvol.read(tmp_path / "w.vti")))
    assert capfd.readouterr() == ("", "")  # VTK is used to speak to the terminal


def test_damaged_compressed_samples_raise(tmp_path: Path) -> None:
    written(tmp_path / "v.vti", a=DATA)
    content = (tmp_path / "v.vti").read_bytes()
    end = content.rindex(b"\n  </AppendedData>")
    (tmp_path / "v.vti").write_bytes(content[: end - 30] + bytes(30) + content[end:])
    with pytest.raises(FormatError, match=r"v\.vti"):
        clvol.read(tmp_path / "v.vti")
    written(tmp_path / "raw.vti", compressor="None", a=DATA)  # VTK takes what is missing for zeros
    content = (tmp_path / "raw.vti").read_bytes()
    (tmp_path / "raw.vti").write_bytes(content[: content.rindex(b"\n  </AppendedData>") - 30])
    with pytest.raises(FormatError, match="cut short"):
        clvol.read(tmp_path / "raw.vti")


def test_without_vtk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written(tmp_path / "v.vti", a=DATA)
    monkeypatch.setitem(sys.modules, "vtkmodules.vtkIOCore", None)
    np.testing.assert_array_equal(clvol.read(tmp_path / "v.vti").data, DATA)
    written(tmp_path / "v.vti", compressor="LZ4", a=DATA)
    with pytest.raises(MissingDependencyError, match=r'pip install "clvol\[vtk\]"'):
        clvol.read(tmp_path / "v.vti", trusted=True)
