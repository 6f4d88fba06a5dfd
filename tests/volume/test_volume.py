"""A volume has samples and a placement."""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from clvol.base.errors import ClvolError, DataError, GeometryError, OptionError
from clvol.volume.volume import Volume, as_volume
from tests.cases import BAD_COUNTS, BAD_DATA, BAD_NUMBERS, BAD_REALS, OBLIQUE

DATA = np.random.default_rng(1).integers(-50, 50, (4, 5, 6)).astype(np.int16)
VOLUME = Volume(DATA, (0.5, 1.5, 2.0), (1.0, -2.0, 3.0), OBLIQUE, "mm")


def test_defaults() -> None:
    volume = Volume(DATA)
    assert (volume.ndim, volume.shape, volume.size) == (3, (4, 5, 6), (6, 5, 4))
    assert (volume.spacing, volume.origin, volume.units) == ((1, 1, 1), (0, 0, 0), "")
    np.testing.assert_array_equal(volume.direction, np.eye(3))
    assert Volume(DATA[0]).spacing == (1, 1)


def test_data_are_viewed_not_copied() -> None:
    for data in (DATA, DATA[::-1, ::2], np.asfortranarray(DATA), DATA.astype(">i2")):
        volume = Volume(data)
        assert np.shares_memory(volume.data, data)
        assert volume.data.dtype == data.dtype


@pytest.mark.parametrize("dtype", ["?", "u1", "i1", ">u2", "i4", "u8", "f2", ">f4", "f8"])
def test_dtypes(dtype: str) -> None:
    assert Volume(np.ones((2, 3), dtype)).value_range == (1, 1)


def test_index_and_world() -> None:
    index = np.random.default_rng(2).uniform(-9, 9, (7, 2, 3))
    world = VOLUME.index_to_world(index)
    by_hand = np.einsum("ij,...j->...i", OBLIQUE, index * VOLUME.spacing) + VOLUME.origin
    np.testing.assert_allclose(world, by_hand)
    np.testing.assert_allclose(VOLUME.world_to_index(world), index, atol=1e-12)
    np.testing.assert_allclose(VOLUME.index_to_world([0, 0, 0]), VOLUME.origin)
    # one step along x in the array is `spacing[0]` along the first column of the direction
    np.testing.assert_allclose(VOLUME.index_to_world([1, 0, 0]) - VOLUME.origin, 0.5 * OBLIQUE[:, 0])


def test_points_in_the_frame_of_nibabel() -> None:
    patient = Volume(DATA, VOLUME.spacing, VOLUME.origin, OBLIQUE, "mm", space="LPS")
    index = np.random.default_rng(2).uniform(-9, 9, (7, 2, 3))
    ras = patient.index_to_world(index, frame="RAS")
    np.testing.assert_array_equal(ras, patient.index_to_world(index) * [-1, -1, 1])
    np.testing.assert_array_equal(patient.index_to_world(index, frame="LPS"), patient.index_to_world(index))
    np.testing.assert_allclose(patient.world_to_index(ras, frame="RAS"), index, atol=1e-12)
    np.testing.assert_array_equal(Volume(DATA[0], space="LPS").index_to_world([2, 3], frame="RAS"), [-2, -3])
    assert "space='LPS'" in repr(patient)
    assert "space" not in repr(VOLUME)
    for call in (VOLUME.index_to_world, VOLUME.world_to_index):
        with pytest.raises(OptionError, match="for volumes of a patient"):
            call([0, 0, 0], frame="RAS")
        with pytest.raises(OptionError, match="frame must be"):
            call([0, 0, 0], frame="ras")


def test_corners_and_center() -> None:
    index = VOLUME.world_to_index(VOLUME.corners)
    assert VOLUME.corners.shape == (8, 3)
    np.testing.assert_allclose(np.unique(index.round(9), axis=0).min(0), [-0.5] * 3)
    np.testing.assert_allclose(index.max(0), [5.5, 4.5, 3.5])
    np.testing.assert_allclose(VOLUME.center, VOLUME.corners.mean(0))
    assert Volume(DATA[0]).corners.shape == (4, 2)


