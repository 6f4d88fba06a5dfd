"""Three slices through a point and the 3-D picture, in one picture."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base.arrays import reals
from clvol.base.checks import if_image, number, one_of
from clvol.base.color import color_of
from clvol.base.errors import GeometryError, OptionError
from clvol.base.progress import Progress, part_of
from clvol.march.bricks import level_within
from clvol.march.choose import as_drawn, source_of
from clvol.march.contours import contour_width
from clvol.march.options import FieldOptions, PanelOptions, PictureOptions, as_size, chosen_mode, covering, transfer_of
from clvol.march.renderer import Renderer
from clvol.march.slices import AXES, Sheet, axis_directions, has_smooth_labels, lay_over, section, window_of_slices
from clvol.scene.mode import DEFAULT_MODE, as_mode
from clvol.show.picture import Picture

if TYPE_CHECKING:
    from clvol.bricks.source import LazyVolume
    from clvol.march.contours import Shown
    from clvol.march.source import Source
    from clvol.scene.mode import Mode
    from clvol.scene.scene import Medium, Scene
    from clvol.scene.transfer import TransferFunction
    from clvol.volume.volume import Volume
    from clvol.volume.volumes import Volumes

__all__ = ["ORIENTATIONS", "OrthogonalOptions", "orthogonal"]

ORIENTATIONS = {"radiological": "the patient's right is on the left", "neurological": "the patient's right is on the right"}
_GAP = 4  # pixels between the panes
_BETWEEN = 0.25  # their grey
_MARGIN = 1.04
_CROSSHAIR = "#ffd24a"
_FREE = 0.02  # of a pane's shorter side: what a crosshair leaves free to either side of the point
_LINE = 512  # pixels of a pane's shorter side for one pixel of a line's width


class OrthogonalOptions(PanelOptions, PictureOptions, FieldOptions, total=False):
    """Options of `clvol.orthogonal`, beside those of the 3-D picture and of the volume's function.

    Attributes
    ----------
    window, cmap
        Of the slices alone, as of `clvol.slice`. The 3-D picture has the look of its mode, which `preset`, `opacity` and `transfer`
        change.
    thickness : float
        Of slabs instead of slices, as of `clvol.slice`.
    slab : {"mean", "mip", "minip"}
        What these show.
    smooth : bool
        Whether labels on slices have smooth boundaries, as of `clvol.slice`: the curves in which the slices cut the boundaries of
        mode "regions". By default those of the picture have them that this mode draws. Labels then have the colours and opacities
        of the 3-D picture.
    contour : float
        Lines along the boundaries of labels, instead of their areas, as of `clvol.slice`.
    progress : callable
        Called with the fraction done.
    """

    thickness: float
    slab: Literal["mean", "mip", "minip"] | None
    smooth: bool | None
    contour: float
    progress: Progress | None


def orthogonal(
    volume: Volume | LazyVolume | Scene | Medium | Volumes | ArrayLike,
    point: Sequence[float] | None = None,
    size: tuple[int, int] = (1024, 1024),
    *,
    crosshair: bool | str | Sequence[float] = False,
    orientation: Literal["radiological", "neurological"] | None = None,
    **options: Unpack[OrthogonalOptions],
) -> Picture:
    """Three slices through a point, across the axes of the world, and the 3-D picture: 2 × 2 in one picture.

    Above the slice across z (axial) and the 3-D picture, below those across y (coronal) and x (sagittal), at one scale, so that
    what lies in one column or row of slices is at one place in the world. They follow the volume's direction: an oblique volume is
    cut along the world's axes, not along its samples.

    Parameters
    ----------
    volume : Volume, LazyVolume, Scene, Medium, Volumes or array-like, 3-D
        As of `clvol.slice`. The slices of a scene are those of its first medium, with the matter of its other visible media over
        it, as `over` of `clvol.slice` lays it, whatever their order; labels as areas or, with `contour`, as lines. Surfaces and
        cuts of media, and what colours one, are in the 3-D picture alone.
    point : (x, y, z), optional
        The world point; by default the middle of the volume.
    size : (width, height)
        Of the whole picture, in pixels; at least 8 × 8.
    crosshair : bool or colour
        Whether lines show the place of each slice in the others, and in which colour.
    orientation : {"radiological", "neurological"}, optional
        Of a patient, whose directions are known (`Volume.space` is "LPS"): "radiological", the default, has the patient's right on
        the left, as seen from the front and from the feet; "neurological" on the right, as seen from behind and from the head.
        Slices from the side have the front on the left in both.
    **options
        Those of `OrthogonalOptions`, and of `clvol.render` for the 3-D picture: `camera`, `mode`, `preset`, `filter`, ...

    Returns
    -------
    Picture, an ndarray of float32, shape (height, width, 4)

    Raises
    ------
    OptionError
        An option is unknown or changes nothing; `orientation` of what is no patient; the volume does not have three axes; `smooth`
        or `contour` where no medium is of labels.
    GeometryError
        The point is not in the volume.
    ClvolError
        As by `clvol.slice` and `clvol.render`.

    Examples
    --------
    >>> import clvol
    >>> ball = clvol.phantoms.sphere(24)
    >>> clvol.orthogonal(ball, (0.1, 0, 0.2), (80, 60), crosshair=True, mode="isosurface").shape
    (60, 80, 4)
    """
    given: dict[str, Any] = {**options}
    slices: dict[str, Any] = {name: given.pop(name) for name in ("window", "cmap", "thickness") if name in given}
    slab, progress = given.pop("slab", None), given.pop("progress", None)
    thickness = number("thickness", slices.get("thickness", 0.0), minimum=0)
    smooth, contour = given.pop("smooth", None), contour_width(given.pop("contour", 0.0), thickness)
    slices |= {"mode": slab, "background": given.get("background", (0.0, 0.0, 0.0))}
    held = {name: given.pop(name) for name in FieldOptions.__annotations__ if name in given}
    camera, mode, step = given.pop("camera", None), given.pop("mode", DEFAULT_MODE), given.pop("step", None)
    chosen = chosen_mode(mode, given, scene=volume)
    width, height = as_size(size)
    if min(width, height) < 2 * _GAP:
        raise OptionError(f"size must be at least {2 * _GAP} × {2 * _GAP}; got {width} × {height}")
    drawn = as_drawn(volume, held.pop("mask", None))
    grid = drawn.grid
    if grid.ndim != 3:
        raise OptionError(f"volume must have 3 axes; got shape {grid.shape}{if_image(grid.shape)}")
    left = _is_mirrored(orientation, grid)
    at = _inside(point, grid)
    color = color_of("crosshair", _CROSSHAIR if isinstance(crosshair, bool) else crosshair)
    columns, rows = ((n - _GAP) // 2 for n in (width, height))
    sizes = {"z": (columns, rows), "y": (columns, height - _GAP - rows), "x": (width - _GAP - columns, height - _GAP - rows)}
    extents = np.ptp(grid.corners, axis=0)
    frames = {name: axis_directions(grid.space, AXES.index(name)) for name in sizes}
    pixel = _MARGIN * max(
        float(extents @ np.abs(way)) / n for name in sizes for way, n in zip(frames[name], sizes[name], strict=True)
    )
    known = drawn.preview()
    if slices.get("window") is None and not (known.is_labels and slices.get("cmap") is None):
        slices["window"] = window_of_slices(known)
    panes: dict[str, NDArray[Any]] = {}
    source = source_of(drawn, **held)
    with Renderer(source) as renderer:
        by_slab = as_mode(slab if slab in ("mip", "minip") else DEFAULT_MODE)
        first, *others = (_layer(source, one, by_slab, pixel, smooth, chosen) for one in _on_slices(source.scene))
        named = {"smooth": smooth, "contour": contour}
        if any(named.values()) and not any(one.labels for one in (first, *others)):
            words = " and ".join(name for name, value in named.items() if value)
            raise OptionError(f"{words} is for labels: Volume(..., labels=True) says that samples are some; got {known!r}")
        if first.smooth and slices.get("window") is None and slices.get("cmap") is None:
            slices["transfer"] = source.scene.media[0].transfer or transfer_of(known, chosen, given | source.scene.media[0].words)
        for i, (name, (right, down)) in enumerate(frames.items()):
            right = -right if left and name in "zy" else right
            middle = np.array(grid.center)
            middle[AXES.index(name)] = at[AXES.index(name)]
            own: dict[str, Any] = slices | {"progress": part_of(progress, i / 10, (i + 1) / 10)}
            place = middle, right, down, (pixel, pixel), sizes[name]
            panes[name] = section(first.shown, *place, **own, contour=contour if first.labels else 0.0)
            sheets = [Sheet.of(*place, own | {"contour": contour if other.labels else 0.0}) for other in others]
            layers = [(other.shown, other.transfer, sheet) for other, sheet in zip(others, sheets, strict=True)]
            lay_over(panes[name], layers, own["progress"])
            if crosshair is not False:
                offset = np.array([(at - middle) @ right, (at - middle) @ down]) / pixel
                _draw_lines(panes[name], offset + np.array(sizes[name]) / 2, color)
        shown = width - _GAP - columns, rows
        panes["3d"] = renderer.render(camera, mode, shown, step, progress=part_of(progress, 0.3, 1.0), **given)
    picture = np.full((height, width, 4), (_BETWEEN, _BETWEEN, _BETWEEN, 1), np.float32)
    picture[:rows, :columns], picture[:rows, columns + _GAP :] = panes["z"], panes["3d"]
    picture[rows + _GAP :, :columns], picture[rows + _GAP :, columns + _GAP :] = panes["y"], panes["x"]
    return Picture(picture)


class _Layer(NamedTuple):
    """What slices show of a medium."""

    shown: Shown
    transfer: TransferFunction  # of what it looks like over others
    labels: bool
    smooth: bool


def _on_slices(scene: Scene) -> tuple[Medium, ...]:
    """The media of a scene that slices show, the first one first."""
    first, *others = scene.media
    return first, *(one for one in others if one.visible and not one.surfaces)


def _layer(source: Source, medium: Medium, by_slab: Mode, pixel: float, smooth: bool | None, mode: Mode) -> _Layer:
    """The function of a medium, of a level as fine as pixels; or the smooth regions of its labels."""
    part = source.part(medium)
    transfer = medium.transfer or covering(part.preview, medium.words)
    if has_smooth_labels(medium, smooth, mode.regions):
        return _Layer(part.regions(), transfer, True, True)
    volume: Any = part.field.volume
    level = level_within(volume, pixel) if part.by_bricks else 0
    return _Layer(part.function(by_slab, level), transfer, part.preview.is_labels, False)


def _is_mirrored(orientation: str | None, grid: Volume) -> bool:
    """Whether slices are seen from behind and from the head."""
    if orientation is None:
        return False
    if orientation not in ORIENTATIONS:
        raise one_of("orientation", orientation, ORIENTATIONS)
    if grid.space != "LPS":
        raise OptionError(f"orientation is of a patient, whose space is 'LPS'; got {orientation!r} for space {grid.space!r}")
    return orientation == "neurological"


def _inside(point: Sequence[float] | None, grid: Volume) -> NDArray[np.float64]:
    """The point, by default the middle; `GeometryError` if it is not in the volume."""
    if point is None:
        return grid.center
    at = reals("point", point, "three numbers (x, y, z)", GeometryError)
    index = grid.world_to_index(at) if at.shape == (3,) else at
    if at.shape != (3,) or not ((index >= -0.5) & (index <= np.asarray(grid.size) - 0.5)).all():
        low, high = grid.corners.min(0), grid.corners.max(0)
        ends = ", ".join(f"{name} {a:g} to {b:g}" for name, a, b in zip(AXES, low, high, strict=True))
        raise GeometryError(f"point must be (x, y, z) in the volume, whose corners are within {ends}; got {point!r}")
    return at


def _draw_lines(pane: NDArray[Any], at: NDArray[np.float64], color: tuple[float, float, float]) -> None:
    """Draw the lines of a crosshair, which leave its middle free."""
    height, width = pane.shape[:2]
    wide, free = max(1, round(min(height, width) / _LINE)), max(2, round(_FREE * min(height, width)))
    x, y = (int(np.floor(v - (wide - 1) / 2)) for v in at)
    for lines, one, other in ((pane, y, x), (np.swapaxes(pane, 0, 1), x, y)):
        across = np.s_[max(0, one) : max(0, one + wide)]
        for part in (np.s_[: max(0, other - free)], np.s_[max(0, other + wide + free) :]):
            lines[across, part] = (*color, 1)
