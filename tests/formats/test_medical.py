"""Medical files with several volumes, compared with their own libraries; and the metadata of such files."""

from __future__ import annotations

import gzip
import os
import shutil
import struct
import tarfile
import tracemalloc
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clvol
from clvol.base.errors import ClvolWarning, DataError, FormatError, GeometryError, OptionError
from clvol.formats import read, read_all, write
from clvol.interop.itk import describe_simpleitk
from clvol.interop.nibabel import describe_nibabel
from clvol.volume.volume import Volume
from clvol.volume.volumes import Leading, Volumes, as_grid
from tests.dicom import element, sequence

nibabel = pytest.importorskip("nibabel")
sitk = pytest.importorskip("SimpleITK")

DATA = Path(os.environ.get("CLVOL_DATA", Path(__file__).parents[3] / "shared" / "data"))
OBLIQUE = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
AFFINE = np.eye(4)
AFFINE[:3, :3], AFFINE[:3, 3] = OBLIQUE * [0.5, 1.5, 2.0], (10, -20, 30)
SHAPE = (4, 3, 2)  # x, y, z


def series(*more: int, dtype: str = "int16") -> np.ndarray:
    """Distinct samples [x, y, z, ...]."""
    return np.arange(np.prod(SHAPE + more)).reshape(SHAPE + more).astype(dtype)


def save(path: Path, data: np.ndarray, kind: Any = None, **fields: Any) -> Path:
    image = (kind or nibabel.Nifti1Image)(data, AFFINE)
    for name, value in fields.items():
        image.header[name] = value
    nibabel.save(image, path)
    return path


def same_grid(one: Volume, other: Volume, rtol: float = 1e-6) -> None:
    np.testing.assert_allclose(one.corners, other.corners, rtol=rtol)
    assert (one.units, one.space, one.clim, one.shape) == (other.units, other.space, other.clim, other.shape)


# -- NIfTI -----------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".nii", ".nii.gz"])
@pytest.mark.parametrize(("units", "axis"), [(2 | 8, "time"), (2 | 16, "time"), (2, "volume"), (2 | 32, "volume")])
def test_nifti_of_a_series(tmp_path: Path, suffix: str, units: int, axis: str) -> None:
    image = nibabel.Nifti1Image(series(5), AFFINE)
    image.header["xyzt_units"] = units
    image.header.set_slope_inter(0.5, 3)
    nibabel.save(image, tmp_path / f"v{suffix}")
    truth = nibabel.load(tmp_path / f"v{suffix}").get_fdata()
    with pytest.warns(ClvolWarning, match=rf"5 {axis}s; {axis} 0 was read: choose by {axis}="):
        first = read(tmp_path / f"v{suffix}")
    np.testing.assert_array_equal(first.data, truth[..., 0].T)
    for k in (0, 2, 4):
        one = read(tmp_path / f"v{suffix}", volume=k)
        np.testing.assert_array_equal(one.data, truth[..., k].T)
        np.testing.assert_array_equal(read(tmp_path / f"v{suffix}", time=k).data, one.data)
    every = read_all(tmp_path / f"v{suffix}")
    assert every.axes == (axis,)
    np.testing.assert_array_equal(every, truth.T)
    np.testing.assert_array_equal(Volumes(nibabel.load(tmp_path / f"v{suffix}")), truth.T)
    np.testing.assert_allclose(one.index_to_world([3, 0, 1], frame="RAS"), (AFFINE @ [3, 0, 1, 1])[:3], rtol=1e-6)
    for wrong in ({"volume": 5}, {"time": -1}):
        with pytest.raises(OptionError, match=r"holds 5 (times|volumes)"):
            read(tmp_path / f"v{suffix}", **wrong)
    with pytest.raises(OptionError, match="one channel"):
        read(tmp_path / f"v{suffix}", time=0, channel=1)


@pytest.mark.parametrize("suffix", [".nii", ".nii.gz"])
def test_only_the_chosen_volume_is_loaded(tmp_path: Path, suffix: str) -> None:
    data = np.zeros((128, 64, 64, 10), np.float32)  # two megabytes a volume
    data[..., 7] = np.arange(64)[:, None]
    save(tmp_path / f"v{suffix}", data)
    tracemalloc.start()
    try:
        one = read(tmp_path / f"v{suffix}", volume=7)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    np.testing.assert_array_equal(one.data, data[..., 7].T)
    assert peak < 2 * one.data.nbytes  # and buffers


def test_nifti_truncated_in_a_later_volume(tmp_path: Path) -> None:
    """No part of it is trusted: a compressed one has its checksum at its end, an uncompressed one its size."""
    whole = save(tmp_path / "v.nii", np.random.default_rng(0).random((20, 20, 20, 3))).read_bytes()
    packed = save(tmp_path / "v.nii.gz", np.random.default_rng(0).random((20, 20, 20, 3))).read_bytes()
    (tmp_path / "v.nii").write_bytes(whole[:-100])
    (tmp_path / "v.nii.gz").write_bytes(packed[:-9000])
    for k in range(3):
        with pytest.raises(FormatError, match="must hold 192000 bytes"):
            read(tmp_path / "v.nii", volume=k)
        with pytest.raises(FormatError, match="end-of-stream"):
            read(tmp_path / "v.nii.gz", volume=k)


