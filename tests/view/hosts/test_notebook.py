"""Notebook views: the widget, alone and in a kernel, and its JavaScript module in a browser."""

from __future__ import annotations

import base64
import builtins
import json
import sys
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import clvol
from clvol.base.errors import OptionError
from clvol.device import Device
from clvol.view import View, show
from tests.view.browser import Browser, why_none
from tests.view.threads import sessions, wait_for_sessions

pytest.importorskip("anywidget", reason="needs anywidget")
from clvol.view.hosts.notebook import Widget

WIDGET = "application/vnd.jupyter.widget-view+json"
RESIZE = {"type": "event", "event": {"event_type": "resize", "width": 48, "height": 48, "ratio": 1, "pane": "3d"}}


def small() -> View:
    return View(clvol.Volume(np.random.default_rng(0).random((12, 12, 12), np.float32)), mode="mip")


class Sent(Widget):
    """A widget that records its messages."""

    def __init__(self, view: View) -> None:
        super().__init__(view)
        self.messages: list[tuple[dict[str, Any], Any]] = []

    def send(self, content: dict[str, Any], buffers: Any = None) -> None:
        self.messages.append((content, buffers))

    def of(self, client: str, kind: str) -> list[tuple[dict[str, Any], Any]]:
        until = time.monotonic() + 60
        while True:
            if found := [each for each in list(self.messages) if (each[0]["client"], each[0]["type"]) == (client, kind)]:
                return found
            assert time.monotonic() < until, f"no {kind} for {client}"
            time.sleep(0.02)


@pytest.fixture
def widget(device: Device) -> Iterator[Sent]:  # noqa: ARG001  # views use the default one
    made = Sent(small())
    made.comm = object.__new__(_Comm)  # outside of a kernel there is none
    yield made
    made.comm = None
    made.close()


class _Comm:
    """The frontend's end of a widget, for ipywidgets."""

    comm_id = "test"

    def send(self, *_: Any, **__: Any) -> None: ...
    def on_msg(self, _: Any) -> None: ...
    def close(self, *_: Any, **__: Any) -> None: ...


def test_each_display_has_its_own_session(widget: Sent) -> None:
    for client in ("a", "b"):
        widget._receive(widget, {"type": "open", "client": client}, [])
        widget._receive(widget, {**RESIZE, "client": client}, [])
    for client in ("a", "b"):
        frame, buffers = widget.of(client, "frame")[0]
        assert (frame["width"] > 0, len(buffers), len(buffers[0]) > 100) == (True, 1, True)
    widget._receive(widget, {"type": "set", "changes": {"mode": "mean"}, "client": "a"}, [])
    deadline = time.monotonic() + 20
    while widget._sessions["a"].state.mode != "mean":
        assert time.monotonic() < deadline
        time.sleep(0.02)
    assert widget._sessions["b"].state.mode == "mip"
    first = widget._sessions["a"]
    widget._receive(widget, {"type": "close", "client": "a"}, [])
    assert first.closed
    assert list(widget._sessions) == ["b"]


def test_closing_it_ends_its_sessions(widget: Sent) -> None:
    widget._receive(widget, {"type": "open", "client": "a"}, [])
    session = widget._sessions["a"]
    widget.close()
    assert session.closed


def test_displays_that_vanished_are_removed(widget: Sent) -> None:
    before = sessions()
    for i in range(20):
        widget._receive(widget, {"type": "open", "client": str(i)}, [])
    assert list(widget._sessions) == [str(i) for i in range(12, 20)]
    wait_for_sessions(8, before)


@pytest.mark.parametrize(
    "message",
    [
        None,
        [],
        {"type": "open"},
        {"type": "open", "client": 3},
        {"type": "open", "client": "x" * 65},
        {"type": "set", "client": "no"},
    ],
)
def test_invalid_messages_are_ignored(widget: Sent, message: Any) -> None:
    widget._receive(widget, message, [])
    assert widget._sessions == {}
    assert widget.messages == []


