"""A session: one client's state, and the worker thread that draws it. The newest state wins.

Messages are JSON objects; a frame is one with bytes beside it. Beyond the protocol of `event`, `set`, `do` and `ack`:

- An event without "pane" is for the pane that is shown; a `resize` without it is for all panes that had none of their own.
- `{"type": "set", "changes": {...}, "live": true, "gesture": "..."?}` is one of several that make one step of undo (a slider
  that is dragged); one without "live" ends them, and is of the same step if it bears the gesture's name. A "number" comes back
  with the states that know of it, as "heard": a client that has set more meanwhile goes on showing that.
- `{"type": "state", ..., "heard": ..., "effective": {...}?}`: what applies where the state leaves it open: "transfer" (points),
  "window" of slices, "filter" by its full name, "options" of the mode (the isovalue), "crosshair". The first may come without,
  and a second one when that is known.
- A `frame` with `"few": true` shows few of the volume's samples: the coefficients of all are being made.
- `{"type": "overlay", "pane", "crosshair": [x, y] | null, "box": [[x, y] | null, ... 8] | null, "faces", "unit_pixels", "right",
  "down"}`: where to draw the crosshair and the crop box, in CSS pixels of the pane (corner ``i`` is at the high end along x, y, z
  where bit 0, 1, 2 of ``i`` is set); `faces` has ``[axis, side, x, y]`` of each clip plane that can be dragged there; how many CSS
  pixels a world unit has, and what runs to the right and down. Sent when one changed.
- `{"type": "wiper", "errors": {...}}`: the measured error of both filters, when it is known (`clvol.view.wiper`); null before.
- `{"type": "do", "what": "save_picture", "width", "height", "pane"?}` replies with a PNG; "movie" with a file of `frames` pictures
  ("format": "gif", "mp4", "webm" or "zip" of PNG).
- "pick" takes x, y and pane; a double click is answered by a reply without an id.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.checks import number, one_of, whole
from clvol.base.errors import ClvolError, DeviceError, OptionError
from clvol.view import code, events, pick, wiper
from clvol.view.drawing import WHOLE, Drawer, Shot, share_visited, sketched
from clvol.view.encode import jpeg, png
from clvol.view.events import Hands, Place
from clvol.view.panes import Pane3D, PaneSize, bounds, visible
from clvol.view.resident import Resident
from clvol.view.slices import window_of_slices
from clvol.view.state import PANES, History, State

__all__ = ["Session"]

_LOG = logging.getLogger("clvol.view")
_BUDGET = 0.04  # seconds for a first picture
_LONGER = 0.065  # and for those of a drag that goes on, where they would be coarser than so many pixels
_FINE = 80 * 80
_STILL = 0.25  # seconds for the first one at rest: if the still picture itself takes no longer, nothing comes before it
_SOON = 1.0  # likewise if the last still picture took no longer than this
_PAUSE = 0.1  # seconds after which a pointer that is down rests
_WHEEL_REST = 0.12
_UNSEEN = 2  # frames that were not acknowledged, at most
_UNSIZED = 0.5  # seconds for a client to say how large its panes are: what else it is told waits for its first picture
_LOST = 2.0  # seconds after which an acknowledgement does not come any more
_MOVING_PIXELS = 1920 * 1080
_MOST_PIXELS = 3840 * 2160
_SKETCHED = "a sketch of few samples, until the coefficients of all are there", "busy"
_COARSER = "finer samples are being read", "busy"
_COMPLETE = "", "info"
_SMALLEST, _LARGEST, _MOST_RATIO = 16.0, 8192.0, 4.0
_MOST_WAITING = 4096
_MOST_PICTURE = 1 << 13  # along an edge of a picture that is saved
_QUALITY = 60, 90  # of JPEG
_SLOW, _FAST = 0.15, 0.05  # seconds of a round trip

Array = NDArray[np.uint8]
Send = Callable[[dict[str, Any], bytes | None], None]


@dataclass
class _Shown:
    """What a pane shows."""

    key: object = None
    final: bool = False


class Session:
    """One client of a view; its thread starts with it and ends with `close`.

    Parameters
    ----------
    resident : Resident
        What is looked at, shared with other sessions.
    send : callable
        ``send(message, data)``, called from the session's thread; `data` is None but for pictures and files. An exception of
        its own ends the session: the client is gone.
    state : State, optional
        What is shown first; by default the view's.
    """

    def __init__(self, resident: Resident, send: Send, state: State | None = None) -> None:
        self._resident = resident
        self._send = send
        first = resident.initial if state is None else state
        resident.require(first)
        self._drawer = Drawer(resident)
        self._history = History(first)
        self._hands = Hands()
        self._sizes: dict[str, PaneSize] = {}
        self._shown: dict[str, _Shown] = {}
        self._released: str | None = None  # the pane in which a drag has just ended
        self._took: dict[str, tuple[object, float]] = {}  # what each pane's last still picture was of, and its seconds
        self._overlays: dict[str, object] = {}
        self._told: Any = None  # the state, the number of the last change, and whether there is something to undo and to redo
        self._heard: int | None = None
        self._told_of = _COMPLETE  # what was said of the last frame
        self._described: object = None  # the place of the volume that the client was told of
        self._told_all, self._began = False, time.monotonic()
        self._compared: object = None
        self._lost_at: State | None = None
        self._wheel_at = self._moved_at = -math.inf
        self._number = 0
        self._unseen: dict[int, float] = {}
        self._quality, self._scale, self._latency = 85, 1.0, 0.0
        self._rates: deque[float] = deque(maxlen=16)
        self._asked: dict[str, object] = {}
        self._asides: dict[str, tuple[tuple[Any, ...], Callable[[], dict[str, Any] | None]]] = {}
        self._aside_thread: threading.Thread | None = None
        self._outgoing: deque[dict[str, Any] | None] = deque()
        self._inbox: deque[Mapping[str, Any]] = deque()
        self._condition = threading.Condition()
        self._closed = False
        self._overflowed = False
        self._undrawn: set[str] = set()  # panes of which something hindered the picture
        self._coarse: set[str] = set()  # panes of which the pictures of this drag would be coarse
        self._thread = threading.Thread(target=self._run, name="clvol view", daemon=True)
        self._thread.start()

    # -- for hosts, from any thread ----------------------------------------------------------------------------

    @property
    def state(self) -> State:
        """What is shown."""
        return self._history.present

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
                self._acknowledged(message.get("frame"))
            elif len(self._inbox) < _MOST_WAITING:
                if self._inbox and _replaces(message, self._inbox[-1]):
                    self._inbox.pop()
                self._inbox.append(message)
            else:
                self._overflowed = True
            self._condition.notify_all()

    def close(self, timeout: float | None = 10.0) -> None:
        """End it; what is being drawn is stopped. Other sessions of the view go on."""
        with self._condition:
            self._closed = True
            self._inbox.clear()
            self._condition.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join(timeout)
            aside = self._aside_thread
            if aside is not None:
                aside.join(timeout)

    def python(self) -> str:
        """A program that draws the still picture of the active pane, bit for bit."""
        return self._code("python")

    def toml(self) -> str:
        """The options of `clvol render` that draw it, as TOML, and the command."""
        return self._code("toml")

    def url(self) -> str:
        """The state as the fragment of an address, ``#s=...``; `State.from_url` of `clvol.view.code` reads it."""
        return code.to_url(self.state)

    def _code(self, what: str) -> str:
        state = self.state
        name = state.active if state.active in visible(state) else visible(state)[0]
        made: str = getattr(code, what)(self._resident, state, name, self._place().size(name), _pixels(self._place().size(name)))
        return made

    # -- the thread --------------------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            self._guarded(self._tell_volume)
            self._guarded(self._tell_state)
            while self._waited():
                self._guarded(self._take)
                self._guarded(self._draw_next)
        except _Gone:
            _LOG.debug("a client is gone")
        finally:
            self._drawer.give_up()
            with self._condition:
                self._closed = True
                self._inbox.clear()

    def _guarded(self, work: Callable[[], None]) -> None:
        """Do it; what goes wrong is told, and the session goes on."""
        try:
            work()
        except _Gone:
            raise
        except Exception as error:
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        if isinstance(error, DeviceError):
            if not isinstance(error, MemoryError):
                self._resident.forget()
                if self._lost_at != self.state:  # once more with a device that is asked anew
                    self._lost_at = self.state
                    self._shown.clear()
            self._status(str(error), "error")
        elif isinstance(error, ClvolError):
            self._status(str(error), "error")
        elif isinstance(error, MemoryError):
            self._status("out of memory: what is shown does not fit; take a smaller window or another filter", "error")
        else:
            _LOG.error("in a session of a view", exc_info=error)
            self._status(f"{type(error).__name__}: {error}", "error")

    def _waited(self) -> bool:
        """As `_wait`; what goes wrong with what is shown is told, and looked at again when something comes."""
        try:
            return self._wait()
        except Exception as error:
            self._fail(error)
        with self._condition:
            self._condition.wait_for(lambda: self._closed or bool(self._inbox or self._outgoing))
            return not self._closed

    def _wait(self) -> bool:
        """Wait for something to do; False at the end."""
        with self._condition:
            while not self._closed:
                if self._inbox or self._outgoing:
                    return True
                pause = self._pause()
                if pause is not None and pause <= 0:
                    return True
                self._condition.wait(pause)
        return False

    def _pause(self) -> float | None:
        """Seconds until there is something to draw; None: not before something comes."""
        now = time.monotonic()
        for frame in [n for n, sent in self._unseen.items() if now - sent > _LOST]:
            del self._unseen[frame]
        job = self._job()
        if job is None:
            waits = not self._told_all and self._asked.get("facts") != ("facts", self.state)
            return max(0.0, self._began + _UNSIZED - now) if waits else None
        if len(self._unseen) >= _UNSEEN:
            return max(0.001, _LOST - (now - min(self._unseen.values())))
        _, first = job
        return 0.0 if first else max(0.0, self._rest_at() - now)

    def _rest_at(self) -> float:
        """When pictures may be refined, if nothing happens."""
        if self._hands.drag is not None:
            return self._moved_at + _PAUSE
        return self._wheel_at + _WHEEL_REST

    @property
    def _moving(self) -> bool:
        return time.monotonic() < self._rest_at()

    def _busy(self) -> bool:
        """Whether something came, or the session ends."""
        return self._closed or bool(self._inbox)

    def _drag_ends(self) -> bool:
        with self._condition:
            return any(isinstance(one, Mapping) and _kind_of(one.get("event")) == "pointer_up" for one in self._inbox)

    # -- messages ----------------------------------------------------------------------------------------------

    def _take(self) -> None:
        """Everything that came."""
        with self._condition:
            messages, overflowed = list(self._inbox), self._overflowed
            self._inbox.clear()
            self._overflowed = False
            outgoing = list(self._outgoing)
            self._outgoing.clear()
        for ready in outgoing:
            if ready is not None:
                self._tell(ready)
        if overflowed:
            self._status(f"more than {_MOST_WAITING} messages waited; some were dropped", "error")
        for message in messages:
            if self._closed:
                return
            self._guarded(lambda message=message: self._handle(message))  # type: ignore[misc]  # bound at once
        self._forget_errors()
        self._guarded(self._tell_volume)  # once, however many steps along an axis came: only the last one is drawn
        if self._hands.drag is None and not self._moving:
            self._tell_state()
        self._tell_overlays()

    def _handle(self, message: Mapping[str, Any]) -> None:
        if not isinstance(message, Mapping):
            raise OptionError(f"a message must be an object of JSON; got {message!r:.200}")
        kind = message.get("type")
        if kind == "event":
            self._event(message.get("event"))
        elif kind == "set":
            self._set(message)
        elif kind == "do":
            self._do(message)
        else:
            raise one_of("the type of a message", kind, ("event", "set", "do", "ack"))

    def _event(self, event: Any) -> None:
        if _kind_of(event) == "resize":
            self._resize(event)
            return
        made = events.reduce(self.state, self._hands, event, self._place())
        now = time.monotonic()
        changed = made.state != self.state
        if made.hands.drag is not None and (changed or self._hands.drag is None):
            self._moved_at = now
        if changed and made.gesture is not None and made.gesture.startswith("wheel"):
            self._wheel_at = now
        ended = self._hands.drag is not None and made.hands.drag is None
        before = self._history if not self._hands_began(made) else self._history.ended()
        gesture = made.gesture
        if gesture is not None and gesture != "drag" and now - self._gesture_at > 1.0:
            before = before.ended()
        self._gesture_at = now
        self._history = before.with_state(made.state, gesture)
        if ended:
            self._history = self._history.ended()
            self._released = self._hands.drag.pane if changed and self._hands.drag is not None else None
        self._hands = made.hands
        for wish in made.wishes:
            self._grant(wish)

    _gesture_at = -math.inf

    def _hands_began(self, made: events.Reduced) -> bool:
        return self._hands.drag is None and made.hands.drag is not None

    def _grant(self, wish: tuple[Any, ...]) -> None:
        what, *rest = wish
        if what == "undo":
            self._history = self._history.undone()
        elif what == "redo":
            self._history = self._history.redone()
        else:
            name, x, y, moves = rest
            found = self._pick(name, x, y)
            if moves and found["position"] is not None:
                point = tuple(found["position"])
                self._history = self._history.with_state(replace(self.state, crosshair=point))
            self._tell({"type": "reply", "id": None, "what": "pick", **found})

    def _resize(self, event: Mapping[str, Any]) -> None:
        name = event.get("pane", "")
        if name != "" and name not in PANES:
            raise one_of("pane", name, PANES)
        width, height = (number(what, event.get(what), minimum=0, maximum=1e6) for what in ("width", "height"))
        ratio = number("ratio", event.get("ratio", event.get("pixel_ratio", 1)), above=0, maximum=16)
        width, height = (min(max(edge, _SMALLEST), _LARGEST) for edge in (width, height))
        self._sizes[name] = PaneSize(width, height, min(max(ratio, 0.25), _MOST_RATIO))

    def _set(self, message: Mapping[str, Any]) -> None:
        changes, count = message.get("changes"), message.get("number")
        self._heard = count if isinstance(count, int) else self._heard
        try:
            made = State.from_json(changes) if message.get("whole") else self.state.changed(changes)  # type: ignore[arg-type]  # it is checked
            made = self._seen_from_there(made, whole=bool(message.get("whole")))
        except Exception:
            self._told = None  # a page shows a change at once, and must learn that it did not happen
            self._guarded(self._tell_state)
            raise
        live, given = bool(message.get("live")), message.get("gesture")
        named = ("set", given) if isinstance(given, str) else ("set", *sorted(map(str, changes))) if live else None  # type: ignore[arg-type]
        self._history = self._history.with_state(made, named)
        if live:
            self._wheel_at = time.monotonic()
        else:
            self._history = self._history.ended()
        self._tell_state()

    def _seen_from_there(self, made: State, *, whole: bool) -> State:
        """A state that is to be shown, unless only the volume can refuse it; the camera stays where another volume is shown."""
        state, resident = self.state, self._resident
        if (made.index, made.labels) != (state.index, state.labels):  # all that `require` looks at: a slider changes neither
            resident.require(made)
        if replace(made, index=state.index, labels=state.labels) != state:
            resident.transfer(made)
        if whole or made.camera != state.camera or resident.which(made) == resident.which(state):
            return made
        return replace(made, camera=self._place().pinned(state).camera)

    def _do(self, message: Mapping[str, Any]) -> None:
        what, answer = message.get("what"), {"type": "reply", "id": message.get("id"), "what": message.get("what")}
        if not isinstance(what, str) or what not in _DEEDS:
            raise one_of("what to do", what, _DEEDS)
        try:
            more, data = getattr(self, f"_do_{what}")(message)
        except _Gone:
            raise
        except Exception as error:
            self._tell({**answer, "error": str(error) or type(error).__name__})
            raise
        self._tell({**answer, **more}, data)
        self._tell_state()

    def _do_undo(self, _: Mapping[str, Any]) -> tuple[dict[str, Any], None]:
        self._history = self._history.undone()
        return {}, None

    def _do_redo(self, _: Mapping[str, Any]) -> tuple[dict[str, Any], None]:
        self._history = self._history.redone()
        return {}, None

    def _do_reset(self, _: Mapping[str, Any]) -> tuple[dict[str, Any], None]:
        self._history = self._history.ended().with_state(events.reset(self.state, self._place()))
        return {}, None

    def _do_fit(self, _: Mapping[str, Any]) -> tuple[dict[str, Any], None]:
        self._history = self._history.ended().with_state(events.fit(self.state))
        return {}, None

    def _do_heat(self, _: Mapping[str, Any]) -> tuple[dict[str, Any], None]:
        self._history = self._history.with_state(replace(self.state, heat=not self.state.heat))
        return {"heat": self.state.heat}, None

    def _do_pick(self, message: Mapping[str, Any]) -> tuple[dict[str, Any], None]:
        name = message.get("pane") or (self.state.active if self.state.active in visible(self.state) else visible(self.state)[0])
        if name not in PANES:
            raise one_of("pane", name, PANES)
        x, y = (number(axis, message.get(axis), minimum=-1e6, maximum=1e6) for axis in "xy")
        return self._pick(name, x, y), None

    def _do_labels(self, message: Mapping[str, Any]) -> tuple[dict[str, Any], None]:
        rows, count = self._resident.labels(self.state, message.get("words", ""))
        return {"rows": rows, "count": count}, None

    def _do_copy_python(self, _: Mapping[str, Any]) -> tuple[dict[str, Any], None]:
        return {"text": self.python()}, None

    def _do_copy_toml(self, _: Mapping[str, Any]) -> tuple[dict[str, Any], None]:
        return {"text": self.toml()}, None

    def _do_copy_url(self, _: Mapping[str, Any]) -> tuple[dict[str, Any], None]:
        return {"text": self.url()}, None

    def _do_save_picture(self, message: Mapping[str, Any]) -> tuple[dict[str, Any], bytes]:
        state = self.state
        name = message.get("pane") or (state.active if state.active in visible(state) else visible(state)[0])
        if name not in PANES:
            raise one_of("pane", name, PANES)
        size = self._place().size(name)
        own = _pixels(size)
        width = whole("width", message.get("width", own[0]), 1, _MOST_PICTURE)
        height = whole("height", message.get("height", own[1]), 1, _MOST_PICTURE)
        self._status("drawing the picture", "busy")
        pixels = self._still(name, (width, height))
        if pixels is None:
            raise _Gone
        self._status("", "info")
        return {"format": "png", "width": width, "height": height, "name": "clvol.png"}, png(pixels)

    def _do_movie(self, message: Mapping[str, Any]) -> tuple[dict[str, Any], bytes]:
        from clvol.view import movie

        size = self._place().size("3d")
        own = _pixels(size)
        width = whole("width", message.get("width", min(own[0], 512)), 16, 1920)
        height = whole("height", message.get("height", min(own[1], 512)), 16, 1920)
        frames = whole("frames", message.get("frames", 60), 2, 360)
        wanted = message.get("format", "gif")
        if wanted not in movie.FORMATS:
            raise one_of("format", wanted, movie.FORMATS)

        def progress(share: float) -> bool:
            self._status(f"drawing the movie: {share:.0%}", "busy")
            return not self._closed

        place = self._place()
        data = movie.turntable(self._resident, self.state, place, (width, height), frames, str(wanted), progress)
        self._status("", "info")
        return {"format": wanted, "name": f"clvol.{wanted}", "frames": frames}, data

    # -- what is known -----------------------------------------------------------------------------------------

    def _place(self) -> Place:
        return Place(
            volume=self._resident.volume,
            placed=self._resident.placed,
            sizes=self._sizes,
            isovalue=lambda state: float(getattr(self._resident.mode(state), "isovalue", 0.0) or 0.0),
            window=self._window,
            anchor=self._anchor,
            stepped=self._resident.stepped,
            initial=self._resident.initial,
        )

    def _window(self, state: State, name: str) -> tuple[float, float]:
        if state.window is not None:
            return state.window
        if name != "3d":
            return window_of_slices(self._resident.volume_of(state))
        low, high = self._resident.transfer(replace(state, transfer=None)).value_range
        return low / 2 + high / 2, (high - low) or 1.0

    def _anchor(self, state: State, x: float, y: float) -> NDArray[np.float64] | None:
        place = self._place()
        which = self._resident.which(state)
        if not self._resident.soon(state.filter, state.boundary, which):
            return None  # a sketch is turned and zoomed all the same
        pane = place.pane(state, "3d")
        assert isinstance(pane, Pane3D)  # of the volume
        with self._resident.renderer(state.filter, state.boundary, which) as renderer:
            return pick.hit(renderer, pane, x, y, self._resident.arguments(state))

    def _pick(self, name: str, x: float, y: float) -> dict[str, Any]:
        state = self.state
        pane = self._place().pane(state, name)
        other = state.wiper is not None and x > state.wiper.at * self._place().size(name).width
        chosen = state.wiper.filter if state.wiper is not None and other else state.filter
        which = self._resident.which(state)
        if not self._resident.soon(chosen, state.boundary, which):
            raise OptionError("there is nothing to pick before the coefficients are there")
        with self._resident.renderer(chosen, state.boundary, which) as renderer:
            return pick.picked(renderer, pane, name, x, y, self._resident.arguments(state))

    # -- pictures ----------------------------------------------------------------------------------------------

    def _still(self, name: str, size: tuple[int, int]) -> Array | None:
        """The still picture of a pane in so many pixels, seen as high as it is shown."""
        place = self._place()
        own = place.size(name)
        fitted = PaneSize(own.height * size[0] / size[1], own.height, own.ratio)
        return self._drawer.still(replace(place, sizes={**self._sizes, name: fitted}), self.state, name, size, lambda: self._closed)

    def _job(self) -> tuple[str, bool] | None:
        """The pane to draw next, and whether it is the first picture of what it shows now."""
        state = self.state
        names = visible(state)
        order = sorted(names, key=lambda name: (name != self._focus(), name not in names))
        known = [name for name in order if name in self._sizes or "" in self._sizes]
        if "3d" in known and sketched(state) and not self._resident.soon(state.filter, state.boundary, self._resident.which(state)):
            known = ["3d"]  # slices wait for the coefficients, and would have it wait too
        for name in known:
            if self._shown.get(name, _Shown()).key != self._key(state, name):
                return name, True
        for name in known:
            if not self._shown[name].final:
                return name, False
        return None

    def _focus(self) -> str:
        return self._hands.drag.pane if self._hands.drag is not None else self.state.active

    def _key(self, state: State, name: str) -> object:
        """What the picture of a pane depends on."""
        size = self._place().size(name)
        which = self._resident.which(state)
        common = (size, which, state.filter, state.boundary, state.window, state.cmap, state.background, state.wiper)
        if name == "3d":
            return (
                *common,
                replace(state, layout="3d", active="3d", tool=None, slice=self._resident.initial.slice, crosshair=None),
            )
        point = state.crosshair or self._resident.volume.center
        return (*common, state.slice, float(point["xyz".index(name)]))

    def _look(self, state: State, name: str) -> object:
        """What the time depends on that the picture of a pane takes, but for the side from which it is seen."""
        initial = self._resident.initial
        camera = replace(state.camera, target=None, direction=initial.camera.direction, up=initial.camera.up)
        return self._key(replace(state, camera=camera, crosshair=None, slice=initial.slice), name)

    def _draw_next(self) -> None:
        job = self._job()
        if job is None and not self._told_all and time.monotonic() - self._began >= _UNSIZED:
            self._find_out()
        if self._closed or job is None or len(self._unseen) >= _UNSEEN:
            return
        name, first = job
        moving = self._moving
        if not first and moving:
            return
        try:
            self._draw(name, first, moving)
        except _Gone:
            raise
        except Exception:
            self._undrawn.add(name)
            raise

    def _draw(self, name: str, first: bool, moving: bool) -> None:
        state, place = self.state, self._place()
        key, size = self._key(state, name), place.size(name)
        # what fails is not tried again before something changes
        self._shown[name] = _Shown(key, True)
        wanted = _pixels(size, _MOVING_PIXELS * self._scale if moving else _MOST_PIXELS)
        sent = 0

        def stop() -> bool:
            """The first picture comes in any case, or a drag without a pause would show none; but not when that ends."""
            return self._closed or (self._busy() if sent > 0 or not first or at_once else moving and self._drag_ends())

        began = time.perf_counter()
        done = False
        if not moving:
            self._coarse.clear()
        budget = (_LONGER if name in self._coarse else _BUDGET) if first else _STILL
        look = self._look(state, name)
        known, took = self._took.get(name, (None, math.inf))
        # what is shown lies near the picture that comes
        at_once = not moving and (not first or name == self._released) and known == look and took <= _SOON
        if at_once:
            budget = WHOLE
        if name == self._released:
            self._released = None
        told = self._outgoing.__len__
        with closing(self._drawer.shots(place, state, name, wanted, budget, stop, coarse=moving, elsewhere=told)) as shots:
            for shot in shots:
                if (shot.final or not sent) and not self._may_send():
                    self._drawer.forget_sketch()
                    break
                if len(self._unseen) < _UNSEEN:  # a picture in between is left out, if the client is slow
                    self._send_frame(name, size, shot, time.perf_counter() - began)
                    sent, done = sent + 1, shot.final
                    if moving and shot.pixels.shape[0] * shot.pixels.shape[1] < min(_FINE, wanted[0] * wanted[1]):
                        self._coarse.add(name)  # until it rests, or sizes would alternate
                if stop():
                    break
        self._shown[name] = _Shown(key, done)
        if not sent and not self._busy():
            self._moved_at = time.monotonic()  # nothing came of it: not again at once
        if done:
            self._took[name] = look, time.perf_counter() - began
            self._report(state, name, shot)

    def _may_send(self) -> bool:
        """Whether the client has room for a frame; waits for it, until something else comes."""
        with self._condition:
            end = time.monotonic() + _LOST
            self._condition.wait_for(lambda: self._busy() or len(self._unseen) < _UNSEEN, max(0.0, end - time.monotonic()))
            if len(self._unseen) >= _UNSEEN and not self._busy():
                self._unseen.clear()
            return len(self._unseen) < _UNSEEN

    # -- to the client -----------------------------------------------------------------------------------------

    def _send_frame(self, name: str, size: PaneSize, shot: Shot, seconds: float) -> None:
        pixels, form = shot.pixels, "png" if shot.final else "jpeg"
        data = png(pixels) if shot.final else jpeg(pixels, self._quality)
        self._number += 1
        message: dict[str, Any] = {
            "type": "frame",
            "number": self._number,
            "pane": name,
            "width": pixels.shape[1],
            "height": pixels.shape[0],
            "shown_width": size.width,
            "shown_height": size.height,
            "format": form,
            "final": shot.final,
            "seconds": round(seconds, 4),
        }
        if shot.step is not None:
            message["step"] = shot.step
        if shot.few:
            message["few"] = True
        if shot.visited is not None:
            message["share_visited"] = shot.visited
        if name in self._undrawn:  # what hindered it is over
            self._undrawn.remove(name)
            self._status("", "info")
        with self._condition:
            self._unseen[self._number] = time.monotonic()
        self._rates.append(time.monotonic())
        self._tell(message, data)
        said = _SKETCHED if shot.few else _COARSER if shot.coarser else _COMPLETE
        if said != self._told_of and not self._undrawn:  # what hindered another pane is still to be read
            self._told_of = said
            self._status(*said)
        if not self._told_all:
            self._find_out()

    def _find_out(self) -> None:
        """Have found out what follows from the volume, once for a state: it may be the state that is wrong."""
        state = self.state

        def work() -> None:
            self._resident.effective(state)

        self._aside(("facts", state), work)

    def _report(self, state: State, name: str, shot: Shot) -> None:
        """Statistics of a still picture, and the errors of the wiper's filters: what takes long comes later."""
        recent = [at for at in self._rates if time.monotonic() - at < 2]
        fps = (len(recent) - 1) / (recent[-1] - recent[0]) if len(recent) > 1 and recent[-1] > recent[0] else 0.0
        stats = {"type": "stats", "fps": round(fps, 1), "latency_ms": round(1e3 * self._latency, 1), "visited": shot.visited}
        self._tell(stats)
        if name == "3d" and shot.visited is None:
            size = self._place().size(name)
            key = "visited", state, size
            self._aside(key, lambda: stats | {"visited": share_visited(self._resident, state, (size.width, size.height))})
        if state.wiper is not None:
            names = tuple(self._resident.filter_name(state, row) for row in (state.filter, state.wiper.filter))
            volume, boundary = self._resident.volume_of(state), state.boundary
            self._aside(
                ("wiper", names, boundary, self._resident.which(state)),
                lambda: {"type": "wiper", "errors": wiper.measured(volume, names, boundary, lambda: self._closed)},
            )

    def _forget_errors(self) -> None:
        """What was measured of other filters is not shown beside those that are compared now."""
        wiper = self.state.wiper
        which = self._resident.which(self.state)
        compared = None if wiper is None else (self.state.filter, wiper.filter, self.state.boundary, which)
        if compared == self._compared:
            return
        self._compared = compared
        with self._condition:
            self._asked.pop("wiper", None)
            self._asides.pop("wiper", None)
            self._outgoing = deque(one for one in self._outgoing if one is None or one["type"] != "wiper")
        self._tell({"type": "wiper", "errors": None})

    def _aside(self, key: tuple[Any, ...], work: Callable[[], dict[str, Any] | None]) -> None:
        """Have a message made by another thread, unless the last one of its kind was the same; pictures do not wait for it.

        Where that gives none, what it found out is looked at all the same.
        """
        with self._condition:
            if self._asked.get(key[0]) == key:
                return
            self._asked[key[0]] = key
            self._asides[key[0]] = key, work
            if self._aside_thread is None:
                self._aside_thread = threading.Thread(target=self._run_asides, name="clvol view: aside", daemon=True)
                self._aside_thread.start()

    def _run_asides(self) -> None:
        while True:
            with self._condition:
                if self._closed or not self._asides:
                    self._aside_thread = None
                    return
                kind = next(iter(self._asides))
                key, work = self._asides.pop(kind)
            try:
                message = work()
            except Exception as error:  # the picture is there all the same
                _LOG.debug("beside a picture: %s", error)
                if kind != "wiper":
                    continue
                message = {"type": "wiper", "errors": {"problem": str(error) or type(error).__name__, "filters": []}}
            with self._condition:
                if self._asked.get(kind) != key:  # something else is compared by now
                    continue
                self._outgoing.append(message)
                self._condition.notify_all()

    def _acknowledged(self, frame: Any) -> None:
        sent = self._unseen.pop(frame, None) if isinstance(frame, int) and not isinstance(frame, bool) else None
        if sent is None:
            return
        took = time.monotonic() - sent
        self._latency = took if not self._latency else 0.7 * self._latency + 0.3 * took
        low, high = _QUALITY
        if self._latency > _SLOW:
            self._quality, self._scale = max(low, self._quality - 5), max(0.1, 0.85 * self._scale)
        elif self._latency < _FAST:
            self._quality, self._scale = min(high, self._quality + 1), min(1.0, 1.05 * self._scale)

    def _tell_state(self) -> None:
        """What is shown; what follows from the volume is told later, if it is not known yet: pictures do not wait for it."""
        state, known = self.state, self._resident.knows(self.state)
        undo, redo = bool(self._history.past), bool(self._history.future)
        telling = (state, self._heard, undo, redo)
        if telling == self._told and known == self._told_all:
            return
        self._told, self._told_all = telling, known
        message = {"type": "state", "state": state.json(), "heard": self._heard, "can_undo": undo, "can_redo": redo}
        if known:
            message["effective"] = self._resident.effective(state)
        self._tell(message)

    def _tell_volume(self) -> None:
        """What there is to say of the volume: first, and when another one is shown."""
        place = self._resident.which(self.state).place
        if place != self._described:
            self._described = place  # what cannot be found out is told once
            self._tell(self._resident.info(self.state))

    def _tell_overlays(self) -> None:
        if not self._resident.knows(self.state):  # where things lie takes as long to find out
            return
        state, place = self.state, self._place()
        for name in visible(state):
            if name not in self._sizes and "" not in self._sizes:
                continue
            pane = place.pane(state, name)
            point = state.crosshair or tuple(map(float, self._resident.volume.center))
            cross = pane.project(point) if state.layout == "linked" or name != "3d" else None
            box, faces = None, []
            if events.shows_box(state, self._hands):
                faces = [list(face) for face in events.faces(state, place, name)]
                low, high = state.clip or bounds(self._resident.volume)
                ends = low, high
                box = [pane.project([ends[i >> axis & 1][axis] for axis in range(3)]) for i in range(8)]
            made = {
                "type": "overlay",
                "pane": name,
                "crosshair": cross,
                "box": box,
                "faces": faces,
                "unit_pixels": pane.unit_pixels,
                "right": pane.right.tolist(),
                "down": pane.down.tolist(),
            }
            if self._overlays.get(name) != made:
                self._overlays[name] = made
                self._tell(dict(made))

    def _status(self, text: str, kind: str) -> None:
        self._tell({"type": "status", "text": text, "kind": kind})

    def _tell(self, message: dict[str, Any], data: bytes | None = None) -> None:
        if self._closed:
            raise _Gone
        try:
            self._send(message, data)
        except Exception as error:
            raise _Gone from error


