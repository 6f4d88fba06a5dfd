"""Generates the tables of reliability.md from the results of tests and soaks.

    python docs/_reliability.py

writes them between ``<!-- table: NAME -->`` and ``<!-- end -->``.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

__all__ = ["TABLES", "with_tables"]

HERE = Path(__file__).parent
FUZZ, SOAK = HERE.parent / "tests" / "fuzz" / "results.json", HERE.parent / "bench" / "results" / "soak"
_NONE = "No run has been recorded.\n"
_AIM = 100_000  # inputs of each format
_WORST = "slowest_s", "peak_mb"
_PLACE = re.compile(r"(<!-- table: (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)


def _table(head: Iterable[str], rows: Iterable[Iterable[Any]]) -> str:
    lines = [list(head), ["---"] * len(list(head)), *rows]
    return "".join(f"| {' | '.join(map(str, line))} |\n" for line in lines)


def _count(number: float) -> str:
    return f"{number:,.0f}"


def soak() -> str:
    """The soaks of the last day: work done, and resources held."""
    runs = [json.loads(file.read_text(encoding="utf-8")) for file in sorted(SOAK.glob("*.json"))]
    last = max((run["date"] for run in runs), default="")
    return "\n".join(_soak(run) for run in runs if run["date"] == last) or _NONE


def _soak(run: dict[str, Any]) -> str:
    machine, faults, programs = run["machine"], len(run["faults"]), run["programs"]
    text = (
        f"{run['date']}: {run['minutes']:g} minutes with {run['threads']} threads on {machine['cores']} cores "
        f"({machine['opencl'].strip()}, Python {machine['python']}). {_count(run['draws'])} operations: {run['catalogue']} "
        f"repeated sets of arguments and {_count(run['draws_of_new_arguments'])} unique ones, with "
        f"{_count(programs['made'])} programs created and {_count(programs.get('compiled', 0))} kernels compiled. "
        f"Different results, and foreign exceptions: {faults or 'none'}.\n\n"
    )
    rows = []
    for name, row in run["held"].items():
        scale = 1e6 if name == "resident" else 1
        rows.append((row["what"], *(_count(row[key] / scale) for key in ("first", "last", "most")), "yes" if row["grew"] else "no"))
    return text + _table(("resource", "first third", "last third", "maximum", "grew"), rows)


def fuzz() -> str:
    """All runs of the fuzzers, a row per format."""
    if not FUZZ.exists():
        return _NONE
    counts = {
        "tried": "tried",
        "refused": "rejected",
        "accepted": "read",
        "crashes": "crashes",
        "hangs": "over 5 s",
        "memory": "over 200 MB",
        "foreign": "foreign errors",
        "silent": "silent changes",
        "leaks": "leaks",
        "contained": "contained",
    }
    found = json.loads(FUZZ.read_text(encoding="utf-8"))
    rows = [[row["format"], *(row.get(key, 0) for key in counts), *(row[key] for key in _WORST)] for row in found]
    sums = [sum(row.get(key, 0) for row in found) for key in counts]
    rows.append(["all", *sums, *(max(row[key] for row in found) for key in _WORST)])
    cells = [[row[0], *map(_count, row[1:-2]), f"{row[-2]:.1f}", _count(row[-1])] for row in rows]
    few = [row["format"] for row in found if row["tried"] < _AIM]
    missed = f"\nFewer than {_count(_AIM)} inputs for: {', '.join(few)}.\n" if few else ""
    return _table(("input", *counts.values(), "slowest, s", "memory, MB"), cells) + missed


TABLES: dict[str, Callable[[], str]] = {"soak": soak, "fuzz": fuzz}
"""By name in the page."""


def with_tables(page: str) -> str:
    """The page with regenerated tables."""
    return _PLACE.sub(lambda match: match[1] + "\n" + TABLES[match[2]]() + "\n" + match[3], page)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        raise SystemExit(f"{sys.argv[0]} takes no arguments: it writes the tables of reliability.md; got {sys.argv[1:]}")
    file = HERE / "reliability.md"
    file.write_text(with_tables(file.read_text(encoding="utf-8")), encoding="utf-8")
