"""Clusters of dask: connecting to one or starting it, submitting work, and clear errors when a scheduler or a worker fails."""

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
from concurrent.futures import ThreadPoolExecutor
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
    "WorkerLock",
    "as_cluster",
    "local_rank",
    "local_size",
    "version",
    "worker_address",
    "worker_device",
]

ClusterLike: TypeAlias = "Cluster | distributed.Client | str | int"
"""What `as_cluster` accepts."""

WAIT = 10.0
"""Timeout in seconds of a scheduler's answer, and of its first worker."""
DESERTED = 60.0
"""Seconds that a cluster may be without workers before work is given up: a nanny restarts a worker that died."""
SLOWEST = 320.0
"""Longest timeout in seconds for the transfer of one result."""
RETRIES = 2
"""How often a task that could not read something runs again: the fault of a disk or a network may have passed."""
_POLL = 0.01  # seconds
_CENSUS = 2.0  # seconds between checks that the scheduler and its workers are there
_LARGE = 8 << 20  # bytes; smaller values pass through the scheduler, which keeps them
_T = TypeVar("_T")


class LostError(ClusterError):
    """Data was lost with the workers that held it; the work may be submitted again."""


class PoisonError(ClusterError):
    """Every worker that ran the task `key` died."""

    def __init__(self, message: str, key: str = "") -> None:
        super().__init__(message)
        self.key = key


def version() -> str:
    """The version of clvol in the calling process."""
    return str(sys.modules["clvol"].__version__)


