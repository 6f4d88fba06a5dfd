"""The ``clvol`` command: pictures, comparisons, resampling, and what is installed.

Exit codes: 0 done, 1 the request failed (the reason is on standard error), 2 the command line is wrong,
130 interrupted.
"""

from __future__ import annotations

import io
import json
import math
import os
import re
import shutil
import sys
import textwrap
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, make_dataclass, replace
from importlib.metadata import version
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NoReturn

from cyclopts import App, CoercionError, CycloptsError, Parameter, Token

import clvol
from clvol.errors import ClvolError, DataError, OptionError
from clvol.files import require_folder, require_suffix
from clvol.filter import Filter
from clvol.formats import WRITTEN
from clvol.march.uncertainty import COVERAGE, in_words
from clvol.mode import as_mode, every_option, mode_options
from clvol.picture import heat, heat_with_scale
from clvol.smoothing import choose

app = App(
    name="clvol",
    help="Volume rendering and reconstruction with B-splines, on OpenCL.",
    version=lambda: version("clvol"),
    default_parameter=Parameter(negative_iterable=()),
    suppress_keyboard_interrupt=False,
)


def _whole(_: object, tokens: Sequence[Token]) -> int | tuple[int, ...]:
    """Whole numbers as they are written: the parser's own rule would round 1.5 to 2."""
    numbers = []
    for token in tokens:
        try:
            numbers.append(int(token.value))
        except ValueError:
            raise CoercionError(token=token, target_type=int) from None
    return numbers[0] if len(numbers) == 1 else tuple(numbers)


_COMPARED = 20_000  # gradients that a table of errors compares
Projection = Literal["perspective", "orthographic"]
_MODES = f"{', '.join(clvol.modes())}."
_BOUNDARIES = f"What lies past the outer samples: {', '.join(clvol.boundaries())}; with a value, constant(5) or grid-constant(5)."


@Parameter(name="*")
@dataclass
class Input:
    """How INPUT is read."""

    shape: Annotated[tuple[int, int, int] | None, Parameter(help="Samples along z, y, x of a raw file.", converter=_whole)] = None
    dtype: Annotated[str | None, Parameter(help="Sample type of a raw file, such as uint16 or '>f4'.")] = None
    spacing: Annotated[tuple[float, float, float] | None, Parameter(help="Spacing along x, y, z, instead of the file's.")] = None
    fill_nan: Annotated[
        float | Literal["smoothly"] | None, Parameter(help="Value that replaces NaN and infinite samples, or 'smoothly'.")
    ] = None

    def read(self, source: str) -> clvol.Volume:
        if source.startswith("phantom:"):
            if self.shape is not None or self.dtype is not None:
                raise OptionError("--shape and --dtype are for raw files; give a phantom's size as phantom:NAME:SIZE")
            volume = clvol.phantoms.by_name(source.removeprefix("phantom:"))
            return volume if self.spacing is None else replace(volume, spacing=self.spacing)
        options = {"shape": self.shape, "dtype": self.dtype, "spacing": self.spacing}
        volume = clvol.read(source, **{k: v for k, v in options.items() if v is not None})  # type: ignore[arg-type]  # by name
        if self.fill_nan is None:
            return volume
        return volume.filled(None if self.fill_nan == "smoothly" else self.fill_nan)


