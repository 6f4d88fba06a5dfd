"""Writing volumes to files."""

from __future__ import annotations

import os

from numpy.typing import ArrayLike

from clvol.base.checks import as_path, suggests_options
from clvol.base.errors import FormatError
from clvol.base.files import staged
from clvol.formats._errors import foreign_errors
from clvol.formats.table import WRITTEN, by_suffix
from clvol.volume.volume import Volume, as_volume
from clvol.volume.volumes import Volumes

__all__ = ["write"]


@suggests_options
def write(volume: Volume | Volumes | ArrayLike, path: str | os.PathLike[str]) -> None:
    """Write a volume (or image), or several on one grid, to a file.

    The file appears when it is complete: a failure leaves what was at `path`. Nothing is lost silently: what a format cannot hold
    is refused, except that boolean samples become uint8, and float16 float32, in formats without these types.

    Parameters
    ----------
    volume : Volume, Volumes or array-like
        What to write.
    path : path-like
        ``.npz``: everything, exactly. ``.nrrd .nhdr .mha .mhd``: samples and geometry, in mm. ``.nii .nii.gz``: the same, with
        geometry in float32 (NIfTI-2, in float64, where that would move a sample by more than a thousandth of a voxel), and
        `clim`, time step and other fields of `Volume.header`. ``.tif .tiff`` (OME): spacing and units, times, and channels with
        names and colours. ``.npy``: samples only.
        ``.nhdr`` and ``.mhd`` put the samples beside the header, into a ``.raw`` file.

    Raises
    ------
    FormatError
        No format with this suffix can be written, the format cannot hold the volume or the volumes, or writing failed.
    MissingDependencyError
        The format needs ``clvol[medical]`` or ``clvol[microscopy]``.

    Examples
    --------
    >>> import clvol, pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "ball.nii"
    >>> clvol.write(clvol.phantoms.sphere(16), path)
    >>> clvol.read(path).shape
    (16, 16, 16)
    """
    path = as_path(path)
    if isinstance(volume, Volumes) and len(volume) == 1:
        volume = volume[0]
    what = volume if isinstance(volume, Volumes) else as_volume(volume)
    chosen, suffix = by_suffix(path, written=True)
    if chosen.write is None:
        raise FormatError(
            f"cannot write {path}: {chosen.name} is only read; written are {' '.join(WRITTEN)}, of which .mhd or .nhdr puts raw "
            "samples beside a header that says how they are arranged"
        )
    with foreign_errors(f"write {path}"), staged(path, suffix) as file:
        chosen.write(what, file)
