"""Native code reads in a child process: its failures do not harm this one, and its results arrive unchanged."""

from __future__ import annotations

import contextlib
import ctypes
import logging
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clvol
from clvol import ClvolWarning, Volume, formats
from clvol.base.errors import DataError, FormatError, OptionError, OutOfMemoryError
from clvol.formats import Limits
from clvol.formats.guarded import messages, worker
from clvol.formats.guarded.limits import Budget, announce, limited
from clvol.volume.volumes import Leading

with contextlib.suppress(ImportError):
    import fcntl

posix = pytest.mark.skipif(sys.platform == "win32", reason="signals and limits of POSIX")
linux = pytest.mark.skipif(sys.platform != "linux", reason="what Linux alone has")


def run(function: Callable[..., Any], *arguments: Any, limits: Limits | None = None, room: int = 8 << 30) -> Any:
    budget = Budget(limits or Limits(), 1000, room)
    return worker.call(function, *arguments, what="read v.x", reader="X", modules=(), budget=budget)


def workers() -> set[int]:
    return {one._process.pid for one in worker._idle}


# -- what happens there ---------------------------------------------------------------------------------------


@posix
@pytest.mark.parametrize(("end", "name"), [("SIGSEGV", "SIGSEGV"), ("SIGABRT", "SIGABRT"), ("SIGKILL", "memory runs out")])
def test_a_crash_is_an_error(end: str, name: str) -> None:
    with pytest.raises(FormatError, match=rf"cannot read v\.x: the reader of X crashed \({name}|{name}.*damaged or hostile"):
        run(exec, f"import os; os.kill(os.getpid(), {getattr(signal, end).value})")
    assert run(len, "abc") == 3  # by a new one


@posix
def test_a_crash_of_native_code_is_an_error() -> None:
    with pytest.raises(FormatError, match="crashed \\(SIGSEGV\\)"):
        run(ctypes.string_at, 0)


@pytest.mark.parametrize("hang", ["while True: pass", "import time; time.sleep(100)"])
def test_a_hang_is_an_error(hang: str) -> None:
    start = time.monotonic()
    with pytest.raises(FormatError, match=r"must be done within 0\.3 s \(Limits\.seconds\).*limits="):
        run(exec, hang, limits=Limits(seconds=0.3))
    assert time.monotonic() - start < 30  # waiting counts a tenth, and the machine may be busy


@linux
def test_memory_beyond_the_announced_size_is_rejected() -> None:
    with pytest.raises(FormatError, match=r"must take at most 128 MiB of memory, for 0 bytes of samples"):
        run(exec, "bytearray(1 << 30)")
    with pytest.raises(FormatError, match=r"must take at most 1 MiB"):
        run(exec, "bytearray(8 << 20)", limits=Limits(bytes=1 << 20))
    run(exec, "from clvol.formats.guarded.limits import announce; announce('v.x', 1 << 27); bytearray(1 << 30)")
    with pytest.raises(FormatError, match="must take at most 128 MiB"):  # it was given back
        run(exec, "bytearray(1 << 30)")


def test_an_interrupt_ends_it() -> None:
    """Sent to this process, which waits; the terminal's own reaches no other."""
    run(len, "")
    timer = threading.Timer(0.5, signal.pthread_kill, [threading.main_thread().ident, signal.SIGINT])
    timer.start()
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # what a shell starts behind itself ignores it
    start = time.monotonic()
    try:
        with pytest.raises(KeyboardInterrupt):
            run(exec, "import time; time.sleep(100)")
    finally:
        signal.signal(signal.SIGINT, before)
    assert time.monotonic() - start < 5
    assert run(len, "abc") == 3


