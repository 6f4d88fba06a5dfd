"""A view as a page of a web server: the page's files, and a websocket for each client.

By default it listens on this machine only. Clients prove that they may look by a random token, once, then by a secret
(`clvol.view.hosts.greeting`); the page's own files hold nothing that is not in the package. No path of a request is opened: there
is a table of these files, and volumes come from one folder that the server's user gave, or from a browser
(`clvol.view.hosts.files`).

On the wire each message is one JSON text; where bytes follow it, it says how many (``"bytes"``), and they are the next message.

One client costs no more than its share (`clvol.view.hosts.outbox`): messages are read at a limited rate, what waits for a slow
client is bounded, idle ones are disconnected.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import socket
import ssl
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Self

from clvol.base.checks import whole
from clvol.base.errors import ClvolError, MissingDependencyError, OptionError
from clvol.view.background import in_thread, started
from clvol.view.hosts.access import Access, Refused, is_any, is_loopback
from clvol.view.hosts.assets import asset
from clvol.view.hosts.files import Files
from clvol.view.hosts.outbox import Limits, Outbox, Rate
from clvol.view.protocol import Message, Receiver, SessionFactory, status

try:
    from aiohttp import WSCloseCode, WSMsgType, web

    from clvol.view.hosts.downloads import Downloads, sent
    from clvol.view.hosts.greeting import Greeter
    from clvol.view.hosts.listener import Listener
except ImportError as missing:
    raise MissingDependencyError('the viewer\'s page needs aiohttp, which is not installed: pip install "clvol[view]"') from missing

__all__ = ["Limits", "Server", "Serving", "serve"]

_IDLE, _FAILED = 4000, 4001  # close codes that an application may define
_FAREWELL = 0.4  # seconds that a client has to answer when it is disconnected
_PORTS = 5  # tries to find a port that is free for all families of addresses
_PAUSE = 0.05  # seconds between checks whether the server has ended


# -- one client ------------------------------------------------------------------------------------------------


class _Client:
    """A websocket and its session."""

    def __init__(self, server: Server, socket: web.WebSocketResponse) -> None:
        self._server, self._socket, self._limits = server, socket, server.limits
        self.downloads = Downloads()
        self._outbox = Outbox(asyncio.get_running_loop(), server.limits, self.downloads.keep)
        self._session: Receiver | None = None
        self._making: asyncio.Future[Receiver] | None = None
        self._early: deque[Message] = deque(maxlen=64)  # sent before there was a session
        self._last = time.monotonic()
        self._ended: tuple[int, str] | None = None

    async def run(self) -> None:
        """Until the client is gone or disconnected."""
        tasks = [asyncio.ensure_future(part) for part in (self._read(), self._write(), self._open(), self._watch())]
        try:
            await asyncio.wait([tasks[0], tasks[1], tasks[3]], return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._outbox.close()
            await in_thread(self.downloads.close, "deleting files")
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            code, reason = self._ended or (WSCloseCode.OK, "")
            with contextlib.suppress(Exception):
                await asyncio.wait_for(self._socket.close(code=code, message=reason.encode()[:120]), _FAREWELL)
            if self._making is not None:  # a client may be gone before its session is there
                with contextlib.suppress(Exception):
                    session: Receiver = await self._making
                    await in_thread(session.close, "closing a view")

    def end(self, code: int, reason: str) -> None:
        """Disconnect it."""
        self._ended = self._ended or (code, reason)
        self._outbox.close()

    async def _open(self) -> None:
        """Open the session, as soon as there is a view; the client gets an error that prevents it, and stays."""
        if not self._server.opened.done():
            self._outbox.put(status(self._server.doing, "busy"))
        try:
            view = await asyncio.shield(self._server.opened)
            self._making = asyncio.ensure_future(in_thread(lambda: view.session(self._outbox.put), "a view"))
            session = await asyncio.shield(self._making)
        except Exception as error:
            self._outbox.put(status(said(error), "error"))
            return
        while self._early:
            self._pass(session, self._early.popleft())
        self._session = session

    async def _read(self) -> None:
        rate, since = Rate(self._limits.rate, self._limits.burst), 0.0
        async for got in self._socket:
            if got.type is not WSMsgType.TEXT:
                self.end(WSCloseCode.UNSUPPORTED_DATA, "messages must be JSON text")
                return
            wait = rate.take()
            if wait:
                now = time.monotonic()
                since = since or now
                if now - since > self._limits.flood:
                    self.end(WSCloseCode.POLICY_VIOLATION, f"more than {self._limits.rate:g} messages a second")
                    return
                await asyncio.sleep(wait)  # its connection fills up; others notice nothing
            elif rate.calm:
                since = 0.0
            message = parsed(got.data)
            if isinstance(message, str):
                self._outbox.put(status(message, "error"))
                continue
            if message["type"] == "ping":  # which is nothing that its user does
                self._outbox.put({"type": "pong", "working": round(getattr(self._session, "working", 0.0), 1)})
                continue
            if message["type"] != "ack":
                self._last = time.monotonic()
            if self._session is None:
                self._early.append(message)
            else:
                self._pass(self._session, message)

    def _pass(self, session: Receiver, message: Message) -> None:
        try:
            session.receive(message)
        except Exception as error:  # of one session: it must not end the server
            self._outbox.put(status(said(error), "error"))

    async def _write(self) -> None:
        while (taken := await self._outbox.take()) is not None:
            message, data = taken
            try:
                text = json.dumps(message if data is None else message | {"bytes": len(data)}, allow_nan=False)
            except (TypeError, ValueError) as error:
                text = json.dumps(status(f"a message could not be written: {error}", "error"))
                data = None
            try:
                async with asyncio.timeout(self._limits.stuck):
                    await self._socket.send_str(text)
                    if data is not None:
                        await self._socket.send_bytes(data)
            except (TimeoutError, ConnectionError):
                return
            if self._session is not None:  # a session waits for acknowledgements of dropped frames, too
                for number_ in self._outbox.take_dropped():
                    self._pass(self._session, {"type": "ack", "frame": number_, "dropped": True})
        if self._outbox.overflowed:
            self.end(WSCloseCode.TRY_AGAIN_LATER, "the connection is too slow")

    async def _watch(self) -> None:
        """End a client that is idle."""
        while (left := self._last + self._limits.idle - time.monotonic()) > 0:
            await asyncio.sleep(left)
        self.end(_IDLE, f"idle for {_duration(self._limits.idle)}")


def parsed(text: str) -> Message | str:
    """A message, or what is wrong with it."""
    try:
        message = json.loads(text, parse_constant=_no_number)
    except (ValueError, RecursionError) as error:
        return f"a message must be JSON; {type(error).__name__}: {str(error)[:80]}"
    if not isinstance(message, dict) or not isinstance(message.get("type"), str):
        return 'a message must be an object with a "type"'
    return message


def _no_number(name: str) -> float:
    raise ValueError(f"{name} is no number of JSON")


def said(error: BaseException) -> str:
    """An error in words for people; with its type if it is not one of ours."""
    words = " ".join(str(error).split())
    if isinstance(error, (ClvolError, OSError)) and words:
        return words
    if isinstance(error, MemoryError):
        return f"out of memory: {words}" if words else "out of memory"
    return f"{type(error).__name__}: {words}" if words else type(error).__name__


def _duration(seconds: float) -> str:
    return f"{seconds / 60:g} minutes" if seconds >= 60 else f"{seconds:g} s"


# -- the server ------------------------------------------------------------------------------------------------


class Server:
    """Serves a view to browsers; `start` and `stop` it in an event loop, or use `serve`.

    Parameters
    ----------
    view : View or callable
        What is shown, or a function that makes it: called in a thread, so that the page is up while a volume is still read.
    host, port : str, int
        Where to listen; port 0 is a free one.
    names : sequence of str
        Further names, with or without a port, by which browsers may reach it: those of a proxy. Its pages may come from there.
    root_path : str
        The path under which a proxy shows it, such as ``"/user/ada/clvol"``; requests may come with it or without.
    frame_ancestors : sequence of str
        Sites that may show the page in a frame; none by default.
    certificate, key : path, optional
        Serve https and wss.
    limits : Limits
        What clients may cost.
    doing : str
        A status for clients while the view is made.
    folder : path, optional
        Volumes below it may be opened by pages as further layers; none by default. What a browser sends may be shown in any case.
    """

    def __init__(
        self,
        view: SessionFactory | Callable[[], SessionFactory],
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        names: Iterable[str] = (),
        root_path: str = "",
        frame_ancestors: Iterable[str] = (),
        certificate: str | Path | None = None,
        key: str | Path | None = None,
        limits: Limits | None = None,
        doing: str = "reading the volume",
        folder: str | os.PathLike[str] | None = None,
    ) -> None:
        self.host, self.port = host, whole("port", port, minimum=0, maximum=65535)
        self.limits, self.doing = limits or Limits(), doing
        self._make = (lambda: view) if hasattr(view, "session") else view
        self._access = Access(host, names)
        self._greeter = Greeter(self._access, self.limits.upload)
        self._root = _as_root(root_path)
        self._tls = _tls(certificate, key)
        self._files, self._shelf = _static(), Files(folder, self.limits)
        self._headers = _headers([*map(_as_ancestor, frame_ancestors)])
        self._clients: set[_Client] = set()
        self._rest: asyncio.TimerHandle | None = None
        self._runner: web.ServerRunner | None = None
        self.opened: asyncio.Future[Any]

    @property
    def url(self) -> str:
        """The address with the token: whoever has it may look."""
        return f"{self.address}?token={self._access.token}"

    @property
    def elsewhere(self) -> str:
        """The address with the token, for other machines."""
        return f"{self._address(socket.gethostname() if is_any(self.host) else self.host)}?token={self._access.token}"

    def ticket(self) -> str:
        """An address that is valid once, within a minute: others on the machine can read command lines of browsers."""
        return f"{self.address}?token={self._access.ticket()}"

    @property
    def address(self) -> str:
        """The address without the token."""
        return self._address(("::1" if ":" in self.host else "127.0.0.1") if is_any(self.host) else self.host)

    def _address(self, host: str) -> str:
        bracketed = f"[{host}]" if ":" in host else host
        return f"{'http' if self._tls is None else 'https'}://{bracketed}:{self.port}{self._root}/"

    @property
    def public(self) -> bool:
        """Whether other machines reach it."""
        return not is_loopback(self.host)

    @property
    def clients(self) -> int:
        """The number of clients that are connected."""
        return len(self._clients)

    async def start(self) -> None:
        """Listen, and start to make the view."""
        self._runner = web.ServerRunner(Listener(self._answer, self._refusal), handle_signals=False, shutdown_timeout=0.2)
        await self._runner.setup()
        try:
            self.port = await self._listen(self._runner)
        except OSError as error:
            await self._runner.cleanup()
            raise OptionError(_why_not(error, self.host, self.port)) from error
        self.opened = asyncio.ensure_future(in_thread(self._make, "reading"))
        self.opened.add_done_callback(lambda made: made.cancelled() or made.exception())  # clients get the error

    async def _listen(self, runner: web.ServerRunner) -> int:
        """One port for all families of addresses of the host, also if any free one will do."""
        port = self.port
        for tries in range(_PORTS, 0, -1):
            site = web.TCPSite(runner, self.host or None, port, ssl_context=self._tls)
            try:
                await site.start()
            except OSError:
                if self.port or tries == 1:
                    raise
                port = 0  # it was free for one family only
                continue
            ports = {int(address[1]) for address in runner.addresses}
            port = ports.pop()
            if not ports or tries == 1:
                break
            await site.stop()
        return port

    async def stop(self) -> None:
        """Disconnect all clients, and stop listening."""
        self.opened.cancel()
        if self._rest is not None:
            self._rest.cancel()
        for client in [*self._clients]:
            client.end(WSCloseCode.GOING_AWAY, "clvol has ended")
        until = time.monotonic() + _FAREWELL + 0.1
        while self._clients and time.monotonic() < until:
            await asyncio.sleep(0.01)
        if self._runner is not None:
            await self._runner.cleanup()

    # -- requests --------------------------------------------------------------------------------------------

    async def _answer(self, request: web.BaseRequest) -> web.StreamResponse:
        try:
            return await self._routed(request)
        except Refused as refused:
            return self._refusal(str(refused), refused.status)

    async def _routed(self, request: web.BaseRequest) -> web.StreamResponse:
        self._access.check(request)
        path = request.rel_url.raw_path
        if self._root and (path == self._root or path.startswith(f"{self._root}/")):
            path = path[len(self._root) :]
        sends = request.method == "POST" and path in ("/open", "/upload")
        if request.method not in ("GET", "HEAD") and not sends:
            raise Refused(405, "only GET is allowed here")
        if path == "":
            return self._redirect(request)
        name = "index.html" if path == "/" else path[1:]
        if name == "ws":
            return await self._connect(request)
        if name == "files" or sends:
            self._access.check_secret(request)
            return await self._layered(request, name)
        if name == "download" and request.method == "GET":
            self._access.check_secret(request)
            return await self._downloaded(request)
        found = self._files.get(name)
        if found is None:
            raise Refused(404, "there is no such page")
        return self._response(*found)

    async def _layered(self, request: web.BaseRequest, name: str) -> web.Response:
        """List files, or show one as a layer."""
        if not self.opened.done():
            raise Refused(503, self.doing)
        try:
            view = self.opened.result()
            if not hasattr(view, "layers"):
                raise Refused(404, "this view takes no files")
            if name == "files":
                answer = await self._shelf.listed()
            else:
                answer = await (self._shelf.opened if name == "open" else self._shelf.received)(request, view)
        except Refused:
            raise
        except Exception as error:
            raise Refused(422, said(error)) from error
        return self._response(json.dumps(answer).encode(), "application/json")

    async def _downloaded(self, request: web.BaseRequest) -> web.StreamResponse:
        """A client's result, once."""
        for client in self._clients:
            if (path := client.downloads.take(request.query.get("name", ""))) is not None:
                return await sent(request, path, dict(self._headers), self.limits.stuck)
        raise Refused(404, "there is no such file, or it was fetched already")

    def _redirect(self, request: web.BaseRequest) -> web.Response:
        response = self._response(b"", "text/plain", 303)
        query = request.rel_url.raw_query_string
        response.headers["Location"] = f"{self._root or '.'}/{query and '?'}{query}"
        return response

    def _refusal(self, words: str, status: int) -> web.Response:
        return self._response(f"clvol: {words}\n".encode(), "text/plain; charset=utf-8", status)

    def _response(self, body: bytes, kind: str, status: int = 200) -> web.Response:
        return web.Response(body=body, status=status, headers={**self._headers, "Content-Type": kind})

    async def _connect(self, request: web.BaseRequest) -> web.StreamResponse:
        socket = web.WebSocketResponse(
            max_msg_size=self.limits.message, compress=False, heartbeat=min(30.0, self.limits.stuck), timeout=1.0, decode_text=True
        )
        if not socket.can_prepare(request).ok:
            raise Refused(400, "this is the address of a websocket")
        socket.headers.update(self._headers)
        await socket.prepare(request)
        if not await self._greeter.admits(socket):
            return socket
        if len(self._clients) >= self.limits.clients:  # said here: pages do not learn why a handshake failed
            text = f"{self.limits.clients} pages are open, the maximum; close one"
            await socket.close(code=WSCloseCode.TRY_AGAIN_LATER, message=text.encode())
            return socket
        await self._greeter.welcome(socket)
        client = _Client(self, socket)
        self._clients.add(client)
        try:
            await client.run()
        finally:
            self._clients.discard(client)
            if not self._clients:
                self._rest_later()
        return socket

    def _rest_later(self) -> None:
        """Free the device's memory if no client comes for as long as one may be idle."""
        if self._rest is not None:
            self._rest.cancel()
        self._rest = asyncio.get_running_loop().call_later(self.limits.idle, self._free)

    def _free(self) -> None:
        made = self.opened.done() and not self.opened.cancelled() and self.opened.exception() is None
        close = getattr(self.opened.result(), "close", None) if made else None
        if not self._clients and close is not None:
            started(close, "clvol: freeing a view")


