"""The min-max pyramid bounds the function, for every filter, and is tight."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from clvol.device import Device
from clvol.filter.boundary import as_boundary
from clvol.filter.filter import Filter
from clvol.filter.make import from_callable, from_pieces
from clvol.filter.table import as_filter, filters
from clvol.phantoms import marschner_lobb
from clvol.spline.evaluator import Evaluator
from clvol.spline.field import coefficients_of
from clvol.spline.minmax import BLOCK, MinMax, bernstein
from clvol.spline.points import sample_coefficients
from clvol.volume.volume import Volume
from tests.cases import SMOOTHED

TAPS = Evaluator(paired=False, image=False)


def levels(bounds: MinMax) -> list[NDArray[np.float32]]:
    """(min, max) of the blocks of each level, [z, y, x, 2]."""
    flat = np.empty(bounds.buffer.size // 4, np.float32)
    bounds.coefficients.device.buffers.download(bounds.buffer, flat)
    found, size = [], np.array(bounds.blocks)
    for offset in bounds.offsets:
        count = int(np.prod(size))
        found.append(flat[2 * offset : 2 * (offset + count)].reshape(*size[::-1], 2))
        size = -(-size // 2)
    return found


def blocks_of(points: NDArray[np.float64], filter: Filter, halo: int) -> NDArray[np.int64]:
    """The finest block that contains each point (x, y, z)."""
    first = np.floor(points * filter.scale - filter.support / 2 + 1).astype(np.int64) + halo  # independent of Filter.cell
    return np.asarray(first // (BLOCK * filter.scale))


def test_bernstein_coefficients_of_a_cell_match_the_filter() -> None:
    # section 4.1: in the Bernstein basis the cubic's four points are sums of its neighbours' with these weights
    want = np.array([[1, 4, 1, 0], [0, 4, 2, 0], [0, 2, 4, 0], [0, 1, 4, 1]]) / 6
    np.testing.assert_allclose(bernstein(as_filter("bspline3")), want, atol=1e-15)
    t = np.linspace(0, 1, 33)
    for row in filters().values():
        n = row.degree
        if n > 5:
            continue  # power coefficients of high degree cancel
        rows = bernstein(row)
        basis = [polynomial.polyfromroots([0] * j + [1] * (n - j)) * (-1) ** (n - j) for j in range(n + 1)]
        choose = [np.prod([(n - i) / (i + 1) for i in range(j)]) for j in range(n + 1)]
        values = sum(c * polynomial.polyval(t, b)[None] * r[:, None] for c, b, r in zip(choose, basis, rows, strict=True))
        np.testing.assert_allclose(values, row.weights(t), atol=1e-12)


ROWS: dict[str, Filter] = {
    **filters(),
    **{name: as_filter(name) for name in SMOOTHED},
    # fits that nearly sum to one, that jump, and one with negative values everywhere
    "nearly one": from_callable("nearly-one", lambda x: np.sinc(x) * np.sinc(x / 4), 4, degree=2),
    "jumps": from_callable("jumps", lambda x: np.exp(-x * x / 0.98), 2, degree=0),
    "negative": from_pieces("negative", [[-1.0, 0.25], [-0.75, 0.5]]),
}


@pytest.mark.one_in(15)
@pytest.mark.parametrize(("name", "boundary"), [*product(ROWS, ["mirror", "zero"])])
def test_no_value_lies_outside_the_bounds_of_its_block(device: Device, name: str, boundary: str) -> None:
    rng = np.random.default_rng(5)
    row = ROWS[name]
    for shape in ((13, 6, 19), (1, 9, 2), (9, 9, 9)):
        data = rng.standard_normal(shape) * 10.0 ** rng.integers(-3, 4, shape) if shape != (9, 9, 9) else np.full(shape, 7.0)
        volume = Volume(data.astype(np.float32))
        points = rng.uniform(-0.5, np.array(shape[::-1]) - 0.5, (20000, 3))
        with coefficients_of(volume, row, as_boundary(boundary), device) as held:
            values = sample_coefficients(held, TAPS, points)
            bounds = MinMax(held, TAPS)
            finest = blocks_of(points, row, int(held.extent[3]))
            for level, blocks in enumerate(levels(bounds)):
                x, y, z = np.moveaxis(finest >> level, -1, 0)
                low, high = np.moveaxis(blocks[z, y, x], -1, 0)
                assert (low <= values).all()
                assert (values <= high).all()
            assert blocks.shape[:3] == (1, 1, 1)
            bounds.release()


def test_bounds_are_tight(device: Device) -> None:
    """For Marschner-Lobb, hardly more blocks may contain the isovalue than do."""
    volume = marschner_lobb(41)
    row = as_filter("bspline3")
    with coefficients_of(volume, row, as_boundary("mirror"), device) as held:
        bounds = MinMax(held, TAPS)
        finest = levels(bounds)[0]
        t = (np.arange(5 * 24) + 0.5) / 5  # of one corner of it
        z, y, x = np.meshgrid(t, t, t, indexing="ij")
        points = np.stack([x, y, z], -1).reshape(-1, 3)
        world = points @ volume.index_to_world_matrix.T + np.asarray(volume.origin)
        values = sample_coefficients(held, TAPS, world)
        index = np.ravel_multi_index(tuple(blocks_of(points, row, int(held.extent[3])).T[::-1]), finest.shape[:3])
        low = np.full(finest[..., 0].size, np.inf)
        high = -low
        np.minimum.at(low, index, values)
        np.maximum.at(high, index, values)
        seen = high > -np.inf
        truth = seen & (low <= 0.5) & (high >= 0.5)
        claimed = seen & (finest[..., 0].ravel() <= 0.5) & (finest[..., 1].ravel() >= 0.5)
        assert not (truth & ~claimed).any()
        assert truth.sum() <= claimed.sum() <= 1.15 * truth.sum()  # blocks at the edge reach past the volume
        bounds.release()


def test_constant_data_have_tight_bounds_and_little_memory(device: Device) -> None:
    volume = Volume(np.full((64, 64, 64), 7.0, np.float32))
    for name, within in (("bspline3", 1e-3), ("sinc", 4.0)):  # a sinc that is cut off does not keep constants
        with coefficients_of(volume, as_filter(name), as_boundary("mirror"), device) as held:
            bounds = MinMax(held, TAPS)
            assert bounds.buffer.size <= 0.1 * volume.data.nbytes
            inner = levels(bounds)[0][1:-1, 1:-1, 1:-1]
            assert np.abs(inner - 7).max() <= within
            bounds.release()
