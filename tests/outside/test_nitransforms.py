"""`clvol.nitransforms` beside NiTransforms' own resampling: values, headers, series."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

nitransforms = pytest.importorskip("nitransforms")
import nibabel  # noqa: E402
from nitransforms.linear import Affine, LinearTransformsMapping  # noqa: E402
from nitransforms.manip import TransformChain  # noqa: E402
from nitransforms.nonlinear import BSplineFieldTransform, DenseFieldTransform  # noqa: E402
from nitransforms.resampling import apply as theirs  # noqa: E402

from clvol.base.errors import DataError, OptionError  # noqa: E402
from clvol.nitransforms import apply, coefficients  # noqa: E402

RNG = np.random.default_rng(0)


def placed(spacing: float, turn: float, shift: float) -> NDArray[np.float64]:
    c, s = spacing * np.cos(turn), spacing * np.sin(turn)
    return np.array([[c, -s, 0, shift], [s, c, 0, 2 * shift], [0, 0, 1.3 * spacing, 3.0], [0, 0, 0, 1]])


def smooth(shape: tuple[int, ...], kind: str = "f4") -> NDArray[Any]:
    data = RNG.standard_normal(shape)
    for axis in range(3):
        data = data + np.roll(data, 1, axis) + np.roll(data, 2, axis)
    return (40 * data).astype(kind)


def image(kind: str = "f4", count: int = 0) -> Any:
    shape = (14, 13, 12, count) if count else (14, 13, 12)
    return nibabel.Nifti1Image(smooth(shape, kind), placed(2, 0.1, -10))


GRID = nibabel.Nifti1Image(np.zeros((11, 12, 10), "u1"), placed(1.7, -0.2, -6))
FIELD = DenseFieldTransform(nibabel.Nifti1Image(smooth((9, 9, 9, 3)) / 500, placed(3, 0, -12)))
AFFINE = Affine(placed(1.02, 0.1, 0.4))
MOTION = [placed(1, 0.01 * t, 0.1 * t) for t in range(9)]
KNOTS = BSplineFieldTransform(nibabel.Nifti1Image(smooth((7, 7, 7, 3)) / 500, placed(5, 0, -18)), reference=GRID)


def close(own: Any, expected: Any) -> None:
    np.testing.assert_allclose(own.get_fdata(), expected.get_fdata(), rtol=0, atol=1e-5 * np.ptp(expected.get_fdata()))
    np.testing.assert_array_equal(own.affine, expected.affine)
    assert type(own) is type(expected)
    assert own.get_data_dtype() == expected.get_data_dtype()
    assert own.dataobj.dtype == expected.dataobj.dtype


@pytest.mark.parametrize("mode", ["constant", "nearest"])
@pytest.mark.parametrize(
    "transform",
    [AFFINE, FIELD, KNOTS, TransformChain([FIELD, AFFINE]), TransformChain([AFFINE, TransformChain([FIELD, AFFINE])])],
    ids=["affine", "field", "B-spline", "chain", "chains"],
)
def test_values_are_nitransforms(transform: Any, mode: str) -> None:
    one = image()
    own = apply(transform, one, GRID, mode=mode, cval=7, precision="single")  # by kernels, however small
    close(own, theirs(transform, one, GRID, mode=mode, cval=7))


def test_the_field_on_its_own_grid() -> None:
    one = image()
    close(apply(FIELD, one), theirs(FIELD, one))


@pytest.mark.parametrize("kind", ["i2", "f8"])
def test_a_series_with_a_matrix_for_each_volume(kind: str) -> None:
    bold, motion = image(kind, 9), LinearTransformsMapping(MOTION)
    how: dict[str, Any] = {"precision": "single" if kind == "i2" else "double"}
    own, expected = apply(motion, bold, GRID, **how), theirs(motion, bold, GRID)
    if kind == "i2":  # rounded, a few the other way
        assert (own.get_fdata() != expected.get_fdata()).mean() < 1e-3
    else:
        close(own, expected)
    whole = apply(TransformChain([FIELD, AFFINE, motion]), bold, GRID, **how).get_fdata()
    for t in (0, 8):
        frame = nibabel.Nifti1Image(np.asarray(bold.dataobj[..., t], "f8"), bold.affine)
        alone = theirs(TransformChain([FIELD, AFFINE, Affine(MOTION[t])]), frame, GRID).get_fdata()
        np.testing.assert_allclose(whole[..., t], alone, rtol=0, atol=0.51 if kind == "i2" else 1e-5 * np.ptp(alone))


def test_coefficients_serve_several_targets() -> None:
    bold = image("i2", 3)
    ready = coefficients(bold, precision="single")
    assert ready.get_data_dtype() == np.float32
    for transform in (AFFINE, FIELD):
        samples = nibabel.Nifti1Image(np.asarray(bold.dataobj, "f4"), bold.affine)
        close(apply(transform, ready, GRID, prefilter=False), apply(transform, samples, GRID))
    with pytest.raises(OptionError, match=r"mode must not pad.*'nearest': leave prefilter=True"):
        coefficients(bold, mode="nearest")


def test_points_of_a_surface_and_kinds_of_results(tmp_path: Any) -> None:
    one, points = image("i2"), nibabel.gifti.GiftiImage()
    places = RNG.uniform(-5, 5, (50, 3)).astype("f4")
    points.add_gifti_data_array(nibabel.gifti.GiftiDataArray(places, "NIFTI_INTENT_POINTSET"))
    nibabel.save(one, tmp_path / "one.nii.gz")
    own = apply(AFFINE, tmp_path / "one.nii.gz", points, output_dtype="f4")
    assert own.dtype == np.float32
    assert (own != theirs(AFFINE, one, points, output_dtype="f4")).mean() < 0.05
    stack = nibabel.Nifti1Image(np.asarray(one.dataobj)[..., None], one.affine)
    own, expected = (f(AFFINE, stack, GRID, output_dtype="f4", dtype_width=1) for f in (apply, theirs))
    assert own.shape == expected.shape == (11, 12, 10, 1)
    assert own.get_data_dtype() == expected.get_data_dtype() == np.float32


@pytest.mark.filterwarnings("ignore:Reference space not set")
def test_what_is_refused() -> None:
    with pytest.raises(OptionError, match="reference must be an image or a surface"):
        apply(AFFINE, image())
    with pytest.raises(DataError, match=r"a volume for each matrix of a series; got 4 of \[9\]"):
        apply(LinearTransformsMapping(MOTION), image(count=4), GRID)
