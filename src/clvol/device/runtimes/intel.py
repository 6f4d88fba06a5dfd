"""Intel's OpenCL runtime for processors as pip installs it (``clvol[intel]``): found, and announced to OpenCL's loader.

The wheels put it into the environment's ``lib``, where no loader looks, with a vendor file (``.icd``) that names a folder of
Intel's build machines. All loaders read an environment variable: libraries on Windows, a folder of vendor files elsewhere. That
folder replaces the usual one, so the content of the latter is copied into it.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

__all__ = ["known_to_the_loader", "library", "variables", "vendors"]

_NAMES = ("libintelocl.so", "intelocl64.dll")


def library() -> Path | None:
    """The runtime's library in this Python environment; None if it is not installed."""
    from importlib.metadata import PackageNotFoundError, distribution  # a tenth of the time that importing clvol takes

    try:
        files = distribution("intel-opencl-rt").files or []
    except PackageNotFoundError:
        return None
    found = (Path(str(file.locate())).resolve() for file in files if file.name in _NAMES)
    return next(filter(Path.is_file, found), None)


@contextmanager
def known_to_the_loader(without: Collection[str] = ()) -> Iterator[None]:
    """Let the loader find Intel's runtime beside others, for the duration of a block in which it is first used.

    Nothing changes if the runtime is not installed, if the system has Intel's runtime for processors (a process cannot load two),
    or if ``OCL_ICD_VENDORS`` names no folder, which is meant to exclude others. Libraries in `without` are hidden from it.
    """
    if without:
        with _only([text for text in vendors() or () if text not in without]):
            yield
        return
    runtime = library()
    if runtime is None:
        yield
        return
    # Our kernels are vectorised by hand: Intel's vectoriser makes them no faster, and compilation takes five times as long.
    # It is read when the first context is created, so it stays set; a user's own setting wins.
    os.environ.setdefault("CL_CONFIG_USE_VECTORIZER", "False")
    if sys.platform == "win32":
        _add_to_path(runtime.parent)
        os.environ.setdefault("CL_CONFIG_TBB_DLL_PATH", str(runtime.parent))
        others = os.environ.get("OCL_ICD_FILENAMES")
        with variables({"OCL_ICD_FILENAMES": os.pathsep.join(filter(None, (str(runtime), others)))}):
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
    """For the duration of a block the loader finds only these, and what lies in its own folder."""
    with tempfile.TemporaryDirectory(prefix="clvol-vendors-") as folder:
        for i, text in enumerate(libraries):  # loaders sort them by name, or take them in directory order
            Path(folder, f"{i:03}.icd").write_bytes(os.fsencode(text) + b"\n")
        with variables({"OCL_ICD_VENDORS": folder, "OPENCL_VENDOR_PATH": folder}):
            yield


def vendors() -> list[str] | None:
    """The libraries that the loader will find, Intel's of this environment last; None if it must not read a folder.

    Excludes those in the loader's own folder, as PoCL by pip, and those of Windows.
    """
    if sys.platform == "win32":
        return None
    found, runtime = _vendor_files(), library()
    if found is None or runtime is None or any("libintelocl." in text for text in found):
        return found
    return [*found, str(runtime)]


def _vendor_files() -> list[str] | None:
    """The libraries named by the vendor files that the loader reads; None if it must not read a folder."""
    given = os.environ.get("OCL_ICD_VENDORS") or os.environ.get("OPENCL_VENDOR_PATH")
    # conda's loader reads the environment's folder, others the system's
    folders = [Path(given)] if given else [Path("/etc/OpenCL/vendors"), Path(sys.prefix, "etc/OpenCL/vendors")]
    if given and not folders[0].is_dir():
        return None
    texts = []
    for file in (file for folder in folders for file in sorted(folder.glob("*.icd"))):
        with suppress(OSError):  # a broken link, or no permission: the loader cannot read it either
            texts.append(os.fsdecode(file.read_bytes()).strip())
    # ignore files that name a library that does not exist, as those of Intel's wheels
    return [text for text in dict.fromkeys(texts) if text and (not Path(text).is_absolute() or Path(text).exists())]


def _add_to_path(folder: Path) -> None:
    """Let Windows find libraries that the runtime loads by name, also later."""
    if str(folder) not in os.environ.get("PATH", "").split(os.pathsep):
        os.environ["PATH"] = os.pathsep.join(filter(None, (os.environ.get("PATH"), str(folder))))


@contextmanager
def variables(values: Mapping[str, str]) -> Iterator[None]:
    """Environment variables for the duration of a block."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
