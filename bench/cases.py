"""The measured work, and our side of it; peers.py has the other programs."""

from __future__ import annotations

import math
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import clvol
from bench import fresh, peers, scene
from bench.machine import Cost, available_memory
from bench.peers import Peer, Points, Shot
from clvol.base.errors import OutOfMemoryError
from clvol.device import Device, as_device
from clvol.filter.boundary import as_boundary
from clvol.filter.filter import Filter
from clvol.filter.table import as_filter
from clvol.march.frame import BY_RAYS
from clvol.march.options import unheard
from clvol.march.planes import OBLIQUE, Planes
from clvol.scene.mode import as_mode
from clvol.spline.coefficients import Coefficients
from clvol.spline.field import coefficients_of
from clvol.spline.prefilter import prefilter_in_place

__all__ = ["Bench", "Case", "Measurement", "Skip", "Work", "all_cases", "draw", "measure", "samples_on_lattice", "shots"]

Array = NDArray[Any]
_EDGE = 16  # samples from the faces, within which programs' boundary rules differ
_PATIENCE = 4.0  # seconds: a peer that has taken this long is not repeated
TURNS = ((0.0, 0.0), (30.0, 20.0), (65.0, 50.0))  # azimuth, elevation: planes across y, y and z or x, near the diagonal


class Skip(Exception):
    """A case that cannot be measured here, and why."""


@dataclass
class Work:
    """A prepared case: our run, the peers' runs, and the minimum cost."""

    ours: Callable[[], Any]
    peers: dict[str, Peer] = field(default_factory=dict)
    amount: float = 0.0  # items
    unit: str = ""  # of a million items
    cost: Cost | None = None  # of one item
    repeats: int = 5
    compare: Callable[[Array, Array], float] | None = None  # how far a peer's result is from ours


@dataclass
class Measurement:
    """The results; `seconds` are medians."""

    seconds: dict[str, float]
    spread: dict[str, tuple[float, float]]
    runs: dict[str, int]
    differs_by: dict[str, float]
    failed: dict[str, str]


@dataclass(frozen=True)
class Case:
    """One kind of work under its name in the results; `prepare` sets it up."""

    name: str
    prepare: Callable[[], Work | dict[str, Any]]


def measure(work: Work) -> Measurement:
    """Alternate ours and theirs, after one uncounted run of each.

    Slow peers are not repeated for more than a few seconds.
    """
    actions = {"clvol": work.ours, **{name: peer.run for name, peer in work.peers.items()}}
    scales = {"clvol": 1.0, **{name: peer.scale for name, peer in work.peers.items()}}
    times: dict[str, list[float]] = {name: [] for name in actions}
    differs, failed = {}, {}
    ours = work.ours()
    for name, peer in work.peers.items():
        try:
            theirs = peer.run()
        except Exception as error:  # whatever a peer raises, the others are still measured
            failed[name] = f"{type(error).__name__}: {error}"
            continue
        if work.compare is not None:
            differs[name] = work.compare(ours, theirs)
        del theirs
    del ours
    for _ in range(work.repeats):
        for name, action in actions.items():
            if name in failed or sum(times[name]) > _PATIENCE:
                continue
            started = time.perf_counter()
            result = action()
            times[name].append(time.perf_counter() - started)
            del result
    scaled = {name: [scales[name] * t for t in taken] for name, taken in times.items() if taken}
    return Measurement(
        {name: statistics.median(t) for name, t in scaled.items()},
        {name: (min(t), max(t)) for name, t in scaled.items()},
        {name: len(t) for name, t in scaled.items()},
        differs,
        failed,
    )


# -- what one item takes ------------------------------------------------------------------------------------
#
# A cubic weight is a polynomial of degree 3: three multiply-adds, its slope two. A row of taps is one load of four.

