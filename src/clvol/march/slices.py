"""Slices: pictures of the function in a plane or a slab, computed at the middle of every pixel."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, Literal, TypedDict, Unpack
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base import memory
from clvol.base.arrays import reals
from clvol.base.checks import flag, if_image, instance, number, one_of, require_known, whole
from clvol.base.color import color_of
from clvol.base.errors import GeometryError, OptionError
from clvol.base.progress import Progress, part_of, require_callback
from clvol.bricks.source import LazyVolume
from clvol.device import Device, as_device
from clvol.filter.boundary import DEFAULT_BOUNDARY, Boundary, as_boundary
from clvol.filter.filter import Filter
from clvol.filter.table import PICTURE_FILTER
from clvol.interop.dispatch import is_in_parts
from clvol.march.bricks import level_within
from clvol.march.choose import without_masked
from clvol.march.contours import Shown, contour_width, on_contours
from clvol.march.function import regions_of, row_for, single
from clvol.march.options import covering
from clvol.march.renderer import Renderer
from clvol.scene.clip import Plane
from clvol.scene.mode import as_mode
from clvol.scene.scene import Medium, Scene, as_medium, as_scene
from clvol.scene.transfer import TransferFunction
from clvol.show.picture import Picture
from clvol.spline.field import as_field
from clvol.spline.function import ContinuousFunction
from clvol.spline.regions import Regions, region_boundary
from clvol.volume.smoothing import filter_for
from clvol.volume.volume import Volume, as_volume

__all__ = [
    "AXES",
    "SLABS",
    "Sheet",
    "SliceOptions",
    "axis_directions",
    "axis_of",
    "has_smooth_labels",
    "lay",
    "lay_over",
    "over_slices",
    "plane_points",
    "section",
    "shaded",
    "slice",
    "slice_function",
    "window_of_slices",
]

AXES = ("x", "y", "z")
_ANATOMICAL = {"sagittal": 0, "coronal": 1, "axial": 2}
SLABS = ("mean", "mip", "minip")
_PIXELS = 512  # along the longer side of a slice, by default
_SAMPLED = 1 << 20
_ENDS = 0.002, 0.998  # quantiles of the samples that are black and white by default
_AT_ONCE = 1 << 20  # points of a slab
_OF_A_PIXEL = 64  # bytes: its position, value and colour
_OPAQUE = 1 - 2.0**-24  # an opacity of 1 has no extinction
_LEAST = 1e-9  # relative: shorter lengths are rounding


class SliceOptions(TypedDict, total=False):
    """How slices are reconstructed and coloured.

    Attributes
    ----------
    thickness : float
        Of a slab, in world units, centred on the plane. 0, the default, is the plane itself. A slab is sampled along its normal at
        ``n = 1 + ceil(2 thickness / s)`` points at equal distances, its two faces included, where s is the smallest spacing of the
        volume, or of the level that is read: at most half of it apart. Points outside the volume, and where samples are missing, do
        not count.
    mode : {"mean", "mip", "minip"}
        What a pixel shows of a slab: the mean (the default), by the trapezoidal rule, so that faces count half; the largest or the
        smallest value.
    smooth : bool
        Whether the samples are labels with smooth boundaries, those of ``clvol.render(mode="regions")`` and
        ``clvol.resample(smooth=True)``: a pixel shows the label whose region its centre lies in. They must be in memory.
    contour : float
        Lines along the boundaries of labels, instead of their areas: how many pixels wide, from 1 to 16, on the inner side of each
        boundary and in the colour of the label there. 0, the default, fills the areas. The volume's own ends are no boundaries.
    filter, boundary, device, memory
        As of `clvol.Renderer`. By default "bspline3(auto)", in the modes that show extremes "bspline3", and labels "nearest", or
        with `smooth` "bspline5-approx".
    window : (center, width)
        Values from black to white; by default those of `Volume.clim`, or nearly all of the volume's.
    cmap : str
        The name of a colour map. By default labels have a colour each, and other values are grey.
    transfer : TransferFunction
        Colours, and how far they cover the background, instead of both. Labels of opacity 0 are hidden; by default, only the one of
        the background among them is.
    background : three numbers, a name, or None
        Outside the volume, where its samples are missing, and where labels are hidden; None is transparent.
    progress : callable
        Called with the fraction done.
    mask : array-like of bool or LazyVolume of bool, shape of the volume
        True where a sample is missing, as of `clvol.Renderer`.
    over : sequence of Medium or Volume
        Up to 7 media that are laid over the slice, whole, as far as their transfer functions are opaque; in words, what they show
        as a little of matter covers. Where they meet, extinctions add and colours are weighted by extinction, as in pictures of a
        scene, so that their order changes nothing. Their cuts, surfaces and what colours them are for 3-D; `smooth` and `contour`
        are of their labels too, of which a mean shows the largest.
    """

    thickness: float
    mode: Literal["mean", "mip", "minip"] | None
    smooth: bool
    contour: float
    filter: str | Filter | None
    boundary: str | Boundary
    device: Device | str | int | None
    memory: int | None
    window: tuple[float, float] | None
    cmap: str | None
    transfer: TransferFunction | None
    background: Sequence[float] | str | None
    progress: Progress | None
    mask: ArrayLike | None
    over: Sequence[Medium | Volume] | None


def slice(  # noqa: A001  # clvol.slice, as its users call it
    volume: Volume | LazyVolume | Medium | ContinuousFunction | ArrayLike,
    plane: str | int | Plane = "z",
    position: float | None = None,
    *,
    size: tuple[int, int] | None = None,
    spacing: float | tuple[float, float] | None = None,
    center: Sequence[float] | None = None,
    up: Sequence[float] | None = None,
    **options: Unpack[SliceOptions],
) -> Picture:
    """A slice of a volume at any angle, or what a slab of some thickness shows, as a picture.

    Parameters
    ----------
    volume : Volume, LazyVolume, Medium, Field, BrickedField or array-like, 3-D
        Of a LazyVolume the coarsest level whose voxels are at most a pixel long is read, where the slice lies. A Field makes many
        slices of one volume in less time: it has its coefficients. A Medium, or a scene of one, has its filter, boundary and mask,
        and with `smooth` its colours and opacities; else its transfer function is for 3-D, as its cuts are. `clvol.orthogonal`
        shows several media.
    plane : str, int or Plane
        An axis of the world that the slice is across, "x", "y" or "z", or 0, 1 or 2; of a patient also "sagittal", "coronal" or
        "axial"; or an oblique `Plane`, which is seen from the side that its normal points to.
    position : float, optional
        Where on that axis, in world units; by default in the middle of the volume. A Plane has its own.
    size : (width, height), optional
        In pixels. Without `spacing` all of the slice fits into it.
    spacing : float or (float, float), optional
        World units per pixel, along rows and columns. Without `size` the picture holds all of the slice. Without both it is 512
        pixels along its longer side.
    center : (x, y, z), optional
        The world point in the middle of the picture, or its projection onto the plane; by default the middle of the slice.
    up : (x, y, z), optional
        Direction of the world that points up in the picture, projected onto the plane. By default slices stand as in `clvol.view`
        and in radiology: z is up, in slices across z y, but for patients their front (-y), seen from the feet with the patient's
        right on the left; rows of a stack of images (`Volume.space` is "image") run down.
    **options
        Those of `clvol.march.slices.SliceOptions`, which describes them: `thickness`, `mode`, `filter`, `window`, `cmap`, ...

    Returns
    -------
    Picture, an ndarray of float32, shape (height, width, 4)
        Red, green, blue, opacity in 0..1; row 0 is the top. `Picture.spacing` is what a pixel measures in the world.

    Raises
    ------
    OptionError
        An unknown name; `position` beside a Plane; `mode` without a thickness; the mean of labels; a number outside its bounds;
        the volume does not have three axes; a scene of several media; `filter` or `boundary` beside a medium; `transfer` beside
        `window` or `cmap`; `contour` of what is no label map, or of a slab; `smooth` of one that is not in memory, or with a filter
        that has a prefilter or negative weights.
    GeometryError
        The plane does not meet the volume, `up` is along its normal, or a point is not three finite numbers.
    DataError, FormatError, DeviceError, OutOfMemoryError
        As by `clvol.render`; with `smooth` also `DataError` where a sample is no whole number.

    Examples
    --------
    >>> import clvol
    >>> volume = clvol.phantoms.marschner_lobb(32)
    >>> picture = clvol.slice(volume, "y", 0.25, spacing=0.01)
    >>> picture.shape, picture.spacing
    ((207, 207, 4), (0.01, 0.01))
    >>> oblique = clvol.slice(volume, clvol.Plane((1, 1, 1), volume.center), thickness=0.2, mode="mip", size=(64, 64))
    >>> labels = clvol.Volume((volume.data > 0.5).astype("uint8"), volume.spacing, volume.origin, labels={1: "waves"})
    >>> lines = clvol.slice(labels, "y", 0.25, smooth=True, contour=2, background=None)
    """
    require_known("slice", options, SliceOptions.__annotations__)
    if isinstance(volume, (Medium, Scene)):
        volume, own = _of_medium(volume, options)
        options |= own
    given = without_masked(_given(volume, options), options.pop("mask", None))
    grid: Volume = given.grid
    if grid.ndim != 3:
        raise OptionError(f"a slice is of a volume with 3 axes; got shape {grid.shape}{if_image(grid.shape)}")
    where, right, down = _placed(grid, plane, position, up)
    thickness = number("thickness", options.get("thickness", 0.0), minimum=0)
    low, high = _extent(grid, where, right, down, thickness / 2)
    if center is None:
        middle = np.asarray(where.point) + (low + high) / 2 @ np.stack([right, down])
    else:
        middle = _vector("center", center)
        middle = middle - ((middle - np.asarray(where.point)) @ np.asarray(where.normal)) * np.asarray(where.normal)
    size, pixel = _pixels(high - low, size, spacing)
    return section(given, middle, right, down, pixel, size, **options)


def section(
    volume: Volume | LazyVolume | Shown | ArrayLike,
    middle: Sequence[float] | NDArray[np.float64],
    right: Sequence[float] | NDArray[np.float64],
    down: Sequence[float] | NDArray[np.float64],
    pixel: tuple[float, float],
    size: tuple[int, int],
    **options: Unpack[SliceOptions],
) -> Picture:
    """A picture of the plane through a world point: what `View` shows as a slice, bit for bit. See `clvol.slice`.

    Parameters
    ----------
    volume : Volume, LazyVolume or array-like
        As of `clvol.slice`; or the regions of labels.
    middle : (x, y, z)
        The world point in the middle of the picture.
    right, down : (x, y, z)
        Unit vectors of the world along rows and columns of the picture, at right angles.
    pixel : (float, float)
        World units per pixel, along rows and columns.
    size : (width, height)
        In pixels.
    **options
        Those of `SliceOptions`.
    """
    require_known("section", options, SliceOptions.__annotations__)
    mode, thickness = options.get("mode"), number("thickness", options.get("thickness", 0.0), minimum=0)
    if mode is not None and mode not in SLABS:
        raise one_of("mode of a slice", mode, SLABS)
    if mode is not None and not thickness:
        raise OptionError("mode changes nothing in a slice without a thickness; leave it out, or give the thickness of a slab")
    contour = contour_width(options.get("contour", 0.0), thickness)
    window, cmap, transfer = options.get("window"), options.get("cmap"), options.get("transfer")
    if transfer is not None:
        instance("transfer", transfer, TransferFunction)
        if transfer.graded:
            raise OptionError("transfer of slices must be by values alone: gradients and curvatures are of matter, in composite")
        if window is not None or cmap is not None:
            raise OptionError("transfer must be left out where window or cmap say what it is; got both")
    background = options.get("background", (0.0, 0.0, 0.0))
    background = None if background is None else color_of("background", background)
    progress = options.get("progress")
    require_callback("progress", progress)
    given = without_masked(_given(volume, options), options.pop("mask", None))
    known: Volume = getattr(given, "volume", given).preview()  # a function has its volume
    _require_no_mean(known, thickness != 0, mode)
    over = _over(known, options.get("over"))
    if contour and not any(one.is_labels for one in (known, *(medium.volume.preview() for medium in over))):
        raise OptionError(f"contour is for labels: Volume(..., labels=True) says that samples are some; got {known!r}")
    width, height = _counts(size)
    memory.require(width * height * _OF_A_PIXEL, f"a slice of {width} × {height} pixels")
    usual = as_mode(mode or "mean").picture_filter if thickness else PICTURE_FILTER
    areas = Sheet.of(middle, right, down, pixel, (width, height), options)
    count = 1 + len(over)
    with slice_function(given, usual, max(pixel), options) as function:
        found = (areas if known.is_labels else replace(areas, contour=0.0)).values(function, part_of(progress, 0, 1 / count))
    picture, laid = shaded(found, known, window, cmap, background, transfer), []
    for k, medium in enumerate(over, 1):
        own, smooth = medium.volume.preview(), has_smooth_labels(medium, None, flag("smooth", options.get("smooth", False)))
        how: SliceOptions = {"filter": medium.filter, "boundary": medium.boundary, "smooth": smooth}
        how |= {"device": options.get("device"), "memory": options.get("memory")}
        with slice_function(medium.volume, PICTURE_FILTER, max(pixel), how) as function:
            found = areas.over(own).values(function, part_of(progress, k / count, (k + 1) / count))
        laid.append((found, over_slices(medium)))
    lay(picture, laid)
    picture.spacing = (float(pixel[0]), float(pixel[1]))
    return picture


def lay_over(
    picture: NDArray[Any], others: Sequence[tuple[Shown, TransferFunction, Sheet]], progress: Progress | None = None
) -> None:
    """Lay other functions over a picture of a slice, as far as their transfer functions are opaque, whatever their order."""
    laid = []
    for k, (function, transfer, sheet) in enumerate(others):
        _require_no_mean(function.grid, bool(sheet.across.any()), sheet.mode)
        laid.append((sheet.values(function, part_of(progress, k / len(others), (k + 1) / len(others))), transfer))
    lay(picture, laid)


def over_slices(medium: Medium) -> TransferFunction:
    """What a medium looks like over a slice."""
    return medium.transfer or covering(medium.volume.preview(), medium.words)


def lay(picture: NDArray[Any], layers: Sequence[tuple[NDArray[Any], TransferFunction]]) -> None:
    """Lay layers of values over a picture, but none where they are NaN.

    Where several meet, their extinctions add, and colours are weighted by extinction. Summands are sorted, so that the order of the
    layers does not change a bit.
    """
    seen = [transfer(np.nan_to_num(values)) for values, transfer in layers]
    shares = [np.where(np.isnan(values), 0.0, one[..., 3]) for (values, _), one in zip(layers, seen, strict=True)]
    if len(layers) == 1:
        _cover(picture, seen[0][..., :3], shares[0])
    elif layers:
        opaque = np.stack(shares).astype(np.float64)
        weights = -np.log1p(-np.minimum(opaque, _OPAQUE))
        total = _sorted(weights).sum(0)[..., None]
        colors = _sorted(weights[..., None] * np.stack([one[..., :3] for one in seen])).sum(0)
        colors = np.divide(colors, total, out=np.zeros_like(colors), where=total > 0)
        _cover(picture, colors, 1 - _sorted(1 - opaque).prod(0))


def _sorted(layers: NDArray[Any]) -> NDArray[Any]:
    """Along axis 0, so that sums do not depend on the order; those of two do not anyway."""
    return layers if len(layers) == 2 else np.sort(layers, 0)


def _cover(picture: NDArray[Any], shown: NDArray[Any], opacities: NDArray[Any]) -> None:
    """Lay colours over a picture, as far as they are opaque."""
    share = opacities[..., None]
    below = (1 - share) * picture[..., 3:]
    opacity = share + below
    colors = share * shown + below * picture[..., :3]
    picture[..., :3] = np.divide(colors, opacity, out=np.zeros_like(colors), where=opacity > 0)
    picture[..., 3:] = opacity


def _over(known: Volume, given: Sequence[Medium | Volume] | None) -> list[Medium]:
    """The media that are laid over a slice and are seen; refused as those of a scene would be."""
    if given is None or (isinstance(given, (list, tuple)) and not given):
        return []
    if not isinstance(given, (list, tuple)):
        raise OptionError(f"over must be a list of media; got {given!r:.200}")
    return [medium for medium in Scene((Medium(known), *map(as_medium, given))).media[1:] if medium.visible and not medium.surfaces]


def _require_no_mean(volume: Volume, slab: bool, mode: str | None) -> None:
    if slab and mode in (None, "mean") and volume.is_labels:
        raise OptionError("mode of a slab of labels must be mip or minip, because the mean of two labels is a third; got mean")


def _of_medium(given: Medium | Scene, options: SliceOptions) -> tuple[Volume, SliceOptions]:
    """The volume of the only medium, and how it is reconstructed."""
    first, *others = as_scene(given).media
    if others:
        raise OptionError(
            f"a slice is of one medium; got a scene of {1 + len(others)}: give one of scene.media, with others as over=, or "
            "let clvol.orthogonal lay them over each other"
        )
    if named := {"filter", "boundary"} & options.keys():
        raise OptionError(f"{' and '.join(sorted(named))} must be left to the medium; got {options}")
    own: SliceOptions = {"filter": None if first.smooth else first.filter, "boundary": first.boundary}
    if has_smooth_labels(first, options.get("smooth")):
        own |= {"smooth": True, "filter": first.filter}
        if (first.transfer or first.words) and all(options.get(name) is None for name in ("transfer", "window", "cmap")):
            own["transfer"] = first.transfer or covering(first.volume, first.words)
    return first.volume, own


def has_smooth_labels(medium: Medium, smooth: bool | None, usual: bool = False) -> bool:
    """Whether slices show smooth boundaries of a medium: if it is of labels, as asked for or as usual."""
    known = medium.volume.preview()
    if medium.smooth:
        as_mode("regions").settled(known)  # which refuses values
    return (usual or medium.smooth if smooth is None else flag("smooth", smooth)) and known.is_labels


def _given(volume: Any, options: SliceOptions) -> Any:
    """A function, a volume that is read by parts, or a volume in memory."""
    if isinstance(volume, (ContinuousFunction, Regions)) or is_in_parts(volume):
        return volume
    volume = as_volume(volume)
    return replace(volume, labels=True) if options.get("smooth") and volume.labels is None else volume


@contextmanager
def slice_function(volume: Any, usual: str, pixel: float, options: SliceOptions) -> Iterator[Shown]:
    """The function of a slice: the one given, a volume's, or that of the level whose voxels are about as long as a pixel."""
    row, boundary, device = options.get("filter"), options.get("boundary"), options.get("device")
    if isinstance(volume, Regions):
        yield volume
    elif flag("smooth", options.get("smooth", False)):
        with regions_of(volume, row, region_boundary(boundary), as_device(device)) as regions:
            yield regions
    elif isinstance(volume, ContinuousFunction):
        yield as_field(volume, row, boundary, device)
    elif is_in_parts(volume):
        with Renderer(volume, row_for(volume, row, usual), boundary, device, memory=options.get("memory")) as renderer:
            yield renderer.field_of_level(level_within(volume, pixel))
    else:
        with single(volume, filter_for(volume, row, usual), as_boundary(boundary or DEFAULT_BOUNDARY), device) as field:
            yield field


