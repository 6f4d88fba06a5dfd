"""`clvol.torchio` beside TorchIO's own transforms: values, affine matrices, history."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

torchio = pytest.importorskip("torchio")
import torch  # noqa: E402

import clvol.torchio  # noqa: E402

AFFINE = np.array([[0.0, -1.4, 0.0, 3.0], [2.0, 0.0, 0.0, -5.0], [0.0, 0.0, 1.1, 2.0], [0.0, 0.0, 0.0, 1.0]])
SMOOTH = {"image_interpolation": "bspline", "label_interpolation": "labels"}
CASES: list[tuple[str, dict[str, Any]]] = [
    ("Resample", {"target": (1.0, 0.9, 1.7)}),
    ("Resample", {"target": (2.5, 2.5, 2.5), "antialias": True}),
    ("Affine", {"scales": (1.1, 0.9, 1.0), "degrees": (10, 20, -5), "translation": (1, 2, 0)}),
    ("RandomAffine", {"degrees": 20, "default_pad_value": 0}),
    ("RandomElasticDeformation", {"max_displacement": 2, "num_control_points": 5}),
]


def _subject() -> Any:
    data = np.random.default_rng(0).standard_normal((2, 12, 11, 10))
    for axis in (1, 2, 3):
        data += np.roll(data, 1, axis)
    return torchio.Subject(
        image=torchio.ScalarImage(tensor=torch.as_tensor(data.astype("f4")), affine=AFFINE),
        labels=torchio.LabelMap(tensor=torch.as_tensor((data[:1] > 0).astype("u1")), affine=AFFINE),
    )


@pytest.mark.filterwarnings("ignore:The maximum displacement")
@pytest.mark.parametrize(("name", "options"), CASES)
def test_values_affines_and_history_are_torchios(name: str, options: dict[str, Any]) -> None:
    made = []
    for package, how in ((torchio, {"image_interpolation": "bspline"}), (clvol.torchio, SMOOTH)):
        torch.manual_seed(2)
        made.append(getattr(package, name)(**options, **how)(_subject()))
    theirs, own = made
    assert own.image.data.dtype == theirs.image.data.dtype
    np.testing.assert_allclose(own.image.data, theirs.image.data, atol=3e-6 * np.ptp(_subject().image.numpy()))
    np.testing.assert_allclose(own.image.affine, theirs.image.affine, atol=1e-12)
    assert own.labels.shape == theirs.labels.shape
    assert np.unique(own.labels.data).tolist() == [0, 1]
    assert (own.labels.data == theirs.labels.data).float().mean() > 0.8
    assert [step for step, _ in own.applied_transforms] == [step for step, _ in theirs.applied_transforms]


def test_other_interpolations_are_left_to_torchio() -> None:
    theirs, own = (package.Affine(1.1, (0, 0, 20), 0)(_subject()) for package in (torchio, clvol.torchio))
    assert torch.equal(own.image.data, theirs.image.data)
    assert torch.equal(own.labels.data, theirs.labels.data)
    with pytest.raises(ValueError, match="Interpolation"):
        clvol.torchio.Resample(1, image_interpolation="septic")
