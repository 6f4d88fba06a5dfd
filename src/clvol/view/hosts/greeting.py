"""How a websocket begins: its page says a token or the secret that it got before, and gets the secret, or is refused.

`{"type": "hello", "token"?, "secret"?}` is the first message, `{"type": "welcome", "secret", "upload"}` its answer. Pages keep the
secret in the storage of their origin: browsers send cookies to all ports of a machine.
"""

from __future__ import annotations

import asyncio
import json
from typing import Any

from aiohttp import WSCloseCode, WSMsgType, web

from clvol.view.hosts.access import INVALID, Access

__all__ = ["REFUSED", "Greeter"]

REFUSED = 4003  # the close code; applications may define it
_PATIENCE = 10.0  # seconds for the first message
_STRANGERS = 32  # sockets that may be waiting for theirs


class Greeter:
    """Lets websockets in."""

    def __init__(self, access: Access, upload: int) -> None:
        self._access, self._upload = access, upload
        self._waiting = 0

    async def admits(self, socket: web.WebSocketResponse) -> bool:
        """Whether its first message proves that it may look; else it is closed."""
        self._waiting += 1
        try:
            if self._waiting > _STRANGERS:  # it may have the secret, and comes again
                await socket.close(code=WSCloseCode.TRY_AGAIN_LATER, message=b"too many pages wait to be let in")
                return False
            admitted = self._access.admits(await _first(socket))
        finally:
            self._waiting -= 1
        if not admitted:
            await socket.close(code=REFUSED, message=INVALID.encode())
        return admitted

    async def welcome(self, socket: web.WebSocketResponse) -> None:
        """Give it the secret, and the most bytes of a file that it may send."""
        await socket.send_json({"type": "welcome", "secret": self._access.secret, "upload": self._upload})


async def _first(socket: web.WebSocketResponse) -> Any:
    """The first message; None if none comes in time, or one that is no JSON."""
    try:
        async with asyncio.timeout(_PATIENCE):
            got = await socket.receive()
        return json.loads(got.data) if got.type is WSMsgType.TEXT else None
    except (TimeoutError, ValueError, RecursionError):
        return None