@Parameter(name="*")
@dataclass
class Look:
    """How a picture is made."""

    mode: Annotated[str, Parameter(help=_MODES)] = "composite"
    boundary: Annotated[str, Parameter(help=_BOUNDARIES)] = "mirror"
    step: Annotated[float, Parameter(help="The most that a ray advances between samples, in voxels; exact surfaces take none.")] = (
        0.5
    )
    samples: Annotated[int, Parameter(help="Rays a pixel.", converter=_whole)] = 1
    pixel_filter: Annotated[str, Parameter(help="What several rays a pixel sample: a filter without a prefilter.")] = "linear"
    cmap: Annotated[str | None, Parameter(help="Colour map by name, instead of the automatic colours.")] = None
    value_range: Annotated[tuple[float, float] | None, Parameter(help="Values that the colour map spans.")] = None
    opacity: Annotated[
        tuple[float, ...] | None, Parameter(help="Points of the opacity: value opacity value opacity ...", consume_multiple=True)
    ] = None
    background: Annotated[str, Parameter(help="A name, a hex code, or 'none'.")] = "black"
    gradient: Annotated[Literal["analytic", "central"], Parameter(help="What lighting uses.")] = "analytic"
    azimuth: Annotated[float, Parameter(help="Degrees about the z axis.")] = 30.0
    elevation: Annotated[float, Parameter(help="Degrees above the xy plane.")] = 20.0
    zoom: Annotated[float, Parameter(help="1 shows the whole volume.")] = 1.0
    projection: Annotated[Projection, Parameter(help="How rays leave the eye.")] = "perspective"
    evaluator: Annotated[Literal["auto", "taps", "paired", "eight-fetch"], Parameter(help="How the spline is evaluated.")] = "auto"
    fetch: Annotated[Literal["auto", "buffer", "image"], Parameter(help="Where coefficients are read from.")] = "auto"

    def options(self, volume: clvol.Volume) -> dict[str, Any]:
        return {
            "camera": clvol.Camera.orbit(self.azimuth, self.elevation, zoom=self.zoom, projection=self.projection),
            "mode": self.mode,
            "step": self.step,
            "samples": self.samples,
            "pixel_filter": self.pixel_filter,
            "transfer": self._transfer(volume),
            "gradient": self.gradient,
            "background": None if self.background == "none" else self.background,
            "evaluator": self.evaluator,
            "fetch": self.fetch,
        }

    def _transfer(self, volume: clvol.Volume) -> clvol.TransferFunction | None:
        if self.cmap is None and self.value_range is None and self.opacity is None:
            return None
        if self.opacity is not None and len(self.opacity) % 2:
            raise OptionError(f"--opacity takes pairs of a value and an opacity; got {len(self.opacity)} numbers")
        numbers = self.opacity or ()
        points = tuple(zip(numbers[0::2], numbers[1::2], strict=True))
        if not points:
            points = as_mode(self.mode).transfer(volume).opacities
        return clvol.TransferFunction.from_cmap(self.cmap or "gray", self.value_range or volume.value_range, points or 1.0)


@Parameter(name="*")
@dataclass
class SurfaceLook(Look):
    """How pictures are made where surfaces are the rule."""

    mode: Annotated[str, Parameter(help=_MODES)] = "isosurface"


@Parameter(name="*")
@dataclass
class ReportLook(SurfaceLook):
    """How the pictures of a report are made: on white, filled by what shows."""

    background: Annotated[str, Parameter(help="A name, a hex code, or 'none'.")] = "white"
    zoom: Annotated[float | None, Parameter(help="1 shows the whole volume; by default what shows fills the picture.")] = None  # type: ignore[assignment]  # not given

    def options(self, volume: clvol.Volume) -> dict[str, Any]:
        given = replace(self, zoom=1.0) if self.zoom is None else self
        return super(ReportLook, given).options(volume) | {"fill": self.zoom is None}


def _flag(name: str) -> tuple[str, Any, None]:
    """A flag for an option of modes, with what their classes say of it; not given, it is the mode's own default."""
    having = [mode for mode in clvol.modes().values() if name in mode_options(mode)]
    defaults = [getattr(mode, name) for mode in having]
    kind: Any = bool if isinstance(defaults[0], bool) else str if isinstance(defaults[0], (str, tuple)) else float
    says = [f"{mode_options(mode)[name]} ({mode.name}{_default(getattr(mode, name))})" for mode in having]
    return name, Annotated[kind | None, Parameter(help=" ".join(says))], None


def _default(value: object) -> str:
    """A mode's default for people; nothing where it follows from the volume."""
    if value is None:
        return ""
    return f"; default {' '.join(f'{v:g}' for v in value) if isinstance(value, tuple) else value}"


class Given:
    """Options of a mode, as they were given."""

    def options(self) -> dict[str, Any]:
        """What was given; a colour may be three numbers in one argument."""
        given = {name: value for name, value in vars(self).items() if value is not None}
        if isinstance(given.get("color"), str) and re.fullmatch(r"\s*([\d.e+-]+[\s,]+){2}[\d.e+-]+\s*", given["color"]):
            given["color"] = tuple(float(v) for v in re.split(r"[\s,]+", given["color"].strip()))
        return given


