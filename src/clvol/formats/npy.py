"""NumPy's own files: ``.npy`` holds samples only, ``.npz`` the whole volume."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from clvol.errors import DataError, FormatError
from clvol.formats._files import require_bytes, require_default
from clvol.interop import Content
from clvol.volume import Volume

__all__ = ["read", "read_archive", "write", "write_archive"]

_GEOMETRY = ("spacing", "origin", "direction", "units")


def read(path: Path) -> Content:
    """Samples of a ``.npy`` file, which knows no geometry."""
    with path.open("rb") as stream:
        return _read_array(stream, path.stat().st_size, path.name), {}


def write(volume: Volume, path: Path) -> None:
    """Write samples; a volume that has a place in the world is refused, it would lose it."""
    require_default(volume, _GEOMETRY, ".npz, .nrrd, .mha and .nii")
    with path.open("wb") as stream:
        np.save(stream, volume.data, allow_pickle=False)


def read_archive(path: Path) -> Content:
    """What `write_archive` wrote, or any archive with one array or an array ``data``."""
    with zipfile.ZipFile(path) as archive:
        members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}

        def array(name: str, kinds: str = "biuf") -> NDArray[Any]:
            with archive.open(members[name]) as stream:
                return _read_array(stream, members[name].file_size, f"{path.name}[{name}]", kinds)

        samples = [name for name in members if name not in _GEOMETRY]
        if "data" not in members and len(samples) != 1:
            raise FormatError(f"an archive must hold one array, or one named data; {path.name} holds {samples}")
        geometry: dict[str, Any] = {name: array(name) for name in ("spacing", "origin", "direction") if name in members}
        if "units" in members:
            geometry["units"] = str(array("units", "U"))
        return array("data" if "data" in members else samples[0]), geometry


def write_archive(volume: Volume, path: Path) -> None:
    """Write samples and geometry, bit for bit."""
    with path.open("wb") as stream:
        np.savez(
            stream,
            data=volume.data,
            spacing=volume.spacing,
            origin=volume.origin,
            direction=volume.direction,
            units=np.asarray(volume.units),
        )


def _read_array(stream: IO[bytes], size: int, source: str, kinds: str = "biuf") -> NDArray[Any]:
    """The array in `stream` of `size` bytes; nothing is allocated before the header has been believed."""
    version = np.lib.format.read_magic(stream)
    if version == (1, 0):
        shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
    elif version == (2, 0):
        shape, _, dtype = np.lib.format.read_array_header_2_0(stream)
    else:
        raise FormatError(f"{source} must be of version 1.0 or 2.0 of NumPy's format; got {version}")
    if dtype.kind not in kinds:  # objects are pickles, and reading a pickle runs code
        raise DataError(f"{source} must hold boolean, integer or floating samples; got dtype {dtype}")
    require_bytes(source, size - stream.tell(), shape, dtype, exact=True)
    stream.seek(0)
    return np.asarray(np.lib.format.read_array(stream, allow_pickle=False))
