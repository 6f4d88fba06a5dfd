"""What a viewer shows, as one value: frozen, validated, and the same in JSON; and the history of such values for undo.

It holds everything that a picture depends on, and nothing else: equal states of one volume give equal pictures.
"""

# ruff: noqa: RUF009  # `_of` and `_part` make fields, as `dataclasses.field`

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, is_dataclass, replace
from functools import partial
from typing import Any, ClassVar, Literal, Self, TypeAlias

from clvol.base.arrays import reals
from clvol.base.axes import AXES
from clvol.base.checks import as_object, instance, number, one_of, whole
from clvol.base.errors import ClvolError, OptionError
from clvol.filter.boundary import as_boundary
from clvol.filter.table import as_filter
from clvol.scene.clip import Corner, Plane, as_clip
from clvol.scene.light import MAX_LIGHTS, Light, Material
from clvol.scene.mode import as_mode, heard_options
from clvol.scene.preset import as_preset
from clvol.scene.scene import MOST_MEDIA
from clvol.scene.transfer import WORDS, TransferFunction
from clvol.scene.written import transfer_of
from clvol.show.furniture import Furniture
from clvol.volume.volumes import COMPUTED

__all__ = [
    "LAYOUTS",
    "MARKS",
    "MOST_LABELS",
    "MOST_POINTS",
    "PANES",
    "WORDS",
    "ZOOMS",
    "CameraState",
    "History",
    "LabelState",
    "Mark",
    "MediumState",
    "SliceState",
    "State",
    "Triple",
    "Wiper",
    "name_of",
    "plain",
]

Triple: TypeAlias = tuple[float, float, float]
Pane: TypeAlias = Literal["3d", "x", "y", "z"]

PANES: tuple[Pane, ...] = ("3d", "x", "y", "z")
"""Names of panes: the volume, and slices across x, y and z in the world."""

VERSION = 1
LAYOUTS = ("3d", "slice", "linked")
ZOOMS = 0.05, 1000.0
MOST_POINTS = 512  # of a transfer function; they fit into one message
_LONGEST_IMAGE = 40_000  # characters of that of a transfer function; likewise
MOST_LABELS = 2048  # that are hidden or shown; they fit into one message
_WHOLE = re.compile(r"-?\d{1,16}")
MARKS: Mapping[str, tuple[int, int]] = {
    "distance": (2, 2),
    "angle": (1, 3),
    "area": (1, 64),
    "rectangle": (3, 3),
    "ellipse": (3, 3),
}
"""What can be measured, and the least and the most points of it."""

_MOST_MARKS, _MOST_CORNERS = 64, 512  # they fit into one message
_TOOLS = ("orbit", "pan", "zoom", "roll", "window", "isovalue", "crop", "crosshair", *MARKS)
_MOST_LABEL = 1 << 53  # the largest integer up to which float64 holds all
_LONGEST_TITLE = 200  # characters
_MOST_PLACES = (1 << 31) - 1  # volumes along an axis
_FARTHEST = 1e15  # world units; its square and cube do not overflow


# -- checks of values: functions of a field's name and the value ---------------------------------------------


def _triple(what: str, value: object) -> Triple:
    rule = "three finite numbers"
    vector = reals(what, value, rule)
    if vector.shape != (3,) or not all(math.isfinite(v) and abs(v) <= _FARTHEST for v in vector.tolist()):
        raise OptionError(f"{what} must be {rule}; got {value!r}")
    x, y, z = vector.tolist()
    return float(x), float(y), float(z)


def _way(what: str, value: object) -> Triple:
    way = _triple(what, value)
    if not math.hypot(*way) > 1e-12:
        raise OptionError(f"{what} must not have zero length; got {value!r}")
    return way


def _color(what: str, value: object) -> Triple:
    """Only numbers: names would not come back from JSON unchanged."""
    color = _triple(what, value)
    if not all(0 <= v <= 1 for v in color):
        raise OptionError(f"{what} must be three numbers in 0..1; got {value!r}")
    return color


