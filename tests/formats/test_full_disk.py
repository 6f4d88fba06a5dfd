"""Writers when the disk is full or fails, and the final sync: the previous file stays, and nothing else."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest

from clvol import formats
from clvol.base.errors import FormatError
from clvol.base.files import staged
from clvol.show import picture

TIMES = 8

SCRIPT = """
import json, os, resource, sys
from pathlib import Path
import numpy as np
from clvol import formats; from clvol.show import picture
from clvol.base.errors import FormatError
from clvol.base.files import staged

root, times = Path(sys.argv[1]), int(sys.argv[2])
noise = np.random.default_rng(0).random((24, 32, 32)).astype(np.float32)

def text(path):
    with staged(path, ".html") as temporary:
        temporary.write_text("x" * 9999)

def figure(path):
    from clvol.figures.style import Drawing
    from matplotlib.figure import Figure
    drawn = Figure()
    drawn.add_subplot().imshow(noise[0])
    Drawing(drawn, []).save(path)

writers = {suffix: lambda path: formats.write(noise, path) for suffix in formats.WRITTEN}
pictures = (".png", ".jpg", ".tif", ".bmp")
writers |= {f"picture{suffix}": lambda path: picture.save(noise.reshape(96, 256), path) for suffix in pictures}
writers |= {"text.html": text} | {f"figure{suffix}": figure for suffix in (".png", ".svg", ".pdf")}
held = lambda: len(os.listdir("/proc/self/fd")) if os.path.isdir("/proc/self/fd") else 0
for name in sys.argv[3:] or writers:
    folder = root / name
    folder.mkdir()
    path = folder / f"v{name if name.startswith('.') else Path(name).suffix}"
    path.write_text("what was there")
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, resource.RLIM_INFINITY))
    told, before = set(), None
    for _ in range(times):
        try:
            writers[name](path)
            told.add("written")
        except FormatError as error:
            told.add("refused" if "no file of that size is allowed there (" in str(error) else str(error))
        before = held() if before is None else before  # the first one may import a library
    after = held()
    resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    left = {file.name: file.read_bytes()[:20].decode("latin1") for file in folder.iterdir()}
    print(json.dumps([name, sorted(told), after - before, left]), flush=True)
"""


def failing(folder: Path, times: int, *names: str) -> dict[str, tuple[list[str], int, dict[str, str]]]:
    """How writers fail when the disk is full after 2000 bytes, by format; the descriptors they leak, and the files left."""
    pytest.importorskip("resource", reason="limits of the file size are set by POSIX calls")
    for module in ("SimpleITK", "nibabel", "tifffile", "matplotlib"):
        pytest.importorskip(module)
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(folder), str(times), *names], capture_output=True, text=True, check=False, timeout=280
    )
    assert run.returncode == 0, run.stderr
    return {name: (told, kept, left) for name, told, kept, left in map(json.loads, run.stdout.splitlines())}


def check(found: dict[str, tuple[list[str], int, dict[str, str]]]) -> None:
    for name, (told, kept, left) in found.items():
        suffix = name if name.startswith(".") else Path(name).suffix
        assert (name, told, kept, left) == (name, ["refused"], 0, {f"v{suffix}": "what was there"})


def test_a_full_disk_leaves_the_previous_file(tmp_path: Path) -> None:
    """SimpleITK's NRRD writer kept the sample file open, and the disk full, until the program exited."""
    found = failing(tmp_path, TIMES)
    assert len(found) > len(formats.WRITTEN)
    check(found)


@pytest.mark.thorough
def test_200_writers_on_a_full_disk(tmp_path: Path) -> None:
    check(failing(tmp_path, 200, *formats.WRITTEN, "picture.png", "text.html"))


def write(path: Path) -> None:
    if path.suffix == ".png":
        picture.save(np.zeros((3, 4)), path)
    else:
        formats.write(np.arange(24, dtype=np.uint8).reshape(2, 3, 4), path)


