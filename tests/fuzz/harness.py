"""Runs mutants through a reader in a separate process with limits, and reports broken promises."""

from __future__ import annotations

import contextlib
import gc
import json
import mmap
import os
import resource
import shutil
import signal
import struct
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import clvol
from clvol.base.errors import ClvolError, ClvolWarning
from tests.fuzz.corpus import CORPORA, Sample
from tests.fuzz.mutate import mutant
from tests.fuzz.truth import TRUTHS, Damaged, Held

__all__ = ["Tally", "fuzz"]

SECONDS = 5.0  # maximum seconds of processor time per input
MEGABYTES = 200.0  # that it may take beyond what the process has
_STALLED = 60.0  # seconds on the clock, on a machine with other work
_ROOM = 3 << 29  # bytes of address space beyond what the process has
_BATCH = 4000  # inputs of one process
_WARM = 500  # of these, before its memory counts as steady
_LEAK = 25.0  # MB that a batch may grow by after that
_SAVED = 3  # saved inputs per kind of finding


@dataclass
class Tally:
    """What became of the mutants of one format.

    Parameters
    ----------
    format : str
        Its name in the corpus.
    tried, rejected, accepted : int
        Mutants; `accepted` were read.
    compared : int
        Of those that were read, how many could be compared with what somebody else reads.
    crashes, hangs, memory, foreign, silent, leaks : int
        Broken promises: a dead process; more than 5 s; more than 200 MB; an error or a warning that is not clvol's; samples
        other than the file's; memory or descriptors that a batch left behind.
    lenient : int
        Damaged files that were read as they had been before the damage.
    contained : int
        Of the files read in one process (`trusted`), those that ended it or took too much of it, and kept all promises when
        the process read them that is there for it.
    slowest_s, peak_mb : float
        The most that one input took, in seconds of processor time and beyond what the process had.
    findings : dict
        How often each, by what it is; and the seed of the first.
    doubtful : list of int
        Seeds of what one process could not bear, which are yet to be read as `clvol.read` does by default.
    """

    format: str
    tried: int = 0
    refused: int = 0
    accepted: int = 0
    compared: int = 0
    crashes: int = 0
    hangs: int = 0
    memory: int = 0
    foreign: int = 0
    silent: int = 0
    lenient: int = 0
    leaks: int = 0
    contained: int = 0
    slowest_s: float = 0.0
    peak_mb: float = 0.0
    findings: dict[str, list[int]] = field(default_factory=dict)
    doubtful: list[int] = field(default_factory=list)

    @property
    def broken(self) -> int:
        """Promises that were broken."""
        return self.crashes + self.hangs + self.memory + self.foreign + self.silent + self.leaks

    def find(self, kind: str, what: str, seed: int) -> bool:
        """Count a finding; returns whether to keep its input."""
        setattr(self, kind, getattr(self, kind) + 1)
        found = self.findings.setdefault(f"{kind}: {what}", [0, seed])
        found[0] += 1
        return found[0] <= _SAVED

    def add(self, other: Tally) -> None:
        """Add the counts of another process."""
        for name, value in asdict(other).items():
            if isinstance(value, float):
                setattr(self, name, max(getattr(self, name), value))
            elif isinstance(value, int):
                setattr(self, name, getattr(self, name) + value)
        for what, (count, seed) in other.findings.items():
            found = self.findings.setdefault(what, [0, seed])
            found[0] += count


def fuzz(kind: str, seeds: Sequence[int], keep: Path, *, trusted: bool = False) -> Tally:
    """Run the mutants of these seeds; inputs that break a promise are saved in a folder."""
    samples = list(CORPORA[kind]())
    total = Tally(kind)
    seeds = list(seeds)
    while seeds:
        batch, died = _run(kind, samples, seeds[:_BATCH], keep, trusted)
        total.add(batch)
        seeds = seeds[batch.tried :]
        if died and trusted:
            batch.doubtful.append(died[2])
        elif died:
            total.find(*died)
            mutated, _ = mutant(samples, kind, died[2])
            _save(mutated, keep / f"{kind}-{died[2]}")
        if batch.doubtful:
            again = fuzz(kind, batch.doubtful, keep)
            total.contained += max(0, len(batch.doubtful) - again.broken)
            again.tried = again.refused = again.accepted = again.compared = again.lenient = 0  # these were counted
            total.add(again)
    return total


