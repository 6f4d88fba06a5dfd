"""FreeSurfer's volumes (``.mgh``, ``.mgz``), by nibabel."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from clvol.base.errors import FormatError, GeometryError
from clvol.formats._choice import Choice
from clvol.formats._files import gunzipped_size, packed, require_bytes, sample_count, unpacked
from clvol.formats.guarded.limits import announce
from clvol.interop.kinds import Content
from clvol.interop.nibabel import describe_nibabel, nibabel
from clvol.volume.volumes import Leading

__all__ = ["read"]

_HEADER_BYTES = 284
_DTYPES = {0: "uint8", 1: "int32", 3: "float32", 4: "int16"}
_AFTER = 1 << 26  # most bytes after the samples, for FreeSurfer's scan parameters, commands and transforms


def read(path: Path, choose: Choice) -> Content:
    """Samples of the chosen volumes, and geometry, converted from FreeSurfer's RAS to ITK's LPS."""
    library = nibabel()
    _require_samples(path)
    with unpacked(path) as stream:
        with np.errstate(all="ignore"):  # `Volume` refuses a geometry that is not finite
            image = library.freesurfer.MGHImage.from_stream(stream)
            try:
                about = describe_nibabel(image)
            except GeometryError as error:
                raise GeometryError(f"{path}: {error}, from its delta and its direction cosines") from error
        pick = choose(path.name, Leading(**about.pop("leading", {})))
        shape = tuple(int(n) for n in image.shape[:3])
        data = np.asanyarray(image.dataobj[(..., *pick.index)] if pick.index else image.dataobj).reshape(*shape, -1, order="F").T
    data = data if any(isinstance(at, slice) for at in pick.index) else data[0]
    return pick.finish(data.astype(data.dtype.newbyteorder("="))), about | pick.about


def _require_samples(path: Path) -> None:
    """Raise if samples are missing, before memory is allocated for them; nibabel reads beyond their end."""
    with unpacked(path) as stream:
        head = stream.read(_HEADER_BYTES)
    if len(head) < _HEADER_BYTES:
        raise FormatError(f"{path.name} must begin with a header of {_HEADER_BYTES} bytes; found {len(head)}")
    version, *shape, code = struct.unpack(">6i", head[:24])
    if version != 1 or min(shape) < 1:
        raise FormatError(
            f"{path.name} must be of version 1, with axes of at least one sample; its header says version {version}, {shape}"
        )
    if code not in _DTYPES:
        raise FormatError(f"{path.name} must have samples of type {', '.join(_DTYPES.values())}; its header says type {code}")
    found, expected = path.stat().st_size, _HEADER_BYTES + sample_count(shape) * np.dtype(_DTYPES[code]).itemsize
    announce(path.name, expected)
    if packed(path):
        with path.open("rb") as stream:
            found = gunzipped_size(stream, expected + _AFTER)
    require_bytes(path.name, max(0, found - _HEADER_BYTES), shape, _DTYPES[code])
