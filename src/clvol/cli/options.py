"""Options that several commands share: how INPUT is read, what a picture shows and how, and what Tab completes."""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, make_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import CoercionError, Group, Parameter, Token

import clvol
from clvol.base.errors import ChunkError, OptionError
from clvol.bricks.continued import holed
from clvol.device import as_device
from clvol.formats.opening import WholeOnlyError, opened_if
from clvol.interfaces.again import parted
from clvol.interfaces.movie import series_of
from clvol.march.options import unheard
from clvol.scene.fit import usual_camera
from clvol.scene.look import look as look_of
from clvol.scene.mode import Mode, as_mode, every_option, mode_options, require_heard
from clvol.scene.transfer import FACTORS

__all__ = [
    "BOUNDARIES",
    "Background",
    "Boundary",
    "ColorMap",
    "Compared",
    "DeviceName",
    "FigureName",
    "FilterName",
    "Filters",
    "Furniture",
    "Input",
    "Json",
    "Look",
    "ModeOptions",
    "Output",
    "PageOutput",
    "ReportLook",
    "Rule",
    "Size",
    "SlicedLabels",
    "Source",
    "SurfaceLook",
    "Together",
    "Whole",
    "bytes_of",
    "bytes_text",
    "is_address",
    "label_of",
    "opacity_points",
    "own_options",
    "whole_numbers",
]


def whole_numbers(_: object, tokens: Sequence[Token]) -> int | tuple[int, ...]:
    """Convert whole numbers strictly: the parser's default would round 1.5 to 2."""
    numbers = []
    for token in tokens:
        try:
            numbers.append(int(token.value))
        except ValueError:
            raise CoercionError(token=token, target_type=int) from None
    return numbers[0] if len(numbers) == 1 else tuple(numbers)


def label_of(text: str) -> int | str:
    """The number or the name of a label."""
    return int(text) if re.fullmatch(r"-?\d+", text) else text


def bytes_of(text: str) -> int:
    """A number of bytes as people write it: 800M, 4G, 1.5GiB."""
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([KMGT]?)(?:i?B)?\s*", text, re.IGNORECASE)
    if found is None:
        raise OptionError(f"memory must be a number of bytes, such as 800M or 4G; got {text!r}")
    return int(float(found[1]) * 1024 ** " KMGT".index(found[2].upper() or " "))


def bytes_text(nbytes: float) -> str:
    """A number of bytes as text: 1.5 GiB."""
    power = min(4, max(0, math.floor(math.log2(max(nbytes, 1)) / 10)))
    return f"{nbytes / 1024**power:.3g} {('bytes', 'KiB', 'MiB', 'GiB', 'TiB')[power]}"


def _whole_or(word: str) -> Callable[[object, Sequence[Token]], int | str]:
    """A whole number, or one word."""

    def convert(kind: object, tokens: Sequence[Token]) -> int | str:
        if tokens[0].value == word:
            return word
        number = whole_numbers(kind, tokens)
        assert isinstance(number, int)  # of one token
        return number

    return convert


# -- completion by Tab ----------------------------------------------------------------------------------------


def _any_of(names: Callable[[], Mapping[str, Any] | Iterable[str]]) -> Callable[[object], dict[str, str]]:
    """A completer that offers names with their descriptions, if they have any."""

    def offered(_: object) -> dict[str, str]:
        found = names()
        rows: Mapping[str, Any] = found if isinstance(found, Mapping) else dict.fromkeys(found)
        return {name: getattr(row, "description", "") for name, row in rows.items()}

    return offered


def _filter_names() -> list[str]:
    table = clvol.filters()
    also = [other for row in table.rows() for other in row[-1].split()]
    return [*table, "bspline3(auto)", *also]


def _color_maps() -> list[str]:
    import cmap

    return sorted(cmap.Catalog().short_keys())


def _figure_names() -> Iterable[str]:
    from clvol import figures

    return list(figures.FIGURES)


# -- how INPUT is read ---------------------------------------------------------------------------------------

