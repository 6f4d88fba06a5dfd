"""Runs every measurement beside its peers, prints a table, and saves it with the machine and the versions.

    python -m bench [--quick] [--only WORD] [--output FILE] [--no-huge]
    python -m bench --pictures DIR
    python -m bench.compare OLD.json [NEW.json]

Each row alternates with its peers (ours, theirs, ours, ...), after one uncounted run of each; medians are compared. "roofline"
is our rate as a fraction of the machine's maximum for the minimum cost of the work (see machine.py and the costs in cases.py).
"""

from __future__ import annotations

import argparse
import datetime as dt
import json
import os
import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

import clvol
from bench import peers
from bench.cases import Bench, Case, Skip, Work, all_cases, draw, measure, shots
from bench.machine import Cost, Limits, describe, measure_limits

RESULTS = Path(__file__).parent / "results"
FORMAT = 2
BUSY = 0.5  # Times measured at a higher initial load are unreliable


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--quick", action="store_true", help="smaller work: a check that all of it runs")
    arguments.add_argument("--only", default="", metavar="WORD", help="only measurements whose name holds this")
    arguments.add_argument("--no-huge", action="store_true", help="leave out 1024³")
    arguments.add_argument("--alone", action="store_true", help="without peers")
    arguments.add_argument("--output", type=Path, help="default: bench/results/<date>.json; not written with --quick or --only")
    arguments.add_argument("--pictures", type=Path, metavar="DIR", help="draw what is measured, ours beside theirs, and do no more")
    options = arguments.parse_args()
    console = Console(width=150)
    bench = Bench(quick=options.quick, huge=not options.no_huge)
    if options.alone:
        peers.TASKS.update({task: {} for task in peers.TASKS})
    else:
        for name, reason in peers.missing().items():
            console.print(f"[yellow]without {name}: {reason}[/yellow]")
    if options.pictures:
        pictures(bench, options.pictures, console)
        return
    started, load = time.perf_counter(), [os.getloadavg()[0]]
    limits = measure_limits(bench.device)
    if load[0] > BUSY:
        console.print(f"[yellow]the machine is busy (load {load[0]:.1f}): times will be too long, ratios less so[/yellow]")
    rows: list[dict[str, Any]] = []
    broken: list[str] = []
    for case in all_cases(bench):
        if options.only in case.name:
            console.print(f"[dim]{case.name}[/dim]")
            try:
                rows.append(row_of(case))
            except Skip as reason:
                console.print(f"[yellow]without {case.name}: {reason}[/yellow]")
                rows.append({"name": case.name, "skipped": str(reason)})
            except Exception:  # the other cases took minutes
                console.print_exception(max_frames=4)
                rows.append({"name": case.name, "skipped": "it failed"})
                broken.append(case.name)
    limits = limits.best(measure_limits(bench.device))  # the machine may have been busy the first time
    add_rooflines(rows, limits)
    console.print(table_of(rows))
    for line in footnotes(rows, limits):
        console.print(line)
    load.append(os.getloadavg()[0])
    today = dt.datetime.now(tz=dt.UTC).date().isoformat()
    console.print(f"[dim]{time.perf_counter() - started:.0f} s, load {load[0]:.1f} before and {load[1]:.1f} at the end[/dim]")
    output = options.output or (None if options.quick or options.only or options.alone else RESULTS / f"{today}.json")
    if output:
        machine = {**describe(bench.device), "load": load, "limits": asdict(limits)}
        if not options.alone:
            machine.update(opengl=peers.renderer_of_opengl(), missing=peers.missing())
        report = {"format": FORMAT, "date": today, "quick": options.quick, "machine": machine, "results": rows}
        output.parent.mkdir(parents=True, exist_ok=True)
        output.write_text(json.dumps(report, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        console.print(f"written: {output}")
    if broken:
        sys.exit(f"failed: {'; '.join(broken)}")


def row_of(case: Case) -> dict[str, Any]:
    """One measured case, in the format of the results."""
    load = os.getloadavg()[0]
    work = case.prepare()
    row: dict[str, Any] = {"name": case.name, "load": load}
    if not isinstance(work, Work):
        return {**row, **work}
    measured = measure(work)
    ours = measured.seconds["clvol"]
    row.update(asdict(measured), times_as_fast_as={k: s / ours for k, s in measured.seconds.items() if k != "clvol"})
    if work.amount:
        row.update(amount=work.amount, rate=work.amount / ours / 1e6, unit=work.unit)
    if work.cost is not None:
        row.update(cost=asdict(work.cost))
    return row


def add_rooflines(rows: list[dict[str, Any]], limits: Limits) -> None:
    for row in rows:
        if "cost" in row:
            share, limit = limits.share(Cost(**row["cost"]), 1e6 * row["rate"])
            row["roofline"] = {"share": share, "of": limit}


def table_of(rows: list[dict[str, Any]]) -> Table:
    table = Table("work", "clvol", "rate", "roofline", "times as fast as", box=None)
    for row in rows:
        if "skipped" in row:
            continue
        taken = f"{row['seconds']['clvol']:.4f} s" if "seconds" in row else f"{row['value']:.2f}"
        rate = f"{row['rate']:.1f} {row['unit']}" if "rate" in row else row.get("unit", "")
        roofline = f"{row['roofline']['share']:.0%} of {row['roofline']['of']}" if "roofline" in row else ""
        if "kernel_build" in row:
            rate = f"+ {row['kernel_build']:.1f} s for kernels"
        ratios = (f"{name} {_colored(ratio)}" for name, ratio in row.get("times_as_fast_as", {}).items())
        table.add_row(row["name"], taken, rate, roofline, "; ".join(ratios))
    return table


def _colored(ratio: float) -> str:
    text = f"{ratio:.1f}×" if ratio >= 2 else f"{ratio:.2f}×"
    return text if ratio >= 1 else f"[bold red]{text}[/bold red]"


def footnotes(rows: list[dict[str, Any]], limits: Limits) -> list[str]:
    """Growth with size, failures, work that is not the same, and the reference of the roofline."""
    seconds = {row["name"]: row["seconds"]["clvol"] for row in rows if "seconds" in row}
    lines = []
    for mode in ("isosurface", "mip"):
        by_size = {int(k.split(", ")[2][:-1]): s for k, s in seconds.items() if k.startswith(f"frame against size, {mode}")}
        steps = [f"{n}³/{n // 2}³ {s / by_size[n // 2]:.2f}×" for n, s in sorted(by_size.items()) if n // 2 in by_size]
        if steps:
            lines.append(f"{mode} against size: {', '.join(steps)}")
    for row in rows:
        lines += [f"[yellow]{row['name']}: {name} failed: {why}[/yellow]" for name, why in row.get("failed", {}).items()]
        for name, difference in row.get("differs_by", {}).items():
            if difference > 1e-4 and not name.endswith(("trilinear", "tricubic")) and not row["name"].startswith("frame"):
                lines.append(f"[yellow]{row['name']}: {name} differs by {difference:.1e} of the range[/yellow]")
    lines.append(
        f"[dim]limits: {limits.copy / 1e9:.0f} GB/s copied, {limits.update / 1e9:.0f} GB/s in place, "
        f"{limits.loads / 1e9:.1f} G loads/s of 16 bytes, {limits.multiply_adds / 1e9:.0f} G multiply-adds/s[/dim]"
    )
    return lines


def pictures(bench: Bench, folder: Path, console: Console) -> None:
    """Every picture by us and by the peers, as files and side by side, to check that they show the same."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, make in shots(bench).items():
        shot = make()
        found = {"clvol": draw(bench.renderer(bench.n), shot), **{k: p.run() for k, p in peers.of("frame", shot).items()}}
        stem = name.replace(", ", "-")
        for who, picture in found.items():
            clvol.save(picture, folder / f"{stem}-{who.replace(', ', '-').replace(' ', '-')}.png")
        clvol.save(np.concatenate(list(found.values()), 1), folder / f"{stem}.png")
        console.print(f"{folder / stem}.png: {', '.join(found)}")


if __name__ == "__main__":
    main()
