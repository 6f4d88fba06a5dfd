"""The work of the soak: small operations over the public API, each reproducible from its seed.

A deed is a function of a `World` and a random generator, which chooses its options; its result is compared to the last bit.
`DEEDS` lists them by name, with the number of seeds of each in the catalogue.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import pickle
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

import clvol
from clvol import analysis, figures, images, ndimage, phantoms, reference
from clvol.device import as_device
from clvol.filter.table import unregister_filter
from clvol.formats import WRITTEN
from clvol.jax import sample as jax_sample
from clvol.march.options import unheard
from clvol.nnunet import labels_from_logits, resample_to_shape
from clvol.scene.mode import as_mode
from clvol.show.picture import grid, labelled, to_png
from clvol.torch import sample as torch_sample
from clvol.volume import smoothing

__all__ = ["DEEDS", "NOT_DONE", "Deed", "World", "do"]

Random: TypeAlias = np.random.Generator

NOT_DONE = {
    "ClvolError": "a class of errors: they are raised",
    "ClvolWarning": "a class of warnings: they are raised",
    "ClusterError": "as above",
    "DataError": "as above",
    "DeviceError": "as above",
    "FormatError": "as above",
    "GeometryError": "as above",
    "MissingDependencyError": "as above",
    "OptionError": "as above",
    "OutOfMemoryError": "as above",
    "Boundary": "what `boundaries` holds",
    "Device": "what `devices` gives",
    "Filter": "what `filters` holds, and `bspline`, `from_pieces` and others make",
    "Mesh": "what `mesh` gives",
    "Output": "a type",
    "Picture": "what `render` gives",
    "Refined": "what `Renderer.refine` gives",
    "Warped": "what `warp` gives",
    "batch": "`Renderer`, once for each file",
    "show": "opens a viewer",
}
"""Public names that no deed uses, and why."""

MODES = ("composite", "isosurface", "mip", "attenuated", "minip", "mean", "surfaces", "integral")
FILTERS = (
    "linear",
    "bspline2",
    "bspline3",
    "bspline5",
    "bspline3-approx",
    "mitchell",
    "catmull-rom",
    "omoms3",
    "lanczos3",
    "nearest",
)
BOUNDARIES = ("mirror", "reflect", "wrap", "zero", "nearest", "constant", "grid-constant", "overlap")
SCIPY = ("mirror", "reflect", "nearest", "constant", "grid-constant", "wrap", "grid-wrap")
_figures = threading.Lock()  # matplotlib is not made for threads


@dataclass(frozen=True)
class Deed:
    """One kind of work.

    Parameters
    ----------
    work : callable
        Takes a `World` and a random generator.
    count : int
        Seeds in the catalogue; others are used once.
    """

    work: Callable[[World, Random], Any]
    count: int


DEEDS: dict[str, Deed] = {}


def _deed(count: int) -> Callable[[Callable[[World, Random], Any]], Callable[[World, Random], Any]]:
    def enter(work: Callable[[World, Random], Any]) -> Callable[[World, Random], Any]:
        DEEDS[work.__name__] = Deed(work, count)
        return work

    return enter


class World:
    """State shared by all threads of a process: volumes, files, and open renderers, fields and interpolators."""

    def __init__(self, folder: Path, quick: bool = False) -> None:
        self.folder, self.quick = folder, quick
        random = np.random.default_rng(1)
        z, y, x = np.mgrid[-1:1:20j, -1:1:24j, -1:1:28j]
        blob = np.exp(-3 * (x**2 + 1.4 * y**2 + z**2)) + 0.1 * np.sin(9 * x) * np.cos(7 * y)
        ct = np.clip(1800 * blob - 1000 + random.normal(0, 30, blob.shape), -1024, 3000)
        self.volumes = {
            "blob": clvol.Volume(blob.astype(np.float32), (1.0, 1.25, 1.5), (-3.0, 2.0, 8.0), units="mm"),
            "ct": clvol.Volume(np.asfortranarray(ct.astype(">i2")), (0.7, 0.7, 1.4), units="mm", space="LPS"),
            "noise": clvol.Volume(random.normal(size=(14, 15, 17))),
            "far": clvol.Volume(101_325 + 3 * blob[:12, :12, :12]),
            "labels": clvol.Volume((blob > 0.2).astype(np.uint8) + (blob > 0.6)),
            "signal": phantoms.marschner_lobb(20),
        }
        self.image = np.clip(255 * (0.5 + 0.4 * np.sin(np.hypot(*np.mgrid[-4:4:40j, -4:4:48j]) ** 2)), 0, 255).astype(np.uint8)
        self.photograph = np.stack([self.image, self.image[::-1], self.image[:, ::-1]], -1)
        self.modes = MODES[:2] if quick else MODES
        self.filters = ("bspline3",) if quick else FILTERS
        self.boundaries = ("mirror",) if quick else BOUNDARIES
        chosen = (("blob", "bspline3"),) if quick else (("blob", None), ("ct", "linear"), ("noise", "bspline3"), ("labels", None))
        self.renderers = [clvol.Renderer(self.volumes[name], row) for name, row in chosen]
        self.fields = [clvol.Field(self.volumes[name], "bspline3") for name in (("blob",) if quick else ("blob", "far", "ct"))]
        axes = [np.linspace(0, 2, n) for n in self.volumes["blob"].shape]
        self.interpolators = [clvol.Interpolator(axes, self.volumes["blob"].data, "cubic", bounds_error=False)]
        self.files = dict(_written(folder, self.volumes))

    def close(self) -> None:
        """Free the device's memory."""
        held: list[Any] = [*self.renderers, *self.fields, *self.interpolators]
        for one in held:
            one.close()

    @contextmanager
    def own_folder(self) -> Iterator[Path]:
        """A new folder for the files of one deed, removed afterwards."""
        folder = Path(tempfile.mkdtemp(dir=self.folder))
        try:
            yield folder
        finally:
            shutil.rmtree(folder)


