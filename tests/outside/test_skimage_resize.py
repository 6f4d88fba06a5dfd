"""`clvol.resize` beside scikit-image's: the same call, the same array.

Departures, each with its test below:

- integers of order 0 that are low-passed are rounded once; scikit-image cuts digits off after each axis, and gives up to 1 less for
  each;
- "symmetric" from order 2 on is exact on short axes, too. SciPy's prefilter begins there with a sum that is cut off: values err by
  0.3 % of the range on axes of 3 samples at order 3, by 4 % at order 5, and an axis that keeps its length does not keep its values;
- NaN and infinities are rejected for orders of 2 and more, where scikit-image gives an array of NaN;
- a shape must be whole numbers; scikit-image rounds.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from itertools import product
from typing import Any

import numpy as np
import pytest

import clvol
from clvol.device import Device

transform = pytest.importorskip("skimage.transform")

KINDS = ("?", "u1", "i1", "u2", ">u2", "i4", "f2", "f4", ">f4", "f8")
SHAPES = (
    ((5,), (9,)),
    ((1, 5), (3, 2)),
    ((8, 6), (4, 9)),
    ((9, 8, 3), (5, 4)),  # the last axis keeps its length
    ((6, 7), (9, 7, 1)),  # and more axes than there were
    ((7, 6, 5), (9, 3, 8)),
    ((6, 5, 7, 8), (8, 7, 5, 6)),
)
MODES = ("reflect", "symmetric", "edge", "wrap", "constant")


def image(kind: str, shape: tuple[int, ...], seed: int) -> np.ndarray[Any, Any]:
    random = np.random.default_rng(seed)
    if np.dtype(kind).kind in "iu":
        limits = np.iinfo(kind)
        made = random.integers(limits.min, limits.max, shape, endpoint=True)
        made.flat[0] = limits.min  # whose magnitude is larger than that of the largest
        return made.astype(kind)
    return (random.random(shape) > 0.5) if kind == "?" else (random.random(shape) * 2 - 1).astype(kind)


def cases() -> Iterator[dict[str, Any]]:
    """A sample of all combinations, the same in each run."""
    random = np.random.default_rng(18)
    for shapes, order, mode, chosen, kept in product(SHAPES, (None, 0, 1, 2, 3, 4, 5), MODES, (None, False, True), (False, True)):
        if random.random() < 0.07:
            yield {
                "shapes": shapes,
                "order": order,
                "mode": mode,
                "anti_aliasing": chosen,
                "preserve_range": kept,
                "clip": bool(random.random() < 0.7),
                "cval": float(random.choice([0, 0.25, -3])),
            }


@pytest.mark.one_in(10)
@pytest.mark.parametrize("kind", KINDS)
def test_values_types_and_shapes_match(kind: str, device: Device) -> None:
    compared = 0
    for seed, options in enumerate(cases()):
        (old, new), order, chosen = options.pop("shapes"), options["order"], options["anti_aliasing"]
        if kind == "?" and (order or chosen):
            continue  # rejected by both: below
        if np.dtype(kind).kind in "iu" and order == 0 and chosen:
            continue  # rounds differently: below
        if options["mode"] == "symmetric" and (order or 1) > 1:  # SciPy is wrong on short axes: below
            if len(old) > 3:
                continue
            old, new = tuple(8 * n for n in old), tuple(8 * n for n in new)
        data = image(kind, old, seed)
        wanted = transform.resize(data, new, **options)
        got = clvol.resize(data, new, device=device, **options)
        assert (got.shape, got.dtype) == (wanted.shape, wanted.dtype.newbyteorder("=")), options
        span = float(np.abs(wanted.astype(np.float64)).max()) or 1.0
        np.testing.assert_allclose(got, wanted, rtol=0, atol=4e-6 * span, err_msg=f"{old} {new} {options}")
        compared += 1
    assert compared > (15 if kind == "?" else 60)


@pytest.mark.parametrize("sigma", [0.0, 1.5, (0.0, 2.0), (0.7, 0.4)])
def test_the_width_of_the_gaussian_can_be_chosen(sigma: Any, device: Device) -> None:
    data = np.random.default_rng(0).random((20, 30))
    for mode in MODES:
        wanted = transform.resize(data, (7, 8), 1, mode, 0.5, anti_aliasing=True, anti_aliasing_sigma=sigma)
        got = clvol.resize(data, (7, 8), 1, mode, 0.5, anti_aliasing=True, anti_aliasing_sigma=sigma, device=device)
        np.testing.assert_allclose(got, wanted, atol=1e-12)


def test_both_warn_of_a_gaussian_where_nothing_shrinks(device: Device) -> None:
    data = np.random.default_rng(0).random((9, 9))
    for resize, options in ((transform.resize, {}), (clvol.resize, {"device": device})):
        with pytest.warns(UserWarning, match="greater than zero"):
            made = resize(data, (5, 12), anti_aliasing=True, anti_aliasing_sigma=1, **options)
        assert made.shape == (5, 12)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            resize(data, (5, 12), anti_aliasing=True, anti_aliasing_sigma=(1, 0), **options)


@pytest.mark.parametrize("chosen", [True, False])
@pytest.mark.parametrize("order", [0, 1])
def test_nan_is_accepted_where_it_stays_local(order: int, chosen: bool, device: Device) -> None:
    data = np.random.default_rng(0).random((9, 9))
    data[2, 3] = np.nan
    for new in ((4, 5), (13, 18)):
        wanted = transform.resize(data, new, order, anti_aliasing=chosen)
        got = clvol.resize(data, new, order, anti_aliasing=chosen, device=device)
        np.testing.assert_allclose(got, wanted, atol=1e-12)


REFUSED: dict[str, tuple[Any, Any, dict[str, Any]]] = {
    "too few numbers": (np.ones((4, 4, 4)), (2,), {}),
    "order 6": (np.ones((4, 4)), (2, 2), {"order": 6}),
    "order -1": (np.ones((4, 4)), (2, 2), {"order": -1}),
    "an unknown mode": (np.ones((4, 4)), (2, 2), {"mode": "nearest"}),
    "booleans between": (np.ones((4, 4), bool), (2, 2), {"order": 1}),
    "booleans low-passed": (np.ones((4, 4), bool), (2, 2), {"anti_aliasing": True}),
    "a negative width": (np.ones((4, 4)), (2, 2), {"anti_aliasing": True, "anti_aliasing_sigma": -1}),
    "complex numbers": (np.ones((4, 4), complex), (2, 2), {}),
}


@pytest.mark.parametrize("what", REFUSED)
def test_input_that_skimage_rejects_raises_a_value_error(what: str, device: Device) -> None:
    data, shape, options = REFUSED[what]
    for resize, more in ((transform.resize, {}), (clvol.resize, {"device": device})):
        with pytest.raises(ValueError):  # noqa: PT011  # the words are each one's own
            resize(data, shape, **options, **more)


# -- departures ----------------------------------------------------------------------------------------------------------


def test_low_passed_integers_are_rounded_once(device: Device) -> None:
    data = np.random.default_rng(0).integers(0, 256, (12, 12)).astype(np.uint8)
    exact = transform.resize(data.astype(np.float64), (4, 4), 0, anti_aliasing=True)
    got = clvol.resize(data, (4, 4), 0, anti_aliasing=True, device=device)
    theirs = transform.resize(data, (4, 4), 0, anti_aliasing=True)
    assert np.abs(got - exact).max() <= 0.5 + 1e-4
    assert -2 < (theirs - exact).min() < -1
    assert (theirs <= got).all()


@pytest.mark.parametrize("order", [2, 3, 4, 5])
def test_symmetric_ends_are_exact_on_short_axes(order: int, device: Device) -> None:
    """The same as in the middle of many repetitions."""
    data = np.random.default_rng(0).random(3)
    copies = np.tile(np.append(data, data[::-1]), 21)
    truth = transform.resize(copies, (copies.size // 3 * 5,), order, "wrap", anti_aliasing=False, clip=False)[100:105]
    got = clvol.resize(data, (5,), order, "symmetric", anti_aliasing=False, clip=False, device=device)
    np.testing.assert_allclose(got, truth, atol=1e-12)
    theirs = transform.resize(data, (5,), order, "symmetric", anti_aliasing=False, clip=False)
    assert np.abs(theirs - truth).max() > 1e-6
    kept = transform.resize(np.stack([data] * 8), (5, 3), order, "symmetric", anti_aliasing=False, clip=False)
    assert np.abs(kept - data).max() > 1e-6
