"""Commands that list filters, presets and devices, check the installation, and print the shells' completion scripts."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, Any, Literal

from cyclopts import Parameter

import clvol
from clvol.base.printable import printable
from clvol.base.shown import Named
from clvol.cli.options import Json
from clvol.cli.root import FILTERS, SETUP, app, command
from clvol.cli.speech import print_json, table

__all__ = ["completion", "devices", "doctor", "filters", "presets"]


@command(FILTERS)
def filters(*, json: Json = False) -> None:
    """List the reconstruction filters, with their aliases."""
    _list(clvol.filters(), json, {"continuity": "class"})  # "continuity" does not fit into 80 columns


@command(FILTERS)
def presets(*, json: Json = False) -> None:
    """List the presets: named looks, each for one kind of data."""
    _list(clvol.presets(), json)


@command(SETUP)
def devices(*, json: Json = False) -> None:
    """List the OpenCL devices, the one used by default first."""
    rows = [
        {
            "number": i,
            "name": d.name,
            "kind": d.kind,
            "platform": d.platform,
            "memory_mib": d.handle.global_mem_size >> 20,
            "images": bool(d.handle.image_support),
        }
        for i, d in enumerate(clvol.devices())
    ]
    if not rows:
        from clvol.device import as_device

        as_device()  # raises, and says what to install
    if json:
        print_json(rows)
    else:
        table([*rows[0]], [[str(value) for value in row.values()] for row in rows])


@command(SETUP)
def doctor(*, json: Json = False) -> None:
    """Check whether OpenCL is usable here, which runtime is used, and what to install if there is none."""
    from clvol.cli import _doctor

    needed, optional = list(_doctor.opencl()), list(_doctor.extras())
    usable = needed[-1].ok
    if json:
        print_json({"usable": usable, "checks": [check._asdict() for check in (*needed, *optional)]})
    else:
        for check in (*optional, *needed):  # what keeps clvol from computing is the last line on the screen
            print(f"{'ok' if check.ok else '--'}  {check.check}: {printable(check.detail)}")
    if not usable:
        raise SystemExit(1)


@command(SETUP)
def completion(shell: Annotated[Literal["bash", "zsh", "fish"], Parameter(help="Your shell.")], /) -> None:
    """Print a script for the shell, so that Tab completes commands, options, and names of files, filters, modes and presets.

    bash: clvol completion bash > ~/.local/share/bash-completion/completions/clvol

    zsh: clvol completion zsh > FOLDER/_cyclopts_clvol, where FOLDER is one of $fpath

    fish: clvol completion fish > ~/.config/fish/completions/clvol.fish

    It takes effect in new shells. Create the folder first if there is none (mkdir -p); bash needs the package bash-completion.
    """
    print(app.generate_completion(prog_name="clvol", shell=shell))


def _list(known: Named[Any], as_json: bool, shorter: Mapping[str, str] = MappingProxyType({})) -> None:
    if as_json:
        print_json([dict(zip(known.HEADER, row, strict=True)) for row in known.rows()])
    else:
        table([shorter.get(name, name) for name in known.HEADER], [list(row) for row in known.rows()])
