"""Samples of any magnitude that float64 holds: values, derivatives, surfaces, and skipping, against SciPy in float64.

A power of two times the samples must change nothing but the scale: truths are those of samples about 1.
"""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray
from scipy import ndimage

import clvol
from clvol import reference
from clvol.base.errors import DataError
from clvol.device import Device
from clvol.filter.make import bspline

Array = NDArray[np.float64]
SHAPE = (13, 14, 15)
LARGE = (1e35, 4.99e36, 1e38, 1e100, 1e300)
SMALL = (1e-30, 1e-40, 1e-45, 1e-50, 1e-100, 1e-290)


def some(seed: int = 0) -> Array:
    return np.random.default_rng(seed).uniform(-1, 1, SHAPE)


def blobs() -> Array:
    """Matter in the centre, nothing around it."""
    z, y, x = np.meshgrid(*(np.linspace(-1, 1, n) for n in SHAPE), indexing="ij")
    return np.where(x**2 + y**2 + z**2 < 0.5, np.exp(-3 * (x**2 + 2 * y**2 + z**2)), 0)


def inside(count: int = 300) -> Array:
    return np.random.default_rng(1).uniform(0, np.array(SHAPE[::-1]) - 1, (count, 3))


@pytest.mark.parametrize("scale", LARGE + SMALL, ids=str)
@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
def test_values_of_every_degree(device: Device, order: int, scale: float) -> None:
    data, at = some() * scale, inside()
    name = "linear" if order == 1 else f"bspline{order}"
    expected = ndimage.map_coordinates(data / scale, at[:, ::-1].T, np.float64, order, "mirror")
    got = clvol.sample(data, at, name, device=device)
    assert got.dtype == np.float64
    assert_allclose(got / scale, expected, rtol=0, atol=4e-6)


@pytest.mark.one_in(75)
@pytest.mark.parametrize(("name", "scale"), [*product(clvol.filters(), [4.99e36, 3e38, 1e-42])])
def test_every_filter_gives_finite_numbers(device: Device, name: str, scale: float) -> None:
    """For samples up to the limits of float32; two boundary rules each, all of them in turn."""
    data, at = (some() * scale).astype(np.float32), inside(50)
    turn = list(clvol.filters()).index(name) % 4
    for boundary in list(clvol.boundaries())[turn::4]:
        with clvol.Field(data, name, boundary, device) as field:
            expected = reference.sample(data.astype(np.float64) / scale, at, name, boundary)
            assert_allclose(field(at) / scale, expected, rtol=0, atol=4e-6)
            assert np.isfinite(field.gradient(at)).all()
            assert np.isfinite(field.hessian(at)).all()


@pytest.mark.parametrize("scale", [1e20, 1e26, 1e36], ids=str)
def test_a_prefilter_of_high_gain(device: Device, scale: float) -> None:
    """The B-spline of degree 9 multiplies by 9! before it filters, along each axis."""
    got = clvol.sample(some() * scale, inside(), bspline(9), device=device)
    assert_allclose(got / scale, reference.sample(some(), inside(), bspline(9)), rtol=0, atol=3e-4)


@pytest.mark.parametrize("exponent", [-900, -149, -100, -91, 85, 91, 110, 127, 1000])
def test_a_power_of_two_changes_no_digit(device: Device, exponent: int) -> None:
    at = inside()
    with clvol.Field(some(), device=device) as plain, clvol.Field(np.ldexp(some(), exponent), device=device) as scaled:
        assert_array_equal(np.ldexp(scaled(at), -exponent), plain(at))
        assert_array_equal(np.ldexp(scaled.gradient(at), -exponent), plain.gradient(at))
        assert_array_equal(np.ldexp(scaled.hessian(at), -exponent), plain.hessian(at))
        assert_array_equal(np.ldexp(scaled.magnify(2).data, -exponent), plain.magnify(2).data)
        assert_array_equal(scaled([[-9.0, 0, 0]], fill=0.125), [0.125])
        assert_array_equal(scaled.gradient([[-9.0, 0, 0]], fill=0.125), [[0.125] * 3])
    coefficients = clvol.prefilter(some(), "bspline5", device=device)
    assert_array_equal(np.ldexp(clvol.prefilter(np.ldexp(some(), exponent), "bspline5", device=device), -exponent), coefficients)
    line = clvol.prefilter(some()[0, 0], "bspline5", device=device)
    assert_array_equal(np.ldexp(clvol.prefilter(np.ldexp(some()[0, 0], exponent), "bspline5", device=device), -exponent), line)
    picture = clvol.images.rotate(some()[0], 30, device=device).astype(np.float32)
    assert_array_equal(np.ldexp(clvol.images.rotate(np.ldexp(some()[0], exponent), 30, device=device), -exponent), picture)


