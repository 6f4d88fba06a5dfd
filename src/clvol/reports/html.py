"""A report as one HTML page: pictures embedded as data, no scripts, nothing from a network."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clvol.analysis import ErrorTable, LeftOutTable, PredictedRow, PredictedTable, RotationTable, Table
from clvol.analysis.table import column
from clvol.base.html import escape
from clvol.figures.style import colour, styled, title
from clvol.reports.advice import Advice
from clvol.reports.pictures import Cards
from clvol.show.picture import to_png

__all__ = ["inline", "page"]

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #222; background: #fff; max-width: 1500px; margin: 2rem auto }
body { padding: 0 1.5rem }
h1 { font-size: 1.7rem; margin-bottom: .3rem } h2 { font-size: 1.25rem; margin-top: 2.4rem; border-bottom: 1px solid #ddd }
.advice { background: #eef4fb; border-left: 5px solid #1769c2; padding: .8rem 1.2rem; margin: 1.2rem 0 }
.advice p:first-child { font-size: 1.2rem; font-weight: 600; margin-top: 0 } .advice p { margin: .35rem 0 }
table { border-collapse: collapse; font-variant-numeric: tabular-nums } th, td { padding: .3rem .7rem; text-align: right }
th { border-bottom: 2px solid #bbb; font-weight: 600 } td { border-bottom: 1px solid #eee } td.best { font-weight: 700 }
th:first-child, td:first-child { text-align: left } tr.chosen { background: #eef4fb } .scroll { overflow-x: auto }
.facts td { text-align: left; padding: .1rem .8rem .1rem 0; border: 0 } .facts td:first-child { color: #6f6f6f }
.cards { table-layout: fixed; width: 100%; min-width: 900px } .cards th:first-child { width: 9rem }
.cards th { text-align: center; border: 0; font-size: .9rem; vertical-align: bottom } .cards td { padding: .25rem; border: 0 }
.cards img { width: 100%; display: block }
.dot { display: inline-block; width: .8em; height: .8em; border-radius: 50%; margin-right: .5em }
.note { color: #6f6f6f; font-size: .9rem } img.plot { max-width: 100% }
""".strip()
_CONSTANT = "All samples have the same value: there is nothing to draw."
_DPI = 110
_WHITE_TO_RED = ((1.0, 1.0, 1.0), (0.95, 0.55, 0.4), (0.6, 0.05, 0.1))
_SHOWN = 0.995  # the strongest colour is this quantile of the differences
_HIGHER = {"psnr", "ssim"}  # the best is the largest; of all others the smallest
_BEST = " The best of each column is bold."
_EXPECTED = (
    "The effect of each filter on the frequencies of these samples, and on their noise: for these numbers nothing is "
    "blurred or omitted. Bias is blur and aliases (0 if the noise may explain all of it); noise is the part of the samples' "
    "noise that the filter keeps; the root of the sum of both squares is the expected error between the samples, and the "
    "advice above is based on it. Frequencies of the object beyond Nyquist cannot be known: they are assumed to be 0, except "
    "at jumps from one sample to the next. Gradients are per world unit. Overshoot is how far values half-way between these "
    "samples leave their range."
)
_MEASURED = (
    "An experiment on blurred data: the volume is low-passed, every second sample of it along each axis is kept, and the "
    "reconstructions from these are compared with the low-passed volume. The low-pass itself removed {lost:.3g} (RMS) from "
    "the samples. No filter can restore that, and only the second column includes it, the difference from the samples "
    "before the low-pass{share}. The low-pass also removes most of the noise, and the rest counts as data here, so filters "
    "that smooth look worse than they are. Angles are to the gradient of the quintic spline through the low-passed volume, "
    "where it exceeds the noise. A dash means that the number does not exist."
)
_LEFT_OUT = (
    "Nothing is low-passed here: along one axis every second slice is omitted and predicted from the others, RMS{noise}. "
    "All filters lose detail finer than two slices."
)
_TURNED = (
    "Nothing is low-passed here either: the middle slice is rotated {turns} times by {degrees:g}°, resampled each time, and "
    "compared with itself within the disc that stays inside. Noise is part of the picture here: smoothing it counts as an "
    "error."
)


def inline(picture: Any) -> str:
    """A matplotlib figure, or an array as `clvol.save` takes it, as a data URI of a PNG."""
    stream = io.BytesIO()
    if hasattr(picture, "savefig"):
        with styled():
            picture.savefig(stream, format="png", dpi=_DPI)
    else:
        stream.write(to_png(picture))
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode("ascii")


def page(
    name: str,
    facts: Sequence[tuple[str, str]],
    advice: Advice,
    table: ErrorTable,
    left_out: LeftOutTable,
    turned: RotationTable | None,
    drawn: Cards | None,
    plots: Sequence[tuple[str, str]],
) -> str:
    """The whole page; `plots` are headings and data URIs, `drawn` is None for constant data."""
    heading = f"Which filter for {escape(name)}?"
    parts = [
        "<!DOCTYPE html>",
        '<html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{heading}</title><style>{_STYLE}</style></head><body>",
        f"<h1>{heading}</h1>",
        _advice(advice),
        _facts(facts),
    ]
    if advice.expected is not None:
        parts += ["<h2>Errors to expect</h2>", _expected(advice.expected, table, advice.filter), _note(_EXPECTED + _BEST)]
    parts += [
        "<h2>Pictures</h2>",
        _note(_CONSTANT) if drawn is None else _cards(drawn),
        "<h2>Measured: from every second sample</h2>",
        _table(
            table, advice.filter, without=("angle_median", "overshoot", "seconds")
        ),  # the last two are beside the expected errors
        _note(_measured(table) + _BEST),
    ]
    if any(value is not None for row in left_out for value in (row.x, row.y, row.z)):
        noise = f", less the noise ({left_out.sigma:.3g})" if left_out.sigma > 0 else ", noise and all"
        parts += [
            "<h2>Measured: slices left out</h2>",
            _table(left_out, advice.filter),
            _note(_LEFT_OUT.format(noise=noise) + _BEST),
        ]
    if turned is not None:
        says = _TURNED.format(turns=turned.turns, degrees=360 / turned.turns)
        parts += ["<h2>Measured: turned in a circle</h2>", _table(turned, advice.filter), _note(says + _BEST)]
    for text, source in plots:
        parts.append(f'<h2>{escape(text)}</h2><img class="plot" alt="{escape(text)}" src="{source}">')
    return "\n".join([*parts, "</body></html>", ""])


