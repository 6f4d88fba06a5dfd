"""Intel's OpenCL runtime for processors as pip installs it (``clvol[intel]``): found, and made known to OpenCL's loader.

The wheels put it among the environment's libraries, where no loader looks, with a vendor file (``.icd``) that names a folder of
Intel's own machines. What every loader takes is an environment variable: of files on Windows, of a folder of vendor files
elsewhere. The folder stands for the usual one, so what that holds is put into ours too.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

__all__ = ["known_to_the_loader", "library", "vendors"]

_NAMES = ("libintelocl.so", "intelocl64.dll")


def library() -> Path | None:
    """The runtime's library in this Python's environment; None if it is not installed there."""
    from importlib.metadata import PackageNotFoundError, distribution  # a tenth of the time that importing clvol takes

    try:
        files = distribution("intel-opencl-rt").files or []
    except PackageNotFoundError:
        return None
    found = (Path(str(file.locate())).resolve() for file in files if file.name in _NAMES)
    return next(filter(Path.is_file, found), None)


@contextmanager
def known_to_the_loader(without: Collection[str] = ()) -> Iterator[None]:
    """For the time of a block, in which the loader must first be used: it finds Intel's runtime beside all that it finds otherwise.

    Nothing changes where the runtime is not installed, where the system has one of Intel's for processors (a process takes no two),
    or where ``OCL_ICD_VENDORS`` names no folder: then it was set to keep others out. Libraries in `without` are kept out.
    """
    if without:
        with _only([text for text in vendors() or () if text not in without]):
            yield
        return
    runtime = library()
    if runtime is None:
        yield
        return
    # Our kernels are written in vectors already: vectors of these are no faster, and take Intel's compiler five times as long.
    # It reads this when the first context is made, so it stays; a user's own word comes first.
    os.environ.setdefault("CL_CONFIG_USE_VECTORIZER", "False")
    if sys.platform == "win32":
        _add_to_path(runtime.parent)
        os.environ.setdefault("CL_CONFIG_TBB_DLL_PATH", str(runtime.parent))
        others = os.environ.get("OCL_ICD_FILENAMES")
        with _set("OCL_ICD_FILENAMES", os.pathsep.join([str(runtime), *([others] if others else [])])):
            yield
        return
    found = vendors()
    if found is None or str(runtime) not in found:
        yield
        return
    with _only(found):
        yield


@contextmanager
def _only(libraries: list[str]) -> Iterator[None]:
    """For the time of a block the loader finds these, and what lies in its own folder."""
    with tempfile.TemporaryDirectory(prefix="clvol-vendors-") as folder:
        for i, text in enumerate(libraries):  # loaders take them by name or as they come
            Path(folder, f"{i:03}.icd").write_bytes(os.fsencode(text) + b"\n")
        with _set("OCL_ICD_VENDORS", folder), _set("OPENCL_VENDOR_PATH", folder):
            yield


def vendors() -> list[str] | None:
    """The libraries that the loader will find, Intel's of this environment last; None where it must not look into a folder.

    Those that lie in the loader's own folder, as PoCL by pip, are not among them, nor are those of Windows.
    """
    if sys.platform == "win32":
        return None
    found, runtime = _vendor_files(), library()
    if found is None or runtime is None or any("libintelocl." in text for text in found):
        return found
    return [*found, str(runtime)]


def _vendor_files() -> list[str] | None:
    """The libraries that vendors' files name, where the loader would look for them; None if it must not look into a folder."""
    given = os.environ.get("OCL_ICD_VENDORS") or os.environ.get("OPENCL_VENDOR_PATH")
    # conda's loader looks into the environment, others into the system's folder
    folders = [Path(given)] if given else [Path("/etc/OpenCL/vendors"), Path(sys.prefix, "etc/OpenCL/vendors")]
    if given and not folders[0].is_dir():
        return None
    texts = []
    for file in (file for folder in folders for file in sorted(folder.glob("*.icd"))):
        with suppress(OSError):  # a link to nowhere, or not for us to read: nor can the loader
            texts.append(os.fsdecode(file.read_bytes()).strip())
    # a file that names a library by a path where there is none, as those that Intel's wheels bring, is no vendor's
    return [text for text in dict.fromkeys(texts) if text and (not Path(text).is_absolute() or Path(text).exists())]


def _add_to_path(folder: Path) -> None:
    """Where Windows looks for the libraries that the runtime loads by name, later too."""
    if str(folder) not in os.environ.get("PATH", "").split(os.pathsep):
        os.environ["PATH"] = os.pathsep.join(filter(None, (os.environ.get("PATH"), str(folder))))


@contextmanager
def _set(name: str, value: str) -> Iterator[None]:
    before = os.environ.get(name)
    os.environ[name] = value
    try:
        yield
    finally:
        if before is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = before