_INPUT = Group("Which volume of SOURCE, and how to read it", sort_key=2)
_LABELS: dict[str, Any] = {"negative": "", "consume_multiple": True}
_AFTER = ("fill_nan", "only_labels", "without_labels")  # changes of samples that were read
_LOOK = Group("What to show, and how", sort_key=3)
_OWN = Group("Options of the mode", sort_key=4)


@Parameter(name="*", group=_INPUT)
@dataclass
class Input:
    """How INPUT is read."""

    volume: Annotated[
        int | Literal["all"] | None,
        Parameter(help="Which of several volumes, from 0; resample and convert accept 'all'.", converter=_whole_or("all")),
    ] = None
    time: Annotated[int | None, Parameter(help="Which of several times, from 0.", converter=whole_numbers)] = None
    channel: Annotated[
        str | None, Parameter(help="Which channel, by number or name; also 'magnitude' of vectors, 'luminance' of colours.")
    ] = None
    position: Annotated[int | None, Parameter(help="Which stage position, from 0.", converter=whole_numbers)] = None
    series: Annotated[str | None, Parameter(help="Which image of a file or folder with several; see 'clvol info'.")] = None
    level: Annotated[
        int | None, Parameter(help="Resolution level, if the file has several: 0 is the finest.", converter=whole_numbers)
    ] = None
    shape: Annotated[
        tuple[int, int, int] | None, Parameter(help="Samples along z, y, x of a raw file.", converter=whole_numbers)
    ] = None
    dtype: Annotated[str | None, Parameter(help="Sample type of a raw file, such as uint16 or '>f4'.")] = None
    byte_order: Annotated[Literal["little", "big"] | None, Parameter(help="Byte order of a raw file.")] = None
    offset: Annotated[int | None, Parameter(help="Bytes of a raw file before its samples.", converter=whole_numbers)] = None
    spacing: Annotated[tuple[float, float, float] | None, Parameter(help="Spacing along x, y, z, instead of the file's.")] = None
    trusted: Annotated[bool, Parameter(negative="", help="Trust the file: read it in this process, without limits.")] = False
    fill_nan: Annotated[
        float | Literal["smoothly"] | None,
        Parameter(help="Value that replaces NaN and infinite samples, or 'smoothly'; by default pictures leave them out."),
    ] = None

    labels: Annotated[
        Path | None,
        Parameter(help="Table of names, colours and opacities of labels: a text file of FreeSurfer, 3D Slicer or ITK-SNAP."),
    ] = None
    only_labels: Annotated[
        tuple[str, ...], Parameter(help="Labels, by number or name, that are kept.", show_default=False, **_LABELS)
    ] = ()
    without_labels: Annotated[
        tuple[str, ...], Parameter(help="Labels, by number or name, that become background.", show_default=False, **_LABELS)
    ] = ()

    def read(self, source: str | Path) -> clvol.Volume:
        """The volume, or the chosen one of several."""
        volume = self.intact(source)
        return volume if isinstance(volume, clvol.Volume) else volume.whole()

    def intact(self, source: str | Path) -> clvol.Volume | clvol.LazyVolume:
        """As `read`; but what is at an address, or has damaged chunks, is opened: its other samples can be read."""
        self._require_one()
        if is_address(source):
            return self._remote(source)
        if (phantom := self._phantom(source)) is not None:
            return phantom
        try:
            return self._changed(clvol.read(source, **self._given()))
        except ChunkError:
            if self._takes_all:
                return self._changed(holed(clvol.open(source, **self._given())).whole())
            return self._opened(source)

    def open(self, source: str | Path) -> clvol.LazyVolume | clvol.Volume:
        """The volume, or the chosen one of several; no samples are read yet, if the file allows that."""
        self._require_one()
        if is_address(source):
            return self._remote(source)
        if (phantom := self._phantom(source)) is not None:
            return phantom
        if self._takes_all:
            return self.read(source)
        try:
            return self._opened(source)
        except WholeOnlyError:
            return self.read(source)

    def by_parts(self, source: str | Path, wanted: Callable[[clvol.LazyVolume], bool]) -> clvol.LazyVolume | None:
        """The opened volume if it is remote, or if `wanted` returns True for it; None if it should be read whole.

        None too if it cannot be opened: `read` then reads it, or raises the error.
        """
        self._require_one()
        if is_address(source):
            return self._remote(source)
        if str(source).startswith("phantom:") or self._takes_all:
            return None
        return opened_if(source, wanted, **self._given(), missing=self.fill_nan)

    def _opened(self, source: str | Path) -> clvol.LazyVolume:
        assert not isinstance(self.fill_nan, str)  # this needs all samples
        return clvol.open(source, **self._given(), missing=self.fill_nan)

    def _remote(self, source: str | Path) -> clvol.LazyVolume:
        """The volume at an address."""
        if isinstance(self.fill_nan, str):
            raise OptionError("--fill-nan smoothly is for files; give a value for an address")
        if self.only_labels or self.without_labels:
            raise OptionError("--only-labels and --without-labels are for files, which are read whole; got an address")
        return self._opened(source)

    def _require_one(self) -> None:
        if self.volume == "all":
            raise OptionError("--volume all is for resample and convert; give the number of one")

    def read_all(self, source: str | Path) -> clvol.Volumes:
        """All volumes; along axes for which an index was given, only that one."""
        if self.volume not in (None, "all") or self.is_changed:
            raise OptionError("--volume all takes neither the number of a volume nor --fill-nan, --only-labels or --without-labels")
        if (phantom := self._phantom(source)) is not None:
            return clvol.Volumes([phantom])
        given = self._given()
        raw = {"shape", "dtype", "byte_order", "offset"} & given.keys()
        return clvol.Volumes([clvol.read(source, **given)]) if raw else clvol.read_all(source, **given)

    def playing(self, source: str | Path, limits: Mapping[str, Any]) -> list[clvol.Volume | clvol.LazyVolume]:
        """The volumes along the times of a file, or else its volumes; the chosen one, if one was chosen."""
        self._require_one()
        if not self.is_changed:
            return series_of(source, limits, **self._given())
        if self._takes_all or self.volume is not None or self.time is not None:
            return [self.intact(source)]
        return [self._changed(one) if isinstance(one, clvol.Volume) else one for one in series_of(source, limits, **self._given())]

    def python(self, source: str | Path) -> str | None:
        """The call in Python that reads the volume; None if there is no short one."""
        given = self._given()
        if str(source).startswith("phantom:"):
            return None if given else f"clvol.phantoms.by_name({str(source).removeprefix('phantom:')!r})"
        if is_address(source):
            return f"{self.python_opened(source)}.whole()"
        filled = "" if self.fill_nan is None else f".filled({'' if self.fill_nan == 'smoothly' else self.fill_nan})"
        text = _call("clvol.read", source, given) + filled
        for what, labels in self._chosen_labels.items():
            text = f"clvol.labels.{what.removesuffix('_labels')}({text}, {labels!r})"
        return text

    def python_opened(self, source: str | Path) -> str:
        """The call in Python that opens the volume."""
        return _call("clvol.open", source, self._given() | ({} if self.fill_nan is None else {"missing": self.fill_nan}))

    def leading(self, source: str | Path) -> clvol.volume.volumes.Leading:
        """The axes of the file before z, y and x."""
        if self._phantom(source) is not None:
            return clvol.volume.volumes.Leading()
        given = self._given()
        return clvol.formats.leading_of(source, series=given.get("series"), level=given.get("level"), trusted=self.trusted)

    def _given(self) -> dict[str, Any]:
        """What was given, as arguments of `clvol.read`; numbers of channels and series become int."""
        given: dict[str, Any] = {}
        for field in fields(self):
            value = getattr(self, field.name)
            if value is not None and value is not False and (field.name, value) != ("volume", "all") and field.name not in _AFTER:
                value = str(value) if isinstance(value, Path) else value
                number = isinstance(value, str) and field.name in ("channel", "series") and value.isdecimal() and len(value) < 10
                given[field.name] = int(value) if number else value
        return given

    def noted(self) -> dict[str, Any]:
        """How the volume is read, as a picture's file says it."""
        return self._given() | ({} if self.fill_nan is None else {"fill_nan": self.fill_nan}) | self._chosen_labels

    @property
    def is_changed(self) -> bool:
        """Whether samples are changed after they were read."""
        return self.fill_nan is not None or bool(self._chosen_labels)

    @property
    def _takes_all(self) -> bool:
        """Whether this needs all samples."""
        return isinstance(self.fill_nan, str) or bool(self._chosen_labels)

    @property
    def _chosen_labels(self) -> dict[str, list[int | str]]:
        """Labels that are kept, and those that are removed, if some are given."""
        given = {"only_labels": self.only_labels, "without_labels": self.without_labels}
        return {what: [label_of(text) for text in texts] for what, texts in given.items() if texts}

    def _phantom(self, source: str | Path) -> clvol.Volume | None:
        if not str(source).startswith("phantom:"):
            return None
        if wrong := [name for name in self._given() if name != "spacing"]:
            flags = ", ".join(f"--{name.replace('_', '-')}" for name in wrong)
            raise OptionError(f"{flags} is for files; give a phantom's size as phantom:NAME:SIZE")
        volume = clvol.phantoms.by_name(str(source).removeprefix("phantom:"))
        return volume if self.spacing is None else replace(volume, spacing=self.spacing)

    def _changed(self, volume: clvol.Volume) -> clvol.Volume:
        if self.fill_nan is not None:
            volume = volume.filled(None if self.fill_nan == "smoothly" else self.fill_nan)
        return parted(volume, self._chosen_labels)


