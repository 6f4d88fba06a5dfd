"""Labels: those present, their names, and volumes with some of them alone."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from clvol import Volume, labels
from clvol.base import memory
from clvol.base.errors import OptionError


@pytest.mark.parametrize("dtype", ["uint8", "int16", ">i4", "float32"])
def test_omitted_labels_become_background(dtype: str) -> None:
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


def test_a_label_far_beyond_the_number_of_samples_takes_no_table(monkeypatch: pytest.MonkeyPatch) -> None:
    data = np.zeros((8, 8, 8), np.int32)
    data[2], data[5] = 7, 2**24 - 2
    volume = Volume(data, labels=True)
    labels.numbers_of(volume)  # kept with the volume
    asked = []
    monkeypatch.setattr(memory, "require", lambda nbytes, _: asked.append(nbytes))
    tracemalloc.start()
    some = labels.without(volume, [7])
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert np.unique(some.data).tolist() == [0, 2**24 - 2]
    assert most < 1 << 20
    assert data.nbytes in asked
    asked.clear()
    few = labels.without(Volume(data % 100, labels=True), [7])
    assert data.nbytes + 4 * (few.limits[1] + 1) in asked  # the table too
    assert np.unique(few.data).tolist() == [0, (2**24 - 2) % 100]


@pytest.mark.parametrize("dtype", ["uint8", "int8", "uint16", "int32", "uint64", "int64", "float16", "float32", "float64"])
@pytest.mark.parametrize("span", [9, 100])
def test_any_samples_can_be_compared_with_any_labels(dtype: str, span: int) -> None:
    chance = np.random.default_rng(span)
    data = chance.integers(0, span, (4, 5, 3)).astype(dtype)
    chosen = [-(10**400), -(2**63), -5, 0, *map(int, chance.integers(0, span, 5)), 300, 70_000, 2**24 + 1, 2**63, 2**64, 10**400]
    volume = Volume(data, labels=True)
    inside = np.isin(data, [label for label in chosen if 0 <= label < span])
    background = 0 if (data == 0).any() else labels.label_numbers(volume)[0]
    assert np.array_equal(labels.only(volume, chosen).data, np.where(inside, data, background))
    assert np.array_equal(labels.without(volume, iter(chosen)).data, np.where(inside, background, data))


def test_a_mask_has_one_label() -> None:
    data = np.eye(3, dtype=bool)[None]
    volume = Volume(data, labels=True)
    assert np.array_equal(labels.only(volume, [1, 2]).data, data)
    assert not labels.without(volume, [1, 2]).data.any()


def test_a_label_beside_one_that_float32_cannot_hold() -> None:
    volume = Volume(np.array([[[0, 2**24, np.nan]]], np.float32), labels=True)
    assert labels.without(volume, [2**24 + 1]).data.tolist()[0][0][1] == 2**24


def test_thousands_of_labels_are_found_in_samples() -> None:
    data = np.arange(200_000, dtype=np.float32).reshape(20, 100, 100) % 5000
    volume = Volume(data, labels=True)
    labels.numbers_of(volume)
    some = labels.without(volume, range(0, 4000, 2))
    assert np.array_equal(some.data, np.where((data < 4000) & (data % 2 == 0), 0, data))


def test_without_0_the_commonest_label_is_background() -> None:
    volume = Volume(np.array([[[7, 7, 2], [3, 2, 7]]], np.int16), labels=True)
    assert labels.numbers_of(volume).tolist() == [2, 3]
    assert labels.without(volume, [3]).data.tolist() == [[[7, 7, 2], [7, 2, 7]]]


def test_recognised_labels_stay_labels() -> None:
    blocks = np.kron(np.array([[[0, 1], [5, 9]], [[9, 5], [0, 3]]]), np.ones((12, 12, 12))).astype(np.uint8)
    volume = Volume(blocks)
    assert volume.labels is None
    assert volume.is_labels
    assert labels.only(volume, [5]).is_labels


def test_rejects_other_volumes_and_invalid_labels() -> None:
    with pytest.raises(OptionError, match="the volume must be a label map"):
        labels.only(Volume(np.random.default_rng(0).normal(size=(4, 4, 4))), [1])
    with pytest.raises(OptionError, match=r"a label must be a whole number; got 1\.5"):
        labels.without(Volume(np.zeros((2, 2, 2), np.uint8), labels=True), [1.5])  # type: ignore[list-item]
    with pytest.raises(OptionError, match=r"labels must be a sequence of whole numbers and names; got 7"):
        labels.without(Volume(np.zeros((2, 2, 2), np.uint8), labels=True), 7)  # type: ignore[arg-type]