if TYPE_CHECKING:
    ModeOptions = Given
else:
    ModeOptions = Parameter(name="*")(
        make_dataclass("ModeOptions", map(_flag, sorted(every_option())), bases=(Given,), namespace={"__module__": __name__})
    )


def _mode_options(look: Look, own: ModeOptions | None) -> dict[str, Any]:
    """The options given for the mode, refused here, before the volume is read, if they are none of it."""
    options = {} if own is None else own.options()
    as_mode(look.mode, options)
    return options


Source = Annotated[str, Parameter(help="A volume file, a DICOM folder, or phantom:NAME[:SIZE].")]
Json = Annotated[bool, Parameter(name="--json", negative="", help="Print what a program would read.")]
Output = Annotated[Path, Parameter(name=["--output", "-o"], help="The file to write.")]
Whole = Annotated[int, Parameter(converter=_whole)]
Size = Annotated[tuple[int, int], Parameter(help="Width and height in pixels.", converter=_whole)]
DeviceName = Annotated[str | None, Parameter(help="Number, 'cpu', 'gpu' or part of a name; see 'clvol devices'.")]
Filters = Annotated[
    tuple[str, ...], Parameter(help="One picture each. [default: the six of Figure 6]", show_default=False, consume_multiple=True)
]

PageOutput = Annotated[Path, Parameter(name=["--output", "-o"], help="A folder, or a file that ends in .html.")]
Compared = Annotated[
    tuple[str, ...], Parameter(help="What is compared; see 'clvol filters'.", show_default=False, consume_multiple=True)
]


@app.command
def render(
    source: Source,
    /,
    *,
    output: Output,
    filter: Annotated[str | None, Parameter(show_default=False)] = None,
    size: Size = (512, 512),
    device: DeviceName = None,
    input: Input | None = None,
    look: Look | None = None,
    own: ModeOptions | None = None,
    heat_map: Path | None = None,
    uncertainty: Path | None = None,
    verbose: Annotated[bool, Parameter(negative="")] = False,
    json: Json = False,
) -> None:
    """Make a picture of a volume.

    Parameters
    ----------
    filter
        How it is reconstructed between its samples; see 'clvol filters'. [default: bspline3(auto), which smooths the noise that it
        finds; bspline3 in modes that show extremes, such as mip]
    heat_map
        A second picture: the share of each ray's samples that was looked at, from black to pale yellow.
    uncertainty
        Another picture, of an isosurface: within what of it the true surface lies in 95 % of places, with its scale.
    verbose
        Report the share of the samples that was looked at, and how long the parts took, kernels that are built first
        included.
    """
    import numpy as np

    _require_picture(output)
    for other in (heat_map, uncertainty):
        if other is not None:
            _require_picture(other)
    look = look or Look()
    options = _mode_options(look, own)
    volume = (input or Input()).read(source)
    result: dict[str, Any] = {"output": str(output), "size": list(size), "filter": "", "mode": look.mode}
    with _progress("rendering", json) as progress:
        options |= look.options(volume)
        begun = time.perf_counter()
        wanted = as_mode(look.mode).picture_filter if filter is None else filter
        with clvol.Renderer(volume, wanted, look.boundary, device) as renderer:
            ready = time.perf_counter()
            outputs: list[clvol.Output] = ["rgba"]
            outputs += ["visited"] if verbose or heat_map is not None else []
            outputs += ["uncertainty"] if uncertainty is not None else []
            pictures = renderer.render(size=size, progress=progress, outputs=outputs, **options)
            done = time.perf_counter()
            drawn = renderer.filter
    result["filter"] = drawn.name if json else _filter_text(drawn, filter, volume)
    clvol.save(pictures["rgba"], output)
    if heat_map is not None:
        result["heat_map"] = str(clvol.save(heat(pictures["visited"]), heat_map))
    if uncertainty is not None:
        within = pictures["uncertainty"]
        title = f"the true surface lies within ± ({100 * COVERAGE:.0f} %)"
        result["uncertainty"] = str(clvol.save(heat_with_scale(within[..., 0], volume.units, title), uncertainty))
        result["surface"] = in_words(within, volume.units)
    if verbose:
        met = np.isfinite(pictures["visited"])
        result |= {
            "samples_visited": round(float(pictures["visited"][met].mean()), 4) if met.any() else 0.0,
            "seconds_to_hold": round(ready - begun, 4),
            "seconds_to_draw": round(done - ready, 4),
        }
    _say(json, result)


