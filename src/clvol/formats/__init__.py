"""Reading and writing volumes: one module a file format, found by suffix.

A new format is one module with ``read(path) -> (samples, geometry)`` and, where it can,
``write(volume, path)``, and one row of `FORMATS`.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from numpy.typing import ArrayLike, DTypeLike

from clvol.base.checks import as_path
from clvol.base.errors import ClvolError, DataError, FormatError, GeometryError, OptionError
from clvol.base.files import staged
from clvol.base.memory import available
from clvol.formats import bioio, dicom, hdf5, imaris, metaimage, mgz, nifti, npy, nrrd, raw, slices, tiff, vti, zarr
from clvol.formats._choice import Choice, Series
from clvol.formats._files import Reader, Writer, foreign_errors
from clvol.formats.guarded.limits import Budget, Limits, limited, size_of
from clvol.formats.guarded.worker import call, prepare
from clvol.interop.kinds import Content
from clvol.volume.volume import Volume, as_volume
from clvol.volume.volumes import Leading, Volumes

__all__ = [
    "FORMATS",
    "WRITTEN",
    "Format",
    "Limits",
    "Series",
    "allowed",
    "called",
    "format_of",
    "leading_of",
    "options_of",
    "read",
    "read_all",
    "series_of",
    "write",
]


@dataclass(frozen=True)
class Format:
    """A file format.

    Parameters
    ----------
    name : str
        Its name for users.
    suffixes : tuple of str
        Endings of file names, in lower case; empty for what is recognised otherwise.
    read : callable
        Gives the samples and what the file says of their geometry. That of a format with `several` takes ``choose``, a `Choice`,
        which it calls with the file's name and its `Leading` axes; it loads the samples of the `Pick`, and gives its `about` with
        the geometry.
    write : callable or None
        None where the format is only read.
    options : frozenset of str
        Arguments of `clvol.read` that are for this format.
    several : bool
        Whether a file may hold more than one volume.
    file : callable or None
        Whether a file with a suffix of no format is of this one, by what it holds.
    folder : callable or None
        Whether a folder is of this format; None: files only.
    series : callable or None
        The images that a file or folder holds, where ``series=`` chooses one: a tuple of `Series`.
    native : tuple of str
        The modules that read it by native code: in a process of its own, which imports them, unless the file is trusted. Empty:
        Python and NumPy alone read it, here.
    write_several : callable or None
        Writes `Volumes` into one file; None where the format holds one volume.
    lazily : callable or None
        As `read`, but it gives a list of sizes, the largest first, each with a `Window` of its samples; an empty one where those of
        this file cannot be read part by part. None: those of no file can.
    """

    name: str
    suffixes: tuple[str, ...]
    read: Reader
    write: Writer | None = None
    options: frozenset[str] = frozenset()
    several: bool = False
    file: Callable[[Path], bool] | None = None
    folder: Callable[[Path], bool] | None = None
    series: Callable[[Path], tuple[Series, ...]] | None = None
    native: tuple[str, ...] = ()
    write_several: Callable[[Volumes, Path], None] | None = None
    lazily: Callable[..., list[Content]] | None = None


_ITK = ("SimpleITK",)
_PILLOW = ("imageio.v3", "PIL.Image")

FORMATS = (
    Format("NumPy array, no geometry", (".npy",), npy.read, npy.write, several=True, write_several=npy.write, lazily=npy.lazily),
    Format("NumPy archive", (".npz",), npy.read_archive, npy.write_archive, several=True, write_several=npy.write_archive),
    Format("NIfTI", (".nii", ".nii.gz"), nifti.read, nifti.write, several=True, write_several=nifti.write, lazily=nifti.lazily),
    Format("NIfTI in two files", (".hdr", ".img"), nifti.read_pair, several=True, lazily=nifti.lazily_pair),
    Format(
        "NRRD", (".nrrd", ".nhdr"), nrrd.read, nrrd.write, several=True, native=_ITK, write_several=nrrd.write, lazily=nrrd.lazily
    ),
    Format(
        "MetaImage",
        (".mha", ".mhd"),
        metaimage.read,
        metaimage.write,
        several=True,
        native=_ITK,
        write_several=metaimage.write,
        lazily=metaimage.lazily,
    ),
    Format("FreeSurfer MGH", (".mgh", ".mgz"), mgz.read, several=True),
    Format(
        "Zarr",
        (".zarr.zip", ".ozx", ".zip"),
        zarr.read,
        None,
        frozenset({"series", "level"}),
        several=True,
        folder=zarr.is_one,
        series=zarr.series,
        native=("zarr",),
        lazily=zarr.lazily,
    ),
    Format(
        "DICOM",
        dicom.SUFFIXES,
        dicom.read,
        options=frozenset({"series"}),
        several=True,
        file=dicom.is_file,
        folder=dicom.is_folder,
        series=dicom.series_of,
        native=_ITK,
    ),
    Format(
        "TIFF stack",
        (".tif", ".tiff"),
        tiff.read,
        tiff.write,
        frozenset({"series", "level"}),
        several=True,
        series=tiff.series,
        native=("tifffile",),
        lazily=tiff.lazily,
        write_several=tiff.write_several,
    ),
    Format(
        "HDF5",
        (".h5", ".hdf5", ".hdf", ".he5", ".nc"),
        hdf5.read,
        None,
        frozenset({"series"}),
        several=True,
        series=hdf5.series,
        native=("h5py",),
        lazily=hdf5.lazily,
    ),
    Format("Imaris", (".ims",), imaris.read, None, frozenset({"level"}), several=True, native=("h5py",), lazily=imaris.lazily),
    Format(
        "VTK image data",
        (".vti",),
        vti.read,
        None,
        frozenset({"series"}),
        several=True,
        series=vti.series,
        native=("vtkmodules.vtkIOCore",),
    ),
    Format(
        "microscope makers' files",
        bioio.SUFFIXES,
        bioio.read,
        None,
        frozenset({"series", "level"}),
        several=True,
        series=bioio.series,
        native=("bioio",),
    ),
    Format("image", slices.SUFFIXES, slices.read, several=True, native=_PILLOW),
    Format("folder of image slices", (), slices.read_folder, several=True, folder=slices.are_in, native=(*_PILLOW, "tifffile")),
    Format(
        "raw samples", (".raw", ".bin"), raw.read, None, frozenset({"shape", "dtype", "byte_order", "offset"}), lazily=raw.lazily
    ),
)

_FOLDERS = "DICOM files, image slices (.tif .png .jpg .bmp) or a Zarr array or group"
_LISTED = 5  # kinds of files in a message

WRITTEN = tuple(suffix for f in FORMATS if f.write for suffix in f.suffixes)
"""Suffixes of the files that `write` writes."""


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
    byte_order: str | None = None,
    offset: int = 0,
    trusted: bool = False,
    limits: Limits | None = None,
) -> Volume:
    """Read a volume (or image) from a file or a folder; one of them, where it holds several.

    Parameters
    ----------
    path : path-like
        A file, which is known by its suffix in upper or lower case: ``.npy .npz``, ``.nii .nii.gz .hdr .img .nrrd .nhdr .mha .mhd
        .mgh .mgz``, ``.dcm .dicom .ima`` (and any DICOM file without a suffix), ``.tif .tiff`` (OME, ImageJ, plain),
        ``.png .jpg .bmp``, ``.h5 .hdf5 .nc``, ``.ims``, ``.vti``, ``.zarr.zip``, ``.raw .bin``, and ``.czi .lif .nd2`` and
        others of microscopes' makers, for which bioio has plug-ins. Or a folder: of DICOM files, of image slices (in the natural
        order of their names), or a Zarr array or group (OME-Zarr).
    volume : int, optional
        Which of several, in the order of the file, the first is 0.
    time, position : int, optional
        Which along such an axis.
    channel : int or str, optional
        Which, by number or name; "magnitude" of vectors, "luminance" of colours (the default for these).
    series : int or str, optional
        Which image of a file or folder that holds several: a DICOM series, an image of a TIFF file, an array of HDF5 or Zarr;
        `clvol info` lists them.
    level : int, optional
        Of files that hold the same image in several sizes, 0 the largest, and the default.
    shape : sequence of int, optional
        Raw files only, and needed there: samples along the axes of the array, (nz, ny, nx) or
        (ny, nx).
    dtype : dtype-like, optional
        Raw files only, and needed there: type of the samples.
    spacing, origin, direction : optional
        As of `Volume`, in place of what the file says; any format.
    byte_order : {"little", "big"}, optional
        Raw files only: overrides the byte order of `dtype`.
    offset : int, optional
        Raw files only: bytes before the first sample.
    trusted : bool, optional
        Whether the file is known to be sound. Libraries of native code (for all formats but NumPy's, NIfTI, MGH and raw ones) read
        what is not in a process of its own, within `limits`: a file that crashes them, hangs them or takes all memory is an
        error. What is trusted is read in this process, without limits.
    limits : Limits, optional
        What reading may cost; see `clvol.formats.Limits` for the defaults.

    Returns
    -------
    Volume
        Medical formats: in ITK's LPS frame, in mm (NRRD and MetaImage: in the unit of the header, if
        it has one). Samples that the header scales are float64. NIfTI files are read as nibabel
        reads them: placed by the sform, else the qform, else the spacing about the middle. Microscopes' files: in
        the unit of the file, first sample at 0, with the names, colours and windows of channels. Files that give no spacing: 1.

    Warns
    -----
    ClvolWarning
        The file holds several volumes, and none was chosen: the first was read. Or it does not say what its axes are: the warning
        says what they were taken for.

    Raises
    ------
    FormatError
        The file is missing, of no known format, damaged, or shorter than its header says; or its reader crashed, or took more time
        or memory than `limits` allow.
    DataError
        The file holds complex numbers or objects.
    GeometryError
        The file's geometry is invalid or unknown; `spacing`, `origin` or `direction` mend it.
    OptionError
        An argument is invalid, or is not for this format; there is no such volume.
    MissingDependencyError
        The format needs an extra of clvol; the message names it.
    OutOfMemoryError
        The file is sound but does not fit into memory. It is a `MemoryError` too.

    Examples
    --------
    >>> volume = clvol.read("head.nii.gz")
    >>> frame = clvol.read("bold.nii.gz", volume=12)
    >>> nuclei = clvol.read("cells.ome.tif", channel="DAPI", time=3)
    >>> volume = clvol.read("engine.raw", shape=(128, 256, 256), dtype="uint8", spacing=(1, 1, 2))
    """
    wanted = {"volume": volume, "time": time, "position": position, "channel": channel}
    options = {"series": series, "level": level, "shape": shape, "dtype": dtype, "byte_order": byte_order, "offset": offset or None}
    replaced = {"spacing": spacing, "origin": origin, "direction": direction}
    choice = Choice({name: v for name, v in wanted.items() if v is not None})
    result = _read(path, choice, options, replaced, allowed(trusted, limits))
    assert isinstance(result, Volume)  # nothing was left open
    return result


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
    trusted: bool = False,
    limits: Limits | None = None,
) -> Volumes:
    """Read all volumes of a file: the frames of a series, the channels of a microscope, the components of a vector.

    Parameters
    ----------
    path : path-like
        As of `read`; a file with one volume gives one.
    time, channel, position : optional
        Only these, as of `read`.
    series, level, spacing, origin, direction, trusted, limits : optional
        As of `read`.

    Returns
    -------
    Volumes
        In the order of the file, in one array.

    Raises
    ------
    ClvolError
        As `read` raises it.

    Examples
    --------
    >>> bold = clvol.read_all("bold.nii.gz")
    >>> pictures = [clvol.render(frame) for frame in bold]
    >>> nuclei = clvol.read_all("cells.ome.tif")["DAPI"]
    """
    wanted = {"time": time, "position": position, "channel": channel}
    replaced = {"spacing": spacing, "origin": origin, "direction": direction}
    choice = Choice({name: v for name, v in wanted.items() if v is not None}, whole=True)
    result = _read(path, choice, {"series": series, "level": level}, replaced, allowed(trusted, limits))
    return Volumes([result]) if isinstance(result, Volume) else result


def begin_to_read(path: str | os.PathLike[str]) -> None:
    """Start the process that will read a file of this name, if one will, so that `read` need not wait for it.

    What is wrong with the file is for `read` to say.
    """
    with suppress(ClvolError, OSError):
        if native := format_of(as_path(path)).native:
            prepare(native)


def series_of(path: str | os.PathLike[str], *, trusted: bool = False, limits: Limits | None = None) -> tuple[Series, ...]:
    """The images that a file or folder holds, of which ``series=`` chooses one; none where its format has but one.

    `trusted` and `limits` are as of `read`.
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
    """What the axes before z, y and x of a file count, from its header: no samples are read.

    `trusted` and `limits` are as of `read`.

    Raises
    ------
    ClvolError
        As `read` raises it.
    """
    path = as_path(path)
    chosen = format_of(path)
    if not chosen.several:
        return Leading()
    options = options_of(chosen, path, {"series": series, "level": level})
    found = called(chosen.name, chosen.native, path, allowed(trusted, limits), _counted, chosen.read, path, **options)
    assert isinstance(found, Leading)
    return found


