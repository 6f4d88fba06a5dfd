"""NIfTI files compared with nibabel: headers are built byte by byte; nibabel's affine and samples are the truth."""

from __future__ import annotations

import gzip
import math
import struct
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clvol
from clvol.base.errors import ClvolError, FormatError, GeometryError

nibabel = pytest.importorskip("nibabel")

SIZE = (4, 3, 2)  # x, y, z
SAMPLES = np.arange(24, dtype=np.int16).reshape(SIZE[::-1]) * 100 - 700
TURN = np.array([0.1, -0.3, 0.4])  # quaternion parts b, c, d
OFFSET = (-90.0, 126.5, -72.25)
SHEARED = ((2.0, 0.6, 0.0, 10.0), (0.0, 1.5, 0.2, -20.0), (0.1, 0.0, 3.0, 30.0))
FIELDS = {
    "length": (0, "i", (348,)),
    "dim": (40, "8h", (3, *SIZE, 1, 1, 1, 1)),
    "datatype": (70, "2h", (4, 16)),
    "pixdim": (76, "8f", (1.0, 0.9, 1.1, 2.5, 1.0, 1.0, 1.0, 1.0)),
    "vox_offset": (108, "f", (352.0,)),
    "scaling": (112, "2f", (1.0, 0.0)),
    "xyzt_units": (123, "B", (2,)),
    "codes": (252, "2h", (0, 0)),  # of qform and sform
    "qform": (256, "6f", (*TURN, *OFFSET)),
    "sform": (280, "12f", sum(SHEARED, ())),
    "magic": (344, "4s", (b"n+1\0",)),
}


def nifti(path: Path, order: str = "<", data: np.ndarray = SAMPLES, **fields: tuple[Any, ...]) -> Path:
    """A file with these header fields replaced."""
    head = bytearray(int(fields.get("vox_offset", (352,))[0]))
    for name, (at, kind, values) in FIELDS.items():
        struct.pack_into(order + kind, head, at, *fields.get(name, values))
    content = bytes(head) + data.astype(data.dtype.newbyteorder(order)).tobytes()
    path.write_bytes(gzip.compress(content) if path.suffix == ".gz" else content)
    return path


def assert_as_nibabel(path: Path, millimetres: float = 1.0) -> clvol.Volume:
    """Both routes give nibabel's samples, to the last bit, and its corners."""
    image = nibabel.load(path)
    corners = np.array(np.meshgrid([-0.5, 9], [0, 7], [0, 3] if len(image.shape) > 2 else [0])).reshape(3, -1)
    right_anterior_superior = image.affine[:3, :3] @ corners + image.affine[:3, 3:]
    truth = millimetres * right_anterior_superior * [[-1], [-1], [1]]
    samples = np.asanyarray(image.dataobj)
    for volume in (clvol.read(path), clvol.Volume(image)):
        d = volume.ndim
        np.testing.assert_allclose(volume.index_to_world(corners[:d].T).T, truth[:d], rtol=1e-12, atol=1e-10)
        np.testing.assert_array_equal(volume.data, samples.reshape(samples.shape[:d]).T)
        assert volume.data.dtype.newbyteorder("=") == samples.dtype.newbyteorder("=")
        assert volume.units == "mm"
    return clvol.read(path)


# -- which file ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("neighbour", ["x.nii", "x.img", "x.hdr", "x"])
def test_a_file_of_a_similar_name_is_ignored(tmp_path: Path, neighbour: str) -> None:
    """ITK searches for the image by name: of ``x.nii.gz`` and ``x.nii`` it reads the latter."""
    path = nifti(tmp_path / "x.nii.gz")
    nifti(tmp_path / neighbour, data=SAMPLES + 1000, pixdim=(1, 7, 7, 7, 1, 1, 1, 1))
    np.testing.assert_array_equal(clvol.read(path).data, SAMPLES)
    if neighbour == "x.nii":
        np.testing.assert_array_equal(clvol.read(tmp_path / neighbour).data, SAMPLES + 1000)


def test_an_uncompressed_file_beside_a_compressed_one(tmp_path: Path) -> None:
    path = nifti(tmp_path / "x.nii")
    nifti(tmp_path / "x.nii.gz", data=SAMPLES + 1000)
    np.testing.assert_array_equal(clvol.read(path).data, SAMPLES)


# -- geometry --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("suffix", [".nii", ".nii.gz"])
@pytest.mark.parametrize("codes", [(0, 0), (1, 0), (0, 1), (1, 1), (2, 4), (1, 5), (3, 9), (1, -1), (7, 0), (-2, 0)])
def test_sform_then_qform_then_pixdim(tmp_path: Path, codes: tuple[int, int], suffix: str, order: str) -> None:
    """The two differ, as after registration; unknown codes count as 0."""
    assert_as_nibabel(nifti(tmp_path / f"v{suffix}", order, codes=codes))


