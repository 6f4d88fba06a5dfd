"""The choice among the volumes of a file, made from its header before samples are read."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.checks import warn, whole
from clvol.base.errors import DataError, OptionError
from clvol.volume.volumes import Leading

__all__ = ["Choice", "Pick", "Series", "chosen_level", "chosen_series"]


@dataclass(frozen=True)
class Series:
    """One of several images in a file or a folder.

    Parameters
    ----------
    id : str
        The value of ``series=`` that chooses it.
    text : str
        A description, for listings.
    shape : tuple of int
        Of the array; empty if that is not known without reading it.
    """

    id: str
    text: str = ""
    shape: tuple[int, ...] = ()

    def __str__(self) -> str:
        """For listings: "cells (float32, 20 × 64 × 64)"."""
        about = ", ".join(part for part in (self.text, " × ".join(map(str, self.shape))) if part)
        return f"{self.id} ({about})" if about else self.id


@dataclass(frozen=True)
class Pick:
    """What a `Choice` picks along a file's leading axes."""

    index: tuple[int | slice, ...]  # for each leading axis; ``samples[index]`` are to be loaded
    about: dict[str, Any]  # arguments of `Volume`, with `leading` if it is several volumes
    finish: Callable[[NDArray[Any]], NDArray[Any]]  # of the loaded samples: the same, or a channel computed from all


@dataclass(frozen=True)
class Choice:
    """What the caller of `clvol.read` or `clvol.read_all` wants of a file that holds several volumes.

    `given` has "volume" (a number among all of them, or a place along the axis of that name), "time", "position", "channel". Axes
    without a choice are kept if `whole`; else the first place along them is taken, with a `ClvolWarning`.
    """

    given: Mapping[str, int | str] = field(default_factory=dict)
    whole: bool = False

    def __call__(self, source: str, leading: Leading, guessed: str = "") -> Pick:
        """The pick among the volumes of `source` (a name for messages).

        `guessed` says how axes were interpreted that the file does not explain; it is part of the warning. An `OptionError` says
        what there is, if the file has no such axis, or the index is out of range.
        """
        places = self._places(source, leading)
        wanted = places.get("channel", "" if self.whole else leading.computed)
        computed = leading.computed if "channel" in leading.axes and wanted == leading.computed else ""
        if computed:
            places["channel"] = computed
        index: list[int | slice] = []
        for axis in leading.axes:
            choice = places.get(axis)
            if (axis == "channel" and computed) or (choice is None and self.whole):
                index.append(slice(None))
            else:
                index.append(0 if choice is None else leading.place(axis, choice, source))
        if computed == "luminance" and "channel" not in self.given:  # colours are lost, where a magnitude is what it says
            lost = "of its colours the luminance was read: choose by channel=, or read all by clvol.read_all"
            guessed = f"{lost}; {guessed}" if guessed else lost
        left = [axis for axis, n in zip(leading.axes, leading.counts, strict=True) if n > 1 and axis not in places]
        self._warn(source, leading, [] if self.whole else left, index, guessed)
        taken = {axis: at for axis, at in zip(leading.axes, index, strict=True) if not isinstance(at, slice)}
        fixed = leading.without(*(axis for axis in leading.axes if axis not in taken))
        about = fixed.about(list(taken.values()))
        if computed:
            about["name"] = computed
        rest = leading.without(*taken, *(["channel"] if computed else []))
        if rest.axes:
            about["leading"] = rest
        at = sum(isinstance(i, slice) for i in index[: leading.axes.index("channel")]) if computed else 0
        return Pick(tuple(index), about, (lambda data: leading.combined(data, at)) if computed else (lambda data: data))

    def _places(self, source: str, leading: Leading) -> dict[str, int | str]:
        """The given choices, by the axes of `leading`."""
        places = dict(self.given)
        if "volume" in places and "volume" not in leading.axes:
            if len(places) > 1:
                raise OptionError(f"give volume or {', '.join(name for name in places if name != 'volume')}; got both")
            flat = Leading(("volume",), (leading.total,)).place("volume", places.pop("volume"), source)
            at = np.unravel_index(flat, leading.counts or (1,))
            places = {axis: int(i) for axis, i in zip(leading.axes, at, strict=bool(leading.axes))}
        if leading.axes == ("volume",) and "time" in places and "volume" not in places:
            places["volume"] = places.pop("time")
        for name in places:
            if name not in leading.axes and places[name] not in (0, "0"):
                raise OptionError(f"{name} must be 0, for {source} holds one {name}; it holds {leading}; got {places[name]!r}")
        return places

    def _warn(self, source: str, leading: Leading, left: list[str], index: list[int | slice], guessed: str) -> None:
        if left:
            places = {axis: at for axis, at in zip(leading.axes, index, strict=True) if axis in left}
            taken = ", ".join(
                f"{axis} {at}" + (f" ({leading.names[axis][at]})" if isinstance(at, int) and axis in leading.names else "")
                for axis, at in places.items()
            )
            how = " or ".join(f"{axis}=" for axis in left)
            message = f"{source} holds {leading}; {taken} was read: choose by {how}, or read all by clvol.read_all"
        elif guessed:
            message = source
        else:
            return
        warn(f"{message}{'; ' if left else ': '}{guessed}" if guessed else message)


_LISTED = 12  # in a message


def chosen_series(
    source: str,
    series: Sequence[Series],
    choice: int | str | None,
    *,
    what: str = "images",
    main: int | None = None,
    first: bool = True,
) -> int:
    """The index in `series` of `choice`, which is a number or an `id`.

    Without a choice, it is the first of the `main` first series, with a `ClvolWarning` if there are several, or a `DataError`
    unless the `first` is preferred; the others must be chosen.
    """
    listed = ", ".join(f"{n}: {one}" for n, one in enumerate(series[:_LISTED]))
    listed += f", … ({len(series)})" if len(series) > _LISTED else ""
    if choice is None:
        if (len(series) if main is None else main or len(series)) > 1:
            message = f"{source} holds {len(series)} {what}: {listed}"
            if not first:
                raise DataError(f"{message}; choose one by series=")
            warn(f"{message}; the first was read: choose by series=")
        return 0
    ids = [one.id for one in series]
    if isinstance(choice, str) and choice in ids:
        return ids.index(choice)
    number = int(choice) if isinstance(choice, str) and choice.isdecimal() else choice
    if isinstance(number, str) or not 0 <= whole("series", number) < len(series):
        if len(series) == 1:
            raise OptionError(f"series must be 0 or the name, for {source} holds one: {listed}; got {choice!r}")
        raise OptionError(
            f"series must be one of the {len(series)} {what} of {source}, by number from 0 or name: {listed}; got {choice!r}"
        )
    return number


def chosen_level(source: str, sizes: Sequence[Sequence[int]], level: int) -> int:
    """Check the index of a level among `sizes`, the largest first."""
    number = whole("level", level)
    if not 0 <= number < len(sizes):
        if len(sizes) == 1:
            raise OptionError(f"level must be 0, for {source} holds the image in one size; got {level}")
        listed = ", ".join(" × ".join(map(str, size)) for size in sizes)
        raise OptionError(
            f"level must be 0 to {len(sizes) - 1}, for {source} holds the image in {len(sizes)} sizes: {listed}; got {level}"
        )
    return number
