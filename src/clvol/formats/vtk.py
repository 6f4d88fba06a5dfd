"""VTK's legacy files (``.vtk``) of structured points: arrays at the points or in the cells of a grid.

VTK's own reader fills up a text that was cut short, and says nothing. This one follows "VTK File Formats" in VTK's documentation.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import DataError, FormatError
from clvol.bricks.sliced import FlatFile, Window
from clvol.formats._choice import Choice, Series, chosen_series
from clvol.formats._files import require_bytes, sample_count
from clvol.formats._headers import numbers, parsed, whole
from clvol.formats._layout import Layout
from clvol.formats.guarded.limits import announce
from clvol.interop.kinds import Content

__all__ = ["is_file", "lazily", "read", "series"]

_MAGIC = b"# vtk DataFile"
_LINE, _AT_ONCE = 1 << 12, 1 << 26  # bytes of a line between arrays, and of numbers
_SIZES = {"i1": "char signed_char", "i2": "short", "i4": "int vtkIdType", "i8": "long vtktypeint64", "f4": "float", "f8": "double"}
_SIZES |= {"u1": "unsigned_char", "u2": "unsigned_short", "u4": "unsigned_int", "u8": "unsigned_long vtktypeuint64"}
_DTYPES = {name.lower(): np.dtype(kind) for kind, names in _SIZES.items() for name in names.split()}
_DTYPES["bit"] = np.dtype(bool)
_COMPONENTS = {"VECTORS": 3, "NORMALS": 3, "TENSORS": 9, "TENSORS6": 6, "GLOBAL_IDS": 1, "PEDIGREE_IDS": 1, "EDGE_FLAGS": 1}


@dataclass(frozen=True)
class _Array:
    """An array: its numbers, of a text; or their first byte in the file."""

    name: str
    cells: bool
    scalars: bool
    shape: tuple[int, ...]  # z, y, x, components
    dtype: np.dtype[Any]
    samples: NDArray[Any] | int

    @property
    def series(self) -> Series:
        n = self.shape[-1]
        words = (self.dtype.name, f"{n} components" * (n > 1), "in cells" * self.cells)
        return Series(self.name, ", ".join(filter(None, words)), self.shape[:3])


def is_file(path: Path) -> bool:
    """Whether a file says that it is of VTK's legacy format."""
    with path.open("rb") as stream:
        return stream.read(len(_MAGIC)) == _MAGIC


def read(path: Path, choose: Choice, series: int | str | None = None) -> Content:
    """One array at points or in cells, with samples at the cells' centres. Components are channels."""
    array, data, about = _content(path, choose, series)
    if isinstance(array.samples, int):
        announce(path.name, sample_count(data.shape) * data.dtype.itemsize)
    return data[...], about


def lazily(path: Path, choose: Choice, series: int | str | None = None) -> list[Content]:
    """As `read`, but samples are read on demand; empty if they are text."""
    array, data, about = _content(path, choose, series)
    return [(data, about)] if isinstance(array.samples, int) else []


def series(path: Path) -> tuple[Series, ...]:
    """The arrays of a file, that which VTK shows first."""
    return tuple(array.series for array in _File(path).arrays)


def _content(path: Path, choose: Choice, series: int | str | None) -> tuple[_Array, Any, dict[str, Any]]:
    """The chosen array, what was chosen of it, and arguments of `Volume`."""
    file = _File(path)
    if not file.arrays:
        raise DataError(f"{path.name} must hold an array of numbers at its points or in its cells; it holds none")
    listed, active = [array.series for array in file.arrays], sum(array.scalars for array in file.arrays)
    array = file.arrays[chosen_series(path.name, listed, series, what="arrays", first=active == 1)]
    shape, stored = array.shape, array.dtype.newbyteorder(">")
    layout = Layout(("z", "y", "x", "channel" if shape[-1] > 1 else ""), shape)
    samples = array.samples
    source: Any = FlatFile(path, shape, stored, samples) if isinstance(samples, int) else samples.reshape(shape).__getitem__
    data, known = layout.chosen(
        path.name, choose, lambda index: Window(source, shape, array.dtype, None, index), layout.channels_of(array.dtype)
    )
    middle = 0.5 * (np.array(file.size) > 1) if array.cells else np.zeros(3)
    about = {"spacing": file.spacing, "origin": np.add(file.origin, middle * file.spacing), "name": array.name}
    return array, data, about | known