_WEIGHTS, _SLOPES = 3 * 4 * 3, 3 * 4 * 2
PREFILTER = Cost(bytes=8, multiply_adds=9)  # every sample read and every coefficient written once; two recursions per axis, gain
VALUE = Cost(bytes=16, loads=16, multiply_adds=_WEIGHTS + 64 + 16 + 4)  # a point in, a value out
# the same for points that are sorted first: read twice, written with their places and read again
SCATTERED = Cost(bytes=2 * 12 + 2 * 16 + 4, loads=16, multiply_adds=VALUE.multiply_adds)
# rows by weights and slopes; columns by weights, slopes, weights; slices likewise, for (x, y, z, value)
GRADIENT = Cost(bytes=24, loads=16, multiply_adds=_WEIGHTS + _SLOPES + 2 * 64 + 3 * 16 + 3 * 4)
MAGNIFY = Cost(bytes=4.5, multiply_adds=3.5 * (1 + 1 / 2 + 1 / 4) + 9 / 8)  # three or four taps per axis, axis by axis


def plane_cost(spacing: float, shaded: bool) -> Cost:
    """The cost of a sample on a plane whose slices were blended for a tile of 16 × 16 rays, `spacing` voxels apart."""
    blended = (16 * spacing + 3) ** 2 / 16**2  # coefficients of the blend, a sample
    weights = 2 * 4 * 3
    if not shaded:
        return Cost(loads=4 + blended, multiply_adds=weights + 16 + 4 + 4 * blended)
    slopes = 2 * 4 * 2
    # rows by weights and slopes, of the blend and of its slope across; colours and light are not counted
    return Cost(loads=8 + 2 * blended, multiply_adds=weights + slopes + 3 * 16 + 4 * 4 + 8 * blended)


# -- all of them ----------------------------------------------------------------------------------------------