def _note(text: str) -> str:
    return f'<p class="note">{escape(text)}</p>'


def _measured(table: ErrorTable) -> str:
    """Text about the table of errors; the share of the low-pass is relative to the best filter's squared difference."""
    best, share = min(table, key=lambda row: row.rms), ""
    if best.original:
        share = f" ({100 * min(1.0, (table.lost / best.original) ** 2):.0f} % of that difference's square for {best.filter})"
    return _MEASURED.format(lost=table.lost, share=share)


def _advice(advice: Advice) -> str:
    return '<div class="advice">' + "".join(f"<p>{escape(sentence)}</p>" for sentence in advice.sentences) + "</div>"


def _facts(facts: Sequence[tuple[str, str]]) -> str:
    return '<table class="facts">' + "".join(f"<tr><td>{escape(k)}</td><td>{escape(v)}</td></tr>" for k, v in facts) + "</table>"


def _table(table: Table[Any], chosen: str | None, without: Sequence[str] = ()) -> str:
    """Rows with readable numbers; columns that are empty in all rows are omitted."""
    header, *lines = table.texts()
    records = table.records()
    columns = [i for i, name in enumerate(records[0]) if name not in without and any(line[i] != "–" for line in lines)]
    best = _best(records)
    rows = []
    for i, cells in enumerate(lines):
        style = ' class="chosen"' if cells[0] == chosen else ""
        texts = [f"<td>{_named(cells[0])}</td>"]
        texts += [f"<td{' class=best' if i in best[c] else ''}>{escape(cells[c])}</td>" for c in columns[1:]]
        rows.append(f"<tr{style}>{''.join(texts)}</tr>")
    head = "".join(f"<th>{escape(header[c])}</th>" for c in columns)
    return f'<div class="scroll"><table><tr>{head}</tr>{"".join(rows)}</table></div>'


def _best(records: Sequence[dict[str, Any]]) -> list[set[int]]:
    """Rows that are best in each column; none in the first, of names."""
    best: list[set[int]] = []
    for key in records[0]:
        known = {i: record[key] for i, record in enumerate(records) if best and record[key] is not None}
        extreme = (max if key in _HIGHER else min)(known.values(), default=None)
        best.append({i for i, value in known.items() if value == extreme})
    return best


@dataclass(frozen=True)
class _Expected(PredictedRow):
    """A row of the expected errors, with overshoot and times."""

    overshoot: float | None = column("overshoot", ".3g")
    seconds: float | None = column("s / million", ".3g")


def _expected(expected: PredictedTable, table: ErrorTable, chosen: str | None) -> str:
    measured = {row.filter: row for row in table}
    others = [{name: getattr(measured[row.filter], name) for name in ("overshoot", "seconds")} for row in expected]
    return _table(Table(_Expected(**vars(row), **other) for row, other in zip(expected, others, strict=True)), chosen)


def _named(name: str) -> str:
    in_words = "" if title(name) == name else f'<br><span class="note">{escape(title(name))}</span>'
    return f'<span class="dot" style="background:{colour(name)}"></span>{escape(name)}{in_words}'


def _cards(drawn: Cards) -> str:
    best = escape(drawn.reference)
    gains = [_scale([c.difference for c in drawn.cards]), _scale([c.error for c in drawn.cards])]
    head = (
        "<th></th><th>whole view</th><th>close-up where filters differ</th>"
        f"<th>close-up: difference from {best}</th><th>close-up from every second sample</th>"
        f"<th>its difference from {best} with all samples</th>"
    )
    rows = []
    for card in drawn.cards:
        pictures = (card.whole, card.closer, _heat(card.difference, gains[0]), card.fewer, _heat(card.error, gains[1]))
        cells = "".join(f'<td><img alt="{escape(card.filter)}" src="{inline(p)}"></td>' for p in pictures)
        rows.append(f"<tr><td>{_named(card.filter)}</td>{cells}</tr>")
    note = (
        f"Mode {escape(drawn.mode)}; differences of shade from 0 (white) to {gains[0]:.2f} and {gains[1]:.2f} of full (dark red)."
    )
    return f'<div class="scroll"><table class="cards"><tr>{head}</tr>{"".join(rows)}</table></div><p class="note">{note}</p>'


def _scale(differences: Sequence[ArrayLike]) -> float:
    return max(float(np.quantile(np.stack(differences), _SHOWN)), 1 / 255)


def _heat(difference: ArrayLike, maximum: float) -> Any:
    share = np.clip(np.asarray(difference, np.float64) / maximum, 0, 1)
    stops = np.linspace(0, 1, len(_WHITE_TO_RED))
    return np.stack([np.interp(share, stops, [c[i] for c in _WHITE_TO_RED]) for i in range(3)], -1)