def name_of(what: str, value: object, allowed: Sequence[str] | Mapping[str, Any]) -> str:
    """The value, if it is one of these names."""
    if not isinstance(value, str) or value not in allowed:
        raise one_of(what, value, allowed)
    return value


def _named(what: str, value: object, known: Callable[[str], object]) -> str:
    """A name that `known` accepts; its error lists the names."""
    if not isinstance(value, str) or len(value) > 200:
        raise OptionError(f"{what} must be a name; got {value!r:.200}")
    known(value)
    return value


def _filter(what: str, value: object) -> str:
    name = _named(what, value, as_filter)
    if as_filter(name).support > 32:
        raise OptionError(f"{what} must be a filter of at most 32 taps an axis; got {value!r}")
    return name


def _switch(what: str, value: object) -> bool:
    if not isinstance(value, bool):
        raise OptionError(f"{what} must be true or false; got {value!r}")
    return value


def _instance(what: str, value: object, kind: type) -> Any:
    instance(what, value, kind)
    return value


def _numbers(what: str, value: object) -> tuple[int, ...]:
    rule = f"a list of up to {MOST_LABELS} whole numbers"
    if not isinstance(value, (list, tuple)):
        raise OptionError(f"{what} must be {rule}; got {value!r:.200}")
    if len(value) > MOST_LABELS:
        raise OptionError(f"{what} must be {rule}; got {len(value)} of them")
    return tuple(sorted({whole(f"each of {what}", part, -_MOST_LABEL, _MOST_LABEL) for part in value}))


def _by_label(what: str, value: object, each: Callable[..., Any]) -> dict[int, Any]:
    """Something of each of some labels, by their numbers, which in JSON are texts."""
    if not isinstance(value, Mapping) or len(value) > MOST_LABELS:
        raise OptionError(f"{what} must be an object of JSON, of up to {MOST_LABELS} labels; got {value!r:.200}")
    numbers = {int(key) if isinstance(key, str) and _WHOLE.fullmatch(key) else key: part for key, part in value.items()}
    labels = _numbers(f"the labels of {what}", tuple(numbers))
    return {label: each(f"{what}.{label}", numbers[label]) for label in labels}


def _index(what: str, value: object) -> dict[str, int | str]:
    given = as_object(what, value, set(AXES))
    return {axis: _place_along(axis, given[axis]) for axis in AXES if axis in given}


def _place_along(axis: str, value: object) -> int | str:
    if axis == "channel" and isinstance(value, str):
        return name_of("index.channel", value, COMPUTED)
    return whole(f"index.{axis}", value, 0, _MOST_PLACES)


def _options(what: str, value: object) -> dict[str, Any]:
    if not isinstance(value, Mapping) or not all(isinstance(name, str) for name in value):
        raise OptionError(f"{what} must be an object of JSON, by names of the mode's options; got {value!r:.200}")
    return dict(value)


def _window(what: str, value: object) -> tuple[float, float]:
    rule = "two finite numbers, (center, width), the width positive"
    pair = reals(what, value, rule)
    if pair.shape != (2,) or not all(map(math.isfinite, pair.tolist())) or not pair[1] > 0:
        raise OptionError(f"{what} must be {rule}; got {value!r:.200}")
    center, width = pair.tolist()
    if not center - width / 2 < center + width / 2:
        raise OptionError(f"{what} must be {rule}, and wide enough to tell its ends apart; got {value!r}")
    return float(center), float(width)


def _lights(what: str, value: Any) -> tuple[Light, ...]:
    lights = tuple(value)
    if len(lights) > MAX_LIGHTS or not all(isinstance(light, Light) for light in lights):
        raise OptionError(f"{what} must be up to {MAX_LIGHTS} of Light; got {value!r:.200}")
    return lights


def _box(what: str, value: Any) -> tuple[Triple, Triple]:
    rule = "two corners, low and high, each coordinate of low less than of high"
    try:
        first, last = value
    except (TypeError, ValueError):
        raise OptionError(f"{what} must be {rule}; got {value!r:.200}") from None
    low, high = _triple(f"{what}.low", first), _triple(f"{what}.high", last)
    if not all(a < b for a, b in zip(low, high, strict=True)):
        raise OptionError(f"{what} must be {rule}; got {value!r:.200}")
    return low, high


