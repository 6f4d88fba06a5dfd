"""Functions that hand dask arrays and volumes in bricks to others of their name."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import wraps
from importlib import import_module
from typing import ParamSpec, TypeVar

__all__ = ["is_in_parts", "is_lazy", "with_dask"]

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def is_lazy(source: object) -> bool:
    """Whether it is an array of dask, which needs no import to know."""
    kind = getattr(sys.modules.get("dask.array"), "Array", None)  # none either while another thread is importing it
    return kind is not None and isinstance(source, kind)


def is_in_parts(source: object) -> bool:
    """Whether it is a LazyVolume or a BrickedField: these stand above this module, and say so themselves."""
    return getattr(source, "in_parts", False) is True


def with_dask(*names: str) -> Callable[[Callable[Arguments, Result]], Callable[Arguments, Result]]:
    """A function that hands arrays of dask to the function of its name in `clvol.dask`, whose result is an array of dask too.

    Parameters
    ----------
    *names : str
        The function's first parameters, which may be arrays of dask.
    """

    def decorator(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
        @wraps(function)
        def either(*arguments: Arguments.args, **options: Arguments.kwargs) -> Result:
            if any(map(is_lazy, (*arguments[: len(names)], *(options.get(name) for name in names)))):
                by_dask: Callable[Arguments, Result] = getattr(import_module("clvol.dask"), function.__name__)
                return by_dask(*arguments, **options)
            return function(*arguments, **options)

        return either

    return decorator