def test_a_registered_file_uses_its_sform(tmp_path: Path) -> None:
    """By hand, without nibabel: sform and qform are 17° and 170 mm apart."""
    angle = math.radians(17)
    rows = (*(2 * math.cos(angle), -2 * math.sin(angle), 0, 170), *(2 * math.sin(angle), 2 * math.cos(angle), 0, 0), *(0, 0, 2, 0))
    volume = clvol.read(nifti(tmp_path / "v.nii", codes=(1, 2), sform=rows, qform=(0,) * 6))
    np.testing.assert_allclose(volume.spacing, 2, rtol=1e-7)
    np.testing.assert_allclose(volume.origin, (-170, 0, 0))
    turn = [[-math.cos(angle), math.sin(angle), 0], [-math.sin(angle), -math.cos(angle), 0], [0, 0, 1]]
    np.testing.assert_allclose(volume.direction, turn, atol=1e-7)


@pytest.mark.parametrize("pixdim", [(1, 9, 9, 9), (1, 0, 0, 0), (1, math.nan, 1, 1), (1, -1, 1, 1)], ids=str)
def test_a_sound_sform_needs_no_pixdim(tmp_path: Path, pixdim: tuple[float, ...]) -> None:
    volume = assert_as_nibabel(nifti(tmp_path / "v.nii", codes=(0, 1), pixdim=(*pixdim, 0, 0, 0, 0)))
    np.testing.assert_allclose(volume.spacing, np.linalg.norm(np.array(SHEARED)[:, :3], axis=0), rtol=1e-7)


@pytest.mark.parametrize("qfac", [1, -1, 0, -0.5, 3, math.nan])
@pytest.mark.parametrize("turn", [(0, 0, 0), tuple(TURN), (1, 0, 0), (0.6, 0.8, 0), (0.6, -0.48, 0.64)], ids=str)
def test_quaternions(tmp_path: Path, turn: tuple[float, ...], qfac: float) -> None:
    """Including half turns, where rounding makes the vector part longer than 1."""
    pixdim = (qfac, 0.9, 1.1, 2.5, 0, 0, 0, 0)
    assert_as_nibabel(nifti(tmp_path / "v.nii", codes=(1, 0), qform=(*turn, *OFFSET), pixdim=pixdim))


@pytest.mark.parametrize("codes", [(0, 0), (1, 0)])
def test_negative_pixdim(tmp_path: Path, codes: tuple[int, int]) -> None:
    assert_as_nibabel(nifti(tmp_path / "v.nii", codes=codes, pixdim=(1, -0.9, 1.1, -2.5, 0, 0, 0, 0)))


@pytest.mark.parametrize("codes", [(0, 0), (1, 0)])
@pytest.mark.parametrize("unknown", [0, math.nan, math.inf, -math.inf])
def test_unknown_spacing_is_an_error(tmp_path: Path, unknown: float, codes: tuple[int, int]) -> None:
    """Not 1: only the caller knows it. (nibabel replaces 0 by 1 on loading, and logs it.)"""
    path = nifti(tmp_path / "v.nii", codes=codes, pixdim=(1, 0.9, 1.1, unknown, 1, 1, 1, 1))
    with pytest.raises(GeometryError, match=r"v\.nii: (spacing|its pixdim) must .*(finite|positive).*spacing=.*replace"):
        clvol.read(path)
    assert clvol.read(path, spacing=(0.9, 1.1, 3)).spacing == (0.9, 1.1, 3)
    if unknown:
        with pytest.raises(GeometryError, match="finite"):
            clvol.Volume(nibabel.load(path))


def test_an_unused_placement_may_be_invalid(tmp_path: Path) -> None:
    nowhere = (math.nan,) * 12
    assert_as_nibabel(nifti(tmp_path / "a.nii", codes=(1, 0), sform=nowhere))
    assert_as_nibabel(nifti(tmp_path / "b.nii", codes=(0, 1), qform=nowhere[:6]))
    assert_as_nibabel(nifti(tmp_path / "c.nii", codes=(0, 0), qform=nowhere[:6], sform=nowhere))