def _counted(reader: Reader, path: Path, **options: Any) -> Leading:
    try:
        reader(path, choose=_Counting(whole=True), **options)
    except _KnownError as known:
        return known.leading
    return Leading()


class _Counting(Choice):
    """Chooses nothing: what there is, is all that is wanted."""

    def __call__(self, source: str, leading: Leading, guessed: str = "") -> NoReturn:  # noqa: ARG002
        raise _KnownError(leading)


class _KnownError(ClvolError):
    """Ends the reading of a file whose header has told what is wanted."""

    def __init__(self, leading: Leading) -> None:
        super().__init__(str(leading))
        self.leading = leading


def allowed(trusted: bool, limits: Limits | None) -> Limits | None:
    """The limits of what is read; None: it is trusted."""
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
    """What `function` returns; in another process if it is `native` code that reads, and the file not trusted."""
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


def _read(
    path: str | os.PathLike[str], choice: Choice, given: Mapping[str, Any], replaced: Mapping[str, Any], limits: Limits | None
) -> Volume | Volumes:
    path = as_path(path)
    chosen = format_of(path)
    options = options_of(chosen, path, given)
    if chosen.several:
        options["choose"] = choice
    data, geometry = called(chosen.name, chosen.native, path, limits, chosen.read, path, **options)
    with foreign_errors(f"read {path}"):
        if not chosen.several:
            pick = choice(path.name, Leading())  # refuses what is asked of one volume
            geometry = geometry | pick.about
        geometry |= {name: value for name, value in replaced.items() if value is not None}
        try:
            return Volumes(data, **geometry) if "leading" in geometry else Volume(data, **geometry)
        except DataError as error:
            raise DataError(f"{path}: {error}") from error
        except GeometryError as error:
            mend = "spacing=, origin= or direction= replace what the file says"
            raise GeometryError(f"{path}: {error}; {mend}") from error


