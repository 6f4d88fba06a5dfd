"""ITK as the truth for chains of transforms: SimpleITK's Resample, TransformPoint and files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import clvol
from clvol import Volume, reference
from clvol.base.errors import DataError, FormatError, OptionError
from clvol.device import Device
from clvol.volume.transform import AffineTransform, BSplineTransform, DisplacementField, as_chain, from_simpleitk

sitk = pytest.importorskip("SimpleITK")

Array = NDArray[np.float64]
WITHIN = {"single": 1e-6, "double": 1e-10}  # of the range of the samples


def moving(d: int) -> Volume:
    dice = np.random.default_rng(1)
    return Volume(dice.normal(100, 50, (19, 24, 21)[:d]), (0.7, 1.1, 2.3)[:d], (-30.0, 12.0, 55.0)[:d], turned(d, 1))


def fixed(d: int) -> Volume:
    """Anisotropic, rotated, about the moving image's centre."""
    size, step, turn = np.array([25, 27, 22])[:d], np.array([0.8, 0.9, 1.7])[:d], turned(d, 2)
    origin = moving(d).center - turn @ (step * (size - 1) / 2) + 0.3
    return Volume(np.zeros(size[::-1]), tuple(step), tuple(origin), turn)


def turned(d: int, seed: int) -> Array:
    if d == 2:
        return np.array([[np.cos(seed), -np.sin(seed)], [np.sin(seed), np.cos(seed)]])
    return np.asarray(Rotation.random(random_state=seed).as_matrix())


def image_of(volume: Volume) -> Any:
    image = sitk.GetImageFromArray(np.asarray(volume.data, np.float64))
    image.SetSpacing(volume.spacing)
    image.SetOrigin(volume.origin)
    image.SetDirection(volume.direction.ravel().tolist())
    return image


def places(volume: Volume) -> Array:
    return volume.index_to_world(np.moveaxis(np.indices(volume.shape)[::-1], 0, -1)).reshape(-1, volume.ndim)


# -- what ITK has ------------------------------------------------------------------------------------------------------------


def affine(d: int, seed: int = 0) -> Any:
    one, dice = sitk.AffineTransform(d), np.random.default_rng(seed)
    one.SetMatrix((np.eye(d) + dice.normal(0, 0.06, (d, d))).ravel().tolist())
    one.SetTranslation(dice.normal(0, 0.5, d).tolist())
    one.SetCenter(moving(d).center.tolist())
    return one


def grid(d: int, order: int = 3) -> Any:
    """A B-spline over the fixed image, whose outer voxels lie at the edge of its domain."""
    one = sitk.BSplineTransformInitializer(image_of(fixed(d)), (4, 5, 3)[:d], order)
    one.SetParameters(np.random.default_rng(5).normal(0, 0.7, len(one.GetParameters())).tolist())
    return one


def displacements(d: int, seed: int = 6) -> Any:
    """An image of displacements over a part of the fixed image, rotated differently."""
    size, turn = (8, 9, 7)[:d], turned(d, seed)
    step = 13.0 / np.array(size)
    image = sitk.GetImageFromArray(np.random.default_rng(seed).normal(0, 0.6, (*size[::-1], d)), isVector=True)
    image.SetSpacing(step.tolist())
    image.SetOrigin((moving(d).center - turn @ (step * (np.array(size) - 1) / 2)).tolist())
    image.SetDirection(turn.ravel().tolist())
    return image


def field(d: int, seed: int = 6) -> Any:
    return sitk.DisplacementFieldTransform(sitk.Image(displacements(d, seed)))


def euler(d: int) -> Any:
    centre = moving(d).center.tolist()
    return sitk.Euler2DTransform(centre, 0.2, (0.4, 1.2)) if d == 2 else sitk.Euler3DTransform(centre, 0.1, -0.2, 0.3, (1, 0.5, -1))


CHAINS: dict[str, Any] = {
    "affine": lambda d: [affine(d)],
    "rigid": lambda d: [euler(d)],
    "B-spline": lambda d: [grid(d)],
    "B-spline of order 2": lambda d: [grid(d, 2)],
    "B-spline of order 1": lambda d: [grid(d, 1)],
    "field": lambda d: [field(d)],
    "affine, field, B-spline": lambda d: [affine(d), field(d), grid(d)],
    "B-spline, rigid, field, affine, field": lambda d: [grid(d), euler(d), field(d), affine(d, 7), field(d, 8)],
}


