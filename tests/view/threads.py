"""Sessions' threads, which end when what they draw is drawn, or its kernels are built."""

from __future__ import annotations

import threading
import time
from collections.abc import Collection

__all__ = ["sessions", "wait_for_sessions"]


def sessions() -> set[threading.Thread]:
    """Those that run."""
    return {thread for thread in threading.enumerate() if thread.name == "clvol view"}


def wait_for_sessions(most: int, but: Collection[threading.Thread] = (), seconds: float = 60.0) -> None:
    """Until at most so many run beside those that ran before; an `AssertionError` if that takes longer."""
    end = time.monotonic() + seconds
    while len(sessions().difference(but)) > most:
        assert time.monotonic() < end, f"{len(sessions().difference(but))} sessions have not ended"
        time.sleep(0.02)
