"""Volumes that sample a known function, to compare reconstructions with it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base import memory
from clvol.base.arrays import reals
from clvol.base.checks import enough_memory, number, one_of, require_room, whole
from clvol.base.errors import OptionError
from clvol.volume.provenance import note
from clvol.volume.volume import Volume

__all__ = [
    "box",
    "by_name",
    "checker",
    "marschner_lobb",
    "marschner_lobb_function",
    "marschner_lobb_gradient",
    "names",
    "polynomial",
    "polynomial_function",
    "sphere",
]

Array: TypeAlias = NDArray[np.float64]
Size: TypeAlias = int | Sequence[int]

_AT_ONCE = 1 << 18  # samples with positions in memory at once, plus one row


@enough_memory("a phantom")
def marschner_lobb(size: Size = 41, alpha: float = 0.25, f_m: float = 6.0) -> Volume:
    """The test signal of Marschner and Lobb (1994), reference [9] of the paper, on [-1, 1]³.

    Parameters
    ----------
    size : int or (nz, ny, nx)
        Samples along each axis, at least 2; the outer ones are on the faces of the cube.
    alpha, f_m : float
        Amplitude and frequency of the waves; usually 0.25 and 6, for which 41 samples are just enough.

    References
    ----------
    - S. R. Marschner and R. J. Lobb, "An evaluation of reconstruction filters for volume rendering", IEEE Visualization
      1994, 100–107.
    """
    return _on_cube(size, lambda points: marschner_lobb_function(points, alpha, f_m))


def marschner_lobb_function(points: ArrayLike, alpha: float = 0.25, f_m: float = 6.0) -> Array:
    """The function that `marschner_lobb` samples, at points (..., 3) in the order x, y, z."""
    x, y, z = _columns(points, alpha, f_m)
    wave = np.cos(2 * np.pi * f_m * np.cos(np.pi * np.hypot(x, y) / 2))
    return np.asarray((1 - np.sin(np.pi * z / 2) + alpha * (1 + wave)) / (2 * (1 + alpha)))


def marschner_lobb_gradient(points: ArrayLike, alpha: float = 0.25, f_m: float = 6.0) -> Array:
    """The gradient of `marschner_lobb_function` at points (..., 3); shape (..., 3)."""
    x, y, z = _columns(points, alpha, f_m)
    r = np.hypot(x, y)
    slope = np.pi**2 * f_m * np.sin(np.pi * r / 2) * np.sin(2 * np.pi * f_m * np.cos(np.pi * r / 2))
    # slope / r is finite on the axis, where x and y are zero
    radial = alpha * np.divide(slope, r, out=np.zeros_like(r), where=r > 0)
    return np.stack([radial * x, radial * y, -np.pi / 2 * np.cos(np.pi * z / 2)], -1) / (2 * (1 + alpha))


@enough_memory("a phantom")
def sphere(size: Size = 64, radius: float = 0.75) -> Volume:
    """A smooth function on [-1, 1]³ that is 1/2 on a sphere, larger inside and smaller outside.

    ``1/2 + (radius² - |p|²) / (2 radius)``: approximately the signed distance near the sphere, and quadratic,
    so that filters of order 3 and higher reconstruct it exactly.

    Parameters
    ----------
    size : int or (nz, ny, nx)
        Samples along each axis, at least 2.
    radius : float
        In world units; the faces of the cube are at ±1.
    """
    radius = number("radius", radius, above=0)
    return _on_cube(size, lambda points: 0.5 + (radius**2 - (points**2).sum(-1)) / (2 * radius))


@enough_memory("a phantom")
def polynomial(size: Size = 16, degree: int = 3, seed: int = 0, coefficients: ArrayLike | None = None) -> Volume:
    """Samples of a polynomial on [-1, 1]³.

    Parameters
    ----------
    size : int or (nz, ny, nx)
        Samples along each axis, at least 2.
    degree : int
        Highest degree along each axis, 0 to 9; unused if `coefficients` are given.
    seed : int
        Seed of the random coefficients, which are in [-1, 1).
    coefficients : array-like, shape (a, b, c), optional
        ``coefficients[i, j, k]`` belongs to ``x**i y**j z**k``.

    See Also
    --------
    polynomial_function : the polynomial at any point.
    """
    chosen = _coefficients(degree, seed, coefficients)
    return _on_cube(size, lambda points: _polynomial_at(points, chosen))


def polynomial_function(points: ArrayLike, degree: int = 3, seed: int = 0, coefficients: ArrayLike | None = None) -> Array:
    """The function that `polynomial` samples, at points (..., 3) in the order x, y, z."""
    return _polynomial_at(_points(points), _coefficients(degree, seed, coefficients))


@enough_memory("a phantom")
def checker(size: Size = 64, period: int = 16) -> Volume:
    """Alternating cubes of 0 and 1 with a period of `period` samples; spacing 1.

    Parameters
    ----------
    size : int or (nz, ny, nx)
        Samples along each axis.
    period : int
        Even, at least 2; with 2 every sample differs from its neighbours, the Nyquist frequency.
    """
    shape = _shape(size, 1)
    if whole("period", period, 2) % 2:
        raise OptionError(f"period must be an even whole number of at least 2; got {period!r}")
    memory.require(4 * math.prod(shape), f"a phantom of {shape} samples")
    z, y, x = np.ix_(*((np.arange(n) // (int(period) // 2) % 2).astype(np.uint8) for n in shape))
    data = np.empty(shape, np.float32)
    for layer, odd in zip(data, z, strict=True):
        np.bitwise_xor(y[0], odd ^ x[0], out=layer)
    return Volume(data)


@enough_memory("a phantom")
def box(size: Size = 64) -> Volume:
    """A hard-edged object of 0 and 1 on [-1, 1]³: a box of half-width 0.6, minus a ball around one corner.

    Parameters
    ----------
    size : int or (nz, ny, nx)
        Samples along each axis, at least 2.
    """
    return _on_cube(size, lambda p: (np.abs(p) <= 0.6).all(-1) & (((p - 0.6) ** 2).sum(-1) > 0.5**2))


_TABLE: dict[str, Callable[..., Volume]] = {
    "marschner-lobb": marschner_lobb,
    "sphere": sphere,
    "polynomial": polynomial,
    "checker": checker,
    "box": box,
}


def names() -> list[str]:
    """The names of `by_name`."""
    return list(_TABLE)


def by_name(name: str) -> Volume:
    """A phantom from a name, or a name and a size: ``"sphere"``, ``"sphere:64"``, ``"box:32,48,64"`` (nz, ny, nx).

    Raises
    ------
    OptionError
        The name is unknown, or the size is not valid.
    """
    if not isinstance(name, str):
        raise one_of("phantom", name, _TABLE)
    kind, colon, size = name.strip().partition(":")
    if kind not in _TABLE:
        raise one_of("phantom", kind, _TABLE)
    try:
        sizes = [int(part) for part in size.split(",")] if colon else []
    except ValueError:
        raise OptionError(f"the size of a phantom must be one whole number or nz,ny,nx; got {size!r}") from None
    volume = _TABLE[kind](*(sizes if len(sizes) == 1 else [sizes] if sizes else []))
    note(volume, f"phantom:{name.strip()}", {})
    return volume


# -- inner -------------------------------------------------------------------------------------------


def _shape(size: Size, minimum: int) -> tuple[int, int, int]:
    wanted = f"size must be a whole number of at least {minimum}, or three of them (nz, ny, nx); got {size!r}"
    if isinstance(size, (bool, str)):
        raise OptionError(wanted)
    try:
        sizes: tuple[object, ...] = tuple(size)  # type: ignore[arg-type]  # a single number is not iterable
    except TypeError:
        sizes = (size,) * 3
    try:
        nz, ny, nx = (whole("size", n, minimum) for n in sizes)
    except ValueError:
        raise OptionError(wanted) from None
    require_room("size", nz * ny * nx, size)
    return nz, ny, nx


def _on_cube(size: Size, function: Callable[[Array], NDArray[Any]]) -> Volume:
    """Sample a function of points (..., 3) on [-1, 1]³, with the outer samples on its faces; by layers and rows."""
    shape = _shape(size, 2)
    memory.require(4 * math.prod(shape), f"a phantom of {shape} samples")
    nz, ny, nx = shape
    data, (z, y, x) = np.empty(shape, np.float32), (np.linspace(-1, 1, n) for n in shape)
    layers, rows = max(1, _AT_ONCE // (ny * nx)), max(1, _AT_ONCE // nx)
    for i in range(0, nz, layers):
        for j in range(0, ny, rows):
            part = np.s_[i : i + layers, j : j + rows]
            axes = np.meshgrid(z[part[0]], y[part[1]], x, indexing="ij")
            data[part] = function(np.stack(axes[::-1], -1))
    return Volume(data, tuple(2 / (n - 1) for n in shape[::-1]), (-1.0,) * 3)


def _points(points: ArrayLike) -> Array:
    array = reals("points", points)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise OptionError(f"points must have shape (..., 3); got {array.shape}")
    return array


def _columns(points: ArrayLike, alpha: float, f_m: float) -> tuple[Array, Array, Array]:
    number("alpha", alpha, minimum=0)
    number("f_m", f_m, minimum=0)
    array = _points(points)
    return array[..., 0], array[..., 1], array[..., 2]


def _coefficients(degree: int, seed: int, coefficients: ArrayLike | None) -> Array:
    if coefficients is not None:
        chosen = reals("coefficients", coefficients)
        if chosen.ndim != 3 or 0 in chosen.shape or not np.isfinite(chosen).all():
            raise OptionError(f"coefficients must be finite numbers of shape (a, b, c); got shape {chosen.shape}")
        return chosen
    degree = whole("degree", degree, 0, 9)
    return np.random.default_rng(whole("seed", seed, 0)).uniform(-1, 1, (degree + 1,) * 3)


def _polynomial_at(points: Array, coefficients: Array) -> Array:
    return np.asarray(np.polynomial.polynomial.polyval3d(points[..., 0], points[..., 1], points[..., 2], coefficients))
