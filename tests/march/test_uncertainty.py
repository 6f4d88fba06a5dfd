from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import clvol
from clvol import Camera, Renderer, Volume, frequency_response
from clvol.analysis.cardinal import impulse_response
from clvol.analysis.theory import error_kernel
from clvol.base.errors import OptionError
from clvol.device import Device
from clvol.filter.table import as_filter
from clvol.march import uncertainty
from clvol.march.uncertainty import in_words
from clvol.noise import Noise
from tests import cases
from tests.cases import BAD_NUMBERS

SIZE = (60, 50)
LOOK: dict[str, Any] = {
    "camera": Camera.orbit(30, 20, zoom=1.6, fit="volume"),
    "mode": "isosurface",
    "size": SIZE,
    "isovalue": 0.5,
    "sigma": 0.01,
}


def bumps() -> Volume:
    z, y, x = np.meshgrid(*[np.linspace(-1, 1, 24)] * 3, indexing="ij")
    data = 0.5 + 2 * (0.6 - np.sqrt(x * x + y * y + z * z)) + 0.1 * np.sin(9 * x) * np.sin(8 * y + 1) * np.sin(7 * z)
    return Volume(data.astype(np.float32), (2 / 23,) * 3, (-1,) * 3, units="mm")


def shown(volume: Volume, device: Device, filter: str = "bspline3", **options: Any) -> Any:
    return clvol.render(volume, filter=filter, device=device, outputs="uncertainty", **{**LOOK, **options})


# -- outputs -------------------------------------------------------------------------------------------------


def test_it_is_given_where_there_is_a_surface(device: Device) -> None:
    outputs = ("uncertainty", "position", "rgba")
    got: Any = clvol.render(bumps(), filter="bspline3", device=device, outputs=outputs, **LOOK)
    assert list(got) == list(outputs)
    stated = got["uncertainty"]
    assert stated.shape == (50, 60, 2)
    assert stated.dtype == np.float32
    hit = np.isfinite(got["position"][..., 0])
    assert 0.1 < hit.mean() < 0.9
    np.testing.assert_array_equal(np.isfinite(stated), np.broadcast_to(hit[..., None], stated.shape))
    assert (stated[hit] > 0).all()
    np.testing.assert_array_equal(shown(bumps(), device), stated)
    plain = clvol.render(bumps(), filter="bspline3", device=device, **{name: LOOK[name] for name in LOOK if name != "sigma"})
    np.testing.assert_array_equal(got["rgba"], plain)


def test_it_is_nan_where_nothing_is_visible(device: Device) -> None:
    assert np.isnan(shown(bumps(), device, isovalue=100.0)).all()


def test_surfaces_of_both_methods(device: Device) -> None:
    exact, stepped = shown(bumps(), device), shown(bumps(), device, method="stepped", step=0.2)
    both = np.isfinite(exact[..., 0]) & np.isfinite(stepped[..., 0])
    assert both.mean() > 0.1
    np.testing.assert_allclose(stepped[both], exact[both], rtol=0.02)


def test_more_noise_is_more_uncertainty(device: Device) -> None:
    stated = [shown(bumps(), device, sigma=sigma) for sigma in (0.0, 0.01, 0.03)]
    hit = np.isfinite(stated[0][..., 0])
    for less, more in itertools.pairwise(stated):
        assert (np.median(more[hit], 0) > 1.5 * np.median(less[hit], 0)).all()


@pytest.mark.one_in(7)
@pytest.mark.parametrize("filter", ["linear", "bspline3", "bspline3-approx", "bspline3(0.1)", "bspline5", "hybrid", "lanczos3"])
def test_units_of_data_and_world_do_not_matter(device: Device, filter: str) -> None:
    """Values scaled by 1000 or 2¹⁰⁰, plus a constant where the weights sum to one; lengths scaled by 10⁻³, far away."""
    volume = bumps()
    want = shown(volume, device, filter)
    hit = np.isfinite(want[..., 0])
    offset = 101_325.0 if as_filter(filter).sums_to_one else 0.0
    for gain, shift in ((1000.0, 0.0), (2.0**100, 0.0), (1.0, offset)):
        changed = replace(volume, data=volume.data.astype(np.float64) * gain + shift)
        got = shown(changed, device, filter, isovalue=0.5 * gain + shift, sigma=0.01 * gain)
        np.testing.assert_allclose(got[hit], want[hit], rtol=0.01, atol=1e-4)
    small = replace(volume, spacing=tuple(s / 1000 for s in volume.spacing), origin=(5.0, -3.0, 70.0))
    got = shown(small, device, filter)
    np.testing.assert_allclose(got[hit], want[hit] * (1e-3, 1), rtol=0.01, atol=1e-6)


