"""`Field`, the continuous function of a volume in memory with its coefficients on a device, and functions that use one once."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial, wraps
from importlib import import_module
from typing import TYPE_CHECKING, Any, ParamSpec, TypeGuard, TypeVar

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from clvol.base import memory
from clvol.base.arrays import as_output
from clvol.base.checks import flag, one_of, suggests_options, warn, whole
from clvol.base.errors import DataError, OptionError, OutOfMemoryError
from clvol.base.progress import Progress, part_of
from clvol.base.rounding import as_kind, wide
from clvol.device import as_device
from clvol.filter.boundary import DEFAULT_BOUNDARY, as_boundary, chosen_boundary
from clvol.filter.table import DEFAULT_FILTER, as_filter
from clvol.interop.dispatch import is_in_parts, require_lazy, with_dask
from clvol.interop.images import read_array
from clvol.spline.chain import Chain
from clvol.spline.coefficients import Coefficients, bytes_of
from clvol.spline.evaluator import DIRECT, choose_evaluator
from clvol.spline.function import (
    CLOSED,
    ContinuousFunction,
    Precision,
    as_result,
    fill_value,
    points_in_world,
    put,
    require_no_transform,
    result_kind,
)
from clvol.spline.grids import Target, between, beyond, described, grid_for
from clvol.spline.lease import Lease
from clvol.spline.points import Floats, Given, Reals, Transform, sample_coefficients, sample_grid
from clvol.spline.reduce import as_anti_aliasing, low_passed, nearest_spline, steps_along
from clvol.spline.regions import labels_on, region_boundary, region_filter, require_no_blending
from clvol.spline.resample import filled, resample_coefficients
from clvol.volume.missing import as_missing, touching
from clvol.volume.smoothing import filter_for, settled
from clvol.volume.stored import Stored, names_beyond
from clvol.volume.transform import as_chain
from clvol.volume.volume import Volume, as_volume, masked

if TYPE_CHECKING:
    from clvol.device import Device
    from clvol.filter.boundary import Boundary
    from clvol.filter.filter import Filter
    from clvol.spline.evaluator import Evaluator
    from clvol.spline.function import Frame
    from clvol.spline.grids import Anchor
    from clvol.spline.reduce import AntiAliasing
    from clvol.volume.missing import Missing
    from clvol.volume.transform import Transforms
    from clvol.volume.volumes import Volumes

__all__ = [
    "Field",
    "Floats",
    "Precision",
    "Reals",
    "as_field",
    "coefficients_of",
    "magnify",
    "opened",
    "precision_kind",
    "prefilter",
    "resample",
    "sample",
]

_PRECISIONS: dict[str, type[np.generic]] = {"single": np.float32, "double": np.float64}

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def coefficients_of(
    volume: Volume, filter: Filter, boundary: Boundary, device: Device, kind: type[np.generic] = np.float32
) -> Coefficients:
    """A volume's coefficients on a device, of type `kind`: prefiltered, with their halo, ready to sample.

    The coefficients of a hybrid (section 4.3) are samples of the spline on a grid of twice the density.
    """
    device.buffers.require_room(bytes_of(volume.size, filter, boundary, kind))  # before reading samples
    volume.require_finite()
    row = settled(filter, volume)
    return filled(Coefficients(volume, row, boundary, device, Stored.of(volume, row, boundary, kind), kind), volume.data)


class Field(ContinuousFunction):
    """The continuous function of a volume, with its coefficients on a device.

    The constructor uploads and prefilters the volume (section 4.2 of the paper); calls then only sample. `clvol.sample`,
    `clvol.resample` and `clvol.magnify` accept a Field in place of a volume.

    Parameters
    ----------
    volume : Volume or array-like, shape (ny, nx) or (nz, ny, nx)
        Samples of any integer or floating dtype; an array has spacing 1 and origin 0.
    filter : str or Filter, optional
        A name in `clvol.filters()`, or a custom filter; default "bspline3", or "nearest" for labels (`Volume.is_labels`).
    boundary : str or Boundary
        "mirror", "reflect", "wrap", …: how samples continue outside the volume; see `clvol.boundaries`.
    device : Device, str or int, optional
        See `as_device`; None is the default device.
    precision : {"single", "double"}, optional
        Precision of coefficients and results: float32, or float64 on devices that support it. Default "single", but "double" for
        labels that float32 cannot hold. Windowed sinc is a fit by polynomials, in double precision too: `Filter.fit_error` is
        5e-9 for `lanczos3n`, 3e-8 for `sinc4n`, and below 1e-11 for those that are not normalised.
    nan : {"error", "propagate", "local"} or Missing
        How samples that are NaN or infinite are treated: see `clvol.Missing`, which also takes a mask of missing samples.

    Attributes
    ----------
    volume : Volume
        The samples, as passed in.
    missing : Missing
        How missing samples are treated.
    gaps : Field or None
        The share of missing samples in each result; None if no sample is missing, or if any share is allowed.
    filter : Filter
        Its smoothing is settled for this volume.
    boundary : Boundary
    device : Device
    coefficients : Coefficients
        On the device.

    Raises
    ------
    DataError
        `volume` is not an array of real numbers with 2 or 3 axes, is empty, or holds a value that is NaN, infinite or too
        large for float64 (unless `nan` allows it); the mask has another shape.
    OptionError
        `filter`, `boundary`, `device` or `nan` is unknown.
    DeviceError
        There is no OpenCL device, or it cannot be used.
    OutOfMemoryError
        The coefficients do not fit on the device.

    Notes
    -----
    If samples are missing, a second field of their positions is kept, and every call samples both: twice the memory, and up to
    twice the time.

    A Field is a context manager: on exit it frees the device's memory, as `close` does. Several threads may share one.

    Single precision computes in float32: values err by about 10⁻⁶ of the largest magnitude. Samples further than 8 times their
    range from zero (a pressure of 101,325 ± 3) are stored minus an offset, and samples outside 2⁻⁹⁰ to 2⁹⁰ are scaled by a
    power of two, whatever their type; values then err by about 10⁻⁶ of the *range*. If samples are stored unchanged, as most
    are, results are float32. Otherwise values are float64; derivatives are float64 only with a power of two, since an offset
    does not change them. No offset is used if the filter's weights do not sum to one (`lanczos3`, `sinc`). Double precision
    does the same in float64, with a power of two for samples outside 2⁻⁹⁴⁰ to 2⁹⁴⁰. A single sample near zero in data that are
    otherwise far from zero also prevents the offset. Integers with a range of more than 2²⁴ are rounded to 2⁻²⁴ of it. See
    `clvol.volume.stored`.

    References
    ----------
    - P. Thévenaz, T. Blu and M. Unser, "Interpolation revisited", IEEE Transactions on Medical Imaging 19(7), 2000,
      739–758.

    Examples
    --------
    >>> import clvol
    >>> points = [(0.1, 0.2, 0.3), (0.2, 0.2, 0.3)]  # (x, y, z)
    >>> with clvol.Field(clvol.phantoms.marschner_lobb(24)) as field:
    ...     values, gradients = field(points), field.gradient(points)
    >>> values.shape, gradients.shape
    ((2,), (2, 3))
    """

    @suggests_options
    def __init__(
        self,
        volume: Volume | ArrayLike,
        filter: str | Filter | None = None,
        boundary: str | Boundary = DEFAULT_BOUNDARY,
        device: Device | str | int | None = None,
        *,
        precision: Precision | None = None,
        nan: str | Missing = "error",
    ) -> None:
        if is_in_parts(volume):
            raise DataError(
                "a Field keeps the coefficients of all samples: clvol.BrickedField(volume) reads them by bricks, "
                "clvol.Field(volume.whole()) reads them all"
            )
        self.volume = as_volume(volume)
        row = filter_for(self.volume, filter, DEFAULT_FILTER)
        self.boundary = as_boundary(boundary)
        usual = "double" if names_beyond(24, self.volume, row) else "single"  # float32 would round labels to others
        kind = precision_kind(usual if precision is None else precision)
        self.device = as_device(device)
        self.missing = as_missing(nan)
        where = self.missing.of(self.volume.data)
        present = self.volume
        if where is not None:
            present = replace(self.volume, data=self._filled(where))
            row = self._settled(row)
        self.coefficients = coefficients_of(present, row, self.boundary, self.device, kind)
        self.filter = self.coefficients.filter
        self._lease = Lease(CLOSED)
        self._lease.frees(self.coefficients.release)
        self.gaps = None if where is None else self._gaps_at(where)
        if self.gaps:
            self._lease.frees(self.gaps.close)

    def _filled(self, where: NDArray[np.bool_]) -> NDArray[Any]:
        """The samples, the missing ones replaced."""
        return self.missing.filled(self.volume.data, where)

    def _gaps_at(self, where: NDArray[np.bool_]) -> Field | None:
        """The share of missing samples as a function; None if any share is allowed."""
        rule, row = self.missing.rule, self.filter
        if rule == "local" and self.missing.most == 1:
            return None
        if rule == "propagate" and (row.magnified_by or row).prefilter:
            where = np.ones_like(where)
        try:
            return Field(replace(self.volume, data=where), touching(row, rule), replace(self.boundary, cval=0.0), self.device)
        except BaseException:
            self.close()
            raise

    def __repr__(self) -> str:
        shape = " × ".join(map(str, self.volume.shape))
        state = ", closed" if self.closed else ""
        return f"<Field of {shape} samples, {self.filter.name}, {self.boundary.name}, on {self.device.name!r}{state}>"

    def _repr_html_(self) -> str:
        """For notebooks: a plot of the kernel, and the field's properties."""
        from clvol.base import html

        known = {
            "samples": f"{html.numbers(self.volume.shape)} {self.volume.data.dtype}",
            "filter": self.filter.name,
            "boundary": self.boundary.name,
            "device": self.device.name,
            "coefficients": "freed, the field is closed"
            if self.closed
            else f"{self.precision} precision, {self.nbytes / 1e6:.4g} MB",
            "missing samples": self.missing.rule if self.missing.rule != "error" else "",
        }
        return html.beside(html.curve(*self.filter.plot(33)), html.facts("Field", known))

    @property
    def grid(self) -> Volume:
        """The volume."""
        return self.volume

    @property
    def precision(self) -> Precision:
        """Precision of coefficients and results: "single" or "double"."""
        return "double" if self.coefficients.kind == np.float64 else "single"

    @property
    def nbytes(self) -> int:
        """Bytes of the coefficients' buffer; 0 once closed. An image takes the same again."""
        return 0 if self.closed else self.coefficients.nbytes + (self.gaps.nbytes if self.gaps else 0)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickles the arguments: another process computes the coefficients again, on its device of the same name."""
        with self._lease.held():
            again = partial(type(self), precision=self.precision, nan=self.missing)
            return again, (self.volume, self.filter, self.boundary, self.device)

    def _settled(self, filter: str | Filter) -> Filter:
        row = as_filter(filter)
        known = row.settled and (row.magnified_by is None or row.magnified_by.settled)
        where = None if known else self.missing.of(self.volume.data)  # filled samples say nothing of the noise
        return settled(row, self.volume if where is None else masked(self.volume, where))

    def _evaluator(self) -> Evaluator:
        return choose_evaluator(self.device, self.filter, double=self.precision == "double")

    def _bytes_at(self, points: int, derivative: int, *, into: bool) -> int:
        """Results of kernels, float64 results beside them if they differ, and the share of missing samples."""
        from_kernels = 0 if into else np.dtype(self.coefficients.kind).itemsize
        results: int = points * self.grid.ndim**derivative
        return results * (from_kernels + 8 * self.coefficients.stored.alters(derivative) + 5 * (self.gaps is not None))

    def _at(
        self, points: NDArray[Any], derivative: int, fill: float | None, progress: Progress | None, out: NDArray[Any] | None
    ) -> Reals:
        made, direct = self.coefficients, out if self._writes(out) else None
        first, second = self._halves(progress)
        flat = sample_coefficients(made, self._evaluator(), points, derivative, fill, first, direct)
        if self.gaps:
            share = sample_coefficients(self.gaps.coefficients, DIRECT, points, 0, None if fill is None else 0.0, second)
            flat[share > self.missing.most] = np.nan
        return flat

    def _on(self, target: Target, progress: Progress | None, out: Any) -> NDArray[Any]:
        if target.anti_aliasing:
            fewer = _low_passed_on(target, self.volume, self.filter, self.boundary, self.device, self.precision, progress)
            room = None if out is None else as_output(out, target.shape)
            return put(fewer, room, room)
        device, made, given, count = self.device, self.coefficients, Given(target.fill), math.prod(target.shape)
        room = None if out is None else as_output(out, target.shape)
        converted = 0 if target.kind is None or target.kind == made.kind else target.kind.itemsize
        device.buffers.require_room(np.dtype(made.kind).itemsize * count, held=True)
        memory.require(self._bytes_at(count, 0, into=out is not None) + converted * count, described(target.shape))
        result = room if self._writes(room) else np.empty(target.shape, made.kind)
        first, second = self._halves(progress)
        final = _values_on(made, self._evaluator(), target, result, given, first)
        if self.gaps:
            outside, room_for_share = Given(None if target.fill is None else 0.0), np.empty(target.shape, np.float32)
            share = _values_on(self.gaps.coefficients, DIRECT, target, room_for_share, outside, second)
            final[share > self.missing.most] = np.nan
        return put(final, room, room)

    def _halves(self, progress: Progress | None) -> tuple[Progress | None, Progress | None]:
        """Callbacks for the values, and for the share of missing samples, which takes as long."""
        return (part_of(progress, 0, 0.5), part_of(progress, 0.5, 1)) if self.gaps else (progress, None)

    def _writes(self, target: NDArray[Any] | None) -> TypeGuard[NDArray[Any]]:
        """Whether kernels can write results directly into an array."""
        return (
            target is not None
            and target.dtype == self.coefficients.kind
            and target.dtype.isnative
            and target.flags.c_contiguous
            and target.flags.aligned
        )


def _values_on(
    made: Coefficients, evaluator: Evaluator, target: Target, result: NDArray[Any], given: Given, progress: Progress | None
) -> NDArray[Any]:
    """Values on a grid in units of the data; kernels write into `result`, an array of the coefficients' type."""
    shape = (1, *target.shape)[-3:]
    with made.device.buffers.lent(result, write=True) as buffer:
        if target.chain is not None:
            last = Transform(target.matrix, target.offset, np.eye(len(target.offset)))
            sample_grid(made, evaluator, last, shape, buffer, given, progress, chain=target.chain)
        else:
            resample_coefficients(made, evaluator, target.matrix, target.offset, shape, buffer, given, progress)
    return given.in_units_of_data(made, result, 0)


