"""Results kept for calls with the same arguments, where these tell all that a result depends on."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import is_dataclass
from types import EllipsisType
from typing import Any, Generic, TypeVar

from clvol.base.checks import warned

__all__ = ["Kept", "Once", "Same"]

T = TypeVar("T")

_PLAIN = (bool, int, str, type(None), EllipsisType)
_SEQUENCES = (tuple, list)
_OURS = "clvol."


class Once(Generic[T]):
    """Up to `most` results by keys."""

    def __init__(self, most: int = 16) -> None:
        self._most = most
        self._results: dict[Hashable, T] = {}

    def __call__(self, key: Hashable, make: Callable[[], T]) -> T:
        """The result of this key, which `make` makes if it is not kept; one that warns is not."""
        try:
            return self._results[key]
        except KeyError:
            pass
        before = warned()
        if len(self._results) >= self._most:
            self._results = {}  # before there is another: they may take memory
        made = make()
        if warned() == before:
            self._results[key] = made
        return made

    def clear(self) -> None:
        """Forget them."""
        self._results = {}


class Kept(Once[T]):
    """Results of calls by their arguments.

    These are told apart as they may be by a bit of a result: 1, 1.0 and True, or 0.0 and -0.0; objects by identity. A call is not
    kept if an argument may change, such as an array.
    """

    def of(self, make: Callable[[], T], *arguments: Any) -> T:
        """The result for these arguments."""
        try:
            key = tuple(map(_key, arguments))
        except TypeError:
            return make()
        return self(key, make)


class Same:
    """A key that is equal to that of the same object alone."""

    __slots__ = ("_object",)

    def __init__(self, object: object) -> None:
        self._object = object

    def __hash__(self) -> int:
        return id(self._object)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Same) and self._object is other._object


def _key(value: Any) -> Hashable:
    kind = type(value)
    if kind is float:
        return repr(value)
    if kind in _PLAIN:
        return kind, value
    if kind in _SEQUENCES:
        return kind, *map(_key, value)
    if kind is dict:
        return kind, *((name, _key(item)) for name, item in value.items())
    # a subclass of the user's may be frozen in name alone
    if is_dataclass(kind) and kind.__dataclass_params__.frozen and kind.__module__.startswith(_OURS):  # type: ignore[attr-defined]
        return Same(value)
    raise TypeError(kind)
