"""FreeSurfer's volumes (``.mgh``, ``.mgz``), by way of nibabel."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from clvol.errors import FormatError
from clvol.foreign import Content, nibabel, nibabel_says
from clvol.formats._choice import Choice
from clvol.formats._files import gunzipped_size, require_bytes
from clvol.volumes import Leading

__all__ = ["read"]

_HEADER_BYTES = 284


def read(path: Path, choose: Choice) -> Content:
    """Samples of what is chosen, and geometry, turned from FreeSurfer's RAS to ITK's LPS."""
    image = nibabel().freesurfer.MGHImage.from_filename(path)
    _require_samples(path, image)
    about = nibabel_says(image)
    pick = choose(path.name, Leading(**about.pop("leading", {})))
    shape = tuple(int(n) for n in image.shape[:3])
    data = np.asanyarray(image.dataobj[(..., *pick.index)] if pick.index else image.dataobj).reshape(*shape, -1, order="F").T
    data = data if any(isinstance(at, slice) for at in pick.index) else data[0]
    return pick.finish(data.astype(data.dtype.newbyteorder("="))), about | pick.about


def _require_samples(path: Path, image: object) -> None:
    """Raise before memory is asked for that the samples do not fill."""
    shape, kind = tuple(int(n) for n in image.shape), image.get_data_dtype()  # type: ignore[attr-defined]  # nibabel's
    if min(shape) < 1:
        raise FormatError(f"{path.name} must have axes of at least one sample; its header says {shape}")
    found = path.stat().st_size
    if path.suffix.lower() == ".mgz":
        with path.open("rb") as stream:
            found = gunzipped_size(stream, _HEADER_BYTES + int(np.prod(shape, dtype=object)) * kind.itemsize)
    require_bytes(path.name, max(0, found - _HEADER_BYTES), shape, kind)
