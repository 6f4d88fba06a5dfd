"""Options inside one argument, as name=value,name=value: spelled and read as those of a command are."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import cache
from typing import Annotated, Any

from cyclopts import App, CycloptsError, Parameter
from cyclopts.argument import Argument

from clvol.base.checks import did_you_mean
from clvol.base.errors import OptionError
from clvol.cli.options import FilterName, Furniture, Look, ModeOptions
from clvol.cli.speech import one_line

__all__ = ["inline_options", "parts_of"]

_NEXT = re.compile(r",(?=[a-z][a-z-]*=)")


def _command(
    *,
    filter: FilterName | None = None,
    mask: str | None = None,
    where: Annotated[tuple[float, ...] | None, Parameter(consume_multiple=True)] = None,
    smooth: bool = False,
    look: Look | None = None,
    own: ModeOptions | None = None,
    furniture: Furniture | None = None,
) -> None:
    """What may be said in an argument."""


@cache
def _parser() -> tuple[Callable[[list[str]], dict[str, Any]], dict[str, Argument]]:
    """What reads options of `_command`, and these by their names."""
    app = App(default_parameter=Parameter(negative_iterable=()), help_flags=(), version_flags=())
    app.default(_command)

    def read(tokens: list[str]) -> dict[str, Any]:
        _, bound, _ = app.parse_args(tokens, exit_on_error=False, print_error=False)
        return bound.arguments

    known = {name.removeprefix("--"): one for one in app.assemble_argument_collection() for name in one.names}
    return read, known


def parts_of(text: str) -> list[str]:
    """The parts of "this,name=value,name=value": values may contain commas."""
    return _NEXT.split(text)


def inline_options(words: Sequence[str], what: str, names: Sequence[str]) -> dict[str, Any]:
    """The options in "name=value", ..., by their names in Python; several numbers of one have "/" between them.

    `what` they are of may have the options with these `names`; `OptionError` says so of others.
    """
    read, known = _parser()
    tokens, given = list[str](), list[str]()
    for word in words:
        name, _, value = word.partition("=")
        if name not in names:
            raise OptionError(f"{name} is no option of {what}{did_you_mean(name, names)}; it may have {', '.join(names)}")
        count, many = known[name].token_count()
        count = max(1, count)  # of a flag it is 0, and --flag=true is read
        if not value:
            raise OptionError(f"{name} of {what} must have a value: {name}=VALUE")
        values = value.split("/") if many or count > 1 else [value]
        if len(values) % count or not (many or len(values) == count):
            raise OptionError(f"{name} of {what} must be {'/'.join(count * ['number'])}; got {value!r}")
        tokens += [f"--{name}={value}"] if len(values) == 1 else [f"--{name}", *values]
        given.append(known[name].field_info.name)
    try:
        found = read(tokens)
    except CycloptsError as error:
        raise OptionError(f"{what}: {one_line(error).rstrip('.')}") from None
    look, own, furniture = (found.pop(name, None) for name in ("look", "own", "furniture"))
    found |= {} if own is None else own.options()
    for part in (look, furniture):
        found |= {} if part is None else {name: value for name, value in vars(part).items() if name in given}
    return found
