"""Bricks on a device within a budget of memory, for any number of threads: who reads them, who waits, and which are evicted.

The lock is held for bookkeeping only, never while a brick is read. Room is reserved before reading begins, so memory stays within
the budget however many threads there are. If several threads want a brick, one of them reads it. A thread that finds no room waits
until another has done with a brick; but a thread that holds a brick never waits for room, or two might wait for each other.

Bricks of several volumes, such as a renderer's levels, may share an account: a budget, a lock, and a queue of waiting threads.
"""

from __future__ import annotations

import _thread
import threading
import weakref
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from clvol.spline.minmax import bytes_beside

if TYPE_CHECKING:
    from clvol.bricks.chunks import Chunks
    from clvol.bricks.source import Index
    from clvol.spline.coefficients import Coefficients
    from clvol.spline.minmax import MinMax

__all__ = ["Account", "Reads", "Resident", "Residents"]

_SMALL_PART = 16  # bricks of other volumes that take less than 1 / _SMALL_PART of the budget are evicted last
_AHEAD = 8  # samples that are read ahead take at most 1 / _AHEAD of the budget
_LOOK = 0.1  # seconds: Windows hears no Ctrl-C while a thread waits without an end


@dataclass
class Reads:
    """What was read of a volume.

    Attributes
    ----------
    bricks : int
        Bricks read, each time that one was read again included.
    samples : int
        Samples read, margins included.
    dropped : int
        Bricks evicted.
    """

    bricks: int = 0
    samples: int = 0
    dropped: int = 0


@dataclass
class Resident:
    """A brick's coefficients on the device, and the threads that use them, once for each use."""

    at: Index
    coefficients: Coefficients
    minmax: MinMax | None = None
    users: list[int] = field(default_factory=list)
    lock: Any = field(default_factory=threading.RLock)  # of `minmax`; a handler of signals may come back here

    @property
    def nbytes(self) -> int:
        return self.coefficients.nbytes + bytes_beside(self.coefficients.shape)

    def release(self) -> None:
        if self.minmax is not None:
            self.minmax.release()
        self.coefficients.release()


class _Coming:
    """A brick that a thread is reading, the threads that wait for it, and the result."""

    def __init__(self, at: Index, nbytes: int, thread: int) -> None:
        self.at, self.nbytes, self.thread = at, nbytes, thread
        self.waiting: list[int] = []
        self.done = False
        self.made: Resident | None = None
        self.error: BaseException | None = None


class _Ahead:
    """Samples that are read, or being read, before a thread needs them."""

    def __init__(self, nbytes: int, thread: int) -> None:
        self.nbytes, self.thread = nbytes, thread
        self.unwanted = False
        self.samples: Future[NDArray[Any]] = Future()