class Bench:
    """Sizes, the device, and shared volumes."""

    def __init__(self, *, quick: bool = False, huge: bool = True) -> None:
        self.quick = quick
        self.huge = huge and not quick
        self.n = 64 if quick else 256
        self.size = (128, 128) if quick else (512, 512)
        self.repeats = 2 if quick else 5
        self.row, self.smoothed = as_filter("bspline3"), as_filter("bspline3(0.1)")
        self.rule = as_boundary("mirror")
        self.head = lru_cache(maxsize=2)(self._head)
        self.renderer = lru_cache(maxsize=2)(self._renderer)  # few at a time: the largest take most of the memory

    @property
    def device(self) -> Device:
        return as_device()

    def _head(self, n: int, kind: str = "float32") -> Array:
        return scene.head(n, self.device, kind)

    def _renderer(self, n: int, kind: str = "float32", filter: str = "bspline3") -> clvol.Renderer:
        return clvol.Renderer(self.head(n, kind), filter)

    def coefficients(self, n: int, filter: Filter) -> Coefficients:
        return coefficients_of(clvol.Volume(self.head(n)), filter, self.rule, self.device)

    # -- prefilter --

    def resident_prefilter(self, n: int) -> Work:
        """The kernels alone, on data already on the device."""
        resident, theirs = self.coefficients(n, self.row), peers.of("prefilter", self.head(n))
        theirs["clvol, λ = 0.1"] = Peer(partial(_prefilter, self.coefficients(n, self.smoothed)))
        return Work(partial(_prefilter, resident), theirs, float(n**3), "Mvoxel/s", PREFILTER, self.repeats)

    def array_prefilter(self, n: int) -> Work:
        data = self.head(n)
        theirs = peers.of("prefilter", data)
        return Work(lambda: clvol.prefilter(data), theirs, float(n**3), "Mvoxel/s", PREFILTER, self.repeats, _difference_inside)

    def upload(self, n: int) -> Work:
        volume = clvol.Volume(self.head(n))

        def ours() -> None:
            coefficients_of(volume, self.row, self.rule, self.device).release()

        return Work(ours, {}, float(n**3), "Mvoxel/s", PREFILTER, self.repeats)

    # -- samples at points --

    def points(self, *, random: bool) -> Points:
        n = self.n
        count = 1 << (16 if self.quick else 22)
        data = self.head(n)
        coefficients = clvol.prefilter(data)
        if random:
            at = np.random.default_rng(0).uniform(2, n - 3, (count, 3)).astype(np.float32)
            return Points(data, coefficients, at)
        # oblique rays, one after the other: a lattice, so that programs that have only those can take part
        along, side = 256, math.isqrt(count // 256)
        last = n - 1
        matrix = last * np.array(
            [[0.10 / along, 0.7 / side, 0, 0.1], [0.07 / along, 0, 0.7 / side, 0.1], [0.9 / along, 0, 0, 0.05]]
        )
        k, j, i = np.meshgrid(np.arange(side), np.arange(side), np.arange(along), indexing="ij")
        at = (np.stack([i, j, k, np.ones_like(i)], -1).reshape(-1, 4) @ matrix.T).astype(np.float32)
        return Points(data, coefficients, at, ((along, side, side), matrix))

    def samples(self, *, random: bool, derivative: int = 0) -> Work:
        work, field = self.points(random=random), clvol.Field(self.head(self.n))
        cost = GRADIENT if derivative else SCATTERED if random else VALUE
        theirs = peers.of("gradient" if derivative else "sample", work)
        return Work(
            partial(field.gradient if derivative else field, work.at),
            theirs,
            float(len(work.at)),
            "Msample/s",
            cost,
            self.repeats,
            _difference,
        )

    # -- samples inside frames --

    def samples_in_frames(self, *, spacing: float, shaded: bool) -> Work:
        """Every sample of the lattice: no skipping, no early termination."""
        renderer = self.renderer(self.n)
        size = (64, 64) if self.quick else (256, 256)
        radius = float(np.linalg.norm(renderer.volume.corners[0] - renderer.volume.center))
        zoom = 2 * radius / (spacing * size[1])
        cameras = [clvol.Camera.orbit(a, e, projection="orthographic", zoom=zoom, fit="volume") for a, e in TURNS]
        fog = clvol.TransferFunction(((0.0, (0.3, 0.2, 0.1)), (2000.0, (1.0, 1.0, 1.0))), ((0.0, 1e-4),), 1.0)
        mode = "composite" if shaded else "mean"
        look: dict[str, Any] = {"transfer": fog, "rays": 1, "skipping": False} | ({"lights": clvol.Light()} if shaded else {})

        def ours() -> Array:
            frames = [renderer.render(camera, mode, size, 0.5, **look) for camera in cameras]
            return np.stack(frames)

        def by_rays() -> Array:
            with renderer.device.limited(tile=BY_RAYS):
                return ours()

        theirs = {"clvol, ray by ray": Peer(by_rays)}
        amount = sum(samples_on_lattice(renderer.volume, camera, size, 0.5) for camera in cameras)
        return Work(ours, theirs, amount, "Msample/s", plane_cost(spacing, shaded), min(3, self.repeats), _difference)

    # -- frames --

    def frame(self, shot: Shot) -> Work:
        renderer = self.renderer(shot.data.shape[0])
        theirs = peers.of("frame", shot)
        theirs["clvol, λ = 0.1"] = Peer(partial(draw, self.renderer(shot.data.shape[0], filter=self.smoothed.name), shot))
        if shot.mode == "isosurface":
            theirs["clvol, stepped, 0.5 voxel"] = Peer(partial(draw, renderer, replace(shot, step=0.5), method="stepped"))
        amount = float(shot.size[0] * shot.size[1])
        return Work(partial(draw, renderer, shot), theirs, amount, "Mpixel/s", None, self.repeats, _difference)

    def radiograph(self) -> Work:
        """Line integrals in a pose, and beside them those with their derivatives."""
        radiograph = clvol.Radiograph(self.renderer(self.n).field, camera(), self.size)
        pose = (1.0, -2.0, 0.5, 0.02, -0.01, 0.03)
        theirs = {"clvol, derivatives too": Peer(lambda: radiograph.gradient(pose)[0])}
        return Work(
            lambda: radiograph(pose), theirs, float(self.size[0] * self.size[1]), "Mpixel/s", None, self.repeats, _difference
        )

    def frame_of(self, n: int, mode: str) -> Work:
        kind = "uint8" if n >= 1024 else "float32"
        self.require(n, kind)
        unit = scene.SCALE[kind]
        renderer = self.renderer(n, kind)
        transfer = clvol.TransferFunction.ramp((0.0, 2300.0 * unit))
        shot = Shot(renderer.volume.data, camera(), mode, self.size, 1.0, transfer, scene.BONE * unit)
        return Work(partial(draw, renderer, shot), {}, float(self.size[0] * self.size[1]), "Mpixel/s", None, self.repeats)

    def require(self, n: int, kind: str) -> None:
        """Raise `Skip` if a volume of this size cannot be rendered here."""
        coefficients = 4 * (n + 8) ** 3
        try:
            self.device.buffers.require_room(coefficients)
        except OutOfMemoryError as error:
            raise Skip(str(error)) from None
        wanted = 1.3 * coefficients + np.dtype(kind).itemsize * n**3
        if 0 < available_memory() < wanted:
            raise Skip(f"it takes {wanted / 2**30:.1f} GiB; {available_memory() / 2**30:.1f} GiB are available")

    # -- magnify --

    def magnify(self, n: int) -> Work:
        data = self.head(n)
        theirs = peers.of("magnify", data)
        amount = float((2 * n) ** 3)
        return Work(lambda: clvol.magnify(data, 2).data, theirs, amount, "Mvoxel/s", MAGNIFY, self.repeats, _difference_inside)

    # -- new processes --

    def first_frame(self, n: int) -> dict[str, Any]:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, "volume.npy")
            np.save(file, self.head(n))
            cold = fresh.run(file, Path(folder, "cache"))["seconds"]
            warm = sorted(fresh.run(file, Path(folder, "cache"))["seconds"] for _ in range(1 if self.quick else 3))
        middle = warm[len(warm) // 2]
        return {"seconds": {"clvol": middle, "with an empty cache": cold}, "kernel_build": cold - middle}

    def memory(self, n: int, kind: str) -> dict[str, Any]:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, "volume.npy")
            np.save(file, self.head(n, kind))
            fresh.run(file, Path(folder, "cache"))  # builds the kernels, which takes memory too
            measured = fresh.run(file, Path(folder, "cache"))
        return {"value": measured["bytes"] / measured["volume"], "unit": "× the volume"}


