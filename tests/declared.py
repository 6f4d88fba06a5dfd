"""Kernels that PoCL builds without reading what they don't use.

PoCL reads a megabyte of declarations of built-in functions before each program, which takes a quarter of a second; our kernels
use a few dozen of them. `declare_few` gives each program the declarations of those that it names, taken from PoCL's own file; the
code that comes out is the same.
"""

from __future__ import annotations

import os
import re
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from clvol.base.interrupted import quiet
from clvol.device import program
from clvol.device.opencl import opencl

_GUARD = "_OPENCL_H_"  # defined, it leaves PoCL's own declarations out
_COMMENT = re.compile(r"//[^\n]*|/\*.*?\*/", re.DOTALL)
_PIECE = re.compile(r"^#(?:.*\\\n)*.*\n|[^;#]*;", re.MULTILINE)  # a directive, or a declaration
_NAME = re.compile(r"(\w+)\s*\(")
_EMPTY = re.compile(r"^#if.*(?:\\\n.*)*\n#endif\n", re.MULTILINE)


def declare_few() -> None:
    """Let this process build kernels that are not optimised with few declarations."""
    whole = program._compiled

    def compiled(context: Any, text: str) -> Any:
        if "-cl-opt-disable" not in os.environ.get("POCL_EXTRA_BUILD_FLAGS", "") or not _pieces():
            return whole(context, text)
        few = _declarations(frozenset(_names() & set(re.findall(r"\w+", text))))
        with quiet():
            return opencl().Program(context, few + text).build(options=[*program._OPTIONS, f"-D{_GUARD}"])

    program._compiled = compiled


@cache
def _pieces() -> list[tuple[str, str]]:
    """Directives and declarations of PoCL's file, each after the function's name; none if there is no such file."""
    found = find_spec("pocl_binary_distribution")
    files = [file for place in (found and found.submodule_search_locations) or () for file in Path(place).rglob("opencl-c.h")]
    text = _COMMENT.sub("", files[0].read_text()) if files else ""
    pieces = [re.sub(r"[ \t]+$", "", piece.strip(), flags=re.MULTILINE) for piece in _PIECE.findall(text)]
    return [
        ("" if piece.startswith("#") else _NAME.findall(piece)[0], piece) for piece in pieces if not piece.startswith("#include")
    ]


@cache
def _names() -> set[str]:
    return {name for name, _ in _pieces()}


@cache
def _declarations(names: frozenset[str]) -> str:
    text = f"#undef {_GUARD}\n" + "".join(f"{piece}\n" for name, piece in _pieces() if not name or name in names)
    count = 1
    while count:
        text, count = _EMPTY.subn("", text)
    return text