def _call(function: str, source: str | Path, given: Mapping[str, Any]) -> str:
    return f"{function}({str(source)!r}{''.join(f', {name}={value!r}' for name, value in given.items())})"


# -- what to show, and how -----------------------------------------------------------------------------------

_MODES = f"{', '.join(clvol.modes())}."
BOUNDARIES = f"What lies past the outer samples: {', '.join(clvol.boundaries())}; with a value, constant(5) or grid-constant(5)."
Boundary = Annotated[str, Parameter(help=BOUNDARIES, completer=_any_of(clvol.boundaries))]
Rule = Annotated[
    str | None,
    Parameter(
        help=f"{BOUNDARIES} By default mirror; of labels with smooth boundaries, nearest.",
        completer=_any_of(clvol.boundaries),
        show_default=False,
    ),
]
_Mode = Annotated[str, Parameter(help=_MODES, completer=_any_of(clvol.modes))]
_PLAIN = (
    "rays",
    "pixel_filter",
    "shadow",
    "shadow_rays",
    "occlusion",
    "linear_light",
    "gradient",
)  # of a look, as of `clvol.render`
_Six = tuple[float, float, float, float, float, float]
Background = Annotated[
    str | None, Parameter(help="A name, a hex code, or 'none'. [default: black; white in theme print]", show_default=False)
]


