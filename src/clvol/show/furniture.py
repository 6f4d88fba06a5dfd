"""What stands around a picture: colour bar, scale bar, axes, box, orientation letters and cube, title and time stamp.

`marks_of` says what stands where, in pixels of the picture; matplotlib draws it: over the picture at its resolution, or as PDF or
SVG. The grid of the back planes, and edges at the back, lie behind the picture's matter; all else lies over it.
"""

from __future__ import annotations

import io
import itertools
import math
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clvol.base.checks import flag, number, one_of
from clvol.base.errors import MissingDependencyError, OptionError
from clvol.base.srgb import on, over

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from clvol.scene.camera import Camera, Viewpoint
    from clvol.scene.transfer import TransferFunction

__all__ = [
    "VECTORS",
    "Area",
    "Bar",
    "Furnished",
    "Furniture",
    "Glyph",
    "Line",
    "Mark",
    "Stage",
    "Strip",
    "Words",
    "drawn",
    "furnished",
    "letters_of",
    "luminance",
    "marks_of",
    "require_matplotlib",
    "ticks_of",
    "vectors",
]

VECTORS = (".pdf", ".svg")
"""Suffixes of files in which furniture stays sharp at any size."""

THEMES = ("screen", "print")
_LETTERS = {"LPS": (("L", "R"), ("P", "A"), ("S", "I"))}  # of the world's x, y and z, each in both directions
_AXES = (("+x", "−x"), ("+y", "−y"), ("+z", "−z"))
_UNITS = {"um": "µm", "angstrom": "Å"}
_OBLIQUE = math.sin(math.radians(22.5))  # a direction that differs more from an axis has a second letter
_FONT = 1 / 34  # of the picture's shorter side
_SMALLEST = 8.0  # pixels of a font
_LONGEST_BAR = 0.24  # of the picture's width
_TALL = 0.5  # of the picture's height: a colour bar
_MOST_LABELS = 16
_PRINTED = 300  # pixels per inch of a page
_FAINT = 0.45  # opacity of a grid
_NEAR = 1e-6  # depth relative to the box, before which lines are cut
_STEPS = (1, 2, 2.5, 5, 10)
_AROUND, _TICKED, _BESIDE = 1.1, 0.25, 0.15  # radius of the view of a box, relative to it, and more for ticks, and for a colour bar
_WIDE = 1.25  # aspect from which there is room beside it

_STYLING = threading.Lock()  # matplotlib's style is one for all threads

Color: TypeAlias = tuple[float, float, float]
Points: TypeAlias = NDArray[np.float64]
_BLACK, _GREY, _WHITE = (0.0, 0.0, 0.0), (0.5, 0.5, 0.5), (1.0, 1.0, 1.0)


