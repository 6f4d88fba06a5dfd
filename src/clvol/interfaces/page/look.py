"""What a page draws: the look as JSON, in units of the 16 bits of its coefficients, and what it cannot draw, by name."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from clvol.base.checks import warn
from clvol.base.errors import OptionError
from clvol.filter.table import as_filter
from clvol.interop.dispatch import is_in_parts
from clvol.march.slices import window_of_slices
from clvol.scene.clip import cuts_of
from clvol.scene.mode import CURVATURES, colored_by, opacities_of, outlined, virtual_samples
from clvol.scene.scene import ROUNDING, Medium, Scene, as_scene
from clvol.scene.transfer import TransferFunction
from clvol.spline.field import Field, resample
from clvol.volume.volume import Volume

if TYPE_CHECKING:
    from clvol.march.options import ResolvedLook
    from clvol.march.source import Source
    from clvol.scene.mode import Mode
    from clvol.spline.coefficients import Coefficients

__all__ = ["Scale", "look_of", "packed", "portraits_of", "reduced", "require_drawable"]

_MODES = ("composite", "isosurface", "surfaces", "mip", "minip")
_KERNELS = {"bspline3-approx": 3, "linear": 1, "nearest": 0}
_LARGEST = 512  # samples along an axis of a 3-D texture on phones, halo included
_HALO = 2
_TOP = 65535
_STEPS = 256  # of 16 bits, for what is shown
_MOST_CUTS = 16
_PORTRAITS = 16  # aspects below 1
_EDGE = 1e-9  # of a piece of a transfer function: what counts as its very beginning or end
_FAR = 1e30


class Scale(NamedTuple):
    """Values are `offset` and as many times `unit` as the 16 bits say."""

    offset: float
    unit: float

    def __call__(self, value: float) -> float:
        """The number of 16 bits, and beyond them."""
        return float(np.clip((value - self.offset) / self.unit, -_FAR, _FAR))


def reduced(scene: Any, most: int) -> Any:
    """A scene, or a volume, with at most so many samples along each axis of its medium's volume."""
    if isinstance(scene, Field):
        raise OptionError("most reduces volumes; a field's coefficients are drawn as they are")
    made: Scene = as_scene(scene)
    (medium, *_) = made.media
    volume = medium.volume
    if is_in_parts(volume) or max(volume.shape) <= most:
        return scene
    lengths = [n * apart for n, apart in zip(volume.shape, volume.spacing[::-1], strict=True)]
    apart = max(length / min(n, most) for n, length in zip(volume.shape, lengths, strict=True) if n > most)
    shape = [
        min(n, most, max(1, round(length / apart))) for n, length in zip(volume.shape, lengths, strict=True)
    ]  # thick slices stay
    how: dict[str, Any] = {"filter": "nearest"} if volume.is_labels else {"anti_aliasing": True}
    small = resample(volume, shape, dtype=volume.data.dtype if volume.is_labels else None, **how)
    kept = {name: getattr(volume, name) for name in ("clim", "color", "name", "header")}
    small = replace(small, **kept)
    if not isinstance(scene, Scene | Medium):
        return small  # whose filter and boundary may be given beside it
    return made.of_media([replace(medium, volume=small), *made.media[1:]])