@Parameter(name="*", group=_LOOK)
@dataclass
class Look:
    """What a picture shows, and how."""

    mode: _Mode = "composite"
    preset: Annotated[
        str | None,
        Parameter(help="Colours and opacities for one kind of data; see 'clvol presets'.", completer=_any_of(clvol.presets)),
    ] = None
    window: Annotated[
        tuple[float, float] | None,
        Parameter(help="Centre (which radiologists call level) and width of the values that are told apart."),
    ] = None
    cmap: Annotated[
        str | None,
        Parameter(help="Colour map by name, instead of the automatic colours; opacities stay.", completer=_any_of(_color_maps)),
    ] = None
    value_range: Annotated[
        tuple[float, float] | None, Parameter(help="Values that the colour map spans, grey where no map is given.")
    ] = None
    transfer: Annotated[
        Path | None,
        Parameter(help="Colours and opacities of a JSON file, by the gradient too, as the viewer saves them.", show_default=False),
    ] = None
    opacity: Annotated[
        tuple[float, ...] | None,
        Parameter(
            help="Points of the opacity, value opacity value opacity ...; or one number, which scales it. Colours stay.",
            consume_multiple=True,
        ),
    ] = None
    gradient_opacity: Annotated[
        tuple[float, ...] | None,
        Parameter(
            help="Opacity by the gradient, too: one number, 0 to 1, how much of it is missing where matter is even; or points, "
            "magnitude factor magnitude factor ..., in units of the data per world unit.",
            consume_multiple=True,
            show_default=False,
        ),
    ] = None
    curvature_opacity: Annotated[
        tuple[float, ...] | None,
        Parameter(
            help="Opacity by how isosurfaces bend, too: points, curvature factor curvature factor ..., per world unit.",
            consume_multiple=True,
            show_default=False,
        ),
    ] = None
    clip: Annotated[_Six | None, Parameter(help="Show only this box: two corners, x y z x y z, in world units.")] = None
    clip_plane: Annotated[
        tuple[_Six, ...],
        Parameter(
            help="Cut away the half that a plane's normal points to: normal and point, nx ny nz x y z. May be repeated.",
            show_default=False,
        ),
    ] = ()
    clip_corner: Annotated[
        tuple[_Six, ...],
        Parameter(
            help="Cut away what is in this box: two corners, x y z x y z, which may be inf or -inf. May be repeated.",
            show_default=False,
        ),
    ] = ()
    boundary: Rule = None
    step: Annotated[
        float | None,
        Parameter(help="The most that a ray advances between samples, in voxels; exact surfaces take none. [default: 0.5]"),
    ] = None
    rays: Annotated[
        int | Literal["auto"] | None,
        Parameter(help="Rays a pixel; 'auto': more where there are edges.", converter=_whole_or("auto")),
    ] = None
    pixel_filter: Annotated[
        str | None,
        Parameter(
            help="What several rays a pixel sample: a filter without a prefilter. [default: linear]",
            show_default=False,
            completer=_any_of(clvol.filters),
        ),
    ] = None
    background: Background = None
    shadow: Annotated[
        float | None, Parameter(help="How dark shadows are, 0 to 1; the lights then stand still.", show_default=False)
    ] = None
    shadow_rays: Annotated[
        bool | None, Parameter(help="Whether shadows of exact surfaces are exact, too. [default: no]", show_default=False)
    ] = None
    occlusion: Annotated[float | None, Parameter(help="How dark it is where matter is around, 0 to 1.", show_default=False)] = None
    linear_light: Annotated[
        bool | None,
        Parameter(
            help="Whether colours are computed in linear light, or with their numbers in sRGB. [default: no]", show_default=False
        ),
    ] = None
    gradient: Annotated[
        Literal["analytic", "central"] | None,
        Parameter(help="The gradient that lighting uses. [default: analytic, where the filter has slopes]", show_default=False),
    ] = None
    azimuth: Annotated[float | None, Parameter(help="Degrees about the z axis; 30, but for thin stacks of images.")] = None
    elevation: Annotated[
        float | None, Parameter(help="Degrees above the xy plane; 20, but for thin stacks of images: 55 to 90.")
    ] = None
    zoom: Annotated[float, Parameter(help="Magnification, relative to the fitted view.")] = 1.0
    fit: Annotated[Literal["matter", "volume"], Parameter(help="What fills the picture: everything visible, or the volume.")] = (
        "matter"
    )
    projection: Annotated[Literal["perspective", "orthographic"], Parameter(help="How rays start at the camera.")] = "perspective"
    evaluator: Annotated[Literal["auto", "taps", "paired", "eight-fetch"], Parameter(help="How the spline is evaluated.")] = "auto"
    fetch: Annotated[Literal["auto", "buffer", "image"], Parameter(help="Where coefficients are read from.")] = "auto"

    def options(self, volume: clvol.Volume) -> dict[str, Any]:
        """Arguments of `clvol.render`."""
        transfer = self.function(volume)
        return self.of_scene(volume) | ({} if transfer is None else {"transfer": transfer})

    def of_scene(self, volume: clvol.Volume) -> dict[str, Any]:
        """The same for a scene, whose first medium has the transfer function."""
        given: dict[str, Any] = {name: getattr(self, name) for name in _PLAIN} | self.factors()
        given |= {"clip": self.cuts() or None}
        given |= {"camera": self.camera(volume), "mode": self.mode, "step": self.step, "background": self.background}
        given = {name: value for name, value in given.items() if value is not None}
        return given | ({"background": None} if self.background == "none" else {})

    def named(self, volume: clvol.Volume) -> dict[str, Any]:
        """The same with the transfer function by its words, if they say it."""
        return self.options(volume) if self.value_range or self.transfer else self.of_scene(volume) | self.words()

    def cuts(self) -> list[Any]:
        """What is cut away."""
        planes = [clvol.Plane(plane[:3], plane[3:]) for plane in self.clip_plane]
        corners = [clvol.Corner(corner[:3], corner[3:]) for corner in self.clip_corner]
        return [*([] if self.clip is None else [(self.clip[:3], self.clip[3:])]), *planes, *corners]

    def words(self) -> dict[str, Any]:
        """The transfer function in words, as `clvol.render` takes it."""
        seen = opacity_points("opacity", self.opacity)
        given = {"preset": self.preset, "window": self.window, "cmap": self.cmap, "opacity": seen}
        return {name: value for name, value in given.items() if value is not None}

    def factors(self) -> dict[str, Any]:
        """Factors of opacity, as `clvol.render` takes them."""
        given = {name: opacity_points(name, getattr(self, name)) for name in FACTORS}
        return {name: value for name, value in given.items() if value is not None}

    def require_heard(self, mode: Mode, outputs: Sequence[str]) -> None:
        """Raise `OptionError` if an option changes nothing in a mode and in these outputs."""
        given = self.words() | {name: getattr(self, name) for name in (*_PLAIN, "transfer")} | self.factors()
        reasons = unheard(mode, given, outputs)
        if mode.stretches and self.step is not None:
            reasons["step"] = "surfaces are exact, and take no samples"
        if self.value_range is not None:
            beside = {"preset", "window"} & given.keys() if mode.shows != "matter" else set()
            reasons |= dict.fromkeys(beside, "the range of values gives black and white")
            reasons |= {"value_range": mode.unheard["cmap"]} if "cmap" in mode.unheard else {}
        require_heard(mode, reasons, reasons)

    def limits(self) -> dict[str, Any]:
        """Limits of the device while it draws, where they differ from its defaults."""
        asked = {"evaluator": self.evaluator, "fetch": self.fetch}
        return {name: value for name, value in asked.items() if value != "auto"}

    @contextlib.contextmanager
    def limited(self, device: str | None) -> Iterator[None]:
        """Set these limits of the device for the duration of a block. Without limits, no device is chosen."""
        limits = self.limits()
        with as_device(device).limited(**limits) if limits else contextlib.nullcontext():
            yield

    def camera(self, volume: clvol.Volume) -> clvol.Camera:
        """The camera for a volume."""
        own: dict[str, Any] = {"zoom": self.zoom, "projection": self.projection, "fit": self.fit}
        if self.azimuth is None and self.elevation is None:
            return replace(usual_camera(volume), **own)
        return clvol.Camera.orbit(*self.turned, **own)

    @property
    def turned(self) -> tuple[float, float]:
        """Azimuth and elevation, where some are given."""
        return 30.0 if self.azimuth is None else self.azimuth, 20.0 if self.elevation is None else self.elevation

    def function(self, volume: clvol.Volume) -> clvol.TransferFunction | None:
        """The requested transfer function; None: the mode's default."""
        words = self.words()
        if self.transfer is not None:
            if given := [*words, *(["value_range"] if self.value_range else [])]:
                raise OptionError(f"transfer is a file of colours and opacities: leave out {' and '.join(given)}")
            return clvol.read_transfer(self.transfer)
        if self.value_range is None:
            return look_of(volume, self.mode, **words) if words else None
        spread = clvol.TransferFunction.from_cmap(words.pop("cmap", "gray"), self.value_range)
        return replace(look_of(volume, self.mode, **words), colors=spread.colors)


