"""One page that says which filter to use for a volume: pictures, errors, frequencies, and a recommendation in words.

>>> from clvol import reports
>>> reports.report(clvol.read("scan.nii.gz"), "report/")
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clvol import analysis
from clvol.analysis import EXACT_SINC, ErrorTable
from clvol.analysis.comparison import as_compared
from clvol.boundary import DEFAULT_BOUNDARY, Boundary, as_boundary
from clvol.checks import as_path, whole
from clvol.device import Device, as_device
from clvol.errors import FormatError, OptionError
from clvol.figures import cost
from clvol.figures.style import require_matplotlib
from clvol.files import require_folder, staged
from clvol.filter import Filter
from clvol.reports import html, spectrum
from clvol.reports.advice import Advice, advise
from clvol.reports.pictures import Cards, cards
from clvol.volume import Volume, as_volume

__all__ = ["REPORTED", "Advice", "Report", "advise", "page", "report"]

REPORTED = ("nearest", "linear", "bspline3-approx", "mitchell", "catmull-rom", "bspline3", "omoms3", "bspline5", "hybrid")
"""The default filters of a report; the exact sinc is added."""

_POINTS = 20_000  # compared gradients
_SHARE = 0.6  # of the time that measuring takes
_FACTOR = 2


@dataclass(frozen=True)
class Report:
    """A written report.

    Attributes
    ----------
    path : Path
        The HTML file.
    table : ErrorTable
        The measured errors.
    advice : Advice
        The recommendation.
    """

    path: Path
    table: ErrorTable
    advice: Advice


def page(output: str | os.PathLike[str]) -> Path:
    """The file that a report is written to: `output` if it ends in .html, else index.html in the folder of that name.

    Raises
    ------
    FormatError
        It cannot be written there.
    """
    path = as_path(output)
    file = path if path.suffix.lower() in (".html", ".htm") else path / "index.html"
    if file != path and path.exists() and not path.is_dir():
        raise FormatError(f"a report is written to a folder, or to a file that ends in .html; got {str(path)!r}")
    require_folder(file if path.is_dir() else path)
    return file


def report(
    volume: Volume,
    output: str | os.PathLike[str],
    name: str = "volume",
    filters: Sequence[str | Filter] = REPORTED,
    pixels: int = 280,
    boundary: str | Boundary = DEFAULT_BOUNDARY,
    *,
    max_samples: int = 1 << 22,
    device: Device | str | int | None = None,
    progress: Callable[[float], Any] | None = None,
    **options: Any,
) -> Report:
    """Measure, draw and recommend; the page embeds its pictures and is written when it is complete.

    Parameters
    ----------
    volume : Volume or array-like, 3-D
        What is measured and drawn.
    output : str or Path
        A folder, which then holds index.html, or a file that ends in .html.
    name : str
        Name of the data.
    filters : sequence of str or Filter
        What is compared and drawn; filters of your own need not be registered. The exact sinc is always compared if the
        boundary rule has a period.
    pixels : int
        Width and height of each picture.
    max_samples : int
        How many samples are measured: of a larger volume the middle. All of it is drawn.
    boundary, device, progress
        As for `clvol.render`.
    **options
        Those of `Renderer.render`, for the pictures.

    Raises
    ------
    DataError
        NaN or infinite samples.
    OptionError
        The volume does not have 3 axes, an argument is invalid, or no filter to draw is named.
    FormatError
        The report cannot be written there.
    DeviceError
        No usable device, or it failed.
    OutOfMemoryError
        The volume or what is computed from it does not fit.
    MissingDependencyError
        matplotlib is not installed.
    """
    require_matplotlib()
    volume, file = as_volume(volume), page(output)
    if volume.ndim != 3:
        raise OptionError(f"a report takes a volume with 3 axes; got shape {volume.shape}")
    volume.require_finite()
    pixels, rule, on = whole("pixels", pixels, 16), as_boundary(boundary), as_device(device)
    max_samples = whole("max_samples", max_samples, 1)
    named = as_compared(filters)
    chosen = [row for row in named if isinstance(row, Filter)]
    if not chosen:
        raise OptionError(f"filters must name one to be drawn beside {EXACT_SINC!r}; got {filters!r}")
    measured: list[str | Filter] = [*chosen]
    if rule.period is not None or EXACT_SINC in named:
        measured.append(EXACT_SINC)
    advance = progress or (lambda _: None)
    middle = _middle(volume, max_samples)
    table = analysis.compare(
        middle,
        measured,
        boundary=rule,
        factor=_FACTOR,
        points=_POINTS,
        timing_device=on,
        progress=lambda done: advance(_SHARE * done),
    )
    found = spectrum.spectra(middle)
    advice = advise(table, spectrum.high_share(found))
    low, high = volume.value_range
    drawn = None
    if low < high:
        drawn = cards(
            volume,
            chosen,
            table.filter(advice.filter),
            pixels,
            rule,
            _FACTOR,
            on,
            lambda done: advance(_SHARE + (0.97 - _SHARE) * done),
            options,
        )
    text = _page(name, volume, middle, table, advice, found, drawn)
    try:
        file.parent.mkdir(exist_ok=True)
    except OSError as error:
        raise FormatError(f"cannot write {file}: {error}") from error
    with staged(file, file.suffix) as temporary:
        temporary.write_text(text, encoding="utf-8")
    advance(1.0)
    return Report(file, table, advice)


def _middle(volume: Volume, max_samples: int) -> Volume:
    """The part about the middle that has at most `max_samples`, every axis cut in the same proportion."""
    if volume.data.size <= max_samples:
        return volume
    share = (max_samples / volume.data.size) ** (1 / 3)
    sizes = [max(1, int(n * share)) for n in volume.size]
    low = [(n - m) // 2 for n, m in zip(volume.size, sizes, strict=True)]
    return volume.crop(low, [a + m for a, m in zip(low, sizes, strict=True)])


def _page(
    name: str, volume: Volume, middle: Volume, table: ErrorTable, advice: Advice, found: spectrum.Spectra, drawn: Cards | None
) -> str:
    """The page; `drawn` is None where the data are constant."""
    rows = [row for row in table if row.filter != EXACT_SINC]
    low, high = volume.value_range
    facts = [
        ("samples", " × ".join(map(str, volume.size)) + f", {volume.data.dtype}"),
        ("spacing", " × ".join(f"{s:.4g}" for s in volume.spacing) + f" {volume.units or ''}".rstrip()),
        ("range", f"{low:.6g} to {high:.6g}"),
        ("measured", f"{' × '.join(map(str, middle.size))} samples" + ("" if middle is volume else ", the middle of the volume")),
        ("against", table.against),
        ("boundary", table.boundary),
        ("computed by", f"{table.evaluated_on}; times and pictures on {table.timed_on or 'no device'}"),
    ]
    plots = [("Frequencies", html.inline(spectrum.plot(found, table.filters)))]
    timed = [row for row in rows if row.seconds and row.rms > 0 and table.value_range[0] < table.value_range[1]]
    if timed:
        numbers = [
            {"filter": r.filter, "nanoseconds": 1000 * (r.seconds or 0), "rms": r.rms, "angle_mean": r.angle_mean or None}
            for r in timed
        ]
        drawing = cost.plot(numbers, "RMS error of the values", "left is faster, lower is better; line: nothing is both")
        plots.append(("Error and time", html.inline(drawing)))
    return html.page(name, facts, advice, table, drawn, plots)
