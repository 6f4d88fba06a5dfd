"""Shadow and occlusion: what matter leaves of light at the nodes of a coarse grid; the host side of shadow.cl and lit.cl.

Matter is what a picture shows: of a transfer function its extinction, with the opacity of each sample as the ray loop has it; of
isosurfaces they themselves, each of which stops its share of light at a crossing. That of all media of a picture adds up. Lights of
a direction are swept through it once (`Shadows`), for each of their directions; and light from everywhere, of which the mean over
directions is kept, for the ambient term. No number depends on the camera, so neither do the shadows.
"""

from __future__ import annotations

import itertools
import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clvol.base.uniform import FLOAT, INT, Block
from clvol.device.program import LANES
from clvol.march.behind import ROW, Behind
from clvol.scene.clip import Cuts, cuts_of, triple
from clvol.scene.light import MAX_LIGHTS
from clvol.scene.mode import opacities_of
from clvol.spline.evaluator import choose_evaluator
from clvol.spline.grids import between
from clvol.spline.lease import release
from clvol.spline.resample import resample_coefficients

if TYPE_CHECKING:
    from clvol.base.uniform import Values
    from clvol.device import Device
    from clvol.march.gaps import Gaps
    from clvol.march.options import ResolvedLook
    from clvol.scene.scene import Scene
    from clvol.spline.coefficients import Coefficients, Whole
    from clvol.volume.volume import Volume

__all__ = [
    "ABOVE",
    "BEYOND",
    "CAST",
    "FAR",
    "LIT",
    "OPAQUE",
    "OPEN",
    "Body",
    "Cells",
    "Lit",
    "Matter",
    "Shadows",
    "cast_block",
    "everywhere",
    "exponent",
]

LIT = Block(
    "lit_block",
    at=INT,
    nodes=(INT, 3),
    to=(FLOAT, 9),  # from samples to nodes
    shift=(FLOAT, 3),
    above=(FLOAT, 9),  # from normals in the world to nodes
    channel=(INT, 1 + MAX_LIGHTS),  # of the ambient light and of each light
    weight=(FLOAT, 1 + MAX_LIGHTS),
)

CAST = Block("cast_block", ways=(FLOAT, 3 * MAX_LIGHTS), weight=FLOAT, clear=FLOAT)  # rays to lights: cast.cl

ABOVE = 2.0
"""Cells, how far above matter its light is read: closer it would lie in the blur of its own shadow."""
FAR = 1 / 8
"""Share of the box's diagonal after which matter counts for 1/e of its extinction to the light from everywhere, so that the
inside of a room is not black."""
OPAQUE = 6.0
"""Base-2 exponent of the light behind a cell of opaque matter, or behind an opaque surface."""
OPEN = 0.4
"""Share of directions from which all ambient light comes: a little less than above a flat surface."""
BEYOND = 3
"""Nodes beyond the box on each side, for what is read above matter at its faces."""
_MOST_CELLS = 80**3  # of about a third of 256 samples
_LONGEST = 256  # cells along an axis: lights from the side sweep planes of all lengths
_DIRECTIONS = 48
_NODES = 4096  # of the integral of extinction over values
_LABELS = 1 << 20  # numbers of labels, of each of which extinction is known
_KEPT = 4  # fields
_BUNDLE = 8  # vectors of shadow.cl
_PARTS = 2  # of a cell along an axis
_CLEAR = 6 * 2.0**-22  # of three places in turn, each rounded along three axes
_SLACK = 1e-3  # samples, by which cells that fill a domain may pass it


class Matter(NamedTuple):
    """What stops light."""

    opacities: tuple[tuple[float, float], ...]  # a transfer function's points of value and opacity
    unit: float  # world units of matter that have this opacity
    surfaces: tuple[tuple[float, float], ...]  # or in place of them surfaces, of a value and an opacity
    cuts: Cuts
    capped: bool = False  # cut faces close what is not below the lowest surface

    @classmethod
    def of(cls, look: ResolvedLook) -> Matter:
        """That of a look of one medium."""
        mode, transfer = look.mode, look.transfer
        if mode.isovalues:
            surfaces = tuple(zip(mode.isovalues, opacities_of(mode), strict=True))
            return cls((), 1.0, surfaces, cuts_of(look.clip), mode.capped)
        unit = transfer.unit_distance or look.scene.media[0].volume.mean_spacing
        return cls(transfer.opacities, unit, (), cuts_of(look.clip))