def require_drawable(source: Source, mode: Mode, options: Mapping[str, Any]) -> None:
    """Raise `OptionError`, which names what a page cannot draw."""
    if source.by_bricks or not isinstance(source.field, Field):
        raise OptionError("a page holds all of its volume, which must be in memory: give its whole(), or a level of it")
    scene = source.scene
    shown = [medium for medium in scene.media if medium.visible]
    light = {name: options[name] if options.get(name) is not None else getattr(scene, name) for name in ("shadow", "occlusion")}
    filters = [medium.filter for medium in shown if medium.filter is not None]
    medium = scene.media[0]
    found = {
        f"several media ({len(shown)})": len(scene.media) != 1,
        "a medium that is not visible": not shown,
        f"mode {mode.name}": mode.name not in _MODES,
        "shadow": bool(light["shadow"]),
        "occlusion": bool(light["occlusion"]),
        "color_by": medium.color_by is not None or colored_by(mode) in (*CURVATURES, "distance"),
        "surfaces of a medium": medium.surfaces is not None,
        "smooth": medium.smooth,
        "outline": outlined(mode),
        'gradient="central"': options.get("gradient") == "central",
        "missing samples": source.field.gaps is not None,
    }
    _refuse([name for name, there in found.items() if there])
    for row in (*filters, source.field.filter, source.filter_of(mode)):
        if _degree(row) is None:
            raise OptionError(f"a page draws bspline3, {', '.join(_KERNELS)}; got filter {row.name}: choose one of them")
    size = max(source.field.grid.size) + 2 * _HALO
    if size > _LARGEST and "most" not in options:
        raise OptionError(
            f"a page holds at most {_LARGEST - 2 * _HALO} samples along an axis, as phones do; got shape "
            f"{source.field.grid.shape}: give most={_LARGEST // 2}, which reduces it without aliases"
        )


def _refuse(found: list[str]) -> None:
    if found:
        raise OptionError(f"a page cannot draw {' and '.join(found)}: leave that out, or draw a picture by clvol.render")


def _degree(row: Any) -> int | None:
    """The degree of the B-spline of a filter, whatever its prefilter; None of others."""
    if row.magnified_by is not None:
        return None
    return next((degree for name, degree in _KERNELS.items() if as_filter(name).taps == row.taps), None)


def packed(coefficients: Coefficients) -> tuple[bytes, Scale]:
    """The coefficients in 16 bits, all high bytes before all low ones, and what the bits stand for.

    Whole numbers of a range that 16 bits hold, by a filter without a prefilter, are themselves.
    """
    with coefficients.device.buffers.mapped(coefficients.buffer, coefficients.shape, write=False, kind=coefficients.kind) as room:
        stored = np.array(room[_kept(coefficients)])
    low, high = float(stored.min()), float(stored.max())
    even = not coefficients.filter.prefilter and high - low <= _TOP and bool((stored == np.rint(stored)).all())
    unit = 1.0 if even or high == low else (high - low) / _TOP
    numbers = np.rint((stored - low) / unit).astype(np.uint16)
    exponent = coefficients.stored.exponent
    scale = Scale(math.ldexp(low, exponent) + coefficients.stored.offset, math.ldexp(unit, exponent))
    return (numbers >> 8).astype(np.uint8).tobytes() + (numbers & 255).astype(np.uint8).tobytes(), scale


def _kept(coefficients: Coefficients) -> tuple[slice, ...]:
    """Those that the page gets: without the halo where that follows by the boundary rule."""
    past = _HALO if coefficients.pad else 0
    return tuple(slice(inside.start - past, inside.stop + past) for inside in coefficients.inner)


