"""Errors of the libraries that read files, as errors of clvol."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from clvol.base.errors import ClvolError, ClvolWarning, FormatError

__all__ = ["foreign_errors"]


@contextmanager
def foreign_errors(what: str, reason: Callable[[Exception], str] = str) -> Iterator[None]:
    """Turn what a library raises into a `FormatError` that says what was being done."""
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # absurd numbers are refused later
            yield
    except (ClvolError, ClvolWarning, MemoryError):
        raise  # sizes were checked before: a MemoryError is the machine's, not the file's
    except Exception as error:
        raise FormatError(f"cannot {what}: {reason(error) or type(error).__name__}") from error
