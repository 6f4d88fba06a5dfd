"""Kernels: read from ``cl/``, spliced, specialised by ``#define``, built once, kept for each thread."""

from __future__ import annotations

import re
import threading
import warnings
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from clvol.boundary import Boundary
from clvol.device import Device, _opencl
from clvol.errors import DeviceError
from clvol.filter import Filter

__all__ = ["LANES", "Program", "boundary_defines", "build", "filter_defines", "row_reach", "source"]

LANES = 8
"""Numbers that one vector of the kernels holds, and what rows of coefficients are padded to."""

_INCLUDE = re.compile(r'^#include "([\w/.]+)"[ \t]*$', re.MULTILINE)
Defines = Mapping[str, str | int | float]


@lru_cache
def _folder() -> Path:
    """Inside the package when installed from a wheel; the repository's own when installed editable."""
    package = Path(__file__).resolve().parent
    for folder in (package / "cl", package.parents[1] / "cl"):
        if (folder / "base/platform.cl").is_file():
            return folder
    raise DeviceError(f"the kernels (cl/*.cl) are not installed beside {package}; reinstall clvol")


def source(name: str, replacements: Mapping[str, str] | None = None, generated: Mapping[str, str] | None = None) -> str:
    """The text of one kernel file with its includes spliced in, each once.

    Splicing is done here because PoCL takes no ``-I`` with a space in it; ``#line`` keeps the
    compiler's messages on the right file and line. `replacements` maps an included name to another,
    which is how a render mode's file takes its place in the ray loop; `generated` maps one to text.
    """
    seen: set[str] = set()

    def splice(name: str) -> str:
        if name in seen:
            return ""
        seen.add(name)
        text = (generated or {}).get(name) or (_folder() / name).read_text(encoding="utf-8")

        def insert(match: re.Match[str]) -> str:
            line = text.count("\n", 0, match.end()) + 2  # of what follows the directive
            inner = splice((replacements or {}).get(match[1], match[1]))
            return f'{inner}\n#line {line} "{name}"' if inner else ""

        return f'#line 1 "{name}"\n' + _INCLUDE.sub(insert, text)

    return splice(name)


class Program:
    """A built program; `kernel` gives each thread kernels of its own, for they hold their arguments."""

    def __init__(self, device: Device, handle: Any) -> None:
        self.device = device
        self._handle = handle
        self._kernels = threading.local()

    def kernel(self, name: str) -> Any:
        mine = self._kernels.__dict__
        if name not in mine:
            with self.device.errors:
                mine[name] = _opencl().Kernel(self._handle, name)
        return mine[name]


def build(
    device: Device,
    name: str,
    defines: Defines,
    replacements: Mapping[str, str] | None = None,
    generated: Mapping[str, str] | None = None,
) -> Program:
    """The program of one kernel file, specialised; built at most once for each device and set of defines."""
    device.require_usable()
    key = (
        name,
        tuple(sorted(defines.items())),
        tuple(sorted((replacements or {}).items())),
        tuple(sorted((generated or {}).items())),
    )
    with device._lock:
        if key not in device._programs:
            cl = _opencl()
            head = "".join(f"#define {k} {_literal(v)}\n" for k, v in sorted(defines.items()))
            text = head + source(name, replacements, generated)
            with device.errors, warnings.catch_warnings():
                # Intel's runtime always has something to say; what is wrong comes as an error
                warnings.simplefilter("ignore", cl.CompilerWarning)
                handle = cl.Program(device.context, text).build(options=["-cl-std=CL1.2"])
            device._programs[key] = Program(device, handle)
        program: Program = device._programs[key]
        return program


def _literal(value: str | float) -> str:
    return _float(value) if isinstance(value, float) else str(value)


def _float(value: float) -> str:
    text = f"{np.float32(value):.9g}"
    return f"{text}f" if "." in text or "e" in text else f"{text}.0f"


def row_width(filter: Filter) -> int:
    """The width of the vectors that a row of taps is loaded in: 1, 2, 4 or 8."""
    return min(8, int(1 << (filter.support - 1).bit_length()))


def row_reach(filter: Filter) -> int:
    """How many coefficients the vectors of one row cover: the taps, rounded up."""
    return -(-filter.support // row_width(filter)) * row_width(filter)


def filter_defines(filter: Filter) -> dict[str, str | int | float]:
    """What filter.cl, patch.cl and locate.cl need to know of a filter."""
    width, reach = row_width(filter), row_reach(filter)
    columns = np.zeros((filter.degree + 1, reach))
    columns[:, : filter.support] = filter.matrix.T
    vector = "float" if width == 1 else f"float{width}"
    rows = [
        "{" + ",".join(f"({vector})({','.join(map(_float, part))})" for part in np.split(column, reach // width)) + "}"
        for column in columns
    ]
    return {
        "TAPS": filter.support,
        "DEGREE": filter.degree,
        "ROW": width,
        "CHUNKS": reach // width,
        "FILTER_COLUMNS": "{" + ",".join(rows) + "}",
        "FILTER_TAPS": "{" + ",".join("{" + ",".join(map(_float, tap)) + "}" for tap in filter.matrix) + "}",
        "LEFT": filter.support / 2 - 1,
        "GRID_SCALE": filter.scale,
    }


def boundary_defines(boundary: Boundary) -> dict[str, str | int | float]:
    """What boundary.cl needs to know of a rule."""
    return {
        "BOUNDARY_PERIODIC": int(boundary.period is not None),
        "BOUNDARY_FOLDED": int(boundary.fold is not None),
        "BOUNDARY_FOLD": boundary.fold or 0,
    }
