"""Names of files hold any characters; none may control a terminal, a comment or a page."""

from __future__ import annotations

import subprocess
import sys
import unicodedata
from pathlib import Path

import numpy as np
import pytest

import clvol
from clvol.base import html
from clvol.base.printable import printable

NAME = "a\nb = 1\r\x1b[31m\x7f\x85\u2028\u202e.npz"


def test_control_characters_are_escaped_and_no_others() -> None:
    controls = {"Cc", "Zl", "Zp", "Cs"}
    for code in range(0x11000):
        wanted = unicodedata.category(chr(code)) in controls or unicodedata.bidirectional(chr(code)) in (
            *("LRE", "RLE", "PDF", "LRO", "RLO", "LRI", "RLI", "FSI", "PDI"),
        )
        if not wanted and code not in (0x61C, 0x200E, 0x200F):  # marks of a direction, which are letters to Unicode
            assert printable(chr(code)) == chr(code)
        else:
            assert printable(chr(code)).isascii()
            assert printable(chr(code)).isprintable()
    assert printable("ü 🧠 \x1b[0m") == r"ü 🧠 \x1b[0m"


def test_pages_have_no_control_characters() -> None:
    for made in (html.table(["n"], [[NAME]]), html.facts(NAME, {NAME: NAME}), html.text_table(["n"], [[NAME]]).partition("\n")[2]):
        assert made.isprintable()


@pytest.mark.skipif(sys.platform == "win32", reason="files there have no such names")
def test_the_command_writes_no_control_characters(tmp_path: Path) -> None:
    volume = clvol.Volume(np.zeros((3, 3, 3), np.uint8), name="n\x1b[31m\nm")
    clvol.write(volume, tmp_path / NAME)
    for arguments in (["info", NAME], ["info", f"{NAME}x"], [NAME]):
        done = subprocess.run(
            [sys.executable, "-m", "clvol", *arguments], cwd=tmp_path, capture_output=True, check=False, timeout=60
        )
        said = (done.stdout + done.stderr).decode()
        assert said.replace("\n", "").isprintable(), said
        assert "\nb = 1" not in said
