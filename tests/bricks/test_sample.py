"""`clvol.sample`, `resample` and `magnify` by bricks: for lazy volumes, and where the coefficients do not fit."""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any

import numpy as np
import pytest

import clvol
from clvol import LazyVolume
from clvol.base.errors import DataError, OptionError, OutOfMemoryError
from clvol.device import Device
from tests.bricks.test_source import Counted

TURN = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
VOLUME = clvol.Volume(np.random.default_rng(1).random((37, 41, 52)).astype(np.float32), (1, 2, 3), (5, 6, 7), TURN, color=(1, 0, 0))
BOUND = 1e-6  # of a range of 1


def lazy() -> LazyVolume:
    return LazyVolume(Counted(VOLUME.data), VOLUME.spacing, VOLUME.origin, VOLUME.direction, limits=VOLUME.value_range)


def at(n: int = 500) -> Any:
    return VOLUME.index_to_world(np.random.default_rng(2).uniform(-2, 38, (n, 3)))


TURNED = clvol.AffineTransform(np.linalg.qr(np.eye(3) + 0.05 * TURN)[0], (1, -2, 0.5), VOLUME.center)
MOVED = clvol.AffineTransform(np.eye(3), (0.3, -40, 2))
SLAB = clvol.Volume(np.zeros((110, 4, 100), np.float32), (0.4, 9.0, 1.0), tuple(VOLUME.center - 30))


def displacements(filter: str) -> clvol.DisplacementField:
    """Over a part of the volume, up to several voxels."""
    values = np.random.default_rng(3).normal(scale=4.0, size=(9, 8, 7, 3))
    return clvol.DisplacementField(values, (9, 11, 14), tuple(VOLUME.origin), TURN, filter=filter)


def lattice() -> clvol.BSplineTransform:
    """Over the whole volume and beyond."""
    values = np.random.default_rng(4).normal(scale=3.0, size=(9, 9, 9, 3))
    return clvol.BSplineTransform(values, (40, 40, 40), tuple(VOLUME.center - 160))


CALLS: dict[str, Any] = {
    "values": lambda volume: clvol.sample(volume, at()),
    "gradients": lambda volume: clvol.sample(volume, at(), "bspline5", "reflect", 1) / 4,
    "hessians, filled": lambda volume: clvol.sample(volume=volume, points=at(), derivative=2, fill=-1.0) / 4,
    "a grid": lambda volume: clvol.resample(volume, (20, 30, 40)).data,
    "another": lambda volume: (
        clvol.resample(volume, spacing=1.7, filter="catmull-rom", boundary="wrap", fill=0, anchor="origin").data
    ),
    "moved": lambda volume: clvol.resample(volume, (20, 30, 40), transform=[TURNED, np.diag([0.9, 1.1, 1, 1])], fill=-1.0).data,
    "along its axes": lambda volume: (
        clvol.resample(volume, like=VOLUME, transform=clvol.AffineTransform(np.eye(3), (0.3, -40, 2))).data
    ),
    "displaced": lambda volume: clvol.resample(volume, (35, 30, 110), transform=displacements("linear")).data,
    "displaced twice": lambda volume: (
        clvol.resample(
            volume, like=SLAB, filter="catmull-rom", transform=[displacements("bspline3"), TURNED, lattice()], fill=0.25
        ).data
    ),
    "rounded": lambda volume: clvol.resample(volume, (20, 30, 40), dtype="float64").data,
    "fewer samples": lambda volume: clvol.resample(volume, (20, 30, 20), anti_aliasing="least-squares").data,
    "fewer, filled": lambda volume: (
        clvol.resample(
            volume, spacing=(3, 4, 2), filter="bspline5", boundary="reflect", anti_aliasing="least-squares", fill=-1
        ).data
    ),
    "low-passed": lambda volume: clvol.resample(volume, (20, 15, 26), anti_aliasing=True).data,
    "low-passed, smoothed": lambda volume: (
        clvol.resample(volume, (20, 15, 26), filter="bspline3(auto)", anti_aliasing="gaussian").data
    ),
    "low-passed, turned": lambda volume: (
        clvol.resample(volume, like=SLAB, filter="linear", boundary="zero", anti_aliasing="gaussian").data
    ),
    "magnified": lambda volume: clvol.magnify(volume, 3, "linear").data,
}


@pytest.mark.one_in(3)
@pytest.mark.parametrize("call", CALLS)
def test_results_match_the_whole_volume(call: str) -> None:
    found, truth = CALLS[call](lazy()), CALLS[call](VOLUME)
    assert found.dtype == truth.dtype
    np.testing.assert_allclose(found, truth, rtol=0, atol=BOUND)


def test_a_few_points_read_a_few_bricks() -> None:
    data = Counted(np.random.default_rng(0).random((300, 300, 300), np.float32))
    volume = LazyVolume(data, limits=(0, 1))
    with clvol.BrickedField(volume, edge=32) as field:
        data.read = 0
        values = clvol.sample(field, [[20.5, 33.0, 280.1]])
        assert field.reads.bricks == 1
    with pytest.raises(OptionError, match=r"made with filter .* cannot be changed to 'linear'"):
        clvol.sample(field, [[0, 0, 0]], "linear")
    np.testing.assert_allclose(values, clvol.sample(data.data[200:], [[20.5, 33.0, 80.1]]), rtol=0, atol=BOUND)