class Cluster:
    """A connected, synchronous client's cluster, whose workers all have this version of clvol. `owned` are closed with it."""

    def __init__(self, client: distributed.Client, owned: Sequence[Any] = ()) -> None:
        self.client = client
        self._populated = time.monotonic()  # when there were workers last
        self._finalizer = weakref.finalize(self, _close, list(owned))
        try:
            self._require_same_version()
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
        """Disconnect, and stop the processes that were started for this cluster."""
        self._finalizer()

    @property
    def address(self) -> str:
        """The scheduler's address."""
        scheduler = getattr(self.client, "scheduler", None)
        return str(getattr(scheduler, "address", None) or "an unknown address")

    @property
    def workers(self) -> tuple[str, ...]:
        """Their addresses, sorted by host and port."""
        if self.client.status != "running":
            raise self._gone()
        try:
            return tuple(sorted(self._census(), key=_host_and_port))
        except OSError as error:
            raise self._gone() from error

    def local_ranks(self) -> dict[str, int]:
        """Each worker's index among those of its host, which chooses between the host's GPUs."""
        count: dict[str, int] = {}
        ranks = {}
        for address in self.workers:
            host, _ = _host_and_port(address)
            ranks[address] = count.get(host, 0)
            count[host] = ranks[address] + 1
        return ranks

    # -- state of the cluster ----------------------------------------------------------------------------------------------

    def _census(self, timeout: float | None = None) -> list[str]:
        """The addresses of all workers, as the scheduler itself has them: the client's own list is refreshed by a timer."""
        scheduler: Any = self.client.scheduler
        try:
            return list(self.client.sync(scheduler.ncores, workers=None, callback_timeout=timeout or WAIT))
        except TimeoutError:
            raise self._gone() from None

    def _require_running(self, timeout: float) -> None:
        """`ClusterError` if the scheduler is gone, or has had no workers for `DESERTED` seconds."""
        if self.client.status != "running":
            raise self._gone()
        try:
            if self._census(timeout):
                self._populated = time.monotonic()
        except ClusterError:
            raise
        except OSError:  # dask is reconnecting
            return
        if time.monotonic() - self._populated > DESERTED:
            raise ClusterError(f"the scheduler at {self.address} has had no workers for {DESERTED:g} s")

    def _require_same_version(self) -> None:
        """`ClusterError` unless there are workers and all have this version of clvol.

        `Client.get_versions` would not do: it takes versions from the metadata of installed packages, which says nothing about
        what a worker imports, skips workers that do not answer, and has no timeout.
        """
        try:
            self.client.wait_for_workers(1, timeout=WAIT)
        except TimeoutError:
            raise ClusterError(
                f"the scheduler at {self.address} must have workers; got none within {WAIT:g} s: dask worker {self.address}"
            ) from None
        except (OSError, RuntimeError, ValueError) as error:
            raise ClusterError(f"no scheduler answers at {self.address} any more: {error}") from error
        try:
            answers = self.client.run(version, on_error="return", callback_timeout=3 * WAIT)
        except TimeoutError:
            raise ClusterError(
                f"the workers at {self.address} must say which clvol they have; got no answer within {3 * WAIT:g} s"
            ) from None
        except Exception as error:
            answers = {"a worker": error}
        wrong = []
        for address, answer in sorted(answers.items()):
            if isinstance(answer, (ImportError, AttributeError)) or "ModuleNotFoundError" in str(answer):  # some arrive as text
                wrong.append(f"{address} has none, or another ({answer})")
            elif isinstance(answer, BaseException):
                wrong.append(f"{address} does not say ({answer})")
            elif answer != version():
                wrong.append(f"{address} has {answer}")
        if wrong:
            raise ClusterError(
                f"workers must have clvol {version()}, as this process has; {'; '.join(wrong)}: start clvol's version on all of "
                f"them, such as by `pip install clvol=={version()}`, and `dask worker` again"
            )

    def _gone(self) -> ClusterError:
        return ClusterError(f"the scheduler at {self.address} is gone, or has dropped this work")

    # -- work --------------------------------------------------------------------------------------------------------------

    def submit(self, function: Callable[..., Any], *args: Any, worker: str | None = None, **options: Any) -> Any:
        """A future of a call, which runs on `worker` if that is free and there."""
        where = {} if worker is None else {"workers": [worker], "allow_other_workers": True}
        return self.client.submit(_retried, function, *args, pure=False, **where, **options)

    def scatter(self, value: Any, nbytes: int) -> Any:
        """A future of an argument of many tasks.

        A large one is copied to all workers, so that it outlives any of them; the scheduler keeps others and can send them again.
        """
        if nbytes > _LARGE:
            return self.client.scatter(value, broadcast=True, hash=False)
        return self.client.submit(_identity, value, pure=False)

    def run_on_all(self, function: Callable[..., Any], *args: Any) -> None:
        """Call a function once on each worker that can be reached, and do not wait for it."""
        if self.client.status == "running":
            with contextlib.suppress(Exception):
                self.client.run(_in_thread, function, *args, callback_timeout=WAIT)

    def as_completed(self, futures: Sequence[Any], *, keep_errors: bool = False) -> Iterator[tuple[int, Any]]:
        """The index and the result of each future, in the order in which they finish.

        Results are fetched one at a time, so that those that the caller is not ready for stay on the workers. With `keep_errors` a
        task's error is yielded in place of its result.
        """
        import distributed

        index = {future.key: i for i, future in enumerate(futures)}
        finished = distributed.as_completed(futures, loop=self.client.loop)
        checked = self._populated = time.monotonic()
        while True:
            for future in finished.next_batch(block=False):
                try:
                    result = self._result(future)
                except ClvolError as error:
                    if not keep_errors or (isinstance(error, ClusterError) and not isinstance(error, PoisonError)):
                        raise
                    result = error
                future.release()
                yield index[future.key], result
            if finished.is_empty():
                return
            if time.monotonic() - checked > _CENSUS:
                self._require_running(2 * WAIT)  # a large graph may keep the scheduler busy
                checked = time.monotonic()
            with finished.thread_condition:
                if not finished.has_ready():
                    finished.thread_condition.wait(_POLL)

    def _result(self, future: Any) -> Any:
        """The result of a finished future."""
        import distributed

        timeout = WAIT
        while timeout <= SLOWEST:
            try:
                return future.result(timeout=timeout)
            except ClvolError:
                raise
            except distributed.KilledWorker as error:
                raise PoisonError(str(error), str(error.task)) from None
            except distributed.CancelledError as error:
                if self.client.status != "running":
                    raise self._gone() from error
                raise LostError(f"the workers that had what this takes are gone from {self.address}") from error
            except TimeoutError:
                self._require_running(WAIT)
                if future.done():  # else its worker died, and another one computes it again
                    timeout *= 2  # each attempt starts the transfer anew
            except Exception as error:
                raise ClusterError(f"{type(error).__name__} in a worker at {self.address}: {error}") from error
        raise ClusterError(
            f"results must come from the workers at {self.address}; one did not within {timeout / 2:g} s, though it is there: "
            "the network is too slow, or a worker is stopped"
        )

    def cancel(self, futures: Sequence[Any]) -> None:
        """Cancel work whose results are not wanted."""
        if self.client.status == "running":
            with contextlib.suppress(Exception):  # the scheduler may be gone, and the work with it
                self.client.cancel(list(futures), force=True)