@dataclass
class _File:
    """The contents of a file, read from its first line to its last."""

    path: Path
    size: tuple[int, ...] = ()  # points along x, y and z
    spacing: tuple[float, ...] = (1.0, 1.0, 1.0)
    origin: tuple[float, ...] = (0.0, 0.0, 0.0)
    arrays: list[_Array] = field(default_factory=list)
    _binary: bool = False
    _cells: bool | None = None  # whether arrays are those of cells; None before any

    def __post_init__(self) -> None:
        self._end = self.path.stat().st_size
        with self.path.open("rb") as stream:
            self._read_head(stream)
            while words := self._words(stream):
                self._read_part(stream, words[0].upper(), words[1:])
        self.arrays.sort(key=lambda array: not array.scalars)

    def _words(self, stream: IO[bytes]) -> list[str]:
        """The words of the next line that has some, without metadata, which an empty line ends; none at the end."""
        while text := stream.readline(_LINE):
            words = text.decode("latin-1").split()
            if words and words[0].upper() == "METADATA":
                while stream.readline(_LINE).strip():
                    pass
            elif words:
                return words
        return []

    def _read_head(self, stream: IO[bytes]) -> None:
        if not stream.readline(_LINE).startswith(_MAGIC):
            raise FormatError(f"{self.path.name} must begin with '# vtk DataFile'; it does not")
        stream.readline(_LINE)  # a title
        form, kind = " ".join(self._words(stream)).upper(), " ".join(self._words(stream)).upper()
        if form not in ("ASCII", "BINARY") or not kind.startswith("DATASET "):
            raise FormatError(f"{self.path.name} must say ASCII or BINARY, then DATASET; it says {form[:80]!r}, {kind[:80]!r}")
        self._binary = form == "BINARY"
        if kind != "DATASET STRUCTURED_POINTS":
            raise DataError(
                f"{self.path.name} must be a DATASET STRUCTURED_POINTS, a uniform grid; it is a {kind[:80]}: "
                "clvol.Volume(pyvista.ImageData(...).sample(pyvista.read(path))) takes its values at the points of an image"
            )

    def _read_part(self, stream: IO[bytes], key: str, words: list[str]) -> None:
        """Read what a line begins."""
        name, text = self.path.name, " ".join(words)
        if key == "DIMENSIONS":
            self.size = whole(name, key, text, 1, 3)
        elif key in ("SPACING", "ASPECT_RATIO"):
            self.spacing = numbers(name, key, text, 3)
        elif key == "ORIGIN":
            self.origin = numbers(name, key, text, 3)
        elif key in ("POINT_DATA", "CELL_DATA") and self.size:
            self._cells = key == "CELL_DATA"
            if whole(name, key, text, 0) != (sample_count(self._shape),):
                raise FormatError(f"{name} must have {key} for {sample_count(self._shape)} samples; it says {text[:80]}")
        elif key == "FIELD" and len(words) == 2:
            for _ in range(*whole(name, key, words[1], 0)):
                self._read_field(stream, self._words(stream))
        elif key == "LOOKUP_TABLE" and len(words) == 2:  # of colours
            self._numbers(stream, 4 * whole(name, key, words[1], 1)[0], np.dtype("u1" if self._binary else "f8"))
        elif self._cells is not None and len(words) >= 2:
            self._read_attribute(stream, key, words)
        else:
            raise FormatError(f"{name} must have DIMENSIONS, then arrays of POINT_DATA or CELL_DATA; found {key} {text}"[:200])

    @property
    def _shape(self) -> tuple[int, ...]:
        return tuple(max(1, n - 1) if self._cells else n for n in self.size[::-1])

    def _read_field(self, stream: IO[bytes], words: list[str]) -> None:
        if len(words) != 4:
            raise FormatError(
                f"{self.path.name} must have fields of a name, two numbers and a type; found {' '.join(words)[:80]!r}"
            )
        components, tuples = whole(self.path.name, words[0], " ".join(words[1:3]), 0, 2)
        if words[3].lower() == "string":
            self._skip_strings(stream, components * tuples)
            return
        dtype = self._dtype(words[0], words[3])
        samples = self._numbers(stream, components * tuples, dtype)
        if self._cells is not None and components:
            if tuples != sample_count(self._shape):
                raise FormatError(f"{self.path.name} must hold {sample_count(self._shape)} samples of {words[0]}; it has {tuples}")
            self._add(words[0], components, dtype, samples)

    def _read_attribute(self, stream: IO[bytes], key: str, words: list[str]) -> None:
        """Read an array at points or in cells."""
        name = self.path.name
        if key == "COLOR_SCALARS":
            components, dtype = whole(name, key, words[1], 1)[0], np.dtype("u1" if self._binary else "f8")
        elif key == "TEXTURE_COORDINATES" and len(words) == 3:
            components, dtype = whole(name, key, words[1], 1)[0], self._dtype(words[0], words[2])
        elif key == "SCALARS":
            components, dtype = whole(name, key, words[2] if len(words) > 2 else "1", 1)[0], self._dtype(words[0], words[1])
            if (table := self._words(stream)) and table[0].upper() != "LOOKUP_TABLE":
                raise FormatError(f"{name} must name a LOOKUP_TABLE before the numbers of {words[0]}; got {' '.join(table)[:80]!r}")
        elif key in _COMPONENTS:
            components, dtype = _COMPONENTS[key], self._dtype(words[0], words[1])
        else:
            raise FormatError(f"{name} must have arrays of SCALARS, VECTORS, FIELD and other attributes of VTK; got {key[:80]!r}")
        samples = self._numbers(stream, components * sample_count(self._shape), dtype)
        if key == "COLOR_SCALARS" and not isinstance(samples, int):  # from 0 to 1
            dtype, samples = np.dtype("u1"), np.floor(255 * np.clip(samples, 0, 1) + 0.5).astype("u1")
        self._add(words[0], components, dtype, samples, key in ("SCALARS", "COLOR_SCALARS"))

    def _add(self, name: str, components: int, dtype: np.dtype[Any], samples: NDArray[Any] | int, scalars: bool = False) -> None:
        first = scalars and not any(array.scalars and array.cells == self._cells for array in self.arrays)
        self.arrays.append(_Array(unquote(name), bool(self._cells), first, (*self._shape, components), dtype, samples))

    def _dtype(self, name: str, text: str) -> np.dtype[Any]:
        if text.lower() not in _DTYPES:
            raise FormatError(
                f"{self.path.name} must hold arrays of {', '.join(_DTYPES)}; {name} is of {text[:80]!r}: "
                "clvol.Volume(pyvista.read(path)) reads the others"
            )
        return _DTYPES[text.lower()]

    def _skip_strings(self, stream: IO[bytes], count: int) -> None:
        """Pass over strings: lines of a text; or bytes behind their number, whose first two bits say how many bytes it has."""
        require_bytes(self.path.name, self._end - stream.tell(), (count,), np.dtype("u1"))
        for _ in range(count):
            if not self._binary:
                while (text := stream.readline(_LINE)) and not text.endswith(b"\n"):
                    pass
                continue
            first = stream.read(1)
            more = (7, 3, 1, 0)[first[0] >> 6] if first else 0
            length = int.from_bytes(bytes([first[0] & 63]) + stream.read(more), "big") if first else 1
            require_bytes(self.path.name, self._end - stream.tell(), (length,), np.dtype("u1"))
            stream.seek(length, 1)

    def _numbers(self, stream: IO[bytes], count: int, dtype: np.dtype[Any]) -> NDArray[Any] | int:
        """The next numbers, or their first byte; the stream is behind them then."""
        if dtype.kind == "b":  # eight to a byte
            bits = self._numbers(stream, -(-count // 8) if self._binary else count, np.dtype("u1"))
            if not isinstance(bits, int):
                return bits.astype(bool)
            packed = np.fromfile(self.path, np.uint8, -(-count // 8), offset=bits)
            return np.unpackbits(packed, count=count).astype(bool)
        name, start = self.path.name, stream.tell()
        require_bytes(name, self._end - start, (count,), dtype if self._binary else "u1")
        if self._binary:
            stream.seek(start + count * dtype.itemsize)
            return start
        announce(name, count * (dtype.itemsize + 8))
        lines: list[bytes] = []
        found = 0
        while found < count and (text := stream.readline(_AT_ONCE)):
            lines.append(text)
            found += len(text.split())
        return parsed(name, "the lines of an array", b"".join(lines), dtype, count)
