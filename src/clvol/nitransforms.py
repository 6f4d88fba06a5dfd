"""NiTransforms' resampling with clvol's splines: `clvol.nitransforms`, an extra.

`apply` takes the place of `nitransforms.resampling.apply`: its arguments, its images, its values. Transforms are NiTransforms' own,
in RAS: matrices, a series of them for head motion, dense and B-spline fields, chains. All of a chain is composed before the image
is interpolated, once; the volumes of a series are read and interpolated one after the other, on the device that `clvol.as_device`
chooses.
"""

from __future__ import annotations

from functools import reduce
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from clvol import ndimage
from clvol.base.errors import DataError, MissingDependencyError, OptionError

if TYPE_CHECKING:
    from clvol.device import Device
    from clvol.spline.field import Precision

try:
    import nibabel
    from nibabel.arrayproxy import get_obj_dtype
    from nibabel.funcs import squeeze_image
    from nitransforms.base import ImageGrid, SpatialReference
    from nitransforms.linear import Affine, LinearTransformsMapping
    from nitransforms.manip import TransformChain
    from nitransforms.nonlinear import DenseFieldTransform
    from nitransforms.resampling import cap_dtype
except ImportError as missing:
    raise MissingDependencyError('clvol.nitransforms needs NiTransforms: pip install "clvol[nitransforms]"') from missing

__all__ = ["apply", "coefficients"]

_Floats = NDArray[np.float64]
_ON_GRID = 1e-3  # voxels, as in NiTransforms


def apply(
    transform: Any,
    spatialimage: Any,
    reference: Any = None,
    order: int = 3,
    mode: str = "constant",
    cval: float = 0.0,
    prefilter: bool = True,
    output_dtype: DTypeLike | None = None,
    dtype_width: int = 8,
    serialize_nvols: int | None = None,  # noqa: ARG001  # NiTransforms' arguments have places
    max_concurrent: int | None = None,  # noqa: ARG001
    *,
    device: Device | str | int | None = None,
    precision: Precision | None = None,
) -> Any:
    """An image, or each volume of a series, through a transform: `nitransforms.resampling.apply`.

    Parameters
    ----------
    transform : nitransforms.base.TransformBase
        From the reference's space to the image's. The first of a chain is applied first; a `LinearTransformsMapping`, alone or in
        a chain, has a matrix for each volume.
    spatialimage : nibabel image or path
        3-D, or 4-D with a volume for each matrix.
    reference : nibabel image, surface or path, optional
        Where results lie; by default the transform's reference.
    order, mode, cval, prefilter
        As in `clvol.ndimage.map_coordinates`. ``prefilter=False`` is for the result of `coefficients`.
    output_dtype, dtype_width
        As in NiTransforms.
    serialize_nvols, max_concurrent : int, optional
        Without effect: memory is always that of one volume, which all processors share.
    device, precision
        As in `clvol.ndimage.map_coordinates`.

    Returns
    -------
    nibabel image of the class of `spatialimage`; ndarray, shape (points,) or (points, volumes), for a surface

    Raises
    ------
    OptionError
        There is no reference.
    DataError
        The numbers of volumes and of matrices differ.

    Examples
    --------
    >>> from clvol.nitransforms import apply
    >>> still = apply(warp + affine + motion, bold, reference=template)
    """
    image = _loaded(spatialimage)
    reference = transform.reference if reference is None else _loaded(reference)
    if reference is None:
        raise OptionError("reference must be an image or a surface where the transform has none; got None")
    place = reference if isinstance(reference, ImageGrid) else SpatialReference.factory(reference)
    alone, image = image.ndim == 4 and image.shape[-1] == 1, squeeze_image(image)
    kind = cap_dtype(get_obj_dtype(image.dataobj), dtype_width)
    volumes = image.shape[3] if image.ndim == 4 else 1
    steps = _steps(transform)
    matrices = {len(step) for step in steps if isinstance(step, LinearTransformsMapping)}
    if len({volumes, *matrices} - {1}) > 1:
        raise DataError(f"the image must have a volume for each matrix of a series; got {volumes} of {sorted(matrices)}")
    count = max(volumes, *matrices, 1)
    how: dict[str, Any] = {"order": order, "mode": mode, "cval": cval, "prefilter": prefilter}
    how |= {"device": device, "precision": precision}
    start = next((n for n, step in enumerate(steps) if isinstance(step, LinearTransformsMapping)), len(steps))
    on_grid = isinstance(place, ImageGrid) and all(isinstance(step, Affine) for step in steps)
    begun = None if on_grid else _through(steps[:start], place.ndcoords.T)
    shape = place.shape if isinstance(place, ImageGrid) else (place.npoints,)
    results = np.empty((*shape, count), kind, order="F")
    back = Affine(np.linalg.inv(image.affine))
    for t in range(count):
        rest = [step[t] if isinstance(step, LinearTransformsMapping) else step for step in steps[start:]]
        if t == 0 or volumes > 1:
            samples = np.asanyarray(image.dataobj[..., t] if volumes > 1 else image.dataobj).astype(kind, copy=False)
        onto = results[..., t]
        if begun is None:
            matrix = _joined([Affine(place.affine), *steps[:start], *rest, back])
            ndimage.affine_transform(samples, matrix, output_shape=shape, output=onto, **how)
        else:
            ndimage.map_coordinates(samples, _through([*rest, back], begun).reshape(3, *shape), output=onto, **how)
    if count == 1:
        results = results[..., 0]
    if not isinstance(place, ImageGrid):
        return results.astype(output_dtype or kind, copy=False)
    header = image.header.__class__() if place.header is None else place.header.copy()
    header.set_data_dtype(output_dtype or image.header.get_data_dtype())
    return image.__class__(results[..., np.newaxis] if alone else results, place.affine, header)


