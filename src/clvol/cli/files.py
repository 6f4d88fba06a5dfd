"""Commands for files: info, resample, convert, mesh, pyramid."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from cyclopts import Parameter

import clvol
from clvol.base import html
from clvol.base.errors import ClvolWarning, DataError, OptionError
from clvol.base.files import require_suffix
from clvol.base.frames import SPACES
from clvol.base.printable import printable
from clvol.base.progress import Progress
from clvol.bricks.source import too_large
from clvol.cli.options import (
    Boundary,
    DeviceName,
    FilterName,
    Input,
    Json,
    Output,
    Rule,
    Source,
    Whole,
    bytes_of,
    is_address,
    label_of,
    whole_numbers,
)
from clvol.cli.root import DATA, command
from clvol.cli.speech import print_json, progress, range_text, require_writable, say, table
from clvol.cli.words import in_the_shell
from clvol.filter.boundary import chosen_boundary
from clvol.formats import WRITTEN, series_of
from clvol.interfaces.mesh import MESHES
from clvol.volume.histogram import isovalue_of
from clvol.volume.smoothing import choose
from clvol.volume.volumes import Leading

__all__ = ["convert", "info", "mesh", "pyramid", "resample"]

_LONGEST = 40  # characters of a header's entry that is shown
_LISTED = 100  # labels that are named


@command(DATA)
def info(source: Source, /, *, input: Input | None = None, json: Json = False) -> None:
    """Show what a volume file holds, its noise, and what follows from it: the surface's threshold, and the smoothing of "auto".

    For a file or folder with several images this lists them, until --series chooses one. If the volume is stored in several sizes,
    is at an address, or does not fit into memory, few samples are read.
    """
    reader = input or Input()
    listed = not (reader.series is not None or str(source).startswith("phantom:") or is_address(source))
    images = series_of(source, trusted=reader.trusted) if listed else ()

    def wanted(lazy: clvol.LazyVolume) -> bool:
        several = reader.level is None and (bool(lazy.levels) or lazy.bounds is not None)
        return several or too_large(lazy)

    if len(images) > 1:
        rows = [[str(n), image.id, html.numbers(image.shape), image.text] for n, image in enumerate(images)]
        if json:
            print_json({"series": [{"id": i.id, "shape": list(i.shape), "text": i.text} for i in images]})
        else:
            print(f"{printable(str(source))} holds {len(images)} images; choose one by --series")
            table(["number", "series", "samples", "description"], rows)
        return
    remote = is_address(source)  # its axes are not counted: a note says what was chosen
    leading = Leading() if remote else reader.leading(source)
    with warnings.catch_warnings():
        if not remote:
            warnings.simplefilter("ignore", ClvolWarning)  # the result says what there is
        lazy = reader.by_parts(source, wanted)
        volume = lazy or reader.intact(source)
        known = _listed(volume, leading, json)
    say(json, known | ({} if isinstance(volume, clvol.Volume) else levels_of(volume, json)))


def _listed(volume: clvol.Volume | clvol.LazyVolume, leading: Leading, as_json: bool) -> dict[str, Any]:
    """Facts about a volume, and about the others in its file."""
    grid, preview, middle = _previewed(volume)
    finite = preview is not None and (grid.data.dtype.kind != "f" or bool(np.isfinite(preview.data).all()))
    known = preview is volume or not finite or grid.data.dtype.kind != "f"  # else some samples were not read
    looked = preview if preview is not None and (finite or np.isfinite(preview.data).any()) else None  # at finite samples
    noise = middle.noise if looked is not None else None
    chosen = choose(middle) if looked is not None else None
    isovalue, why = isovalue_of(looked) if looked is not None else (None, "")
    held = {"holds": _places(leading)} if as_json else {"holds": _several(leading), "channels": _channels(leading)}
    return held | {
        "name": grid.name,
        "shape": list(grid.shape),
        "dtype": str(grid.data.dtype),
        "spacing": list(grid.spacing),
        "origin": list(grid.origin),
        "direction": grid.direction.tolist(),
        "units": grid.units,
        "space": grid.space if as_json else _space_text(grid.space),
        **_range(volume, as_json),
        "clim": grid.clim if as_json else _clim_text(grid),
        "labels": _labels(middle) if as_json else _labels_text(middle),
        **_damages(volume, as_json),
        "finite": finite if known else None if as_json else "",
        "bytes": grid.data.nbytes,
        "noise": noise.kind if noise else None,
        "sigma": noise.sigma if noise else None,
        "smoothing": list(chosen.values) if chosen else None,
        "reason": chosen.reason if chosen else "",
        "isovalue": isovalue if as_json or isovalue is None else f"{isovalue:.6g}, {why}",
        "isovalue_reason": why if as_json else "",
        "header": {name: _plain(value) for name, value in grid.header.items()} if as_json else _header_text(grid.header),
    }


def _previewed(volume: clvol.Volume | clvol.LazyVolume) -> tuple[clvol.Volume, clvol.Volume | None, clvol.Volume]:
    """A volume's grid, its preview, and its samples in the middle; no preview of a lazy one that has NaN or infinite samples."""
    try:
        return volume.grid, volume.preview(), volume.part()
    except DataError:
        return volume.grid, None, volume.grid