def do(world: World, name: str, seed: int) -> tuple[str, bool]:
    """The hash of a deed's result, and whether it was a rejection."""
    random = np.random.default_rng([seed, *name.encode()])
    try:
        return _hash(DEEDS[name].work(world, random)), False
    except clvol.ClvolError as error:  # incompatible options: the same error each time
        text = str(error).replace(os.fspath(world.folder), "")
        return f"{type(error).__name__}: {text}", True


def _hash(value: Any) -> str:
    digest = hashlib.sha256()
    _feed(digest.update, value)
    return digest.hexdigest()


def _feed(update: Callable[[bytes], Any], value: Any) -> None:
    """Hash all bits of a result."""
    match value:
        case clvol.Volume():
            _feed(update, (value.data, value.spacing, value.origin, value.direction, value.units or ""))
        case clvol.Volumes():
            _feed(update, list(value))
        case np.ndarray() | np.generic():
            update(f"{value.dtype.str} {value.shape}".encode())
            update(np.ascontiguousarray(value).tobytes())
        case Mapping():
            _feed(update, [part for pair in value.items() for part in pair])
        case bytes():
            update(value)
        case tuple() | list():
            update(f"{len(value)} of".encode())
            for part in value:
                _feed(update, part)
        case None | str() | bool() | int() | float() | complex():
            update(repr(value).encode())
        case _:
            raise TypeError(f"a deed gave a {type(value)}")


# -- choosing ---------------------------------------------------------------------------------------------------------


def _one(random: Random, choices: Sequence[Any]) -> Any:
    return choices[int(random.integers(len(choices)))]


def _some(random: Random, table: Mapping[str, Sequence[Any]], share: float = 0.25) -> dict[str, Any]:
    """Each option with this probability."""
    return {name: _one(random, choices) for name, choices in table.items() if random.random() < share}


def _volume(world: World, random: Random) -> clvol.Volume:
    chosen: clvol.Volume = _one(random, list(world.volumes.values())[: 1 if world.quick else None])
    return chosen


def _points(volume: clvol.Volume, random: Random, count: int = 500) -> Any:
    low, high = volume.corners.min(0), volume.corners.max(0)
    return random.uniform(low - 1, high + 1, (count, volume.ndim)).astype(_one(random, ["f4", "f8"]))


def _array(random: Random, ndim: int | None = None) -> Any:
    shape = random.integers(3, 16, ndim or int(random.integers(1, 4)))
    return (100 * random.normal(size=shape)).astype(_one(random, ["f4", "f8", "i2", "u1", "c8"]))


def _camera(random: Random) -> clvol.Camera:
    if random.random() < 0.1:
        return clvol.Camera.look_at((40, 30, 20), (0, 0, 0))
    return clvol.Camera.orbit(
        float(random.uniform(0, 360)),
        float(random.uniform(-90, 90)),
        zoom=_one(random, [1.0, 1.5, 0.7]),
        projection="orthographic" if random.random() < 0.3 else "perspective",
        fit="volume" if random.random() < 0.5 else "matter",
    )


_FRAME: dict[str, Sequence[Any]] = {
    "step": (1.0, 0.3),
    "gradient": ("central",),
    "rays": (1, 3),
    "pixel_filter": ("linear", "mitchell"),
    "skipping": (False,),
    "evaluator": ("taps", "paired"),
    "background": (None, "white", (0.1, 0.2, 0.3)),
    "lights": (clvol.Light(), (clvol.Light((1, 2, 3)), clvol.Light((0, 0, 1), frame="camera"))),
    "material": (clvol.Material(0.1, 0.6, 0.5, 12.0),),
    "outputs": ("depth", ["rgba", "normal", "position"], ["depth", "visited"]),
}
_WORDS: dict[str, Sequence[Any]] = {
    "preset": ("mr-default", "ct-bone", "fluorescence"),
    "cmap": ("viridis", "gray"),
    "opacity": (0.5, ((0.1, 0.0), (0.8, 0.7))),
}
_OF_MODE: dict[str, dict[str, Sequence[Any]]] = {
    "composite": {"shading": (False,), "termination": (0.0, 0.05), "virtual": (2,), "tolerance": (0.02,)},
    "isosurface": {"isovalue": (0.3, 0.5), "method": ("stepped",), "color": ("steelblue",), "shading": (False,)},
    "attenuated": {"attenuation": (0.5, 5.0)},
    "surfaces": {"surfaces": ("0.3:tan:0.4,0.6:teal", "1 sigma:red:0.5"), "shading": (False,)},
}


