"""How far pictures by the kernels may be from the reference's, and what is drawn to compare them.

Without pytest, for `bench.parity` too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.device import Device
from clvol.filter.table import as_filter
from clvol.march.renderer import OUTPUTS, Renderer
from clvol.reference.march import march as reference
from clvol.scene.camera import Camera
from clvol.scene.light import HEADLIGHT
from clvol.scene.transfer import TransferFunction
from clvol.volume.volume import Volume
from tests.march.looks import suited

SIZE = (24, 20)
STEP = 0.37  # no plane of these volumes then lies where a filter jumps or kinks, nor where a box is cut
CAMERA = Camera.orbit(33, 21, fit="volume")
# points on equal nodes; the default look has others
TRANSFER = TransferFunction(
    ((0.0, (0.1, 0.2, 0.9)), (0.25, (0.9, 0.1, 0.2)), (0.5, (0.2, 0.8, 0.3)), (1.0, (1.0, 1.0, 0.9))),
    ((0.25, 0.0), (0.5, 0.3), (1.0, 0.7)),
)
OPTIONS: dict[str, Any] = {
    "transfer": TRANSFER,
    "background": None,
    "outputs": OUTPUTS[:-1],
    "isovalue": 0.5,
    "surfaces": [(0.35, "orange", 0.3), (0.6, "teal", 0.6), (0.85, "white", 0.9)],
    "termination": 0.0,
    "rays": 1,
    "lights": HEADLIGHT,  # continuous where normals turn over; others are tested below
}


@dataclass(frozen=True)
class Allowance:
    """What may differ: greatest and RMS difference of the picture; greatest of the others, in world units.

    Colours of nearly transparent pixels are divided by their opacity here, which magnifies rounding. To depths and
    positions 4e-7 of the distance from the eye is added: what float32 holds of it.

    `pixels` is the share of pixels left out: a ray that grazes a surface or touches an edge may go either way, and where
    the gradient is nearly nothing so may the normal.
    """

    rgba: float = 1e-4
    rms: float = 5e-6
    depth: float = 4e-5
    position: float = 3e-5
    normal: float = 5e-4
    pixels: float = 0.0


# A texture unit of a GPU blends with 8 bits (facts.md: values err by 0.11 % of the range, gradients by 4.3°).
COARSE = Allowance(rgba=0.1, rms=0.01, depth=0.2, position=0.2, normal=0.3, pixels=0.05)


@lru_cache
def block(*, oblique: bool = False, origin: tuple[float, float, float] = (5, -3, 2)) -> Volume:
    """Smooth noise over 0..1, with unequal spacings and, on request, sheared axes."""
    noise = Volume(np.random.default_rng(3).random((9, 7, 11))).gaussian(0.8).data
    data = ((noise - noise.min()) / np.ptp(noise)).astype(np.float32)
    direction = np.array([[0.8, -0.6, 0.1], [0.6, 0.8, 0.2], [0.0, 0.0, 1.0]])
    sheared = direction / np.linalg.norm(direction, axis=0)
    return Volume(data, (1.0, 0.8, 1.3), origin, *([sheared] if oblique else []))


def both(
    renderer: Renderer,
    camera: Camera,
    mode: str,
    size: tuple[int, int] = SIZE,
    step: float = STEP,
    ways: dict[str, Any] | None = None,
    **options: Any,
) -> tuple[dict[str, NDArray[Any]], dict[str, NDArray[Any]]]:
    """Pictures by the kernels and by the reference; `ways` are limits of the device."""
    options = suited(mode, {**OPTIONS, **options})
    with renderer.device.limited(**(ways or {})):
        got = renderer.render(camera, mode, size, step, **options)
    want = reference.render(renderer.volume, camera, mode, renderer.filter, renderer.field.boundary, size, step, **options)
    assert isinstance(got, dict)
    assert isinstance(want, dict)
    return got, want


def compare(got: dict[str, NDArray[Any]], want: dict[str, NDArray[Any]], allowed: Allowance) -> None:
    """Assert that two sets of pictures agree, and are not empty."""
    budget = allowed.pixels * want["depth"].size
    flipped = np.isfinite(got["depth"]) != np.isfinite(want["depth"])
    assert flipped.sum() <= budget, f"{flipped.sum()} pixels are in one picture only"
    difference = np.abs(got["rgba"] - want["rgba"]).max(-1)
    outside = difference > allowed.rgba
    rms = float(np.sqrt((difference[~flipped & ~outside] ** 2).mean()))
    worst = np.unravel_index(int(np.argmax(difference)), difference.shape)
    assert outside.sum() <= budget, f"rgba differs by {difference.max():.2g} at {worst}, rms {rms:.2g}"
    assert rms <= allowed.rms, f"rgba differs by {rms:.2g} rms, at most {difference.max():.2g}"
    assert want["rgba"][..., 3].max() > 0
    both = np.isfinite(got["depth"]) & np.isfinite(want["depth"])
    lengths = np.linalg.norm(got["normal"], axis=-1)
    np.testing.assert_allclose(lengths[np.isfinite(lengths)], 1, atol=1e-5)
    far = 4e-7 * float(np.abs(want["depth"][both]).max(initial=0))
    for name in ("depth", "position", "normal"):
        a, b = (picture[name].reshape(*both.shape, -1)[both] for picture in (got, want))
        unknown = np.isnan(a) != np.isnan(b)
        assert unknown.any(-1).sum() <= budget, f"{name} is in one picture only at {unknown.any(-1).sum()} pixels"
        off = np.nan_to_num(np.abs(a - b)).max(-1, initial=0)
        most = getattr(allowed, name) + (0 if name == "normal" else far)
        assert (off > most).sum() <= budget, f"{name} differs by {off.max():.2g}"


def allowance(filter: str, mode: str, device: Device, ways: Mapping[str, Any] | None = None) -> Allowance:
    """By properties of the filter, not its name."""
    row = as_filter(filter)
    ways = ways or {}
    if ways.get("evaluator") in ("eight-fetch", "paired") and ways.get("fetch") == "image" and device.sampler_bits < 16:
        return COARSE
    base = Allowance()
    if mode == "composite":
        base = replace(base, depth=2e-4, position=2e-4)  # depth errs by the light's rounding over how fast it falls
    if mode in ("isosurface", "surfaces"):
        # depth errs by rounding over the slope along the ray, so grazing rays err most
        base = replace(base, rgba=2e-4, rms=2e-5, depth=2e-4, position=2e-4, normal=1e-3, pixels=0.0025)
    if mode in ("isosurface", "surfaces") and row.continuity == 0:
        base = replace(base, pixels=0.005)  # the normal jumps where the surface passes a cell's face
    if mode == "attenuated":
        base = replace(base, pixels=0.0025)  # one pixel: a normal that lies across the ray, by chance, may face either way
    return base