def _warm(kind: str, sample: Sample, trusted: bool) -> None:
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings(action="ignore"):
        _save(sample, Path(folder))
        wrong = _difference(TRUTHS[kind](sample.files, sample.entry, sample.options), _read(Path(folder), sample, trusted))
    if wrong:
        raise AssertionError(f"the corpus of {kind} is not read as it is: {wrong}")


def _run(
    kind: str, samples: list[Sample], seeds: list[int], keep: Path, trusted: bool
) -> tuple[Tally, tuple[str, str, int] | None]:
    """Fork and watch: the child's counts, and its cause of death."""
    shared = mmap.mmap(-1, 16)  # how many were begun, and the processor time at the last
    with tempfile.TemporaryDirectory(dir=_memory_disk()) as folder:
        out = Path(folder) / "tally.json"
        sys.stdout.flush()
        child = os.fork()
        if not child:
            status = 1
            try:
                _child(kind, samples, seeds, keep, trusted, Path(folder), shared)
                status = 0
            except BaseException:
                traceback.print_exc()
            finally:
                sys.stderr.flush()
                os._exit(status)
        status, hung = _watch(child, shared)
        begun = struct.unpack_from("q", shared)[0]
        tally = Tally(**json.loads(out.read_text())) if out.is_file() else Tally(kind)
        if not hung and os.WIFEXITED(status) and os.WEXITSTATUS(status) == 0:
            return tally, None
    if not hung and os.WIFEXITED(status) and os.WEXITSTATUS(status) == 1:
        raise RuntimeError(f"the harness failed at {kind}, seed {seeds[max(0, begun - 1)]}")
    tally.tried = begun
    if hung:
        return tally, ("hangs", f"no end within {SECONDS:g} s", seeds[begun - 1])
    why = signal.Signals(os.WTERMSIG(status)).name if os.WIFSIGNALED(status) else f"exit status {os.WEXITSTATUS(status)}"
    return tally, ("crashes", why, seeds[begun - 1])


def _watch(child: int, shared: mmap.mmap) -> tuple[int, bool]:
    """The child's exit status, and whether it had to be killed."""
    last, since = -1, time.monotonic()
    while True:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return status, False
        begun, started = struct.unpack("qd", shared[:16])
        if begun != last:
            last, since = begun, time.monotonic()
        if time.monotonic() - since > _STALLED or (begun and _processor_time(child) - started > 2 * SECONDS):
            os.kill(child, signal.SIGKILL)
            return os.waitpid(child, 0)[1], True
        time.sleep(0.02)


def _processor_time(process: int) -> float:
    with contextlib.suppress(OSError):
        words = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
        return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")
    return 0.0


def _memory_disk() -> str | None:
    return "/dev/shm" if Path("/dev/shm").is_dir() else None


