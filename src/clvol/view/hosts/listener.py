"""Connections of the viewer's server: what of a request is ever logged, and what answers those that are no proper requests.

aiohttp logs tracebacks of these, with the line that was too long: an address with its token, or cookies, also of other programs.
"""

from __future__ import annotations

import asyncio
import logging
import traceback
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from aiohttp import web

__all__ = ["Listener"]

_LOG = logging.getLogger(__name__)
_LONGEST_LINE, _LONGEST_FIELD = 4096, 8190  # bytes of a request's address, and of one of its headers
_KEPT_ALIVE = 15  # seconds between requests of a connection
_BAD = (
    f"this is no proper request, or it is too long: an address has at most {_LONGEST_LINE} bytes, and a header {_LONGEST_FIELD}; "
    "if the browser has many cookies for this machine's name, delete them, or open the address in a private window"
)


class _Connection(web.RequestHandler):
    """One connection; it logs what kind of fault there was, and where, but nothing that came."""

    def __init__(self, listener: Listener, respond: Callable[[str, int], web.Response], **options: Any) -> None:
        super().__init__(listener, **options)
        self._respond = respond

    def handle_error(
        self,
        request: web.BaseRequest,
        status: int = 500,
        exc: BaseException | None = None,
        message: str | None = None,  # noqa: ARG002  # it cites the request
    ) -> web.StreamResponse:
        """The answer to what is no request, and to one at which this server failed."""
        kind = "" if exc is None else type(exc).__name__
        if status < 500:  # the client's
            _LOG.debug("not a proper request from %s: %s", request.remote, kind)
        else:
            _LOG.error("a request failed: %s\n%s", kind, _frames(exc))
        response = self._respond(_BAD if status < 500 else "clvol failed at this request", status)
        response.force_close()
        return response

    def log_exception(self, *args: Any, **more: Any) -> None:
        exc = more.get("exc_info")
        _LOG.error("%s: %s\n%s", args[0] if args else "", type(exc).__name__, _frames(exc))

    def log_debug(self, *args: Any, **more: Any) -> None:  # noqa: ARG002  # with the exception
        _LOG.debug("%s", args[0] if args else "")


def _frames(exc: Any) -> str:
    """Where an error came from, without its words."""
    return "".join(traceback.format_tb(exc.__traceback__)) if isinstance(exc, BaseException) else ""


class Listener(web.Server):
    """Makes a connection of whatever asks for one.

    Parameters
    ----------
    answer : callable
        Answers a request.
    respond : callable
        ``respond(words, status)`` is the answer to what is none.
    """

    def __init__(
        self, answer: Callable[[web.BaseRequest], Awaitable[web.StreamResponse]], respond: Callable[[str, int], web.Response]
    ) -> None:
        self._options: Mapping[str, Any] = {
            "access_log": None,
            "keepalive_timeout": _KEPT_ALIVE,
            "max_line_size": _LONGEST_LINE,
            "max_field_size": _LONGEST_FIELD,
        }
        super().__init__(answer, **self._options)
        self._respond = respond

    def __call__(self) -> web.RequestHandler:
        return _Connection(self, self._respond, loop=asyncio.get_running_loop(), **self._options)