def look_of(
    look: ResolvedLook, step: float, coefficients: Coefficients, scale: Scale, portraits: list[list[float]]
) -> dict[str, Any]:
    """The look of a page: all that it draws, beside the coefficients; `portraits` are those of its camera."""
    scene, mode, transfer, medium = look.scene, look.mode, look.transfer, look.scene.media[0]
    if transfer.graded:
        _refuse(["gradient_opacity, curvature_opacity or a transfer function of two variables"])
    cuts, volume = cuts_of(look.clip), coefficients.volume
    if cuts.corners:
        _refuse(["corners that are cut away"])
    unit, inverse, matrix = volume.mean_spacing, volume.world_to_index_matrix, volume.index_to_world_matrix
    names = volume.is_labels and not coefficients.filter.has_gradient
    if names and mode.shows == "surface":
        _refuse([f"mode {mode.name} of labels"])
    values, shown = _values(mode, transfer)
    if shown / scale.unit < _STEPS and not names:
        warn(
            f"what is shown spans {shown:.3g}, {shown / scale.unit:.0f} steps of the page's 16 bits: cut off what is far outside it"
        )
    first, last = medium.domain
    steepest = float(np.linalg.norm(inverse, 2)) * unit
    view, target = look.camera.view(volume, 1.0), look.camera.target
    material = medium.material.block(linear=look.linear)
    cap = getattr(mode, "cap", False)
    background = scene.background
    lights = scene.lights if mode.shaded else ()
    return {
        "mode": "surfaces" if mode.shows == "surface" else mode.name,
        "filter": _degree(coefficients.filter),
        "names": names,
        "linear": look.linear,
        "shaded": mode.shaded,
        "stored": [inside.stop - inside.start for inside in _kept(coefficients)[::-1]],
        "halo": _halo(coefficients),
        "beyond": 0 if coefficients.boundary.beyond is None else round(np.clip(scale(coefficients.boundary.beyond), 0, _TOP)),
        "offset": scale.offset,
        "scale": scale.unit,
        "size": list(volume.size),
        "spacing": list(volume.spacing),
        "unit": unit,
        "origin": list(volume.origin),
        "center": volume.center.tolist(),
        "toIndex": inverse.ravel().tolist(),
        "toWorld": (matrix / unit).ravel().tolist(),
        "step": _step(mode, step),
        "camera": {
            "eye": view.eye.tolist(),
            "right": view.right.tolist(),
            "up": view.up.tolist(),
            "forward": view.forward.tolist(),
            "half": view.half_height,
            "orthographic": view.orthographic,
            "target": list(map(float, volume.center if target is None else target)),
            "pole": [0, 0, -1 if volume.space == "image" else 1],
            "portraits": portraits,
        },
        "lights": [[light.direction, light.color, light.frame == "camera"] for light in lights if light.direction is not None],
        "cuts": _cuts(cuts, volume),
        "background": [0, 0, 0, 0] if background is None else [*background, 1],
        "pieces": _pieces(transfer, scale),
        "surfaces": [[scale(value), [*color, opacity]] for value, color, opacity in values],
        "window": [scale(end) for end in _ends(window_of_slices(volume))],
        "slices": _slices(volume),
        "uniforms": {
            "toWorld": (matrix / unit).ravel().tolist(),
            "toSlope": (inverse.T * unit).ravel().tolist(),
            "low": first.tolist(),
            "high": last.tolist(),
            "cutLeast": 0.01,
            "material": [float(material[name]) for name in ("ambient", "diffuse", "specular", "shininess")],
            "ahead": np.sum([light.color for light in lights if light.direction is None] or [(0, 0, 0)], axis=0).tolist(),
            "zero": scale(0.0),
            "rounding": [0, 0] if names else [0.5 * steepest, ROUNDING * steepest],
            "perUnit": unit / (transfer.unit_distance or unit),
            "termination": getattr(mode, "termination", 0.0),
            "faces": mode.capped,
            "cap": int(cap) if isinstance(cap, bool | np.bool_) else 0 if cap is None else 2,
            "capColor": [0, 0, 0] if isinstance(cap, bool | np.bool_) or cap is None else list(cap),
        },
    }


def portraits_of(look: ResolvedLook) -> list[list[float]]:
    """How far an open camera moves back, and up, for pictures of k / 16 of their height in width, k = 1 to 16.

    Their width must hold what is seen. The first number is times the aspect, by which it is nearly constant.
    """
    square, rows = look.view((1, 1)), []
    for k in range(1, _PORTRAITS + 1):
        by = look.view((k, _PORTRAITS)).eye - square.eye
        rows.append([float(-by @ square.forward) * k / _PORTRAITS, float(by @ square.up)])
    return rows


def _step(mode: Mode, step: float) -> float:
    """Voxels between samples; virtual ones are samples, too."""
    return min(step, 0.5) if mode.shows == "surface" else step / (1 + virtual_samples(mode))