def _child(kind: str, samples: list[Sample], seeds: list[int], keep: Path, trusted: bool, folder: Path, shared: mmap.mmap) -> None:
    silence = os.open(os.devnull, os.O_WRONLY)
    errors = os.dup(2)
    os.dup2(silence, 1)
    os.dup2(silence, 2)
    sys.stderr = os.fdopen(errors, "w")
    limit = _status("VmSize") + _ROOM
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for sample in samples:  # what is imported once, and that the corpus is sound; threads do not live on in a fork
        _warm(kind, sample, trusted)
    family = _Family()
    tally = Tally(kind)
    steady: tuple[float, int] | None = None
    for n, seed in enumerate(seeds):
        shared[:16] = struct.pack("qd", n + 1, time.process_time())
        mutated, original = mutant(samples, kind, seed)
        here = folder / "files"
        _save(mutated, here)
        if not _one(mutated, original, kind, seed, here, trusted, tally, family):
            _save(mutated, keep / f"{kind}-{seed}")
        tally.tried += 1
        if n == _WARM:
            steady = _held()
        (folder / "tally.json").write_text(json.dumps(asdict(tally)))
    if steady:
        memory, handles = _held()
        if memory - steady[0] > _LEAK or handles > steady[1]:
            tally.find("leaks", f"of memory or handles ({memory - steady[0]:.0f} MB, {handles - steady[1]})", seeds[0])
    (folder / "tally.json").write_text(json.dumps(asdict(tally)))


def _held() -> tuple[float, int]:
    """Megabytes in memory, and open handles."""
    gc.collect()
    return _status("VmRSS") / 1e6, sum(1 for _ in Path("/proc/self/fd").iterdir())


def _status(name: str, process: str = "self") -> int:
    for line in Path(f"/proc/{process}/status").read_text().splitlines():
        if line.startswith(name + ":"):
            return int(line.split()[1]) * 1024
    return 0


