"""Results that are too large for a page's socket: on disk until the page has fetched them by a request of its own."""

from __future__ import annotations

import asyncio
import contextlib
import os
import secrets
import shutil
import tempfile
import threading
from pathlib import Path

from aiohttp import web

from clvol.base.errors import DataError
from clvol.view.background import in_thread

__all__ = ["Downloads", "sent"]

_CHUNK = 1 << 20  # bytes


class Downloads:
    """The results of one client; each is given once, and then deleted, as all are by `close`."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._paths: dict[str, Path] = {}
        self._closed = False

    def keep(self, data: bytes) -> str:
        """Write bytes to a file; returns the name under which `sent` finds it. Raises `DataError` if there is no room."""
        if shutil.disk_usage(tempfile.gettempdir()).free < 2 * len(data):
            raise DataError(f"there is no room for {len(data) >> 20} MiB where clvol runs")
        number, path = tempfile.mkstemp(prefix="clvol-")
        with os.fdopen(number, "wb") as file:
            file.write(data)
        name = secrets.token_urlsafe()
        with self._lock:
            self._paths[name] = Path(path)
        if self._closed:
            self.close()
        return name

    def take(self, name: str) -> Path | None:
        """The file of a name, which nobody gets after this; None if it is not here."""
        with self._lock:
            return self._paths.pop(name, None)

    def close(self) -> None:
        """Delete what was not fetched."""
        self._closed = True
        with self._lock:
            paths, self._paths = list(self._paths.values()), {}
        for path in paths:
            with contextlib.suppress(OSError):
                path.unlink()


async def sent(request: web.BaseRequest, path: Path, headers: dict[str, str], stuck: float) -> web.StreamResponse:
    """Answer with a file, which is deleted; `stuck` are seconds within which a part must be received."""
    response = web.StreamResponse(headers={**headers, "Content-Type": "application/octet-stream"})
    try:
        response.content_length = path.stat().st_size
        await response.prepare(request)
        with path.open("rb") as file:
            while chunk := await in_thread(lambda: file.read(_CHUNK), "a file"):
                async with asyncio.timeout(stuck):
                    await response.write(chunk)
        await response.write_eof()
    except TimeoutError:  # the page sees that it is cut off
        if request.transport is not None:
            request.transport.abort()
    finally:
        path.unlink(missing_ok=True)
    return response
