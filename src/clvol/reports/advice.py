"""A recommendation in plain words, computed from the errors that were measured of the data at hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from clvol.analysis import EXACT_SINC, ErrorRow, ErrorTable
from clvol.figures.style import title
from clvol.filter import Filter

__all__ = ["Advice", "advise"]

_AS_GOOD = 1.05  # times the least error: what nobody would tell from the best
_LITTLE = 0.05  # share of the error: less is not worth the time
_LEAVES = 0.01  # of the range
_NONE = 1e-6  # of the range: rounding
_RICH, _SMOOTH = 0.1, 0.01  # shares of the variance above half of Nyquist
_BASE = "linear"  # what most programs do


@dataclass(frozen=True)
class Advice:
    """What to use for some data, and why.

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
    """Of the filters that err least the narrowest, of these the smoothest; and what its choice gains and costs.

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
        told = f"What was measured is constant: every filter whose weights sum to one gives it back, so use {name}, which is fast."
        return Advice(name, [told])
    least = min(row.rms for row in rows)
    near = [row for row in rows if row.rms <= _AS_GOOD * least]
    slopes = [row.gradient_rms for row in near if row.gradient_rms is not None]
    steady = [row for row in near if row.gradient_rms is not None and row.gradient_rms <= _AS_GOOD * min(slopes)]
    chosen = min(steady or near, key=lambda row: (_taps(table.filter(row.filter)), -table.filter(row.filter).continuity, row.rms))
    spoken = "" if title(chosen.filter) == chosen.filter else f" ({title(chosen.filter)})"
    sentences = [f"For these data use {chosen.filter}{spoken}."]
    sentences += _against_base(rows, chosen)
    best = min(rows, key=lambda row: row.rms)
    if best is not chosen and chosen.rms > best.rms:
        gain = 1 - best.rms / chosen.rms
        sentences.append(f"The least error of all has {best.filter}, {_percent(gain)} less{_slower(best, chosen)}.")
    sentences += _gradients(rows, chosen)
    sentences.append(_overshoot(rows, chosen, top - low))
    if sinc is not None and chosen.rms > 0:
        ratio = sinc.rms / chosen.rms - 1
        word = "more" if ratio > 0 else "less"
        sentences.append(f"The exact sinc, ideal in theory, errs {_percent(abs(ratio))} {word} than {chosen.filter} on these data.")
    if high is not None:
        kind = "rich in detail as fine as the samples" if high > _RICH else "well sampled" if high > _SMOOTH else "very smooth"
        sentences.append(f"{_percent(high)} of their variance lies above half of the Nyquist frequency: they are {kind}.")
    return Advice(chosen.filter, sentences)


def _taps(row: Filter) -> int:
    """Taps a sample along each axis, of the given data: what a filter costs wherever it runs, and no chance in it."""
    return row.support * row.scale


def _against_base(rows: Sequence[ErrorRow], chosen: ErrorRow) -> list[str]:
    base = next((row for row in rows if row.filter == _BASE), None)
    if base is None or base is chosen or not base.rms:
        return []
    gain = 1 - chosen.rms / base.rms
    if gain < _LITTLE:
        return [f"The choice matters little here: it errs {_percent(max(gain, 0))} less than {_BASE} interpolation."]
    return [
        f"It errs {_percent(gain)} less than {_BASE} interpolation (RMS {chosen.rms:.3g} against {base.rms:.3g})"
        f"{_slower(chosen, base)}."
    ]


def _slower(row: ErrorRow, than: ErrorRow) -> str:
    if not row.seconds or not than.seconds:
        return ""
    return f", in {row.seconds / than.seconds:.1f} times the time a sample"


def _gradients(rows: Sequence[ErrorRow], chosen: ErrorRow) -> list[str]:
    base = next((row for row in rows if row.filter == _BASE), None)
    if base is None or base is chosen or not base.gradient_rms or chosen.gradient_rms is None:
        return []
    gain = 1 - chosen.gradient_rms / base.gradient_rms
    word = "less" if gain >= 0 else "more"
    return [f"Its gradients, which light surfaces, err {_percent(abs(gain))} {word} than those of {_BASE} interpolation."]


def _overshoot(rows: Sequence[ErrorRow], chosen: ErrorRow, span: float) -> str:
    if chosen.overshoot <= _LEAVES * span:
        most = chosen.overshoot / span
        if most < _NONE:
            return "It stays within the range of the samples."
        return f"It leaves the range of the samples by no more than {_percent(most)} of it."
    within = [row.filter for row in rows if row.overshoot <= _LEAVES * span]
    instead = f"; where that may not be, use {' or '.join(within)}" if within else ""
    return f"At edges it leaves the range of the samples by up to {_percent(chosen.overshoot / span)} of it{instead}."


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if share >= 0.0995 or share == 0 else f"{100 * share:.2g} %"