def _low_passed_on(
    target: Target,
    volume: Volume,
    filter: Filter,
    boundary: Boundary,
    device: Device,
    precision: Precision,
    progress: Progress | None,
) -> NDArray[Any]:
    """A volume's function on a coarser grid, low-passed against aliasing."""
    kind = precision_kind(precision)
    if target.anti_aliasing == "gaussian":
        smooth = low_passed(volume, steps_along(target.matrix), boundary, kind, device)
        with Field(smooth, filter, boundary, device, precision=precision) as field:
            return field._on(replace(target, anti_aliasing=None, kind=None), progress, None)
    data = nearest_spline(volume, filter, boundary, kind, device, target.matrix, target.offset, target.shape, progress)
    if target.fill is not None:
        for axis, outside in enumerate(beyond(target.matrix, target.offset, volume.shape, target.shape, boundary)):
            np.moveaxis(data, axis, 0)[outside] = target.fill
    return data


# -- fields of any input -----------------------------------------------------------------------------------------


def as_field(
    volume: Any,
    filter: str | Filter | None = None,
    boundary: str | Boundary | None = None,
    device: Device | str | int | None = None,
    precision: Precision | None = None,
    nan: str | Missing | None = None,
) -> ContinuousFunction:
    """The function of a volume: a Field, or a BrickedField of a LazyVolume; a function is returned unchanged.

    Parameters
    ----------
    volume : Volume, array-like, LazyVolume, Field or BrickedField
    filter, boundary, device, precision, nan
        As for `Field`; None is the default, or the option of the given function.

    Raises
    ------
    OptionError
        A function is given with a filter, boundary, device, precision or treatment of missing samples that differs from its
        options; or a LazyVolume with a precision or treatment of missing samples that a BrickedField does not support.
    DataError, DeviceError, OutOfMemoryError
        As `Field` raises them.
    """
    if isinstance(volume, ContinuousFunction):
        _require_same(volume, filter, boundary, device, precision, nan)
        return volume
    boundary = DEFAULT_BOUNDARY if boundary is None else boundary
    if is_in_parts(volume):
        by_bricks: ContinuousFunction = _bricks().of_lazy(volume, filter, boundary, device, precision, nan)
        return by_bricks
    return Field(volume, filter, boundary, device, precision=precision, nan="error" if nan is None else nan)


