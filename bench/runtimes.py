"""`bench.parity` on every OpenCL runtime for the processor that is found here, each in a process of its own.

    python -m bench.runtimes [--minutes 20] [--only WORD] [--markdown] [--root FOLDER ...]

Found are PoCL and Intel's runtime as pip installs them, and those that the system's vendor files name (Debian: pocl-opencl-icd,
mesa-opencl-icd; of the latter rusticl, on llvmpipe). `--root` adds those of another Debian in a folder, as debootstrap makes it,
with /proc, /sys and /dev mounted, this checkout at the same path, and in /opt/clvol a virtual environment with clvol's
dependencies; this takes root. What does not end within the minutes is killed, and what it had done by then is printed.
POCL_EXTRA_BUILD_FLAGS=-cl-opt-disable is passed on: most of the time goes into optimising kernels. Only PoCL 3.0 takes it: 6.0 and
7.1 make wrong kernels with it.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from bench.parity import ROUTES, WORKS
from clvol.device.runtimes import intel

ROOT = Path(__file__).parents[1]
_VENDORS = Path("etc/OpenCL/vendors")
_POCL = "portable"
_PYTHON = "/opt/clvol/bin/python"  # in another Debian


@dataclass
class Runtime:
    """One to be tried: the library that OpenCL's loader is to load, and where.

    Attributes
    ----------
    device : str
        Part of the name of its device or platform.
    library : str
        "" for what lies beside the loader, as PoCL by pip.
    root : Path
        Of the system whose it is.
    lines : list of dict
        What it has printed.
    ended : str
        How.
    seconds : float
        Until then.
    """

    name: str
    device: str
    library: str = ""
    root: Path = Path("/")
    lines: list[dict[str, Any]] = field(default_factory=list)
    ended: str = ""
    seconds: float = 0.0

    def run(self, minutes: float) -> None:
        """Run it to its end, or as long as it may."""
        begun = time.monotonic()
        with tempfile.TemporaryDirectory(dir=self.root / "tmp") as folder:
            if self.library:
                Path(folder, "one.icd").write_text(self.library + "\n", encoding="utf-8")
            inside = "/" + Path(folder).relative_to(self.root).as_posix()
            asked = {
                "OCL_ICD_VENDORS": inside,
                "OPENCL_VENDOR_PATH": inside,
                "XDG_CACHE_HOME": inside,
                "RUSTICL_ENABLE": "llvmpipe",
            }
            if self.library and self.root == Path("/"):
                _without_pocl(Path(folder))
            asked |= {"PYTHONPATH": os.pathsep.join((inside, str(ROOT / "src"), str(ROOT))), "CLVOL_DEVICE": self.device}
            command = [sys.executable, "-m", "bench.parity"]
            if self.root != Path("/"):
                command = ["chroot", str(self.root), "sh", "-c", f'cd "{ROOT}" && exec {_PYTHON} -m bench.parity']
            others = {name for name in os.environ if name.startswith(("POCL_", "CLVOL_", "CL_"))} - {"POCL_EXTRA_BUILD_FLAGS"}
            kept = {name: value for name, value in os.environ.items() if name not in others}
            with tempfile.TemporaryFile("w+", encoding="utf-8") as errors:
                with subprocess.Popen(command, cwd=ROOT, env=kept | asked, stdout=-1, stderr=errors, encoding="utf-8") as process:
                    timer = threading.Timer(60 * minutes, process.kill)
                    timer.start()
                    assert process.stdout is not None
                    self.lines = [json.loads(line) for line in process.stdout if line.startswith("{")]
                    timer.cancel()
                errors.seek(0)
                last = (errors.read().strip().splitlines() or [""])[-1]
        self.seconds = time.monotonic() - begun
        killed = process.returncode < 0 and self.seconds >= 60 * minutes
        self.ended = "" if not process.returncode else f"not done after {minutes:g} minutes" if killed else f"ended: {last}"

    @property
    def what(self) -> str:
        """Its device and version."""
        return f"{self.lines[0]['platform']} {self.lines[0]['driver']}" if self.lines else "no device"

    def result(self, works: tuple[str, ...]) -> str:
        """How many comparisons passed, over all routes, and the largest error as a share of what is tolerated."""
        mine = [line for line in self.lines[1:] if line["work"] in works]
        if not mine:
            return "not reached"
        count, failed = sum(line["count"] for line in mine), sum(len(line["failed"]) for line in mine)
        missing = len(ROUTES) if set(works) <= set(WORKS[3:]) else len(ROUTES) - 1
        parts = "" if len(mine) == missing * len(works) else f" ({len(mine)} of {missing * len(works)} parts)"
        worst = max((line["most"] / line["tolerance"] for line in mine), default=0.0)
        return f"{count - failed} of {count}{parts}, {worst:.2f}"


def _without_pocl(folder: Path) -> None:
    """A copy of pyopencl without the PoCL that pip puts beside its loader, which would always be loaded too."""
    spec = find_spec("pyopencl")
    assert spec is not None
    assert spec.origin is not None
    without = shutil.ignore_patterns("pocl.icd", "libpocl*", "__pycache__")
    shutil.copytree(Path(spec.origin).parent, folder / "pyopencl", ignore=without)


def found(roots: list[Path]) -> Iterator[Runtime]:
    """Those of this environment, of the system, and of other ones."""
    if find_spec("pocl_binary_distribution") is not None:
        yield Runtime("PoCL, pip", _POCL)
    library = intel.library()
    if library is not None:
        yield Runtime("Intel, pip", "intel", str(library))
    for root in (Path("/"), *roots):
        release = (root / "etc/os-release").read_text(encoding="utf-8") if (root / "etc/os-release").exists() else ""
        system = next((line[13:].strip('"') for line in release.splitlines() if line.startswith("PRETTY_NAME=")), str(root))
        for file in sorted((root / _VENDORS).glob("*.icd")):
            device = {"pocl": _POCL, "rusticl": "llvmpipe"}.get(file.stem)
            if device is not None:  # else for GPUs
                yield Runtime(f"{file.stem}, {system}", device, file.read_text(encoding="utf-8").strip(), root.resolve())


def main() -> None:
    """Try them, and print a table; the exit status is 1 if one of them errs."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--minutes", type=float, default=20.0, help="for each (default: 20)")
    arguments.add_argument("--only", default="", metavar="WORD", help="only those whose name holds this")
    arguments.add_argument("--root", type=Path, action="append", default=[], metavar="FOLDER", help="of another Debian")
    arguments.add_argument("--markdown", action="store_true", help="print the table as in the documentation")
    options = arguments.parse_args()
    if options.root and not shutil.which("chroot"):
        sys.exit("--root needs chroot")
    console, groups = Console(width=200), {"points": WORKS[:3], **{mode: (mode,) for mode in WORKS[3:]}}
    head, lines, wrong = ["runtime", "version", *groups, "time", "remarks"], [], False
    for runtime in found(options.root):
        if options.only.lower() not in runtime.name.lower():
            continue
        runtime.run(options.minutes)
        faults = [f"{line['route']}, {line['work']}: {why}" for line in runtime.lines[1:] for why in line["failed"]]
        wrong = wrong or bool(faults)
        lines.append([runtime.name, runtime.what, *map(runtime.result, groups.values()), f"{runtime.seconds:.0f} s", runtime.ended])
        console.print(f"[dim]{' | '.join(lines[-1])}[/dim]")
        for fault in faults:
            console.print(f"[red]{fault}[/red]")
    if options.markdown:
        for line in (head, ["---"] * len(head), *lines):
            print(f"| {' | '.join(line)} |")
    else:
        table = Table(*head, box=None)
        for line in lines:
            table.add_row(*line)
        console.print(table)
    sys.exit(wrong)


if __name__ == "__main__":
    main()