def _look(world: World, random: Random) -> dict[str, Any]:
    """Options of one picture."""
    mode = _one(random, world.modes)
    sizes = ((64, 48),) if world.quick else ((64, 48), (97, 61), (33, 120))
    options: dict[str, Any] = {"camera": _camera(random), "mode": mode, "size": _one(random, sizes)}
    if world.quick:
        return options
    options |= _some(random, _FRAME, 0.2) | _some(random, _OF_MODE.get(mode, {}), 0.3)
    if mode not in ("mean", "integral"):
        options |= _some(random, _WORDS, 0.2)
    if "tolerance" in options:
        options.pop("step", None)
    own = {name: options[name] for name in _OF_MODE.get(mode, {}) if name in options}
    left_out = unheard(as_mode(mode, own), options, options.get("outputs", "rgba"))
    return {name: value for name, value in options.items() if name not in left_out}


# -- pictures ---------------------------------------------------------------------------------------------------------


@_deed(40)
def frames_of_one_renderer(world: World, random: Random) -> Any:
    """All threads share these renderers."""
    return _one(random, world.renderers).render(**_look(world, random))


@_deed(16)
def new_renderers(world: World, random: Random) -> Any:
    volume, row, rule = _volume(world, random), _one(random, world.filters), _one(random, world.boundaries)
    with clvol.Renderer(volume, row, rule) as renderer:
        return [renderer.render(**_look(world, random)) for _ in range(2)]


@_deed(20)
def pictures_at_once(world: World, random: Random) -> Any:
    volume = _volume(world, random)
    if random.random() < 0.5:
        transfer = clvol.TransferFunction.from_cmap("magma", volume.value_range, 0.6)
        scene = clvol.Scene((clvol.Medium(volume, transfer),), background=(0.2, 0.2, 0.2))
        return clvol.render(scene, _camera(random), size=(40, 40))
    return clvol.render(volume, **_look(world, random))


@_deed(4)
def joint_histograms(world: World, random: Random) -> Any:
    return clvol.joint_histogram(_one(random, (world.fields[0], world.volumes["blob"])), (16, 32)).counts


@_deed(6)
def pictures_of_boundaries(world: World, random: Random) -> Any:
    low, high = (0.2, 0.9)
    transfer = clvol.TransferFunction2D([((low, high), (float(random.uniform(0, 0.3)), None), "gold", 0.5)])
    with world.own_folder() as folder:
        transfer = clvol.read_transfer(transfer.save(folder / "edges.json"))  # type: ignore[assignment]  # either kind
    return clvol.render(world.volumes["blob"], _camera(random), size=(40, 40), transfer=transfer)


@_deed(6)
def modes_as_classes(world: World, random: Random) -> Any:
    classes = (
        clvol.Composite(),
        clvol.Isosurface(0.4),
        clvol.Mip(),
        clvol.Attenuated(1.0),
        clvol.Minip(),
        clvol.Mean(),
        clvol.Surfaces(),
        clvol.Integral(),
    )
    assert clvol.Regions().regions
    chosen: clvol.Mode = _one(random, classes[: len(world.modes)])
    assert chosen.name in clvol.modes()
    return _one(random, world.renderers).render(_camera(random), chosen, (48, 48))


@_deed(8)
def cut_open(world: World, random: Random) -> Any:
    volume = _volume(world, random)
    cuts = [clvol.Plane(random.normal(size=3), volume.center), clvol.Corner(volume.center, [np.inf] * 3)]
    return clvol.render(volume, _camera(random), _one(random, world.modes), (40, 40), clip=_one(random, [*cuts, cuts]))


@_deed(8)
def several_media(world: World, random: Random) -> Any:
    looks = [clvol.TransferFunction.from_cmap(name, (0.1, 1), 0.3) for name in ("magma", "viridis")]
    media = [clvol.Medium(_volume(world, random), look) for look in looks]
    return clvol.render(clvol.Scene(tuple(media)), _camera(random), _one(random, world.modes), (40, 40))


@_deed(6)
def slices(world: World, random: Random) -> Any:
    volume = _volume(world, random)
    plane = _one(random, ("x", 1, clvol.Plane(random.normal(size=3), volume.center)))
    return [clvol.slice(volume, plane, size=(40, 32)), clvol.orthogonal(volume, size=(64, 64))]


@_deed(4)
def meshes(world: World, random: Random) -> Any:
    found = clvol.mesh(_volume(world, random), "1sigma", closed=bool(random.integers(2)), curvature=True)
    labels = clvol.Volume(random.integers(0, 4, (5, 6, 7)).astype(np.uint8), labels=True)
    labels = clvol.labels.with_table(labels, {3: ("three", "red", 0.5)})
    between = clvol.mesh(labels, only=[0, "three"], filter="linear")
    one = between.of(3)
    return [found.vertices, found.faces, found.normals, found.curvature, between.vertices, between.labels, one.faces, one.normals]