# -- what pixels show ------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Sheet:
    """The points of a slice, and what of a function its pixels show.

    Attributes
    ----------
    points : (height, width, 3)
        The middles of pixels in the world.
    axes : (2, 3)
        What a pixel measures in the world, along rows and columns.
    across : (3,)
        From face to face of a slab.
    mode : {"mean", "mip", "minip"}, optional
        What is shown of it.
    contour : float
        The width of lines along the boundaries of labels, in pixels; 0 fills areas.
    """

    points: NDArray[np.float64]
    axes: NDArray[np.float64]
    across: NDArray[np.float64]
    mode: str | None
    contour: float

    @classmethod
    def of(
        cls,
        middle: Sequence[float] | NDArray[np.float64],
        right: Sequence[float] | NDArray[np.float64],
        down: Sequence[float] | NDArray[np.float64],
        pixel: tuple[float, float],
        size: tuple[int, int],
        options: Mapping[str, Any],
    ) -> Sheet:
        """The sheet of a picture of `section`."""
        axes = np.stack([right, down]) * np.reshape(pixel, (2, 1))
        across = options.get("thickness", 0.0) * np.cross(right, down)
        points = plane_points(middle, right, down, pixel, size)
        return cls(points, axes, across, options.get("mode"), options.get("contour", 0.0))

    def over(self, volume: Volume) -> Sheet:
        """The same of a volume that is laid over another: values have no contours, and labels no mean but the largest."""
        if not volume.is_labels:
            return replace(self, contour=0.0)
        return replace(self, mode="mip") if self.across.any() and self.mode in (None, "mean") else self

    def values(self, function: Shown, progress: Progress | None) -> NDArray[Any]:
        """What the pixels show of a function; NaN outside, and beside contours."""
        if self.across.any():
            return _slab(function, self.points, self.across, _SLABS[self.mode or "mean"], progress)
        found = function(self.points, fill=np.nan, progress=progress)
        if self.contour:
            found[~on_contours(function, found, self.points, self.axes, self.contour)] = np.nan
        return found


