"""netCDF-3, the classic format of netCDF, by SciPy; netCDF-4 is HDF5."""

from __future__ import annotations

import io
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import DataError, FormatError
from clvol.bricks.sliced import FlatFile, Index, Window
from clvol.formats._choice import Choice, Series, chosen_series
from clvol.formats._files import bytes_at
from clvol.formats._layout import Layout, Lines, by_names, decoded
from clvol.formats.guarded.limits import announce
from clvol.interop.kinds import Content

__all__ = ["Variable", "is_file", "lazily", "read", "series", "variables_of"]

_MAGIC = b"CDF"
_VERSIONS = (b"\1", b"\2")  # with offsets of 32 bits, and of 64


@dataclass(frozen=True)
class Variable:
    """An array in a file: the meaning of its axes, and where its samples lie."""

    name: str
    dimensions: tuple[str, ...]
    shape: tuple[int, ...]
    dtype: np.dtype[Any]  # as stored
    attrs: Mapping[str, Any]
    path: Path
    offsets: tuple[int, ...]  # of the first byte; of each record, where these are interleaved with those of others

    @property
    def ndim(self) -> int:
        """Axes."""
        return len(self.shape)

    def window(self, index: Index = ()) -> Window:
        """Samples at an index, read on demand."""
        return Window(self._flat(self.shape), self.shape, self.dtype, None, index)

    def loaded(self, index: Index = ()) -> NDArray[Any]:
        """Samples at an index."""
        announce(self.path.name, bytes_at(self.shape, index, self.dtype))
        return self.window(index)[...] if self.shape else self._flat((1,))((slice(1),)).reshape(())

    def _flat(self, shape: tuple[int, ...]) -> FlatFile:
        return FlatFile(self.path, shape, self.dtype, self.offsets if len(self.offsets) > 1 else self.offsets[0])


def is_file(path: Path) -> bool:
    """Whether a file has the signature of netCDF-3."""
    with path.open("rb") as stream:
        return stream.read(3) == _MAGIC


def read(path: Path, choose: Choice, series: int | str | None = None) -> Content:
    """The chosen volumes of one array, by the rules of netCDF-4: the only one with three axes or more, else with two."""
    return _content(path, choose, series, Variable.loaded)


def lazily(path: Path, choose: Choice, series: int | str | None = None) -> list[Content]:
    """As `read`, but samples are read on demand."""
    return [_content(path, choose, series, Variable.window)]


def series(path: Path) -> tuple[Series, ...]:
    """The arrays of numbers with two axes or more; those with two come last."""
    return tuple(_listed(array) for array in _arrays(variables_of(path)))


def _content(path: Path, choose: Choice, series: int | str | None, load: Any) -> Content:
    variables = variables_of(path)
    arrays = _arrays(variables)
    if not arrays:
        raise DataError(f"{path.name} must hold an array of numbers with two axes or more; it holds none")
    deep = sum(array.ndim > 2 for array in arrays)
    listed = [_listed(array) for array in arrays]
    array = arrays[chosen_series(path.name, listed, series, what="arrays", main=deep or None, first=False)]
    scales = [variables.get(name) for name in array.dimensions]
    scales = [scale if scale is not None and scale.shape == (n,) else None for scale, n in zip(scales, array.shape, strict=True)]
    words = [str(scale.attrs.get("axis", name)) if scale else name for scale, name in zip(scales, array.dimensions, strict=True)]
    units = [str(scale.attrs.get("units", "")) if scale else "" for scale in scales]

    def lines_of(layout: Layout) -> Lines:
        lines = {}
        for axis, scale in zip(layout.axes, scales, strict=True):
            if scale is not None:
                lines[axis] = decoded(scale.loaded(), scale.attrs)
        return lines, {axis: units[i] for i, axis in enumerate(layout.axes) if scales[i]}

    data, known = by_names(path.name, words, array, choose, lambda _, array, index: load(array, index), lines_of)
    space = {"space": "image"} if "um" in units else {}
    return data, {"name": array.name} | space | known


def _arrays(variables: Mapping[str, Variable]) -> list[Variable]:
    found = [one for one in variables.values() if one.ndim > 1 and one.dtype.kind in "biuf" and 0 not in one.shape]
    return sorted(found, key=lambda one: one.ndim == 2)


def _listed(array: Variable) -> Series:
    return Series(array.name, array.dtype.name, array.shape)


class _Bounded(io.FileIO):
    """A file of which no more is read than there is: a length in a damaged header would be allocated."""

    def read(self, size: int | None = -1, /) -> bytes:
        """The next bytes."""
        if size is None or not 0 <= size <= os.fstat(self.fileno()).st_size:
            raise FormatError(f"a header must give lengths within its file; one is {size}")
        return super().read(size) or b""


def variables_of(path: Path) -> dict[str, Variable]:
    """All arrays of a file, from its header."""
    from scipy.io import netcdf_file

    with path.open("rb") as stream:
        magic = stream.read(4)
    if magic[3:] not in _VERSIONS:
        raise FormatError(
            f"{path.name} must be of netCDF-3 with offsets of 32 or 64 bits (CDF-1, CDF-2); it begins with {magic!r}: "
            "nccopy -k nc4 makes HDF5 of it"
        )
    with _Bounded(path) as whole, netcdf_file(whole, "r", mmap=True, maskandscale=False) as file:
        return {name: _variable(path, name, variable) for name, variable in file.variables.items()}


def _variable(path: Path, name: str, variable: Any) -> Variable:
    """What the header says of an array, whose samples are mapped."""
    data = variable.data
    root = data
    while isinstance(root.base, np.ndarray):
        root = root.base
    start = data.ctypes.data - root.ctypes.data
    records = len(data) if variable.isrec else 1
    offsets = tuple(start + n * data.strides[0] for n in range(records)) if records > 1 else (start,)
    attrs = {key: value.decode("latin-1") if isinstance(value, bytes) else value for key, value in variable._attributes.items()}
    return Variable(name, tuple(variable.dimensions), tuple(map(int, data.shape)), data.dtype, attrs, path, offsets)