def test_nifti_of_vectors(tmp_path: Path) -> None:
    data = series(1, 3, dtype="float32")
    path = save(tmp_path / "v.nii.gz", data, intent_code=1007)
    every = read_all(path)
    assert (every.axes, every.names, every.leading.vector) == (("channel",), ("x", "y", "z"), True)
    np.testing.assert_array_equal(every, data[:, :, :, 0].T)
    np.testing.assert_array_equal(read(path, channel="y").data, data[..., 0, 1].T)
    length = read(path)  # no warning: vectors have one way to be shown
    assert length.name == "magnitude"
    np.testing.assert_allclose(length.data, np.linalg.norm(data[:, :, :, 0], axis=-1).T, rtol=1e-6)
    np.testing.assert_array_equal(Volumes(nibabel.load(path)), every)
    with pytest.raises(OptionError, match=r"channel must be 0 to 2, of 0 \(x\), 1 \(y\), 2 \(z\), magnitude"):
        read(path, channel="w")
    write(every, tmp_path / "again.nii")
    again = nibabel.load(tmp_path / "again.nii")
    assert (again.shape, again.header["intent_code"]) == (data.shape, 1007)
    np.testing.assert_array_equal(again.dataobj, data)
    write(read(path, channel=0), tmp_path / "x.nii")  # a component is no vector
    assert nibabel.load(tmp_path / "x.nii").header["intent_code"] == 0


def test_nifti_of_times_and_channels(tmp_path: Path) -> None:
    data = series(5, 2)
    path = save(tmp_path / "v.nii", data, xyzt_units=2 | 8)
    every = read_all(path)
    assert every.axes == ("channel", "time")
    np.testing.assert_array_equal(every, data.T)
    np.testing.assert_array_equal(read(path, channel=1, time=3).data, data[..., 3, 1].T)
    np.testing.assert_array_equal(read_all(path, time=3), data[..., 3, :].T)
    np.testing.assert_array_equal(nibabel.Nifti1Image.to_bytes(every.to_nibabel())[352:], path.read_bytes()[352:])
    six = save(tmp_path / "six.nii", series(2, 1, 3))
    with pytest.warns(ClvolWarning, match="axes 4 to 6 were taken for one"):
        np.testing.assert_array_equal(read(six).data, series(2, 1, 3)[..., 0, 0, 0].T)
    with pytest.warns(ClvolWarning, match="taken for one"):
        np.testing.assert_array_equal(read(six, volume=3).data, series(2, 1, 3)[..., 1, 0, 1].T)  # the fourth axis is the fastest


@pytest.mark.parametrize("letters", ["RGB", "RGBA"])
@pytest.mark.parametrize("frames", [(), (3,)], ids=["one", "series"])
def test_nifti_of_colours(tmp_path: Path, letters: str, frames: tuple[int, ...]) -> None:
    values = series(*frames, len(letters), dtype="uint8")
    colours = values.view([(letter, "u1") for letter in letters])[..., 0]
    path = save(tmp_path / "v.nii.gz", colours)
    every = read_all(path)
    assert every.axes == (*(["volume"] if frames else []), "channel")
    np.testing.assert_array_equal(every, np.moveaxis(values, -1, 3).T)
    np.testing.assert_array_equal(Volumes(nibabel.load(path)), every)
    frame = {"volume": 2} if frames else {}
    assert every.pick(channel="red", **frame).color == (1, 0, 0)
    red, green, blue = np.moveaxis(values[..., 2, :] if frames else values, -1, 0)[:3].astype(float)
    grey = every.pick(channel="luminance", **frame)
    with pytest.warns(ClvolWarning, match="of its colours the luminance was read: choose by channel="):
        np.testing.assert_array_equal(read(path, **frame).data, grey.data)
    with warnings.catch_warnings(action="error"):
        read(path, channel="luminance", **frame)
    np.testing.assert_array_equal(grey.data, np.rint(0.2126 * red + 0.7152 * green + 0.0722 * blue).T)  # Rec. 709
    write(every, tmp_path / "again.nii")
    again = nibabel.load(tmp_path / "again.nii")
    assert again.get_data_dtype() == colours.dtype
    np.testing.assert_array_equal(np.asarray(again.dataobj), colours)


@pytest.mark.parametrize("order", ["<", ">"])
def test_nifti_2_and_pairs(tmp_path: Path, order: str) -> None:
    for name, kind in (("two.nii.gz", nibabel.Nifti2Image), ("pair.img", nibabel.Nifti1Pair), ("pair2.hdr", nibabel.Nifti2Pair)):
        header = kind.header_class(endianness=order)
        header.set_data_dtype(np.int16)
        nibabel.save(kind(series(3), AFFINE, header), tmp_path / name)
        image = nibabel.load(tmp_path / name)
        assert image.header.endianness == order
        one = read(tmp_path / name, volume=1)
        np.testing.assert_array_equal(one.data, series(3)[..., 1].T)
        same_grid(one, Volumes(image)[1])
    assert read(tmp_path / "pair.hdr", volume=1).data.sum() == series(3)[..., 1].sum()
    (tmp_path / "pair.img").unlink()
    with pytest.raises(FormatError, match=r"pair\.img beside it, which is not there"):
        read(tmp_path / "pair.hdr")
    header = nibabel.Nifti2Header()
    header.set_data_dtype(np.int16)
    header.set_data_shape((4, 3, 2, 1 << 40))
    header["vox_offset"] = 544
    (tmp_path / "huge.nii").write_bytes(header.binaryblock + bytes(100))
    with pytest.raises(FormatError, match="must hold 52776558133248 bytes"):  # and no memory is asked for
        read(tmp_path / "huge.nii", volume=1)
    long = Volume(np.arange(40000, dtype=np.uint16)[None, None], units="mm")  # more than NIfTI-1 holds along an axis
    write(long, tmp_path / "long.nii")
    assert isinstance(nibabel.load(tmp_path / "long.nii"), nibabel.Nifti2Image)
    np.testing.assert_array_equal(read(tmp_path / "long.nii").data, long.data)


