"""Parameter blocks of kernels: each is declared once, and gives a NumPy dtype and a C struct of the same layout.

A type that kernels read defines its own block: the declaration (`BLOCK`) and the values (`block(...)`). Every number has
four bytes, so that the layout is the same everywhere.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["FLOAT", "INT", "REACH", "Block", "Values", "copied"]

FLOAT, INT = np.float32, np.int32
REACH = 1 << 18
"""Voxels that positions along rays may count: up to here float32 holds them within 1/16 of a voxel, see `Viewpoint.reach`."""
Values: TypeAlias = NDArray[np.void]
"""The values of a block: one element of its dtype."""

Kind: TypeAlias = "type[np.float32 | np.int32] | Block | tuple[type[np.float32 | np.int32], int]"


class Block:
    """The fields of a block: numbers, arrays of numbers, and nested blocks; `name` is the type's in OpenCL C."""

    def __init__(self, name: str, **fields: Kind) -> None:
        self.name = name
        self.fields = fields or {"unused": INT}  # C has no empty struct
        members: list[Any] = [(key, kind.dtype if isinstance(kind, Block) else kind) for key, kind in self.fields.items()]
        self.dtype: np.dtype[np.void] = np.dtype(members)
        self._nested = {key: self.dtype.fields[key][1] for key, kind in self.fields.items() if isinstance(kind, Block)}  # type: ignore[index]

    def __call__(self, **values: ArrayLike) -> Values:
        """The block with a value for each field."""
        if values.keys() != self.fields.keys() and (values or "unused" not in self.fields):
            raise TypeError(f"{self.name} has the fields {', '.join(self.fields)}; got {', '.join(values)}")
        return self._with(bytearray(self.dtype.itemsize), values)

    def changed(self, values: Values, **changes: ArrayLike) -> Values:
        """A copy of values with others for some fields."""
        return self._with(bytearray(values.tobytes()), changes)

    def _with(self, content: bytearray, values: Mapping[str, ArrayLike]) -> Values:
        result: Values = np.ndarray((), self.dtype, content)
        for key, value in values.items():
            if key in self._nested:  # by bytes: NumPy would take 20 µs
                start, inner = self._nested[key], value.tobytes()  # type: ignore[union-attr]  # values of that block
                content[start : start + len(inner)] = inner
            else:
                result[key] = value
        return result

    def declaration(self) -> str:
        """The struct in OpenCL C, after those of its nested blocks, each once."""
        return "".join(self._structs().values())

    def _structs(self) -> dict[str, str]:
        parts: Sequence[Block] = [kind for kind in self.fields.values() if isinstance(kind, Block)]
        members = "\n".join(f"    {_member(key, kind)};" for key, kind in self.fields.items())
        nested = {name: text for part in parts for name, text in part._structs().items()}
        return nested | {self.name: f"typedef struct {{\n{members}\n}} {self.name};\n"}


def copied(values: Values) -> Values:
    """A copy of a block's values; NumPy takes 300 µs for those of many nested blocks."""
    return np.ndarray((), values.dtype, bytearray(values.tobytes()))


def _member(key: str, kind: Any) -> str:
    if isinstance(kind, Block):
        return f"{kind.name} {key}"
    base, count = kind if isinstance(kind, tuple) else (kind, 0)
    return f"{'int' if base is INT else 'float'} {key}" + (f"[{count}]" if count else "")