@dataclass(frozen=True)
class Furniture:
    """What stands around a picture; the options of `clvol.render` of these names, which describe them.

    Raises
    ------
    OptionError
        A word that takes True or False has another value, `title` is no string, `time_stamp` neither string nor number, or `theme`
        is unknown.
    """

    color_bar: bool = False
    scale_bar: bool = False
    axes: bool = False
    box: bool = False
    letters: bool = False
    cube: bool = False
    title: str = ""
    time_stamp: str | float = ""
    theme: Literal["screen", "print"] = "screen"

    def __post_init__(self) -> None:
        for name in ("color_bar", "scale_bar", "axes", "box", "letters", "cube"):
            object.__setattr__(self, name, flag(name, getattr(self, name)))
        if not isinstance(self.title, str):
            raise OptionError(f"title must be a string; got {self.title!r}")
        if not isinstance(self.time_stamp, str):
            object.__setattr__(self, "time_stamp", number("time_stamp, if it is no string,", self.time_stamp))
        if not isinstance(self.theme, str) or self.theme not in THEMES:
            raise one_of("theme", self.theme, THEMES)

    def __bool__(self) -> bool:
        """Whether anything is drawn."""
        return bool(self.given.keys() - {"theme"})

    @property
    def given(self) -> dict[str, Any]:
        """What differs from the default: options of `clvol.render`."""
        values = {each.name: (getattr(self, each.name), each.default) for each in fields(self)}
        return {name: value for name, (value, usual) in values.items() if value is not False and value != usual}

    def require_shown(self, space: str) -> None:
        """Raise `OptionError` if a word applies to no volume of this space, `MissingDependencyError` if matplotlib is missing."""
        if self.letters and space not in _LETTERS:
            raise OptionError(
                f"letters changes nothing for a volume whose space is {space!r}: it takes a patient, 'LPS'; cube shows x, y, z"
            )
        if self:
            require_matplotlib("what stands around pictures needs")

    @property
    def behind(self) -> bool:
        """Whether some of it lies behind the picture's matter."""
        return self.axes or self.box

    def in_view(self, camera: Camera, low: Points, high: Points, aspect: float) -> Camera:
        """The camera that has all of the box in view, with its ticks, if that is drawn and the camera's place was left open."""
        left_open = camera.fit == "matter" and all(
            value is None for value in (camera.position, camera.target, camera.distance, camera.radius)
        )
        if not (self.behind and left_open):
            return camera
        x, y, z = (float(v) for v in (low + high) / 2)
        around = _AROUND + _TICKED * self.axes + _BESIDE * (self.color_bar and aspect < _WIDE)
        return replace(camera, target=(x, y, z), radius=around * float(np.linalg.norm(high - low)) / 2)


class Bar(NamedTuple):
    """What a colour bar shows: a transfer function, or the colours of labels by name."""

    transfer: TransferFunction
    opacity: bool = False  # it is used
    name: str = ""
    labels: Mapping[int, str] | None = None


@dataclass(frozen=True)
class Stage:
    """The picture around which furniture stands."""

    view: Viewpoint
    size: tuple[int, int]  # width and height in pixels
    low: Points  # corners of the box in the world
    high: Points
    focus: Points  # where the scale bar is true
    units: str
    space: str
    bars: tuple[Bar, ...]
    background: Color | None
    linear: bool  # matter lies over what is behind it in linear light

    @property
    def font(self) -> float:
        """The size of letters in pixels."""
        return max(_SMALLEST, min(self.size) * _FONT)

    @property
    def ink(self) -> Color:
        """Black or white, whichever differs more from the background; on none, black with a white edge."""
        return _BLACK if self.background is None or luminance(self.background) > 0.179 else _WHITE

    @property
    def halo(self) -> Color:
        """The other one, around letters."""
        return _WHITE if self.ink == _BLACK else _BLACK


class Line(NamedTuple):
    """Straight pieces through points."""

    points: Points  # (n, 2)
    width: float
    behind: bool = False
    faint: bool = False


class Words(NamedTuple):
    """Text about a point: `across` and `down` say which part of it lies there, 0 to 1."""

    x: float
    y: float
    text: str
    size: float
    across: float = 0.5
    down: float = 0.5


class Area(NamedTuple):
    """A polygon; `color` None is the ink."""

    points: Points  # (n, 2)
    color: Color | None = None
    opacity: float = 1.0
    outlined: bool = False


class Strip(NamedTuple):
    """A picture of colours, one for each row of pixels."""

    left: int
    top: int
    width: int
    colors: Points  # (height, 3)


class Glyph(NamedTuple):
    """A text that is turned into a plane: the world's directions of its letters, as the picture shows them."""

    x: float
    y: float
    text: str
    right: Points  # (2,): a font's size along the text
    up: Points


Mark: TypeAlias = Line | Words | Area | Strip | Glyph


@dataclass(frozen=True)
class Furnished:
    """A picture before anything was drawn around it, and what is."""

    bare: NDArray[np.float32]  # (height, width, 4), over nothing if something lies behind it
    stage: Stage
    marks: tuple[Mark, ...]