def _save(sample: Sample, folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for name, content in sample.files.items():
        path = folder / name
        if "/" in name:
            path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


_TRUSTED = {"trusted": True} if "trusted" in signature(clvol.read).parameters else {}


def _read(folder: Path, sample: Sample, trusted: bool) -> Any:
    path, how = folder / sample.entry, _TRUSTED if trusted else {}
    return clvol.read(path, **sample.options, **how) if sample.options else clvol.read_all(path, **how)


class _Family:
    """This process and its reading process, if any: their total use."""

    def __init__(self) -> None:
        self._children = self._found()
        self._any = bool(self._children)
        self._before: dict[str, float] = {}
        self._spent = 0.0

    def begin(self) -> None:
        """Start counting time and memory."""
        if self._any and not all(Path(f"/proc/{child}").exists() for child in self._children):
            self._children = self._found()
        self._before = {}
        for process in ("self", *self._children):
            with contextlib.suppress(OSError):
                Path(f"/proc/{process}/clear_refs").write_text("5")  # the peak begins anew
                self._before[process] = _status("VmRSS", process)
        self._spent = self._processor_time()

    def end(self) -> tuple[float, float]:
        """Processor time in seconds, and the peak memory of one process beyond its start, in MB."""
        peaks = [0.0]
        for process, before in self._before.items():
            with contextlib.suppress(OSError):
                peaks.append((_status("VmHWM", process) - before) / 1e6)
        return max(0.0, self._processor_time() - self._spent), max(peaks)

    def _processor_time(self) -> float:
        return time.process_time() + sum(_processor_time(int(child)) for child in self._children)

    @staticmethod
    def _found() -> list[str]:
        me, found = os.getpid(), []
        for folder in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                if int((folder / "stat").read_text().rpartition(")")[2].split()[1]) == me:
                    found.append(folder.name)
        return found


def _one(
    mutated: Sample, original: Sample, kind: str, seed: int, folder: Path, trusted: bool, tally: Tally, family: _Family
) -> bool:
    """Whether the reader keeps its promises for this input."""
    result, wrong, scarce = None, [], False
    family.begin()
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            result = _read(folder, mutated, trusted)
        except ClvolError:
            tally.refused += 1
        except Exception as error:
            where = traceback.extract_tb(error.__traceback__)[-1]
            scarce = trusted and isinstance(error, MemoryError)
            if not scarce:
                wrong.append(("foreign", f"{type(error).__name__} in {Path(where.filename).name}:{where.name}"))
    seconds, peak = family.end()
    if trusted and (scarce or seconds > SECONDS or peak > MEGABYTES):
        tally.doubtful.append(seed)
    else:
        tally.slowest_s, tally.peak_mb = max(tally.slowest_s, seconds), max(tally.peak_mb, peak)
        if seconds > SECONDS:
            wrong.append(("hangs", f"more than {SECONDS:g} s"))
        if peak > MEGABYTES:
            wrong.append(("memory", f"more than {MEGABYTES:g} MB"))
    wrong += [
        ("foreign", f"{w.category.__name__}: {str(w.message)[:60]}") for w in told if not issubclass(w.category, ClvolWarning)
    ]
    if result is not None:
        tally.accepted += 1
        silent = _judged(kind, mutated, original, result, bool(told), tally)
        wrong += [silent] if silent else []
    kept = [tally.find(what, why, seed) for what, why in wrong]  # each is counted
    return not any(kept)


def _judged(kind: str, mutated: Sample, original: Sample, result: Any, told: bool, tally: Tally) -> tuple[str, str] | None:
    """How what was read differs from what the file holds; None where it does not, or nobody can tell.

    A damaged file that is read as it was before the damage is read leniently; no sample was changed by that.
    """
    truth, held, damaged = TRUTHS[kind], None, ""
    with warnings.catch_warnings(action="ignore"), np.errstate(all="ignore"):
        try:
            held = truth(mutated.files, mutated.entry, mutated.options)
        except Damaged as error:
            damaged = _general(str(error))
        except Exception:  # the other reader's trouble
            held = None
        if not (damaged or original.checked):
            tally.compared += held is not None
            wrong = _difference(held, result, told)
            return ("silent", wrong) if wrong else None
        tally.compared += 1
        wrong = _difference(truth(original.files, original.entry, original.options), result, told)
    if damaged:
        return (
            ("silent", f"read otherwise, but damaged: {damaged}")
            if wrong
            else ("lenient", f"read as before, but damaged: {damaged}")
        )
    return ("silent", wrong) if wrong else None


def _general(text: str) -> str:
    """A message without its numbers, to group similar findings."""
    return "".join("#" if c.isdigit() else c for c in text)[:70]


def _difference(held: Held | None, result: Any, told: bool = False) -> str:
    """How samples or geometry differ, in a few words; `told`: a warning may have said that only a part was read."""
    if held is None:
        return ""
    grid = result if isinstance(result, clvol.Volume) else result.grid
    data, truth = np.asarray(result), held.data
    ours, theirs = (tuple(n for n in one.shape if n > 1) for one in (data, truth))
    if data.dtype == np.float64 and truth.dtype.char == "g":  # volumes of HDF5 hold long doubles as these
        truth = truth.astype(np.float64)
    native = truth.dtype.newbyteorder("=")
    scaled = held.loose and native == np.float64  # by whole numbers, which other types hold too
    if data.dtype.newbyteorder("=") != native and not scaled:
        return f"dtype {data.dtype} for {native}"
    if told and data.size < truth.size:
        return "" if np.isin(data, truth).all() else "other samples"
    if held.loose:
        if sorted(ours) != sorted(theirs):
            if data.size == truth.size:
                return "" if _alike(np.sort(data, None), np.sort(truth, None)) else "other samples"
            return "another number of samples"
        return "" if _alike(np.sort(data, None), np.sort(truth, None)) else "other samples"
    if ours != theirs:
        return "another shape"
    if not _alike(data.reshape(ours), truth.reshape(theirs)):
        return "other samples"
    for name, value in (("spacing", held.spacing), ("origin", held.origin)):
        if value is not None and not np.allclose(getattr(grid, name), value[: grid.ndim], rtol=1e-5, atol=1e-6, equal_nan=True):
            return f"another {name}"
    return ""


def _alike(a: NDArray[Any], b: NDArray[Any]) -> bool:
    return bool(np.array_equal(a, b, equal_nan=a.dtype.kind == "f"))