def _require_same(
    function: ContinuousFunction,
    filter: str | Filter | None,
    boundary: str | Boundary | None,
    device: Device | str | int | None,
    precision: Precision | None,
    nan: str | Missing | None,
) -> None:
    """Raise `OptionError` for an option that differs from the function's; None is not compared."""
    for what, present, same, given in (
        ("filter", function.filter.name, filter is None or function._settled(filter) == function.filter, filter),
        ("boundary", function.boundary.name, boundary is None or as_boundary(boundary) == function.boundary, boundary),
        ("device", function.device.name, device is None or as_device(device) is function.device, device),
        ("precision", function.precision, precision is None or precision == function.precision, precision),
        ("nan", function.missing.rule, nan is None or nan in (function.missing, function.missing.rule), nan),
    ):
        if not same:
            name = getattr(given, "name", given)
            other = f"another {what} of that name" if name == present else repr(name)
            raise OptionError(
                f"the field was made with {what} {present!r}, which cannot be changed to {other}; "
                f"leave {what} out, or make another {type(function).__name__}"
            )


@contextmanager
def opened(
    volume: Any,
    filter: str | Filter | None = None,
    boundary: str | Boundary | None = None,
    device: Device | str | int | None = None,
    precision: Precision | None = None,
    nan: str | Missing | None = None,
    *,
    results: tuple[int, ...] = (),
) -> Iterator[ContinuousFunction]:
    """`as_field` as a context: on exit, a field that was made here is closed; a given one is not.

    For a volume in memory, checks first that its coefficients and results of shape `results` fit together.
    """
    if results and (plain := _in_memory(volume)) is not None:
        volume = plain
        require_both(volume.size, filter, boundary, device, precision, results)
    field = as_field(volume, filter, boundary, device, precision, nan)
    try:
        yield field
    finally:
        if field is not volume:
            field.close()


