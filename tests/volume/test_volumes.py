"""Several volumes on one grid: selection, and conversion to other libraries."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from clvol.base.errors import DataError, GeometryError, OptionError
from clvol.volume.volume import Volume
from clvol.volume.volumes import Leading, Volumes

DATA = np.arange(3 * 2 * 4 * 5 * 6, dtype=np.int16).reshape(3, 2, 4, 5, 6)
CELLS = Leading(("time", "channel"), (3, 2), {"channel": ("DAPI", "GFP")}, ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0)), ((0.0, 9.0), None))
GRID: dict[str, Any] = {"spacing": (1, 2, 3), "origin": (4, 5, 6), "units": "mm"}


def cells() -> Volumes:
    return Volumes(DATA, leading=CELLS, **GRID)


def test_a_sequence_of_volumes() -> None:
    volumes = cells()
    assert (len(volumes), volumes.shape, volumes.axes) == (6, DATA.shape, ("time", "channel"))
    np.testing.assert_array_equal([volume.data for volume in volumes], DATA.reshape(6, 4, 5, 6))
    one = volumes.pick(time=2, channel="GFP")
    assert (one.name, one.color, one.clim, one.spacing) == ("GFP", (0, 1, 0), None, (1, 2, 3))
    assert volumes[4].clim == (0, 9)
    np.testing.assert_array_equal(one.data, DATA[2, 1])
    np.testing.assert_array_equal(volumes[-1].data, DATA[2, 1])
    assert np.shares_memory(one.data, DATA)
    assert [volume.name for volume in volumes[1:3]] == ["GFP", "DAPI"]
    assert "3 times × 2 channels (DAPI, GFP)" in repr(volumes)
    with pytest.raises(IndexError):
        volumes[6]
    for wrong, rule in (
        ({"time": 3, "channel": 0}, "time must be 0 to 2, because the volume holds 3 times"),
        ({"time": 0, "channel": "RFP"}, r"0 \(DAPI\), 1 \(GFP\)"),
        ({"time": 0}, "channel must be given"),
        ({"time": 0, "channel": 0, "position": 0}, "got position"),
    ):
        with pytest.raises(OptionError, match=rule):
            volumes.pick(**wrong)


def test_volumes_of_one_grid_are_joined() -> None:
    first = Volume(DATA[0, 0], clim=(0, 9), labels={1: "a"}, header={"a": 1}, name="one", **GRID)
    both = Volumes([first, replace(first, data=DATA[0, 1], name="two")])
    assert (both.axes, both.names, both["two"].clim, both[1].labels, both[1].header) == (
        ("volume",),
        ("one", "two"),
        (0, 9),
        {1: "a"},
        {"a": 1},
    )
    assert Volumes([first, replace(first, clim=(0, 5))])[0].clim is None  # one for both would be wrong
    with pytest.raises(GeometryError, match="one grid"):
        Volumes([first, replace(first, spacing=(1, 1, 1))])
    with pytest.raises(DataError, match="one shape"):
        Volumes([first, first.downsample(2)])
    with pytest.raises(OptionError, match="must count the first axes"):
        Volumes(DATA, leading=Leading(("time",), (2,)))
    with pytest.raises(DataError, match=r"clvol\.Volumes\(data\)\[k\]"):
        Volume(DATA)


def test_grids_are_compared_in_voxels_and_units() -> None:
    data = np.zeros((3, 3, 3), np.uint8)
    fine = Volume(data, (1e-9,) * 3, units="m")
    with pytest.raises(GeometryError, match="one grid"):
        Volumes([fine, replace(fine, spacing=(2e-9,) * 3)])
    with pytest.raises(GeometryError, match="one grid"):
        Volumes([Volume(data, units="mm"), Volume(data, units="um")])
    assert len(Volumes([fine, replace(fine, origin=(1e-14, 0.0, 0.0))])) == 2  # with rounding
    with pytest.raises(DataError, match="got none"):
        Volumes([])


def test_a_colour_shared_by_all_volumes_is_kept() -> None:
    red = Volume(np.zeros((2, 2, 2)), color=np.array([1.0, 0, 0]), clim=np.array([0.0, 1]))  # type: ignore[arg-type]
    assert Volumes([red])[0].color == (1.0, 0.0, 0.0)
    assert Volumes([red, red])[1].clim == (0.0, 1.0)
    assert Volumes([red, replace(red, color=(0.0, 0.0, 1.0))])[0].color is None


def test_computed_channels() -> None:
    vectors = Volumes(DATA[:, 0], leading=Leading(("channel",), (3,), vector=True))
    assert vectors.names == ("x", "y", "z")
    length = vectors["magnitude"]
    assert length.data.dtype == np.float32
    np.testing.assert_allclose(length.data, np.linalg.norm(DATA[:, 0].astype(float), axis=0), rtol=1e-6)
    colours = Volumes(DATA[:, 0].astype(np.uint8), leading=Leading.of_rgb(3))
    assert (colours["red"].color, colours.pick(channel="luminance").data.dtype) == ((1, 0, 0), np.uint8)


def test_arrays() -> None:
    volumes = cells()
    assert np.shares_memory(np.asarray(volumes), DATA)
    np.testing.assert_array_equal(np.asarray(volumes, np.float32), DATA.astype(np.float32))
    assert np.array(volumes, copy=True).flags.writeable


def test_simpleitk() -> None:
    sitk = pytest.importorskip("SimpleITK")
    image = cells().to_sitk()
    assert (image.GetSize(), image.GetNumberOfComponentsPerPixel(), image.GetSpacing()[:3]) == ((6, 5, 4, 3), 2, (1, 2, 3))
    np.testing.assert_array_equal(sitk.GetArrayFromImage(image), np.moveaxis(DATA, 1, -1))
    again = Volumes(image)
    assert again.axes == ("volume", "channel")
    np.testing.assert_array_equal(again, DATA)
    assert (again[0].spacing, again[0].origin, again[0].units, again[0].space) == ((1, 2, 3), (4, 5, 6), "mm", "LPS")
    flat = Volumes(DATA[:, 0, 0], spacing=(1, 2))  # a sequence of images is not a volume
    assert flat.to_sitk().GetSize() == (6, 5, 1, 3)
    np.testing.assert_array_equal(Volumes(flat.to_sitk())[:][2].data[0], DATA[2, 0, 0])
    one = Volumes(sitk.GetImageFromArray(DATA[0, 0]))
    assert (len(one), one[0].shape) == (1, (4, 5, 6))
    plane = Volumes(sitk.GetImageFromArray(np.moveaxis(DATA[0, :, 0], 0, -1).astype(np.float32), isVector=True))
    assert plane.leading.computed == "magnitude"
    np.testing.assert_array_equal(plane, DATA[0, :, 0])


def test_nibabel() -> None:
    pytest.importorskip("nibabel")
    image = cells().to_nibabel()
    assert (image.shape, image.header.get_xyzt_units()) == ((6, 5, 4, 3, 2), ("mm", "sec"))
    np.testing.assert_array_equal(image.dataobj, np.moveaxis(DATA, 1, 0).T)  # the fifth axis is that of channels
    np.testing.assert_allclose(image.affine @ [1, 1, 1, 1], [-5, -7, 9, 1])
    again = Volumes(image)
    assert again.axes == ("channel", "time")
    np.testing.assert_array_equal(again, np.moveaxis(DATA, 1, 0))
    micro = Volumes(DATA[:, 0], spacing=(500, 500, 2000), units="um").to_nibabel()
    np.testing.assert_allclose(Volumes(micro)[0].spacing, (0.5, 0.5, 2))
    with pytest.raises(GeometryError, match="units must be a length"):
        Volumes(DATA[:, 0], units="parsec").to_nibabel()
    with pytest.raises(DataError, match="channels and one other"):
        Volumes(DATA, leading=Leading(("time", "position"), (3, 2))).to_sitk()


def test_xarray() -> None:
    pytest.importorskip("xarray")
    array = cells().to_xarray()
    assert array.dims == ("time", "channel", "z", "y", "x")
    np.testing.assert_array_equal(array.sel(channel="GFP", time=2, z=9), DATA[2, 1, 1])
    again = Volumes(array)
    assert (again.axes, again.names, again[0].units) == (("time", "channel"), ("DAPI", "GFP") * 3, "mm")
    np.testing.assert_array_equal(again, DATA)
    np.testing.assert_array_equal(Volumes(array.sel(channel="GFP", time=[0, 2])), DATA[[0, 2], 1])
    with pytest.raises(DataError, match="3 times × 2 channels"):
        Volume(array)
