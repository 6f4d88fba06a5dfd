"""Kernels: read from ``cl/``, spliced into one text, specialised by ``#define``, kept for each thread."""

from __future__ import annotations

import re
import threading
import warnings
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from clvol.errors import DeviceError, OptionError
from clvol.moved import forwarding
from clvol.opencl import opencl

__all__ = ["LANES", "Defines", "Program", "build", "literal", "source"]

LANES = 8
"""Numbers that one vector of the kernels holds, and what rows of coefficients are padded to."""

Defines = Mapping[str, str | int | float]
_INCLUDE = re.compile(r'^#include "([\w/.]+)"[ \t]*$', re.MULTILINE)


@lru_cache
def folder() -> Path:
    """Where the kernel files are: inside the package if it was installed from a wheel, in the repository if it is editable."""
    package = Path(__file__).resolve().parent
    for folder in (package / "cl", package.parents[1] / "cl"):
        if (folder / "base/platform.cl").is_file():
            return folder
    raise DeviceError(f"the kernels (cl/*.cl) are not installed beside {package}; reinstall clvol")


def source(
    name: str,
    replacements: Mapping[str, str] | None = None,
    generated: Mapping[str, str] | None = None,
    defines: Defines | None = None,
) -> str:
    """The text of one kernel file, with its includes spliced in, each once, behind the `defines`.

    Splicing is done here because PoCL takes no ``-I`` with a space in it; ``#line`` keeps the
    compiler's messages on the right file and line. `replacements` maps an included name to another,
    which is how a render mode's file takes its place in the ray loop; `generated` maps one to text.
    """
    seen: set[str] = set()

    def splice(name: str) -> str:
        if name in seen:
            return ""
        seen.add(name)
        try:
            text = (generated or {}).get(name) or (folder() / name).read_text(encoding="utf-8")
        except FileNotFoundError:
            raise OptionError(f"every kernel must have a file in {folder()}; there is no {name}") from None

        def insert(match: re.Match[str]) -> str:
            line = text.count("\n", 0, match.end()) + 2  # of what follows the directive
            inner = splice((replacements or {}).get(match[1], match[1]))
            return f'{inner}\n#line {line} "{name}"' if inner else ""

        return f'#line 1 "{name}"\n' + _INCLUDE.sub(insert, text)

    head = "".join(f"#define {k} {literal(v)}\n" for k, v in sorted((defines or {}).items()))
    return head + splice(name)


class Program:
    """A built program; `kernel` gives each thread kernels of its own, for they hold their arguments."""

    def __init__(self, handle: Any) -> None:
        self._handle = handle
        self._kernels = threading.local()

    def kernel(self, name: str) -> Any:
        """The kernel of this name; `DeviceError` if there is none."""
        mine = self._kernels.__dict__
        if name not in mine:
            try:
                mine[name] = opencl().Kernel(self._handle, name)
            except opencl().Error as error:
                raise DeviceError(f"there is no kernel {name!r}: {error}") from error
        return mine[name]


def build(context: Any, text: str) -> Program:
    """The program of a text in a context; errors are the runtime's."""
    cl = opencl()
    with warnings.catch_warnings():
        # Intel's runtime always has something to say; what is wrong comes as an error
        warnings.simplefilter("ignore", cl.CompilerWarning)
        return Program(cl.Program(context, text).build(options=["-cl-std=CL1.2"]))


def literal(value: str | float) -> str:
    """A number as OpenCL C writes it, floats in single precision; a text as it is."""
    if not isinstance(value, float):
        return str(value)
    text = f"{np.float32(value):.9g}"
    return f"{text}f" if "." in text or "e" in text else f"{text}.0f"


__getattr__ = forwarding(
    __name__, dict.fromkeys(("boundary_defines", "filter_defines", "row_reach", "row_width"), "clvol.spline.build")
)
