"""Coefficients of the device compared with the float64 reference."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from clvol import reference
from clvol.base.errors import DataError, OptionError
from clvol.device import Device
from clvol.filter.make import bspline
from clvol.filter.table import as_filter, filters
from clvol.spline.field import prefilter
from clvol.volume.volume import Volume
from tests.cases import RULES, SMOOTHED

# Greatest error allowed, in units of the greatest sample. float32 rounds at 6e-8; the prefilter gains
# 1/(sum of (-1)^k b_k) an axis at Nyquist, 27 in 3-D for the cubic and far more for higher degrees, and
# its rounding with it. Measured on normal noise, PoCL: about half of these.
TOLERANCE = {
    "bspline2": 2e-6,
    "bspline3": 2e-6,
    "bspline4": 1e-5,
    "bspline5": 2e-5,
    "omoms3": 1e-5,
    "moms3": 1e-5,
    "linear-quasi": 1e-6,
    "bspline3-quasi": 3e-6,
    "bspline7": 8e-4,
}
TOLERANCE |= dict.fromkeys(SMOOTHED, 2e-6)
# ... and in units of the greatest coefficient, for all.
RELATIVE = 1e-6

ROWS = {row.name: row for row in (*filters().values(), bspline(7), *map(as_filter, SMOOTHED)) if row.prefilter}
SHAPES = (
    *[(n,) for n in (1, 2, 3, 4, 5, 17, 64, 301)],
    (1, 1),
    (2, 3),
    (5, 4),
    (33, 17),
    (1, 40),
    (40, 1),
    (1, 1, 1),
    (2, 1, 3),
    (5, 4, 3),
    (9, 17, 12),
    (1, 1, 9),
    (9, 1, 1),
    (31, 3, 2),
    (3, 25, 41),
    (12, 24, 30),
    (70, 9),
)


def check(device: Device, data: Any, name: str, rule: str = "mirror") -> None:
    got = prefilter(data, ROWS[name], rule, device)
    wanted = reference.prefilter(np.asarray(data), ROWS[name], rule)
    assert got.dtype == np.float32
    assert got.shape == wanted.shape
    miss = np.abs(got - wanted).max()
    largest = np.abs(np.asarray(data).astype(np.float64)).max()
    assert miss <= TOLERANCE[name] * largest, np.asarray(data).shape
    assert miss <= RELATIVE * np.abs(wanted).max(), np.asarray(data).shape


def test_every_filter_with_a_prefilter_has_a_tolerance() -> None:
    assert set(TOLERANCE) == set(ROWS)


@pytest.mark.one_in(70)
@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("name", ROWS)
def test_coefficients(device: Device, name: str, rule: str) -> None:
    rng = np.random.default_rng(0)
    for shape in SHAPES:
        check(device, rng.normal(size=shape).astype(np.float32), name, rule)


@pytest.mark.one_in(19)
@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize(
    "name",
    [
        "bspline2(3)",
        "bspline3(1e-6)",
        "bspline3(0.00694)",
        "bspline3(1)",
        "bspline4(0.3)",
        "bspline3(0,0.1,3)",
        "bspline5(0.2,0,1)",
    ],
)
def test_coefficients_of_smoothing_splines(device: Device, name: str, rule: str) -> None:
    """λ with real poles, nearly equal ones (1/144) and complex ones; different per axis, too."""
    rng = np.random.default_rng(3)
    for shape in SHAPES:
        if "," in name and len(shape) < 3:
            continue
        data = rng.normal(size=shape).astype(np.float32)
        wanted = reference.prefilter(data, name, rule)
        largest = max(np.abs(wanted).max(), np.abs(data).max())  # the smoothed result is smaller than the intermediate rounding
        allowed = (
            2 * RELATIVE if rule.startswith(("nearest", "grid-constant")) else RELATIVE
        )  # padded: constants round in one direction
        np.testing.assert_allclose(prefilter(data, name, rule, device), wanted, rtol=0, atol=allowed * largest)


@pytest.mark.one_in(8)
@pytest.mark.parametrize(
    ("name", "error"),
    [("bspline2(30)", 2e-5), ("bspline3(100)", 2e-5), ("bspline3(1e5)", 1e-4), ("bspline5(1e3)", 2e-5), ("bspline5(1e5)", 5e-4)],
)
def test_coefficients_of_strong_smoothing(device: Device, name: str, error: float) -> None:
    """Poles near the unit circle accumulate rounding."""
    worst = 0.0
    for n, rule in itertools.product((4, 60, 800), RULES):
        data = np.random.default_rng(n).normal(size=(n, 9)).astype(np.float32)
        wanted = reference.prefilter(data, name, rule)
        worst = max(worst, float(np.abs(prefilter(data, name, rule, device) - wanted).max() / np.abs(wanted).max()))
    assert worst < error


@pytest.mark.parametrize("rule", RULES)
def test_halo_is_the_extension(device: Device, rule: str) -> None:
    """The halo on the device equals that of numpy.pad."""
    from clvol.filter.boundary import as_boundary
    from clvol.spline.field import coefficients_of

    for shape in ((4, 3, 5), (1, 2, 1), (3, 4), (1, 1)):
        volume = Volume(np.random.default_rng(1).normal(size=shape).astype(np.float32))
        with coefficients_of(volume, as_filter("lanczos3"), as_boundary(rule), device) as held:
            halo = int(held.extent[3])
            with device.buffers.mapped(held.buffer, held.shape, write=False) as stored:
                got = np.array(stored)
        wanted = reference.extend(volume.data, halo, rule).astype(np.float32)
        np.testing.assert_array_equal(got[..., : wanted.shape[-1]].reshape(wanted.shape), wanted)


def test_a_long_axis_starts_as_a_short_one(device: Device) -> None:
    """Longer than the initial sums reach, with all energy at one end."""
    data = np.zeros(5000, np.float32)
    data[[0, 1, -1]] = (1, -3, 2)
    for name in ("bspline3", "bspline5"):
        check(device, data, name)


@pytest.mark.parametrize("name", ["bspline3", "bspline5"])
def test_results_do_not_depend_on_the_order_of_work(device: Device, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """Slice by slice or axis by axis, in long or short launches."""
    data = np.random.default_rng(6).normal(size=(6, 21, 75)).astype(np.float32)
    results = []
    for units, voxels in itertools.product((1, 1000), (1, 1 << 26)):
        monkeypatch.setitem(vars(device), "units", units)
        with device.limited(launch_voxels=voxels):
            results.append(prefilter(data, name, device=device))
        check(device, data, name)
    for result in results[1:]:
        np.testing.assert_array_equal(result, results[0])


DTYPES = ("?", "u1", "i1", "<u2", ">u2", "<i2", ">i2", "<u4", ">i4", "u8", "i8", "f2", "<f4", ">f4", "<f8", ">f8")


@pytest.mark.parametrize("dtype", DTYPES)
def test_dtypes(device: Device, dtype: str) -> None:
    rng = np.random.default_rng(2)
    kind = np.dtype(dtype)
    data = rng.integers(0, 2, (4, 5, 3)).astype(kind) if kind.kind == "b" else rng.integers(0, 100, (4, 5, 3)).astype(kind)
    check(device, data, "bspline3")
    check(device, data[0, 0], "bspline3")


def read_only(a: np.ndarray) -> np.ndarray:
    a.setflags(write=False)
    return a


LAYOUTS: dict[str, Callable[[np.ndarray], Any]] = {
    "strided": lambda a: np.repeat(np.repeat(a, 2, 0), 3, 2)[::2, :, ::3],
    "reversed": lambda a: a[::-1, ::-1, ::-1],
    "fortran": np.asfortranarray,
    "transposed": lambda a: a.transpose(2, 0, 1),
    "read-only": lambda a: read_only(a.copy()),
    "broadcast": lambda a: np.broadcast_to(a[:1], a.shape),
    "memory map like": lambda a: np.frombuffer(a.tobytes(), a.dtype).reshape(a.shape),
    "list": lambda a: a.tolist(),
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_layouts(device: Device, layout: str) -> None:
    data = np.random.default_rng(3).normal(size=(4, 5, 3)).astype(np.float32)
    made = LAYOUTS[layout](data)
    before = np.array(made)
    check(device, made, "bspline3")
    np.testing.assert_array_equal(np.asarray(made), before)  # never written to


def test_without_a_prefilter_coefficients_are_samples(device: Device) -> None:
    data = np.random.default_rng(4).integers(0, 255, (4, 5, 3)).astype(np.uint8)
    for name in ("nearest", "linear", "mitchell", "bspline3-approx"):
        np.testing.assert_array_equal(prefilter(data, name, device=device), data)
        np.testing.assert_array_equal(prefilter(data[0, 0], name, device=device), data[0, 0])


def test_hybrid_uses_the_coefficients_of_its_magnifier(device: Device) -> None:
    data = np.random.default_rng(5).normal(size=(4, 5))
    np.testing.assert_array_equal(prefilter(data, "hybrid", device=device), prefilter(data, "bspline3", device=device))


@pytest.mark.parametrize(
    ("data", "error"),
    [
        (3.0, DataError),
        ([], DataError),
        (np.ones((2, 2, 2, 2)), DataError),
        (np.ones((0, 3)), DataError),
        (["a"], DataError),
        ([1j], DataError),
        ([object()], DataError),
        ([np.nan, 1.0], DataError),
        ([[1.0, np.inf]], DataError),
        ([[1.0], [1.0, 2.0]], DataError),
        (np.zeros(3, "M8[s]"), DataError),
    ],
)
def test_invalid_samples_are_rejected(device: Device, data: Any, error: type[Exception]) -> None:
    with pytest.raises(error):
        prefilter(data, device=device)


def test_bad_options_are_rejected(device: Device) -> None:
    for options in ({"filter": "none"}, {"boundary": "none"}, {"filter": 3}, {"device": "no such device"}):
        with pytest.raises(OptionError):
            prefilter([1.0, 2.0], **{"device": device, **options})  # type: ignore[arg-type]
