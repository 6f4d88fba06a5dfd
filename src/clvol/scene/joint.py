"""Transfer functions of two numbers: the value, and how steep the function is there."""

from __future__ import annotations

import base64
import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any, NoReturn, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base.arrays import reals
from clvol.base.checks import as_object, number, suggests_options, whole
from clvol.base.color import color_of
from clvol.base.errors import OptionError
from clvol.base.srgb import as_light
from clvol.base.uniform import FLOAT, INT, Block, Values
from clvol.scene.factor import Factors
from clvol.scene.transfer import TransferFunction, previewed
from clvol.volume.histogram import slopes_of
from clvol.volume.stored import AS_THEY_ARE, Stored
from clvol.volume.volume import Volume

__all__ = ["JOINT", "Image", "TransferFunction2D", "joint_block", "opacity_at"]

JOINT = Block("joint_block", at=INT, columns=INT, rows=INT, low=FLOAT, scale=FLOAT, per_slope=FLOAT)

Color: TypeAlias = tuple[float, float, float]
_BoxShape: TypeAlias = tuple[tuple[float, float], tuple[float, float], Color, float]
_Arch: TypeAlias = tuple[tuple[float, float], float, Color, float]
_COLUMNS, _ROWS = 256, 128  # nodes that shapes are drawn into
_PARTS = 4  # of the values of matter, each a box of the automatic function
_STEEP = 4  # part of the way from even matter to its boundaries, from which on those boxes are
_ROOM = 0.02  # of their extent, left free around shapes
_MOST_NODES = 1024  # along a side
_MOST_SHAPES = 32
_FINEST = 1e38  # most rows a unit of slope
_WIDTH = 0.3  # of its peak, from an arch to where nothing is left of its opacity


@dataclass(frozen=True)
class Image:
    """Colours and opacities at equally spaced nodes, row by row from steepness 0 up, each from the smallest value to the largest.

    `pixels` are float32 numbers of shape (rows, columns, 4); `values` those of the first and the last column, `steepest` the
    magnitude of gradients of the last row.
    """

    pixels: bytes = field(repr=False)
    shape: tuple[int, int]
    values: tuple[float, float]
    steepest: float

    @classmethod
    def of(cls, array: ArrayLike, values: object, steepest: object) -> Image:
        """That of an array [steepness, value, (red, green, blue, opacity)]; `OptionError` if it is none."""
        rule = f"numbers in 0..1 of shape (rows, columns, 4), 2 to {_MOST_NODES} rows and columns"
        given = reals("image", array, rule)
        if given.ndim != 3 or given.shape[2] != 4 or not all(2 <= n <= _MOST_NODES for n in given.shape[:2]):
            raise OptionError(f"image must be {rule}; got shape {given.shape}")
        if count := np.count_nonzero(np.isnan(given)):
            raise OptionError(f"image must be {rule}; got NaN for {count} of {given.size} numbers")
        if not ((given >= 0) & (given <= 1)).all():
            raise OptionError(f"image must be {rule}; got {given.min():g} to {given.max():g}")
        low, high = _span("values of an image", values)
        most = number("the largest gradient of an image", steepest, above=0)
        return cls(given.astype(np.float32).tobytes(), (given.shape[0], given.shape[1]), (low, high), most)

    @classmethod
    def of_json(cls, given: Any) -> Image:
        """That of a value of `json`; `OptionError` if it is none."""
        known = as_object("image", given, {"pixels", "shape", "values", "steepest"})
        try:
            rows, columns = (whole("rows and columns of an image", n, 2, _MOST_NODES) for n in known["shape"])
            packed, size = base64.b64decode(known["pixels"], validate=True), 16 * rows * columns
            pixels = zlib.decompressobj().decompress(packed, size)  # no more, whatever a text says
            return cls.of(np.frombuffer(pixels, "<f4").reshape(rows, columns, 4), known["values"], known["steepest"])
        except (KeyError, TypeError, ValueError, zlib.error) as error:
            if isinstance(error, OptionError):
                raise
            raise OptionError(f"image must be one that clvol wrote; {error!s:.120}") from None

    def json(self) -> dict[str, Any]:
        """A value for `json.dumps`."""
        return {"pixels": self.text, "shape": list(self.shape), "values": list(self.values), "steepest": self.steepest}

    @cached_property
    def text(self) -> str:
        """The numbers, in little-endian order, compressed, in base64."""
        return base64.b64encode(zlib.compress(self.array.astype("<f4").tobytes())).decode()

    @cached_property
    def array(self) -> NDArray[np.float32]:
        """The numbers, (rows, columns, 4)."""
        return np.frombuffer(self.pixels, np.float32).reshape(*self.shape, 4)


