"""`clvol.monai` beside MONAI's own transforms: values, metadata and inverses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clvol import OptionError

monai = pytest.importorskip("monai")
import torch  # noqa: E402

import clvol.monai  # noqa: E402

TURNED = np.array([[0.0, -1.4, 0.1, 3.0], [2.0, 0.1, 0.0, -5.0], [0.0, 0.0, 1.1, 2.0], [0.0, 0.0, 0.0, 1.0]])
ELASTIC = {"sigma_range": (2, 3), "magnitude_range": (20, 30), "prob": 1.0, "rotate_range": 0.3, "padding_mode": "zeros"}
CASES: list[tuple[str, dict[str, Any]]] = [
    ("Spacing", {"pixdim": (1.0, 0.9, 1.7)}),
    ("Spacing", {"pixdim": (2.0, 1.4, 1.5), "diagonal": True, "padding_mode": "reflection"}),
    ("Affine", {"rotate_params": (0.2, 0.1, -0.3), "scale_params": (1.1, 0.9, 1.0), "padding_mode": "zeros", "image_only": True}),
    ("RandAffine", {"rotate_range": 0.5, "translate_range": 3, "prob": 1.0, "padding_mode": "border", "spatial_size": (8, 9, 7)}),
    ("Rand3DElastic", ELASTIC),
]


def _image() -> Any:
    data = np.random.default_rng(0).standard_normal((2, 9, 10, 11))
    for axis in (1, 2, 3):
        data += np.roll(data, 1, axis)
    return monai.data.MetaTensor(torch.as_tensor(data.astype("f4")), affine=torch.as_tensor(TURNED))


@pytest.mark.parametrize("order", [1, 3])
@pytest.mark.parametrize(("name", "options"), CASES)
def test_values_metadata_and_inverses_are_monais(name: str, options: dict[str, Any], order: int) -> None:
    made = []
    for package in (monai.transforms, clvol.monai):
        transform = getattr(package, name)(mode=order, **options)
        if hasattr(transform, "set_random_state"):
            transform.set_random_state(1)
        image = transform(_image())
        made.append((image, transform.inverse(image) if hasattr(transform, "inverse") else image))
    for theirs, own in zip(*made, strict=True):
        assert own.dtype == torch.float32
        np.testing.assert_allclose(own.numpy(), theirs.numpy(), atol=3e-6 * np.ptp(_image().numpy()))
        np.testing.assert_allclose(own.affine, theirs.affine, atol=1e-6)  # theirs goes through float32
    assert not made[1][1].applied_operations


def test_a_dictionary_of_an_image_and_smooth_labels() -> None:
    labels = (_image() > 0).to(torch.uint8)[:1]
    data = {"image": _image(), "labels": labels}
    how: dict[str, Any] = {"keys": ["image", "labels"], "mode": [3, "labels"]}
    kinds = (
        clvol.monai.Spacingd(pixdim=(1, 1, 1), **how),
        clvol.monai.RandAffined(prob=1, rotate_range=1, **how),
        clvol.monai.Affined(scale_params=(1.1, 1, 1), **how),
        clvol.monai.Rand3DElasticd(sigma_range=(2, 3), magnitude_range=(2, 3), prob=1, **how),
    )
    for kind in kinds:
        made = kind(data)
        assert made["image"].shape[1:] == made["labels"].shape[1:]
        assert np.unique(made["labels"]).tolist() == [0, 1]
        back = kind.inverse(made) if hasattr(kind, "inverse") else data
        assert back["labels"].shape == labels.shape
        assert (back["labels"] == labels)[:, 2:-2, 2:-2, 2:-2].float().mean() > 0.7


def test_other_modes_are_left_to_monai_and_corners_refused() -> None:
    theirs, own = (package.Spacing((1, 1, 1), mode="bilinear")(_image()) for package in (monai.transforms, clvol.monai))
    np.testing.assert_allclose(own, theirs, atol=1e-5)
    with pytest.raises(OptionError, match="align_corners must be False"):
        clvol.monai.Spacing((1, 1, 1), mode=3, align_corners=True)(_image())