@_deed(2)
def movies(world: World, random: Random) -> Any:
    with world.own_folder() as folder:
        made = clvol.movie(_volume(world, random), folder / "turn.zip", frames=3, size=(24, 24))
        return [made.frames, made.path.read_bytes()]


@_deed(6)
def uncertain_surfaces(world: World, random: Random) -> Any:
    sigma = float(random.uniform(0.001, 0.1))
    options: dict[str, Any] = {"outputs": ["position"]} if world.quick else {"outputs": ["rgba", "uncertainty"], "sigma": sigma}
    return world.renderers[0].render(_camera(random), "isosurface", (40, 40), **options)


@_deed(8)
def pictures_kept(world: World, random: Random) -> Any:
    picture = world.renderers[0].render(_camera(random), size=(40, 32))
    with world.own_folder() as folder:
        saved = clvol.save(picture, folder / f"picture{_one(random, ['.png', '.jpg', '.tif'])}")
        return [saved.read_bytes(), to_png(grid([picture, picture], 2)), labelled(picture, "soak")]


@_deed(4)
def pages(world: World, random: Random) -> Any:
    volume, mode = _volume(world, random), _one(random, ("composite", "isosurface", "surfaces", "mip", "minip"))
    with world.own_folder() as folder:
        return clvol.save_html(volume, folder / "page.html", _camera(random), mode, most=24, filter="bspline3").read_bytes()


@_deed(8)
def closed_under_another(world: World, random: Random) -> Any:
    """Closing while another thread renders gives it correct pictures or an error."""
    look = _look(world, random)
    with clvol.Renderer(world.volumes["blob"], "bspline3") as renderer:
        right = renderer.render(**look)
    renderer = clvol.Renderer(world.volumes["blob"], "bspline3")

    def drawn() -> list[Any]:
        pictures: list[Any] = []
        with suppress(clvol.OptionError):
            pictures.extend(renderer.render(**look) for _ in range(3))
        return pictures

    with ThreadPoolExecutor(1) as other:
        drawing = other.submit(drawn)
        time.sleep(float(random.uniform(0, 0.03)))
        renderer.close()
        return [right, all(_hash(picture) == _hash(right) for picture in drawing.result())]


@_deed(12)
def fields_drawn(world: World, random: Random) -> Any:
    return clvol.render(_one(random, world.fields), _camera(random), _one(random, world.modes), size=(40, 40))


# -- the function between the samples ---------------------------------------------------------------------------------

_SAMPLED: dict[str, Sequence[Any]] = {"fill": (0.0, np.nan), "precision": ("double",)}


@_deed(40)
def samples(world: World, random: Random) -> Any:
    volume = _volume(world, random)
    options = {} if world.quick else _some(random, _SAMPLED)
    derivative = int(random.integers(3))
    points = _points(volume, random)
    with as_device(None).limited(evaluator=_one(random, ("auto", "taps", "paired"))):
        return clvol.sample(
            volume,
            points,
            derivative=derivative,
            filter=_one(random, world.filters),
            boundary=_one(random, world.boundaries),
            **options,
        )


@_deed(20)
def one_field(world: World, random: Random) -> Any:
    """All threads share these fields."""
    field = _one(random, world.fields)
    points = _points(field.volume, random)
    which = int(random.integers(5))
    if which < 3:
        return (field.__call__, field.gradient, field.hessian)[which](points)
    return field.magnify(2) if which == 3 else field.resample(tuple(random.integers(5, 30, 3).tolist()))


@_deed(20)
def grids(world: World, random: Random) -> Any:
    volume = _volume(world, random)
    chosen = _one(random, world.filters), _one(random, world.boundaries)
    which = int(random.integers(5))
    if which == 4:
        like = replace(world.volumes["noise"], origin=tuple(volume.center))
        labels = replace(volume, data=random.integers(0, 9, volume.shape).astype(np.uint16))
        return [
            clvol.resample(labels, like=like, boundary=chosen[1], smooth=True),
            clvol.resample_scores(random.normal(size=(3, 5, 6, 7)), (6, 7, 8), filter=chosen[0]),
        ]
    if which == 0:
        shape = tuple(random.integers(4, 30, 3).tolist())
        return clvol.resample(volume, shape, None, None, *chosen, dtype=_one(random, [None, "same", "f8"]))
    if which == 1:
        spacing = float(random.uniform(0.8, 4)) * volume.mean_spacing
        return clvol.resample(
            volume, None, spacing, None, *chosen, anti_aliasing=_one(random, [False, "gaussian", "least-squares"])
        )
    if which == 2:
        like = replace(world.volumes["noise"], origin=tuple(volume.center))
        return clvol.resample(volume, like=like, transform=_affine(random), filter=chosen[0], fill=0.0)
    return clvol.magnify(volume, int(random.integers(1, 4)), *chosen)


@_deed(12)
def coefficients(world: World, random: Random) -> Any:
    row = _one(random, world.filters)
    return clvol.prefilter(
        _volume(world, random), row, _one(random, world.boundaries), precision=_one(random, ["single", "double"])
    )