# -- parts in JSON -------------------------------------------------------------------------------------------


def plain(value: Any) -> Any:
    """The value as JSON gives it back: lists for tuples, objects for dataclasses."""
    if isinstance(value, (tuple, list)):
        return [plain(part) for part in value]
    if isinstance(value, Mapping):
        return {str(key): plain(part) for key, part in value.items()}
    if is_dataclass(value):
        return {each.name: plain(getattr(value, each.name)) for each in fields(value)}
    return value


def _transfer(what: str, value: Any) -> TransferFunction:
    """Of a size that fits into one message."""
    instance(what, value, TransferFunction)
    image = getattr(value, "image", None)
    if image is not None and len(image.text) > _LONGEST_IMAGE:
        raise OptionError(
            f"{what}.image must take up to {_LONGEST_IMAGE} characters in JSON, compressed, so that a page can have it; got "
            f"{len(image.text)}: give fewer nodes, or shapes"
        )
    return value  # type: ignore[no-any-return]  # checked


def _transfer_of(what: str, value: Any) -> TransferFunction:
    points = value.get("points") if isinstance(value, dict) else None
    if isinstance(points, (list, tuple)) and len(points) > MOST_POINTS:
        raise OptionError(f"{what}.points must be up to {MOST_POINTS}; got {len(points)}")
    return transfer_of(what, value)


def _light_of(what: str, value: object) -> Light:
    given = as_object(what, value, {"direction", "color", "frame"})
    direction = given.get("direction")
    direction = None if direction is None else _triple(f"{what}.direction", direction)
    try:
        return Light(direction, _color(f"{what}.color", given.get("color", (1.0, 1.0, 1.0))), given.get("frame", "world"))
    except ClvolError as error:
        raise OptionError(f"{what}: {error}") from None


def _lights_of(what: str, value: object) -> tuple[Light, ...]:
    if not isinstance(value, (list, tuple)):
        raise OptionError(f"{what} must be a list of up to {MAX_LIGHTS}; got {value!r:.200}")
    return tuple(_light_of(what, light) for light in value[: MAX_LIGHTS + 1])


def _dataclass_of(what: str, value: object, kind: Callable[..., Any]) -> Any:
    known = fields(kind)  # type: ignore[arg-type]  # of a dataclass
    given = as_object(what, value, {each.name for each in known})
    needed = [each.name for each in known if each.default is MISSING and each.default_factory is MISSING]
    if not given.keys() >= set(needed):
        raise OptionError(f"{what} must each have {' and '.join(needed)}; got {value!r:.200}")
    try:
        return kind(**given)
    except TypeError as error:
        raise OptionError(f"{what}: {error}") from None


def _clip_of(what: str, value: object) -> tuple[Triple, Triple]:
    given = as_object(what, value, {"low", "high"})
    return _box(what, (given.get("low"), given.get("high")))


def _cuts(what: str, value: Any) -> tuple[Plane | Corner, ...]:
    cuts = tuple(value)
    if not all(isinstance(cut, Plane | Corner) for cut in cuts):
        raise OptionError(f"{what} must be planes and corners; got {value!r:.200}")
    try:
        as_clip(cuts)
    except ClvolError as error:
        raise OptionError(f"{what}: {error}") from None
    return cuts


def _cuts_of(what: str, value: object) -> tuple[Plane | Corner, ...]:
    if not isinstance(value, (list, tuple)):
        raise OptionError(f"{what} must be a list of planes and corners; got {value!r:.200}")
    return tuple(_cut_of(what, cut) for cut in value)