@linux
def test_it_ends_with_this_process() -> None:
    """Whatever it is doing."""
    code = """
import os, threading, time
from clvol.formats.guarded import worker
from clvol.formats.guarded.limits import Budget, Limits
def busy():
    worker.call(exec, "while True: pass", what="read", reader="X", modules=(), budget=Budget(Limits(seconds=99), 1, 1 << 30))
threading.Thread(target=busy, daemon=True).start()
while not list(worker._all): time.sleep(0.01)
time.sleep(1.5)
print(list(worker._all)[0]._process.pid, flush=True)
os.kill(os.getpid(), 9)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    stat, end = Path(f"/proc/{int(done.stdout)}/stat"), time.monotonic() + 20

    def gone() -> bool:
        return not stat.exists() or stat.read_text().rpartition(")")[2].split()[0] == "Z"  # there may be no process to reap it

    while not gone():
        assert time.monotonic() < end
        time.sleep(0.05)


def test_a_killed_child_is_replaced() -> None:
    run(len, "")
    for pid in workers():
        os.kill(pid, signal.SIGTERM)
    time.sleep(0.2)
    assert run(len, "abc") == 3


def test_a_child_started_in_advance_reads(tmp_path: Path) -> None:
    pytest.importorskip("SimpleITK")
    clvol.write(Volume(np.arange(8.0).reshape(2, 2, 2)), tmp_path / "v.nrrd")
    worker._end_all()
    for name in ("none.nrrd", "v.txt"):  # what is wrong with them, `read` says
        formats.begin_to_read(tmp_path / name)
    assert not workers()
    formats.begin_to_read(tmp_path / "v.nrrd")
    begun = workers()
    assert len(begun) == 1
    assert clvol.read(tmp_path / "v.nrrd").shape == (2, 2, 2)
    assert run(eval, "'SimpleITK' in __import__('sys').modules")
    assert workers() == begun


def test_one_child_serves_many_calls_and_threads_do_not_wait() -> None:
    assert run(os.getpid) == run(os.getpid) != os.getpid()
    found: list[int] = []

    def ask() -> None:
        found.append(run(exec, "import time; time.sleep(0.4)") or run(os.getpid))

    threads = [threading.Thread(target=ask) for _ in range(3)]
    for one in threads:
        one.start()
    for one in threads:
        one.join()
    assert len(found) == 3
    assert len(workers()) <= 4


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of forking beside threads
def test_a_forked_process_gets_its_own_child() -> None:
    mine = run(os.getpid)
    pid = os.fork()
    if pid == 0:
        code = 1
        try:
            code = 0 if run(os.getpid) not in (mine, os.getpid()) else 2
            worker._end_all()
        finally:
            os._exit(code)
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0
    assert run(os.getpid) == mine


def test_scripts_without_a_main_guard_and_with_their_own_paths(tmp_path: Path) -> None:
    """Nothing is printed at exit, and no process is left."""
    Path(tmp_path / "v.npy").touch()
    script = tmp_path / "script.py"
    script.write_text(
        "from clvol.formats.guarded import worker\nfrom clvol.formats.guarded.limits import Budget, Limits\n"
        "print(worker.call(len, 'abc', what='read', reader='X', modules=(), budget=Budget(Limits(), 1, 1)))\n"
        "print(list(worker._all)[0]._process.pid)\n"
    )
    (tmp_path / "numpy.py").write_text("raise SystemExit('the wrong module')")  # the folder of the file is no place for modules
    script_folder = tmp_path / "elsewhere"
    script_folder.mkdir()
    script = script.rename(script_folder / "script.py")
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=60, cwd=tmp_path, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    count, pid = map(int, done.stdout.split())
    assert count == 3
    if sys.platform == "linux":
        assert not Path(f"/proc/{pid}").exists()


def test_no_child_can_be_started(monkeypatch: pytest.MonkeyPatch) -> None:
    """Protection must not lapse silently: the error says how to read without it."""
    for executable in (None, "/nowhere/python"):
        monkeypatch.setattr(sys, "executable", executable)
        monkeypatch.setattr(worker, "_idle", [])
        with pytest.raises(FormatError, match=r"cannot be started.*trusted=True reads in this one"):
            run(len, "")


# -- what comes back ------------------------------------------------------------------------------------------


@pytest.fixture
def plain(tmp_path: Path) -> Path:
    path = tmp_path / "v.nrrd"
    pytest.importorskip("SimpleITK")
    clvol.write(Volume(np.arange(24, dtype=np.int16).reshape(2, 3, 4), (1, 2, 3)), path)
    return path


def test_trusted_files_are_read_in_this_process(plain: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    there, here = clvol.read(plain), clvol.read(plain, trusted=True)
    np.testing.assert_array_equal(there.data, here.data)
    assert (there.spacing, there.units, there.space) == (here.spacing, here.units, here.space)
    assert not there.data.flags.writeable

    def refuse(*_: Any, **__: Any) -> None:
        raise DataError("another process was asked")

    monkeypatch.setattr("clvol.formats.reading.call", refuse)
    clvol.read(plain, trusted=True)
    clvol.read_all(plain, trusted=True)
    formats.series_of(plain, trusted=True)
    formats.leading_of(plain, trusted=True)
    with pytest.raises(DataError, match="another process"):
        clvol.read(plain)


def test_transforms_are_read_in_the_child(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sitk = pytest.importorskip("SimpleITK")
    sitk.WriteTransform(sitk.Euler3DTransform((1, 2, 3), 0.1, 0.2, 0.3, (4, 5, 6)), str(tmp_path / "t.tfm"))
    (there,), (here,) = (clvol.read_transform(tmp_path / "t.tfm", trusted=trusted) for trusted in (False, True))
    assert isinstance(there, clvol.AffineTransform)
    assert isinstance(here, clvol.AffineTransform)
    np.testing.assert_array_equal(there.matrix, here.matrix)
    np.testing.assert_array_equal(there.offset, here.offset)
    monkeypatch.setattr(worker, "_idle", [])
    monkeypatch.setattr(worker, "_Worker", lambda what: (_ for _ in ()).throw(DataError(what)))
    with pytest.raises(DataError, match="read"):
        clvol.read_transform(tmp_path / "t.tfm")


def test_arguments_are_checked(plain: Path) -> None:
    with pytest.raises(OptionError, match="trusted must be True or False"):
        clvol.read(plain, trusted="yes")  # type: ignore[arg-type]
    with pytest.raises(OptionError, match="not trusted"):
        clvol.read(plain, trusted=True, limits=Limits())
    for wrong in ({"seconds": 0}, {"bytes": -1}, {"expansion": "x"}):
        with pytest.raises(OptionError):
            Limits(**wrong)  # type: ignore[arg-type]


def test_large_arrays_are_not_copied(tmp_path: Path) -> None:
    pytest.importorskip("SimpleITK")
    data = np.random.default_rng(1).integers(0, 9999, (40, 130, 210), np.uint16)
    clvol.write(Volume(data), tmp_path / "v.nrrd")
    read = clvol.read(tmp_path / "v.nrrd")
    np.testing.assert_array_equal(read.data, data)
    assert read.data.dtype == data.dtype
    if sys.platform == "linux":
        assert "memfd:clvol" in Path("/proc/self/maps").read_text()


@linux
def test_memory_that_cannot_be_shared_is_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    def forbidden(*_: Any) -> int:
        raise PermissionError(13, "vm.memfd_noexec")

    monkeypatch.setattr(os, "memfd_create", forbidden)
    monkeypatch.setattr(messages, "_sharing", True)
    ours, theirs = Pipe()
    with ours, theirs, ThreadPoolExecutor(1) as pool:
        data = messages.empty((1 << 19,), np.uint32)
        data[:] = np.arange(1 << 19)
        pool.submit(messages.send, theirs, "x", data)
        np.testing.assert_array_equal(messages.receive(ours, lambda: None)[1], data)


def test_uncompressed_samples_are_read_in_this_process(tmp_path: Path) -> None:
    tifffile = pytest.importorskip("tifffile")
    data = np.random.default_rng(1).integers(0, 9999, (2, 40, 130, 210), np.uint16)
    for order in "<>":
        tifffile.imwrite(tmp_path / "v.tif", data, ome=True, photometric="minisblack", metadata={"axes": "CZYX"}, byteorder=order)
        for trusted in (False, True):
            read = clvol.read(tmp_path / "v.tif", channel=1, trusted=trusted)
            np.testing.assert_array_equal(read.data, data[1])
            assert read.data.dtype == np.uint16
            assert type(np.asarray(read)) is np.ndarray
            np.testing.assert_array_equal(np.asarray(clvol.read_all(tmp_path / "v.tif", trusted=trusted)), data)


@linux
@pytest.mark.parametrize(("name", "start"), [("/dev/zero", 0), ("v", 1), ("v", -8), ("gone", 0)])
def test_special_files_are_not_read(tmp_path: Path, name: str, start: int) -> None:
    (tmp_path / "v").write_bytes(bytes(32))
    with pytest.raises(messages.MessageError, match="32 bytes at"):
        messages._read(tmp_path / name, start, np.dtype(np.int64), (4,))


def test_warnings_point_to_the_callers_line(tmp_path: Path) -> None:
    tifffile = pytest.importorskip("tifffile")
    tifffile.imwrite(tmp_path / "v.tif", np.zeros((3, 4, 5), np.uint16), photometric="minisblack", metadata=None)
    with pytest.warns(ClvolWarning, match="3 pages") as told:
        clvol.read(tmp_path / "v.tif")
    assert told[0].filename == __file__
    with warnings.catch_warnings(action="error"), pytest.raises(ClvolWarning, match="3 pages"):
        clvol.read(tmp_path / "v.tif")


def test_warnings_and_logs_of_libraries_are_forwarded(caplog: pytest.LogCaptureFixture) -> None:
    with pytest.warns(FutureWarning, match="later"):
        run(exec, "import warnings; warnings.warn('later', FutureWarning)")
    with caplog.at_level(logging.WARNING):
        run(exec, "import logging; logging.getLogger('some.library').warning('odd %s', 'file')")
    assert [(r.name, r.levelname, r.getMessage()) for r in caplog.records] == [("some.library", "WARNING", "odd file")]


@pytest.mark.parametrize("kind", [DataError, OptionError, OutOfMemoryError, FormatError])
def test_errors_keep_their_class(kind: type[Exception]) -> None:
    with pytest.raises(kind, match=r"^it is so$") as told:
        run(exec, f"from clvol.base import errors; raise errors.{kind.__name__}('it is so')")
    assert type(told.value) is kind
    with pytest.raises(FormatError, match=r"cannot read v\.x: 'gone'"):
        run(exec, "{}['gone']")


def test_paths_are_relative_to_the_callers_folder(plain: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clvol.read(plain)
    monkeypatch.chdir(plain.parent)
    assert clvol.read("v.nrrd").shape == (2, 3, 4)


@linux
def test_it_keeps_no_folder_open_and_little_memory_for_threads(plain: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(plain.parent)
    monkeypatch.setattr(sys, "path", [*sys.path, plain])  # as some libraries add it, in vain
    for pid in workers():
        os.kill(pid, signal.SIGKILL)
    clvol.read("v.nrrd")
    assert {Path(f"/proc/{pid}/cwd").readlink() for pid in workers()} == {Path("/")}
    assert run(threading.stack_size) <= 4 << 20


# -- nonsense that a process may send once a file has taken it over --------------------------------------------


VALUES: list[Any] = [
    None,
    True,
    3,
    -0.0,
    float("inf"),
    "µm",
    b"\x00\xff",
    [1, (2.5, "x")],
    {3: "liver", "a": (None,)},
    np.arange(6, dtype=">u2").reshape(2, 3),
    np.float32(0.1),
    np.array("text"),
    Leading(("time", "channel"), (2, 2), {"channel": ("DAPI", "GFP")}, ((1.0, 0.0, 0.0), None)),
    formats.Series("a", "CT", (1, 2)),
]


def sent(*values: Any) -> list[Any]:
    ours, theirs = Pipe()
    with ours, theirs:
        for value in values:
            messages.send(theirs, "x", value)
        return [messages.receive(ours, lambda: None)[1] for _ in values]


def test_values_round_trip() -> None:
    for value, found in zip(VALUES, sent(*VALUES), strict=True):
        assert type(found) is type(value)
        assert str(found) == str(value)
        assert not isinstance(value, np.ndarray) or found.dtype == value.dtype


NONSENSE = [
    b"",
    b"[]",
    b"[1, 2, 3]",
    b'["x", {"eval": "1"}, []]',
    b'["x", {"Leading": [["axes", ["a"]]]}, []]',
    b'["x", {"Series": [["__class__", 1]]}, []]',
    b'["x", {"array": ["|O", [1]]}, [false]]',
    b'["x", {"array": ["<f8", [1000000000000]]}, [false]]',
    b'["x", {"array": ["<f8", [-1]]}, [false]]',
    b'["x", {"array": ["<f8", [2]]}, []]',
    b'["x", {"array": ["<f8", [2]]}, [true]]',
    b'["x", {"dict": [[{"dict": []}, 1]]}, []]',
    b'["x", ' + b"[" * 100_000 + b"]" * 100_000 + b", []]",
    b"\xff\xfe",
]


@pytest.mark.parametrize("text", NONSENSE, ids=range(len(NONSENSE)))
def test_nonsense_is_rejected(text: bytes) -> None:
    ours, theirs = Pipe()
    with ours:
        with theirs:
            theirs.send_bytes(text[: 1 << 16])
        with pytest.raises((messages.MessageError, EOFError)):
            messages.receive(ours, lambda: None)


def test_absurd_lengths_are_rejected() -> None:
    ours, theirs = socket.socketpair()
    with Connection(ours.detach()) as peer, theirs:
        theirs.sendall(b"\xff\xff\xff\xff" + (1 << 60).to_bytes(8, "big"))
        with pytest.raises(messages.MessageError, match="bad message length"):
            messages.receive(peer, lambda: None)


@linux
def test_memory_that_may_shrink_is_rejected() -> None:
    """Whoever can truncate a mapped file can crash the process that maps it."""
    fd = os.memfd_create("x", os.MFD_ALLOW_SEALING)
    os.write(fd, np.arange(4, dtype=np.int64).tobytes())
    with pytest.raises(messages.MessageError, match="32 bytes of memory for an array of 32, which may shrink"):
        messages._mapped(os.dup(fd), np.dtype(np.int64), (4,))
    fcntl.fcntl(fd, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK)
    with pytest.raises(messages.MessageError, match="32 bytes of memory for an array of 40"):
        messages._mapped(os.dup(fd), np.dtype(np.int64), (5,))
    assert messages._mapped(fd, np.dtype(np.int64), (4,)).tolist() == [0, 1, 2, 3]


# -- limits ---------------------------------------------------------------------------------------------------


def test_limits_name_the_rule() -> None:
    with limited(Budget(Limits(), 1000, 1 << 34)):
        announce("v", 1 << 30)  # any file may stand for so much
        announce("v", 5 << 30, 1 << 23)
        with pytest.raises(FormatError, match=r"at most 1000 times as large as what is stored, 1000 bytes \(Limits\.ex"):
            announce("v", 5 << 30)
        with pytest.raises(OutOfMemoryError, match=r"into the 16384 MiB that are available; they take 20480 MiB"):
            announce("v", 20 << 30, 1 << 30)
    with limited(Budget(Limits(expansion=1e9), 1000, 1 << 34)):
        announce("v", 5 << 30)
    with limited(Budget(Limits(bytes=1000), 1000, 1 << 34)), pytest.raises(FormatError, match=r"at most 1000 bytes \(Limits\.byt"):
        announce("v", 1001)
    announce("v", 1 << 30, 1)  # trusted


def test_limits_are_those_of_the_caller(plain: Path) -> None:
    with pytest.raises(FormatError, match=r"must take at most 47 bytes \(Limits\.bytes\); its header says 48"):
        clvol.read(plain, limits=Limits(bytes=47))
