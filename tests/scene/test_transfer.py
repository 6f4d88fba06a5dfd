"""Transfer functions: the exact function, its table, and the automatic one from a histogram."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import clvol
from clvol import phantoms
from clvol.base.errors import ClvolError, OptionError
from clvol.base.srgb import as_light, as_shown
from clvol.scene.factor import factors_block
from clvol.scene.joint import TransferFunction2D
from clvol.scene.transfer import TransferFunction
from clvol.volume.histogram import isovalue_of
from clvol.volume.stored import AS_THEY_ARE, Stored
from clvol.volume.volume import Volume

SOME = TransferFunction(((-1.0, "red"), (0.0, (0, 1, 0)), (3.0, "#0000ff")), ((-0.5, 0.0), (1.0, 0.8), (2.0, 0.1)))


def test_linear_between_points() -> None:
    np.testing.assert_allclose(SOME([-1, 0, 3])[:, :3], np.eye(3))
    np.testing.assert_allclose(SOME([-0.5, 1, 2])[:, 3], [0, 0.8, 0.1])
    np.testing.assert_allclose(SOME(1.5), [0, 0.5, 0.5, 0.45])
    np.testing.assert_allclose(SOME([[-9, 9]]), [[[1, 0, 0, 0], [0, 0, 1, 0.1]]])  # constant beyond the ends
    assert SOME.value_range == (-1.0, 3.0)


ODD = TransferFunction(
    ((0.0, "black"), (0.30003, "red"), (0.30003, "blue"), (1.0, "white")), ((0.30003, 0.0), (0.70001, 0.999), (0.8, 1.0))
)
DAMAGED = {"pixels": "eJw=", "shape": [4, 4], "values": [0, 1], "steepest": 1}
MANY = TransferFunction.from_cmap("viridis", (0, 1), [(0.30003, 0.0), (0.5, 0.3), (0.70001, 0.0)])

NARROW = TransferFunction([(0, "black"), (0.4996, "black"), (0.5001, "white"), (1, "red")], [(0, 0), (1, 1)])


def looked_up(
    transfer: TransferFunction, values: NDArray[np.float32], stored: Stored = AS_THEY_ARE, *, linear: bool = False
) -> NDArray[np.float64]:
    """Colours and opacities of stored values, from the table that kernels read."""
    block, table = transfer.block(1.0, stored, linear=linear), transfer.table(stored, linear=linear)
    assert table.dtype == np.float32
    table = table.astype(np.float64)
    if not block["pieces"]:
        nodes = table[: 4 * (int(block["last"]) + 1)].reshape(-1, 4)
        place = (values.astype(np.float64) - block["low"]) * block["scale"]
        return np.stack([np.interp(place, np.arange(len(nodes)), column) for column in nodes.T], -1)
    pieces = table[: 12 * int(block["pieces"])].reshape(-1, 3, 4)
    number = np.searchsorted(pieces[1:, 2, 0], values, side="right")
    if block["halvings"]:
        first = table[12 * len(pieces) :].reshape(1024, -1)[:, 0].astype(int)
        bucket = np.clip((values - block["low"]) * block["scale"], 0, block["last"]).astype(int)
        assert ((first[bucket] <= number) & (number < first[bucket] + (1 << int(block["halvings"])))).all()
    return np.asarray(pieces[number, 0] + (values - pieces[number, 2, 0])[:, None] * pieces[number, 1])


@pytest.mark.parametrize("points", [5, 7, 40])
def test_infinite_values_lie_in_the_last_piece(points: int) -> None:
    """Bounds may be infinite, and so may finished rays' values: the search must stay within the table."""
    at = np.sqrt(np.arange(1.0, points + 1))
    chosen = TransferFunction(tuple((x, "red") for x in at), ((at[0], 0.2), (at[-1], 0.9)))
    table, pieces = chosen.table(), int(chosen.block(1.0)["pieces"])
    assert pieces == points + 1
    rest = table[12 * pieces :]
    if chosen.block(1.0)["halvings"]:
        rows = rest.reshape(1024, 4)
        assert (rows[:, 0] + (np.inf >= rows[:, 2]) < pieces).all()
    else:
        assert (np.inf >= rest).sum() == pieces - 1