def opacity_points(name: str, given: tuple[float, ...] | None) -> float | tuple[tuple[float, float], ...] | None:
    """An opacity, or factors of it, as `clvol.render` takes them."""
    if given is None or len(given) == 1:
        return None if given is None else given[0]
    if len(given) % 2:
        flag = f"--{name.replace('_', '-')}"
        raise OptionError(f"{flag} takes one number, or pairs of a place and an opacity or factor; got {len(given)} numbers")
    return tuple(zip(given[0::2], given[1::2], strict=True))


@Parameter(name="*", group=_LOOK)
@dataclass
class SlicedLabels:
    """How slices show labels."""

    smooth: Annotated[
        bool, Parameter(help="Labels have smooth boundaries on slices, as with 'clvol render --mode regions'.", negative="")
    ] = False
    contour: Annotated[
        float, Parameter(help="Draw lines along the boundaries of labels on slices, so many pixels wide (1 to 16), no areas.")
    ] = 0.0


@Parameter(name="*", group=_LOOK)
@dataclass
class SurfaceLook(Look):
    """The same, with surfaces as the default."""

    mode: _Mode = "isosurface"


@Parameter(name="*", group=_LOOK)
@dataclass
class ReportLook(SurfaceLook):
    """The same for the pictures of a report, on white."""

    background: Background = "white"