def _cut_of(what: str, value: object) -> Plane | Corner:
    """JSON has no infinite numbers: in corners null stands for these."""
    given = as_object(what, value, {"normal", "point", "low", "high"})
    try:
        if "normal" in given:
            return Plane(given["normal"], given.get("point"))  # type: ignore[arg-type]  # it is checked
        ends = zip((given.get("low"), given.get("high")), (-math.inf, math.inf), strict=True)
        return Corner(*(tuple(end if v is None else v for v in corner) for corner, end in ends))  # type: ignore[union-attr]
    except (ClvolError, TypeError) as error:
        raise OptionError(f"{what}: {error}") from None


def _cut_json(cut: Plane | Corner) -> dict[str, list[float | None]]:
    return {each.name: [v if math.isfinite(v) else None for v in getattr(cut, each.name)] for each in fields(cut)}


def _media(what: str, value: Any) -> tuple[MediumState, ...]:
    media = tuple(value)
    if len(media) > MOST_MEDIA or not all(isinstance(one, MediumState) for one in media):
        raise OptionError(f"{what} must be up to {MOST_MEDIA} of MediumState; got {value!r:.200}")
    return media


def _media_of(what: str, value: object) -> tuple[MediumState, ...]:
    if not isinstance(value, (list, tuple)):
        raise OptionError(f"{what} must be a list of up to {MOST_MEDIA} media; got {value!r:.200}")
    return tuple(_dataclass_of(what, one, MediumState) for one in value)


def _points(what: str, value: Any) -> tuple[Triple, ...]:
    if not isinstance(value, (list, tuple)) or len(value) > _MOST_CORNERS:
        raise OptionError(f"{what} must be a list of points; got {value!r:.200}")
    return tuple(_triple(what, point) for point in value)


def _marks(what: str, value: Any) -> tuple[Mark, ...]:
    marks = tuple(value)
    rule = f"up to {_MOST_MARKS} of Mark, with up to {_MOST_CORNERS} points in all"
    if len(marks) > _MOST_MARKS or not all(isinstance(mark, Mark) for mark in marks):
        raise OptionError(f"{what} must be {rule}; got {value!r:.200}")
    if (count := sum(len(mark.points) for mark in marks)) > _MOST_CORNERS:
        raise OptionError(f"{what} must be {rule}; got {count} points")
    return marks


def _marks_of(what: str, value: object) -> tuple[Mark, ...]:
    if not isinstance(value, (list, tuple)):
        raise OptionError(f"{what} must be a list of up to {_MOST_MARKS} marks; got {value!r:.200}")
    return tuple(_dataclass_of(what, mark, Mark) for mark in value)


def _furniture(what: str, value: Any) -> Furniture:
    instance(what, value, Furniture)
    if value.theme != "screen":
        raise OptionError(f"{what}.theme must be left out: a state has a background; got {value.theme!r}")
    for name in ("title", "time_stamp"):
        if len(text := str(getattr(value, name))) > _LONGEST_TITLE:
            raise OptionError(f"{what}.{name} must have at most {_LONGEST_TITLE} characters; got {len(text)}")
    return value  # type: ignore[no-any-return]  # checked


def _furniture_json(furniture: Furniture) -> dict[str, Any]:
    return {name: value for name, value in vars(furniture).items() if name != "theme"}


# -- the state -----------------------------------------------------------------------------------------------


def _of(
    check: Callable[..., Any],
    default: Any = MISSING,
    read: Callable[[str, object], Any] | None = None,
    write: Callable[[Any], Any] = plain,
    optional: bool = False,
    **limits: Any,
) -> Any:
    """A field: the check of its values, and what makes a value of JSON and JSON of a value. None passes where it is the default."""
    optional = optional or default is None
    rules = {"check": partial(check, **limits), "read": read, "write": write, "optional": optional}
    return field(default_factory=dict, metadata=rules) if default == {} else field(default=default, metadata=rules)


def _part(kind: type, default: Any = None, write: Callable[[Any], Any] = plain) -> Any:
    """A field that is a dataclass, and an object of JSON with its fields."""
    return _of(_instance, default, partial(_dataclass_of, kind=kind), write, kind=kind)