def _range(volume: clvol.Volume | clvol.LazyVolume, as_json: bool) -> dict[str, Any]:
    """The smallest and the largest sample, and whether they are an estimate."""
    kind: type[int | float] = float if volume.grid.data.dtype.kind == "f" else int
    try:
        ends, estimated = volume.limits if kind is int else volume.value_range, volume.estimated
    except DataError:  # no sample is finite, or not all of the preview
        return {"value_range": None}
    low, high = map(kind, ends)
    if as_json:
        return {"value_range": [low, high]} | ({"value_range_estimated": True} if estimated else {})
    return {"value_range": range_text(low, high) + (" (estimated)" if estimated else "")}


def _damages(volume: clvol.Volume | clvol.LazyVolume, as_json: bool) -> dict[str, Any]:
    """What is wrong with chunks that could not be read, if there are any."""
    found = [in_the_shell(text, ["info"]) for text in getattr(volume, "damages", ())]  # of a LazyVolume
    return {"damaged": found if as_json else "; ".join(found)} if found else {}


def _places(leading: Leading) -> dict[str, Any]:
    """For programs: the length of each axis; for channels and axes with names, what is known of each index."""
    found: dict[str, Any] = dict(zip(leading.axes, leading.counts, strict=True))
    for axis, count in found.items():
        known: dict[str, Any] = {"name": leading.names[axis]} if axis in leading.names else {}
        if axis == "channel":
            known |= {"color": leading.colors} if leading.colors else {}
            known |= {"clim": leading.clims} if leading.clims else {}
        if known:
            found[axis] = [{key: values[n] for key, values in known.items()} for n in range(count)]
    return found


def _several(leading: Leading) -> str:
    return str(leading) if leading.total > 1 else ""


def _channels(leading: Leading) -> str:
    """For people: the channels, with their names and colours."""
    names = leading.names.get("channel", ())
    colors = leading.colors or (None,) * len(names)
    codes = ["" if color is None else f", #{''.join(f'{round(255 * c):02x}' for c in color)}" for color in colors]
    return "; ".join(f"{n} {name}{code}" for n, (name, code) in enumerate(zip(names, codes, strict=False)))


def _space_text(space: str) -> str:
    if not space:
        return ""
    return f"{space}: {SPACES[space]}" + (" (nibabel's RAS flips x and y)" if space == "LPS" else "")


def _clim_text(volume: clvol.Volume) -> str:
    if volume.clim is None:
        return ""
    low, high = volume.clim
    return f"{low:.6g} to {high:.6g} (--window {low / 2 + high / 2:.6g} {high - low:.6g})"


