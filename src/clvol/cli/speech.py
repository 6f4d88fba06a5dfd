"""The output of the commands, for people and for programs, and checks of where results go."""

from __future__ import annotations

import json
import math
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

import clvol
from clvol.base.files import require_folder, require_suffix
from clvol.base.printable import printable
from clvol.filter.filter import Filter
from clvol.volume.smoothing import choose

if TYPE_CHECKING:
    from clvol.cli._preview import Preview

__all__ = ["filter_text", "one_line", "print_json", "progress", "range_text", "require_picture", "require_writable", "say", "table"]

# -- where results go ----------------------------------------------------------------------------------------


def require_picture(output: Path) -> None:
    from clvol.show.picture import SUFFIXES

    require_writable(output, SUFFIXES, "pictures")


def require_writable(output: Path, suffixes: Sequence[str], what: str) -> None:
    """Raise, before hours of work, if `output` has no suffix of that kind, or cannot be written."""
    require_suffix(output, suffixes, what)
    require_folder(output)


# -- speaking ------------------------------------------------------------------------------------------------


@contextmanager
def progress(what: str, quiet: bool, *, preview: bool = False) -> Iterator[Preview | Callable[[float], None] | None]:
    """A progress bar on standard error if that is a terminal, else None.

    With `preview` it is a `Preview`, which shows pictures too, if the terminal can show them.
    """
    if quiet or not sys.stderr.isatty():
        yield None
        return
    if preview:
        from clvol.cli._preview import Preview, console

        if (terminal := console()) is not None:
            with Preview(what, terminal) as shown:
                yield shown
            return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=1.0)
        yield lambda done: bar.update(task, completed=done)


def say(as_json: bool, what: dict[str, Any], lines: Sequence[str] = ()) -> None:
    """Print results, as JSON or as text; in text, `lines` replace the values that are tables."""
    if as_json:
        print_json(what)
        return
    for line in lines:
        print(printable(line))
    for key, value in what.items():
        if not (lines and isinstance(value, list)) and value != "":
            print(f"{key.replace('_', ' ')}: {text(value)}")


def filter_text(row: Filter, given: str | None, volume: clvol.Volume | clvol.LazyVolume) -> str:
    """A filter as text: its smoothing, and the reason if that was chosen for the volume."""
    if not row.smoothing:
        return row.name
    values = row.smoothing if isinstance(row.smoothing, tuple) else (row.smoothing,)
    text = f"{row.name.partition('(')[0]}, λ = {', '.join(map(str, values))}"
    if given is not None and "auto" not in given:
        return text
    if given is None and volume.bounds is not None:
        return f"{text} (the filter of the bounds in the store)"
    return f"{text} ({choose(volume.part(), row.degree).reason})"


def range_text(low: float, high: float) -> str:
    """The ends of a range as text: integers in full, others to six digits of the range, even far from zero."""
    if isinstance(low, int):
        return f"{low} {high}"
    span, largest = high - low, max(abs(low), abs(high))
    more = math.ceil(math.log10(largest) - math.log10(span)) if 0 < span < largest else 0
    return " ".join(f"{v:.{min(6 + more, 17)}g}" for v in (low, high))


def text(value: Any) -> str:
    """A value as text: numbers to six digits, lists separated by blanks, rows by commas."""
    if value is None or isinstance(value, bool):
        return {None: "none", True: "yes", False: "no"}[value]
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list):
        return (", " if any(isinstance(v, list) for v in value) else " ").join(map(text, value))
    return printable(str(value))


def print_json(value: Any) -> None:
    print(json.dumps(value, indent=2, default=str, allow_nan=False))


def table(header: list[str], rows: list[list[str]]) -> None:
    """Print a table; on a narrow terminal its cells are wrapped, or each row becomes a paragraph."""
    rows = [list(map(printable, row)) for row in rows]
    cells = [header, *rows]
    columns = list(zip(*cells, strict=True))
    widths = [max(map(len, column)) for column in columns]
    words = [max((len(word) for cell in column for word in cell.split()), default=0) for column in columns]
    whole = room = shutil.get_terminal_size().columns if sys.stdout.isatty() else math.inf
    gap = 2 if sum(words) + 2 * (len(words) - 1) <= room else 1
    room -= gap * (len(words) - 1)
    while sum(widths) > room and widths != words:  # the column with the most to spare
        spare = [width - word for width, word in zip(widths, words, strict=True)]
        widths[spare.index(max(spare))] -= 1
    if sum(widths) > room:
        for first, *others in rows:
            lines = [f"  {name}: {cell}" for name, cell in zip(header[1:], others, strict=True) if cell]
            shown = [textwrap.fill(line, int(whole), subsequent_indent="    ", break_on_hyphens=False) for line in lines]
            print(f"{header[0]} {first}", *shown, sep="\n")
        return
    for row in cells:
        folded = [textwrap.wrap(cell, width, break_on_hyphens=False) for cell, width in zip(row, widths, strict=True)]
        for line in zip_longest(*folded, fillvalue=""):
            print((" " * gap).join(part.ljust(width) for part, width in zip(line, widths, strict=True)).rstrip())


def one_line(error: BaseException | str) -> str:
    return printable(" ".join(str(error).split())) or type(error).__name__
