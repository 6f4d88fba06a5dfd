"""A plugin for pytest that puts `clvol.ndimage` in place of `scipy.ndimage` in SciPy's own tests.

``python -m pytest -p scipy_plugin --pyargs scipy.ndimage.tests.test_interpolation`` with this folder on the path. The tests keep
their tolerances; they compute in float64, so everything does.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable
from inspect import unwrap
from typing import Any, ClassVar

import pytest
from scipy import ndimage

import clvol.ndimage
from clvol.ndimage import interpolation


class InDouble:
    """The `ndimage` that the tests see; counts calls."""

    calls: ClassVar[Counter[str]] = Counter()

    def __getattr__(self, name: str) -> Callable[..., Any]:
        function: Callable[..., Any] = getattr(clvol.ndimage, name)
        if name not in interpolation.__all__:
            return function

        def computed(*arguments: Any, **options: Any) -> Any:
            self.calls[name] += 1
            return function(*arguments, precision="double", **options)

        return computed


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Select one test in n, if the environment says so, and one of each function that none of these calls."""
    selected = items[:: int(os.environ.get("EVERY", "1"))]
    for name in interpolation.__all__:
        calling = [item for item in items if isinstance(item, pytest.Function) and name in unwrap(item.function).__code__.co_names]
        if not any(item in selected for item in calling):
            selected += calling[:1]
    items[:] = selected


def pytest_collection_finish(session: pytest.Session) -> None:
    """After the tests' decorators have looked up SciPy's functions."""
    modules = {item.module for item in session.items if isinstance(item, pytest.Function)}
    assert modules
    for module in modules:
        assert module.ndimage is ndimage, f"{module.__name__} does not call scipy.ndimage by this name"
        module.ndimage = InDouble()


def pytest_sessionfinish() -> None:
    assert set(InDouble.calls) == set(interpolation.__all__), f"the tests called {InDouble.calls}"
