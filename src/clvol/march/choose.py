"""Which source a renderer draws from: the only place that asks what it was given."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from clvol.base.checks import one_of, whole
from clvol.base.errors import OptionError, OutOfMemoryError
from clvol.bricks.continued import continued, holed, lacks_some
from clvol.bricks.field import BrickedField
from clvol.bricks.source import LazyVolume, memory_for
from clvol.filter.table import PICTURE_FILTER
from clvol.interop.dispatch import is_in_parts
from clvol.march.options import MERGES
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
    from clvol.filter.boundary import Boundary
    from clvol.filter.filter import Filter
    from clvol.march.options import Merge
    from clvol.march.source import Drawable, Source


from clvol.march.source import ByBricks, InMemory, Several, by_parts, lacks_samples, row_for, single, usual_filter

__all__ = ["source_of", "without_masked"]


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
    if isinstance(given, LazyVolume):
        memory_for(given, memory)  # before anything is read
        if mask is not None or lacks_some(given):
            given = continued(given, mask)
        row = filter if usual is None else row_for(given, filter, usual)
        field = BrickedField(
            given, usual_filter(given) if row is None else row, boundary, device, memory=memory, at_once=cluster is None
        )
        medium = Medium(field.coefficients.volume, filter=None if row is None else field.filter, boundary=field.boundary)
        scene, preview = as_scene(medium), given.preview()
        arguments: tuple[Any, ...] = given, medium.filter, medium.boundary
    else:
        if memory is not None:  # which has no effect where the coefficients fit on the device
            memory = whole("memory", memory, 1)
        scene = _scene(given, filter, boundary, usual)
        if len(scene.media) > 1:
            return _of_several(scene, device, memory, cluster)
        (medium,) = scene.media
        arguments, preview = (scene, None, None), medium.volume
        row = filter_for(medium.volume, medium.filter, PICTURE_FILTER)
        if lacks_samples(medium.volume):
            row = settled(row, medium.volume)  # before they are filled
        if cluster is None:
            try:
                made = single(medium.volume, row, medium.boundary, device)
                return InMemory(scene, made, preview, arguments)
            except OutOfMemoryError:  # of a buffer, perhaps, which is less than the memory
                pass
        field = BrickedField(by_parts(medium.volume), row, medium.boundary, device, memory=memory, at_once=cluster is None)
    if cluster is None:
        return ByBricks(scene, field, preview, arguments)
    from clvol.march.cluster import Workers

    workers = Workers(cluster, merge, device, memory)
    return ByBricks(scene, workers.shared_out(field), preview, arguments, workers)


def _of_several(scene: Scene, device: Device | str | int | None, memory: int | None, cluster: ClusterLike | None) -> Source:
    """The source of several media, all of whose coefficients fit on the device."""
    for name, value in (("cluster", cluster), ("memory", memory)):
        if value is not None:
            raise OptionError(f"{name} takes one medium, which is read by bricks; several are drawn in memory. Got {value!r}")
    return Several(scene, device)


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