class Body(NamedTuple):
    """A function with what of it stops light."""

    matter: Matter
    coefficients: Coefficients | Whole
    on: Callable[[Volume, Any], object]  # writes its stored values on a grid to a buffer
    gaps: Gaps | None = None

    @classmethod
    def of(cls, coefficients: Coefficients, matter: Matter, gaps: Gaps | None = None) -> Body:
        """That of a function in memory."""

        def write(grid: Volume, buffer: Any) -> None:
            how = choose_evaluator(coefficients.device, coefficients.filter)
            resample_coefficients(coefficients, how, *between(coefficients.volume, grid), grid.shape, buffer)

        return cls(matter, coefficients, write, gaps)


_There: TypeAlias = tuple[NDArray[np.float32] | np.float32, NDArray[np.bool_] | None]


class Cells(NamedTuple):
    """The coarse grid: equal cells, as good as cubes, that fill a box; nodes are in their middles."""

    nodes: Volume  # a grid without samples

    @classmethod
    def over(cls, volumes: Sequence[Volume]) -> Cells:
        """Those of the box along the axes of the first volume that holds all: of a third of the resolution for 256³ samples, and
        about as many for any larger box.
        """
        first = volumes[0]
        corners = np.concatenate([first.world_to_index(volume.corners) for volume in volumes]).round(6)
        low, high = corners.min(0), corners.max(0)
        lengths = (high - low) * first.spacing
        edge = max(first.mean_spacing, float(np.prod(lengths) / _MOST_CELLS) ** (1 / 3), lengths.max() / _LONGEST)
        counts = np.minimum(np.ceil(lengths / edge), np.ceil(high - low)).astype(np.int64)
        return cls(_grid(first, counts, low + (high - low) / (2 * counts), (high - low) / counts))

    @property
    def edge(self) -> float:
        """The mean length of their edges in the world."""
        return math.prod(self.nodes.spacing) ** (1 / 3)

    @property
    def diagonal(self) -> float:
        """The length of the box's diagonal."""
        return float(np.linalg.norm(np.multiply(self.nodes.size, self.nodes.spacing)))

    def parts(self, first: float) -> Volume:
        """A grid of positions that divide cells in parts; `first` is the first of them, in parts: corners, or middles."""
        counts = np.array(self.nodes.size) * _PARTS + (first == 0)
        return _grid(self.nodes, counts, np.full(3, first / _PARTS - 0.5), np.full(3, 1 / _PARTS))


def _grid(volume: Volume, counts: NDArray[np.int64], first: NDArray[np.float64], step: NDArray[np.float64]) -> Volume:
    """A grid along the axes of a volume; its first place and its steps are in samples of that."""
    zeros = np.broadcast_to(np.float32(0), tuple(counts[::-1].tolist()))
    spacing, origin = tuple(step * volume.spacing), tuple(volume.index_to_world(first))
    return replace(volume.grid, data=zeros, spacing=spacing, origin=origin)


@lru_cache
def everywhere() -> NDArray[np.float64]:
    """Directions of light from everywhere, shape (n, 3): a spiral over the sphere, each for an equal area."""
    n = np.arange(_DIRECTIONS) + 0.5
    up, turn = 1 - 2 * n / _DIRECTIONS, math.pi * (1 + math.sqrt(5)) * n
    across = np.sqrt(1 - up**2)
    return np.stack([across * np.cos(turn), across * np.sin(turn), up], -1)


