"""Lists of plain dataclasses that can be written out: CSV, JSON, Markdown, HTML."""

from __future__ import annotations

import csv
import io
import json
import math
import os
from collections.abc import Iterable
from dataclasses import Field, field, fields
from pathlib import Path
from typing import Any, Final, TypeVar

from clvol.base.checks import as_path
from clvol.base.errors import DataError, OptionError
from clvol.base.files import require_suffix, staged
from clvol.base.html import table

__all__ = ["SUFFIXES", "UNLISTED", "Table", "column"]

Row = TypeVar("Row")
SUFFIXES = (".csv", ".json", ".md")

UNLISTED: Final = {"listed": False}
"""Metadata of a field that tables omit, such as an array."""


def column(heading: str, form: str = "") -> Any:
    """A field of a row: its heading, and the format of its numbers in readable tables."""
    return field(metadata={"heading": heading, "form": form})


class Table(list[Row]):
    """Rows of one dataclass each; a value that does not exist is None, never NaN.

    A subclass that knows more than its rows is a dataclass too, whose first field is ``rows: InitVar[Iterable[Row]]``.

    >>> Table([metrics(name) for name in ("linear", "mitchell")]).to_markdown()
    """

    def __post_init__(self, rows: Iterable[Row]) -> None:
        self.extend(rows)

    def records(self) -> list[dict[str, Any]]:
        """Each row by field name."""
        names = [f.name for f in self._columns()]
        return [{name: getattr(row, name) for name in names} for row in self]

    def texts(self) -> list[list[str]]:
        """Headings, then each row, with readable numbers."""
        forms = [f.metadata.get("form", "") for f in self._columns()]
        shown = [["–" if v is None else format(v, form) for v, form in zip(r.values(), forms, strict=True)] for r in self.records()]
        return [[f.metadata.get("heading", f.name) for f in self._columns()], *shown]

    def write(self, path: str | os.PathLike[str]) -> Path:
        """Write the table by suffix: .csv, .json or .md, atomically, by renaming a temporary file.

        Raises
        ------
        FormatError
            Unknown suffix, or the file cannot be written.
        """
        path, suffix = as_path(path), require_suffix(path, SUFFIXES, "tables")
        text = {".csv": self.to_csv, ".json": self.to_json, ".md": self.to_markdown}[suffix]()
        with staged(path, suffix) as temporary:
            temporary.write_text(text.rstrip("\n") + "\n", encoding="utf-8")
        return path

    def to_csv(self) -> str:
        """Comma-separated values with a header of field names; numbers in full, missing ones empty."""
        text = io.StringIO()
        writer = csv.DictWriter(text, [f.name for f in self._columns()], lineterminator="\n")
        writer.writeheader()
        writer.writerows(self.records())  # None is empty
        return text.getvalue()

    def to_json(self) -> str:
        """A list of objects by field name; numbers in full, missing ones null.

        Raises
        ------
        DataError
            A number is NaN or infinite, which JSON cannot represent.
        """
        records = self.records()
        for record, (key, value) in ((r, item) for r in records for item in r.items()):
            if isinstance(value, float) and not math.isfinite(value):
                raise DataError(f"numbers of a table must be finite to be written as JSON; got {key} = {value} in {record!r}")
        return json.dumps(records, indent=2, allow_nan=False, ensure_ascii=False)

    def to_markdown(self) -> str:
        """A pipe table with headings; numbers rounded, missing ones a dash."""
        head, *rows = self.texts()
        rule = ["---", *("--:" for _ in head[1:])]
        cells = [[cell.replace("|", "\\|") for cell in line] for line in (head, rule, *rows)]
        return "\n".join(f"| {' | '.join(line)} |" for line in cells)

    def _repr_html_(self) -> str | None:
        """For notebooks."""
        if not self:
            return None
        header, *rows = self.texts()
        return table(header, rows)

    def _columns(self) -> list[Field[Any]]:
        if not self:
            raise OptionError("a table must hold at least one row to be written; got none")
        return [f for f in fields(self[0]) if f.metadata.get("listed", True)]  # type: ignore[arg-type]  # rows are dataclasses
