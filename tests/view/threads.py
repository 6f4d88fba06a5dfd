"""Threads of sessions, which end with their rendering or their kernels' builds."""

from __future__ import annotations

import threading
import time
from collections.abc import Collection

__all__ = ["sessions", "wait_for_sessions"]


def sessions() -> set[threading.Thread]:
    """The running ones."""
    return {thread for thread in threading.enumerate() if thread.name == "clvol view"}


def wait_for_sessions(most: int, but: Collection[threading.Thread] = (), seconds: float = 60.0) -> None:
    """Wait until at most n more run than before; an `AssertionError` after a timeout."""
    end = time.monotonic() + seconds
    while len(sessions().difference(but)) > most:
        assert time.monotonic() < end, f"{len(sessions().difference(but))} sessions have not ended"
        time.sleep(0.02)