def _labels(volume: clvol.Volume) -> Any:
    named = isinstance(volume.labels, Mapping)
    return {str(n): name for n, name in volume.labels.items()} if named else volume.is_labels  # type: ignore[union-attr]  # named


def _labels_text(volume: clvol.Volume) -> str:
    if not isinstance(volume.labels, Mapping):
        return "yes: regions, which are never blended" if volume.is_labels else ""
    rows = [f"{number} {name}".strip() for number, name in volume.labels.items()]
    return ", ".join(rows[:_LISTED]) + (f", and {len(rows) - _LISTED} more" if len(rows) > _LISTED else "")


def _plain(value: Any) -> Any:
    """The value for JSON, which has no NaN."""
    value = value.tolist() if hasattr(value, "tolist") else value
    if isinstance(value, (list, tuple)):
        return [_plain(part) for part in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _header_text(header: Mapping[str, Any]) -> str:
    """The header's entries that fit on one line."""
    texts = {name: " ".join(str(_plain(value)).split()) for name, value in header.items()}
    return ", ".join(f"{name} {text}" for name, text in texts.items() if text and len(text) <= _LONGEST)


@command(DATA)
def resample(
    source: Source,
    /,
    *,
    output: Output,
    shape: Annotated[tuple[int, int, int] | None, Parameter(name="--to-shape", converter=whole_numbers)] = None,
    spacing: Annotated[tuple[float, float, float] | None, Parameter(name="--to-spacing")] = None,
    like: str | Path | None = None,
    magnify: Whole | None = None,
    anchor: Literal["center", "origin"] = "center",
    to_dtype: str | None = None,
    filter: Annotated[FilterName | None, Parameter(show_default=False)] = None,
    boundary: Rule = None,
    fill: float | None = None,
    nan: Literal["error", "propagate", "local"] = "error",
    smooth: Annotated[bool, Parameter(negative="")] = False,
    device: DeviceName = None,
    input: Input | None = None,
    json: Json = False,
) -> None:
    """Put a volume on another grid: that of --to-shape, --to-spacing, --like or --magnify.

    With --volume all, put each volume of the file on that grid, into one file.

    Parameters
    ----------
    shape
        Samples along z, y, x.
    spacing
        Spacing along x, y, z.
    like
        A volume whose grid is taken.
    magnify
        Factor for the samples along each axis, a whole number.
    anchor
        The point that --to-spacing keeps in place: the centre of the volume, or, as in ITK, its first sample.
    to_dtype
        Type of the samples that are written: a name such as uint16, rounded and clipped, or 'same', that of SOURCE; by default
        floating point.
    filter
        How it is reconstructed between its samples; see 'clvol filters'. [default: bspline3; nearest for labels]
    fill
        Value outside the volume; by default the boundary rule applies.
    nan
        How NaN and infinite samples are treated: error, propagate, or local, which makes only what they touch NaN.
    smooth
        The samples are labels, which are kept, with smooth boundaries; the filter is then bspline5-approx by default.
    """
    grids = (("--to-shape", shape), ("--to-spacing", spacing), ("--like", like), ("--magnify", magnify))
    given = [name for name, value in grids if value is not None]
    if len(given) != 1:
        raise OptionError(f"give one of --to-shape, --to-spacing, --like, --magnify; got {', '.join(given) or 'none'}")
    if magnify is not None and (to_dtype is not None or anchor != "center" or smooth):
        raise OptionError("--to-dtype, --anchor and --smooth are for --to-shape, --to-spacing and --like; got --magnify")
    require_writable(output, WRITTEN, "volumes")
    reader = input or Input()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ClvolWarning)  # all volumes of a series have its grid
        grid = None if like is None else Input().read(like)

    def one(volume: clvol.Volume, report: Progress | None) -> clvol.Volume:
        if magnify is not None:
            return clvol.magnify(volume, magnify, filter, chosen_boundary(boundary), device=device, nan=nan, progress=report)
        dtype = volume.data.dtype if to_dtype == "same" else to_dtype
        return clvol.resample(
            volume,
            shape,
            spacing,
            grid,
            filter,
            chosen_boundary(boundary),
            anchor=anchor,
            smooth=smooth,
            dtype=dtype,
            fill=fill,
            device=device,
            nan=None if nan == "error" else nan,
            progress=report,
        )

    result: clvol.Volume | clvol.Volumes
    if reader.volume == "all":
        volumes = reader.read_all(source)
        made = []
        with progress("resampling", json) as report:
            for number, volume in enumerate(volumes):
                made.append(one(volume, None))
                if report is not None:
                    report((number + 1) / len(volumes))
        result = clvol.Volumes(made, leading=volumes.leading)
        first = result[0]
    else:
        volume = reader.read(source)
        with progress("resampling", json) as report:
            first = result = one(volume, report)
    clvol.write(result, output)
    say(json, {"output": str(output), "shape": list(result.shape), "spacing": list(first.spacing)})


