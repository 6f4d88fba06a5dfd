"""Errors and warnings, translated from Python's terms into the shell's; only this module knows both."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from cyclopts import CycloptsError, MissingArgumentError, UnknownCommandError, UnknownOptionError, UnusedCliTokensError

from clvol.base.checks import did_you_mean, meant_by
from clvol.base.errors import DataError
from clvol.cli.root import app
from clvol.cli.speech import one_line

__all__ = ["in_the_shell", "of_the_command_line"]

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
    (r"clvol\.images resamples, zooms and rotates images", "'clvol resample' and 'clvol convert' take images"),
    (r"size=\(width, height\)", "--size WIDTH HEIGHT"),
    (r"Volume\(\.\.\., labels=True\) says", "a table of them, --labels FILE, says"),
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
        message = re.sub(
            rf"^({names})(?= (?:must|is no option|is only|is for values|changes nothing)\b)", lambda m: flags[m[1]], message
        )
    message = re.sub(rf"(?<![\w.-])({names})=(?=[\w(\"'\[])", lambda m: f"{flags[m[1]]} ", message)
    return re.sub(rf"(?<![\w.-])({names})=", lambda m: flags[m[1]], message)


def of_the_command_line(error: CycloptsError) -> str:
    """What is wrong with a command line, on one line."""
    command = " ".join(("clvol", *(error.command_chain or ())))
    tokens = error.unused_tokens or []
    if isinstance(error, UnknownCommandError):
        return _unknown_command(tokens[0] if tokens else "")
    if isinstance(error, UnknownOptionError):
        text = _unknown_option(command, error.token.keyword or error.token.value)
    elif isinstance(error, MissingArgumentError) and error.argument is not None:
        known = [*_options(error.command_chain or ()), *error.argument.names]
        unknown = [token for token in tokens if token.startswith("--") and token.partition("=")[0] not in known]
        text = _unknown_option(command, unknown[0]) if unknown else _missing(command, error)  # perhaps it was meant
    elif isinstance(error, UnusedCliTokensError) and tokens:
        text = f"'{command}' takes no more than its arguments and options; {tokens[0]!r} belongs to none"
    else:
        text = one_line(error).rstrip(".")
    return f"{text}; see '{command} --help'"


def _unknown_command(token: str) -> str:
    known = [name for name in app if not name.startswith("-") and app[name].show]
    if token.startswith("phantom:") or "://" in token or Path(token).suffix or Path(token).exists():
        name = one_line(token)
        return (
            f"a command must come before {name}: 'clvol view {name}', 'clvol info {name}' or 'clvol render {name} -o picture.png', "
            "for example; see 'clvol --help'"
        )
    return f"unknown command \"{token}\"{did_you_mean(token, known)}; commands are {', '.join(sorted(known))}: see 'clvol --help'"


def _unknown_option(command: str, token: str) -> str:
    flag = token.partition("=")[0]
    flags = {name.removeprefix("--").replace("-", "_"): name for name in _options(command.removeprefix("clvol").split())}
    meant = meant_by(flag.lstrip("-").replace("-", "_"), flags)
    for phrase, words in _PHRASES:
        meant = re.sub(phrase, words, meant)
    hint = f" (did you mean {flags.get(meant, meant)}?)" if meant else ""
    return f"unknown option {flag}{hint}"


def _options(command: Sequence[str]) -> list[str]:
    """The options of a command that its help shows."""
    arguments = app[command[0]].assemble_argument_collection() if command else ()
    return [name for one in arguments for name in one.names if name.startswith("--") and not name.startswith("--empty-")]


def _missing(command: str, error: MissingArgumentError) -> str:
    """Which argument is missing, or has too few values, and what it means."""
    argument, given = error.argument, error.tokens_so_far
    assert argument is not None
    name = argument.name if argument.name.startswith("-") else argument.name.upper()
    short = next((f" (or {other})" for other in argument.names if other.startswith("-") and not other.startswith("--")), "")
    about = (argument.parameter.help or "").partition(". ")[0].rstrip(".")
    what = f": {about[:1].lower()}{about[1:]}" if about else ""
    count, _ = argument.token_count()
    if given or any(token.partition("=")[0] in argument.names for token in error.root_input_tokens or ()):
        number = f"{count} values" if count > 1 else "a value"
        return f"{name} takes {number}{what}; got {' '.join(given) or 'none'}"
    return f"'{command}' needs {name}{short}{what}"


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
