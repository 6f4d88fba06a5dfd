"""Every file format: written data round-trip, and no file crashes, hangs or misleads."""

from __future__ import annotations

import bz2
import gzip
import itertools
import json
import logging
import os
import random
import re
import struct
import subprocess
import sys
import tarfile
import textwrap
import warnings
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from clvol import formats
from clvol.base.errors import ClvolWarning, DataError, FormatError, GeometryError, MissingDependencyError, OptionError
from clvol.volume.volume import Volume

DATA = Path(os.environ.get("CLVOL_DATA", Path(__file__).parents[3] / "shared" / "data"))

ITK = (".nii", ".nii.gz", ".nrrd", ".nhdr", ".mha", ".mhd")
WRITTEN = (".npy", ".npz", *ITK, ".tif", ".tiff")
DTYPES = (
    "bool",
    "uint8",
    "int8",
    "uint16",
    "int16",
    "uint32",
    "int32",
    "uint64",
    "int64",
    "float16",
    "float32",
    "float64",
    ">u2",
    ">f4",
)
WIDENED = {"bool": "uint8", "float16": "float32"}
SPACING, ORIGIN = (1 / 3, 0.7, 2.123456789012), (-1 / 7, 123.456789, 1e4 / 3)
OBLIQUE = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
FLIPPED = OBLIQUE @ np.diag([1.0, -1.0, 1.0])  # left-handed


def need(suffix: str) -> None:
    """Skip if the format's extra is missing."""
    if suffix in ITK:
        pytest.importorskip("SimpleITK")
    if suffix.startswith(".tif"):
        pytest.importorskip("tifffile")


def place(suffix: str, data: np.ndarray, direction: np.ndarray = OBLIQUE) -> Volume:
    """`data` with all geometry that the format can store."""
    if suffix == ".npy":
        return Volume(data)
    if suffix.startswith(".tif"):
        return Volume(data, SPACING[: data.ndim], units="um")
    d = data.ndim
    turn = direction if d == 3 else np.array([[0.6, -0.8], [0.8, 0.6]])
    return Volume(data, SPACING[:d], ORIGIN[:d], turn, "mm")


def samples(dtype: str, shape: tuple[int, ...] = (2, 3, 4)) -> np.ndarray:
    """Distinct values that include the limits of `dtype`."""
    kind = np.dtype(dtype)
    data = np.arange(np.prod(shape)).reshape(shape).astype(kind)
    if kind.kind in "iuf":
        limits = np.iinfo(kind) if kind.kind != "f" else np.finfo(kind)
        data.flat[0], data.flat[-1] = limits.min, limits.max
    return data


def assert_same(read: Volume, wrote: Volume, suffix: str) -> None:
    tolerance = 2e-7 if suffix.startswith(".nii") else 1e-15  # float32 in NIfTI; NRRD multiplies spacing and direction
    np.testing.assert_array_equal(read.data, wrote.data)
    np.testing.assert_allclose(read.spacing, wrote.spacing, rtol=tolerance)
    np.testing.assert_allclose(read.origin, wrote.origin, rtol=tolerance)
    np.testing.assert_allclose(read.direction, wrote.direction, atol=tolerance)
    assert read.units == wrote.units


# -- round trips ------------------------------------------------------------------------------


@pytest.mark.one_in(3)
@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("suffix", WRITTEN)
def test_round_trip(tmp_path: Path, suffix: str, dtype: str) -> None:
    need(suffix)
    volume, path = place(suffix, samples(dtype)), tmp_path / f"volume{suffix}"
    if suffix.startswith(".tif") and dtype in ("int64", "uint64"):
        with pytest.raises(FormatError, match=f"got {dtype}"):
            formats.write(volume, path)
        assert list(tmp_path.iterdir()) == []
        return
    formats.write(volume, path)
    read = formats.read(path)
    assert_same(read, volume, suffix)
    native = np.dtype(dtype).newbyteorder("=").name
    exact = suffix in (".npy", ".npz")
    assert read.data.dtype == np.dtype(dtype if exact else WIDENED.get(native, native))


@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 3, 4), (3, 4, 4), (4, 5, 1), (1, 1, 7), (5, 4), (1, 4), (1, 1)])
@pytest.mark.parametrize("suffix", WRITTEN)
def test_round_trip_of_images_and_thin_volumes(tmp_path: Path, suffix: str, shape: tuple[int, ...]) -> None:
    need(suffix)
    volume = place(suffix, np.arange(np.prod(shape), dtype=np.uint8).reshape(shape))
    formats.write(volume, tmp_path / f"volume{suffix}")
    assert_same(formats.read(tmp_path / f"volume{suffix}"), volume, suffix)


@pytest.mark.parametrize("suffix", [".npz", *ITK])
def test_round_trip_of_a_left_handed_frame(tmp_path: Path, suffix: str) -> None:
    need(suffix)
    volume = place(suffix, samples("int16"), FLIPPED)
    formats.write(volume, tmp_path / f"volume{suffix}")
    assert_same(formats.read(tmp_path / f"volume{suffix}"), volume, suffix)


@pytest.mark.parametrize("suffix", [".npz", ".nrrd", ".nhdr", ".mha", ".mhd"])
def test_round_trip_of_a_sheared_frame(tmp_path: Path, suffix: str) -> None:
    need(suffix)
    volume = place(suffix, samples("int16"), np.array([[1, 0.6, 0], [0, 0.8, 0], [0, 0, 1]]))
    formats.write(volume, tmp_path / f"volume{suffix}")
    assert_same(formats.read(tmp_path / f"volume{suffix}"), volume, suffix)


@pytest.mark.parametrize("suffix", WRITTEN)
def test_any_memory_layout_is_written(tmp_path: Path, suffix: str) -> None:
    need(suffix)
    data = np.asfortranarray(np.arange(4 * 6 * 5, dtype=np.int16).reshape(4, 6, 5))[::2, ::-1, 1:]
    formats.write(place(suffix, data), tmp_path / f"volume{suffix}")
    np.testing.assert_array_equal(formats.read(tmp_path / f"volume{suffix}").data, data)


@pytest.mark.parametrize("suffix", WRITTEN)
@pytest.mark.parametrize("name", ["UPPER", "with space", "ünï", "a.b.c", "x%d"])
def test_file_names(tmp_path: Path, suffix: str, name: str) -> None:
    need(suffix)
    path = tmp_path / f"{name}{suffix.upper() if name == 'UPPER' else suffix}"
    volume = place(suffix, samples("uint8"))
    if "%" in name and suffix in (".nhdr", ".mhd"):  # readers take the data file's name for a pattern
        with pytest.raises(FormatError, match="FIRST LAST STEP"):
            formats.write(volume, path)
        assert list(tmp_path.iterdir()) == []
        return
    formats.write(volume, path)
    assert_same(formats.read(path), volume, suffix)
    detached = suffix in (".nhdr", ".mhd")
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted([path.name] + [f"{name}.raw"] * detached)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    suffix=st.sampled_from([".npz", ".nrrd", ".mha", ".nii.gz"]),
    shape=st.lists(st.integers(1, 5), min_size=2, max_size=3),
    spacing=st.lists(st.floats(2**-10, 2**10, width=32), min_size=3, max_size=3),
    origin=st.lists(st.floats(-(2**17), 2**17, width=32), min_size=3, max_size=3),
    angles=st.lists(st.floats(-3, 3), min_size=3, max_size=3),
)
def test_round_trip_of_any_geometry(
    tmp_path: Path, suffix: str, shape: list[int], spacing: list[float], origin: list[float], angles: list[float]
) -> None:
    need(suffix)
    from scipy.spatial.transform import Rotation

    d = len(shape)
    turn = Rotation.from_euler("xyz", angles if d == 3 else [0, 0, angles[2]]).as_matrix()[:d, :d]
    volume = Volume(np.arange(np.prod(shape), dtype=np.int16).reshape(shape), spacing[:d], origin[:d], turn, "mm")
    formats.write(volume, tmp_path / f"volume{suffix}")
    read = formats.read(tmp_path / f"volume{suffix}")
    tolerance = 1e-6 if suffix == ".nii.gz" else 4e-15
    np.testing.assert_array_equal(read.data, volume.data)
    np.testing.assert_allclose(read.spacing, volume.spacing, rtol=tolerance)
    np.testing.assert_allclose(read.origin, volume.origin, rtol=tolerance)
    np.testing.assert_allclose(read.direction, volume.direction, atol=tolerance)


