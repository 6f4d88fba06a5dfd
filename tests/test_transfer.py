"""Transfer functions: the exact function, its table, and what is guessed from a histogram."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clvol import phantoms
from clvol.errors import ClvolError, OptionError
from clvol.transfer import TABLE_SIZE, TransferFunction, otsu_threshold
from clvol.volume import Volume

SOME = TransferFunction(((-1.0, "red"), (0.0, (0, 1, 0)), (3.0, "#0000ff")), ((-0.5, 0.0), (1.0, 0.8), (2.0, 0.1)))


def test_points_are_met_and_lines_lie_between() -> None:
    np.testing.assert_allclose(SOME([-1, 0, 3])[:, :3], np.eye(3))
    np.testing.assert_allclose(SOME([-0.5, 1, 2])[:, 3], [0, 0.8, 0.1])
    np.testing.assert_allclose(SOME(1.5), [0, 0.5, 0.5, 0.45])
    np.testing.assert_allclose(SOME([[-9, 9]]), [[[1, 0, 0, 0], [0, 0, 1, 0.1]]])  # constant beyond the ends
    assert SOME.value_range == (-1.0, 3.0)


def test_the_table_is_the_function_at_its_nodes() -> None:
    table = SOME.table()
    assert table.shape == (TABLE_SIZE, 4)
    assert table.dtype == np.float32
    nodes = np.linspace(-1, 3, TABLE_SIZE)
    np.testing.assert_allclose(table, SOME(nodes), atol=1e-7)
    # these points lie on nodes, so that lines between nodes are the function itself
    values = np.random.default_rng(0).uniform(-1, 3, 1000)
    between = np.stack([np.interp(values, nodes, column) for column in table.T], -1)
    np.testing.assert_allclose(between, SOME(values), atol=2e-7)


def test_points_between_nodes_move_by_less_than_a_node() -> None:
    odd = TransferFunction(((0.0, "black"), (1.0, "white")), ((0.30003, 0.0), (0.70001, 1.0)))
    nodes = np.linspace(0, 1, TABLE_SIZE)
    values = np.linspace(0, 1, 20011)
    between = np.interp(values, nodes, odd.table()[:, 3])
    slope = 1 / 0.4
    assert np.abs(between - odd(values)[:, 3]).max() <= slope / (TABLE_SIZE - 1)


def test_a_single_point_is_a_constant() -> None:
    fog = TransferFunction(((5.0, "white"),), ((5.0, 0.3),))
    np.testing.assert_allclose(fog([-100, 5, 100]), [[1, 1, 1, 0.3]] * 3)
    np.testing.assert_allclose(fog.table(), [[1, 1, 1, 0.3]] * TABLE_SIZE, rtol=1e-6)


def test_colour_maps_by_name() -> None:
    grey = TransferFunction.from_cmap("gray", (10, 20))
    np.testing.assert_allclose(grey([10, 15, 20])[:, :3], [[0, 0, 0], [0.5, 0.5, 0.5], [1, 1, 1]], atol=5e-3)
    assert grey(3)[3] == 1
    viridis = TransferFunction.from_cmap("viridis", (0, 1), [(0.2, 0.0), (1.0, 0.5)])
    np.testing.assert_allclose(viridis(0)[:3], [0.267, 0.005, 0.329], atol=5e-3)
    np.testing.assert_allclose(viridis(1), [0.993, 0.906, 0.144, 0.5], atol=5e-3)
    assert viridis(0.6)[3] == pytest.approx(0.25)


def test_ramp_and_with_opacity() -> None:
    ramp = TransferFunction.ramp((2, 4))
    np.testing.assert_allclose(ramp([2, 3, 4]), [[0, 0, 0, 1], [0.5, 0.5, 0.5, 1], [1, 1, 1, 1]])
    other = ramp.with_opacity([(2, 0.25), (4, 0.75)])
    np.testing.assert_allclose(other(3), [0.5, 0.5, 0.5, 0.5])
    assert other.colors == ramp.colors


def test_otsu_parts_two_humps() -> None:
    rng = np.random.default_rng(1)
    data = np.concatenate([rng.normal(10, 2, 6000), rng.normal(60, 5, 2000)]).reshape(20, 20, 20)
    assert 18 < otsu_threshold(Volume(data)) < 45
    two = np.zeros((8, 8, 8), np.uint8)
    two[:3] = 200
    assert 50 < otsu_threshold(Volume(two)) < 150
    assert otsu_threshold(Volume(np.full((3, 3, 3), 4.0))) == 4.0
    assert otsu_threshold(Volume(np.zeros((3, 3, 3), bool))) == 0.0


def test_otsu_does_not_mind_units() -> None:
    volume = phantoms.marschner_lobb(24)
    t = otsu_threshold(volume)
    assert otsu_threshold(Volume(volume.data * np.float32(1024))) == pytest.approx(1024 * t, rel=1e-4)


@pytest.mark.parametrize("name", ["marschner-lobb", "sphere", "box", "checker"])
def test_automatic_shows_the_brighter_part(name: str) -> None:
    volume = phantoms.by_name(f"{name}:24")
    low, high = volume.value_range
    chosen = TransferFunction.automatic(volume)
    assert chosen(low)[3] == 0
    assert chosen(high)[3] > 0.3
    rising = chosen(np.linspace(low, high, 200))[:, 3]
    assert (np.diff(rising) >= -1e-12).all()


def test_automatic_of_constant_data_is_fog() -> None:
    fog = TransferFunction.automatic(Volume(np.full((3, 3, 3), -7.0)))
    assert 0 < fog(-7.0)[3] < 1


WRONG: dict[str, tuple[Any, type[ClvolError], str]] = {
    "no points": (lambda: TransferFunction(()), OptionError, "colors must be one or more points"),
    "descending": (lambda: TransferFunction(((1, "red"), (0, "blue"))), OptionError, "ascending order of value; got"),  # type: ignore[arg-type]
    "no pairs": (lambda: TransferFunction((1, 2, 3)), OptionError, "colors must be pairs"),  # type: ignore[arg-type]
    "a colour's name": (lambda: TransferFunction(((0, "rojo"),)), OptionError, "a color must be .*; got 'rojo'"),  # type: ignore[arg-type]
    "opacity": (lambda: SOME.with_opacity([(0, 1.2)]), OptionError, r"opacities must lie in 0..1; got \[1.2\]"),
    "NaN": (lambda: SOME.with_opacity([(float("nan"), 1)]), OptionError, "must be a finite number; got nan"),
    "unit": (lambda: TransferFunction(((0, "red"),), unit_distance=0), OptionError, "unit_distance must be a finite number"),  # type: ignore[arg-type]
    "map": (lambda: TransferFunction.from_cmap("nomap", (0, 1)), OptionError, "colour map 'nomap' is not known"),
    "map's range": (lambda: TransferFunction.from_cmap("gray", (1, 0)), OptionError, "value_range must be"),
}


@pytest.mark.parametrize("case", WRONG)
def test_errors(case: str) -> None:
    make, kind, message = WRONG[case]
    with pytest.raises(kind, match=message):
        make()


@pytest.mark.parametrize(
    "make",
    [
        lambda: TransferFunction(((0, "red"),), unit_distance="a"),
        lambda: TransferFunction(((True, "red"),)),
        lambda: TransferFunction(None),
        lambda: SOME.with_opacity(3),
        lambda: SOME("a"),
        lambda: SOME([1j]),
        *(lambda bad=bad: TransferFunction.from_cmap("gray", bad) for bad in (3, None, (0,), (0, 1, 2), "ab", (0, np.inf))),
        *(lambda bad=bad: TransferFunction.from_cmap("gray", (0, 1), bad) for bad in (None, "a", 2, [1], {}, [(0, "a")])),
        *(lambda bad=bad: TransferFunction.from_cmap(bad, (0, 1)) for bad in ([], {}, None, 3)),
        *(lambda bad=bad: TransferFunction.ramp(bad) for bad in (3, None, (1, 0), "ab")),
    ],
)
def test_wrong_types_are_refused(make: Any) -> None:
    with pytest.raises(OptionError):
        make()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("scale", [1e-320, 1e-300, 1e-40, 1.0, 1e200, 1.7e308])
def test_ranges_of_any_size(scale: float) -> None:
    data = np.linspace(-1, 1, 125).reshape(5, 5, 5) * scale
    assert otsu_threshold(data) == pytest.approx(0, abs=0.1 * scale)
    for chosen in (TransferFunction.automatic(data), TransferFunction.ramp((-scale, scale)), TransferFunction.ramp((0, scale))):
        assert np.isfinite(chosen.value_range).all()
        table = chosen.table(exponent=int(np.frexp(scale)[1]))  # as data of this magnitude are stored
        assert np.isfinite(table).all()
        assert np.isfinite(chosen([0, scale, -scale])).all()
        assert table[0, 0] < table[-1, 0] == chosen(scale)[0]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "values",
    [[0, 0], [7, 7], [-3, 4], [1, np.nextafter(1, 2)], [0, np.nan], [-1, 5, np.nan, np.inf], [0] * 9999 + [1], [0, 5e-324]],
    ids=str,
)
def test_few_values(values: list[float]) -> None:
    data = np.resize(np.array(values), (2, max(2, len(values))))
    finite = data[np.isfinite(data)]
    low, high = finite.min(), finite.max()
    assert low <= otsu_threshold(data) <= high
    for chosen in (TransferFunction.automatic(data), TransferFunction.ramp((low, high))):
        assert np.isfinite(chosen.table()).all()


def test_it_is_chosen_where_the_sparse_sample_holds_no_finite_value() -> None:
    data = np.full((2, 4_000_000), np.nan)
    data[1, 1::2] = [1, 2] * 1_000_000
    assert 1 <= otsu_threshold(data) <= 2
