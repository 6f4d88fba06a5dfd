"""A session: one client of a view, and the thread that draws for it. The newest state wins."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import closing
from typing import Any

from clvol.base.errors import ClvolError, DeviceError
from clvol.view import actions, code, protocol
from clvol.view.actions import Gone, pixels_of
from clvol.view.background import Background
from clvol.view.control import Control
from clvol.view.drawing import WHOLE, Drawer, Order, Shot, has_sketch, jpeg, png
from clvol.view.panes import PaneSize, visible
from clvol.view.protocol import Change, Message, PointerOrKey, Request, Resize, Send
from clvol.view.resident import Resident
from clvol.view.schedule import Draw, FindFacts, Job, Shown, Wait, next_job
from clvol.view.state import State
from clvol.view.throttle import Inbox, Throttle
from clvol.view.updates import Updates

__all__ = ["Session"]

_LOG = logging.getLogger("clvol.view")
_BUDGET = 0.04  # seconds for a first picture
_LONGER = 0.065  # seconds for those of a drag that goes on, if they would have fewer than `_FINE` pixels
_FINE = 80 * 80
_STILL = 0.25  # seconds for the first picture at rest: if the final one takes no longer, nothing comes before it
_SOON = 1.0  # seconds: nothing comes before a final picture if the last one took no longer than this
_UNSIZED = 0.5  # seconds that a client has to give the size of its panes; then facts no longer wait for its first picture
_PATIENCE = 2.0  # seconds that a finished picture waits for acknowledgements
_MOVING_PIXELS = 1920 * 1080
_MOST_PIXELS = 3840 * 2160


class Session:
    """One client of a view; its thread starts with it and ends with `close`. Messages are those of `clvol.view.protocol`.

    Parameters
    ----------
    resident : Resident
        What is viewed, shared with other sessions.
    send : callable
        ``send(message, data)``, called from the session's thread; `data` is None except for pictures and files. If it raises, the
        client is gone, and the session ends.
    state : State, optional
        What is shown first; by default the view's.
    """

    def __init__(self, resident: Resident, send: Send, state: State | None = None) -> None:
        first = resident.initial if state is None else state
        resident.catalog.require(first)
        self._resident, self._send = resident, send
        self._condition = threading.Condition()
        self._closed = False
        self._inbox, self._throttle, self._background = Inbox(), Throttle(), Background(self._condition)
        self._control, self._drawer = Control(resident, first), Drawer(resident)
        self._updates = Updates(resident, self._control, self._background, self._tell, lambda: self._closed)
        self._parts = actions.Parts(resident, self._control, self._drawer, self._updates.status, lambda: self._closed)
        self._began = time.monotonic()
        self._shown: dict[str, Shown] = {}
        self._took: dict[str, tuple[object, float]] = {}  # by pane: what its last final picture showed, and its seconds
        self._failed: set[str] = set()  # panes whose picture failed
        self._coarse: set[str] = set()  # panes whose pictures of this drag would be coarse
        self._lost_at: State | None = None  # the state in which the device failed
        self._thread = threading.Thread(target=self._run, name="clvol view", daemon=True)
        self._thread.start()

    # -- for hosts, from any thread ----------------------------------------------------------------------------

    @property
    def state(self) -> State:
        """What is shown."""
        return self._control.state

    @property
    def closed(self) -> bool:
        """Whether it has ended."""
        return self._closed

    def receive(self, message: Mapping[str, Any]) -> None:
        """Take a client's message; returns at once."""
        with self._condition:
            if self._closed:
                return
            if isinstance(message, Mapping) and message.get("type") == "ack":
                self._throttle.acknowledge(message.get("frame"), time.monotonic())
            else:
                self._inbox.put(message)
            self._condition.notify_all()

    def close(self, timeout: float | None = 10.0) -> None:
        """End it; what is being drawn is stopped. Other sessions of the view go on."""
        self._end()
        if threading.current_thread() is not self._thread:
            self._thread.join(timeout)
            self._background.join(timeout)

    def _end(self) -> None:
        with self._condition:
            self._closed = True
            self._background.close()
            self._inbox.clear()
            self._condition.notify_all()

    def python(self) -> str:
        """A program that draws the final picture of the active pane, bit for bit."""
        return actions.copied(self._parts, "python")

    def toml(self) -> str:
        """The options of `clvol render` that draw it, as TOML, and the command."""
        return actions.copied(self._parts, "toml")

    def url(self) -> str:
        """The state as the fragment of an address, ``#s=...``; `clvol.view.from_url` reads it."""
        return code.to_url(self.state)

    # -- the thread --------------------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            self._guarded(self._updates.volume)
            self._guarded(self._updates.state)
            while self._wait():
                self._guarded(self._take)
                self._guarded(self._work)
        except Gone:
            _LOG.debug("a client is gone")
        finally:
            self._drawer.give_up()
            self._end()

    def _guarded(self, work: Callable[[], None]) -> None:
        """Do it; errors are sent to the client, and the session goes on."""
        try:
            work()
        except Gone:
            raise
        except Exception as error:
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        if isinstance(error, DeviceError) and not isinstance(error, MemoryError):
            self._resident.forget()
            if self._lost_at != self.state:  # try once more with new renderers
                self._lost_at = self.state
                self._shown.clear()
        self._updates.status(_said(error), "error")

    def _wait(self) -> bool:
        """Wait for something to do; False at the end."""
        try:
            with self._condition:
                while not self._came():
                    job = self._job()
                    if not isinstance(job, Wait):
                        break
                    self._condition.wait(job.seconds)
                return not self._closed
        except Exception as error:
            self._fail(error)
        with self._condition:  # what is shown cannot be drawn: until something arrives
            self._condition.wait_for(self._came)
            return not self._closed

    def _came(self) -> bool:
        return self._busy() or len(self._background) > 0

    def _busy(self) -> bool:
        """Whether a message came, or the session ends."""
        return self._closed or len(self._inbox) > 0

    def _job(self) -> Job:
        state, now, updates = self.state, time.monotonic(), self._updates
        sizes, focus = self._control.sizes, self._control.focus
        panes = [name for name in sorted(visible(state), key=lambda name: name != focus) if name in sizes or "" in sizes]
        key, renderers = self._resident.catalog.key(state), self._resident.renderers
        with self._condition:
            room_in = self._throttle.room_in(now)
        return next_job(
            wanted={name: self._control.key(name) for name in panes},
            shown=self._shown,
            sketching="3d" in panes and has_sketch(state) and not renderers.soon(*key),
            rest_in=self._control.rests_at - now,
            room_in=room_in,
            facts_in=None if updates.complete or updates.finding_facts else self._began + _UNSIZED - now,
        )

    # -- messages ----------------------------------------------------------------------------------------------

    def _take(self) -> None:
        """Everything that came."""
        with self._condition:
            messages, warning = self._inbox.take_all()
            ready = self._background.take()
        for message in ready:
            self._tell(message)
        if warning:
            self._updates.status(warning, "error")
        for received in messages:
            if self._closed:
                return
            self._guarded(lambda received=received: self._handle(received))  # type: ignore[misc]  # bound at once
        self._updates.forget_errors()
        self._guarded(self._updates.volume)  # once, however many steps along an axis came: only the last is drawn
        if self._control.inputs.drag is None and not self._control.moving:
            self._updates.state()
        self._updates.overlays()

    def _handle(self, received: Mapping[str, Any]) -> None:
        match protocol.parse(received):
            case Resize() as resize:
                self._control.sizes[resize.pane] = resize.size
            case PointerOrKey(event):
                for what, *rest in self._control.event(event):
                    if what == "pick":
                        self._tell({"type": "reply", "id": None, "what": "pick", **self._control.pick(*rest[:3], moves=rest[3])})
                    else:
                        self._control.act(what)
            case Change() as change:
                self._set(change)
            case Request() as request:
                self._do(request)

    def _set(self, change: Change) -> None:
        self._updates.heard = self._updates.heard if change.number is None else change.number
        try:
            self._control.change(change)
        except Exception:
            self._guarded(lambda: self._updates.state(again=True))
            raise
        self._updates.state()

    def _do(self, request: Request) -> None:
        act = actions.action_of(request)
        answer = {"type": "reply", "id": request.id, "what": request.what}
        try:
            more, data = act(self._parts, request)
        except Gone:
            raise
        except Exception as error:
            self._tell({**answer, "error": str(error) or type(error).__name__})
            raise
        self._tell({**answer, **more}, data)
        self._updates.state()

    def _tell(self, message: Message, data: bytes | None = None) -> None:
        if self._closed:
            raise Gone
        try:
            self._send(message, data)
        except Exception as error:
            raise Gone from error

    # -- pictures ----------------------------------------------------------------------------------------------

    def _work(self) -> None:
        match Wait(None) if self._closed else self._job():
            case FindFacts():
                self._updates.find_facts()
            case Draw(name, first):
                try:
                    self._draw(name, first)
                except Gone:
                    raise
                except Exception:
                    self._failed.add(name)
                    raise

    def _draw(self, name: str, first: bool) -> None:
        control = self._control
        moving, context = control.moving, control.context()
        key, size = control.key(name), context.size(name)
        self._shown[name] = Shown(key, True)  # what fails is not tried again before something changes
        look = control.look(name)
        if not moving:
            self._coarse.clear()
        known, took = self._took.get(name, (None, 0.0))
        # whether nothing comes before the final picture: what is shown is close to it
        at_once = not moving and (not first or name == control.released) and known == look and took <= _SOON
        if name == control.released:
            control.released = None
        budget = WHOLE if at_once else _STILL if not first else _LONGER if name in self._coarse else _BUDGET
        sent = 0

        def stop() -> bool:
            """The first picture comes in any case, or a drag without a pause would show none; but not when that ends."""
            return self._closed or (self._busy() if sent > 0 or not first or at_once else moving and self._drag_ends())

        wanted = pixels_of(size, _MOVING_PIXELS * self._throttle.scale if moving else _MOST_PIXELS)
        order = Order(context, self.state, name, wanted, budget, stop, moving, self._background.__len__)
        began, last = time.perf_counter(), None
        with closing(self._drawer.shots(order)) as shots:
            for shot in shots:
                if (shot.final or not sent) and not self._may_send():
                    self._drawer.forget_sketch()
                    break
                if not self._throttle.full:  # pictures in between are left out if the client is slow
                    self._send_frame(name, size, shot, time.perf_counter() - began)
                    sent, last = sent + 1, shot
                    if moving and shot.pixels.shape[0] * shot.pixels.shape[1] < min(_FINE, wanted[0] * wanted[1]):
                        self._coarse.add(name)  # until it rests, or sizes would alternate
                if stop():
                    break
        done = last is not None and last.final
        self._shown[name] = Shown(key, done)
        if not sent and not self._busy():
            control.pause()  # nothing came of it
        if last is not None and done:
            self._took[name] = look, time.perf_counter() - began
            self._updates.statistics(name, last, self._throttle.fps(time.monotonic()), self._throttle.latency)

    def _drag_ends(self) -> bool:
        with self._condition:
            return any(map(protocol.ends_drag, self._inbox))

    def _may_send(self) -> bool:
        """Whether the client has room for a frame; waits for it, until something else comes."""
        with self._condition:
            self._condition.wait_for(lambda: self._busy() or not self._throttle.full, _PATIENCE)
            if self._throttle.full and not self._busy():
                self._throttle.give_up()
            return not self._throttle.full

    def _send_frame(self, name: str, size: PaneSize, shot: Shot, seconds: float) -> None:
        data = png(shot.pixels) if shot.final else jpeg(shot.pixels, self._throttle.quality)
        if name in self._failed:  # what hindered it is over
            self._failed.remove(name)
            self._updates.status("", "info")
        with self._condition:
            number = self._throttle.send(time.monotonic())
        self._tell(_frame(number, name, size, shot, seconds), data)
        self._updates.frame(shot, quiet=bool(self._failed))


def _said(error: Exception) -> str:
    """What the client reads of an error; faults of ours are logged."""
    if isinstance(error, ClvolError):
        return str(error)
    if isinstance(error, MemoryError):
        return "out of memory: what is shown does not fit; take a smaller window or another filter"
    _LOG.error("in a session of a view", exc_info=error)
    return f"{type(error).__name__}: {error}"


def _frame(number: int, name: str, size: PaneSize, shot: Shot, seconds: float) -> Message:
    message: Message = {
        "type": "frame",
        "number": number,
        "pane": name,
        "width": shot.pixels.shape[1],
        "height": shot.pixels.shape[0],
        "shown_width": size.width,
        "shown_height": size.height,
        "format": "png" if shot.final else "jpeg",
        "final": shot.final,
        "seconds": round(seconds, 4),
    }
    optional = {"step": shot.step, "few": shot.few or None, "share_visited": shot.visited}
    return message | {key: value for key, value in optional.items() if value is not None}
