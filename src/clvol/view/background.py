"""Work that pictures do not wait for, in one thread per session: facts of the volume, statistics, errors of filters."""

from __future__ import annotations

import asyncio
import contextvars
import logging
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, TypeAlias, TypeVar

from clvol.base.checks import heard_by
from clvol.view.protocol import Message

__all__ = ["Background", "Key", "in_thread", "started"]

Result = TypeVar("Result")
_LOG = logging.getLogger("clvol.view")
Key: TypeAlias = tuple[Any, ...]
"""Of a piece of work: its kind, and what the result depends on."""


def started(work: Callable[[], Result], name: str) -> Future[Result]:
    """Work in a daemon thread of this name, in the caller's context: the process waits for those of executors at its end."""
    future: Future[Result] = Future()
    future.set_running_or_notify_cancel()
    context = contextvars.copy_context()

    def run() -> None:
        try:
            future.set_result(context.run(work))
        except Exception as error:
            future.set_exception(error)
        except BaseException as error:
            future.set_exception(RuntimeError(f"{name} ended by {type(error).__name__}"))

    threading.Thread(target=run, name=name, daemon=True).start()
    return future


async def in_thread(work: Callable[[], Result], name: str) -> Result:
    """The result of work in a daemon thread, for an event loop."""
    return await asyncio.wrap_future(started(work, f"clvol: {name}"))


class Background:
    """Computes messages in a thread that exists only while there is work; the condition guards it, and says that one is ready."""

    def __init__(self, condition: threading.Condition) -> None:
        self._condition = condition
        self._asked: dict[str, Key] = {}
        self._waiting: dict[str, tuple[Key, Callable[[], Message | None], Callable[[str], Message | None]]] = {}
        self._ready: deque[tuple[str, Message | None]] = deque()
        self._thread: threading.Thread | None = None
        self._closed = False

    def submit(
        self,
        key: Key,
        work: Callable[[], Message | None],
        failed: Callable[[str], Message | None] = lambda reason: None,  # noqa: ARG005
    ) -> None:
        """Have a message computed, unless the last one of its kind had the same key.

        A result of None wakes the session nevertheless. `failed` turns the reason of a failure into a message.
        """
        with self._condition:
            if self._closed or self._asked.get(key[0]) == key:
                return
            self._asked[key[0]] = key
            self._waiting[key[0]] = key, work, failed
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="clvol view: aside", daemon=True)
                self._thread.start()

    def asked(self, key: Key) -> bool:
        """Whether the last work of its kind has this key."""
        return self._asked.get(key[0]) == key

    def forget(self, kind: str) -> None:
        """Drop work of a kind, and results of it that were not taken."""
        with self._condition:
            self._asked.pop(kind, None)
            self._waiting.pop(kind, None)
            self._ready = deque(one for one in self._ready if one[0] != kind)

    def take(self) -> list[Message]:
        """Messages that are ready."""
        with self._condition:
            taken = [message for _, message in self._ready if message is not None]
            self._ready.clear()
            return taken

    def __len__(self) -> int:
        return len(self._ready)

    def close(self) -> None:
        """Start nothing more."""
        self._closed = True

    def join(self, timeout: float | None) -> None:
        """Wait for the work that is under way."""
        if (thread := self._thread) is not None:
            thread.join(timeout)

    def _run(self) -> None:
        while True:
            with self._condition:
                if self._closed or not self._waiting:
                    self._thread = None
                    return
                kind = next(iter(self._waiting))
                key, work, failed = self._waiting.pop(kind)
            try:
                with heard_by(_LOG.debug):  # the picture tells them to who looks at it
                    message = work()
            except Exception as error:  # pictures are not affected
                _LOG.debug("in the background of a session: %s", error)
                message = failed(str(error) or type(error).__name__)
                if message is None:
                    continue
            with self._condition:
                if self._asked.get(kind) == key:  # else something else is wanted by now
                    self._ready.append((kind, message))
                    self._condition.notify_all()
