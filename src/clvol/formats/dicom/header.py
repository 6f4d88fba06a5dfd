"""What the header of a DICOM file says of each of its frames, parsed by pydicom.

Source: DICOM PS3.3, C.7.6.2 (image plane), C.7.6.16 (functional groups), C.8.8.3 (dose), C.8.4.8 (nuclear medicine).
"""

from __future__ import annotations

import logging
import mmap
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from clvol.base.checks import warn
from clvol.base.errors import ClvolWarning, FormatError, MissingDependencyError
from clvol.formats._errors import foreign_errors
from clvol.formats.guarded.limits import announce

__all__ = [
    "ROOT",
    "SUFFIXES",
    "TIMES",
    "Frame",
    "Value",
    "frames_of",
    "has_palette",
    "has_pictures",
    "leniently",
    "moved",
    "names_of",
    "numbers_of",
    "opened",
    "pydicom",
    "read_header",
]

SUFFIXES = (".dcm", ".dicom", ".ima")
"""Usual suffixes of DICOM files; many have none."""

# SOP classes without pictures: directories, waveforms, presentation states, registrations, reports, documents, treatment plans.
ROOT = "1.2.840.10008."
_NO_PICTURES = ("1.3.10", *(f"5.1.4.1.1.{group}" for group in ("9.", "11.", "66", "88.", "104.", "481.")))
_PICTURES = tuple(f"5.1.4.1.1.{group}" for group in ("66.4", "66.7", "481.1", "481.2"))  # segmentations, RT images, dose
_DTYPES = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "uint64", "int64")
_CENTIMETRES = 3  # PhysicalUnitsXDirection of ultrasound, PS3.3 C.8.5.5.1.15

# What distinguishes images of the same place, in order of meaning, and the elements that say it.
_KEYS = {
    "stack": ("StackID",),
    "segment": ("ReferencedSegmentNumber",),
    "frame type": ("FrameType", "ImageType"),
    "component": ("ComplexImageComponent",),
    "energy window": ("EnergyWindowVector",),
    "time": ("TemporalPositionIndex", "TemporalPositionIdentifier", "TimeSlotVector", "PhaseVector", "FrameReferenceTime"),
    "trigger time": ("TemporalPositionTimeOffset", "NominalCardiacTriggerDelayTime", "TriggerTime"),
    "echo time": ("EffectiveEchoTime", "EchoTime", "EchoNumbers"),
    "inversion time": ("InversionTimes", "InversionTime"),
    "b-value": ("DiffusionBValue",),
    "gradient": ("DiffusionGradientOrientation",),
    "flip angle": ("FlipAngle",),
    "repetition time": ("RepetitionTime",),
    "kVp": ("KVP",),
    "cardiac phase": ("NominalPercentageOfCardiacPhase",),
    "acquisition": ("AcquisitionNumber",),
    "sequence": ("SequenceName", "PulseSequenceName"),
    "acquisition time": ("FrameAcquisitionDateTime", "AcquisitionDateTime", "AcquisitionTime"),
    "content time": ("ContentTime",),
}
TIMES = ("time", "trigger time", "cardiac phase", "acquisition time", "content time")
# Makers' own b-values: creator and element, PS3.15 E.3.10 and the makers' conformance statements.
_B_VALUES = ((0x0019, "SIEMENS MR HEADER", 0x0C), (0x2001, "Philips Imaging DD 001", 0x03), (0x0043, "GEMS_PARM_01", 0x39))

Value = tuple[Any, ...]


