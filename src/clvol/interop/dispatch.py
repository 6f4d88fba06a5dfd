"""Functions that hand dask arrays and volumes in bricks to others of their name."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import wraps
from importlib import import_module
from inspect import signature
from typing import ParamSpec, TypeVar

from clvol.base.errors import OptionError

__all__ = ["is_in_parts", "is_lazy", "require_lazy", "with_dask"]

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def is_lazy(source: object) -> bool:
    """Whether it is an array of dask, which needs no import to know."""
    kind = getattr(sys.modules.get("dask.array"), "Array", None)  # none either while another thread is importing it
    return kind is not None and isinstance(source, kind)


def is_in_parts(source: object) -> bool:
    """Whether it is a LazyVolume or a BrickedField: these stand above this module, and say so themselves."""
    return getattr(source, "in_parts", False) is True


def require_lazy(what: str, **options: object) -> None:
    """Refuse options that only arrays of dask have."""
    for name, value in options.items():
        if value is not None:
            raise OptionError(f"{name} must be None where {what} is no array of dask; got {value!r}")


def with_dask(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """A function whose first argument may be an array of dask: it then calls that of its name in `clvol.dask.volumes`.

    That one gets every argument by name, so signature, defaults and documentation are in one place.
    """
    known = signature(function)
    first = next(iter(known.parameters))

    @wraps(function)
    def either(*arguments: Arguments.args, **options: Arguments.kwargs) -> Result:
        if not is_lazy(arguments[0] if arguments else options.get(first)):
            return function(*arguments, **options)
        call = known.bind(*arguments, **options)
        call.apply_defaults()
        by_dask: Callable[..., Result] = getattr(import_module("clvol.dask.volumes"), function.__name__)
        return by_dask(**call.arguments)

    return either
