"""The table of modes: each has its kernel file and its reference."""

from __future__ import annotations

import pytest

from clvol import program
from clvol.errors import OptionError
from clvol.mode import DEFAULT_MODE, Mode, as_mode, modes
from clvol.reference import march


@pytest.mark.parametrize("name", modes())
def test_each_mode_has_a_kernel_file_and_a_reference(name: str) -> None:
    mode = as_mode(name)
    assert mode.name == name
    assert as_mode(mode) is mode
    assert mode.description
    text = program.source(mode.file)
    for word in ("begin", "gather", "finish", "state_t"):
        assert word in text
    assert "for (" not in text or name == "isosurface"  # the ray loop is march.cl's; isosurface refines
    assert name in march._MODES


def test_the_table_is_a_copy() -> None:
    modes().clear()
    assert DEFAULT_MODE in modes()
    assert set(march._MODES) == set(modes())


@pytest.mark.parametrize("wrong", ["MIP", "", None, 3])
def test_unknown_modes(wrong: object) -> None:
    with pytest.raises(OptionError, match=r"mode must be one of composite, isosurface, mip, minip, mean; got "):
        as_mode(wrong)  # type: ignore[arg-type]


def test_a_mode_is_a_row() -> None:
    assert Mode("fog", "none").file == "modes/fog.cl"
