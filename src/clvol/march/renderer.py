"""Pictures of volumes: the host side of march.cl.

The samples of a ray are where it crosses equally spaced planes perpendicular to one axis of the volume,
the axis most parallel to the view. In index space an axis of ``n`` samples spans ``[-1/2, n - 1/2]``;
it holds ``K`` planes at ``-1/2 + (k + 1/2) n / K``, with ``K`` the least number such that no ray advances
more than `step` voxels from one plane to the next. Rays that make an angle of more than 60° with the
axis would need planes too close: they step `step` voxels along themselves, from half a step past where
they enter. `reference/march.py` samples the same lattice.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from types import TracebackType
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.boundary import DEFAULT_BOUNDARY, Boundary, as_boundary
from clvol.camera import Camera, View
from clvol.checks import number, one_of, whole
from clvol.color import color_of
from clvol.device import Device, as_device
from clvol.errors import GeometryError, OptionError
from clvol.filter import DEFAULT_FILTER, Filter, as_filter
from clvol.light import HEADLIGHT, MAX_LIGHTS, Light, Material
from clvol.mode import DEFAULT_MODE, Mode, as_mode
from clvol.spline.build import row_reach, row_width
from clvol.spline.evaluator import Evaluator, EvaluatorName, FetchName, choose_evaluator
from clvol.spline.field import Floats, Progress, coefficients_of
from clvol.spline.minmax import BLOCK, MAX_LEVELS, MinMax
from clvol.transfer import TABLE_SIZE, TransferFunction, otsu_threshold
from clvol.volume import Volume, as_volume

__all__ = ["OBLIQUE", "OUTPUTS", "Lattice", "Renderer", "pixel_offsets", "render"]

OUTPUTS = ("rgba", "depth", "normal", "position", "visited")
OBLIQUE = 0.5  # cosine between ray and axis below which a ray steps along itself
FLAT = 1e-5  # gradients below this share of the range, or of the greatest magnitude, per mean spacing are rounding: no normal
TOLERANCE = 1e-4  # of the range: how near to the isovalue a surface is drawn
DEFAULT_SURFACE = (0.93, 0.87, 0.76)
SLAB = 8  # samples of a slab at most: a work-item holds a patch for each
_BITS = 8.0  # of the sampler's fraction, before pictures are made by it: what texture units have
_LAUNCH_SECONDS = 0.25
_MAX_PLANES = 1 << 20
_MAX_SIZE = 1 << 15
_MAX_ANISOTROPY = 1e6  # of spacings: what float32 carries
_ROW_SECONDS = 1.5e-9  # a generous guess of the time of one row of taps on one processor core; it is corrected as tiles finish

# The parameter block of march.cl, declared once: the struct of the kernels is generated from it. All
# fields are four bytes wide, so that it has the same layout everywhere.
FRAME = np.dtype(
    [(name, np.float32, 3) for name in ("origin", "origin_u", "origin_v", "direction", "direction_u", "direction_v")]
    + [(name, np.float32, 3) for name in ("low", "high", "clip_low", "clip_high", "surface", "background", "world_origin")]
    + [(name, np.float32, 9) for name in ("index_to_world", "gradient")]
    + [("light", np.float32, 8 * MAX_LIGHTS), ("offset", np.float32, 2)]
    + [
        (name, np.float32)
        for name in (
            "ahead",
            "unit",
            "oblique",
            "plane",
            "plane_back",
            "spacing",
            "planes",
            "stride",
            "table_low",
            "table_scale",
            "per_unit_distance",
            "termination",
            "isovalue",
            "tolerance",
            "ambient",
            "diffuse",
            "specular",
            "shininess",
            "weight",
            "slab",
            "margin",
            "least_shine",
        )
    ]
    + [(name, np.int32) for name in ("axis", "orthographic", "clipped", "lights", "whole_shininess", "width", "height")]
    + [(name, np.int32) for name in ("pass", "last_pass", "opaque", "skipping", "levels")]
    + [("blocks", np.int32, 3), ("level_at", np.int32, MAX_LEVELS)]
)


def _frame_declaration() -> str:
    """frame.cl: the struct that `FRAME` is on the device."""
    lines = []
    for name in FRAME.names or ():
        kind = FRAME[name]
        base, shape = (kind.subdtype[0], kind.subdtype[1]) if kind.subdtype else (kind, ())
        lines.append(f"    {'int' if base == np.int32 else 'float'} {name}{''.join(f'[{n}]' for n in shape)};")
    return "typedef struct {\n" + "\n".join(lines) + "\n} frame_t;\n"


@dataclass(frozen=True)
class Tile:
    """The rays of one work-item of march.cl: how many across and down, how many at a time, and whether they share planes."""

    width: int = 1
    height: int = 1
    lanes: int = 1
    patched: bool = False


RAYS = Tile()  # one ray a work-item: for GPUs, and wherever coefficients are not read as rows of a buffer
PLANES = Tile(16, 16, 8, patched=True)  # plane marching, for processors


class Lattice:
    """The planes on which a view is sampled; see the module's docstring.

    Attributes
    ----------
    axis : int
        0, 1 or 2 for x, y, z.
    planes : int
        How many.
    spacing : float
        Their distance in voxels.
    oblique : bool
        Whether some rays are too oblique to them and step along themselves.
    """

    def __init__(self, volume: Volume, view: View, aspect: float, step: float) -> None:
        inverse = volume.world_to_index_matrix
        forward = inverse @ view.forward
        self.axis = int(np.argmax(np.abs(forward)))
        corners = [forward]
        if not view.orthographic:
            sides = [(a, b) for a in (-1, 1) for b in (-1, 1)]
            corners = [inverse @ (view.forward + view.half_height * (a * aspect * view.right + b * view.up)) for a, b in sides]
        cosine = min(abs(float(d[self.axis])) / float(np.linalg.norm(d)) for d in corners)
        if any(d[self.axis] * forward[self.axis] < 0 for d in corners):
            cosine = 0.0  # so wide that some rays run the other way
        n = volume.size[self.axis]
        self.oblique = cosine < OBLIQUE
        wanted = n / (step * max(cosine, OBLIQUE))
        if wanted > _MAX_PLANES:
            raise OptionError(f"step must give no more than {_MAX_PLANES} planes; {step:g} would give {wanted:.3g}")
        if self.oblique and math.hypot(*volume.size) > _MAX_PLANES * step:
            raise OptionError(f"step must give no more than {_MAX_PLANES} samples a ray; got {step:g} for oblique rays")
        self.planes = max(1, math.ceil(wanted - 1e-9))
        self.spacing = n / self.planes


def pixel_offsets(samples: int) -> NDArray[np.float64]:
    """Where in a pixel its samples lie: the first in the middle, the others by the R2 sequence; (samples, 2)."""
    golden = np.array([0.7548776662466927, 0.5698402909980532])  # 1/g, 1/g² with g³ = g + 1
    return np.asarray((0.5 + np.arange(samples)[:, None] * golden) % 1.0)


class Renderer:
    """A volume held on a device, to be drawn many times.

    Parameters
    ----------
    volume : Volume or array-like, 3-D
        What to draw.
    filter, boundary : str, Filter, Boundary
        How it is reconstructed between its samples.
    device : Device, str or int, optional
        See `as_device`.

    Raises
    ------
    DataError, OptionError, DeviceError

    Notes
    -----
    A context manager: leaving it frees the device's memory.
    """

    def __init__(
        self,
        volume: Volume | ArrayLike,
        filter: str | Filter = DEFAULT_FILTER,
        boundary: str | Boundary = DEFAULT_BOUNDARY,
        device: Device | str | int | None = None,
    ) -> None:
        self.volume = as_volume(volume)
        if self.volume.ndim != 3:
            raise OptionError(f"rendering takes a volume with 3 axes; got shape {self.volume.shape}")
        row, rule = as_filter(filter), as_boundary(boundary)
        self.device = as_device(device)
        self.coefficients = coefficients_of(self.volume, row, rule, self.device)
        self._transfers: dict[Mode, TransferFunction] = {}
        self._bounds: dict[Evaluator, MinMax] = {}

    @property
    def filter(self) -> Filter:
        return self.coefficients.filter

    def close(self) -> None:
        """Free the device's memory."""
        self.coefficients.release()
        while self._bounds:
            self._bounds.popitem()[1].release()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def render(
        self,
        camera: Camera | None = None,
        mode: str | Mode = DEFAULT_MODE,
        size: tuple[int, int] = (512, 512),
        step: float = 0.5,
        *,
        transfer: TransferFunction | None = None,
        isovalue: float | None = None,
        color: Sequence[float] | str = DEFAULT_SURFACE,
        shading: bool = True,
        gradient: Literal["analytic", "central"] = "analytic",
        material: Material | None = None,
        lights: Sequence[Light] = (HEADLIGHT,),
        background: Sequence[float] | str | None = (0.0, 0.0, 0.0),
        clip: tuple[Sequence[float], Sequence[float]] | None = None,
        samples: int = 1,
        termination: float = 1e-3,
        skipping: bool = True,
        evaluator: EvaluatorName = "auto",
        fetch: FetchName = "auto",
        outputs: str | Sequence[str] = "rgba",
        progress: Progress | None = None,
        _tile: Tile | None = None,
    ) -> Any:
        """One picture.

        Parameters
        ----------
        camera : Camera, optional
            Default `Camera.orbit()`, fitted to the volume.
        mode : str
            "composite", "isosurface", "mip", "minip" or "mean".
        size : (width, height)
            In pixels.
        step : float
            The most that a ray advances between samples, in voxels.
        transfer : TransferFunction, optional
            Default: from the histogram for "composite", a grey ramp for the projections.
        isovalue : float, optional
            Of the surface; default: Otsu's threshold of the histogram.
        color : three numbers or a name
            Of the surface.
        shading : bool
            Light "composite" and "isosurface" by the gradient.
        gradient : {"analytic", "central"}
            "analytic" is the exact derivative of the function drawn. "central" takes differences of one voxel
            to either side, as many others do. `nearest` has no derivative that tells anything and is always
            shaded by central differences.
        material : Material, optional
            How light is answered.
        lights : sequence of Light
            Up to 4; default a headlight.
        background : three numbers, a name, or None
            None leaves the picture transparent; its colours are then not premultiplied.
        clip : (low, high), optional
            A box of world coordinates (x, y, z) outside which nothing is drawn.
        samples : int
            Rays a pixel.
        termination : float
            A ray ends when no more than this share of light would come through: colours err by at most this, times
            the brightest colour behind.
        skipping : bool
            Do not look where the function's bounds say that nothing can be seen. The picture is the same to the
            last bit.
        evaluator, fetch
            As for `clvol.sample`.
        outputs : str or sequence of str
            Of "rgba", "depth", "normal", "position", "visited". Several give a dictionary. Depth is the world distance
            from the eye along the ray (orthographic: from the camera's plane), inf where there is nothing;
            normals face the viewer; NaN where there are none. In "composite" they are where half of the light
            is stopped, in projections where the extreme lies; "mean" has none. "visited" is the share of a ray's
            samples that was looked at, NaN where it has none.
        progress : callable, optional
            Called with the fraction done.

        Returns
        -------
        ndarray of float32, shape (height, width, 4), or a dictionary
            Red, green, blue, opacity in 0..1; row 0 is the top. Depth and visited have shape (height, width),
            normals and positions (height, width, 3).

        Raises
        ------
        OptionError, GeometryError, DeviceError
        """
        chosen = as_mode(mode)
        camera = Camera.orbit() if camera is None else camera
        material = Material() if material is None else material
        lights = (lights,) if isinstance(lights, Light) else lights
        _instance("camera", camera, Camera)
        _instance("material", material, Material)
        _instance("shading", shading, bool, np.bool_)
        _instance("skipping", skipping, bool, np.bool_)
        if transfer is not None:
            _instance("transfer", transfer, TransferFunction)
        if not isinstance(lights, Sequence) or not all(isinstance(light, Light) for light in lights):
            raise OptionError(f"lights must be a Light or a sequence of them; got {lights!r}")
        if progress is not None and not callable(progress):
            raise OptionError(f"progress must be callable; got {progress!r}")
        if not isinstance(outputs, (str, Sequence)) or not outputs:
            raise one_of("outputs", outputs, OUTPUTS)
        wanted = (outputs,) if isinstance(outputs, str) else tuple(outputs)
        for name in wanted:
            if name not in OUTPUTS:
                raise one_of("outputs", name, OUTPUTS)
        if gradient not in ("analytic", "central"):
            raise one_of("gradient", gradient, ("analytic", "central"))
        width, height = _size(size)
        path = choose_evaluator(self.device, self.filter, evaluator, fetch, bits=_BITS)
        table = transfer if transfer is not None else self._default_transfer(chosen)
        frame, lattice = self._frame(
            camera,
            (width, height),
            step,
            table,
            self._threshold if isovalue is None and chosen.name == "isosurface" else isovalue,
            color_of("color", color),
            material,
            lights,
            clip,
            termination,
        )
        if background is not None:
            frame["background"], frame["opaque"] = color_of("background", background), 1
        if skipping and chosen.skips:
            self._skip(frame, path)
        guides = wanted != ("rgba",)
        central = gradient == "central" or not self.filter.has_gradient
        arrays = self._march(
            frame,
            lattice,
            chosen,
            path,
            table,
            shading,
            central,
            guides,
            whole("samples", samples, least=1, most=4096),
            progress,
            _tile,
        )
        return arrays[wanted[0]] if isinstance(outputs, str) else {name: arrays[name] for name in wanted}

    @cached_property
    def _threshold(self) -> float:
        return otsu_threshold(self.volume)

    def _default_transfer(self, mode: Mode) -> TransferFunction:
        if mode not in self._transfers:
            low, high = self.volume.value_range
            ramp = TransferFunction.ramp((low, low + mode.ramp * (high - low)))
            self._transfers[mode] = TransferFunction.automatic(self.volume) if mode.automatic else ramp
        return self._transfers[mode]

    def _frame(
        self,
        camera: Camera,
        size: tuple[int, int],
        step: float,
        transfer: TransferFunction,
        isovalue: float | None,
        surface: tuple[float, float, float],
        material: Material,
        lights: Sequence[Light],
        clip: tuple[Sequence[float], Sequence[float]] | None,
        termination: float,
    ) -> tuple[NDArray[Any], Lattice]:
        """The parameter block of one picture, computed in float64, and where it is sampled."""
        step = min(number("step", step, above=0), 1e30)
        termination = number("termination", termination, least=0, below=1)
        if isovalue is not None:
            isovalue = min(max(number("isovalue", isovalue), -3e38), 3e38)  # as good as any beyond float32
        if len(lights) > MAX_LIGHTS:
            raise OptionError(f"there may be up to {MAX_LIGHTS} lights; got {len(lights)}")
        volume, (width, height) = self.volume, size
        aspect = width / height
        least_spacing, greatest_spacing = min(volume.spacing), max(volume.spacing)
        if greatest_spacing > _MAX_ANISOTROPY * least_spacing or not 1e-30 <= least_spacing <= greatest_spacing <= 1e30:
            raise GeometryError(
                "rendering takes spacings from 1e-30 to 1e30 that differ by a factor of up to "
                f"{_MAX_ANISOTROPY:g}; got {volume.spacing}"
            )
        view = camera.view(volume, aspect)
        lattice = Lattice(volume, view, aspect, float(step))
        inverse, origin = volume.world_to_index_matrix, np.asarray(volume.origin)
        frame = np.zeros((), FRAME)

        # picture coordinates: a from -1 to 1 along `right`, b along `up`; pixel (0, 0) is top left
        across, down = view.right * view.half_height * aspect, -view.up * view.half_height
        corner, per_x, per_y = -across - down, 2 * across / width, 2 * down / height
        # rays start on the plane through the volume's centre; world units are mean spacings, so that none is too
        # large or small for float32
        unit = float(np.mean(volume.spacing))
        ahead = float((volume.center - view.eye) @ view.forward)
        start = inverse @ (view.eye + ahead * view.forward - origin)
        spread = 1.0 if view.orthographic else ahead
        frame["origin"] = start + spread * (inverse @ corner)
        frame["origin_u"], frame["origin_v"] = spread * (inverse @ per_x), spread * (inverse @ per_y)
        fan = 0.0 if view.orthographic else unit
        frame["direction"] = unit * (inverse @ view.forward) + fan * (inverse @ corner)
        frame["direction_u"], frame["direction_v"] = fan * (inverse @ per_x), fan * (inverse @ per_y)
        frame["orthographic"], frame["ahead"], frame["unit"] = view.orthographic, ahead / unit, unit
        frame["index_to_world"] = volume.index_to_world_matrix.ravel() / unit
        frame["world_origin"] = origin
        frame["low"], frame["high"] = -0.5, np.asarray(volume.size) - 0.5
        if clip is not None:
            low, high = _box(clip)
            frame["clipped"], frame["clip_low"], frame["clip_high"] = 1, (low - origin) / unit, (high - origin) / unit

        n = volume.size[lattice.axis]
        frame["axis"], frame["planes"], frame["spacing"], frame["oblique"] = (
            lattice.axis,
            lattice.planes,
            lattice.spacing,
            OBLIQUE,
        )
        frame["slab"] = min(SLAB, max(1, int(BLOCK / max(lattice.spacing, step))))  # samples that cross about one block
        frame["plane"], frame["plane_back"], frame["stride"] = -0.5 + lattice.spacing / 2, n - 0.5 - lattice.spacing / 2, step

        first, last = transfer.value_range
        frame["table_low"], frame["table_scale"] = first, min((TABLE_SIZE - 1) / (last - first), 1e38) if last > first else 0.0
        frame["per_unit_distance"], frame["termination"] = unit / (transfer.unit_distance or unit), termination
        least, greatest = volume.value_range
        frame["isovalue"] = least if isovalue is None else isovalue
        frame["tolerance"] = TOLERANCE * (greatest - least)
        flat = FLAT * max(greatest - least, greatest, -least) / unit
        frame["gradient"] = inverse.ravel() / max(flat, 1e-36 * float(np.abs(inverse).max()))  # finite in float32
        frame["surface"] = surface
        for name in ("ambient", "diffuse", "specular", "shininess"):
            frame[name] = getattr(material, name)
        exponent = material.shininess  # cosines whose power is below 2**-60 are as good as nought
        frame["least_shine"] = 2.0 ** (-60 / max(exponent, 1e-3))
        frame["whole_shininess"] = int(exponent) if float(exponent).is_integer() and exponent < 1 << 20 else 0
        frame["lights"] = len(lights)
        rows = [[*(light.direction or (0, 0, 0)), float(light.direction is None), *light.color, 0] for light in lights]
        frame["light"][: 8 * len(rows)] = np.ravel(rows) if rows else []
        frame["width"], frame["height"] = width, height
        return frame, lattice

    def _skip(self, frame: NDArray[Any], path: Evaluator) -> None:
        """Tell the ray loop where the bounds are, which are computed for the first picture."""
        if path not in self._bounds:
            self._bounds[path] = MinMax(self.coefficients, path)
        bounds = self._bounds[path]
        frame["skipping"], frame["levels"] = 1, len(bounds.offsets)
        frame["blocks"], frame["level_at"][: len(bounds.offsets)] = bounds.blocks, bounds.offsets
        # positions are rounded by up to a few millionths of the volume's size; the rest is reserve
        frame["margin"] = 0.01 + 1e-6 * max(self.volume.size)

    def _march(
        self,
        frame: NDArray[Any],
        lattice: Lattice,
        mode: Mode,
        path: Evaluator,
        transfer: TransferFunction,
        shading: bool,
        central: bool,
        guides: bool,
        samples: int,
        progress: Progress | None,
        tile: Tile | None,
    ) -> dict[str, Floats]:
        device, held = self.device, self.coefficients
        if tile is None:
            tile = PLANES if device.kind == "cpu" and not path.image and not path.paired else RAYS
        built = device.build(
            "march/march.cl",
            {
                **held.defines(path),
                "LANES": tile.lanes,
                "TILE_WIDTH": tile.width,
                "TILE_HEIGHT": tile.height,
                "PATCHED": int(tile.patched),
                "ENDPOINTS": int(mode.endpoints),
                "SHADED": int(shading),
                "GRADIENT_CENTRAL": int(central),
                "GUIDES": int(guides),
                "TABLE_SIZE": TABLE_SIZE,
                "BLOCK": BLOCK * self.filter.scale,
                "SLAB": SLAB,
                "COORD_DOUBLE": 0,
            },
            {"mode.cl": mode.file},
            {"frame.cl": _frame_declaration()},
        )
        width, height = int(frame["width"]), int(frame["height"])
        channels = {"rgba": (4,), "depth": (), "normal": (3,), "position": (3,), "visited": ()}
        wanted = {name: np.empty((height, width, *n), np.float32) for name, n in channels.items() if guides or name == "rgba"}
        unused = [device.allocate(4) for name in channels if name not in wanted]  # nobody asked: not computed
        table = device.upload(_searchable(transfer.table()))
        bounds = self._bounds[path].buffer if frame["skipping"] else table  # any: it is not read
        kernel = built.kernel("march")
        source = held.argument(path)
        offsets = pixel_offsets(samples)
        frame["last_pass"] = samples - 1
        together = tile.patched and not lattice.oblique
        budget = _Budget(device, self.filter, lattice.planes, together, central or shading)
        with contextlib.ExitStack() as lent:
            buffers = [lent.enter_context(device.lent(array, write=True)) for array in wanted.values()] + unused
            for i, offset in enumerate(offsets):
                frame["offset"], frame["weight"], frame["pass"] = offset, 1 / samples, i
                block = device.upload(frame[None])
                for x, y, w, h in budget.tiles(width, height):
                    across, down = -(-w // tile.width), -(-h // tile.height)
                    shape = (1, 1) if tile.patched else (8, 8)
                    whole = tuple(-(-n // m) * m for n, m in zip((across, down), shape, strict=True))
                    with device.errors:
                        kernel(
                            device.queue,
                            whole,
                            shape,
                            source,
                            held.extent,
                            bounds,
                            block,
                            table,
                            *buffers,
                            global_offset=(x // tile.width, y // tile.height),
                        )
                    device.finish()
                    if progress:
                        progress((i + min(1.0, ((y + h) * width) / (width * height))) / samples)
        return wanted


class _Budget:
    """Cuts a frame into tiles, none of which should run longer than a quarter of a second.

    The time of a ray is bounded by its number of planes; the guess of the time of one sample is raised
    when a tile took longer than guessed, and never lowered: the next tile may hold what this one did not.
    """

    def __init__(self, device: Device, filter: Filter, planes: int, together: bool, shaded: bool) -> None:
        cores = int(device.handle.max_compute_units) * (1 if device.kind == "cpu" else 32)
        chunks = row_reach(filter) // row_width(filter)
        rows = filter.support * chunks / 2 + 2 if together else filter.support**2 * chunks + 8
        self._per_pixel = planes * rows * _ROW_SECONDS * (3 if shaded else 1) / max(1, cores)

    def tiles(self, width: int, height: int) -> Any:
        y = 0
        while y < height:
            area = _LAUNCH_SECONDS / self._per_pixel
            h = min(height - y, max(16, int(area / width) // 16 * 16))
            x = 0
            while x < width:
                w = min(width - x, max(16, int(_LAUNCH_SECONDS / self._per_pixel / h) // 16 * 16))
                started = time.perf_counter()
                yield x, y, w, h
                self._per_pixel = max(self._per_pixel, (time.perf_counter() - started) / (w * h))
                x += w
            y += h


def render(
    volume: Volume | ArrayLike,
    camera: Camera | None = None,
    mode: str | Mode = DEFAULT_MODE,
    filter: str | Filter = DEFAULT_FILTER,
    boundary: str | Boundary = DEFAULT_BOUNDARY,
    size: tuple[int, int] = (512, 512),
    step: float = 0.5,
    *,
    device: Device | str | int | None = None,
    outputs: str | Sequence[str] = "rgba",
    **options: Any,
) -> Any:
    """One picture of a volume; `Renderer` is the same for many pictures of one volume.

    Parameters are those of `Renderer` and of `Renderer.render`.

    Returns
    -------
    ndarray of float32, shape (height, width, 4)
        Red, green, blue and opacity in 0..1, or a dictionary if several `outputs` are asked for.
    """
    with Renderer(volume, filter, boundary, device) as renderer:
        return renderer.render(camera, mode, size, step, outputs=outputs, **options)


def _searchable(table: Floats) -> Floats:
    """The nodes of a transfer function, and behind them for each the next one that has some opacity; flat."""
    seen = np.where(table[:, 3] > 0, np.arange(len(table), dtype=np.float32), np.float32(np.inf))
    following = np.minimum.accumulate(seen[::-1])[::-1]
    return np.concatenate([table.ravel(), following])


def _size(size: tuple[int, int]) -> tuple[int, int]:
    try:
        width, height = size
    except (TypeError, ValueError):
        raise OptionError(f"size must be (width, height) in pixels; got {size!r}") from None
    return whole("width", width, least=1, most=_MAX_SIZE), whole("height", height, least=1, most=_MAX_SIZE)


def _instance(what: str, value: object, *kinds: type) -> None:
    if not isinstance(value, kinds):
        raise OptionError(f"{what} must be a {kinds[0].__name__}; got {value!r}")


def _box(clip: tuple[Sequence[float], Sequence[float]]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    try:
        low, high = (np.array([float(v) for v in corner]) for corner in clip)
    except (TypeError, ValueError):
        raise GeometryError(f"clip must be two corners (x, y, z); got {clip!r}") from None
    if low.shape != (3,) or high.shape != (3,) or np.isnan(low).any() or np.isnan(high).any() or (low >= high).any():
        raise GeometryError(
            f"clip must be two corners (x, y, z), each coordinate of the first less than of the second; got {clip!r}"
        )
    return low, high
