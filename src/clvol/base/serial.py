"""Dataclasses as JSON, by their fields, and back: nothing is executed, and only classes of a table are made.

Numbers come back to the last bit. What JSON lacks, and what is an object, is an object of one entry that names its kind.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Mapping
from fractions import Fraction
from typing import Any, TypeAlias

import numpy as np

from clvol.base.errors import ClvolError, FormatError, OptionError

__all__ = ["LONGEST", "Described", "dataclasses_of", "from_text", "to_text"]

Described: TypeAlias = Callable[[Any], Mapping[str, Any]]
Maker: TypeAlias = Callable[[Mapping[str, Any]], Any]

LONGEST = 1 << 20
"""Characters of a text that is written, or read."""
_MOST_NUMBERS = 4096  # of an array
_ROUNDING = 4e-16  # of the components of a unit vector


def dataclasses_of(*modules: Any) -> dict[str, type]:
    """The public dataclasses that modules define, by name."""
    return {
        name: kind
        for module in modules
        for name, kind in vars(module).items()
        if not name.startswith("_")
        and isinstance(kind, type)
        and dataclasses.is_dataclass(kind)
        and kind.__module__ == module.__name__
    }


def to_text(value: Any, classes: Mapping[str, type], described: Mapping[type, Described], **head: str | int) -> str:
    """An object as JSON, after the entries of `head`; objects of a class in `described` as what its function says of them.

    `OptionError` if it holds objects of other classes, large arrays, or is too long.
    """
    plain = {**head, **_plain(value, classes, described)}
    text = json.dumps(plain, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    if len(text) > LONGEST:
        raise OptionError(f"a description must have at most {LONGEST} characters; got {len(text)}")
    return text


def from_text(text: str, classes: Mapping[str, type], made: Mapping[str, Maker], **head: str | int) -> Any:
    """The object of `to_text`; what was described is made by the functions of `made`, by the name of its class.

    `FormatError` if it is anything else, or if an entry of `head` is another.
    """
    if len(text) > LONGEST:
        raise FormatError(f"it must have at most {LONGEST} characters; got {len(text)}")
    try:
        plain = json.loads(text, parse_constant=_no_constant)
        for name, value in head.items():
            if (found := plain.pop(name, None)) != value or type(found) is not type(value):
                raise FormatError(
                    f"its {name} must be {value}; got {str(found)[:80]}, made by clvol {str(plain.get('clvol'))[:80]}"
                )
        plain.pop("clvol", None)
        return _made(plain, classes, made)
    except RecursionError:
        raise FormatError("it is nested too deeply") from None
    except ClvolError as error:
        raise FormatError(str(error)) from error
    except (ValueError, TypeError, KeyError, AttributeError, ArithmeticError) as error:
        raise FormatError(f"{type(error).__name__}: {str(error)[:200]}") from error


def _plain(value: Any, classes: Mapping[str, type], described: Mapping[type, Described]) -> Any:
    """What JSON can hold of a value."""
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, (bool, str, int)):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else {"float": repr(value)}
    if isinstance(value, Fraction):
        return {"fraction": str(value)}
    if isinstance(value, np.ndarray) and value.size <= _MOST_NUMBERS:
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [_plain(one, classes, described) for one in value]
    if isinstance(value, Mapping):
        return {"dict": {str(name): _plain(one, classes, described) for name, one in value.items()}}
    kind = type(value)
    if kind in described:
        known = dict(described[kind](value))
        return {kind.__name__: {name: _plain(one, classes, described) for name, one in known.items()}}
    if classes.get(kind.__name__) is not kind:
        raise OptionError(f"only clvol's own objects can be written as text; got a {kind.__name__}")
    known = {field.name: getattr(value, field.name) for field in dataclasses.fields(value) if field.init}
    return {kind.__name__: {name: _plain(one, classes, described) for name, one in known.items()}}


def _made(plain: Any, classes: Mapping[str, type], made: Mapping[str, Maker]) -> Any:
    """The value that JSON stands for."""
    if isinstance(plain, list):
        return tuple(_made(one, classes, made) for one in plain)
    if not isinstance(plain, dict):
        return plain
    ((name, content),) = plain.items()
    if name == "float":
        return float(content)
    if name == "fraction":
        return Fraction(content)
    if name == "dict":
        return {key: _made(one, classes, made) for key, one in content.items()}
    if name in made:
        return made[name]({key: _made(one, classes, made) for key, one in content.items()})
    if name not in classes:
        raise FormatError(f"it holds a {name[:80]!r}, which this version does not know")
    known = {field.name for field in dataclasses.fields(classes[name]) if field.init}
    if unknown := sorted(content.keys() - known):
        raise FormatError(f"its {name} has {', '.join(unknown)[:200]}, which this version does not know")
    given = {key: _made(one, classes, made) for key, one in content.items()}
    value = classes[name](**given)
    for key, one in given.items():
        if _is_rounded_again(one, getattr(value, key)):
            object.__setattr__(value, key, one)
    return value


def _is_rounded_again(given: Any, held: Any) -> bool:
    """Whether a vector was normalised that had been normalised before, which changes its last bits."""
    if not (isinstance(given, tuple) and isinstance(held, tuple) and len(given) == len(held) == 3):
        return False
    if not all(isinstance(v, float) for v in (*given, *held)):
        return False
    return given != held and all(abs(a - b) <= _ROUNDING for a, b in zip(given, held, strict=True)) and max(map(abs, given)) <= 1


def _no_constant(name: str) -> float:
    raise FormatError(f"it holds {name}, which is not JSON")