class Lit(Behind):
    """What is left of lights at nodes: `light`, float32 of shape (rows, z, y, x, 4), of four channels in a row."""

    def __init__(self, cells: Cells, light: NDArray[np.float32]) -> None:
        super().__init__([light])
        self.cells, self.light = cells, light

    @property
    def rows(self) -> int:
        """Rows of numbers of a node."""
        return int(self.light.shape[0])

    def block(self, scene: Scene, at: int) -> Values:
        """The block for kernels that draw a scene's medium; the numbers begin with number `at` of a table, a multiple of four."""
        cast = [light.direction is not None for light in scene.lights]
        channels = np.cumsum(cast) - 1 if scene.shadow else np.zeros(len(cast), np.int64)
        every = sum(cast) if scene.shadow else 0
        pad = [0] * (MAX_LIGHTS - len(cast))
        nodes = self.cells.nodes
        matrix, shift = between(nodes, scene.media[0].volume)
        return LIT(
            at=at // 4,
            nodes=self.light.shape[3:0:-1],
            to=matrix.ravel(),
            shift=shift + BEYOND,
            above=(ABOVE * self.cells.edge * nodes.world_to_index_matrix).ravel(),
            channel=[every * (scene.occlusion > 0), *(n if own else every for n, own in zip(channels, cast, strict=True)), *pad],
            weight=[scene.occlusion, *(scene.shadow if own else scene.occlusion for own in cast), *pad],
        )


def cast_block(scene: Scene, unit: float, reach: float) -> Values:
    """What kernels that draw a scene's medium read of rays to its lights: directions in samples for each `unit` of the world.

    `reach`: samples from the middle of the volume to the farthest place that a ray is at.
    """
    ways = np.zeros((MAX_LIGHTS, 3))
    cast = [light.direction for light in scene.lights if light.direction is not None]
    ways[: len(cast)] = unit * np.reshape(cast, (-1, 3)) @ scene.media[0].volume.world_to_index_matrix.T
    return CAST(ways=ways.ravel(), weight=scene.shadow, clear=_CLEAR * reach)