@pytest.mark.parametrize(("transfer", "pieces"), [(SOME, 0), (ODD, 6), (MANY, 68)], ids=["equal nodes", "few", "many"])
@pytest.mark.parametrize(("offset", "exponent"), [(0.0, 0), (0.5, 0), (-0.75, -3), (0.125, 140)])
def test_the_table_represents_the_function(transfer: TransferFunction, pieces: int, offset: float, exponent: int) -> None:
    low, high = transfer.value_range
    values = np.concatenate([np.random.default_rng(0).uniform(low - 0.2, high + 0.2, 5000), [p[0] for p in transfer.colors]])
    way = Stored(offset, exponent)
    stored = np.ldexp(values - offset, -exponent).astype(np.float32)
    back = np.ldexp(stored.astype(np.float64), exponent) + offset
    if exponent < 100:  # else they are near the limits of float32
        assert transfer.block(1.0, way)["pieces"] == pieces
        np.testing.assert_allclose(looked_up(transfer, stored, way), transfer(back), rtol=0, atol=3e-6)
    assert np.isfinite(looked_up(transfer, stored, way)).all()


@pytest.mark.parametrize("transfer", [SOME, ODD, MANY, NARROW], ids=["equal nodes", "few", "many", "narrow"])
def test_tables_of_light_are_within_a_thousandth(transfer: TransferFunction) -> None:
    values = np.linspace(-0.1, 1.1, 4001).astype(np.float32)
    want, got = transfer(values), looked_up(transfer, values, linear=True)
    np.testing.assert_allclose(got[:, :3], as_light(want[:, :3]), rtol=0, atol=1e-3)
    np.testing.assert_allclose(as_shown(got[:, :3]), want[:, :3], rtol=0, atol=0.5 / 255)
    np.testing.assert_allclose(got[:, 3], want[:, 3], rtol=0, atol=3e-6)


def test_equal_nodes_represent_points_on_them() -> None:
    for stops in (2, 3, 5, 64, 257, 1025):
        at = np.linspace(-3, 7, stops)
        block = TransferFunction(tuple((float(x), (1.0, 1.0, 1.0)) for x in at), ((-3.0, 1.0),)).block(1.0)
        assert block["pieces"] == 0
        assert block["last"] % (stops - 1) == 0


def test_nearly_opaque_matter_is_stored_as_transmittance() -> None:
    fog = TransferFunction(((0.0, "white"),), ((0.0, 1 - 1e-7), (1.0, 1 - 1e-6)))
    assert fog.block(1.0)["pieces"] == 3
    pieces = fog.table()[:36].reshape(-1, 3, 4)
    np.testing.assert_allclose(pieces[:, 2, 1], [1e-7, 1e-7, 1e-6], rtol=1e-6)


def test_a_single_point_is_a_constant() -> None:
    fog = TransferFunction(((5.0, "white"),), ((5.0, 0.3),))
    np.testing.assert_allclose(fog([-100, 5, 100]), [[1, 1, 1, 0.3]] * 3)
    np.testing.assert_allclose(looked_up(fog, np.float32([-100, 5, 100])), [[1, 1, 1, 0.3]] * 3, rtol=1e-6)


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


