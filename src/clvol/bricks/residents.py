"""Bricks on a device within a budget of memory, for any number of threads: who reads them, who waits, and which make room.

The lock is held for the bookkeeping alone, and never while a brick is read. Room is taken before reading begins, so memory stays
within the budget however many threads there are. A brick that several threads want is read by one of them. Who finds no room waits
until somebody has done with a brick; but whoever holds one waits for no room, or two threads might wait for each other.

Bricks of several volumes, as of a renderer's levels, may share an account: a budget, a lock, and who waits for whom.
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
from typing import Any

from numpy.typing import NDArray

from clvol.bricks.chunks import Chunks
from clvol.bricks.source import Index
from clvol.spline.coefficients import Coefficients
from clvol.spline.minmax import MinMax, bytes_beside

__all__ = ["Account", "Reads", "Resident", "Residents"]

_SMALL_PART = 16  # of the budget: bricks of other volumes that take less make room last
_AHEAD = 8  # samples that are read ahead may take one part in so many of the budget
_LOOK = 0.1  # seconds: without an end, Windows would not hear Ctrl-C


@dataclass
class Reads:
    """What was read of a volume.

    Attributes
    ----------
    bricks : int
        How often a brick was read, one that had to be read again included.
    samples : int
        How many samples that were, margins included.
    dropped : int
        How often a brick made room for another one.
    """

    bricks: int = 0
    samples: int = 0
    dropped: int = 0


@dataclass
class Resident:
    """A brick's coefficients on the device, and the threads that use them, each as often as it does."""

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
    """A brick that a thread is reading, those that wait for it, and what came of it."""

    def __init__(self, at: Index, nbytes: int, thread: int) -> None:
        self.at, self.nbytes, self.thread = at, nbytes, thread
        self.waiting: list[int] = []
        self.done = False
        self.made: Resident | None = None
        self.error: BaseException | None = None


class _Ahead:
    """Samples that are being read, or were, before a thread comes to them."""

    def __init__(self, nbytes: int, thread: int) -> None:
        self.nbytes, self.thread = nbytes, thread
        self.unwanted = False
        self.samples: Future[NDArray[Any]] = Future()


