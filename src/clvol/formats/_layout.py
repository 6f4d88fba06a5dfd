"""The meaning of each axis of an array, and the volumes that were chosen of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base.axes import AXES, meaning
from clvol.base.errors import DataError
from clvol.base.units import in_one_unit
from clvol.bricks.sliced import Window
from clvol.formats._choice import Choice
from clvol.formats._files import scaled
from clvol.interop.kinds import Content
from clvol.volume.volumes import Leading

__all__ = ["Layout", "Line", "by_names", "decoded", "lay_out", "place", "scaled_part", "shrunk", "unnamed"]

_UNNAMED = {1: ("volume",), 2: ("time", "channel"), 3: ("time", "position", "channel")}
_OFF = 1e-3  # deviation of evenly spaced coordinates, in steps; float32 has that on long axes


Line: TypeAlias = "tuple[float, float] | NDArray[Any]"
"""First coordinate and step of an axis, or all coordinates."""

Lines: TypeAlias = tuple[dict[str, Line], dict[str, str]]
"""Coordinates, and units, of axes."""


@dataclass(frozen=True)
class Layout:
    """The meaning of each axis of an array."""

    axes: tuple[str, ...]  # one of `AXES`, "z", "y" or "x" each; "" for an axis of one sample without a meaning
    shape: tuple[int, ...]
    guessed: str = ""  # how axes were interpreted that their source does not explain, for messages

    @property
    def leading(self) -> tuple[str, ...]:
        """The axes that count volumes, slowest first."""
        return tuple(axis for axis in self.axes if axis in AXES)

    @property
    def counts(self) -> tuple[int, ...]:
        """Volumes along each of `leading`."""
        return tuple(n for axis, n in zip(self.axes, self.shape, strict=True) if axis in AXES)

    def saying_where_spacing_is_missing(self, spacing: Mapping[str, float]) -> Layout:
        """The layout, whose messages name the axes along which the spacing is NaN: it is missing there, and 1 is taken."""
        unknown = [axis for axis in "xyz" if axis in self.axes and math.isnan(spacing.get(axis, 1.0))]
        text = f"it gives no spacing along {' and '.join(unknown)}, where 1 was taken: spacing= replaces it" if unknown else ""
        return replace(self, guessed="; ".join(filter(None, (self.guessed, text))))

    @property
    def in_colour(self) -> Leading:
        """The leading axes, with channels red, green, blue (and alpha)."""
        rgb = Leading.of_rgb(self.shape[self.axes.index("channel")])
        return Leading(self.leading, self.counts, rgb.names, rgb.colors, rgb=True)

    def channels_of(self, dtype: np.dtype[Any]) -> Leading:
        """The leading axes; channels without names are colours (bytes) or components of vectors (floating)."""
        n = self.shape[self.axes.index("channel")] if "channel" in self.axes else 0
        if dtype == np.uint8 and n in (3, 4):
            return self.in_colour
        return Leading(self.leading, self.counts, vector=dtype.kind == "f" and n in (2, 3))

    def of(self, values: Mapping[str, float], default: float = 1.0) -> list[float]:
        """One number for each axis of the grid, in the order x, y(, z)."""
        return [values.get(axis, default) for axis in "xyz" if axis in self.axes]

    def chosen(
        self,
        source: str,
        choose: Choice,
        load: Callable[[tuple[int | slice, ...]], NDArray[Any] | Window],
        leading: Leading | None = None,
    ) -> tuple[Any, dict[str, Any]]:
        """The samples that `choose` picks, [..., z, y, x], and arguments of `Volume`; `load` returns the array at an index.

        If `load` returns a `Window`, so does this. `leading` may have the axes in the order that the samples shall have.
        """
        known = leading or Leading(self.leading, self.counts)
        pick = choose(source, known, self.guessed)
        taken = dict(zip(known.axes, pick.index, strict=True))
        index = tuple(taken.get(axis, slice(None) if axis else 0) for axis in self.axes)
        left = [axis for axis, place in zip(self.axes, index, strict=True) if isinstance(place, slice)]
        order = sorted(left, key=lambda axis: ("z", "y", "x").index(axis) + len(AXES) if axis in "zyx" else known.axes.index(axis))
        samples = load(index).transpose([left.index(axis) for axis in order])
        if isinstance(samples, Window):
            several = sum(axis in AXES for axis in left)
            return samples.combined(pick.finish, several) if several else samples, dict(pick.about)
        return pick.finish(samples), dict(pick.about)


def lay_out(
    source: str, words: Sequence[str], shape: Sequence[int], keep: Sequence[str] = ("z",), asked: Collection[str] = ()
) -> Layout:
    """The layout of an array whose axes have these names, or "".

    Axes without a known name become the missing ones of x, y and z, from the last axis on, then volumes, times, positions and
    channels; `guessed` says so, unless no axis has a name and there are at most three. An axis that the caller `asked` for exists:
    choosing a channel makes channels of volumes, or of slices. Axes of one sample are dropped, except x, y and those to `keep`.
    """
    if len(shape) < 2 or len(words) != len(shape):
        raise DataError(f"{source} must hold an image or a volume; got an array of shape {tuple(shape)}")
    axes = [meaning(word) for word in words]
    for i, axis in enumerate(axes):
        if axis and axis in axes[:i]:  # of two axes with one meaning, the first counts volumes
            axes[axes.index(axis)] = ""
    named = any(axes)
    unknown = [i for i, axis in enumerate(axes) if not axis and (shape[i] > 1 or not named)]
    for axis in "xyz":
        if axis not in axes and unknown:
            axes[unknown.pop()] = axis
    before = [i for i in unknown if shape[i] > 1]
    free = [axis for axis in _UNNAMED.get(len(before), ()) if axis not in axes] if len(before) < 4 else []
    free += [axis for axis in AXES if axis not in axes and axis not in free]
    if len(before) > len(free) or "x" not in axes or "y" not in axes:
        given = ", ".join(f"{word or '?'}: {n}" for word, n in zip(words, shape, strict=True))
        raise DataError(f"{source} must hold images or volumes, times, positions and channels of these; its axes are {given}")
    for i, axis in zip(before, free, strict=False):
        axes[i] = axis
    guessed = [i for i, word in enumerate(words) if not meaning(word) and axes[i] and shape[i] > 1]
    for axis in asked:
        spare = [i for i in guessed if axes[i] == "volume"] or [i for i in guessed if axes[i] == "z" and not before]
        if axis not in ("volume", *axes) and spare:
            axes[spare[0]] = axis
            guessed.remove(spare[0])
    text = ""
    if guessed and (named or len(shape) > 3):
        taken = ", ".join(f"{axis} ({n})" for axis, n in zip(axes, shape, strict=True) if axis and (n > 1 or axis in "xy"))
        text = f"its axes were taken for {taken}, for it does not say what all of them are"
    kept = tuple(axis if n > 1 or axis in ("x", "y", *keep) else "" for axis, n in zip(axes, shape, strict=True))
    return Layout(kept, tuple(int(n) for n in shape), text)


def unnamed(shape: Sequence[int], dtype: np.dtype[Any]) -> list[str]:
    """Names for the axes of an array without names: "", but "channel" for a last axis that is much shorter than the others.

    Of images and single volumes, only for three or four bytes, which look like colours.
    """
    short = (3, 4) if len(shape) == 3 and dtype == np.uint8 else (2, 3, 4) if len(shape) > 3 else ()
    last = len(shape) > 2 and shape[-1] in short and min(shape[-3:-1]) > max(short)
    return [""] * (len(shape) - last) + ["channel"] * last


def by_names(
    source: str,
    words: Sequence[str],
    array: Any,
    choose: Choice,
    load: Callable[..., Any],
    lines_of: Callable[[Layout], Lines],
    attributes_of: Callable[[Any], dict[str, Any]] = lambda array: dict(array.attrs),
) -> Content:
    """The chosen volumes of an array of netCDF's kind, whose axes may have names, and attributes say how samples are decoded.

    `load` returns its samples at an index, `lines_of` coordinates and units of axes, as `place` takes them.
    """
    named = any(words)
    words = words if named else unnamed(array.shape, array.dtype)
    layout = lay_out(source, words, array.shape, asked=choose.given)
    placed = place(source, layout, *lines_of(layout))
    leading = layout.channels_of(array.dtype) if words[-1:] == ["channel"] and not named else None
    data, chosen = layout.chosen(source, choose, lambda index: decoded(load(source, array, index), attributes_of(array)), leading)
    return data, placed | chosen


def line_of(axis: str, coordinates: ArrayLike) -> tuple[float, float, str]:
    """First value and step of coordinates along an axis; if they are not evenly spaced the step is NaN, and the text says why."""
    values = np.asarray(coordinates)
    what = f"its coordinates along {axis} must be"
    if values.dtype.kind not in "iuf":
        return 0.0, math.nan, f"{what} numbers; they are {values.dtype}"
    if not np.isfinite(values).all():
        return 0.0, math.nan, f"{what} finite; that at index {int(np.argmin(np.isfinite(values)))} is not"
    values = values.astype(np.float64)
    if len(values) < 2:
        return float(values[0]), 1.0, ""
    step = float(values[-1] - values[0]) / (len(values) - 1)
    if step and np.abs(values - values[0] - step * np.arange(len(values))).max() <= _OFF * abs(step):
        return float(values[0]), step, ""
    gaps = np.diff(values)
    odd = int(np.argmax(np.abs(gaps - np.median(gaps))))
    pair = f"{values[odd]:.9g} and {values[odd + 1]:.9g} at indices {odd} and {odd + 1}"
    found = f"they lie {gaps.min():.9g} to {gaps.max():.9g} apart, as {pair} do"
    return float(values[0]), math.nan, f"{what} evenly spaced, to within {_OFF:g} of a step; {found}"


def place(source: str, layout: Layout, lines: Mapping[str, Line], units: Mapping[str, str]) -> dict[str, Any]:
    """Geometry of a grid from coordinates along its axes, or their first and their step, and units.

    Without these, an axis begins at 0 with a step of 1. Lengths are converted to one unit. What is wrong is under "unplaced".
    """
    axes = [axis for axis in "xyz" if axis in layout.axes]
    unit, factors = in_one_unit(source, {axis: units.get(axis, "") for axis in axes})
    found = {axis: lines.get(axis, (0.0, 1.0)) for axis in axes}
    firsts, steps, wrong = zip(*(_checked(axis, line) for axis, line in found.items()), strict=True)
    about: dict[str, Any] = {
        "spacing": [abs(step) * factors[axis] for axis, step in zip(axes, steps, strict=True)],
        "origin": [first * factors[axis] for axis, first in zip(axes, firsts, strict=True)],
        "units": unit,
    }
    if any(step < 0 for step in steps):  # latitudes from north to south
        about["direction"] = np.diag([math.copysign(1.0, step) for step in steps])
    return about | ({"unplaced": "; ".join(filter(None, wrong))} if any(wrong) else {})


def _checked(axis: str, line: Line) -> tuple[float, float, str]:
    """First coordinate, step, and what is wrong with them."""
    if not isinstance(line, tuple):
        return line_of(axis, line)
    first, step = line
    sound = math.isfinite(first) and math.isfinite(step)
    return first, step, "" if sound else f"its origin and spacing along {axis} must be finite; found {first} and {step}"


def shrunk(base: Content, content: Content) -> Content:
    """A smaller size of an image, without metadata of its own, placed where the largest one, `base`, lies."""
    (data, about), (_, first) = content, base
    factors = [n / m for n, m in zip(base[0].shape[::-1], data.shape[::-1], strict=True)]
    spacing = [s * factor for s, factor in zip(first["spacing"], factors, strict=True)]
    amid = [(factor - 1) / 2 * s for factor, s in zip(factors, first["spacing"], strict=True)]
    origin = np.asarray(first["origin"]) + np.asarray(first.get("direction", np.eye(len(amid)))) @ amid
    return data, about | {"spacing": spacing, "origin": origin.tolist()}


def scaled_part(part: Window, slope: float, offset: float) -> Window:
    """As `scaled`, of samples that are read on demand."""
    return part if slope == 1 and offset == 0 else part.mapped(lambda samples: scaled(samples, slope, offset))


def decoded(data: Any, attributes: Mapping[str, Any]) -> Any:
    """Samples by the conventions of netCDF: signed or not, missing and invalid ones NaN, the others scaled and shifted.

    Those of a `Window` are floating if any could be missing. As in netCDF4-python, valid values are those of stored samples, and
    limits that the samples' type does not hold are ignored.
    """
    stored = np.dtype(data.dtype)
    sign = {"true": "u", "false": "i"}.get(str(np.ravel(np.asarray(attributes.get("_Unsigned", ""), str))[0]).lower())
    dtype = np.dtype(f"{stored.byteorder}{sign}{stored.itemsize}") if sign and stored.kind in "iu" else stored

    def given(name: str) -> list[float]:
        value = np.ravel(attributes.get(name, ()))
        if value.dtype.kind not in "iuf":
            return []
        alike = (value.dtype.kind, value.dtype.itemsize) == (stored.kind, stored.itemsize)
        return list((value.astype(stored).view(dtype) if alike else value).tolist())

    slope, offset = (*given("scale_factor"), 1.0)[0], (*given("add_offset"), 0.0)[0]
    missing = {value for name in ("_FillValue", "missing_value") for value in given(name) if not math.isnan(value)}
    ends = given("valid_range") or [(*given("valid_min"), -math.inf)[0], (*given("valid_max"), math.inf)[0]]
    held = len(ends) == 2 and (dtype.kind == "f" or all(math.isinf(end) or end == int(end) for end in ends))
    low, high = ends if held else (-math.inf, math.inf)
    least, most = (np.iinfo(dtype).min, np.iinfo(dtype).max) if dtype.kind in "iu" else (-math.inf, math.inf)
    some = bool(missing) or least < low or high < most

    def values(part: NDArray[Any], always: bool) -> NDArray[Any]:
        part = part.view(dtype)
        if some:
            gone = (part < low) | (part > high)
            for value in missing:
                gone |= part == value
            if always or gone.any():
                part = part.astype(np.result_type(dtype, np.float32))
                part[gone] = np.nan
        return scaled(part, slope, offset)

    if not isinstance(data, Window):
        return values(data, False)
    if not some and dtype == stored and slope == 1 and offset == 0:
        return data
    return data.mapped(lambda part: values(part, some), values(np.zeros(1, stored), some).dtype)