@dataclass(frozen=True)
class Frame:
    """What a header says of one frame, or of one tile of a mosaic.

    Parameters
    ----------
    path : Path
    index : int
        Number of the frame in its file.
    kind : tuple of int
        Rows, columns, and values of a voxel: alike in a volume.
    position, orientation : tuple of float
        In LPS and mm; empty if unknown.
    pixels : tuple of float
        Distances between rows and between columns in mm; empty if unknown.
    between : float
        Distance between slices in mm; NaN if unknown.
    scale : (float, float) or None
        Slope and intercept of stored samples; None: a lookup table.
    dtype : dtype or None
        Holds all values that its bits can stand for; None: that of the decoded samples.
    clim : tuple of float or None
        The values that the source shows as black and as white.
    location : float
        Along the normal, in mm, where no position is given; NaN if unknown.
    number : float
        Of the instance; NaN if unknown.
    keys : dict
        What distinguishes it from other frames of the same place, by the names in `_KEYS`.
    tile : tuple of slice
        Where it lies in the stored frame.
    """

    path: Path
    index: int
    kind: tuple[int, int, int]
    position: tuple[float, ...]
    orientation: tuple[float, ...]
    pixels: tuple[float, ...]
    between: float
    scale: tuple[float, float] | None
    dtype: np.dtype[Any] | None
    clim: tuple[float, float] | None
    location: float
    number: float
    keys: dict[str, Value]
    tile: tuple[slice, ...] = ()


def pydicom() -> Any:
    """The pydicom module; its import is slow and waits until it is needed."""
    try:
        import pydicom as module
        import pydicom.pixels.utils
    except ImportError as error:
        raise MissingDependencyError('DICOM files need pydicom: pip install "clvol[medical]"') from error
    return module


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """A file as mapped memory: a length that lies then allocates nothing."""
    with path.open("rb") as stream:
        try:
            mapped = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
        except ValueError as error:
            raise FormatError(f"cannot read {path}: {path.name} is damaged or cut short: it is empty") from error
        with mapped:
            yield mapped


@contextmanager
def leniently(path: Path) -> Iterator[None]:
    """Let pydicom read over harmless faults, and pass on what it says of them, each once."""
    settings, log = pydicom().config.settings, logging.getLogger("pydicom")
    level = log.level
    log.setLevel(logging.CRITICAL)  # it says the same by warnings
    mode, settings.reading_validation_mode = settings.reading_validation_mode, pydicom().config.IGNORE
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            yield
    finally:
        settings.reading_validation_mode = mode
        log.setLevel(level)
    for text, ours in dict.fromkeys((str(one.message), issubclass(one.category, ClvolWarning)) for one in caught):
        warn(text if ours else f"{path.name}: {' '.join(text.split())}")


def read_header(path: Path, *elements: str) -> Any:
    """The elements before the samples, or only some of them."""
    with foreign_errors(f"read {path}: {path.name} is damaged or cut short"), opened(path) as stream:
        whole = stream[128:132] == b"DICM"
        if not whole and path.suffix.lower() not in SUFFIXES:
            raise FormatError(f"cannot read {path}: it is no DICOM file, or it is damaged or cut short")
        header = pydicom().dcmread(stream, stop_before_pixels=True, force=True, specific_tags=list(elements) or None)
        if whole and "TransferSyntaxUID" not in header.file_meta:
            raise FormatError(f"{path.name} is damaged or cut short: it must say how its samples are encoded, in (0002,0010)")
        if not whole:
            warn(f"{path.name} has no preamble, which every DICOM file should have; it was read nevertheless")
    return header


def has_pictures(header: Any) -> bool:
    """Whether a file should hold pictures, by its SOP class."""
    kind = str(header.get("SOPClassUID") or header.file_meta.get("MediaStorageSOPClassUID") or "").removeprefix(ROOT)
    return kind.startswith(_PICTURES) or not kind.startswith(_NO_PICTURES)


def has_palette(header: Any) -> bool:
    """Whether samples are indices of colours; labels stay labels."""
    return header.get("PhotometricInterpretation") == "PALETTE COLOR" and "SegmentSequence" not in header


def names_of(header: Any) -> tuple[str, str]:
    """Modality and description of a series."""
    modality, description = (str(header.get(name) or "").strip() for name in ("Modality", "SeriesDescription"))
    return modality, description.encode("utf-8", "replace").decode("utf-8")


