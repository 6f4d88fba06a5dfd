"""The viewer's server with counting sessions only: access control, and limits on the cost of clients."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Self

import imageio.v3 as iio
import numpy as np
import pytest

import clvol
from clvol import cli
from clvol.base.errors import DeviceError, FormatError, OptionError
from clvol.device import Device

aiohttp = pytest.importorskip("aiohttp", reason="needs aiohttp")
resource = pytest.importorskip("resource", reason="needs getrusage")
from clvol.view.hosts.access import INVALID, SECRET  # noqa: E402
from clvol.view.hosts.greeting import REFUSED  # noqa: E402
from clvol.view.hosts.outbox import Outbox, Rate  # noqa: E402
from clvol.view.hosts.server import Limits, Server, Serving, parsed, serve  # noqa: E402

Message = dict[str, Any]


class Session:
    """What a view creates for a client: it records its input, and answers as the test sets."""

    def __init__(self, send: Callable[[Message, bytes | None], None]) -> None:
        self.send, self.got, self.closed = send, list[Message](), threading.Event()

    def begin(self) -> None:
        self.send({"type": "info", "title": "fake"}, None)

    def receive(self, message: Message) -> None:
        self.got.append(message)
        if message["type"] == "echo":
            self.send({"type": "reply", "id": message["id"]}, None)
        elif message["type"] == "picture":
            self.send({"type": "frame", "number": 1, "pane": "3d"}, b"x" * message["bytes"])
        elif message["type"] == "frames":
            for number in range(message["count"]):
                self.send({"type": "frame", "number": number, "pane": "3d"}, bytes(message["bytes"]))
        elif message["type"] == "file":
            self.send({"type": "reply", "id": 1, "what": "mesh"}, bytes(range(256)) * (message["bytes"] // 256))
        elif message["type"] == "fail":
            raise DeviceError("the device is lost")

    def close(self) -> None:
        self.closed.set()


class View:
    def __init__(self) -> None:
        self.sessions: list[Session] = []

    def session(self, send: Callable[[Message, bytes | None], None]) -> Session:
        made = Session(send)
        self.sessions.append(made)
        made.begin()
        return made


@contextmanager
def serving(view: Any = None, **options: Any) -> Iterator[Serving]:
    with serve(view or View(), **options) as found:
        yield found


class Visitor:
    """A client that proves that it may look, as the page does."""

    def __init__(self, http: aiohttp.ClientSession, server: Serving) -> None:
        self.http, self.url = http, server.url
        self.base = self.url.partition("?")[0]
        self.token = self.url.partition("token=")[2]

    async def enter(self) -> None:
        """Get the secret, for requests beside the socket."""
        async with await self.connect() as ws:
            self.http.headers[SECRET] = ws.secret

    async def status(self, path: str = "", url: str = "", **options: Any) -> int:
        async with self.http.get(url or self.base + path, allow_redirects=False, **options) as answer:
            return int(answer.status)

    async def connect(self, **options: Any) -> aiohttp.ClientWebSocketResponse:
        ws = await self.greet({"token": self.token}, **options)
        ws.secret = (await told(ws, "welcome"))["secret"]
        return ws

    async def greet(self, hello: Message, **options: Any) -> aiohttp.ClientWebSocketResponse:
        """A socket whose first message is given."""
        ws = await self.http.ws_connect(self.base + "ws", max_msg_size=0, **options)
        await ws.send_json({"type": "hello"} | hello)
        return ws


def visit(server: Serving, work: Callable[[Visitor], Coroutine[Any, Any, None]]) -> None:
    async def main() -> None:
        async with aiohttp.ClientSession() as http, asyncio.timeout(30):
            await work(Visitor(http, server))

    asyncio.run(main())


async def told(ws: aiohttp.ClientWebSocketResponse, kind: str) -> Message:
    """The next message of that type."""
    while True:
        got = await ws.receive()
        assert got.type is aiohttp.WSMsgType.TEXT, (got, ws.close_code)
        message: Message = json.loads(got.data)
        if message["type"] == kind:
            return message


async def ended(ws: aiohttp.ClientWebSocketResponse) -> tuple[int | None, str]:
    """How the server ends a connection: the code and the reason."""
    while True:
        got = await ws.receive()
        if got.type is aiohttp.WSMsgType.CLOSE:
            return got.data, got.extra or ""
        if got.type in (aiohttp.WSMsgType.CLOSED, aiohttp.WSMsgType.ERROR, aiohttp.WSMsgType.CLOSING):
            return ws.close_code, ""


def wait_for(condition: Callable[[], Any], seconds: float = 5) -> None:
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.01)


# -- who is let in ---------------------------------------------------------------------------------------------


def test_the_token_becomes_a_secret_which_no_cookie_carries() -> None:
    async def work(visitor: Visitor) -> None:
        assert len(visitor.token) >= 43  # 32 bytes
        for path in ("", f"?token={visitor.token}", "clvol.js"):
            async with visitor.http.get(visitor.base + path, allow_redirects=False) as answer:
                assert answer.status == 200
                assert "Set-Cookie" not in answer.headers
                assert visitor.token not in await answer.text()
        async with await visitor.connect() as first:
            secret = first.secret
        assert len(secret) >= 43
        assert secret != visitor.token
        async with await visitor.greet({"token": "", "secret": secret}) as again:
            assert (await told(again, "welcome"))["secret"] == secret
            assert (await told(again, "info"))["title"] == "fake"

    with serving() as server:
        visit(server, work)


def test_a_ticket_lets_in_once(monkeypatch: pytest.MonkeyPatch) -> None:
    async def work(visitor: Visitor) -> None:
        async with await visitor.greet({"token": ticket}) as ws:
            secret = (await told(ws, "welcome"))["secret"]
        async with await visitor.greet({"token": ticket, "secret": secret}) as ws:
            await told(ws, "welcome")  # a reload of the page
        for spent in (ticket, late):
            async with await visitor.greet({"token": spent}) as ws:
                assert (await ended(ws))[0] == REFUSED

    with serving() as server:
        ticket = server._server.ticket().partition("token=")[2]
        monkeypatch.setattr("clvol.view.hosts.access._TICKET", -1.0)
        late = server._server.ticket().partition("token=")[2]
        assert len({ticket, late, server.url}) == 3
        visit(server, work)


def test_all_families_of_addresses_have_one_port() -> None:
    async def main() -> None:
        server = Server(View(), host="localhost")
        await server.start()
        assert server._runner is not None
        assert {address[1] for address in server._runner.addresses} == {server.port}
        await server.stop()

    asyncio.run(main())


def test_without_the_token_nothing_is_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("clvol.view.hosts.greeting._PATIENCE", 0.3)

    async def work(visitor: Visitor) -> None:
        token, port = visitor.token, visitor.base.rstrip("/").rpartition(":")[2]
        for hello in (
            {},
            {"token": ""},
            {"token": token[:-1]},
            {"token": f"{token}x"},
            {"token": "é"},
            {"token": [token]},
            {"secret": token},
            {"type": "set", "token": token},
        ):
            async with await visitor.greet(hello) as ws:
                assert await ended(ws) == (REFUSED, INVALID), hello
        for header in ({"Cookie": f"clvol-{port}={token}"}, {SECRET: token}, {"Authorization": f"Bearer {token}"}):
            async with await visitor.greet({}, headers=header) as ws:
                assert (await ended(ws))[0] == REFUSED, header
            assert await visitor.status("files", headers=header) == 403, header
        for text in ("", "[]", "[" * 9999, None):
            async with await visitor.http.ws_connect(visitor.base + "ws") as ws:
                if text is not None:  # else it says nothing at all
                    await ws.send_str(text)
                assert (await ended(ws))[0] == REFUSED, text

    view = View()
    with serving(view) as server:
        visit(server, work)
    assert not view.sessions


def test_strangers_do_not_take_the_places_of_clients(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("clvol.view.hosts.greeting._STRANGERS", 3)

    async def work(visitor: Visitor) -> None:
        silent = [await visitor.http.ws_connect(visitor.base + "ws") for _ in range(3)]
        assert (await ended(await visitor.greet({"token": visitor.token})))[0] == aiohttp.WSCloseCode.TRY_AGAIN_LATER
        await silent.pop().close()
        async with await visitor.connect() as ws:
            await told(ws, "info")

    with serving(limits=Limits(clients=1)) as server:
        visit(server, work)


def test_another_host_name_is_rejected_with_the_right_token() -> None:
    """A name that resolves to this machine: its pages would have the same origin."""

    async def work(visitor: Visitor) -> None:
        await visitor.enter()
        port = visitor.base.rstrip("/").rpartition(":")[2]
        for host in (
            "evil.example",
            f"evil.example:{port}",
            "127.0.0.1.evil.example",
            "127.0.0.1@evil.example",
            "192.168.1.5",
            "",
            "[::1",
        ):
            assert await visitor.status(headers={"Host": host}) == 403, host
            assert await visitor.status(url=visitor.url, headers={"Host": host}) == 403, host
            with pytest.raises(aiohttp.WSServerHandshakeError, match="403"):
                await visitor.connect(headers={"Host": host})
        for host in (f"localhost:{port}", f"LOCALHOST:{port}", f"[::1]:{port}", f"127.0.0.1:{port}"):
            assert await visitor.status(url=visitor.url, headers={"Host": host}) == 200, host

    with serving() as server:
        visit(server, work)


def test_pages_of_other_origins_are_rejected_with_the_right_secret() -> None:
    async def work(visitor: Visitor) -> None:
        await visitor.enter()
        port = int(visitor.base.rstrip("/").rpartition(":")[2])
        own = f"http://127.0.0.1:{port}"
        for origin in (
            "https://evil.example",
            "null",
            f"http://127.0.0.1:{port + 1}",
            "http://127.0.0.1",
            f"http://localhost:{port}",
            f"file://127.0.0.1:{port}",
            f"http://127.0.0.1:{port}.evil.example",
            "",
        ):
            assert await visitor.status(headers={"Origin": origin}) == 403, origin
            assert await visitor.status(url=visitor.url, headers={"Origin": origin}) == 403, origin
            with pytest.raises(aiohttp.WSServerHandshakeError, match="403"):
                await visitor.connect(headers={"Origin": origin})
        assert await visitor.status(headers={"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors"}) == 403
        assert await visitor.status(headers={"Origin": own}) == 200
        async with await visitor.connect(headers={"Origin": own}) as ws:
            assert (await told(ws, "info"))["title"] == "fake"

    with serving() as server:
        visit(server, work)


def test_security_headers_of_every_response() -> None:
    async def work(visitor: Visitor) -> None:
        await visitor.enter()
        for path in ("", "clvol.js", "nothing"):
            async with visitor.http.get(visitor.base + path) as answer:
                said = answer.headers
                policy = dict(part.split(maxsplit=1) for part in said["Content-Security-Policy"].split("; "))
                assert policy["default-src"] == policy["frame-ancestors"] == policy["base-uri"] == "'none'"
                assert policy["script-src"] == policy["style-src"] == policy["connect-src"] == "'self'"
                assert said["X-Content-Type-Options"] == "nosniff"
                assert said["Referrer-Policy"] == "no-referrer"
                assert said["X-Frame-Options"] == "DENY"
                assert not [name for name in said if name.lower().startswith("access-control")]
                assert said["Server"] == "clvol"
        async with await visitor.connect() as ws:
            assert ws._response.headers["Server"] == "clvol"

    with serving() as server:
        visit(server, work)


def test_what_is_no_request_is_refused_and_nothing_of_it_is_logged(
    capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("DEBUG")
    long = "topsecret" * 1000
    with serving() as server:
        port = int(server.url.split(":")[2].partition("/")[0])
        host = f"Host: 127.0.0.1:{port}"
        for head in (
            f"GET /?token={long} HTTP/1.1\r\n{host}",
            f"GET / HTTP/1.1\r\n{host}\r\nCookie: clvol={long}",
            f"GET / HTTP/1.1\r\n{host}\r\nCookie\x00: topsecret",
            "topsecret /",
            f"GET http://topsecret:topsecret@[/ HTTP/1.1\r\n{host}",
        ):
            with socket.create_connection(("127.0.0.1", port), timeout=10) as link:
                link.sendall(f"{head}\r\nConnection: close\r\n\r\n".encode())
                said = b"".join(iter(lambda link=link: link.recv(65536), b"")).decode()  # type: ignore[misc]
            first, *fields = said.partition("\r\n\r\n")[0].split("\r\n")
            assert " 400 " in first, head[:40]
            assert {"Server: clvol", "Referrer-Policy: no-referrer", "X-Content-Type-Options: nosniff"} <= {*fields}
            assert any(field.startswith("Content-Security-Policy: default-src 'none'") for field in fields)
            assert "topsecret" not in said
    assert "no proper request" in said
    assert "not a proper request" in caplog.text
    assert "topsecret" not in caplog.text + str(capfd.readouterr())


def test_no_requested_path_is_opened(tmp_path: Path) -> None:
    (tmp_path / "secret.txt").write_text("secret")

    def raw(path: str, port: int) -> bytes:
        with socket.create_connection(("127.0.0.1", port), timeout=10) as link:
            request = f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nConnection: close\r\n\r\n"
            link.sendall(request.encode())
            return b"".join(iter(lambda: link.recv(65536), b""))

    with serving() as server:
        port = server._server.port
        deep = "/".join([".."] * 12)
        for path in (
            f"/{deep}/etc/passwd", "/../server.py", "/%2e%2e/server.py", "/..%2fserver.py", "/static/../../server.py",
            "//etc/passwd", "/etc/passwd", f"/{tmp_path}/secret.txt", "/clvol.js%00.txt", "/clvol.js/", "/./clvol.js",
            "/..\\server.py",
            "/server.py",
        ):  # fmt: skip
            answer = raw(path, port)
            assert answer.split(b" ", 2)[1] in (b"404", b"400"), (path, answer[:80])
            assert b"import" not in answer
            assert b"root:" not in answer
        assert raw("/clvol.js", port).startswith(b"HTTP/1.1 200")


def test_only_get_is_allowed() -> None:
    async def work(visitor: Visitor) -> None:
        await visitor.enter()
        for method in ("POST", "PUT", "DELETE", "OPTIONS", "TRACE"):
            async with visitor.http.request(method, visitor.base) as answer:
                assert answer.status == 405, method
        async with visitor.http.head(visitor.base) as answer:
            assert answer.status == 200

    with serving() as server:
        visit(server, work)


def test_behind_a_proxy() -> None:
    """Its name is allowed, and its path is passed on or stripped."""
    names = {"names": ["hub.example.org"], "root_path": "user/ada/clvol/", "frame_ancestors": ["self", "https://hub.example.org"]}

    async def work(visitor: Visitor) -> None:
        assert visitor.base.endswith("/user/ada/clvol/")
        plain = visitor.base.removesuffix("user/ada/clvol/")
        through = {"Host": "hub.example.org", "Origin": "https://hub.example.org", "X-Forwarded-Proto": "https"}
        url = f"{visitor.base[:-1]}?token=abc"
        async with visitor.http.get(url, headers=through, allow_redirects=False) as answer:
            assert answer.status == 303
            assert answer.headers["Location"] == "/user/ada/clvol/?token=abc"
        for base in (visitor.base, plain):
            async with visitor.http.get(base, headers=through) as page:
                assert page.status == 200
                assert "frame-ancestors 'self' https://hub.example.org" in page.headers["Content-Security-Policy"]
                assert "X-Frame-Options" not in page.headers
            visitor.base = base
            async with await visitor.connect(headers=through) as ws:
                await told(ws, "info")
        assert await visitor.status(headers={"Host": "other.example.org"}) == 403
        assert await visitor.status(headers={"Host": "hub.example.org", "Origin": "https://other.example.org"}) == 403
        # a proxy that asks for the machine's own name, for a page that is its own
        assert await visitor.status(headers={"Origin": "https://hub.example.org"}) == 200

    with serving(**names) as server:
        visit(server, work)


# -- what a client may cost -----------------------------------------------------------------------------------


def test_messages_both_ways() -> None:
    async def work(visitor: Visitor) -> None:
        async with await visitor.connect() as ws:
            assert (await told(ws, "info")) == {"type": "info", "title": "fake"}
            await ws.send_json({"type": "echo", "id": 7})
            assert (await told(ws, "reply")) == {"type": "reply", "id": 7}
            await ws.send_json({"type": "picture", "bytes": 3_000_000})
            assert (await told(ws, "frame")) == {"type": "frame", "number": 1, "pane": "3d", "bytes": 3_000_000}
            assert await ws.receive_bytes() == b"x" * 3_000_000

    with serving() as server:
        visit(server, work)


def test_invalid_messages_get_an_error_and_change_nothing() -> None:
    view = View()

    async def work(visitor: Visitor) -> None:
        async with await visitor.connect() as ws:
            await told(ws, "info")
            for text in (
                "",
                "{",
                "[]",
                "3",
                '{"type": 3}',
                "[" * 60_000,
                '{"type": "a", "x": NaN}',
                '{"type": "a", "x": 1' + "0" * 6000 + "}",
            ):
                await ws.send_str(text)
                answer = await told(ws, "status")
                assert answer["kind"] == "error", text[:20]
                assert "must be" in answer["text"]
            await ws.send_json({"type": "fail"})
            assert (await told(ws, "status"))["text"] == "the device is lost"
            await ws.send_json({"type": "echo", "id": 1})
            await told(ws, "reply")
        async with await visitor.connect() as ws:
            await told(ws, "info")
            await ws.send_bytes(b"{}")
            assert (await ended(ws))[0] == aiohttp.WSCloseCode.UNSUPPORTED_DATA

    with serving(view) as server:
        visit(server, work)
        assert [message["type"] for message in view.sessions[0].got] == ["fail", "echo"]
        wait_for(lambda: all(session.closed.is_set() for session in view.sessions))


@pytest.mark.parametrize("frames", [1, 1000], ids=["at once", "in parts"])
def test_a_message_of_a_gigabyte_is_rejected_before_it_is_read(frames: int) -> None:
    """By its announced length, or when its fragments exceed the limit."""
    size = (1 << 30) // frames

    async def work(visitor: Visitor) -> None:
        ws = await visitor.connect()
        await told(ws, "info")
        reader, transport = ws._reader, ws._writer.transport  # a client that ignores the rules
        assert reader is not None
        sent = 0
        chunk = bytes(1 << 20)
        for number in range(frames):
            first = (0x01 if number == 0 else 0x00) | (0x80 if number == frames - 1 else 0)
            transport.write(bytes([first, 0x80 | 127]) + size.to_bytes(8, "big") + bytes(4))
            for start in range(0, size, len(chunk)):
                if transport.is_closing():
                    break
                transport.write(chunk[: min(len(chunk), size - start)])
                sent += len(chunk)
                await asyncio.sleep(0)
                if ws.closed or reader.is_eof() or transport.get_write_buffer_size() > 64 << 20:
                    break
            else:
                continue
            break
        with contextlib.suppress(ConnectionError):
            got = await asyncio.wait_for(ws.receive(), 5)
            assert got.type in (aiohttp.WSMsgType.CLOSE, aiohttp.WSMsgType.ERROR, aiohttp.WSMsgType.CLOSED), got
            if got.type is aiohttp.WSMsgType.CLOSE:
                assert got.data == aiohttp.WSCloseCode.MESSAGE_TOO_BIG
        transport.abort()
        async with await visitor.connect() as other:  # it goes on
            await other.send_json({"type": "echo", "id": 2})
            await told(other, "reply")

    view = View()
    with serving(view) as server:
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        visit(server, work)
        grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
        assert not view.sessions[0].got
    assert grown < 200  # MiB, of which the client's own buffer has 65 at most


def flood(server: Serving, stop: threading.Event, ends: list[tuple[int | None, str]]) -> None:
    """Send messages as fast as possible, and read only how the connection ends."""

    async def work(visitor: Visitor) -> None:
        ws = await visitor.connect()
        await told(ws, "info")

        async def send() -> None:
            with contextlib.suppress(ConnectionError):
                while not stop.is_set():
                    await ws.send_str('{"type": "event", "event": {"event_type": "pointer_move", "x": 1, "y": 2}}')
                    await asyncio.sleep(0)

        sending = asyncio.ensure_future(send())
        ends.append(await ended(ws))
        sending.cancel()

    visit(server, work)


def test_a_flooding_client_does_not_block_another() -> None:
    view, stop, waits = View(), threading.Event(), list[float]()
    ends: list[tuple[int | None, str]] = []

    async def work(visitor: Visitor) -> None:
        other = await visitor.connect()
        await told(other, "info")
        flooding = threading.Thread(target=flood, args=(server, stop, ends), daemon=True)
        flooding.start()
        while flooding.is_alive():
            asked = time.monotonic()
            await other.send_json({"type": "echo", "id": 1})
            await told(other, "reply")
            waits.append(time.monotonic() - asked)
            await asyncio.sleep(0.02)

    with serving(view, limits=Limits(rate=200, burst=100, flood=1.5)) as server:
        visit(server, work)
    assert len(waits) > 20
    assert sorted(waits)[len(waits) // 2] < 0.2
    assert [end[0] for end in ends] == [aiohttp.WSCloseCode.POLICY_VIOLATION] or [end[0] for end in ends] == [1006]
    events = [sum(message["type"] == "event" for message in session.got) for session in view.sessions]
    assert 200 < events[1] < 100 + 3 * 200


def test_a_client_that_does_not_read_costs_no_memory() -> None:
    """Of 300 pictures of a megabyte only the newest is queued, and the session learns which were dropped."""
    view = View()

    async def work(visitor: Visitor) -> None:
        async with await visitor.connect() as ws:
            await told(ws, "info")
            before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            await ws.send_json({"type": "frames", "count": 300, "bytes": 1 << 20})
            wait_for(lambda: view.sessions[0].got)
            time.sleep(0.5)  # this loop reads nothing
            assert (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024 < 60
            seen = []
            while not seen or seen[-1] != 299:
                seen.append((await told(ws, "frame"))["number"])
                assert len(await ws.receive_bytes()) == 1 << 20
            assert seen == sorted(seen)
            assert len(seen) < 20

    with serving(view) as server:
        visit(server, work)
        session = view.sessions[0]
        wait_for(lambda: any(message["type"] == "ack" for message in session.got))
        dropped = [message["frame"] for message in session.got if message["type"] == "ack"]
        assert len(dropped) == len(set(dropped)) > 280


def test_what_is_too_large_for_the_socket_is_fetched_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    size = 3 << 20

    async def work(visitor: Visitor) -> None:
        async with await visitor.connect() as ws:
            names = []
            for _ in range(2):
                await ws.send_json({"type": "file", "bytes": size})
                message = await told(ws, "reply")
                assert "bytes" not in message
                names.append(message["download"])
            first = f"download?name={names[0]}"
            assert await visitor.status(first) == 403
            visitor.http.headers[SECRET] = ws.secret
            assert await visitor.status("download?name=../x") == 404
            async with visitor.http.get(visitor.base + first) as answer:
                assert (answer.status, await answer.read()) == (200, bytes(range(256)) * (size // 256))
                assert "Content-Security-Policy" in answer.headers
            assert await visitor.status(first) == 404
            await ws.send_json({"type": "file", "bytes": 1 << 20})
            assert (await told(ws, "reply"))["bytes"] == 1 << 20
            assert len(list(tmp_path.iterdir())) == 1

    with serving(limits=Limits(waiting=4 << 20)) as server:
        visit(server, work)
        wait_for(lambda: not list(tmp_path.iterdir()))  # with the page that did not fetch it
        with monkeypatch.context() as patch:
            patch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=size))

            async def without_room(visitor: Visitor) -> None:
                async with await visitor.connect() as ws:
                    await ws.send_json({"type": "file", "bytes": size})
                    assert (await told(ws, "reply"))[
                        "error"
                    ] == "the file cannot be sent: there is no room for 3 MiB where clvol runs"

            visit(server, without_room)


def test_undroppable_messages_are_bounded() -> None:
    async def main() -> None:
        outbox = Outbox(asyncio.get_running_loop(), Limits(waiting=10_000, messages=20), lambda _: "")
        for number in range(100):
            outbox.put({"type": "state", "n": number})
            outbox.put({"type": "frame", "number": number, "pane": "xyz"[number % 3]}, bytes(1000))
        assert [message.get("n") or message.get("number") for message, _ in outbox._waiting] == [97, 98, 99, 99]
        assert outbox.take_dropped() == list(range(97))
        for number in range(100):  # a step along an axis each
            outbox.put({"type": "info", "n": number})
        assert [message["n"] for message, _ in outbox._waiting if message["type"] == "info"] == [99]
        assert not outbox.overflowed
        for number in range(20):
            outbox.put({"type": "reply", "id": number})
        assert outbox.overflowed
        assert len(outbox._waiting) <= 24
        assert await outbox.take() is None

    asyncio.run(main())


def test_the_rate_of_messages() -> None:
    rate = Rate(100, 50)
    waits = [rate.take() for _ in range(150)]
    assert waits[:50] == [0] * 50
    assert waits[-1] == pytest.approx(1, abs=0.1)


def test_messages_are_objects_with_a_type() -> None:
    assert parsed('{"type": "ack", "frame": 3}') == {"type": "ack", "frame": 3}
    for wrong in ("null", "{}", "[1]", "{'type': 1}", '{"type": "a", "b": Infinity}', "\x00"):
        assert isinstance(parsed(wrong), str), wrong


def test_no_more_pages_than_are_allowed() -> None:
    async def work(visitor: Visitor) -> None:
        first, second = await visitor.connect(), await visitor.connect()
        await told(first, "info")
        await told(second, "info")
        third = await visitor.greet({"token": visitor.token})
        assert await ended(third) == (aiohttp.WSCloseCode.TRY_AGAIN_LATER, "2 pages are open, the maximum; close one")
        await first.close()
        for _ in range(100):  # its place is free when its session has ended
            again = await visitor.greet({"token": visitor.token})
            got = await again.receive()
            if got.type is aiohttp.WSMsgType.TEXT:
                break
            await asyncio.sleep(0.02)
        assert json.loads(got.data)["type"] == "welcome"

    with serving(limits=Limits(clients=2)) as server:
        visit(server, work)


def test_an_idle_client_is_disconnected_and_its_view_freed() -> None:
    view = View()

    async def work(visitor: Visitor) -> None:
        silent, busy = await visitor.connect(), await visitor.connect()
        begun = time.monotonic()
        task = asyncio.ensure_future(ended(silent))
        while not task.done():
            await silent_ack(silent)
            await busy.send_json({"type": "event", "event": {}})
            await asyncio.sleep(0.05)
        assert await task == (4000, "idle for 0.5 s")
        assert 0.4 < time.monotonic() - begun < 5
        assert not busy.closed

    async def silent_ack(ws: aiohttp.ClientWebSocketResponse) -> None:
        with contextlib.suppress(ConnectionError):
            await ws.send_json({"type": "ack", "frame": 1})  # of pictures, which only the page causes

    with serving(view, limits=Limits(idle=0.5)) as server:
        visit(server, work)
        wait_for(lambda: all(session.closed.is_set() for session in view.sessions))
        assert len(view.sessions) == 2


def test_a_client_that_vanishes_during_a_picture() -> None:
    view = View()

    async def work(visitor: Visitor) -> None:
        ws, other = await visitor.connect(), await visitor.connect()
        await told(ws, "info")
        await told(other, "info")
        await ws.send_json({"type": "picture", "bytes": 30_000_000})
        await told(ws, "frame")
        ws._writer.transport.abort()
        await other.send_json({"type": "echo", "id": 1})
        await told(other, "reply")

    with serving(view) as server:
        visit(server, work)
        wait_for(lambda: all(session.closed.is_set() for session in view.sessions))
        wait_for(lambda: server.clients == 0)
        for session in view.sessions:
            session.send({"type": "frame", "number": 2, "pane": "3d"}, b"late")  # a thread that has not noticed yet


def test_a_client_that_leaves_before_its_session_starts() -> None:
    class Slow(View):
        def session(self, send: Callable[[Message, bytes | None], None]) -> Session:
            made = super().session(send)
            time.sleep(0.5)
            return made

    view = Slow()

    async def work(visitor: Visitor) -> None:
        ws = await visitor.connect()
        await told(ws, "info")
        await ws.close()

    with serving(view) as server:
        visit(server, work)
        wait_for(lambda: view.sessions[0].closed.is_set())
        wait_for(lambda: server.clients == 0)


# -- what goes wrong ------------------------------------------------------------------------------------------


def test_a_failed_view_is_reported_to_the_page() -> None:
    release = threading.Event()

    def make() -> Any:
        release.wait(10)
        raise FormatError("scan.nii.gz is damaged")

    async def work(visitor: Visitor) -> None:
        async with await visitor.connect() as ws:
            assert (await told(ws, "status")) == {"type": "status", "kind": "busy", "text": "reading scan.nii.gz"}
            release.set()
            assert (await told(ws, "status")) == {"type": "status", "kind": "error", "text": "scan.nii.gz is damaged"}
            await ws.send_json({"type": "event"})
            assert not ws.closed
        async with await visitor.connect() as ws:
            assert (await told(ws, "status"))["text"] == "scan.nii.gz is damaged"

    with serving(make, doing="reading scan.nii.gz") as server:
        visit(server, work)


def test_messages_during_loading_are_not_lost() -> None:
    release, view = threading.Event(), View()

    def make() -> View:
        release.wait(10)
        return view

    async def work(visitor: Visitor) -> None:
        async with await visitor.connect() as ws:
            await told(ws, "status")
            for number in range(3):
                await ws.send_json({"type": "echo", "id": number})
            release.set()
            assert [(await told(ws, "reply"))["id"] for _ in range(3)] == [0, 1, 2]

    with serving(make) as server:
        visit(server, work)


def test_a_port_in_use_and_other_wrong_options() -> None:
    with serving() as server:
        port = int(server.url.partition("/?")[0].rpartition(":")[2])
        with pytest.raises(OptionError, match=f"port {port} of 127.0.0.1 is taken"):
            serve(View(), port=port)
    wrong: list[tuple[dict[str, Any], str]] = [
        ({"port": 70_000}, "port must be a whole number"),
        ({"host": "203.0.113.7"}, "host must be an address or a name of this machine"),
        ({"names": ["a/b"]}, "names must be hosts"),
        ({"root_path": "/a/../b"}, "root_path must be a path"),
        ({"root_path": '/a"b'}, "root_path must be a path"),
        ({"frame_ancestors": ["https://a; script-src *"]}, "frame_ancestors must be sites"),
        ({"key": "key.pem"}, "key is for a certificate"),
        ({"certificate": "nothing.pem"}, "certificate must be a PEM file"),
    ]
    for options, message in wrong:
        with pytest.raises(OptionError, match=message):
            serve(View(), **options)
    with pytest.raises(OptionError, match="clients must be a whole number"):
        Limits(clients=0)


def test_closing_disconnects_clients() -> None:
    view = View()

    async def work(visitor: Visitor) -> None:
        async with await visitor.connect() as ws:
            await told(ws, "info")
            begun = time.monotonic()
            await asyncio.to_thread(server.close)
            assert time.monotonic() - begun < 1
            assert await ended(ws) == (aiohttp.WSCloseCode.GOING_AWAY, "clvol has ended")

    with serving(view) as server:
        visit(server, work)
        assert view.sessions[0].closed.is_set()
        assert repr(server) == "<Serving ended>"


def test_https(tmp_path: Path) -> None:
    made = subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-keyout", tmp_path / "key.pem", "-out", tmp_path / "cert.pem",
         "-days", "2", "-subj", "/CN=localhost"], capture_output=True, check=False,
    ) if _has("openssl") else None  # fmt: skip
    if made is None or made.returncode:
        pytest.skip("needs openssl, which makes a certificate")

    async def work(visitor: Visitor) -> None:
        assert visitor.url.startswith("https://")
        async with visitor.http.get(visitor.url, ssl=False) as answer:
            assert answer.status == 200
        async with await visitor.connect(ssl=False) as ws:
            await told(ws, "info")

    with serving(certificate=tmp_path / "cert.pem", key=tmp_path / "key.pem") as server:
        visit(server, work)


def _has(program: str) -> bool:
    import shutil

    return shutil.which(program) is not None


def test_listening_on_all_interfaces_allows_ip_addresses_and_the_host_name() -> None:
    async def work(visitor: Visitor) -> None:
        for host, status in (
            (socket.gethostname(), 200),
            ("192.168.7.7:80", 200),
            ("evil.example", 403),
            ("10.0.0.1.evil.example", 403),
        ):
            assert await visitor.status(url=visitor.url, headers={"Host": host}) == status, host

    with serving(host="0.0.0.0") as server:
        assert server.url.startswith("http://127.0.0.1:")
        visit(server, work)
    assert Server(View(), host="0.0.0.0").public
    assert Server(View(), host="0.0.0.0", port=80).elsewhere.startswith(f"http://{socket.gethostname()}:80/?token=")
    assert not Server(View()).public


# -- the command ----------------------------------------------------------------------------------------------


class Command:
    """``clvol view`` in its own process, without a desktop."""

    def __init__(self, *arguments: object, code: str = "") -> None:
        script = f"{code}\nfrom clvol.cli import main\nmain()"
        command = [sys.executable, "-c", script, "view", *map(str, arguments)]
        plain = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, encoding="utf-8", env=plain)
        assert self.process.stdout is not None
        self.url = self.process.stdout.readline().strip()

    def end(self, by: int = signal.SIGINT) -> tuple[int, str, float]:
        """Exit code, standard error, and the seconds taken."""
        sent = time.monotonic()
        self.process.send_signal(by)
        _, said = self.process.communicate(timeout=30)
        return self.process.returncode, said, time.monotonic() - sent

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.communicate()


def visit_url(url: str, work: Callable[[Visitor], Coroutine[Any, Any, None]]) -> None:
    visit(SimpleNamespace(url=url), work)  # type: ignore[arg-type]  # its address is what is used


SLACK = 1 + os.getloadavg()[0] / (os.cpu_count() or 1)  # seconds, on a busy machine


def test_the_command_renders_and_ctrl_c_stops_it(device: Device) -> None:
    assert device is not None
    seen: list[Message] = []

    async def work(visitor: Visitor) -> None:
        async with await visitor.connect() as ws:
            resize = {"event_type": "resize", "width": 64, "height": 48, "ratio": 1}
            await ws.send_json({"type": "event", "event": resize})
            assert (await told(ws, "info"))["volume"]["shape"] == [16, 16, 16]
            state = (await told(ws, "state"))["state"]
            assert (state["mode"], state["preset"], state["filter"]) == ("mip", None, "linear")
            while not seen or not seen[-1]["final"]:
                seen.append(await told(ws, "frame"))
                data = await ws.receive_bytes()
                await ws.send_json({"type": "ack", "frame": seen[-1]["number"]})
            picture = iio.imread(data)
            expected = clvol.render(clvol.phantoms.sphere(16), mode="mip", filter="linear", size=(64, 48), device=device)
            np.testing.assert_array_equal(picture[..., :3], clvol.show.picture.to_bytes(expected)[..., :3])
            code, said, took = await asyncio.to_thread(command.end)
            assert (code, said.replace("1 error generated.\n", "")) == (0, "")  # from LLVM, disturbed by Ctrl-C during a build
            assert took < SLACK
            assert (await ended(ws))[0] == aiohttp.WSCloseCode.GOING_AWAY

    with Command("phantom:sphere:16", "--serve", "--mode", "mip", "--filter", "linear", "--device", device.name) as command:
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/\?token=[\w-]{43}", command.url)
        visit_url(command.url, work)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("by", [signal.SIGINT, signal.SIGTERM], ids=["SIGINT", "SIGTERM"])
def test_the_command_can_be_stopped_while_reading(by: int) -> None:
    slow = "import clvol, time; clvol.phantoms.by_name = lambda name: time.sleep(60)"
    with Command("phantom:sphere", "--serve", code=slow) as command:
        code, said, took = command.end(by)
    assert (code, said) == (0, "")
    assert took < SLACK


def test_an_unreadable_file_is_reported_in_terminal_and_page(tmp_path: Path) -> None:
    (tmp_path / "broken.nii").write_text("x")
    words = "broken.nii must begin with a NIfTI header of 348 bytes; found 1"

    async def work(visitor: Visitor) -> None:
        async with await visitor.connect() as ws:
            while (status := await told(ws, "status"))["kind"] != "error":
                assert status["text"] == "reading broken.nii"
            assert status["text"] == words

    with Command(tmp_path / "broken.nii", "--serve") as command:
        visit_url(command.url, work)
        code, said, _ = command.end()
    assert (code, said) == (1, f"clvol: {words}\n")


def test_a_volume_too_large_for_memory_is_reported() -> None:
    code = """
