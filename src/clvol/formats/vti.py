"""VTK's image data (``.vti``): arrays at the points or in the cells of a grid, by way of VTK's own reader."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.errors import DataError, FormatError, MissingDependencyError
from clvol.formats._choice import Choice, Series, chosen_series
from clvol.formats._files import sample_count
from clvol.formats._layout import lay_out
from clvol.formats._limits import announce
from clvol.interop import Content
from clvol.volumes import Leading

__all__ = ["read", "series"]

_PACKED = 7000  # bytes that one of the file may stand for: LZMA packs zeros so; VTK dies if memory ends
_TAIL = 1024  # bytes at the end of a file, among which XML ends
_ACTIVE = 1  # of the bits of FIELD_ACTIVE_ATTRIBUTE: the scalars that VTK's programs show


@dataclass(frozen=True)
class _Array:
    """One array of a file: at points or in cells, and whether VTK's programs show it."""

    kind: str
    name: str
    components: int
    dtype: str
    shape: tuple[int, ...]
    active: bool

    @property
    def series(self) -> Series:
        parts = (self.dtype, f"{self.components} components" * (self.components > 1), "in cells" * (self.kind == "Cell"))
        return Series(self.name, ", ".join(filter(None, parts)), self.shape)


def read(path: Path, choose: Choice, series: int | str | None = None) -> Content:
    """One array at the points, or in the cells: then samples lie at the cells' centres. Components are channels."""
    with _reader(path) as reader:
        arrays = _arrays(path, reader)
        listed = [array.series for array in arrays]
        active = sum(array.active for array in arrays)
        array = arrays[chosen_series(path.name, listed, series, what="arrays", first=active == 1)]
        for kind in ("Point", "Cell"):
            selection = getattr(reader, f"Get{kind}DataArraySelection")()
            selection.DisableAllArrays()
            if kind == array.kind:
                selection.EnableArray(array.name)
        announce(path.name, sample_count(array.shape) * array.components * np.dtype(array.dtype).itemsize)
        reader.Update()
        image = reader.GetOutput()
        found = getattr(image, f"Get{array.kind}Data")().GetArray(array.name)
        count = 0 if found is None else found.GetNumberOfTuples()
        if count != sample_count(array.shape):
            raise FormatError(
                f"{path.name} must hold {sample_count(array.shape)} samples in the array {array.name!r}; found {count}"
            )
    channels = found.GetNumberOfComponents()
    names = tuple(found.GetComponentName(i) or "" for i in range(channels))
    data = _numbers(found).reshape(*array.shape, channels)
    layout = lay_out(path.name, [*"zyx", "channel"], data.shape)
    leading = Leading(
        layout.leading,
        layout.counts,
        {"channel": names} if channels > 1 and all(names) else {},
        vector=channels in (2, 3) and data.dtype.kind == "f",
    )
    data, chosen = layout.chosen(path.name, choose, lambda index: data[index], data.dtype, leading)
    spacing, extent = np.array(image.GetSpacing()), np.array(image.GetExtent()).reshape(3, 2)
    matrix = image.GetDirectionMatrix()
    direction = np.array([[matrix.GetElement(i, j) for j in range(3)] for i in range(3)])
    first = extent[:, 0] + (0.5 * (extent[:, 1] > extent[:, 0]) if array.kind == "Cell" else 0.0)
    origin = np.array(image.GetOrigin()) + direction @ (first * spacing)
    return data, {"spacing": spacing, "origin": origin, "direction": direction, "name": array.name} | chosen


def series(path: Path) -> tuple[Series, ...]:
    """The arrays of a file, those at points before those in cells."""
    with _reader(path) as reader:
        return tuple(array.series for array in _arrays(path, reader))


