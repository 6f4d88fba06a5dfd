from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import clvol
from clvol import reference
from clvol.volume.volume import Volume

TURNED = np.linalg.qr(np.array([[2.0, 1, 0], [-1, 2, 1], [0, 1, -3]]))[0]


def labels(shape: tuple[int, ...] = (9, 10, 11), kind: Any = np.uint8, count: int = 5) -> Volume:
    return Volume(np.random.default_rng(0).integers(0, count, shape).astype(kind), (1.5, 0.75, 2.0)[: len(shape)], labels=True)


def grid_over(volume: Volume, shape: tuple[int, ...], *, turned: bool) -> Volume:
    """A grid that reaches past the volume."""
    d = volume.ndim
    spacing = 1.2 * np.asarray(volume.size) * volume.spacing / shape[::-1]
    direction = TURNED[:d, :d] / np.linalg.norm(TURNED[:d, :d], axis=0) if turned and d == 3 else np.eye(d)
    origin = volume.center - direction @ (spacing * (np.asarray(shape[::-1]) - 1) / 2)
    return Volume(np.broadcast_to(np.float32(0), shape), tuple(spacing), tuple(origin), direction)


def points_of(grid: Volume) -> np.ndarray[Any, Any]:
    return grid.index_to_world(np.stack(np.meshgrid(*(np.arange(n) for n in grid.shape), indexing="ij"), -1)[..., ::-1])


@pytest.mark.parametrize(
    ("filter", "boundary", "kind", "turned"),
    [
        ("linear", "reflect", np.uint8, False),
        ("bspline2-approx", "mirror", np.uint8, False),
        ("bspline3-approx", "overlap", np.int16, False),
        ("bspline4-approx", "zero", np.uint8, True),
        ("bspline5-approx", "grid-constant(3)", np.int16, True),
        ("bspline5-approx", "constant(-7)", np.int16, False),
        ("bspline5-approx", "nearest", np.int16, True),
    ],
)
def test_every_label_on_its_own_gives_the_same(filter: str, boundary: str, kind: Any, turned: bool) -> None:
    volume = labels(kind=kind)
    grid = grid_over(volume, (8, 13, 12), turned=turned)
    got = clvol.resample(volume, like=grid, filter=filter, boundary=boundary, smooth=True)
    wanted, margin = reference.labels_at(volume, points_of(grid), filter, boundary)
    assert got.data.dtype == kind
    assert got.is_labels
    assert (margin > 1e-5).mean() > 0.95
    assert not ((got.data != wanted) & (margin > 1e-5)).any()


def test_of_images() -> None:
    volume = labels((12, 13))
    grid = grid_over(volume, (21, 17), turned=False)
    wanted, margin = reference.labels_at(volume, points_of(grid))
    assert not ((clvol.resample(volume, like=grid, smooth=True).data != wanted) & (margin > 1e-5)).any()


def test_any_number_of_labels_meet_and_no_name_is_lost() -> None:
    names = np.random.default_rng(1).permutation(6**3).reshape(6, 6, 6)
    plain = clvol.resample(names.astype(np.int16), (9, 9, 9), smooth=True).data
    assert len(np.unique(plain)) > 100
    table = np.sort(np.random.default_rng(2).integers(-(2**62), 2**62, 6**3))
    assert (clvol.resample(table[names], (9, 9, 9), smooth=True).data == table[plain]).all()  # far apart, and negative
    assert (clvol.resample(names.astype(np.float32), (9, 9, 9), smooth=True).data == plain).all()
    assert clvol.resample((names % 2).astype(bool), (9, 9, 9), smooth=True).data.dtype == bool


@pytest.mark.parametrize("turned", [False, True])
def test_ties_go_to_the_smaller_label(turned: bool) -> None:
    """On both sides of a voxel of another label, and where three meet, whatever lies where."""
    data = np.zeros((8, 8, 8), np.uint8)
    data[:, :4] = 2
    data[:, 4:, :4], data[:, 4:, 4:] = 5, 1
    for flipped in (data, data[:, ::-1], data[..., ::-1], data[:, ::-1, ::-1]):
        grid = Volume(np.broadcast_to(np.float32(0), (1, 1, 3)), (3, 1, 1), (0.5, 3.5, 3.5))
        volume = Volume(flipped)
        if turned:  # another kernel: the same places along turned axes
            grid = replace(grid, origin=(3.5, 0.5, 3.5), direction=np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]]))
            volume = Volume(flipped.swapaxes(1, 2))
        line = clvol.resample(volume, like=grid, smooth=True).data.ravel()
        beside_2 = flipped[0, -1 if flipped[0, 0, 0] == 2 else 0, [0, -1]]
        assert line[[0, 2]].tolist() == np.minimum(beside_2, 2).tolist()
        assert line[1] == 2  # half of the weight, beside a quarter each