def all_cases(bench: Bench) -> Iterator[Case]:
    """Every case, ordered so that neighbours share volumes."""
    n = bench.n
    large = [2 * n, *([] if bench.quick or not bench.huge else [4 * n])]
    yield Case(f"prefilter {n}³, on the device", lambda: bench.resident_prefilter(n))
    yield Case(f"prefilter {n}³, array to array", lambda: bench.array_prefilter(n))
    yield Case(f"prefilter {n}³ and upload", lambda: bench.upload(n))
    yield Case("cubic along rays", lambda: bench.samples(random=False))
    yield Case("cubic along rays, gradient", lambda: bench.samples(random=False, derivative=1))
    yield Case("cubic at random points", lambda: bench.samples(random=True))
    for shaded in (False, True):
        for spacing in (0.3, 0.5):
            what = "composite, shaded" if shaded else "value"
            yield Case(
                f"samples in frames, {what}, pixels {spacing} voxel",
                partial(bench.samples_in_frames, spacing=spacing, shaded=shaded),
            )
    for name in shots(bench):
        yield Case(f"frame {bench.size[0]}² of {n}³, {name}", partial(_frame_by_name, bench, name))
    yield Case(f"radiograph {bench.size[0]}² of {n}³", bench.radiograph)
    yield Case(f"magnify ×2, {n // 2}³, prefilter included", lambda: bench.magnify(n // 2))
    yield Case(f"first frame of {n}³ in a new process", lambda: bench.first_frame(n))
    for kind in ("float32", "uint16"):
        yield Case(f"peak memory, {kind} {n}³", partial(bench.memory, n, kind))
    for side in (n // 2, n, *large):
        for mode in ("isosurface", "mip"):
            yield Case(f"frame against size, {mode}, {side}³", partial(bench.frame_of, side, mode))
    yield Case(f"prefilter {2 * n}³, on the device", lambda: bench.resident_prefilter(2 * n))


def camera() -> clvol.Camera:
    return clvol.Camera.orbit(30, 15, zoom=1.8, fit="volume")


def shots(bench: Bench) -> dict[str, Callable[[], Shot]]:
    """The pictures that peers render too."""
    ramp = clvol.TransferFunction.ramp((0.0, 2300.0))

    def shot(mode: str, transfer: clvol.TransferFunction) -> Shot:
        return Shot(bench.head(bench.n), camera(), mode, bench.size, 1.0, transfer, scene.BONE)

    return {
        "isosurface": lambda: shot("isosurface", ramp),
        "opaque, shaded": lambda: shot("composite", scene.OPAQUE),
        "translucent, shaded": lambda: shot("composite", scene.TRANSLUCENT),
        "mip": lambda: shot("mip", ramp),
    }


def _frame_by_name(bench: Bench, name: str) -> Work:
    return bench.frame(shots(bench)[name]())


def draw(renderer: clvol.Renderer, shot: Shot, **options: Any) -> Array:
    """Our side of a `Shot`; `options` are the mode's."""
    if shot.mode == "isosurface":
        options |= {"isovalue": shot.isovalue, "color": shot.color}
    options |= {"lights": clvol.Light(), "transfer": shot.transfer}
    left_out = unheard(as_mode(shot.mode), options)
    options = {name: value for name, value in options.items() if name not in left_out}
    return np.asarray(renderer.render(shot.camera, shot.mode, shot.size, shot.step, rays=1, **options))  # a ray, as others draw


def samples_on_lattice(volume: clvol.Volume, camera: clvol.Camera, size: tuple[int, int], step: float) -> float:
    """The number of samples in a frame without skipping: lengths of rays in the volume over their spacing (see `Planes`)."""
    aspect = size[0] / size[1]
    view = camera.view(volume, aspect)
    planes = Planes(volume, view, aspect, step)
    a = ((np.arange(size[0]) + 0.5) / size[0] * 2 - 1)[:, None] * aspect * view.half_height
    b = (1 - (np.arange(size[1]) + 0.5) / size[1] * 2)[None, :, None] * view.half_height
    across = a[:, None] * view.right + b * view.up
    starts, directions = np.broadcast_arrays(view.eye, view.forward + across)
    if view.orthographic:
        starts, directions = np.broadcast_arrays(view.eye + across, view.forward)
    inverse = volume.world_to_index_matrix
    starts, directions = (starts - np.asarray(volume.origin)) @ inverse.T, directions @ inverse.T
    with np.errstate(divide="ignore", invalid="ignore"):
        faces = np.stack([(np.full(3, -0.5) - starts) / directions, (np.asarray(volume.size) - 0.5 - starts) / directions])
    enter, leave = np.nanmax(faces.min(0), -1), np.nanmin(faces.max(0), -1)
    length, along = np.linalg.norm(directions, axis=-1), np.abs(directions[..., planes.axis])
    rate = np.where(along > OBLIQUE * length, along / planes.spacing, length / step)  # samples, a unit of the ray's parameter
    return float((np.clip(leave - enter, 0, None) * rate).sum())


# -- inner ------------------------------------------------------------------------------------------------------


def _prefilter(resident: Coefficients) -> None:
    """The part of `coefficients_of` between copying the samples and filling the halo."""
    extent, sizes = tuple(resident.extent.tolist()), tuple(resident.size[:3].tolist())
    prefilter_in_place(resident.device, resident.buffer, resident.filter, resident.boundary, extent, sizes, resident.volume.ndim)
    resident.device.finish()


def _difference(ours: Array, theirs: Array) -> float:
    """The RMS difference relative to the range, over the points that both have."""
    count = min(len(ours), len(theirs))
    a, b = ours[:count], theirs[:count]
    return float(np.sqrt(np.mean((a - b) ** 2, dtype=np.float64)) / np.ptp(a))


def _difference_inside(ours: Array, theirs: Array) -> float:
    inner = (slice(_EDGE, -_EDGE),) * 3
    return _difference(ours[inner], theirs[inner])