@app.command
def compare(
    source: Source,
    /,
    *,
    output: Annotated[Path | None, Parameter(name=["--output", "-o"], help="The picture to write.")] = None,
    table: Annotated[Path | None, Parameter(help="Errors from every second sample to write: .csv, .json or .md.")] = None,
    expected: Annotated[Path | None, Parameter(help="Errors to expect of the samples as they are, likewise.")] = None,
    left_out: Annotated[Path | None, Parameter(help="Errors of slices left out along each axis, likewise.")] = None,
    turned: Annotated[Path | None, Parameter(help="What is left of the middle slice after nine turns of 40°, likewise.")] = None,
    filters: Filters = (),
    pixels: Whole = 384,
    device: DeviceName = None,
    input: Input | None = None,
    look: SurfaceLook | None = None,
    own: ModeOptions | None = None,
    json: Json = False,
) -> None:
    """Draw a volume by several filters side by side, measure their errors in up to four ways, or both.

    Parameters
    ----------
    pixels
        Width and height of each picture.
    """
    from clvol import analysis, figures
    from clvol.analysis.table import SUFFIXES

    tables = {"table": table, "expected": expected, "left_out": left_out, "turned": turned}
    wanted = {kind: path for kind, path in tables.items() if path is not None}
    if output is None and not wanted:
        flags = ", ".join(f"--{kind.replace('_', '-')}" for kind in tables)
        raise OptionError(f"give --output, a picture, or a table of errors ({flags}), or several; got none")
    if output is not None:
        _require_picture(output)
    for path in wanted.values():
        _require_writable(path, SUFFIXES, "tables")
    look = look or SurfaceLook()
    options = _mode_options(look, own)
    volume = (input or Input()).read(source)
    names = filters or figures.SIX
    result: dict[str, Any] = {}
    if output is not None:
        with _progress("drawing", json) as progress:
            _, sheet = figures.compare(
                volume, names, pixels, look.boundary, device=device, progress=progress, **look.options(volume), **options
            )
        result["output"] = str(clvol.save(sheet, output))
    result |= {"filters": list(names)} | ({"mode": look.mode} if output is not None else {})
    for kind, path in wanted.items():
        with _progress("measuring", json) as progress:
            errors: analysis.Table[Any]
            if kind == "table":
                errors = analysis.compare(
                    volume, names, boundary=look.boundary, points=_COMPARED, timing_device=device, progress=progress
                )
                result["against"] = errors.against
            elif kind == "expected":
                errors = analysis.predict(volume, names)
                result["noise"] = errors.sigma
            elif kind == "left_out":
                errors = analysis.leave_out(volume, names, look.boundary, progress=progress)
            else:
                errors = analysis.rotations(volume, names, boundary=look.boundary, progress=progress)
        result[kind] = str(errors.write(path))
        if json:
            result["errors" if kind == "table" else f"{kind}_errors"] = errors.records()
        else:
            header, *rows = errors.texts()
            _table(header, rows)
    _say(json, result)


@app.command
def figure(
    name: Annotated[
        str, Parameter(help="1 to 6 as in the paper, impulse, gradients, convergence, noise, slices, edges, reduction or cost.")
    ],
    /,
    *,
    output: Annotated[
        Path | None, Parameter(name=["--output", "-o"], help="The file to write: .png, .svg, .pdf, ... [default: figureNAME.png]")
    ] = None,
    samples: Whole | None = None,
    pixels: Whole | None = None,
    filters: Compared = (),
    scan: Annotated[str | None, Parameter(help="A volume to measure (4, slices) or draw (3) too.")] = None,
    device: DeviceName = None,
    json: Json = False,
) -> None:
    """Make a figure of the paper, or one beyond: impulse, gradients, convergence, noise, slices, edges, reduction, cost.

    Each has defaults.

    Parameters
    ----------
    samples
        Of the function along each axis.
    pixels
        Width of each picture.
    """
    from clvol import figures
    from clvol.figures import style

    output = Path(f"figure{name}.png") if output is None else output
    options: dict[str, Any] = {"samples": samples, "pixels": pixels, "filters": filters or None, "scan": scan, "device": device}
    options = {key: value for key, value in options.items() if value is not None}
    known = figures.options_of(name)
    if not set(options) <= set(known):
        flags = [f"--{key}" for key in known if key in ("samples", "pixels", "filters", "scan", "device")]
        wrong = next(key for key in options if key not in known)
        raise OptionError(f"figure {name} takes {', '.join(flags) or 'no option'}; got --{wrong}")
    if figures.FIGURES[name].plotted:
        style.require_matplotlib()
        _require_writable(output, style.SUFFIXES, "figures")
    else:
        _require_picture(output)
    if scan is not None:
        options["scan"] = Input().read(scan)
    with _progress(f"figure {name}", json) as progress:
        drawing = figures.draw(name, **options, **({"progress": progress} if "progress" in known else {}))
    _say(json, {"output": str(drawing.save(output)), "panels": drawing.numbers}, drawing.lines)