def luminance(color: Sequence[float]) -> float:
    """The relative luminance of an sRGB colour, 0 to 1, as WCAG defines it."""
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in (min(1.0, float(c)) for c in color)]
    return float(np.dot(linear, (0.2126, 0.7152, 0.0722)))


# -- what stands where ----------------------------------------------------------------------------------------------------------


def marks_of(furniture: Furniture, stage: Stage) -> tuple[Mark, ...]:
    """What is drawn, in pixels from the upper left corner of the picture; what is first lies below."""
    width, font, edge = stage.size[0], stage.font, stage.font * 0.8
    marks: list[Mark] = []
    right = float(width)
    if furniture.axes or furniture.box:
        marks += _box(stage, box=furniture.box, axes=furniture.axes)
    if furniture.color_bar:
        for bar in stage.bars:
            found, right = _color_bar(stage, bar, right)
            marks += found
    if furniture.scale_bar:
        marks += _scale_bar(stage)
    if furniture.cube:
        marks += _cube(stage)
    top = edge
    if furniture.title:
        marks.append(Words(width / 2, top, furniture.title, 1.25 * font, down=0.0))
        top += 1.25 * font * (1.2 * furniture.title.count("\n") + 1.2)
    if furniture.time_stamp != "":
        stamp = furniture.time_stamp
        text = stamp if isinstance(stamp, str) else f"{stamp:g} s"
        marks.append(Words(edge, top if furniture.title else edge, text, font, across=0.0, down=0.0))
    if furniture.letters:
        marks += _letters(stage, top, right)
    return tuple(marks)


def ticks_of(low: float, high: float, most: int) -> list[tuple[float, str]]:
    """Round values from `low` to `high`, at most about `most`, each with its text."""
    from matplotlib.ticker import MaxNLocator

    values = MaxNLocator(max(1, most), steps=_STEPS).tick_values(low, high)
    slack = 1e-9 * (high - low)
    values = [0.0 if abs(v) < slack else float(v) for v in values if low - slack <= v <= high + slack]
    return list(zip(values, _texts(values), strict=True))


def _texts(values: Sequence[float]) -> list[str]:
    """The shortest texts with equal digits that tell values apart."""
    most = max(map(abs, values), default=0.0)
    if most and not 1e-3 <= most < 1e5:
        return [f"{v:.4g}".replace("-", "−") for v in values]
    step = min((b - a for a, b in itertools.pairwise(values)), default=most or 1.0)
    digits = next((n for n in range(8) if abs(step - round(step, n)) <= 1e-6 * step), 8)
    return [f"{v:.{digits}f}".replace("-", "−") for v in values]


def _color_bar(stage: Stage, bar: Bar, right: float) -> tuple[list[Mark], float]:
    """A colour bar left of `right`, and where its left edge is."""
    font, height = stage.font, stage.size[1]
    if bar.labels:
        return _legend(stage, bar.labels, bar.transfer, right)
    low, high = bar.transfer.value_range
    if not low < high:
        low, high = low - 0.5, low + 0.5
    ticks = ticks_of(low, high, max(2, int(_TALL * height / (2.5 * font))))
    across = 0.62 * font * max(len(text) for _, text in ticks)
    wide, tall = max(3, round(1.2 * font)), max(8, round(_TALL * height))
    left, top = round(right - font - across - 0.5 * font - wide), (height - tall) // 2
    values = high - (np.arange(tall) + 0.5) / tall * (high - low)
    marks: list[Mark] = [Strip(left, top, wide, bar.transfer(values)[:, :3])]
    frame = np.array([(left, top), (left + wide, top), (left + wide, top + tall), (left, top + tall), (left, top)], float)
    marks.append(Line(frame, 0.06 * font))
    for value, text in ticks:
        y = top + (high - value) / (high - low) * tall
        marks.append(Line(np.array([(left + wide, y), (left + wide + 0.3 * font, y)]), 0.08 * font))
        marks.append(Words(left + wide + 0.5 * font, y, text, font, across=0.0))
    if bar.name:
        marks.append(Words(left + wide / 2, top - 0.4 * font, bar.name, font, down=1.0))
    if not bar.opacity:
        return marks, left
    room, points = 2.0 * font, [value for value, _ in bar.transfer.opacities if low <= value <= high]
    at = np.unique([*values, low, high, *points])[::-1]
    beside = 1e-6 * (high - low)  # it may jump at a point
    at = np.clip(np.stack([at + beside, at - beside], 1).ravel(), low, high)
    x = left - 0.25 * font - room * bar.transfer(at)[:, 3]
    curve = np.stack([x, top + (high - at) / (high - low) * tall], 1)
    foot = left - 0.25 * font
    marks.append(Area(np.concatenate([curve, [(foot, top + tall), (foot, top)]]), None, 0.3))
    marks.append(Line(curve, 0.1 * font))
    marks.append(Words(foot, top + tall + 0.3 * font, "opacity", 0.8 * font, across=1.0, down=0.0))
    return marks, foot - room


