"""What ``clvol view`` waits for, begun before the command imports its parts, which takes half a second: the process that reads.

Imported before all else, and by itself without effect unless this process is that command.
"""

from __future__ import annotations

import os
import sys

from clvol.base.interrupted import is_the_command

__all__ = ["begin"]


def begin(arguments: list[str]) -> None:
    """Start what will read the first of the arguments that is a file or a folder."""
    # the matrices of filters are small: threads that NumPy starts for them only spin on cores that others need now
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from clvol.formats import begin_to_read

    source = next((name for name in arguments if not name.startswith("-") and os.path.exists(name)), None)  # noqa: PTH110  # a text
    if source is not None:
        begin_to_read(source)


if is_the_command() and sys.argv[1:2] == ["view"]:
    begin(sys.argv[2:])
