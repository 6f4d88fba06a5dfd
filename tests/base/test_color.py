"""Colours that are distinct, in CIELAB by scikit-image."""

from __future__ import annotations

import numpy as np
import pytest

from clvol.base.color import channel_colors, lab_of


def test_cielab_is_that_of_scikit_image() -> None:
    color = pytest.importorskip("skimage.color")
    rgb = np.random.default_rng(0).uniform(0, 1, (200, 3))
    np.testing.assert_allclose(lab_of(rgb), color.rgb2lab(rgb[None])[0], atol=0.01)
    np.testing.assert_allclose(lab_of([1, 1, 1]), [100, 0, 0], atol=1e-9)


@pytest.mark.parametrize(("n", "apart"), [(2, 200), (3, 100), (4, 60), (6, 60), (8, 50), (12, 40), (24, 30)])
def test_the_colours_of_channels_are_far_apart_and_bright(n: int, apart: float) -> None:
    color = pytest.importorskip("skimage.color")
    lab = color.rgb2lab(np.array(channel_colors(n))[None])[0]
    assert np.linalg.norm(lab[:, None] - lab, axis=-1)[np.triu_indices(n, 1)].min() > apart
    assert lab[:, 0].min() >= 40  # seen on black


def test_the_first_colours_are_those_of_microscopy() -> None:
    assert channel_colors(3) == ((0, 1, 0), (1, 0, 1), (0, 1, 1))
    assert channel_colors(0) == ()
    for n in range(1, 9):
        assert channel_colors(n) == channel_colors(8)[:n]


def test_given_colours_stay_and_others_are_distinct_from_them() -> None:
    color = pytest.importorskip("skimage.color")
    given = ((0.0, 0.0, 1.0), None, (0.1, 0.95, 0.05), None, None)
    found = channel_colors(5, given)
    assert (found[0], found[2]) == (given[0], given[2])
    lab = color.rgb2lab(np.array(found)[None])[0]
    assert np.linalg.norm(lab[:, None] - lab, axis=-1)[np.triu_indices(5, 1)].min() > 34
    alike = ((1.0, 1.0, 1.0),) * 2
    assert channel_colors(2, alike) == alike  # the file decides
