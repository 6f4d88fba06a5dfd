"""Random work over the public API, for a long time, in several threads; no result may change and no resource may grow.

    python -m bench.soak --minutes N [--threads T] [--seed S] [--new SHARE] [--output FILE]

Each deed of deeds.py gives the same result, to the last bit, for the same seed. The deeds of a catalogue are computed in advance,
one after the other in the single thread of another process, then repeated by all threads of this one; some draws use new seeds,
which the other process computes afterwards. From time to time all threads pause, and the process's resources are counted: resident
memory, open descriptors, threads, files left behind, and buffers on the device. After a first quarter, in which caches fill, the
median of the last third must not exceed that of the first: memory by 2 % or 20 MB at most, all else not at all. What calls keep
for the next ones, such as a renderer's last frame, is emptied before. Memory is judged in runs of ten minutes or more, the time
that caches need to fill, and of ``--new 0``: runtimes keep some memory of each program that they build (PoCL 3.0: 16 kB of one
with 140 kB of text, even from its cache), and new arguments need new programs. Without new ones all programs are kept; otherwise
the 128 most recently used are. With glibc, free heap memory is returned before memory is counted: how much of it remains depends
on the mix of threads' requests, not on what is held. The resident memory before that is recorded too. Exit status 1 means that a
result changed, a foreign exception occurred, or something grew; 2 that a deed did not finish.

Kernels are rebuilt in a temporary cache unless POCL_CACHE_DIR names one.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import datetime as dt
import faulthandler
import gc
import json
import os
import queue
import subprocess
import sys
import tempfile
import threading
import time
import traceback
import warnings
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import median
from typing import IO, Any

import numpy as np
from rich.console import Console
from rich.table import Table

__all__ = ["HELD", "Buffers", "grown", "held", "kernels", "main", "table_of"]

RESULTS = Path(__file__).parent / "results" / "soak"
FORMAT = 1
HELD = {"resident": "resident memory, MB", "descriptors": "descriptors", "threads": "threads", "files": "files left behind"} | {
    "buffers": "buffers on the device",
    "buffer_bytes": "bytes in these",
}
"""What is counted, in words."""
_WARM_UP = 0.25  # of the time
_SLACK, _SLACK_SHARE = 20e6, 0.02  # bytes by which resident memory may grow
_ALL = 1 << 20  # programs
_FILLING = 10  # minutes in which caches fill
_STUCK = 600  # maximum seconds per deed
_STATUS_STUCK = 2
_SHOWN = 5


class Buffers:
    """Live OpenCL memory objects, counted on creation and release."""

    def __init__(self) -> None:
        self.sizes: dict[int, int] = {}

    def watch(self) -> None:
        """Replace pyopencl's classes by counting ones."""
        import pyopencl as cl

        for name in ("Buffer", "Image"):
            setattr(cl, name, self._counted(getattr(cl, name)))

    def _counted(self, kind: Any) -> Any:
        sizes = self.sizes

        class Counted(kind):  # type: ignore[misc]  # pyopencl tells no types
            def __init__(self, *given: Any, **options: Any) -> None:
                super().__init__(*given, **options)
                sizes[id(self)] = self.size

            def release(self) -> None:
                super().release()
                sizes.pop(id(self), None)

            def __del__(self) -> None:
                sizes.pop(id(self), None)

        return Counted


class Reference:
    """The process that computes one deed at a time in one thread."""

    def __init__(self, quick: bool) -> None:
        command = [sys.executable, "-m", "bench.soak", "--reference", *(["--quick"] if quick else [])]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, encoding="utf-8", cwd=Path(__file__).parents[1]
        )
        self._lock = threading.Lock()

    def ask(self, name: str, seed: int) -> tuple[str, bool]:
        """As `deeds.do`."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with self._lock:
            print(name, seed, file=self._process.stdin, flush=True)
            line = self._process.stdout.readline()
        if not line:
            raise RuntimeError(f"the reference process ended at {name} {seed} with status {self._process.wait(60)}")
        told, refused = json.loads(line)
        return told, refused

    def close(self) -> None:
        """End it."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        try:
            self._process.wait(60)
        except subprocess.TimeoutExpired:
            self._process.kill()