# -- orientation: where other libraries see the marked voxel --------------------------------------

MARK = (3, 0, 1)  # (x, y, z) of the bright voxel, off every symmetry of the shape


def marked() -> np.ndarray:
    data = np.zeros((2, 3, 4), np.int16)
    data[MARK[::-1]] = 99
    return data


def world_of_mark(volume: Volume) -> np.ndarray:
    index = np.argwhere(volume.data == 99)
    assert len(index) == 1
    return volume.index_to_world(index[0][::-1])


@pytest.mark.parametrize("suffix", ITK)
def test_simpleitk_sees_the_mark_where_we_do(tmp_path: Path, suffix: str) -> None:
    sitk = pytest.importorskip("SimpleITK")
    volume = place(suffix, marked(), FLIPPED)
    formats.write(volume, tmp_path / f"v{suffix}")
    image = sitk.ReadImage(str(tmp_path / f"v{suffix}"))
    assert image[MARK] == 99
    there = image.TransformIndexToPhysicalPoint(MARK)
    np.testing.assert_allclose(there, volume.index_to_world(MARK), rtol=1e-6)
    rounding = 1e-6 if suffix.startswith(".nii") else 1e-12  # ITK takes the qform, we the sform; each is kept in float32
    np.testing.assert_allclose(world_of_mark(formats.read(tmp_path / f"v{suffix}")), there, rtol=rounding)
    np.testing.assert_allclose(world_of_mark(Volume(image)), there, rtol=1e-12)


@pytest.mark.parametrize("suffix", [".nii", ".nii.gz"])
def test_nibabel_sees_the_mark_where_we_do(tmp_path: Path, suffix: str) -> None:
    need(suffix)
    nibabel = pytest.importorskip("nibabel")
    volume = place(suffix, marked(), FLIPPED)
    formats.write(volume, tmp_path / f"v{suffix}")
    image = nibabel.load(tmp_path / f"v{suffix}")
    assert image.dataobj[MARK] == 99
    right_anterior_superior = image.affine @ [*MARK, 1]
    there = right_anterior_superior[:3] * [-1, -1, 1]
    np.testing.assert_allclose(there, volume.index_to_world(MARK), rtol=1e-6)
    np.testing.assert_allclose(world_of_mark(formats.read(tmp_path / f"v{suffix}")), there, rtol=1e-6)
    np.testing.assert_allclose(world_of_mark(Volume(image)), there, rtol=1e-6)
    assert formats.read(tmp_path / f"v{suffix}").units == Volume(image).units == "mm"


@pytest.mark.parametrize(
    ("space", "signs"), [("left-posterior-superior", (1, 1, 1)), ("RAS", (-1, -1, 1)), ("left-anterior-superior", (1, -1, 1))]
)
def test_nrrd_spaces(tmp_path: Path, space: str, signs: tuple[int, ...]) -> None:
    need(".nrrd")
    (tmp_path / "v.nrrd").write_bytes(
        f"NRRD0004\ntype: short\ndimension: 3\nspace: {space}\nsizes: 4 3 2\nendian: little\nencoding: raw\n"
        "space directions: (0,2,0) (3,0,0) (0,0,4)\nspace origin: (10,20,30)\n\n".encode()
        + marked().tobytes()
    )
    there = np.array([10 + 0, 20 + 2 * 3, 30 + 4 * 1]) * signs
    np.testing.assert_allclose(world_of_mark(formats.read(tmp_path / "v.nrrd")), there)


def test_nrrd_axis_order_and_big_endian(tmp_path: Path) -> None:
    need(".nrrd")
    data = samples("int16")
    (tmp_path / "v.nhdr").write_text(
        "NRRD0001\ncontent: " + "long " * 200 + "\n# comment\nkey:=value: with colon\ntype: short\ndimension: 3\n"
        "sizes: 4 3 2\nspacings: 1 2 3\ndata file: ./sub/d.bin\nendian: big\n"
        "encoding: raw\nline skip: 2\nbyte skip: 3\n"
    )
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "d.bin").write_bytes(b"one\ntwo\nabc" + data.astype(">i2").tobytes())
    read = formats.read(tmp_path / "v.nhdr")
    np.testing.assert_array_equal(read.data, data)
    assert read.spacing == (1, 2, 3)


@pytest.mark.parametrize("packed", [True, False])
def test_formats_written_by_others(tmp_path: Path, packed: bool) -> None:
    """Compressed and uncompressed, written by SimpleITK itself."""
    sitk = pytest.importorskip("SimpleITK")
    image = sitk.GetImageFromArray(samples("uint16", (4, 8, 6)))
    image.SetSpacing((1.5, 2, 3))
    for suffix in ITK:
        sitk.WriteImage(image, str(tmp_path / f"v{suffix}"), useCompression=packed)
        read = formats.read(tmp_path / f"v{suffix}")
        np.testing.assert_array_equal(read.data, samples("uint16", (4, 8, 6)))
        assert read.spacing == (1.5, 2, 3)


def test_nifti_scaling_units_and_a_fourth_axis_of_one(tmp_path: Path) -> None:
    need(".nii")
    nibabel = pytest.importorskip("nibabel")
    data = np.arange(24, dtype=np.int16).reshape(4, 3, 2, 1)
    image = nibabel.Nifti1Image(data, np.diag([1000.0, 2000.0, 3000.0, 1.0]))
    image.header.set_xyzt_units("micron")
    image.header.set_slope_inter(2, 5)
    nibabel.save(image, tmp_path / "v.nii")
    read = formats.read(tmp_path / "v.nii")
    assert (read.shape, read.spacing, read.units) == ((2, 3, 4), (1, 2, 3), "mm")
    np.testing.assert_allclose(read.data, 5 + 2 * data[..., 0].T)  # scaled as the header says
    np.testing.assert_allclose(read.data, nibabel.load(tmp_path / "v.nii").get_fdata()[..., 0].T)


def test_four_axes_with_one_sample(tmp_path: Path) -> None:
    sitk = pytest.importorskip("SimpleITK")
    image = sitk.GetImageFromArray(samples("int16", (1, 2, 3, 4)), isVector=False)
    image.SetSpacing((1, 2, 3, 9))
    for suffix in (".nrrd", ".mha", ".nii"):
        sitk.WriteImage(image, str(tmp_path / f"v{suffix}"))
        read = formats.read(tmp_path / f"v{suffix}")
        np.testing.assert_array_equal(read.data, samples("int16"))
        assert read.spacing == (1, 2, 3)


# -- NumPy -----------------------------------------------------------------------------------


def test_npy_rejects_to_lose_geometry(tmp_path: Path) -> None:
    data = samples("uint8")
    for lost in ({"spacing": (1, 1, 2)}, {"origin": (0, 0, 1)}, {"direction": OBLIQUE}, {"units": "mm"}):
        with pytest.raises(FormatError, match=rf"cannot hold {next(iter(lost))}.*\.npz"):
            formats.write(Volume(data, **lost), tmp_path / "v.npy")
    assert list(tmp_path.iterdir()) == []


def test_arrays_are_written_as_volumes(tmp_path: Path) -> None:
    formats.write(samples("float32"), tmp_path / "v.npy")
    np.testing.assert_array_equal(np.load(tmp_path / "v.npy"), samples("float32"))


