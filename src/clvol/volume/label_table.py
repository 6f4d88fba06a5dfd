"""A table of labels, their names, colours and opacities: from rows, and from the text files of other programs."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

from clvol.base.checks import did_you_mean, number, whole
from clvol.base.color import Color, color_of
from clvol.base.errors import FormatError, OptionError

__all__ = ["LabelRow", "LabelTable", "read_table"]

LabelRow: TypeAlias = "str | tuple[str | None, Color | str | None] | tuple[str | None, Color | str | None, float | None]"
"""A name; or a name, a colour and an opacity, of which None leaves one open."""
_Row: TypeAlias = tuple[str | None, Color | None, float | None]

_RULE = "a name, or (name, color, opacity), of which the last may be left out and any may be None"
_OPEN: _Row = (None, None, None)
_LISTED = 16  # names in a message
_LARGEST = 1 << 24  # bytes of a file
_OF_COLOR_TABLE = re.compile(r"(\d+)\s+(\S+)((?:\s+\d+){3,5})|(\d+)\s+(.+?)((?:\s+\d+){4})")
_OF_ITK_SNAP = re.compile(r'(\d+)\s+(\d+)\s+(\d+)\s+(\d+)\s+(\d*\.?\d+|\d+\.)\s+([01])\s+([01])\s+"(.*)"')


class LabelTable(Mapping[int, str]):
    """Names of labels by their numbers, in ascending order, and the colours and opacities that they have.

    It may have rows for labels that a volume has not, and a volume labels without a row. See `Volume` and `clvol.labels.table`.

    Parameters
    ----------
    rows : mapping of int to str or (name, color, opacity)
        Of each label its name, or its name, colour (three numbers in 0..1, or a name) and opacity (0..1), of which the last
        may be left out. None leaves open: the label has a colour for its number, and is opaque.

    Raises
    ------
    OptionError
        A number is not whole, or a row is none of these.

    Examples
    --------
    >>> import clvol
    >>> table = clvol.labels.LabelTable({1: "liver", 2: ("skin", "bisque", 0.3)})
    >>> table[2], table.opacities[2]
    ('skin', 0.3)
    """

    def __init__(self, rows: Mapping[int, LabelRow]) -> None:
        if not isinstance(rows, Mapping):
            raise OptionError(f"labels must be a mapping from whole numbers to {_RULE}; got {rows!r:.200}")
        known = {whole("each label", label): _row(label, row) for label, row in rows.items()}
        self._rows = dict(sorted(known.items()))

    def __getitem__(self, label: int) -> str:
        return self._rows[label][0] or ""

    def __iter__(self) -> Iterator[int]:
        return iter(self._rows)

    def __len__(self) -> int:
        return len(self._rows)

    def __eq__(self, other: object) -> bool:
        """Equal rows; a mapping of names is equal to one that has these names."""
        return self._rows == other._rows if isinstance(other, LabelTable) else super().__eq__(other)

    __hash__ = None  # type: ignore[assignment]  # as of any mapping

    def __repr__(self) -> str:
        return f"LabelTable({self.rows!r})"

    @property
    def rows(self) -> dict[int, Any]:
        """The rows, from which `LabelTable` makes the same: names where nothing else is known."""
        return {label: row[0] if row[0] is not None and row[1:] == (None, None) else row for label, row in self._rows.items()}

    @cached_property
    def colors(self) -> dict[int, Color]:
        """Colours from 0 to 1 of the labels that have one."""
        return {label: color for label, (_, color, _) in self._rows.items() if color is not None}

    @cached_property
    def opacities(self) -> dict[int, float]:
        """Opacities of the labels that have one."""
        return {label: opacity for label, (_, _, opacity) in self._rows.items() if opacity is not None}

    def over(self, other: Mapping[int, LabelRow]) -> LabelTable:
        """A table with the rows of both; what this one leaves open is that of the other."""
        below = (other if isinstance(other, LabelTable) else LabelTable(other))._rows
        both = {
            label: tuple(b if a is None else a for a, b in zip(row, below.get(label, _OPEN), strict=True))
            for label, row in self._rows.items()
        }
        return LabelTable({**below, **both})  # type: ignore[dict-item]  # three of each

    def number_of(self, label: object) -> int:
        """The number of a label that is given by its number, which need not have a row, or by its name.

        Raises
        ------
        OptionError
            No label has the name, or several have it; or it is neither a name nor a whole number.
        """
        if not isinstance(label, str):
            return whole("a label", label)
        found = [number for number, name in self.items() if label and name == label]
        if len(found) == 1:
            return found[0]
        if found:
            raise OptionError(f"a name must be that of one label, or the label given by its number; {label!r} is of {_some(found)}")
        known = sorted({name for name in self.values() if name})
        raise OptionError(f"no label has this name{did_you_mean(label, known)}; got {label!r}, and names are: {_some(known)}")


def _some(items: Sequence[object]) -> str:
    return ", ".join(map(str, items[:_LISTED])) + (", ..." if len(items) > _LISTED else "") if items else "none"


def _row(label: object, given: object) -> _Row:
    row = (given,) if isinstance(given, str) else given
    if not isinstance(row, (tuple, list)) or not 1 <= len(row) <= 3 or not isinstance(row[0], (str, type(None))):
        raise OptionError(f"labels must be a mapping from whole numbers to {_RULE}; got {given!r:.200} for label {label}")
    name, color, opacity = (*row, None, None)[:3]
    if color is not None:
        color = color_of(f"the color of label {label}", color)
        if max(color) > 1:
            raise OptionError(f"the color of label {label} must be three numbers in 0..1, or a name; got {row[1]!r}")
    if opacity is not None:
        opacity = number(f"the opacity of label {label}", opacity, minimum=0, maximum=1)
    return name, color, opacity


# -- files of other programs -----------------------------------------------------------------------------------


def read_table(path: Path) -> LabelTable:
    """The table of a text file: see `clvol.labels.table`."""
    try:
        size = path.stat().st_size
        if size > _LARGEST:
            raise FormatError(f"{path} must be a table of labels, a text of up to {_LARGEST} bytes; it has {size}")
        lines = list(map(str.strip, path.read_text(encoding="utf-8-sig").splitlines()))
    except (OSError, UnicodeDecodeError) as error:
        raise FormatError(f"{path} must be a table of labels, a text in UTF-8: {error}") from error
    rows = [(at, line) for at, line in enumerate(lines, 1) if line and not line.startswith("#")]
    if not rows:
        raise FormatError(f"{path} must be a table of labels; it has no row")
    of_itk_snap = _OF_ITK_SNAP.fullmatch(rows[0][1]) is not None
    found: dict[int, _Row] = {}
    lines_of: dict[int, int] = {}
    for at, line in rows:
        try:
            label, row = _of_itk_snap(line) if of_itk_snap else _of_color_table(line)
        except ValueError as error:
            raise FormatError(f"{path}, line {at}: {error}; got {line!r:.200}") from None
        if found.setdefault(label, row) != row:
            raise FormatError(f"{path}, line {at}: a label must have one row; line {lines_of[label]} has another one of {label}")
        lines_of.setdefault(label, at)
    if not of_itk_snap:
        of_slicer = any(line.startswith("#") and "color table file" in line.casefold() for line in lines)
        found = _seen(found, of_slicer=of_slicer)
    return LabelTable(found)


def _of_itk_snap(line: str) -> tuple[int, _Row]:
    """A row of ITK-SNAP; a label that is not visible has the opacity 0."""
    match = _OF_ITK_SNAP.fullmatch(line)
    if match is None:
        raise ValueError('a row must be, as those above, number R G B A VIS MSH "name"')
    if float(match[5]) > 1:
        raise ValueError("opacity must be 0 to 1")
    return int(match[1]), (match[8], _color(match.groups()[1:4]), float(match[5]) * int(match[6]))


def _of_color_table(line: str) -> tuple[int, _Row]:
    """A row of FreeSurfer, which may end with a type of tissue, or of 3D Slicer, with the number behind the colour as it is."""
    match = _OF_COLOR_TABLE.fullmatch(line)
    if match is None:
        raise ValueError(
            'a row must be number name R G B A, as in tables of FreeSurfer and 3D Slicer, or number R G B A VIS MSH "name", as in '
            "those of ITK-SNAP"
        )
    label, name, numbers = match.groups()[:3] if match[1] else match.groups()[3:]
    shades = numbers.split()
    if len(shades) > 3 and int(shades[3]) > 255:
        raise ValueError("the number behind a colour must be 0 to 255")
    return int(label), (name, _color(shades[:3]), float(shades[3]) if len(shades) > 3 else None)


def _color(shades: Sequence[str]) -> Color:
    r, g, b = (int(shade) / 255 for shade in shades)
    if max(r, g, b) > 1:
        raise ValueError("red, green and blue must be 0 to 255")
    return r, g, b


def _seen(rows: Mapping[int, _Row], *, of_slicer: bool) -> dict[int, _Row]:
    """Rows with opacities, of numbers that are opacities in 3D Slicer, and transparencies in FreeSurfer."""
    last = [shown for label, (_, _, shown) in rows.items() if label and shown is not None]
    of_slicer = of_slicer or 2 * last.count(255) >= len(last)  # or half of the labels would be invisible
    return {
        label: (name, color, None if shown is None else (shown if of_slicer else 255 - shown) / 255)
        for label, (name, color, shown) in rows.items()
    }
