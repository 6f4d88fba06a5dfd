"""MONAI's spatial transforms with the values of clvol's splines, and with smooth labels: `clvol.monai`, an extra.

Each class has the name and the arguments of the one in `monai.transforms` that it takes the place of. Where `mode` is the order of
a spline, 0 to 5, values are clvol's, which are SciPy's, as MONAI's are; ``mode="labels"`` keeps whole numbers and gives them smooth
boundaries (see `clvol.ndimage`). Any other mode is left to MONAI. Metadata, dictionaries, lazy evaluation, random numbers and
inverses are MONAI's own.

Values are computed in single precision, in double where the image is float64, whatever `dtype` says, on the device that
`clvol.as_device` chooses; tensors must be on the host.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from clvol import ndimage
from clvol.base.errors import MissingDependencyError, OptionError

try:
    import torch
    from monai import transforms
    from monai.data import MetaTensor
    from monai.data.utils import to_affine_nd
    from monai.transforms.lazy.functional import apply_pending
    from monai.transforms.utils import resolves_modes
    from monai.utils import LazyAttr, TraceKeys, convert_to_numpy, get_torch_dtype_from_string
except ImportError as missing:
    raise MissingDependencyError('clvol.monai needs MONAI: pip install "clvol[monai]"') from missing

__all__ = [
    "Affine",
    "Affined",
    "Rand2DElastic",
    "Rand2DElasticd",
    "Rand3DElastic",
    "Rand3DElasticd",
    "RandAffine",
    "RandAffined",
    "Resample",
    "Spacing",
    "Spacingd",
    "SpatialResample",
]


def _is_own(mode: Any) -> bool:
    return isinstance(mode, int) or mode == "labels"


def _options(mode: Any, padding_mode: Any, align_corners: Any) -> dict[str, Any]:
    """The options of `clvol.ndimage` for those of MONAI."""
    if align_corners is True:
        raise OptionError("align_corners must be False where mode is an order or 'labels'; got True")
    return {"order": mode, "mode": str(resolves_modes(3, padding_mode, backend=None)[2])}


def _computed(image: Any, compute: Any) -> Any:
    """Channels of an image, each computed from an array; float32, as of all of MONAI's."""
    return torch.as_tensor(np.stack([np.asarray(compute(channel), np.float32) for channel in convert_to_numpy(image)]))


def _as(kind: type[Any], made: Any) -> Any:
    """A transform of MONAI's as one of a class that adds methods only."""
    own: Any = object.__new__(kind)
    vars(own).update(vars(made))
    return own


def _evaluated(noted: Any) -> Any:
    """An image for which MONAI has noted a matrix, evaluated."""
    if not isinstance(noted, MetaTensor):
        raise OptionError("clvol.monai needs monai.data.set_track_meta(True), the default; got False")
    about = noted.pending_operations[-1]
    extra = about[TraceKeys.EXTRA_INFO]
    if not _is_own(extra["mode"]):
        return apply_pending(noted)[0]
    how = _options(extra["mode"], extra["padding_mode"], extra["align_corners"])
    noted.clear_pending_operations()
    shape = [int(n) for n in about[LazyAttr.SHAPE]]
    matrix = to_affine_nd(len(shape), convert_to_numpy(about[LazyAttr.AFFINE]))
    values = _computed(noted, lambda channel: ndimage.affine_transform(channel, matrix, output_shape=shape, **how))
    made = MetaTensor(values).copy_meta_from(noted)
    made.affine = noted.affine @ to_affine_nd(len(noted.affine) - 1, torch.as_tensor(matrix))
    made.push_applied_operation(about)
    return made


class _Noted:
    """MONAI notes the matrix, as for lazy evaluation, and clvol evaluates it."""

    def __call__(self, img: Any, *args: Any, **options: Any) -> Any:
        lazy = options.get("lazy")
        if self.lazy if lazy is None else lazy:  # type: ignore[attr-defined]  # of LazyTransform
            return super().__call__(img, *args, **options)  # type: ignore[misc]  # of the transform
        noted = super().__call__(img, *args, **{**options, "lazy": True})  # type: ignore[misc]
        return (_evaluated(noted[0]), *noted[1:]) if isinstance(noted, tuple) else _evaluated(noted)


