"""HDF5 files written by h5py, xarray (as netCDF) and ITK."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clvol
from clvol import ClvolWarning, formats
from clvol.base.errors import ClvolError, DataError, FormatError, GeometryError, MissingDependencyError, OptionError

h5py = pytest.importorskip("h5py")

DATA = np.arange(2 * 3 * 4 * 5 * 6, dtype=np.float32).reshape(2, 3, 4, 5, 6)


def test_the_only_array(tmp_path: Path) -> None:
    """Tables, strings and scalars do not count, nor do images beside a volume."""
    with h5py.File(tmp_path / "v.h5", "w") as file:
        file["run/3/density"] = DATA[0, 0].astype(">f8")
        file["run/affine"] = np.eye(4)
        file["run/time"] = 0.5
        file["run/steps"] = np.arange(7)
        file["run/names"] = ["a", "b"]
        file["run/table"] = np.zeros((2, 2), [("a", "f4")])
    volume = clvol.read(tmp_path / "v.h5")
    np.testing.assert_array_equal(volume.data, DATA[0, 0])
    assert (volume.name, volume.spacing, volume.space) == ("density", (1, 1, 1), "")
    assert clvol.read(tmp_path / "v.h5", series="run/affine").shape == (4, 4)
    assert [(one.id, one.shape) for one in formats.series_of(tmp_path / "v.h5")] == [
        ("run/3/density", (4, 5, 6)),
        ("run/affine", (4, 4)),
    ]


def test_several_arrays_are_listed(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "v.hdf5", "w") as file:
        file["u"], file["v"], file["none"] = DATA[0, 0], DATA[0, 1], np.zeros((0, 3, 3))
    with pytest.raises(DataError, match=r"v\.hdf5 holds 2 arrays: 0: u \(float32, 4 × 5 × 6\), 1: v .*choose one by series="):
        clvol.read(tmp_path / "v.hdf5")
    np.testing.assert_array_equal(clvol.read(tmp_path / "v.hdf5", series="v").data, DATA[0, 1])
    np.testing.assert_array_equal(clvol.read(tmp_path / "v.hdf5", series=0).data, DATA[0, 0])


def test_axes_without_names_are_guessed(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "v.h5", "w") as file:
        file["a"] = DATA
    with pytest.warns(ClvolWarning, match=r"2 times × 3 channels.*taken for time \(2\), channel \(3\), z \(4\)"):
        clvol.read(tmp_path / "v.h5")
    with warnings.catch_warnings(action="ignore"):
        np.testing.assert_array_equal(np.asarray(clvol.read_all(tmp_path / "v.h5", channel=2)), DATA[:, 2])
    with h5py.File(tmp_path / "w.h5", "w") as file:
        file["a"] = DATA[None, None, None].repeat(2, 0).repeat(2, 1).repeat(2, 2)
    with pytest.raises(DataError, match="times, positions and channels of these"):
        clvol.read(tmp_path / "w.h5")


def test_choosing_a_time_names_the_first_axis(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "v.h5", "w") as file:
        file["a"] = DATA[0, 0]
    np.testing.assert_array_equal(clvol.read(tmp_path / "v.h5", time=3).data, DATA[0, 0, 3])
    with pytest.raises(OptionError, match="channel must be 0 to 3"):
        clvol.read(tmp_path / "v.h5", channel=4)


def test_a_short_last_axis_without_a_name_holds_channels(tmp_path: Path) -> None:
    flow = np.random.default_rng(4).normal(size=(5, 6, 7, 3))
    colours = np.random.default_rng(4).integers(0, 255, (6, 7, 3), np.uint8)
    for name, data in (("flow", flow), ("colours", colours), ("slab", flow[0])):
        with h5py.File(tmp_path / f"{name}.h5", "w") as file:
            file["a"] = data
    with pytest.warns(ClvolWarning, match=r"taken for z \(5\), y \(6\), x \(7\), channel \(3\)"):
        np.testing.assert_allclose(clvol.read(tmp_path / "flow.h5").data, np.linalg.norm(flow, axis=-1))
    with pytest.warns(ClvolWarning, match=r"taken for y \(6\), x \(7\), channel \(3\)"):
        np.testing.assert_array_equal(clvol.read(tmp_path / "colours.h5", channel="red").data, colours[..., 0])
    np.testing.assert_array_equal(clvol.read(tmp_path / "slab.h5").data, flow[0])


@pytest.mark.parametrize("said", ["axistags", "axes", "labels"])
def test_names_of_axes(tmp_path: Path, said: str) -> None:
    """In any order: here x, y, z, channels, times."""
    with h5py.File(tmp_path / "v.h5", "w") as file:
        array = file.create_dataset("a", data=DATA.transpose(4, 3, 2, 1, 0))
        if said == "axistags":
            keys = ", ".join(f'{{"key": "{key}", "typeFlags": 2, "resolution": {step}, "description": ""}}' for key, step in TAGS)
            array.attrs["axistags"] = f'{{"axes": [{keys}]}}'
        elif said == "axes":
            array.attrs["axes"] = "xyzct"
        else:
            for dimension, label in zip(array.dims, ("x", "y", "z", "channel", "time"), strict=True):
                dimension.label = label
    volume = clvol.read(tmp_path / "v.h5", time=1, channel=2)
    np.testing.assert_array_equal(volume.data, DATA[1, 2])
    assert volume.spacing == ((0.5, 0.25, 2.0) if said == "axistags" else (1, 1, 1))
    np.testing.assert_array_equal(np.asarray(clvol.read_all(tmp_path / "v.h5")), DATA.swapaxes(0, 1))


TAGS = (("x", 0.5), ("y", 0.25), ("z", 2.0), ("c", 0), ("t", 0))


def test_spacing_of_fiji(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "v.h5", "w") as file:
        file["t0/channel0"] = DATA[0, 0]
        file["t0/channel0"].attrs["element_size_um"] = (2.0, 0.5, 0.25)
    volume = clvol.read(tmp_path / "v.h5")
    assert (volume.spacing, volume.units, volume.space) == ((0.25, 0.5, 2.0), "um", "image")


def test_dimension_scales(tmp_path: Path) -> None:
    """As in netCDF-4; descending ones flip the axis, uneven ones leave the spacing to the caller."""
    with h5py.File(tmp_path / "v.nc", "w") as file:
        array = file.create_dataset("t", data=DATA[:, 0].astype(np.int16))
        array.attrs["scale_factor"], array.attrs["add_offset"], array.attrs["_FillValue"] = 0.5, 10.0, np.int16(7)
        values = {"time": [0.0, 4], "level": [1.0, 2, 3, 4], "lat": [50.0, 40, 30, 20, 10], "lon": [0.0, 20, 40, 60, 80, 100]}
        for i, (name, positions) in enumerate(values.items()):
            file[name] = np.array(positions)
            file[name].make_scale(name)
            array.dims[i].attach_scale(file[name])
    volume = clvol.read(tmp_path / "v.nc", time=0)
    expected = DATA[0, 0] * 0.5 + 10
    expected.flat[7] = np.nan
    np.testing.assert_array_equal(volume.data, expected)
    np.testing.assert_allclose(volume.index_to_world([[0, 0, 0], [1, 2, 3]]), [[0, 50, 1], [20, 30, 4]])
    with h5py.File(tmp_path / "v.nc", "a") as file:
        file["level"][:] = [1, 2, 4, 8]
    expected = "coordinates along z must be evenly spaced.*they lie 1 to 4 apart, as 4 and 8 at indices 2 and 3 do; spacing="
    for call in (clvol.read, clvol.open):
        with pytest.raises(GeometryError, match=expected):
            call(tmp_path / "v.nc", time=0)
        assert call(tmp_path / "v.nc", time=0, spacing=(1, 2, 3)).spacing == (1, 2, 3)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ([1.0, 2, 2, 3], "they lie 0 to 1 apart, as 2 and 2 at indices 1 and 2 do"),
        ([1.0, np.nan, 3, 4], "coordinates along z must be finite; that at index 1 is not"),
        ([5, 5, 5, 5], "they lie 0 to 0 apart"),
        (np.array([b"a", b"b", b"c", b"d"]), "coordinates along z must be numbers; they are"),
    ],
)
def test_coordinates_that_give_no_spacing(tmp_path: Path, values: Any, message: str) -> None:
    with h5py.File(tmp_path / "v.nc", "w") as file:
        file["t"], file["z"] = DATA[0, 0, :, :, :][: len(values)], values
        file["z"].make_scale("z")
        file["t"].dims[0].attach_scale(file["z"])
    with pytest.raises(GeometryError, match=message):
        clvol.read(tmp_path / "v.nc")


def test_spacings_that_are_none(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "v.h5", "w") as file:
        group = file.create_group("ITKImage/0")
        group["VoxelData"], group["Origin"], group["Directions"] = DATA[0, 0], np.zeros(3), np.eye(3)
        group["Spacing"] = [np.nan, 1, 1]
    np.savez(tmp_path / "v.npz", data=DATA[0, 0], spacing=[1, 0, np.nan])
    for name, said in (
        ("v.h5", r"its Spacing must be .*; found \[nan, 1\.0"),
        ("v.npz", r"member spacing must be .*; found \[1\.0, 0"),
    ):
        with pytest.raises(GeometryError, match=said):
            clvol.read(tmp_path / name)
        assert clvol.read(tmp_path / name, spacing=(1, 2, 3)).spacing == (1, 2, 3)


def test_packed_coordinates(tmp_path: Path) -> None:
    """As by xarray, which decodes coordinates as it does samples."""
    with h5py.File(tmp_path / "v.nc", "w") as file:
        file["t"], file["z"] = DATA[0, 0], np.arange(DATA.shape[2], dtype=np.int16)
        file["z"].make_scale("z")
        file["z"].attrs.update({"scale_factor": 0.5, "add_offset": 10.0})
        file["t"].dims[0].attach_scale(file["z"])
    volume = clvol.read(tmp_path / "v.nc")
    assert (volume.spacing, volume.origin) == ((1, 1, 0.5), (0, 0, 10))


def test_one_coordinate_is_a_place(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "v.nc", "w") as file:
        file["t"], file["z"] = DATA[0, 0, :1], [7.5]
        file["z"].make_scale("z")
        file["t"].dims[0].attach_scale(file["z"])
    volume = clvol.read(tmp_path / "v.nc")
    assert (volume.spacing, volume.origin) == ((1, 1, 1), (0, 0, 7.5))


CODED: dict[str, tuple[str, dict[str, Any]]] = {
    "missing": ("i2", {"missing_value": np.int16(7)}),
    "both": ("f4", {"missing_value": np.float32(7), "_FillValue": np.float32(9)}),
    "two": ("i2", {"missing_value": np.array([7, 9], np.int16), "scale_factor": 0.5}),
    "unsigned": ("i1", {"_Unsigned": "true"}),
    "unsigned and missing": ("i1", {"_Unsigned": "true", "_FillValue": np.int8(-2), "add_offset": 100.0}),
    "signed": ("u1", {"_Unsigned": "false", "_FillValue": np.uint8(254)}),
}


def coded(path: Path, dtype: str, attributes: dict[str, Any]) -> np.ndarray:
    stored = (np.arange(120) - 60).astype(np.int8).astype(dtype).reshape(4, 5, 6)
    with h5py.File(path, "w") as file:
        file["t"] = stored
        file["t"].attrs.update(attributes)
    return stored


def both_ways(path: Path) -> np.ndarray:
    """The samples of a file, which `open` reads alike, but for the missing ones."""
    data = np.asarray(clvol.read(path).data)
    part = clvol.open(path, missing=-1e9).read((0, 0, 0), (6, 5, 4))
    np.testing.assert_array_equal(part.data, np.nan_to_num(data, nan=-1e9))
    return data


@pytest.mark.filterwarnings("ignore:.*multiple fill values")
@pytest.mark.parametrize("name", CODED)
def test_codes_of_netcdf(tmp_path: Path, name: str) -> None:
    """As xarray decodes them."""
    xarray = pytest.importorskip("xarray")
    stored = coded(tmp_path / "t.nc", *CODED[name])
    expected = xarray.conventions.decode_cf_variable("t", xarray.Variable(("z", "y", "x"), stored, CODED[name][1])).values
    np.testing.assert_array_equal(both_ways(tmp_path / "t.nc"), expected)


@pytest.mark.parametrize(
    ("attributes", "low", "high"),
    [
        ({"valid_range": np.array([-20, 30], np.int16)}, -20, 30),
        ({"valid_min": np.int16(-5)}, -5, 99),
        ({"valid_max": np.int16(9)}, -99, 9),
        ({"valid_range": [0.5, 3.5]}, -99, 99),
    ],
)
def test_the_valid_range_of_netcdf(tmp_path: Path, attributes: dict[str, Any], low: int, high: int) -> None:
    """As netCDF4-python has it: of stored values, and ignored if their type does not hold the limits."""
    stored = coded(tmp_path / "t.nc", "i2", attributes)
    expected = np.where((stored < low) | (stored > high), np.nan, stored)
    np.testing.assert_array_equal(both_ways(tmp_path / "t.nc"), expected)


@pytest.mark.parametrize(
    ("units", "factor", "unit"),
    [
        (("m", "km"), 1e3, "m"),
        (("micrometers", "nm"), 1e-3, "um"),
        (("meters", "mm"), 1e-3, "m"),
        (("nm", "Angstrom"), 0.1, "nm"),
        (("degrees_east", "m"), 1, ""),
    ],
)
def test_units_of_each_axis(tmp_path: Path, units: tuple[str, str], factor: float, unit: str) -> None:
    """They are converted; of what cannot be, a warning says so."""
    with h5py.File(tmp_path / "t.nc", "w") as file:
        file["t"] = DATA[0, 0]
        for axis, name in enumerate("zyx"):
            file[name] = 3.0 + 2 * np.arange(DATA.shape[2 + axis])
            file[name].make_scale(name)
            file[name].attrs["units"] = units[name == "z"]
            file["t"].dims[axis].attach_scale(file[name])
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        volume = clvol.read(tmp_path / "t.nc")
    np.testing.assert_allclose(volume.spacing, (2, 2, 2 * factor))
    np.testing.assert_allclose(volume.origin, (3, 3, 3 * factor))
    assert volume.units == unit
    assert ["t.nc has axes of different units (x in degrees_east" in str(one.message) for one in warned] == [True] * (not unit)


def test_images_of_itk(tmp_path: Path) -> None:
    sitk = pytest.importorskip("SimpleITK")
    image = sitk.GetImageFromArray(DATA[0, 0])
    image.SetSpacing((1, 2, 3))
    image.SetOrigin((4, 5, 6))
    image.SetDirection((0.36, 0.48, -0.8, -0.8, 0.6, 0, 0.48, 0.64, 0.6))
    try:
        sitk.WriteImage(image, str(tmp_path / "v.h5"))
    except RuntimeError:
        pytest.skip("this SimpleITK writes no HDF5")
    volume = clvol.read(tmp_path / "v.h5")
    np.testing.assert_array_equal(volume.data, DATA[0, 0])
    world = image.TransformContinuousIndexToPhysicalPoint((3.0, 2.0, 1.0))
    np.testing.assert_allclose(volume.index_to_world([3, 2, 1]), world)
    assert volume.space == "LPS"


def imaris(path: Path) -> None:
    """An image as Imaris stores it: one array per channel, padded to chunks; attributes are arrays of letters."""

    def say(node: Any, **attributes: object) -> None:
        for key, value in attributes.items():
            node.attrs[key] = np.array([letter.encode() for letter in str(value)], "S1")

    with h5py.File(path, "w") as file:
        image = file.create_group("DataSetInfo/Image")
        say(image, X=6, Y=5, Z=4, Unit="um", ExtMin0=-1.5, ExtMax0=1.5, ExtMin1=0, ExtMax1=5, ExtMin2=10, ExtMax2=18)
        for i, (name, color) in enumerate((("DAPI", "0 0 1"), ("GFP", "0 1 0"), ("Cy5", "1 0 1"))):
            say(file.create_group(f"DataSetInfo/Channel {i}"), Name=name, Color=color, ColorRange=f"{i} 100.5")
        for level, step in enumerate((1, 2)):
            for t, c in np.ndindex(2, 3):
                part = DATA[t, c, :, ::step, ::step]
                channel = file.create_group(f"DataSet/ResolutionLevel {level}/TimePoint {t}/Channel {c}")
                say(channel, **{f"ImageSize{axis}": n for axis, n in zip("ZYX", part.shape, strict=True)})
                channel["Data"] = np.pad(part, ((0, 0), (0, 3), (0, 2)))


def test_images_of_imaris(tmp_path: Path) -> None:
    imaris(tmp_path / "v.ims")
    volume = clvol.read(tmp_path / "v.ims", time=1, channel="GFP")
    np.testing.assert_array_equal(volume.data, DATA[1, 1])
    assert (volume.spacing, volume.origin, volume.units) == ((0.5, 1.0, 2.0), (-1.25, 0.5, 11.0), "um")
    assert (volume.name, volume.color, volume.clim) == ("GFP", (0, 1, 0), (1, 100.5))
    np.testing.assert_array_equal(np.asarray(clvol.read_all(tmp_path / "v.ims")), DATA)
    small = clvol.read(tmp_path / "v.ims", time=0, channel=2, level=1)
    np.testing.assert_array_equal(small.data, DATA[0, 2, :, ::2, ::2])
    np.testing.assert_allclose(small.center, volume.center)
    with h5py.File(tmp_path / "v.ims", "a") as file:
        file["DataSet/ResolutionLevel 0/TimePoint 0/Channel 0"].attrs["ImageSizeX"] = np.array([b"9"], "S1")
    with pytest.raises(FormatError, match="must hold 4 × 5 × 9 samples"):
        clvol.read(tmp_path / "v.ims")
    with h5py.File(tmp_path / "w.ims", "w") as file:
        file["a"] = DATA
    with pytest.raises(FormatError, match=r"Imaris 5\.5"):
        clvol.read(tmp_path / "w.ims")


@pytest.mark.parametrize("kind", ["external", "virtual", "link"])
def test_external_samples_are_not_followed(tmp_path: Path, kind: str) -> None:
    """A file may name any file that its reader can read: `clvol.open` and `clvol.read` do not follow it, and say so."""
    data = np.arange(5 * 6 * 7, dtype=np.uint16).reshape(5, 6, 7)
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["a"] = data
    data.tofile(tmp_path / "other.bin")
    with h5py.File(tmp_path / "v.h5", "w") as file:
        if kind == "external":
            file.create_dataset("a", data.shape, data.dtype, external=[(str(tmp_path / "other.bin"), 0, data.nbytes)])
        elif kind == "virtual":
            layout = h5py.VirtualLayout(data.shape, data.dtype)
            layout[:] = h5py.VirtualSource(tmp_path / "other.h5", "a", data.shape)
            file.create_virtual_dataset("a", layout)
        else:
            file["a"] = h5py.ExternalLink("other.h5", "/a")
    told = r"/a leads to /a in other\.h5" if kind == "link" else "those of /a are in other files"
    for call in (clvol.open, clvol.read):
        with pytest.raises(ClvolError, match=rf"v\.h5 must hold.*{told}.*clvol\.LazyVolume\(dataset\)"):
            call(tmp_path / "v.h5", trusted=True)
    with h5py.File(tmp_path / "v.h5") as file:
        lazy = clvol.LazyVolume(file["a"])
        np.testing.assert_array_equal(lazy.read((1, 2, 3), (7, 6, 5)), data[3:5, 2:6, 1:7])
        with clvol.BrickedField(lazy, "linear", edge=8) as field:
            assert field([[2, 3, 4]]).item() == data[4, 3, 2]


def test_only_the_chosen_channel_is_read(tmp_path: Path) -> None:
    """The chunks of another channel are damaged."""
    with h5py.File(tmp_path / "v.h5", "w") as file:
        array = file.create_dataset("a", data=DATA[0], chunks=(1, 4, 5, 6), compression="gzip", fletcher32=True)
        array.attrs["axes"] = "czyx"
        start = array.id.get_chunk_info(1).byte_offset
    content = bytearray((tmp_path / "v.h5").read_bytes())
    content[start : start + 20] = bytes(20)
    (tmp_path / "v.h5").write_bytes(content)
    np.testing.assert_array_equal(clvol.read(tmp_path / "v.h5", channel=2).data, DATA[0, 2])
    with pytest.raises(FormatError, match="cannot read"):
        clvol.read(tmp_path / "v.h5", channel=1)


def test_damaged_files_raise(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "v.h5", "w") as file:
        file["a"] = DATA[0, 0]
    content = (tmp_path / "v.h5").read_bytes()
    for name, part in (("empty", b""), ("text", b"1 2 3"), ("head", content[:600]), ("cut", content[:-9])):
        (tmp_path / f"{name}.h5").write_bytes(part)
        with pytest.raises(FormatError, match="cannot read"):
            clvol.read(tmp_path / f"{name}.h5")
    with h5py.File(tmp_path / "none.h5", "w") as file:
        file["words"] = [["a"]]
    with pytest.raises(DataError, match="holds none"), warnings.catch_warnings(action="ignore"):
        clvol.read(tmp_path / "none.h5")


def test_without_h5py(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "v.h5").write_bytes(b"")
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(MissingDependencyError, match=r'pip install "clvol\[hdf5\]"'):
        clvol.read(tmp_path / "v.h5", trusted=True)
    with pytest.raises(ClvolError):
        formats.series_of(tmp_path / "v.h5", trusted=True)