def _static() -> Mapping[str, tuple[bytes, str]]:
    """The page's files by name, read once: requests choose only from these."""
    kinds = {"clvol.js": "text/javascript", "clvol.css": "text/css", "index.html": "text/html"}
    return {name: (asset(name).encode(), f"{kind}; charset=utf-8") for name, kind in kinds.items()}


def _headers(ancestors: list[str]) -> Mapping[str, str]:
    """The page makes no request to another machine, no other site shows it in a frame, and its address is not revealed."""
    policy = {
        "default-src": "'none'",
        "script-src": "'self'",
        "style-src": "'self'",
        "img-src": "'self' blob: data:",
        "media-src": "blob:",
        "connect-src": "'self'",
        "base-uri": "'none'",
        "form-action": "'none'",
        "frame-ancestors": " ".join(ancestors) or "'none'",
    }
    return {
        "Content-Security-Policy": "; ".join(f"{name} {value}" for name, value in policy.items()),
        "X-Content-Type-Options": "nosniff",
        "Referrer-Policy": "no-referrer",
        "Cross-Origin-Opener-Policy": "same-origin",
        "Cross-Origin-Resource-Policy": "same-origin",
        "Cache-Control": "no-store",
        "Server": "clvol",
        **({} if ancestors else {"X-Frame-Options": "DENY"}),
    }


