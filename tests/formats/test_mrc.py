"""MRC and CCP4 maps written by mrcfile."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clvol
from clvol import ClvolWarning
from clvol.base.errors import DataError, FormatError

mrcfile = pytest.importorskip("mrcfile")

DATA = np.random.default_rng(0).normal(50, 20, (4, 5, 6))


def written(path: Path, data: Any, *, step: Any = (1.5, 2.0, 3.0), compression: str | None = None, **fields: Any) -> Path:
    """A file of mrcfile's whose header has these fields."""
    with mrcfile.new(path, compression=compression) as file:
        file.set_data(data)
        file.voxel_size = step
        for name, value in fields.items():
            file.header[name] = value
    return path


@pytest.mark.parametrize("suffix", [".mrc", ".map", ".ccp4.gz"])
@pytest.mark.parametrize("dtype", ["i1", "i2", "f4", "u2", "f2"])
def test_samples_of_every_type(tmp_path: Path, dtype: str, suffix: str) -> None:
    data = DATA.astype(dtype)
    packed = "gzip" if suffix.endswith("gz") else None
    path = written(tmp_path / f"v{suffix}", data, compression=packed, origin=(3, 4, 5), nlabl=2)
    volume = clvol.read(path)
    with mrcfile.open(path) as file:
        np.testing.assert_array_equal(volume.data, file.data)
        assert volume.spacing == pytest.approx(file.voxel_size.tolist())
    assert (volume.data.dtype, volume.origin, volume.units) == (data.dtype, (3, 4, 5), "angstrom")
    assert volume.header["labels"][0].startswith("Created by mrcfile")
    if packed is None:
        lazy = clvol.open(path)
        np.testing.assert_array_equal(lazy.read((1, 2, 0), (5, 5, 3)), data[:3, 2:5, 1:5])


@pytest.mark.parametrize("stamp", [(0x44, 0x44), (0x44, 0x41), (0x11, 0x11), (0, 0)])
def test_byte_orders(tmp_path: Path, stamp: tuple[int, int]) -> None:
    """By the machine stamp, or where there is none by a header that makes sense."""
    path = written(tmp_path / "v.mrc", DATA.astype("f4"), origin=(3, 4, 5))
    content = bytearray(path.read_bytes())
    orders = [">"] if stamp[0] == 0x11 else ["<"] if stamp[0] else ["<", ">"]
    for order in orders:
        swapped = bytearray(content)
        if order == ">":
            words = np.frombuffer(content, "<u4").byteswap()
            swapped = bytearray(words.tobytes())
            swapped[208:212], swapped[224:1024] = content[208:212], content[224:1024]  # texts
        swapped[212:216] = bytes((*stamp, 0, 0))
        path.write_bytes(swapped)
        volume = clvol.read(path)
        np.testing.assert_array_equal(volume.data, DATA.astype("f4"))
        assert (volume.spacing, volume.origin) == ((1.5, 2, 3), (3, 4, 5))


@pytest.mark.parametrize("axes", list(itertools.permutations((1, 2, 3))))
def test_axes_in_any_order(tmp_path: Path, axes: tuple[int, int, int]) -> None:
    """MAPC, MAPR and MAPS name the axes of columns, rows and sections; NXSTART, ... are theirs, and the cell is x, y, z."""
    order = ["zyx".index("xyz"[axis - 1]) for axis in axes[::-1]]
    stored = np.ascontiguousarray(DATA.astype("f4").transpose(order))
    first = {1: 10, 2: -20, 3: 30}
    fields = dict(zip(("mapc", "mapr", "maps", "nxstart", "nystart", "nzstart"), (*axes, *(first[a] for a in axes)), strict=True))
    path = written(tmp_path / "v.mrc", stored, **fields, mx=6, my=5, mz=4, cella=(6 * 1.5, 5 * 2.0, 4 * 3.0))
    lazy = clvol.open(path)
    np.testing.assert_array_equal(lazy.read((0, 0, 0), (6, 5, 4)), DATA.astype("f4"))
    np.testing.assert_array_equal(clvol.read(path).data, DATA.astype("f4"))
    for volume in (clvol.read(path), lazy):
        assert volume.grid.spacing == (1.5, 2, 3)
        assert volume.grid.origin == (10 * 1.5, -20 * 2, 30 * 3)


def test_origin_before_start(tmp_path: Path) -> None:
    assert clvol.read(written(tmp_path / "v.mrc", DATA.astype("f4"), nxstart=7, origin=(0, 1, 0))).origin == (0, 1, 0)
    assert clvol.read(written(tmp_path / "w.mrc", DATA.astype("f4"), nxstart=7)).origin == (10.5, 0, 0)


def test_skew_cells(tmp_path: Path) -> None:
    """Lengths and angles of the steps are those of the cell, and the first axis is the world's x."""
    angles = np.array((80.0, 100.0, 120.0))
    volume = clvol.read(written(tmp_path / "v.map", DATA.astype("f4"), cellb=tuple(angles), nxstart=1, nystart=2, nzstart=3))
    a, b, c = steps = (np.asarray(volume.direction) * volume.spacing).T
    np.testing.assert_allclose(np.linalg.norm(steps, axis=1), (1.5, 2, 3))
    found = [np.degrees(np.arccos(u @ v / np.linalg.norm(u) / np.linalg.norm(v))) for u, v in ((b, c), (a, c), (a, b))]
    np.testing.assert_allclose(found, angles)
    assert (a[1:] == 0).all()
    assert b[2] == 0
    assert c[2] > 0
    np.testing.assert_allclose(volume.origin, a + 2 * b + 3 * c)