def test_a_hot_voxel_far_away_changes_nothing(device: Device) -> None:
    want, data = shown(bumps(), device), bumps().data.copy()
    data[0, 0, 0] = 1e6
    got = shown(replace(bumps(), data=data), device)
    hit = np.isfinite(want[..., 0])
    np.testing.assert_allclose(got[hit], want[hit], rtol=0.01)


def test_no_result_depends_on_how_launches_are_cut(device: Device) -> None:
    with Renderer(bumps(), "bspline3", device=device) as renderer:
        want = renderer.render(outputs="uncertainty", **LOOK)
        with device.limited(launch_taps=1 << 10):
            got = renderer.render(outputs="uncertainty", **LOOK)
        np.testing.assert_array_equal(got, want)
        np.testing.assert_array_equal(renderer.render(outputs="uncertainty", skipping=False, **LOOK), want)


@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 9, 9), (2, 2, 2), (3, 7, 2)])
@pytest.mark.parametrize("boundary", ["mirror", "zero"])
def test_thin_volumes(device: Device, shape: tuple[int, int, int], boundary: str) -> None:
    data = np.random.default_rng(1).random(shape)
    with Renderer(data, "bspline3", boundary, device=device) as renderer:
        got: Any = renderer.render(outputs=("uncertainty", "position"), **LOOK)
    hit = np.isfinite(got["position"][..., 0])
    assert not np.isnan(got["uncertainty"][hit]).any()


def test_a_surface_without_slope_is_unbounded(device: Device) -> None:
    got = uncertainty.Uncertainty(clvol.Field(np.full((8, 8, 8), 0.5), "bspline3", device=device))(
        np.full((1, 3), 3.2), Noise(0.0, "none")
    )
    assert got.tolist() == [[np.inf, 180.0]]


def test_a_field_serves_many_pictures(device: Device) -> None:
    with clvol.Field(bumps(), "bspline3", device=device) as field, Renderer(field) as renderer:
        pictures = [renderer.render(**{**LOOK, "camera": Camera.orbit(a, fit="volume")}, outputs="uncertainty") for a in (0, 40, 0)]
        np.testing.assert_array_equal(pictures[0], pictures[2])
        renderer.close()
        with pytest.raises(OptionError, match="closed"):
            renderer.render(outputs="uncertainty", **LOOK)


# -- what is rejected -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", [name for name in cases.MODES if name != "isosurface"])
def test_other_modes_have_no_uncertainty(device: Device, mode: str) -> None:
    with Renderer(bumps(), device=device) as renderer, pytest.raises(OptionError, match=f"mode must be isosurface; got '{mode}'"):
        renderer.render(mode=mode, outputs=("rgba", "uncertainty"))


@pytest.mark.parametrize("sigma", [1e25, 1e300])
def test_noise_beyond_all_values_is_unbounded(device: Device, sigma: float) -> None:
    stated = shown(bumps(), device, sigma=sigma)
    hit = ~np.isnan(stated[..., 0])
    assert 0.1 < hit.mean() < 0.9
    assert (stated[hit] >= [1e6, 180]).all()


def test_filters_without_slopes_have_no_uncertainty(device: Device) -> None:
    with pytest.raises(OptionError, match="needs a filter that has slopes; got 'nearest'"):
        shown(bumps(), device, "nearest")


@pytest.mark.parametrize("sigma", [-1.0, *(bad for bad in BAD_NUMBERS if bad is not None)])
def test_sigma_is_a_number(device: Device, sigma: Any) -> None:
    with pytest.raises(OptionError, match="sigma"):
        shown(bumps(), device, sigma=sigma)


# -- in words ------------------------------------------------------------------------------------------------


def test_description() -> None:
    stated = np.full((3, 4, 2), np.nan, np.float32)
    assert in_words(stated) == "no surface"
    stated[1] = [0.03, 2.0]
    said = (
        "half of the surface lies within ± 0.03 mm of the true one, its normals within ± 2°; 95 % of it within ± 0.03 mm and ± 2°"
    )
    assert in_words(stated, "mm") == said
    assert "± 0.03 of" in in_words(stated)


# -- what follows from a filter ------------------------------------------------------------------------------

ROWS = [
    "linear",
    "bspline2",
    "bspline3",
    "bspline5",
    "bspline3-approx",
    "mitchell",
    "omoms3",
    "hybrid",
    "lanczos3",
    "bspline3(0.1)",
]


