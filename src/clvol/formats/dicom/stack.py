"""Frames as volumes: which lie in the same place, what tells them apart, and the geometry of a stack."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.checks import warn
from clvol.base.errors import FormatError
from clvol.formats.dicom.header import TIMES, Frame, Value, moved
from clvol.volume.volumes import Leading

__all__ = ["finite", "geometry_of", "grid_of", "order_of", "require_alike", "spread_out"]

_LARGEST_TURN = 1e-2  # between directions of parallel slices; some files give three digits
_LARGEST_SHIFT = 0.05  # of the distance between slices
_ALIKE = 1e-3  # relative, between spacings within the slices of a volume


def require_alike(path: Path, frames: Sequence[Frame]) -> None:
    """Raise, naming the file, if one is of another size, colour, direction or spacing than the first."""
    first = frames[0]
    turns: list[tuple[tuple[float, ...], int]] = []
    for frame in frames:
        if frame.kind != first.kind:
            rows, columns, channels = (f"{a} and {b}" if a != b else f"{a}" for a, b in zip(first.kind, frame.kind, strict=True))
            raise FormatError(
                f"{path} must hold slices of one size and colour; {first.path.name} and {frame.path.name} have {rows} rows, "
                f"{columns} columns and {channels} values per sample: part them into folders"
            )
        if frame.orientation:
            at = next((n for n, (turn, _) in enumerate(turns) if np.allclose(turn, frame.orientation, 0, _LARGEST_TURN)), -1)
            if at < 0:
                turns.append((frame.orientation, 1))
            else:
                turns[at] = turns[at][0], turns[at][1] + 1
    if len(turns) > 1:
        counts = ", ".join(str(count) for _, count in turns)
        raise FormatError(
            f"{path} must hold one stack of parallel slices; these lie in {len(turns)} orientations ({counts} slices), "
            "as localizers do: part them into folders, or read one file"
        )
    for frame in frames:
        if bool(frame.position) != bool(first.position):
            without = first if frame.position else frame
            raise FormatError(f"{path} must say where each slice lies; {_called(without)} does not: part them into folders")
        if frame.pixels != first.pixels and (
            not frame.pixels or not first.pixels or not np.allclose(frame.pixels, first.pixels, _ALIKE, 0)
        ):
            raise FormatError(
                f"{path} must hold slices of one spacing; {first.path.name} has {_listing(first.pixels)} and {frame.path.name} "
                f"{_listing(frame.pixels)} mm: part them into folders"
            )


def _listing(values: Sequence[float]) -> str:
    return " × ".join(f"{value:g}" for value in values) or "no"


def order_of(path: Path, frames: Sequence[Frame]) -> tuple[NDArray[np.intp], Leading, str, dict[str, Any]]:
    """Which frames make the volumes, shape (volumes, slices); their leading axis; what was guessed; and time steps for the header.

    Frames are ordered by where they lie; those of the same place by the first of their keys that divide all places alike.
    """
    places = _placed(frames)
    counts = np.bincount(places)
    rows = [[int(n) for n in np.flatnonzero(places == place)] for place in range(len(counts))]
    if counts.min() != counts.max():
        twice = [_called(frames[n]) for n in rows[int(counts.argmax())][:2]]
        raise FormatError(
            f"{path} must hold as many images of each place; it holds several images of some places, {counts.min()} to "
            f"{counts.max()}: {twice[0]} and {twice[1]} lie in the same"
        )
    if counts[0] == 1:
        return np.array(rows).T, Leading(), "", {}
    tuples: list[tuple[Value, ...]] = [() for _ in frames]
    used: list[str] = []
    names = list(dict.fromkeys(name for frame in frames for name in frame.keys))
    for name in names:  # those that divide all places alike
        trial = [(*old, frame.keys.get(name, ())) for old, frame in zip(tuples, frames, strict=True)]
        divisions = {tuple(sorted(map(_sortable, (trial[n] for n in row)))) for row in rows}
        if len(divisions) == 1 and len(set(trial)) > len(set(tuples)):
            tuples, used = trial, [*used, name]
    for name in TIMES:  # or a time that differs from place to place, but orders the images of each
        trial = [(*old, frame.keys.get(name, ())) for old, frame in zip(tuples, frames, strict=True)]
        if len({tuples[n] for n in rows[0]}) < len(rows[0]) and all(len({trial[n] for n in row}) == len(row) for row in rows):
            tuples, used = trial, [*used, name]
    numbers: dict[tuple[Value, ...], list[float]] = defaultdict(list)
    for key, frame in zip(tuples, frames, strict=True):
        numbers[key].extend(finite([frame.number]))
    meant = [tuple(value for name, value in zip(used, key, strict=True) if name != "gradient") for key in tuples]  # it has no order

    def place_of(n: int) -> tuple[Any, ...]:
        return _sortable(meant[n]), np.mean(numbers[tuples[n]]), finite([frames[n].number]), frames[n].index

    order = np.array([sorted(row, key=place_of) for row in rows]).T
    if len({tuples[n] for n in rows[0]}) < len(rows[0]):
        guess = f"the {counts[0]} images of each place were taken for volumes, by their numbers"
        return order, Leading(("volume",), (int(counts[0]),)), guess, {}
    chosen = [frames[n].keys for n in order[:, 0]]
    varying = [name for name in used if len({keys.get(name) for keys in chosen}) > 1]
    axis = "time" if all(name in TIMES for name in varying) else "volume"
    titles = tuple(", ".join(f"{name} {_said(keys.get(name, ()))}" for name in varying) for keys in chosen)
    return order, Leading((axis,), (int(counts[0]),), {axis: titles}), "", _time_step(chosen, varying)


def spread_out(frames: Sequence[Frame]) -> tuple[list[Frame], str]:
    """The frames, placed as far apart as they say where they lack places of their own; and what was guessed."""
    first, turn = frames[0], frames[0].orientation
    normal = np.cross(turn[:3], turn[3:]) if turn else np.array([0.0, 0.0, 1.0])
    if not any(frame.position for frame in frames):
        places = {frame.location for frame in frames}
        if len(frames) < 2 or len(places) < len(frames) or not np.isfinite(list(places)).all():
            return list(frames), ""
        guess = "its slices say no position; they were placed by their SliceLocation"
        return [replace(frame, position=moved((0.0, 0.0, 0.0), frame.location * normal)) for frame in frames], guess
    alike = {(frame.path, frame.position, *((k, v) for k, v in frame.keys.items() if "stack" not in k.lower())) for frame in frames}
    if len(frames) < 2 or len(alike) > 1 or not np.isfinite(first.between):
        return list(frames), ""
    guess = f"its {len(frames)} frames say one position; they were taken for slices, {first.between:g} mm apart"
    return [replace(one, position=moved(one.position, n * first.between * normal)) for n, one in enumerate(frames)], guess


def _sortable(key: tuple[Value, ...]) -> tuple[Any, ...]:
    """Numbers before words, and by their values."""
    return tuple(tuple((isinstance(part, str), part) for part in value) for value in key)


def _said(value: Value) -> str:
    return " ".join(f"{part:g}" if isinstance(part, float) else str(part) for part in value)


def _time_step(chosen: Sequence[dict[str, Value]], varying: Sequence[str]) -> dict[str, Any]:
    """The step of even trigger times, in milliseconds."""
    if list(varying) != ["trigger time"]:
        return {}
    steps = np.diff([keys["trigger time"][0] for keys in chosen])
    even = len(steps) and steps[0] > 0 and np.allclose(steps, steps[0], rtol=_ALIKE)
    return {"time_step": float(steps[0]), "time_unit": "msec"} if even else {}


def _placed(frames: Sequence[Frame]) -> NDArray[np.intp]:
    """Numbers of the places at which frames lie, along the normal of slices in several files, or as the frames of one file run."""
    positions = np.array([frame.position for frame in frames])
    away = positions - positions[0]
    far = np.linalg.norm(away, axis=1)
    if not far.any():
        return np.zeros(len(positions), np.intp)
    axis = away[far.argmax()] / far.max()
    turn = frames[0].orientation
    onwards = np.cross(turn[:3], turn[3:]) if turn and frames[0].path != frames[-1].path else away[-1]
    along = away @ axis * (1 if onwards @ axis >= 0 else -1)
    order = np.argsort(along, kind="stable")
    apart = np.fmin(far.max() / len(positions), frames[0].between) / 10  # frames nearer than that lie in the same place
    places = np.empty(len(positions), np.intp)
    places[order] = np.concatenate([[0], np.cumsum(np.diff(along[order]) > apart)])
    return places


def finite(values: Sequence[float]) -> tuple[float, ...]:
    """For sorting: what is not given comes last."""
    return tuple(np.nan_to_num(values or (np.inf,), nan=np.inf))


def geometry_of(path: Path, stack: Sequence[Frame], film: bool = False) -> dict[str, Any]:
    """Arguments of `Volume` for slices in order; refuses uneven ones."""
    first = stack[0]
    about: dict[str, Any] = {"units": "mm", "space": "LPS"}
    if not first.pixels:
        warn(f"{path.name} does not say how far apart its samples are; 1 mm was taken: spacing= replaces it")
    rows, columns = first.pixels or (1.0, 1.0)
    direction = np.eye(3)
    if first.orientation:
        direction[:, :2] = np.reshape(first.orientation, (2, 3)).T
        direction[:, :2] /= np.linalg.norm(direction[:, :2], axis=0)
        direction[:, 2] = np.cross(direction[:, 0], direction[:, 1])
    distance = first.between
    positions = np.array([frame.position or (0.0, 0.0, 0.0) for frame in stack])
    if first.path == stack[-1].path and not np.isfinite(distance):
        distance = 1.0
    if len(stack) == 1:
        pass
    elif first.position and not film:
        steps = np.diff(positions, axis=0)
        step = (positions[-1] - positions[0]) / (len(stack) - 1)
        distance = float(np.linalg.norm(step))
        shift = np.linalg.norm(positions - positions[0] - np.arange(len(stack))[:, None] * step, axis=1)
        if shift.max() > _LARGEST_SHIFT * distance:
            gaps = np.linalg.norm(steps, axis=1)
            if np.ptp(gaps) <= _LARGEST_SHIFT * distance:
                off = int(np.argmax(shift))
                raise FormatError(
                    f"{path} must hold one stack of slices on a line; they lie {gaps.mean():g} mm apart, but "
                    f"{_called(stack[off])} lies {shift[off]:g} mm beside the line from {_called(stack[0])} to {_called(stack[-1])}"
                )
            wide = int(np.argmax(np.abs(gaps - np.median(gaps))))
            raise FormatError(
                f"{path} must hold one stack of evenly spaced slices; they lie {gaps.min():g} to {gaps.max():g} mm apart, "
                f"{gaps[wide]:g} mm between {_called(stack[wide])} and {_called(stack[wide + 1])}: slices are missing, "
                "or were taken at uneven distances"
            )
        direction[:, 2] = step / distance
    if not np.isfinite(distance):
        about["unplaced"] = "its slices must say where they lie, or how far apart; they do not"
    return about | {"spacing": (columns, rows, distance), "direction": direction, "origin": tuple(positions[0])}


def _called(frame: Frame) -> str:
    return frame.path.name if not frame.index else f"frame {frame.index} of {frame.path.name}"


def grid_of(frames: Sequence[Frame]) -> tuple[list[Frame], NDArray[np.intp]]:
    """The slices of the smallest even stack on which frames lie, and the number of each frame's slice."""
    if not all(frame.position for frame in frames):
        return list(frames[:1]), np.zeros(len(frames), np.intp)
    places = _placed(frames)
    firsts = np.array([frame.position for frame in frames])[np.unique(places, return_index=True)[1]]
    if len(firsts) == 1:
        return list(frames[:1]), places
    gaps = np.linalg.norm(np.diff(firsts, axis=0), axis=1)
    between = frames[0].between  # known, unless it does not divide the gaps
    if not (np.abs(gaps / between - np.rint(gaps / between)) < _LARGEST_SHIFT).all() or (gaps < between / 2).any():
        between = gaps.min()
    counts = np.rint(gaps / between)
    step = (firsts[-1] - firsts[0]) / counts.sum()
    slices = np.concatenate([[0], np.cumsum(counts)]).astype(np.intp)
    stack = [replace(frames[0], position=moved(firsts[0], k * step)) for k in range(int(slices[-1]) + 1)]
    for k, position in zip(slices, firsts, strict=True):  # uneven ones are refused with the rest of the geometry
        stack[k] = replace(stack[k], position=tuple(position))
    return stack, slices[places]
