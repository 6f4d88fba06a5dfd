"""Former names: what they lead to now, each use with a `DeprecationWarning`; they will go after the next version.

A former module whose name is now that of a function of the package stands in `sys.modules` alone: ``from clvol.filters
import as_filter`` works, and ``clvol.filters`` is still the function.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Mapping
from importlib import import_module
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType
from typing import Any

__all__ = ["callable_as_before", "forwarding", "submodule"]

_MODULES = {
    "clvol.analysis.compare": "clvol.analysis.comparison",
    "clvol.analysis.metrics": "clvol.analysis.marschner_lobb",
    "clvol.analysis.ssim": "clvol.analysis.similarity",
    "clvol.bounds": "clvol.spline.minmax",
    "clvol.filters": "clvol.filter",
    "clvol.modes": "clvol.mode",
    "clvol.order": "clvol.spline.sort",
    "clvol.reference.boundary": "clvol.reference.spline.boundary",
    "clvol.reference.exact": "clvol.reference.march.exact",
    "clvol.reference.filter": "clvol.reference.spline.filter",
    "clvol.reference.lattice": "clvol.reference.spline.resample",
    "clvol.reference.prefilter": "clvol.reference.spline.prefilter",
    "clvol.reference.sample": "clvol.reference.spline.points",
    "clvol.render": "clvol.march.renderer",
}
_ELSEWHERE = {  # names of those modules that are in another one now, or have another name
    "clvol.bounds.Bounds": "clvol.spline.minmax:MinMax",
    "clvol.render.Lattice": "clvol.march.planes:Planes",
    "clvol.render.OBLIQUE": "clvol.march.planes:OBLIQUE",
    "clvol.render.pixel_offsets": "clvol.march.pixels:pixel_offsets",
}


def submodule(package: str, name: str) -> ModuleType | None:
    """A part of a package, imported now that it is asked for; None if the package has none of that name."""
    if (
        name.startswith("_")
        or "." in name
        or not hasattr(sys.modules[package], "__path__")
        or find_spec(f"{package}.{name}") is None
    ):
        return None
    return import_module(f"{package}.{name}")


def forwarding(module: str, places: Mapping[str, str]) -> Callable[[str], Any]:
    """A module's `__getattr__` for names that moved: from each to "module" or to "module:new name"."""

    def __getattr__(name: str) -> Any:
        if name not in places:
            if (part := submodule(module, name)) is not None:
                return part
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        target, _, new = places[name].partition(":")
        return _found(f"{module}.{name}", target, new or name)

    return __getattr__


class _FormerModule(ModuleType):
    """Stands in `sys.modules` for a module that has another name now."""

    def __init__(self, name: str, target: str) -> None:
        super().__init__(name, f"Now {target}.")
        self.__spec__ = ModuleSpec(name, None)
        self.__dict__["_target"] = target

    def __getattr__(self, name: str) -> Any:
        if name == "__all__":  # for `from ... import *`
            return list(import_module(self._target).__all__)
        if name.startswith("__"):  # what tools look for in every module
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}")
        former = f"{self.__name__}.{name}"
        target, _, new = _ELSEWHERE.get(former, self._target).partition(":")
        return _found(former, target, new or name)

    def __reduce__(self) -> tuple[Any, ...]:
        """By its name, as cloudpickle takes modules along with functions in which their names occur."""
        return import_module, (self.__name__,)


class _FormerFunction(ModuleType):
    """A module whose name was that of a function before: it can still be called."""

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        name = self.__name__.rpartition(".")[2]
        return _found(self.__name__, "clvol", name)(*arguments, **options)


def callable_as_before(*modules: str) -> None:
    """Lets modules be called as the functions that had their names, each time with a warning."""
    for name in modules:
        sys.modules[name].__class__ = _FormerFunction


def _found(former: str, target: str, name: str) -> Any:
    value = getattr(import_module(target), name)
    warnings.warn(f"{former} is now {target}.{name}", DeprecationWarning, stacklevel=3)
    return value


for _name, _target in _MODULES.items():
    sys.modules.setdefault(_name, _FormerModule(_name, _target))