def test_npz_of_others(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "one.npz", image=samples("int16"), spacing=[1, 2, 3])
    read = formats.read(tmp_path / "one.npz")
    np.testing.assert_array_equal(read.data, samples("int16"))
    assert read.spacing == (1, 2, 3)
    np.savez(tmp_path / "two.npz", a=samples("int16"), b=samples("int16"))
    with pytest.raises(FormatError, match=r"\['a', 'b'\]"):
        formats.read(tmp_path / "two.npz")


class Bomb:
    """An object whose unpickling would be detected."""

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[str]]:
        return os.mkdir, ("pickle-was-run",)


def test_pickles_are_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    np.save("v.npy", np.array([[Bomb()]], dtype=object), allow_pickle=True)
    np.savez("v.npz", data=np.array([[Bomb()]], dtype=object))
    for name in ("v.npy", "v.npz"):
        with pytest.raises(DataError, match="dtype object"):
            formats.read(name)
    assert not Path("pickle-was-run").exists()


@pytest.mark.parametrize("dtype", ["complex64", "U3", "datetime64[s]", [("a", "u1")]])
def test_npy_of_other_types(tmp_path: Path, dtype: Any) -> None:
    np.save(tmp_path / "v.npy", np.zeros((2, 2, 2), dtype))
    with pytest.raises(DataError, match="must hold boolean, integer or floating"):
        formats.read(tmp_path / "v.npy")


@pytest.mark.parametrize("shape", [(4,), (2,) * 8, (0, 3, 3), (0, 2, 2, 2), ()])
def test_npy_of_other_shapes(tmp_path: Path, shape: tuple[int, ...]) -> None:
    np.save(tmp_path / "v.npy", np.zeros(shape))
    with pytest.raises(DataError, match=r"v\.npy.*(axes|axis)"):
        formats.read(tmp_path / "v.npy")


def test_npy_with_an_absurd_shape_allocates_nothing(tmp_path: Path) -> None:
    head = b"{'descr': '<f8', 'fortran_order': False, 'shape': (%d, %d, %d), }\n" % (10**6, 10**6, 10**6)
    (tmp_path / "v.npy").write_bytes(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head)
    with pytest.raises(FormatError, match="8000000000000000000 bytes"):
        formats.read(tmp_path / "v.npy")


# -- raw -------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", ["bool", "uint8", ">i2", "<f4", "float64"])
@pytest.mark.parametrize("suffix", [".raw", ".BIN"])
def test_raw(tmp_path: Path, suffix: str, dtype: str) -> None:
    data = samples(dtype)
    (tmp_path / f"v{suffix}").write_bytes(b"header" + data.tobytes())
    read = formats.read(tmp_path / f"v{suffix}", shape=(2, 3, 4), dtype=dtype, offset=6, spacing=(1, 2, 3))
    np.testing.assert_array_equal(read.data, data)
    assert read.data.dtype == np.dtype(dtype)
    assert read.spacing == (1, 2, 3)


def test_raw_byte_order(tmp_path: Path) -> None:
    samples(">u2").tofile(tmp_path / "v.raw")
    for dtype, order in [("u2", "big"), (">u2", None), ("<u2", "big")]:
        read = formats.read(tmp_path / "v.raw", shape=(2, 3, 4), dtype=dtype, byte_order=order)
        np.testing.assert_array_equal(read.data, samples("u2"))


def test_raw_size_must_match(tmp_path: Path) -> None:
    (tmp_path / "v.raw").write_bytes(bytes(47))
    with pytest.raises(FormatError, match=r"48 bytes.*found 47"):
        formats.read(tmp_path / "v.raw", shape=(2, 3, 4), dtype="u2")
    with pytest.raises(FormatError, match=r"46 bytes.*found 47"):
        formats.read(tmp_path / "v.raw", shape=(1, 1, 23), dtype="u2")
    with pytest.raises(FormatError, match=r"found -53"):
        formats.read(tmp_path / "v.raw", shape=(2, 3, 4), dtype="u2", offset=100)
    with pytest.raises(FormatError, match=r"1000000000000000000000 bytes"):
        formats.read(tmp_path / "v.raw", shape=(10**7, 10**7, 10**7), dtype="u1")


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"shape": (2, 3, 4)},
        {"dtype": "u1"},
        {"shape": 24, "dtype": "u1"},
        {"shape": (24,), "dtype": "u1"},
        {"shape": (2, 3, -4), "dtype": "u1"},
        {"shape": (2, 3, 4.5), "dtype": "u1"},
        {"shape": (2, 3, float("nan")), "dtype": "u1"},
        {"shape": "abc", "dtype": "u1"},
        {"shape": (2, 3, 4), "dtype": "nonsense"},
        {"shape": (2, 3, 4), "dtype": "O"},
        {"shape": (2, 3, 4), "dtype": "u1", "byte_order": "middle"},
        {"shape": (2, 3, 4), "dtype": "u1", "offset": -1},
        {"shape": (2, 3, 4), "dtype": "u1", "offset": 1.5},
        {"shape": (2, 3, 4), "dtype": "u1", "series": "1"},
    ],
    ids=str,
)
def test_raw_options(tmp_path: Path, options: dict[str, Any]) -> None:
    (tmp_path / "v.raw").write_bytes(bytes(24))
    with pytest.raises(OptionError, match=r"must be|must name|says nothing|only for"):
        formats.read(tmp_path / "v.raw", **options)


def test_raw_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=r"\.mhd or \.nhdr"):
        formats.write(samples("u1"), tmp_path / "v.raw")


# -- TIFF ------------------------------------------------------------------------------------


@pytest.mark.parametrize("unit", ["", "nm", "um", "mm", "cm", "m", "inch"])
def test_tiff_units(tmp_path: Path, unit: str) -> None:
    tifffile = pytest.importorskip("tifffile")
    volume = Volume(samples("uint16"), SPACING, units=unit)
    formats.write(volume, tmp_path / "v.tif")
    assert_same(formats.read(tmp_path / "v.tif"), volume, ".tif")
    with tifffile.TiffFile(tmp_path / "v.tif") as file:  # a marked voxel, seen by another reader
        assert file.is_ome
        assert f'PhysicalSizeZ="{SPACING[2]}"' in file.ome_metadata
        np.testing.assert_array_equal(file.asarray(), volume.data)


@pytest.mark.parametrize("spelled", ["micron", "um", "\\u00B5m"])
def test_tiff_of_imagej(tmp_path: Path, spelled: str) -> None:
    tifffile = pytest.importorskip("tifffile")
    tifffile.imwrite(
        tmp_path / "v.tif",
        samples("uint16"),
        imagej=True,
        resolution=(1 / 0.3, 1 / 0.7),
        metadata={"spacing": 2.5, "unit": spelled, "axes": "ZYX"},
    )
    read = formats.read(tmp_path / "v.tif")
    np.testing.assert_array_equal(read.data, samples("uint16"))
    np.testing.assert_allclose(read.spacing, (0.3, 0.7, 2.5), rtol=1e-6)
    assert read.units == "um"


def test_tiff_of_ome_with_several_units(tmp_path: Path) -> None:
    tifffile = pytest.importorskip("tifffile")
    sizes = {"PhysicalSizeX": 500, "PhysicalSizeXUnit": "nm", "PhysicalSizeY": 0.5, "PhysicalSizeZ": 0.002}
    metadata = {"axes": "ZYX", **sizes, "PhysicalSizeZUnit": "mm"}
    tifffile.imwrite(tmp_path / "v.ome.tif", samples("uint8"), photometric="minisblack", metadata=metadata)
    read = formats.read(tmp_path / "v.ome.tif")
    np.testing.assert_allclose(read.spacing, (500, 500, 2000))
    assert read.units == "nm"


