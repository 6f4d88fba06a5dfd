"""Worker processes that draw together: how they are reached, what is asked of them, and what is said when they fail.

The processes are those of a cluster of dask: of this machine, or of any that `dask scheduler` and `dask worker` started.
"""

from __future__ import annotations

import contextlib
import importlib
import logging
import os
import re
import signal
import socket
import sys
import threading
import time
import weakref
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from multiprocessing.resource_tracker import ensure_running
from typing import TYPE_CHECKING, Any, Self, TypeAlias, TypeVar

from clvol.base.checks import whole
from clvol.base.errors import ClusterError, ClvolError, FormatError, MissingDependencyError, OptionError
from clvol.device import Device, as_device, devices

if TYPE_CHECKING:
    import distributed

__all__ = [
    "Cluster",
    "ClusterLike",
    "LostError",
    "PoisonError",
    "Turn",
    "as_cluster",
    "neighbours",
    "own_address",
    "own_place",
    "version",
    "worker_device",
]

ClusterLike: TypeAlias = "Cluster | distributed.Client | str | int"
"""What `as_cluster` takes."""

WAIT = 10.0
"""Seconds for a scheduler to answer, and for its first worker."""
DESERTED = 60.0
"""Seconds for which a cluster may be without workers: one that died is started again."""
_T = TypeVar("_T")
SLOWEST = 600.0
"""Seconds for a result to come from the worker that has it."""
RETRIES = 2
"""How often work that could not read something is done again: a disk or a network may have failed."""
_LOOK = 0.01  # seconds between looks at what is done
_CENSUS = 2.0  # seconds between looks at who is there
_PLEASE = "start clvol's version on all of them, such as by `pip install clvol=={version}`, and `dask worker` again"


class LostError(ClusterError):
    """What workers had is gone with them; it may be sent again."""


class PoisonError(ClusterError):
    """Work ended each worker that began it; `key` says which."""

    def __init__(self, message: str, key: str) -> None:
        super().__init__(message)
        self.key = key

    def __reduce__(self) -> Any:
        return type(self), (str(self), self.key)


def version() -> str:
    """Of this process's clvol."""
    return str(sys.modules[__package__].__version__)


@dataclass(frozen=True)
class _About:
    """What a worker says of itself."""

    version: str
    process: int


def about() -> _About:
    """Asked of each worker."""
    return _About(version(), os.getpid())