@_deed(8)
def gaps(world: World, random: Random) -> Any:
    if world.quick:
        return None
    volume = world.volumes["blob"]
    missing = clvol.Missing(mask=random.random(volume.shape) < 0.02, most=_one(random, [0.0, 0.3, 1.0]))
    return clvol.sample(volume, _points(volume, random), "bspline3", nan=missing)


@_deed(12)
def interpolators(world: World, random: Random) -> Any:
    at = _one(random, world.interpolators)
    first = at(random.uniform(0, 2, (200, 3)), nu=_one(random, [None, (1, 0, 0), (0, 1, 1)]))
    axis = np.linspace(0, 1, 9)
    with clvol.Interpolator((axis,), random.normal(size=(9, 2)), _one(random, ["slinear", "cubic"]), False, None) as own:
        return [first, own(random.uniform(-0.2, 1.2, (50, 1)))]


# -- through transforms, and back ---------------------------------------------------------------------------------------


def _affine(random: Random) -> clvol.AffineTransform:
    return clvol.AffineTransform(np.eye(3) + random.uniform(-0.2, 0.2, (3, 3)), random.uniform(-2, 2, 3))


@_deed(12)
def warps(world: World, random: Random) -> Any:
    volume = world.volumes["blob"]
    stages = (
        _affine(random),
        clvol.DisplacementField(random.normal(0, 0.5, (4, 5, 6, 3)), (6, 6, 6), volume.origin),
        clvol.BSplineTransform(random.normal(0, 0.5, (6, 6, 6, 3)), (8, 8, 8), tuple(np.array(volume.origin) - 8)),
    )
    chain = stages[: int(random.integers(1, 4))]
    warped = clvol.warp(volume, world.volumes["noise"], list(chain), derivative=int(random.integers(2)), jacobian=True)
    assert isinstance(warped, clvol.Warped)
    return list(warped)


@_deed(4)
def series(_: World, random: Random) -> Any:
    return clvol.resample_series(random.normal(size=(3, 6, 7, 8)), [_affine(random) for _ in range(3)], fill=0.0)


@_deed(10)
def adjoints(world: World, random: Random) -> Any:
    points = random.uniform(-1, 12, (300, 3))
    precision = _one(random, ["single", "double"])
    return clvol.adjoint(random.normal(size=300), points, (9, 10, 11), _one(random, world.filters), precision=precision)


# -- others' functions ------------------------------------------------------------------------------------------------


def _scipy(world: World, random: Random) -> dict[str, Any]:
    if world.quick:
        return {"order": 3, "mode": "mirror"}
    return {"order": int(random.integers(6)), "mode": _one(random, SCIPY), "cval": 2.0} | _some(random, {"output": ("f4", "f8")})


@_deed(20)
def scipys_points_and_grids(world: World, random: Random) -> Any:
    data, options = _array(random), _scipy(world, random)
    which = int(random.integers(3))
    if which == 0:
        return ndimage.map_coordinates(data, random.uniform(-2, 16, (data.ndim, 40)), **options)
    matrix = np.eye(data.ndim) + random.uniform(-0.3, 0.3, (data.ndim, data.ndim))
    if which == 1:
        return ndimage.affine_transform(data, matrix, float(random.normal()), **options)
    return ndimage.geometric_transform(data, lambda at: tuple(0.9 * i + 0.3 for i in at), **options)


@_deed(20)
def scipys_zooms_and_turns(world: World, random: Random) -> Any:
    data, options = _array(random, int(random.integers(2, 4))), _scipy(world, random)
    which = int(random.integers(4))
    if which == 0:
        return ndimage.zoom(data, float(random.uniform(0.5, 2.5)), **options)
    if which == 1:
        return ndimage.shift(data, random.uniform(-3, 3, data.ndim), **options)
    if which == 2:
        return ndimage.rotate(data, float(random.uniform(-180, 180)), **options)
    order, mode = max(2, options["order"]), options["mode"]
    return [ndimage.spline_filter(data, order, mode=mode), ndimage.spline_filter1d(data, order, 0, mode=mode)]


@_deed(12)
def resized(_: World, random: Random) -> Any:
    array = np.abs(_array(random, 2).real)
    anti_aliasing = _one(random, [None, False, "gaussian", "least-squares"])
    return clvol.resize(array, random.integers(2, 24, 2).tolist(), int(random.integers(6)), anti_aliasing=anti_aliasing)


@_deed(12)
def photographs(world: World, random: Random) -> Any:
    image = _one(random, [world.image, world.photograph, world.image.astype("f4")])
    row, rule = _one(random, world.filters), _one(random, world.boundaries)
    which = int(random.integers(3))
    if which == 0:
        return images.resample(image, random.integers(10, 60, 2).tolist(), row, rule)
    if which == 1:
        return images.zoom(image, float(random.uniform(0.3, 1.8)), row, rule)
    return images.rotate(image, float(random.uniform(-180, 180)), row, rule)


@_deed(4)
def radiographs(world: World, random: Random) -> Any:
    pose = np.concatenate([random.normal(0, 0.1, 3), random.normal(0, 0.05, 3)])
    with clvol.Radiograph(world.volumes["blob"], _camera(random), (40, 40)) as radiograph:
        return radiograph.gradient(pose)