def answer(questions: IO[str], answers: IO[str], quick: bool) -> None:
    """The reference process: for each line with a deed's name and seed, the outcome."""
    from bench.deeds import World, do

    with tempfile.TemporaryDirectory(prefix="clvol-soak-") as folder:
        world = World(Path(folder), quick)
        for line in questions:
            name, seed = line.split()
            try:
                told, refused = do(world, name, int(seed))
            except Exception as error:
                told, refused = f"foreign {type(error).__name__}: {error}", False
            print(json.dumps([told, refused]), file=answers, flush=True)
        world.close()


class Soak:
    """One run."""

    def __init__(self, world: Any, reference: Reference, catalogue: dict[tuple[str, int], str], seed: int, share: float) -> None:
        self.world, self.reference, self.catalogue, self.seed, self.share = world, reference, catalogue, seed, share
        self.done: Counter[str] = Counter()
        self.refused: Counter[str] = Counter()
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self.new = 0
        self.faults: list[str] = []
        self.stuck = False
        self._over = threading.Event()
        self._lock = threading.Lock()
        self._pausing = threading.Event()
        self._to_check: queue.Queue[tuple[str, int, str] | None] = queue.Queue(64)

    def run(self, seconds: float, threads: int, buffers: Buffers) -> list[dict[str, float]]:
        """Work for the given time; returns the measurements over time.

        Threads stop when they are signalled, never by their own clock: one that had stopped early would block the others.
        """
        self._gate = threading.Barrier(threads + 1)
        begun = time.perf_counter()
        checker = threading.Thread(target=self._check_new, daemon=True)
        workers = [threading.Thread(target=self._work, args=(number,), daemon=True) for number in range(threads)]
        for thread in (checker, *workers):
            thread.start()
        pause = min(30.0, max(0.5, seconds / 60))
        samples: list[dict[str, float]] = []
        try:
            while time.perf_counter() + pause < begun + seconds:
                time.sleep(pause)
                self._pausing.set()
                self._gate.wait(_STUCK)  # all threads have arrived
                self._pausing.clear()
                forget()
                gc.collect()
                samples.append({"seconds": time.perf_counter() - begun, **held(self.world.folder, buffers)})
                self._gate.wait(_STUCK)
        except threading.BrokenBarrierError:
            self._tell_stuck()
            return samples
        self._over.set()
        for worker in workers:
            worker.join(_STUCK)
        with contextlib.suppress(queue.Full):
            self._to_check.put(None, timeout=_STUCK)
        checker.join(_STUCK)
        if any(thread.is_alive() for thread in (checker, *workers)):
            self._tell_stuck()
        return samples

    def _tell_stuck(self) -> None:
        self.stuck = True
        faulthandler.dump_traceback()
        self.faults.append(f"a deed took more than {_STUCK} s; where all threads are stands above")

    def _work(self, number: int) -> None:
        from bench.deeds import do

        random = np.random.default_rng([self.seed, number])
        known = list(self.catalogue)
        while not self._over.is_set():
            if self._pausing.is_set():
                try:
                    self._gate.wait(_STUCK)
                    self._gate.wait(_STUCK)
                except threading.BrokenBarrierError:
                    return
            name, seed = known[int(random.integers(len(known)))]
            if is_new := random.random() < self.share:
                seed = int(random.integers(1 << 20, 1 << 62))
            started = time.perf_counter()
            try:
                told, refused = do(self.world, name, seed)
            except Exception:
                self._fault(f"{name} {seed}: {traceback.format_exc()}")
                continue
            took = time.perf_counter() - started
            with self._lock:
                self.done[name] += 1
                self.refused[name] += refused
                self.seconds[name] += took
                self.new += is_new
            if is_new:
                self._to_check.put((name, seed, told))
            elif told != self.catalogue[name, seed]:
                self._fault(f"{name} {seed}: {told}, not {self.catalogue[name, seed]}")

    def _check_new(self) -> None:
        while (item := self._to_check.get()) is not None:
            name, seed, told = item
            try:
                expected, _ = self.reference.ask(name, seed)
            except RuntimeError as error:
                expected = str(error)
            if told != expected:
                self._fault(f"{name} {seed}, drawn once: {told}, not {expected}")

    def _fault(self, text: str) -> None:
        with self._lock:
            self.faults.append(text)
        print(text, file=sys.stderr, flush=True)


