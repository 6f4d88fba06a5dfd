"""Trial of this machine's OpenCL runtimes in another process, before this one loads them.

A driver may abort, or hang, when it is loaded, when a context is created, or when a kernel is built. The verdict is cached under
a hash of everything that may change it: the libraries that the loader finds and their dates, the linker, environment variables,
and driver versions.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from clvol.device import cache
from clvol.device.runtimes import intel, processor

__all__ = ["Verdict", "forget", "identity", "tried"]

SECONDS = 90.0
"""Time limit of a trial; longer counts as a hang."""

_DOUBT = 600.0  # seconds for which a failure is cached: it may have been fixed since
_LEFT_OUT = 86400.0  # the same for libraries, which have dates: one that hangs takes minutes to try
_KEPT = 16  # cached verdicts
_VARIABLES = ("OCL_", "OPENCL_", "POCL_", "CL_", "CUDA_", "HIP_", "ROCR_", "LD_", "DYLD_")

_TRIAL = """
import json, os, runpy, signal, sys
signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that waits, and says nothing about a driver
try:
    import resource
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
except (ImportError, ValueError, OSError):
    pass
def say(*words):
    print("clvol:" + json.dumps(words), flush=True)
say("begun")
kept, first = runpy.run_path(sys.argv[1]), int(sys.argv[2])
try:
    import pyopencl as cl
except ImportError:
    os._exit(0)  # the parent reports it
try:
    platforms = cl.get_platforms()
except cl.Error:
    platforms = []
found = []
for p in platforms:
    say("platform", p.name.strip())
    try:
        found += p.get_devices()
    except cl.Error:
        pass
say("found", ["|".join(str(t).strip() for t in (d.platform.name, d.platform.version, d.name, d.driver_version)) for d in found])
for i, d in enumerate(found[first:] if first >= 0 else []):
    if not (d.available and d.compiler_available):
        continue
    say("trying", first + i)
    try:
        kept["name_processor"](d)
        c = cl.Context([d]); q = cl.CommandQueue(c)
        k = cl.Program(c, "kernel void probe(global int *a) { a[0] = 1; }").build()
        got = bytearray(4)
        a = cl.Buffer(c, cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR, hostbuf=got)
        cl.Kernel(k, "probe")(q, (1,), None, a); cl.enqueue_copy(q, got, a)
        if int.from_bytes(got, sys.byteorder) == 1:
            say("works", first + i)
        else:  # PoCL 7.1 without a linker
            say("fails", first + i, "a kernel ran without a result")
    except cl.Error as error:
        say("fails", first + i, (str(error).strip().splitlines() or ["without a message"])[-1])
os._exit(0)
"""


@dataclass
class Verdict:
    """Result of a trial: why something is unusable, or "" if it is usable."""

    unloadable: str = ""  # all runtimes
    libraries: dict[str, str] = field(default_factory=dict)  # vendors' libraries, which must be hidden from the loader
    devices: dict[str, str] = field(default_factory=dict)  # by their `identity`

    @property
    def sound(self) -> bool:
        return not (self.unloadable or self.libraries or any(self.devices.values()))


class _NotBegun(Exception):
    """A trial printed nothing: what was started is not Python, as in a program that embeds it, or the disk is full.

    It says nothing about drivers.
    """


def identity(handle: Any) -> str:
    """Names of a device and its platform, and versions of its driver."""
    platform = handle.platform
    return "|".join(str(text).strip() for text in (platform.name, platform.version, handle.name, handle.driver_version))


def tried() -> Verdict:
    """The cached verdict on this machine's runtimes, or that of a trial now."""
    if not sys.executable or getattr(sys, "frozen", False):
        return Verdict()  # a frozen program: there is no Python to start
    note = _note()
    if note is not None:
        with suppress(OSError, ValueError, TypeError):
            verdict = Verdict(**json.loads(note.read_text(encoding="utf-8")))
            others = verdict.unloadable or any(verdict.devices.values())
            if verdict.sound or time.time() - note.stat().st_mtime < (_DOUBT if others else _LEFT_OUT):
                return verdict
    try:
        verdict = _try()
    except _NotBegun:
        return Verdict()
    if note is not None:
        with suppress(OSError):
            cache.replace(note, json.dumps(asdict(verdict)).encode())
            notes = sorted(note.parent.glob("probe-*.json"), key=lambda file: file.stat().st_mtime)
            for old in notes[:-_KEPT]:
                old.unlink(missing_ok=True)
    return verdict


def forget() -> None:
    """Discard the cached verdict."""
    note = _note()
    if note is not None:
        with suppress(OSError):
            note.unlink(missing_ok=True)


