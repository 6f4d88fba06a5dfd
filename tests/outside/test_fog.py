"""Homogeneous fog compared with its closed form: opacity 1 - (1 - a)^(L/u) over a length L, and the depth of half of the light."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import clvol
from clvol.device import Device, Tile

TILES = {"planes": Tile(16, 16, 8, shared=True), "rays": Tile(1, 1, 1, shared=False)}
ALONG = clvol.Camera(direction=(0, 1, 0), up=(0, 0, 1), projection="orthographic", zoom=0.9, fit="volume")


def fog(opacity: float, unit: float) -> clvol.TransferFunction:
    return clvol.TransferFunction(((0.0, "white"),), ((0.0, opacity),), unit)


def opacity_of(opacity: float, lengths: Any) -> Any:
    return -np.expm1(np.log1p(-opacity) * np.asarray(lengths, np.float64))


def draw(device: Device, length: int, transfer: clvol.TransferFunction, **options: Any) -> Any:
    data = np.zeros((2, length, 2), np.float32)
    look: dict[str, Any] = {
        "size": (9, 9),
        "rays": 1,
        "background": None,
        "outputs": ("rgba", "depth", "position"),
        "termination": 0.0,
    }
    return clvol.render(data, ALONG, "composite", filter="linear", device=device, transfer=transfer, **{**look, **options})


@pytest.mark.one_in(18)
@pytest.mark.parametrize("tile", TILES)
@pytest.mark.parametrize("unit", [1.0, 40.0])
@pytest.mark.parametrize(
    "opacity",
    [1e-12, 1e-9, 1e-8, 3e-8, 1e-7, 1e-6, 3e-5, 1e-3, 0.013, 0.03, 0.05, 0.3, 0.9, 0.995, 1 - 1e-4, 1 - 1e-6, 1 - 1e-8, 1 - 1e-12],
)
def test_opacity(device: Device, opacity: float, unit: float, tile: str) -> None:
    with device.limited(tile=TILES[tile]):
        for step in (0.5, 0.013, 3.0):
            drawn = draw(device, 17, fog(opacity, unit), step=step, shading=False)["rgba"][..., 3].astype(np.float64)
            seen = drawn > 0
            assert seen[4, 4]
            np.testing.assert_allclose(drawn[seen], opacity_of(opacity, 17 / unit), rtol=1e-5)


@pytest.mark.parametrize("opacity", [1 - 1e-6, 1 - 1e-8, 1 - 1e-12, 1.0])
def test_thin_slabs_of_nearly_opaque_matter(device: Device, opacity: float) -> None:
    """0.1 thick, cut by a clip box: float32 rounds 1 - 1e-8 to 1, which was rendered as opaque."""
    box = ((-1, 3.0, -1), (3, 3.1, 3))
    drawn = draw(device, 17, fog(opacity, 1.0), clip=box, shading=False)["rgba"][4, 4, 3]
    np.testing.assert_allclose(drawn, opacity_of(opacity, 0.1) if opacity < 1 else 1.0, rtol=1e-5)


@pytest.mark.parametrize("opacity", [1e-12, 1e-8, 2.3e-8, 1e-6, 1e-4, 1e-3])
def test_light_through_thousands_of_thin_samples(device: Device, opacity: float) -> None:
    length = 3000
    for step in (0.37, 1.0):
        drawn = draw(device, length, fog(opacity, 1.0), step=step, shading=False)["rgba"][4, 4].astype(np.float64)
        np.testing.assert_allclose(drawn[3], opacity_of(opacity, length), rtol=1e-5)
        np.testing.assert_allclose(drawn[:3], 1, rtol=2e-4)  # colours are summed without Kahan's correction


@pytest.mark.parametrize("opacity", [0.05, 0.2, 0.7, 0.99, 1 - 1e-6])
def test_the_depth_is_where_half_of_the_light_is_absorbed(device: Device, opacity: float) -> None:
    """At u ln(1/2) / ln(1 - a) behind the fog's face, whatever the step."""
    past = np.log(0.5) / np.log1p(-opacity)
    for step in (0.1, 0.5, 1.3, 4.0):
        made = draw(device, 40, fog(opacity, 1.0), step=step, shading=False)
        hit = np.isfinite(made["depth"])
        assert hit[4, 4]
        np.testing.assert_allclose(made["position"][hit][:, 1], -0.5 + past, atol=3e-5)