@pytest.mark.parametrize(
    "fields",
    [
        {"codes": (0, 1), "sform": (math.inf, *FIELDS["sform"][2][1:])},
        {"codes": (0, 1), "sform": (0,) * 12},
        {"codes": (0, 1), "sform": (1, 2, 0, 0, 1, 2, 0, 0, 0, 0, 1, 0)},
        {"codes": (1, 0), "qform": (math.nan, *FIELDS["qform"][2][1:])},
        {"codes": (1, 0), "qform": (1, 1, 0, *OFFSET)},
        {"scaling": (1.0, math.inf)},
    ],
    ids=["sform not finite", "sform zero", "sform flat", "qform not finite", "quaternion too long", "offset not finite"],
)
def test_invalid_headers_are_errors_by_every_route(tmp_path: Path, fields: dict[str, Any]) -> None:
    path = nifti(tmp_path / "v.nii", **fields)
    with pytest.raises((FormatError, GeometryError)):
        clvol.read(path)
    with pytest.raises((ClvolError, ValueError, nibabel.spatialimages.HeaderDataError)):  # some are nibabel's own
        clvol.Volume(nibabel.load(path))


@pytest.mark.parametrize(("code", "millimetres"), [(0, 1.0), (1, 1e3), (2, 1.0), (3, 1e-3), (3 + 8, 1e-3)])
@pytest.mark.parametrize("codes", [(0, 0), (1, 0), (0, 1)])
def test_units(tmp_path: Path, codes: tuple[int, int], code: int, millimetres: float) -> None:
    """nibabel's affine is in the file's unit, ours in millimetres."""
    assert_as_nibabel(nifti(tmp_path / "v.nii", codes=codes, xyzt_units=(code,)), millimetres)


@pytest.mark.parametrize("code", [4, 5, 6, 7, 7 + 16])
def test_unknown_units_are_errors_by_every_route(tmp_path: Path, code: int) -> None:
    path = nifti(tmp_path / "v.nii", xyzt_units=(code,))
    with pytest.raises(FormatError, match="xyzt_units 1, 2 or 3"):
        clvol.read(path)
    with pytest.raises(GeometryError, match="xyzt_units 1, 2 or 3"):
        clvol.Volume(nibabel.load(path))


@pytest.mark.parametrize("code", [2 + 56, 3 + 64, 1 + 248])
def test_an_unknown_unit_of_time_does_not_affect_space(tmp_path: Path, code: int) -> None:
    assert_as_nibabel(nifti(tmp_path / "v.nii", xyzt_units=(code,)), {1: 1e3, 2: 1.0, 3: 1e-3}[code & 7])


# -- samples ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "scaling",
    [
        *[(1, 0), (2, 5), (0.1, -1024), (1, -1024), (-3, 0), (1e-16, 0), (1e-30, 0), (1e-38, 1e-38), (1e-3, 101325), (1e30, 0)],
        *[(0, 7), (math.nan, 7), (math.inf, 7), (0, math.nan)],  # no scale is given
    ],
    ids=str,
)
@pytest.mark.parametrize("order", ["<", ">"])
def test_scaling(tmp_path: Path, scaling: tuple[float, float], order: str) -> None:
    path = nifti(tmp_path / "v.nii", order, scaling=scaling)
    volume = assert_as_nibabel(path)
    slope, offset = (float(np.float32(v)) for v in scaling)
    given = math.isfinite(slope) and slope != 0
    np.testing.assert_array_equal(volume.data, SAMPLES * slope + offset if given else SAMPLES)
    np.testing.assert_array_equal(volume.data, nibabel.load(path).get_fdata().T)


@pytest.mark.parametrize("code", [(2, "u1"), (4, "i2"), (8, "i4"), (16, "f4"), (64, "f8"), (256, "i1"), (512, "u2")], ids=str)
@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("scaling", [(1.0, 0.0), (0.25, 3.0)], ids=str)
def test_types(tmp_path: Path, scaling: tuple[float, float], order: str, code: tuple[int, str]) -> None:
    data = np.random.default_rng(3).integers(0, 100, SIZE[::-1]).astype(code[1])
    fields = {"datatype": (code[0], 8 * data.itemsize), "scaling": scaling}
    assert_as_nibabel(nifti(tmp_path / "v.nii.gz", order, data, **fields))


@pytest.mark.parametrize("code", [(768, "u4"), (1024, "i8"), (1280, "u8")], ids=str)
def test_wide_integers_keep_every_bit(tmp_path: Path, code: tuple[int, str]) -> None:
    data = np.full(SIZE[::-1], np.iinfo(code[1]).max, code[1])
    assert_as_nibabel(nifti(tmp_path / "v.nii", ">", data, datatype=(code[0], 8 * data.itemsize)))


@pytest.mark.parametrize("start", [352, 368, 1000, 4096])
@pytest.mark.parametrize("suffix", [".nii", ".nii.gz"])
def test_extensions_before_the_samples_are_skipped(tmp_path: Path, suffix: str, start: int) -> None:
    assert_as_nibabel(nifti(tmp_path / f"v{suffix}", vox_offset=(float(start),)))


