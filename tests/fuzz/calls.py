"""Calls of public functions with arguments of wrong types and values: each must raise a clvol error, or be correct.

No kernel is built: a call that gets that far was accepted.
"""

from __future__ import annotations

import contextlib
import math
import random
import resource
import signal
import tempfile
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

import clvol
from clvol.base.errors import ClvolError, ClvolWarning
from clvol.device import program
from tests.fuzz.harness import MEGABYTES, SECONDS, Tally

__all__ = ["fuzz_calls"]


class _BuiltError(BaseException):
    """A kernel is about to be built; no library in between mistakes it for its own error."""


class _LateError(BaseException):
    """The timeout."""


_NASTY: tuple[Any, ...] = (
    None,
    True,
    False,
    0,
    1,
    -1,
    2,
    3,
    7,
    64,
    2**31 - 1,
    2**31,
    2**32,
    2**63,
    -(2**63),
    10**30,
    -(10**400),
    0.0,
    -0.0,
    0.5,
    1.5,
    -2.5,
    1e-300,
    1e300,
    5e-324,
    math.nan,
    math.inf,
    -math.inf,
    1j,
    Fraction(1, 3),
    "",
    " ",
    "x",
    "bspline3",
    "mirror",
    "composite",
    "²",
    "１",
    "nan",
    "1",
    "\0",
    "ü" * 300,
    "../x",
    "v.nii",
    "v.npy",
    "v.png",
    b"",
    b"bytes",
    bytearray(3),
    (),
    [],
    {},
    set(),
    {"a": 1},
    [None],
    [[]],
    [[1], [1, 2]],
    (1,),
    (1, 2),
    (1, 2, 3),
    (0, 0, 0),
    (3, 4, 5),
    (-1, 2, 3),
    (2.5, 2, 2),
    (2**31, 2, 2),
    (2**20, 2**20, 2**20),
    (math.nan,) * 3,
    (math.inf, 1, 1),
    ("1", "2", "3"),
    "123",
    range(3),
    iter([1, 2, 3]),
    object(),
    object,
    int,
    len,
    lambda *_: None,
    Ellipsis,
    NotImplemented,
    np.float32(1),
    np.int8(-1),
    np.uint64(2**63),
    np.bool_(True),
    np.str_("x"),
    np.datetime64("2026-01-01"),
    np.array(1.0),
    np.zeros(0),
    np.zeros((0, 3)),
    np.zeros((2, 0, 2)),
    np.zeros(3),
    np.zeros((2, 2)),
    np.eye(3),
    np.zeros((3, 3)),
    np.zeros((2, 2, 2)),
    np.zeros((2,) * 7),
    np.full((3, 3, 3), np.nan),
    np.full((2, 2, 2), np.inf),
    np.array([None, 1], object),
    np.array(["a", "b"]),
    np.array([1j, 2]),
    np.zeros((2, 2, 2), "M8[s]"),
    np.zeros((2, 2, 2), [("a", "f4")]),
    np.ma.masked_all((2, 2, 2)),
    np.zeros((2, 2, 2), np.float16),
    np.array([3.4e38, -3.4e38, 1e39]),
    np.longdouble(1),
    Path(),
    Path("nowhere"),
    2**1000,
    "9" * 5000,
)