@suggests_options
@dataclass(frozen=True)
class TransferFunction2D(TransferFunction):
    """Colour and opacity by the value and the magnitude of the gradient, so that boundaries between materials are told apart.

    Parameters
    ----------
    boxes : sequence of ((value, value), (gradient, gradient), color, opacity)
        Values, and magnitudes of the gradient in units of the data per world unit, that have a colour and an opacity; a largest
        magnitude of None, or infinity, is no limit.
    arches : sequence of ((value, value), peak, color, opacity)
        Boundaries between two materials of these values. In the plane of values and gradients a blurred step lies on an arch: from
        no slope at the one value, over the `peak` in the middle, the largest magnitude, to none at the other. Opacity is largest on
        the arch, and falls to 0 three tenths of the peak to either side and at places without slope.
    image : (array, (value, value), gradient) or dict, optional
        In place of shapes, colours and opacities of shape (rows, columns, 4) at equally spaced nodes: rows from magnitude 0 to
        `gradient`, columns between the values; up to 1024 each. What lies outside has those of the edge. A dict is the "image" of
        the function's `json`, as programs have it that a viewer copies.
    unit_distance, gradient_opacity, curvature_opacity : optional
        As of `TransferFunction`, by name.

    Raises
    ------
    OptionError
        There are no shapes and no image, or both; more than 32 shapes; a box or an arch is narrower than the nodes that shapes are
        drawn into are apart, a 245th of the values and a 122nd of the magnitudes of all shapes.

    Notes
    -----
    Shapes are drawn into 256 × 128 nodes, between which the function is bilinear (of colours times opacity); where several overlap,
    the most opaque one counts. The image and the arches are those of Kniss, Kindlmann and Hansen (2002) and of Kindlmann and Durkin
    (1998).

    References
    ----------
    - J. Kniss, G. Kindlmann and C. Hansen, "Multidimensional transfer functions for interactive volume rendering", IEEE
      Transactions on Visualization and Computer Graphics 8(3), 2002, 270–285.
    - G. Kindlmann and J. W. Durkin, "Semi-automatic generation of transfer functions for direct volume rendering", IEEE
      Symposium on Volume Visualization, 1998, 79–86.

    Examples
    --------
    >>> import clvol
    >>> volume = clvol.phantoms.sphere(16)
    >>> edges = clvol.TransferFunction2D([((0.2, 0.8), (0.05, None), "gold", 0.6)])
    >>> picture = clvol.render(volume, transfer=edges, size=(64, 64))
    """

    colors: tuple[tuple[float, Color], ...] = field(init=False, repr=False, compare=False)
    opacities: tuple[tuple[float, float], ...] = field(init=False, repr=False, compare=False)
    unit_distance: float | None = field(default=None, kw_only=True)
    gradient_opacity: Factors | None = field(default=None, kw_only=True)
    curvature_opacity: Factors | None = field(default=None, kw_only=True)
    boxes: Sequence[Any] = ()  # tuples of _BoxShape and _Arch, once made
    arches: Sequence[Any] = ()
    image: Image | None = None

    def __post_init__(self) -> None:
        boxes, arches = (self._shapes(what) for what in ("boxes", "arches"))
        object.__setattr__(self, "boxes", tuple(map(_box, boxes)))
        object.__setattr__(self, "arches", tuple(map(_arch, arches)))
        if self.image is not None and not isinstance(self.image, Image):
            object.__setattr__(self, "image", _given_image(self.image))
        count = len(self.boxes) + len(self.arches)
        if (self.image is None) != (1 <= count <= _MOST_SHAPES):
            raise OptionError(
                f"a TransferFunction2D takes 1 to {_MOST_SHAPES} boxes and arches, or an image in place of them; got {count} and "
                f"{'no image' if self.image is None else 'an image'}"
            )
        # by value alone, the largest opacity and its colour: none is larger between nodes, so space can be skipped by values
        array = self.nodes.array
        most = array[..., 3].argmax(0)
        shades = array[most, np.arange(array.shape[1])].astype(np.float64)
        places = np.linspace(*self.nodes.values, array.shape[1]).tolist()
        object.__setattr__(self, "colors", tuple(zip(places, map(tuple, shades[:, :3].tolist()), strict=True)))
        object.__setattr__(self, "opacities", tuple(zip(places, shades[:, 3].tolist(), strict=True)))
        super().__post_init__()

    def _shapes(self, what: str) -> Sequence[Any]:
        given: Any = getattr(self, what)
        if not isinstance(given, (list, tuple)) or any(not isinstance(one, (list, tuple)) or len(one) != 4 for one in given):
            raise OptionError(f"{what} must be a sequence of four things each; got {given!r:.200}")
        return given

    @classmethod
    def automatic(cls, volume: Volume | ArrayLike, clim: tuple[float, float] | None = None) -> TransferFunction2D:
        """The colours and opacities of `TransferFunction.automatic`, in a few boxes over the boundaries of the volume's matter."""
        volume = previewed(volume)
        by_value, (even, steep) = TransferFunction.automatic(volume, clim), slopes_of(volume)
        low, high = by_value.value_range
        ends = np.linspace(low, high if low < high else low + 1.0, _PARTS + 1)
        spans = list(zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True))
        looks = by_value(ends[:-1] / 2 + ends[1:] / 2).tolist()
        boxes = [
            (span, (even + (steep - even) / _STEEP, None), look[:3], look[3])
            for span, look in zip(spans, looks, strict=True)
            if look[3]
        ]
        return cls(boxes or [(spans[-1], (0.0, None), looks[-1][:3], 1.0)], unit_distance=by_value.unit_distance)

    @classmethod
    def _by_value(cls, *_: Any, **__: Any) -> NoReturn:
        raise OptionError(
            "a TransferFunction2D is made of boxes, arches or an image, or by automatic; from_cmap, ramp and preset are of "
            "TransferFunction, whose gradient_opacity= depends on the gradient too"
        )

    from_cmap = ramp = preset = _by_value

    @property
    def graded(self) -> int:
        return super().graded + 4

    @cached_property
    def nodes(self) -> Image:
        """Colours and opacities at nodes, between which the function is bilinear."""
        return self.image or _drawn(self.boxes, self.arches)

    def table(self, stored: Stored = AS_THEY_ARE, *, linear: bool = False) -> NDArray[np.float32]:
        own = super().table(stored, linear=linear)
        return np.concatenate([own, np.zeros(-own.size % 4, np.float32), _rows(self.nodes, linear)])

    def json(self) -> dict[str, Any]:
        boxes = [[list(span), [bottom, top if math.isfinite(top) else None], list(color), seen]
                 for span, (bottom, top), color, seen in self.boxes]  # fmt: skip
        arches = [[list(span), peak, list(color), seen] for span, peak, color, seen in self.arches]
        shapes = {"boxes": boxes, "arches": arches} if self.image is None else {"image": self.image.json()}
        return shapes | self._shared_json()

    def with_opacity(self, opacities: Sequence[tuple[float, float]]) -> TransferFunction:
        raise OptionError(f"opacity changes nothing of a TransferFunction2D, whose shapes have their own; got {opacities!r:.80}")


