"""A session: one client of a view, and the thread that draws for it. The newest state wins."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping
from typing import Any

from clvol.base.errors import ClvolError, DeviceError
from clvol.view import actions, code, protocol
from clvol.view.audience import Pick
from clvol.view.control import Control
from clvol.view.drawing import Drawer
from clvol.view.files import FILES
from clvol.view.layers import follow
from clvol.view.notices import Notices
from clvol.view.pictures import Pictures
from clvol.view.post import Gone, Post
from clvol.view.protocol import Change, PointerOrKey, Request, Resize, Send
from clvol.view.readout import Readout
from clvol.view.resident import Resident
from clvol.view.schedule import Draw, FindFacts, Read, Wait
from clvol.view.state import State
from clvol.view.updates import Updates

__all__ = ["Session"]

_LOG = logging.getLogger("clvol.view")


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
        self._resident, self._post = resident, Post(send)
        self._control, self._drawer = Control(resident, first), Drawer(resident)
        post = self._post
        resident.layers.watch(post)
        self._notices = Notices(post.tell)
        self._updates = Updates(resident, self._control, post.background, post.tell, self._notices, post.is_closed)
        self._parts = actions.Parts(resident, self._control, self._updates, post.jobs)
        post.jobs.waits = lambda: post.busy() or self._control.moving  # what came may begin a drag
        self._pictures = Pictures(resident, self._control, self._drawer, self._updates, self._notices, post)
        self._pictures.meanwhile = self._tell_files
        self._readout = Readout(self._control, post)
        self._lost_at: State | None = None  # the state in which the device failed
        self._told = first  # what listeners know
        self._given: State | None = None  # what `show` was given last, until it is shown
        resident.audience.join(self)
        self._thread = threading.Thread(target=self._run, name="clvol view", daemon=True)
        self._thread.start()

    # -- for hosts, from any thread ----------------------------------------------------------------------------

    @property
    def state(self) -> State:
        """What is shown."""
        return self._given or self._control.state

    @property
    def working(self) -> float:
        """Seconds for which its thread has worked and shown no progress: it may hang."""
        return self._post.pulse.pause

    @property
    def closed(self) -> bool:
        """Whether it has ended."""
        return self._post.closed

    def receive(self, message: Mapping[str, Any]) -> None:
        """Take a client's message; returns at once."""
        self._post.put(message)

    def show(self, state: State) -> None:
        """Show another state, from any thread; it is in `state` at once."""
        with self._post.condition:  # together
            self._given = state
            self.receive(_shows(state))

    def close(self, timeout: float | None = 10.0) -> None:
        """End it; what is being drawn is stopped. Other sessions of the view go on."""
        self._post.close()
        if threading.current_thread() is not self._thread:
            self._thread.join(timeout)
            self._post.background.join(timeout)
            self._post.jobs.join(timeout)

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
            self._post.close()
            self._resident.audience.leave(self)

    def _guarded(self, work: Callable[[], None], source: str = "request") -> None:
        """Do it; errors are sent to the client, and the session goes on."""
        try:
            work()
        except Gone:
            raise
        except Exception as error:
            self._fail(error, source)

    def _fail(self, error: Exception, source: str = "request") -> None:
        if isinstance(error, DeviceError) and not isinstance(error, MemoryError):
            self._resident.forget()
            if self._lost_at != self.state:  # try once more with new renderers
                self._lost_at = self.state
                self._pictures.forget()
        self._notices.put(source, _said(error), "error")

    def _wait(self) -> bool:
        """Wait for something to do; False at the end."""
        post = self._post
        try:
            with post.condition:
                while not post.came():
                    job = self._pictures.next_job(self._readout.due_in())
                    if not isinstance(job, Wait):
                        break
                    with post.pulse.resting():
                        post.condition.wait(job.seconds)
                return not post.closed
        except Exception as error:
            self._fail(error)
        with post.condition, post.pulse.resting():  # what is shown cannot be drawn: until something arrives
            post.condition.wait_for(post.came)
            return not post.closed

    def _work(self) -> None:
        match Wait(None) if self._post.closed else self._pictures.next_job(self._readout.due_in()):
            case FindFacts():
                self._updates.find_facts()
            case Draw(name, first):
                self._guarded(lambda: self._pictures.draw(name, first), name)
            case Read():
                self._readout.tell()

    # -- messages ----------------------------------------------------------------------------------------------

    def _take(self) -> None:
        """Everything that came."""
        post = self._post
        with post.condition:
            post.woken = False
            messages, warning = post.inbox.take_all()
            given = self._given
            ready = post.background.take()
        for message in ready:
            post.tell(message)
        if warning:
            self._notices.put("request", warning, "error")
        for received in messages:
            if post.closed:
                return
            self._guarded(lambda received=received: self._handle(received))  # type: ignore[misc]  # bound at once
        if given is not None and self._given is given:  # it was among those dropped, but is in `state`
            self._guarded(lambda: self._handle(_shows(given)))
        self._updates.forget_errors()
        follow(self._control)
        restored, lost = self._control.left_out
        self._notices.put("layers", lost if restored == self._control.state else "", "warning")
        self._guarded(self._updates.volume)  # once, however many steps along an axis came: only the last is drawn
        if self._control.inputs.drag is None and not self._control.moving:
            self._updates.state()
            self._updates.curve()
        self._updates.measures()
        self._updates.overlays()
        self._tell_files()

    def _tell_files(self) -> None:
        """How far files are, and those that are ready."""
        jobs = self._post.jobs
        news, ready = jobs.take()
        if news or ready:
            self._notices.put("doing", jobs.doing, "busy")  # before replies: a page then says that it has saved a file
        for message in news:
            self._post.tell(message)
        for done in ready:
            self._post.tell(done.message, done.data)
            if done.error is not None:
                self._fail(done.error)

    def _handle(self, received: Mapping[str, Any]) -> None:
        self._post.pulse.beat()
        follow(self._control)
        message = protocol.parse(received)
        via = message.via if isinstance(message, Change) else None
        if via is None and not isinstance(message, Resize):
            self._resident.audience.use(self)
        try:
            match message:
                case Resize(pane, size):
                    self._control.sizes[pane] = size
                    self._pictures.forget(pane)  # it may be a new one, which shows nothing yet
                case PointerOrKey(event):
                    for what, *rest in self._control.event(event):
                        if what == "pick":
                            self._pick(*rest)
                        else:
                            self._control.act(what)
                case Change():
                    self._set(message)
                    if via is None:
                        self._notices.put("request")  # what was at fault is over
                case Request():
                    self._do(message)
                    self._notices.put("request")
        finally:
            before, self._told = self._told, self._control.state
            if self._told != before:
                self._resident.audience.tell("change", self._told, before, via or frozenset())

    def _pick(self, name: str, x: float, y: float, moves: bool) -> None:
        found = self._control.pick(name, x, y, moves=moves)
        self._post.tell({"type": "reply", "id": None, "what": "pick", **found})
        if found["position"] is not None:
            self._resident.audience.tell("pick", Pick.of(found))

    def _set(self, change: Change) -> None:
        self._updates.heard = self._updates.heard if change.number is None else change.number
        try:
            self._control.change(change)
        except Exception:
            self._guarded(lambda: self._updates.state(again=True))
            raise
        finally:
            if change.changes is self._given:
                self._given = None
        self._updates.state()

    def _do(self, request: Request) -> None:
        answer = {"type": "reply", "id": request.id, "what": request.what}
        try:
            if (act := actions.action_of(request, FILES)) is None:
                self._post.jobs.start(answer, FILES[request.what](self._parts, request))
                return
            more, data = act(self._parts, request)
        except Gone:
            raise
        except Exception as error:
            self._post.tell({**answer, "error": str(error) or type(error).__name__})
            raise
        self._post.tell({**answer, **more}, data)
        self._updates.state()


def _shows(state: State) -> protocol.Message:
    """The message that shows a state of a program's."""
    return {"type": "set", "changes": state, "whole": True, "via": frozenset()}


def _said(error: Exception) -> str:
    """What the client reads of an error; faults of ours are logged."""
    if isinstance(error, ClvolError):
        return str(error)
    if isinstance(error, MemoryError):
        return "out of memory: what is shown does not fit; take a smaller window or another filter"
    _LOG.error("in a session of a view", exc_info=error)
    return f"{type(error).__name__}: {error}"