@Parameter(name="*", group=Group("What stands around a picture: nothing by default", sort_key=4))
@dataclass
class Furniture:
    """What stands around a picture."""

    color_bar: Annotated[bool, Parameter(negative="", help="The colours of the transfer function, with values and opacity.")] = (
        False
    )
    scale_bar: Annotated[
        bool, Parameter(negative="", help="A bar of a round length; in perspective true at the depth of what fills the picture.")
    ] = False
    axes: Annotated[bool, Parameter(negative="", help="Ticks with the world's coordinates, and their grid behind the volume.")] = (
        False
    )
    box: Annotated[bool, Parameter(negative="", help="The edges of the box around the volume.")] = False
    letters: Annotated[bool, Parameter(negative="", help="The sides of a patient at the edges: L, R, A, P, S, I.")] = False
    cube: Annotated[bool, Parameter(negative="", help="A small cube with these letters, or with x, y and z.")] = False
    title: Annotated[str | None, Parameter(help="Text above.")] = None
    time_stamp: Annotated[str | None, Parameter(help="Text at the upper left.")] = None
    theme: Annotated[Literal["screen", "print"] | None, Parameter(help="'print' is on white.", show_default=False)] = None

    def options(self) -> dict[str, Any]:
        """Arguments of `clvol.render`."""
        return {name: value for name, value in vars(self).items() if value not in (None, False)}


