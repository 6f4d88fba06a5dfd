"""What the panes of a client show, and how their next pictures are drawn and sent."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import closing

from clvol.base.checks import heard_by
from clvol.view.actions import MOST_PIXELS, pixels_of
from clvol.view.control import Control
from clvol.view.drawing import WHOLE, Drawer, Order, Shot, has_sketch, jpeg, png
from clvol.view.notices import Notices
from clvol.view.panes import PaneSize, visible
from clvol.view.post import Post
from clvol.view.protocol import Message
from clvol.view.resident import Resident
from clvol.view.schedule import Job, Shown, next_job
from clvol.view.state import PANES
from clvol.view.updates import Updates

__all__ = ["Pictures"]

_BUDGET = 0.04  # seconds for a first picture
_STILL = 0.25  # seconds for the first picture at rest: if the final one takes no longer, nothing comes before it
_SOON = 1.0  # seconds: nothing comes before a final picture if the last one took no longer than this
_UNSIZED = 0.5  # seconds that a client has to give the size of its panes; then facts no longer wait for its first picture
_MOVING_PIXELS = 1920 * 1080


class Pictures:
    """Of one session, drawn in its thread."""

    def __init__(
        self, resident: Resident, control: Control, drawer: Drawer, updates: Updates, notices: Notices, post: Post
    ) -> None:
        self._resident, self._control, self._drawer = resident, control, drawer
        self._updates, self._notices, self._post = updates, notices, post
        self.meanwhile: Callable[[], None] = lambda: None
        """Called in the session's thread while a picture is drawn and there is something to tell of files."""
        self._began = time.monotonic()
        self._shown: dict[str, Shown] = {}
        self._took: dict[str, tuple[object, float]] = {}  # by pane: what its last final picture showed, and its seconds
        self._sizes: dict[str, int] = {}  # of the last pictures

    def forget(self, pane: str = "") -> None:
        """Draw all of them again, or one."""
        for name in [pane] if pane else PANES:
            self._shown.pop(name, None)

    def next_job(self, read_in: float | None) -> Job:
        """What to do next; `read_in` are seconds until what lies under the pointer may be told."""
        control, updates, now = self._control, self._updates, time.monotonic()
        state, sizes = control.state, control.sizes
        panes = [name for name in sorted(visible(state), key=lambda name: name != control.focus) if name in sizes or "" in sizes]
        key, renderers = self._resident.catalog.key(state), self._resident.renderers
        return next_job(
            wanted={name: control.key(name) for name in panes},
            shown=self._shown,
            sketching="3d" in panes and has_sketch(state) and not renderers.soon(*key),
            rest_in=control.rests_at - now,
            room_in=self._post.room_in(),
            facts_in=None if updates.complete or updates.finding_facts else self._began + _UNSIZED - now,
            read_in=read_in,
        )

    def draw(self, name: str, first: bool) -> None:
        """Draw a pane, better and better, and send it, until it is final or something comes."""
        post, throttle, control = self._post, self._post.throttle, self._control
        moving, context = control.moving, control.context()
        key, size = control.key(name), context.size(name)
        self._shown[name] = Shown(key, True)  # what fails is not tried again before something changes
        look = control.look(name)
        known, took = self._took.get(name, (None, 0.0))
        # whether nothing comes before the final picture: what is shown is close to it
        at_once = not moving and (not first or name == control.released) and known == look and took <= _SOON
        if name == control.released:
            control.released = None
        budget = WHOLE if at_once else _BUDGET if first else _STILL
        coarse = moving or (first and name == "3d" and not (at_once or control.state.heat))  # as good as those of a drag
        sent = 0

        def stop() -> bool:
            """The first picture comes in any case, or a drag without a pause would show none; but not when that ends."""
            post.pulse.beat()
            if len(post.jobs):
                self.meanwhile()  # a picture may take longer than a file
            return post.closed or (post.busy() if sent > 0 or not first or at_once else moving and post.drag_ends())

        wanted = pixels_of(size, _MOVING_PIXELS * throttle.scale if coarse else MOST_PIXELS)
        order = Order(context, control.state, name, wanted, budget, stop, coarse, post.has_results)
        began, last = time.perf_counter(), None
        warned: list[str] = []
        with heard_by(warned.append), closing(self._drawer.shots(order)) as shots:
            for shot in shots:
                if (shot.final or not sent) and not post.may_send():
                    self._drawer.forget_sketch()
                    break
                worse = not (first or shot.final) and shot.pixels.size < self._sizes.get(name, 0)  # than what was there before rest
                if not (throttle.full or worse):  # pictures in between are left out if the client is slow
                    self._send(name, size, shot, time.perf_counter() - began)
                    sent, last = sent + 1, shot
                if stop():
                    break
        done = last is not None and last.final
        self._shown[name] = Shown(key, done)
        if not sent and not post.busy():
            control.pause()  # nothing came of it
        if last is not None and done:
            self._notices.put(f"{name}: warnings", "; ".join(dict.fromkeys(warned)), "warning")
            self._took[name] = look, time.perf_counter() - began
            self._updates.statistics(name, last, throttle.fps(time.monotonic()), throttle.latency)

    def _send(self, name: str, size: PaneSize, shot: Shot, seconds: float) -> None:
        throttle = self._post.throttle
        data = png(shot.pixels) if shot.final else jpeg(shot.pixels, throttle.quality)
        self._notices.put(name)  # what hindered it is over
        self._sizes[name] = shot.pixels.size
        with self._post.condition:
            number = throttle.send(time.monotonic())
        self._post.tell(_frame(number, name, size, shot, seconds), data)
        self._updates.frame(shot)


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