def options_of(chosen: Format, path: Path, given: Mapping[str, Any]) -> dict[str, Any]:
    """Those options that are given; `OptionError` for one that is not for this format."""
    options = {name: value for name, value in given.items() if value is not None}
    for name in options:
        if name not in chosen.options:
            having = ", ".join(f.name for f in FORMATS if name in f.options)
            raise OptionError(f"{name} is only for: {having}; {path} is read as: {chosen.name}")
    return options


def format_of(path: Path) -> Format:
    """That of a file by its name, of a folder by what it holds."""
    with foreign_errors(f"read {path}"):
        if not path.exists():
            raise FormatError(f"cannot read {path}: there is no such file or folder")
        if path.is_dir():
            found = next((f for f in FORMATS if f.folder is not None and f.folder(path)), None)
            if found is None:
                raise FormatError(f"cannot read {path}: a folder must hold {_FOLDERS}; this one holds {_holdings(path)}")
            return found
        if not path.is_file():
            raise FormatError(f"cannot read {path}: it is neither a file nor a folder")
        if not path.name.lower().endswith(tuple(suffix for row in FORMATS for suffix in row.suffixes)):
            for row in FORMATS:
                if row.file is not None and row.file(path):
                    return row
        return _by_suffix(path)[0]


def write(volume: Volume | Volumes | ArrayLike, path: str | os.PathLike[str]) -> None:
    """Write a volume (or image), or several on one grid, to a file.

    The file appears when it is complete: on any failure, what was at `path` is left as it was.
    Nothing is lost silently. What a format cannot hold is refused; boolean samples become
    uint8 and float16 becomes float32 where the format has no such type.

    Parameters
    ----------
    volume : Volume, Volumes or array-like
        What to write.
    path : path-like
        ``.npz``: everything, exactly. ``.nrrd .nhdr .mha .mhd``: samples and geometry, in mm. ``.nii .nii.gz``:
        the same, with the geometry in float32, and with what `Volume.header` keeps of a NIfTI file, the window and the step
        of time. ``.tif .tiff`` (OME): spacing and units, times, and channels with names and colours. ``.npy``: samples only.
        ``.nhdr`` and ``.mhd`` put the samples beside the header, into a ``.raw`` file.

    Raises
    ------
    FormatError
        The suffix is of no format that is written, the format cannot hold the volume, or only one, or
        writing failed.
    MissingDependencyError
        The format needs ``clvol[medical]`` or ``clvol[microscopy]``.
    """
    path = as_path(path)
    if isinstance(volume, Volumes) and len(volume) == 1:
        volume = volume[0]
    what = volume if isinstance(volume, Volumes) else as_volume(volume)
    chosen, suffix = _by_suffix(path, written=True)
    if chosen.write is None:
        raise FormatError(
            f"cannot write {path}: {chosen.name} is only read; written are {' '.join(WRITTEN)}, of which .mhd or .nhdr puts raw "
            "samples beside a header that says how they are arranged"
        )
    if isinstance(what, Volumes) and chosen.write_several is None:
        holding = " ".join(s for f in FORMATS if f.write_several for s in f.suffixes)
        raise FormatError(
            f"cannot write {path}: {chosen.name} holds one volume; got {what.leading}: choose one, as volumes[0]"
            + (f", or write {holding}" if holding else "")
        )
    with foreign_errors(f"write {path}"), staged(path, suffix) as file:
        if isinstance(what, Volumes):
            assert chosen.write_several is not None
            chosen.write_several(what, file)
        else:
            chosen.write(what, file)


