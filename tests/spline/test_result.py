"""Results of `resample`: dtype, placement of the grid, and labels, which are never blended."""

from __future__ import annotations

import numpy as np
import pytest

import clvol
from clvol import DataError, Device, OptionError, Volume
from clvol.base.rounding import as_kind

RNG = np.random.default_rng(5)
DATA = RNG.normal(100, 60, (9, 10, 11)).astype(np.int16)


def regions(*labels: int, dtype: type = np.uint16) -> Volume:
    """Three balls on an empty background."""
    z, y, x = np.mgrid[:20, :22, :24]
    data = np.zeros((20, 22, 24), dtype)
    for (cz, cy, cx), label in zip([(7, 7, 7), (13, 14, 17), (5, 16, 6)], labels, strict=True):
        data[(z - cz) ** 2 + (y - cy) ** 2 + (x - cx) ** 2 < 22] = label
    return Volume(data, spacing=(1, 1, 2))


@pytest.mark.parametrize("dtype", ["same", np.uint8, ">i4", bool, np.float64])
def test_results_are_rounded_and_clipped(device: Device, dtype: object) -> None:
    wide = clvol.resample(DATA, spacing=0.7, precision="double", device=device).data
    got = clvol.resample(DATA, spacing=0.7, dtype=dtype, precision="double", device=device).data
    kind = DATA.dtype if dtype == "same" else np.dtype(dtype)  # type: ignore[call-overload]  # one of those above
    assert got.dtype == kind
    ends = (0, 1) if kind.kind == "b" else (-np.inf, np.inf) if kind.kind == "f" else (np.iinfo(kind).min, np.iinfo(kind).max)
    np.testing.assert_array_equal(got, np.clip(wide if kind.kind == "f" else np.rint(wide), *ends).astype(kind))


def test_dtype_same_has_native_byte_order() -> None:
    assert as_kind("same", np.dtype(">i2")) == np.dtype(np.int16)


def test_wide_types_are_computed_in_double(device: Device) -> None:
    data = DATA.astype(np.int64) * 10_000_019  # float32 would round these to tens of their last digit
    got = clvol.resample(data, shape=data.shape, dtype="same", device=device).data
    np.testing.assert_array_equal(got, data)


def test_the_origin_stays_as_in_itk(device: Device) -> None:
    sitk = pytest.importorskip("SimpleITK")
    turn = np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]])
    volume = Volume(DATA.astype(np.float32), (1, 1.5, 2), (3, -4, 5), turn)
    image = sitk.GetImageFromArray(volume.data)
    image.SetSpacing(volume.spacing)
    image.SetOrigin(volume.origin)
    image.SetDirection(volume.direction.ravel())
    size = [round(n * s / 0.9) for n, s in zip(image.GetSize(), image.GetSpacing(), strict=True)]
    want = sitk.Resample(
        image, size, sitk.Transform(), sitk.sitkBSpline, image.GetOrigin(), (0.9,) * 3, image.GetDirection(), np.nan
    )
    got = clvol.resample(volume, spacing=0.9, anchor="origin", device=device)
    assert got.origin == volume.origin
    assert got.size == tuple(size)
    inside = np.isfinite(sitk.GetArrayFromImage(want))
    assert inside.mean() > 0.8
    np.testing.assert_allclose(got.data[inside], sitk.GetArrayFromImage(want)[inside], atol=2e-3)
    centred = clvol.resample(volume, spacing=0.9, device=device)
    np.testing.assert_allclose(centred.center, volume.center)


def test_labels_are_not_blended(device: Device) -> None:
    volume = regions(3, 41, 700)
    assert volume.is_labels
    got = clvol.resample(volume, spacing=0.7, device=device)
    assert got.data.dtype == np.uint16
    assert set(np.unique(got.data)) == {0, 3, 41, 700}
    assert set(np.unique(clvol.magnify(volume, 2, device=device).data)) == {0, 3, 41, 700}
    assert set(clvol.sample(volume, RNG.uniform(0, 20, (500, 3)), device=device)) <= {0, 3, 41, 700}
    named = clvol.Volume(RNG.integers(0, 5, (4, 5, 6)), labels={1: "bone", 4: "skin"})
    assert clvol.Field(named, device=device).filter.name == "nearest"
    blended = clvol.resample(named, shape=(8, 8, 8), filter="linear", device=device)
    assert blended.labels is None