@dataclass(frozen=True)
class _Checked:
    """Its fields are checked, as `_of` says."""

    _WITHIN: ClassVar[str] = ""

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            if value is not None or not each.metadata["optional"]:
                object.__setattr__(self, each.name, each.metadata["check"](f"{self._WITHIN}{each.name}", value))


@dataclass(frozen=True)
class CameraState(_Checked):
    """The camera, as `clvol.Camera`; what is None is fitted. A drag turns it as `style` says.

    A "turntable" turns about the world's vertical, which stays upright in the picture, and a "trackball" freely.
    """

    target: Triple | None = _of(_triple, None)
    direction: Triple = _of(_way, (0.0, 1.0, 0.0))
    up: Triple = _of(_way, (0.0, 0.0, 1.0))
    distance: float | None = _of(number, None, above=0, maximum=_FARTHEST)
    radius: float | None = _of(number, None, above=0, maximum=_FARTHEST)
    zoom: float = _of(number, 1.0, minimum=ZOOMS[0], maximum=ZOOMS[1])
    projection: Literal["perspective", "orthographic"] = _of(name_of, "perspective", allowed=("perspective", "orthographic"))
    fov: float = _of(number, 30.0, minimum=1, maximum=150)
    fit: Literal["matter", "volume"] = _of(name_of, "matter", allowed=("matter", "volume"))
    style: Literal["turntable", "trackball"] = _of(name_of, "turntable", allowed=("turntable", "trackball"))

    _WITHIN = "camera."


@dataclass(frozen=True)
class SliceState(_Checked):
    """How slices are seen: all of them alike.

    Attributes
    ----------
    zoom : float
        Magnification.
    center : three numbers, optional
        The world point in their middle; by default the volume's centre.
    window : (center, width), optional
        Values from black to white; by default the state's.
    turn : three numbers, optional
        By which the planes are turned from across the axes of the world: a direction, as long as the angle in radians.
    thickness : float
        Of a slab, in world units; 0 is the plane itself.
    project : {"mip", "mean", "minip"}
        What is shown of a slab.
    contour : float
        The width of lines along the boundaries of labels, in pixels; 0 fills areas.
    alike : bool
        Whether slices across all axes have the same scale.
    """

    zoom: float = _of(number, 1.0, minimum=ZOOMS[0], maximum=ZOOMS[1])
    center: Triple | None = _of(_triple, None)
    window: tuple[float, float] | None = _of(_window, None)
    turn: Triple | None = _of(_triple, None)
    thickness: float = _of(number, 0.0, minimum=0, maximum=_FARTHEST)
    project: Literal["mip", "mean", "minip"] = _of(name_of, "mip", allowed=("mip", "mean", "minip"))
    contour: float = _of(number, 0.0, minimum=0, maximum=16)
    alike: bool = _of(_switch, False)

    _WITHIN = "slice."

    @property
    def words(self) -> dict[str, Any]:
        """Options of `clvol.slice`: those of a slab and of contours."""
        slab = {"thickness": self.thickness, "mode": self.project} if self.thickness else {}
        return slab | ({"contour": self.contour} if self.contour else {})


@dataclass(frozen=True)
class Wiper(_Checked):
    """Another filter's picture to the right of a line, at this fraction of the width."""

    filter: str = _of(_filter)
    at: float = _of(number, 0.5, minimum=0, maximum=1)

    _WITHIN = "wiper."


@dataclass(frozen=True)
class LabelState(_Checked):
    """Which labels are seen: all but those `hidden`, or only those `shown`. One of the two is given.

    Up to `MOST_LABELS` numbers of labels; sorted, without duplicates.
    """

    hidden: tuple[int, ...] | None = _of(_numbers, None)
    shown: tuple[int, ...] | None = _of(_numbers, None)

    _WITHIN = "labels."

    def __post_init__(self) -> None:
        if (self.hidden is None) == (self.shown is None):
            raise OptionError(f"labels must have one of hidden and shown; got {'neither' if self.hidden is None else 'both'}")
        super().__post_init__()

    def json(self) -> dict[str, list[int]]:
        """The one that is given."""
        return {name: part for name, part in plain(self).items() if part is not None}