@_deed(4)
def vectors(_: World, random: Random) -> Any:
    points = random.uniform(0, 7, (40, 3))
    with clvol.VectorField(random.normal(size=(8, 9, 10, 3)).astype("f4")) as field:
        lines = field.streamlines(points[:3], length=2)
        return [field(points), field.hessian(points), field.curl(points), field.divergence(points), lines.points]


@_deed(4)
def tensors(world: World, random: Random) -> Any:
    if world.quick or importlib.util.find_spec("torch") is None:
        return None
    import torch

    data = torch.from_numpy(random.normal(size=(8, 9, 10)).astype("f4")).requires_grad_()
    points = torch.from_numpy(random.uniform(0, 7, (40, 3)).astype("f4"))
    values = torch_sample(data, points)
    values.sum().backward()
    assert data.grad is not None
    return [values.detach().numpy(), data.grad.numpy()]


@_deed(4)
def traced_arrays(world: World, random: Random) -> Any:
    if world.quick or importlib.util.find_spec("jax") is None:
        return None
    import jax

    data, points = random.normal(size=(8, 9, 10)).astype("f4"), random.uniform(0, 7, (40, 3)).astype("f4")
    return [np.asarray(one) for one in jax.jit(jax.value_and_grad(lambda values: jax_sample(values, points).sum()))(data)]


@_deed(4)
def logits(_: World, random: Random) -> Any:
    scores = random.normal(size=(3, 6, 7, 8)).astype("f4")
    shape, before, after = tuple(random.integers(4, 14, 3).tolist()), (float(random.uniform(1, 5)), 1.0, 1.0), (1.0, 1.0, 1.0)
    how: dict[str, Any] = {"order": int(random.integers(0, 4)), "force_separate_z": None}
    return [f(scores, shape, before, after, **how) for f in (labels_from_logits, resample_to_shape)]


@_deed(4)
def labelled_arrays(world: World, random: Random) -> Any:
    if world.quick or importlib.util.find_spec("xarray") is None:
        return None
    import xarray

    import clvol.xarray  # noqa: F401  # the accessor

    array = xarray.DataArray(random.normal(size=(9, 10)), dims=("y", "x"), coords={"y": np.arange(9.0) ** 2, "x": np.arange(10.0)})
    return array.clvol.interp(x=random.uniform(0, 9, 7), y=random.uniform(0, 64, 5)).values


# -- filters, noise, measures -----------------------------------------------------------------------------------------


@_deed(16)
def filters_of_ones_own(world: World, random: Random) -> Any:
    """New filters each time, hence new programs."""
    b, c = (float(v) for v in random.uniform(0, 1, 2).round(3))
    w = round(float(random.uniform(0.5, 2)), 3)
    chosen = (
        (lambda: clvol.bc(b, c)),
        (lambda: clvol.moms3(w / 100)),
        (lambda: clvol.lanczos(int(random.integers(2, 5)), normalized=True)),
        (lambda: clvol.sinc(int(random.integers(2, 5)))),
        (lambda: clvol.quasi(3)),
        (lambda: clvol.wide(int(random.integers(1, 4)))),
        (lambda: clvol.bspline(int(random.integers(1, 6)))),
        (lambda: clvol.from_pieces("hat", [(1, -1)])),
        (lambda: clvol.from_callable("bell", lambda x: np.cos(np.pi * x / 4) ** 2 * np.exp(-w * x * x), 2, prefilter=True)),
    )
    row = _one(random, chosen[4:5] if world.quick else chosen)()
    volume = world.volumes["noise"]
    omega = np.linspace(0, np.pi, 33)
    responses = [clvol.frequency_response(row, omega), clvol.prefilter_response(row, omega), row.weights(0.3)]
    return [clvol.sample(volume, _points(volume, random, 100), row), *responses]


@_deed(6)
def filters_registered(world: World, random: Random) -> Any:
    name = f"soaked-{threading.get_ident()}"
    clvol.register_filter(replace(clvol.filters()["bspline3"], name=name))
    try:
        points = _points(world.volumes["signal"], random, 50)
        return clvol.sample(world.volumes["signal"], points, name, clvol.boundaries()["mirror"])
    finally:
        unregister_filter(name)


@_deed(8)
def noise_smoothed(world: World, random: Random) -> Any:
    samples = world.volumes["blob"].data + random.normal(0, 0.05, world.volumes["blob"].shape)
    volume = clvol.Volume(samples)
    chosen = smoothing.choose(volume, int(random.integers(2, 6)))
    return [volume.noise.sigma, chosen.values, clvol.resample(volume, (10, 11, 12), filter="bspline3(auto)")]


@_deed(8)
def volumes_derived(world: World, random: Random) -> Any:
    volume = _volume(world, random)
    parts = [
        volume.gaussian(float(random.uniform(0.3, 2))),
        volume.downsample(2),
        volume.crop((1, 2, 3), (8, 9, 10)),
        volume.filled(),
    ]
    labels = world.volumes["labels"]
    both = clvol.Volumes((parts[0], parts[0]))
    return [*parts, labels.indicator(1), labels.is_labels, volume.limits, volume.world_to_index(volume.center), both]


