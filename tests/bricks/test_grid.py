"""Bricks partition a volume, and have margins."""

from __future__ import annotations

import itertools
import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from clvol.bricks.grid import ALIGNED, BrickGrid
from clvol.spline.minmax import BLOCK

SIZES = st.tuples(*[st.integers(1, 70)] * 3)
GRIDS = st.builds(
    BrickGrid,
    size=SIZES,
    edge=st.integers(8, 40),
    margin=st.integers(0, 20),
    wraps=st.booleans(),
    support=st.integers(1, 6),
    scale=st.sampled_from([1, 2, 4]),  # planes of others are rounded
    halo=st.integers(2, 9),
)


@settings(max_examples=40, deadline=None)
@given(GRIDS)
def test_each_position_has_one_owner(grid: BrickGrid) -> None:
    bricks = list(grid)
    assert len(bricks) == len(grid) == math.prod(grid.counts)
    assert [brick.at for brick in bricks] == [(x, y, z) for z, y, x in itertools.product(*map(range, grid.counts[::-1]))]
    for axis, n in enumerate(grid.size):
        x = np.concatenate([np.linspace(-2.0, n + 2.0, 97), [grid.plane(i) for i in range(grid.counts[axis])], [-1e9, 1e9]])
        owners = grid.owners(x, axis)
        for brick in bricks:
            np.testing.assert_array_equal(owners == brick.at[axis], (brick.low[axis] <= x) & (x < brick.high[axis]))


@settings(max_examples=40, deadline=None)
@given(GRIDS)
def test_neighbours_share_planes(grid: BrickGrid) -> None:
    for brick in grid:
        for axis in range(3):
            at = list(brick.at)
            at[axis] += 1
            if at[axis] == grid.counts[axis]:
                assert brick.high[axis] == math.inf
                continue
            after = grid[at[0], at[1], at[2]]
            assert brick.high[axis] == after.low[axis] == grid.plane(at[axis])
            assert grid.cells(brick)[1][axis] == grid.cells(after)[0][axis]


@settings(max_examples=40, deadline=None)
@given(GRIDS)
def test_margins_end_at_the_samples(grid: BrickGrid) -> None:
    for brick in grid:
        for axis, n in enumerate(grid.size):
            first, last = brick.at[axis] * grid.edge, min((brick.at[axis] + 1) * grid.edge, n)
            low, high = first - grid.margin, last + grid.margin
            if not grid.wraps:
                low, high = max(0, low), min(n, high)
            assert brick.first[axis] <= low
            assert brick.last[axis] >= high
            assert low - brick.first[axis] < ALIGNED
            assert brick.first[axis] % ALIGNED == 0
            if not grid.wraps:
                assert 0 <= brick.first[axis] < brick.last[axis] <= n


@settings(max_examples=40, deadline=None)
@given(GRIDS)
def test_runs_are_a_bricks_samples_within_the_volume(grid: BrickGrid) -> None:
    for brick in grid:
        for axis, (runs, n) in enumerate(zip(grid.runs(brick)[::-1], grid.size, strict=True)):
            read = np.concatenate([np.arange(*run) for run in runs])
            np.testing.assert_array_equal(read, np.arange(brick.first[axis], brick.last[axis]) % n)
            assert all(0 <= start < stop <= n for start, stop in runs)
        assert brick.samples == math.prod(brick.size)


@settings(max_examples=40, deadline=None)
@given(GRIDS)
def test_the_pyramid_covers_a_bricks_cells_and_a_margin(grid: BrickGrid) -> None:
    for brick in grid:
        stored = [grid.scale * n + 2 * grid.halo for n in brick.size]
        first, past = grid.pyramid_cells(brick, stored)
        own = grid.cells(brick)
        for axis in range(3):
            shift = brick.first[axis] * grid.scale
            last = stored[axis] - grid.support + 1
            low, high = own[0][axis] - shift, own[1][axis] - shift
            assert 0 <= first[axis] <= max(0, low - BLOCK * grid.scale)
            assert first[axis] % ALIGNED == 0
            assert past[axis] == min(last, high + BLOCK * grid.scale)


@settings(max_examples=40, deadline=None)
@given(GRIDS)
def test_the_rendered_region_contains_the_brick(grid: BrickGrid) -> None:
    for brick in grid:
        low, high = grid.seen(brick)
        for axis, n in enumerate(grid.size):
            assert 0 <= low[axis] <= max(0, brick.low[axis])
            assert min(brick.high[axis], n) <= high[axis] <= n