class _Gone(Exception):  # nothing went wrong
    """The client is no longer there, or the session was closed."""


_DEEDS = ("undo", "redo", "reset", "fit", "save_picture", "copy_python", "copy_toml", "copy_url", "pick", "heat", "movie", "labels")


def _kind_of(event: Any) -> Any:
    return event.get("event_type", event.get("type")) if isinstance(event, Mapping) else None


def _replaces(message: Any, other: Any) -> bool:
    """Whether a message makes the one before it needless: moves of a pointer, and resizes."""
    if not (isinstance(message, Mapping) and isinstance(other, Mapping) and message.get("type") == other.get("type") == "event"):
        return False
    one, two = message.get("event"), other.get("event")
    if not (isinstance(one, Mapping) and isinstance(two, Mapping)) or one.get("pane") != two.get("pane"):
        return False
    kinds = [_kind_of(event) for event in (one, two)]
    return kinds[0] == kinds[1] and kinds[0] in ("pointer_move", "resize")


def _pixels(size: PaneSize, most: float | None = None) -> tuple[int, int]:
    """Pixels of a picture that fills a pane."""
    width, height = size.width * size.ratio, size.height * size.ratio
    shrink = min(1.0, math.sqrt((_MOST_PIXELS if most is None else most) / (width * height)))
    return max(1, round(width * shrink)), max(1, round(height * shrink))
