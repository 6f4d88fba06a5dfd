"""The impulse response as polynomials, compared with the reference's reconstruction of an impulse."""

from __future__ import annotations

import numpy as np
import pytest

from clvol import reference
from clvol.analysis import impulse_response
from clvol.analysis.cardinal import pieces
from clvol.base.errors import OptionError
from clvol.filter.make import bspline
from clvol.filter.table import as_filter, filters
from clvol.volume.volume import Volume
from tests.cases import BAD_FILTERS, BAD_REALS, BAD_WHOLE, SMOOTHED

NEARLY_EQUAL = "bspline3(0.00694444)"  # poles
ROWS = {row.name: row for row in (*filters().values(), bspline(7), bspline(9), *map(as_filter, (*SMOOTHED, NEARLY_EQUAL)))}


@pytest.mark.parametrize("derivative", [0, 1, 2])
@pytest.mark.parametrize("name", ROWS)
def test_matches_the_reference_for_an_impulse(name: str, derivative: int) -> None:
    n = 161
    impulse = np.zeros((1, n))
    impulse[0, n // 2] = 1
    x = np.random.default_rng(0).uniform(-12, 12, 400)
    drawn = reference.sample(impulse, np.stack([x + n // 2, np.zeros_like(x)], -1), ROWS[name], "wrap", derivative)
    along = drawn if derivative == 0 else drawn[:, 0] if derivative == 1 else drawn[:, 0, 0]
    along = along / reference.sample(Volume([[1.0]]), [[0.0, 0.0]], name if name in filters() else ROWS[name], "wrap")
    row = ROWS[name]
    # the reference uses the kernel, the pieces its fit; a derivative's error may be 2 n² times as large (Markov)
    tolerance = 1e-10 * 400**derivative + 2 * row.fit_error * (2 * row.degree**2) ** derivative
    np.testing.assert_allclose(impulse_response(row, x, derivative), along, rtol=0, atol=tolerance)


def test_the_kernel_alone_without_a_prefilter() -> None:
    x = np.linspace(-3, 3, 601)
    np.testing.assert_allclose(impulse_response("bspline3-approx", x), as_filter("bspline3")(x), atol=1e-15)


def test_energy_and_integral_by_hand() -> None:
    linear = pieces(as_filter("linear"))
    assert linear.energy() == pytest.approx(2 / 3, rel=1e-15)
    assert linear.max_integral() == pytest.approx(1, rel=1e-15)
    assert pieces(as_filter("nearest")).energy() == 1


@pytest.mark.parametrize(
    "bad",
    [
        *({"filter": bad} for bad in BAD_FILTERS),
        *({"x": bad} for bad in (*BAD_REALS, np.nan, [0, np.inf])),
        *({"derivative": bad} for bad in (3, *BAD_WHOLE)),
    ],
    ids=str,
)
def test_bad_input_is_rejected(bad: dict[str, object]) -> None:
    with pytest.raises(OptionError):
        impulse_response(**{"filter": "linear", "x": 0.0, **bad})  # type: ignore[arg-type]