@command(DATA)
def convert(source: Source, /, *, output: Output, input: Input | None = None, json: Json = False) -> None:
    """Write a volume in another file format, or all volumes of the file with --volume all. No sample changes."""
    require_writable(output, WRITTEN, "volumes")
    reader = input or Input()
    result = reader.read_all(source) if reader.volume == "all" else reader.read(source)
    clvol.write(result, output)
    say(json, {"output": str(output), "shape": list(result.shape), "dtype": str(np.asarray(result).dtype)})


@Parameter(name="*")
@dataclass
class Meshing:
    """How the surface is made: options of `clvol.mesh`."""

    isovalue: Annotated[
        float | str | None,
        Parameter(
            name=("--isovalue", "--threshold"),
            show_default=False,
            help="Value of the surface, or standard deviations above the mean, as 3sigma. [default: as of 'clvol render']",
        ),
    ] = None
    only: Annotated[
        tuple[str, ...],
        Parameter(
            help="Of labels: those whose surfaces are made, by number or name. [default: all but the background]",
            show_default=False,
            consume_multiple=True,
        ),
    ] = ()
    closed: Annotated[bool, Parameter(help="Close it where it meets the faces of the volume.")] = True
    faces: Annotated[int | None, Parameter(help="Triangles at most.", converter=whole_numbers)] = None
    curvature: Annotated[bool, Parameter(negative="", help="Keep the principal curvatures of the vertices, in a .ply.")] = False
    filter: Annotated[
        FilterName | None, Parameter(help="As of 'clvol render'; of labels, as of 'clvol resample --smooth'.", show_default=False)
    ] = None
    boundary: Rule = None
    nan: Annotated[
        Literal["error", "local"], Parameter(help="NaN and infinite samples: error, or local, where the surface ends at them.")
    ] = "error"
    device: DeviceName = None


@command(DATA)
def mesh(
    source: Source,
    /,
    *,
    output: Output,
    meshing: Meshing | None = None,
    frame: Literal["LPS", "RAS"] = "LPS",
    input: Input | None = None,
    json: Json = False,
) -> None:
    """Write the surface of a value, or the surfaces of labels, as triangles that lie on the spline: STL, PLY, OBJ or GLB.

    Labels have smooth boundaries, as by 'clvol resample --smooth'; an STL holds one, chosen by --only.

    Parameters
    ----------
    frame
        Of coordinates, for a volume of a patient.
    """
    given = dict(vars(meshing or Meshing()))
    given |= {"only": list(map(label_of, given["only"])) or None, "boundary": chosen_boundary(given["boundary"])}
    require_writable(output, MESHES, "meshes")
    if given["curvature"] and output.suffix.lower() != ".ply":
        raise OptionError(f"--curvature is kept by .ply alone; got {output.name}")
    reader = input or Input()
    volume = reader.by_parts(source, too_large) or reader.read(source)
    with progress("meshing", json) as report:
        made = clvol.mesh(volume, progress=report, **given)
    made.save(output, frame=frame)
    found = {"output": str(output), "triangles": len(made.faces), "vertices": len(made.vertices), "area": made.area}
    if output.suffix.lower() == ".stl":
        found["normals"] = "of triangles alone: .stl has no others"
    if made.labels is not None:
        found["labels"] = len(made.names)
    if made.is_closed:
        found["volume"] = made.volume
    say(json, found | {"units": volume.units})