def test_crop_keeps_positions() -> None:
    part = VOLUME.crop((1, 0, 2), (4, 5, 3))
    np.testing.assert_array_equal(part.data, DATA[2:3, 0:5, 1:4])
    np.testing.assert_allclose(part.index_to_world([0, 0, 0]), VOLUME.index_to_world([1, 0, 2]))
    assert (part.spacing, part.units) == (VOLUME.spacing, "mm")
    for low, high in (((0, 0, 0), (7, 5, 4)), ((2, 0, 0), (2, 1, 1)), ((-1, 0, 0), (1, 1, 1)), ((0.5, 0, 0), (1, 1, 1))):
        with pytest.raises(OptionError):
            VOLUME.crop(low, high)  # type: ignore[arg-type]


def test_downsample_keeps_positions() -> None:
    part = VOLUME.downsample(2)
    np.testing.assert_array_equal(part.data, DATA[::2, ::2, ::2])
    np.testing.assert_allclose(part.index_to_world([1, 1, 1]), VOLUME.index_to_world([2, 2, 2]))
    for n in BAD_COUNTS:
        with pytest.raises(OptionError, match="n must be"):
            VOLUME.downsample(n)


def test_gaussian_is_in_world_units() -> None:
    impulse = np.zeros((41, 41), np.float32)
    impulse[20, 20] = 1
    smooth = Volume(impulse, (0.5, 2.0)).gaussian(2.0).data
    x = np.arange(41) - 20
    assert smooth.dtype == np.float32
    assert smooth.sum() == pytest.approx(1, abs=1e-4)
    assert np.sqrt((smooth * x**2).sum()) == pytest.approx(4, rel=0.01)  # samples along x
    assert np.sqrt((smooth * x[:, None] ** 2).sum()) == pytest.approx(1, rel=0.01)
    assert Volume(np.ones((3, 3))).gaussian(1).data.dtype == np.float64
    np.testing.assert_array_equal(Volume(impulse).gaussian(0).data, impulse)
    for sigma in (-1, np.nan, (1, 2, 3), "a"):
        with pytest.raises(ClvolError):
            Volume(impulse).gaussian(sigma)  # type: ignore[arg-type]


def test_nonfinite_values() -> None:
    data = np.array([[1.0, np.nan], [np.inf, -3.0]])
    volume = Volume(data)
    assert volume.value_range == (-3, 1)
    with pytest.raises(DataError, match=r"1 NaN and 1 infinite, the first at index \[0, 1\]"):
        volume.require_finite()
    np.testing.assert_array_equal(volume.filled(7).data, [[1, 7], [7, -3]])
    volume.filled(7).require_finite()
    with pytest.raises(DataError, match="no sample of the volume is finite"):
        _ = Volume([[np.nan]]).value_range  # type: ignore[arg-type]
    with pytest.raises(OptionError):
        volume.filled(np.nan)
    Volume([[1e308]]).require_finite()  # type: ignore[arg-type]


@pytest.mark.parametrize("bad", [*(v for v in BAD_NUMBERS if v is not None), 1e10], ids=repr)
def test_filled_requires_a_representable_value(bad: object) -> None:
    half = Volume(np.array([[np.nan, 1]], np.float16))
    with pytest.raises(OptionError, match="value must be"):
        half.filled(bad)  # type: ignore[arg-type]
    assert half.filled(np.float32(2)).data.tolist() == [[2, 1]]


@pytest.mark.filterwarnings("error")
@pytest.mark.skipif(np.finfo(np.longdouble).maxexp == np.finfo(np.float64).maxexp, reason="longdouble is float64 here")
def test_longdouble_beyond_float64() -> None:
    volume = Volume(np.array([[1, np.longdouble("1e4000")]]))
    assert volume.value_range == (1, 1)
    with pytest.raises(DataError, match=r"the range of float64; got 1.0 to 1e\+4000"):
        volume.require_finite()


@pytest.mark.filterwarnings("error")
def test_infinite_points_give_no_warning() -> None:
    for place in ([np.inf, 0, 0], [np.nan, 1, -np.inf], [1e308, 1e308, 1e308]):
        assert VOLUME.world_to_index(place).shape == VOLUME.index_to_world(place).shape == (3,)


