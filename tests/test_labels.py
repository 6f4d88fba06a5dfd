"""Labels: which there are, their names, and volumes with some of them alone."""

from __future__ import annotations

import numpy as np
import pytest

from clvol import Volume, labels
from clvol.errors import OptionError


@pytest.mark.parametrize("dtype", ["uint8", "int16", ">i4", "float32"])
def test_what_is_left_out_becomes_background(dtype: str) -> None:
    data = np.array([[[0, 1, 2], [3, 2, 0]]], dtype)
    volume = Volume(data, labels={1: "liver", 3: "spleen"}, spacing=(1, 2, 3))
    assert labels.numbers_of(volume).tolist() == [1, 2, 3]
    assert [labels.name_of(volume, n) for n in (1, 2, 3)] == ["liver", "", "spleen"]
    some = labels.without(volume, [2, 99])
    assert some.data.tolist() == [[[0, 1, 0], [3, 0, 0]]]
    assert (some.data.dtype, some.spacing, some.labels) == (volume.data.dtype.newbyteorder("="), volume.spacing, volume.labels)
    assert labels.only(volume, (2, 99)).data.tolist() == [[[0, 0, 2], [0, 2, 0]]]
    assert not labels.only(volume, ()).data.any()
    assert volume.data.tolist() == data.tolist()


def test_labels_below_0_and_beyond_any_table() -> None:
    volume = Volume(np.array([[[0, -1, 1 << 30], [3, -1, 0]]], np.int64), labels=True)
    assert labels.numbers_of(volume).tolist() == [-1, 3, 1 << 30]
    assert labels.without(volume, [-1]).data.tolist() == [[[0, 0, 1 << 30], [3, 0, 0]]]
    assert labels.only(volume, [1 << 30]).data.tolist() == [[[0, 0, 1 << 30], [0, 0, 0]]]


def test_background_is_the_commonest_where_there_is_no_0() -> None:
    volume = Volume(np.array([[[7, 7, 2], [3, 2, 7]]], np.int16), labels=True)
    assert labels.numbers_of(volume).tolist() == [2, 3]
    assert labels.without(volume, [3]).data.tolist() == [[[7, 7, 2], [7, 2, 7]]]


def test_what_was_seen_to_be_labels_stays_labels() -> None:
    blocks = np.kron(np.array([[[0, 1], [5, 9]], [[9, 5], [0, 3]]]), np.ones((12, 12, 12))).astype(np.uint8)
    volume = Volume(blocks)
    assert volume.labels is None
    assert volume.is_labels
    assert labels.only(volume, [5]).is_labels


def test_refuses_what_is_no_label_map_and_no_label() -> None:
    with pytest.raises(OptionError, match="labels are chosen of a label map"):
        labels.only(Volume(np.random.default_rng(0).normal(size=(4, 4, 4))), [1])
    with pytest.raises(OptionError, match=r"each label must be a whole number; got 1\.5"):
        labels.without(Volume(np.zeros((2, 2, 2), np.uint8), labels=True), [1.5])  # type: ignore[list-item]