@pytest.mark.one_in(3)
@pytest.mark.parametrize("call", CALLS)
def test_volumes_whose_coefficients_do_not_fit(call: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """They are evaluated by bricks."""
    truth = CALLS[call](VOLUME)

    def refused(*_: Any, **__: Any) -> Any:
        raise OutOfMemoryError("out of memory: a buffer of the whole volume")

    monkeypatch.setattr("clvol.spline.field.coefficients_of", refused)
    with pytest.raises(OutOfMemoryError):
        clvol.Field(VOLUME)  # which is for callers that need the coefficients
    warns = pytest.warns(clvol.ClvolWarning, match="by bricks in single precision.*a buffer of the whole volume")
    with nullcontext() if call.startswith("fewer") else warns:  # sums need no coefficients
        found = CALLS[call](VOLUME)
    np.testing.assert_allclose(found, truth, rtol=0, atol=BOUND)
    with pytest.warns(clvol.ClvolWarning, match="by bricks"):
        assert clvol.resample(VOLUME, (4, 5, 6)).color == (1, 0, 0)
    for other in ({"precision": "double"}, {"nan": "local"}):
        with pytest.raises(OutOfMemoryError, match="a buffer of the whole volume"):
            clvol.resample(VOLUME, (4, 5, 6), **other)


@pytest.mark.parametrize("kind", ["uint8", "int16", "float32", "float64"])
def test_reduction_is_the_same_to_the_last_bit(kind: str, tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the blocks: each sum has its terms in the same order. Results may exceed memory."""
    data = np.random.default_rng(5).integers(0, 200, (130, 70, 90)).astype(kind)
    volume = LazyVolume(Counted(data), (1, 1, 2), limits=(float(data.min()), float(data.max())), labels=False)
    truth = clvol.resample(clvol.Volume(data, (1, 1, 2), labels=False), (60, 33, 20), anti_aliasing="least-squares")
    out = np.lib.format.open_memmap(tmp_path / "out.npy", "w+", np.float32, truth.shape)
    told: list[float] = []
    monkeypatch.setattr("clvol.bricks.reduced._EDGES", (16, 8))
    with clvol.BrickedField(volume) as field:
        made = field.resample((60, 33, 20), anti_aliasing="least-squares", out=out, progress=told.append)
    assert told == sorted(told)
    assert told[-1] == 1.0
    assert field.reads.samples >= data.size
    assert len(told) == 4 * 3 * 2
    np.testing.assert_array_equal(made.data, truth.data)
    np.testing.assert_allclose(made.origin, truth.origin)
    least = pytest.raises(OptionError, match=r"memory must be at least \d+ MiB, which a block of 8³ takes; got 0 MiB")
    with clvol.BrickedField(volume, "linear", memory=300 << 10, edge=8) as field, least:
        field.resample((8, 8, 8), anti_aliasing="least-squares")


def test_labels_keep_their_type() -> None:
    data = (VOLUME.data > 0.5).astype(np.uint8) * 7
    labels = LazyVolume(data, labels=True)
    found = clvol.resample(labels, (20, 30, 40))
    assert found.data.dtype == np.uint8
    np.testing.assert_array_equal(found.data, clvol.resample(clvol.Volume(data, labels=True), (20, 30, 40)).data)
    assert clvol.resample(labels, (20, 30, 40), filter="linear").labels is None


def test_unsupported_options_are_rejected_with_alternatives() -> None:
    volume = lazy()
    for call, match in (
        (lambda: clvol.resample(volume, (4, 5, 6), transform=TURNED, anti_aliasing=True), r"transform or anti_aliasing, not both"),
        (lambda: clvol.resample(volume, like=SLAB, anti_aliasing="least-squares"), r"this one is turned"),
        (lambda: clvol.sample(volume, at(), precision="double"), r"takes no precision.*dask"),
        (lambda: clvol.sample(volume, at(), nan="local"), r"takes no nan"),
        (lambda: clvol.prefilter(volume), r"clvol\.dask\.prefilter.*whole"),
    ):
        with pytest.raises(OptionError, match=match):
            call()
    with pytest.raises(TypeError, match="unexpected keyword argument 'colour'"):
        clvol.sample(volume, at(), colour=1)  # type: ignore[call-arg]  # there is none
    with pytest.raises(DataError, match=r"clvol\.BrickedField\(volume\)"):
        clvol.Field(volume)  # type: ignore[arg-type]  # that is the question


@pytest.mark.parametrize("boundary", ["constant", "overlap", "zero", "mirror"])
@pytest.mark.parametrize("filter", ["nearest", "linear"])
def test_magnified_samples_have_their_positions_in_any_world(device: Device, boundary: str, filter: str) -> None:
    """On the outer samples, where the function may jump, and half-way between two."""
    rng = np.random.default_rng(0)
    data = (np.arange(180).reshape(6, 3, 10) % 11).astype(np.float32) + 1
    for factor in (2, 3):
        spacing, origin, direction = rng.uniform(0.1, 3, 3), 50 * rng.normal(size=3), np.linalg.qr(rng.normal(size=(3, 3)))[0]
        wanted = clvol.magnify(clvol.Volume(data, spacing, origin, direction), factor, filter, boundary, device=device)
        lazy = clvol.LazyVolume(data, spacing, origin, direction, labels=False)
        found = clvol.magnify(lazy, factor, filter, boundary, device=device)
        np.testing.assert_allclose(found.data, wanted.data, rtol=0, atol=1e-6 * np.ptp(data))
        assert (found.spacing, found.origin) == (wanted.spacing, wanted.origin)


@pytest.mark.parametrize("way", ["gaussian", "least-squares"])
def test_integers_far_from_zero_are_low_passed_exactly(device: Device, way: Any) -> None:
    data = np.random.default_rng(1).integers(100000, 100200, (18, 38, 26), np.int32)
    about: dict[str, Any] = {"shape": (9, 19, 13), "filter": "bspline3", "anti_aliasing": way, "device": device}
    wanted = clvol.resample(clvol.Volume(data, labels=False), **about).data
    found = clvol.resample(LazyVolume(data, labels=False), **about).data
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-6 * 200)
