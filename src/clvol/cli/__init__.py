"""The ``clvol`` command: pictures, comparisons, resampling, and what is installed.

Exit codes: 0 done, 1 the request failed (the reason is on standard error), 2 the command line is wrong,
130 interrupted.
"""

from __future__ import annotations

from clvol.cli import ahead as ahead  # before all that takes long to import

# isort: split
import io
import os
import sys
import warnings
from collections.abc import Sequence
from typing import Any, NoReturn

from cyclopts import CycloptsError

from clvol.base.errors import ClvolError, ClvolWarning
from clvol.base.interrupted import at_the_end, only_our_lines
from clvol.base.printable import printable
from clvol.cli import files, lists, pages, pictures, view
from clvol.cli.root import app
from clvol.cli.speech import one_line
from clvol.cli.words import in_the_shell, of_the_command_line

__all__ = ["app", "files", "lists", "main", "pages", "pictures", "view"]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command. User errors are printed on one line, without a traceback."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # a terminal without a degree sign still shows the numbers
    only_our_lines()
    given = sys.argv[1:] if arguments is None else list(arguments)
    try:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("always", ClvolWarning)
                warnings.showwarning = _warning_printer(given, warnings.showwarning)
                app(given, exit_on_error=False, print_error=False)
        except Exception as error:
            if _caused_by_interrupt(error):
                raise KeyboardInterrupt from error
            raise
        finally:
            at_the_end()
            sys.stdout.flush()  # here, so that we handle its errors: the command may raise SystemExit
    except CycloptsError as error:
        _fail(of_the_command_line(error), 2)
    except ClvolError as error:
        _fail(in_the_shell(error, given), 1)
    except MemoryError as error:
        _fail(f"out of memory: {one_line(error)}", 1)
    except BrokenPipeError:  # the reader of our output closed it
        _discard_output()
        raise SystemExit(0) from None
    except OSError as error:
        _fail(one_line(error), 1)
    except KeyboardInterrupt:
        _fail("interrupted", 130)


def _warning_printer(given: Sequence[str], otherwise: Any) -> Any:
    """A `warnings.showwarning` that prints each of clvol's warnings once, in the shell's terms; `otherwise` prints the rest."""
    printed = set()

    def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        if issubclass(category, ClvolWarning):
            line = f"clvol: note: {in_the_shell(message, given)}"
            if line not in printed:  # as for each picture of a movie
                printed.add(line)
                print(line, file=sys.stderr)
        else:
            otherwise(message, category, *where, **more)

    return show


def _caused_by_interrupt(error: BaseException) -> bool:
    """Whether it was raised while an interrupt propagated, for example by a file that had just been closed."""
    before = error.__context__
    return before is not None and (isinstance(before, KeyboardInterrupt) or _caused_by_interrupt(before))


def _discard_output() -> None:
    """Discard buffered output if standard output cannot be written: Python would try again at exit."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _fail(reason: str, code: int) -> NoReturn:
    at_the_end(code)
    _discard_output()
    print(f"clvol: {printable(reason)}", file=sys.stderr)  # the command line is repeated in it
    raise SystemExit(code) from None
