"""Spatial transforms from registration: affine maps, displacement fields and B-spline grids, in ITK's conventions.

A transform maps points of the *fixed* world to points of the *moving* one: the direction that resampling needs, and that
ITK, SimpleITK, elastix and ANTs write. Worlds are ITK's (LPS in medicine), as for `Volume`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base.arrays import as_array, reals
from clvol.base.errors import DataError, GeometryError, OptionError
from clvol.filter.filter import Filter
from clvol.filter.make import bspline
from clvol.filter.table import as_filter
from clvol.interop.itk import simpleitk
from clvol.volume.volume import Volume

__all__ = [
    "AffineTransform",
    "BSplineTransform",
    "DisplacementField",
    "Transform",
    "Transforms",
    "as_chain",
    "from_simpleitk",
    "split_at_grids",
]

_SINGULAR = 1e-12  # smallest determinant of a matrix whose columns have length 1
_MOST_TAPS = 6
_FAR = 2.0**20  # index along an axis, far outside but small enough that differences of positions lose no digits


class AffineTransform:
    """An affine map of the world, ``y = matrix (x - center) + center + translation``, with ITK's parameters.

    Parameters
    ----------
    matrix : array-like, shape (d, d)
        d = 2 or 3; not singular.
    translation, center : array-like, shape (d,), optional
        In world units; default 0.

    Attributes
    ----------
    matrix : ndarray of float64, shape (d, d)
    offset : ndarray of float64, shape (d,)
        The map is ``y = matrix x + offset``.

    Raises
    ------
    GeometryError
        `matrix` is not 2 × 2 or 3 × 3 finite numbers, or is singular; `translation` or `center` is not d finite
        numbers.

    Examples
    --------
    >>> import clvol
    >>> turn = clvol.AffineTransform([[0, -1, 0], [1, 0, 0], [0, 0, 1]], (5, 0, 0))  # transform=turn of resample and warp
    """

    def __init__(self, matrix: ArrayLike, translation: ArrayLike | None = None, center: ArrayLike | None = None) -> None:
        given = reals("matrix", matrix, "2 × 2 or 3 × 3 numbers", GeometryError)
        if given.shape not in ((2, 2), (3, 3)) or not np.isfinite(given).all():
            raise GeometryError(f"matrix must be 2 × 2 or 3 × 3 finite numbers; got {given.tolist()}")
        lengths = np.linalg.norm(given, axis=0)
        if not lengths.all() or abs(np.linalg.det(given / lengths)) < _SINGULAR:
            raise GeometryError(f"matrix must not be singular; got {given.tolist()}")
        about = _vector("center", center, len(given))
        self.matrix = given.copy()
        self.offset = _vector("translation", translation, len(given)) + about - given @ about

    @classmethod
    def from_homogeneous(cls, matrix: ArrayLike) -> AffineTransform:
        """The map of a (d + 1) × (d + 1) matrix, whose last row is 0 ... 0 1.

        Raises
        ------
        GeometryError
            `matrix` is not such a matrix of finite numbers, or is singular.
        """
        whole = reals("an affine matrix", matrix, "3 × 3 numbers in 2-D or 4 × 4 in 3-D", GeometryError)
        if whole.shape not in ((3, 3), (4, 4)) or not np.array_equal(whole[-1], np.eye(len(whole))[-1]):
            raise GeometryError(
                "an affine matrix must be 3 × 3 numbers in 2-D or 4 × 4 in 3-D, the last row 0 ... 0 1; "
                f"got {whole.tolist() if whole.size <= 16 else f'an array of shape {whole.shape}'}"
            )
        return cls(whole[:-1, :-1], whole[:-1, -1])

    @classmethod
    def unchecked(cls, matrix: NDArray[np.float64], offset: NDArray[np.float64]) -> AffineTransform:
        """``y = matrix x + offset``, without checks of the numbers."""
        result = cls.__new__(cls)
        result.matrix, result.offset = matrix, offset
        return result

    def __repr__(self) -> str:
        return f"AffineTransform({self.matrix.tolist()}, {self.offset.tolist()})"

    @property
    def ndim(self) -> int:
        """2 or 3."""
        return len(self.matrix)

    def after(self, first: AffineTransform) -> AffineTransform:
        """The map that applies `first`, then this one."""
        return AffineTransform.unchecked(self.matrix @ first.matrix, self.matrix @ first.offset + self.offset)


class _GridTransform:
    """What is added to a point: a spline with coefficients on a grid in the world, within a part of it, and nothing outside.

    Parameters
    ----------
    what : str
        Name of the values in messages.
    values : ndarray, shape (nz, ny, nx, 3) or (ny, nx, 2)
    spacing, origin, direction
        See `Volume`.
    filter : Filter
    """

    filter: Filter

    def __init__(self, what: str, values: ArrayLike, spacing: Any, origin: Any, direction: Any, filter: Filter) -> None:
        array = as_array(values, what)
        if array.dtype.kind not in "biuf":
            raise DataError(f"{what} must be real numbers; got {array.dtype}")
        if array.ndim not in (3, 4) or array.shape[-1] != array.ndim - 1:
            raise DataError(f"{what} must have shape (nz, ny, nx, 3) or (ny, nx, 2); got {array.shape}")
        self._values = array.view()
        self._values.flags.writeable = False
        self.filter = filter
        # Volume checks the grid and converts its indices
        self.grid = Volume(np.broadcast_to(np.float32(0), array.shape[:-1]), spacing, origin, direction)
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            first = np.unravel_index(int(np.argmax(~np.isfinite(array))), array.shape)
            raise DataError(f"{what} must be finite; got {array[first]} at index {[int(i) for i in first]} [z, y, x, component]")

    def __repr__(self) -> str:
        grid = self.grid
        return f"{type(self).__name__}(shape={self._values.shape}, spacing={grid.spacing}, origin={grid.origin})"

    @property
    def ndim(self) -> int:
        """2 or 3."""
        return self.grid.ndim

    @property
    def domain(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lowest and highest grid indices (x, y[, z]) of the domain in which points are displaced."""
        raise NotImplementedError