@pytest.mark.one_in(18)
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("name", CHAINS)
@pytest.mark.parametrize("precision", WITHIN)
def test_resample(device: Device, precision: Any, name: str, d: int) -> None:
    """Values and missing results match ITK: for the composite transform and for its parts in a list."""
    if precision == "double" and not device.has_double:
        pytest.skip("the device has no float64")
    parts = CHAINS[name](d)
    options = {"boundary": "mirror", "fill": np.nan, "precision": precision, "device": device}
    whole, volume, like = sitk.CompositeTransform(parts), moving(d), fixed(d)
    resampled = sitk.Resample(image_of(volume), image_of(like), whole, sitk.sitkBSpline3, np.nan, sitk.sitkFloat64)
    theirs = sitk.GetArrayFromImage(resampled)
    ours = clvol.resample(volume, like=like, transform=parts, **options).data
    assert np.isfinite(theirs).mean() > 0.3
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=WITHIN[precision] * np.ptp(volume.data))
    got = clvol.resample(volume, like=like, transform=whole, **options).data
    np.testing.assert_array_equal(got, ours)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("name", CHAINS)
def test_points_match_the_reference(name: str, d: int) -> None:
    whole = sitk.CompositeTransform(CHAINS[name](d))
    points = np.random.default_rng(0).permutation(places(fixed(d)))[:200] + 0.01
    ours, jacobian = reference.map_points(points, whole)
    theirs = [whole.TransformPoint(point.tolist()) for point in points]
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-10)
    h = 1e-5
    for axis, step in enumerate(h * np.eye(d)):
        ends = [[whole.TransformPoint((p + s).tolist()) for p in points] for s in (step, -step)]
        slopes = (np.array(ends[0]) - ends[1]) / (2 * h)
        close = np.isclose(jacobian[..., axis], slopes, rtol=0, atol=1e-6).all(axis=-1)
        assert close.mean() > 0.97  # a linear field has kinks, and every grid an edge


@pytest.mark.one_in(2)
@pytest.mark.parametrize("d", [2, 3])
def test_jacobians(device: Device, d: int) -> None:
    """Of a quadratic displacement, for which ITK's central differences are exact; ITK ignores the direction."""
    like = Volume(fixed(d).data, fixed(d).spacing, fixed(d).origin)
    index = places(like) - like.center
    values = np.stack([0.01 * index[:, 0] * index[:, -1], 0.008 * index[:, 0] ** 2, 0.1 * index[:, -1]][:d], axis=-1)
    image = sitk.GetImageFromArray(values.reshape(*like.shape, d), isVector=True)
    image.CopyInformation(image_of(like))
    theirs = sitk.GetArrayFromImage(sitk.DisplacementFieldJacobianDeterminant(image))
    place = (like.spacing, like.origin, like.direction)
    chain = [DisplacementField(values.reshape(*like.shape, d), *place, filter="bspline3")]
    got = clvol.warp(moving(d), like, chain, jacobian=True, device=device).jacobian
    assert got is not None
    inner = (slice(8, -8),) * d  # the spline's ends are mirrored, which no quadratic is
    np.testing.assert_allclose(got.data[inner], theirs[inner], rtol=0, atol=1e-4)
    assert np.ptp(theirs[inner]) > 0.05


LINEAR: dict[str, Any] = {
    "AffineTransform": lambda: affine(3),
    "Euler2DTransform": lambda: euler(2),
    "Euler3DTransform": lambda: euler(3),
    "VersorTransform": lambda: sitk.VersorTransform((1, 2, 3), 0.4, (5, 6, 7)),
    "VersorRigid3DTransform": lambda: sitk.VersorRigid3DTransform((1, 2, 3), 0.4, (1, 0, 2), (5, 6, 7)),
    "Similarity2DTransform": lambda: sitk.Similarity2DTransform(1.3, 0.2, (1, 2), (5, 6)),
    "Similarity3DTransform": lambda: sitk.Similarity3DTransform(1.3, (1, 2, 3), 0.2, (1, 2, 3), (5, 6, 7)),
    "ScaleVersor3DTransform": lambda: sitk.ScaleVersor3DTransform((1.1, 0.9, 1.2), (1, 2, 3), 0.2, (1, 2, 3), (5, 6, 7)),
    "ScaleTransform": lambda: sitk.ScaleTransform(3, (1.1, 0.9, 1.2)),
    "TranslationTransform": lambda: sitk.TranslationTransform(2, (3.5, -2)),
    "identity": lambda: sitk.Transform(3, sitk.sitkIdentity),
    "quaternion": lambda: sitk.Transform(3, sitk.sitkQuaternionRigid),
    "a generic one": lambda: sitk.Transform(affine(3)),
    "CompositeTransform": lambda: sitk.CompositeTransform([affine(3), euler(3), sitk.CompositeTransform([euler(3), affine(3, 1)])]),
}


