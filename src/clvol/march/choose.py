"""Which source a renderer draws from: the only place that asks what it was given."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np

from clvol.base.checks import one_of, whole
from clvol.base.errors import DataError, OptionError, OutOfMemoryError
from clvol.bricks.continued import continued, holed, lacks_some
from clvol.bricks.field import BrickedField, as_lazy
from clvol.bricks.source import LazyVolume, memory_for
from clvol.filter.boundary import Boundary, is_given
from clvol.filter.table import PICTURE_FILTER
from clvol.interop.dispatch import is_in_parts
from clvol.march.function import extrapolated_samples, lacks_samples, row_for, single
from clvol.march.launch import Drawing
from clvol.march.media import drawing_of
from clvol.march.options import MERGES
from clvol.march.source import ByBricks, InMemory, Several
from clvol.scene.scene import Medium, Scene, as_scene, channels
from clvol.spline.field import Field, as_field
from clvol.spline.function import CLOSED, ContinuousFunction
from clvol.volume.smoothing import filter_for, settled
from clvol.volume.volume import as_volume, masked
from clvol.volume.volumes import Volumes

if TYPE_CHECKING:  # clusters need dask
    from numpy.typing import ArrayLike

    from clvol.dask.cluster import ClusterLike
    from clvol.device import Device
    from clvol.filter.filter import Filter
    from clvol.march.cluster import Workers
    from clvol.march.options import Merge
    from clvol.march.source import Drawable, Source
    from clvol.volume.volume import Volume

__all__ = ["as_drawn", "by_parts", "source_of", "without_masked"]


def source_of(
    given: Drawable,
    filter: str | Filter | None = None,
    boundary: str | Boundary | None = None,
    device: Device | str | int | None = None,
    *,
    memory: int | None = None,
    mask: ArrayLike | None = None,
    cluster: ClusterLike | None = None,
    merge: Merge = "order",
    usual: str | None = None,
) -> Source:
    """The source of what a renderer is given: see `Renderer`. `usual` is the filter of a single picture, if none is given."""
    if merge not in MERGES:
        raise one_of("merge", merge, MERGES)
    if merge != "order" and cluster is None:
        raise OptionError(f"merge says how a cluster puts rays together; got {merge!r} and no cluster")
    if mask is not None and not isinstance(given, LazyVolume):
        given = without_masked(given, mask)
    if isinstance(given, ContinuousFunction):
        if cluster is not None:
            raise OptionError("cluster takes a volume, of which its processes make fields; got a field of this process")
        return _of_field(given, filter, boundary, device, memory)
    how = _How(device, memory, cluster is None)
    if isinstance(given, LazyVolume):
        memory_for(given, memory)  # before anything is read
        if mask is not None:
            given = continued(given, mask)
        row = filter if usual is None else row_for(given, filter, usual)
        field, medium = _lazy(given, row, boundary, how)
        scene, preview = as_scene(medium), field.volume.preview()
        arguments: tuple[Any, ...] = field.volume, medium.filter, medium.boundary
    else:
        if memory is not None:  # which has no effect where the coefficients fit on the device
            how = how._replace(memory=whole("memory", memory, 1))
        asked = scene = _scene(given, filter, boundary, usual)
        if len(scene.media) > 1:
            return _of_several(scene, how, cluster, merge)
        made, medium, preview = _made(scene.media[0], how)
        if medium is not scene.media[0]:
            scene = scene.of_media([medium])
        arguments = asked, None, None
        if isinstance(made, Field):
            return InMemory(scene, made, preview, arguments)
        field = made
    workers = None
    if cluster is not None:
        from clvol.march.cluster import Workers

        workers = Workers(cluster, merge, device, memory)
        field = workers.shared_out(field)
    return ByBricks(scene, field, preview, arguments, workers)


def _source(
    scene: Scene, field: Field | BrickedField, preview: Volume, arguments: tuple[Any, ...], workers: Workers | None = None
) -> InMemory | ByBricks:
    """The source of a scene of one medium."""
    if isinstance(field, Field):
        return InMemory(scene, field, preview, arguments)
    return ByBricks(scene, field, preview, arguments, workers)


class _How(NamedTuple):
    """How functions are made."""

    device: Device | str | int | None
    memory: int | None
    here: bool  # in this process, not by those of a cluster
    sharing: int = 1  # how many share the memory

    def budget(self, volume: LazyVolume) -> int | None:
        """Bytes for the bricks of a volume."""
        if self.sharing == 1:
            return self.memory
        return memory_for(volume, None, self.sharing) if self.memory is None else self.memory // self.sharing


def _lazy(volume: LazyVolume, row: str | Filter | None, boundary: str | Boundary | None, how: _How) -> tuple[BrickedField, Medium]:
    """The function of a volume that is read by bricks, and its medium."""
    if lacks_some(volume):
        volume = continued(volume)
    used = row_for(volume, row)
    field = BrickedField(volume, used, boundary, how.device, memory=how.budget(volume), at_once=how.here)
    known = field.coefficients.volume
    return field, Medium(
        known, filter=None if row is None else field.filter, boundary=replace(field.boundary, given=is_given(boundary))
    )


def _made(medium: Medium, how: _How) -> tuple[Field | BrickedField, Medium, Volume]:
    """The function of a medium, by bricks if need be; the medium, of what is known of a volume in parts; and its preview."""
    volume: Any = medium.volume
    if is_in_parts(volume):
        memory_for(volume, how.memory)
        field, made = _lazy(volume, medium.filter, medium.boundary, how)
        vars(made.volume)["_of"] = medium  # which looks may be given of: `Medium.with_look`
        return field, replace(medium, volume=made.volume, filter=made.filter), field.volume.preview()
    row = filter_for(volume, medium.filter, PICTURE_FILTER)
    if lacks_samples(volume):
        row = settled(row, volume)  # before they are filled
    if how.here:
        try:
            return single(volume, row, medium.boundary, how.device), medium, volume
        except OutOfMemoryError:  # of a buffer, perhaps, which is less than the memory
            pass
    lazy = as_lazy(by_parts(volume))
    return BrickedField(lazy, row, medium.boundary, how.device, memory=how.budget(lazy), at_once=how.here), medium, volume


def _of_several(scene: Scene, how: _How, cluster: ClusterLike | None, merge: Merge) -> Source:
    """The source of several media."""
    how = how._replace(sharing=len(scene.media))
    workers, device = None, how.device
    begin: Callable[..., Drawing] = drawing_of
    keywords: dict[str, Any] = {} if how.memory is None else {"memory": how.memory}
    if cluster is not None:
        from clvol.march.cluster import ClusterMediaDrawing, Workers

        workers = Workers(cluster, merge, device, how.memory, how.sharing)
        begin, keywords = partial(ClusterMediaDrawing, workers), workers.keywords
    made: dict[tuple[Any, ...], tuple[Field | BrickedField, Medium, Volume]] = {}
    media, parts = [], []
    try:
        for number, medium in enumerate(scene.media):
            try:
                key = _function_of(medium)
                if key not in made:
                    made[key] = _made(medium, how)
            except DataError as error:
                raise DataError(f"medium {number} of the scene: {error}") from error
            field, known, preview = made[key]
            if workers is not None:
                field = workers.shared_out(cast("BrickedField", field))
                made[key] = field, known, preview
            how = how._replace(device=field.device)
            if known.volume is not medium.volume:
                medium = replace(medium, volume=known.volume, filter=known.filter)
            media.append(medium)
            parts.append(_source(scene.of_media([medium]), field, preview, (field,), workers))
        arguments = scene, None, None, how.device if workers is None else device
        return Several(scene.of_media(media), parts, arguments, keywords, begin)
    except BaseException:
        for field, *_ in made.values():
            field.close()
        raise


def _function_of(medium: Medium) -> tuple[Any, ...]:
    """What coefficients depend on, which looks of one volume share."""
    volume: Any = medium.volume
    row = medium.filter
    if not is_in_parts(volume):
        row = settled(filter_for(volume, row, PICTURE_FILTER), volume)
    return id(volume), row, medium.boundary


def _scene(given: Any, filter: str | Filter | None, boundary: str | Boundary | None, usual: str | None) -> Scene:
    """The scene of a volume, an array, a medium or a scene; the last two say themselves how they are reconstructed."""
    words = {name: value for name, value in (("filter", filter), ("boundary", boundary)) if value is not None}
    if isinstance(given, (Scene, Medium)):
        if words:
            raise OptionError(f"{' and '.join(words)} must be left to the medium of a scene; got {words}")
        return as_scene(given)
    if isinstance(given, Volumes):
        return Scene(channels(given, **({"filter": usual} if usual else {}) | words))
    if usual is not None:
        given = as_volume(given)
        words["filter"] = filter_for(given, filter, usual)
    return as_scene(Medium(given, **words))  # type: ignore[arg-type]  # __post_init__ converts


def as_drawn(given: Any, mask: ArrayLike | None = None) -> Volume | LazyVolume | Scene:
    """What many pictures are made of, without what a mask excludes: it has a `grid`, a `preview()` and what tasks need."""
    given = without_masked(given, mask)
    if isinstance(given, (Medium, Scene, Volumes)):
        return as_scene(given)
    return given if is_in_parts(given) else as_volume(given)


def without_masked(given: Any, mask: ArrayLike | None) -> Any:
    """What is drawn, without the samples that a mask excludes: a volume, lazy or not, a medium, or a scene of one."""
    if mask is None:
        return given
    if is_in_parts(given):
        return holed(given, mask)
    if isinstance(given, ContinuousFunction):
        raise OptionError(
            f"mask takes a volume, of which coefficients are made; got a {type(given).__name__}: a Field takes "
            'nan=Missing("local", mask)'
        )
    mask = mask.whole().data if is_in_parts(mask) else mask  # type: ignore[union-attr]  # a LazyVolume
    if not isinstance(given, (Scene, Medium)):
        return masked(as_volume(given), mask)
    if len(as_scene(given).media) > 1:
        raise OptionError("mask must be left to the media of a scene of several: Medium(..., mask=...)")
    (medium,) = as_scene(given).media
    medium = replace(medium, volume=masked(medium.volume, mask))
    return medium if isinstance(given, Medium) else replace(given, media=(medium,))


def _of_field(
    field: Field | BrickedField,
    filter: str | Filter | None,
    boundary: str | Boundary | None,
    device: Device | str | int | None,
    memory: int | None,
) -> Source:
    """The source of a field, which stays open when the renderer is closed."""
    medium = Medium(field.coefficients.volume, filter=field.filter, boundary=field.boundary)
    if isinstance(field, Field):
        as_field(field, filter, boundary, device)  # which refuses others than the field's
        if field.gaps is not None:
            if field.missing.rule == "propagate":
                raise OptionError(
                    'rendering takes a field that was made with nan="local", or without missing samples; got "propagate"'
                )
            medium = replace(medium, volume=masked(field.volume, field.gaps.volume.data))
        if field.closed:
            raise OptionError(CLOSED)
        if field.precision != "single":
            raise OptionError(f"rendering takes a field of single precision; got one of {field.precision} precision")
        return InMemory(as_scene(medium), field, medium.volume, (field,))
    if filter is not None or boundary is not None or device is not None or memory is not None:
        raise OptionError("filter, boundary, device and memory must be left to the field; got them beside it")
    if field.closed:
        raise OptionError(CLOSED)
    return ByBricks(as_scene(medium), field, field.volume.preview(), (field,))


def by_parts(volume: Volume) -> Volume | LazyVolume:
    """What a bricked field of a picture takes for a volume: itself, or if samples are missing, the filled one, and where."""
    if not lacks_samples(volume):
        return volume
    where = ~np.isfinite(volume.data)
    filled = as_lazy(replace(volume, data=extrapolated_samples(volume, where)))
    filled.where = where
    return filled