def _in_memory(volume: Any) -> Volume | None:
    """A volume or an array as a Volume; None for a function or a lazy volume."""
    return None if isinstance(volume, ContinuousFunction) or is_in_parts(volume) else as_volume(volume)


def _bricks() -> Any:
    """The module of bricked functions; imported late, since it imports this one."""
    return import_module("clvol.bricks.field")


def _else_by_bricks(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Decorate a function of a volume to compute by bricks, with a warning, if the volume's coefficients do not fit in memory."""

    @wraps(function)
    def wrapped(*arguments: Arguments.args, **options: Arguments.kwargs) -> Result:
        try:
            return function(*arguments, **options)
        except OutOfMemoryError as refused:
            others: dict[str, Any] = dict(options)
            given = arguments[0] if arguments else others.pop("volume")
            try:
                if (volume := _in_memory(given)) is None:
                    raise
                _bricks().require_plain(others.get("precision"), others.get("nan"))  # before reading samples
                lazy = _bricks().as_lazy(volume)
                result = function(lazy, *arguments[1:], **others)  # type: ignore[arg-type]
            except (OptionError, DataError, OutOfMemoryError):  # bricks cannot do it either
                raise refused from None
            warn(
                f"computed by bricks in single precision, so that the last bits may differ, because the memory is too small for "
                f"all coefficients: {refused}"
            )
            return result

    return wrapped


def require_both(
    size: tuple[int, ...],
    filter: str | Filter | None,
    boundary: str | Boundary | None,
    device: Device | str | int | None,
    precision: Precision | None,
    results: tuple[int, ...],
) -> None:
    """Raise `OutOfMemoryError` unless the coefficients of `size` samples and results of shape `results` fit together."""
    kind = precision_kind(precision or "single")
    made = bytes_of(size, as_filter(DEFAULT_FILTER if filter is None else filter), chosen_boundary(boundary), kind)
    result_bytes = np.dtype(kind).itemsize * math.prod(results)
    shared = as_device(device).kind == "cpu"  # else coefficients are in the device's memory
    memory.require(result_bytes + made * shared, f"{described(results)}{' and the coefficients' * shared}")


# -- functions -------------------------------------------------------------------------------------------------------


@suggests_options
@_else_by_bricks
def sample(
    volume: Volume | ArrayLike | ContinuousFunction,
    points: ArrayLike,
    filter: str | Filter | None = None,
    boundary: str | Boundary | None = None,
    derivative: int = 0,
    *,
    frame: Frame = "LPS",
    fill: float | None = None,
    device: Device | str | int | None = None,
    precision: Precision | None = None,
    nan: str | Missing | None = None,
    progress: Progress | None = None,
    out: Any = None,
) -> Reals:
    """The reconstructed function, its gradient or its Hessian at points of the world (eqs 8 and 9 of the paper).

    A volume is prefiltered on every call; make a `Field` to sample it repeatedly.

    Parameters
    ----------
    volume : Volume, array-like, Field, LazyVolume or BrickedField
        2-D or 3-D samples; an array has spacing 1 and origin 0. A LazyVolume is read by bricks, as by `BrickedField`. So is a
        volume whose coefficients do not fit in memory, if `BrickedField` supports the options; values then differ by less than
        10⁻⁶ of the samples' range.
    points : array-like, shape (..., d)
        World positions (x, y) or (x, y, z). A position that is not finite gives NaN.
    filter : str or Filter, optional
        A name in `clvol.filters()`, or a custom filter; default "bspline3", "nearest" for labels (`Volume.is_labels`), or that of
        the Field.
    boundary : str or Boundary, optional
        "mirror", "reflect", "wrap", …: see `clvol.boundaries`; default "mirror", or that of the Field.
    derivative : {0, 1, 2}
        0 for values, 1 for gradients, 2 for Hessians: the exact derivatives of the function that derivative 0 gives, per
        world unit (almost everywhere, where it has kinks or jumps).
    frame, fill, progress, out
        As in a call of `Field`.
    device : Device, str or int, optional
        See `as_device`; default that of the Field, if one is given.
    precision : {"single", "double"}, optional
        As of `Field`; default "single", or that of the Field.
    nan : {"error", "propagate", "local"} or Missing, optional
        How samples that are NaN or infinite are treated: see `clvol.Missing`; default "error", or that of the Field.

    Returns
    -------
    ndarray of float32, shape (...), (..., d) or (..., d, d)
        float64 if the samples are far from zero (values only), or very large or small: see the notes of `Field`.

    Raises
    ------
    OptionError
        `derivative` is not 0, 1 or 2; a Field is given with a filter, boundary, device, precision or nan that differs from its
        options; or as a call of `Field` raises it.
    DataError, DeviceError, OutOfMemoryError
        As `Field` and a call of it raise them.

    References
    ----------
    - P. Thévenaz, T. Blu and M. Unser, "Interpolation revisited", IEEE Transactions on Medical Imaging 19(7), 2000,
      739–758.
    - C. Sigg and M. Hadwiger, "Fast third-order texture filtering", GPU Gems 2, chapter 20, Addison-Wesley, 2005, 313–329.

    Examples
    --------
    >>> import clvol
    >>> volume = clvol.phantoms.polynomial(degree=1)  # a plane, which a spline reproduces
    >>> points = [(0.1, 0.2, 0.3), (0.2, 0.2, 0.3)]  # (x, y, z)
    >>> values = clvol.sample(volume, points)
    >>> gradients = clvol.sample(volume, points, derivative=1)
    >>> values.shape, gradients.shape
    ((2,), (2, 3))
    """
    derivative = whole("derivative", derivative, minimum=0, maximum=2)
    results: tuple[int, ...] = ()
    if (plain := _in_memory(volume)) is not None:
        volume = plain
        shape = points_in_world(points, frame, plain).shape[:-1] + (plain.ndim,) * derivative  # before the volume is prefiltered
        if out is not None:
            as_output(out, shape)
        results = () if out is not None else shape
    with opened(volume, filter, boundary, device, precision, nan, results=results) as field:
        evaluate = (field.__call__, field.gradient, field.hessian)[derivative]
        return evaluate(points, frame=frame, fill=fill, progress=progress, out=out)


@suggests_options
@with_dask
@_else_by_bricks
def resample(
    volume: Volume | ArrayLike | ContinuousFunction,
    shape: Sequence[int] | None = None,
    spacing: Sequence[float] | float | None = None,
    like: Volume | Volumes | ArrayLike | None = None,
    filter: str | Filter | None = None,
    boundary: str | Boundary | None = None,
    *,
    anchor: Anchor = "center",
    transform: Transforms | None = None,
    smooth: bool = False,
    anti_aliasing: AntiAliasing | bool = False,
    dtype: DTypeLike | None = None,
    fill: float | None = None,
    device: Device | str | int | None = None,
    precision: Precision | None = None,
    nan: str | Missing | None = None,
    progress: Progress | None = None,
    out: Any = None,
    chunks: Any = None,
    dimensions: int | None = None,
) -> Volume:
    """The volume on another grid; give exactly one of `shape`, `spacing` and `like`.

    Parameters
    ----------
    volume : Volume, array-like, Field, LazyVolume, BrickedField or dask.array.Array
        2-D or 3-D samples; an array has spacing 1 and origin 0. A LazyVolume is read by bricks, as in `sample`.
    shape, spacing, like, anchor, transform, anti_aliasing, dtype, fill
        As in `Field.resample`; without `anti_aliasing` larger voxels bring aliases of what is finer. With it no sample may be NaN.
    smooth : bool
        The samples are labels, whole numbers of any type, and the boundaries between them become smooth: see the notes. `filter` is
        then "bspline5-approx" by default, and may be "linear" or another B-spline without a prefilter; `boundary` is
        "nearest" by default, and `fill` a label.
    filter, boundary, device, nan
        As in `sample`.
    precision : {"single", "double"}, optional
        As in `sample`, but "double" for a `dtype` wider than float32, if the device supports it.
    progress, out
        As in `Field.resample`.
    chunks : as of `dask.array.normalize_chunks`, optional
        Of the result for an array of dask. By default, along axes of another length, chunks as long as the longest of `volume`.
    dimensions : int, optional
        How many of the last axes of an array of dask span a volume, 2 or 3: each index of the others is a separate volume. By
        default all, at most 3. `shape` is that of a volume.

    Returns
    -------
    Volume of float32, or of float64 as `sample` gives it, or of `dtype`; or a dask.array.Array of this dtype
        With `smooth` of the volume's type, marked as labels.

    Raises
    ------
    OptionError
        With `smooth`: the volume is not in memory, nor an array of dask; a filter with a prefilter or negative weights; a `fill`
        that is no label; `anti_aliasing`, `precision`, `nan` or `out`, which are for values.
        A Field is given with a filter, boundary, device, precision or nan that differs from its options; or as `Field.resample`
        raises it.
    GeometryError
        As `Field.resample` raises it.
    UnsupportedError
        Of an array of dask: `like`, `transform`, `progress`, `out`, or a `nan` other than "error".
    DataError, DeviceError, OutOfMemoryError
        As `Field` and `Field.resample` raise them; of an array of dask as `prefilter` raises them. With `smooth` also `DataError`
        where a sample is no whole number.

    Notes
    -----
    With `smooth` a point belongs to the label whose indicator, 1 at its samples and 0 elsewhere, is largest there as `filter`
    reconstructs it. Labels leave no gaps and do not overlap; where several weigh the same, to 10⁻⁶, the smallest number wins.
    A block of 2 × 2 × 2 samples keeps its middle with each of these filters. Where the new voxels are no smaller than the old ones
    "bspline5-approx" may yet miss it, and keeps blocks of 2 × 2 × 3; "bspline3-approx" misses none unless they are larger.

    A block of an array of dask reads the samples in the support of its own, the margin that the prefilter needs, and with
    `anti_aliasing` the reach of the low-pass. Nothing is read before it is computed, so `filter` is "bspline3" by default also for
    labels, and its smoothing is not "auto". Results are float64 in double precision and, where no precision is given, of types that
    float32 does not hold (float64, integers of 32 and 64 bits): so samples that are large, or far from zero, keep their digits, as
    in memory. Where the filter has no prefilter the result is bit for bit that in one piece; where it has one, coefficients differ
    as those of `prefilter` do. With "least-squares" no bit differs either, but where samples lie so far from zero that single
    precision would lose digits of some blocks and not of others: there sums differ by rounding.

    References
    ----------
    - M. Unser, A. Aldroubi and M. Eden, "Enlargement or reduction of digital images with minimum loss of information", IEEE
      Transactions on Image Processing 4(3), 1995, 247–258: "least-squares".

    Examples
    --------
    >>> import clvol
    >>> volume = clvol.phantoms.marschner_lobb(24)
    >>> clvol.resample(volume, shape=(48, 48, 48), filter="bspline5").shape
    (48, 48, 48)
    >>> clvol.resample(volume, like=clvol.phantoms.sphere(16)).shape  # on another volume's grid
    (16, 16, 16)
    """
    require_lazy("volume", chunks=chunks, dimensions=dimensions)
    results: tuple[int, ...] = ()
    plain = _in_memory(volume)
    if flag("smooth", smooth):
        require_no_blending(anti_aliasing=anti_aliasing or None, precision=precision, nan=nan, out=out)
        if plain is None:
            raise OptionError(
                "smooth=True takes labels in memory, or an array of dask: a LazyVolume gives them by whole(), a Field by volume; "
                f"got {volume!r}"
            )
        grid, fill, device = grid_for(plain, shape, spacing, like, anchor), fill_value(fill), as_device(device)
        chain = Chain(as_chain(transform, plain.ndim), grid, device)
        kind = None if dtype is None else as_kind(dtype, plain.data.dtype)
        target = Target(*chain.to_indices(plain), grid.shape, chain if chain.stages else None, fill, None, kind)
        data = labels_on(target, plain, region_filter(filter), region_boundary(boundary), device, progress)
        return replace(plain.placed(data, grid), labels=True if plain.labels is None else plain.labels)
    if plain is not None:
        volume = plain
        grid = grid_for(plain, shape, spacing, like, anchor)  # before the volume is prefiltered
        if out is not None:
            as_output(out, grid.shape)
        transform = as_chain(transform, plain.ndim)
        row = filter_for(plain, filter, DEFAULT_FILTER)
        kind = result_kind(dtype, plain, row, out, fill)
        if precision is None and kind is not None and wide(kind) and (device := as_device(device)).has_double:
            precision = "double"
        if low_pass := as_anti_aliasing(anti_aliasing):  # on the samples: their coefficients are not needed
            require_no_transform(transform)
            target = Target(*between(plain, grid), grid.shape, None, fill_value(fill), low_pass, kind)
            options = row, as_boundary(boundary or DEFAULT_BOUNDARY), as_device(device), precision or "single"
            room = None if out is None else as_output(out, grid.shape)
            data = put(_low_passed_on(target, plain, *options, progress), room, room)
            return as_result(plain, data, grid, kind, row)
        results = grid.shape if out is None else ()
    with opened(volume, filter, boundary, device, precision, nan, results=results) as field:
        return field.resample(
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


@suggests_options
@with_dask
@_else_by_bricks
def magnify(
    volume: Volume | ArrayLike | ContinuousFunction,
    factor: int = 2,
    filter: str | Filter | None = None,
    boundary: str | Boundary | None = None,
    *,
    device: Device | str | int | None = None,
    precision: Precision | None = None,
    nan: str | Missing | None = None,
    progress: Progress | None = None,
    chunks: Any = None,
    dimensions: int | None = None,
) -> Volume:
    """The volume with `factor` times the samples along each axis, the original samples among them (section 4.3).

    Parameters
    ----------
    volume : Volume, array-like, Field, LazyVolume, BrickedField or dask.array.Array
        2-D or 3-D samples; an array has spacing 1 and origin 0. A LazyVolume is read by bricks, as in `sample`.
    factor : int
        At least 1; see `Field.magnify` for the positions of the new samples.
    filter, boundary, device, precision, nan
        As in `sample`.
    progress
        As in a call of `Field`.
    chunks, dimensions
        As in `resample`, for an array of dask.

    Returns
    -------
    Volume of float32, or of float64 as `sample` gives it; or a dask.array.Array, as `resample` gives it

    Raises
    ------
    OptionError
        A Field is given with a filter, boundary, device, precision or nan that differs from its options; or as `Field.magnify`
        raises it.
    UnsupportedError
        Of an array of dask: `progress`, or a `nan` other than "error".
    DataError, DeviceError, OutOfMemoryError
        As `Field` and `Field.magnify` raise them; of an array of dask as `prefilter` raises them.

    Examples
    --------
    >>> import clvol
    >>> clvol.magnify(clvol.phantoms.marschner_lobb(16), 2).shape
    (32, 32, 32)
    """
    require_lazy("volume", chunks=chunks, dimensions=dimensions)
    factor = whole("factor", factor, minimum=1)
    results: tuple[int, ...] = ()
    if (plain := _in_memory(volume)) is not None:
        volume, results = plain, tuple(factor * n for n in plain.shape)
    with opened(volume, filter, boundary, device, precision, nan, results=results) as field:
        return field.magnify(factor, progress=progress)


@suggests_options
@with_dask
def prefilter(
    data: ArrayLike,
    filter: str | Filter = DEFAULT_FILTER,
    boundary: str | Boundary = DEFAULT_BOUNDARY,
    device: Device | str | int | None = None,
    *,
    precision: Precision = "single",
    dimensions: int | None = None,
) -> Reals:
    """Spline coefficients of samples (section 4.2 of the paper).

    Parameters
    ----------
    data : Volume, array-like or dask.array.Array, shape (nx,), (ny, nx) or (nz, ny, nx)
        Samples of any integer or floating dtype. Chunks of dask may be of any size, but blocks shorter than the prefilter's
        `clvol.dask.reach` read most of their neighbours.
    filter : str or Filter
        A filter without a prefilter returns the samples; a hybrid returns the coefficients of the filter that magnifies.
    boundary : str or Boundary
        "mirror", "reflect", "wrap", …; coefficients of padding are removed.
    device : Device, str or int, optional
        See `as_device`.
    precision : {"single", "double"}
        As of `Field`.
    dimensions : int, optional
        How many of the last axes of an array of dask span a volume, 1 to 3: each index of the others is a separate volume. By
        default all, at most 3.

    Returns
    -------
    ndarray of float32, the shape of `data`
        The control points r of eq. (11), for every axis, in units of the data; float64 as `sample` gives it. An array of dask in
        the chunks of `data` if that is one; then float64 in double precision only.

    Raises
    ------
    DataError
        `data` is not a regular array of real numbers with 1 to 3 axes, is empty, or holds a value that is NaN, infinite or
        too large for float64. Of an array of dask also chunks of unknown sizes, or of other arrays than NumPy's; samples are
        checked when it is computed, and the message has the index of the first that is not finite.
    OptionError
        `filter`, `boundary` or `device` is unknown; or smoothing is "auto", which depends on all samples, for an array of dask.
    DeviceError
        There is no OpenCL device, or it cannot be used.
    OutOfMemoryError
        The coefficients do not fit on the device.

    Notes
    -----
    By blocks of dask, coefficients along one axis differ from those of the array in one piece by ``2⁻²⁴ G R`` at most, or by
    ``10⁻¹⁴ G R`` in double precision, G being the sum of the prefilter's weights and R the range of the samples, and by rounding.
    The largest that coefficients may be is G times the samples. Samples that lie far from zero compared with their range are
    filtered with all their digits, and coefficients of single precision then rounded to float32.

    References
    ----------
    - M. Unser, A. Aldroubi and M. Eden, "Fast B-spline transforms for continuous image representation and interpolation",
      IEEE Transactions on Pattern Analysis and Machine Intelligence 13(3), 1991, 277–285: reference [15] of the paper.
    - M. Unser, A. Aldroubi and M. Eden, "B-spline signal processing", parts I and II, IEEE Transactions on Signal
      Processing 41(2), 1993, 821–848.

    Examples
    --------
    >>> import clvol, numpy as np
    >>> wave = np.cos(np.arange(32) * np.pi / 4) + np.zeros((4, 4, 1))
    >>> coefficients = clvol.prefilter(wave)
    >>> coefficients.shape
    (4, 4, 32)
    """
    require_lazy("data", dimensions=dimensions)
    if is_in_parts(data):
        raise OptionError(
            "prefilter takes no volume that is read by parts: clvol.dask.prefilter gives its coefficients as an array of dask, "
            "clvol.prefilter(volume.whole()) all at once"
        )
    array, _ = read_array(data, placed=False)  # coefficients have no geometry
    line = array.ndim == 1
    volume = Volume(array[None] if line else array)
    chosen, boundary, kind, device = as_filter(filter), as_boundary(boundary), precision_kind(precision), as_device(device)
    require_both(array.shape[::-1], chosen, boundary, device, precision, array.shape)
    chosen = settled(chosen.magnified_by or chosen, volume)
    if line:
        volume.require_finite()
        made = Coefficients(array.shape, chosen, boundary, device, Stored.of(volume, chosen, boundary, kind), kind)
        made.fill(array)
    else:
        made = coefficients_of(volume, chosen, boundary, device, kind)
    with made, device.buffers.mapped(made.buffer, made.shape, write=False, kind=kind) as held:
        coefficients = np.array(held[made.inner]).reshape(array.shape)
        return made.stored.values(coefficients, _gain(chosen) ** array.ndim)


def _gain(filter: Filter) -> float:
    """The coefficients of samples that are all 1, along one axis."""
    return 1 / float(filter.samples[0] + 2 * filter.samples[1:].sum()) if filter.prefilter else 1.0


def precision_kind(precision: str) -> type[np.generic]:
    """The NumPy type for "single" or "double"."""
    if precision not in _PRECISIONS:
        raise one_of("precision", precision, _PRECISIONS)
    return _PRECISIONS[precision]