def test_as_volume() -> None:
    assert as_volume(VOLUME) is VOLUME
    assert as_volume([[1, 2]]).shape == (1, 2)
    again = Volume(VOLUME)  # type: ignore[arg-type]
    assert (again.spacing, again.origin, again.units) == (VOLUME.spacing, VOLUME.origin, "mm")
    said = {"space": "LPS", "name": "a", "color": (1, 0, 0), "clim": (0, 1), "labels": {1: "b"}, "header": {"c": 2}}
    told = Volume(Volume(DATA, **said))  # type: ignore[arg-type]
    assert {name: getattr(told, name) for name in said} == said
    assert "spacing=(0.5, 1.5, 2.0)" in repr(VOLUME)


def test_it_is_frozen() -> None:
    with pytest.raises(AttributeError):
        VOLUME.spacing = (1, 1, 1)  # type: ignore[misc]
    with pytest.raises(ValueError, match="read-only"):
        VOLUME.direction[0, 0] = 9
    with pytest.raises(ValueError, match="read-only"):
        VOLUME.data[0] = 9
    mine = np.zeros((2, 2))
    Volume(mine)
    mine[0, 0] = 1  # the caller's array stays writable


def test_masked_arrays_without_masked_elements_are_accepted() -> None:
    assert Volume(np.ma.array([[1, 2]])).data.tolist() == [[1, 2]]
    masked = np.ma.array([[1, 2]], mask=[[False, True]])
    with pytest.raises(DataError, match=r"filled\(value\)"):
        Volume(masked)
    assert Volume(masked.filled(0)).data.tolist() == [[1, 0]]


def test_simpleitk_images_have_their_geometry() -> None:
    sitk = pytest.importorskip("SimpleITK")
    image = sitk.GetImageFromArray(DATA)
    image.SetSpacing((0.5, 1.5, 2.0))
    image.SetOrigin((1, -2, 3))
    image.SetDirection(OBLIQUE.ravel().tolist())
    volume = Volume(image)
    np.testing.assert_array_equal(volume.data, DATA)
    for index in ((0, 0, 0), (5, 1, 3)):
        np.testing.assert_allclose(volume.index_to_world(index), image.TransformIndexToPhysicalPoint(index))
    with pytest.raises(DataError, match=r"3 channels.*clvol\.Volumes\(image\)\[k\]"):
        Volume(sitk.GetImageFromArray(np.zeros((2, 2, 2, 3)), isVector=True))


def test_nibabel_images_are_converted_to_lps() -> None:
    nibabel = pytest.importorskip("nibabel")
    affine = np.eye(4)
    affine[:3, :3] = OBLIQUE * [0.5, 1.5, 2.0]
    affine[:3, 3] = (1, -2, 3)
    image = nibabel.Nifti1Image(np.ascontiguousarray(DATA.T), affine)
    volume = Volume(image)
    np.testing.assert_array_equal(volume.data, DATA)
    ras = affine @ [5, 1, 3, 1]
    np.testing.assert_allclose(volume.index_to_world([5, 1, 3]), ras[:3] * [-1, -1, 1], rtol=1e-6)


def test_simpleitk_images_are_in_mm_without_trailing_axes_of_one_sample() -> None:
    sitk = pytest.importorskip("SimpleITK")
    image = sitk.GetImageFromArray(DATA[None], isVector=False)
    image.SetSpacing((0.5, 1.5, 2.0, 9.0))
    assert image.GetDimension() == 4
    volume = Volume(image)
    assert (volume.shape, volume.spacing, volume.units) == (DATA.shape, (0.5, 1.5, 2.0), "mm")
    assert volume.space == "LPS"
    assert Volume(image, units="um").units == "um"
    with pytest.raises(DataError, match=r"2 volumes.*clvol\.Volumes\(image\)\[k\]"):
        Volume(sitk.GetImageFromArray(np.zeros((2, 2, 2, 2)), isVector=False))


