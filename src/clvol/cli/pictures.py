"""Commands that draw: render, compare, figure, report."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Group, Parameter

import clvol
from clvol.base import html
from clvol.base.errors import OptionError
from clvol.base.files import require_folder
from clvol.bricks.field import BrickedField, as_lazy
from clvol.bricks.source import by_bricks as are_by_bricks
from clvol.bricks.source import memory_for
from clvol.cli import speech
from clvol.cli.keys import Keys
from clvol.cli.media import Others
from clvol.cli.options import (
    Background,
    ColorMap,
    Compared,
    DeviceName,
    FigureName,
    FilterName,
    Filters,
    Furniture,
    Input,
    Json,
    Look,
    ModeOptions,
    Output,
    PageOutput,
    ReportLook,
    Rule,
    Size,
    SlicedLabels,
    Source,
    SurfaceLook,
    Together,
    Whole,
    bytes_of,
    is_address,
    own_options,
    whole_numbers,
)
from clvol.cli.root import PICTURES, command
from clvol.filter.boundary import chosen_boundary
from clvol.interfaces.again import render_again
from clvol.interfaces.batches import needs_whole
from clvol.interfaces.movie import pooled
from clvol.interfaces.orthogonal import ORIENTATIONS
from clvol.march.empty import warn_of_refined
from clvol.march.function import row_for
from clvol.march.uncertainty import COVERAGE, in_words
from clvol.scene.mode import as_mode
from clvol.show import movies
from clvol.show.picture import heat, heat_with_scale
from clvol.volume.histogram import isovalue_of
from clvol.volume.provenance import note
from clvol.volume.smoothing import settled

if TYPE_CHECKING:
    from clvol.cli._preview import Preview

__all__ = ["batch", "compare", "figure", "figure6", "movie", "orthogonal", "render", "report", "slice"]

_BRICKS = Group("For volumes that are read by bricks: large, remote, or stored in several sizes", sort_key=5)
_PLANE = Group("Which slice", sort_key=1)
_Plane = Literal["x", "y", "z", "sagittal", "coronal", "axial"]
_FIRST = 0.2  # seconds until the first picture in the terminal
_COMPARED = 20_000  # gradients compared in a table of errors


@command(PICTURES)
def render(
    source: Source | None = None,
    /,
    *,
    output: Output,
    from_: Annotated[Path | None, Parameter(name="--from", show_default=False)] = None,
    filter: Annotated[FilterName | None, Parameter(show_default=False)] = None,
    size: Annotated[Size | None, Parameter(help="Width and height in pixels. [default: 512 512]", show_default=False)] = None,
    device: DeviceName = None,
    input: Input | None = None,
    look: Look | None = None,
    own: ModeOptions | None = None,
    others: Others | None = None,
    furniture: Furniture | None = None,
    heat_map: Path | None = None,
    uncertainty: Path | None = None,
    by_bricks: Annotated[bool, Parameter(negative="", group=_BRICKS)] = False,
    memory: Annotated[str | None, Parameter(show_default=False, group=_BRICKS)] = None,
    lod: Annotated[float | Literal["auto"], Parameter(group=_BRICKS)] = "auto",
    together: Together | None = None,
    preview: bool = True,
    verbose: Annotated[bool, Parameter(negative="")] = False,
    json: Json = False,
) -> None:
    """Draw a volume.

    A volume that is stored in several sizes, is at an address, or does not fit into half of the available memory is read by bricks,
    and no more of it than the picture needs; 'clvol pyramid' makes such sizes.

    Parameters
    ----------
    from_
        Draw the picture of this PNG file again, to the bit: clvol's PNG files say what made them. SOURCE is then read from where it
        was, as seen from that file's folder, unless it is given. The size may be another.
    filter
        How it is reconstructed between its samples; see 'clvol filters'. [default: bspline3(auto), which smooths the noise that it
        finds; bspline3 in modes that show extremes, such as mip]
    heat_map
        A second picture: the share of each ray's samples that was looked at, from black to pale yellow.
    uncertainty
        Another picture, for isosurfaces: how far the true surface may be, in 95 % of places, with a scale.
    by_bricks
        Read it by bricks in any case.
    memory
        Memory that bricks may take, such as 800M or 4G; what fits into it in one size is read whole. The whole process takes up to
        450M more: Python and its libraries, compiled kernels, the picture. [default: 2G, or half of what there is]
    lod
        The most pixels that a voxel of the drawn size may span, where the volume is nearest; auto is 1, 0 draws the largest size.
    preview
        Show coarser pictures above the progress bar, in a terminal with colours, if the picture of a volume in memory takes long
        and is the only output.
    verbose
        Report the share of the samples that was looked at, and how long the parts took, kernels that are built first
        included.
    """
    import numpy as np

    speech.require_picture(output)
    for other in (heat_map, uncertainty):
        if other is not None:
            speech.require_picture(other)
    if from_ is not None:
        refused: dict[str, Any] = {
            "filter": filter,
            "look": look,
            "mode": own,
            "around it": furniture,
            "heat_map": heat_map,
            "memory": memory,
        }
        refused |= {"other volumes": others}
        refused |= {"uncertainty": uncertainty, "by_bricks": by_bricks, "lod": lod != "auto", "together": together}
        if given := [name for name, value in refused.items() if value]:
            raise OptionError(f"--from says all that a picture shows: leave out other options; got some of {', '.join(given)}")
        _again(from_, source, input, output, size, device, json)
        return
    if source is None:
        raise OptionError("give SOURCE, a volume, or --from, a picture of one")
    size = size or (512, 512)
    look, others = look or Look(), others or Others()
    outputs: list[clvol.Output] = ["rgba"]
    outputs += ["visited"] if verbose or heat_map is not None else []
    outputs += ["uncertainty"] if uncertainty is not None else []
    around = furniture.options() if furniture else {}
    options = own_options(look, own, outputs, around=around, colored=others.colors is not None)
    options |= {} if lod == "auto" else {"lod": lod}
    most = None if memory is None else bytes_of(memory)
    whole = needs_whole(look.limits(), () if uncertainty is None else ("uncertainty",))
    cluster = together.cluster if together else None
    by_bricks = by_bricks or cluster is not None
    reader = input or Input()
    if others.all_channels and (by_bricks or memory is not None):
        raise OptionError("--all-channels are read whole: leave out --by-bricks, --memory, --scheduler and --workers")
    volume = _volume(others.first(reader), source, most, by_bricks=by_bricks, whole=whole)
    result: dict[str, Any] = {"output": str(output), "size": list(size), "filter": "", "mode": look.mode}
    preview = preview and isinstance(volume, clvol.Volume) and outputs == ["rgba"] and not around
    with speech.progress("rendering", json, preview=preview) as progress, look.limited(device):
        options |= look.options(volume.preview()) | around
        begun = time.perf_counter()
        wanted = row_for(volume, filter, as_mode(look.mode).picture_filter)
        transfer = options.get("transfer")
        options |= {"filter": wanted, "boundary": chosen_boundary(look.boundary)}
        (drawn,) = others.drawn([volume], options, source, reader, partial(_volume, Input(), memory=most, whole=whole))
        held = {name: options.pop(name) for name in ("filter", "boundary") if name in options}
        with clvol.Renderer(drawn, **held, device=device, memory=most, cluster=cluster) as renderer:
            ready = time.perf_counter()
            shows = preview and progress is not None and isinstance(renderer.field, clvol.Field)
            if shows and isinstance(progress, _preview()):
                pictures = {"rgba": _refined(renderer, progress, size=size, **options)}
            else:
                pictures = renderer.render(size=size, progress=progress, outputs=outputs, **options)
            done = time.perf_counter()
            shown = renderer.shown
            read = {} if isinstance(shown, clvol.Field) else _bricks_read(shown, volume, json)
    result["filter"] = shown.filter.name if json else speech.filter_text(shown.filter, filter, shown.volume)
    result |= read
    result |= _values_shown(volume, as_mode(look.mode, own.options() if own else {}), transfer, json)
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
    speech.say(json, result)


def _again(
    path: Path,
    source: str | Path | None,
    reader: Input | None,
    output: Path,
    size: tuple[int, int] | None,
    device: str | None,
    json: bool,
) -> None:
    """Draw the picture of a file again."""
    if source is None and reader is not None:
        raise OptionError("options of how SOURCE is read need SOURCE: without it a picture says itself how its volume is read")
    volume = None if source is None else _volume(reader or Input(), source)
    with speech.progress("rendering", json) as progress:
        picture = render_again(path, volume, size=size, device=device, progress=progress)
    clvol.save(picture, output)
    height, width = picture.shape[:2]
    speech.say(json, {"output": str(output), "from": str(path), "size": [width, height], "mode": picture.options["mode"].name})


def _values_shown(
    volume: clvol.Volume | clvol.LazyVolume, mode: clvol.Mode, transfer: clvol.TransferFunction | None, as_json: bool
) -> dict[str, Any]:
    """The isovalue or the display window of a picture, and whether it was estimated from few samples."""
    some = volume.preview()
    estimated = some.shape != volume.shape and getattr(volume, "statistics", None) is None
    settled_mode = mode.settled(some)
    if values := list(settled_mode.isovalues):
        given = mode.isovalues or getattr(mode, "isovalue", None) is not None or getattr(mode, "surfaces", None)  # such as "3sigma"
        name, chosen = "isovalue" if len(values) == 1 else "isovalues", not given
    else:
        low, high = (transfer or settled_mode.transfer(some)).value_range
        name, values, chosen = "window", [(low + high) / 2, high - low], transfer is None
    if as_json:
        return {name: values[0] if name == "isovalue" else values} | ({"estimated": True} if estimated and chosen else {})
    reason = isovalue_of(some)[1] if chosen and name == "isovalue" else ""
    words = [reason, f"estimated from {some.data.size} of {math.prod(volume.shape)} samples" if estimated and chosen else ""]
    said = "; ".join(filter(None, words))
    return {name: speech.text(values) + (f" ({said})" if said else "")}


def _preview() -> type[Preview]:
    from clvol.cli._preview import Preview  # only for terminals: it imports rich

    return Preview


def _refined(renderer: clvol.Renderer, shown: Preview, **options: Any) -> clvol.Picture:
    """The picture that `render` makes, those on the way to it being shown."""
    for picture in renderer.refine(seconds=_FIRST, progress=shown, **options):
        if not picture.final:
            shown.show(picture)
    warn_of_refined(renderer, picture, **{name: value for name, value in options.items() if name != "size"})
    return picture


@command(PICTURES)
def batch(
    sources: Annotated[list[str], Parameter(help="One or more volume files.", allow_leading_hyphen=False)],
    /,
    *,
    output: Annotated[str, Parameter(name=["--output", "-o"], help="Files of the pictures: see below.")] = "{name}-{frame:04}.png",
    turn: Whole = 1,
    filter: Annotated[FilterName | None, Parameter(show_default=False)] = None,
    size: Size = (512, 512),
    device: DeviceName = None,
    input: Input | None = None,
    look: Look | None = None,
    own: ModeOptions | None = None,
    others: Others | None = None,
    furniture: Furniture | None = None,
    together: Together | None = None,
    json: Json = False,
) -> None:
    """Draw many volumes from many sides.

    With --scheduler or --workers each picture is a task, and workers read SOURCES themselves.
    In --output {name} is the file's name without its suffix, {number} its index, and {frame} that of the side.
    If a file fails, the others are still drawn; the exit status then is 1.

    Parameters
    ----------
    turn
        The number of pictures of each volume, on a full turn around it.
    filter
        As of 'clvol render'.
    """
    look = look or Look()
    around = furniture.options() if furniture else {}
    options = own_options(look, own, around=around, colored=others is not None and others.colors is not None) | around
    reader = input or Input()
    held: dict[str, Any] = {"filter": filter, "boundary": chosen_boundary(look.boundary)}
    whole = needs_whole(look.limits())
    reading: Any = partial(_volume, reader, whole=whole)
    if others is not None:
        reading, held = partial(_scene, others=others, reader=reader, look=look, held=held, whole=whole), {}
    speech.require_picture(Path(f"picture{Path(output).suffix}"))
    camera = {"zoom": look.zoom, "projection": look.projection, "fit": look.fit}
    azimuth, elevation = look.turned
    cameras = clvol.Camera.turntable(turn, elevation, azimuth=azimuth, **camera) if turn != 1 else None
    with speech.progress("drawing", json) as progress:
        drawn = clvol.batch(
            sources,
            cameras,
            output,
            cluster=together.cluster if together else None,
            reading=reading,
            look=look.options if others is None else look.of_scene,
            limits=look.limits(),
            progress=progress,
            device=device,
            size=size,
            **held,
            **options,
        )
    failed = [one for one in drawn if one.error is not None]
    result: dict[str, Any] = {"pictures": len(drawn) - len(failed)}
    result |= {
        "failed": [{"source": one.source, "frame": one.frame, "error": str(one.error)} for one in failed] if json else len(failed)
    }
    speech.say(json, result, list(dict.fromkeys(f"{one.source}: {one.error}" for one in failed)))
    if failed:
        raise SystemExit(1)


def _scene(source: str, *, others: Others, reader: Input, look: Look, held: dict[str, Any], whole: bool) -> Any:
    """The scene of one of several files and of others."""
    volume = _volume(others.first(reader), source, whole=whole)
    options = held | {"transfer": look.function(volume.preview())}
    (drawn,) = others.drawn(
        [volume], {name: v for name, v in options.items() if v is not None}, source, reader, partial(_volume, Input(), whole=whole)
    )
    return drawn


@command(PICTURES)
def movie(
    source: Source,
    /,
    *,
    output: Annotated[
        Path,
        Parameter(
            name=["--output", "-o"], help="The file to write: .mp4, .webm, .gif, .webp, .zip with PNG files, or a folder for them."
        ),
    ],
    seconds: Annotated[float | None, Parameter(show_default=False)] = None,
    fps: Annotated[float | None, Parameter(show_default=False)] = None,
    frames: Annotated[Whole | None, Parameter(show_default=False)] = None,
    turns: Annotated[float | None, Parameter(show_default=False)] = None,
    key: Annotated[tuple[str, ...], Parameter(show_default=False)] = (),
    filter: Annotated[FilterName | None, Parameter(show_default=False)] = None,
    size: Size = (512, 512),
    device: DeviceName = None,
    input: Input | None = None,
    look: Look | None = None,
    own: ModeOptions | None = None,
    others: Others | None = None,
    furniture: Furniture | None = None,
    together: Together | None = None,
    json: Json = False,
) -> None:
    """Make a movie: a volume turns about its vertical, and a file of several times or volumes plays them.

    Of such a file --time or --volume chooses one, which then turns; --turns turns it while it plays. All its pictures have one
    transfer function, isovalue and filter. The first picture of a volume that turns is that of 'clvol render'; if --turns is whole,
    the movie loops smoothly. Videos need an even number of pixels along each axis: the last one of an odd number is left out. With
    --scheduler or --workers each picture is a task; a volume that is not read by bricks is sent to the workers.

    Parameters
    ----------
    seconds
        Its duration. [default: 5]
    fps
        Pictures per second, 0.1 to 1000. GIF rounds the duration of each to hundredths of a second. [default: 25; if several times
        play and nothing turns, what shows each of them once]
    frames
        The number of pictures, instead of --seconds.
    turns
        The number of turns; a negative number turns the other way. [default: 1; 0 if several times play, or with --key]
    key
        What is shown at a moment from 0, the first picture, to 1, the last: options of the look, the mode and the furniture, as
        0:isovalue=300,azimuth=30 and 1:isovalue=1200,azimuth=120, with / between the numbers of one. Numbers, colours and the
        camera change evenly from one to the next. May be repeated.
    filter
        As of 'clvol render'.
    """
    form = movies.form_of(output)
    require_folder(output)
    movies.require_encoder(form)
    look, others, reader, keys = look or Look(), others or Others(), input or Input(), Keys(key)
    around = furniture.options() if furniture else {}
    options = own_options(look, own, around=around, colored=others.colors is not None) | around
    cluster = together.cluster if together else None
    limits = look.limits()
    volumes = _times(others.first(reader), source, limits)
    with speech.progress("drawing", json) as progress:
        some = pooled(volumes)
        options = keys.beside(options | look.named(some), look, several=others != Others()) | {
            "filter": filter,
            "boundary": chosen_boundary(look.boundary),
        }
        read = partial(_volume, Input(), whole=needs_whole(limits))
        made = clvol.movie(
            others.drawn(volumes, options, source, reader, read, plays=True),
            output,
            keys.frames(look, some),
            seconds=seconds,
            fps=fps,
            frames=frames,
            turns=turns,
            cluster=cluster,
            progress=progress,
            limits=limits,
            device=device,
            size=size,
            **options,
        )
    result: dict[str, Any] = {"output": str(output), "frames": made.frames, "fps": made.fps, "mode": look.mode}
    result |= {"times": made.times} if made.times > 1 else {}
    volume = volumes[0]
    row = made.filter or row_for(volume, filter, as_mode(look.mode).picture_filter)
    shown = settled(row or volume.bounds.filter, volume.part())  # type: ignore[union-attr]  # None: by its bounds
    result["filter"] = shown.name if json else speech.filter_text(shown, filter, volume)
    speech.say(json, result)


def _times(reader: Input, source: str | Path, limits: Mapping[str, Any]) -> Sequence[clvol.Volume | clvol.LazyVolume]:
    """The volumes of a movie: several, if a file has several times or volumes and none was chosen."""
    if is_address(source) or str(source).startswith("phantom:"):
        return [_volume(reader, source, whole=needs_whole(limits))]
    return reader.playing(source, limits)


@command(PICTURES)
def slice(  # noqa: A001  # its name in the shell
    source: Source,
    /,
    *,
    output: Output,
    plane: Annotated[_Plane | None, Parameter(show_default=False, group=_PLANE)] = None,
    at: Annotated[float | None, Parameter(show_default=False, group=_PLANE)] = None,
    normal: Annotated[tuple[float, float, float] | None, Parameter(group=_PLANE)] = None,
    point: Annotated[tuple[float, float, float] | None, Parameter(show_default=False, group=_PLANE)] = None,
    up: Annotated[tuple[float, float, float] | None, Parameter(show_default=False, group=_PLANE)] = None,
    thickness: Annotated[float, Parameter(group=_PLANE)] = 0.0,
    mode: Annotated[Literal["mean", "mip", "minip"] | None, Parameter(show_default=False, group=_PLANE)] = None,
    size: Annotated[tuple[int, int] | None, Parameter(show_default=False, converter=whole_numbers)] = None,
    pixel: Annotated[float | None, Parameter(show_default=False)] = None,
    window: tuple[float, float] | None = None,
    cmap: ColorMap | None = None,
    background: Background = "black",
    filter: Annotated[FilterName | None, Parameter(show_default=False)] = None,
    boundary: Rule = None,
    device: DeviceName = None,
    labels: SlicedLabels | None = None,
    input: Input | None = None,
    json: Json = False,
) -> None:
    """Draw a slice of a volume, at any angle, or a slab of some thickness.

    Lengths and positions are in world units, as 'clvol info' lists them. Of a volume that is stored in several sizes or too large
    for memory no more is read than the slice needs.

    Parameters
    ----------
    plane
        The axis of the world that it is across; of a patient also by the plane's name. [default: z]
    at
        Where on that axis. [default: the middle]
    normal
        Instead of --plane: the direction, x y z, that an oblique slice faces.
    point
        A point x y z of the oblique slice. [default: the middle of the volume]
    up
        The direction x y z that points up in the picture. [default: z; in slices across z y, for patients their front]
    thickness
        Of a slab about the plane. It is sampled at least twice a voxel.
    mode
        What a pixel of a slab shows: mean, mip (the maximum), minip (the minimum). [default: mean]
    size
        Width and height in pixels. [default: 512 along the longer side, or as --pixel says]
    pixel
        World units per pixel. [default: as the size says]
    window
        Centre (which radiologists call level) and width of the values that are told apart.
    cmap
        Colour map by name.
    filter
        As of 'clvol render'.
    """
    speech.require_picture(output)
    if normal is None and point is not None:
        raise OptionError(f"--point is of an oblique slice: give its --normal too, or --at; got {point}")
    if normal is not None and (plane is not None or at is not None):
        raise OptionError("--normal is of an oblique slice, whose place is its --point: leave out --plane and --at")
    labels = labels or SlicedLabels()
    volume = _volume(input or Input(), source, whole=labels.smooth)
    x, y, z = (float(v) for v in (volume.center if point is None else point))
    cut = plane or "z" if normal is None else clvol.Plane(normal, (x, y, z))
    with speech.progress("drawing", json) as progress:
        picture = clvol.slice(
            volume,
            cut,
            at,
            size=size,
            spacing=pixel,
            up=up,
            thickness=thickness,
            mode=mode,
            smooth=labels.smooth,
            contour=labels.contour,
            window=window,
            cmap=cmap,
            background=None if background == "none" else background,
            filter=filter,
            boundary=chosen_boundary(boundary),
            device=device,
            progress=progress,
        )
    clvol.save(picture, output)
    assert picture.spacing is not None
    result = {"output": str(output), "size": [picture.shape[1], picture.shape[0]], "pixel": picture.spacing[0]}
    speech.say(json, result | {"units": volume.units})


@command(PICTURES)
def orthogonal(
    source: Source,
    /,
    *,
    output: Output,
    point: Annotated[tuple[float, float, float] | None, Parameter(show_default=False, group=_PLANE)] = None,
    crosshair: Annotated[bool, Parameter(negative="", group=_PLANE)] = False,
    orientation: Annotated[Literal["radiological", "neurological"] | None, Parameter(show_default=False, group=_PLANE)] = None,
    thickness: Annotated[float, Parameter(group=_PLANE)] = 0.0,
    slab: Annotated[Literal["mean", "mip", "minip"] | None, Parameter(show_default=False, group=_PLANE)] = None,
    filter: Annotated[FilterName | None, Parameter(show_default=False)] = None,
    size: Size = (1024, 1024),
    device: DeviceName = None,
    labels: SlicedLabels | None = None,
    input: Input | None = None,
    look: Look | None = None,
    own: ModeOptions | None = None,
    others: Others | None = None,
    json: Json = False,
) -> None:
    """Draw three slices through a point, across the world's axes, and the 3-D picture, in one picture.

    Above the slice across z (axial) and the 3-D picture, below those across y (coronal) and x (sagittal), at one scale. Of the look
    --window and --cmap are of the slices, and the other options of the 3-D picture. Other volumes lie over the slices of SOURCE as
    far as they are opaque.

    Parameters
    ----------
    point
        The point x y z, in world units. [default: the middle]
    crosshair
        Draw lines where the other slices are.
    orientation
        Of a patient: radiological, with the right on the left, or neurological, with the right on the right. [default:
        radiological]
    thickness
        Of slabs instead of slices.
    slab
        What a pixel of a slab shows. [default: mean]
    filter
        As of 'clvol render'.
    """
    speech.require_picture(output)
    look, others, reader, labels = look or Look(), others or Others(), input or Input(), labels or SlicedLabels()
    solid = replace(look, window=None, cmap=None)
    options = own_options(solid, own, colored=others.colors is not None)
    whole = labels.smooth or needs_whole(look.limits())
    volume = _volume(others.first(reader), source, whole=whole)
    with speech.progress("drawing", json) as progress, look.limited(device):
        options |= solid.options(volume.preview()) | {"filter": filter, "boundary": chosen_boundary(look.boundary)}
        (drawn,) = others.drawn([volume], options, source, reader, partial(_volume, Input(), whole=whole))
        picture = clvol.orthogonal(
            drawn,
            point,
            size,
            crosshair=crosshair,
            orientation=orientation,
            thickness=thickness,
            slab=slab,
            smooth=labels.smooth or None,
            contour=labels.contour,
            window=look.window,
            cmap=look.cmap,
            device=device,
            progress=progress,
            **options,
        )
    clvol.save(picture, output)
    result: dict[str, Any] = {"output": str(output), "size": list(size), "mode": look.mode}
    if volume.grid.space == "LPS":
        seen = orientation or "radiological"
        result["orientation"] = seen if json else f"{seen}: {ORIENTATIONS[seen]}"
    speech.say(json, result)


def _volume(
    reader: Input, source: str | Path, memory: int | None = None, *, by_bricks: bool = False, whole: bool = False
) -> clvol.Volume | clvol.LazyVolume:
    """The volume to draw: opened if it should be read by bricks, else read. `whole`: it must be read whole if it fits."""

    def wanted(lazy: clvol.LazyVolume) -> bool:
        return by_bricks or are_by_bricks(lazy, several=reader.level is None and not whole, most=memory)

    lazy = reader.by_parts(source, wanted)
    if lazy is None:
        volume = reader.intact(source)
        if isinstance(volume, clvol.Volume):
            note(volume, source, reader.noted())
            return _noted(as_lazy(volume), source, reader) if by_bricks else volume
        lazy = volume
    memory_for(lazy, memory)  # before it is looked at
    return _noted(lazy, source, reader)


def _noted(volume: clvol.LazyVolume, source: str | Path, reader: Input) -> clvol.LazyVolume:
    """The volume, which knows where it is from; the open store of an address knows it already, without what is secret in it."""
    if not is_address(source):
        note(volume, source, reader.noted())
    return volume


def _bricks_read(shown: BrickedField, volume: clvol.Volume | clvol.LazyVolume, as_json: bool) -> dict[str, Any]:
    """Which size of the volume a picture used, and how many of its bricks."""
    sizes = volume, *volume.levels
    level = next((n for n, one in enumerate(sizes) if one is shown.volume), 0)
    read, there, shape = shown.reads.bricks, len(shown.bricks), list(shown.volume.shape)
    if as_json:
        return {"level": level, "level_shape": shape, "bricks": there, "bricks_read": read}
    several = f"{level}, {html.numbers(shape)}" if len(sizes) > 1 else ""
    return {"level": several, "bricks": f"{read} read, of {there}"}


@command(PICTURES)
def compare(
    source: Source,
    /,
    *,
    output: Annotated[Path | None, Parameter(name=["--output", "-o"], help="The picture to write.")] = None,
    table: Annotated[Path | None, Parameter(help="Write errors from every second sample: .csv, .json or .md.")] = None,
    expected: Annotated[Path | None, Parameter(help="Write the errors expected for the samples as they are, likewise.")] = None,
    left_out: Annotated[Path | None, Parameter(help="Write errors of slices left out along each axis, likewise.")] = None,
    turned: Annotated[Path | None, Parameter(help="Write errors of the middle slice after nine turns of 40°, likewise.")] = None,
    filters: Filters = (),
    pixels: Whole = 384,
    device: DeviceName = None,
    input: Input | None = None,
    look: SurfaceLook | None = None,
    own: ModeOptions | None = None,
    json: Json = False,
) -> None:
    """Draw a volume with several filters side by side, measure their errors in up to four ways, or both.

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
        speech.require_picture(output)
    for path in wanted.values():
        speech.require_writable(path, SUFFIXES, "tables")
    if output is None:
        _require_of_tables(look, own)
    look = look or SurfaceLook()
    options, rule = own_options(look, own), chosen_boundary(look.boundary)
    volume = (input or Input()).read(source)
    names = filters or figures.SIX
    result: dict[str, Any] = {}
    if output is not None:
        with speech.progress("drawing", json) as progress, look.limited(device):
            _, sheet = figures.compare(
                volume, names, pixels, rule, device=device, progress=progress, **look.options(volume), **options
            )
        result["output"] = str(clvol.save(sheet, output))
    result |= {"filters": list(names)} | ({"mode": look.mode} if output is not None else {})
    for kind, path in wanted.items():
        with speech.progress("measuring", json) as progress:
            errors: analysis.Table[Any]
            if kind == "table":
                errors = analysis.compare(volume, names, boundary=rule, points=_COMPARED, timing_device=device, progress=progress)
                result["against"] = errors.against
            elif kind == "expected":
                errors = analysis.predict(volume, names)
                result["noise"] = errors.sigma
            elif kind == "left_out":
                errors = analysis.leave_out(volume, names, rule, progress=progress)
            else:
                errors = analysis.rotations(volume, names, boundary=rule, progress=progress)
        result[kind] = str(errors.write(path))
        if json:
            result["errors" if kind == "table" else f"{kind}_errors"] = errors.records()
        else:
            header, *rows = errors.texts()
            speech.table(header, rows)
    speech.say(json, result)