@contextmanager
def _reader(path: Path) -> Iterator[Any]:
    """VTK's reader of a file whose header has been read. What it only tells the terminal, and then reads on, is raised."""
    try:
        from vtkmodules.vtkCommonCore import vtkLogger, vtkOutputWindow, vtkStringOutputWindow
        from vtkmodules.vtkIOXML import vtkXMLImageDataReader
    except ImportError as error:
        raise MissingDependencyError("VTK's files need vtk: pip install clvol[vtk]") from error
    with path.open("rb") as stream:  # VTK does not notice where raw samples end too early
        stream.seek(max(0, path.stat().st_size - _TAIL))
        if b"</VTKFile>" not in stream.read():
            raise FormatError(f"{path.name} must be a file of VTK's in XML; it is not, or cut short")
    window, heard, verbosity = vtkOutputWindow.GetInstance(), vtkStringOutputWindow(), vtkLogger.GetCurrentVerbosityCutoff()

    def check() -> None:
        told = re.findall(r"ERR\w*[|:] *(?:In [^\n]*\n)?(?:\w+ \(0x\w+\): )?([^\n]+)", heard.GetOutput())
        if told:
            raise FormatError(f"{path.name} is damaged, or no image data: {told[0][:200]}")

    vtkOutputWindow.SetInstance(heard)
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
    try:
        reader = vtkXMLImageDataReader()
        reader.SetFileName(str(path))
        if not reader.CanReadFile(str(path)):
            raise FormatError(f"{path.name} must be XML image data of VTK (ImageData); it is not, or damaged")
        reader.UpdateInformation()
        check()
        yield reader
        check()
    except FormatError:
        check()  # it tells the cause
        raise
    finally:
        vtkOutputWindow.SetInstance(window)
        vtkLogger.SetStderrVerbosity(verbosity)


def _arrays(path: Path, reader: Any) -> list[_Array]:
    """The arrays of numbers, those that are shown before others."""
    from vtkmodules.util.numpy_support import get_vtk_to_numpy_typemap
    from vtkmodules.vtkCommonDataModel import vtkDataObject
    from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline

    numbers = get_vtk_to_numpy_typemap()
    about = reader.GetOutputInformation(0)
    extent = about.Get(vtkStreamingDemandDrivenPipeline.WHOLE_EXTENT()) or (0, -1)
    points = [extent[i + 1] - extent[i] + 1 for i in (4, 2, 0)] if len(extent) == 6 else [0]
    if min(points) < 1:
        raise FormatError(f"{path.name} must hold at least one sample along each axis; its extent is {tuple(extent)}")
    found = []
    for kind, key in (("Point", vtkDataObject.POINT_DATA_VECTOR()), ("Cell", vtkDataObject.CELL_DATA_VECTOR())):
        vector = about.Get(key)
        shape = tuple(points if kind == "Point" else [max(1, n - 1) for n in points])
        for i in range(vector.GetNumberOfInformationObjects() if vector else 0):
            one = vector.GetInformationObject(i)
            name, number = one.Get(vtkDataObject.FIELD_NAME()), one.Get(vtkDataObject.FIELD_ARRAY_TYPE())
            if name in (None, "vtkGhostType") or number not in numbers:
                continue
            components = one.Get(vtkDataObject.FIELD_NUMBER_OF_COMPONENTS()) or 1
            active = bool(one.Get(vtkDataObject.FIELD_ACTIVE_ATTRIBUTE()) & _ACTIVE)
            dtype = np.dtype(numbers[number])
            bytes_ = sample_count(shape) * components * dtype.itemsize
            if bytes_ > _PACKED * path.stat().st_size:
                raise FormatError(f"{path.name} must hold {bytes_} bytes of samples in {name!r}; it has {path.stat().st_size}")
            found.append(_Array(kind, name, components, dtype.name, shape, active))
    if not found:
        raise DataError(f"{path.name} must hold an array of numbers; it holds none")
    return sorted(found, key=lambda array: not array.active)


def _numbers(array: Any) -> NDArray[Any]:
    from vtkmodules.util.numpy_support import vtk_to_numpy

    return np.array(vtk_to_numpy(array))  # a copy, which outlives the reader