class Account:
    """A budget of bytes, and whose bricks and chunks take them.

    Parameters
    ----------
    budget : int

    Attributes
    ----------
    lock : RLock
        Of all that is counted.
    beside : int
        Bytes that were set aside for what is neither brick nor chunk.
    """

    def __init__(self, budget: int) -> None:
        self.budget, self.beside = budget, 0
        self.lock = threading.RLock()  # a handler of signals may come back here
        self._members: list[weakref.ref[Residents]] = []  # whose bricks were asked for last is last
        self._sleeping: list[Any] = []  # locks that wake who waits

    def members(self) -> list[Residents]:
        """Whose bricks they are, those first whose were not asked for longest. The lock is held."""
        return [one for ref in self._members if (one := ref()) is not None]

    def joins(self, member: Residents) -> None:
        """One more, or one whose bricks are asked for. The lock is held."""
        others = [ref for ref in self._members if (one := ref()) is not None and one is not member]
        self._members = [*others, weakref.ref(member)]

    @property
    def nbytes(self) -> int:
        """Bytes that are taken. The lock is held."""
        return self.beside + sum(one.taken for one in self.members())

    def make_room(self, nbytes: int, own: Residents) -> bool:
        """Let go of what nobody uses until so many bytes more fit; whether they do. The lock is held.

        First go bricks and chunks of other volumes, unless they take little, then own ones, then what others have left. Where all
        of these would not be enough, they stay.
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
                over -= one.let_go(over)
        return over <= 0

    def grant(self, nbytes: int, chunks: Chunks) -> bool:
        """Whether there is room for so many bytes more of some chunks."""
        own = next((one for one in self.members() if one.chunks is chunks), None)
        return own is not None and self.make_room(nbytes, own)

    @contextmanager
    def set_aside(self, nbytes: int, own: Residents) -> Iterator[None]:
        """Bytes that are taken for the time of a block by what is neither brick nor chunk; others of the kind are waited for."""
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
        """Until something is true, which is looked at whenever anything has changed."""
        turn = threading.Lock()
        turn.acquire()
        try:
            while True:
                with self.lock:
                    if ready():
                        return
                    if turn not in self._sleeping:
                        turn.acquire(blocking=False)  # it may have been woken just as its time was up, and is released but once
                        self._sleeping.append(turn)
                turn.acquire(timeout=_LOOK)
        finally:
            with self.lock:
                if turn in self._sleeping:
                    self._sleeping.remove(turn)

    def wake(self) -> None:
        """Have all who wait look again."""
        with self.lock:
            while self._sleeping:
                self._sleeping.pop().release()


class Residents:
    """Bricks of a volume that are on a device, are coming, or were read ahead.

    Parameters
    ----------
    account : Account
        Where they are counted.
    reads : Reads
        Where it is counted what is read and dropped.
    chunks : Chunks, optional
        Of the volume, that are kept unpacked.
    chunks_first : bool
        Whether these make room for bricks: all bricks find room, and will be there when the volume is gone through again.

    Attributes
    ----------
    lock : RLock
        Of all that is here, and of `reads`.
    """

    def __init__(self, account: Account, reads: Reads, chunks: Chunks | None = None, *, chunks_first: bool = False) -> None:
        self.account, self.reads, self.chunks, self._chunks_first = account, reads, chunks, chunks_first
        self.lock = account.lock
        self._there: OrderedDict[Index, Resident] = OrderedDict()  # the one used last is last
        self._coming: list[_Coming] = []
        self._ahead: dict[Index, _Ahead] = {}
        self._turns: dict[Index, int] = {}  # when each brick is asked for, and how far that has come
        self._turn = 0
        with self.lock:
            account.joins(self)

    @property
    def nbytes(self) -> int:
        """Bytes that are taken, those included that were set aside for bricks that are being read."""
        with self.lock:
            return self.taken

    @property
    def taken(self) -> int:
        """The same. The lock is held."""
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
        """A brick for the time of a block, and longer if there is room.

        Parameters
        ----------
        at : (int, int, int)
            Which one.
        nbytes : int
            What it takes at most, while it is made and later.
        read, make : callable
            Its samples, and what is made of them. An error of theirs is raised by all threads that wait for this brick.
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
        """Whether another thread is reading a brick. (This one may be, where a handler of signals asks for the same.)"""
        return next((one for one in self._coming if one.at == at and one.thread != me), None)

    def _read(
        self, at: Index, nbytes: int, read: Callable[[], NDArray[Any]], make: Callable[[NDArray[Any]], Resident], me: int
    ) -> Resident | None:
        """A brick that this thread reads; None if there is no room, or another thread was first."""
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
                if there is not made:  # a handler of signals was here meanwhile
                    made.release()
                there.users += [me, *coming.waiting]
                coming.made, coming.done = there, True  # at once: who comes later is not among its users
                self._coming.remove(coming)  # nor is its room counted twice
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
        """The brick that another thread reads, for this one too; None if that thread was interrupted, and it is to be read anew."""
        waits = False
        try:
            with self.lock:
                if coming.done:
                    return None
                coming.waiting.append(me)
                waits = True
            self.account.wait(lambda: coming.done)
            if coming.made is None and isinstance(coming.error, Exception):  # Ctrl-C is not for those who wait
                raise coming.error
            return coming.made
        except BaseException:
            if waits:
                with self.lock:
                    (coming.waiting if coming.made is None else coming.made.users).remove(me)
            raise

    def _may_begin(self, at: Index, nbytes: int, me: int) -> bool:
        """Whether a thread may read a brick: there is room, or none will ever be."""
        ahead = self._ahead.get(at)
        nbytes -= 0 if ahead is None else ahead.nbytes
        if self.account.make_room(nbytes, self):
            return True
        members = self.account.members()
        if busy := {thread for one in members for thread in one.busy}:
            return me in busy
        for one in members:
            one._forget([other for other in one._ahead if one is not self or other != at])
        return self.account.make_room(nbytes, self) or not any(
            other is not ahead for one in members for other in one._ahead.values()
        )

    @property
    def busy(self) -> set[int]:
        """Threads that use bricks or read some. The lock is held."""
        return {thread for one in self._there.values() for thread in one.users} | {one.thread for one in self._coming}

    # -- what makes room ---------------------------------------------------------------------------------------------------

    def expect(self, order: Sequence[Index]) -> None:
        """Set the access order: bricks will be asked for like this, and perhaps once more from the first on."""
        with self.lock:
            self._turns, self._turn = {at: i for i, at in enumerate(order)}, 0

    def _first_to_go(self) -> list[Index]:
        """The bricks that are there, those first that will be asked for last, as far as is known.

        Those come first of which nothing is known, the longest unused before others; then those that had their turn, the last one
        first, for when all begins again it is the last to come; then those whose turn comes.
        """
        known = [at for at in self._there if at in self._turns]
        known.sort(key=lambda at: (self._turns[at] > self._turn, -self._turns[at]))
        return [at for at in self._there if at not in self._turns] + known

    @property
    def idle(self) -> int:
        """Bytes that `let_go` can free. The lock is held."""
        return sum(one.nbytes for one in self._there.values() if not one.users) + (0 if self.chunks is None else self.chunks.idle)

    def let_go(self, nbytes: int) -> int:
        """Free as many bytes of what nobody uses: bricks, those first that are asked for last, and chunks. The lock is held."""
        freed = 0
        if self.chunks is not None and self._chunks_first:
            freed += self.chunks.let_go(nbytes)
        for at in self._first_to_go():
            if freed >= nbytes:
                break
            if not self._there[at].users:
                gone = self._there.pop(at)
                freed += gone.nbytes
                self.reads.dropped += 1
                gone.release()
        if self.chunks is not None and freed < nbytes:
            freed += self.chunks.let_go(nbytes - freed)
        return freed

    def make_room(self) -> None:
        """Drop all bricks that nobody uses: the device has less memory than the budget."""
        with self.lock:
            for one in self.account.members():
                one.reads.dropped += one._drop_idle()

    def drop(self) -> None:
        """Let go of all that nobody uses."""
        with self.lock:
            self._forget(list(self._ahead))
            self._drop_idle()
            self.account.wake()

    def _drop_idle(self) -> int:
        """Drop all bricks that nobody uses; how many there were."""
        idle = [at for at, one in self._there.items() if not one.users]
        for at in idle:
            self._there.pop(at).release()
        if self.chunks is not None:
            self.chunks.let_go()
        return len(idle)

    def release(self) -> None:
        """Let go of everything: the last use has ended. Others of the account may be counting."""
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
        """Have the samples of a brick read while this thread does something else, if there is room for them."""
        me = threading.get_ident()
        with self.lock:
            if (known := self._ahead.get(at)) is not None:
                known.unwanted = False
                return
            if at in self._there or any(one.at == at for one in self._coming) or _AHEAD * nbytes > self.account.budget:
                return
            self._forget([other for other, one in self._ahead.items() if one.thread == me])  # what it did not come to after all
            if not self.account.make_room(nbytes, self):
                return
            ahead = _Ahead(nbytes, me)
            try:
                self._ahead[at] = ahead
                # a thread that nobody waits for at the end: a server may not answer
                _thread.start_new_thread(self._work, (at, ahead, read))
            except BaseException as error:
                self._ahead.pop(at, None)
                if not isinstance(error, RuntimeError):  # there can be no thread more
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
        """What was read ahead for this thread is not wanted."""
        me = threading.get_ident()
        with self.lock:
            self._forget([at for at, one in self._ahead.items() if one.thread == me])

    def _forget(self, some: Sequence[Index]) -> None:
        """Let go of what was read ahead; what is still being read takes its room until then."""
        for at in some:
            if self._ahead[at].samples.done():
                del self._ahead[at]
            else:
                self._ahead[at].unwanted = True