def test_numpy_reads_the_samples() -> None:
    assert np.shares_memory(np.asarray(VOLUME), DATA)
    assert not np.asarray(VOLUME).flags.writeable
    assert VOLUME.__array__() is VOLUME.data  # as NumPy 1 calls it
    assert VOLUME.__array__(np.float64).dtype == np.float64
    mine = np.array(VOLUME)
    mine[0, 0, 0] = 9  # a copy
    assert np.mean(VOLUME) == DATA.mean()
    assert np.asarray(Volume(DATA.astype(">i2"))).dtype == ">i2"
    with pytest.raises(ValueError, match="without a copy"):
        VOLUME.__array__(np.float32, copy=False)


class OldLibrary:
    """A library that does not support read-only memory."""

    def __init__(self, volume: Volume) -> None:
        self.volume = volume

    def __dlpack__(self, **_: object) -> object:
        return self.volume.__dlpack__()

    def __dlpack_device__(self) -> tuple[Any, int]:
        return self.volume.__dlpack_device__()


def test_dlpack_shares_the_samples_or_copies_them() -> None:
    assert VOLUME.__dlpack_device__() == DATA.__dlpack_device__()
    for source in (VOLUME, OldLibrary(VOLUME), Volume(DATA.astype(">i2"))):
        np.testing.assert_array_equal(np.from_dlpack(source), DATA)
    assert not np.shares_memory(np.from_dlpack(OldLibrary(VOLUME)), DATA)
    with pytest.raises(BufferError, match="are read-only"):
        VOLUME.__dlpack__(copy=False)


@pytest.mark.skipif(np.lib.NumpyVersion(np.__version__) < "2.1.0", reason="older ones cannot export read-only memory")
def test_current_dlpack_shares_memory() -> None:
    assert np.shares_memory(np.from_dlpack(VOLUME), DATA)


def test_images_of_other_libraries_round_trip() -> None:
    sitk, nibabel = pytest.importorskip("SimpleITK"), pytest.importorskip("nibabel")
    for volume in (VOLUME, Volume(DATA[0], (2, 3), (4, 5), [[0, -1], [1, 0]], "mm"), Volume(DATA > 0, units="mm")):
        image, other = volume.to_sitk(), volume.to_nibabel()
        assert isinstance(image, sitk.Image)
        assert isinstance(other, nibabel.Nifti1Image)
        for again in (Volume(image), Volume(other)):
            np.testing.assert_array_equal(again.data, volume.data)
            np.testing.assert_allclose(again.corners, volume.corners, rtol=1e-12)
            np.testing.assert_allclose(again.direction, volume.direction, atol=1e-12)
            assert (again.units, again.space) == ("mm", "LPS")
    there = [5.0, 1.0, 3.0]
    np.testing.assert_allclose(VOLUME.to_sitk().TransformContinuousIndexToPhysicalPoint(there), VOLUME.index_to_world(there))
    np.testing.assert_allclose((VOLUME.to_nibabel().affine @ [*there, 1])[:3], VOLUME.index_to_world(there) * [-1, -1, 1])
    np.testing.assert_allclose(Volume(DATA, spacing=(500, 500, 2e3), units="um").to_sitk().GetSpacing(), (0.5, 0.5, 2))
    for call in (Volume(DATA, units="parsec").to_sitk, Volume(DATA, units="parsec").to_nibabel):
        with pytest.raises(GeometryError, match="units must be a length"):
            call()
    if np.dtype(np.longdouble) != np.float64:
        with pytest.raises(DataError, match="samples must be"):
            Volume(DATA.astype(np.longdouble)).to_nibabel()


def test_xarray_has_coordinates_where_axes_are_aligned_with_the_world() -> None:
    pytest.importorskip("xarray")
    straight = Volume(DATA, (1, 2, 3), (4, 5, 6), np.diag([1, -1, 1]), "um", name="cells", clim=(0, 9), space="image")
    array = straight.to_xarray()
    assert (array.dims, array.name, array.attrs["world_units"], array.x.attrs["units"]) == (("z", "y", "x"), "cells", "um", "um")
    assert (array.attrs["clim"], array.attrs["space"]) == ([0, 9], "image")
    for index in ((0, 0, 0), (5, 1, 3)):
        x, y, z = straight.index_to_world(index)
        assert array.sel(x=x, y=y, z=z) == DATA[index[::-1]]
    assert "x" not in VOLUME.to_xarray().coords
    assert Volume(DATA[0]).to_xarray().dims == ("y", "x")
    for volume in (straight, VOLUME, Volume(DATA[0], (2, 3), clim=(0, 1))):
        again = Volume(volume.to_xarray())
        np.testing.assert_array_equal(again.data, volume.data)
        np.testing.assert_allclose(again.corners, volume.corners)
        for name in ("units", "space", "name", "clim"):
            assert getattr(again, name) == getattr(volume, name)


