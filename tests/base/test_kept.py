"""Results kept for calls with the same arguments."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from clvol import Camera, ClvolWarning
from clvol.base.checks import warn
from clvol.base.kept import Kept, Once


@dataclass(frozen=True)
class Own:
    """Of the user's, who may change what it holds."""

    values: list[float]


CAMERA = Camera.orbit(30, 20)


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        (1.0, 1.0, True),
        ("mip", "mip", True),
        ((1.0, [2, None]), (1.0, [2, None]), True),
        ({"step": 0.5}, {"step": 0.5}, True),
        (CAMERA, CAMERA, True),
        (CAMERA, Camera.orbit(30, 20), False),
        (1, 1.0, False),
        (1, True, False),
        (0.0, -0.0, False),
        ((1.0,), [1.0], False),
        ({"step": 0.5}, {"step": 0.6}, False),
        (np.ones(3), np.ones(3), False),
        (own := Own([1.0]), own, False),
    ],
)
def test_arguments_are_told_apart(one: Any, other: Any, same: bool) -> None:
    kept: Kept[object] = Kept()
    assert (kept.of(object, one) is kept.of(object, other)) is same


def test_what_warns_is_not_kept() -> None:
    kept: Kept[None] = Kept()
    for _ in range(2):
        with pytest.warns(ClvolWarning, match="again"):
            kept.of(lambda: warn("again"), "mip")


def test_few_are_kept() -> None:
    kept: Once[object] = Once(2)
    first = kept("first", object)
    assert kept("second", object) is not kept("first", object) is first
    kept("third", object)
    assert kept("first", object) is not first
