"""A recommendation in plain words, computed from the errors that were measured of the data at hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from clvol.analysis import EXACT_SINC, ErrorRow, ErrorTable
from clvol.figures.style import title
from clvol.filter import Filter

__all__ = ["Advice", "advise"]

_AS_GOOD = 1.05  # times the smallest error: nobody would see the difference
_LITTLE = 0.05  # share of the error: a smaller gain is not worth the time
_LEAVES = 0.01  # of the range
_NONE = 1e-6  # of the range: rounding
_RICH, _SMOOTH = 0.1, 0.01  # shares of the variance above half of Nyquist
_BASE = "linear"  # what most programs do


@dataclass(frozen=True)
class Advice:
    """Which filter to use for some data, and why.

    Attributes
    ----------
    filter : str
        Name of the filter recommended.
    sentences : list of str
        The recommendation first.
    """

    filter: str
    sentences: list[str]


def advise(table: ErrorTable, high: float | None = None) -> Advice:
    """The narrowest of the filters with the smallest error, then the smoothest; and what the choice gains and costs.

    Parameters
    ----------
    table : ErrorTable
        From `clvol.analysis.compare`.
    high : float, optional
        Share of the data's variance above half of the Nyquist frequency.
    """
    rows = [row for row in table if row.filter != EXACT_SINC]
    sinc = next((row for row in table if row.filter == EXACT_SINC), None)
    low, top = table.value_range
    if low == top:
        name = _BASE if any(row.filter == _BASE for row in rows) else rows[0].filter
        sentence = f"The data are constant: every filter whose weights sum to one reproduces them, so use {name}, which is fast."
        return Advice(name, [sentence])
    smallest = min(row.rms for row in rows)
    near = [row for row in rows if row.rms <= _AS_GOOD * smallest]
    slopes = [row.gradient_rms for row in near if row.gradient_rms is not None]
    steady = [row for row in near if row.gradient_rms is not None and row.gradient_rms <= _AS_GOOD * min(slopes)]
    chosen = min(steady or near, key=lambda row: (_taps(table.filter(row.filter)), -table.filter(row.filter).continuity, row.rms))
    in_words = "" if title(chosen.filter) == chosen.filter else f" ({title(chosen.filter)})"
    sentences = [f"For these data use {chosen.filter}{in_words}."]
    sentences += _against_base(rows, chosen)
    best = min(rows, key=lambda row: row.rms)
    if best is not chosen and chosen.rms > best.rms:
        gain = 1 - best.rms / chosen.rms
        sentences.append(f"{best.filter} has the smallest error, {_percent(gain)} lower{_slower(best, chosen)}.")
    sentences += _gradients(rows, chosen)
    sentences.append(_overshoot(rows, chosen, top - low))
    if sinc is not None and chosen.rms > 0:
        ratio = sinc.rms / chosen.rms - 1
        word = "larger" if ratio > 0 else "smaller"
        sentences.append(
            f"The exact sinc, ideal in theory, has a {_percent(abs(ratio))} {word} error than {chosen.filter} on these data."
        )
    if high is not None:
        kind = "rich in detail as fine as the samples" if high > _RICH else "well sampled" if high > _SMOOTH else "very smooth"
        sentences.append(f"{_percent(high)} of their variance lies above half of the Nyquist frequency: they are {kind}.")
    return Advice(chosen.filter, sentences)


def _taps(row: Filter) -> int:
    """Taps per sample along each axis of the given data: the cost of a filter on every machine, free of timing noise."""
    return row.support * row.scale


def _against_base(rows: Sequence[ErrorRow], chosen: ErrorRow) -> list[str]:
    base = next((row for row in rows if row.filter == _BASE), None)
    if base is None or base is chosen or not base.rms:
        return []
    gain = 1 - chosen.rms / base.rms
    if gain < _LITTLE:
        return [f"The choice matters little here: its error is {_percent(max(gain, 0))} smaller than that of {_BASE}."]
    return [
        f"Its error is {_percent(gain)} smaller than that of {_BASE} interpolation (RMS {chosen.rms:.3g} against {base.rms:.3g})"
        f"{_slower(chosen, base)}."
    ]


def _slower(row: ErrorRow, than: ErrorRow) -> str:
    if not row.seconds or not than.seconds:
        return ""
    return f", at {row.seconds / than.seconds:.1f} times the time per sample"


def _gradients(rows: Sequence[ErrorRow], chosen: ErrorRow) -> list[str]:
    base = next((row for row in rows if row.filter == _BASE), None)
    if base is None or base is chosen or not base.gradient_rms or chosen.gradient_rms is None:
        return []
    gain = 1 - chosen.gradient_rms / base.gradient_rms
    word = "smaller" if gain >= 0 else "larger"
    return [f"The error of its gradients, which shade surfaces, is {_percent(abs(gain))} {word} than with {_BASE} interpolation."]


def _overshoot(rows: Sequence[ErrorRow], chosen: ErrorRow, span: float) -> str:
    if chosen.overshoot <= _LEAVES * span:
        share = chosen.overshoot / span
        if share < _NONE:
            return "It stays within the range of the samples."
        return f"It leaves the range of the samples by no more than {_percent(share)}."
    within = [row.filter for row in rows if row.overshoot <= _LEAVES * span]
    instead = f"; if that must not happen, use {' or '.join(within)}" if within else ""
    return f"At edges it leaves the range of the samples by up to {_percent(chosen.overshoot / span)}{instead}."


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if share >= 0.0995 or share == 0 else f"{100 * share:.2g} %"