@pytest.mark.parametrize("exponent", [-1000, 950, 1022])
def test_a_power_of_two_changes_no_digit_in_double_precision(device: Device, exponent: int) -> None:
    """Up to the limits of float64, where the gain of a prefilter overflows."""
    if not device.has_double:
        pytest.skip("the device has no float64")
    at, options = inside(50), {"device": device, "precision": "double"}
    for name in ("bspline3", "hybrid"):
        with clvol.Field(some(), name, **options) as plain, clvol.Field(np.ldexp(some(), exponent), name, **options) as scaled:
            assert_array_equal(np.ldexp(scaled(at), -exponent), plain(at))
            assert_array_equal(np.ldexp(scaled.gradient(at), -exponent), plain.gradient(at))
            assert_array_equal(scaled([[-9.0, 0, 0]], fill=0.125), [0.125])
    coefficients = clvol.prefilter(some(), "bspline3", **options)  # up to 27 times the samples
    less = exponent - 5
    assert_array_equal(np.ldexp(clvol.prefilter(np.ldexp(some(), less), "bspline3", **options), -less), coefficients)


def test_a_large_constant_outside_in_double_precision(device: Device) -> None:
    """1e200 around samples of 1e200: SciPy's spline of the scaled samples."""
    if not device.has_double:
        pytest.skip("the device has no float64")
    at = np.random.default_rng(2).uniform(-3, 16, (100, 3))
    options: dict[str, Any] = {"device": device, "precision": "double"}
    got = clvol.sample(some() * 1e200, at, "linear", "grid-constant(1e200)", **options)
    expected = ndimage.map_coordinates(some(), at[:, ::-1].T, np.float64, 1, "grid-constant", 1.0)
    assert_allclose(got / 1e200, expected, rtol=0, atol=1e-14)


def test_small_differences_far_from_zero(device: Device) -> None:
    """An offset and a power of two: float64 cannot resolve 1 ± 1e-20, but 1e30 ± 1e20."""
    data, at = 1e30 + some() * 1e20, inside()
    got = clvol.sample(data, at, device=device) - 1e30
    expected = ndimage.map_coordinates(data - 1e30, at[:, ::-1].T, np.float64, 3, "mirror")
    assert_allclose(got / 1e20, expected / 1e20, rtol=0, atol=1e-5)  # float64 has 1.4e14 there


def test_one_large_sample_beside_small_ones(device: Device) -> None:
    data = np.full(SHAPE, 1e-40)
    data[2, 3, 4] = 1e30
    got = clvol.sample(data, [[4.0, 3, 2], [12, 12, 10]], "linear", device=device)
    assert_allclose(got[0], 1e30, rtol=1e-6)
    assert abs(got[1]) <= 1e-30


def test_beyond_float64_is_rejected() -> None:
    if np.finfo(np.longdouble).maxexp == np.finfo(np.float64).maxexp:
        pytest.skip("longdouble is float64 here")
    with pytest.raises(DataError, match="float64"):
        clvol.Volume(np.array([[1, np.longdouble("1e4000")]])).require_finite()


# -- pictures --------------------------------------------------------------------------------------------------------

OUTPUTS = ("rgba", "depth", "normal", "position", "visited")
VIEW: dict[str, Any] = {"size": (37, 35), "rays": 1, "camera": clvol.Camera.orbit(30, 20, fit="volume"), "outputs": OUTPUTS}


def looks(scale: float) -> dict[str, dict[str, Any]]:
    fog = clvol.TransferFunction(((0.0, "black"), (scale, "white")), ((0.1 * scale, 0.0), (0.5 * scale, 0.2), (scale, 0.9)))
    ramp = clvol.TransferFunction.ramp((0.0, scale))
    return {
        "isosurface": {"isovalue": 0.3 * scale},
        "composite": {"transfer": fog},
        **{mode: {"transfer": ramp} for mode in ("mip", "minip", "mean", "attenuated")},
    }


@pytest.mark.parametrize("exponent", [-1000, -149, -133, 66, 119, 124, 1000])
def test_pictures_match_those_of_data_about_one(device: Device, exponent: int) -> None:
    scale = 2.0**exponent
    with clvol.Renderer(blobs(), device=device) as plain, clvol.Renderer(blobs() * scale, device=device) as scaled:
        for (mode, look), other in zip(looks(1.0).items(), looks(scale).values(), strict=True):
            one, two = plain.render(mode=mode, **look, **VIEW), scaled.render(mode=mode, **other, **VIEW)
            for name in OUTPUTS:
                assert_array_equal(two[name], one[name], err_msg=f"{mode} {name}")