@app.command
def report(
    source: Source,
    /,
    *,
    output: PageOutput,
    filters: Compared = (),
    pixels: Whole = 280,
    device: DeviceName = None,
    input: Input | None = None,
    look: ReportLook | None = None,
    own: ModeOptions | None = None,
    json: Json = False,
) -> None:
    """Show by pictures, errors and words which filter to use for a volume: one HTML page that needs nothing else.

    Parameters
    ----------
    pixels
        Width and height of each picture.
    """
    from clvol import reports

    reports.page(output)  # raises before minutes of work if it cannot be written
    look = look or ReportLook()
    options = _mode_options(look, own)
    volume = (input or Input()).read(source)
    with _progress("measuring and drawing", json) as progress:
        done = reports.report(
            volume,
            output,
            Path(source).name,
            filters or reports.REPORTED,
            pixels,
            look.boundary,
            device=device,
            progress=progress,
            **look.options(volume),
            **options,
        )
    result: dict[str, Any] = {"output": str(done.path), "filter": done.advice.filter, "advice": " ".join(done.advice.sentences)}
    if json:
        result |= {"against": done.table.against, "lost": done.table.lost, "errors": done.table.records()}
        result |= {"expected": None if done.advice.expected is None else done.advice.expected.records()}
        result |= {"left_out": done.left_out.records(), "turned": None if done.turned is None else done.turned.records()}
    _say(json, result)


@app.command
def figure6(
    *, output: Output = Path("figure6.png"), samples: Whole = 40, pixels: Whole = 512, device: DeviceName = None, json: Json = False
) -> None:
    """Make Figure 6 of the paper: the Marschner-Lobb function by six filters, each with its errors.

    Parameters
    ----------
    samples
        Of the function along each axis.
    pixels
        Width and height of each panel.
    """
    figure("6", output=output, samples=samples, pixels=pixels, device=device, json=json)


@app.command
def info(source: Source, /, *, input: Input | None = None, json: Json = False) -> None:
    """Show what a volume file holds, its noise, and the smoothing λ that "auto" chooses for cubic splines."""
    import numpy as np

    volume = (input or Input()).read(source)
    finite = volume.data.dtype.kind != "f" or bool(np.isfinite(volume.data).all())
    try:
        value_range = list(volume.value_range if volume.data.dtype.kind == "f" else map(int, volume.limits))
    except DataError:  # nothing is finite
        value_range = None
    noise = volume.noise if finite else None
    chosen = choose(volume) if finite else None
    _say(
        json,
        {
            "shape": list(volume.shape),
            "dtype": str(volume.data.dtype),
            "spacing": list(volume.spacing),
            "origin": list(volume.origin),
            "direction": volume.direction.tolist(),
            "units": volume.units,
            "value_range": value_range if json or value_range is None else _range_text(*value_range),
            "finite": finite,
            "bytes": volume.data.nbytes,
            "noise": noise.kind if noise else None,
            "sigma": noise.sigma if noise else None,
            "smoothing": list(chosen.values) if chosen else None,
            "reason": chosen.reason if chosen else "",
        },
    )