def _identity(value: Any) -> Any:
    return value


def _close(things: list[Any]) -> None:
    log = logging.getLogger("distributed.client")
    level = log.level
    log.setLevel(logging.CRITICAL + 1)  # an interrupted reconnection to a scheduler that is gone is logged with its tracebacks
    for thing in things:
        with contextlib.suppress(Exception):  # the other side may be gone
            thing.close()
    log.setLevel(level)


def _host_and_port(address: str) -> tuple[str, int]:
    host, _, port = address.rpartition(":")
    return host, int(port) if port.isdigit() else 0


def as_cluster(choice: ClusterLike) -> Cluster:
    """A cluster of dask.

    Parameters
    ----------
    choice : Cluster, distributed.Client, str or int
        A client, the address of a scheduler ("tcp://host:8786"), or how many processes to start on this machine.

    Raises
    ------
    ClusterError
        No scheduler answers there, it has no workers, or these have another version of clvol.
    OptionError
        `choice` is none of these, or a client that is asynchronous or closed.
    MissingDependencyError
        distributed is not installed.
    """
    if isinstance(choice, Cluster):
        return choice
    try:
        distributed = importlib.import_module("distributed")
    except ImportError as missing:
        raise MissingDependencyError('a cluster needs distributed: pip install "clvol[dask]"') from missing
    if isinstance(choice, distributed.Client):
        if choice.asynchronous:
            raise OptionError("cluster must be a client that is not asynchronous; got one that is: Client(...) outside a coroutine")
        if choice.status != "running":
            raise OptionError(f"cluster must be a client that is connected; got one that is {choice.status}")
        return Cluster(choice)
    if isinstance(choice, str):
        try:
            _require_listening(choice)  # a client takes the whole timeout to find that nobody listens
            client = distributed.Client(choice, timeout=WAIT, set_as_default=False)
        except OptionError:
            raise
        except (OSError, TimeoutError, TypeError, ValueError) as error:  # TypeError: tls without certificates
            why = f" within {WAIT:g} s" if isinstance(error, TimeoutError) else f": {str(error) or type(error).__name__}"
            raise ClusterError(f"no scheduler answers at {choice}{why}") from error
        return Cluster(client, [client])
    if isinstance(choice, bool) or not isinstance(choice, int):
        raise OptionError(
            f"cluster must be a distributed.Client, the address of a scheduler, or a number of processes; got {choice!r}"
        )
    return _local(distributed, whole("cluster", choice, minimum=1, maximum=1024))


def _require_listening(address: str) -> None:
    """Raise unless a TCP server listens at an address."""
    if address.startswith("inproc://"):  # a scheduler of this process
        return
    found = re.fullmatch(r"(?:(\w+)://)?(.+):(\d+)", address)
    if found is None:
        raise OptionError(f"cluster must be the address of a scheduler, such as tcp://host:8786; got {address!r}")
    if found[1] in (None, "tcp", "tls"):
        socket.create_connection((found[2].strip("[]"), int(found[3])), timeout=WAIT).close()


