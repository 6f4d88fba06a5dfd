"""TorchIO's spatial transforms with the values of clvol's splines, and with smooth labels: `clvol.torchio`, an extra.

Each class has the name and the arguments of TorchIO's. Where an interpolation is "bspline" or "cubic", values are clvol's, which
are those of SimpleITK's ``sitkBSpline``, as TorchIO's are; "labels" keeps the whole numbers of a `LabelMap` and gives them smooth
boundaries (see `clvol.resample` with ``smooth=True``). Any other interpolation is left to TorchIO, and so are subjects, their
history, affine matrices, random numbers and inverses. The device is the one that `clvol.as_device` chooses.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import MissingDependencyError
from clvol.spline.field import resample
from clvol.volume.volume import Volume

try:
    import SimpleITK
    import torch
    import torchio
    from torchio.data.io import nib_to_sitk
except ImportError as missing:
    raise MissingDependencyError('clvol.torchio needs TorchIO: pip install "clvol[torchio]"') from missing

__all__ = ["Affine", "ElasticDeformation", "RandomAffine", "RandomElasticDeformation", "Resample"]

_CUBIC: dict[str, Any] = {"filter": "bspline3", "boundary": "mirror", "smooth": False}
_OWN: dict[str, dict[str, Any]] = {"bspline": _CUBIC, "cubic": _CUBIC, "labels": {"smooth": True}}


def _on_grid(image: Any, like: Any, transform: Any, interpolation: str, fill: float) -> NDArray[Any]:
    """A scalar image of SimpleITK's on the grid of another, [z, y, x], through a transform."""
    place = [(one.GetSpacing(), one.GetOrigin(), np.reshape(one.GetDirection(), (3, 3))) for one in (image, like)]
    volume = Volume(SimpleITK.GetArrayViewFromImage(image), *place[0], labels=interpolation == "labels")
    grid = Volume(np.broadcast_to(np.float32(0), like.GetSize()[::-1]), *place[1], labels=False)
    return resample(volume, like=grid, transform=transform, fill=fill, dtype=volume.data.dtype, **_OWN[interpolation]).data


class _Named(int):
    """An interpolator of SimpleITK's, with the name of the interpolation that takes its place."""

    name: str


class _Interpolated:
    """A transform whose interpolations may be "labels"."""

    @staticmethod
    def parse_interpolation(interpolation: str) -> str:
        """TorchIO's check of an interpolation."""
        return interpolation if interpolation == "labels" else str(torchio.Transform.parse_interpolation(interpolation))

    @staticmethod
    def get_sitk_interpolator(interpolation: str) -> int:
        """The interpolator of SimpleITK."""
        made = _Named(torchio.Transform.get_sitk_interpolator("nearest" if interpolation == "labels" else interpolation))
        made.name = interpolation
        return made


class _Resampler:
    """In place of a `SimpleITK.ResampleImageFilter`, which holds the grid."""

    def __init__(self, theirs: Any, interpolation: str) -> None:
        self._theirs, self._interpolation = theirs, interpolation

    def __getattr__(self, name: str) -> Any:
        return getattr(self._theirs, name)

    def Execute(self, image: Any) -> Any:
        """The image, resampled component by component."""
        theirs, several = self._theirs, image.GetNumberOfComponentsPerPixel()
        like = SimpleITK.Image(theirs.GetSize(), SimpleITK.sitkUInt8)
        like.SetSpacing(theirs.GetOutputSpacing())
        like.SetOrigin(theirs.GetOutputOrigin())
        like.SetDirection(theirs.GetOutputDirection())
        parts = [image] if several == 1 else [SimpleITK.VectorIndexSelectionCast(image, c) for c in range(several)]
        fill = theirs.GetDefaultPixelValue()
        made = []
        for part in parts:
            values = SimpleITK.GetImageFromArray(_on_grid(part, like, theirs.GetTransform(), self._interpolation, fill))
            values.CopyInformation(like)
            made.append(values)
        return made[0] if several == 1 else SimpleITK.Compose(made)


class Resample(_Interpolated, torchio.Resample):
    """`torchio.Resample`: images on another grid.

    Examples
    --------
    >>> from clvol.torchio import Resample
    >>> finer = Resample(0.5, image_interpolation="bspline", label_interpolation="labels")(subject)
    """

    def _get_resampler(self, interpolator: Any, *args: Any) -> Any:
        theirs = super()._get_resampler(interpolator, *args)
        return _Resampler(theirs, interpolator.name) if interpolator.name in _OWN else theirs


class Affine(_Interpolated, torchio.Affine):
    """`torchio.Affine`: images turned, scaled and moved."""

    def apply_affine_transform(self, sitk_image: Any, transform: Any, interpolation: str, default_value: float) -> Any:
        """The values of one channel, as float32."""
        if interpolation not in _OWN:
            return super().apply_affine_transform(sitk_image, transform, interpolation, default_value)
        values = _on_grid(sitk_image, sitk_image, transform, interpolation, default_value)
        return torch.as_tensor(values.transpose().astype(np.float32))


class ElasticDeformation(_Interpolated, torchio.ElasticDeformation):
    """`torchio.ElasticDeformation`: images deformed by a B-spline."""

    def apply_bspline_transform(self, tensor: Any, affine: NDArray[Any], interpolation: str) -> Any:
        """The values of all channels, as float32."""
        if interpolation not in _OWN:
            return super().apply_bspline_transform(tensor, affine, interpolation)
        made = []
        for channel in tensor:
            image = nib_to_sitk(channel[np.newaxis], affine, force_3d=True)
            transform = self.get_bspline_transform(image)
            self.parse_free_form_transform(transform, self.max_displacement)
            made.append(_on_grid(image, image, transform, interpolation, float(channel.min())).transpose().astype(np.float32))
        return torch.as_tensor(np.stack(made))


class RandomAffine(_Interpolated, torchio.RandomAffine):
    """`torchio.RandomAffine`: `Affine` with random parameters."""

    def apply_transform(self, subject: Any) -> Any:
        """The subject through an `Affine` of clvol's, which its history holds."""
        drawn = self.get_params(self.scales, self.degrees, self.translation, self.isotropic)
        scales, degrees, translation = (tuple(values.tolist()) for values in drawn)
        return Affine(
            scales,
            degrees,
            translation,
            center=self.center,
            default_pad_value=self.default_pad_value,
            default_pad_label=self.default_pad_label,
            image_interpolation=self.image_interpolation,
            label_interpolation=self.label_interpolation,
            check_shape=self.check_shape,
            **self._get_base_args(),
        )(subject)


class RandomElasticDeformation(_Interpolated, torchio.RandomElasticDeformation):
    """`torchio.RandomElasticDeformation`: `ElasticDeformation` with random displacements."""

    def apply_transform(self, subject: Any) -> Any:
        """The subject through an `ElasticDeformation` of clvol's, which its history holds."""
        subject.check_consistent_spatial_shape()
        return ElasticDeformation(
            self.get_params(self.num_control_points, self.max_displacement, self.num_locked_borders),
            self.max_displacement,
            image_interpolation=self.image_interpolation,
            label_interpolation=self.label_interpolation,
            **self._get_base_args(),
        )(subject)