def numbers_of(item: Any, name: str) -> tuple[float, ...]:
    """The numbers of an element; NaN for what is none, nothing if there is no such element."""
    if item is None or name not in item:
        return ()
    try:
        value = item[name].value
    except (ValueError, TypeError, OverflowError):  # numbers that are none are decoded only now
        value = bytes(item.get_item(name).value or b"").decode("latin-1").split("\\")
    if value is None or value == "":
        return ()
    return tuple(_number(part) for part in (value if isinstance(value, Iterable) and not isinstance(value, str) else (value,)))


def _number(part: Any) -> float:
    try:
        return float(str(part).strip(" \0"))
    except ValueError:
        return np.nan


class _Groups:
    """Elements of one frame: in its functional groups, in those that all frames share, or at the top of the file."""

    def __init__(self, header: Any, index: int) -> None:
        own, shared = header.get("PerFrameFunctionalGroupsSequence"), header.get("SharedFunctionalGroupsSequence")
        self.header, self.index, self.items = header, index, []
        for group in (own[index] if own and index < len(own) else None, shared[0] if shared else None):
            for element in group or ():
                if element.VR == "SQ" and element.value and not element.tag.is_private:
                    self.items.append(element.value[0])
                    self.items += [inner.value[0] for inner in element.value[0] if inner.VR == "SQ" and inner.value]
        self.items.append(header)

    def item(self, name: str) -> Any:
        """The innermost item that has an element."""
        return next((item for item in self.items if name in item), None)

    def numbers(self, name: str) -> tuple[float, ...]:
        return numbers_of(self.item(name), name)

    def value(self, name: str) -> Value:
        """What an element says, to compare and to sort by; of a vector over frames, this frame's entry."""
        item = self.item(name)
        if item is None:
            return ()
        if numbers := tuple(n for n in numbers_of(item, name) if n == n):
            return numbers[self.index : self.index + 1] if name.endswith("Vector") else numbers
        value = item[name].value
        return tuple(map(str, value)) if not isinstance(value, str) and isinstance(value, Iterable) else (str(value or ""),)