def _note() -> Path | None:
    """The file of the verdict on what is installed now."""
    folder = cache.folder()
    if folder is None:
        return None
    stamp: list[object] = [sys.executable, sys.prefix, _TRIAL]
    variables = (name for name in os.environ if name.startswith(_VARIABLES) and name != "POCL_CACHE_DIR")
    stamp += sorted(f"{name}={os.environ[name]}" for name in variables)
    loader = find_spec("pyopencl")
    package = Path(loader.origin).parent if loader and loader.origin else None
    linker = shutil.which("ld")
    files = [Path(text) for text in intel.vendors() or () if Path(text).is_absolute()]
    files += [package / "version.py", *sorted(package.glob(".libs/*"))] if package else []
    for file in (*files, *([Path(linker)] if linker else ())):
        with suppress(OSError):
            about = file.stat()
            stamp.append((str(file), about.st_size, about.st_mtime_ns))
    stamp.append(intel.vendors())
    return folder / f"probe-{hashlib.sha256(repr(stamp).encode()).hexdigest()[:16]}.json"


def _try() -> Verdict:
    verdict = Verdict()
    for _ in range(2):
        names, failures = _all(verdict.libraries)
        if names is not None:
            verdict.devices = {name: failures.get(i, "") for i, name in enumerate(names)}
            return verdict
        verdict.unloadable = failures[-1]
        if not verdict.unloadable:
            return verdict
        for library in intel.vendors() or ():
            others = {other for other in intel.vendors() or () if other != library}
            found, why = _run(-1, {*others, *verdict.libraries})[1:]
            if found is None:
                verdict.libraries[library] = why
        if not verdict.libraries:
            return verdict
        verdict.unloadable = ""
    verdict.unloadable = failures[-1]
    return verdict


def _all(without: Collection[str]) -> tuple[list[str] | None, dict[int, str]]:
    """Names of the devices, None if loading fails; why some fail, by number (-1: loading)."""
    failures: dict[int, str] = {}
    first = 0
    while True:
        trying, names, why = _run(first, without, failures)
        if names is None:
            return None, {-1: why}
        if trying is None:
            return names, failures
        failures[trying] = why
        first = trying + 1


def _run(first: int, without: Collection[str], failures: dict[int, str] | None = None) -> tuple[int | None, list[str] | None, str]:
    """One trial, from device `first` on: the device that ended it early, the devices found, and how it ended."""
    begun, trying, names, why, platform = False, None, None, "", ""
    with tempfile.TemporaryDirectory(prefix="clvol-trial-", dir=_roomy()) as folder, intel.known_to_the_loader(without):
        environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
            "PYOPENCL_NO_CACHE": "1",
            "POCL_CACHE_DIR": folder,
        }
        command = [sys.executable, "-P", "-c", _TRIAL, processor.__file__, str(first)]
        try:
            nothing = subprocess.DEVNULL  # in case a driver reads input
            done = subprocess.run(command, capture_output=True, env=environment, timeout=SECONDS, check=False, stdin=nothing)
            output = done.stdout
            why = "" if done.returncode == 0 else _ending(done.returncode, done.stderr)
        except subprocess.TimeoutExpired as error:
            output, why = error.stdout or b"", f"gave no answer within {SECONDS:g} s"
        except OSError as error:
            raise _NotBegun from error
    for kind, *words in _said(output):
        if kind == "begun":
            begun = True
        elif kind == "platform":
            platform = words[0]
        elif kind == "found":
            names = words[0]
        elif kind == "trying":
            trying = words[0]
        else:
            trying = None
            if kind == "fails" and failures is not None:
                failures[words[0]] = f"failed: {words[1]}"
    if not begun:
        raise _NotBegun
    if names is None and platform:
        why = f"{why} (at {platform})"
    return trying if why else None, names, why


def _roomy() -> Path:
    """A folder with room for what a trial builds, without which it would abort: a full disk says nothing about drivers."""
    for folder in (Path(tempfile.gettempdir()), cache.folder()):
        if folder is not None and cache.has_room(folder):
            return folder
    raise _NotBegun


def _said(output: bytes) -> Iterator[list[Any]]:
    for line in output.decode(errors="replace").splitlines():
        _, found, text = line.partition("clvol:")
        if found:
            with suppress(ValueError):  # the last line of a process that was killed
                yield json.loads(text)


def _ending(code: int, errors: bytes) -> str:
    last = errors.decode(errors="replace").strip().splitlines()[-1:]
    words = f" ({last[0]})" if last else ""
    if code < 0:
        with suppress(ValueError):
            return f"ended by {signal.Signals(-code).name}{words}"
    return f"ended with status {code}{words}"
