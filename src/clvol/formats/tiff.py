"""TIFF stacks from microscopes: OME and ImageJ are read, OME is written; by way of tifffile."""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from clvol.errors import DataError, FormatError, MissingDependencyError
from clvol.formats._files import require_default, sample_count, storable
from clvol.formats._units import METRES, scale, unit_name
from clvol.interop import Content
from clvol.volume import Volume

__all__ = ["read", "write"]

_DTYPES = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "float32", "float64")  # those of OME
_OME_NAMES = {"": "pixel", "um": "µm", "inch": "in"}


def read(path: Path) -> Content:
    """Samples, and the spacing of an OME or ImageJ file.

    A plain TIFF file has spacing 1: its resolution is meant for printing, and there is none along z.
    """
    tifffile = _tifffile()
    with _strict(), tifffile.TiffFile(path) as file:
        if len(file.series) != 1:
            raise DataError(f"{path.name} must hold one volume; it holds {[s.shape for s in file.series]}")
        series = file.series[0]
        spacing, units = [1.0, 1.0, 1.0], ""
        deep = False
        if file.is_ome:
            spacing, units, deep = _ome(file.ome_metadata)
        elif file.is_imagej:
            spacing, units = _imagej(file)
        shape = _stack_shape(path.name, series, deep)
        _check_samples(path.name, series)
        data = series.asarray().reshape(shape)
    if data.dtype.kind not in "biuf":
        raise DataError(f"{path.name} must hold real numbers; got dtype {data.dtype}")
    return data, {"spacing": spacing[: data.ndim], "units": units}


def write(volume: Volume, path: Path) -> None:
    """Write samples, spacing and units exactly, as OME-TIFF; it has no place for origin and direction."""
    require_default(volume, ("origin", "direction"), ".nrrd, .mha, .nii and .npz")
    name = unit_name(volume.units)
    if name and name not in METRES:
        raise FormatError(f"OME-TIFF must have a unit of {', '.join(METRES)}; got {volume.units!r}: .npz holds any")
    unit = _OME_NAMES.get(name, name)
    metadata: dict[str, Any] = {"axes": "ZYX"[3 - volume.ndim :]}
    for axis, spacing in zip("XYZ", volume.spacing, strict=False):  # Z only for volumes: thus an image stays an image
        metadata |= {f"PhysicalSize{axis}": spacing, f"PhysicalSize{axis}Unit": unit}
    # Without the photometric a stack of three or four slices would be taken for colours.
    _tifffile().imwrite(path, storable(volume.data, _DTYPES), ome=True, photometric="minisblack", metadata=metadata)


def _tifffile() -> Any:
    try:
        import tifffile
    except ImportError as error:
        raise MissingDependencyError("TIFF files need tifffile: pip install clvol[microscopy]") from error
    return tifffile


@contextmanager
def _strict() -> Iterator[None]:
    """Raise what tifffile only logs: it reads on past damage, and leaves out slices or zeroes them."""
    errors: list[FormatError] = []
    thread = threading.get_ident()

    class Raiser(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if record.thread in (thread, None):  # other threads may read other files
                errors.append(
                    FormatError(
                        f"the file is damaged or unusual: {record.getMessage()}; "
                        "if you trust what tifffile makes of it, give its array to clvol.Volume"
                    )
                )
                raise errors[0]

    logger, raiser = logging.getLogger("tifffile"), Raiser(logging.WARNING)
    level = logger.level
    logger.addHandler(raiser)
    logger.setLevel(logging.WARNING)  # even where the caller keeps tifffile silent
    try:
        yield
    finally:
        logger.setLevel(level)
        logger.removeHandler(raiser)
    if errors:  # and tifffile caught it
        raise errors[0]


def _stack_shape(name: str, series: Any, deep: bool) -> tuple[int, ...]:
    """The shape [z, y, x] or [y, x] of a series; slices may be named Z, or not be named at all (I, Q)."""
    axes, counts = series.get_axes(squeeze=False), series.get_shape(squeeze=False)
    if "Y" not in axes or "X" not in axes:
        raise DataError(f"{name} must hold an image or a stack; its axes are {axes}")
    kept = [(axis, n) for axis, n in zip(axes, counts, strict=True) if n > 1 or axis in "YX" or (axis == "Z" and deep)]
    found = "".join(axis for axis, _ in kept)
    if found not in ("YX", "ZYX", "QYX", "IYX"):
        raise DataError(
            f"{name} must hold one stack of slices with one value a sample; its axes are {found} with "
            f"{[n for _, n in kept]} samples (S, C: channels, T: time): write one channel of one time"
        )
    return tuple(int(n) for _, n in kept)


def _check_samples(name: str, series: Any) -> None:
    """Raise if samples lie past the end of the file, or a slice is missing: tifffile would give zeros."""
    lengths = {}
    for page in series.pages:
        if page is None:
            raise FormatError(f"{name} must hold all of its slices; some are missing")
        lengths[page.parent.filehandle.path] = page.parent.filehandle.size
        length = page.parent.filehandle.size
        ends = [start + count for start, count in zip(page.dataoffsets, page.databytecounts, strict=True)]
        if not ends or max(ends) > length or min(page.databytecounts) < 1:
            raise FormatError(f"{name} must hold the samples of every slice; some lie past the end of the file")
    if series.keyframe.compression == 1:  # checked before memory is allocated
        bits = sample_count(series.shape) * series.keyframe.bitspersample
        if bits > sum(lengths.values()) * 8:
            raise FormatError(f"{name} must hold {bits // 8} bytes of samples; found {sum(lengths.values())}")


def _ome(description: str) -> tuple[list[float], str, bool]:
    """Spacing and unit of OME-XML, and whether it gives a distance of slices. NaN: the file does not say."""
    elements = ET.fromstring(description).iter()
    pixels = next((element for element in elements if element.tag.rpartition("}")[2] == "Pixels"), None)
    if pixels is None:
        raise FormatError("OME-XML must have an element Pixels; it has none")
    sizes = [pixels.get(f"PhysicalSize{axis}") for axis in "XYZ"]
    if not any(sizes):
        return [1.0, 1.0, 1.0], "", False
    units = [unit_name(pixels.get(f"PhysicalSize{axis}Unit", "µm")) for axis in "XYZ"]
    spacing = [float(size) * scale(unit, units[0]) if size else math.nan for size, unit in zip(sizes, units, strict=True)]
    return spacing, units[0], bool(sizes[2])


def _imagej(file: Any) -> tuple[list[float], str]:
    """Spacing and unit of an ImageJ file: samples a unit in the tags of TIFF, slices in ImageJ's own text."""
    metadata, tags = file.imagej_metadata or {}, file.pages.first.tags
    in_plane = []
    for tag in ("XResolution", "YResolution"):
        samples, unit = tags[tag].value if tag in tags else (1, 1)
        in_plane.append(unit / samples if samples else math.nan)
    return [*in_plane, abs(float(metadata.get("spacing", 1.0)))], unit_name(str(metadata.get("unit", "")))
