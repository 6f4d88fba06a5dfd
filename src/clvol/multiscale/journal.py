"""The unfinished store beside its target, and what of it is done: the same command goes on where one was killed."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from clvol.errors import FormatError

__all__ = ["Journal"]

_NAME = "journal"
_STORE = "store.zarr"


class Journal:
    """A folder beside the target, with the store that is being made and a list of the parts that are done.

    A part is on the list once its chunks have been written, so that a process may be killed at any time. (A power failure may keep
    the list and lose chunks: delete the folder after one.)

    Parameters
    ----------
    target : Path
        Of the store once it is complete.
    command : mapping
        All that decides what is made: another command does not go on with what this one began.
    anew : bool
        Whether to begin from nothing where another command has begun.

    Attributes
    ----------
    store : Path
        What is being made.
    begun : bool
        Whether something of it was there.

    Raises
    ------
    FormatError
        Another command has begun there, or another process is at work, or nothing can be written.
    """

    def __init__(self, target: Path, command: Mapping[str, Any], anew: bool = False) -> None:
        self.target = target
        self.folder = target.with_name(f".{target.name}.unfinished")
        self.store = self.folder / _STORE
        self._done: dict[str, dict[str, Any]] = {}
        head = json.dumps({"command": command}, sort_keys=True, default=str)
        try:
            self.folder.mkdir(exist_ok=True)
            self._stream = (self.folder / _NAME).open("a+", encoding="utf-8")
        except OSError as error:
            raise FormatError(f"cannot write {target}: nothing can be made in {target.parent}: {error.strerror}") from error
        try:
            self._lock()
            self._stream.seek(0)
            lines = self._stream.read().splitlines()
            if anew and lines and lines[0] != head:
                lines = []
            self.begun = bool(lines)
            if lines and lines[0] != head:
                raise FormatError(
                    f"cannot write {target}: {self.folder} holds what another command began ({_differences(lines[0], head)}); "
                    "finish it by that command, or begin anew by overwrite=True"
                )
            for line in lines[1:]:
                with contextlib.suppress(ValueError):  # the last one may have been cut
                    self._done.update(json.loads(line))
            if not lines:
                self._stream.truncate(0)
                shutil.rmtree(self.store, ignore_errors=True)
                self._write(head)
            else:
                if not _ends_well(self.folder / _NAME):
                    self._write("")
                for partial in self.store.rglob("*.partial"):  # which zarr was writing when it was killed
                    partial.unlink(missing_ok=True)
        except BaseException:
            self._stream.close()
            raise

    def _lock(self) -> None:
        try:
            import fcntl
        except ImportError:  # Windows
            return
        try:
            fcntl.flock(self._stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise FormatError(f"cannot write {self.target}: another process is at work in {self.folder}") from error

    def _write(self, line: str) -> None:
        self._stream.write(line + "\n")
        self._stream.flush()

    def __contains__(self, part: str) -> bool:
        return part in self._done

    def facts(self, prefix: str) -> Iterator[dict[str, Any]]:
        """What is known of the parts whose names begin so."""
        return (facts for part, facts in self._done.items() if part.startswith(prefix))

    def done(self, part: str, **facts: Any) -> None:
        """A part is written, and this is known of it."""
        self._done[part] = facts
        self._write(json.dumps({part: facts}))

    def complete(self, overwrite: bool) -> None:
        """Move the store to its target, once the disk has it.

        Raises
        ------
        FormatError
            Something is there by now, and must not be replaced; or it cannot be moved.
        """
        with contextlib.suppress(AttributeError):  # Windows has none
            os.sync()
        try:
            if self.target.exists() or self.target.is_symlink():
                if not overwrite:
                    raise FormatError(f"cannot write {self.target}: it is there by now; the store is complete in {self.store}")
                old = self.folder / "replaced"
                self.target.rename(old)
            self.store.rename(self.target)
        except OSError as error:
            raise FormatError(f"cannot write {self.target}: {error}; the store is complete in {self.store}") from error
        self._stream.close()
        shutil.rmtree(self.folder, ignore_errors=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._stream.close()
        if kind is not None and not self._done:  # nothing is lost
            shutil.rmtree(self.folder, ignore_errors=True)


def _ends_well(file: Path) -> bool:
    with file.open("rb") as stream:
        stream.seek(-1, os.SEEK_END)
        return stream.read(1) == b"\n"


def _differences(before: str, now: str) -> str:
    """In which words two commands differ."""
    try:
        a, b = (json.loads(line)["command"] for line in (before, now))
        return ", ".join(f"{key}: {a.get(key)} and not {b.get(key)}" for key in sorted({*a, *b}) if a.get(key) != b.get(key))
    except (ValueError, KeyError, AttributeError, TypeError):
        return "its journal cannot be read"
