"""Errors and warnings, translated from Python's terms into the shell's; only this module knows both."""

from __future__ import annotations

import re
from collections.abc import Sequence

from cyclopts import CycloptsError

from clvol.base.errors import DataError
from clvol.cli.root import app
from clvol.cli.speech import one_line

__all__ = ["in_the_shell"]

_PHRASES = (
    (r"replace them with Volume\.filled\(\w*\)", "replace them with --fill-nan VALUE (or --fill-nan smoothly)"),
    (r"replace missing samples with Volume\.filled\(\)", "replace missing samples with --fill-nan VALUE"),
    (r": choose by ([a-z= ]+), or read all by clvol\.read_all", r": choose by \1"),
    (r"limits=clvol\.formats\.Limits\(\.\.\.\) or trusted=True", "--trusted"),
    (r"trusted=True", "--trusted"),
    (r"LazyVolume\(\.\.\., missing=value\) replaces them", "--fill-nan VALUE replaces them"),
    (r"a picture of volume\.whole\(\) leaves them out", "pictures of volumes in memory leave them out"),
    (r"clvol\.pyramid makes a Zarr store of it", "'clvol pyramid' makes a Zarr store of it"),
    (r"overwrite=True", "--overwrite"),
    (r"spacing=, origin= or direction= replace what the file says", "--spacing replaces that of the file"),
    (r"shape=\(nz, ny, nx\)", "--shape NZ NY NX"),
    (r"window=\(center, width\)", "--window CENTER WIDTH"),
)
"""Advice in Python, and the same for the shell."""


def in_the_shell(error: Exception | str, given: Sequence[str]) -> str:
    """The message of an error or a warning, on one line, in the terms of the command line `given`.

    Advice in Python becomes an option of the command. Arguments in Python (``series=``, or "step must be ...") become the options
    of the command that set them.
    """
    message = one_line(error)
    for phrase, words in _PHRASES:
        message = re.sub(phrase, words, message)
    flags = _flags(given)
    if not flags:
        return message
    names = "|".join(map(re.escape, flags))
    if not isinstance(error, DataError):  # whose "samples must be finite" are those of the file
        message = re.sub(rf"^({names})(?= (?:must|is no option|is only|changes nothing)\b)", lambda m: flags[m[1]], message)
    message = re.sub(rf"(?<![\w.-])({names})=(?=[\w(\"'\[])", lambda m: f"{flags[m[1]]} ", message)
    return re.sub(rf"(?<![\w.-])({names})=", lambda m: flags[m[1]], message)


def _flags(given: Sequence[str]) -> dict[str, str]:
    """The option that sets each argument of the command.

    If two options have one name (``--spacing`` of the file, ``--to-spacing`` of the result), it is the one that was given; none if
    both were.
    """
    try:
        command, *_ = app.parse_commands(given)
        arguments = app[command[0]].assemble_argument_collection() if command else ()
    except (CycloptsError, KeyError):
        return {}
    found: dict[str, list[str]] = {}
    for argument in arguments:
        flag = next((n for n in argument.names if n.startswith("--")), "")
        if flag and argument.field_info.name:
            found.setdefault(argument.field_info.name.removeprefix("to_"), []).append(flag)
    used = {token.partition("=")[0] for token in given}
    for flags in found.values():
        flags[:] = [flag for flag in flags if flag in used] or flags
    return {name: flags[0] for name, flags in found.items() if len(flags) == 1}