def test_without_anywidget_there_is_a_still_picture(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:  # noqa: ARG001
    real = builtins.__import__

    def refusing(name: str, *args: Any, **options: Any) -> Any:
        if name == "anywidget":
            raise ImportError(name)
        return real(name, *args, **options)

    monkeypatch.setattr(builtins, "__import__", refusing)
    monkeypatch.delitem(sys.modules, "clvol.view.hosts.notebook")
    monkeypatch.delattr("clvol.view.hosts.notebook")
    shown = small()._repr_mimebundle_()
    assert shown["image/png"].startswith(b"\x89PNG")
    assert 'pip install "clvol[view]"' in shown["text/plain"]


def test_outside_a_notebook_show_explains_what_to_do() -> None:
    with pytest.raises(OptionError, match="no notebook here"):
        show(small())


# -- in a kernel ---------------------------------------------------------------------------------------------


def test_a_kernel_shows_the_widget_and_renders_in_it(device: Device) -> None:  # noqa: ARG001  # the kernel uses the default one
    nbclient, nbformat = pytest.importorskip("nbclient"), pytest.importorskip("nbformat")
    pytest.importorskip("ipykernel")
    messages: list[tuple[dict[str, Any], list[Any]]] = []

    class Client(nbclient.NotebookClient):  # type: ignore[misc]  # untyped
        def handle_comm_msg(self, outs: Any, msg: Any, cell_index: int) -> None:
            data = msg["content"].get("data", {})
            if data.get("method") == "custom":
                messages.append((data["content"], msg.get("buffers", [])))
            super().handle_comm_msg(outs, msg, cell_index)

    made = """
import clvol, numpy as np
from clvol.view import View
view = View(clvol.Volume(np.random.default_rng(0).random((12, 12, 12), np.float32)), mode="mip")
view
"""
    used = f"""
import threading, time
widget, sent = view.widget(), []
send = widget.send
widget.send = lambda message, data=None: (send(message, data), sent.append(message["type"]))
for message in ({{"type": "open"}}, {json.dumps(RESIZE)}):
    widget._receive(widget, {{**message, "client": "a"}}, [])
until = time.monotonic() + 60
while "frame" not in sent and time.monotonic() < until:
    time.sleep(0.05)
widget.close()
while any(thread.name == "clvol view" for thread in threading.enumerate()) and time.monotonic() < until:
    time.sleep(0.05)
print(sum(thread.name == "clvol view" for thread in threading.enumerate()))
"""
    book = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(made), nbformat.v4.new_code_cell(used)])
    Client(book, timeout=120, kernel_name="python3").execute()
    assert WIDGET in book.cells[0].outputs[0]["data"]
    assert book.cells[1].outputs[0]["text"].strip() == "0"  # no session is left
    kinds = [content["type"] for content, _ in messages]
    assert kinds[:2] == ["info", "state"]
    frames = [buffers for content, buffers in messages if content["type"] == "frame"]
    assert frames
    assert bytes(frames[0][0])[:3] in (b"\xff\xd8\xff", b"\x89PN")


# -- in a browser --------------------------------------------------------------------------------------------


@pytest.mark.skipif(bool(why_none()), reason=why_none())
def test_the_module_shows_a_models_messages_and_says_goodbye(widget: Sent, browser: Browser) -> None:
    """The module's `render`, with messages relayed by the test between a model in the page and the widget."""
    pytest.importorskip("aiohttp", reason="needs aiohttp")
    from clvol.view.hosts.server import serve

    with serve(small()) as server:
        browser.open(server.url)
        browser.wait("document.querySelector('.clvol')")
        begin = """const done = arguments[0];
            import(new URL('clvol.js', location.href)).then(({ default: widget }) => {
              const el = document.createElement('div');
              document.body.replaceChildren(el);
              window.sent = [];
              const on = (_, listener) => { window.deliver = listener; };
              const model = { send: (m) => window.sent.push(m), on, off: () => { window.deliver = null; } };
              window.leave = widget.render({ model, el });
              done();
            });"""
        browser.driver.execute_async_script(begin)
        deliver = """const [message, text] = arguments;
            const bytes = text === null ? null : Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
            window.deliver(message, bytes ? [new DataView(bytes.buffer)] : []);"""
        done = 0

        def carried() -> bool:
            nonlocal done
            for message in browser.js("return window.sent.splice(0)"):
                widget._receive(widget, message, [])
            for message, buffers in widget.messages[done:]:
                done += 1
                text = None if buffers is None else base64.b64encode(buffers[0]).decode()
                browser.js(deliver, message, text)
            return bool(browser.js("return document.querySelector('.clvol-pane[data-final=true]') !== null"))

        browser.wait(carried, 60, "the picture")
        assert browser.canvas()[..., :3].max() > 100
        assert browser.box(".clvol")[3] == 600
        (session,) = widget._sessions.values()
        browser.js("window.leave()")
        assert browser.js("return document.querySelector('.clvol')") is None
        for message in browser.js("return window.sent.splice(0)"):
            widget._receive(widget, message, [])
        assert session.closed
