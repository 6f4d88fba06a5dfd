"""A custom mode, a class and a kernel file, renders in memory, by bricks and on a cluster, with skipping."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

import clvol
from clvol import Mode, Renderer, TransferFunction
from clvol.base.uniform import FLOAT, Block, Values
from clvol.bricks.field import BrickedField
from clvol.device import program
from clvol.march.options import KEYWORDS, ModeOptions
from clvol.scene.mode import every_option
from clvol.volume.stored import AS_THEY_ARE, Stored
from tests.march.test_bricks import CAMERAS, GUIDES, Known, waves

KERNEL = """
#include "march/sample.cl"
#include "transfer/ramp.cl"

typedef struct { real value, t; } state_t;

#define REACH 0.0f
#define ANY_ORDER 0
#define PROMISE(low, high) 0.0f

INLINE void begin(state_t *s)
{
    s->value = (real)(0.0f);
    s->t = NOWHERE;
}

INLINE mask finished(const state_t *s, constant frame_t *frame) { return s->t < NOWHERE; }

INLINE int matters(const state_t *s, constant frame_t *frame, global const float4 *table, float low, float high, real t,
                   mask active)
{
    return low <= frame->mode.high && high >= frame->mode.low && any_lane(active & (s->t == NOWHERE));
}

INLINE mask gather(state_t *s, COEFFICIENTS coefficients, const sample_t *sample, real t, real value, mask active)
{
    const real low = (real)(sample->frame->mode.low), high = (real)(sample->frame->mode.high);
    const mask met = active & (s->t == NOWHERE) & (value >= low) & (value <= high);
    s->value = choose(met, value, s->value);
    s->t = choose(met, t, s->t);
    return s->t < NOWHERE;
}

INLINE void merge(state_t *front, const state_t *back)
{
    const mask later = front->t == NOWHERE;
    front->value = choose(later, back->value, front->value);
    front->t = choose(later, back->t, front->t);
}

INLINE real place_of(const state_t *s) { return s->t; }

INLINE color_t finish(const state_t *s, COEFFICIENTS coefficients, const sample_t *sample)
{
    color_t color = classify(&sample->frame->transfer, sample->table, s->value);
    color.opacity = choose(s->t < NOWHERE, (real)(1.0f), (real)(0.0f));
    return color;
}
"""


@dataclass(frozen=True)
class Band(Mode):
    """The first sample of a ray whose value lies in a band."""

    low: float = 0.75
    high: float = 0.8

    name: ClassVar[str] = "band"
    description: ClassVar[str] = "the first sample within a band of values"
    state_fields: ClassVar[int] = 2
    BLOCK: ClassVar[Block] = Block("mode_block", low=FLOAT, high=FLOAT)

    def interval_matters(self, low: float, high: float, transfer: TransferFunction) -> bool:  # noqa: ARG002
        return low <= self.high and high >= self.low

    def block(self, volume: clvol.Volume, stored: Stored = AS_THEY_ARE) -> Values:  # noqa: ARG002
        return self.BLOCK(low=stored(self.low), high=stored(self.high))


@pytest.fixture(autouse=True)
def kernels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(program.folder(), tmp_path / "cl")
    (tmp_path / "cl/modes/band.cl").write_text(KERNEL)
    monkeypatch.setattr(program, "folder", lambda: tmp_path / "cl")


@pytest.fixture
def samples() -> Any:
    """Waves, few of which reach the band."""
    data = waves(40, 44, 48)
    data[:, :, 16:] *= 0.5
    return data


LOOK: dict[str, Any] = {"transfer": TransferFunction.ramp((0, 1)), "outputs": GUIDES}


@pytest.fixture
def expected(samples: Any) -> Iterator[dict[str, Any]]:
    with Renderer(clvol.Volume(samples), "linear") as renderer:
        yield renderer.render(CAMERAS["aslant"], Band(), (48, 40), skipping=False, **LOOK)


def equal(made: dict[str, Any], expected: dict[str, Any]) -> None:
    assert 0.05 < (expected["rgba"][..., :3] > 0).any(-1).mean() < 0.95
    for name in GUIDES:
        np.testing.assert_array_equal(made[name], expected[name], err_msg=name)


def test_in_memory_space_is_skipped(samples: Any, expected: dict[str, Any]) -> None:
    with Renderer(clvol.Volume(samples), "linear") as renderer:
        equal(renderer.render(CAMERAS["aslant"], Band(), (48, 40), **LOOK), expected)
        visited = renderer.render(CAMERAS["aslant"], Band(), (48, 40), outputs="visited")
        assert np.nanmean(visited) < 0.5


def test_by_bricks_those_outside_the_band_are_not_read(samples: Any, expected: dict[str, Any]) -> None:
    lazy = clvol.LazyVolume(samples, limits=(samples.min(), samples.max()), labels=False, bounds=Known(samples))
    with BrickedField(lazy, "linear", edge=16) as field, Renderer(field) as renderer:
        equal(renderer.render(CAMERAS["aslant"], Band(), (48, 40), **LOOK), expected)
        assert 0 < field.reads.bricks < len(field.bricks) / 2


def test_on_a_cluster(samples: Any, expected: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr("clvol.bricks.field.edge_for", lambda *_, **_options: 16)
    lazy = clvol.LazyVolume(samples, limits=(samples.min(), samples.max()), labels=False)
    with distributed.Client(processes=False, n_workers=2, threads_per_worker=1, dashboard_address=None) as client:
        for merge in ("order", "tree"):
            with Renderer(lazy, "linear", cluster=client, merge=merge) as renderer:
                equal(renderer.render(CAMERAS["aslant"], Band(), (48, 40), **LOOK), expected)


def test_options_of_the_modes_of_the_table_are_declared() -> None:
    assert set(ModeOptions.__annotations__) == every_option()
    assert not set(KEYWORDS) & every_option()