@app.command
def devices(*, json: Json = False) -> None:
    """List the OpenCL devices, the one used by default first."""
    rows = [
        {
            "number": i,
            "name": d.name,
            "kind": d.kind,
            "platform": d.platform,
            "memory_mib": d.handle.global_mem_size >> 20,
            "images": bool(d.handle.image_support),
        }
        for i, d in enumerate(clvol.devices())
    ]
    if not rows:
        from clvol.device import as_device

        as_device()  # raises, and says what to install
    if json:
        _print_json(rows)
    else:
        header = ["number", "name", "kind", "platform", "memory_mib", "images"]
        _table(header, [[str(row[key]) for key in header] for row in rows])


@app.command
def filters(*, json: Json = False) -> None:
    """List the reconstruction filters."""
    table = clvol.filters()
    if json:
        _print_json([dict(zip(table.HEADER, row, strict=True)) for row in table.rows()])
    else:
        _table(list(table.HEADER), [list(row) for row in table.rows()])


@app.command
def resample(
    source: Source,
    /,
    *,
    output: Output,
    shape: Annotated[tuple[int, int, int] | None, Parameter(name="--to-shape", converter=_whole)] = None,
    spacing: Annotated[tuple[float, float, float] | None, Parameter(name="--to-spacing")] = None,
    like: str | None = None,
    magnify: Whole | None = None,
    filter: str = "bspline3",
    boundary: Annotated[str, Parameter(help=_BOUNDARIES)] = "mirror",
    fill: float | None = None,
    nan: str = "error",
    device: DeviceName = None,
    input: Input | None = None,
    json: Json = False,
) -> None:
    """Put a volume on another grid, in floating point; say which by one of --to-shape, --to-spacing, --like, --magnify.

    Parameters
    ----------
    shape
        Samples along z, y, x.
    spacing
        Spacing along x, y, z.
    like
        A volume whose grid is taken.
    magnify
        As many times the samples along each axis, a whole number.
    filter
        How it is reconstructed between its samples; see 'clvol filters'.
    fill
        Value outside the volume; by default its boundary rule goes on.
    nan
        What becomes of NaN and infinite samples: error, propagate, or local, which leaves out what they touch.
    """
    given = [
        name
        for name, value in (("--to-shape", shape), ("--to-spacing", spacing), ("--like", like), ("--magnify", magnify))
        if value is not None
    ]
    if len(given) != 1:
        raise OptionError(f"give one of --to-shape, --to-spacing, --like, --magnify; got {', '.join(given) or 'none'}")
    _require_writable(output, WRITTEN, "volumes")
    volume = (input or Input()).read(source)
    with _progress("resampling", json) as progress:
        if magnify is not None:
            result = clvol.magnify(volume, magnify, filter, boundary, device=device, nan=nan, progress=progress)
        else:
            grid = None if like is None else Input().read(like)
            result = clvol.resample(
                volume, shape, spacing, grid, filter, boundary, fill=fill, device=device, nan=nan, progress=progress
            )
    clvol.write(result, output)
    _say(json, {"output": str(output), "shape": list(result.shape), "spacing": list(result.spacing)})


@app.command
def doctor(*, json: Json = False) -> None:
    """Find out whether OpenCL is usable here, which runtime is used, and what to install if none is."""
    from clvol import doctor

    needed, optional = list(doctor.opencl()), list(doctor.extras())
    usable = needed[-1].ok
    if json:
        _print_json({"usable": usable, "checks": [check._asdict() for check in (*needed, *optional)]})
    else:
        for check in (*needed, *optional):
            print(f"{'ok' if check.ok else '--'}  {check.check}: {check.detail}")
    if not usable:
        raise SystemExit(1)


# -- where results go ----------------------------------------------------------------------------------------


def _require_picture(output: Path) -> None:
    from clvol.picture import SUFFIXES

    _require_writable(output, SUFFIXES, "pictures")


def _require_writable(output: Path, suffixes: Sequence[str], what: str) -> None:
    """Raise before hours of work if `output` is no name of a file of that kind, or cannot be written there."""
    require_suffix(output, suffixes, what)
    require_folder(output)


# -- speaking ------------------------------------------------------------------------------------------------


@contextmanager
def _progress(what: str, quiet: bool) -> Iterator[Callable[[float], None] | None]:
    """A bar on standard error where that is a terminal; nothing elsewhere."""
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=1.0)
        yield lambda done: bar.update(task, completed=done)