def test_large_labels_keep_their_last_digit(device: Device) -> None:
    labels = (3_000_000_019, 41, 4_294_967_291)
    got = clvol.resample(regions(*labels, dtype=np.uint32), spacing=0.7, device=device)
    assert set(np.unique(got.data)) == {0, *labels}


@pytest.mark.parametrize(
    ("data", "labels"),
    [
        (DATA, False),  # noise
        ((np.indices((20, 20, 20)).sum(0) > 30).astype(np.uint8), False),  # a mask: its edge is a surface
        (np.indices((20, 20, 20)).sum(0).astype(np.uint8), False),  # smooth, rounded
        (np.zeros((5, 5, 5), np.uint8), False),
        (np.kron(RNG.permutation(8**3).reshape(8, 8, 8), np.ones((6, 6, 6), int)), True),  # 512 cells
        (np.arange(2000)[None, None].repeat(6, -1) * np.ones((3, 3, 1), int), False),  # a slow ramp
        (np.where(np.indices((40, 40, 40)).sum(0) > 80, RNG.normal(1000, 90, (40,) * 3), 0).astype(np.int16), False),  # cut out
    ],
)
def test_which_volumes_are_treated_as_labels(data: np.ndarray, labels: bool) -> None:
    assert Volume(data).is_labels is labels
    assert Volume(data, labels=True).is_labels


def test_invalid_arguments_are_rejected(device: Device) -> None:
    with pytest.raises(OptionError, match="dtype must be 'same' or"):
        clvol.resample(DATA, spacing=1, dtype="complex64", device=device)
    with pytest.raises(OptionError, match="dtype or out"):
        clvol.resample(DATA, spacing=1, dtype="same", out=np.empty(DATA.shape, np.float32), device=device)
    with pytest.raises(OptionError, match="fill must be a number that int16 holds"):
        clvol.resample(DATA, spacing=1, dtype="same", fill=np.nan, device=device)
    with pytest.raises(OptionError, match="anchor must be one of"):
        clvol.resample(DATA, spacing=1, anchor="corner", device=device)
    with pytest.raises(OptionError, match="anchor is for shape and spacing"):
        clvol.resample(DATA, like=DATA, anchor="origin", device=device)
    hurt = DATA.astype(float)
    hurt[4, 5, 6] = np.nan
    with pytest.raises(DataError, match="results hold NaN"):
        clvol.resample(hurt, spacing=1, nan="local", dtype=np.int16, device=device)


def test_points_in_array_order_are_detected(device: Device) -> None:
    data = np.zeros((10, 20, 40), np.float32)
    with pytest.warns(clvol.ClvolWarning, match=r"points are \(x, y, z\) .* reversed") as told:
        clvol.sample(data, [[9, 15, 35], [8, 12, 30]], device=device)
    assert told[0].filename == __file__  # the caller's line


def test_points_outside_alone_raise_no_warning(device: Device, recwarn: pytest.WarningsRecorder) -> None:
    clvol.sample(np.zeros((10, 20, 40), np.float32), [[80, 80, 80], [9, 15, 5]], device=device)
    assert not recwarn.list


def test_points_in_ras(device: Device) -> None:
    nib = pytest.importorskip("nibabel")
    affine = np.array([[2, 0, 0, -9], [0, 1.5, 0, 4], [0, 0, 1, 7], [0, 0, 0, 1.0]])
    image = nib.Nifti1Image(np.einsum("i,j,k->ijk", *(np.arange(1.0, n) ** 1.5 for n in (8, 9, 7))), affine)
    index = np.array([[2, 3, 4], [5, 1, 2]])
    points = nib.affines.apply_affine(image.affine, index)
    with clvol.Field(Volume(image, space="LPS"), device=device) as field:
        np.testing.assert_allclose(field(points, frame="RAS"), image.get_fdata()[tuple(index.T)], rtol=1e-5)
        own = points * [-1, -1, 1]
        np.testing.assert_allclose(field.gradient(points, frame="RAS"), field.gradient(own) * [-1, -1, 1])
        turned = field.hessian(own) * np.outer([-1, -1, 1], [-1, -1, 1])
        np.testing.assert_allclose(field.hessian(points, frame="RAS"), turned)
    with pytest.raises(OptionError, match="RAS"):
        clvol.sample(DATA, [[1, 2, 3]], frame="RAS", device=device)