def _by_suffix(path: Path, written: bool = False) -> tuple[Format, str]:
    """The format of a file name and its suffix, the longest that fits, as in .nii.gz."""
    name = path.name.lower()
    rows = [row for row in FORMATS if row.write or not written]
    found = [(suffix, row) for row in FORMATS for suffix in row.suffixes if name.endswith(suffix)]
    if not found:
        known = " ".join(suffix for row in rows for suffix in row.suffixes)
        rule = "write" if written else "read"
        also = "" if written else f"; a folder may hold {_FOLDERS}"
        raise FormatError(f"cannot {rule} {path}: its suffix must be one of {known}{also}")
    suffix, row = max(found, key=lambda pair: len(pair[0]))
    return row, suffix


def _holdings(path: Path) -> str:
    """What lies in a folder, in a few words."""
    entries = [entry for entry in path.iterdir() if not entry.name.startswith(".")]
    folders = sorted(entry.name for entry in entries if entry.is_dir())
    kinds = Counter(entry.suffix.lower() or "without a suffix" for entry in entries if not entry.is_dir())
    parts = [f"{n} file{'s' if n > 1 else ''} {kind}" for kind, n in kinds.most_common(_LISTED)]
    if len(kinds) > _LISTED:
        parts.append("others")
    if folders:
        names = ", ".join(folders[:_LISTED]) + (", …" if len(folders) > _LISTED else "")
        parts.append(f"{len(folders)} folder{'s' if len(folders) > 1 else ''} ({names}): give one of them")
    return ", ".join(parts) or "nothing"
