"""Where kernels come to the edges of their memory and of their numbers: the smallest sizes, every rule, places far outside.

Each function takes one kind of kernels there and checks no more than that results are numbers where they should be: those who
call it (guarded.py, sanitized) have memory watched.
"""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

import clvol
from clvol import ndimage
from clvol.device import as_device
from clvol.filter.boundary import boundaries
from clvol.filter.table import filters
from clvol.march.frame import BY_RAYS
from clvol.spline.field import Precision
from clvol.spline.reduce import AntiAliasing
from tests import cases

BOTH: tuple[Precision, Precision] = ("single", "double")
LENGTHS = (1, 2, 3, 7, 8, 9, 15, 16, 17, 33)
PLACES = (np.nan, np.inf, -np.inf, 3e38, -3e38, 1e300, -1e300, 2.0**31, -(2.0**31) - 1, 2.0**63, 1e-40, 5e-324, -0.0, -0.5, 1e6)
LOOKS = [clvol.Camera.orbit(a, e) for a, e in ((35, -25), (0, 0), (90, 0), (0, 90), (180, -90), (270, 10))]


def noise(*shape: int) -> NDArray[np.float32]:
    return np.random.default_rng(sum(shape)).standard_normal(shape).astype(np.float32)


def far_points(shape: tuple[int, ...], count: int) -> NDArray[np.float64]:
    """All of `PLACES` along each axis and along all at once, among points inside and just outside."""
    d = len(shape)
    points = np.random.default_rng(count).uniform(-3, max(shape) + 3, (count, d))
    odd = np.concatenate(
        [np.array(PLACES)[:, None] * np.ones(d), *(np.where(np.eye(d)[k], np.array(PLACES)[:, None], 0.5) for k in range(d))]
    )
    return np.concatenate([points, odd])


def finite(values: NDArray[np.generic], points: NDArray[np.float64]) -> None:
    """Require finite values at finite points; other points give NaN or the `fill` value."""
    assert np.isfinite(values[(np.abs(points) < 1e5).all(-1)]).all()


def points(rules: Iterable[str], names: Iterable[str]) -> None:
    """Values and derivatives at arbitrary points, in both types, few and many, of volumes and images."""
    for rule, name in itertools.product(rules, names):
        for shape, count in (((7, 18, 21), 70), ((7, 18, 21), 1), ((5, 9), 33), ((1, 1), 3)):
            for derivative in (0, 1) if filters()[name].degree else (0,):
                at = far_points(shape, count)
                for kind in (np.float64, np.float32):
                    with np.errstate(over="ignore"):
                        given = at.astype(kind)
                    finite(clvol.sample(noise(*shape), given, name, rule, derivative=derivative), given)
                finite(clvol.sample(noise(*shape), at, name, rule, derivative=derivative, fill=7.0), at)


