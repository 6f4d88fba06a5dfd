"""`clvol.sample`, `resample` and `magnify` of volumes that are read part by part: brick by brick, within a budget of memory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, NoReturn

from numpy.typing import ArrayLike, DTypeLike

from clvol.base.checks import whole
from clvol.base.errors import OptionError
from clvol.bricks.source import LazyVolume, budget_for
from clvol.device import Device, as_device
from clvol.filter.boundary import Boundary, as_boundary
from clvol.filter.filter import Filter
from clvol.filter.table import DEFAULT_FILTER
from clvol.spline.bricked import BrickedField, as_lazy
from clvol.spline.field import Anchor, Frame, Progress, Reals
from clvol.spline.reduce import AntiAliasing
from clvol.volume.smoothing import filter_for, settled
from clvol.volume.transform import Transforms
from clvol.volume.volume import Volume

__all__ = ["magnify", "prefilter", "resample", "sample"]


def sample(
    volume: LazyVolume | BrickedField | Volume | ArrayLike,
    points: ArrayLike,
    filter: str | Filter | None = None,
    boundary: str | Boundary | None = None,
    derivative: int = 0,
    *,
    frame: Frame = "LPS",
    fill: float | None = None,
    device: Device | str | int | None = None,
    progress: Progress | None = None,
    out: Any = None,
    **others: Any,
) -> Reals:
    """As `clvol.sample`; each brick that points lie in is read once."""
    derivative = whole("derivative", derivative, minimum=0, maximum=2)
    with _opened("sample", volume, filter, boundary, device, others) as field:
        at = (field.__call__, field.gradient, field.hessian)[derivative]
        return at(points, frame=frame, fill=fill, progress=progress, out=out)


def resample(
    volume: LazyVolume | BrickedField | Volume | ArrayLike,
    shape: Sequence[int] | None = None,
    spacing: Sequence[float] | float | None = None,
    like: Any = None,
    filter: str | Filter | None = None,
    boundary: str | Boundary | None = None,
    *,
    anchor: Anchor = "center",
    transform: Transforms | None = None,
    anti_aliasing: AntiAliasing | bool = False,
    dtype: DTypeLike | None = None,
    fill: float | None = None,
    device: Device | str | int | None = None,
    progress: Progress | None = None,
    out: Any = None,
    **others: Any,
) -> Volume:
    """As `clvol.resample`; `out` may be what `BrickedField.resample` takes."""
    with _opened("resample", volume, filter, boundary, device, others) as field:
        made = field.resample(
            shape,
            spacing,
            like,
            anchor=anchor,
            transform=transform,
            anti_aliasing=anti_aliasing,
            dtype=dtype,
            fill=fill,
            progress=progress,
            out=out,
        )
        return _of(volume, made, field)


def magnify(
    volume: LazyVolume | BrickedField | Volume | ArrayLike,
    factor: int = 2,
    filter: str | Filter | None = None,
    boundary: str | Boundary | None = None,
    *,
    device: Device | str | int | None = None,
    progress: Progress | None = None,
    **others: Any,
) -> Volume:
    """As `clvol.magnify`."""
    with _opened("magnify", volume, filter, boundary, device, others) as field:
        return _of(volume, field.magnify(factor, progress=progress), field)


def _of(volume: Any, made: Volume, field: BrickedField) -> Volume:
    """A result, which says all that its volume does, but is no label map where labels were blended."""
    if isinstance(volume, Volume):
        made = volume.placed(made.data, made)
    return replace(made, labels=None) if field.filter.support > 1 and made.labels not in (None, False) else made


def prefilter(*_: Any, **__: Any) -> NoReturn:
    """There is no array for the coefficients of a volume that is larger than memory."""
    raise OptionError(
        "prefilter takes no volume that is read part by part: clvol.dask.prefilter gives its coefficients as an array of dask, "
        "clvol.prefilter(volume.whole()) all at once"
    )


_OTHERS = {  # options that bricks do not know, and what of them is no more than what they do
    "evaluator": ("auto", "taps"),
    "fetch": ("auto", "buffer"),
    "precision": (None, "single"),
    "nan": (None, "error"),
}


@contextmanager
def _opened(
    function: str,
    volume: LazyVolume | BrickedField | Volume | ArrayLike,
    filter: str | Filter | None,
    boundary: str | Boundary | None,
    device: Device | str | int | None,
    others: dict[str, Any],
) -> Iterator[BrickedField]:
    """The field of a volume for the time of a block, or the one that was given."""
    for name, value in others.items():
        if name not in _OTHERS:
            raise TypeError(f"{function}() got an unexpected keyword argument {name!r}")
        if not any(value is one or (isinstance(one, str) and value == one) for one in _OTHERS[name]):
            instead = "volume.whole() has all samples in memory, and arrays of dask are taken by parts with it"
            told = f" {value!r}" if isinstance(value, str) else ""
            raise OptionError(f"{function} by bricks takes no {name}{told}: {instead}")
    if isinstance(volume, BrickedField):
        for name, own, given in (
            (
                "filter",
                volume.filter,
                None if filter is None else settled(filter_for(volume.volume.part(), filter, ""), volume.volume.part()),
            ),
            ("boundary", volume.boundary, None if boundary is None else as_boundary(boundary)),
            ("device", volume.device, None if device is None else as_device(device)),
        ):
            if given is not None and given != own:
                raise OptionError(f"the field was made with another {name}, which cannot be changed; leave {name} out")
        yield volume
        return
    lazy = as_lazy(volume)
    budget_for(lazy, None)
    row = filter_for(lazy.part(), filter, DEFAULT_FILTER)  # that of a volume in memory, whatever bounds are beside it
    with BrickedField(lazy, row, "mirror" if boundary is None else boundary, device) as field:
        yield field
