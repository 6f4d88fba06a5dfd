"""Objects with a notebook representation: each lists its facts, and `clvol.base.html` formats them."""

from __future__ import annotations

from typing import ClassVar, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from clvol.base import html

__all__ = ["Facts", "Named", "Shown"]

Row = TypeVar("Row")


class Facts(NamedTuple):
    """Facts about an object: a title, one line per fact, and an optional curve."""

    title: str
    lines: dict[str, str]
    curve: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None


class Shown:
    """An object that notebooks show as facts beside a curve."""

    def _facts(self) -> Facts:
        raise NotImplementedError

    def _repr_html_(self) -> str:
        title, lines, curve = self._facts()
        return html.beside(*([html.curve(*curve)] if curve else []), html.facts(title, lines))


class Named(dict[str, Row]):
    """Rows by name, shown as a table."""

    HEADER: ClassVar[tuple[str, ...]]

    def rows(self) -> list[tuple[str, ...]]:
        """One tuple of strings per row, in the order of `HEADER`."""
        raise NotImplementedError

    def __repr__(self) -> str:
        return html.text_table(self.HEADER, self.rows())

    def _repr_html_(self) -> str:
        return html.table(self.HEADER, self.rows())