# -- options of modes ----------------------------------------------------------------------------------------

_ALSO = {"isovalue": "--threshold"}
"""Common names of the options of modes."""
_KINDS = {"isovalue": float | str, "cap": str, "surfaces": str, "color_by": str}
"""Types that a default does not show."""
_CAPS = {"values": True, "none": False}
"""Caps that are no colours, by their names in the shell."""


def _flag(name: str) -> tuple[str, Any, None]:
    """A flag for an option of modes, documented by their classes. Its default is the mode's."""
    having = [mode for mode in clvol.modes().values() if name in mode_options(mode)]
    defaults = [getattr(mode, name) for mode in having]
    kind: Any = bool if isinstance(defaults[0], bool) else str if isinstance(defaults[0], (str, tuple)) else _KINDS.get(name, float)
    says = [f"{mode_options(mode)[name]} ({mode.name}{_default(getattr(mode, name))})" for mode in having]
    says += ["Here: values, none or a colour."] if name == "cap" else []
    return name, Annotated[kind | None, Parameter(help=" ".join(says), alias=_ALSO.get(name))], None


def _default(value: object) -> str:
    """A mode's default as text; "" if it follows from the volume."""
    if value is None:
        return ""
    return f"; default {' '.join(f'{v:g}' for v in value) if isinstance(value, tuple) else value}"


class Given:
    """The options of a mode that were given."""

    def options(self) -> dict[str, Any]:
        """The options; a colour may be three numbers in one argument."""
        given = {name: value for name, value in vars(self).items() if value is not None}
        if isinstance(given.get("color"), str) and re.fullmatch(r"\s*([\d.e+-]+[\s,]+){2}[\d.e+-]+\s*", given["color"]):
            with contextlib.suppress(ValueError):  # 1.2.3 is not a number: it is refused as a name later
                given["color"] = tuple(float(v) for v in re.split(r"[\s,]+", given["color"].strip()))
        if "cap" in given:
            given["cap"] = _CAPS.get(given["cap"], given["cap"])
        return given


