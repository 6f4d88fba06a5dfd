"""Former names: what they lead to now, each use with a `DeprecationWarning`; they will go after the next version.

A former module whose name is now that of a function of the package stands in `sys.modules` alone: ``from clvol.filters
import as_filter`` works, and ``clvol.filters`` is still the function.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Mapping
from importlib import import_module
from types import ModuleType
from typing import Any

__all__ = ["forwarding"]

_MODULES = {
    "clvol.bounds": "clvol.spline.minmax",
    "clvol.filters": "clvol.filter",
    "clvol.modes": "clvol.mode",
    "clvol.order": "clvol.spline.sort",
    "clvol.render": "clvol.march.renderer",
}
_RENAMED = {"clvol.bounds.Bounds": "MinMax"}


def forwarding(module: str, places: Mapping[str, str]) -> Callable[[str], Any]:
    """A module's `__getattr__` for names that moved: from each to "module" or to "module:new name"."""

    def __getattr__(name: str) -> Any:
        if name not in places:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        target, _, new = places[name].partition(":")
        return _found(f"{module}.{name}", target, new or name)

    return __getattr__


class _FormerModule(ModuleType):
    """Stands in `sys.modules` for a module that has another name now."""

    def __init__(self, name: str, target: str) -> None:
        super().__init__(name, f"Now {target}.")
        self.__dict__["_target"] = target

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):  # what tools ask of every module
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}")
        former = f"{self.__name__}.{name}"
        return _found(former, self._target, _RENAMED.get(former, name))


def _found(former: str, target: str, name: str) -> Any:
    value = getattr(import_module(target), name)
    warnings.warn(f"{former} is now {target}.{name}", DeprecationWarning, stacklevel=3)
    return value


for _name, _target in _MODULES.items():
    sys.modules.setdefault(_name, _FormerModule(_name, _target))
