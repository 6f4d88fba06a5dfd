"""A page that recommends a filter for a volume: pictures, errors, frequencies, and a recommendation in words.

>>> from clvol import reports
>>> reports.report(clvol.read("scan.nii.gz"), "report/")
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Unpack

from clvol import analysis
from clvol.analysis import EXACT_SINC, ErrorTable, LeftOutTable, RotationTable
from clvol.analysis.comparison import as_compared
from clvol.analysis.trial import middle_part
from clvol.base.checks import as_path, if_image, whole
from clvol.base.errors import DataError, FormatError, OptionError
from clvol.base.files import require_folder, staged
from clvol.base.progress import Progress, part_of
from clvol.device import Device, as_device
from clvol.figures import cost
from clvol.figures.style import require_matplotlib
from clvol.filter.boundary import DEFAULT_BOUNDARY, Boundary, as_boundary
from clvol.filter.filter import Filter
from clvol.march.options import PanelOptions
from clvol.noise import Noise
from clvol.reports import html, spectrum
from clvol.reports.advice import ADVISED, Advice, advise, settled_once
from clvol.reports.pictures import Cards, cards
from clvol.volume.histogram import isovalue_of
from clvol.volume.volume import Volume, as_volume

__all__ = ["REPORTED", "Advice", "Report", "advise", "page", "report"]

REPORTED = ADVISED
"""The default filters of a report; the exact sinc is added."""

_COMPARED = 1 << 20  # samples over all shifts of the decimated grid, and omitted samples
_POINTS = 20_000  # compared gradients
_ADVISED, _COMPARING, _SHARE = 0.1, 0.4, 0.5  # progress after each step
_FACTOR = 2


@dataclass(frozen=True)
class Report:
    """A written report.

    Attributes
    ----------
    path : Path
        The HTML file.
    table : ErrorTable
        The errors measured from every second sample.
    advice : Advice
        The recommendation, with the expected errors that it is based on.
    left_out : LeftOutTable
        The errors at samples omitted along each axis.
    turned : RotationTable or None
        The error of a slice after nine turns; None if the slice is too small.
    """

    path: Path
    table: ErrorTable
    advice: Advice
    left_out: LeftOutTable
    turned: RotationTable | None


def page(output: str | os.PathLike[str]) -> Path:
    """The file that a report is written to: `output` if it ends in .html, else index.html in the folder of that name.

    Raises
    ------
    FormatError
        The file cannot be written.
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
    progress: Progress | None = None,
    **options: Unpack[PanelOptions],
) -> Report:
    """Measure, draw and recommend; the page embeds its pictures and is written once it is complete.

    Parameters
    ----------
    volume : Volume or array-like, 3-D
        The measured and rendered data.
    output : str or Path
        A folder, for index.html, or a file that ends in .html.
    name : str
        Name of the data.
    filters : sequence of str or Filter
        Filters to compare and draw; custom filters need not be registered. "auto" smoothing is settled for the volume. The exact
        sinc is always compared if the boundary rule has a period.
    pixels : int
        Width and height of each picture.
    max_samples : int
        How many samples are measured: of a larger volume the middle. All of it is drawn.
    boundary, device, progress
        As for `clvol.render`.
    **options
        Those of `Renderer.render`, for the pictures; the background is white by default.

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
        The volume or the results do not fit into memory.
    MissingDependencyError
        matplotlib is not installed.
    """
    require_matplotlib()
    volume, file = as_volume(volume), page(output)
    if volume.ndim != 3:
        raise OptionError(f"a report takes a volume with 3 axes; got shape {volume.shape}{if_image(volume.shape)}")
    volume.require_finite()
    pixels, rule, on = whole("pixels", pixels, 16), as_boundary(boundary), as_device(device)
    max_samples = whole("max_samples", max_samples, 1)
    named = as_compared(filters)
    chosen = settled_once(named, volume)
    if not chosen:
        raise OptionError(f"filters must name one to be drawn beside {EXACT_SINC!r}; got {filters!r}")
    sinc = [EXACT_SINC] if rule.repeats or EXACT_SINC in named else []
    advance = progress or (lambda _: None)
    middle = middle_part(volume, max_samples)
    noise = volume.noise
    advice = advise(middle, [*chosen, *sinc], rule, noise=noise)
    advance(_ADVISED)
    table = analysis.compare(
        middle,
        [*chosen, *sinc],
        boundary=rule,
        factor=_FACTOR,
        sigma=noise.sigma,
        points=_POINTS,
        timing_device=on,
        max_samples=_COMPARED,
        progress=part_of(progress, _ADVISED, _COMPARING),
    )
    left_out = analysis.leave_out(middle_part(middle, _COMPARED // 2), chosen, rule)
    try:
        turned = analysis.rotations(middle, chosen, boundary=rule)
    except DataError:  # too small
        turned = None
    advance(_SHARE)
    low, high = volume.value_range
    drawn = None
    if low < high:
        best = next((row for row in chosen if row.name == advice.filter), chosen[-1])  # differences need a reference
        drawn = cards(volume, chosen, best, pixels, rule, _FACTOR, on, part_of(progress, _SHARE, 0.97), {**options})
    made = Report(file, table, advice, left_out, turned)
    text = _page(name, volume, middle, made, spectrum.spectra(middle), drawn)
    try:
        file.parent.mkdir(exist_ok=True)
    except OSError as error:
        raise FormatError(f"cannot write {file}: {error}") from error
    with staged(file, file.suffix) as temporary:
        temporary.write_text(text, encoding="utf-8")
    advance(1.0)
    return made


def _in_words(noise: Noise) -> str:
    """The kind of noise, its standard deviation and gain, and why nothing is predicted from it."""
    if noise.sigma == 0:
        return "none found"
    kinds = {
        "magnitude": "of magnitudes (Rician), standard deviation of the complex values' parts",
        "clipped": "clipped, standard deviation before",
        "uneven": "uneven from place to place, root mean square",
        "signal-dependent": "signal-dependent, root mean square",
    }
    says = f"{kinds.get(noise.kind, f'{noise.kind}, standard deviation')} {noise.sigma:.3g}"
    says += f", variance grows by {noise.gain:.3g} per unit of the value" if noise.gain else ""
    return says + (f"; no error is predicted: {noise.doubt}" if noise.doubt else "")


def _page(name: str, volume: Volume, middle: Volume, made: Report, found: spectrum.Spectra, drawn: Cards | None) -> str:
    """The page; `drawn` is None for constant data."""
    table, expected, noise = made.table, made.advice.expected, volume.noise
    low, high = volume.value_range
    isovalue, reason = isovalue_of(volume)
    facts = [
        ("samples", " × ".join(map(str, volume.size)) + f", {volume.data.dtype}"),
        ("spacing", " × ".join(f"{s:.4g}" for s in volume.spacing) + f" {volume.units or ''}".rstrip()),
        ("range", f"{low:.6g} to {high:.6g}"),
        ("noise", _in_words(noise)),
        ("isovalue by default", f"{isovalue:.6g}, {reason}"),
        ("measured", f"{' × '.join(map(str, middle.size))} samples" + ("" if middle is volume else ", the middle of the volume")),
        ("every second sample", f"against {table.against}"),
        ("boundary", table.boundary),
        ("computed by", f"{table.evaluated_on}; times and pictures on {table.timed_on or 'no device'}"),
    ]
    plots = [("Frequencies", html.inline(spectrum.plot(found, table.filters)))]
    errors = {row.filter: row.rms for row in (table if expected is None else expected)}
    timed = [row for row in table if row.seconds and errors.get(row.filter)]
    if timed and low < high:
        numbers = [
            {
                "filter": r.filter,
                "nanoseconds": 1000 * (r.seconds or 0),
                "rms": errors[r.filter],
                "angle_mean": r.angle_mean or None,
            }
            for r in timed
        ]
        which = "RMS error of the values" if expected is None else "expected RMS error of the values"
        drawing = cost.plot(numbers, which, "left is faster, lower is better; line: nothing is both")
        plots.append(("Error and time", html.inline(drawing)))
    return html.page(name, facts, made.advice, table, made.left_out, made.turned, drawn, plots)