def _values(mode: Mode, transfer: TransferFunction) -> tuple[list[tuple[float, Any, float]], float]:
    """The surfaces of a settled mode, value, colour and opacity; and the span of values that is told apart."""
    if mode.shows != "surface":
        low, high = transfer.value_range
        return [], high - low
    colors = [one[1] for one in getattr(mode, "surfaces", None) or [(0, getattr(mode, "color", None))]]
    return list(zip(mode.isovalues, colors, opacities_of(mode), strict=True)), math.inf


def _halo(coefficients: Coefficients) -> list[list[int]]:
    """Of each axis, x first, which stored coefficient stands in each place of the texture; -1 for the constant outside."""
    around = []
    for axis in range(3):
        n = int(coefficients.size[axis])
        places = np.arange(-_HALO, n + _HALO)
        found = places + _HALO if coefficients.pad else np.maximum(coefficients.boundary.index(places, n), -1)
        around.append(found.tolist())
    return around


def _pieces(transfer: TransferFunction, scale: Scale) -> list[list[Any]]:
    """A transfer function piece by piece: where it begins, how long it is, colour and opacity there and at its end."""
    at = sorted({point[0] for point in (*transfer.colors, *transfer.opacities)})
    inner = [(a, a + _EDGE * (b - a), b - _EDGE * (b - a)) for a, b in itertools.pairwise(at)]
    before, after = (at[0] - 1.0 - abs(at[0]),) * 2, (at[-1] + 1.0 + abs(at[-1]),) * 2
    ends = transfer([*itertools.chain(before, *((first, last) for _, first, last in inner), after)]).tolist()
    starts = [-_FAR, *(scale(value) for value in at)]
    lengths = [1.0, *(max(b - a, 1e-20) for a, b in itertools.pairwise(starts[1:])), 1.0]
    return [[start, length, *ends[2 * k : 2 * k + 2]] for k, (start, length) in enumerate(zip(starts, lengths, strict=True))]


def _cuts(cuts: Any, volume: Volume) -> list[list[float]]:
    """The planes of all cuts in samples: normal and offset; what lies beyond is cut away."""
    planes = [(np.asarray(plane.normal, float), np.asarray(plane.point, float)) for plane in cuts.planes]
    if cuts.box is not None:
        for corner, side in zip(cuts.box, (-1.0, 1.0), strict=True):
            planes += [(side * np.eye(3)[i], corner[i] * np.eye(3)[i]) for i in range(3) if math.isfinite(corner[i])]
    if len(planes) > _MOST_CUTS:
        _refuse([f"more than {_MOST_CUTS} faces of cuts ({len(planes)})"])
    matrix, origin = volume.index_to_world_matrix, np.asarray(volume.origin)
    return [[*(matrix.T @ normal).tolist(), float(normal @ (point - origin))] for normal, point in planes]


def _ends(window: tuple[float, float]) -> tuple[float, float]:
    center, width = window
    return center - width / 2, center + width / 2


def _slices(volume: Volume) -> list[list[Any]]:
    """Slices across the volume's axes: name, axis, and which axis runs to the right and down, each with its sign.

    As those of patients are seen from the feet, from the front and from the left.
    """
    direction = np.asarray(volume.direction)
    order = max(itertools.permutations(range(3)), key=lambda own: sum(abs(direction[world, own[world]]) for world in range(3)))
    names = ("sagittal", "coronal", "axial") if volume.space == "LPS" else ("across x", "across y", "across z")
    down = 1 if volume.space == "image" else -1  # whether z points down

    def way(world: int, sign: int) -> list[int]:
        return [order[world], sign if direction[world, order[world]] > 0 else -sign]

    return [
        [names[2], order[2], *way(0, 1), *way(1, 1)],
        [names[1], order[1], *way(0, 1), *way(2, down)],
        [names[0], order[0], *way(1, 1), *way(2, down)],
    ]