class Account:
    """A budget of bytes, and the stores whose bricks and chunks take them.

    Parameters
    ----------
    budget : int

    Attributes
    ----------
    lock : RLock
        Guards all that is counted.
    beside : int
        Bytes set aside for what is neither brick nor chunk.
    """

    def __init__(self, budget: int) -> None:
        self.budget, self.beside = budget, 0
        self.lock = threading.RLock()  # a handler of signals may come back here
        self._members: list[weakref.ref[Residents]] = []  # the most recently used last
        self._sleeping: list[Any] = []  # locks that wake waiting threads

    def members(self) -> list[Residents]:
        """Those that share the budget, least recently used first. The lock is held."""
        return [one for ref in self._members if (one := ref()) is not None]

    def joins(self, member: Residents) -> None:
        """Add a member, or mark one as the most recently used. The lock is held."""
        others = [ref for ref in self._members if (one := ref()) is not None and one is not member]
        self._members = [*others, weakref.ref(member)]

    @property
    def nbytes(self) -> int:
        """Bytes that are taken. The lock is held."""
        return self.beside + sum(one.taken for one in self.members())

    def make_room(self, nbytes: int, own: Residents) -> bool:
        """Evict what nobody uses until `nbytes` more fit. Returns whether they do. The lock is held.

        Bricks and chunks of other volumes are evicted first, unless they take little, then own ones, then the rest of the others'.
        If all of that would not be enough, nothing is evicted.
        """
        over = self.nbytes + nbytes - self.budget
        if over <= 0:
            return True
        members = self.members()
        if nbytes and over > sum(one.idle for one in members):
            return False
        others = [one for one in members if one is not own]
        large = [one for one in others if one.taken > self.budget // _SMALL_PART]
        for one in (*large, own, *(one for one in others if one not in large)):
            if over > 0:
                over -= one.evict(over)
        return over <= 0

    def grant(self, nbytes: int, chunks: Chunks) -> bool:
        """Whether there is room for `nbytes` more of some chunks."""
        own = next((one for one in self.members() if one.chunks is chunks), None)
        return own is not None and self.make_room(nbytes, own)

    @contextmanager
    def set_aside(self, nbytes: int, own: Residents) -> Iterator[None]:
        """A context that takes bytes for what is neither brick nor chunk; it waits until others like it leave room."""
        taken = 0

        def may_begin() -> bool:
            nonlocal taken
            if self.beside and self.beside + nbytes > self.budget:
                return False
            taken = nbytes
            self.beside += nbytes
            return True

        try:
            self.wait(may_begin)
            with self.lock:
                self.make_room(0, own)
            yield
        finally:
            with self.lock:
                self.beside -= taken
            self.wake()

    def wait(self, ready: Callable[[], object]) -> None:
        """Wait until `ready` is true; it is called whenever something has changed."""
        turn = threading.Lock()
        turn.acquire()
        try:
            while True:
                with self.lock:
                    if ready():
                        return
                    if turn not in self._sleeping:
                        turn.acquire(blocking=False)  # woken just as the wait timed out: it is released only once
                        self._sleeping.append(turn)
                turn.acquire(timeout=_LOOK)
        finally:
            with self.lock:
                if turn in self._sleeping:
                    self._sleeping.remove(turn)

    def wake(self) -> None:
        """Have all waiting threads check again."""
        with self.lock:
            while self._sleeping:
                self._sleeping.pop().release()


class Residents:
    """Bricks of a volume that are on a device, are being read, or were read ahead.

    Parameters
    ----------
    account : Account
        Counts their bytes.
    reads : Reads
        Counts what is read and evicted.
    chunks : Chunks, optional
        Unpacked chunks of the volume.
    chunks_first : bool
        Whether chunks are evicted before bricks: there is room for all bricks, which then stay for the next pass.

    Attributes
    ----------
    lock : RLock
        Guards all of this, and `reads`.
    """

    def __init__(self, account: Account, reads: Reads, chunks: Chunks | None = None, *, chunks_first: bool = False) -> None:
        self.account, self.reads, self.chunks, self._chunks_first = account, reads, chunks, chunks_first
        self.lock = account.lock
        self._there: OrderedDict[Index, Resident] = OrderedDict()  # the most recently used last
        self._coming: list[_Coming] = []
        self._ahead: dict[Index, _Ahead] = {}
        self._turns: dict[Index, int] = {}  # each brick's place in the access order
        self._turn = 0
        with self.lock:
            account.joins(self)

    @property
    def nbytes(self) -> int:
        """Bytes that are taken, including those reserved for bricks that are being read."""
        with self.lock:
            return self.taken

    @property
    def taken(self) -> int:
        """As `nbytes`. The lock is held."""
        being_read = sum(one.nbytes for one in self._coming) + sum(one.nbytes for one in self._ahead.values())
        kept = 0 if self.chunks is None else self.chunks.nbytes
        return being_read + kept + sum(one.nbytes for one in self._there.values())

    def has(self, at: Index) -> bool:
        """Whether a brick's coefficients are on the device."""
        with self.lock:
            return at in self._there

    @contextmanager
    def held(
        self, at: Index, nbytes: int, read: Callable[[], NDArray[Any]], make: Callable[[NDArray[Any]], Resident]
    ) -> Iterator[Resident]:
        """A context in which a brick is resident; it stays longer if there is room.

        Parameters
        ----------
        at : (int, int, int)
            Its number.
        nbytes : int
            The most that it takes, while it is read and later.
        read, make : callable
            Read its samples, and turn them into coefficients. Their errors are raised in all threads that wait for this brick.
        """
        me, own = threading.get_ident(), None
        try:
            while own is None:
                with self.lock:
                    self.account.joins(self)
                    self._turn = self._turns.get(at, self._turn)
                    found, other = self._there.get(at), self._with_another(at, me)
                    if found is not None:
                        self._there.move_to_end(at)
                        found.users.append(me)
                        own = found
                        break
                own = self._read(at, nbytes, read, make, me) if other is None else self._of_another(other, me)
                if own is None:
                    self.account.wait(lambda: at in self._there or self._with_another(at, me) or self._may_begin(at, nbytes, me))
            yield own
        finally:
            if own is not None:
                with self.lock:
                    own.users.remove(me)
                    self.account.make_room(0, self)
                    self.account.wake()

    def _with_another(self, at: Index, me: int) -> _Coming | None:
        """The read of a brick by another thread, if any. (This thread may read it too: a signal handler may ask for the same.)"""
        return next((one for one in self._coming if one.at == at and one.thread != me), None)

    def _read(
        self, at: Index, nbytes: int, read: Callable[[], NDArray[Any]], make: Callable[[NDArray[Any]], Resident], me: int
    ) -> Resident | None:
        """Read a brick in this thread; None if there is no room, or another thread was first."""
        coming = _Coming(at, nbytes, me)
        try:
            with self.lock:
                if at in self._there or self._with_another(at, me) or not self._may_begin(at, nbytes, me):
                    return None
                self._coming.append(coming)
                ahead = self._ahead.pop(at, None)
            samples = read() if ahead is None else ahead.samples.result()
            with self.lock:
                self.reads.bricks += 1
            made = make(samples)
            with self.lock:
                there = self._there.setdefault(at, made)
                if there is not made:  # a signal handler was faster
                    made.release()
                there.users += [me, *coming.waiting]
                coming.made, coming.done = there, True  # together: a thread that comes later is not among its users
                self._coming.remove(coming)  # so that its room is not counted twice
            return there
        except BaseException as error:
            coming.error = error
            with self.lock:
                if coming.made is not None:
                    coming.made.users.remove(me)
            raise
        finally:
            with self.lock:
                if coming in self._coming:
                    self._coming.remove(coming)
                coming.done = True
                self.account.wake()

    def _of_another(self, coming: _Coming, me: int) -> Resident | None:
        """The brick that another thread reads; None if that thread was interrupted, and the brick has to be read again."""
        waits = False
        try:
            with self.lock:
                if coming.done:
                    return None
                coming.waiting.append(me)
                waits = True
            self.account.wait(lambda: coming.done)
            if coming.made is None and isinstance(coming.error, Exception):  # Ctrl-C is not for the waiting threads
                raise coming.error
            return coming.made
        except BaseException:
            if waits:
                with self.lock:
                    (coming.waiting if coming.made is None else coming.made.users).remove(me)
            raise

    def _may_begin(self, at: Index, nbytes: int, me: int) -> bool:
        """Whether a thread may read a brick: there is room, or there never will be."""
        ahead = self._ahead.get(at)
        nbytes -= 0 if ahead is None else ahead.nbytes
        if self.account.make_room(nbytes, self):
            return True
        members = self.account.members()
        if busy := {thread for one in members for thread in one._busy}:
            return me in busy
        for one in members:
            one._forget([other for other in one._ahead if one is not self or other != at])
        return self.account.make_room(nbytes, self) or not any(
            other is not ahead for one in members for other in one._ahead.values()
        )

    @property
    def _busy(self) -> set[int]:
        """Threads that use bricks or read some. The lock is held."""
        return {thread for one in self._there.values() for thread in one.users} | {one.thread for one in self._coming}

    # -- eviction ---------------------------------------------------------------------------------------------------------

    def expect(self, order: Sequence[Index]) -> None:
        """Set the access order: bricks will be asked for like this, and perhaps once more from the first on."""
        with self.lock:
            self._turns, self._turn = {at: i for i, at in enumerate(order)}, 0

    def _eviction_order(self) -> list[Index]:
        """Resident bricks in the order of eviction: those needed last come first, as far as the access order tells.

        First those that are not in the access order, least recently used first; then those that had their turn, the latest first,
        because the next pass comes to it last; then those whose turn is still to come, the last one first.
        """
        known = [at for at in self._there if at in self._turns]
        known.sort(key=lambda at: (self._turns[at] > self._turn, -self._turns[at]))
        return [at for at in self._there if at not in self._turns] + known

    @property
    def idle(self) -> int:
        """Bytes that `evict` can free. The lock is held."""
        return sum(one.nbytes for one in self._there.values() if not one.users) + (0 if self.chunks is None else self.chunks.idle)

    def evict(self, nbytes: int) -> int:
        """Evict unused bricks and chunks until `nbytes` are freed. Returns the number of bytes freed. The lock is held."""
        freed = 0
        if self.chunks is not None and self._chunks_first:
            freed += self.chunks.evict(nbytes)
        for at in self._eviction_order():
            if freed >= nbytes:
                break
            if not self._there[at].users:
                gone = self._there.pop(at)
                freed += gone.nbytes
                self.reads.dropped += 1
                gone.release()
        if self.chunks is not None and freed < nbytes:
            freed += self.chunks.evict(nbytes - freed)
        return freed

    def make_room(self) -> None:
        """Evict all bricks that nobody uses, of all members: the device has less memory than the budget."""
        with self.lock:
            for one in self.account.members():
                one.reads.dropped += one._drop_idle()

    def drop(self) -> None:
        """Evict all that nobody uses."""
        with self.lock:
            self._forget(list(self._ahead))
            self._drop_idle()
            self.account.wake()

    def _drop_idle(self) -> int:
        """Evict all bricks and chunks that nobody uses. Returns the number of bricks."""
        idle = [at for at, one in self._there.items() if not one.users]
        for at in idle:
            self._there.pop(at).release()
        if self.chunks is not None:
            self.chunks.evict()
        return len(idle)

    def release(self) -> None:
        """Free everything: the last use has ended. Others may still use the account."""
        with self.lock:
            self._ahead.clear()
            gone, self._there = self._there, OrderedDict()
            if self.chunks is not None:
                self.chunks.close()
            for one in gone.values():
                one.release()
            self.account.wake()

    # -- reading ahead -----------------------------------------------------------------------------------------------------

    def read_ahead(self, at: Index, nbytes: int, read: Callable[[], NDArray[Any]]) -> None:
        """Read the samples of a brick in another thread, if there is room for them."""
        me = threading.get_ident()
        with self.lock:
            if (known := self._ahead.get(at)) is not None:
                known.unwanted = False
                return
            if at in self._there or any(one.at == at for one in self._coming) or _AHEAD * nbytes > self.account.budget:
                return
            self._forget([other for other, one in self._ahead.items() if one.thread == me])  # which it did not need after all
            if not self.account.make_room(nbytes, self):
                return
            ahead = _Ahead(nbytes, me)
            try:
                self._ahead[at] = ahead
                # not joined at exit: a server may never answer
                _thread.start_new_thread(self._work, (at, ahead, read))
            except BaseException as error:
                self._ahead.pop(at, None)
                if not isinstance(error, RuntimeError):  # no more threads can be started
                    raise

    def _work(self, at: Index, ahead: _Ahead, read: Callable[[], NDArray[Any]]) -> None:
        try:
            ahead.samples.set_result(read())
        except BaseException as error:
            ahead.samples.set_exception(error)
        finally:
            with self.lock:
                if ahead.unwanted and self._ahead.get(at) is ahead:
                    del self._ahead[at]
                self.account.wake()

    def forget_ahead(self) -> None:
        """Drop what was read ahead for this thread."""
        me = threading.get_ident()
        with self.lock:
            self._forget([at for at, one in self._ahead.items() if one.thread == me])

    def _forget(self, some: Sequence[Index]) -> None:
        """Drop samples that were read ahead; a read in progress keeps its room until it ends."""
        for at in some:
            if self._ahead[at].samples.done():
                del self._ahead[at]
            else:
                self._ahead[at].unwanted = True