def _bases(folder: Path) -> Mapping[str, tuple[Callable[..., Any], dict[str, Any]]]:
    """Functions, with valid arguments."""
    data = np.arange(60, dtype=np.float32).reshape(3, 4, 5)
    volume, image, points = clvol.Volume(data), clvol.Volume(data[0]), np.ones((4, 3))
    path = folder / "v.npy"
    np.save(path, data)
    draw: dict[str, Any] = {
        "camera": None,
        "mode": "composite",
        "filter": "bspline3",
        "boundary": "mirror",
        "size": (8, 8),
        "step": 0.5,
    }
    grid: dict[str, Any] = {"filter": "bspline3", "boundary": "mirror", "device": None}
    found: dict[str, tuple[Callable[..., Any], dict[str, Any]]] = {
        "Volume": (
            clvol.Volume,
            {
                "data": data,
                "spacing": (1, 2, 3),
                "origin": (0, 0, 0),
                "direction": np.eye(3),
                "units": "mm",
                "space": "LPS",
                "name": "v",
                "color": "red",
                "clim": (0, 1),
                "labels": None,
                "header": {},
            },
        ),
        "Volumes": (clvol.Volumes, {"data": np.zeros((2, 3, 4, 5)), "spacing": (1, 2, 3), "leading": None}),
        "Camera": (clvol.Camera, {"position": (0, -9, 0), "target": (0, 0, 0), "up": (0, 0, 1), "direction": (0, 1, 0)}),
        "TransferFunction": (
            clvol.TransferFunction,
            {"colors": ((0, (0, 0, 0)), (1, (1, 1, 1))), "opacities": ((0, 0), (1, 1)), "unit_distance": 1.0},
        ),
        "Light": (clvol.Light, {"direction": (0, 0, 1), "color": (1, 1, 1), "frame": "world"}),
        "Material": (clvol.Material, {"ambient": 0.2, "diffuse": 0.7, "specular": 0.1, "shininess": 30.0}),
        "Medium": (clvol.Medium, {"volume": volume, "transfer": None, "filter": None, "boundary": "mirror"}),
        "Scene": (clvol.Scene, {"media": (clvol.Medium(volume),)}),
        "Composite": (clvol.Composite, {"shading": True, "termination": 0.001}),
        "Isosurface": (clvol.Isosurface, {"isovalue": 1.0, "color": "red", "shading": True, "method": "exact", "tolerance": 1e-4}),
        "Attenuated": (clvol.Attenuated, {"attenuation": 2.0}),
        "Missing": (clvol.Missing, {"rule": "local", "mask": None, "most": 0.0}),
        "Filter": (clvol.Filter, {"name": "f", "taps": clvol.bspline(1).taps, "prefilter": False}),
        "AffineTransform": (clvol.AffineTransform, {"matrix": np.eye(3), "translation": (0, 0, 0), "center": (0, 0, 0)}),
        "BSplineTransform": (clvol.BSplineTransform, {"coefficients": np.zeros((3, 5, 5, 5)), "spacing": (1, 1, 1), "order": 3}),
        "DisplacementField": (
            clvol.DisplacementField,
            {"displacements": np.zeros((3, 4, 5, 3)), "spacing": (1, 1, 1), "filter": "linear"},
        ),
        "Interpolator": (
            clvol.Interpolator,
            {"points": (np.arange(3.0), np.arange(4.0)), "values": np.zeros((3, 4)), "filter": "linear"},
        ),
        "Picture": (clvol.Picture, {"array": np.zeros((2, 2, 4)), "kind": "rgba"}),
        "bc": (clvol.bc, {"B": 0, "C": 0.5}),
        "bspline": (clvol.bspline, {"degree": 3, "prefilter": True, "smoothing": 0, "length": None}),
        "lanczos": (clvol.lanczos, {"radius": 3, "normalized": False}),
        "sinc": (clvol.sinc, {"radius": 4, "normalized": False}),
        "quasi": (clvol.quasi, {"degree": 3}),
        "moms3": (clvol.moms3, {"weight": Fraction(1, 56)}),
        "wide": (clvol.wide, {"width": 2}),
        "from_pieces": (clvol.from_pieces, {"name": "p", "pieces": [[1, -1]], "prefilter": False}),
        "from_callable": (clvol.from_callable, {"name": "c", "kernel": lambda x: np.maximum(0, 1 - np.abs(x)), "radius": 1}),
        "frequency_response": (clvol.frequency_response, {"filter": "bspline3", "omega": np.zeros(3)}),
        "prefilter_response": (clvol.prefilter_response, {"filter": "bspline3", "omega": np.zeros(3)}),
        "read": (
            clvol.read,
            {
                "path": path,
                "volume": None,
                "time": None,
                "channel": None,
                "series": None,
                "level": None,
                "shape": None,
                "dtype": None,
                "spacing": None,
                "origin": None,
                "direction": None,
                "byte_order": None,
                "offset": 0,
            },
        ),
        "read_all": (clvol.read_all, {"path": path, "time": None, "channel": None, "spacing": None}),
        "write": (clvol.write, {"volume": data, "path": folder / "out.npy"}),
        "save": (clvol.save, {"picture": np.zeros((2, 2, 4)), "path": folder / "out.png"}),
        "render": (clvol.render, {"scene": volume, **draw}),
        "sample": (clvol.sample, {"volume": volume, "points": points, **grid, "derivative": 0}),
        "resample": (clvol.resample, {"volume": volume, "shape": (2, 3, 4), "spacing": None, "like": None, **grid}),
        "magnify": (clvol.magnify, {"volume": image, "factor": 2, **grid}),
        "warp": (clvol.warp, {"volume": volume, "like": volume, "transform": None, **grid}),
        "resize": (
            clvol.resize,
            {"image": data[0], "output_shape": (7, 8), "order": 3, "mode": "reflect", "cval": 0, "clip": True},
        ),
        "prefilter": (clvol.prefilter, {"data": data, **grid}),
        "adjoint": (clvol.adjoint, {"values": np.ones(4), "points": points, "like": volume, "filter": "bspline3", "derivative": 0}),
        "Field": (clvol.Field, {"volume": volume, **grid}),
        "Renderer": (clvol.Renderer, {"scene": volume, **grid}),
        "zoom": (clvol.ndimage.zoom, {"input": data, "zoom": 2, "order": 3, "mode": "mirror", "cval": 0.0}),
        "shift": (clvol.ndimage.shift, {"input": data, "shift": 0.5, "order": 3, "mode": "mirror", "cval": 0.0}),
        "rotate": (clvol.ndimage.rotate, {"input": data, "angle": 20.0, "axes": (1, 0), "reshape": True, "order": 3}),
        "map_coordinates": (clvol.ndimage.map_coordinates, {"input": data, "coordinates": np.ones((3, 4)), "order": 3}),
        "affine_transform": (
            clvol.ndimage.affine_transform,
            {"input": data, "matrix": np.eye(3), "offset": 0.0, "output_shape": None},
        ),
        "spline_filter": (clvol.ndimage.spline_filter, {"input": data, "order": 3}),
        "marschner_lobb": (clvol.phantoms.marschner_lobb, {"size": 8}),
    }
    return found