@pytest.mark.parametrize("axes", ["ZYX", "YX"])
@pytest.mark.parametrize("given", ["X", "XY", "Z", "YZ"])
def test_tiff_of_ome_with_some_sizes(tmp_path: Path, axes: str, given: str) -> None:
    """Each is optional: a missing one is 1, and a warning names its axis."""
    tifffile = pytest.importorskip("tifffile")
    sizes = {f"PhysicalSize{axis}": {"X": 0.5, "Y": 0.25, "Z": 2.0}[axis] for axis in given}
    data = samples("uint8") if axes == "ZYX" else samples("uint8")[0]
    tifffile.imwrite(tmp_path / "v.ome.tif", data, photometric="minisblack", metadata={"axes": axes, **sizes})
    with tifffile.TiffFile(tmp_path / "v.ome.tif") as file:
        assert [f"PhysicalSize{axis}=" in file.ome_metadata for axis in "XYZ"] == [axis in given for axis in "XYZ"]
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        read = formats.read(tmp_path / "v.ome.tif")
    assert read.spacing == tuple(sizes.get(f"PhysicalSize{axis}", 1.0) for axis in "XYZ"[: read.ndim])
    assert read.units == "um"
    missing = [axis.lower() for axis in "XYZ"[: read.ndim] if axis not in given]
    expected = [f"v.ome.tif: it gives no spacing along {' and '.join(missing)}, where 1 was taken"] if missing else []
    assert [str(one.message).partition(": spacing=")[0] for one in warned] == expected
    assert formats.read(tmp_path / "v.ome.tif", spacing=(1, 1, 2)[: read.ndim]).spacing == (1, 1, 2)[: read.ndim]


@pytest.mark.parametrize("compression", [None, "zlib", "lzw"])
@pytest.mark.parametrize("metadata", [None, {}], ids=["plain", "shaped"])
def test_plain_tiff(tmp_path: Path, compression: str | None, metadata: dict[str, Any] | None) -> None:
    tifffile = pytest.importorskip("tifffile")
    if compression:
        pytest.importorskip("imagecodecs")
    data = samples("uint16", (3, 20, 30))
    tifffile.imwrite(tmp_path / "v.tif", data, photometric="minisblack", metadata=metadata, compression=compression, byteorder=">")
    read = formats.read(tmp_path / "v.tif")
    np.testing.assert_array_equal(read.data, data)
    assert (read.spacing, read.units) == ((1, 1, 1), "")


def test_tiff_of_a_set_with_a_missing_file(tmp_path: Path) -> None:
    """Tifffile logs the missing slices and fills them with 0; this is detected even if its log is silenced."""
    tifffile = pytest.importorskip("tifffile")
    formats.write(samples("uint8"), tmp_path / "v.tif")
    with tifffile.TiffFile(tmp_path / "v.tif") as file:
        text = file.ome_metadata.replace('SizeZ="2"', 'SizeZ="3"')
    tifffile.tiffcomment(tmp_path / "v.tif", text.encode())
    logger = logging.getLogger("tifffile")
    level = logger.level
    try:
        for silenced in (level, logging.CRITICAL):
            logger.setLevel(silenced)
            with pytest.raises(FormatError, match="missing"):
                formats.read(tmp_path / "v.tif")
            assert logger.level == silenced
    finally:
        logger.setLevel(level)


@pytest.mark.parametrize("lost", [{"origin": (0, 0, 1)}, {"direction": OBLIQUE}, {"units": "parsec"}], ids=str)
def test_tiff_rejects_to_lose_geometry(tmp_path: Path, lost: dict[str, Any]) -> None:
    pytest.importorskip("tifffile")
    with pytest.raises(FormatError, match=r"\.npz"):
        formats.write(Volume(samples("uint8"), **lost), tmp_path / "v.tif")
    assert list(tmp_path.iterdir()) == []


# -- DICOM -----------------------------------------------------------------------------------


def write_series(
    folder: Path, volume: Volume, uid: str = "1.2.3", positions: np.ndarray | None = None, place_it: bool = True
) -> None:
    """One file per slice, names shuffled against their order in the patient."""
    sitk = pytest.importorskip("SimpleITK")
    folder.mkdir(exist_ok=True)
    names = list(range(volume.shape[0]))
    random.Random(1).shuffle(names)
    writer = sitk.ImageFileWriter()
    writer.KeepOriginalImageUIDOn()
    for k, name in enumerate(names):
        image = sitk.GetImageFromArray(volume.data[k : k + 1])
        image.SetSpacing(volume.spacing)
        tags = {"0008|0060": "CT", "0020|000e": uid, "0020|000d": "1.2", "0008|0018": f"{uid}.{name}"}
        if place_it:
            position = volume.index_to_world([0, 0, k]) if positions is None else positions[k]
            tags["0020|0032"] = "\\".join(f"{p:.10g}" for p in position)
            tags["0020|0037"] = "\\".join(f"{c:.10g}" for c in volume.direction[:, :2].T.ravel())
        else:
            tags["0008|0060"] = "OT"
        for tag, value in tags.items():
            image.SetMetaData(tag, value)
        writer.SetFileName(str(folder / f"{uid}-{name:03}.dcm"))
        writer.Execute(image)


def series(direction: np.ndarray = OBLIQUE, slices: int = 6) -> Volume:
    data = np.arange(slices * 8 * 9, dtype=np.int16).reshape(slices, 8, 9)
    return Volume(data, (0.5, 0.75, 2.5), (10, -20, 30), direction, "mm")


@pytest.mark.parametrize("direction", [np.eye(3), OBLIQUE], ids=["straight", "oblique"])
def test_dicom_shuffled(tmp_path: Path, direction: np.ndarray) -> None:
    volume = series(direction)
    write_series(tmp_path, volume)
    read = formats.read(tmp_path)
    np.testing.assert_array_equal(read.data, volume.data)
    np.testing.assert_allclose(read.spacing, volume.spacing, rtol=1e-9)
    np.testing.assert_allclose(read.origin, volume.origin, rtol=1e-9)
    np.testing.assert_allclose(read.direction, volume.direction, atol=1e-9)
    assert read.units == "mm"


def test_dicom_of_one_slice(tmp_path: Path) -> None:
    write_series(tmp_path, series(slices=1))
    np.testing.assert_array_equal(formats.read(tmp_path).data, series(slices=1).data)


def test_dicom_with_a_tilted_gantry(tmp_path: Path) -> None:
    volume = series(np.array([[1, 0, 0], [0, 1, -0.28], [0, 0, 0.96]]))
    write_series(tmp_path, volume)
    np.testing.assert_allclose(formats.read(tmp_path).corners, volume.corners, rtol=1e-8)


def test_dicom_with_a_missing_slice(tmp_path: Path) -> None:
    for missing in (1, 3):
        folder = tmp_path / str(missing)
        positions = [series().index_to_world([0, 0, k + (k >= missing)]) for k in range(6)]
        write_series(folder, series(), positions=np.array(positions))
        with pytest.raises(FormatError, match=r"2.5 to 5 mm apart"):
            formats.read(folder)


def test_dicom_of_rotated_slices(tmp_path: Path) -> None:
    """As in a series of localizers; the positions alone would form a regular stack."""
    straight = series(np.eye(3))
    write_series(tmp_path, straight)
    for file in list(tmp_path.iterdir()):
        file.rename(tmp_path / f"first-{file.name}")
    write_series(tmp_path, series(OBLIQUE), positions=np.array([straight.index_to_world([0, 0, k + 6]) for k in range(6)]))
    with pytest.raises(FormatError, match=r"2 orientations \(6, 6 slices\)"):
        formats.read(tmp_path)


def test_dicom_with_a_truncated_slice(tmp_path: Path) -> None:
    """GDCM skips it, and the rest may look complete: here the last slice of the stack is truncated."""
    write_series(tmp_path, series())
    last = max(tmp_path.iterdir(), key=lambda file: file.read_bytes()[-2:][::-1])
    whole = last.read_bytes()
    for keep in (0, 100, 150, 400, len(whole) - 2):
        last.write_bytes(whole[:keep])
        with pytest.raises(FormatError, match=f"{last.name} is damaged"):
            formats.read(tmp_path)
    last.write_bytes(whole)
    (tmp_path / "README.txt").write_text("other files are passed over")
    assert formats.read(tmp_path).shape == (6, 8, 9)