@command(DATA)
def pyramid(
    source: Source,
    /,
    *,
    # not a Path, which would remove the second slash of an address
    output: Annotated[str, Parameter(name=["--output", "-o"], help="The store to write, a folder *.zarr.")],
    filter: Annotated[FilterName | None, Parameter(show_default=False)] = None,
    boundary: Boundary = "mirror",
    method: Literal["least-squares", "average", "nearest"] | None = None,
    levels: Whole | None = None,
    chunks: Annotated[tuple[int, int, int], Parameter(converter=whole_numbers)] = (64, 64, 64),
    shards: Annotated[tuple[int, int, int] | None, Parameter(converter=whole_numbers)] = None,
    compressor: Literal["lz4", "zstd", "none"] = "lz4",
    bounds: bool = True,
    ome: Literal["0.4", "0.5"] = "0.5",
    memory: Annotated[str | None, Parameter(show_default=False)] = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
    device: DeviceName = None,
    input: Input | None = None,
    json: Json = False,
) -> None:
    """Write a volume of any size as OME-Zarr in several sizes, part by part.

    If it is killed or interrupted, the same command resumes.

    Parameters
    ----------
    filter
        The filter of the function that smaller sizes approximate and bounds describe; see 'clvol filters'. [default:
        bspline3(auto), which smooths the noise that it finds; nearest for labels]
    method
        How smaller sizes are computed: by least squares, as means of two samples along each axis, or as every second sample.
        [default: least-squares; nearest for labels]
    levels
        Sizes, that of SOURCE included; by default until no axis has more samples than a chunk.
    chunks
        Samples along x, y, z that are stored together.
    shards
        Samples along x, y, z in one file, a multiple of a chunk; by default each chunk is a file.
    compressor
        The compression of samples, by Blosc.
    bounds
        Store minima and maxima of the function, so that invisible parts need not be read.
    ome
        Version of OME-Zarr: 0.4 is Zarr 2, 0.5 is Zarr 3.
    memory
        Memory to take, such as 800M or 4G. [default: 2G, or half of what there is]
    overwrite
        Replace OUTPUT, and the unfinished store of another command.
    """
    require_suffix(Path(output), (".zarr",), "pyramids")
    volume = (input or Input()).open(source)
    with progress("pyramid", json) as report:
        made = clvol.pyramid(
            volume,
            output,
            filter=filter,
            boundary=boundary,
            method=method,
            levels=levels,
            chunks=chunks,
            shards=shards,
            compressor=compressor,
            bounds=bounds,
            version=ome,
            memory=None if memory is None else bytes_of(memory),
            overwrite=overwrite,
            device=device,
            progress=report,
        )
    say(json, {"output": str(output)} | levels_of(made, json))


def levels_of(volume: clvol.LazyVolume, as_json: bool) -> dict[str, Any]:
    """The sizes of a volume, and the filter and boundary rule of its bounds."""
    sizes = [list(one.shape) for one in (volume, *volume.levels)]
    bounds = volume.bounds
    within = "" if as_json or bounds is None else f", samples of {range_text(*bounds.value_range)}"
    return {
        "levels": sizes if as_json else ", ".join(html.numbers(size) for size in sizes),
        "bounds": (None if as_json else "none") if bounds is None else f"{bounds.filter}, {bounds.boundary}{within}",
    }
