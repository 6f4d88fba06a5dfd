"""Fuzzes every reader with mutated files: ``python -m tests.fuzz nii tiff --count 100000``."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from dataclasses import asdict
from pathlib import Path

from tests.fuzz.calls import fuzz_calls
from tests.fuzz.corpus import CORPORA
from tests.fuzz.harness import Tally, fuzz

_ALL = [*CORPORA, "calls"]
_CHUNK = 4000  # inputs per turn of a format, when time is the limit


def main() -> int:
    """Run, print a table, and return whether a promise was broken as the exit status."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("formats", nargs="*", metavar="FORMAT", help=f"of {', '.join(_ALL)}; default: all")
    parser.add_argument("--count", type=int, default=1000, help="mutants a format")
    parser.add_argument("--seconds", type=float, help="go on for so long instead")
    parser.add_argument("--first", type=int, help="first seed; default 0, or with --seconds one that is new")
    parser.add_argument(
        "--trusted",
        action="store_true",
        help="read in one process what native code reads, and again with its own what this one cannot bear: much faster",
    )
    parser.add_argument("--results", type=Path, help="a JSON file, in which the rows of the formats are replaced")
    parser.add_argument(
        "--keep", type=Path, default=Path(tempfile.gettempdir()) / "clvol-fuzz", help="where inputs go that broke a promise"
    )
    given = parser.parse_args()
    formats = given.formats or _ALL
    if unknown := set(formats) - set(_ALL):
        parser.error(f"formats must be of {', '.join(_ALL)}; got {', '.join(sorted(unknown))}")
    first = given.first if given.first is not None else int(time.time()) * 1000 if given.seconds else 0
    totals = {kind: Tally(kind) for kind in formats}
    missing: set[str] = set()
    end = time.monotonic() + given.seconds if given.seconds else None
    heads = {"tried": 8, "refused": 8, "read": 8, "compared": 9, "broken": 7, "contained": 10, "s": 7, "MB": 6}
    print(f"{'format':<12}{'seeds from':>15}{''.join(f'{head:>{width}}' for head, width in heads.items())}", flush=True)
    while True:
        for kind in [kind for kind in formats if kind not in missing]:
            if end is not None and time.monotonic() > end:
                break
            seeds = range(first, first + (_CHUNK if end else given.count))
            try:
                tally = fuzz_calls(seeds) if kind == "calls" else fuzz(kind, seeds, given.keep, trusted=given.trusted)
            except ImportError as error:
                print(f"{kind:<12}left out: {error}", flush=True)
                missing.add(kind)
                continue
            totals[kind].add(tally)
            _print(tally, first, given.keep)
            if given.results:
                _store(given.results, totals[kind])
        first += _CHUNK
        if end is None or time.monotonic() > end:
            break
    return int(any(tally.broken for tally in totals.values()))


def _print(tally: Tally, first: int, keep: Path) -> None:
    t = tally
    numbers = f"{t.tried:>8}{t.refused:>8}{t.accepted:>8}{t.compared:>9}{t.broken:>7}{t.contained:>10}"
    numbers += f"{t.slowest_s:>7.2f}{t.peak_mb:>6.0f}"
    print(f"{t.format:<12}{first:>15}{numbers}", flush=True)
    for what, (count, seed) in sorted(t.findings.items(), key=lambda item: -item[1][0]):
        print(f"    {count:>6} × {what}; {keep / f'{t.format}-{seed}'}", flush=True)


def _store(path: Path, tally: Tally) -> None:
    """Replace a format's row, and keep the others."""
    rows = {row["format"]: row for row in json.loads(path.read_text())} if path.is_file() else {}
    row = {name: round(value, 3) if isinstance(value, float) else value for name, value in asdict(tally).items()}
    rows[tally.format] = {name: value for name, value in row.items() if name != "doubtful"}
    path.write_text(json.dumps([rows[kind] for kind in _ALL if kind in rows], indent=1) + "\n")


if __name__ == "__main__":
    sys.exit(main())
