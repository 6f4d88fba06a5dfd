"""NumPy's files: ``.npy`` holds samples only, ``.npz`` a whole volume."""

from __future__ import annotations

import json
import re
import zipfile
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.checks import if_image
from clvol.base.errors import DataError, FormatError
from clvol.base.files import MAX_HEADER
from clvol.bricks.sliced import FlatFile, Window
from clvol.formats._choice import Choice
from clvol.formats._files import require_bytes, require_default, require_members, unplaced_by
from clvol.formats._layout import lay_out, unnamed
from clvol.formats.guarded.limits import announce
from clvol.interop.kinds import Content
from clvol.volume.label_table import LabelTable
from clvol.volume.volume import Volume
from clvol.volume.volumes import Leading, Volumes

__all__ = ["lazily", "read", "read_archive", "write", "write_archive"]

_GEOMETRY = ("spacing", "origin", "direction", "units")
_ABOUT = ("space", "name", "color", "clim", "labels", "header")  # other attributes, as JSON
_OWN = (*_GEOMETRY, "about", "leading")


def read(path: Path, choose: Choice) -> Content:
    """Samples of a ``.npy`` file, which has no geometry."""
    with path.open("rb") as stream:
        return _chosen(_read_array(stream, path.stat().st_size, path.name), None, {}, path.name, choose)


def lazily(path: Path, choose: Choice) -> list[Content]:
    """As `read`, but samples are read on demand."""
    with path.open("rb") as stream:
        shape, transposed, dtype = _header(stream, path.stat().st_size, path.name)
        flat = FlatFile(path, shape, dtype, stream.tell(), transposed)
    words = unnamed(shape, dtype) if len(shape) > 3 else [""] * len(shape)
    if len(shape) < 3 or 0 in shape:
        raise DataError(f"{path.name} must hold a volume to be read part by part; it has the shape {shape}{if_image(shape)}")
    layout = lay_out(path.name, words, shape, asked=choose.given)
    return [layout.chosen(path.name, choose, lambda index: Window(flat, shape, dtype, None, index))]


def write(what: Volume | Volumes, path: Path) -> None:
    """Write samples; a volume with a geometry is refused, for it would be lost."""
    require_default(what.grid if isinstance(what, Volumes) else what, _GEOMETRY, ".npz, .nrrd, .mha and .nii")
    with path.open("wb") as stream:
        np.save(stream, np.asarray(what), allow_pickle=False)


def read_archive(path: Path, choose: Choice) -> Content:
    """An archive that `write_archive` wrote, or any with one array or an array ``data``."""
    with zipfile.ZipFile(path) as archive:
        require_members(path.name, archive)
        members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}

        def array(name: str, kinds: str = "biuf") -> NDArray[Any]:
            with archive.open(members[name]) as stream:
                return _read_array(stream, members[name].file_size, f"{path.name}[{name}]", kinds)

        samples = [name for name in members if name not in _OWN]
        if "data" not in members and len(samples) != 1:
            raise FormatError(f"an archive must hold one array, or one named data; {path.name} holds {samples}")
        geometry: dict[str, Any] = {name: array(name) for name in ("spacing", "origin", "direction") if name in members}
        geometry |= unplaced_by("its member spacing", geometry.get("spacing", 1.0))
        if "units" in members:
            geometry["units"] = str(array("units", "U"))
        if "about" in members:
            said = json.loads(str(array("about", "U")))
            geometry |= {name: said[name] for name in _ABOUT if name in said}
            if isinstance(named := geometry.get("labels"), dict):  # the keys of JSON are strings
                geometry["labels"] = {int(label): row for label, row in named.items()}
        leading = None
        if "leading" in members:
            said = json.loads(str(array("leading", "U")))
            leading = Leading(**{name: _tuples(value) for name, value in said.items()})
        return _chosen(array("data" if "data" in members else samples[0]), leading, geometry, path.name, choose)


def write_archive(what: Volume | Volumes, path: Path) -> None:
    """Write samples and geometry bit for bit, and other attributes as JSON."""
    volume = what.grid if isinstance(what, Volumes) else what
    said = {name: value for name in _ABOUT if (value := getattr(volume, name)) or value is False}
    arrays: dict[str, Any] = {name: getattr(volume, name) for name in _GEOMETRY} | {"about": json.dumps(said, default=_plain)}
    if isinstance(what, Volumes):
        arrays["leading"] = json.dumps(asdict(what.leading))
    with path.open("wb") as stream:
        np.savez(stream, data=np.asarray(what), **arrays)


def _plain(value: object) -> object:
    """An object of a header, or a table of labels, as JSON can hold it."""
    if isinstance(value, LabelTable):
        return value.rows
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else str(value)


def _tuples(value: Any) -> Any:
    """Lists of JSON as tuples."""
    if isinstance(value, Mapping):
        return {name: _tuples(part) for name, part in value.items()}
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def _chosen(data: NDArray[Any], leading: Leading | None, about: dict[str, Any], name: str, choose: Choice) -> Content:
    """The chosen volumes of an array; the meaning of four and more axes is guessed if it is unknown."""
    if leading is None and data.ndim > 3 and 0 not in data.shape:
        samples, known = lay_out(name, unnamed(data.shape, data.dtype), data.shape, asked=choose.given).chosen(
            name, choose, data.__getitem__
        )
        return samples, about | known
    pick = choose(name, leading or Leading())
    return pick.finish(data[pick.index]), about | pick.about


def _read_array(stream: IO[bytes], size: int, source: str, kinds: str = "biuf") -> NDArray[Any]:
    """The array in `stream` of `size` bytes; its header is checked before memory is allocated."""
    _header(stream, size, source, kinds)
    announce(source, size)
    stream.seek(0)
    return np.asarray(np.lib.format.read_array(stream, allow_pickle=False))


def _header(stream: IO[bytes], size: int, source: str, kinds: str = "biuf") -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, whether in Fortran order, and dtype; leaves the stream at the first sample."""
    version = np.lib.format.read_magic(stream)
    at = stream.tell()
    length = int.from_bytes(stream.read(2 if version == (1, 0) else 4), "little")
    if length > MAX_HEADER:
        raise FormatError(f"{source} must have a header of up to {MAX_HEADER} bytes")
    if found := re.search(rb"\\|'descr': '[<>|=]?a\d*'", stream.read(length)):  # deprecated in NumPy
        raise FormatError(f"{source} must have a header as NumPy writes it; found {found[0]!r}")
    stream.seek(at)
    if version == (1, 0):
        shape, transposed, dtype = np.lib.format.read_array_header_1_0(stream)
    elif version == (2, 0):
        shape, transposed, dtype = np.lib.format.read_array_header_2_0(stream)
    else:
        raise FormatError(f"{source} must be of version 1.0 or 2.0 of NumPy's format; got {version}")
    if dtype.kind not in kinds:  # objects are pickles, and reading a pickle runs code
        raise DataError(f"{source} must hold boolean, integer or floating samples; got dtype {dtype}")
    require_bytes(source, size - stream.tell(), shape, dtype, exact=True)
    return tuple(shape), bool(transposed), dtype