@lru_cache(8)  # a moving camera changes no node
def _rows(nodes: Image, linear: bool) -> NDArray[np.float32]:
    """What kernels read of nodes: colours times opacity, and of how many that are seen there are before each."""
    array = nodes.array.copy()
    array[..., :3] = (as_light(array[..., :3]) if linear else array[..., :3]) * array[..., 3:]
    before = np.zeros((array.shape[0] + 1, array.shape[1] + 1), np.float32)
    before[1:, 1:] = (array[..., 3] > 0).cumsum(0).cumsum(1)
    return np.concatenate([array.ravel(), before.ravel()])


def joint_block(transfer: TransferFunction, stored: Stored, scale: float, *, linear: bool) -> Values:
    """The block of a function's image for kernels, whose gradients are `scale` times those of stored values in the world."""
    if not isinstance(transfer, TransferFunction2D):
        return np.zeros((), JOINT.dtype)
    image, (low, high) = transfer.nodes, (float(v) for v in stored(np.array(transfer.nodes.values)))
    rows, columns = image.shape
    own = TransferFunction.table(transfer, stored, linear=linear).size
    with np.errstate(all="ignore"):
        per_slope = min(float((rows - 1) / (np.ldexp(image.steepest, -stored.exponent) * scale)), _FINEST)
    return JOINT(at=-(-own // 4), columns=columns, rows=rows, low=low, scale=(columns - 1) / (high - low), per_slope=per_slope)


def opacity_at(transfer: TransferFunction, values: NDArray[Any], steepness: NDArray[np.float64]) -> NDArray[np.float64]:
    """Opacity by value and by magnitude of the gradient, in units of the data per world unit; without the factor of curvature."""
    seen = transfer(values)[..., 3]
    if isinstance(transfer, TransferFunction2D):
        from scipy.ndimage import map_coordinates

        image, (low, high) = transfer.nodes, transfer.nodes.values
        place = np.stack([steepness / image.steepest, (values.astype(np.float64) - low) / (high - low)])
        ends = np.reshape(image.shape, (2, *[1] * values.ndim)) - 1
        seen = map_coordinates(image.array[..., 3], np.clip(place, 0, 1) * ends, np.float64, order=1, mode="nearest")
    if transfer.gradient_opacity is not None:
        seen = seen * np.interp(steepness, *np.array(transfer.gradient_opacity).T)
    return np.asarray(seen)


# -- shapes ------------------------------------------------------------------------------------------------------


def _span(what: str, given: Any, *, minimum: float | None = None) -> tuple[float, float]:
    try:
        low, high = given
    except (TypeError, ValueError):
        raise OptionError(f"{what} must be (low, high); got {given!r:.80}") from None
    bottom = number(what, low, minimum=minimum)
    top = math.inf if minimum is not None and high in (None, math.inf) else number(what, high)
    if not bottom < top:
        raise OptionError(f"{what} must be (low, high) in ascending order; got {given!r:.80}")
    return bottom, top


def _box(given: Sequence[Any]) -> _BoxShape:
    values, slopes, color, opacity = given
    shade = color_of("a box's color", color)
    seen = number("a box's opacity", opacity, minimum=0, maximum=1)
    return _span("values of a box", values), _span("gradients of a box", slopes, minimum=0), shade, seen


def _arch(given: Sequence[Any]) -> _Arch:
    values, peak, color, opacity = given
    shade = color_of("an arch's color", color)
    seen = number("an arch's opacity", opacity, minimum=0, maximum=1)
    return _span("values of an arch", values), number("the peak of an arch", peak, above=0), shade, seen


def _given_image(given: Any) -> Image:
    if isinstance(given, dict):
        return Image.of_json(given)
    try:
        array, values, steepest = given
    except (TypeError, ValueError):
        raise OptionError(f"image must be (array, (value, value), gradient); got {given!r:.80}") from None
    return Image.of(array, values, steepest)


def _drawn(boxes: Sequence[_BoxShape], arches: Sequence[_Arch]) -> Image:
    """Shapes as an image, whose edge is transparent but for what reaches to infinity."""
    spans = [box[0] for box in boxes] + [arch[0] for arch in arches]
    peaks = [arch[1] * (1 + _WIDTH) for arch in arches]
    tops = [end for box in boxes for end in box[1] if math.isfinite(end)] + peaks
    low, high = min(a for a, _ in spans), max(b for _, b in spans)
    room, steepest = _ROOM * (high - low), (1 + _ROOM) * (max(tops) or 1.0)
    values = np.linspace(low - room, high + room, _COLUMNS)
    slopes = np.linspace(0, steepest, _ROWS)[:, None]
    array = np.zeros((_ROWS, _COLUMNS, 4), np.float64)

    def draw(opacity: NDArray[np.float64], color: Color) -> None:
        more = (opacity > array[..., 3]) | ((array[..., 3] == 0) & (opacity >= 0) & ~array[..., :3].any(-1))
        array[more] = np.concatenate([np.broadcast_to(color, (*opacity.shape, 3)), opacity[..., None]], -1)[more]

    for (a, b), (bottom, top), color, opacity in boxes:
        inside = (values >= a) & (values <= b) & (slopes >= bottom) & (slopes <= top)
        if not inside.any():
            raise OptionError(f"a box is too narrow to be drawn beside the other shapes; got {(a, b)} by {(bottom, top)}")
        draw(np.where(inside, opacity, 0.0), color)
    for (a, b), peak, color, opacity in arches:
        near = _on_arch(values, slopes, (a, b), peak)
        if not near.any():
            raise OptionError(f"an arch is too narrow to be drawn beside the other shapes; got {(a, b)} by {peak:g}")
        draw(opacity * near, color)
    return Image.of(array, (float(values[0]), float(values[-1])), steepest)


def _on_arch(
    values: NDArray[np.float64], slopes: NDArray[np.float64], span: tuple[float, float], peak: float
) -> NDArray[np.float64]:
    """How near an arch is, from 1 on it to 0: the slope of a step blurred by a Gaussian, as a function of its value."""
    from scipy.special import erfinv

    share = 2 * (values - span[0]) / (span[1] - span[0]) - 1
    inside = np.abs(share) < 1
    arch = peak * np.exp(-(erfinv(np.where(inside, share, 0.0)) ** 2))
    with np.errstate(over="ignore"):  # beside shapes that are far steeper
        near = np.clip(1 - np.abs(slopes - arch) / (_WIDTH * peak), 0, 1) * np.minimum(1, slopes / (_WIDTH * peak))
    return np.where(inside, near, 0.0)
