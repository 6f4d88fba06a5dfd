"""TIFF files as tifffile opens them, after their directories and the files they name are checked; its warnings are errors."""

from __future__ import annotations

import html
import logging
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from clvol.base.errors import FormatError, MissingDependencyError
from clvol.formats._directories import Directory, directories

__all__ = ["directories_of", "opened", "require_own_files", "strict", "tifffile"]

_DECLARED = re.compile(r"<!(DOCTYPE|ENTITY)")
_NAMED = re.compile(r"""FileName\s*=\s*(?:"([^"]*)"|'([^']*)')""")
_listening = threading.local()


def tifffile() -> Any:
    try:
        import tifffile
    except ImportError as error:
        raise MissingDependencyError("TIFF files need tifffile: pip install clvol[microscopy]") from error
    return tifffile


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """The file, opened by tifffile after its directories are checked. Warnings that tifffile logs are raised."""
    library = tifffile()
    directories_of(path)
    with strict(), library.TiffFile(path) as file:
        require_own_files(path, file)
        yield file


def directories_of(path: Path) -> dict[int, Directory]:
    with path.open("rb") as stream:
        return directories(stream, path.stat().st_size, path.name)


def require_own_files(path: Path, file: Any) -> None:
    """Raise before tifffile opens files named in OME-XML: it would block on a pipe, and read any file."""
    text = file.ome_metadata or ""
    if _DECLARED.search(text):
        raise FormatError(f"{path.name} must have OME-XML without declarations of a document type or of entities")
    for name in (html.unescape(a or b) for a, b in _NAMED.findall(text)):  # escaped ones too, as &#47;
        if re.search(r"[/\\]", name) or name in ("", ".."):
            raise FormatError(f"{path.name} must name the other files of its set, beside it; got {name[:80]!r}")
        other = path.with_name(name)
        if other.exists() and (not other.is_file() or other.resolve().parent != path.resolve().parent):
            raise FormatError(f"{path.name} must name files that lie beside it; {name[:80]!r} is elsewhere, or no file")


class _Overheard:
    """Mixed into a `logging.Logger`: raises warnings in threads that listen, however the program has configured logging."""

    def isEnabledFor(self, level: int) -> bool:  # a name of logging
        heard = getattr(_listening, "heard", None) is not None and level >= logging.WARNING
        return heard or super().isEnabledFor(level)  # type: ignore[misc]  # of the logger

    def handle(self, record: logging.LogRecord) -> None:
        heard: list[FormatError] | None = getattr(_listening, "heard", None)
        if heard is None:
            super().handle(record)  # type: ignore[misc]
        elif record.levelno >= logging.WARNING:
            error = FormatError(
                f"the file is damaged or unusual: {record.getMessage()}; "
                "if you trust what tifffile makes of it, give its array to clvol.Volume"
            )
            heard.append(error)
            raise error


@contextmanager
def strict() -> Iterator[None]:
    """Raise warnings that tifffile logs: it continues after damage, and omits slices or zeroes them."""
    logger = logging.getLogger("tifffile")
    if not isinstance(logger, _Overheard):  # permanently: other threads may be listening
        logger.__class__ = type("Overheard", (_Overheard, type(logger)), {})
    before = getattr(_listening, "heard", None)
    heard: list[FormatError] = []
    _listening.heard = heard
    try:
        yield
    finally:
        _listening.heard = before
    if heard:  # tifffile caught it
        raise heard[0]