@pytest.mark.parametrize("without", ["z", "x", "yz"])
def test_a_cell_without_a_length(tmp_path: Path, without: str) -> None:
    """An axis whose length the header leaves out has spacing 1; the others keep theirs, as in mrcfile."""
    path = written(tmp_path / "v.mrc", DATA.astype("f4"), nxstart=7)
    with mrcfile.open(path, "r+") as file:
        for axis in without:
            file.header.cella[axis] = 0
        known = {axis: float(file.voxel_size[axis]) for axis in "xyz"}
    with pytest.warns(ClvolWarning, match=f"how far apart its samples are along {without}; 1 Å was taken"):
        volume = clvol.read(path)
    assert volume.spacing == tuple(known[axis] or 1.0 for axis in "xyz")
    assert (volume.units, volume.origin) == ("angstrom", (7 * volume.spacing[0], 0, 0))


@pytest.mark.filterwarnings("error::clvol.ClvolWarning")
def test_an_image_needs_no_third_length(tmp_path: Path) -> None:
    image = clvol.read(written(tmp_path / "v.mrc", DATA[0].astype("f4"), cella=(9, 10, 0)))
    assert (image.spacing, image.units) == ((1.5, 2), "angstrom")


def test_extended_header_and_more_bytes(tmp_path: Path) -> None:
    path = tmp_path / "v.mrc"
    with mrcfile.new(path) as file:
        file.set_data(DATA.astype("i2"))
        file.set_extended_header(np.arange(300, dtype="f4"))
        file.header.exttyp = b"FEI1"
    volume = clvol.read(path)
    np.testing.assert_array_equal(volume.data, DATA.astype("i2"))
    assert (volume.header["exttyp"], volume.header["extended_bytes"], volume.spacing) == ("FEI1", 1200, (1, 1, 1))
    assert volume.units == ""  # the cell has no size
    path.write_bytes(path.read_bytes() + b"123")
    with pytest.warns(ClvolWarning, match="has 3 bytes behind"):
        np.testing.assert_array_equal(clvol.read(path).data, DATA.astype("i2"))


def test_images_and_stacks(tmp_path: Path) -> None:
    image = clvol.read(written(tmp_path / "image.mrc", DATA[0].astype("f4"), origin=(1, 2, 0)))
    assert (image.shape, image.spacing, image.origin) == ((5, 6), (1.5, 2), (1, 2))
    with mrcfile.new(tmp_path / "stack.mrcs") as file:
        file.set_data(DATA.astype("f4"))
        file.set_image_stack()
        file.voxel_size = 2.0
    assert clvol.read(tmp_path / "stack.mrcs").spacing == (2, 2, 2)
    several = np.stack([DATA, DATA + 1, DATA + 2]).astype("f4")
    volumes = clvol.read_all(written(tmp_path / "several.mrc", several))
    assert volumes.axes == ("volume",)
    np.testing.assert_array_equal(volumes, several)
    np.testing.assert_array_equal(clvol.open(tmp_path / "several.mrc", volume=2).read((0, 0, 0), (6, 5, 4)), several[2])


def test_bytes_of_imod(tmp_path: Path) -> None:
    """Bytes have a sign, but in files of IMOD only where its flag says so."""
    for flags, dtype in ((1, "i1"), (0, "u1"), (4, "u1")):
        path = written(tmp_path / f"{flags}.mrc", np.arange(-60, 60, dtype="i1").reshape(4, 5, 6))
        content = bytearray(path.read_bytes())
        content[152:160] = np.array((1146047817, flags), "<i4").tobytes()
        path.write_bytes(content)
        np.testing.assert_array_equal(clvol.read(path).data, np.arange(-60, 60, dtype="i1").view(dtype).reshape(4, 5, 6))


def test_colours(tmp_path: Path) -> None:
    """Mode 16, which IMOD writes and SimpleITK reads."""
    sitk = pytest.importorskip("SimpleITK")
    colours = np.random.default_rng(1).integers(0, 255, (4, 5, 6, 3), np.uint8)
    sitk.WriteImage(sitk.GetImageFromArray(colours, isVector=True), tmp_path / "v.mrc")
    volumes = clvol.read_all(tmp_path / "v.mrc")
    assert volumes.names == ("red", "green", "blue")
    np.testing.assert_array_equal(volumes, np.moveaxis(colours, -1, 0))


def test_any_suffix(tmp_path: Path) -> None:
    """A tomogram of IMOD, by its MAP."""
    written(tmp_path / "v.mrc", DATA.astype("f4")).rename(tmp_path / "v.rec")
    np.testing.assert_array_equal(clvol.read(tmp_path / "v.rec").data, DATA.astype("f4"))


def test_others_are_rejected(tmp_path: Path) -> None:
    path = written(tmp_path / "v.mrc", DATA.astype("c8"))
    with pytest.raises(DataError, match="complex numbers, of mode 4"):
        clvol.read(path)
    whole = written(tmp_path / "w.mrc", DATA.astype("f4")).read_bytes()
    for name, content, match in (
        ("cut", whole[:-1], "must hold 480 bytes"),
        ("head", whole[:1000], "must begin with a header of 1024 bytes"),
        ("text", b"x" * 2000, "must have a header of MRC"),
    ):
        (tmp_path / f"{name}.map").write_bytes(content)
        with pytest.raises(FormatError, match=match):
            clvol.read(tmp_path / f"{name}.map")
    flat = written(tmp_path / "flat.mrc", DATA.astype("f4"), cellb=(10, 20, 170))
    with pytest.raises(FormatError, match="three independent axes"):
        clvol.read(flat)