def test_dicom_of_several_images_at_one_position(tmp_path: Path) -> None:
    positions = [series().index_to_world([0, 0, k // 2]) for k in range(6)]
    write_series(tmp_path / "two", series(), positions=np.array(positions))
    with pytest.warns(ClvolWarning, match=r"2 volumes.*images of each place were taken for volumes"):
        first = formats.read(tmp_path / "two")
    with pytest.warns(ClvolWarning, match="taken for volumes"):
        both = formats.read_all(tmp_path / "two")
    assert (both.axes, both.shape) == (("volume",), (2, 3, 8, 9))
    np.testing.assert_array_equal(first.data, both[0].data)
    for n in range(3):  # by hand: places 0, 0, 1, 1, 2, 2
        np.testing.assert_array_equal(np.sort(np.asarray(both)[:, n], axis=0), series().data[2 * n : 2 * n + 2])
    np.testing.assert_allclose(first.spacing, series().spacing, rtol=1e-9)
    write_series(tmp_path / "one", series(), positions=np.array([positions[max(0, k - 1)] for k in range(6)]))
    with pytest.raises(FormatError, match="several images of some places"):
        formats.read(tmp_path / "one")


def test_dicom_without_positions(tmp_path: Path) -> None:
    write_series(tmp_path, series(np.eye(3)), place_it=False)
    with pytest.raises(GeometryError, match="spacing="):
        formats.read(tmp_path)
    assert formats.read(tmp_path, spacing=(1, 1, 2)).spacing == (1, 1, 2)


def test_dicom_with_two_series(tmp_path: Path) -> None:
    write_series(tmp_path, series(), "1.2.3")
    write_series(tmp_path, replace(series(), data=series().data + 1), "1.2.4")
    with pytest.raises(DataError, match=r"2 series: 0: 1\.2\.3\S* \(CT, 6 files\), 1: 1\.2\.4.*choose one by series="):
        formats.read(tmp_path)
    listed = formats.series_of(tmp_path)
    assert [(one.id[:5], one.text) for one in listed] == [("1.2.3", "CT, 6 files"), ("1.2.4", "CT, 6 files")]
    for number, one in enumerate(listed):
        for choice in (one.id, number, str(number)):
            assert int(formats.read(tmp_path, series=choice).data[0, 0, 0]) == number
    for wrong in ("7", 2, -1, True):
        with pytest.raises(OptionError, match="series must be"):
            formats.read(tmp_path, series=wrong)


def test_folder_without_dicom(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    need(".mha")
    (tmp_path / "notes.txt").write_text("nothing here")
    (tmp_path / "below").mkdir()
    with pytest.raises(FormatError, match=r"must hold DICOM files.*this one holds"):
        formats.read(tmp_path)
    assert capfd.readouterr().err == ""


# -- real scans ------------------------------------------------------------------------------


def scan(name: str) -> Path:
    if not (DATA / name).exists():
        pytest.skip(f"no {name}: set CLVOL_DATA to the folder that holds it")
    pytest.importorskip("SimpleITK")
    return DATA / name


def test_tooth() -> None:
    volume = formats.read(scan("tooth.nhdr"))
    assert (volume.size, volume.spacing, volume.data.dtype) == ((103, 94, 161), (1, 1, 1), np.uint16)
    assert volume.value_range == (0, 1300)
    raw = formats.read(scan("tooth.raw"), shape=(161, 94, 103), dtype="uint16", byte_order="big")
    np.testing.assert_array_equal(raw.data, volume.data)


@pytest.mark.parametrize("name", ["mr_head.nii.gz", "bonsai.nii.gz", "stroke_t1.nii.gz"])
def test_brains_and_trees(name: str) -> None:
    nibabel = pytest.importorskip("nibabel")
    volume, image = formats.read(scan(name)), nibabel.load(scan(name))
    other = Volume(image)
    np.testing.assert_array_equal(volume.data[::7, ::7, ::7], other.data[::7, ::7, ::7])
    np.testing.assert_allclose(volume.corners, other.corners, rtol=1e-12)
    np.testing.assert_allclose(volume.spacing, other.spacing, rtol=1e-12)
    if name.startswith("bonsai"):
        assert (volume.shape, volume.data.dtype) == ((256, 256, 256), np.uint8)


def test_heart(tmp_path: Path) -> None:
    with tarfile.open(scan("mr_series_dicom.tar.xz")) as archive:
        archive.extractall(tmp_path, filter="data")
    volume = formats.read(next(p for p in tmp_path.iterdir() if p.is_dir()))
    assert (volume.size, volume.data.dtype) == ((640, 640, 44), np.uint16)
    np.testing.assert_allclose(volume.spacing, (0.625, 0.625, 2.5), rtol=1e-12)
    np.testing.assert_allclose(volume.origin, (-156.4164658003, -199.99999995898, -17.120460510254), rtol=1e-12)


# -- damaged files: all of them in one other process, which must live to tell ------------------------

CHILD = """
import json, sys
from pathlib import Path
from clvol import formats
from clvol.base.errors import ClvolError

try:
    import resource
    resource.setrlimit(resource.RLIMIT_AS, (6 << 30, 6 << 30))
except ImportError:
    pass
for path in sorted(Path(sys.argv[1]).iterdir()):
    print(json.dumps([path.name, "died", ""]), flush=True)
    try:
        volume = formats.read(path)
        outcome = ["read", volume.data.tolist()]
    except ClvolError as error:
        outcome = [type(error).__name__, str(error)]
    except BaseException as error:
        outcome = ["escaped", repr(error)]
    print(json.dumps([path.name, *outcome]), flush=True)
"""

Outcomes = dict[str, tuple[str, Any]]


def read_elsewhere(folder: Path, timeout: float = 240) -> Outcomes:
    """The outcome of reading each file of `folder`; "died" for the one that crashed the process."""
    run = subprocess.run([sys.executable, "-c", CHILD, str(folder)], capture_output=True, text=True, timeout=timeout, check=False)
    outcomes: Outcomes = {}
    for text in run.stdout.splitlines():
        name, kind, detail = json.loads(text)
        outcomes[name] = (kind, detail)
    assert outcomes, run.stderr
    return outcomes


MHA = """\
ObjectType = Image
NDims = 3
BinaryData = True
BinaryDataByteOrderMSB = False
ElementSpacing = 1 1 1
DimSize = 4 3 2
ElementType = MET_UCHAR
ElementDataFile = LOCAL
"""
NRRD = "NRRD0004\ntype: uchar\ndimension: 3\nsizes: 4 3 2\nencoding: raw\n"
BYTES = bytes(range(24))


def nifti(**fields: tuple[int, str, Any]) -> bytes:
    """A NIfTI file of 4×3×2 int16, with fields written at byte offsets."""
    head = bytearray(352)
    sound: dict[str, tuple[int, str, Any]] = {
        "length": (0, "i", (348,)),
        "dim": (40, "8h", (3, 4, 3, 2, 1, 1, 1, 1)),
        "type": (70, "2h", (4, 16)),
        "pixdim": (76, "8f", (1,) * 8),
        "start": (108, "f", (352,)),
        "magic": (344, "4s", (b"n+1\0",)),
    }
    for offset, kind, values in (sound | fields).values():
        struct.pack_into("<" + kind, head, offset, *values)
    return bytes(head) + np.arange(24, dtype="<i2").tobytes()


def mha(old: str = "", new: str = "", data: bytes = BYTES) -> bytes:
    assert old in MHA
    return MHA.replace(old, new, 1).encode() + data


def packed_mha(data: bytes, size: int | None = None) -> bytes:
    fields = f"CompressedData = True\nCompressedDataSize = {len(data) if size is None else size}\nNDims"
    return mha("NDims", fields, data)


DAMAGED: dict[str, tuple[bytes, str]] = {
    # crashes of SimpleITK 2.5
    "ndims-99.mha": (mha("NDims = 3", "NDims = 99"), "NDims = 99"),
    "ndims-minus-1.mha": (mha("NDims = 3", "NDims = -1"), "NDims = -1"),
    "ndims-2e9.mha": (mha("NDims = 3", "NDims = 2000000000"), "NDims = 2000000000"),
    "format-string.mhd": (mha("LOCAL", "%s%n"), "FIRST LAST STEP"),
    "format-string-range.mhd": (mha("LOCAL", "%s%n%s%n 1 2 1"), "FIRST LAST STEP"),
    "line-of-5-mb.nrrd": (f"{NRRD}content: {'a' * 5_000_000}\n\n".encode() + BYTES, "lines up to"),
    "unknown-field-of-3000.nrrd": (f"{NRRD}{'A' * 3000}: 1\n\n".encode() + BYTES, "up to 500 bytes"),
    "wrong-field-of-3000.nrrd": (f"{NRRD}space: {'é' * 400}\n\n".encode() + BYTES, "up to 500 bytes"),
    # hangs
    "line-skip-2e9.nrrd": (f"{NRRD}line skip: 2000000000\n\n".encode() + BYTES, "2000000000 lines"),
    "data-from-the-terminal.nhdr": (f"{NRRD}data file: -\n".encode(), "must name a file"),
    "data-from-a-device.nhdr": (f"{NRRD}data file: /dev/zero\n".encode(), "not there"),
    # zero-filled
    "truncated.nii": (nifti()[:-10], "48 bytes.*found 38"),
    "truncated.nii.gz": (gzip.compress(nifti())[:-20], "end-of-stream"),
    "truncated-inside.nii.gz": (gzip.compress(nifti()[:-10]), "48 bytes.*found 38"),
    "start-past-the-end.nii": (nifti(start=(108, "f", (1e9,))), "48 bytes"),
    "flipped-checksum.nii.gz": (gzip.compress(nifti())[:-8] + bytes(8), "CRC"),
    # truncated or beyond any memory
    "truncated.mha": (mha(data=BYTES[:10]), "24 bytes.*found 10"),
    "truncated.nrrd": (f"{NRRD}\n".encode() + BYTES[:10], "24 bytes.*found 10"),
    "truncated-gzip.nrrd": (f"{NRRD}\n".replace("raw", "gzip").encode() + gzip.compress(BYTES[:20]), "24 bytes.*found 20"),
    "truncated-zlib.mha": (packed_mha(zlib.compress(BYTES)[:-8]), "too early"),
    "short-zlib.mha": (packed_mha(zlib.compress(BYTES[:9])), "24 bytes.*found 9"),
    "long-zlib.mha": (packed_mha(zlib.compress(BYTES * 9)), "24 bytes.*found 216"),
    "no-packed-size.mha": (mha("NDims", "CompressedData = True\nNDims", zlib.compress(BYTES)), "CompressedDataSize"),
    "packed-size-short.mha": (packed_mha(zlib.compress(BYTES), 9), "9 compressed bytes"),
    "packed-size-long.mha": (packed_mha(zlib.compress(BYTES), 999), "999 compressed bytes"),
    "packed-by-nobody.mha": (packed_mha(b"x" + zlib.compress(BYTES)), "header check"),
    "huge.mha": (mha("4 3 2", "400000 300000 200000"), "24000000000000000 bytes"),
    "huge.nrrd": (f"{NRRD}\n".replace("4 3 2", "400000 300000 200000").encode() + BYTES, "24000000000000000 bytes"),
    "huge.nii": (nifti(dim=(40, "8h", (3, 32767, 32767, 32767, 1, 1, 1, 1))), "70362301923326 bytes"),
    # nonsense
    "empty.mha": (b"", "end of the file"),
    "empty.nrrd": (b"", "NRRD0001"),
    "empty.nii": (b"", "348 bytes"),
    "empty.nii.gz": (b"", "348 bytes"),
    "empty.npy": (b"", "cannot read"),
    "empty.npz": (b"", "cannot read"),
    "empty.tif": (b"", "as a TIFF or BigTIFF file does"),
    "text.tif": (b"this is not a picture", "as a TIFF or BigTIFF file does"),
    "text.npy": (b"this is not an array!", "cannot read"),
    "text.nii.gz": (b"this is not packed", "cannot read"),
    "zeros.mha": (bytes(500), "byte 0"),
    "missing-data.mhd": (mha("LOCAL", "gone.raw"), "gone.raw.*not there"),
    "missing-data.nhdr": (f"{NRRD}data file: gone.raw\n".encode(), "gone.raw.*not there"),
    "data-list.mhd": (mha("LOCAL", "LIST"), "text header"),
    "no-size.mha": (mha("DimSize = 4 3 2\n", ""), "'DimSize'"),
    "size-0.mha": (mha("4 3 2", "4 0 2"), "at least 1"),
    "size-short.mha": (mha("4 3 2", "4 3"), "3 whole numbers"),
    "size-words.mha": (mha("4 3 2", "four three two"), "3 whole numbers"),
    "size-of-100-digits.mha": (mha("4 3 2", f"{'9' * 100} 3 2"), "at least 1"),
    "spacing-short.mha": (mha("1 1 1", "1 1"), "3 finite numbers"),
    "spacing-nan.mha": (mha("1 1 1", "1 nan 1"), "finite"),
    "twice.mha": (mha("NDims = 3", "NDims = 3\nNDims = 2"), "twice"),
    "type.mha": (mha("MET_UCHAR", "MET_STRING"), "MET_STRING"),
    "samples-in-the-header.mha": (mha("NDims", "HeaderSize = 5\nNDims"), "inside its header"),
    "ascii.mha": (mha("BinaryData = True", "BinaryData = False"), "numbers of uint8 in its text"),
    "channels.mha": (mha("NDims", "ElementNumberOfChannels = 3\nNDims"), "72 bytes.*found 24"),
    "channels-0.mha": (mha("NDims", "ElementNumberOfChannels = 0\nNDims"), "at least 1"),
    "dimension-17.nrrd": (NRRD.replace("3\nsizes", "17\nsizes").encode() + b"\n" + BYTES, "dimension: 17"),
    "type.nrrd": (NRRD.replace("uchar", "block").encode() + b"\n" + BYTES, "'block'"),
    "bzip2.nrrd": (NRRD.replace("raw", "bzip2").encode() + b"\n" + bz2.compress(BYTES), "bzip2"),
    "skip-minus-9.nrrd": (f"{NRRD}byte skip: -9\n\n".encode() + BYTES, "at least -1"),
    "units.nrrd": (f'{NRRD}units: "mm" "mm" "s"\n\n'.encode() + BYTES, "one unit"),
    "nifti-2.nii": (nifti(length=(0, "i", (540,))), "540 bytes; found 400"),
    "pair.nii": (nifti(magic=(344, "4s", (b"ni1\0",))), "n\\+1"),
    "pair.hdr": (nifti(magic=(344, "4s", (b"ni1\0",))), "pair.img beside it"),
    "analyze.img": (bytes(24), "analyze.hdr beside it"),
    "truncated-series.nii": (nifti(dim=(40, "8h", (4, 4, 3, 2, 5, 1, 1, 1))), "240 bytes.*found 48"),
    "truncated-series.nii.gz": (gzip.compress(nifti(dim=(40, "8h", (4, 4, 3, 2, -5, 1, 1, 1)))), "at least one sample"),
    "dim-0.nii": (nifti(dim=(40, "8h", (9, 4, 3, 2, 1, 1, 1, 1))), "9 axes"),
    "dim-minus.nii": (nifti(dim=(40, "8h", (3, 4, -3, 2, 1, 1, 1, 1))), "at least one sample"),
    "rgb.nii": (nifti(type=(70, "2h", (128, 24))), "72 bytes.*found 48"),
    "complex.nii": (nifti(type=(70, "2h", (32, 64))), "datatype 32"),
    "text.dcm": (b"this is not a picture", "cannot read"),
    "empty.dcm": (b"", "cannot read"),
    "empty.mgz": (b"", "284 bytes; found 0"),
    "zeros.mgh": (bytes(284), "at least one sample"),
    "start-nan.nii": (nifti(start=(108, "f", (float("nan"),))), "where its samples begin"),
    "start-minus.nii": (nifti(start=(108, "f", (-5,))), "where its samples begin"),
    "placed-nowhere.nii": (nifti(code=(254, "h", (1,)), rows=(280, "4f", (1, float("inf"), 0, 0))), "finite"),
    "ifd-loop.tif": (
        b"II*\0\x08\0\0\0" + struct.pack("<H", 1) + struct.pack("<HHIHH", 256, 3, 1, 4, 0) + struct.pack("<I", 8),
        "one at 8 is reached twice",
    ),
}


@pytest.fixture(scope="module")
def damaged(tmp_path_factory: pytest.TempPathFactory) -> Outcomes:
    pytest.importorskip("SimpleITK")
    pytest.importorskip("tifffile")
    folder = tmp_path_factory.mktemp("damaged")
    for name, (content, _) in DAMAGED.items():
        (folder / name).write_bytes(content)
    return read_elsewhere(folder)


@pytest.mark.parametrize("name", DAMAGED)
def test_damaged_files_raise(damaged: Outcomes, name: str) -> None:
    assert name in damaged, f"the process ended before, at {list(damaged)[-1]}"
    kind, message = damaged[name]
    assert kind in ("FormatError", "DataError"), (kind, message)
    assert re.search(DAMAGED[name][1], message), message


def test_the_valid_originals_are_read(tmp_path: Path) -> None:
    """The originals of the damaged files; otherwise the test above would prove nothing."""
    need(".mha")
    sound = {"a.mha": mha(), "a.nrrd": f"{NRRD}\n".encode() + BYTES, "a.nii": nifti()}
    sound["a.nii.gz"] = gzip.compress(nifti())
    sound["packed.nrrd"] = f"{NRRD}\n".replace("raw", "gzip").encode() + gzip.compress(BYTES)
    sound["packed.mha"] = packed_mha(zlib.compress(BYTES))
    for name, content in sound.items():
        (tmp_path / name).write_bytes(content)
        np.testing.assert_array_equal(formats.read(tmp_path / name).data.ravel(), np.arange(24))


@pytest.fixture(scope="module")
def originals(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """One small valid file of each single-file format."""
    pytest.importorskip("SimpleITK")
    pytest.importorskip("tifffile")
    folder = tmp_path_factory.mktemp("originals")
    files = {}
    for suffix in WRITTEN:
        if suffix not in (".nhdr", ".mhd", ".tiff"):
            formats.write(place(suffix, samples("uint16")), folder / f"v{suffix}")
            files[suffix] = (folder / f"v{suffix}").read_bytes()
    return files


def test_every_truncation_raises(tmp_path: Path, originals: dict[str, bytes]) -> None:
    for suffix, content in originals.items():
        step = 7 if len(content) > 300 else 1
        for keep in {*range(0, len(content), step), *range(max(0, len(content) - 60), len(content))}:
            (tmp_path / f"{keep:05}{suffix}").write_bytes(content[:keep])
    outcomes = read_elsewhere(tmp_path)
    assert len(outcomes) == len(list(tmp_path.iterdir())), list(outcomes)[-1]
    wrong = {name: kind for name, (kind, _) in outcomes.items() if kind not in ("FormatError", "DataError")}
    assert wrong == {}


def test_no_flipped_byte_crashes_the_process(tmp_path: Path, originals: dict[str, bytes]) -> None:
    dice = random.Random(20)
    for suffix, content in originals.items():
        plain = gzip.decompress(content) if suffix == ".nii.gz" else content
        for k in range(30):  # tests.fuzz goes on
            flipped = bytearray(plain)
            for _ in range(dice.choice([1, 1, 2, 5])):
                flipped[dice.randrange(len(flipped))] = dice.randrange(256)
            changed = gzip.compress(flipped) if suffix == ".nii.gz" else bytes(flipped)
            (tmp_path / f"{k:03}{suffix}").write_bytes(changed)
    outcomes = read_elsewhere(tmp_path)
    assert len(outcomes) == len(list(tmp_path.iterdir())), list(outcomes)[-1]
    wrong = {name: kind for name, (kind, _) in outcomes.items() if kind in ("died", "escaped")}
    assert wrong == {}


# -- writing safely --------------------------------------------------------------------------

FULL_DISK = """
import resource, sys
from pathlib import Path
import numpy as np
from clvol import formats
from clvol.base.errors import FormatError

path = Path(sys.argv[1])
formats.write(np.zeros((2, 2, 2), np.float32), path)
before = {file.name: file.read_bytes() for file in path.parent.iterdir()}
large = np.random.default_rng(0).random((24, 32, 32)).astype(np.float32)
resource.setrlimit(resource.RLIMIT_FSIZE, (3000, resource.RLIM_INFINITY))
try:
    formats.write(large, path)
except FormatError as error:
    print("refused")
assert {file.name: file.read_bytes() for file in path.parent.iterdir()} == before
"""


@pytest.mark.skipif(sys.platform == "win32", reason="limits of the file size are set by POSIX calls")
def test_a_full_disk_leaves_the_old_file(tmp_path: Path) -> None:
    """ITK does not detect that NIfTI files were truncated."""
    need(".mha")
    need(".tif")
    runs = []
    for suffix in WRITTEN[:-1]:
        (tmp_path / suffix).mkdir()
        runs.append((suffix, [sys.executable, "-c", FULL_DISK, str(tmp_path / suffix / f"v{suffix}")]))
    for suffix, command in runs:
        run = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
        assert (run.returncode, run.stdout) == (0, "refused\n"), (suffix, run.stderr)


def test_an_interrupt_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(stream: Any, *_: object, **__: object) -> None:
        stream.write(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(np, "save", interrupted)
    with pytest.raises(KeyboardInterrupt):
        formats.write(samples("u1"), tmp_path / "v.npy")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", WRITTEN)
def test_overwriting(tmp_path: Path, suffix: str) -> None:
    need(suffix)
    path = tmp_path / f"v{suffix}"
    formats.write(place(suffix, samples("int16", (5, 6, 7))), path)
    formats.write(place(suffix, samples("uint8")), path)
    assert_same(formats.read(path), place(suffix, samples("uint8")), suffix)


def test_samples_of_another_header_are_not_overwritten(tmp_path: Path) -> None:
    """The pair v.nhdr and v.mhd would share v.raw, and the older one would become wrong."""
    need(".nhdr")
    formats.write(samples("uint16"), tmp_path / "v.nhdr")
    before = {file.name: file.read_bytes() for file in tmp_path.iterdir()}
    with pytest.raises(FormatError, match="choose another name"):
        formats.write(samples("uint8"), tmp_path / "v.mhd")
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == before


@pytest.mark.skipif(sys.platform == "win32", reason="links need rights there")
def test_links_and_permissions(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "link.npy").symlink_to(tmp_path / "real" / "v.npy")
    formats.write(samples("u1"), tmp_path / "link.npy")
    assert (tmp_path / "link.npy").is_symlink()
    mask = os.umask(0)
    os.umask(mask)
    assert (tmp_path / "real" / "v.npy").stat().st_mode & 0o777 == 0o666 & ~mask


@pytest.mark.parametrize("suffix", ITK)
def test_medical_formats_reject_other_units(tmp_path: Path, suffix: str) -> None:
    need(suffix)
    with pytest.raises(FormatError, match="measures in mm"):
        formats.write(Volume(samples("u1"), units="um"), tmp_path / f"v{suffix}")
    formats.write(Volume(samples("u1")), tmp_path / f"v{suffix}")  # no unit: treated as mm, as in every reader
    assert formats.read(tmp_path / f"v{suffix}").units == "mm"
    assert not [file for file in tmp_path.iterdir() if file.name.startswith(".clvol")]


def test_nrrd_units_are_read(tmp_path: Path) -> None:
    need(".nrrd")
    (tmp_path / "v.nrrd").write_bytes(f'{NRRD}units: "um" "um" "um"\n\n'.encode() + BYTES)
    assert formats.read(tmp_path / "v.nrrd").units == "um"


@pytest.mark.parametrize("line", ["spacings: 1 1 nan", "space: LPS\nspace directions: (1,0,0) none (0,0,1)"])
def test_nrrd_with_unknown_spacing(tmp_path: Path, line: str) -> None:
    need(".nrrd")
    (tmp_path / "v.nrrd").write_bytes(f"{NRRD}{line}\n\n".encode() + BYTES)
    with pytest.raises(GeometryError, match=r"its header must say how far apart .*; it says nan or none; spacing="):
        formats.read(tmp_path / "v.nrrd")
    assert formats.read(tmp_path / "v.nrrd", spacing=(1, 1, 2)).spacing == (1, 1, 2)


@pytest.mark.parametrize(
    "volume",
    [
        Volume(samples("u1"), direction=[[1, 0.6, 0], [0, 0.8, 0], [0, 0, 1]]),
        Volume(samples("u1"), spacing=(1e39, 1, 1)),
        Volume(samples("longdouble")),
    ],
    ids=["sheared", "beyond float32", "long double"],
)
def test_nifti_rejects_volumes_that_it_cannot_store(tmp_path: Path, volume: Volume) -> None:
    need(".nii")
    if volume.data.dtype == np.float64:
        pytest.skip("long double is double here")
    with pytest.raises(FormatError):
        formats.write(volume, tmp_path / "v.nii")
    assert list(tmp_path.iterdir()) == []


# -- finding the format, and errors of the caller ---------------------------------------------------


def test_overrides(tmp_path: Path) -> None:
    formats.write(Volume(samples("u1"), units="mm"), tmp_path / "v.npz")
    read = formats.read(tmp_path / "v.npz", spacing=(1, 2, 3), origin=(4, 5, 6), direction=OBLIQUE)
    assert (read.spacing, read.origin, read.units) == ((1, 2, 3), (4, 5, 6), "mm")
    np.testing.assert_array_equal(read.direction, OBLIQUE)
    with pytest.raises(GeometryError, match=r"v\.npz.*positive"):
        formats.read(tmp_path / "v.npz", spacing=(1, 2, 0))


@pytest.mark.parametrize(
    "option", [{"shape": (2, 3, 4)}, {"dtype": "u1"}, {"byte_order": "big"}, {"offset": 4}, {"series": "1"}], ids=str
)
def test_options_of_other_formats(tmp_path: Path, option: dict[str, Any]) -> None:
    formats.write(samples("u1"), tmp_path / "v.npy")
    with pytest.raises(OptionError, match=f"{next(iter(option))} is only for: .*(raw samples|DICOM)"):
        formats.read(tmp_path / "v.npy", **option)


@pytest.mark.parametrize("name", ["v.doc", "v", "v.gz", "v.nii.bz2", "nii"])
def test_unknown_suffix(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"x")
    for call in (lambda: formats.read(tmp_path / name), lambda: formats.write(samples("u1"), tmp_path / name)):
        with pytest.raises(FormatError, match=r"\.npy.*\.nii\.gz"):
            call()


@pytest.mark.parametrize("suffix", [*WRITTEN, ".raw", ""])
def test_missing_file(tmp_path: Path, suffix: str) -> None:
    with pytest.raises(FormatError, match="no such file") as caught:
        formats.read(tmp_path / f"gone{suffix}")
    assert isinstance(caught.value, OSError)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes with names are POSIX")
def test_a_pipe_does_not_block(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "v.npy")
    with pytest.raises(FormatError, match="neither a file nor a folder"):
        formats.read(tmp_path / "v.npy")


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may read and write anything")
def test_unreadable_and_unwritable(tmp_path: Path) -> None:
    formats.write(samples("u1"), tmp_path / "v.npy")
    (tmp_path / "v.npy").chmod(0)
    with pytest.raises(FormatError, match="cannot read"):
        formats.read(tmp_path / "v.npy")
    tmp_path.chmod(0o500)
    with pytest.raises(FormatError, match="cannot write"):
        formats.write(samples("u1"), tmp_path / "w.npy")
    tmp_path.chmod(0o700)


def test_unwritable_targets(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="does not exist"):
        formats.write(samples("u1"), tmp_path / "gone" / "v.npy")
    (tmp_path / "v.npy").mkdir()
    with pytest.raises(FormatError, match="it is a folder"):
        formats.write(samples("u1"), tmp_path / "v.npy")


@pytest.mark.parametrize(
    ("module", "suffix", "extra"),
    [("nibabel" if suffix.startswith(".nii") else "SimpleITK", suffix, "medical") for suffix in ITK]
    + [("tifffile", ".tif", "microscopy")],
)
def test_missing_extras(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str, suffix: str, extra: str) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    contents = {".nii": nifti(), ".nii.gz": gzip.compress(nifti()), ".tif": b""}
    text = {".mha": mha(), ".nrrd": f"{NRRD}\n".encode() + BYTES}
    text[".mhd"], text[".nhdr"] = mha("LOCAL", "d.raw"), f"{NRRD}data file: d.raw\n".encode()
    (tmp_path / "d.raw").write_bytes(BYTES)
    (tmp_path / f"v{suffix}").write_bytes((contents | text)[suffix])
    if suffix.startswith(".nii"):  # read without any
        np.testing.assert_array_equal(formats.read(tmp_path / f"v{suffix}").data.ravel(), np.arange(24))
    else:
        with pytest.raises(MissingDependencyError, match=rf'pip install "clvol\[{extra}\]"'):
            formats.read(tmp_path / f"v{suffix}", trusted=True)
    with pytest.raises(MissingDependencyError, match=rf'pip install "clvol\[{extra}\]"'):
        formats.write(samples("u1"), tmp_path / f"w{suffix}")
    if module == "SimpleITK":
        monkeypatch.setitem(sys.modules, "pydicom", None)
        (tmp_path / "v.dcm").write_bytes(bytes(128) + b"DICM")
        with pytest.raises(MissingDependencyError):
            formats.read(tmp_path, trusted=True)


def test_importing_formats_imports_no_extra() -> None:
    code = "import sys, clvol.formats; print([m for m in ('SimpleITK', 'pydicom', 'tifffile', 'pyopencl') if m in sys.modules])"
    run = subprocess.run([sys.executable, "-c", textwrap.dedent(code)], capture_output=True, text=True, check=True)
    assert run.stdout == "[]\n"


def test_the_table() -> None:
    suffixes = list(itertools.chain.from_iterable(row.suffixes for row in formats.FORMATS))
    for suffix in set(suffixes):  # of several formats, what a file holds decides
        rows = [row for row in formats.FORMATS if suffix in row.suffixes]
        assert sum(row.file is None for row in rows) <= 1
    assert all(suffix == suffix.lower() and suffix.startswith(".") for suffix in suffixes)
    assert all(row.suffixes or row.folder for row in formats.FORMATS)


@pytest.mark.parametrize("path", [3, None, b"a.npy", "a\0.npy", ["a.npy"]], ids=repr)
def test_arguments_that_are_not_paths_are_rejected(path: object) -> None:
    with pytest.raises(OptionError, match="path must be"):
        formats.read(path)  # type: ignore[arg-type]
    with pytest.raises(OptionError, match="path must be"):
        formats.write(np.zeros((2, 2)), path)  # type: ignore[arg-type]


def test_a_name_that_the_system_rejects() -> None:
    with pytest.raises(FormatError):
        formats.read("a" * 9999 + ".npy")
    with pytest.raises(FormatError):
        formats.write(np.zeros((2, 2)), "a" * 9999 + ".npy")