if TYPE_CHECKING:
    ModeOptions = Given
else:
    ModeOptions = Parameter(name="*", group=_OWN)(
        make_dataclass("ModeOptions", map(_flag, sorted(every_option())), bases=(Given,), namespace={"__module__": __name__})
    )


def own_options(
    look: Look,
    own: ModeOptions | None,
    outputs: Sequence[str] = ("rgba",),
    *,
    shown: bool = True,
    around: Mapping[str, Any] | None = None,
    colored: bool = False,
) -> dict[str, Any]:
    """The options given for the mode; raises, before the volume is read, if it does not have them.

    It raises too if an option of the look changes nothing in it, unless other modes may follow, as in a viewer (`shown` is False).
    `colored`: another volume colours what the mode shows.
    """
    options = {} if own is None else own.options()
    mode = as_mode(look.mode, options)
    if shown:
        look.require_heard(mode, outputs)
    require_heard(mode, unheard(mode, around or {}, outputs, colored=colored))
    return options


# -- who draws -----------------------------------------------------------------------------------------------


@Parameter(name="*", group=Group("By several processes", sort_key=6))
@dataclass
class Together:
    """The processes that draw."""

    scheduler: Annotated[
        str | None,
        Parameter(
            help="The address of a dask scheduler (tcp://host:8786) whose workers draw; they need this version of clvol, and "
            "access to files that are read by bricks."
        ),
    ] = None
    workers: Annotated[int | None, Parameter(help="Instead, how many processes on this machine.", converter=whole_numbers)] = None

    @property
    def cluster(self) -> str | int | None:
        """The argument of `clvol.dask.cluster.as_cluster`; None: this process."""
        if self.scheduler is not None and self.workers is not None:
            raise OptionError(f"give --scheduler or --workers; got both: {self.scheduler} and {self.workers}")
        return self.scheduler if self.workers is None else self.workers


# -- the rest ------------------------------------------------------------------------------------------------


def is_address(source: str | Path) -> bool:
    """Whether it is not a file, but an address for fsspec."""
    return "://" in str(source)


# `Path` makes Tab complete names of files; the text stays as given
Source = Annotated[
    str | Path, Parameter(help="A volume file, a folder of slices, the address of a Zarr store, or phantom:NAME[:SIZE].")
]
Json = Annotated[bool, Parameter(name="--json", negative="", help="Print JSON, for programs.")]
Output = Annotated[Path, Parameter(name=["--output", "-o"], help="The file to write.")]
PageOutput = Annotated[Path, Parameter(name=["--output", "-o"], help="A folder, or a file that ends in .html.")]
Whole = Annotated[int, Parameter(converter=whole_numbers)]
Size = Annotated[tuple[int, int], Parameter(help="Width and height in pixels.", converter=whole_numbers)]
DeviceName = Annotated[str | None, Parameter(help="Number, 'cpu', 'gpu' or part of a name; see 'clvol devices'.")]
ColorMap = Annotated[str, Parameter(completer=_any_of(_color_maps))]
FilterName = Annotated[str, Parameter(completer=_any_of(_filter_names))]
FigureName = Annotated[
    str,
    Parameter(
        help="1 to 6 as in the paper, impulse, gradients, convergence, noise, slices, edges, reduction or cost.",
        completer=_any_of(_figure_names),
    ),
]
Filters = Annotated[
    tuple[str, ...],
    Parameter(
        help="The filters, one picture each. [default: the six of Figure 6]",
        show_default=False,
        consume_multiple=True,
        completer=_any_of(_filter_names),
    ),
]
Compared = Annotated[
    tuple[str, ...],
    Parameter(
        help="Filters to compare; see 'clvol filters'.", show_default=False, consume_multiple=True, completer=_any_of(_filter_names)
    ),
]
