"""Shadow and occlusion: what matter leaves of light at the nodes of a coarse grid; the host side of shadow.cl and lit.cl.

Matter is what a picture shows: of a transfer function its extinction, with the opacity of each sample as the ray loop has it; of
isosurfaces they themselves, each of which stops its share of light at a crossing. Lights of a direction are swept through it once
(`Shadows`), for each of their directions; and light from everywhere, of which the mean over directions is kept, for the ambient
term. No number depends on the camera, so neither do the shadows.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from clvol.base.uniform import FLOAT, INT, Block
from clvol.device.program import LANES
from clvol.march.behind import ROW, Behind
from clvol.scene.clip import Cuts, cuts_of
from clvol.scene.light import MAX_LIGHTS
from clvol.scene.mode import opacities_of
from clvol.spline.evaluator import choose_evaluator
from clvol.spline.lease import release
from clvol.spline.resample import resample_coefficients

if TYPE_CHECKING:
    from clvol.base.uniform import Values
    from clvol.device import Device
    from clvol.march.gaps import Gaps
    from clvol.march.options import ResolvedLook
    from clvol.scene.scene import Scene
    from clvol.spline.coefficients import Coefficients
    from clvol.volume.volume import Volume

__all__ = ["ABOVE", "BEYOND", "FAR", "LIT", "OPAQUE", "OPEN", "Cells", "Lit", "Matter", "Shadows", "everywhere"]

LIT = Block(
    "lit_block",
    at=INT,
    nodes=(INT, 3),
    scale=(FLOAT, 3),  # from samples to nodes
    shift=(FLOAT, 3),
    above=(FLOAT, 9),  # from normals in the world to nodes
    channel=(INT, 1 + MAX_LIGHTS),  # of the ambient light and of each light
    weight=(FLOAT, 1 + MAX_LIGHTS),
)

ABOVE = 2.0
"""Cells, how far above matter its light is read: closer it would lie in the blur of its own shadow."""
FAR = 1 / 8
"""Share of the volume's diagonal after which matter counts for 1/e of its extinction to the light from everywhere, so that the
inside of a room is not black."""
OPAQUE = 6.0
"""Base-2 exponent of the light behind a cell of opaque matter, or behind an opaque surface."""
OPEN = 0.4
"""Share of directions from which all ambient light comes: a little less than above a flat surface."""
BEYOND = 3
"""Nodes beyond the volume on each side, for what is read above matter at its faces."""
_MOST_CELLS = 80**3  # of about a third of 256 samples
_DIRECTIONS = 48
_NODES = 4096  # of the integral of extinction over values
_KEPT = 4  # fields
_BUNDLE = 8  # vectors of shadow.cl
_PARTS = 2  # of a cell along an axis


class Matter(NamedTuple):
    """What stops light."""

    opacities: tuple[tuple[float, float], ...]  # a transfer function's points of value and opacity
    unit: float  # world units of matter that have this opacity
    surfaces: tuple[tuple[float, float], ...]  # or in place of them surfaces, of a value and an opacity
    cuts: Cuts

    @classmethod
    def of(cls, look: ResolvedLook) -> Matter:
        """That of a look of one medium."""
        mode, transfer = look.mode, look.transfer
        if mode.isovalues:
            return cls((), 1.0, tuple(zip(mode.isovalues, opacities_of(mode), strict=True)), cuts_of(look.clip))
        unit = transfer.unit_distance or look.scene.media[0].volume.mean_spacing
        return cls(transfer.opacities, unit, (), cuts_of(look.clip))


class Cells(NamedTuple):
    """The coarse grid: equal cells, as good as cubes, that fill the volume's domain; nodes are in their middles."""

    counts: tuple[int, ...]  # along x, y and z
    sizes: NDArray[np.float64]  # in samples
    to_nodes: NDArray[np.float64]  # from vectors in the world
    edge: float  # in the world

    @classmethod
    def of(cls, volume: Volume) -> Cells:
        """Those of a volume: of a third of the resolution for 256³ samples, and about as many for any larger volume."""
        size = np.asarray(volume.size)
        lengths = size * np.asarray(volume.spacing)
        edge = max(volume.mean_spacing, float(np.prod(lengths) / _MOST_CELLS) ** (1 / 3))
        counts = np.minimum(np.ceil(lengths / edge), size).astype(np.int64)
        sizes = size / counts
        to_nodes = volume.world_to_index_matrix / sizes[:, None]
        return cls(tuple(counts.tolist()), sizes, to_nodes, float(np.prod(lengths / counts)) ** (1 / 3))

    def in_samples(self, parts: int, first: float) -> list[NDArray[np.float64]]:
        """Positions along x, y and z that divide cells in so many parts; `first` is the first of them, in parts."""
        return [
            (np.arange(n * parts + (first == 0)) + first) * size / parts - 0.5
            for n, size in zip(self.counts, self.sizes, strict=True)
        ]


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
        """The block for kernels; the numbers begin with number `at` of their table, a multiple of four."""
        cast = [light.direction is not None for light in scene.lights]
        channels = np.cumsum(cast) - 1 if scene.shadow else np.zeros(len(cast), np.int64)
        every = sum(cast) if scene.shadow else 0
        pad = [0] * (MAX_LIGHTS - len(cast))
        return LIT(
            at=at // 4,
            nodes=self.light.shape[3:0:-1],
            scale=1 / self.cells.sizes,
            shift=0.5 / self.cells.sizes - 0.5 + BEYOND,
            above=(ABOVE * self.cells.edge * self.cells.to_nodes).ravel(),
            channel=[every * (scene.occlusion > 0), *(n if own else every for n, own in zip(channels, cast, strict=True)), *pad],
            weight=[scene.occlusion, *(scene.shadow if own else scene.occlusion for own in cast), *pad],
        )