def test_a_boundary_is_where_two_balls_touch_and_thin_ones_stay() -> None:
    z, y, x = np.mgrid[:20, :24, :32]
    two = np.zeros(x.shape, np.uint8)
    for label, centre in ((1, 9.3), (2, 21.3)):
        two[(x - centre) ** 2 + (y - 11.6) ** 2 + (z - 9.7) ** 2 < 36] = label
    fine = clvol.resample(two, (60, 72, 96), smooth=True)
    at = points_of(fine.grid)
    truth = np.zeros(fine.shape, np.uint8)
    for label, centre in ((1, 9.3), (2, 21.3)):
        truth[((at - [centre, 11.6, 9.7]) ** 2).sum(-1) < 36] = label
    rough = clvol.resample(two, (60, 72, 96), filter="nearest").data
    for label in (1, 2):
        off, before = (((one == label) != (truth == label)).sum() for one in (fine.data, rough))
        assert off < 0.6 * before
    thin = np.zeros((12, 12, 12), np.int16)
    thin[5:7], thin[2:4, 5:7, 5:7] = 9, -9
    kept = clvol.resample(Volume(thin, (1, 1, 10)), (24, 24, 24), smooth=True)
    assert set(np.unique(kept.data)) == {-9, 0, 9}


def test_fill_and_transform() -> None:
    volume = labels()
    grid = grid_over(volume, (8, 13, 12), turned=False)
    filled = clvol.resample(volume, like=grid, smooth=True, fill=77).data
    plain = clvol.resample(volume, like=grid, smooth=True).data
    index = volume.world_to_index(points_of(grid))
    outside = ((index < -0.5) | (index > np.asarray(volume.size) - 0.5)).any(-1)
    assert outside.any()
    assert (filled == np.where(outside, 77, plain)).all()
    still = clvol.DisplacementField(np.zeros((*volume.shape, 3), np.float32), volume.spacing)
    assert (clvol.resample(volume, like=grid, smooth=True, fill=77, transform=still).data == filled).mean() > 0.999


@pytest.mark.parametrize(
    ("data", "options", "says"),
    [
        (np.full((4, 4, 4), 0.5), {}, "labels must be whole numbers"),
        (np.full((4, 4, 4), np.nan), {}, "labels must be whole numbers"),
        (np.zeros((4, 4, 4), np.uint8), {"filter": "bspline3"}, "bspline5-approx"),
        (np.zeros((4, 4, 4), np.uint8), {"filter": "catmull-rom"}, "nowhere negative"),
        (np.zeros((4, 4, 4), np.uint8), {"fill": 256}, "from 0 to 255"),
        (np.zeros((4, 4, 4), np.uint8), {"fill": 0.5}, "whole number"),
        (np.zeros((4, 4, 4), np.uint8), {"boundary": "constant(-1)"}, "from 0 to 255"),
        (np.zeros((4, 4, 4), np.uint8), {"precision": "double"}, "is for values"),
        (np.zeros((4, 4, 4), np.uint8), {"anti_aliasing": True}, "is for values"),
    ],
)
def test_bad_input(data: np.ndarray[Any, Any], options: dict[str, Any], says: str) -> None:
    with pytest.raises((clvol.DataError, clvol.OptionError), match=says):
        clvol.resample(data, (5, 5, 5), smooth=True, **options)


def test_one_voxel() -> None:
    assert (clvol.resample(np.full((1, 1, 1), 7, np.uint16), (3, 3, 3), smooth=True).data == 7).all()


def test_the_largest_score_names_the_label() -> None:
    scores = np.random.default_rng(3).normal(size=(5, 6, 7, 8)).astype(np.float32)
    got = clvol.resample_scores(scores, (9, 9, 9), filter="linear")
    assert (got.data == np.stack([clvol.resample(one, (9, 9, 9), filter="linear").data for one in scores]).argmax(0)).all()
    assert got.data.dtype == np.uint8
    same = clvol.resample_scores(np.concatenate([scores, scores]), (9, 9, 9), filter="linear")
    assert (same.data == got.data).all()  # equal scores: the first class
    for wrong, options, says in ((scores[0, 0], {}, "shape"), (scores[:0], {}, "classes"), (scores, {"dtype": "f4"}, "dtype")):
        with pytest.raises((clvol.DataError, clvol.OptionError), match=says):
            clvol.resample_scores(wrong, (9, 9, 9), **options)