@dataclass(frozen=True)
class MediumState(_Checked):
    """What is changed of a medium of a scene; None leaves it as it was given.

    `opacity` scales that of a transfer function, and `window`, (center, width), moves its values. `name` is the medium's, by which
    it is found among other layers when a state is restored; a view sets it.
    """

    name: str | None = _of(_named, None, known=lambda name: name)
    visible: bool | None = _of(_switch, None)
    window: tuple[float, float] | None = _of(_window, None)
    cmap: str | None = _of(_named, None, known=partial(TransferFunction.from_cmap, value_range=(0.0, 1.0)))
    opacity: float | None = _of(number, None, minimum=0, maximum=1e6)

    _WITHIN = "media."


@dataclass(frozen=True)
class Mark(_Checked):
    """Something that is measured on a slice, by points in the world.

    A "distance" is between two points, an "angle" at the second of three, an "area" within a polygon of up to 64. A "rectangle",
    and an "ellipse" within one, have a corner and both corners next to it. An angle or area may lack points that are to come.
    """

    kind: str = _of(name_of, allowed=MARKS)
    points: tuple[Triple, ...] = _of(_points)

    _WITHIN = "marks."

    def __post_init__(self) -> None:
        super().__post_init__()
        least, most = MARKS[self.kind]
        if not least <= len(self.points) <= most:
            raise OptionError(f"marks.points of {self.kind} must be {least} to {most}; got {len(self.points)}")


