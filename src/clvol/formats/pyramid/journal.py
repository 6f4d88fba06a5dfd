"""The unfinished store beside its target, and what of it is done: the same command goes on where one was killed."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from clvol.base.errors import FormatError

__all__ = ["Journal"]

_NAME = "journal"
_STORE = "store.zarr"
_OLD = "replaced"
_BOOT = Path("/proc/sys/kernel/random/boot_id")
_SECONDS = 10.0  # at least, from one time that the disk is waited for to the next
_SHARE = 20  # times as long as that takes, at least


class Journal:
    """A folder beside the target, with the store that is being made and a list of the parts that are done.

    A process may be killed at any time, and the power may fail: what is at the target is what was there, or the whole new store,
    or, between two renamings, nothing, and the next call of any command puts the new one there. A part is on the list once its
    chunks have been written. After another start of the machine those count that the disk is known to have had (on Windows all:
    delete the folder there after a power failure).

    Parameters
    ----------
    target : Path
        Of the store once it is complete.
    command : mapping
        All that decides what is made: another command does not go on with what this one began.
    replace : bool
        Whether what is at the target may be replaced, and what another command began be thrown away.

    Attributes
    ----------
    store : Path
        What is being made.
    finished : bool
        Whether the store was complete already, and is at the target: one of this command was killed when little was left to do.

    Raises
    ------
    FormatError
        Something is at the target, another command has begun, another process is at work, or nothing can be written.
    """

    def __init__(self, target: Path, command: Mapping[str, Any], replace: bool = False) -> None:
        self.target, self._replace = target, replace
        self.folder = target.with_name(f".{target.name}.unfinished")
        self.store = self.folder / _STORE
        self.finished = False
        self._done: dict[str, Any] = {}
        self._next = time.monotonic() + _SECONDS
        if not self.folder.exists():
            self._require_free()
        head = json.dumps({"command": command}, sort_keys=True, default=str)
        try:
            self.folder.mkdir(exist_ok=True)
            self._stream = (self.folder / _NAME).open("a+", encoding="utf-8", errors="replace")
        except OSError as error:
            raise FormatError(f"cannot write {target}: nothing can be made in {target.parent}: {error.strerror}") from error
        self._lock()
        try:
            self._begin(head)
        except BaseException:
            try:
                if not self._lines():
                    self._close()
            finally:
                self._stream.close()
            raise

    def _lock(self) -> None:
        try:
            import fcntl
        except ImportError:  # Windows
            return
        try:
            fcntl.flock(self._stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if not os.fstat(self._stream.fileno()).st_nlink:
                raise FileNotFoundError("another process has just finished with it")
        except OSError as error:
            self._stream.close()
            raise FormatError(f"cannot write {self.target}: another process is at work in {self.folder}") from error

    def _begin(self, head: str) -> None:
        """Go on with what is there, finish it, or begin anew."""
        lines, boot = self._lines(), _boot()
        told = _Told(lines, boot)
        same, before = lines[:1] == [head], _command(lines)
        if told.complete is not None:
            if self.store.exists() and (not self._taken() or (same and self._replace)):
                self._move()
            if not self.store.exists() and self._taken() and self.target.lstat().st_ino == told.complete:
                self._tidy(keep=not same)
                self.finished, lines = same, []
                if same:
                    return
        self._require_free()
        if not self.store.exists():  # without it, parts that were done are not
            lines = []
        if lines and before is not None and not same and not self._replace:
            now = json.loads(head)["command"]
            keys = [key for key in sorted(before | now) if before.get(key) != now.get(key)]
            differences = ", ".join(f"{key}: {before.get(key)} and not {now.get(key)}" for key in keys)
            raise FormatError(
                f"cannot write {self.target}: {self.folder} holds what another command began ({differences}); "
                "finish it by that command, or begin anew by overwrite=True"
            )
        if not lines or not same or (told.lost and told.synced is None):
            self._begin_anew(head, boot, bool(lines))
            return
        if not _ends_well(self.folder / _NAME):
            self._write("")
        for file in self.store.rglob("*"):  # what zarr was writing when it was killed, and what the disk may not have whole
            partial = file.name.endswith(".partial")
            if partial or (told.lost and told.synced is not None and file.is_file() and file.stat().st_mtime_ns > told.synced):
                file.unlink(missing_ok=True)
        self._write(json.dumps({"boot": boot}))
        self._done = told.done

    def _begin_anew(self, head: str, boot: str, listed: bool) -> None:
        self._stream.truncate(0)
        if listed:
            os.fsync(self._stream.fileno())  # no list outlives its store
        if self.store.exists():
            shutil.rmtree(self.store)
        self._remove_old()
        self._write(head)
        self._write(json.dumps({"boot": boot}))

    def _lines(self) -> list[str]:
        self._stream.seek(0)
        return self._stream.read().splitlines()

    def _write(self, line: str) -> None:
        self._stream.write(line + "\n")
        self._stream.flush()

    def _taken(self) -> bool:
        return self.target.exists() or self.target.is_symlink()

    def _require_free(self) -> None:
        if self._taken() and not self._replace:
            raise FormatError(f"cannot write {self.target}: it is there already; overwrite=True replaces it")

    # -- parts -----------------------------------------------------------------------------------------------------------

    def __contains__(self, part: str) -> bool:
        return part in self._done

    def facts(self, prefix: str) -> Iterator[dict[str, Any]]:
        """What is known of the parts whose names begin so."""
        return (facts for part, facts in self._done.items() if part.startswith(prefix))

    def done(self, part: str, **facts: Any) -> None:
        """A part is written, and this is known of it."""
        self._done[part] = facts
        self._write(json.dumps({part: facts}))
        if time.monotonic() >= self._next:
            self._sync()

    def _sync(self) -> None:
        """Wait until the disk has all that was written, and note when that was, by the clock of the disk's files."""
        if not hasattr(os, "sync"):  # Windows
            return
        begun = time.monotonic()
        os.sync()
        os.utime(self.folder / _NAME)
        self._write(json.dumps({"synced": os.fstat(self._stream.fileno()).st_mtime_ns}))
        os.fsync(self._stream.fileno())
        now = time.monotonic()
        self._next = now + max(_SECONDS, _SHARE * (now - begun))

    # -- the end ---------------------------------------------------------------------------------------------------------

    def complete(self) -> None:
        """Move the store to its target, once the disk has it.

        Raises
        ------
        FormatError
            Something is there by now, and must not be replaced; or it cannot be moved.
        """
        self._write(json.dumps({"complete": self.store.stat().st_ino}))  # from here on it is moved, and never begun anew
        self._sync()
        if self._taken() and not self._replace:
            raise FormatError(f"cannot write {self.target}: it is there by now; the store is complete in {self.store}")
        try:
            self._move()
        except OSError as error:
            raise FormatError(f"cannot write {self.target}: {error}; the store is complete in {self.store}") from error
        self._tidy()

    def _move(self) -> None:
        """The store to its target, and what is there out of its way."""
        old = self.folder / _OLD
        replaced = self._taken()
        if replaced:
            self._remove_old()
            self.target.rename(old)
        try:
            self.store.rename(self.target)
        except OSError:
            if replaced:
                old.rename(self.target)
            raise

    def _tidy(self, keep: bool = False) -> None:
        """Remove what was replaced, and then the journal, which says until then that the new store is there.

        Of one that is to be kept, only the lines go.
        """
        if (self.folder / _OLD).exists():
            _require_on_disk(self.target.parent, self.folder)
            self._remove_old()
        if keep:
            self._stream.truncate(0)
        else:
            self._close()

    def _remove_old(self) -> None:
        old = self.folder / _OLD
        if old.is_dir() and not old.is_symlink():
            shutil.rmtree(old, ignore_errors=True)
        else:
            old.unlink(missing_ok=True)

    def _close(self) -> None:
        """Let the next one have the folder, which is empty."""
        if os.name == "nt":  # removes no open files
            self._stream.close()
        (self.folder / _NAME).unlink(missing_ok=True)
        with contextlib.suppress(OSError):  # another process has begun there
            self.folder.rmdir()
        self._stream.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        try:
            if kind is not None and not self.finished and not self._done:  # nothing is lost
                shutil.rmtree(self.store, ignore_errors=True)
                self._close()
        finally:
            self._stream.close()


