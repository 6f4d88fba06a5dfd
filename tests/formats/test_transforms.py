"""Transforms of other programs than ITK: MNI's are of the RAS world, and FSL's text matrices are said to be that."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy.io
import SimpleITK as sitk

import clvol
from clvol import reference
from clvol.base.errors import ClvolWarning, FormatError

RAS = np.array([[0.9, 0.1, -0.2, 10.0], [0.05, 1.1, 0.3, -20.0], [-0.1, 0.2, 1.2, 30.0], [0.0, 0.0, 0.0, 1.0]])
SECOND = np.array([[1.0, 0.0, 0.2, -5.0], [0.0, 0.8, 0.0, 6.0], [0.1, 0.0, 1.0, 7.0], [0.0, 0.0, 0.0, 1.0]])
TO_RAS = np.diag([-1.0, -1.0, 1.0, 1.0])
POINTS = np.random.default_rng(0).normal(0, 50, (20, 3))


def linear(matrix: np.ndarray, inverse: bool = False) -> str:
    rows = "\n".join(" ".join(map(repr, map(float, row))) for row in matrix[:3])
    return f"Transform_Type = Linear;\n{'Invert_Flag = True;' * inverse}\nLinear_Transform =\n{rows};\n"


@pytest.mark.parametrize(
    ("body", "matrix"),
    [(linear(RAS), RAS), (linear(RAS, inverse=True), np.linalg.inv(RAS)), (linear(RAS) + linear(SECOND), SECOND @ RAS)],
    ids=["one", "inverse", "two"],
)
def test_mni_transforms_are_in_ras(tmp_path: Path, body: str, matrix: np.ndarray) -> None:
    """Each maps a point's RAS coordinates, as MINC and FreeSurfer define it; the first of two is applied first."""
    path = tmp_path / "talairach.xfm"
    path.write_text(f"MNI Transform File\n% made by hand\n\n{body}")
    homogeneous = np.append(POINTS, np.ones((20, 1)), 1) @ TO_RAS
    expected = (homogeneous @ matrix.T @ TO_RAS)[:, :3]
    np.testing.assert_allclose(reference.map_points(POINTS, clvol.read_transform(path))[0], expected, rtol=1e-13, atol=1e-10)


def test_mni_displacements_are_in_ras(tmp_path: Path) -> None:
    """SimpleITK reads the same file without a change of the frame: expected are its points, x and y negated before and after."""
    values = np.random.default_rng(1).normal(size=(5, 6, 7, 3))
    image = sitk.GetImageFromArray(values, isVector=True)
    image.SetOrigin((-9, 5, 7))
    image.SetSpacing((3, 2, 4))
    path = tmp_path / "grid.xfm"
    sitk.WriteTransform(sitk.DisplacementFieldTransform(image), str(path))
    path.write_text(path.read_text().replace("%ITK-XFM writer", "%nonlinear registration"))
    theirs = sitk.ReadTransform(str(path))
    flip = np.array([-1.0, -1.0, 1.0])
    points = np.array([[0.3, 8.1, 12.9], [2.7, 9.4, 20.2]]) * flip
    expected = [np.array(theirs.TransformPoint((point * flip).tolist())) * flip for point in points]
    assert np.abs(expected - points).max() > 0.1
    np.testing.assert_allclose(reference.map_points(points, clvol.read_transform(path))[0], expected, atol=1e-6)


def test_mni_transforms_that_itk_wrote(tmp_path: Path) -> None:
    """They come back as they were written, with a warning: ITK 5 writes LPS."""
    path = tmp_path / "itk.xfm"
    sitk.WriteTransform(sitk.AffineTransform(RAS[:3, :3].ravel().tolist(), RAS[:3, 3].tolist()), str(path))
    with pytest.warns(ClvolWarning, match="itk.xfm was written by ITK.*taken for LPS"):
        (one,) = clvol.read_transform(path)
    assert isinstance(one, clvol.AffineTransform)
    np.testing.assert_array_equal(one.matrix, RAS[:3, :3])


@pytest.mark.parametrize("name", ["flirt.mat", "flirt.txt", "rows.mat"])
def test_text_matrices_are_named(tmp_path: Path, name: str) -> None:
    np.savetxt(tmp_path / name, RAS if name != "rows.mat" else RAS[:3])
    with pytest.raises(FormatError, match=rf"{name} must be a transform of ITK or MNI; it is a text matrix of .* FLIRT of FSL"):
        clvol.read_transform(tmp_path / name)


def test_later_files_of_matlab_are_named(tmp_path: Path) -> None:
    scipy.io.savemat(tmp_path / "spm.mat", {"M": RAS})
    with pytest.raises(FormatError, match=r"spm\.mat must be of MATLAB 4, .*; it is of MATLAB 5\.0"):
        clvol.read_transform(tmp_path / "spm.mat")