@pytest.mark.parametrize(("ndims", "surplus"), [(2, "ElementSpacing"), (2, "Offset"), (2, "Position"), (3, "ElementSpacing")])
def test_metaimages_with_more_numbers_than_axes(tmp_path: Path, ndims: int, surplus: str) -> None:
    """ITK reads the first; some programs write three spacings for two axes."""
    fields = {"NDims": ndims, "DimSize": "4 3 2"[: 2 * ndims - 1], "ElementSpacing": "0.5 0.25 2 9", "ElementType": "MET_UCHAR"}
    fields["ElementSpacing"] = " ".join(fields["ElementSpacing"].split()[: ndims + (surplus == "ElementSpacing")])
    if surplus != "ElementSpacing":
        fields[surplus] = "7 8 9"
    text = "".join(f"{key} = {value}\n" for key, value in fields.items()) + "ElementDataFile = LOCAL\n"
    (tmp_path / "foot.mha").write_bytes(text.encode() + bytes(range(12 * (ndims - 1))))
    with pytest.warns(ClvolWarning, match=rf"foot\.mha gives {ndims + 1} numbers for {surplus} of {ndims} axes"):
        volume = clvol.read(tmp_path / "foot.mha")
    image = sitk.ReadImage(str(tmp_path / "foot.mha"))
    np.testing.assert_array_equal(volume.data, sitk.GetArrayFromImage(image))
    assert (volume.spacing, volume.origin) == (image.GetSpacing(), image.GetOrigin())


@pytest.mark.parametrize("suffix", [".nii", ".nii.gz"])
@pytest.mark.parametrize("after", [4, 0])
def test_a_vox_offset_of_0(tmp_path: Path, suffix: str, after: int) -> None:
    """Samples end with the file; where they begin right after the header, ITK is the witness."""
    data = np.arange(60, dtype=np.int16).reshape(3, 4, 5)
    content = nibabel.Nifti1Image(data, np.diag([2, 3, 4, 1])).to_bytes()
    content = content[:108] + bytes(4) + content[112:348] + bytes(after) + content[352:]
    path = tmp_path / f"v{suffix}"
    path.write_bytes(gzip.compress(content) if suffix == ".nii.gz" else content)
    with pytest.warns(ClvolWarning, match=f"its vox_offset is 0, and its samples were taken to begin at byte {348 + after}"):
        volume = clvol.read(path)
    np.testing.assert_array_equal(volume.data, data.T)
    if not after:
        np.testing.assert_array_equal(volume.data, sitk.GetArrayFromImage(sitk.ReadImage(str(path))))
    path.write_bytes(gzip.compress(content[:-1]) if suffix == ".nii.gz" else content[:-1])
    with pytest.raises(FormatError, match="must hold 120 bytes"):
        clvol.read(path)


def test_cifti_is_named(tmp_path: Path) -> None:
    cifti = nibabel.cifti2
    voxels = cifti.BrainModelAxis.from_mask(np.ones((1, 2, 5)), name="thalamus_left", affine=np.eye(4))
    image = cifti.Cifti2Image(np.zeros((4, 10), np.float32), header=(cifti.SeriesAxis(0, 1, 4), voxels))
    image.to_filename(tmp_path / "v.dtseries.nii")
    with pytest.raises(FormatError, match=r"v\.dtseries\.nii must hold a volume; it is CIFTI-2.*wb_command"):
        clvol.read(tmp_path / "v.dtseries.nii")
    with pytest.raises(DataError, match="must hold a volume; it is CIFTI-2"):
        Volume(nibabel.load(tmp_path / "v.dtseries.nii"))


@pytest.mark.parametrize(
    ("codes", "at", "message"),
    [
        ((0, 1), 280, r"its sform \(srow\) must give each axis a finite length that is not 0; its header says \[0\.0, 0\.0"),
        ((0, 0), 80, r"its pixdim must give each axis a finite length that is not 0; its header says \[1\.0, 0\.0"),
        ((1, 0), 80, r"its pixdim must give each axis a finite length that is not 0; its header says \[1\.0, 0\.0"),
    ],
)
def test_nifti_without_lengths(tmp_path: Path, codes: tuple[int, int], at: int, message: str) -> None:
    content = bytearray(nibabel.Nifti1Image(np.zeros((3, 4, 5), np.uint8), np.eye(4)).to_bytes())
    content[252:256] = struct.pack("<hh", *codes)
    content[at : at + 4] = bytes(4)
    (tmp_path / "v.nii").write_bytes(content)
    for call in (clvol.read, clvol.open):
        with pytest.raises(GeometryError, match=message):
            call(tmp_path / "v.nii")
        placed = call(tmp_path / "v.nii", spacing=(1, 2, 3), direction=np.eye(3))
        assert placed.spacing == (1, 2, 3)


