"""Random clients at the viewer's server for a long time: nothing may fail and nothing may grow.

    python -m bench.view_soak --minutes N [--clients C] [--seed S] [--samples N] [--output FILE]

In rounds, clients without a browser connect by websocket, all at once, and leave. Each sends random pointer and key events,
changes of state, requests (undo, saved pictures and movies, ...) and, sometimes, invalid messages; half of the clients leave
abruptly, the others wait for the answer to a last request. Between rounds, when no client is connected, the process is measured
and judged as in soak.py. Exit status 1 means that an internal exception occurred, that an answer or a connection was lost, or
that something grew.

Kernels are rebuilt in a temporary cache unless POCL_CACHE_DIR names one.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import faulthandler
import gc
import json
import logging
import random
import sys
import tempfile
import threading
import time
import warnings
from collections import Counter
from pathlib import Path
from typing import Any

import aiohttp
from rich.console import Console

from bench.soak import Buffers, grown, held, kernels, table_of
from tests.view.clients import random_changes, random_event

__all__ = ["main"]

_ROUND = 10.0  # seconds in which clients act
_ANSWER = 300.0  # seconds for an answer, including compilation
_FILLING = 10  # minutes in which caches fill
_PANES = ("3d", "x", "y", "z")
_DEEDS = ("undo", "redo", "reset", "fit", "save_picture", "copy_python", "copy_toml", "copy_url", "pick", "heat", "movie")
_NONSENSE = ("", "[]", "{", '{"type": 7}', '{"type": "do"}', '{"type": "set", "changes": 3}', '{"type": "event", "event": {}}')
_SHOWN = 5


class Faults(logging.Handler):
    """Faults, including errors that the viewer logs: exceptions that the client did not cause."""

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self.found: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.add(f"{record.name}: {self.format(record)}")

    def add(self, text: str) -> None:
        self.found.append(text)
        print(text, file=sys.stderr, flush=True)


def message(chance: random.Random, size: tuple[int, int]) -> str:
    """Any message that a client may send."""
    kind = chance.choices(("event", "resize", "set", "do", "nonsense"), (80, 3, 8, 8, 1))[0]
    if kind == "nonsense":
        return chance.choice(_NONSENSE)
    pane = {"pane": chance.choice(_PANES)} if chance.random() < 0.3 else {}
    if kind == "event":
        return json.dumps({"type": "event", "event": random_event(chance, *size) | pane})
    if kind == "resize":
        event = {"event_type": "resize", "width": chance.randint(16, 300), "height": chance.randint(16, 300), "ratio": 1}
        return json.dumps({"type": "event", "event": event | pane})
    if kind == "set":
        drawn = random_changes(chance)
        names = chance.sample(sorted(drawn), chance.randint(1, 4))
        return json.dumps({"type": "set", "changes": {name: drawn[name] for name in names}, "live": chance.random() < 0.5})
    what = chance.choices(_DEEDS, (8, 4, 8, 4, 2, 2, 2, 2, 4, 2, 0.3))[0]
    more: dict[str, Any] = {"x": chance.uniform(0, size[0]), "y": chance.uniform(0, size[1])} if what == "pick" else {}
    if what in ("save_picture", "movie"):
        more = {"width": 64, "height": 48, **({"frames": 3} if what == "movie" else {})}
    return json.dumps({"type": "do", "what": what, "id": chance.randint(0, 99), **more, **pane})


async def visit(url: str, seed: str, faults: Faults, counts: Counter[str]) -> None:
    """One client, until it has done enough."""
    chance = random.Random(seed)
    size = chance.randint(64, 256), chance.randint(64, 256)
    stays, answered = chance.random() < 0.5, asyncio.Event()
    async with aiohttp.ClientSession() as client:
        async with client.ws_connect(url.partition("?")[0] + "ws", max_msg_size=0) as socket:
            await socket.send_json({"type": "hello", "token": url.partition("token=")[2]})

            async def listen() -> None:
                async for got in socket:
                    if got.type is not aiohttp.WSMsgType.TEXT:
                        continue
                    told = json.loads(got.data)
                    counts[told["type"]] += 1
                    if told["type"] == "frame" and chance.random() < 0.98:
                        await socket.send_json({"type": "ack", "frame": told["number"]})
                    if told.get("id") == "last":
                        answered.set()

            listening = asyncio.ensure_future(listen())
            first = {"event_type": "resize", "width": size[0], "height": size[1], "ratio": 1}
            await socket.send_json({"type": "event", "event": first})
            end = time.monotonic() + _ROUND
            while time.monotonic() < end and not socket.closed:
                await socket.send_str(message(chance, size))
                counts["sent"] += 1
                await asyncio.sleep(chance.choice((0.0, 0.005, 0.02, 0.1)))
            if stays and not socket.closed:
                await socket.send_json({"type": "do", "what": "copy_url", "id": "last"})
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(answered.wait(), _ANSWER)
            if socket.closed or (stays and not answered.is_set()):
                faults.add(f"{seed}: " + (f"sent away ({socket.close_code})" if socket.closed else "no answer"))
        await listening


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--minutes", type=float, default=30)
    arguments.add_argument("--clients", type=int, default=2, help="that are there at once")
    arguments.add_argument("--seed", type=int, default=0, help="of what is drawn")
    arguments.add_argument("--samples", type=int, default=48, help="along each axis of the volume")
    arguments.add_argument("--output", type=Path, help="a file for what was counted")
    options = arguments.parse_args()
    faulthandler.enable()
    warnings.simplefilter("ignore")
    with kernels(), tempfile.TemporaryDirectory(prefix="clvol-soak-") as folder:
        sys.exit(_soak(options, Path(folder)))


def _soak(options: argparse.Namespace, folder: Path) -> int:
    import clvol
    from clvol.view import View

    buffers, faults, counts = Buffers(), Faults(), Counter[str]()
    clvol.devices()  # before its classes are counted
    buffers.watch()
    for name in ("clvol", "asyncio", "aiohttp"):
        logging.getLogger(name).addHandler(faults)
    samples: list[dict[str, float]] = []
    begun, rounds = time.monotonic(), 0
    view = View(clvol.phantoms.marschner_lobb(options.samples))
    with view.serve() as server:
        while time.monotonic() < begun + 60 * options.minutes:
            seeds = [f"{options.seed}-{rounds}-{number}" for number in range(options.clients)]

            async def visits(seeds: list[str] = seeds) -> None:
                await asyncio.gather(*(visit(server.url, seed, faults, counts) for seed in seeds))

            asyncio.run(visits())
            rounds += 1
            if not _quiet(server):
                faults.add(f"round {rounds}: sessions have not ended; {[thread.name for thread in threading.enumerate()]}")
            view.close()  # else device memory would depend on the last view
            gc.collect()
            samples.append({"seconds": time.monotonic() - begun, **held(folder, buffers)})
    rows = grown(samples)
    console = Console(width=120)
    sums = f"{counts['sent']} messages, {counts['frame']} frames; {len(faults.found)} faults"
    title = f"{rounds} rounds of {options.clients} clients: {sums}"
    console.print(table_of(rows, title))
    for fault in faults.found[:_SHOWN]:
        console.print(fault, markup=False, highlight=False)
    grew = any(row["grew"] for name, row in rows.items() if name != "resident" or options.minutes >= _FILLING)
    if options.output:
        told = {"minutes": options.minutes, "clients": options.clients, "rounds": rounds, "counts": dict(counts)}
        told |= {"faults": faults.found, "held": rows, "samples": samples}
        options.output.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
    return int(bool(faults.found) or grew)


def _quiet(server: Any) -> bool:
    """Whether no client is connected and all sessions have ended: their kernels may have to finish compiling."""
    end = time.monotonic() + _ANSWER
    while time.monotonic() < end:
        working = any(thread.name.startswith("clvol") and thread.name != "clvol: page" for thread in threading.enumerate())
        if not server.clients and not working:
            return True
        time.sleep(0.05)
    return False


if __name__ == "__main__":
    main()