def _as_ancestor(given: str) -> str:
    if not given or any(c in given for c in ";, \t\r\n") or not given.isascii():
        raise OptionError(f"frame_ancestors must be sites such as https://hub.example.org, or 'self'; got {given!r}")
    return "'self'" if given.strip("'") == "self" else given


def _as_root(given: str) -> str:
    root = "/" + given.strip("/") if given.strip("/") else ""
    if any(not (c.isalnum() or c in "/-._~@%+") for c in root) or not root.isascii() or ".." in root or "//" in root:
        raise OptionError(f"root_path must be a path such as /user/ada/clvol; got {given!r}")
    return root


def _tls(certificate: str | Path | None, key: str | Path | None) -> ssl.SSLContext | None:
    if certificate is None:
        if key is not None:
            raise OptionError("key is for a certificate; got a key alone")
        return None
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    try:
        context.load_cert_chain(certificate, key)
    except (OSError, ssl.SSLError) as error:
        raise OptionError(
            f"certificate must be a PEM file with its key, which may be in a file of its own; {said(error)}"
        ) from error
    return context


def _why_not(error: OSError, host: str, port: int) -> str:
    import errno

    if error.errno == errno.EADDRINUSE:
        return f"port {port} of {host} is taken; give another, or none for a free one"
    if error.errno in (errno.EACCES, errno.EPERM):
        return f"port {port} may not be listened on here; give one above 1023, or none for a free one"
    return f"host must be an address or a name of this machine; got {host!r} ({error.strerror or error})"


