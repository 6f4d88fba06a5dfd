"""``python -m clvol.ndimage [--fallback] [--verbose] script.py arguments...``: a script with SciPy's interpolation replaced."""

from __future__ import annotations

import argparse
from pathlib import Path

from clvol.ndimage.patch import run


def main() -> None:
    """Run a script with `scipy.ndimage` patched."""
    parser = argparse.ArgumentParser(
        prog="python -m clvol.ndimage", description="Run a script with clvol's functions in the place of SciPy's interpolation."
    )
    parser.add_argument("--fallback", action="store_true", help="calls that clvol refuses go to SciPy, with a warning")
    parser.add_argument("--verbose", action="store_true", help="print which calls were taken")
    parser.add_argument("script")
    parser.add_argument("arguments", nargs=argparse.REMAINDER)
    given = parser.parse_args()
    if not Path(given.script).is_file():
        parser.error(f"script must be a file; got {given.script!r}")
    run(given.script, given.arguments, fallback=given.fallback, verbose=given.verbose)


if __name__ == "__main__":
    main()