@pytest.mark.parametrize(
    ("origin", "spacing", "size", "version"),
    [
        ((123456.789, 2000.123456, -5.0), (1e-3, 1e-3, 1e-3), (4, 5, 6), 2),
        ((100000.05, 0.0, 0.0), (0.1, 0.1, 0.1), (4, 5, 6), 2),
        ((1e6, 0.0, 0.0), (1 / 3, 1.0, 1.0), (30000, 2, 2), 2),
        ((1000.05, -90.123, 72.77), (0.1, 0.9, 1.1), (4, 5, 6), 1),
    ],
)
def test_nifti_moves_no_sample(
    tmp_path: Path, origin: tuple[float, ...], spacing: tuple[float, ...], size: tuple[int, ...], version: int
) -> None:
    """NIfTI-1 holds geometry in float32; where that is off by a thousandth of a voxel, the file is NIfTI-2. nibabel says where."""
    volume = Volume(np.zeros(size[::-1], np.uint8), spacing, origin, direction=[[0.6, 0.8, 0], [-0.8, 0.6, 0], [0, 0, 1]])
    clvol.write(volume, tmp_path / "v.nii")
    image = nibabel.load(tmp_path / "v.nii")
    assert type(image).__name__ == f"Nifti{version}Image"
    for corner in np.ndindex(2, 2, 2):
        index = np.multiply(corner, np.array(size) - 1)
        there = (image.affine @ [*index, 1])[:3] * [-1, -1, 1]
        np.testing.assert_allclose(volume.world_to_index(there), index, rtol=0, atol=1e-3)


def test_nifti_preserves_its_header(tmp_path: Path) -> None:
    image = nibabel.Nifti1Image(series(dtype="float32"), AFFINE)
    image.set_qform(AFFINE, 3)
    image.set_sform(AFFINE, 4)
    said = {"cal_min": -2, "cal_max": 7.5, "descrip": b"a map", "intent_code": 3, "intent_p1": 12, "intent_name": b"t"}
    for name, value in said.items():
        image.header[name] = value
    nibabel.save(image, tmp_path / "v.nii")
    volume = read(tmp_path / "v.nii")
    assert (volume.clim, volume.labels, volume.space) == ((-2, 7.5), None, "LPS")
    direct = Volume(image)
    assert (direct.clim, direct.header) == (volume.clim, volume.header)
    grid = Volume(np.zeros((2, 2, 2)), (3, 3, 3), (1, 2, 3))
    for changed in (volume, volume.crop((1, 0, 0), (4, 3, 2)), volume.placed(np.ones((2, 2, 2)), grid)):  # as resample does it
        write(changed, tmp_path / "again.nii")
        again = nibabel.load(tmp_path / "again.nii")
        assert {name: again.header[name].item() for name in said} == said
        assert (again.header["qform_code"], again.header["sform_code"]) == (3, 4)
        for placed in (again.header.get_qform(), again.header.get_sform()):
            np.testing.assert_allclose((placed @ [1, 1, 1, 1])[:3], changed.index_to_world([1, 1, 1]) * [-1, -1, 1], rtol=1e-5)
    write(replace(volume, clim=None), tmp_path / "again.nii")
    assert nibabel.load(tmp_path / "again.nii").header["cal_max"] == 0


def test_a_qform_that_differs_from_the_sform(tmp_path: Path) -> None:
    """The sform gives the placement: its code is written for the qform, whose own would be wrong for it."""
    image = nibabel.Nifti1Image(series(dtype="float32"), AFFINE)
    image.set_sform(AFFINE, 4)
    for moved, code in ((AFFINE, 1), (np.diag([3.0, 3, 3, 1]) @ AFFINE, 4)):
        image.set_qform(moved, 1, update_affine=False)
        nibabel.save(image, tmp_path / "v.nii")
        volume = read(tmp_path / "v.nii")
        assert volume.header == Volume(image).header
        assert (volume.header["sform_code"], volume.header["qform_code"]) == (4, code)
    image.header["quatern_b"] = 2  # longer than 1: nibabel takes the sform all the same
    nibabel.save(image, tmp_path / "v.nii")
    assert read(tmp_path / "v.nii").header == Volume(image).header == volume.header


def test_nifti_of_labels(tmp_path: Path) -> None:
    volume = read(save(tmp_path / "v.nii", np.ones(SHAPE, np.int16), intent_code=1002))
    assert volume.labels is True
    assert volume.is_labels
    write(Volume(np.ones((2, 2, 2), np.uint8), labels={1: "liver"}, units="mm"), tmp_path / "w.nii")
    assert nibabel.load(tmp_path / "w.nii").header["intent_code"] == 1002
    write(volume.indicator(1), tmp_path / "w.nii")  # no longer labels
    assert nibabel.load(tmp_path / "w.nii").header["intent_code"] == 0


def test_volumes_are_written_with_their_time_step(tmp_path: Path) -> None:
    image = nibabel.Nifti1Image(series(5), AFFINE)
    image.header.set_xyzt_units("mm", "msec")
    image.header["pixdim"][4] = 800
    nibabel.save(image, tmp_path / "v.nii")
    every = read_all(tmp_path / "v.nii")
    write(every, tmp_path / "w.nii.gz")
    again = nibabel.load(tmp_path / "w.nii.gz")
    np.testing.assert_array_equal(again.dataobj, series(5))
    assert (again.header.get_zooms()[3], again.header.get_xyzt_units()) == (800, ("mm", "msec"))
    np.testing.assert_allclose(again.affine, AFFINE, rtol=1e-6)
    write(every[0], tmp_path / "one.nii")
    assert nibabel.load(tmp_path / "one.nii").shape == SHAPE
    two = Volumes(np.zeros((2, 3, 2, 2, 2), np.uint8), leading=Leading(("time", "position"), (2, 3)))
    with pytest.raises(FormatError, match="no leading axis but channels and one other"):
        write(two, tmp_path / "w.nii")
    with pytest.raises(FormatError, match="measures in mm"):
        write(Volumes(np.zeros((2, 2, 2, 2), np.uint8), units="um"), tmp_path / "w.nii")