class Shadows:
    """The shadows of functions: their values are kept on the device, and what is left of lights for the last looks."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._kept: dict[tuple[Any, ...], Lit] = {}
        self._values: dict[tuple[Coefficients | Whole, Cells], tuple[Any, tuple[float, float]]] = {}
        self._cells: tuple[tuple[Volume, ...], Cells] | None = None
        self._lock = threading.RLock()  # a signal handler may re-enter

    def of(self, scene: Scene, volumes: Sequence[Volume], among: Callable[[float], Sequence[Body]]) -> Lit:
        """What is left of a scene's lights in the box that holds volumes; `among` has bodies for parts of cells of a length."""
        ways = tuple(light.direction for light in scene.lights if light.direction is not None) if scene.shadow else ()
        with self._lock:
            cells = self._over(tuple(volumes))
            bodies = among(cells.edge / _PARTS)
            key = cells, *((body.matter, body.coefficients) for body in bodies), ways, scene.occlusion > 0
            if key not in self._kept:
                if len(self._kept) >= _KEPT:
                    self._kept.pop(next(iter(self._kept)))
                self._kept[key] = Lit(cells, self.light(cells, bodies, ways, occlusion=scene.occlusion > 0))
            return self._kept[key]

    def _over(self, volumes: tuple[Volume, ...]) -> Cells:
        """The cells over volumes; values at those of others are freed."""
        if self._cells is None or any(one is not other for one, other in itertools.zip_longest(self._cells[0], volumes)):
            self._free()
            self._cells = volumes, Cells.over(volumes)
        return self._cells[1]

    def extinction(
        self, cells: Cells, body: Body, way: tuple[float, ...] | None = None, there: _There | None = None
    ) -> NDArray[np.float32]:
        """The mean extinction of each cell, [z, y, x], in base-2 exponents for each world unit; of surfaces that for light of a
        direction, or for light along their normals everywhere.

        `there`: which cells are, if that is known.
        """
        device, (nx, ny, nz), coefficients, matter = self._device, cells.nodes.size, body.coefficients, body.matter
        values, limits = self._values_of(cells, body)
        share, caps = there or self._there(cells, body)
        numbers, count, first, scale = _integral(matter, coefficients, cells.edge, limits)
        slopes = (cells.nodes.world_to_index_matrix * _PARTS).astype(np.float32)
        defines = {
            "LANES": LANES,
            "SHEETS": int(bool(matter.surfaces)),
            "NAMES": int(coefficients.volume.is_labels),
            "COORD_DOUBLE": 0,
        }
        found = np.empty((nz, ny, nx), np.float32)
        with device.buffers.lent(found, write=True) as result, device.errors:
            device.build("march/shadow.cl", defines).kernel("extinction")(
                device.queue,
                (ny, nz),
                device.alone(2),
                values,
                np.array([nx, ny, nz, count], np.int32),
                device.buffers.upload(numbers),
                np.float32(first),
                np.float32(scale),
                device.buffers.upload(slopes),
                np.array([*(way or (0, 0, 0)), 0], np.float32),
                result,
            )
        found *= share
        if caps is not None:
            found[caps] = OPAQUE / cells.edge
        return found

    def _there(self, cells: Cells, body: Body) -> _There:
        """The share of each cell that is there and not cut away, and the cells of caps, if there are some."""
        matter, share = body.matter, _share_there(cells, body)
        if matter.cuts == Cuts():
            return share, None
        kept = matter.cuts.kept_share(_places(cells), cells.edge).astype(np.float32)
        if not matter.capped:
            return share * kept, None
        from scipy.ndimage import binary_erosion  # it takes a fifth of a second

        with self._device.buffers.mapped(self._values_of(cells, body)[0], cells.parts(0).shape, write=False) as corners:
            inside = corners[1::2, 1::2, 1::2] >= body.coefficients.stored(min(matter.surfaces)[0])
        outermost = (kept > 0) & ~binary_erosion(kept > 0, border_value=1)
        return share * kept, outermost & inside & (share > 0)

    def _values_of(self, cells: Cells, body: Body) -> tuple[Any, tuple[float, float]]:
        """Stored values at the corners of parts of cells, and the smallest and the largest of them."""
        key, buffers = (body.coefficients, cells), self._device.buffers
        if key not in self._values:
            corners = cells.parts(0)
            made = buffers.allocate(4 * math.prod(corners.shape))
            body.on(corners, made)
            with buffers.mapped(made, corners.shape, write=False) as values:
                self._values[key] = made, (float(values.min()), float(values.max()))
        return self._values[key]

    def light(
        self, cells: Cells, bodies: Sequence[Body], directions: Sequence[tuple[float, ...]], *, occlusion: bool
    ) -> NDArray[np.float32]:
        """The channels of all nodes: what is left of light from each direction, then that from everywhere."""
        sheets = [(body, self._there(cells, body)) for body in bodies if body.matter.surfaces]
        matter = [self.extinction(cells, body) for body in bodies if not body.matter.surfaces]
        to_nodes, channels = cells.nodes.world_to_index_matrix, []

        def sweeps(way: tuple[float, ...] | None) -> _Sweeps:
            each = [*matter, *(self.extinction(cells, body, way, there) for body, there in sheets)]
            return _Sweeps(self._device, np.pad(np.sum(each, 0), BEYOND))

        for alike in [(way,) for way in directions] if sheets else [tuple(directions)] * bool(directions):
            with sweeps(alike[0]) as through:
                channels += [through.light(to_nodes @ np.array([way]).T, math.inf) for way in alike]
        if occlusion:
            with sweeps(None) as through:
                channels.append(np.minimum(through.light(to_nodes @ everywhere().T, FAR * cells.diagonal) / OPEN, 1))
        light = np.ones((-(-len(channels) // ROW), *channels[0].shape, ROW), np.float32)
        for k, channel in enumerate(channels):
            light[k // ROW, ..., k % ROW] = channel
        return light

    def release(self) -> None:
        """Free the device's memory."""
        self._kept.clear()
        self._free()

    def _free(self) -> None:
        values, self._values = self._values, {}
        release(self._device, *(buffer for buffer, _ in values.values()))


def _places(cells: Cells) -> NDArray[np.float64]:
    """Where the nodes are in the world, [z, y, x]."""
    x, y, z = np.meshgrid(*map(np.arange, cells.nodes.shape), indexing="ij")[::-1]
    return cells.nodes.index_to_world(np.stack([x, y, z], -1).reshape(-1, 3)).reshape(*x.shape, 3)


def _share_there(cells: Cells, body: Body) -> NDArray[np.float32] | np.float32:
    """The share of each cell that is in the function's domain, and whose samples are there."""
    nodes, volume = cells.nodes, body.coefficients.volume
    share: Any = np.float32(1) if body.gaps is None else _samples_there(cells, volume, body.gaps)
    low, high = np.full(3, -0.5), np.asarray(volume.size) - 0.5
    ends = volume.world_to_index(nodes.corners)
    if ((ends > low - _SLACK) & (ends < high + _SLACK)).all():
        return share  # type: ignore[no-any-return]
    points, (matrix, _) = _places(cells), between(volume, nodes)
    within = Cuts((triple(low), triple(high))).kept_share(
        volume.world_to_index(points.reshape(-1, 3)).reshape(points.shape), np.abs(matrix).sum(1)
    )
    return (share * within).astype(np.float32)  # type: ignore[no-any-return]


def _samples_there(cells: Cells, volume: Volume, gaps: Gaps) -> NDArray[np.float32]:
    """The share of the parts of each cell whose nearest samples are there."""
    middles = cells.parts(0.5)
    matrix, first = between(volume, middles)
    where, last = np.asarray(gaps.where), np.asarray(volume.size) - 1
    x, y = np.meshgrid(*map(np.arange, middles.size[:2]))
    plane = np.stack([x, y], -1) @ matrix[:, :2].T + first
    there = np.empty(middles.shape, np.bool_)
    for z, of_plane in enumerate(there):
        places = np.clip(np.rint(plane + z * matrix[:, 2]), 0, last).astype(np.int64)
        of_plane[...] = ~where[places[..., 2], places[..., 1], places[..., 0]]
    nx, ny, nz = cells.nodes.size
    return np.asarray(there.reshape(nz, _PARTS, ny, _PARTS, nx, _PARTS).mean((1, 3, 5), dtype=np.float32))


def _integral(
    matter: Matter, coefficients: Coefficients | Whole, edge: float, limits: tuple[float, float]
) -> tuple[NDArray[np.float32], int, float, float]:
    """The integral of the extinction over stored values at equal nodes, how many, the second and nodes for each value; of surfaces
    their values and exponents, and how many there are.
    """
    stored = coefficients.stored
    if matter.surfaces:
        pairs = [(float(stored(value)), min(exponent(opacity), OPAQUE)) for value, opacity in matter.surfaces]
        return np.array(pairs, np.float32).ravel(), len(pairs), 0.0, 0.0
    at, opacities = (np.array(numbers, np.float64) for numbers in zip(*matter.opacities, strict=True))
    at = stored(at)
    if coefficients.volume.is_labels and limits[1] - limits[0] < _LABELS:  # exactly that of each, whose name counts from a half
        extinction = _extinction(np.interp(np.arange(limits[0], limits[1] + 1), at, opacities), matter, edge)
        integral = np.concatenate([[0, 0], np.cumsum(extinction)])
        return integral.astype(np.float32), len(integral), limits[0] - 0.5, 1.0
    low, high = np.clip(limits, at[0], at[-1])
    width = (high - low or limits[1] - limits[0] or 1e-3 * (1 + abs(low))) / (_NODES - 3)
    nodes = low + width * np.arange(-1, _NODES - 1)  # up to a node past each end
    ends = np.sort(np.concatenate([nodes, at[(at > nodes[0]) & (at < nodes[-1])]]))
    extinction = _extinction(np.interp((ends[1:] + ends[:-1]) / 2, at, opacities), matter, edge)
    integral = np.append(0, np.cumsum(extinction * np.diff(ends)))
    return (np.interp(nodes, ends, integral) / width).astype(np.float32), _NODES, float(low), 1 / float(width)


def _extinction(opacities: NDArray[np.float64], matter: Matter, edge: float) -> NDArray[np.float64]:
    return np.asarray(np.minimum(exponent(opacities) / matter.unit, OPAQUE / edge))


def exponent(opacity: Any) -> Any:
    """Base-2 exponents of what matter of an opacity leaves of light."""
    with np.errstate(divide="ignore"):
        return -np.log2(1 - opacity)


class _Layout:
    """Cells whose rows are one of their axes, on the device: extinctions, and sums of light. See shadow.cl."""

    def __init__(self, device: Device, extinction: NDArray[np.float32]) -> None:
        self._device, self._sizes = device, extinction.shape[::-1]
        nu, nv, nw = self._sizes
        pitch = LANES * (-(-(nu + 1) // LANES) + 2)
        self._shape = nw + 2, nv + 2, pitch
        self._strides = 1, pitch, pitch * (nv + 2)
        self._first = self._strides[2] + self._strides[1] + LANES
        padded = np.zeros(self._shape, np.float32)
        self._inner = slice(1, -1), slice(1, -1), slice(LANES, LANES + nu)
        padded[self._inner] = extinction
        self._extinction, self._sums = device.buffers.upload(padded), device.buffers.allocate(padded.nbytes)
        self._left: Any = None
        self._room = 0

    def clear(self) -> None:
        """Set the sums to 0."""
        self._device.buffers.clear(self._sums, 0, math.prod(self._shape))

    def sums(self) -> NDArray[np.float32]:
        """The sums of light, [w, v, u]."""
        with self._device.buffers.mapped(self._sums, self._shape, write=False) as sums:
            return np.array(sums[self._inner])

    def add(self, direction: NDArray[np.float64], weight: float, far: float) -> None:
        """Add what is left of light from a direction, (u, v, w) in nodes for each world unit; u is not its largest."""
        w = 1 if abs(direction[1]) > abs(direction[2]) else 2
        v, length = 3 - w, 1 / abs(float(direction[w]))
        shift = -direction[0] * length, -direction[v] * length
        nu, nv, nw = self._sizes[0], self._sizes[v], self._sizes[w]
        begin = [-1 - math.ceil(max(by, 0) * (nw - 1)) for by in shift]
        ends = [n + math.ceil(max(-by, 0) * (nw - 1)) for n, by in zip((nu, nv), shift, strict=True)]
        pitch, rows = _BUNDLE * LANES * -(-(ends[0] - begin[0] + 2 * LANES + 2) // (_BUNDLE * LANES)), ends[1] - begin[1] + 2
        down = direction[w] > 0  # light enters at the last plane
        step = -self._strides[w] if down else self._strides[w]
        strides = self._strides[v], step, self._first - (nw - 1) * step * down, 0
        self._make_room(4 * nw * rows * pitch)
        device, many = self._device, np.array([nu, nv, nw, 0], np.int32)
        common = many, np.array(strides, np.int32), np.array([*begin, pitch, pitch * rows], np.int32), np.array(shift, np.float32)
        built = device.build("march/shadow.cl", {"LANES": LANES, "SHEETS": 0, "NAMES": 0, "COORD_DOUBLE": 0})
        faded = math.exp(-length / far)
        with device.errors:
            alone = device.alone(2)
            half = np.float32(length / 2)
            built.kernel("along_lines")(
                device.queue,
                (pitch // (_BUNDLE * LANES), rows),
                alone,
                self._extinction,
                *common,
                half,
                np.float32(faded),
                self._left,
            )
            built.kernel("add_light")(device.queue, (nv, nw), alone, self._left, *common, np.float32(weight), self._sums)

    def _make_room(self, size: int) -> None:
        if size > self._room:
            release(self._device, self._left)
            self._left, self._room = self._device.buffers.allocate(size), size
            self._device.buffers.clear(self._left, 0, size // 4)  # what no line writes is read, with a weight of 0: not NaN

    def release(self) -> None:
        release(self._device, self._extinction, self._sums, self._left)


class _Sweeps:
    """Sweeps through cells in all directions: in rows along x, or for light along x in rows along y."""

    def __init__(self, device: Device, extinction: NDArray[np.float32]) -> None:
        self._along_x, self._along_y = _Layout(device, extinction), _Layout(device, extinction.transpose(0, 2, 1))

    def light(self, directions: NDArray[np.float64], far: float) -> NDArray[np.float32]:
        """The mean of what is left of light from directions, shape (3, n), in nodes for each world unit; [z, y, x]."""
        self._along_x.clear()
        self._along_y.clear()
        count = directions.shape[1]
        for x, y, z in directions.T:
            if abs(x) > max(abs(y), abs(z)):
                self._along_y.add(np.array([y, x, z]), 1 / count, far)
            else:
                self._along_x.add(np.array([x, y, z]), 1 / count, far)
        return self._along_x.sums() + self._along_y.sums().transpose(0, 2, 1)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._along_x.release()
        self._along_y.release()