@pytest.mark.parametrize("name", ["marschner-lobb", "sphere", "box", "checker"])
def test_automatic_shows_the_brighter_part(name: str) -> None:
    volume = phantoms.by_name(f"{name}:24")
    low, high = volume.value_range
    chosen = TransferFunction.automatic(volume)
    assert chosen(low)[3] == 0
    assert chosen(high)[3] > (0.3 if name in ("box", "checker") else 0.1)  # computed ones are half transparent
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
    "opacity": (lambda: SOME.with_opacity([(0, 1.2)]), OptionError, r"opacities must be in 0..1; got \[1.2\]"),
    "NaN": (lambda: SOME.with_opacity([(float("nan"), 1)]), OptionError, "must be a finite number; got nan"),
    "unit": (lambda: TransferFunction(((0, "red"),), unit_distance=0), OptionError, "unit_distance must be a finite number"),  # type: ignore[arg-type]
    "shapes of a map": (lambda: TransferFunction2D.from_cmap("gray", (0, 1)), OptionError, "made of boxes, arches or an image"),
    "narrow box": (lambda: TransferFunction2D([((0, 1), (1, 1), "red", 1)]), OptionError, "gradients of a box must be"),
    "low arch": (
        lambda: TransferFunction2D([((0, 1), (0, 1e308), "red", 1)], [((0, 1), 1e-300, "red", 1)]),
        OptionError,
        "an arch is too",
    ),
    "unknown image": (lambda: TransferFunction2D(image=(np.full((2, 2, 4), np.nan), (0, 1), 1)), OptionError, "NaN for 16 of 16"),  # type: ignore[arg-type]
    "damaged image": (lambda: TransferFunction2D(image=DAMAGED), OptionError, "one that clvol wrote"),  # type: ignore[arg-type]
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
def test_wrong_types_are_rejected(make: Any) -> None:
    with pytest.raises(OptionError):
        make()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("scale", [1e-320, 1e-300, 1e-40, 1.0, 1e200, 1.7e308])
def test_ranges_of_any_size(scale: float) -> None:
    data = np.linspace(-1, 1, 125).reshape(5, 5, 5) * scale
    assert isovalue_of(data)[0] == pytest.approx(0, abs=0.1 * scale)
    for chosen in (TransferFunction.automatic(data), TransferFunction.ramp((-scale, scale)), TransferFunction.ramp((0, scale))):
        assert np.isfinite(chosen.value_range).all()
        for linear in (False, True):
            table = chosen.table(linear=linear)
            assert np.isfinite(table[: 12 * int(chosen.block(1.0, linear=linear)["pieces"]) or None]).all()
        assert np.isfinite(chosen([0, scale, -scale])).all()
        if 1e-37 < scale < 1e37:  # else float32 cannot represent these numbers or slopes
            red = looked_up(chosen, np.array(chosen.value_range, np.float32))[:, 0]
            assert red[0] < red[1] == pytest.approx(chosen(scale)[0])


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
    assert low <= isovalue_of(data)[0] <= high
    for chosen in (TransferFunction.automatic(data), TransferFunction.ramp((low, high))):
        assert np.isfinite(chosen.table()[: 12 * int(chosen.block(1.0)["pieces"]) or None]).all()


def test_automatic_when_the_subsample_has_no_finite_value() -> None:
    data = np.full((2, 4_000_000), np.nan)
    data[1, 1::2] = [1, 2] * 1_000_000
    assert 1 <= isovalue_of(data)[0] <= 2


def test_factors_of_tiny_samples() -> None:
    """What kernels get depends on no unit of the data, even where that of a gradient is out of range."""
    plain, tiny = (((1e-3, 0.2), (1.5, 1.0)), 1e5, 0), (((math.ldexp(1e-3, -1000), 0.2), (math.ldexp(1.5, -1000), 1.0)), 1e5, -1000)
    assert factors_block((plain, (None, 1.0, 0))).tobytes() == factors_block((tiny, (None, 1.0, 0))).tobytes()


@pytest.mark.parametrize("kind", [TransferFunction, TransferFunction2D])
def test_automatic_functions_of_a_file_that_is_read_by_parts(kind: type[TransferFunction], tmp_path: Path) -> None:
    volume = phantoms.sphere(8)
    clvol.write(volume, tmp_path / "sphere.nrrd")
    assert kind.automatic(clvol.open(tmp_path / "sphere.nrrd")) == kind.automatic(volume)