def frames_of(path: Path, header: Any) -> list[Frame]:
    """What the header of a file says of each of its frames."""
    if not has_pictures(header):
        kind = getattr(header.get("SOPClassUID"), "name", "") or "object"
        raise FormatError(f"{path} holds no pictures: it is a DICOM {kind}")
    if "TotalPixelMatrixColumns" in header:
        raise FormatError(f"{path} must hold slices; its frames are tiles of a slide: OpenSlide and bioio read those")
    sizes = [numbers_of(header, name) for name in ("Rows", "Columns", "BitsAllocated")]
    counts = numbers_of(header, "NumberOfFrames") or (1.0,)
    if not all(size and size[0] > 0 for size in sizes) or not (counts[0] >= 1 and counts[0] == int(counts[0])):
        raise FormatError(
            f"cannot read {path}: it must say how many rows, columns, bits and frames it has; it is damaged or cut short"
        )
    rows, columns, bits = (int(size[0]) for size in sizes)
    channels = 3 if has_palette(header) else int((numbers_of(header, "SamplesPerPixel") or (1,))[0])
    announce(path.name, int(counts[0]) * rows * columns * channels * max(bits, 8) // 8)
    offsets = _offsets(header, int(counts[0]))
    frames = []
    for index in range(int(counts[0])):
        groups = _Groups(header, index)
        position, orientation = _place_of(groups)
        if offsets and position and orientation:
            position = moved(position, np.cross(orientation[:3], orientation[3:]) * offsets[index])
        elif counts[0] > 1 and groups.item("ImagePositionPatient") is header:
            position = ()  # of the first frame at most
        between = [abs(n[0]) for name in ("SpacingBetweenSlices", "SliceThickness") if (n := groups.numbers(name)) and n[0]]
        scale = _scale(path, groups)
        frames.append(
            Frame(
                path=path,
                index=index,
                kind=(rows, columns, channels),
                position=position,
                orientation=orientation,
                pixels=_pixels(groups),
                between=between[0] if between else np.nan,
                scale=scale,
                dtype=_dtype(header, bits, scale),
                clim=_clim(groups),
                location=(groups.numbers("SliceLocation") or (np.nan,))[0],
                number=(groups.numbers("InstanceNumber") or (np.nan,))[0],
                keys=_keys(groups, path),
            )
        )
    return _tiles(header, frames[0]) if "MOSAIC" in frames[0].keys.get("frame type", ()) else frames


def moved(position: Sequence[float], by: Any) -> tuple[float, ...]:
    return tuple(float(c) for c in np.add(position, by))


def _scale(path: Path, groups: _Groups) -> tuple[float, float] | None:
    """Slope and intercept of a frame; None if it has a lookup table instead."""
    if groups.header.get("ModalityLUTSequence"):
        return None
    found = []
    blank = not any(groups.numbers(name) for name in ("RescaleSlope", "DoseGridScaling", "RescaleIntercept"))  # they say nothing
    for names, default in ((("RescaleSlope", "DoseGridScaling"), 1.0), (("RescaleIntercept",), 0.0)):
        name = "" if blank else next((name for name in names if groups.item(name) is not None), "")
        value = next(iter(groups.numbers(name)), np.nan) if name else default
        if not np.isfinite(value) or (value == 0 and default):
            raise FormatError(f"{path.name} must have a finite {name}, and no slope of 0; it says {groups.value(name)}")
        found.append(value)
    return found[0], found[1]


def _dtype(header: Any, bits: int, scale: tuple[float, float] | None) -> np.dtype[Any] | None:
    """The smallest dtype for all values that stored bits can stand for; float64 where the scale is no whole number."""
    if scale is None or has_palette(header) or "FloatPixelData" in header or "DoubleFloatPixelData" in header:
        return None
    if any(number != int(number) for number in scale):
        return np.dtype(np.float64)
    stored = int((numbers_of(header, "BitsStored") or (bits,))[0])
    signed = numbers_of(header, "PixelRepresentation")[:1] == (1.0,)
    ends = sorted(int(scale[0]) * end + int(scale[1]) for end in (-(signed << stored - 1), (1 << stored - signed) - 1))
    return np.dtype(next((d for d in _DTYPES if np.iinfo(d).min <= ends[0] and ends[1] <= np.iinfo(d).max), np.float64))


def _place_of(groups: _Groups) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Position and orientation of a frame, () where the file does not say."""
    detector = groups.header.get("DetectorInformationSequence")  # nuclear medicine keeps both there
    places = []
    for name, count in (("ImagePositionPatient", 3), ("ImageOrientationPatient", 6)):
        numbers = groups.numbers(name) or (numbers_of(detector[0], name) if detector else ())
        places.append(numbers if len(numbers) == count and np.isfinite(numbers).all() else ())
    return places[0], places[1] if any(places[1]) else ()


def _tiles(header: Any, mosaic: Frame) -> list[Frame]:
    """The slices of a mosaic, as Siemens scanners tile them into one picture, with the geometry of its CSA header."""
    with warnings.catch_warnings(action="ignore"):  # it calls all its readers experimental
        csareader: Any = import_module("nibabel.nicom.csareader")
    csa = csareader.get_csa_header(header) or {"tags": {}}
    count = csareader.get_n_mosaic(csa) if csa["tags"] else None
    normal = csareader.get_slice_normal(csa) if csa["tags"] else None
    placed = mosaic.position and mosaic.orientation and mosaic.pixels and not np.isnan(mosaic.between)
    if not count or normal is None or not placed:
        raise FormatError(f"{mosaic.path} is a mosaic of slices, without the CSA header that says how many and where they lie")
    edge = int(np.ceil(np.sqrt(count)))
    if mosaic.kind[0] % edge or mosaic.kind[1] % edge:
        raise FormatError(
            f"{mosaic.path} is a mosaic of {count} slices: its rows and columns must be multiples of {edge}; it has "
            f"{mosaic.kind[0]} and {mosaic.kind[1]}"
        )
    rows, columns = mosaic.kind[0] // edge, mosaic.kind[1] // edge
    # The position is that of a single picture of the mosaic's size around the centre of the slice (nibabel, "Siemens mosaic").
    shift = np.multiply((mosaic.kind[1] - columns, mosaic.kind[0] - rows), mosaic.pixels[::-1]) / 2
    first = mosaic.position + shift @ np.reshape(mosaic.orientation, (2, 3))
    tiles = []
    for k in range(count):
        y, x = k // edge * rows, k % edge * columns
        position, tile = moved(first, k * mosaic.between * np.array(normal)), (slice(y, y + rows), slice(x, x + columns))
        tiles.append(replace(mosaic, kind=(rows, columns, mosaic.kind[2]), position=position, tile=tile))
    return tiles


def _pixels(groups: _Groups) -> tuple[float, ...]:
    """Distances between rows and between columns in mm, () if the file does not say."""
    for name in ("PixelSpacing", "ImagerPixelSpacing", "NominalScannedPixelSpacing"):
        if numbers := [n for n in groups.numbers(name) if np.isfinite(n) and n > 0]:
            return numbers[0], numbers[min(1, len(numbers) - 1)]  # some write one of two, or zeros between
    regions = groups.header.get("SequenceOfUltrasoundRegions") or []
    if len(regions) == 1 and _CENTIMETRES in numbers_of(regions[0], "PhysicalUnitsXDirection"):
        deltas = [delta for axis in "YX" for delta in numbers_of(regions[0], f"PhysicalDelta{axis}")]
        if len(deltas) == 2 and all(deltas):
            return 10 * abs(deltas[0]), 10 * abs(deltas[1])
    return ()


def _offsets(header: Any, frames: int) -> tuple[float, ...]:
    """Where the frames of a dose or of nuclear medicine lie along the normal of the first, in mm; () where nothing says so."""
    grid = numbers_of(header, "GridFrameOffsetVector")
    if frames > 1 and len(grid) == frames:
        return tuple(place - grid[0] for place in grid)  # the first may be 0 or a place along the patient
    slices, between = numbers_of(header, "SliceVector"), numbers_of(header, "SpacingBetweenSlices")
    if frames > 1 and len(slices) == frames and between and "DetectorInformationSequence" in header:
        return tuple((number - 1) * between[0] for number in slices)
    return ()


def _clim(groups: _Groups) -> tuple[float, float] | None:
    """The values that the source shows as black and as white."""
    center, width = groups.numbers("WindowCenter"), groups.numbers("WindowWidth")
    if not center or not width or not np.isfinite([center[0], width[0]]).all() or width[0] <= 0:
        return None
    return center[0] - width[0] / 2, center[0] + width[0] / 2


def _keys(groups: _Groups, path: Path) -> dict[str, Value]:
    """What may distinguish a frame from others of the same place, in order of meaning."""
    found = {name: [value for element in elements if (value := groups.value(element))] for name, elements in _KEYS.items()}
    for group, creator, element in _B_VALUES:
        with suppress(KeyError):
            item = groups.header.private_block(group, creator)
            found["b-value"] += [(b % 1e6,) for b in numbers_of({"b": item[element]}, "b")[:1]]  # GE adds 10⁹ to some
    keys = {name: values[0] for name, values in found.items() if values}
    dimensions = groups.header.get("DimensionIndexSequence") or ()
    for number, place in enumerate(groups.numbers("DimensionIndexValues")):
        label = str(dimensions[number].get("DimensionDescriptionLabel") or "") if number < len(dimensions) else ""
        keys[label or f"dimension {number + 1}"] = (place,)
    return keys | {"file": (path.name,)}
