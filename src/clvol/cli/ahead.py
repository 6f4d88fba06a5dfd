"""Starts the process that reads files for ``clvol view`` while the command imports its modules, which takes half a second.

Imported before everything else; the import has no effect unless this process is that command.
"""

from __future__ import annotations

import os
import sys

from clvol.base.interrupted import is_the_command

__all__ = ["begin"]


def begin(arguments: list[str]) -> None:
    """Start reading the first argument that is a file or a folder."""
    # filters' matrices are small: NumPy's threads would only spin on cores that are needed now
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from clvol.formats import begin_to_read

    source = next((name for name in arguments if not name.startswith("-") and os.path.exists(name)), None)  # noqa: PTH110  # a text
    if source is not None:
        begin_to_read(source)


if is_the_command() and sys.argv[1:2] == ["view"]:
    begin(sys.argv[2:])