class Cluster:
    """Worker processes of dask.

    Parameters
    ----------
    client : distributed.Client
        Connected, and not asynchronous.
    own : sequence of objects with `close`
        What is closed with it.

    Attributes
    ----------
    client : distributed.Client
    workers : tuple of str
        Addresses, in an order that stays.
    """

    def __init__(self, client: distributed.Client, own: Sequence[Any] = ()) -> None:
        self.client = client
        self._end = weakref.finalize(self, _close, list(own))
        try:
            self._require_alike()
        except BaseException:
            self.close()
            raise

    def __repr__(self) -> str:
        return f"<Cluster of {len(self._census())} workers at {self.address}>"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the cluster, and end it if it is one's own."""
        self._end()

    @property
    def address(self) -> str:
        """Of the scheduler."""
        scheduler = getattr(self.client, "scheduler", None)
        return str(getattr(scheduler, "address", None) or "an unknown address")

    @property
    def workers(self) -> tuple[str, ...]:
        if self.client.status != "running":
            raise self._gone()
        return tuple(sorted(self._census(), key=_by_host_and_port))

    def places(self) -> dict[str, int]:
        """Of each worker, which one it is of those on its host: that is which of the host's GPUs it uses."""
        count: dict[str, int] = {}
        found = {}
        for address in self.workers:
            host = _host(address)
            found[address] = count.get(host, 0)
            count[host] = found[address] + 1
        return found

    def _census(self) -> list[str]:
        def ask() -> list[str]:
            try:
                return list(self.client.scheduler_info(n_workers=-1).get("workers", ()))
            except TypeError:  # older than that parameter
                return list(self.client.scheduler_info().get("workers", ()))

        try:
            return _within(WAIT, ask)
        except TimeoutError:
            raise self._gone() from None

    def _require_alike(self) -> None:
        """`ClusterError` unless there are workers, and all have this version of clvol."""
        try:
            self.client.wait_for_workers(1, timeout=WAIT)
        except TimeoutError:
            raise ClusterError(
                f"the scheduler at {self.address} must have workers; got none within {WAIT:g} s: dask worker {self.address}"
            ) from None
        except (OSError, RuntimeError, ValueError) as error:
            raise ClusterError(f"no scheduler answers at {self.address} any more: {error}") from error
        told = self._asked()
        wrong = []
        for address, answer in sorted(told.items()):
            if isinstance(answer, (ImportError, AttributeError)) or "ModuleNotFoundError" in str(answer):  # it may come as text
                wrong.append(f"{address} has none, or another ({answer})")
            elif isinstance(answer, BaseException):
                wrong.append(f"{address} does not say ({answer})")
            elif answer.version != version():
                wrong.append(f"{address} has {answer.version}")
        if wrong:
            advice = _PLEASE.format(version=version())
            raise ClusterError(f"workers must have clvol {version()}, as this process has; {'; '.join(wrong)}: {advice}")

    def _asked(self) -> dict[str, Any]:
        """What each worker says of itself, or the error that it has instead."""
        try:
            return dict(_within(3 * WAIT, lambda: self.client.run(about, on_error="return")))
        except TimeoutError:
            raise ClusterError(
                f"the workers at {self.address} must say which clvol they have; got no answer within {3 * WAIT:g} s"
            ) from None
        except Exception as error:
            return {"a worker": error}

    # -- work --------------------------------------------------------------------------------------------------------------

    def submit(self, function: Callable[..., Any], *arguments: Any, worker: str | None = None, **options: Any) -> Any:
        """A future of what a function gives, preferably of this worker."""
        where = {} if worker is None else {"workers": [worker], "allow_other_workers": True}
        return self.client.submit(_tried, function, *arguments, pure=False, **where, **options)

    def shared(self, value: Any, nbytes: int) -> Any:
        """A future of a value that much work takes: a large one lies with all workers, so that the death of one loses nothing."""
        if nbytes > _LARGE:
            return self.client.scatter(value, broadcast=True, hash=False)  # type: ignore[no-untyped-call]  # as distributed has it
        return self.client.submit(_same, value, pure=False)

    def tell(self, function: Callable[..., Any], *arguments: Any) -> None:
        """Have each worker call a function; who cannot be reached is left out."""
        if self.client.status == "running":
            with contextlib.suppress(Exception):
                _within(WAIT, lambda: self.client.run(_aside, function, *arguments))

    def done(self, futures: Sequence[Any], *, keeping: bool = False) -> Iterator[tuple[int, Any]]:
        """The number of each future, as it is done, and its result; or, if `keeping`, the error that it has instead.

        Raises
        ------
        ClusterError
            The scheduler is gone, or has no workers any more; or a result does not come, though it is there.
        PoisonError
            What it asks for ends each worker that tries.
        ClvolError
            That which was raised in a worker.
        """
        import distributed

        left = dict(enumerate(futures))
        waits: dict[int, float] = {}  # for results that did not come within WAIT: asked for again, they begin anew
        peopled = looked = time.monotonic()
        silent = 0
        while left:
            for number in [n for n, future in left.items() if future.done()]:
                future = left.pop(number)
                result: Any
                try:
                    with self._told_apart(distributed):
                        result = future.result(timeout=waits.get(number, WAIT))
                except _UnreadyError as error:  # who had the result died, and it is made again; or it is large, and comes slowly
                    left[number] = future
                    if future.done():
                        waits[number] = 2 * waits.get(number, WAIT)
                        if waits[number] > SLOWEST:
                            raise ClusterError(
                                f"results must come from the workers at {self.address}; one did not within {waits[number] / 2:g} "
                                "s, though it is there: the network is too slow, or a worker is stopped"
                            ) from error
                    continue
                except ClvolError as error:
                    if not keeping or (isinstance(error, ClusterError) and not isinstance(error, PoisonError)):
                        raise
                    result = error
                future.release()  # the worker need not keep it
                yield number, result
            now = time.monotonic()
            if left and now - looked > _CENSUS:
                looked = now
                if self.client.status != "running":
                    raise self._gone()
                try:
                    peopled = now if self._census() else peopled
                    silent = 0
                except ClusterError:  # which is an OSError too
                    silent += 1
                    if silent > 1:  # once may be a large graph that it is busy with
                        raise
                except OSError:  # of a connection that is made anew
                    pass
                if now - peopled > DESERTED:
                    raise ClusterError(f"the scheduler at {self.address} has had no workers for {DESERTED:g} s")
            if left:
                time.sleep(_LOOK)

    @contextlib.contextmanager
    def _told_apart(self, distributed: Any) -> Iterator[None]:
        try:
            yield
        except ClvolError:
            raise
        except distributed.KilledWorker as error:
            raise PoisonError(str(error), str(error.task)) from None
        except distributed.CancelledError as error:
            if self.client.status != "running":
                raise self._gone() from error
            raise LostError(f"the workers that had what this takes are gone from {self.address}") from error
        except TimeoutError as error:
            if self.client.status != "running":
                raise self._gone() from error
            raise _UnreadyError from error
        except Exception as error:
            raise ClusterError(f"{type(error).__name__} in a worker at {self.address}: {error}") from error

    def _gone(self) -> ClusterError:
        return ClusterError(f"the scheduler at {self.address} is gone, or has dropped this work")

    def cancel(self, futures: Sequence[Any]) -> None:
        """What was asked for is not wanted."""
        if self.client.status == "running":
            with contextlib.suppress(Exception):  # it is gone, and so is the work
                self.client.cancel(list(futures), force=True)  # type: ignore[no-untyped-call]  # as distributed has it


