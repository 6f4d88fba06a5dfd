"""Files that take long: made one after the other in a thread of a session, which goes on drawing; each can be cancelled."""

from __future__ import annotations

import atexit
import contextlib
import logging
import threading
import time
import weakref
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeAlias, TypeVar

from clvol.base.errors import OptionError
from clvol.base.progress import Progress
from clvol.view.protocol import Message

__all__ = ["Answer", "Cancelled", "Done", "Jobs", "Reins", "Task"]

Made = TypeVar("Made")
_LOG = logging.getLogger("clvol.view")
_MOST = 16  # files at once
_EVERY = 0.1  # seconds between two messages of one file's progress
_TICK = 0.02  # seconds between looks at whether what is dragged has come to rest
_END = 30.0  # seconds that the end of the program waits for what is computed on a device

Answer: TypeAlias = tuple[dict[str, Any], bytes | None]
"""What is added to a reply, and its bytes."""


class Cancelled(Exception):  # nothing went wrong
    """The file is no longer wanted."""


class _Dragged(Exception):  # nothing went wrong
    """Something is dragged, whose pictures come first."""


class Task(NamedTuple):
    """A file that is to be made: what is done, in words; its name; and what does it."""

    doing: str
    name: str
    work: Callable[[Reins], Answer]


class Done(NamedTuple):
    """A reply, and the error, if there was one."""

    message: Message
    data: bytes | None = None
    error: Exception | None = None


@dataclass(eq=False)
class Reins:
    """What a task is held by: it says how far it is, and hears whether to stop."""

    answer: Message
    task: Task
    waits: Callable[[], bool]  # whether to make room for something that is dragged
    tell: Callable[[Reins], None]
    share: float = 0.0
    told_at: float = -_EVERY
    ended: threading.Event = field(default_factory=threading.Event)

    def stopped(self) -> bool:
        """Whether nobody waits for it any more."""
        return self.ended.is_set()

    def progress(self, share: float) -> None:
        """Say how much is done. Raises `Cancelled` once nobody waits for it."""
        self.share, now = share, time.monotonic()
        if now - self.told_at >= _EVERY:
            self.told_at = now
            self.tell(self)
        if self.stopped():
            raise Cancelled

    def alone(self, work: Callable[[Progress], Made]) -> Made:
        """The result of work that is given up, and begun again, whenever something is dragged. Raises `Cancelled` as `progress`."""
        while True:
            while self.waits() and not self.stopped():
                time.sleep(_TICK)
            with contextlib.suppress(_Dragged):
                return work(self._looked)

    def _looked(self, share: float) -> None:  # noqa: ARG002  # of a part
        if self.stopped():
            raise Cancelled
        if self.waits():
            raise _Dragged


class Jobs:
    """The files of one session; the condition guards them, and says that there is something to tell.

    `waits` says whether something is dragged, which work then makes room for.
    """

    def __init__(self, condition: threading.Condition) -> None:
        self._condition = condition
        self._waiting: deque[Reins] = deque()  # the first is being made
        self._news: dict[Any, Message] = {}  # the newest of each file
        self._done: deque[Done] = deque()
        self._thread: threading.Thread | None = None
        self._closed = False
        self.waits: Callable[[], bool] = lambda: False

    def start(self, answer: Message, task: Task) -> None:
        """Have a file made, after those that came before; its reply is `answer` with what the work gives."""
        with self._condition:
            if self._closed:
                return
            if len(self._waiting) >= _MOST:
                raise OptionError(f"at most {_MOST} files may be made at once; wait for one, or cancel it")
            reins = Reins(answer, task, lambda: self.waits(), self._tell)
            self._waiting.append(reins)
            self._tell(reins)
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="clvol view: files", daemon=True)
                _remember(self)
                self._thread.start()

    def cancel(self, request: object) -> None:
        """Give up the file of a request; `OptionError` if there is none."""
        with self._condition:
            found = [one for one in self._waiting if one.answer["id"] == request]
            if not found:
                raise OptionError(f"no file of request {request!r:.60} is being made")
            for one in found:
                one.ended.set()
                if one is not self._waiting[0]:  # which its own thread removes
                    self._waiting.remove(one)
                    self._end(one, Done({**one.answer, "cancelled": True}))

    def take(self) -> tuple[list[Message], list[Done]]:
        """Messages of progress, and replies."""
        with self._condition:
            taken = list(self._news.values()), list(self._done)
            self._news.clear()
            self._done.clear()
            return taken

    @property
    def doing(self) -> str:
        """What is done now, in words; "" if nothing is."""
        first = next(iter(self._waiting), None)
        return "" if first is None else f"{first.task.doing}: {first.share:.0%}" if first.share else first.task.doing

    def __len__(self) -> int:
        return len(self._news) + len(self._done)

    def close(self) -> None:
        """Give up all files."""
        with self._condition:
            self._closed = True
            for one in self._waiting:
                one.ended.set()

    def join(self, timeout: float | None) -> None:
        """Wait for what cannot be interrupted."""
        if (thread := self._thread) is not None and thread is not threading.current_thread():
            thread.join(timeout)

    # -- its thread --------------------------------------------------------------------------------------------

    def _run(self) -> None:
        while True:
            with self._condition:
                if self._closed or not self._waiting:
                    self._thread = None
                    return
                reins = self._waiting[0]
            done = self._made(reins)
            with self._condition:
                self._waiting.popleft()
                self._end(reins, done)

    def _made(self, reins: Reins) -> Done:
        try:
            reins.progress(0.0)
            more, data = reins.task.work(reins)
            if reins.stopped():
                raise Cancelled
        except Cancelled:
            return Done({**reins.answer, "cancelled": True})
        except Exception as error:
            return Done({**reins.answer, "error": str(error) or type(error).__name__}, None, error)
        return Done({**reins.answer, "name": reins.task.name, **more}, data)

    def _tell(self, reins: Reins) -> None:
        with self._condition:
            request = reins.answer["id"]
            self._news[id(reins)] = {
                "type": "job",
                "id": request,
                "name": reins.task.name,
                "doing": reins.task.doing,
                "share": round(reins.share, 3),
            }
            self._condition.notify_all()

    def _end(self, reins: Reins, done: Done) -> None:
        self._news.pop(id(reins), None)
        self._done.append(done)
        self._condition.notify_all()


_all: weakref.WeakSet[Jobs] = weakref.WeakSet()


def _remember(jobs: Jobs) -> None:
    atexit.unregister(_end)
    atexit.register(_end)  # again, to be called before what devices register
    _all.add(jobs)


def _end() -> None:
    """A thread that is in a device's runtime when the interpreter ends would end the process with an error."""
    found, until = list(_all), time.monotonic() + _END
    for jobs in found:
        jobs.close()
    for jobs in found:
        jobs.join(max(0.0, until - time.monotonic()))
