"""Functions that hand dask arrays and volumes in bricks to others of their name."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import wraps
from importlib import import_module
from typing import ParamSpec, TypeVar

from clvol.base.errors import DataError, OptionError, OutOfMemoryError

__all__ = ["is_in_parts", "is_lazy", "lazily", "with_dask"]

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def is_lazy(source: object) -> bool:
    """Whether it is an array of dask, which needs no import to know."""
    kind = getattr(sys.modules.get("dask.array"), "Array", None)  # none either while another thread is importing it
    return kind is not None and isinstance(source, kind)


def is_in_parts(source: object) -> bool:
    """Whether it is a LazyVolume or a BrickedField, which stand on this module."""
    names = (("clvol.bricks.source", "LazyVolume"), ("clvol.bricks.field", "BrickedField"))
    kinds = tuple(kind for module, name in names if (kind := getattr(sys.modules.get(module), name, None)) is not None)
    return isinstance(source, kinds)


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


def lazily(*names: str, instead: bool = False) -> Callable[[Callable[Arguments, Result]], Callable[Arguments, Result]]:
    """`with_dask`, and what `is_in_parts` goes to the function of that name in the module `parts` of the function's package.

    Parameters
    ----------
    *names : str
        The function's first parameters, as far as arrays of dask are looked for among them; only the first may be in parts.
    instead : bool
        Whether what is in memory goes to the module `parts` too, if there is no room for what is made of it as a whole.
    """

    def decorator(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
        parts = function.__module__.rpartition(".")[0] + ".parts"

        def by_parts(*arguments: Arguments.args, **options: Arguments.kwargs) -> Result:
            found: Callable[Arguments, Result] = getattr(import_module(parts), function.__name__)
            return found(*arguments, **options)

        @with_dask(*names)
        @wraps(function)
        def either(*arguments: Arguments.args, **options: Arguments.kwargs) -> Result:
            if is_in_parts(arguments[0] if arguments else options.get(names[0])):
                return by_parts(*arguments, **options)
            if not instead:
                return function(*arguments, **options)
            try:
                return function(*arguments, **options)
            except OutOfMemoryError as refused:
                try:
                    return by_parts(*arguments, **options)
                except (OptionError, DataError, OutOfMemoryError):  # nor is there another way
                    raise refused from None

        return either

    return decorator
