"""The table of filters: names, aliases and families, and the parser of names."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any

from clvol.base.checks import did_you_mean, one_of, several
from clvol.base.errors import OptionError
from clvol.base.shown import Named
from clvol.filter.filter import ALIASES, Filter, also_called
from clvol.filter.make import bc, bspline, lanczos, moms3, omoms3, quasi, sinc, wide

__all__ = [
    "DEFAULT_FILTER",
    "PICTURE_FILTER",
    "REGION_FILTER",
    "FilterTable",
    "as_filter",
    "as_filters",
    "filters",
    "register_filter",
    "several_names",
    "unregister_filter",
]

DEFAULT_FILTER = "bspline3"
PICTURE_FILTER = "bspline3(auto)"  # default of pictures: they should not show the noise of the data
REGION_FILTER = "bspline5-approx"  # default of smooth boundaries between labels

_TABLE: dict[str, Filter] = {}
_FAMILIES: dict[str, tuple[str, Callable[..., Filter]]] = {
    "bc": ("B, C", bc),
    "moms3": ("weight", moms3),
    "sinc": ("radius", lambda radius: sinc(_whole(radius))),
    "sincn": ("radius", lambda radius: sinc(_whole(radius), normalized=True)),
    "lanczos": ("radius", lambda radius: lanczos(_whole(radius))),
    "lanczosn": ("radius", lambda radius: lanczos(_whole(radius), normalized=True)),
    "wide": ("width", lambda width: wide(_whole(width))),
}
_SMOOTHED = "bspline3(0.1), bspline3(auto), bspline3(length=0.5)"


def register_filter(new: Filter, *, replace_existing: bool = False) -> Filter:
    """Add a filter to the table, so that its name works wherever a filter is expected. Returns the filter."""
    if not isinstance(new, Filter):
        raise OptionError(f"register_filter takes a Filter; got {new!r}")
    if not re.fullmatch(r"[a-zA-Z][\w.+-]*(\([\w.+/,-]*\))?", new.name):
        raise OptionError(
            "a filter's name must be a letter, then letters, digits, '-', '+', '.' or '_', and perhaps "
            f"parameters in parentheses; got {new.name!r}"
        )
    if (new.name in _TABLE or new.name in ALIASES) and not replace_existing:
        raise OptionError(f"a filter named {new.name!r} exists; pass replace_existing=True to replace it")
    _TABLE[new.name] = new
    return new


def unregister_filter(name: str) -> Filter:
    """Remove a filter from the table and return it; `OptionError` if the name is unknown.

    Built-in filters can be removed too; ``register_filter(unregister_filter("linear"))`` restores one.
    """
    if not isinstance(name, str) or name not in _TABLE:
        raise one_of("filter", name, _TABLE)
    return _TABLE.pop(name)


class FilterTable(Named[Filter]):
    """Filters by name, shown as a table."""

    HEADER = ("filter", "support", "degree", "continuity", "order", "interpolates", "sums to one", "poles", "also called")

    def rows(self) -> list[tuple[str, ...]]:
        """One tuple of strings per filter, in the order of `HEADER`."""
        return [(name, *f.properties().values()) for name, f in self.items()]


def filters() -> FilterTable:
    """The table of filters by name, in order, with their properties and aliases when shown.

    Examples
    --------
    >>> import clvol
    >>> [name for name in clvol.filters() if name.startswith("omoms")]
    ['omoms3']
    """
    return FilterTable(_TABLE)


def as_filter(choice: str | Filter) -> Filter:
    """The filter of a name, an alias, or a family with parameters, such as ``"bc(0, 1/2)"``, ``"sinc(6)"``, ``"bspline3(0.1)"``,
    ``"bspline3(0.1, 0.1, 0.4)"``, ``"bspline3(auto)"`` or ``"bspline3(length=0.5)"``.
    """
    if isinstance(choice, Filter):
        return choice
    if not isinstance(choice, str):
        raise one_of("filter", choice, _TABLE)
    name = choice.strip().lower()
    name = ALIASES.get(name, name)
    if name in _TABLE:
        return _TABLE[name]
    if choice in _TABLE:
        return _TABLE[choice]
    written = [f"{family}({parameters})" for family, (parameters, _) in _FAMILIES.items()]
    if (match := re.fullmatch(r"(\w+)\(([^()]*)\)", name)) and match[1] in _FAMILIES:
        try:
            return _FAMILIES[match[1]][1](*(Fraction(v.strip()) for v in match[2].split(",")))
        except (ValueError, TypeError, ZeroDivisionError) as error:
            how = f"{', '.join(written[:-1])} or {written[-1]}{_reason(error)}"
            raise OptionError(f"filter {choice!r} has wrong parameters; write {how}") from None
    if match := re.fullmatch(r"bspline([6-9])", name):  # the name of a smoothing filter with λ = 0
        return bspline(int(match[1]))
    if match := re.fullmatch(r"(?:bspline|cubic)\(([^()]*)\)|bspline(\d)\(([^()]*)\)", name):
        return _smoothed_by_name(choice, int(match[2] or 3), match[1] or match[3] or "")
    known = [f"{row} ({', '.join(also_called(row))})" if also_called(row) else row for row in _TABLE]
    known += [*written, "bspline3(λ)", "bspline3(auto)"]
    raise OptionError(f"filter must be one of {', '.join(known)}; got {choice!r}{did_you_mean(name, [*_TABLE, *ALIASES])}")


def _smoothed_by_name(choice: str, degree: int, text: str) -> Filter:
    try:
        if text.strip() == "auto":
            return bspline(degree, smoothing="auto")
        key, given, value = text.partition("=")
        if given and key.strip() == "length":
            return bspline(degree, length=float(Fraction(value.strip())))
        values = [float(Fraction(v.strip())) for v in text.split(",")]
        return bspline(degree, smoothing=values[0] if len(values) == 1 else tuple(values))
    except (ValueError, ZeroDivisionError, OverflowError) as error:
        raise OptionError(f"filter {choice!r} has wrong parameters; write it as one of {_SMOOTHED}{_reason(error)}") from None


def _reason(error: Exception) -> str:
    """What a filter refuses, as the end of a message; "" if a parameter is no number."""
    return f": {error}" if isinstance(error, OptionError) else ""


def as_filters(choices: Sequence[str | Filter], maximum: int | None = None) -> list[Filter]:
    """The filters for one or more names, at most `maximum`."""
    return [as_filter(choice) for choice in several_names(choices, maximum)]


def several_names(choices: object, maximum: int | None = None) -> list[Any]:
    """`filters` as a list of one or more names or filters, without looking them up."""
    if isinstance(choices, Filter):
        raise OptionError(f"filters must be one or more names; got {choices!r}")
    return several("filters", choices, "one or more names", maximum)


def _whole(value: Fraction) -> int:
    if value.denominator != 1:
        raise ValueError
    return int(value)


for _row in (
    bspline(0),
    bspline(1),
    *(bspline(degree) for degree in (2, 3, 4, 5)),
    *(bspline(degree, prefilter=False) for degree in (2, 3, 4, 5)),
    replace(bc(Fraction(1, 3), Fraction(1, 3)), name="mitchell"),
    replace(bc(0, Fraction(1, 2)), name="catmull-rom"),
    omoms3(),
    moms3(),
    quasi(1),
    quasi(3),
    *(lanczos(radius) for radius in (2, 3, 4, 5)),
    lanczos(3, normalized=True),
    sinc(),
    sinc(normalized=True),
):
    register_filter(_row)
register_filter(replace(bspline(1), name="hybrid", magnified_by=bspline(3)))