def _slab(
    function: Shown,
    points: NDArray[np.float64],
    across: NDArray[np.float64],
    projected: Callable[[NDArray[Any]], NDArray[Any]],
    progress: Progress | None,
) -> NDArray[Any]:
    """What a slab through the points shows: `across` is from face to face."""
    count = 1 + math.ceil(2 * float(np.linalg.norm(across)) / min(function.grid.spacing))
    offsets = np.linspace(-0.5, 0.5, count)[:, None, None] * across
    flat, each = points.reshape(-1, 3), max(1, _AT_ONCE // count)
    found = []
    for first in range(0, len(flat), each):
        part = flat[first : first + each]
        told = part_of(progress, first / len(flat), min(1.0, (first + each) / len(flat)))
        found.append(projected(function(part + offsets, fill=np.nan, progress=told)))
    return np.concatenate(found).reshape(points.shape[:-1])


def _mean(values: NDArray[Any]) -> NDArray[Any]:
    """The mean along axis 0 by the trapezoidal rule, without NaN; NaN where there is nothing else."""
    weights = np.ones(len(values))
    weights[[0, -1]] = 0.5
    there = ~np.isnan(values)
    with np.errstate(invalid="ignore"):
        mean = (weights @ np.where(there, values, 0.0)) / (weights @ there)
    return np.asarray(mean, values.dtype)


_SLABS: dict[str, Callable[[NDArray[Any]], NDArray[Any]]] = {"mean": _mean, "mip": np.fmax.reduce, "minip": np.fmin.reduce}


# -- where ----------------------------------------------------------------------------------------------------


def axis_of(plane: str | int, space: str = "") -> int:
    """The number of an axis of the world, 0 to 2, from its name; of a patient also by the names of its planes."""
    known = (*AXES, *_ANATOMICAL) if space == "LPS" else AXES
    if isinstance(plane, str) and plane in known:
        return AXES.index(plane) if plane in AXES else _ANATOMICAL[plane]
    if isinstance(plane, str) or not isinstance(plane, (int, np.integer)) or isinstance(plane, bool) or not 0 <= plane <= 2:
        why = f"; {plane} is of a patient, whose space is 'LPS', not {space!r}" if plane in _ANATOMICAL else ""
        raise OptionError(f"plane must be one of {', '.join(known)}, a number from 0 to 2, or a clvol.Plane; got {plane!r}{why}")
    return int(plane)


def axis_directions(space: str, axis: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """World directions along rows and columns of a slice across an axis, seen as by radiologists: from the feet.

    Up is z, or y in slices across z; rows of images run down.
    """
    across, along = [(1, 2), (0, 2), (0, 1)][axis]
    right, down = np.eye(3)[across], np.eye(3)[along]
    if space != "image" and not (axis == 2 and space == "LPS"):
        down = -down
    return right, down


def _placed(
    grid: Volume, plane: str | int | Plane, position: float | None, up: Sequence[float] | None
) -> tuple[Plane, NDArray[np.float64], NDArray[np.float64]]:
    """The plane, and world directions along rows and columns of its picture."""
    if isinstance(plane, Plane):
        if position is not None:
            raise OptionError(f"position is of a plane across an axis; a Plane has its point; got {position!r} beside {plane!r}")
        normal = np.asarray(plane.normal)
        upward = -axis_directions(grid.space, 0)[1]  # as slices across x and y have it
        if up is None and np.linalg.norm(np.cross(normal, upward)) < _LEAST:
            upward = -axis_directions(grid.space, 2)[1]
    else:
        axis = axis_of(plane, grid.space)
        right, down = axis_directions(grid.space, axis)
        point = np.array(grid.center)
        point[axis] = point[axis] if position is None else number("position", position)
        plane = Plane(tuple(np.cross(down, right)), tuple(point))
        normal, upward = np.asarray(plane.normal), -down
    if up is not None:
        upward = _vector("up", up)
        upward = upward / (float(np.abs(upward).max()) or 1.0)
    down = (upward @ normal) * normal - upward
    length = float(np.linalg.norm(down))
    if not length > _LEAST * float(np.linalg.norm(upward)):
        raise GeometryError(f"up must have a direction that is not along the normal of the plane, {plane.normal}; got {up!r}")
    down = down / length + 0.0  # no zero is negative
    return plane, np.cross(normal, down) + 0.0, down


def _extent(
    grid: Volume, plane: Plane, right: NDArray[np.float64], down: NDArray[np.float64], half: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The ends, along rows and columns from the plane's point, of the part of a slab that is in the domain."""
    corners = grid.corners - np.asarray(plane.point)
    height = corners @ np.asarray(plane.normal)
    found = [corners[np.abs(height) <= half]]
    for face in {-half, half}:
        for i, j in ((i, i | bit) for bit in (1, 2, 4) for i in range(8) if not i & bit):
            if (height[i] < face) != (height[j] < face):
                share = (face - height[i]) / (height[j] - height[i])
                found.append((corners[i] + share * (corners[j] - corners[i]))[None])
    flat = np.concatenate(found) @ np.stack([right, down], 1)
    if not len(flat) or not (np.ptp(flat, axis=0) > _LEAST * grid.radius).all():
        ends = np.sort(height + float(np.asarray(plane.point) @ np.asarray(plane.normal)))[[0, -1]]
        raise GeometryError(
            f"the plane must meet the volume, which lies from {ends[0]:g} to {ends[1]:g} along its normal {_text(plane.normal)}; "
            f"got a plane at {float(np.asarray(plane.point) @ np.asarray(plane.normal)):g}"
        )
    return flat.min(0), flat.max(0)


def _pixels(
    extent: NDArray[np.float64], size: tuple[int, int] | None, spacing: float | tuple[float, float] | None
) -> tuple[tuple[int, int], tuple[float, float]]:
    """Numbers of pixels and their spacings, for a slice of this extent along rows and columns."""
    if spacing is not None:
        given = reals("spacing", spacing, "one positive number, or two, along rows and columns")
        if given.shape not in ((), (2,)) or not (np.isfinite(given) & (given > 0)).all():
            raise OptionError(f"spacing must be one positive number, or two, along rows and columns; got {spacing!r}")
        pixel = np.broadcast_to(given, 2)
    elif size is not None:
        pixel = np.broadcast_to((extent / _counts(size)).max(), 2)
    else:
        pixel = np.broadcast_to(extent.max() / _PIXELS, 2)
    if size is None:
        counts = np.maximum(1, np.ceil(np.minimum(extent / pixel * (1 - _LEAST), 1e9)).astype(int))
        size = int(counts[0]), int(counts[1])
    return _counts(size), (float(pixel[0]), float(pixel[1]))


def _counts(size: tuple[int, int]) -> tuple[int, int]:
    try:
        width, height = size
    except (TypeError, ValueError):
        raise OptionError(f"size must be (width, height) in pixels; got {size!r}") from None
    return whole("width", width, 1, 1 << 15), whole("height", height, 1, 1 << 15)


def _vector(what: str, value: object) -> NDArray[np.float64]:
    vector = reals(what, value, "three numbers (x, y, z)", GeometryError)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise GeometryError(f"{what} must be three finite numbers (x, y, z); got {value!r}")
    return vector


def _text(vector: Sequence[float] | NDArray[np.float64]) -> str:
    return f"({', '.join(f'{v:g}' for v in vector)})"


def plane_points(
    middle: Sequence[float] | NDArray[np.float64],
    right: Sequence[float] | NDArray[np.float64],
    down: Sequence[float] | NDArray[np.float64],
    pixel: tuple[float, float],
    size: tuple[int, int],
) -> NDArray[np.float64]:
    """World points at the centres of pixels; (height, width, 3)."""
    width, height = _counts(size)
    u = (np.arange(width) + 0.5 - width / 2) * pixel[0]
    v = (np.arange(height) + 0.5 - height / 2) * pixel[1]
    return np.asarray(
        np.asarray(middle) + v[:, None, None] * np.asarray(down, np.float64) + u[None, :, None] * np.asarray(right, np.float64)
    )


def shaded(
    values: NDArray[Any],
    volume: Volume,
    window: tuple[float, float] | None,
    cmap: str | None,
    background: Sequence[float] | None,
    transfer: TransferFunction | None = None,
) -> Picture:
    """Values in colours, (height, width, 4) float32; NaN is background, as are hidden labels. `transfer` excludes the words."""
    picture = np.zeros((*values.shape, 4), np.float32)
    if background is not None:
        picture[...] = (*background, 1)
    if transfer is None and volume.is_labels and window is None and cmap is None:
        transfer = TransferFunction.preset("labels", volume)
    if transfer is not None:
        lay(picture, [(values, transfer)])
        return Picture(picture)
    center, width = window_of_slices(volume) if window is None else window
    low = center - width / 2
    if not width > 0:
        raise OptionError(f"window must be (center, width), the width positive; got {window!r}")
    inside = ~np.isnan(values)
    share = np.clip((values[inside] - low) / width, 0, 1)
    if cmap is None:
        colors = share[..., None]
    else:
        table = TransferFunction.from_cmap(cmap, (0.0, 1.0))(np.linspace(0, 1, 1024))[:, :3]
        colors = table[np.rint(share * 1023).astype(np.intp)]
    picture[inside, :3], picture[inside, 3] = colors, 1
    return Picture(picture)


def window_of_slices(volume: Volume) -> tuple[float, float]:
    """The default window of slices: (center, width)."""
    if volume in _WINDOWS:
        return _WINDOWS[volume]
    if volume.clim is not None:
        low, high = volume.clim
    else:
        step = max(1, -(-volume.data.size // _SAMPLED))
        each = max(1, round(step ** (1 / 3)))
        some = volume.data[::each, ::each, ::each].astype(np.float64)
        low, high = np.quantile(some[np.isfinite(some)], _ENDS).tolist()
        if not low < high:
            low, high = volume.value_range
    if not low < high:
        low, high = low - 0.5, high + 0.5
    _WINDOWS[volume] = found = float(low / 2 + high / 2), float(high - low)
    return found


_WINDOWS: WeakKeyDictionary[Volume, tuple[float, float]] = WeakKeyDictionary()
