"""Pictures again, from what their files say of how they were made."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from clvol.base.checks import as_path, warn
from clvol.base.errors import DataError, FormatError, OptionError
from clvol.base.progress import Progress
from clvol.bricks.field import as_lazy
from clvol.bricks.source import LazyVolume
from clvol.device import Device, as_device
from clvol.formats import read
from clvol.formats.opening import open as opened
from clvol.labels import only, without
from clvol.march.recipe import Recipe
from clvol.march.renderer import Renderer
from clvol.phantoms import by_name
from clvol.scene.scene import Medium
from clvol.show.picture import Picture, read_recipe, stored
from clvol.volume.provenance import facts_of, provenance_of
from clvol.volume.volume import Volume

__all__ = ["parted", "render_again"]


def render_again(
    path: str | os.PathLike[str],
    volume: Volume | LazyVolume | None = None,
    *,
    size: tuple[int, int] | None = None,
    device: Device | str | int | None = None,
    progress: Progress | None = None,
) -> Picture:
    """A picture as the one in a PNG file that `clvol.save` wrote, to the bit.

    The file is treated as untrusted: nothing in it is executed, and no address is opened.

    Parameters
    ----------
    path : path-like
        The PNG file.
    volume : Volume or LazyVolume, optional
        What it shows; by default it is read from where it was, as seen from the picture's folder.
    size : (width, height), optional
        Other than the file's.
    device, progress : optional
        As of `Renderer`, and as of `Renderer.render`.

    Returns
    -------
    Picture

    Raises
    ------
    FormatError
        The file is no PNG file by clvol, its text is damaged or of another version, or its volume is not where it was, is unknown,
        or is at an address: then give it as `volume`.
    DataError
        The volume has changed since; give it as `volume` to render it nevertheless.
    ClvolError
        As of `clvol.read` and `clvol.render`.

    Warns
    -----
    ClvolWarning
        `volume` is another than the file's; or the pixels are not those of the file, as on another device.
    """
    path = as_path(path)
    text = read_recipe(path)
    try:
        recipe = Recipe.of_text(text)
        medium, *others = recipe.scene.media
        seen = recipe.options if size is None else recipe.options | {"size": size}
    except FormatError as error:
        raise FormatError(f"{path} does not say in a way that can be read what made it: {error}") from error
    if others:
        return _several_again(path, volume, recipe, seen, device, progress)
    given, medium = volume is not None, _colored(path, medium)
    volume = _found(path, medium.volume, by_bricks=recipe.by_bricks) if volume is None else volume
    same = facts_text(volume.grid, volume.preview()) == facts_text(medium.volume, medium.volume)
    if not same and not given:
        raise _changed(path, medium.volume)
    if not same:
        warn(f"{path} was made of another volume, or of other samples: the picture differs")
    picture: Picture
    with as_device(device).limited(**recipe.limits):
        if recipe.by_bricks:
            lazy = as_lazy(volume) if isinstance(volume, Volume) else volume
            vars(lazy).setdefault("_provenance", provenance_of(volume))
            options = seen | recipe.options_of_lazy(bool(lazy.levels))
            own = Medium(lazy, filter=medium.filter, boundary=medium.boundary, color_by=medium.color_by)  # type: ignore[arg-type]  # by bricks
            with Renderer(own, device=device) as renderer:
                picture = renderer.render(recipe.camera, progress=progress, **(options | seen))
        else:
            whole = volume if isinstance(volume, Volume) else volume.whole()
            scene = replace(recipe.scene, media=(replace(medium, volume=whole),))
            with Renderer(scene, device=device) as renderer:
                picture = renderer.render(recipe.camera, progress=progress, **seen)
    if same and size is None:
        _warn_if_other(path, picture)
    return picture


def _several_again(
    path: Path, volume: object, recipe: Recipe, seen: dict[str, Any], device: Device | str | int | None, progress: Progress | None
) -> Picture:
    """A picture of several media, whose volumes are where they were."""
    if volume is not None:
        raise OptionError(f"volume stands for the only medium of a picture; {path} shows {len(recipe.scene.media)}: leave it out")
    media = []
    for number, medium in enumerate(recipe.scene.media):
        lazy = number in recipe.bricked
        found = _found(path, medium.volume, by_bricks=lazy)
        if facts_text(found.grid, found.preview()) != facts_text(medium.volume, medium.volume):
            raise _changed(path, medium.volume)
        if lazy:
            found = as_lazy(found)
            if found.levels:
                seen = seen | {"lod": recipe.lod}
        own: Any = found if lazy or isinstance(found, Volume) else found.whole()
        media.append(replace(_colored(path, medium), volume=own))
    with as_device(device).limited(**recipe.limits), Renderer(replace(recipe.scene, media=tuple(media)), device=device) as renderer:
        picture: Picture = renderer.render(recipe.camera, progress=progress, **seen)
    if recipe.size == seen["size"]:
        _warn_if_other(path, picture)
    return picture


def _colored(path: Path, medium: Medium) -> Medium:
    """A medium with the volume that colours it, if one does, from where that was."""
    if medium.color_by is None:
        return medium
    known = medium.color_by.volume
    source = (provenance_of(known) or {}).get("path")
    if source is None:
        raise FormatError(f"{path} is coloured by a volume that was made in Python: draw it again there, with color_by=")
    found = _found(path, known, by_bricks=False)
    whole = found if isinstance(found, Volume) else found.whole()
    if facts_text(whole, whole) != facts_text(known, known):
        raise DataError(f"{source}, whose values colour {path}, has changed since that was made: draw it again in Python")
    return replace(medium, color_by=replace(medium.color_by, volume=whole))


def _changed(path: Path, volume: Volume) -> DataError:
    known = provenance_of(volume) or {}
    name = f"{known.get('path')} or its mask {known['mask']['path']}" if "mask" in known else known.get("path")
    return DataError(
        f"{name} has changed since {path} was made of it: its grid or its samples differ; give the volume, "
        "to render it nevertheless"
    )


def facts_text(volume: Volume, preview: Volume) -> str:
    """What a volume is recognised by, in words that can be compared."""
    known = facts_of(volume, preview)
    return repr({name: np.asarray(value).tolist() for name, value in known.items()})


def _found(path: Path, wanted: Volume, *, by_bricks: bool) -> Volume | LazyVolume:
    """The volume of a picture, from where it was."""
    known: dict[str, Any] = dict(provenance_of(wanted) or {})
    if not isinstance(known.get("path"), str):
        raise FormatError(f"{path} shows a volume that was made in Python, of {wanted.shape} samples: give the volume")
    mask, where = known.pop("mask", None), known.pop("where", None)
    volume = _from(path, known, by_bricks=by_bricks)
    if mask is None:
        return volume
    if not isinstance(mask, Mapping) or not isinstance(mask.get("path"), str):
        raise FormatError(f"{path} does not say in a way that can be read where the mask of {known['path']} is")
    labels = _from(path, dict(mask), by_bricks=False)
    return Medium(volume, mask=labels, where=where).volume  # type: ignore[arg-type]  # or by bricks


def _from(path: Path, known: dict[str, Any], *, by_bricks: bool) -> Volume | LazyVolume:
    """The volume of a path, as seen from a picture, that was read with these options."""
    source = known.pop("path")
    if source.startswith("phantom:"):
        return by_name(source.removeprefix("phantom:"))
    if "://" in source:
        raise FormatError(f"{path} shows the volume at {source}: give it, for no address in a picture is opened by itself")
    place = path.absolute().parent / source
    if not place.exists():
        raise FormatError(
            f"{path} shows {source}, which is not there any more (seen from the folder of the picture): give the volume"
        )
    filled = known.pop("fill_nan", None)
    chosen: dict[str, list[int | str]] = {what: known.pop(what) for what in ("only_labels", "without_labels") if what in known}
    if isinstance(known.get("labels"), str):
        known["labels"] = path.absolute().parent / known["labels"]
    try:
        if by_bricks and known.get("missing") is None and filled is None and not chosen:
            return opened(place, **known)
        return parted(_filled(read(place, **known), filled), chosen)
    except TypeError as error:
        raise FormatError(f"{path} says how {source} was read in a way that this version does not know: {error}") from error


def parted(volume: Volume, chosen: Mapping[str, list[int | str]]) -> Volume:
    """A volume with its "only_labels", and without its "without_labels", which in the shell are options of how it is read."""
    if "only_labels" in chosen:
        volume = only(volume, chosen["only_labels"])
    return without(volume, chosen["without_labels"]) if "without_labels" in chosen else volume


def _filled(volume: Volume, fill: object) -> Volume:
    if fill is None:
        return volume
    return volume.filled(fill if isinstance(fill, float) else None)


def _warn_if_other(path: Path, picture: Picture) -> None:
    """Warn if a picture is not that of a file."""
    import imageio.v3 as iio

    try:
        before = iio.imread(path, plugin="pillow")
    except Exception as error:
        raise FormatError(f"{path} cannot be read as a picture: {error}") from error
    now = stored(picture)
    if before.shape != now.shape:
        warn(f"the picture is not that of {path}, which is of {before.shape} numbers, not {now.shape}: it was changed")
    elif (before != now).any():
        apart = np.abs(before.astype(np.int16) - now).reshape(*now.shape[:2], -1).max(-1)
        warn(
            f"the picture is not that of {path} to the bit: {int((apart > 0).sum())} of {apart.size} pixels differ, by up to "
            f"{int(apart.max())} of 255: the file was changed, or made on another device or by another version"
        )