def forget() -> None:
    """Empty what calls keep for the next ones: how much it is, up to a bound, depends on which calls came last."""
    from clvol.base.kept import Kept, Once
    from clvol.device.plan import Plans

    for one in gc.get_objects():
        if type(one) in (Kept, Once, Plans):
            one.clear()


def held(folder: Path, buffers: Buffers) -> dict[str, float]:
    """What the process holds now; system values only where the system reports them."""
    told: dict[str, float] = {"threads": threading.active_count()}
    with contextlib.suppress(OSError):
        told |= {"untrimmed": _resident(), "descriptors": len(list(Path("/proc/self/fd").iterdir()))}
        with contextlib.suppress(AttributeError):  # it is glibc's
            ctypes.CDLL(None).malloc_trim(0)
        told |= {"resident": _resident()}
    told |= {"files": sum(len(files) + len(folders) for _, folders, files in os.walk(folder))}
    return told | {"buffers": len(buffers.sizes), "buffer_bytes": sum(buffers.sizes.values())}


def _resident() -> int:
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")


def grown(samples: Sequence[dict[str, float]]) -> dict[str, dict[str, Any]]:
    """For each measured quantity, the medians of the first and last third after the warm-up, and whether it grew."""
    steady = samples[int(_WARM_UP * len(samples)) :]
    third = max(1, len(steady) // 3)
    rows: dict[str, dict[str, Any]] = {}
    for name in HELD:
        if all(name in sample for sample in steady) and steady:
            first, last = (median(s[name] for s in part) for part in (steady[:third], steady[-third:]))
            slack = max(_SLACK, _SLACK_SHARE * first) if name == "resident" else 0.0
            most = max(sample[name] for sample in samples)
            rows[name] = {"what": HELD[name], "first": first, "last": last, "most": most, "grew": last > first + slack}
    return rows


def _catalogue(
    reference: Reference, without: Sequence[str], quick: bool, console: Console
) -> tuple[dict[tuple[str, int], str], int]:
    """The hash of each deed and seed, and the number of rejections among them."""
    from bench.deeds import DEEDS

    chosen = {name: deed for name, deed in DEEDS.items() if name not in without}
    made, refusals, begun = {}, 0, time.perf_counter()
    for name, deed in chosen.items():
        for seed in range(1 if quick else deed.count):
            made[name, seed], refused = reference.ask(name, seed)
            refusals += refused
            if made[name, seed].startswith("foreign "):
                raise SystemExit(f"{name} {seed}: {made[name, seed]}")
        console.print(f"{time.perf_counter() - begun:6.0f} s  {name}", highlight=False)
    console.print(f"catalogue: {len(made)} sets of arguments of {len(chosen)} deeds, in {time.perf_counter() - begun:.0f} s")
    return made, refusals


def _programs_counted() -> Counter[str]:
    """The number of programs created, and of those that the compiler had to build or finish, from now on."""
    from clvol.device import program
    from clvol.device.runtimes.pocl import KernelCache

    counts: Counter[str] = Counter()
    make, room = program.build, KernelCache.require_room

    def made(*given: Any) -> Any:
        counts["made"] += 1
        return make(*given)

    def compiled(kernels: KernelCache) -> None:  # requested before each call of the compiler
        counts["compiled"] += 1
        room(kernels)

    setattr(program, "build", made)  # noqa: B010  # mypy lets nobody assign to them
    setattr(KernelCache, "require_room", compiled)  # noqa: B010
    return counts


@contextlib.contextmanager
def kernels() -> Iterator[None]:
    """A kernel cache that is removed after the run, unless one is given: new programs would fill the user's."""
    if os.environ.get("POCL_CACHE_DIR"):
        yield
        return
    with tempfile.TemporaryDirectory(prefix="clvol-soak-kernels-") as folder:
        os.environ["POCL_CACHE_DIR"] = folder
        yield


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--minutes", type=float, default=60, help="how long all threads work; the catalogue is made before")
    arguments.add_argument("--threads", type=int, default=2)
    arguments.add_argument("--seed", type=int, default=0, help="of what is drawn")
    arguments.add_argument("--new", type=float, default=0.04, metavar="SHARE", help="of draws whose seed was never seen")
    arguments.add_argument("--quick", action="store_true", help="the commonest options alone: a check that all of it runs")
    arguments.add_argument("--without", nargs="*", default=[], metavar="DEED")
    arguments.add_argument("--output", type=Path, help="default: bench/results/soak/<date>.json; not written with --quick")
    arguments.add_argument("--reference", action="store_true", help=argparse.SUPPRESS)
    options = arguments.parse_args()
    faulthandler.enable()
    warnings.simplefilter("ignore")
    if options.reference:
        answer(sys.stdin, sys.stdout, options.quick)
        return
    with kernels(), tempfile.TemporaryDirectory(prefix="clvol-soak-") as folder:
        status = _soak(options, Path(folder))
    sys.stdout.flush()
    if status == _STATUS_STUCK:
        os._exit(status)  # interpreter shutdown would wait for the threads
    sys.exit(status)


def _soak(options: argparse.Namespace, folder: Path) -> int:
    import clvol.device.device
    from bench.deeds import World
    from bench.machine import describe
    from clvol.device.choose import as_device
    from clvol.formats.guarded import worker

    console = Console(width=120)
    device = as_device()
    if not options.new:
        setattr(clvol.device.device, "_KEPT", _ALL)  # noqa: B010  # mypy lets nobody assign to it
    buffers = Buffers()
    buffers.watch()
    counted = _programs_counted()
    reference = Reference(options.quick)
    catalogue, refusals = _catalogue(reference, options.without, options.quick, console)
    world = World(folder, options.quick)
    soak = Soak(world, reference, catalogue, options.seed, options.new)
    for _ in range(options.threads):  # else a second one would start when two threads first read files concurrently
        worker.prepare(())
    samples = soak.run(60 * options.minutes, options.threads, buffers)
    rows = grown(samples)
    if not soak.stuck:  # it would wait, too
        world.close()
    gc.collect()
    left = len(buffers.sizes)
    reference.close()
    _show(soak, rows, console)
    judged = [row for name, row in rows.items() if name != "resident" or (options.minutes >= _FILLING and not options.new)]
    failed = bool(soak.faults) or any(row["grew"] for row in judged)
    report = {
        "format": FORMAT,
        "date": dt.date.today().isoformat(),
        "version": clvol.__version__,
        "machine": describe(device),
        "minutes": options.minutes,
        "threads": options.threads,
        "seed": options.seed,
        "new": options.new,
        "programs": dict(counted),
        "catalogue": len(catalogue),
        "catalogue_refusals": refusals,
        "draws": sum(soak.done.values()),
        "draws_of_new_arguments": soak.new,
        "refused": sum(soak.refused.values()),
        "by_deed": {name: {"draws": soak.done[name], "seconds": round(soak.seconds[name], 1)} for name in sorted(soak.done)},
        "faults": soak.faults,
        "held": rows,
        "buffers_after": left,
        "samples": samples,
        "failed": failed,
    }
    output = options.output or (None if options.quick else RESULTS / f"{report['date']}.json")
    if output:
        output.parent.mkdir(parents=True, exist_ok=True)
        output.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
        console.print(f"written to {output}")
    return _STATUS_STUCK if soak.stuck else int(failed)


def _show(soak: Soak, rows: dict[str, dict[str, Any]], console: Console) -> None:
    title = f"{sum(soak.done.values())} draws, {soak.new} of them of new arguments; {len(soak.faults)} faults"
    console.print(table_of(rows, title))
    for fault in soak.faults[:_SHOWN]:
        console.print(fault, markup=False, highlight=False)


def table_of(rows: dict[str, dict[str, Any]], title: str) -> Table:
    """The measurements as a table."""
    table = Table(title=title)
    for column in ("held", "first third", "last third", "most", "grew"):
        table.add_column(column, justify="left" if column == "held" else "right")
    for name, row in rows.items():
        shown = [f"{row[key] / (1e6 if name == 'resident' else 1):,.0f}" for key in ("first", "last", "most")]
        table.add_row(row["what"], *shown, "[red]yes[/red]" if row["grew"] else "no")
    return table


if __name__ == "__main__":
    main()
