"""A plugin for pytest that puts `clvol.ndimage` in place of `scipy.ndimage` in SciPy's own tests.

``python -m pytest -p scipy_plugin --pyargs scipy.ndimage.tests.test_interpolation`` with this folder on the path. The tests keep
their tolerances; they compute in float64, so everything does.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import pytest
from scipy import ndimage

import clvol.ndimage


class InDouble:
    """What the tests find under the name `ndimage`."""

    def __getattr__(self, name: str) -> Callable[..., Any]:
        function: Callable[..., Any] = getattr(clvol.ndimage, name)
        return partial(function, precision="double") if name in clvol.ndimage.__all__ else function


def pytest_collection_finish(session: pytest.Session) -> None:
    """After the tests' decorators have looked SciPy's functions up."""
    modules = {item.module for item in session.items if isinstance(item, pytest.Function)}
    assert modules
    for module in modules:
        assert module.ndimage is ndimage, f"{module.__name__} does not call scipy.ndimage by this name"
        module.ndimage = InDouble()
