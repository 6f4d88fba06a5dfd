"""The README's Python runs as written."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import clvol.ndimage
from clvol.device import Device
from tests.cases import small_pictures

README = Path(__file__).resolve().parents[1] / "README.md"

pytestmark = pytest.mark.skipif(not README.is_file(), reason="not in a checkout")


_NAMES = re.compile(
    r"Python 3\.11|64-bit x86|PowerShell 5|[Ff]igure 6|Goluban, .{1,60}, 1999|PoCL 3\.0|2026-11-21|a processor of 2017", re.I
)
_SIZES = ("prefilter on the device, 256³ (512³)", "4 million points along", "4 million random", "magnify ×2", "512² frame of 256³")


def test_every_number_of_the_readme_is_among_the_claims() -> None:
    """Numbers in text: not those in code, in links, or within names such as AVX-512."""
    claims = (README.parent / "docs" / "claims.md").read_text(encoding="utf-8")
    quoted = re.findall(r"^\| (.+?) \|", claims.partition("## What failed")[0], re.MULTILINE)[1:]
    text = " ".join(README.read_text(encoding="utf-8").split())
    assert len(quoted) > 25
    assert [claim for claim in quoted if claim not in text] == []
    for claim in (*quoted, *_SIZES):
        text = text.replace(claim, "")
    text = re.sub(r"```.*?```|`[^`]*`|\]\([^)]*\)", "", text)
    assert re.findall(r".{,30}(?<![\w.-])\d.{,20}", _NAMES.sub("", text)) == []


def test_the_python_of_the_readme_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, device: Device) -> None:
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) == 5
    monkeypatch.chdir(tmp_path)
    small_pictures(monkeypatch)
    image = np.random.default_rng(0).integers(0, 255, (30, 40, 3)).astype(np.uint8)
    nibabel, tifffile = pytest.importorskip("nibabel"), pytest.importorskip("tifffile")
    nibabel.save(nibabel.Nifti1Image(np.ones((4, 5, 6, 13), np.int16), np.eye(4)), "bold.nii.gz")
    cells = np.arange(4 * 3 * 2 * 5 * 6, dtype=np.uint16).reshape(4, 3, 2, 5, 6)
    about = {"axes": "TZCYX", "Channel": {"Name": ["DAPI", "GFP"]}}
    tifffile.imwrite("cells.ome.tif", cells, ome=True, photometric="minisblack", metadata=about)
    here: dict[str, object] = {"image": image}
    for block in blocks:
        exec(block, here)  # one after the other, as a reader would
    assert here["ndimage"] is clvol.ndimage
    assert (tmp_path / "picture.png").is_file()
    np.testing.assert_array_equal(here["nuclei"], cells[3, :, 0])  # type: ignore[arg-type]  # a volume is an array
    assert np.shape(here["channels"]) == (4, 2, 3, 5, 6)
    assert np.shape(here["portrait"]) == (75, 100, 3)
    assert np.shape(here["turned"]) == (400, 400, 3)
    assert [row.filter for row in here["table"]][-1] == "exact-sinc"  # type: ignore[attr-defined]
    assert device is not None