def _legend(stage: Stage, labels: Mapping[int, str], transfer: TransferFunction, right: float) -> tuple[list[Mark], float]:
    """The colours of labels with their names."""
    font = stage.font
    numbers = sorted(labels)
    shown = [(look[:3], labels[label] or str(label)) for label, look in zip(numbers, transfer(numbers), strict=True) if look[3] > 0]
    rows: list[tuple[Points | None, str]] = [*shown[:_MOST_LABELS]]
    if len(shown) > _MOST_LABELS:
        rows.append((None, f"and {len(shown) - _MOST_LABELS} more"))
    across = 0.62 * font * max((len(name) for _, name in rows), default=0)
    left, top = right - font - across - 1.5 * font, stage.size[1] / 2 - 0.75 * font * len(rows)
    marks: list[Mark] = []
    for row, (color, name) in enumerate(rows):
        y = top + 1.5 * font * row
        if color is not None:
            r, g, b = (float(c) for c in color)
            square = np.array([(left, y), (left + font, y), (left + font, y + font), (left, y + font)])
            marks.append(Area(square, (r, g, b), outlined=True))
        marks.append(Words(left + 1.5 * font, y + font / 2, name, font, across=0.0))
    return marks, left


def _scale_bar(stage: Stage) -> list[Mark]:
    """A bar of a round length at the lower right; in perspective it is true in the plane through the focus."""
    width, height = stage.size
    font = stage.font
    per_unit = stage.view.pixels_per_unit(stage.focus, height)
    longest = _LONGEST_BAR * width / per_unit
    power = 10.0 ** math.floor(math.log10(longest))
    length = float(f"{next(digit for digit in (5, 2, 1) if digit * power <= longest * (1 + 1e-12)) * power:.1g}")
    right, bottom, thick = width - font, height - font, max(2.0, 0.25 * font)
    left, top = right - length * per_unit, bottom - thick
    bar = np.array([(left, top), (right, top), (right, bottom), (left, bottom)])
    unit = _UNITS.get(stage.units, stage.units)
    return [Area(bar, outlined=True), Words((left + right) / 2, top - 0.3 * font, f"{length:g} {unit}".strip(), font, down=1.0)]


def _letters(stage: Stage, top: float, right: float) -> list[Mark]:
    """The side of the patient in the middle of each edge of the picture, as radiologists mark it."""
    width, height = stage.size
    size, edge = 1.2 * stage.font, 0.8 * stage.font
    view = stage.view
    return [
        Words(edge, height / 2, letters_of(-view.right), size, across=0.0),
        Words(right - edge, height / 2, letters_of(view.right), size, across=1.0),
        Words(width / 2, top, letters_of(view.up), size, down=0.0),
        Words(width / 2, height - edge, letters_of(-view.up), size, down=1.0),
    ]