@pytest.mark.parametrize("suffix", [".npy", ".nhdr", ".tif", ".nii.gz", ".png"])
def test_a_disk_that_fails_at_sync(tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Network disks report only then that they are full."""
    for module in ("SimpleITK", "nibabel", "tifffile"):
        pytest.importorskip(module)
    path = tmp_path / f"v{suffix}"
    path.write_text("what was there")

    def full(_: int) -> NoReturn:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(FormatError, match=r"cannot write .*: the disk is full \(No space left on device\)$"):
        write(path)
    assert {file.name: file.read_text() for file in tmp_path.iterdir()} == {path.name: "what was there"}


def test_a_file_is_synced_before_it_is_renamed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise a power failure could replace the old file with an empty one."""
    events: list[str] = []
    replace, sync = Path.replace, os.fsync

    def replaced(self: Path, target: Path) -> Path:
        events.append(target.name)
        return replace(self, target)

    def synced(descriptor: int) -> None:
        events.append("folder" if os.path.isdir(descriptor) else f"{os.fstat(descriptor).st_size} bytes")  # noqa: PTH112
        sync(descriptor)

    monkeypatch.setattr(Path, "replace", replaced)
    monkeypatch.setattr(os, "fsync", synced)
    with staged(tmp_path / "v.txt", ".txt") as temporary:
        temporary.with_name("v.raw").write_text("12345")
        temporary.write_text("123")
    assert events[:4] == ["5 bytes", "3 bytes", "v.raw", "v.txt"]
    assert events[4:] == ([] if os.name == "nt" else ["folder"])


@pytest.mark.parametrize("at", ["fsync", "replace"])
def test_an_interrupt_while_writing_leaves_nothing(tmp_path: Path, at: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: Any) -> NoReturn:
        raise KeyboardInterrupt

    monkeypatch.setattr(os if at == "fsync" else Path, at, interrupted)
    with pytest.raises(KeyboardInterrupt):
        write(tmp_path / "v.npy")
    assert list(tmp_path.iterdir()) == []


def short(path: Path) -> None:
    np.zeros(9).tofile(path)
    raise OSError("72 requested and 9 written")  # as NumPy does, without a number


def test_a_full_disk_is_found_where_a_library_does_not_say_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any, **__: Any) -> NoReturn:
        raise OSError(errno.EDQUOT, os.strerror(errno.EDQUOT))

    with pytest.raises(FormatError, match=r"72 requested and 9 written$"), staged(tmp_path / "v.raw", ".raw") as path:
        short(path)
    monkeypatch.setattr("clvol.base.files.tempfile.TemporaryFile", full)
    with pytest.raises(FormatError, match="the quota of the disk is used up"), staged(tmp_path / "v.raw", ".raw") as path:
        short(path)
    assert list(tmp_path.iterdir()) == []


KILLED = """
import os, signal, sys
from pathlib import Path
from clvol.base.files import staged
with staged(Path(sys.argv[1]), ".txt") as path:
    path.write_text("half")
    print("writing", flush=True)
    if sys.argv[2] == "killed":
        os.kill(os.getpid(), signal.SIGKILL)
    sys.stdin.readline()
"""


@pytest.mark.skipif(os.name != "posix", reason="no file can be locked here")
def test_what_a_killed_process_left_is_removed_by_the_next_writer(tmp_path: Path) -> None:
    subprocess.run([sys.executable, "-c", KILLED, tmp_path / "a.txt", "killed"], stdout=subprocess.DEVNULL, check=False)
    (left,) = tmp_path.iterdir()
    command = [sys.executable, "-c", KILLED, tmp_path / "b.txt", "waits"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        assert other.stdout.readline()
        (working,) = tmp_path.iterdir()
        assert working != left  # removed as the other process began
        write(tmp_path / "v.npy")
        assert set(tmp_path.iterdir()) == {working, tmp_path / "v.npy"}
        other.communicate(b"\n")
    assert {file.name for file in tmp_path.iterdir()} == {"b.txt", "v.npy"}
