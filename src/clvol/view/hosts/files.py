"""Files that a page opens as layers: those below one folder of the server's user, and those that a browser sends."""

from __future__ import annotations

import asyncio
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clvol.base.errors import ClvolError, DataError, OptionError
from clvol.formats import raw, read_all
from clvol.formats.guarded.limits import MORE
from clvol.formats.table import FORMATS
from clvol.view.background import in_thread
from clvol.view.hosts.access import Refused
from clvol.view.hosts.outbox import Limits

if TYPE_CHECKING:
    from aiohttp import web

__all__ = ["Files"]

_SUFFIXES = tuple(sorted({suffix for row in FORMATS if row.read is not raw.read for suffix in row.suffixes}))
"""Not those of raw samples, which are a volume with a shape alone, and a page has none to give."""
_LISTED = 500  # files
_VISITED = 20_000  # entries of folders that are looked at
_DEEP = 4  # folders below the first
_RECENT = 8
_CHUNK = 1 << 18  # bytes
_NAME = re.compile(r"[^\W_][\w .,+()=-]{0,127}")  # begins with a letter or a digit: no path, nothing hidden, no option
_SENT_AS = "application/octet-stream"  # of which browsers ask leave, which other sites never get


class Files:
    """Reads files for a view; one at a time.

    Nothing outside `folder` is listed or opened, links that lead out of it included. What a browser sends is in a folder of its own
    while it is read, and then gone.
    """

    def __init__(self, folder: str | os.PathLike[str] | None, limits: Limits) -> None:
        self._folder, self._limits = None if folder is None else Path(folder).resolve(), limits
        if self._folder is not None and not self._folder.is_dir():
            raise OptionError(f"folder must be a folder, whose volumes the page may open; got {str(folder)!r}")
        self._recent: list[str] = []
        self._reading = False

    async def listed(self) -> dict[str, Any]:
        """The names of files that can be opened, and those that were opened last."""
        names = [] if self._folder is None else await in_thread(partial(_below, self._folder), "a file")
        folder = None if self._folder is None else self._folder.name
        return {"folder": folder, "files": names, "recent": self._recent}

    async def opened(self, request: web.BaseRequest, view: Any) -> dict[str, Any]:
        """Show a file of the folder, by its name in `listed`."""
        name = request.query.get("name", "")
        path = self._path_of(name)
        with self._one():
            await in_thread(lambda: _shown(view, path, name, f"clvol.read({str(path)!r})"), "a file")
        self._recent = [name, *(one for one in self._recent if one != name)][:_RECENT]
        return {"opened": name}

    async def received(self, request: web.BaseRequest, view: Any) -> dict[str, Any]:
        """Show a file that is the body of a request."""
        name = request.query.get("name", "")
        if not _NAME.fullmatch(name) or not name.lower().endswith(_SUFFIXES):
            raise Refused(400, f"the name of a file must be plain and end in one of {' '.join(_SUFFIXES)}; got {name[:80]!r}")
        if request.headers.get("Content-Type") != _SENT_AS or "Content-Encoding" in request.headers:
            raise Refused(415, f"a file must be sent as {_SENT_AS}, without a coding of its own")
        length, most = request.content_length, self._limits.upload
        if length is None:
            raise Refused(411, "the length of a file must be said first")
        if length > most:
            raise Refused(
                413, f"a file must have at most {most >> 20} MiB to be sent; got {-(-length >> 20)}: open it from the folder"
            )
        with self._one(), tempfile.TemporaryDirectory(prefix="clvol-", ignore_cleanup_errors=True) as folder:
            if shutil.disk_usage(folder).free < 2 * length:
                raise Refused(507, "there is no room for the file where clvol runs")
            path = Path(folder).resolve() / name
            await self._saved(request, path, length)
            with _as_sent(path):
                await in_thread(lambda: _shown(view, path, name, f"clvol.read({name!r})"), "a file")
        return {"opened": name}

    async def _saved(self, request: web.BaseRequest, path: Path, length: int) -> None:
        got = 0
        with path.open("xb") as file:
            while True:
                try:
                    async with asyncio.timeout(self._limits.stuck):
                        chunk = await request.content.read(_CHUNK)
                except TimeoutError:
                    raise Refused(408, "the file came too slowly") from None
                if not chunk:
                    break
                got += len(chunk)
                if got > length:
                    raise Refused(400, "the file is longer than was said")
                await in_thread(partial(file.write, chunk), "a file")
        if got != length:
            raise Refused(400, "the file was cut off on its way")

    def _path_of(self, name: str) -> Path:
        """The file of this name below the folder."""
        folder, parts = self._folder, name.split("/")
        if folder is not None and not any(part in ("", "..") or part.startswith(".") or "\\" in part for part in parts):
            try:
                path = (folder / name).resolve()
                if path.is_relative_to(folder) and path.is_file() and name.lower().endswith(_SUFFIXES):
                    return path
            except (OSError, ValueError):  # too long, or with a NUL
                pass
        raise Refused(404, "there is no such volume in the folder")

    @contextmanager
    def _one(self) -> Iterator[None]:
        if self._reading:
            raise Refused(429, "another file is being read")
        self._reading = True
        try:
            yield
        finally:
            self._reading = False


@contextmanager
def _as_sent(path: Path) -> Iterator[None]:
    """Have errors tell the name of a file that was sent, not where it is for now; nor options, which a page has not."""
    try:
        yield
    except (ClvolError, OSError) as error:
        words = str(error).replace(str(path), path.name).replace(str(path.parent), "its folder")
        raise DataError(words.removesuffix(f"; {MORE}")) from error


def _shown(view: Any, path: Path, name: str, source: str) -> None:
    """Add a file's volume, or its channels, to the layers."""
    found = read_all(path)
    several = len(found) > 1 and bool(found.colors)
    data = found if several else found.first
    view.layers.add(data, name=None if several or found.first.name else Path(name).name, source=None if len(found) > 1 else source)


def _below(folder: Path) -> list[str]:
    """Files below a folder whose suffix is that of a volume; of many the first."""
    names: list[str] = []
    visited = 0
    for place, folders, files in os.walk(folder):
        here = Path(place).relative_to(folder)
        visited += len(folders) + len(files)
        folders[:] = sorted(one for one in folders if not one.startswith(".")) if len(here.parts) < _DEEP else []
        names += [
            (here / one).as_posix()
            for one in sorted(files)
            if not one.startswith(".")
            and one.lower().endswith(_SUFFIXES)
            and (folder / here / one).resolve().is_relative_to(folder)
        ]
        if len(names) >= _LISTED or visited >= _VISITED:
            break
    return names[:_LISTED]