def _require_of_tables(look: Look | None, own: ModeOptions | None) -> None:
    """Raise `OptionError` for options of a picture that is not drawn."""
    heard = ("boundary", "evaluator", "fetch")
    given = {name: value for part in (look, own) if part is not None for name, value in vars(part).items()}
    usual = vars(SurfaceLook()) | vars(ModeOptions())
    if changed := [name for name, value in given.items() if name not in heard and value != usual[name]]:
        flags = ", ".join(f"--{name.replace('_', '-')}" for name in changed)
        raise OptionError(f"{flags} changes nothing in a table of errors; give --output, a picture, or leave it out")


@command(PICTURES)
def figure(
    name: FigureName,
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
    """Make a figure of the paper, or another one: impulse, gradients, convergence, noise, slices, edges, reduction, cost.

    Each has defaults for its options.

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
        speech.require_writable(output, style.SUFFIXES, "figures")
    else:
        speech.require_picture(output)
    if scan is not None:
        options["scan"] = Input().read(scan)
    with speech.progress(f"figure {name}", json) as progress:
        drawing = figures.draw(name, **options, **({"progress": progress} if "progress" in known else {}))
    speech.say(json, {"output": str(drawing.save(output)), "panels": drawing.numbers}, drawing.lines)


@command(PICTURES)
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
    """Recommend a filter for a volume, with pictures, errors and reasons, on one self-contained HTML page.

    Parameters
    ----------
    pixels
        Width and height of each picture.
    """
    from clvol import reports

    reports.page(output)  # raises, before minutes of work, if it cannot be written
    look = look or ReportLook()
    options = own_options(look, own)
    volume = (input or Input()).read(source)
    with speech.progress("measuring and drawing", json) as progress, look.limited(device):
        done = reports.report(
            volume,
            output,
            Path(source).name,
            filters or reports.REPORTED,
            pixels,
            chosen_boundary(look.boundary),
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
    speech.say(json, result)


@command(PICTURES, show=False)  # its former name
def figure6(
    *, output: Output = Path("figure6.png"), samples: Whole = 40, pixels: Whole = 512, device: DeviceName = None, json: Json = False
) -> None:
    """Make Figure 6 of the paper: the Marschner-Lobb function with six filters, and their errors.

    Parameters
    ----------
    samples
        Of the function along each axis.
    pixels
        Width and height of each panel.
    """
    figure("6", output=output, samples=samples, pixels=pixels, device=device, json=json)