def coefficients(spatialimage: Any, order: int = 3, mode: str = "constant", **options: Any) -> Any:
    """An image of the coefficients of each volume's spline, to be resampled several times with ``prefilter=False``.

    Parameters
    ----------
    spatialimage : nibabel image or path
    order, mode
        As for `apply`; modes "nearest" and "grid-constant" need the samples.
    **options
        `device` and `precision`, as in `clvol.ndimage.spline_filter`.

    Returns
    -------
    nibabel image of the same class; float32 for samples of at most 16 bits or float32, else float64

    Raises
    ------
    OptionError
        Coefficients do not have the mode.

    Examples
    --------
    >>> from clvol.nitransforms import apply, coefficients
    >>> ready = coefficients("bold.nii.gz")
    >>> spaces = [apply(chain, ready, reference=grid, prefilter=False) for chain, grid in targets]
    """
    if mode in ("nearest", "grid-constant"):
        raise OptionError(f"mode must not pad the samples before they are filtered; got {mode!r}: leave prefilter=True")
    image = _loaded(spatialimage)
    kind = get_obj_dtype(image.dataobj)
    results = np.empty(image.shape, np.float32 if np.can_cast(kind, np.float32) else np.float64, order="F")
    for t in range(image.shape[3]) if image.ndim == 4 else [...]:
        ndimage.spline_filter(np.asanyarray(image.dataobj[..., t]), order, results[..., t], mode, **options)
    header = image.header.copy()
    header.set_data_dtype(results.dtype)
    return image.__class__(results, image.affine, header)


def _loaded(image: Any) -> Any:
    return nibabel.load(image) if isinstance(image, (str, Path)) else image


def _steps(transform: Any) -> list[Any]:
    """The transforms of a chain, which may hold others."""
    if not isinstance(transform, TransformChain):
        return [transform]
    return [step for one in transform.transforms for step in _steps(one)]


def _joined(affines: list[Any]) -> _Floats:
    """The matrix of some, of which the first is applied first."""
    return reduce(lambda done, step: np.asarray(step.matrix @ done, np.float64), affines, np.eye(4))


def _through(steps: list[Any], points: _Floats) -> _Floats:
    """Points, (3, points), through transforms, one after the other."""
    linear: list[Any] = []
    for step in [*steps, None]:
        if isinstance(step, Affine):
            linear.append(step)
            continue
        if linear:
            matrix = _joined(linear)
            points, linear = matrix[:3, :3] @ points + matrix[:3, 3:], []
        if isinstance(step, DenseFieldTransform):
            points = _deformed(step, points)
        elif step is not None:
            points = np.asarray(step.map(points.T), np.float64).T
    return points


def _deformed(field: Any, points: _Floats) -> _Floats:
    """Points through a dense field: NiTransforms' cubic spline of places, and no displacement outside the outer samples."""
    grid, inverse = field.reference, np.linalg.inv(field.reference.affine)
    at = inverse[:3, :3] @ points + inverse[:3, 3:]
    places = field.to_x5().transform
    if field.is_deltas:
        places = places + grid.ndcoords.reshape(places.shape)
    whole = np.rint(at).astype(np.intp)
    inside = ((whole >= 0) & (whole < np.reshape(grid.shape, (3, 1)))).all()
    if inside and np.linalg.norm(at - whole, axis=0).max() < _ON_GRID:
        return np.asarray(places[tuple(whole)].T, np.float64)
    moved = [ndimage.map_coordinates(places[..., k], at, np.float64, cval=np.nan, precision="double") for k in range(3)]
    return np.where(np.isnan(moved), points, moved)