class DisplacementField(_GridTransform):
    """Displacements on a grid: ``y = x + u(x)``, as ITK's DisplacementFieldTransform.

    A point is displaced inside the domain of the field, which ends half a voxel outside the outer samples, and unchanged
    elsewhere (ITK's rule).

    Parameters
    ----------
    displacements : array-like, shape (nz, ny, nx, 3) or (ny, nx, 2)
        Along (x, y[, z]) of the *world*, in world units, whatever the grid's direction is.
    spacing, origin, direction : optional
        Placement of the grid, as for `Volume`.
    filter : str or Filter
        Interpolation: "linear" as in ITK, which clamps to the outer sample in the outer half voxel; or a filter of 2 to 6
        taps such as "bspline3", which interpolates the samples and gives a smooth Jacobian.

    Raises
    ------
    DataError
        The displacements are empty, or not finite real numbers of such a shape.
    GeometryError
        The grid is not valid.
    OptionError
        `filter` is unknown, smooths or magnifies, or does not have 2 to 6 taps.

    Examples
    --------
    >>> import clvol, numpy as np
    >>> still = clvol.DisplacementField(np.zeros((4, 4, 4, 3)), spacing=(0.5, 0.5, 0.5), origin=(-1, -1, -1))
    """

    def __init__(
        self,
        displacements: ArrayLike,
        spacing: Sequence[float] = (),
        origin: Sequence[float] = (),
        direction: ArrayLike | None = None,
        filter: str | Filter = "linear",
    ) -> None:
        row = as_filter(filter)
        if not 2 <= row.support <= _MOST_TAPS or row.degree >= row.support or row.magnified_by or row.smoothing or row.length:
            raise OptionError(
                f"the filter of a displacement field must have 2 to {_MOST_TAPS} taps, a lower degree, and neither smooth nor "
                f"magnify, such as 'linear' and 'bspline3'; got {row.name!r}"
            )
        super().__init__("displacements", displacements, spacing, origin, direction, row)

    @property
    def displacements(self) -> NDArray[Any]:
        """The samples, read-only."""
        return self._values

    @property
    def domain(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return np.full(self.ndim, -0.5), np.asarray(self.grid.size) - 0.5


class BSplineTransform(_GridTransform):
    """A free-form deformation, ``y = x + u(x)`` with a B-spline ``u`` given by its coefficients, as ITK's BSplineTransform.

    Rueckert et al., IEEE Trans. Med. Imaging 18(8), 1999. A point is displaced where the grid has all coefficients of its
    support, from index (order - 1) / 2 to n - 1 - (order - 1) / 2 along each axis, and unchanged elsewhere
    (ITK's rule).

    Parameters
    ----------
    coefficients : array-like, shape (nz, ny, nx, 3) or (ny, nx, 2)
        Displacements along (x, y[, z]) of the world: ITK's coefficient images, one per component.
    spacing, origin, direction : optional
        Placement of the coefficient images; the origin is the position of the first coefficient, outside the domain.
    order : {1, 2, 3}
        Order of the B-spline.

    Raises
    ------
    DataError
        The coefficients are not finite real numbers of such a shape.
    GeometryError
        The grid is not valid, or has fewer than order + 1 coefficients along an axis.
    OptionError
        `order` is not 1, 2 or 3.
    """

    def __init__(
        self,
        coefficients: ArrayLike,
        spacing: Sequence[float] = (),
        origin: Sequence[float] = (),
        direction: ArrayLike | None = None,
        order: int = 3,
    ) -> None:
        if isinstance(order, bool) or not isinstance(order, (int, np.integer)) or order not in (1, 2, 3):
            raise OptionError(f"order must be 1, 2 or 3; got {order!r}")
        super().__init__("coefficients", coefficients, spacing, origin, direction, bspline(order))
        if min(self.grid.shape) <= order:
            raise GeometryError(
                f"a B-spline of order {order} must have at least {order + 1} coefficients along each axis; got {self.grid.shape}"
            )

    @property
    def coefficients(self) -> NDArray[Any]:
        """The coefficients, read-only."""
        return self._values

    @property
    def domain(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        margin = (self.filter.support - 2) / 2
        return np.full(self.ndim, margin), np.asarray(self.grid.size) - 1 - margin


Transform: TypeAlias = AffineTransform | DisplacementField | BSplineTransform
"""One transform."""

Transforms: TypeAlias = "Transform | NDArray[Any] | Any | Sequence[Transform | NDArray[Any] | Any]"
"""Values of `transform=`: a transform, a homogeneous matrix, a SimpleITK transform, or a list of these."""


def as_chain(transform: Transforms | None, ndim: int) -> list[Transform]:
    """The transforms of a chain, in ITK's order: **the last one is applied first**, as in a product of matrices.

    Parameters
    ----------
    transform : transform, array, SimpleITK transform, or a list of these
        An array of (d + 1) × (d + 1) numbers is an affine map in homogeneous coordinates. None and an empty list leave points
        unchanged.
    ndim : int
        Number of dimensions of the images, 2 or 3.

    Raises
    ------
    OptionError
        An entry is not a transform, or an unsupported SimpleITK transform.
    GeometryError
        A transform has another number of dimensions, or a matrix is singular.
    """
    if transform is None:
        return []
    chain: list[Transform] = []
    for part in transform if isinstance(transform, (list, tuple)) else [transform]:
        if isinstance(part, (AffineTransform, DisplacementField, BSplineTransform)):
            chain.append(part)
        elif isinstance(part, np.ndarray):
            chain.append(AffineTransform.from_homogeneous(part))
        elif hasattr(part, "TransformPoint"):
            chain += from_simpleitk(part)
        else:
            raise OptionError(
                "transform must be an AffineTransform, a DisplacementField, a BSplineTransform, an array with a homogeneous "
                f"matrix, a transform of SimpleITK, or a list of these; got {part!r}"
            )
    for one in chain:
        if one.ndim != ndim:
            raise GeometryError(f"transforms must be of {ndim} dimensions, as the image is; got {one!r}, which is of {one.ndim}")
    return chain


def split_at_grids(
    chain: Sequence[Transform], ndim: int
) -> tuple[list[AffineTransform], list[DisplacementField | BSplineTransform]]:
    """The n grids of a chain in order of application, and the n + 1 affine maps before, between and after them."""
    still = AffineTransform.unchecked(np.eye(ndim), np.zeros(ndim))
    affine, grids = [still], []
    for one in reversed(chain):
        if isinstance(one, AffineTransform):
            affine[-1] = one.after(affine[-1])
        else:
            grids.append(one)
            affine.append(still)
    return affine, grids


def from_simpleitk(transform: Any) -> list[Transform]:
    """Convert a SimpleITK transform to a chain.

    Parameters
    ----------
    transform : SimpleITK.Transform
        Affine, Euler, versor, rigid, similarity, scale, translation and identity transforms, B-spline and displacement field
        transforms, and composite ones of these. Displacement fields are interpolated linearly, ITK's default.

    Returns
    -------
    list of transforms
        In ITK's order, as `transform=` of `clvol.resample` expects.

    Raises
    ------
    OptionError
        The transform has another type.
    MissingDependencyError
        SimpleITK is not installed.
    """
    sitk = simpleitk()
    if not isinstance(transform, sitk.Transform):
        raise OptionError(f"a transform must be one of SimpleITK's; got a {type(transform).__name__}")
    one = transform.Downcast() if type(transform) is sitk.Transform else transform
    if one.IsLinear():  # the images of the origin and the axes define it, whatever its parameters or parts
        d = one.GetDimension()
        offset = np.array(one.TransformPoint((0.0,) * d))
        ends = np.array([one.TransformPoint(tuple(end)) for end in _FAR * np.eye(d)])
        return [AffineTransform((ends - offset).T / _FAR, offset)]
    if isinstance(one, sitk.CompositeTransform):
        parts = [from_simpleitk(one.GetNthTransform(n)) for n in range(one.GetNumberOfTransforms())]
        return [part for chain in parts for part in chain]
    if isinstance(one, sitk.DisplacementFieldTransform):
        return [displacements_of(one.GetDisplacementField())]
    if isinstance(one, sitk.BSplineTransform):
        images = one.GetCoefficientImages()
        values = np.stack([sitk.GetArrayFromImage(image) for image in images], axis=-1)
        return [BSplineTransform(values, *_geometry(images[0]), order=one.GetOrder())]
    raise OptionError(
        "a transform of SimpleITK must be linear (affine, Euler, versor, similarity, scale, translation), a BSplineTransform, a "
        f"DisplacementFieldTransform, or a CompositeTransform of these; got a {one.GetName()}"
    )


def displacements_of(image: Any) -> DisplacementField:
    """The displacement field of a SimpleITK image of vectors.

    Raises
    ------
    DataError
        The image does not have 2 or 3 axes and the same number of components.
    """
    return DisplacementField(simpleitk().GetArrayFromImage(image), *_geometry(image))


def _geometry(image: Any) -> tuple[Any, Any, NDArray[np.float64]]:
    """Spacing, origin and direction of a SimpleITK image."""
    d = image.GetDimension()
    return image.GetSpacing(), image.GetOrigin(), np.reshape(image.GetDirection(), (d, d))


def _vector(what: str, value: ArrayLike | None, d: int) -> NDArray[np.float64]:
    if value is None:
        return np.zeros(d)
    vector = reals(what, value, f"{d} numbers", GeometryError)
    if vector.shape != (d,) or not np.isfinite(vector).all():
        raise GeometryError(f"{what} must be {d} finite numbers; got {value!r}")
    return vector