@dataclass(frozen=True)
class State(_Checked):
    """What a viewer shows of a volume; `json` and `from_json` convert it.

    Parameters
    ----------
    index : mapping of str to int or str
        Which of several volumes on one grid: the index along each leading axis, or the name of a channel that is computed from
        all. By default what `clvol.read` gives: 0, or the computed channel.
    layout : {"3d", "slice", "linked"}
        The volume, one slice (`active`), or the volume and three slices with one crosshair.
    active : {"3d", "x", "y", "z"}
        The pane that keys and copies are for.
    enlarged : bool
        Whether the layout "linked" shows that pane alone.
    tool : str or None
        What the first button drags; by default "orbit" in the volume, "crosshair" in slices.
    camera : CameraState
    slice : SliceState
    mode, options, filter, boundary, step
        As for `clvol.render`; `options` are the mode's, and so is the default of `filter`.
    transfer : TransferFunction, optional
        In JSON as `TransferFunction.json` says. If it is given, `preset`, `window`, `cmap` and `opacity` are not used for the
        volume's picture; a `TransferFunction2D` is in "composite" alone, and other modes have their own.
    preset, window, cmap, opacity
        As for `clvol.render`; slices take `cmap`, and `window` where they have none of their own (`slice.window`).
    gradient_opacity : float
        How much of the opacity is missing where the function is flat, 0 to 1.
    lights : tuple of Light, optional
    shadow, occlusion : float
        How dark shadows are, and places that matter surrounds, 0 to 1.
    shadow_rays : bool
        Whether shadows of exact surfaces are exact, too.
    linear_light : bool
        Whether colours are computed in linear light.
    material : Material, optional
    background : three numbers in 0..1, or None
    clip : (low, high), optional
        The crop box, in world units.
    cuts : tuple of Plane and Corner
        What else is cut away: see `clip` of `clvol.render`.
    labels : LabelState, optional
        Which labels of a label map are seen; others are background.
    label_colors, label_opacities : mapping of int to three numbers in 0..1, and to a number in 0..1
        What is changed of the table of labels (`clvol.labels.with_table`), for up to `MOST_LABELS` of them.
    media : tuple of MediumState
        Of a scene of several, what is changed of each; of the first only whether it is seen, for its look is the state's.
    furniture : Furniture
        What stands around the volume's picture, but no theme: that is a background.
    marks : tuple of Mark
        What is measured on slices.
    crosshair : three numbers, optional
        In world units; by default the volume's centre.
    wiper : Wiper, optional
    heat : bool
        Whether the fraction of samples that were visited is shown instead of the picture.
    """

    index: Mapping[str, int | str] = _of(_index, {})
    layout: Literal["3d", "slice", "linked"] = _of(name_of, "3d", allowed=LAYOUTS)
    active: Pane = _of(name_of, "3d", allowed=PANES)
    enlarged: bool = _of(_switch, False)
    tool: str | None = _of(name_of, None, allowed=_TOOLS)
    camera: CameraState = _part(CameraState, CameraState())
    slice: SliceState = _part(SliceState, SliceState())
    mode: str = _of(lambda _, mode: mode, "composite")  # checked with its options
    options: Mapping[str, Any] = _of(_options, {})
    filter: str | None = _of(_filter, None)
    boundary: str = _of(_named, "mirror", known=as_boundary)
    step: float = _of(number, 0.5, minimum=0.02, maximum=16)
    transfer: TransferFunction | None = _of(_transfer, None, _transfer_of, lambda transfer: transfer.json())
    preset: str | None = _of(_named, None, known=as_preset)
    window: tuple[float, float] | None = _of(_window, None)
    cmap: str | None = _of(_named, None, known=partial(TransferFunction.from_cmap, value_range=(0.0, 1.0)))
    opacity: float | None = _of(number, None, minimum=0, maximum=1e6)
    lights: tuple[Light, ...] | None = _of(_lights, None, _lights_of)
    gradient_opacity: float = _of(number, 0.0, minimum=0, maximum=1)
    shadow: float = _of(number, 0.0, minimum=0, maximum=1)
    occlusion: float = _of(number, 0.0, minimum=0, maximum=1)
    shadow_rays: bool = _of(_switch, False)
    linear_light: bool = _of(_switch, False)
    material: Material | None = _part(Material)
    background: Triple | None = _of(_color, (0.0, 0.0, 0.0), optional=True)
    clip: tuple[Triple, Triple] | None = _of(_box, None, _clip_of, lambda clip: {"low": list(clip[0]), "high": list(clip[1])})
    cuts: tuple[Plane | Corner, ...] = _of(_cuts, (), _cuts_of, lambda cuts: [_cut_json(cut) for cut in cuts])
    labels: LabelState | None = _part(LabelState, write=LabelState.json)
    label_colors: Mapping[int, Triple] = _of(_by_label, {}, each=_color)
    label_opacities: Mapping[int, float] = _of(_by_label, {}, each=partial(number, minimum=0, maximum=1))
    media: tuple[MediumState, ...] = _of(_media, (), _media_of)
    furniture: Furniture = _of(_furniture, Furniture(), partial(_dataclass_of, kind=Furniture), _furniture_json)
    marks: tuple[Mark, ...] = _of(_marks, (), _marks_of)
    crosshair: Triple | None = _of(_triple, None)
    wiper: Wiper | None = _part(Wiper)
    heat: bool = _of(_switch, False)

    def __post_init__(self) -> None:
        super().__post_init__()
        mode = as_mode(self.mode, heard_options(self.mode, self.options))
        object.__setattr__(self, "options", {name: plain(getattr(mode, name)) for name in self.options if name not in mode.unheard})
        if self.labels is not None and self.labels.hidden == ():  # equal pictures have equal states
            object.__setattr__(self, "labels", None)

    def __hash__(self) -> int:
        return hash(self.text())

    @property
    def words(self) -> dict[str, Any]:
        """The values of `WORDS`, by name: arguments of `clvol.scene.look`."""
        return {name: getattr(self, name) for name in WORDS}

    @property
    def slice_window(self) -> tuple[float, float] | None:
        """The window of slices: their own, else that of the volume's picture; None leaves it to the volume."""
        return self.slice.window or self.window

    @property
    def label_rows(self) -> dict[int, tuple[None, Triple | None, float | None]]:
        """Rows of `clvol.labels.LabelTable` that it changes."""
        changed = sorted({*self.label_colors, *self.label_opacities})
        return {label: (None, self.label_colors.get(label), self.label_opacities.get(label)) for label in changed}

    # -- in JSON -----------------------------------------------------------------------------------------------

    def json(self) -> dict[str, Any]:
        """A value for `json.dumps`, from which `from_json` makes the same state."""
        values = {each: getattr(self, each.name) for each in fields(self)}
        written = {each.name: None if value is None else each.metadata["write"](value) for each, value in values.items()}
        return {"version": VERSION} | written

    def text(self) -> str:
        """The JSON as one compact line."""
        return json.dumps(self.json(), separators=(",", ":"), allow_nan=False)

    @classmethod
    def from_json(cls, value: object) -> Self:
        """The state that `json` describes; fields that are missing have their defaults.

        Raises
        ------
        OptionError
            A field is unknown or has a value that is not allowed.
        """
        rows = {each.name: each for each in fields(cls)}
        given = as_object("state", value, {"version", *rows})
        version = given.pop("version", VERSION)
        if version != VERSION or isinstance(version, bool):
            raise OptionError(f"version must be {VERSION}, that of this program's states; got {version!r:.60}")
        for name, part in given.items():
            read = rows[name].metadata["read"]
            if read is not None and (part is not None or not rows[name].metadata["optional"]):
                given[name] = read(name, part)
        return cls(**given)

    @classmethod
    def from_text(cls, text: str | bytes) -> Self:
        """The state of a line of JSON; raises `OptionError` as `from_json`."""
        try:
            value = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise OptionError(f"a state must be JSON; {error}") from None
        return cls.from_json(value)

    def changed(self, changes: Mapping[str, Any]) -> Self:
        """A copy with other values, in JSON, by dotted names such as "camera.zoom" or "options.isovalue".

        A change of the mode drops options that are not given with it; None leaves one open again.

        Raises
        ------
        OptionError
            A name is no field, or a value is not allowed there.
        """
        if not isinstance(changes, Mapping):
            raise OptionError(f"changes must be an object of JSON; got {changes!r:.200}")
        result = self.json()
        names = sorted(changes, key=str)  # "options" before "options.isovalue"
        if "mode" in changes and changes["mode"] != self.mode:
            result["options"] = {}
        for name in names:
            head, *rest = str(name).split(".")
            if head not in result or head == "version":
                raise OptionError(f"{name!s:.80} is no field; a state has {', '.join(each.name for each in fields(self))}")
            part, key = result, head
            for word in rest:
                if key in part and part[key] is None:
                    part[key] = {}
                if not isinstance(part.get(key), dict):
                    raise OptionError(f"{name!s:.80} is no field; {key:.80} has no parts of that name")
                part, key = part[key], word
            part[key] = changes[name]
            if part is result["options"] and part[key] is None:  # left open again
                del part[key]
        return type(self).from_json(result)


