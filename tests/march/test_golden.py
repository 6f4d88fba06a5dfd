"""Pictures of scenes as they were when somebody looked at them and found them good: small PNG files beside this one.

The tolerance is 3 of 255 in 99 % of the numbers and 40 in all, for other compilers and processors round otherwise, and edges move
by a share of a pixel. Their kernels are optimised, as users' are. After a change that is meant to be seen, look at the new ones:
`python -m tests.march.test_golden`.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import clvol
from clvol import Camera, Corner, Medium, Plane, Scene, TransferFunction, Volume
from clvol.device import Device
from clvol.show.picture import to_bytes

FOLDER = Path(__file__).parent / "golden"
Z, Y, X = np.mgrid[-1:1:32j, -1:1:36j, -1:1:40j]
FOLDS = 0.05 * np.sin(9 * X + 2 * np.sin(4 * Y)) * np.cos(7 * Y)
HEAD = Volume((1 - np.sqrt(X**2 + (Y / 0.9) ** 2 + (Z / 0.85) ** 2) + FOLDS).astype(np.float32), (1, 1.1, 1.2))
WARM = 8 * np.exp(-9 * ((X - 0.4) ** 2 + (Y + 0.4) ** 2 + Z**2))
COLD = 6 * np.exp(-9 * ((X + 0.4) ** 2 + (Y + 0.5) ** 2 + Z**2))
SPOTS = Volume((WARM - COLD)[::2, ::2, ::2], (2, 2.2, 2.4))
TISSUE = TransferFunction([(0, "sienna"), (0.5, "bisque"), (1, "white")], [(0.1, 0), (0.3, 0.5)])
VIEW, SIZE = Camera.orbit(-50, 25), (96, 80)
SCENES: dict[str, tuple[Any, dict[str, Any]]] = {
    "overlay": (Scene([Medium(HEAD, opacity=0.02), Medium(SPOTS, preset="stat-map")]), {}),
    "cut open": (Scene([Medium(HEAD, TISSUE, clip=Corner((19, -99, 18), (99, 20, 99))), Medium(SPOTS, preset="stat-map")]), {}),
    "slab": (Medium(HEAD, TISSUE, clip=Plane((0.3, 0, 1), HEAD.center).slab(0.5)), {}),
    "shells": (HEAD, {"mode": "surfaces", "surfaces": "0.15:bisque:0.3,0.5:firebrick", "outline": 1}),
    "colored": (Medium(HEAD, color_by=Medium(SPOTS, preset="stat-map")), {"mode": "isosurface", "isovalue": 0.3}),
    "capped": (HEAD, {"mode": "isosurface", "isovalue": 0.3, "clip": Plane((0, -1, 0.4), HEAD.center), "cap": True}),
}


def drawn(name: str, device: Device | None = None) -> np.ndarray:
    scene, look = SCENES[name]
    return np.asarray(to_bytes(clvol.render(scene, VIEW, size=SIZE, filter=None, device=device, **look)))[..., :3]


@pytest.fixture(scope="module")
def optimised(device: Device) -> Iterator[Device]:
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("POCL_EXTRA_BUILD_FLAGS", "")
        yield Device(device.handle)  # of no program yet


@pytest.mark.parametrize("name", SCENES)
def test_it_looks_as_it_did(optimised: Device, name: str) -> None:
    want = np.asarray(Image.open(FOLDER / f"{name}.png")).astype(int)
    apart = np.abs(drawn(name, optimised).astype(int) - want)
    assert np.quantile(apart, 0.99) <= 3
    assert apart.max() <= 40


if __name__ == "__main__":
    for one in SCENES:
        Image.fromarray(drawn(one)).save(FOLDER / f"{one}.png")
