"""A report as one HTML page: pictures embedded as data, no scripts, nothing from a network."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clvol.analysis import EXACT_SINC, ErrorTable
from clvol.figures.style import colour, styled, title
from clvol.picture import to_bytes
from clvol.reports.advice import Advice
from clvol.reports.pictures import Cards

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
_LOWER = {"rms", "maximum", "gradient_rms", "angle_mean", "angle_median", "angle_95", "overshoot", "seconds"}
_NOTES = (
    "The data are low-passed and every second sample along each axis is kept. Each filter reconstructs the data from these "
    "samples, and the result is compared with all original samples except those near the faces. So values are compared only at "
    "the kept samples and half-way between them. There the hybrid equals bspline3, by which it magnifies; only its gradients "
    "differ. Half-way, nearest has two equally near samples and takes the upper one, so its error at hard edges is a matter of "
    "chance.",
    "Overshoot is how far values leave the range of the samples. Angles are measured between a gradient and that of a quintic "
    "spline through all samples. A dash means that the number does not exist. The best of each column is bold: the largest PSNR "
    "and SSIM, the smallest of the others.",
)


def inline(picture: Any) -> str:
    """A matplotlib figure, or an array as `clvol.save` takes it, as a data URI of a PNG."""
    stream = io.BytesIO()
    if hasattr(picture, "savefig"):
        with styled():
            picture.savefig(stream, format="png", dpi=_DPI)
    else:
        import imageio.v3 as iio

        iio.imwrite(stream, to_bytes(picture), extension=".png", plugin="pillow", optimize=True)
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode("ascii")


def page(
    name: str,
    facts: Sequence[tuple[str, str]],
    advice: Advice,
    table: ErrorTable,
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
        "<h2>Errors</h2>",
        _table(table, advice.filter),
        *(f'<p class="note">{escape(note)}</p>' for note in _NOTES),
        "<h2>Pictures</h2>",
        f'<p class="note">{_CONSTANT}</p>' if drawn is None else _cards(drawn),
    ]
    for text, source in plots:
        parts.append(f'<h2>{escape(text)}</h2><img class="plot" alt="{escape(text)}" src="{source}">')
    return "\n".join([*parts, "</body></html>", ""])


def _advice(advice: Advice) -> str:
    return '<div class="advice">' + "".join(f"<p>{escape(sentence)}</p>" for sentence in advice.sentences) + "</div>"


def _facts(facts: Sequence[tuple[str, str]]) -> str:
    return '<table class="facts">' + "".join(f"<tr><td>{escape(k)}</td><td>{escape(v)}</td></tr>" for k, v in facts) + "</table>"


def _table(table: ErrorTable, chosen: str) -> str:
    header, _, *lines = [[cell.strip() for cell in line.strip("| ").split("|")] for line in table.to_markdown().splitlines()]
    best = _best(table)
    rows = []
    for i, cells in enumerate(lines):
        style = ' class="chosen"' if cells[0] == chosen else ""
        texts = [f"<td>{_named(cells[0])}</td>"]
        for column, cell in enumerate(cells[1:], 1):
            texts.append(f"<td{' class=best' if i in best.get(column, ()) else ''}>{escape(cell)}</td>")
        rows.append(f"<tr{style}>{''.join(texts)}</tr>")
    head = "".join(f"<th>{escape(cell)}</th>" for cell in header)
    return f'<div class="scroll"><table><tr>{head}</tr>{"".join(rows)}</table></div>'


def _best(table: ErrorTable) -> dict[int, set[int]]:
    """Rows that are best in each column."""
    best: dict[int, set[int]] = {}
    for column, key in enumerate(vars(table[0])):
        known = {i: getattr(row, key) for i, row in enumerate(table) if column and getattr(row, key) is not None}
        if known:
            extreme = min(known.values()) if key in _LOWER else max(known.values())
            best[column] = {i for i, value in known.items() if value == extreme}
    return best


def _named(name: str) -> str:
    in_words = "" if title(name) == name else f'<br><span class="note">{escape(title(name))}</span>'
    shown = "sinc" if name == EXACT_SINC else name
    return f'<span class="dot" style="background:{colour(name)}"></span>{escape(shown)}{in_words}'


def _cards(drawn: Cards) -> str:
    best = escape(drawn.reference)
    gains = [_scale([c.difference for c in drawn.cards]), _scale([c.error for c in drawn.cards])]
    head = "".join(
        f"<th>{text}</th>"
        for text in (
            "",
            "whole view",
            "close-up where filters differ",
            f"close-up: difference from {best}",
            "close-up from every second sample",
            f"its difference from {best} with all samples",
        )
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
    return max(float(np.quantile(np.stack([np.asarray(d) for d in differences]), _SHOWN)), 1 / 255)


def _heat(difference: ArrayLike, maximum: float) -> Any:
    share = np.clip(np.asarray(difference, np.float64) / maximum, 0, 1)
    stops = np.linspace(0, 1, len(_WHITE_TO_RED))
    return np.stack([np.interp(share, stops, [c[i] for c in _WHITE_TO_RED]) for i in range(3)], -1)