class Resample(transforms.Resample):
    """`monai.transforms.Resample`: an image at the positions of a grid."""

    def __call__(
        self, img: Any, grid: Any = None, mode: Any = None, padding_mode: Any = None, dtype: Any = None, align_corners: Any = None
    ) -> Any:
        mode = self.mode if mode is None else mode
        padding_mode = self.padding_mode if padding_mode is None else padding_mode
        align_corners = self.align_corners if align_corners is None else align_corners
        if grid is None or not _is_own(mode):
            return super().__call__(img, grid, mode, padding_mode, dtype, align_corners)
        how = _options(mode, padding_mode, align_corners)
        positions = np.array(convert_to_numpy(grid)[: img.ndim - 1], np.float64)
        if self.norm_coords:  # from the middle
            for along, n in zip(positions, img.shape[1:], strict=True):
                along += (max(2, n) - 1) / 2
        values = _computed(img, lambda channel: ndimage.map_coordinates(channel, positions, **how))
        return MetaTensor(values).copy_meta_from(img) if isinstance(img, MetaTensor) else values


class SpatialResample(_Noted, transforms.SpatialResample):
    """`monai.transforms.SpatialResample`: an image on the grid of another affine matrix."""

    def inverse(self, data: Any) -> Any:
        """The image on the grid that it came from."""
        transform = self.pop_transform(data)
        extra = transform[TraceKeys.EXTRA_INFO]
        mode, padding_mode, corners = extra["mode"], extra["padding_mode"], extra["align_corners"] is True
        kind = get_torch_dtype_from_string(extra["dtype"])
        made = self(data, extra["src_affine"], transform[TraceKeys.ORIG_SIZE], mode, padding_mode, corners, kind, lazy=False)
        self.pop_transform(made)
        return made


class Spacing(transforms.Spacing):
    """`monai.transforms.Spacing`: an image with another spacing.

    Examples
    --------
    >>> from clvol.monai import Spacing
    >>> finer = Spacing(pixdim=(1, 1, 1), mode=3)(image)
    >>> labels = Spacing(pixdim=(1, 1, 1), mode="labels")(segmentation)
    """

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.sp_resample: Any = _as(SpatialResample, self.sp_resample)


class _Resampled:
    """A transform with a resampler."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.resampler = _as(Resample, self.resampler)  # type: ignore[has-type]  # of the transform


class Affine(_Noted, _Resampled, transforms.Affine):
    """`monai.transforms.Affine`: an image turned, scaled, sheared and moved."""


class RandAffine(_Noted, _Resampled, transforms.RandAffine):
    """`monai.transforms.RandAffine`: `Affine` with random parameters."""


class Rand2DElastic(_Resampled, transforms.Rand2DElastic):
    """`monai.transforms.Rand2DElastic`: an image deformed at random."""


class Rand3DElastic(_Resampled, transforms.Rand3DElastic):
    """`monai.transforms.Rand3DElastic`: a volume deformed at random."""


class _OfKeys:
    """A transform of dictionaries, whose attribute `inner` transforms one image."""

    inner: tuple[str, type[Any]]

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        name, kind = self.inner
        made = _as(kind, getattr(self, name))
        for resampler, own in (("resampler", Resample), ("sp_resample", SpatialResample)):
            if hasattr(made, resampler):
                setattr(made, resampler, _as(own, getattr(made, resampler)))
        setattr(self, name, made)


class Spacingd(_OfKeys, transforms.Spacingd):
    """`monai.transforms.Spacingd`: `Spacing` of the images in a dictionary."""

    inner = ("spacing_transform", Spacing)


class Affined(_OfKeys, transforms.Affined):
    """`monai.transforms.Affined`: `Affine` of the images in a dictionary."""

    inner = ("affine", Affine)


class RandAffined(_OfKeys, transforms.RandAffined):
    """`monai.transforms.RandAffined`: `RandAffine` of the images in a dictionary."""

    inner = ("rand_affine", RandAffine)


class Rand2DElasticd(_OfKeys, transforms.Rand2DElasticd):
    """`monai.transforms.Rand2DElasticd`: `Rand2DElastic` of the images in a dictionary."""

    inner = ("rand_2d_elastic", Rand2DElastic)


class Rand3DElasticd(_OfKeys, transforms.Rand3DElasticd):
    """`monai.transforms.Rand3DElasticd`: `Rand3DElastic` of the images in a dictionary."""

    inner = ("rand_3d_elastic", Rand3DElastic)