@_deed(8)
def measures(world: World, random: Random) -> Any:
    row = _one(random, ["linear", "bspline3", "mitchell"])
    noisy = world.image + random.normal(0, 5, world.image.shape)
    return [
        analysis.ssim(world.image.astype(float), noisy),
        analysis.impulse_response(row, np.linspace(-3, 3, 31)),
        reference.prefilter(noisy[:6, :7], row),
        phantoms.by_name(_one(random, ["sphere:12", "box:9", "checker:8", "polynomial:6"])),
        list(clvol.presets()),
        [one.name for one in clvol.devices()],
    ]


@_deed(3)
def figures_drawn(world: World, random: Random) -> Any:
    if world.quick or importlib.util.find_spec("matplotlib") is None:
        return None
    with _figures, world.own_folder() as folder:
        return figures.draw(_one(random, ["2", "impulse", "1"])).save(folder / "figure.png").read_bytes()


# -- files and pickles ------------------------------------------------------------------------------------------------


def _written(folder: Path, volumes: Mapping[str, clvol.Volume]) -> Iterator[tuple[str, Path]]:
    """Files in read-only formats."""
    data: Any = np.asarray(volumes["ct"].data, "<i2", order="C")
    (folder / "samples.raw").write_bytes(data.tobytes())
    yield "raw", folder / "samples.raw"
    slices = folder / "slices"
    slices.mkdir()
    for number, rows in enumerate(data[:5]):
        clvol.save(np.clip(rows / 4000 + 0.25, 0, 1), slices / f"{number}.png")
    yield "slices", slices
    with suppress(ImportError):
        import h5py

        with h5py.File(folder / "samples.h5", "w") as file:
            file["samples"] = data
        yield "hdf5", folder / "samples.h5"
    with suppress(ImportError):
        import nibabel

        nibabel.MGHImage(data.astype("f4"), np.eye(4)).to_filename(folder / "samples.mgz")
        yield "mgz", folder / "samples.mgz"
    with suppress(ImportError):
        import SimpleITK as sitk

        sitk.WriteImage(sitk.GetImageFromArray(data[0]), str(folder / "slice.dcm"))
        yield "dicom", folder / "slice.dcm"
        sitk.WriteTransform(sitk.AffineTransform(3), str(folder / "map.tfm"))
        yield "transform", folder / "map.tfm"
    with suppress(ImportError):
        import zarr

        zarr.save(str(folder / "samples.zarr"), data)
        yield "zarr", folder / "samples.zarr"


@_deed(24)
def files_written_and_read(world: World, random: Random) -> Any:
    volume = _volume(world, random)
    suffix = _one(random, WRITTEN)
    with world.own_folder() as folder:
        path = folder / f"volume{suffix}"
        several = random.random() < 0.2 and suffix in (".nii.gz", ".nrrd", ".npz")
        clvol.write(clvol.Volumes([volume, volume]) if several else volume, path)
        return clvol.read_all(path) if several else clvol.read(path)


@_deed(8)
def files_read(world: World, random: Random) -> Any:
    kind, path = _one(random, list(world.files.items()))
    if kind == "raw":
        return clvol.read(path, shape=world.volumes["ct"].shape, dtype="<i2")
    if kind == "transform":
        return [stage.matrix for stage in clvol.read_transform(path) if isinstance(stage, clvol.AffineTransform)]
    return clvol.read(path)


@_deed(4)
def stores(world: World, random: Random) -> Any:
    """Make a pyramid, open it, read parts of it, and sample it by bricks."""
    volume = world.volumes["ct"]
    with world.own_folder() as folder:
        source = clvol.LazyVolume(volume.data, volume.spacing)
        clvol.pyramid(source, folder / "v.zarr", levels=2, chunks=16, method=_one(random, ["least-squares", "average"]))
        lazy = clvol.open(folder / "v.zarr", trusted=True)
        assert lazy.bounds is not None
        with clvol.BrickedField(lazy, edge=16) as field:
            values = field(_points(lazy.grid, random, 50))
        return [*(one.whole().data for one in (lazy, *lazy.levels)), *lazy.bounds.within((0, 0, 0), (8, 8, 8)), values]


@_deed(6)
def pickles(world: World, random: Random) -> Any:
    given = (
        _volume(world, random),
        _camera(random),
        clvol.TransferFunction.automatic(world.volumes["blob"]),
        clvol.boundaries()["mirror"],
    )
    volume, camera, transfer, rule = pickle.loads(pickle.dumps(given))
    with pickle.loads(pickle.dumps(_one(random, [*world.fields, *world.renderers[:1]]))) as other:
        made = other(_points(other.volume, random, 50)) if isinstance(other, clvol.Field) else other.render(camera, size=(32, 32))
    return [made, clvol.render(volume, camera, "composite", (32, 32), filter="bspline3", boundary=rule, transfer=transfer)]


# -- failing calls ----------------------------------------------------------------------------------------------------