@pytest.mark.parametrize("start", [348, 349, 351])
@pytest.mark.parametrize("suffix", [".nii", ".nii.gz"])
def test_samples_begin_after_the_extension_flag(tmp_path: Path, suffix: str, start: int) -> None:
    path = nifti(tmp_path / f"v{suffix}", vox_offset=(float(start),))
    with pytest.raises(FormatError, match=f"352 or later; its header says {start}"):
        clvol.read(path)
    with pytest.raises(nibabel.spatialimages.HeaderDataError, match="vox offset"):
        nibabel.load(path)


def test_samples_beyond_the_end_are_an_error(tmp_path: Path) -> None:
    path = nifti(tmp_path / "v.nii")
    content = bytearray(path.read_bytes())
    struct.pack_into("<f", content, 108, 3e14)
    path.write_bytes(content)
    with pytest.raises(FormatError, match=r"must hold 48 bytes of samples.*found 0$"):
        clvol.read(path)


def test_a_compressed_file_is_measured_before_large_allocations(tmp_path: Path) -> None:
    """250 kB of gzip could contain the 250 MB that this header promises, but do not."""
    path = nifti(tmp_path / "v.nii", datatype=(2, 8), dim=(3, 500, 500, 1000, 1, 1, 1, 1))
    noise = np.random.default_rng(0).bytes(1 << 18)
    packed = tmp_path / "v.nii.gz"
    packed.write_bytes(gzip.compress(path.read_bytes() + noise))
    tracemalloc.start()
    try:
        with pytest.raises(FormatError, match="must hold 250000000 bytes of samples"):
            clvol.read(packed)
        assert tracemalloc.get_traced_memory()[1] < 1 << 24
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    "dim", [(4, 4, 3, 2, 1, 0, 0, 0), (7, 4, 3, 2, 1, 1, 1, 1), (3, 24, 1, 1, 0, 0, 0, 0), (3, 1, 1, 24, 1, 1, 1, 1)]
)
@pytest.mark.parametrize("codes", [(0, 0), (1, 1)])
def test_axes_of_one_sample(tmp_path: Path, codes: tuple[int, int], dim: tuple[int, ...]) -> None:
    assert assert_as_nibabel(nifti(tmp_path / "v.nii", codes=codes, dim=dim)).shape == dim[3:0:-1]


@pytest.mark.parametrize("codes", [(0, 0), (1, 0), (0, 1)])
def test_images(tmp_path: Path, codes: tuple[int, int]) -> None:
    """Of two axes; pixdim and dim past them say nothing."""
    flat = (0.0, -2.0, 0.0, 5.0, 3.0, 0.0, 0.0, 6.0, 0.0, 0.0, 1.0, 0.0)
    fields = {"dim": (2, 6, 4, 0, 0, 0, 0, 0), "pixdim": (1, 0.9, 1.1, 1, 0, 0, 0, 0), "qform": (0, 0, 0.6, *OFFSET), "sform": flat}
    assert assert_as_nibabel(nifti(tmp_path / "v.nii", codes=codes, **fields)).shape == (4, 6)


def test_an_image_across_the_plane_is_an_error_by_every_route(tmp_path: Path) -> None:
    path = nifti(tmp_path / "v.nii", codes=(1, 0), dim=(2, 6, 4, 1, 1, 1, 1, 1))
    for way_in in (clvol.read, lambda path: clvol.Volume(nibabel.load(path))):
        with pytest.raises(GeometryError, match="must be in the xy plane"):
            way_in(path)


def test_frames_are_the_same_by_every_route(tmp_path: Path) -> None:
    path = nifti(tmp_path / "v.nii", dim=(4, 4, 3, 1, 2, 1, 1, 1))
    frames, direct = clvol.read_all(path), clvol.Volumes(nibabel.load(path))
    np.testing.assert_array_equal(frames, direct)
    np.testing.assert_array_equal(frames[1].corners, direct[1].corners)


@pytest.mark.parametrize("kind", [np.uint8, np.int16, np.float32, np.float64])
def test_files_written_by_nibabel(tmp_path: Path, kind: type) -> None:
    """nibabel stores floats as integers with a scale that it chooses."""
    affine = np.array(np.vstack([SHEARED, (0, 0, 0, 1)]))
    values = np.random.default_rng(1).normal(40, 1e-20 if kind is np.float64 else 15, SIZE)
    image = nibabel.Nifti1Image(values, affine)
    image.set_data_dtype(kind)
    image.set_qform(np.diag([1, 2, 3, 1]), 1)
    nibabel.save(image, tmp_path / "v.nii.gz")
    assert_as_nibabel(tmp_path / "v.nii.gz")