# -- in a thread ------------------------------------------------------------------------------------


class Serving:
    """A server that runs in a thread; also a context manager."""

    def __init__(self, server: Server) -> None:
        self._server = server
        self._ready = threading.Event()
        self._failed: BaseException | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._enough: asyncio.Event | None = None
        self._thread = threading.Thread(target=self._work, name="clvol: page", daemon=True)
        self._thread.start()
        self._ready.wait()
        if self._failed is not None:
            raise self._failed

    def _work(self) -> None:
        try:
            asyncio.run(self._run())
        except Exception as error:
            if self._ready.is_set():
                raise
            self._failed = error
        finally:
            self._ready.set()

    async def _run(self) -> None:
        self._loop, self._enough = asyncio.get_running_loop(), asyncio.Event()
        await self._server.start()
        self._ready.set()
        try:
            await self._enough.wait()
        finally:
            await self._server.stop()

    @property
    def url(self) -> str:
        """The address with the token: whoever has it may look."""
        return self._server.url

    @property
    def clients(self) -> int:
        """The number of clients that are connected."""
        return self._server.clients

    def wait(self, seconds: float | None = None) -> None:
        """Wait until it has ended, or for so many seconds."""
        until = None if seconds is None else time.monotonic() + seconds
        while self._thread.is_alive() and (until is None or time.monotonic() < until):
            self._thread.join(_PAUSE)

    def close(self) -> None:
        """Disconnect all clients, and free the port."""
        if self._loop is not None and self._enough is not None and self._thread.is_alive():
            with contextlib.suppress(RuntimeError):  # it ended just now
                self._loop.call_soon_threadsafe(self._enough.set)
        self._thread.join()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        state = self.url if self._thread.is_alive() else "ended"
        return f"<{type(self).__name__} {state}>"