def _say(as_json: bool, what: dict[str, Any], lines: Sequence[str] = ()) -> None:
    """What was done, for programs or for people; `lines` stand for the values that are tables."""
    if as_json:
        _print_json(what)
        return
    for line in lines:
        print(line)
    for key, value in what.items():
        if not (lines and isinstance(value, list)) and value != "":
            print(f"{key.replace('_', ' ')}: {_text(value)}")


def _filter_text(row: Filter, given: str | None, volume: clvol.Volume) -> str:
    """A filter as people read it: its smoothing, and why it is so if it was chosen for the volume."""
    if not row.smoothing:
        return row.name
    values = row.smoothing if isinstance(row.smoothing, tuple) else (row.smoothing,)
    text = f"{row.name.partition('(')[0]}, λ = {', '.join(map(str, values))}"
    return f"{text} ({choose(volume, row.degree).reason})" if given is None or "auto" in given else text


def _range_text(low: float, high: float) -> str:
    """The ends of a range as people read them: integers in full, others to six digits of the range, even far from zero."""
    if isinstance(low, int):
        return f"{low} {high}"
    span, largest = high - low, max(abs(low), abs(high))
    more = math.ceil(math.log10(largest) - math.log10(span)) if 0 < span < largest else 0
    return " ".join(f"{v:.{min(6 + more, 17)}g}" for v in (low, high))


def _text(value: Any) -> str:
    """A value as people read it: numbers to six digits, lists with blanks between, rows with commas."""
    if value is None or isinstance(value, bool):
        return {None: "none", True: "yes", False: "no"}[value]
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list):
        return (", " if any(isinstance(v, list) for v in value) else " ").join(map(_text, value))
    return str(value)


def _print_json(value: Any) -> None:
    print(json.dumps(value, indent=2, default=str, allow_nan=False))


def _table(header: list[str], rows: list[list[str]]) -> None:
    """A table; on a narrow terminal its words go below each other, or each row becomes a paragraph."""
    cells = [header, *rows]
    columns = list(zip(*cells, strict=True))
    widths = [max(map(len, column)) for column in columns]
    words = [max((len(word) for cell in column for word in cell.split()), default=0) for column in columns]
    room = shutil.get_terminal_size().columns if sys.stdout.isatty() else math.inf
    gap = 2 if sum(words) + 2 * (len(words) - 1) <= room else 1
    room -= gap * (len(words) - 1)
    while sum(widths) > room and widths != words:  # the column that has most to give
        spare = [width - word for width, word in zip(widths, words, strict=True)]
        widths[spare.index(max(spare))] -= 1
    if sum(widths) > room:
        for first, *others in rows:
            print(f"{header[0]} {first}", *(f"  {name}: {cell}" for name, cell in zip(header[1:], others, strict=True)), sep="\n")
        return
    for row in cells:
        folded = [textwrap.wrap(cell, width, break_on_hyphens=False) for cell, width in zip(row, widths, strict=True)]
        for line in zip_longest(*folded, fillvalue=""):
            print((" " * gap).join(part.ljust(width) for part, width in zip(line, widths, strict=True)).rstrip())


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command; errors that are the user's come out as one line, never as a traceback."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # a terminal without a degree sign still gets the numbers
    try:
        try:
            app(arguments, exit_on_error=False, print_error=False)
        finally:
            sys.stdout.flush()  # here, where its errors are ours: the command may end by an exit
    except CycloptsError as error:
        command = " ".join(("clvol", *(error.command_chain or ())))
        _fail(f"{_one_line(error).rstrip('.')}; see '{command} --help'", 2)
    except ClvolError as error:
        _fail(_one_line(error), 1)
    except MemoryError as error:
        _fail(f"out of memory: {_one_line(error)}", 1)
    except BrokenPipeError:  # whoever read our output has seen enough
        _discard_output()
        raise SystemExit(0) from None
    except OSError as error:
        _fail(_one_line(error), 1)
    except KeyboardInterrupt:
        _fail("interrupted", 130)


def _discard_output() -> None:
    """Let what standard output still holds go nowhere, if it cannot be written: Python would try again at its end."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _fail(reason: str, code: int) -> NoReturn:
    _discard_output()
    print(f"clvol: {reason}", file=sys.stderr)
    raise SystemExit(code) from None