def letters_of(direction: Points, space: str = "LPS") -> str:
    """The letters of a direction, the nearest axis of the patient first, as DICOM orders them."""
    order = np.argsort(-np.abs(direction), kind="stable")
    some = [int(axis) for axis in order if abs(direction[axis]) >= _OBLIQUE]
    return "".join(_LETTERS[space][axis][0 if direction[axis] > 0 else 1] for axis in some)


def _cube(stage: Stage) -> list[Mark]:
    """A cube at the lower left, turned as the world is, with the names of its faces."""
    font, view = stage.font, stage.view
    half = 1.5 * font
    x, y = font + math.sqrt(3) * half, stage.size[1] - font - math.sqrt(3) * half

    def seen(vector: Points) -> Points:
        return half * np.stack([vector @ view.right, -(vector @ view.up)], -1)

    marks: list[Mark] = []
    for axis, side in itertools.product(range(3), (1, -1)):
        normal, up = np.zeros(3), np.zeros(3)
        normal[axis] = side
        facing = -float(normal @ view.forward)
        if facing <= 0.02:
            continue
        up[1 if axis == 2 else 2] = -1 if axis == 2 and stage.space == "LPS" else 1
        right = np.cross(up, normal)
        corners = np.stack([normal + a * right + b * up for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
        shade = 0.62 + 0.33 * facing
        marks.append(Area(np.array((x, y)) + seen(corners), (shade, shade, shade), outlined=True))
        name = _LETTERS.get(stage.space, _AXES)[axis][0 if side > 0 else 1]
        middle = np.array((x, y)) + seen(normal)
        marks.append(Glyph(float(middle[0]), float(middle[1]), name, seen(1.1 * right), seen(1.1 * up)))
    return marks


@dataclass(frozen=True)
class _Edge:
    """An edge of the box, parallel to an axis."""

    axis: int
    ends: Points  # (2, 3)
    facing: int  # of its two faces, those that face the viewer


def _box(stage: Stage, *, box: bool, axes: bool) -> list[Mark]:
    """The edges of the box; with `axes` ticks on its outline and their grid on the planes at the back."""
    view, font, corners = stage.view, stage.font, np.stack([stage.low, stage.high])
    thin = 0.07 * font
    facing = {(axis, side): _faces(stage, axis, side) for axis, side in itertools.product(range(3), range(2))}
    edges = []
    for axis in range(3):
        one, other = (n for n in range(3) if n != axis)
        for a, b in itertools.product(range(2), repeat=2):
            ends = np.empty((2, 3))
            ends[:, axis], ends[:, one], ends[:, other] = corners[:, axis], corners[a, one], corners[b, other]
            edges.append(_Edge(axis, ends, facing[one, a] + facing[other, b]))
    marks: list[Mark] = []
    ticks = [_ticks(stage, axis, edges) for axis in range(3)] if axes else []
    for (axis, side), front in facing.items() if axes else ():
        if front:
            continue
        for along, across in itertools.permutations([n for n in range(3) if n != axis]):
            for value, _ in ticks[along][1]:
                ends = np.empty((2, 3))
                ends[:, axis], ends[:, along], ends[:, across] = corners[side, axis], value, corners[:, across]
                marks += [Line(piece, thin, behind=True, faint=True) for piece in _seen(stage, ends)]
    for edge in edges:
        if box or edge.facing < 2:
            marks += [Line(piece, 1.4 * thin, behind=edge.facing == 0) for piece in _seen(stage, edge.ends)]
    center = view.project((stage.low + stage.high)[None] / 2, *stage.size)[0][0]
    for axis, (edge_of_ticks, found) in enumerate(ticks):
        if edge_of_ticks is not None:
            marks += _ticked(stage, axis, edge_of_ticks, found, center)
    return marks


def _faces(stage: Stage, axis: int, side: int) -> bool:
    """Whether a face of the box faces the viewer."""
    sign = 1 if side else -1
    if stage.view.orthographic:
        return float(-sign * stage.view.forward[axis]) > 1e-9
    return float(sign * (stage.view.eye[axis] - (stage.low, stage.high)[side][axis])) > 0


def _seen(stage: Stage, ends: Points) -> list[Points]:
    """A straight line in pixels, without what lies behind the viewer."""
    pixels, depth = stage.view.project(ends, *stage.size)
    least = 0.0 if not stage.view.orthographic else -math.inf
    least += _NEAR * float(np.linalg.norm(stage.high - stage.low))
    if (depth > least).all():
        return [pixels]
    if not (depth > least).any():
        return []
    share = (least - depth[0]) / (depth[1] - depth[0])
    cut = ends[0] + share * (ends[1] - ends[0]) * (1 + 1e-9)
    pixels, _ = stage.view.project(np.stack([cut, ends[int(depth[1] > least)]]), *stage.size)
    return [pixels]


def _ticks(stage: Stage, axis: int, edges: Sequence[_Edge]) -> tuple[Points | None, list[tuple[float, str]]]:
    """The edge of the outline that has the ticks of an axis, the lowest, or if it points up the leftmost; and the ticks."""
    upright = axis == int(np.argmax(np.abs(stage.view.up)))
    found: list[tuple[float, Points]] = []
    for edge in edges:
        pixels, depth = stage.view.project(edge.ends, *stage.size)
        if edge.axis == axis and edge.facing == 1 and (stage.view.orthographic or (depth > 0).all()):
            x, y = (float(v) for v in pixels.mean(0))
            found.append((-x if upright else y - 1e-6 * x, edge.ends))
    if not found:
        return None, []
    ends = max(found, key=lambda one: one[0])[1]
    pixels, _ = stage.view.project(ends, *stage.size)
    length = float(np.linalg.norm(pixels[1] - pixels[0]))
    if length < 2 * stage.font:
        return None, []
    return ends, ticks_of(float(stage.low[axis]), float(stage.high[axis]), min(8, int(length / (3.2 * stage.font))))


def _ticked(stage: Stage, axis: int, ends: Points, ticks: list[tuple[float, str]], center: Points) -> list[Mark]:
    """The ticks of an axis, their numbers, and its name, outside of the box."""
    font = stage.font
    pixels, _ = stage.view.project(ends, *stage.size)
    along = (pixels[1] - pixels[0]) / np.linalg.norm(pixels[1] - pixels[0])
    out = np.array([along[1], -along[0]])
    out = out if out @ (pixels.mean(0) - center) > 0 else -out
    at = np.repeat(ends[:1], len(ticks), 0)
    at[:, axis] = [value for value, _ in ticks]
    marks: list[Mark] = []
    reach = 0.0
    for place, (_, text) in zip(stage.view.project(at, *stage.size)[0], ticks, strict=True):
        marks.append(Line(np.stack([place, place + 0.4 * font * out]), 0.1 * font))
        half = abs(out[0]) * 0.31 * font * len(text) + abs(out[1]) * 0.5 * font
        x, y = place + (0.7 * font + half) * out
        marks.append(Words(float(x), float(y), text, font))
        reach = max(reach, 2 * half)
    unit = _UNITS.get(stage.units, stage.units)
    name = f"{'xyz'[axis]} ({unit})" if unit else "xyz"[axis]
    half = abs(out[0]) * 0.31 * font * len(name) + abs(out[1]) * 0.5 * font
    x, y = pixels.mean(0) + (1.1 * font + reach + half) * out
    marks.append(Words(float(x), float(y), name, font))
    return marks


# -- drawing --------------------------------------------------------------------------------------------------------------------


def furnished(bare: NDArray[np.float32], furniture: Furniture, stage: Stage) -> tuple[NDArray[np.float32], Furnished]:
    """A picture with its furniture, shape (height, width, 4), and what it was made of.

    `bare` lies over the background; over nothing, if some of the furniture lies behind its matter. Pixels that no furniture covers
    are those of `bare`, over the background.
    """
    made = Furnished(bare, stage, marks_of(furniture, stage))
    picture = bare
    if furniture.behind:
        behind = on(stage.background, drawn([mark for mark in made.marks if _behind(mark)], stage))
        picture = over(bare, behind, linear=stage.linear)
    return over(drawn([mark for mark in made.marks if not _behind(mark)], stage), picture), made


def drawn(marks: Sequence[Mark], stage: Stage) -> NDArray[np.float32]:
    """Marks at the picture's resolution, over nothing; shape (height, width, 4)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    with _styled():
        figure, axes = _page(stage.size, 72.0)
        _put(axes, marks, stage, 1.0)
        canvas: Any = FigureCanvasAgg(figure)
        canvas.draw()
        return np.asarray(canvas.buffer_rgba(), np.float32) / np.float32(255)


def vectors(pixels: NDArray[np.uint8], suffix: str, made: Furnished | None = None) -> bytes:
    """A PDF or SVG file of a picture, (height, width, 1, 3 or 4), with its furniture, if there is any, as lines and letters."""
    height, width = pixels.shape[:2]
    marks = () if made is None else made.marks
    with _styled():
        figure, axes = _page((width, height), _PRINTED)
        if made is not None:
            if made.stage.background is not None:
                figure.patch.set(facecolor=tuple(np.clip(made.stage.background, 0, 1)), alpha=1.0)
            _put(axes, [mark for mark in marks if _behind(mark)], made.stage, 72 / _PRINTED)
        shades: Any = {"cmap": "gray", "vmin": 0, "vmax": 255} if pixels.shape[2:] in ((), (1,)) else {}
        axes.imshow(pixels, extent=(0, width, height, 0), interpolation="none", aspect="auto", zorder=_next(axes), **shades)
        axes.set(xlim=(0, width), ylim=(height, 0))
        if made is not None:
            _put(axes, [mark for mark in marks if not _behind(mark)], made.stage, 72 / _PRINTED)
        stream = io.BytesIO()
        dated: Any = {"CreationDate": None} if suffix == ".pdf" else {"Date": None}
        figure.savefig(stream, format=suffix.removeprefix("."), metadata=dated)
        return stream.getvalue()


def require_matplotlib(what: str = "figures need") -> Any:
    """The matplotlib module; `MissingDependencyError` if it is not installed."""
    try:
        import matplotlib as mpl
    except ImportError:
        raise MissingDependencyError(f'{what} matplotlib, which is not installed: pip install "clvol[figures]"') from None
    return mpl


@contextmanager
def _styled() -> Iterator[None]:
    """A context with matplotlib's own style, whatever the user's is; texts stay texts in files."""
    mpl = require_matplotlib("PDF and SVG files, and what stands around pictures, need")
    with _STYLING, mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update({"pdf.fonttype": 42, "svg.fonttype": "none", "svg.hashsalt": "clvol"})
        yield


def _behind(mark: Mark) -> bool:
    return isinstance(mark, Line) and mark.behind


def _page(size: tuple[int, int], dots: float) -> tuple[Figure, Axes]:
    """A figure of the picture's size, whose only axes count its pixels."""
    from matplotlib.figure import Figure

    width, height = size
    inches = (width * (1 + 1e-12) / dots, height * (1 + 1e-12) / dots)  # not a pixel less, by rounding
    figure = Figure(figsize=inches, dpi=dots)
    figure.patch.set_alpha(0.0)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_axis_off()
    axes.set(xlim=(0, width), ylim=(height, 0))
    return figure, axes


def _next(axes: Axes) -> float:
    """A place above all that has been put."""
    return max((artist.get_zorder() for artist in axes.get_children()), default=0.0) + 1


def _put(axes: Axes, marks: Sequence[Mark], stage: Stage, points: float) -> None:
    """Put marks on a page, where a pixel of the picture is as many `points`."""
    for mark in marks:
        put: Any = {Line: _put_line, Words: _put_words, Area: _put_area, Strip: _put_strip, Glyph: _put_glyph}[type(mark)]
        put(axes, mark, stage, points, _next(axes))


def _edged(stage: Stage, width: float) -> list[Any]:
    """Drawn twice: wider, in the colour that differs from the ink, and itself."""
    from matplotlib.patheffects import Normal, Stroke

    return [Stroke(linewidth=width, foreground=stage.halo), Normal()]


def _put_line(axes: Axes, mark: Line, stage: Stage, points: float, order: float) -> None:
    width = max(1.0, mark.width) * points
    effects = [] if mark.behind else _edged(stage, width + 0.12 * stage.font * points)
    alpha = _FAINT if mark.faint and stage.background is not None else 1.0
    color = _GREY if mark.faint and stage.background is None else stage.ink  # seen on any page
    axes.plot(*mark.points.T, color=color, linewidth=width, alpha=alpha, solid_capstyle="butt", path_effects=effects, zorder=order)


def _put_words(axes: Axes, mark: Words, stage: Stage, points: float, order: float) -> None:
    from matplotlib.patheffects import Stroke

    sides: Any = {0.0: ("left", "top"), 0.5: ("center", "center"), 1.0: ("right", "bottom")}
    about = {"horizontalalignment": sides[mark.across][0], "verticalalignment": sides[mark.down][1], "parse_math": False}
    halo = [Stroke(linewidth=0.25 * stage.font * points, foreground=stage.halo, joinstyle="round")]
    for effects in (halo, []):  # letters with an effect are outlines in a file, so they are written again
        axes.text(
            mark.x, mark.y, mark.text, fontsize=mark.size * points, color=stage.ink, zorder=order, path_effects=effects, **about
        )


def _put_area(axes: Axes, mark: Area, stage: Stage, points: float, order: float) -> None:
    from matplotlib.patches import Polygon

    face = stage.ink if mark.color is None else mark.color
    edge = (stage.halo if mark.color is None else stage.ink) if mark.outlined else "none"
    wide = max(1.0, 0.07 * stage.font) * points
    if mark.outlined and mark.color is None:  # around it, so that its own size is seen
        axes.add_patch(
            Polygon(mark.points, closed=True, facecolor="none", edgecolor=edge, linewidth=2 * wide, joinstyle="round", zorder=order)
        )
        edge = "none"
    axes.add_patch(
        Polygon(
            mark.points,
            closed=True,
            facecolor=face,
            edgecolor=edge,
            linewidth=wide,
            alpha=mark.opacity,
            joinstyle="round",
            zorder=order,
        )
    )


def _put_strip(axes: Axes, mark: Strip, stage: Stage, points: float, order: float) -> None:  # noqa: ARG001  # as all of them
    tall = len(mark.colors)
    extent = (mark.left, mark.left + mark.width, mark.top + tall, mark.top)
    limits = axes.get_xlim(), axes.get_ylim()
    pixels = np.repeat(np.rint(np.clip(mark.colors, 0, 1) * 255).astype(np.uint8)[:, None], mark.width, 1)
    axes.imshow(pixels, extent=extent, interpolation="none", aspect="auto", zorder=order)
    axes.set(xlim=limits[0], ylim=limits[1])


def _put_glyph(axes: Axes, mark: Glyph, stage: Stage, points: float, order: float) -> None:  # noqa: ARG001  # as all of them
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path
    from matplotlib.textpath import TextPath

    path = TextPath((0, 0), mark.text, size=1.0)
    plain = np.asarray(path.vertices) - (np.asarray(path.get_extents().min) + np.asarray(path.get_extents().max)) / 2
    place = np.array((mark.x, mark.y)) + plain[:, :1] * mark.right + plain[:, 1:] * mark.up
    axes.add_patch(PathPatch(Path(place, path.codes), facecolor=_BLACK, edgecolor="none", zorder=order))