@pytest.mark.parametrize("name", LINEAR)
def test_linear_transforms(name: str) -> None:
    one = LINEAR[name]()
    points = np.random.default_rng(1).normal(0, 100, (20, one.GetDimension()))
    ours, _ = reference.map_points(points, one)
    np.testing.assert_allclose(ours, [one.TransformPoint(point.tolist()) for point in points], rtol=0, atol=1e-10)


# -- files --------------------------------------------------------------------------------------------------------------------


NAMES = ("affine", "B-spline", "affine, field, B-spline")
FILES = [(name, suffix) for name in NAMES for suffix in (".tfm", ".txt", ".h5")] + [("affine", ".mat"), ("affine", ".xfm")]


@pytest.mark.filterwarnings("ignore:.*was written by ITK")  # of .xfm
@pytest.mark.parametrize(("name", "suffix"), FILES)
def test_transform_files(tmp_path: Path, name: str, suffix: str) -> None:
    parts = CHAINS[name](3)
    whole = parts[0] if len(parts) == 1 else sitk.CompositeTransform(parts)
    path = tmp_path / f"transform{suffix}"
    sitk.WriteTransform(whole, str(path))
    points = places(fixed(3))[::97] + 0.01
    np.testing.assert_allclose(
        reference.map_points(points, clvol.read_transform(path))[0], reference.map_points(points, whole)[0], rtol=0, atol=1e-5
    )


@pytest.mark.parametrize("suffix", [".mha", ".nrrd", ".nii.gz"])
def test_displacement_images(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"field{suffix}"
    sitk.WriteImage(displacements(3), str(path))
    (one,) = clvol.read_transform(path)
    assert isinstance(one, DisplacementField)
    wanted = as_chain(field(3), 3)[0]
    assert isinstance(wanted, DisplacementField)
    np.testing.assert_array_equal(one.displacements, wanted.displacements)
    np.testing.assert_allclose(one.grid.index_to_world_matrix, wanted.grid.index_to_world_matrix, atol=1e-6)
    np.testing.assert_allclose(one.grid.origin, wanted.grid.origin, atol=1e-5)


def test_accepted_files() -> None:
    kinds = [type(one) for one in from_simpleitk(sitk.CompositeTransform(CHAINS["affine, field, B-spline"](2)))]
    assert kinds == [AffineTransform, DisplacementField, BSplineTransform]


def test_rejected_files(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=r"suffix of a transform must be one of \.tfm"):
        clvol.read_transform(tmp_path / "field.png")
    with pytest.raises(FormatError, match="there is no such file"):
        clvol.read_transform(tmp_path / "none.tfm")
    with pytest.raises(OptionError, match="path must be"):
        clvol.read_transform(5)  # type: ignore[arg-type]
    for name in ("broken.tfm", "broken.h5", "broken.mha"):
        (tmp_path / name).write_text("nothing of the kind\n")
        with pytest.raises(FormatError, match=f"cannot read .*{name}"):
            clvol.read_transform(tmp_path / name)
    sitk.WriteImage(image_of(moving(3)), str(tmp_path / "scalar.mha"))
    with pytest.raises(DataError, match="displacements must have shape"):
        clvol.read_transform(tmp_path / "scalar.mha")
    with pytest.raises(OptionError, match="order must be 1, 2 or 3; got 0"):
        from_simpleitk(sitk.BSplineTransform(2, 0))

    class Foreign:
        def TransformPoint(self, point: Any) -> Any:
            return point

    with pytest.raises(OptionError, match="got a Foreign"):
        clvol.resample(moving(3), like=fixed(3), transform=Foreign())


def test_an_inverse_of_a_composite_transform_is_one_matrix() -> None:
    """SimpleITK lists a composite of the inverse as its own part."""
    scale, turn = sitk.ScaleTransform(3, (1.1, 0.9, 1.2)), sitk.Euler3DTransform((1, 2, 3), 0.1, 0.2, 0.3, (1, 0, 2))
    scale.SetCenter((1, 2, 3))
    inverse = sitk.CompositeTransform([scale, turn]).GetInverse()
    (own,) = from_simpleitk(inverse)
    assert isinstance(own, AffineTransform)
    point = (3.0, -1.0, 2.0)
    np.testing.assert_allclose(reference.map_points(np.array([point]), own)[0][0], inverse.TransformPoint(point), atol=1e-9)