def test_parts_of_xarray_arrays_keep_their_positions() -> None:
    pytest.importorskip("xarray")
    volume = Volume(DATA, (1, 2, 3), (4, 5, 6), np.diag([1, -1, 1]))
    part = Volume(volume.to_xarray()[1:3, ::-2, 2:])
    np.testing.assert_array_equal(part.data, DATA[1:3, ::-2, 2:])
    for index, whole in (((0, 0, 0), (2, 4, 1)), ((1, 2, 1), (3, 0, 2))):
        np.testing.assert_allclose(part.index_to_world(index), volume.index_to_world(whole))
    slice_ = Volume(volume.to_xarray()[2, :, 1:])
    np.testing.assert_allclose(slice_.index_to_world([0, 0]), volume.index_to_world([1, 0, 2])[:2])
    with pytest.raises(GeometryError, match="evenly spaced"):
        Volume(volume.to_xarray().isel(x=[0, 1, 4]))
    with pytest.raises(GeometryError, match="nothing says where it lies"):
        Volume(VOLUME.to_xarray()[1:])
    for one in (volume, VOLUME):
        turned = Volume(one.to_xarray().transpose("x", "z", "y"))
        np.testing.assert_array_equal(turned.data, one.data)
        np.testing.assert_array_equal(turned.index_to_world_matrix, one.index_to_world_matrix)
        assert turned.origin == one.origin


BAD: list[tuple[dict[str, Any], type[ClvolError]]] = [
    *(({"data": data}, DataError) for data in BAD_DATA),
    ({"spacing": np.array([1 + 1j, 1])}, GeometryError),
    ({"spacing": ("1", "1")}, GeometryError),
    ({"spacing": np.ma.array([1, 2], mask=[0, 1])}, GeometryError),
    ({"direction": np.eye(2) * (1 + 0j)}, GeometryError),
    ({"spacing": (1,)}, GeometryError),
    ({"spacing": (1, 1, 1)}, GeometryError),
    ({"spacing": (0, 1)}, GeometryError),
    ({"spacing": (-1, 1)}, GeometryError),
    ({"spacing": (np.nan, 1)}, GeometryError),
    ({"spacing": "ab"}, GeometryError),
    ({"origin": (np.inf, 0)}, GeometryError),
    ({"origin": (0, 0, 0)}, GeometryError),
    ({"origin": ("a", 0)}, GeometryError),
    ({"direction": np.zeros((2, 2))}, GeometryError),
    ({"direction": np.eye(3)}, GeometryError),
    ({"direction": 2 * np.eye(2)}, GeometryError),
    ({"direction": [[1, 1], [0, 0]]}, GeometryError),
    ({"direction": [[np.nan, 0], [0, 1]]}, GeometryError),
    ({"direction": "ab"}, GeometryError),
    ({"units": 3}, OptionError),
]


@pytest.mark.parametrize(("change", "error"), BAD, ids=[str(c)[:50] for c, _ in BAD])
def test_bad_input_is_rejected(change: dict[str, Any], error: type[ClvolError]) -> None:
    with pytest.raises(error):
        Volume(**{"data": np.ones((2, 2)), **change})


def test_bad_points_are_rejected() -> None:
    for points in (3.0, [1.0, 2.0], [[1.0] * 4]):
        with pytest.raises(OptionError, match="must have shape"):
            VOLUME.world_to_index(points)
    for bad in BAD_REALS:
        with pytest.raises(OptionError, match="world must be numbers of shape"):
            VOLUME.world_to_index(bad)


def test_a_library_being_imported_by_another_thread_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """Until the import completes, the module exists without its contents."""
    monkeypatch.setitem(sys.modules, "torch", ModuleType("torch"))
    assert Volume(DATA.tolist()).shape == DATA.shape
