"""Changes since an earlier result.

    python -m bench.compare OLD.json [NEW.json]

Without NEW.json, the latest of bench/results other than OLD.json. "change" is the old time over the new one: above one is
faster. "beside" is the change of the ratio to a peer that did the same work in both: the speed of the machine, which varies
from day to day, cancels out.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

__all__ = ["compare", "read"]

RESULTS = Path(__file__).parent / "results"
_FORMATS = (1, 2)
# names of the peers and of the same work in format 1
_PEERS = {"scipy spline_filter": "scipy", "scipy map_coordinates": "scipy", "scipy zoom": "scipy"}
_NAMES = {
    "prefilter and upload": "prefilter 256³ and upload",
    "magnify ×2, prefilter included": "magnify ×2, 128³, prefilter included",
}
_STEADY = 0.05  # smaller changes are noise


def read(file: Path) -> dict[str, Any]:
    """A report of any former format, converted to the present one.

    Raises
    ------
    ValueError
        The file is not a report; the message says why.
    """
    try:
        report = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ValueError(f"{file} cannot be read: {error}") from None
    if not isinstance(report, dict) or not isinstance(report.get("results"), list):
        raise ValueError(f"{file} must be a report of `python -m bench`; it has no results")
    number = report.get("format", 1)
    if number not in _FORMATS:
        raise ValueError(f"{file} must be of a format of {_FORMATS}; got {number!r}")
    rows = {}
    for row in report["results"]:
        if number == 1:
            row = {**row, "name": _NAMES.get(row["name"], row["name"])}
            row["seconds"] = {_PEERS.get(name, name): s for name, s in row["seconds"].items()}
        rows[row["name"]] = row
    return {**report, "results": rows}


def compare(old: dict[str, Any], new: dict[str, Any]) -> list[dict[str, Any]]:
    """Work that is in both: `old`, `new`, `change`, and `beside`, the change relative to each peer in both."""
    rows = []
    for name, now in new["results"].items():
        before = old["results"].get(name)
        if before is None or ("seconds" in before) != ("seconds" in now) or "skipped" in before or "skipped" in now:
            continue
        if "seconds" not in now:
            rows.append({"name": name, "old": before["value"], "new": now["value"], "change": before["value"] / now["value"]})
            continue
        was, is_now = before["seconds"], now["seconds"]
        change = was["clvol"] / is_now["clvol"]
        beside = {peer: change * is_now[peer] / was[peer] for peer in is_now if peer != "clvol" and peer in was}
        rows.append({"name": name, "old": was["clvol"], "new": is_now["clvol"], "change": change, "beside": beside})
    return rows


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m bench.compare", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("old", type=Path)
    parser.add_argument("new", type=Path, nargs="?")
    options = parser.parse_args(arguments)
    new_file = options.new or _latest(options.old)
    if new_file is None:
        parser.error(f"there is no other result in {RESULTS}; name one")
    try:
        old, new = read(options.old), read(new_file)
    except ValueError as error:
        parser.error(str(error))
    console = Console(width=130)
    console.print(f"old: {options.old} ({_machine(old)})\nnew: {new_file} ({_machine(new)})")
    if _machine(old) != _machine(new):
        console.print("[yellow]the machines differ: only what is beside a peer can be compared[/yellow]")
    rows = compare(old, new)
    table = Table("work", "old", "new", "change", "beside", box=None)
    for row in rows:
        beside = ", ".join(f"{peer} {_colored(ratio)}" for peer, ratio in row.get("beside", {}).items())
        table.add_row(row["name"], f"{row['old']:.4g}", f"{row['new']:.4g}", _colored(row["change"]), beside)
    console.print(table)
    if rows:
        console.print(f"geometric mean of {len(rows)}: {math.exp(sum(math.log(r['change']) for r in rows) / len(rows)):.2f}×")
    for what, one, other in (("old", old, new), ("new", new, old)):
        alone = [name for name in one["results"] if name not in other["results"]]
        if alone:
            console.print(f"[dim]only in {what}: {'; '.join(alone)}[/dim]")
    return 0


def _latest(but: Path) -> Path | None:
    return max((f for f in RESULTS.glob("*.json") if f.resolve() != but.resolve()), default=None)


def _machine(report: dict[str, Any]) -> str:
    machine = report.get("machine", {})
    return f"{machine.get('processor', 'unknown')}, {machine.get('cores', '?')} cores"


def _colored(ratio: float) -> str:
    color = "green" if ratio > 1 + _STEADY else "red" if ratio < 1 - _STEADY else "dim"
    return f"[{color}]{ratio:.2f}×[/{color}]"


if __name__ == "__main__":
    sys.exit(main())