def serve(view: SessionFactory | Callable[[], SessionFactory], **options: Any) -> Serving:
    """Serve a view from a thread of this process: see `clvol.view.View.serve`."""
    return Serving(Server(view, **options))


def run(server: Server, ready: Callable[[Server], None], failed: Callable[[BaseException], bool]) -> BaseException | None:
    """Serve until Ctrl-C or SIGTERM; returns the error if the view could not be made.

    `ready` is called when the server listens, `failed` when the view could not be made; it returns whether the server goes on, and
    tells its clients.
    """
    import signal

    async def main() -> BaseException | None:
        enough, loop = asyncio.Event(), asyncio.get_running_loop()
        for name in (signal.SIGINT, signal.SIGTERM):
            with contextlib.suppress(NotImplementedError, RuntimeError):  # no such handlers on Windows: KeyboardInterrupt there
                loop.add_signal_handler(name, enough.set)

        def opened(made: asyncio.Future[Any]) -> None:
            error = None if made.cancelled() else made.exception()
            if error is not None and not failed(error):
                enough.set()

        await server.start()
        try:
            server.opened.add_done_callback(opened)
            ready(server)
            await enough.wait()
            made = server.opened
            return made.exception() if made.done() and not made.cancelled() else None
        finally:
            await server.stop()

    return asyncio.run(main())