def fuzz_calls(seeds: Sequence[int]) -> Tally:
    """Call with one or two wrong arguments per seed; accepted calls are counted."""
    tally = Tally("calls")
    with tempfile.TemporaryDirectory() as name, _limited(), contextlib.chdir(name):
        bases = _bases(Path(name))
        for seed in seeds:
            _one(bases, seed, tally)
            tally.tried += 1
    return tally


def _one(bases: Mapping[str, tuple[Callable[..., Any], dict[str, Any]]], seed: int, tally: Tally) -> None:
    dice = random.Random(f"calls {seed}")
    name = dice.choice(sorted(bases))
    function, arguments = bases[name]
    wrong = {key: dice.choice(_NASTY) for key in dice.sample(sorted(arguments), min(dice.choice((1, 1, 2)), len(arguments)))}
    told = f"{name}({', '.join(f'{key}={type(value).__name__}' for key, value in wrong.items())})"
    signal.setitimer(signal.ITIMER_REAL, 2 * SECONDS)
    try:
        with warnings.catch_warnings(record=True) as heard:
            warnings.simplefilter("always")
            function(**(arguments | wrong))
        tally.accepted += 1
    except _BuiltError:
        tally.accepted += 1
    except ClvolError:
        tally.refused += 1
    except _LateError:
        tally.find("hangs", told, seed)
    except MemoryError:
        tally.find("memory", told, seed)
    except Exception as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        tally.find("foreign", f"{told}: {type(error).__name__} in {Path(where.filename).name}:{where.name}", seed)
    else:
        for one in heard:
            if not issubclass(one.category, ClvolWarning) and "complex" not in str(one.message):  # of which SciPy warns too
                tally.find("foreign", f"{told}: {one.category.__name__} {str(one.message)[:50]}", seed)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)


@contextlib.contextmanager
def _limited() -> Iterator[None]:
    """No kernels, at most five times the memory that a call may take, and a timeout."""
    build, limits = program.build, resource.getrlimit(resource.RLIMIT_AS)
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize() if Path("/proc/self/statm").exists() else 0

    def stop(*_: object, **__: object) -> Any:
        raise _BuiltError

    def late(*_: object) -> None:
        raise _LateError

    before = signal.signal(signal.SIGALRM, late)
    program.build = stop
    if size:
        resource.setrlimit(resource.RLIMIT_AS, (size + int(10 * MEGABYTES * 1e6), limits[1]))
    try:
        yield
    finally:
        program.build = build
        resource.setrlimit(resource.RLIMIT_AS, limits)
        signal.signal(signal.SIGALRM, before)