# -- units, frames and windows are the same by every route ------------------------------------------


@pytest.mark.parametrize("suffix", [".nii", ".nii.gz", ".nrrd", ".mha", ".mgz", ".img"])
def test_every_route_gives_the_same_geometry(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"v{suffix}"
    if suffix == ".mgz":
        nibabel.save(nibabel.freesurfer.MGHImage(series(), AFFINE.astype(np.float32)), path)
    else:
        image = sitk.GetImageFromArray(series().T)
        image.SetSpacing((0.5, 1.5, 2.0))
        image.SetOrigin((1, -2, 3))
        image.SetDirection(OBLIQUE.ravel().tolist())
        sitk.WriteImage(image, str(path))
    volume = read(path)
    assert (volume.units, volume.space) == ("mm", "LPS")
    np.testing.assert_array_equal(volume.data, series().T)
    routes: list[Any] = [volume.to_sitk(), volume.to_nibabel()]
    if suffix != ".mgz":
        routes.append(sitk.ReadImage(str(path)))
    if suffix not in (".nrrd", ".mha"):
        routes.append(nibabel.load(path))
    for other in routes:
        same_grid(volume, Volume(other))
        np.testing.assert_array_equal(Volume(other).data, volume.data)


# -- NRRD and MetaImage ------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".nrrd", ".nhdr", ".mha", ".mhd"])
@pytest.mark.parametrize(
    ("dtype", "channels", "computed"),
    [("uint8", 3, "luminance"), ("float32", 3, "magnitude"), ("int16", 3, ""), ("float32", 2, "")],
)
def test_several_values_per_voxel(tmp_path: Path, suffix: str, dtype: str, channels: int, computed: str) -> None:
    data = np.moveaxis(series(channels, dtype=dtype).T, 0, -1)  # z, y, x, channel
    image = sitk.GetImageFromArray(data, isVector=True)
    image.SetSpacing((1, 2, 3))
    path = tmp_path / f"v{suffix}"
    sitk.WriteImage(image, str(path), useCompression=suffix == ".mha")
    if suffix.startswith(".n") or not computed:  # in NRRD they have a kind, for which ITK writes vector
        every = read_all(path)
    else:
        with pytest.warns(ClvolWarning, match="values of each voxel were taken for"):
            every = read_all(path)
        assert every.leading.computed == computed
    assert every.axes == ("channel",)
    np.testing.assert_array_equal(every, np.moveaxis(data, -1, 0))
    assert every[0].spacing == (1, 2, 3)
    write(every, tmp_path / f"again{suffix}")
    again = sitk.ReadImage(str(tmp_path / f"again{suffix}"))
    np.testing.assert_array_equal(sitk.GetArrayFromImage(again), data)
    assert (again.GetSpacing(), again.GetNumberOfComponentsPerPixel()) == ((1, 2, 3), channels)
    with pytest.raises(OptionError, match=f"holds {channels} channels"):
        read(path, channel=channels)


@pytest.mark.parametrize("suffix", [".nrrd", ".mha"])
def test_a_fourth_axis(tmp_path: Path, suffix: str) -> None:
    image = sitk.GetImageFromArray(series(5).T, isVector=False)
    image.SetSpacing((1, 2, 3, 0.5))
    sitk.WriteImage(image, str(tmp_path / f"v{suffix}"))
    every = read_all(tmp_path / f"v{suffix}")
    assert (every.axes, every[0].spacing, every[0].header["time_step"]) == (("volume",), (1, 2, 3), 0.5)
    np.testing.assert_array_equal(every, series(5).T)
    np.testing.assert_array_equal(read(tmp_path / f"v{suffix}", volume=3).data, series(5)[..., 3].T)
    write(every, tmp_path / f"again{suffix}")
    again = sitk.ReadImage(str(tmp_path / f"again{suffix}"))
    assert (again.GetSize(), again.GetSpacing()) == (image.GetSize(), image.GetSpacing())
    np.testing.assert_array_equal(sitk.GetArrayFromImage(again), series(5).T)


@pytest.mark.parametrize(
    ("kinds", "directions", "axis", "leading"),
    [
        ("list domain domain domain", "none (2,0,0) (0,3,0) (0,0,4)", 0, "volume"),
        ("domain domain domain list", "(2,0,0) (0,3,0) (0,0,4) none", 3, "volume"),
        ("3-vector domain domain domain", "none (2,0,0) (0,3,0) (0,0,4)", 0, "channel"),
        ("domain domain domain RGB-color", "(2,0,0) (0,3,0) (0,0,4) none", 3, "channel"),
    ],
)
def test_kinds_of_nrrd(tmp_path: Path, kinds: str, directions: str, axis: int, leading: str) -> None:
    data = np.arange(3 * 24, dtype=np.uint8).reshape((2, 3, 4, 3) if axis == 0 else (3, 2, 3, 4))  # slowest first
    sizes = " ".join(map(str, data.shape[::-1]))
    (tmp_path / "v.nrrd").write_bytes(
        f"NRRD0005\ntype: uchar\ndimension: 4\nspace: RAS\nsizes: {sizes}\nencoding: raw\nkinds: {kinds}\n"
        f"space directions: {directions}\nspace origin: (1,2,3)\n\n".encode()
        + data.tobytes()
    )
    every = read_all(tmp_path / "v.nrrd")
    assert every.axes == (leading,)
    assert every.leading.computed == {"3": "magnitude", "d": "luminance"}.get(kinds[0] if leading == "channel" else "", "")
    np.testing.assert_array_equal(every, np.moveaxis(data, -1, 0) if axis == 0 else data)
    np.testing.assert_allclose(every[0].index_to_world([1, 1, 1], frame="RAS"), [3, 5, 7])


def test_an_axis_of_time_in_nrrd(tmp_path: Path) -> None:
    text = "NRRD0005\ntype: short\ndimension: 4\nsizes: 4 3 2 5\nendian: little\nencoding: raw\nspacings: 1 2 3 0.5\nkinds: {}\n\n"
    (tmp_path / "v.nrrd").write_bytes(text.format("domain domain domain time").encode() + series(5).T.tobytes())
    with pytest.warns(ClvolWarning, match="5 times; time 0 was read: choose by time="):
        first = read(tmp_path / "v.nrrd")
    assert (first.spacing, first.header) == ((1, 2, 3), {"time_step": 0.5})
    np.testing.assert_array_equal(read(tmp_path / "v.nrrd", time=2).data, series(5)[..., 2].T)
    (tmp_path / "v.nrrd").write_bytes(text.format("time domain domain domain").encode() + series(5).T.tobytes())
    with pytest.raises(FormatError, match="time last"):
        read(tmp_path / "v.nrrd")


# -- FreeSurfer --------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".mgh", ".mgz"])
def test_mgh(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"v{suffix}"
    nibabel.save(nibabel.freesurfer.MGHImage(series(5, dtype="float32"), AFFINE.astype(np.float32)), path)
    image = nibabel.load(path)
    one = read(path, volume=3)
    np.testing.assert_array_equal(one.data, series(5)[..., 3].T)
    np.testing.assert_array_equal(read_all(path), series(5).T)
    np.testing.assert_array_equal(Volumes(image), series(5).T)
    same_grid(one, Volumes(image)[3])
    np.testing.assert_allclose(one.index_to_world([3, 2, 1], frame="RAS"), (image.affine @ [3, 2, 1, 1])[:3], rtol=1e-6)
    whole = path.read_bytes()
    for keep in (0, 100, 290, len(whole) // 2, len(whole) - (60 if suffix == ".mgh" else 30)):
        path.write_bytes(whole[:keep])
        with pytest.raises(FormatError):
            read(path, volume=4)


# -- DICOM -------------------------------------------------------------------------------------


def enhanced(data: np.ndarray, positions: list[tuple[float, ...]]) -> bytes:
    """A multi-frame CT, as section C.7.6.16 of the standard defines it: what varies between frames is in a sequence."""
    kind = "1.2.840.10008.5.1.4.1.1.2.1"
    shared = sequence(0x00209116, element(0x00200037, "DS", "0\\1\\0\\1\\0\\0"))
    shared += sequence(0x00289110, element(0x00180050, "DS", "2.5") + element(0x00280030, "DS", "0.75\\0.5"))
    values = element(0x00281052, "DS", "-1000") + element(0x00281053, "DS", "2") + element(0x00281054, "LO", "HU")
    shared += sequence(0x00289145, values)
    window = sequence(0x00289132, element(0x00281050, "DS", "40") + element(0x00281051, "DS", "400"))
    places = ["\\".join(f"{c:g}" for c in position) for position in positions]
    frames = [sequence(0x00209113, element(0x00200032, "DS", place)) + window for place in places]
    meta = element(0x00020001, "OB", b"\0\1") + element(0x00020002, "UI", kind) + element(0x00020003, "UI", "1.2.3.4")
    meta += element(0x00020010, "UI", "1.2.840.10008.1.2.1") + element(0x00020012, "UI", "1.2.3")
    body = element(0x00080016, "UI", kind) + element(0x00080018, "UI", "1.2.3.4") + element(0x00080060, "CS", "CT")
    body += element(0x0008103E, "LO", "Head thin") + element(0x0020000D, "UI", "1.2") + element(0x0020000E, "UI", "1.2.5")
    body += element(0x00280002, "US", struct.pack("<H", 1)) + element(0x00280004, "CS", "MONOCHROME2")
    body += element(0x00280008, "IS", str(len(data)))
    for tag, value in zip((0x10, 0x11, 0x100, 0x101, 0x102, 0x103), (*data.shape[1:], 16, 16, 15, 0), strict=True):
        body += element(0x00280000 | tag, "US", struct.pack("<H", value))
    body += sequence(0x52009229, shared) + sequence(0x52009230, *frames) + element(0x7FE00010, "OW", data.astype("<u2").tobytes())
    return bytes(128) + b"DICM" + element(0x00020000, "UL", struct.pack("<I", len(meta))) + meta + body


@pytest.mark.parametrize("name", ["v.dcm", "v.IMA", "IM0001"])
def test_dicom_with_many_frames(tmp_path: Path, name: str) -> None:
    data, order = np.arange(60, dtype=np.uint16).reshape(4, 3, 5), [0, 3, 1, 2]
    (tmp_path / name).write_bytes(enhanced(data, [(1, 2, 10 - 2.5 * k) for k in order]))
    for path in (tmp_path / name, tmp_path):
        volume = read(path)
        np.testing.assert_array_equal(volume.data, 2.0 * data[np.argsort(order)] - 1000)
        assert (volume.name, volume.clim, volume.header) == ("Head thin", (-160, 240), {"modality": "CT"})
        assert (volume.units, volume.space) == ("mm", "LPS")
        # rows run along y of the patient, 0.5 apart, and columns along x, 0.75 apart
        np.testing.assert_allclose(volume.index_to_world([1, 1, 1]), [1 + 0.75, 2 + 0.5, 10 - 2.5])


def test_dicom_with_frames_at_one_position(tmp_path: Path) -> None:
    data = np.arange(60, dtype=np.uint16).reshape(4, 3, 5)
    (tmp_path / "v.dcm").write_bytes(enhanced(data, [(1, 2, 10 + 2.5 * (k // 2)) for k in range(4)]))
    with pytest.warns(ClvolWarning, match=r"2 volumes.*images of each place were taken for volumes"):
        read(tmp_path / "v.dcm")
    with pytest.warns(ClvolWarning, match="taken for volumes"):
        np.testing.assert_array_equal(read(tmp_path / "v.dcm", volume=1).data, 2.0 * data[[1, 3]] - 1000)
    with pytest.raises(OptionError, match="holds 2 volumes"):
        read(tmp_path / "v.dcm", volume=2)
    with pytest.raises(OptionError, match=r"series is for a folder"):
        read(tmp_path / "v.dcm", series=0)
    (tmp_path / "v.dcm").write_bytes(enhanced(data, [(1, 2, z) for z in (0, 1, 2, 7)]))
    with pytest.raises(FormatError, match="1 to 5 mm apart"):
        read(tmp_path / "v.dcm")


def test_dicom_of_a_film(tmp_path: Path) -> None:
    """Frames of an ultrasound probe that is held still have no positions."""
    whole = enhanced(np.arange(60, dtype=np.uint16).reshape(4, 3, 5), [])
    frame_time = element(0x00181063, "DS", "40")
    at = whole.index(element(0x0020000D, "UI", "1.2"))
    (tmp_path / "v.dcm").write_bytes(whole[:at] + frame_time + whole[at:])
    with pytest.warns(ClvolWarning, match="4 times; time 0 was read: choose by time="):
        first = read(tmp_path / "v.dcm")
    assert (first.shape, first.header["time_step"], first.header["time_unit"]) == ((1, 3, 5), 40, "msec")
    (tmp_path / "v.dcm").write_bytes(whole)
    with pytest.warns(ClvolWarning, match="does not say where its 4 frames lie, they were taken for slices"):
        assert read(tmp_path / "v.dcm").shape == (4, 3, 5)


def test_dicom_in_colour(tmp_path: Path) -> None:
    data = np.moveaxis(series(3, dtype="uint8").T, 0, -1)
    sitk.WriteImage(sitk.GetImageFromArray(data[:1], isVector=True), str(tmp_path / "v.dcm"))
    every = read_all(tmp_path / "v.dcm")
    assert (every.leading.rgb, every.names) == (True, ("red", "green", "blue"))
    np.testing.assert_array_equal(every, np.moveaxis(data[:1], -1, 0))
    assert read(tmp_path / "v.dcm", channel="green").data.tolist() == data[:1, ..., 1].tolist()
    assert read(tmp_path / "v.dcm").name == "luminance"


def test_dicom_truncated(tmp_path: Path) -> None:
    whole = enhanced(np.zeros((2, 3, 5), np.uint16), [(0, 0, 0), (0, 0, 1)])
    for keep in (*range(0, len(whole), 97), len(whole) - 1):
        (tmp_path / "v.dcm").write_bytes(whole[:keep])
        with pytest.raises(FormatError):
            read(tmp_path / "v.dcm")


@pytest.mark.filterwarnings("error::clvol.ClvolWarning")
def test_a_heart_has_its_metadata(tmp_path: Path) -> None:
    if not (DATA / "mr_series_dicom.tar.xz").exists():
        pytest.skip("no mr_series_dicom.tar.xz: set CLVOL_DATA to the folder that holds it")
    with tarfile.open(DATA / "mr_series_dicom.tar.xz") as archive:
        member = next(file for file in archive if file.name.endswith(".dcm"))
        archive.extract(member, tmp_path, filter="data")
    path = tmp_path / member.name
    shutil.copy(path, tmp_path / "IM1")
    for file in (path, tmp_path / "IM1", path.parent):
        slice_ = read(file)  # no warning: no other lies beside it
        assert (slice_.name, slice_.header["modality"]) == ("My Special Series For Testing", "MR")
        assert slice_.clim is not None
        np.testing.assert_array_equal(slice_.data, sitk.GetArrayFromImage(sitk.ReadImage(str(path))))
        assert slice_.spacing[2] == 2.5  # its thickness, where ITK takes 1: nothing says how far the next slice would be
        same_grid(replace(slice_, clim=None, spacing=(*slice_.spacing[:2], 1.0)), Volume(sitk.ReadImage(str(path))))
    (path.parent / ("._" + path.name)).write_bytes(bytes.fromhex("00051607") + bytes(200))  # as Macs leave beside files
    (path.parent / "notes.txt").write_text("not a slice")
    np.testing.assert_array_equal(read(path.parent).data, slice_.data)
    (one,) = clvol.formats.series_of(path.parent)
    assert one.text == "MR, My Special Series For Testing, 1 file"
    shutil.copy(path, path.with_name("other.dcm"))
    with pytest.warns(ClvolWarning, match="it is one slice, and 1 more DICOM files lie beside it: give the folder"):
        read(path)
    image = sitk.ReadImage(str(path))
    center, width = (float(image.GetMetaData(tag)) for tag in ("0028|1050", "0028|1051"))
    assert slice_.clim == (center - width / 2, center + width / 2)


# -- NumPy --------------------------------------------------------------------------------------


def test_npz_preserves_all_metadata(tmp_path: Path) -> None:
    said: dict[str, Any] = {"space": "LPS", "name": "µ", "color": (1.0, 0.5, 0.0), "clim": (-1.0, 2.5), "labels": {3: "liver"}}
    header = {"sform_code": 4, "intent_p": (1.0, 2.0), "step": np.float32(0.5)}
    volume = Volume(series().T, (1, 2, 3), (4, 5, 6), OBLIQUE, "um", **said, header=header)
    write(volume, tmp_path / "v.npz")
    again = read(tmp_path / "v.npz")
    assert {name: getattr(again, name) for name in said} == said
    assert again.header == {"sform_code": 4, "intent_p": [1.0, 2.0], "step": 0.5}
    same_grid(again, volume)
    for labels in (True, False, None):
        write(Volume(series().T, labels=labels), tmp_path / "v.npz")
        assert read(tmp_path / "v.npz").labels is labels


def test_npz_stores_several_volumes(tmp_path: Path) -> None:
    leading = Leading(("time", "channel"), (2, 2), {"channel": ("a", "b")}, ("red", None), ((0.0, 1.0), None))  # type: ignore[arg-type]
    every = Volumes(series(2, 2).T, leading=leading, spacing=(1, 2, 3), units="um", space="image")
    write(every, tmp_path / "v.npz")
    again = read_all(tmp_path / "v.npz")
    assert again.leading == every.leading
    np.testing.assert_array_equal(again, every)
    one = read(tmp_path / "v.npz", time=1, channel="a")
    assert (one.name, one.color, one.clim, one.space, one.spacing) == ("a", (1, 0, 0), (0, 1), "image", (1, 2, 3))


def test_axes_of_arrays_are_guessed(tmp_path: Path) -> None:
    np.save(tmp_path / "v.npy", series(5).T)
    with pytest.warns(ClvolWarning, match=r"5 volumes; volume 0 was read: .*taken for volume \(5\), z \(2\)"):
        np.testing.assert_array_equal(read(tmp_path / "v.npy").data, series(5)[..., 0].T)
    np.testing.assert_array_equal(read(tmp_path / "v.npy", time=3).data, series(5)[..., 3].T)  # the caller explains the axis
    with pytest.warns(ClvolWarning, match="taken for"):
        np.testing.assert_array_equal(read_all(tmp_path / "v.npy"), series(5).T)
    np.savez(tmp_path / "v.npz", data=series(5).T, spacing=(1, 2, 3))
    with pytest.warns(ClvolWarning, match="taken for"):
        assert read(tmp_path / "v.npz", volume=4).spacing == (1, 2, 3)


def test_metadata_of_images_need_no_samples() -> None:
    """Large files are rejected, or chosen from, before they are loaded."""
    assert describe_simpleitk(sitk.Image([2, 3, 4, 5], sitk.sitkUInt8))["leading"]["counts"] == (5,)
    proxy = nibabel.Nifti1Image(np.broadcast_to(np.int16(0), (1000, 1000, 1000, 50)), AFFINE)
    assert describe_nibabel(proxy)["leading"]["counts"] == (50,)
    with pytest.raises(DataError, match=r"50 volumes: take one as clvol\.Volumes"):
        Volume(proxy)


def test_the_grid_of_a_series() -> None:
    """``like=`` accepts an image of several volumes with one grid, and loads none of them."""
    image = nibabel.Nifti1Image(np.broadcast_to(np.int16(0), (500, 1000, 1000, 50)), AFFINE)
    grid = Volume(nibabel.Nifti1Image(np.zeros((500, 1000, 1), np.int16), AFFINE))
    found = as_grid(image)
    assert found.shape == (1000, 1000, 500)
    same_grid(found, replace(grid, data=found.data))
    several = Volumes(nibabel.Nifti1Image(series(5), AFFINE))
    for like in (several, several.to_sitk(), several.to_nibabel(), several.to_xarray(), several[3]):
        same_grid(as_grid(like), replace(several[0], data=as_grid(like).data, clim=None))
        assert clvol.resample(several[1], like=like, dtype="same").data.tolist() == several[1].data.tolist()
    assert Volumes([several[1].to_nibabel(), several[3].to_sitk()])[1].data.tolist() == several[3].data.tolist()
    with pytest.raises(DataError, match=r"got Volumes of 5 \w+s: take one, as volumes\[0\]"):
        clvol.resample(several, spacing=1)  # type: ignore[arg-type]
    with pytest.raises(DataError, match=r"'scan\.nii': clvol\.read\(path\) reads a file"):
        clvol.render("scan.nii")
