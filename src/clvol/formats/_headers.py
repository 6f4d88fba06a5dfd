"""Text headers of MetaImage and NRRD, read within limits."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import FormatError
from clvol.base.files import MAX_HEADER
from clvol.formats.guarded.limits import is_trusted

__all__ = ["data_files", "line", "numbers", "parsed", "samples_each", "whole"]

_MAX_LINE = 1 << 16
_LARGEST = 1e30
_PATTERN = re.compile(r"([^%]*)%(0?\d{0,2})[diu]([^%]*?)\s+(-?\d{1,9})\s+(-?\d{1,9})\s+(-?\d{1,9})(?:\s+\d+)?", re.ASCII)
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


def parsed(name: str, what: str, text: str | bytes, dtype: np.dtype[Any], count: int) -> NDArray[Any]:
    """`count` samples that are given as text, between blanks; `what` names them for an error."""
    try:
        if dtype.kind in "iu":  # NumPy parses numbers of 64 bits modulo 2⁶⁴
            values = np.array(list(map(int, text.split()))) if dtype.itemsize > 4 else _from_text(text, np.int64)
            limits = np.iinfo(dtype)
            if values.size and not limits.min <= int(values.min()) <= int(values.max()) <= limits.max:
                raise ValueError(f"they reach from {values.min()} to {values.max()}")
        else:
            values = _from_text(text, np.float64)
    except (ValueError, DeprecationWarning) as error:
        raise FormatError(f"{name} must hold numbers of {dtype} in {what}; {error}") from error
    if len(values) != count:
        raise FormatError(f"{name} must hold {count} numbers in {what}; found {len(values)}")
    return values.astype(dtype)


def _from_text(text: str | bytes, kind: type[np.generic]) -> NDArray[Any]:
    if not text.strip():
        return np.empty(0, kind)
    with warnings.catch_warnings(action="error"):  # of what is no number
        return np.fromstring(text, kind, sep=" ")


def samples_each(name: str, size: Sequence[int], files: int) -> int:
    """Samples in each of several files, which hold as many as each other."""
    each, rest = divmod(math.prod(size), files)
    if rest:
        raise FormatError(f"{name} must divide {' × '.join(map(str, size))} samples evenly among its files; it names {files}")
    return each


def data_files(header: Path, text: str, stream: IO[bytes], most: int) -> list[Path]:
    """The files with the samples of a detached header, which must lie in its folder or below; up to `most`.

    `text` names one, or a range of numbers in a printf pattern ("slice%03d.raw 1 20 1"), or says LIST: names follow in `stream`.
    Otherwise a hostile header could have any file of this machine read and shown. A trusted header may name any file.
    """
    if re.fullmatch(r"LIST(\s+\d+D?)?", text, re.IGNORECASE):
        names = [name for one in iter(lambda: line(stream, header.name), None) if (name := one.strip())]
    elif "%" in text:
        names = _numbered(header.name, text, most)
    else:
        names = [text]
    if not 0 < len(names) <= most:
        raise FormatError(f"{header.name} must name one to {most} files for its samples; it names {len(names)}")
    return [_data_file(header, name) for name in names]


def _numbered(name: str, text: str, most: int) -> list[str]:
    """The file names of a pattern with one whole number."""
    match = _PATTERN.fullmatch(text)
    first, last, step = (int(match[group]) for group in (4, 5, 6)) if match else (0, 0, 0)
    numbers = range(first, last + (1 if step > 0 else -1), step) if step else range(0)
    if match is None or not 0 < len(numbers) <= most:
        raise FormatError(
            f"{name} must name files for its samples as 'slice%03d.raw FIRST LAST STEP', up to {most} of them; got {text[:80]!r}"
        )
    return [f"{match[1]}{number:{match[2]}d}{match[3]}" for number in numbers]


def _data_file(header: Path, text: str) -> Path:
    if not text or text == "-":  # ITK reads "-" from the terminal
        raise FormatError(f"{header.name} must name a file with its samples; got {text[:80]!r}")
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
