"""A mesh by scikit-image, as docs/how-to/moving.md says how, lies on the surface of the function."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import clvol
from clvol.device import Device

PAGE = Path(__file__).parents[2] / "docs/how-to/moving.md"


def test_the_mesh_of_the_page_lies_on_the_surface(device: Device) -> None:
    measure = pytest.importorskip("skimage.measure")
    volume = clvol.Volume(clvol.phantoms.sphere(24).data, (1, 2, 3), (5, 6, 7))
    names = {"clvol": clvol, "volume": volume, "measure": measure, "isovalue": 0.4}
    lines = re.findall(r"`((?:finer|corners|finer\.index_to_world)[^`]*\))`", PAGE.read_text(encoding="utf-8"))
    assert len(lines) == 3
    for line in lines[:2]:
        exec(line, names)  # what the page says
    world = eval(lines[2], names)
    assert len(world) > 500
    np.testing.assert_allclose(clvol.sample(volume, world, device=device), 0.4, atol=0.02)