@pytest.mark.parametrize("name", ROWS)
def test_waves_match_theory(name: str) -> None:
    """The mean squared error over all positions is the error kernel, computed by other code."""
    row, x, omega = as_filter(name), (np.arange(512) + 0.5) / 512, np.linspace(0.05, 3.0, 20)
    value, slope = (uncertainty._wave(row, 0, x, omega, derivative) for derivative in (0, 1))
    got = (np.abs(value - 1) ** 2).mean(1), (np.abs(slope - 1j * omega[:, None]) ** 2).mean(1)
    for derivative in (0, 1):
        np.testing.assert_allclose(got[derivative], error_kernel(row, omega, derivative), rtol=1e-3, atol=1e-12)


@pytest.mark.parametrize("name", [row for row in ROWS if "(" not in row])
def test_noise_becomes_the_sum_of_squares_of_the_impulse_response(name: str) -> None:
    row, k = as_filter(name), np.arange(-40, 41)
    x = (np.arange(uncertainty._PLACES) + 0.5) / uncertainty._PLACES
    errors = uncertainty._errors(row)
    for axis in range(3):
        for derivative, table in ((0, errors.squares), (1, errors.slopes)):
            want = (impulse_response(row, x[:, None] - k, derivative) ** 2).sum(1)
            np.testing.assert_allclose(table[axis], want, rtol=1e-6)


@pytest.mark.parametrize("name", [row for row in ROWS if row != "lanczos3"])  # whose error has many extrema
def test_stencils_match_the_filters_error(name: str) -> None:
    """Within a fourth of the error, except near the Nyquist frequency; constants give nothing."""
    row, omega = as_filter(name), np.linspace(0.06, 0.75, 40) * np.pi
    k = np.arange(-uncertainty._REACH, uncertainty._REACH + 1)
    stencils = uncertainty._errors(row).stencils[0]
    got = np.abs(np.exp(1j * omega[:, None] * k) @ stencils.T)
    kept = np.maximum(uncertainty._wave(row, 0, np.zeros(1), omega)[:, 0].real, uncertainty._KEPT)
    for response, kernel in (
        (np.hypot(got[:, 0], got[:, 1]), error_kernel(row, omega)),
        (np.hypot(got[:, 2], got[:, 3]), error_kernel(row, omega, 1) - (omega * (1 - frequency_response(row, omega))) ** 2),
    ):
        np.testing.assert_allclose(response * kept, np.sqrt(kernel), rtol=0.25)
    np.testing.assert_allclose(stencils.sum(1), 0, atol=1e-12)


def test_smoothing_may_differ_per_axis() -> None:
    errors = uncertainty._errors(as_filter("bspline3(0.1,0,1)"))
    for axis, name in enumerate(("bspline3(0.1)", "bspline3", "bspline3(1)")):
        np.testing.assert_array_equal(errors.squares[axis], uncertainty._errors(as_filter(name)).squares[0])


@pytest.mark.parametrize("name", [name for name, row in clvol.filters().items() if row.has_gradient])
def test_every_filter_has_finite_stencils_of_one_parity(name: str) -> None:
    for central in (False, True):
        errors = uncertainty._errors(as_filter(name), central)
        assert np.isfinite(errors.stencils).all()
        assert errors.defines["REACH"] <= uncertainty._REACH
        sign = -1 if errors.defines["VALUE_IS_ODD"] else 1
        for kind, other in enumerate((1, sign, 1, -1)):
            np.testing.assert_allclose(errors.stencils[:, kind], other * errors.stencils[:, kind, ::-1], atol=1e-12)
        assert (errors.noise >= 0).all()


def test_the_noise_in_the_detail_estimate_is_subtracted(device: Device) -> None:
    """Averaged over a volume of noise, the estimated detail equals the subtraction."""
    rng = np.random.default_rng(3)
    volume = Volume(rng.standard_normal((40, 40, 40)).astype(np.float32))
    with clvol.Field(volume, "bspline3-approx", "reflect", device=device) as field:
        stated = uncertainty.Uncertainty(field)
        points = rng.uniform(8, 31, (20_000, 3))
        none, all_of_it = (stated(points, Noise(sigma, "white"))[:, 0] for sigma in (0.0, 1.0))
    slope = np.linalg.norm(clvol.sample(volume, points, "bspline3-approx", "reflect", 1), axis=1)
    found = ((none * slope / 1.96) ** 2).mean()
    assert found == pytest.approx(uncertainty._errors(as_filter("bspline3-approx")).noise[0], rel=0.1)
    assert np.isfinite(all_of_it).all()
