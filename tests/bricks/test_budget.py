"""The brick edge that a memory budget allows."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clvol.bricks.budget import LEAST, Needs, edge_for, too_small

MIB = 1 << 20


def needs(size: tuple[int, int, int] = (512, 512, 512), chunks: int = 0, *, wraps: bool = False, margin: int = 20) -> Needs:
    lines = [np.append(np.arange(0, n, chunks), n) for n in size[::-1]] if chunks else None
    return Needs(size, 2, margin, wraps, lambda n: 4 * math.prod(n), lines, 2 * chunks**3)


@settings(max_examples=60, deadline=None)
@given(
    st.tuples(*[st.integers(1, 2000)] * 3),
    st.sampled_from([0, 16, 64, 200]),
    st.booleans(),
    st.integers(0, 60),
    st.integers(1 << 18, 1 << 34),
    st.integers(1 << 18, 1 << 34),
)
def test_bricks_fit(size: tuple[int, int, int], chunks: int, wraps: bool, margin: int, budget: int, largest: int) -> None:
    own = needs(size, chunks, wraps=wraps, margin=margin)
    edge = edge_for(own, budget, largest, [chunks] * 3 if chunks else None)
    if edge is None:
        assert own.read(LEAST) > budget or own.buffer(LEAST) > largest or own.layer(LEAST) > budget // 2
        return
    assert own.resident(edge) <= own.read(edge) <= budget
    assert own.buffer(edge) <= largest
    if chunks and edge >= chunks:
        assert edge % chunks == 0
    assert own.chunks_kept(edge, budget) <= budget // 2


@settings(max_examples=40, deadline=None)
@given(st.integers(8, 300), st.integers(1, 100))
def test_longer_edges_need_at_least_as_much(edge: int, more: int) -> None:
    for own in (needs(), needs(chunks=64), needs(wraps=True)):
        for bytes_of in (own.buffer, own.resident, own.read):
            assert bytes_of(edge) <= bytes_of(edge + more)
        assert all(a <= b for a, b in zip(own.samples(edge), own.samples(edge + more), strict=True))


@settings(max_examples=40, deadline=None)
@given(st.integers(1 << 20, 1 << 33), st.integers(0, 1 << 32))
def test_a_larger_budget_still_holds_a_brick(budget: int, more: int) -> None:
    if edge_for(needs(), budget, 1 << 40) is not None:
        assert edge_for(needs(), budget + more, 1 << 40) is not None


def test_edges() -> None:
    assert edge_for(needs((100, 100, 100)), 2 << 30, 1 << 40, in_memory=True) == 100  # all of it, without margins
    assert edge_for(needs((100, 100, 100), wraps=True), 2 << 30, 1 << 40, in_memory=True) == 256
    assert edge_for(needs((3, 3, 3)), 2 << 30, 1 << 40, in_memory=True) == 8
    assert edge_for(needs(), 2 << 30, 1 << 40) == 256  # which holds all coefficients
    assert edge_for(needs(), 512 * MIB, 1 << 40) == 128
    assert edge_for(needs(chunks=96), 512 * MIB, 1 << 40, [96] * 3) == 96  # whole chunks
    assert edge_for(needs(), 1 * MIB, 1 << 40) is None
    assert edge_for(needs(), 2 << 30, 3 * MIB) == 32  # as the device's buffers allow


def test_chunks_longer_than_bricks() -> None:
    planes = Needs(
        (512, 512, 512), 2, 4, False, lambda n: 4 * math.prod(n), [np.arange(513), np.array([0, 512]), np.array([0, 512])], 2 << 18
    )
    assert planes.long_chunks(64) == (True, True, False)
    assert planes.layer(64) == 2 * 512 * 512 * (64 + 2 * 4 + 4)
    assert planes.chunks_kept(64, 1 << 30) == 2 * 512**3
    edge = edge_for(planes, 120 * MIB, 1 << 40, [512, 512, 1])
    assert edge == 64  # half of the budget holds the planes of a layer
    assert planes.layer(edge) <= 60 * MIB < planes.layer(2 * edge)


def test_the_error_states_the_minimum() -> None:
    own = needs(chunks=200)
    assert str(too_small(own, 32, 9)) == (
        f"memory must be at least {own.read(32)} bytes, which reading a brick of 32³ samples takes with its chunk of {2 * 200**3} "
        "bytes; got 9"
    )
    assert str(too_small(needs(), 32, 9)).startswith(f"memory must be at least {needs().read(32)} bytes, which a brick of 32³")
    with pytest.raises(type(too_small(own, 32, 9))):
        raise too_small(own, 32, 9)
