"""Commands about files: info, resample, convert."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

import clvol
from clvol.cli.options import Boundary, DeviceName, FilterName, Input, Json, Output, Source, Whole, whole_numbers
from clvol.cli.root import DATA, app
from clvol.cli.speech import print_json, progress, range_text, require_writable, say, table
from clvol.errors import ClvolError, DataError, OptionError
from clvol.formats import WRITTEN, series_of
from clvol.smoothing import choose
from clvol.volume import SPACES

__all__ = ["convert", "info", "resample"]


@app.command(group=DATA)
def info(source: Source, /, *, input: Input | None = None, json: Json = False) -> None:
    """Show what a volume file holds, its noise, and what is chosen by it: the surface's threshold, the smoothing of "auto".

    Of a file or folder with several images the list alone is shown, until --series says which.
    """
    input = input or Input()
    images = () if input.chooses() or str(source).startswith("phantom:") else series_of(source)
    if len(images) > 1:
        rows = [[image.id, display.numbers(image.shape), image.text] for image in images]
        if json:
            print_json({"series": [{"id": i.id, "shape": list(i.shape), "text": i.text} for i in images]})
        else:
            print(f"{source} holds {len(images)} images; choose one by --series")
            table(["series", "samples", "what it is"], rows)
        return
    leading = input.leading(source)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ClvolWarning)  # what there is, is said below
        volume = input.read(source)
    say(json, _listed(volume, leading, json))


def _listed(volume: clvol.Volume, leading: Leading, as_json: bool) -> dict[str, Any]:
    """What is known of a volume, and of the others in its file."""
    import numpy as np

    finite = volume.data.dtype.kind != "f" or bool(np.isfinite(volume.data).all())
    try:
        value_range = list(volume.value_range if volume.data.dtype.kind == "f" else map(int, volume.limits))
    except DataError:  # nothing is finite
        value_range = None
    noise = volume.noise if finite else None
    chosen = choose(volume) if finite and not volume.is_labels else None
    isovalue, why = isovalue_of(volume) if finite and volume.ndim == 3 and not volume.is_labels else (None, "")
    several = {axis: _places(axis, leading) for axis in leading.axes}
    return {
        **({"holds": str(leading) if leading.total > 1 else ""} | several if not as_json else {"leading": several}),
        "name": volume.name,
        "shape": list(volume.shape),
        "dtype": str(volume.data.dtype),
        "spacing": list(volume.spacing),
        "origin": list(volume.origin),
        "direction": volume.direction.tolist(),
        "units": volume.units,
        "space": volume.space if as_json else _space_text(volume.space),
        "value_range": value_range if as_json or value_range is None else range_text(*value_range),
        "window": _pair(volume.window, as_json),
        "labels": _labels(volume, as_json),
        "finite": finite,
        "bytes": volume.data.nbytes,
        "noise": noise.kind if noise else None,
        "sigma": noise.sigma if noise else None,
        "smoothing": list(chosen.values) if chosen else None,
        "reason": chosen.reason if chosen else "",
        "isovalue": isovalue,
        "isovalue_reason": why,
        "header": _header(volume.header) if as_json else _header_text(volume.header),
    }


@app.command(group=DATA)
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
    require_writable(output, WRITTEN, "volumes")
    volume = (input or Input()).read(source)
    with progress("resampling", json) as progress:
        if magnify is not None:
            result = clvol.magnify(volume, magnify, filter, boundary, device=device, nan=nan, progress=progress)
        else:
            grid = None if like is None else Input().read(like)
            result = clvol.resample(
                volume, shape, spacing, grid, filter, boundary, fill=fill, device=device, nan=nan, progress=progress
            )
    clvol.write(result, output)
    say(json, {"output": str(output), "shape": list(result.shape), "spacing": list(result.spacing)})