def small(names: Iterable[str], precision: Precision = "single") -> None:
    """Images and volumes of every small size: coefficients, finer and coarser grids."""
    for name, n in itertools.product(names, LENGTHS):
        for shape in ((n, 3), (1, n), (n, 1, 2), (2, n, 3), (1, 2, n)):
            made = clvol.resample(noise(*shape), tuple(m + 3 for m in shape), filter=name, precision=precision)
            assert np.isfinite(np.asarray(made.data)).all()
            coarser = tuple(-(-m // 2) for m in shape)
            assert np.isfinite(clvol.resize(noise(*shape), coarser, anti_aliasing="gaussian")).all()


def texels(names: Iterable[str]) -> None:
    """Evaluators that read images, in pictures and at points."""
    for name in names:
        field = noise(5, 9, 12)
        at = far_points(field.shape, 33)
        for evaluator in ("paired", "taps"):
            with as_device().limited(evaluator=evaluator, fetch="image"), clvol.Renderer(field, filter=name) as renderer:
                finite(clvol.sample(field, at, name), at)
                assert np.isfinite(renderer.render(LOOKS[0], "composite", (9, 7), 0.7)).all()


def sorted_points(rules: Iterable[str]) -> None:
    """Points that are sorted first, many far outside."""
    for precision, rule in itertools.product(BOTH, rules):
        shape = (7, 18, 21)
        with clvol.Field(noise(*shape), "bspline3", rule, precision=precision) as field, field.device.limited(sorting=True):
            for count in (1, 70, 600):
                at = np.concatenate([far_points(shape, count), np.random.default_rng(0).uniform(-40, 60, (count, 3))])
                finite(field(at), at)
                finite(field.gradient(at.astype(np.float32)), at.astype(np.float32))


def pictures(names: Iterable[str], size: tuple[int, int] = (17, 15)) -> None:
    """Every mode for slabs, lines and single voxels; guides, cuts, lists of rays, tiles of rays and single rays."""
    low, high = (2.0, 1.0, 1.0), (9.0, 7.0, 3.0)
    cuts = [clvol.Plane((1, 2, 3), (5, 5, 2)), clvol.Corner((-9, 2, -9), (9, 4, 9)), clvol.Corner((5, -9, 0), (6, 99, np.inf))]
    for name, shape in itertools.product(names, ((9, 12, 20), (3, 30, 9), (1, 2, 33), (1, 1, 1))):
        with clvol.Renderer(noise(*shape), filter=name) as renderer:
            for camera, mode, step in itertools.product(LOOKS, cases.MODES, (0.6, 8, 300)):
                assert np.isfinite(renderer.render(camera, mode, size, step)).all()
            for mode in ("composite", "isosurface"):
                made = renderer.render(
                    LOOKS[0], mode, size, outputs=("rgba", "depth", "normal", "position", "visited"), clip=(low, high)
                )
                assert np.isfinite(made["rgba"]).all()
                for camera in LOOKS:
                    assert np.isfinite(renderer.render(camera, mode, size, 0.6, clip=cuts, cap=True)).all()
                with renderer.device.limited(tile=BY_RAYS):
                    assert np.isfinite(renderer.render(LOOKS[0], mode, size, 0.8, gradient="central")).all()


def bricks(names: Iterable[str], size: tuple[int, int] = (17, 15), seen: Iterable[str] = (), *, few: bool = False) -> None:
    """The same by bricks, the last ones thinner: rays of pixels and listed rays, guides, with and without bounds."""
    shapes = (((9, 12, 20), 8), ((3, 30, 9), 8), ((1, 2, 33), 16), ((1, 1, 1), 8))
    seen = tuple(seen or cases.MODES)
    for name, (shape, edge) in itertools.product(names, shapes[: 1 if few else None]):
        with clvol.BrickedField(noise(*shape), name, edge=edge) as field, clvol.Renderer(field) as renderer:
            for camera, mode, step in itertools.product(LOOKS[: 1 if few else 2], seen, (0.6, 3)):
                field.drop()  # so that rays are checked
                assert np.isfinite(renderer.render(camera, mode, size, step)).all()
            for mode in {"composite", "isosurface"} & {*seen}:
                made = renderer.render(LOOKS[0], mode, size, outputs=("rgba", "depth", "normal", "position", "visited"))
                assert np.isfinite(renderer.render(LOOKS[0], mode, size, clip=clvol.Corner((3, 2, 1), (9, 7, 5)), cap=True)).all()
                assert np.isfinite(made["rgba"]).all()
                with renderer.device.limited(tile=renderer.device.limits.tile if few else BY_RAYS):
                    field.drop()
                    assert np.isfinite(renderer.render(LOOKS[0], mode, size, 0.8, rays="auto")).all()
            at = far_points(shape, 33)
            finite(field(at), at)


def arrays(shapes: Iterable[tuple[int, ...]] = ((9,), (3, 17), (2, 3, 5), (3, 2, 5, 9))) -> None:
    """`clvol.ndimage`: lines, images and batches of them, points axis by axis, results of other types and strides, reductions."""
    rng = np.random.default_rng(0)
    kinds = list(zip(BOTH, (3, 5), (("constant", "nearest"), ("wrap", "grid-constant")), strict=True))
    for shape, (precision, order, rules) in itertools.product(shapes, kinds):
        data, batch = rng.standard_normal(shape), max(0, len(shape) - 2)
        for output in (np.float32, np.uint8, np.float64):
            zoomed = ndimage.zoom(data, [1] * batch + [1.7] * (len(shape) - batch), output, order, precision=precision)
            assert np.isfinite(zoomed).all()
        filtered = np.empty((*shape, 2), np.float32)[::-1, ..., 0]
        ndimage.spline_filter1d(data, order, -1, filtered, precision=precision)
        assert np.isfinite(filtered).all()
        if len(shape) < 4:
            at = rng.uniform(-9, 20, (len(shape), 13))
            for mode in rules:
                assert np.isfinite(ndimage.map_coordinates(data, at, order=order, mode=mode, precision=precision)).all()
    low_passes: tuple[AntiAliasing, AntiAliasing] = ("gaussian", "least-squares")
    for shape, kind in itertools.product(((5, 70), (70, 5), (4, 33, 6)), low_passes):
        image = rng.standard_normal(shape).astype(np.float32)
        assert np.isfinite(clvol.resize(image, [max(1, n // 2) for n in shape], anti_aliasing=kind)).all()


def chains() -> None:
    """Grids of every filter that a chain takes, with points inside and outside; values, gradients, Jacobians."""
    rng = np.random.default_rng(0)
    for volume in (noise(7, 18, 21), noise(18, 21)):
        d = volume.ndim
        like = clvol.Volume(np.zeros(volume.shape, np.float32), (1.3,) * d, (-4.0,) * d)
        shift = [rng.uniform(-2, 2, (*(3, 4, 5)[-d:], d)) for _ in range(2)]
        for precision, order, name in zip(BOTH, (2, 3), ("bspline5", "linear"), strict=True):
            grids = [
                clvol.BSplineTransform(np.pad(shift[0], [(1, 1)] * d + [(0, 0)]), (4.0,) * d, (-2.0,) * d, order=order),
                clvol.DisplacementField(shift[1], (5.0,) * d, filter=name),
            ]
            made = clvol.warp(volume, like, grids, derivative=1, wrt="fixed", jacobian=True, precision=precision)
            assert made.gradient is not None
            assert made.jacobian is not None
            assert all(np.isfinite(each).all() for each in (made.values.data, made.gradient, made.jacobian.data))


def adjoints() -> None:
    """Points inside, just outside and far outside, which the rule maps to the outermost positions."""
    rng = np.random.default_rng(0)
    for name, precision in zip(("nearest", "linear", "bspline2", "bspline5"), BOTH * 2, strict=True):
        for shape in ((1, 1), (9, 7), (3, 8, 5)):
            at = np.concatenate([rng.uniform(-3, 12, (70, len(shape))), np.full((1, len(shape)), 99.0), far_points(shape, 3)])
            at = at[np.isfinite(at).all(-1)]
            assert np.isfinite(clvol.adjoint(np.ones(len(at)), at, shape, name, "zero", precision=precision)).all()


def media() -> None:
    """Two media of other sizes and places in one picture, whole and cut: apart, and together and coloured by a third."""
    shown = clvol.TransferFunction([(0, "red")], [(-0.5, 0), (1, 0.5)])
    for first, second in (((9, 12, 20), (1, 2, 33)), ((1, 1, 1), (3, 30, 9))):
        other = clvol.Medium(clvol.Volume(noise(*second), (1.3, 0.7, 2), (3, -4, 1)), shown, filter="linear")
        holed = clvol.Volume(np.where(np.indices((4, 3, 5))[2] < 2, np.nan, noise(4, 3, 5)), (4, 3, 2), (-2, 1, 3))
        colored = clvol.Medium(noise(*first), shown, filter="linear", color_by=clvol.Medium(holed, filter="bspline3"))
        for scene in ([clvol.Medium(noise(*first), shown), other], [colored, other]):
            with clvol.Renderer(clvol.Scene(scene)) as renderer:  # type: ignore[arg-type]  # it converts
                for look in LOOKS:
                    for clip in (None, clvol.Corner((5, -9, 0), (6, 99, np.inf))):
                        assert np.isfinite(renderer.render(look, size=(19, 21), clip=clip)).all()


def uncertainty() -> None:
    """Uncertainty of surfaces in volumes hardly larger than the stencils."""
    for shape in ((9, 12, 20), (2, 3, 9)):
        with clvol.Renderer(noise(*shape)) as renderer:
            renderer.render(LOOKS[0], "isosurface", (9, 7), isovalue=0.1, outputs=("rgba", "uncertainty"), sigma=0.1)


RULES = tuple(boundaries())
FEW: dict[str, Callable[[], None]] = {
    "points": lambda: points(("mirror", "constant(3)"), ("bspline3",)),
    "texels": lambda: texels(("linear",)),
    "pictures": lambda: pictures(("bspline3",), (9, 7)),
    "bricks": lambda: bricks(("bspline3",), (9, 7), ("isosurface",), few=True),
}
GUARDED: dict[str, Callable[[], None]] = {  # the sanitizers watch the others of the few
    "bricks": lambda: bricks(("bspline3",), (9, 7), ("composite", "isosurface", "mip"), few=True),
    "sorted points": lambda: sorted_points(("constant(3)", "nearest")),
    "arrays": arrays,
    "chains": chains,
    "adjoints": adjoints,
    "media": media,
}
ALL: dict[str, Callable[[], None]] = {
    "points by every rule": lambda: points((*RULES, "constant(3)"), ("bspline3", "linear")),
    "points by every filter": lambda: points(("mirror",), filters()),
    "small": lambda: [small(("bspline3", "linear", "bspline5"), p) for p in BOTH] and None,
    "texels": lambda: texels(("nearest", "linear", "bspline3", "bspline5", "catmull-rom", "lanczos3")),
    "sorted points": lambda: sorted_points(("constant(3)", "nearest", "wrap")),
    "pictures": lambda: pictures(("nearest", "linear", "bspline3", "bspline5", "lanczos3", "hybrid")),
    "bricks": lambda: bricks(("nearest", "linear", "bspline3", "bspline5", "lanczos3", "hybrid")),
    "arrays": arrays,
    "chains": chains,
    "adjoints": adjoints,
    "media": media,
    "uncertainty": uncertainty,
}


def run(tasks: dict[str, Callable[[], None]]) -> None:
    """Run all of these."""
    as_device()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", clvol.ClvolWarning)
        for name, task in tasks.items():
            print(name, flush=True)
            task()
