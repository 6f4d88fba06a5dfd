"""Tables as text that people and programs read."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from clvol.analysis import ErrorTable, Metrics, Table, metrics
from clvol.analysis.table import UNLISTED, column
from clvol.base.errors import DataError, FormatError, OptionError


@dataclass(frozen=True, kw_only=True)
class Row:
    name: str = column("Name")
    value: float | None = column("Value (°)", ".2f")
    plain: int
    hidden: np.ndarray = field(metadata=UNLISTED)


ROWS = Table([Row(name="a, b", value=1 / 3, plain=3, hidden=np.ones(3)), Row(name="c|d", value=None, plain=4, hidden=np.ones(3))])


def test_csv_holds_numbers_in_full() -> None:
    assert list(csv.reader(io.StringIO(ROWS.to_csv()))) == [
        ["name", "value", "plain"],
        ["a, b", repr(1 / 3), "3"],
        ["c|d", "", "4"],
    ]


def test_json_holds_numbers_in_full() -> None:
    assert json.loads(ROWS.to_json()) == [{"name": "a, b", "value": 1 / 3, "plain": 3}, {"name": "c|d", "value": None, "plain": 4}]


def test_markdown_is_readable() -> None:
    assert ROWS.to_markdown() == ("| Name | Value (°) | plain |\n| --- | --: | --: |\n| a, b | 0.33 | 3 |\n| c\\|d | – | 4 |")


def test_rows_can_be_combined() -> None:
    table = Table([metrics(name) for name in ("linear", "mitchell")])
    assert isinstance(table[0], Metrics)
    assert table.to_markdown().count("\n") == 3
    assert issubclass(ErrorTable, Table)


@pytest.mark.parametrize(("name", "make"), [("a.csv", "to_csv"), ("a.JSON", "to_json"), ("a.md", "to_markdown")])
def test_tables_are_written_by_suffix(tmp_path: Path, name: str, make: str) -> None:
    assert ROWS.write(tmp_path / name) == tmp_path / name
    assert (tmp_path / name).read_text(encoding="utf-8") == getattr(ROWS, make)().rstrip("\n") + "\n"
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_unwritable_targets_are_rejected(tmp_path: Path) -> None:
    for bad in ("a.txt", "a", "csv"):
        with pytest.raises(FormatError, match=rf"tables are written as \.csv, \.json, \.md; got '{bad}'"):
            ROWS.write(bad)
    with pytest.raises(FormatError, match="does not exist"):
        ROWS.write(tmp_path / "none" / "a.csv")


@pytest.mark.parametrize("bad", [float("nan"), float("-inf")])
def test_nonfinite_numbers_in_json_are_rejected(bad: float) -> None:
    with pytest.raises(DataError, match="numbers of a table must be finite to be written as JSON; got value = "):
        Table([Row(name="a", value=bad, plain=1, hidden=np.ones(1))]).to_json()


def test_an_empty_table_is_rejected() -> None:
    for write in (Table().to_csv, Table().to_json, Table().to_markdown):
        with pytest.raises(OptionError, match="at least one row"):
            write()