# -- undo ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class History:
    """A state, those before it and those that were undone.

    A gesture, such as a drag, is one step: its states have the same `gesture`, and replace each other.
    """

    present: State
    past: tuple[State, ...] = ()
    future: tuple[State, ...] = ()
    gesture: object = None

    MOST = 200

    def with_state(self, state: State, gesture: object = None) -> History:
        """The history after a change; consecutive changes of one gesture (not None) are one step."""
        if state == self.present:
            return self
        if gesture is not None and gesture == self.gesture:
            return replace(self, present=state, future=())
        return History(state, (*self.past, self.present)[-self.MOST :], (), gesture)

    def ended(self) -> History:
        """The history after a gesture: the next change is a step of its own."""
        return replace(self, gesture=None)

    def mapped(self, change: Callable[[State], State]) -> History:
        """The same with every state changed, as something else demands."""
        past, future = (tuple(map(change, states)) for states in (self.past, self.future))
        return replace(self, present=change(self.present), past=past, future=future)

    def undone(self) -> History:
        """One step back, if there is one."""
        if not self.past:
            return self.ended()
        return History(self.past[-1], self.past[:-1], (self.present, *self.future))

    def redone(self) -> History:
        """One step forward again, if there is one."""
        if not self.future:
            return self.ended()
        return History(self.future[0], (*self.past, self.present), self.future[1:])