import clvol
def by_name(name):
    raise clvol.OutOfMemoryError('the volume takes 900 GB; 8 GB are free')
clvol.phantoms.by_name = by_name
"""

    async def work(visitor: Visitor) -> None:
        async with await visitor.connect() as ws:
            while (status := await told(ws, "status"))["kind"] != "error":
                pass
            assert status["text"] == "the volume takes 900 GB; 8 GB are free"

    with Command("phantom:sphere", "--serve", code=code) as command:
        visit_url(command.url, work)
        assert command.end()[:2] == (1, "clvol: the volume takes 900 GB; 8 GB are free\n")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nothing.nii"], "cannot read nothing.nii: there is no such file or folder"),
        (["phantom:ball"], "phantom must be one of"),
        (["phantom:sphere:8", "--preset", "ct-bones"], "--preset must be one of"),
        (["phantom:sphere:8", "--filter", "cubik"], "--filter must be"),
        (["phantom:sphere:8", "--isovalue", "3"], "isovalue"),
        (["phantom:sphere:8", "--port", "99999"], "--port must be a whole number"),
        (["phantom:sphere:8", "--idle", "0"], "--idle must be above 0"),
        (["phantom:sphere:8", "--host", "203.0.113.7"], "--host must be an address or a name of this machine"),
        (["phantom:sphere:8", "--root-path", "/a b"], "--root-path must be a path"),
    ],
)
def test_an_invalid_command_line_exits_at_once(arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        cli.main(["view", *arguments, "--serve"])
    assert end.value.code == 1
    said = capsys.readouterr().err
    assert said.startswith("clvol: ")
    assert said.count("\n") == 1
    assert words in said


def test_a_port_in_use_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(SystemExit) as end:
            cli.main(["view", "phantom:sphere:8", "--serve", "--port", str(port)])
    assert end.value.code == 1
    said = capsys.readouterr()
    assert said.err == f"clvol: port {port} of 127.0.0.1 is taken; give another, or none for a free one\n"
    assert said.out == ""


def test_without_aiohttp_its_extra_is_named() -> None:
    with Command("phantom:sphere:8", code="import sys; sys.modules['aiohttp'] = None") as command:
        _, said = command.process.communicate(timeout=60)
    assert command.process.returncode == 1
    assert said == 'clvol: the viewer\'s page needs aiohttp, which is not installed: pip install "clvol[view]"\n'


def test_a_note_warns_of_public_and_unreachable_addresses() -> None:
    with Command("phantom:sphere:8", "--host", "0.0.0.0") as command:
        assert command.url.startswith("http://127.0.0.1:")
        time.sleep(0.2)
        code, said, _ = command.end()
    assert code == 0
    assert re.search(
        r"clvol: note: other machines reach this page, at http://\S+; whoever has the address can look. It is not encrypted", said
    )
    assert "clvol: note: there is no desktop here: open the address in a browser" in said


def test_the_command_line_alone_needs_no_server() -> None:
    code = "import clvol.cli, sys; print([m for m in ('aiohttp', 'asyncio', 'clvol.view.hosts.server') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8", timeout=60, check=True)
    assert done.stdout == "[]\n"