_LARGE = 8 << 20  # bytes of what the scheduler itself passes on


class _UnreadyError(Exception):
    """A result is not there yet after all."""


def _within(seconds: float, work: Callable[[], _T]) -> _T:
    """What work gives; `TimeoutError` if it takes longer: who should answer may be stopped."""
    answer: list[Any] = []

    def ask() -> None:
        try:
            answer.append((work(), None))
        except BaseException as error:
            answer.append((None, error))

    asking = threading.Thread(target=ask, daemon=True, name="clvol: asking a cluster")
    asking.start()
    asking.join(seconds)
    if not answer:
        raise TimeoutError
    result, error = answer[0]
    if error is not None:
        raise error
    return result  # type: ignore[no-any-return]  # it is what work gave


def _same(value: Any) -> Any:
    return value


def _close(things: list[Any]) -> None:
    for thing in things:
        with contextlib.suppress(Exception):  # the other side may be gone
            thing.close()


def _host(address: str) -> str:
    return address.rpartition(":")[0]


def _by_host_and_port(address: str) -> tuple[str, int, str]:
    port = address.rpartition(":")[2]
    return _host(address), int(port) if port.isdigit() else 0, address


def as_cluster(choice: ClusterLike) -> Cluster:
    """Worker processes of dask.

    Parameters
    ----------
    choice : Cluster, distributed.Client, str or int
        A client, the address of a scheduler ("tcp://host:8786"), or how many processes of this machine, which are started for it.

    Raises
    ------
    ClusterError
        No scheduler answers there, it has no workers, or these have another version of clvol.
    OptionError
        `choice` is none of these, or a client that is asynchronous or closed.
    MissingDependencyError
        dask's distributed is not installed.
    """
    if isinstance(choice, Cluster):
        return choice
    try:
        distributed = importlib.import_module("distributed")
    except ImportError as missing:
        raise MissingDependencyError("a cluster needs distributed: pip install clvol[dask]") from missing
    if isinstance(choice, distributed.Client):
        if choice.asynchronous:
            raise OptionError("cluster must be a client that is not asynchronous; got one that is: Client(...) outside a coroutine")
        if choice.status != "running":
            raise OptionError(f"cluster must be a client that is connected; got one that is {choice.status}")
        return Cluster(choice)
    if isinstance(choice, str):
        try:
            _require_listening(choice)  # a client that fails to connect takes long to give up
            client = distributed.Client(choice, timeout=WAIT, set_as_default=False)
        except OptionError:
            raise
        except (OSError, TimeoutError, TypeError, ValueError) as error:  # TypeError: of tls without certificates
            why = f" within {WAIT:g} s" if isinstance(error, TimeoutError) else f": {str(error) or type(error).__name__}"
            raise ClusterError(f"no scheduler answers at {choice}{why}") from error
        return Cluster(client, [client])
    if isinstance(choice, bool) or not isinstance(choice, int):
        raise OptionError(
            f"cluster must be a distributed.Client, the address of a scheduler, or a number of processes; got {choice!r}"
        )
    return _local(distributed, whole("cluster", choice, minimum=1, maximum=1024))


def _require_listening(address: str) -> None:
    """Raise unless somebody listens at an address by TCP."""
    found = re.fullmatch(r"(?:(\w+)://)?(.+):(\d+)", address)
    if address.startswith("inproc://"):  # of this process
        return
    if found is None:
        raise OptionError(f"cluster must be the address of a scheduler, such as tcp://host:8786; got {address!r}")
    if found[1] in (None, "tcp", "tls"):
        socket.create_connection((found[2].strip("[]"), int(found[3])), timeout=WAIT).close()