def _local(distributed: Any, count: int) -> Cluster:
    """`count` processes of this machine, which share its cores."""
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
            cluster = _uninterrupted(
                lambda: distributed.LocalCluster(
                    n_workers=count,
                    threads_per_worker=1,
                    processes=True,
                    dashboard_address="127.0.0.1:0",
                    memory_limit=0,  # bricks have a budget; a nanny with a limit of its own would restart workers for ever
                    silence_logs=logging.CRITICAL + 1,  # an interrupted scheduler logs at CRITICAL
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


def _uninterrupted(start: Callable[[], _T]) -> _T:
    """Start processes that ignore Ctrl-C, which a terminal sends to all of them: the process that draws decides.

    Processes inherit the blocked signal from the thread that starts them, and so do those that replace them later. An interrupt
    takes effect once they are there: a cluster that is starting cannot be closed.
    """
    pool = ThreadPoolExecutor(1, "clvol: starting a cluster", _block_interrupts)
    if hasattr(signal, "pthread_sigmask"):
        ensure_running()  # else the first process to start brings it along, and unblocks the signal
    starting = pool.submit(start)
    try:
        return starting.result()
    except KeyboardInterrupt:
        with contextlib.suppress(Exception):
            _close([starting.result()])
        raise
    finally:
        pool.shutdown(wait=False)


def _block_interrupts() -> None:
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})


# -- in a worker -----------------------------------------------------------------------------------------------------------


def _retried(function: Callable[..., _T], *args: Any) -> _T:
    """Call a function again if it could not read something. dask's own retries would repeat what is refused for good as well."""
    for _ in range(RETRIES):
        try:
            return function(*args)
        except OSError as error:
            if isinstance(error, ClvolError) and not isinstance(error, FormatError):
                raise
    return function(*args)


def _in_thread(function: Callable[..., Any], *args: Any) -> None:
    """Call a function in a thread: it may wait for a task, and `Client.run` calls in the event loop that tasks need."""
    threading.Thread(target=function, args=args, daemon=True, name="clvol: called by a cluster").start()


def worker_address() -> str:
    """The calling worker's address; "" outside a worker."""
    import distributed

    try:
        return str(distributed.get_worker().address)
    except ValueError:
        return ""


class WorkerLock:
    """A lock that lets one task of a worker run at a time, and never keeps a worker from a task that the holder waits for.

    Samples may be those of a dask array, which are computed by the same cluster: the holder then secedes, and another task takes
    its thread. If that one finds the lock taken, it would block that thread for ever, and so secedes as well.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._holder: Any = None

    def __enter__(self) -> Self:
        seceded = False
        while not self._lock.acquire(timeout=_POLL):
            if not seceded and _has_seceded(self._holder):
                import distributed

                distributed.secede()
                seceded = True
        self._holder = _current_task()
        return self

    def __exit__(self, *_: object) -> None:
        self._lock.release()


def _current_task() -> Any:
    """The key of this thread's task; None outside a task."""
    if (distributed := sys.modules.get("distributed")) is None:
        return None
    try:
        return distributed.get_worker().get_current_task()
    except (ValueError, AttributeError):  # no worker, or no task
        return None


def _has_seceded(key: Any) -> bool:
    """Whether a task of this worker has seceded, and this thread runs a task that could as well."""
    import distributed

    if key is None or _current_task() is None:
        return False
    task = distributed.get_worker().state.tasks.get(key)
    return task is not None and task.state == "long-running"


def local_size(ranks: dict[str, int]) -> int:
    """The number of workers on the calling worker's host, itself included."""
    host, _ = _host_and_port(worker_address())
    return max(1, sum(_host_and_port(address)[0] == host for address in ranks))


def local_rank(ranks: dict[str, int]) -> int:
    """The calling worker's index among those of its host; any, if it joined later."""
    return ranks.get(worker_address(), len(ranks))


def worker_device(choice: str | int | None, rank: int) -> Device:
    """A worker's device: workers of a host that has several GPUs take turns at them."""
    first = as_device(choice)
    if first.kind == "cpu" or choice is not None:
        return first
    alike = [device for device in devices() if device.kind == first.kind]
    return alike[rank % len(alike)]
