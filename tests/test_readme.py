"""The README's Python runs as it stands there."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import clvol.ndimage
from clvol.device import Device

README = Path(__file__).resolve().parents[1] / "README.md"

pytestmark = pytest.mark.skipif(not README.is_file(), reason="not in a checkout")


def test_the_python_of_the_readme_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, device: Device) -> None:
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) == 3
    monkeypatch.chdir(tmp_path)
    image = np.random.default_rng(0).integers(0, 255, (30, 40, 3)).astype(np.uint8)
    here: dict[str, object] = {"image": image}
    for block in blocks:
        exec(block, here)  # one after the other, as a reader would
    assert here["ndimage"] is clvol.ndimage
    assert (tmp_path / "picture.png").is_file()
    assert np.shape(here["portrait"]) == (75, 100, 3)
    assert np.shape(here["turned"]) == (400, 400, 3)
    assert [row.filter for row in here["table"]][-1] == "exact-sinc"  # type: ignore[attr-defined]
    assert device is not None
