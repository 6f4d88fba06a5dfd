"""A recommendation in plain words, from the expected error of each filter on the given data.

The recommendation is based on `clvol.analysis.predict`: the spectrum of the samples, minus their noise, through each filter. Two
filters are compared in words only if the bootstrap of their errors over blocks of the volume shows which is better.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from clvol.analysis import EXACT_SINC, PredictedRow, PredictedTable, predict
from clvol.analysis.comparison import as_compared, keeps_range, overshoot
from clvol.base.errors import OptionError
from clvol.figures.style import title
from clvol.filter.boundary import DEFAULT_BOUNDARY, Boundary, as_boundary
from clvol.filter.filter import Filter
from clvol.filter.table import PICTURE_FILTER
from clvol.noise import Noise
from clvol.volume.smoothing import settled
from clvol.volume.volume import Volume, as_volume

__all__ = ["ADVISED", "Advice", "advise"]

ADVISED = (
    "nearest",
    "linear",
    "bspline3-approx",
    "mitchell",
    "catmull-rom",
    "bspline3",
    "bspline3(auto)",
    "omoms3",
    "bspline5",
    "hybrid",
)
"""The filters that `advise` and reports choose from by default."""

_AS_GOOD = 1.05  # times the smallest error; the difference is not visible
_LITTLE = 0.05  # share of the error; a smaller gain is not worth a sentence
_RISK = 1.1  # times the smallest error, within what is known of the noise
_UNCERTAIN = "too few samples show how strong it is: its variance is known to within {}, and other filters may err less"
_BASE = "linear"  # the default of most programs
_UNSEEN = 1e-4  # of the range; smaller noise and errors are not visible
_UNSEEN_SLOPE = 0.01  # of the gradients; half a degree
_SLIGHT = 1e-3  # of the range; noise that eight bits do not show
_ROUNDING = 1e-6  # of the range; float32's rounding errors
_DETAIL = (  # share of the squared differences above half of Nyquist; at a step from one sample to the next it is a half
    (0.4, "their detail is as fine as the samples, and some of it is lost between them"),
    (0.1, "they are sharp, and their samples just hold them"),
    (0.01, "they are well sampled"),
    (0.0, "they are very smooth"),
)
_NOTHING = 0.1  # of the variance; less is within the uncertainty of the estimated noise
_STEPS = 0.5  # share of the squared differences in jumps
_KINDS = {
    "correlated": ", correlated from sample to sample",
    "signal-dependent": ", whose variance changes with the value",
    "magnitude": " of magnitudes (Rician), which raises low values",
    "clipped": ", clipped at a limit, which shifts values beside it",
    "uneven": ", uneven from place to place",
}


@dataclass(frozen=True)
class Advice:
    """Which filter to use for some data, and why.

    Attributes
    ----------
    filter : str or None
        Name of the filter recommended; None if the noise cannot be told from detail.
    sentences : list of str
        The recommendation first, or why there is none.
    expected : PredictedTable or None
        The errors that it is based on; None for constant data, for labels, and without a recommendation.
    """

    filter: str | None
    sentences: list[str]
    expected: PredictedTable | None = None


def advise(
    volume: Volume | ArrayLike,
    filters: Sequence[str | Filter] = ADVISED,
    boundary: str | Boundary = DEFAULT_BOUNDARY,
    *,
    noise: Noise | float | None = None,
) -> Advice:
    """The narrowest, then smoothest, of the filters with the smallest expected errors; and what the choice gains.

    Parameters
    ----------
    volume : Volume or array-like
        2-D or 3-D samples.
    filters : sequence of str or Filter
        Candidates; the exact sinc is reported, not recommended. "auto" smoothing is settled for the volume.
    boundary : str or Boundary
        For values between samples, which are tested for leaving the samples' range.
    noise : Noise or float, optional
        As for `clvol.analysis.predict`.

    Raises
    ------
    OptionError
        An unknown name, or none but the exact sinc.
    DataError
        NaN or infinite samples.
    """
    volume, rule = as_volume(volume), as_boundary(boundary)
    volume.require_finite()
    named = as_compared(filters)
    rows = settled_once(named, volume)
    if not rows:
        raise OptionError(f"filters must name one beside {EXACT_SINC!r}; got {filters!r}")
    by_name = {row.name: row for row in rows}
    low, high = volume.value_range
    if low == high:
        chosen = _BASE if _BASE in by_name else rows[0].name
        says = f"The data are constant: every filter whose weights sum to one reproduces them, so use {chosen}, which is fast."
        return Advice(chosen, [says])
    known = volume.noise if noise is None else noise
    if isinstance(known, Noise) and known.kind == "labels" and "nearest" in by_name:
        return Advice("nearest", _labels(known))
    if isinstance(known, Noise) and known.doubt:
        return Advice(None, _silent(known.doubt))
    smooth = settled(PICTURE_FILTER, volume).name
    if isinstance(known, Noise) and known.kind == "rounded" and smooth in by_name:
        return Advice(smooth, _rounded(smooth, known))
    sinc = [EXACT_SINC] if EXACT_SINC in named and rule.repeats else []
    expected = predict(volume, [*rows, *sinc], known)
    best = _choice(expected, by_name, high - low)
    if expected.risk(best, _UNSEEN * (high - low)) > _RISK:
        return Advice(None, _silent(_UNCERTAIN.format(_percent(2 * expected.uncertain))))
    if float(np.var(volume.data, dtype=np.float64)) < (1 + _NOTHING) * expected.sigma**2:
        smooth = max(by_name.values(), key=lambda row: -expected.row(row.name).noise).name
        return Advice(smooth, _pure_noise(smooth, expected), expected)
    sentences = [f"For these data use {best}{_in_words(best)}."]
    sentences += _noise(expected, known, best, by_name, high - low)
    sentences += _gains(expected, best, by_name, high - low)
    sentences += _range(volume, by_name, best, rule)
    sentences += _edges(expected, known, best, by_name)
    if sinc:
        sentences += _sinc(expected, best)
    return Advice(best, sentences, expected)


def settled_once(filters: Sequence[str | Filter], volume: Volume) -> list[Filter]:
    """The filters, without the exact sinc, settled for a volume; each once, since "auto" may be 0."""
    return list({row.name: row for row in (settled(f, volume) for f in filters if isinstance(f, Filter))}.values())


def _choice(expected: PredictedTable, rows: dict[str, Filter], span: float) -> str:
    having = [row for row in expected if row.filter in rows]
    near = [row for row in having if row.rms <= _AS_GOOD * max(min(r.rms for r in having), _UNSEEN * span)]
    # a jump has no true gradient
    slopes = [row.gradient_rms for row in near if row.gradient_rms is not None and expected.jumps < _STEPS]
    least = max(min(slopes, default=0.0), _UNSEEN_SLOPE * math.sqrt(expected.steepness))
    steady = [row for row in near if slopes and row.gradient_rms is not None and row.gradient_rms <= _AS_GOOD * least]

    def cost(row: PredictedRow) -> tuple[float, ...]:
        return _taps(rows[row.filter]), -rows[row.filter].continuity, row.rms

    return min(steady or near, key=cost).filter


def _taps(row: Filter) -> int:
    """Taps per sample along each axis: the cost on every machine, without timing noise."""
    return row.support * row.scale


def _labels(noise: Noise) -> list[str]:
    return [
        f"These data are labels: {noise.distinct} values in even regions. Use nearest: between two labels there is no third one.",
        "To draw a region's surface without stairs, draw its indicator, volume.indicator(label), at 1/2 by bspline3(auto).",
    ]


def _rounded(smooth: str, noise: Noise) -> list[str]:
    return [
        f"These data are smooth ones, rounded to {noise.distinct} values, which stand side by side in terraces. Use "
        f"{smooth}{_in_words(smooth)}, which goes between them; a spline through the samples rings at every step."
    ]


def _silent(doubt: str) -> list[str]:
    return [
        f"No filter is recommended: the samples hold noise, and {doubt}.",
        "Errors measured on the samples themselves count this noise as detail. If the noise is known, pass it as noise=.",
    ]


def _pure_noise(smooth: str, expected: PredictedTable) -> list[str]:
    left = _percent(expected.row(smooth).noise / expected.sigma)
    return [
        f"These data are noise: a standard deviation of {expected.sigma:.3g} explains nearly all of their variance.",
        f"If something must be drawn use {smooth}{_in_words(smooth)}, which leaves {left} of it.",
    ]


def _noise(expected: PredictedTable, known: Noise | float, best: str, rows: dict[str, Filter], span: float) -> list[str]:
    if expected.sigma < (_SLIGHT if rows[best].interpolates else _UNSEEN) * span:
        return []
    kind = _KINDS.get(known.kind, "") if isinstance(known, Noise) else ""
    share = _percent(expected.sigma / span)
    gain = f" (by {known.gain:.3g} per unit)" if isinstance(known, Noise) and known.gain else ""
    says = [f"The samples hold noise{kind}{gain}: its standard deviation is {expected.sigma:.3g}, {share} of their range."]
    if expected.detail is None:
        says.append("It explains nearly all of the differences between neighbouring samples.")
    row = expected.row(best)
    through = min((name for name in rows if rows[name].interpolates), key=lambda name: expected.row(name).rms, default=None)
    if not rows[best].interpolates and through is not None and expected.surely_less(best, through, 1 - _LITTLE):
        other = expected.row(through)
        says.append(
            f"It pays not to pass through them: {best} is expected to err by {row.rms:.3g}, {row.noise:.3g} of it noise, and "
            f"{through}, the best that does, by {other.rms:.3g}, {other.noise:.3g} of it noise."
        )
    elif rows[best].interpolates and row.noise < row.bias:
        says.append("It is less than what is lost between the samples, so there is no need to smooth.")
    return says


def _gains(expected: PredictedTable, best: str, rows: dict[str, Filter], span: float) -> list[str]:
    if not expected.enough:
        return ["The samples are too few to tell how sure that is."]
    says = []
    row = expected.row(best)
    if _BASE in rows and best != _BASE:
        base = expected.row(_BASE)
        if base.rms <= _UNSEEN * span:
            says.append(f"The choice matters little: even {_BASE} interpolation errs by less than a ten-thousandth of their range.")
        elif expected.surely_less(best, _BASE, 1 - _LITTLE):
            says.append(
                f"Its expected error is {_gain(row.rms / base.rms)} smaller than that of {_BASE} interpolation "
                f"(RMS {_error(row.rms, span)} against {base.rms:.3g})."
            )
        elif expected.surely_less(best, _BASE):
            says.append(f"It errs less than {_BASE} interpolation, but by little.")
        else:
            says.append(f"For the values alone it matters little: {_BASE} interpolation may err as little.")
        seen = (base.gradient_rms or 0.0) > _UNSEEN_SLOPE * math.sqrt(expected.steepness)
        gradients = row.gradient_rms is not None and seen and expected.jumps < _STEPS
        if gradients and expected.surely_less(best, _BASE, key="gradient_rms"):
            gain = _gain((row.gradient_rms or 0.0) / (base.gradient_rms or 1.0))
            says.append(f"The error of its gradients, which shade surfaces, is {gain} smaller than with {_BASE} interpolation.")
    others = [r for r in expected if r.filter in rows and r.filter != best]
    least = min(others, key=lambda r: r.rms, default=None)
    if least is not None and min(row.rms, least.rms) > _UNSEEN * span and expected.surely_less(least.filter, best):
        more = f", with {_taps(rows[least.filter])} taps a sample along each axis instead of {_taps(rows[best])}"
        says.append(
            f"{least.filter} errs still less, by {_gain(least.rms / row.rms)}"
            f"{more if _taps(rows[least.filter]) > _taps(rows[best]) else ''}."
        )
    return says


def _range(volume: Volume, rows: dict[str, Filter], best: str, rule: Boundary) -> list[str]:
    low, high = volume.value_range
    leaving = overshoot(volume, rows[best], rule) / (high - low)
    if keeps_range(rows[best]):
        return ["It cannot leave the range of the samples."]
    if leaving < _ROUNDING:
        return ["On these samples it stays within their range."]
    within = [name for name, row in rows.items() if keeps_range(row)]
    instead = f"; if that must not happen, {_listed(within)} cannot" if within else ""
    return [f"It leaves the range of the samples by up to {_percent(leaving)} of it{instead}."]


def _edges(expected: PredictedTable, known: Noise | float, best: str, rows: dict[str, Filter]) -> list[str]:
    says = []
    if expected.jumps >= _STEPS:
        says.append(
            "Most edges go from one sample to the next, with level ones on either side, and no filter can tell where between the "
            "two they lie: the smoother ones blur or ring there."
        )
    elif expected.detail is not None:
        kind = next(words for least, words in _DETAIL if expected.detail >= least)
        high = _percent(expected.detail) if expected.detail >= 0.001 else "Less than 0.1 %"
        says.append(f"{high} of the squared differences between neighbouring samples lie above half of Nyquist: {kind}.")
    if isinstance(known, Noise) and known.kind == "binary":
        says.append("The samples have two values. For surfaces without stairs draw them at the mean of the two by bspline3(auto).")
    elif isinstance(known, Noise) and known.masked and rows[best].interpolates:
        says.append(
            f"They have been masked: the value {known.background:.6g} cuts through objects. For surfaces without stairs there use "
            "bspline3(auto)."
        )
    return says


def _sinc(expected: PredictedTable, best: str) -> list[str]:
    row, sinc = expected.row(best), expected.row(EXACT_SINC)
    if sinc.rms > 0 and row.rms > 0 and expected.surely_less(best, EXACT_SINC):
        return [f"The exact sinc, ideal without noise and jumps, is expected to err {_percent(sinc.rms / row.rms - 1)} more."]
    return []


def _in_words(name: str) -> str:
    return "" if title(name) == name else f" ({title(name)})"


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _gain(ratio: float) -> str:
    """How much smaller an error is, in words; never by 100 %."""
    return "more than 99 %" if ratio < 0.01 else _percent(1 - ratio)


def _error(rms: float, span: float) -> str:
    return f"{rms:.3g}" if rms > _UNSEEN * span else f"less than {_UNSEEN * span:.1g}"


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if share >= 0.0995 or share == 0 else f"{100 * share:.2g} %"
