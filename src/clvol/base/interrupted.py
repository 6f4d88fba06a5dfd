"""Handle Ctrl-C while the command is still importing, which takes a second: print one line, as `clvol.cli.main` does later.

Import this first. It has no effect unless this process is the command.
"""

from __future__ import annotations

import os
import sys
from itertools import pairwise
from types import TracebackType

__all__ = ["excepthook", "is_the_command"]


def is_the_command() -> bool:
    """Whether this process is the command ``clvol``, rather than a program that imports it."""
    started = getattr(sys, "orig_argv", [])
    as_module = any(pair == ("-m", "clvol") for pair in pairwise(started))
    script = started[1].replace("\\", "/").rpartition("/")[2] if len(started) > 1 else ""
    return as_module or script in ("clvol", "clvol.exe", "clvol-script.py")


def excepthook(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """`sys.excepthook` of the command: on an interrupt, print one line and exit with code 130."""
    if not issubclass(kind, KeyboardInterrupt):
        sys.__excepthook__(kind, error, trace)
        return
    print("clvol: interrupted", file=sys.stderr, flush=True)
    os._exit(130)


if is_the_command():
    sys.excepthook = excepthook
