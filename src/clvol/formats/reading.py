"""Reading volumes: one of a file, or all of them."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn, TypeAlias

from numpy.typing import ArrayLike, DTypeLike

from clvol.base.checks import as_path, suggests_options
from clvol.base.errors import ClvolError, DataError, GeometryError, OptionError
from clvol.base.memory import available
from clvol.formats._choice import Choice, Series
from clvol.formats._errors import foreign_errors
from clvol.formats._files import Reader
from clvol.formats.guarded.limits import Budget, Limits, limited, size_of
from clvol.formats.guarded.worker import call, prepare
from clvol.formats.table import format_of, options_of
from clvol.labels import LabelTable, table
from clvol.volume.label_table import LabelRow
from clvol.volume.provenance import note
from clvol.volume.volume import Volume
from clvol.volume.volumes import Leading, Volumes

__all__ = [
    "allowed",
    "begin_to_read",
    "called",
    "leading_of",
    "misplaced",
    "read",
    "read_all",
    "replacing",
    "series_of",
    "sorted_out",
]

LabelSource: TypeAlias = bool | str | os.PathLike[str] | Mapping[int, LabelRow]
"""Whether samples are labels, or their table."""

_CHOICES = ("volume", "time", "position", "channel")
_GEOMETRY = ("spacing", "origin", "direction")


@suggests_options
def read(
    path: str | os.PathLike[str],
    *,
    volume: int | None = None,
    time: int | None = None,
    channel: int | str | None = None,
    position: int | None = None,
    series: int | str | None = None,
    level: int | None = None,
    shape: Sequence[int] | None = None,
    dtype: DTypeLike | None = None,
    spacing: Sequence[float] | None = None,
    origin: Sequence[float] | None = None,
    direction: ArrayLike | None = None,
    labels: LabelSource | None = None,
    byte_order: str | None = None,
    offset: int = 0,
    trusted: bool = False,
    limits: Limits | None = None,
) -> Volume:
    """Read a volume (or image) from a file or a folder; one of them, where it holds several.

    Parameters
    ----------
    path : path-like
        A file, recognised by its suffix in upper or lower case: ``.npy .npz``, ``.nii .nii.gz .hdr .img .nrrd .nhdr .mha .mhd
        .mgh .mgz .mnc``, ``.mrc .map .ccp4`` (also ``.gz``), ``.dcm .dicom .ima``, ``.tif .tiff`` (OME, ImageJ, plain),
        ``.png .jpg .bmp``, ``.h5 .hdf5 .nc``, ``.ims``, ``.vti .vtk``, ``.zarr.zip``, ``.raw .bin``, and ``.czi .lif .nd2`` and
        others of microscope makers, for which bioio has plug-ins; DICOM, HDF5, netCDF, MINC, MRC and VTK's legacy files by
        their content under any other name. Or a folder of DICOM files or of image slices (in the natural
        order of their names), or a Zarr array or group (OME-Zarr).
    volume : int, optional
        Number among several volumes, in the order of the file, from 0.
    time, position : int, optional
        Index along such an axis.
    channel : int or str, optional
        Number or name; "magnitude" of vectors, "luminance" of colours (the default for these; a `ClvolWarning` says that colours
        are lost).
    series : int or str, optional
        Image of a file or folder that holds several: a DICOM series, an image of a TIFF file, an array of HDF5 or Zarr;
        `clvol info` lists them.
    level : int, optional
        Size of an image that is stored in several, 0 the largest, and the default.
    shape : sequence of int, optional
        Raw files only, and required there: shape of the array, (nz, ny, nx) or (ny, nx).
    dtype : dtype-like, optional
        Raw files only, and required there: type of the samples.
    spacing, origin, direction : optional
        As of `Volume`, replacing what the file says; any format.
    labels : bool, path-like or mapping, optional
        Whether samples are labels, or a table of their names, colours and opacities, as of `clvol.labels.table`: a text file of
        FreeSurfer, 3D Slicer or ITK-SNAP, or rows. What it leaves open is as the file says.
    byte_order : {"little", "big"}, optional
        Raw files only: overrides the byte order of `dtype`.
    offset : int, optional
        Raw files only: bytes before the first sample.
    trusted : bool, optional
        Files are treated as untrusted by default: libraries with native code (for all formats but NumPy's, NIfTI, MGH, MRC,
        netCDF-3, VTK's legacy files and raw) read them in another process, within `limits`, so that a file that crashes or
        hangs them, or exhausts memory, is an error. A trusted file is read in this process, without limits.
    limits : Limits, optional
        Time and memory that reading may take; see `clvol.formats.Limits` for the defaults.

    Returns
    -------
    Volume
        Medical formats: in ITK's LPS frame, in mm (NRRD and MetaImage: in the unit of the header, if it has one). Samples that the
        header scales are float64. NIfTI is read as nibabel reads it: placed by the sform, else the qform, else the spacing
        about the centre. Maps of MRC are in Å. Microscope files: in the unit of the file, first sample at 0, with names,
        colours and `clim` of channels. Spacing is 1 if the file gives none.

    Warns
    -----
    ClvolWarning
        The file holds several volumes, and none was chosen: the first is read. Or it does not name its axes: the warning says how
        they are interpreted.

    Raises
    ------
    FormatError
        The file is missing, of no known format, damaged, or shorter than its header says; or its reader crashed, or exceeded
        `limits`.
    DataError
        The file holds complex numbers or objects.
    GeometryError
        The file's geometry is invalid or unknown; `spacing`, `origin` or `direction` replace it.
    OptionError
        An argument is invalid, or does not apply to this format; there is no such volume.
    MissingDependencyError
        The format needs an extra of clvol; the message names it.
    OutOfMemoryError
        The file is sound but does not fit into memory. It is a `MemoryError` too.

    Examples
    --------
    >>> volume = clvol.read("head.nii.gz")
    >>> frame = clvol.read("bold.nii.gz", volume=12)
    >>> nuclei = clvol.read("cells.ome.tif", channel="DAPI", time=3)
    >>> brain = clvol.read("aseg.mgz", labels="FreeSurferColorLUT.txt")
    >>> volume = clvol.read("engine.raw", shape=(128, 256, 256), dtype="uint8", spacing=(1, 1, 2))
    """
    arguments = locals()
    result = _read(arguments)
    assert isinstance(result, Volume)  # one is picked
    note(result, path, arguments)
    return result


@suggests_options
def read_all(
    path: str | os.PathLike[str],
    *,
    time: int | None = None,
    channel: int | str | None = None,
    position: int | None = None,
    series: int | str | None = None,
    level: int | None = None,
    spacing: Sequence[float] | None = None,
    origin: Sequence[float] | None = None,
    direction: ArrayLike | None = None,
    labels: LabelSource | None = None,
    trusted: bool = False,
    limits: Limits | None = None,
) -> Volumes:
    """Read all volumes of a file: frames of a series, channels of a microscope, components of a vector.

    Parameters
    ----------
    path : path-like
        As of `read`.
    time, channel, position : optional
        Restrict an axis, as in `read`.
    series, level, spacing, origin, direction, labels, trusted, limits : optional
        As of `read`.

    Returns
    -------
    Volumes
        In file order, in one array.

    Raises
    ------
    ClvolError
        As `read`.

    Examples
    --------
    >>> bold = clvol.read_all("bold.nii.gz")
    >>> pictures = [clvol.render(frame) for frame in bold]
    >>> nuclei = clvol.read_all("cells.ome.tif")["DAPI"]
    """
    result = _read(locals(), whole=True)
    return Volumes([result]) if isinstance(result, Volume) else result


def begin_to_read(path: str | os.PathLike[str]) -> None:
    """Start the process that will read a file of this name, if it needs one, so that `read` does not wait for it.

    Errors are left to `read`.
    """
    with suppress(ClvolError, OSError):
        if native := format_of(as_path(path)).native:
            prepare(native)


def series_of(path: str | os.PathLike[str], *, trusted: bool = False, limits: Limits | None = None) -> tuple[Series, ...]:
    """The images of a file or folder, of which ``series=`` chooses one; empty for formats that hold one.

    `trusted` and `limits` are as in `read`.
    """
    path = as_path(path)
    chosen = format_of(path)
    if chosen.series is None:
        return ()
    return tuple(called(chosen.name, chosen.native, path, allowed(trusted, limits), chosen.series, path))


def leading_of(
    path: str | os.PathLike[str],
    *,
    series: int | str | None = None,
    level: int | None = None,
    trusted: bool = False,
    limits: Limits | None = None,
) -> Leading:
    """The axes of a file before z, y and x, from its header: no samples are read.

    `trusted` and `limits` are as in `read`, and so are errors.
    """
    path = as_path(path)
    chosen = format_of(path)
    if not chosen.several:
        return Leading()
    options = options_of(chosen, path, {"series": series, "level": level})
    found = called(chosen.name, chosen.native, path, allowed(trusted, limits), _counted, chosen.read, path, **options)
    assert isinstance(found, Leading)
    return found


def allowed(trusted: bool, limits: Limits | None) -> Limits | None:
    """Limits for a file; None if it is trusted."""
    if not isinstance(trusted, bool):
        raise OptionError(f"trusted must be True or False; got {trusted!r}")
    if limits is not None and (trusted or not isinstance(limits, Limits)):
        raise OptionError(f"limits must be clvol.formats.Limits, for a file that is not trusted; got {limits!r}")
    return None if trusted else limits or Limits()


def called(
    reader: str,
    native: tuple[str, ...],
    path: Path,
    limits: Limits | None,
    function: Callable[..., Any],
    *given: Any,
    **options: Any,
) -> Any:
    """The result of `function`; in another process if it runs `native` code and the file is not trusted."""
    what = f"read {path}"
    with foreign_errors(what):
        if limits is None:
            budget = None
        else:
            stored, files = size_of(path)
            budget = Budget(limits, stored, available(), files)
        if budget is not None and native:
            return call(function, *given, what=what, reader=reader, modules=native, budget=budget, options=options)
        with limited(budget):
            return function(*given, **options)


def sorted_out(arguments: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Of the arguments of `read`: the choices of volumes, the options of a format, and what replaces the file's."""
    given = {name: value for name, value in arguments.items() if value is not None}
    options = {name: given.get(name) for name in ("series", "level", "shape", "dtype", "byte_order")}
    choices, replaced = ({name: given[name] for name in names if name in given} for names in (_CHOICES, _GEOMETRY))
    if "labels" in given:
        replaced["labels"] = given["labels"] if isinstance(given["labels"], bool) else table(given["labels"])
    return choices, options | {"offset": given.get("offset") or None}, replaced


def replacing(replaced: Mapping[str, Any], about: Mapping[str, Any]) -> dict[str, Any]:
    """What is known of a volume, and what replaces it: a table of labels goes over that of the file."""
    made = {**about, **replaced}
    if isinstance(made.get("labels"), LabelTable) and isinstance(own := about.get("labels"), Mapping):
        made["labels"] = made["labels"].over(own)
    return made


def misplaced(source: object, error: GeometryError, unplaced: str) -> GeometryError:
    """The error of a geometry that no `Volume` has: `unplaced` is the reason, if the format knows it."""
    return GeometryError(f"{source}: {unplaced or error}; spacing=, origin= or direction= replace what the file says")


def _read(arguments: Mapping[str, Any], whole: bool = False) -> Volume | Volumes:
    path = as_path(arguments["path"])
    choices, given, replaced = sorted_out(arguments)
    choice, limits = Choice(choices, whole), allowed(arguments["trusted"], arguments["limits"])
    chosen = format_of(path)
    options = options_of(chosen, path, given)
    if chosen.several:
        options["choose"] = choice
    data, geometry = called(chosen.name, chosen.native, path, limits, chosen.read, path, **options)
    with foreign_errors(f"read {path}"):
        if not chosen.several:
            pick = choice(path.name, Leading())  # refuses a choice among one
            geometry = geometry | pick.about
        unplaced = geometry.pop("unplaced", "")
        geometry = replacing(replaced, geometry)
        try:
            return Volumes(data, **geometry) if "leading" in geometry else Volume(data, **geometry)
        except DataError as error:
            raise DataError(f"{path}: {error}") from error
        except GeometryError as error:
            raise misplaced(path, error, "" if "spacing" in replaced else unplaced) from error


def _counted(reader: Reader, path: Path, **options: Any) -> Leading:
    try:
        reader(path, choose=_Counting(whole=True), **options)
    except _KnownError as known:
        (leading,) = known.args
        return leading  # type: ignore[no-any-return]  # what `_Counting` raises
    return Leading()


class _Counting(Choice):
    """Ends the reading once the leading axes are known."""

    def __call__(self, source: str, leading: Leading, guessed: str = "") -> NoReturn:  # noqa: ARG002
        raise _KnownError(leading)


class _KnownError(ClvolError):
    """Carries the leading axes out of a reader."""