def _refused(world: World, folder: Path) -> tuple[Callable[[], Any], ...]:
    """Calls that must each raise a clvol error."""
    volume, renderer, field = world.volumes["blob"], world.renderers[0], world.fields[0]
    return (
        lambda: clvol.read(folder / "missing.nrrd"),
        lambda: clvol.read(_bytes(folder / "a.nrrd", b"NRRD0004\ntype: float\ndimension: 3\nsizes: 9 9 9\nencoding: raw\n\n123")),
        lambda: clvol.read(_bytes(folder / "a.nii.gz", b"\x1f\x8b\x08\x00damaged")),
        lambda: clvol.read(_bytes(folder / "a.mha", b"NDims = 99\nDimSize = 1\n")),
        lambda: clvol.read(_bytes(folder / "a.tif", b"II*\x00\x08\x00\x00\x00\xff\xff")),
        lambda: clvol.read(_bytes(folder / "a.npy", b"\x93NUMPY\x01\x00\x10\x00{")),
        lambda: clvol.read(_bytes(folder / "a.h5", b"\x89HDF\r\n\x1a\n" + bytes(64))),
        lambda: clvol.write(volume, folder / "a.xyz"),
        lambda: clvol.write(volume, folder / "no" / "such" / "folder.nrrd"),
        lambda: clvol.write(volume, folder / "a.dcm"),
        lambda: renderer.render(mode="none"),
        lambda: renderer.render(size=(0, 4)),
        lambda: renderer.render(step=-1.0),
        lambda: renderer.render(azimuth=4),  # type: ignore[call-overload]
        lambda: renderer.render(outputs=["light"]),  # type: ignore[list-item]
        lambda: renderer.render(clip=((3, 3, 3), (1, 1, 1))),
        lambda: renderer.render(mode="mip", outputs="uncertainty"),
        lambda: renderer.render(clvol.Camera(position=(1, 1, 1), target=(1, 1, 1))),
        lambda: clvol.Renderer(volume, "none"),
        lambda: clvol.Renderer(np.full((3, 3, 3), np.nan)),
        lambda: clvol.Renderer(np.zeros((3, 3))),
        lambda: clvol.Renderer(volume, device="none"),
        lambda: clvol.Volume(np.zeros((2, 2, 2)), spacing=(1, 0, 1)),
        lambda: clvol.Volume(np.array([[1, None]])),
        lambda: field([[1, 2]]),
        lambda: field([["a", "b", "c"]]),
        lambda: field([[0, 0, 0]], fill="none"),  # type: ignore[arg-type]
        lambda: field.resample((0, 1, 2)),
        lambda: field.resample((4, 4, 4), out=np.zeros((4, 4, 5))),
        lambda: field.resample((4, 4, 4), transform=np.zeros((4, 4))),
        lambda: clvol.magnify(volume, 0),
        lambda: clvol.prefilter(np.array([1, np.inf])),
        lambda: clvol.bspline(12),
        lambda: clvol.from_callable("bad", lambda x: x / 0, 2),
        lambda: clvol.TransferFunction(((1.0, (0, 0, 1)), (0.0, (1, 0, 0))), ((0.0, 1.0),)),
        lambda: clvol.adjoint([1.0], [[0, 0, 0]], (3, 3, 3), "hybrid"),
        lambda: clvol.Interpolator(([0, 1, 3],), [1, 2, 3]),
        lambda: ndimage.zoom(np.zeros((3, 3)), 2, order=9),
        lambda: ndimage.map_coordinates(np.zeros((3, 3)), [[0]]),
        lambda: ndimage.shift(np.array(["a"]), 1),
        lambda: clvol.resize(np.zeros((3, 3)), (0, 1)),
        lambda: images.rotate(np.zeros((3, 3, 3, 3)), 4),
        lambda: figures.draw("99"),
        lambda: _closed(volume).render(),
    )


def _bytes(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


def _closed(volume: clvol.Volume) -> clvol.Renderer:
    renderer = clvol.Renderer(volume, "bspline3")
    renderer.close()
    return renderer


@_deed(60)
def calls_refused(world: World, random: Random) -> Any:
    with world.own_folder() as folder:
        number = int(random.integers(len(calls := _refused(world, folder))))
        try:
            calls[number]()
        except clvol.ClvolError as error:
            return f"{type(error).__name__}: {error}".replace(os.fspath(folder), "")
    raise AssertionError(f"call {number} was not refused")


@_deed(4)
def work_abandoned(world: World, random: Random) -> Any:
    """An exception from a call's progress callback; the next call must be correct."""
    volume = world.volumes["blob"]

    def stop(_: float) -> None:
        raise KeyError("stop")

    with ExitStack() as stack:
        stack.enter_context(as_device().limited(launch_seconds=1e-6, launch_taps=1 << 12, launch_voxels=1 << 10))
        with suppress(KeyError):
            clvol.resample(volume, (20, 20, 20), filter="bspline3", progress=stop)
        with suppress(KeyError):
            world.renderers[0].render(size=(64, 48), progress=stop)
    return world.renderers[0].render(clvol.Camera.orbit(float(random.uniform(0, 360))), size=(48, 48))