@pytest.mark.one_in(6)
@pytest.mark.parametrize("mode", ["composite", "isosurface", "mip", "minip", "mean", "attenuated"])
def test_default_looks_up_to_the_limits_of_float64(device: Device, mode: str) -> None:
    """Samples of ±1.7e308, whose range overflows float64: the pictures are those of ±0.95."""
    z, y, x = np.mgrid[:9, :9, :9] / 8
    data = 0.95 * np.cos(3 * (x + 2 * y + z))
    data[4, 4, 4], data[0, 0, 0] = 0.95, -0.95
    views: dict[str, Any] = {"mode": mode, "filter": "linear", "size": (17, 17), "device": device}
    np.testing.assert_array_equal(clvol.render(np.ldexp(data, 1024), **views), clvol.render(data, **views))
    with np.errstate(over="raise"):
        look = clvol.TransferFunction.from_cmap("viridis", (-1.7e308, 1.7e308))
    assert look.value_range == (-1.7e308, 1.7e308)


@pytest.mark.one_in(80)
@pytest.mark.parametrize(
    ("filter", "scale", "kind"),
    [
        *product(
            ["bspline3", "linear", "bspline5", "lanczos3", "hybrid"],
            [1e36, 4.99e36, 1e-38, 1e-40, 1e-44],
            ["blobs", "noise", "constant"],
        )
    ],
)
def test_skipping_changes_no_picture(device: Device, filter: str, scale: float, kind: str) -> None:
    base = {"blobs": blobs(), "noise": some(), "constant": np.full(SHAPE, 0.7)}[kind]
    data = (base * scale).astype(np.float32)
    value = float(data.max())  # the constant itself, too
    with clvol.Renderer(data, filter, device=device) as renderer:
        for mode, look in (looks(scale) | {"mip": {}, "minip": {}}).items():
            for options in [look] if mode != "isosurface" else [look, {"isovalue": value}, {"isovalue": 0.0}]:
                on, off = (renderer.render(mode=mode, skipping=skipping, **options, **VIEW) for skipping in (True, False))
                for name in OUTPUTS[:-1]:
                    assert_array_equal(on[name], off[name], err_msg=f"{mode} {name}")


def test_skipping_among_subnormal_samples_beside_large_ones(device: Device) -> None:
    data = np.full(SHAPE, 1e-40, np.float32)
    data[:3] = 1.0
    data[6:9] = 3e-41
    with clvol.Renderer(data, "linear", device=device) as renderer:
        for isovalue in (1e-40, float(np.float32(1e-40)), 5e-41, 3e-41, 0.0, 0.5):
            on, off = (renderer.render(mode="isosurface", skipping=s, isovalue=isovalue, **VIEW) for s in (True, False))
            for name in OUTPUTS[:-1]:
                assert_array_equal(on[name], off[name], err_msg=f"{isovalue} {name}")
        faint = clvol.TransferFunction(((0.0, "white"),), ((0.0, 0.0), (1e-40, 0.0), (1.1e-40, 0.5)))
        on, off = (renderer.render(mode="composite", skipping=s, transfer=faint, **VIEW) for s in (True, False))
        assert_array_equal(on["rgba"], off["rgba"])


def test_transfer_functions_wider_than_the_data(device: Device) -> None:
    """Data about 1e-45 with a transfer function from -1 to 1: all have the colour of zero; and vice versa."""
    wide = clvol.TransferFunction(((-1.0, (0.0, 0, 0)), (1.0, (1.0, 1, 1))), ((-1.0, 1.0),))
    with clvol.Renderer(blobs() * 1e-45, device=device) as renderer:
        drawn = renderer.render(mode="mip", transfer=wide, size=(17, 17))
        assert_allclose(drawn[8, 8], [0.5, 0.5, 0.5, 1], atol=1e-6)
    with clvol.Renderer(blobs(), device=device) as renderer:
        wider = clvol.TransferFunction(((-1e300, (0.0, 0, 0)), (1e300, (1.0, 1, 1))), ((-1e300, 1.0),))
        assert_allclose(renderer.render(mode="mip", transfer=wider, size=(17, 17))[8, 8], [0.5, 0.5, 0.5, 1], atol=1e-6)
        for isovalue in (1e300, -1e300):
            assert not renderer.render(mode="isosurface", isovalue=isovalue, background=None, size=(17, 17)).any()
