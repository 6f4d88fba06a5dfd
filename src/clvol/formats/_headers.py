"""Text headers of MetaImage and NRRD, read within limits."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import FormatError
from clvol.base.files import MAX_HEADER
from clvol.formats.guarded.limits import is_trusted

__all__ = ["data_path", "line", "numbers", "parsed", "whole"]

_MAX_LINE = 1 << 16
_LARGEST = 1e30
_NUMBER = r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?"


def line(stream: IO[bytes], name: str) -> str | None:
    """The next line without its end; None at the end of the file."""
    raw = stream.readline(_MAX_LINE + 1)
    if len(raw) > _MAX_LINE or stream.tell() > MAX_HEADER:
        raise FormatError(f"{name} must have a header of lines up to {_MAX_LINE} bytes, {MAX_HEADER} in all")
    if b"\0" in raw:
        raise FormatError(f"{name} must have a text header; a line holds the byte 0")
    return raw.decode("utf-8", "surrogateescape").rstrip("\r\n") if raw else None


def numbers(name: str, key: str, text: str, count: int, *, nan: bool = False) -> tuple[float, ...]:
    """`count` finite numbers in `text`, or also nan if `nan`. Libraries would read what they cannot parse as 0.

    Numbers are limited to `_LARGEST`, for libraries multiply them.
    """
    words = text.split()
    known = text.isascii() and all(re.fullmatch(_NUMBER, word) or (nan and word.lower() == "nan") for word in words)
    values = tuple(map(float, words)) if known else ()
    if len(values) != count or any(abs(value) > _LARGEST for value in values):
        missing = " or nan" if nan else ""
        raise FormatError(f"{name} must give {count} finite numbers{missing} up to {_LARGEST:g} for {key!r}; got {text[:80]!r}")
    return values


def whole(name: str, key: str, text: str, low: int, count: int = 1) -> tuple[int, ...]:
    """`count` whole numbers of at least `low` in `text`, of digits only, which every reader parses alike."""
    words = text.split()
    if len(words) != count or not all(word.removeprefix("-").isdecimal() and word.isascii() for word in words):
        raise FormatError(f"{name} must give {count} whole numbers for {key!r}; got {text[:80]!r}")
    values = tuple(int(word) for word in words) if all(len(word) < 19 for word in words) else (-1,)
    if min(values) < low:
        raise FormatError(f"{name} must give numbers of at least {low} for {key!r}; got {text[:80]!r}")
    return values


def parsed(name: str, what: str, words: Sequence[str | bytes], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Samples that are given as text; `what` names them for an error."""
    try:
        integers = [int(word) for word in words] if dtype.kind in "iu" else []
        if integers and not np.iinfo(dtype).min <= min(integers) <= max(integers) <= np.iinfo(dtype).max:
            raise ValueError(f"they reach from {min(integers)} to {max(integers)}")
        return np.array(integers or words).astype(dtype)
    except ValueError as error:
        raise FormatError(f"{name} must hold {what}, of {dtype}; {error}") from error


def data_path(header: Path, text: str) -> Path:
    """The file with the samples of a detached header, which must lie in the folder of the header or below.

    Otherwise a hostile header could have any file of this machine read and shown. A trusted header may name any file.
    """
    # ITK passes a pattern to sprintf, and reads "-" from the terminal.
    if not text or text == "-" or "%" in text or text.split()[0].upper() == "LIST":
        raise FormatError(f"{header.name} must name one file with all samples; got {text[:80]!r}")
    path = header.parent / text
    if not path.is_file():  # a pipe or a device would never end
        raise FormatError(f"{header.name} names the file {text[:80]!r} for its samples, which is not there")
    if path.samefile(header):
        raise FormatError(f"{header.name} must name a file with its samples; it names itself")
    if not is_trusted() and not path.resolve().is_relative_to(header.parent.resolve()):
        raise FormatError(
            f"{header.name} must name a file for its samples in its own folder or below; {text[:80]!r} is elsewhere: "
            "trusted=True reads it"
        )
    return path