class Shadows:
    """The shadows of a function in memory: its values are kept on the device, and what is left of lights for the last looks."""

    def __init__(self, coefficients: Coefficients, gaps: Gaps | None) -> None:
        self._coefficients, self._gaps = coefficients, gaps
        self.cells = Cells.of(coefficients.volume)
        self._kept: dict[tuple[Any, ...], Lit] = {}
        self._values: Any = None
        self._lock = threading.RLock()  # a signal handler may re-enter

    def of(self, look: ResolvedLook) -> Lit:
        """What is left of the lights of a look."""
        scene = look.scene
        directions = tuple(light.direction for light in scene.lights if light.direction is not None) if scene.shadow else ()
        key = Matter.of(look), directions, scene.occlusion > 0
        with self._lock:
            if key not in self._kept:
                if len(self._kept) >= _KEPT:
                    self._kept.pop(next(iter(self._kept)))
                self._kept[key] = Lit(self.cells, self.light(*key))
            return self._kept[key]

    def extinction(self, matter: Matter) -> NDArray[np.float32]:
        """The mean extinction of each cell, [z, y, x], in base-2 exponents for each world unit."""
        coefficients, cells = self._coefficients, self.cells
        device, (nx, ny, nz) = coefficients.device, cells.counts
        if self._values is None:
            shape = tuple(_PARTS * n + 1 for n in (nz, ny, nx))
            self._values = device.buffers.allocate(4 * math.prod(shape))
            steps = cells.sizes / _PARTS
            how = choose_evaluator(device, coefficients.filter)
            resample_coefficients(coefficients, how, np.diag(steps), np.full(3, -0.5), shape, self._values)
        numbers, count, first, scale = _integral(matter, coefficients, cells.edge)
        slopes = (cells.to_nodes * _PARTS).astype(np.float32)
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
                self._values,
                np.array([nx, ny, nz, count], np.int32),
                device.buffers.upload(numbers),
                np.float32(first),
                np.float32(scale),
                device.buffers.upload(slopes),
                result,
            )
        found *= self._kept_share(matter.cuts)
        return found

    def _kept_share(self, cuts: Cuts) -> NDArray[np.float32] | float:
        """The share of each cell that is not cut away, and whose samples are there."""
        cells, volume = self.cells, self._coefficients.volume
        share: Any = np.float32(1)
        if self._gaps is not None:
            places = [
                np.clip(np.rint(at), 0, n - 1).astype(np.int64)
                for at, n in zip(cells.in_samples(_PARTS, 0.5), volume.size, strict=True)
            ]
            there = ~np.asarray(self._gaps.where)[np.ix_(*places[::-1])]
            nx, ny, nz = cells.counts
            share = there.reshape(nz, _PARTS, ny, _PARTS, nx, _PARTS).mean((1, 3, 5), dtype=np.float32)
        if cuts == Cuts():
            return share  # type: ignore[no-any-return]
        x, y, z = np.meshgrid(*cells.in_samples(1, 0.5)[::-1], indexing="ij")[::-1]
        points = volume.index_to_world(np.stack([x, y, z], -1).reshape(-1, 3)).reshape(*x.shape, 3)
        return (share * cuts.kept_share(points, cells.edge)).astype(np.float32)  # type: ignore[no-any-return]

    def light(self, matter: Matter, directions: Sequence[tuple[float, ...]], occlusion: bool) -> NDArray[np.float32]:
        """The channels of all nodes: what is left of light from each direction, then that from everywhere."""
        cells, volume = self.cells, self._coefficients.volume
        found = np.pad(self.extinction(matter), BEYOND)
        with _Sweeps(self._coefficients.device, found) as sweeps:
            channels = [sweeps.light(cells.to_nodes @ np.array([direction]).T, math.inf) for direction in directions]
            if occlusion:
                far = FAR * float(np.linalg.norm(np.asarray(volume.size) * np.asarray(volume.spacing)))
                channels.append(np.minimum(sweeps.light(cells.to_nodes @ everywhere().T, far) / OPEN, 1))
        light = np.ones((-(-len(channels) // ROW), *found.shape, ROW), np.float32)
        for k, channel in enumerate(channels):
            light[k // ROW, ..., k % ROW] = channel
        return light

    def release(self) -> None:
        """Free the device's memory."""
        values, self._values = self._values, None
        self._kept.clear()
        release(self._coefficients.device, values)


def _integral(matter: Matter, coefficients: Coefficients, edge: float) -> tuple[NDArray[np.float32], int, float, float]:
    """The integral of the extinction over stored values at equal nodes, how many, the first and nodes for each value; of surfaces
    their values and exponents, and how many there are.
    """
    stored = coefficients.stored
    if matter.surfaces:
        pairs = [(float(stored(value)), min(_exponent(opacity), OPAQUE)) for value, opacity in matter.surfaces]
        return np.array(pairs, np.float32).ravel(), len(pairs), 0.0, 0.0
    at, opacities = (np.array(numbers) for numbers in zip(*matter.opacities, strict=True))
    width = (at[-1] - at[0]) / (_NODES - 3) or 1e-3 * (1 + abs(at[0]))
    values = at[0] + width * np.arange(-1, _NODES - 1)  # up to a node past each end
    extinction = np.minimum(_exponent(np.interp(values, at, opacities)) / matter.unit, OPAQUE / edge)
    integral = np.append(0, np.cumsum((extinction[1:] + extinction[:-1]) / 2))
    first, last = float(stored(values[0])), float(stored(values[-1]))
    return integral.astype(np.float32), _NODES, first, (_NODES - 1) / (last - first)


def _exponent(opacity: Any) -> Any:
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