def _local(distributed: Any, count: int) -> Cluster:
    """So many processes of this machine, which share its cores."""
    import dask

    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    each = str(max(1, cores // count))
    settings = {
        "distributed.scheduler.allowed-failures": 1,
        "distributed.worker.use-file-locking": False,
        "distributed.worker.multiprocessing-method": "spawn",  # OpenCL does not survive a fork
    }
    with dask.config.set(settings):
        try:
            cluster = _heedless(
                lambda: distributed.LocalCluster(
                    n_workers=count,
                    threads_per_worker=1,
                    processes=True,
                    dashboard_address="127.0.0.1:0",
                    memory_limit=0,  # bricks have a budget; workers that dask ends at a limit of its own would be started for ever
                    silence_logs=logging.CRITICAL + 1,  # where an interrupt ends it, its scheduler finds that critical
                    env={"POCL_MAX_PTHREAD_COUNT": each, "CL_CONFIG_CPU_FORCE_MAX_COMPUTE_UNITS": each},
                )
            )
        except RuntimeError as error:
            raise ClusterError(
                f"{count} processes must start; got {error}: they import the script that starts them, which does its work below "
                '`if __name__ == "__main__":`'
            ) from error
        try:
            client = distributed.Client(cluster, timeout=3 * WAIT, set_as_default=False)
        except BaseException:
            cluster.close()
            raise
    return Cluster(client, [client, cluster])


def _heedless(start: Callable[[], Any]) -> Any:
    """What starts processes, which do not heed Ctrl-C, that is for who asks for them: a terminal sends it to all of them.

    They have this from the thread that starts them, as have those that are started later. An interrupt meanwhile waits until they
    are there: what has half begun cannot be closed.
    """
    posix = hasattr(signal, "pthread_sigmask")
    made: Future[Any] = Future()
    if posix:
        ensure_running()  # else the thread that starts the first process does it, and heeds Ctrl-C from then on

    def work() -> None:
        if posix:
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            made.set_result(start())
        except BaseException as error:
            made.set_exception(error)

    threading.Thread(target=work, daemon=True, name="clvol: starting a cluster").start()
    try:
        return made.result()
    except KeyboardInterrupt:
        with contextlib.suppress(Exception):  # it did not start
            _close([made.result()])
        raise


# -- in a worker -----------------------------------------------------------------------------------------------------------


def _tried(function: Callable[..., _T], *arguments: Any) -> _T:
    """What a function gives, which is called again where it could not read something; what it refuses it would refuse again."""
    for _ in range(RETRIES):
        try:
            return function(*arguments)
        except OSError as error:
            if isinstance(error, ClvolError) and not isinstance(error, FormatError):
                raise
    return function(*arguments)


def _aside(function: Callable[..., Any], *arguments: Any) -> None:
    """Call a function by a thread of its own: it may have to wait for a task, and the one that asks is what workers listen by."""
    threading.Thread(target=function, args=arguments, daemon=True, name="clvol: told by a cluster").start()


def own_address() -> str:
    """Of this worker; "" in a process that is none."""
    import distributed

    try:
        return str(distributed.get_worker().address)
    except ValueError:
        return ""


class Turn:
    """A lock of a worker's tasks, for one at a time, which does not keep from its turn what the holder waits for.

    Samples may come from an array of dask, which asks the cluster for them: the holder's task then leaves its place to another. One
    that finds the lock taken would wait there for ever, and so leaves its place as well.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._holder: Any = None

    def __enter__(self) -> Self:
        stays = True
        while not self._lock.acquire(timeout=_LOOK):
            if stays and _has_left(self._holder):
                import distributed

                distributed.secede()  # type: ignore[no-untyped-call]  # as distributed has it
                stays = False
        self._holder = _own_task()
        return self

    def __exit__(self, *_: object) -> None:
        self._lock.release()


def _own_task() -> Any:
    """The key of the task that this thread is about; None where it is about none."""
    if (distributed := sys.modules.get("distributed")) is None:
        return None
    try:
        return distributed.get_worker().get_current_task()
    except (ValueError, AttributeError):  # no worker, or no task of its own
        return None


def _has_left(key: Any) -> bool:
    """Whether a task of this thread's worker has left its place to another, and this thread has one to leave."""
    import distributed

    if key is None or _own_task() is None:
        return False
    task = distributed.get_worker().state.tasks.get(key)
    return task is not None and task.state == "long-running"


def neighbours(places: dict[str, int]) -> int:
    """How many workers there are on this one's host, itself included."""
    return max(1, [_host(address) for address in places].count(_host(own_address())))


def own_place(places: dict[str, int]) -> int:
    """Which of its host's workers this process is; any, of one that came later."""
    return places.get(own_address(), len(places))


def worker_device(choice: str | int | None, place: int) -> Device:
    """The device of a worker: of several GPUs of a host each of its workers has its own, in turns."""
    first = as_device(choice)
    if first.kind == "cpu" or choice is not None:
        return first
    alike = [device for device in devices() if device.kind == first.kind]
    return alike[place % len(alike)]