class _Told:
    """What the lines of a journal say at a start of the machine.

    Attributes
    ----------
    done : dict
        The parts that count, and what is known of them.
    complete : int or None
        The number by which the complete store is known, wherever it is moved.
    synced : int or None
        When the disk last had everything.
    lost : bool
        Whether what was written after that may be lost.
    """

    def __init__(self, lines: Sequence[str], boot: str) -> None:
        self.done: dict[str, Any] = {}
        self.synced: int | None = None
        self.lost = False
        since: dict[str, Any] = {}
        before = None
        for line in [*lines[1:], json.dumps({"boot": boot})]:
            try:
                ((key, value),) = json.loads(line).items()
            except (ValueError, AttributeError):  # the last one may have been cut
                continue
            if key == "boot":
                self.lost = before is not None and (not value or value != before)
                since, before = ({} if self.lost else since), value
            elif key == "synced":
                self.done |= since
                since, self.synced = {}, value
            else:
                since[key] = value
        self.done |= since
        self.complete: int | None = self.done.pop("complete", None)


def _command(lines: Sequence[str]) -> dict[str, Any] | None:
    """Which one has begun; None where the first line did not reach the disk."""
    try:
        return dict(json.loads(lines[0])["command"])
    except (IndexError, ValueError, KeyError, TypeError):
        return None


def _boot() -> str:
    """Which start of the machine this is; nothing where that is not known."""
    if not hasattr(os, "sync"):  # Windows
        return "any"
    try:
        return _BOOT.read_text(encoding="ascii").strip()
    except OSError:
        return ""


def _require_on_disk(*folders: Path) -> None:
    """Wait until the disk has what folders list."""
    if os.name == "nt":  # opens none
        return
    for folder in folders:
        number = os.open(folder, os.O_RDONLY)
        try:
            with contextlib.suppress(OSError):  # not all file systems do so for folders
                os.fsync(number)
        finally:
            os.close(number)


def _ends_well(file: Path) -> bool:
    with file.open("rb") as stream:
        stream.seek(-1, os.SEEK_END)
        return stream.read(1) == b"\n"
