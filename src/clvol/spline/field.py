"""The continuous function of a volume: `Field`, which keeps its coefficients on a device, and functions that use one once."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from functools import partial
from types import TracebackType
from typing import Any, Literal, Self, TypeAlias, TypeGuard, get_args

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from clvol.base import memory
from clvol.base.arrays import as_array, as_output
from clvol.base.checks import one_of, warn, whole
from clvol.base.errors import DataError, OptionError
from clvol.base.frames import in_frame
from clvol.base.rounding import as_kind, in_kind, wide
from clvol.device import Device, as_device
from clvol.filter.boundary import DEFAULT_BOUNDARY, Boundary, as_boundary
from clvol.filter.filter import Filter
from clvol.filter.table import DEFAULT_FILTER, as_filter
from clvol.interop.dispatch import is_in_parts, lazily
from clvol.interop.images import read_array
from clvol.spline.chain import Chain
from clvol.spline.coefficients import Coefficients, Lattice, bytes_of
from clvol.spline.evaluator import DIRECT, Evaluator, EvaluatorName, FetchName, choose_evaluator
from clvol.spline.lease import Lease
from clvol.spline.points import Floats, Given, Progress, Reals, Transform, sample_coefficients, sample_grid
from clvol.spline.reduce import AntiAliasing, as_anti_aliasing, low_passed, nearest_spline, steps_along
from clvol.spline.resample import resample_coefficients
from clvol.volume.missing import Missing, as_missing, touching
from clvol.volume.smoothing import filter_for, settled
from clvol.volume.stored import AS_THEY_ARE, Stored
from clvol.volume.transform import Transforms, as_chain
from clvol.volume.volume import Volume, as_volume
from clvol.volume.volumes import Volumes, as_grid

__all__ = [
    "RENUMBER",
    "Anchor",
    "Field",
    "Floats",
    "Frame",
    "Precision",
    "Progress",
    "Reals",
    "as_field",
    "as_points",
    "between",
    "beyond",
    "coefficients_of",
    "fill_value",
    "filled",
    "grid_for",
    "magnify",
    "names_beyond",
    "opened",
    "precision_kind",
    "prefilter",
    "resample",
    "result_kind",
    "sample",
]

Frame: TypeAlias = Literal["LPS", "RAS"]
Anchor: TypeAlias = Literal["center", "origin"]
Precision: TypeAlias = Literal["single", "double"]
_PRECISIONS: dict[str, type[np.generic]] = {"single": np.float32, "double": np.float64}
_CHANNELS = 4  # of an image in colour, at most
_TURN = np.array([-1.0, -1.0, 1.0])  # between LPS and RAS
RENUMBER = "renumber them, as numpy.unique(data, return_inverse=True) does"
_CLOSED = "the field was closed, and its coefficients were released; make a new one"
_LOOKED_AT = 256  # points of which the order of coordinates is guessed


def coefficients_of(
    volume: Volume, filter: Filter, boundary: Boundary, device: Device, kind: type[np.generic] = np.float32
) -> Coefficients:
    """A volume's coefficients on a device: prefiltered, surrounded by their halo, ready to be sampled.

    Those of a hybrid (section 4.3) are samples of the spline on a grid of twice the density. They are numbers of `kind`, float32 or
    float64.

    Raises
    ------
    DataError
        A sample is NaN, infinite or too large for float64.
    DeviceError
        Coefficients of float64 on a device without it.
    OutOfMemoryError
        The device has no room for them.
    """
    device.buffers.require_room(bytes_of(volume.size, filter, boundary, kind))  # before samples are looked at
    volume.require_finite()
    row = settled(filter, volume)
    stored = Stored.of(volume, row, boundary) if kind == np.float32 else AS_THEY_ARE
    return filled(Coefficients(volume, row, boundary, device, stored, kind), volume.data)


def filled(made: Coefficients, data: NDArray[Any]) -> Coefficients:
    """The coefficients that there is room for, of samples [z, y, x]; it is released if that fails."""
    try:
        if made.filter.magnified_by is not None:
            _fill_hybrid(made, made.filter.magnified_by, data)
        else:
            made.fill(data)
    except BaseException:
        made.release()
        raise
    return made


def _fill_hybrid(made: Coefficients, by: Filter, data: NDArray[Any]) -> None:
    """Fill the coefficients of a hybrid, halo included, by samples of the spline of `by`."""
    scale, halo, d = made.filter.scale, int(made.extent[3]), made.ndim
    steps = np.eye(d) / scale
    with filled(Coefficients(made.volume, by, made.boundary, made.device, made.stored, made.kind), data) as coarse:
        resample_coefficients(coarse, DIRECT, steps, np.full(d, -halo / scale), made.shape, made.buffer, Given(edge=0.5))


class Field:
    """The continuous function of a volume, with its coefficients kept on a device.

    Making one uploads and prefilters the volume (section 4.2 of the paper); every call then costs its samples only. The
    functions `clvol.sample`, `clvol.resample` and `clvol.magnify` take a Field in place of a volume.

    Parameters
    ----------
    volume : Volume or array-like, shape (ny, nx) or (nz, ny, nx)
        Samples of any integer or floating dtype; an array has spacing 1 and origin 0.
    filter : str or Filter, optional
        A name in `clvol.filters()`, or a filter of your own; default "bspline3", or "nearest" for labels (`Volume.is_labels`).
    boundary : str or Boundary
        "mirror", "reflect", "wrap", …: what lies past the outer samples; see `clvol.boundaries`.
    device : Device, str or int, optional
        See `as_device`; None is the default device.
    precision : {"single", "double"}, optional
        Of coefficients and results: float32, or float64 on devices that have it. Default "single", but "double" for labels that
        float32 does not hold.
    nan : {"error", "propagate", "local"} or Missing
        What becomes of samples that are NaN or infinite: see `clvol.Missing`, which also takes a mask of missing samples.

    Attributes
    ----------
    volume : Volume
        The samples, as they were given.
    missing : Missing
        What becomes of missing samples.
    gaps : Field or None
        The share of missing samples that a result is computed from; None where none is missing, or none is too many.
    filter : Filter
        Its smoothing settled for this volume.
    boundary : Boundary
    device : Device
    coefficients : Coefficients
        As they are stored on the device.

    Raises
    ------
    DataError
        `volume` is no array of real numbers with 2 or 3 axes, is empty, or holds a value that is NaN, infinite or too
        large for float64 (unless `nan` allows for it); a mask has another shape.
    OptionError
        `filter`, `boundary`, `device` or `nan` is the name of none.
    DeviceError
        There is no OpenCL device, or it cannot be used.
    OutOfMemoryError
        The device has no room for the coefficients.

    Notes
    -----
    Where samples are missing, their places are kept like a second volume, and every call samples both: twice the memory, and up
    to twice the time.

    A Field is a context manager: leaving it frees the device's memory, as `close` does. Several threads may use one at a
    time.

    Single precision computes in float32: values err by about 10⁻⁶ of the largest magnitude. Samples further than 8 times their
    range from zero (a pressure of 101,325 ± 3) are stored less an offset, and samples beyond 2⁻⁹⁰ to 2⁹⁰ less a power of two,
    whatever their type, so that values err by about 10⁻⁶ of the *range* then. Results are float32 where samples are stored as
    they are, as most are. Otherwise values are float64; derivatives are so with a power of two alone, for an offset does not
    change them. No offset is taken off where the filter's weights do not sum to one (`lanczos3`, `sinc`), nor under the
    boundary rules "zero" and "grid-constant". Double precision stores samples as they are. A single sample near zero in data
    that are otherwise far from it prevents the offset too. Integers with a range of more than 2²⁴ are rounded to 2⁻²⁴ of it.
    See `clvol.volume.stored`.

    Examples
    --------
    >>> with clvol.Field(volume) as field:
    ...     values = field(points)
    ...     gradients = field.gradient(points)
    """

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
        kind = precision_kind(_precision_for(self.volume, row) if precision is None else precision)
        self.device = as_device(device)
        self.missing = as_missing(nan)
        where = self.missing.of(self.volume.data)
        present = self.volume if where is None else replace(self.volume, data=self.missing.filled(self.volume.data, where))
        self.coefficients = coefficients_of(present, row, self.boundary, self.device, kind)
        self.filter = self.coefficients.filter
        self._lease = Lease(_CLOSED)
        self._lease.frees(self.coefficients.release)
        self.gaps = None if where is None else self._gaps_at(where)
        if self.gaps:
            self._lease.frees(self.gaps.close)

    def _gaps_at(self, where: NDArray[np.bool_]) -> Field | None:
        """The share of missing samples as a function of its own; None where it decides nothing."""
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
        """For notebooks: the kernel, and what the function is made of."""
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
    def precision(self) -> Precision:
        """Of coefficients and results: "single" or "double"."""
        return "double" if self.coefficients.kind == np.float64 else "single"

    @property
    def nbytes(self) -> int:
        """Bytes of the buffer with the coefficients; 0 once closed. An image (``fetch="image"``) takes as many again."""
        return 0 if self.closed else self.coefficients.nbytes + (self.gaps.nbytes if self.gaps else 0)

    @property
    def closed(self) -> bool:
        """Whether `close` was called."""
        return self._lease.closed

    def close(self) -> None:
        """Free the device's memory. Results stay valid; asking for more raises `OptionError`.

        What other threads are computing, or whoever calls this from a callback, goes on to its end, and the memory is freed then.
        """
        self._lease.close()

    def in_use(self) -> AbstractContextManager[None]:
        """For the time of a block `close` frees nothing.

        Raises
        ------
        OptionError
            The field was closed before.
        DeviceError
            This is the child of a fork, where no OpenCL device works.
        """
        self.device.require_usable()
        return self._lease.held()

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled is what the field is made of; another process makes its coefficients anew, on its device of the same name."""
        with self._lease.held():
            again = partial(type(self), precision=self.precision, nan=self.missing)
            return again, (self.volume, self.filter, self.boundary, self.device)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    # -- at points ---------------------------------------------------------------------------------------------

    def __call__(
        self,
        points: ArrayLike,
        *,
        frame: Frame = "LPS",
        evaluator: EvaluatorName = "auto",
        fetch: FetchName = "auto",
        fill: float | None = None,
        progress: Progress | None = None,
        out: Any = None,
    ) -> Reals:
        """Values at points of the world.

        Parameters
        ----------
        points : array-like, shape (..., d)
            World positions (x, y) or (x, y, z), as many coordinates as the volume has axes. float32 is computed with as it
            is, everything else as float64 where the device has it; where it has none, positions err by up to 2⁻²⁴ of their
            distance from the world's origin and from the first sample. A position that is not finite gives NaN. Points that lie
            outside, and would not in the order (z, y, x), cause a `ClvolWarning`.
        frame : {"LPS", "RAS"}
            In which points are given, and derivatives come, of a volume whose space is "LPS": that of ITK and DICOM, or that of
            NIfTI and nibabel, where x and y run the other way.
        evaluator : {"auto", "taps", "paired", "eight-fetch"}
            Direct taps, or linear fetches that serve two taps along each axis: 8 fetches for the 4 taps an axis of a
            cubic in 3-D (hence "eight-fetch", another name for it), 4 in 2-D, 27 for the 6 taps of `bspline5`. Filters
            whose weights change sign within a pair take direct taps; second derivatives always do.
        fetch : {"auto", "buffer", "image"}
            Where coefficients are read from.
        fill : float, optional
            The result outside the volume's domain, NaN and infinities included; None: the boundary rule goes on there.
        progress : callable, optional
            Called with the fraction done, from time to time and after the last point with 1.
        out : array, optional
            Where results are put, instead of into a new array: one of float32 or float64 and of their shape that can be written
            into, with any strides, of NumPy or of another library (see `as_output`). Kernels write directly into
            contiguous ones of the type of the results. It is what is returned.

        Returns
        -------
        ndarray of float32, shape (...)
            float64 in double precision, and where the samples lie far from zero, or are very large or small: see the notes of
            `Field`.

        Raises
        ------
        OptionError
            `points` are no real numbers of shape (..., d); `frame` is neither of the two, or "RAS" where the volume is of no
            patient; `fill` is no number; `evaluator` or `fetch` is an unknown name;
            the field is closed; `out` has another shape or dtype, or cannot be written into (before anything is computed).
        DeviceError
            ``fetch="image"`` on a device without float images, or paired fetches from an image on one whose sampler does
            not interpolate.
        OutOfMemoryError
            The device has no room for the points.
        """
        return self._at(points, 0, evaluator, fetch, fill, progress, out, frame)

    def gradient(
        self,
        points: ArrayLike,
        *,
        frame: Frame = "LPS",
        evaluator: EvaluatorName = "auto",
        fetch: FetchName = "auto",
        fill: float | None = None,
        progress: Progress | None = None,
        out: Any = None,
    ) -> Reals:
        """Gradients at points of the world: the exact derivative of the function that calling the field gives.

        It holds almost everywhere: some filters have kinks or jumps. Parameters and errors are those of a call.

        Returns
        -------
        ndarray of float32, shape (..., d)
            Derivatives along (x, y[, z]), per world unit; float64 where the samples are very large or small.
        """
        return self._at(points, 1, evaluator, fetch, fill, progress, out, frame)

    def hessian(
        self,
        points: ArrayLike,
        *,
        frame: Frame = "LPS",
        evaluator: EvaluatorName = "auto",
        fetch: FetchName = "auto",
        fill: float | None = None,
        progress: Progress | None = None,
        out: Any = None,
    ) -> Reals:
        """Second derivatives at points of the world, exact as `gradient` is. Parameters and errors are those of a call.

        Returns
        -------
        ndarray of float32, shape (..., d, d)
            Symmetric, [x, y[, z]] twice, per world unit squared; float64 where the samples are very large or small.
        """
        return self._at(points, 2, evaluator, fetch, fill, progress, out, frame)

    def _at(
        self,
        points: ArrayLike,
        derivative: int,
        evaluator: str,
        fetch: str,
        fill: float | None,
        progress: Progress | None,
        out: Any = None,
        frame: Frame = "LPS",
    ) -> Reals:
        with self.in_use():
            d, made = self.volume.ndim, self.coefficients
            array = as_points(points, frame, self.volume)
            shape = array.shape[:-1] + (d,) * derivative
            target = None if out is None else as_output(out, shape)
            memory.require(self._result_bytes(math.prod(shape), derivative, out), _results(shape))
            direct = target if self._writes(target) and not np.may_share_memory(target, array) else None
            chosen = self._evaluator(evaluator, fetch)
            first, second = _halves(progress) if self.gaps else (progress, None)
            flat = sample_coefficients(made, chosen, array.reshape(-1, d), derivative, fill_value(fill), first, direct)
            if self.gaps:
                share = self.gaps._at(array.reshape(-1, d), 0, "taps", "buffer", None if fill is None else 0.0, second)
                flat[share > self.missing.most] = np.nan
            shaped = flat.reshape(shape)
            if frame == "RAS" and derivative:
                np.multiply(
                    shaped, _TURN[:d] if derivative == 1 else np.outer(_TURN[:d], _TURN[:d]), out=shaped, casting="same_kind"
                )
            results = _put(shaped, target)
            return results if out is None else out

    def _writes(self, target: NDArray[Any] | None) -> TypeGuard[NDArray[Any]]:
        """Whether kernels can write their results into an array themselves."""
        return (
            target is not None
            and target.dtype == self.coefficients.kind
            and target.dtype.isnative
            and target.flags.c_contiguous
            and target.flags.aligned
        )

    # -- on other grids ----------------------------------------------------------------------------------------

    def resample(
        self,
        shape: Sequence[int] | None = None,
        spacing: Sequence[float] | float | None = None,
        like: Volume | Volumes | ArrayLike | None = None,
        *,
        anchor: Anchor = "center",
        transform: Transforms | None = None,
        anti_aliasing: AntiAliasing | bool = False,
        dtype: DTypeLike | None = None,
        evaluator: EvaluatorName = "auto",
        fetch: FetchName = "auto",
        fill: float | None = None,
        progress: Progress | None = None,
        out: Any = None,
    ) -> Volume:
        """The function on another grid; give exactly one of `shape`, `spacing` and `like`.

        Where voxels become larger, what is finer than they can hold comes back as aliases, unless `anti_aliasing` is given.

        Parameters
        ----------
        shape : sequence of int, optional
            Samples along (z, y, x) or (y, x). The domain stays; its voxels become larger or smaller.
        spacing : float or sequence of float, optional
            New spacing along (x, y[, z]) in world units. The domain's centre stays, and its size to within half a voxel.
        like : Volume, Volumes, or what these take, optional
            Take the grid of this volume or image, wherever it lies; of a series that of its volumes.
        anchor : {"center", "origin"}
            What stays in its place with `shape` and `spacing`: the centre of the domain, or the first sample, as with those who
            keep ITK's origin; the domain is then moved by half the difference of the spacings.
        transform : transform, array, SimpleITK transform, or a list of these, optional
            From points of the grid's world (the fixed one) to points of this volume's (the moving one), as ITK resamples: the
            function is taken there. In a list the last transform is applied first, as in ITK's CompositeTransform. An array
            holds a homogeneous matrix. See `clvol.AffineTransform`, `clvol.DisplacementField`, `clvol.BSplineTransform` and
            `clvol.read_transform`; `clvol.warp` gives gradients and Jacobians too.
        anti_aliasing : {False, True, "gaussian", "least-squares"}
            "gaussian" (and True): the samples go through a Gaussian first, whose standard deviation is (f - 1) / 2 samples along
            an axis where voxels become f times as large. "least-squares": the result is the spline of the new grid, of the same
            filter, that is nearest to this function in the mean square (`clvol.spline.reduce`), for grids along the volume's axes.
        dtype : dtype-like or "same", optional
            Type of the result, "same" as that of the volume: rounded to the nearest whole number, halves to even, and clipped to
            what the type holds. Default: floating point as in a call, but the same for labels drawn by "nearest".
        evaluator, fetch, fill, progress, out
            As in a call; `out` is of the new grid's shape, and the result's data are a view of it.

        Returns
        -------
        Volume of float32, or of float64 as in a call, or of `dtype`

        Raises
        ------
        OptionError
            None or several of `shape`, `spacing` and `like` are given; `shape` is not one whole number of at least 1 for
            each axis; `spacing` is not positive and finite, or needs more than 2³¹ − 1 samples along an axis; `like` is
            no Volume of as many axes; `anchor` is neither of the two, or "origin" with `like`; `dtype` holds no real numbers,
            or is given with `out`, or holds no NaN while `fill` is; `transform` is none, or given with `anti_aliasing`;
            `anti_aliasing` is none of these, or "least-squares" for a turned grid, with a hybrid or under the boundary rule
            "zero"; `fill`, `evaluator` or `fetch` as in a call; the field is closed.
        DataError
            Results are NaN where samples are missing, and `dtype` holds none; or labels, drawn by "nearest", exceed 2⁵³.
        GeometryError
            A transform is singular, or of another number of dimensions.
        DeviceError
            As in a call.
        OutOfMemoryError
            The device has no room for the result.
        """
        volume = self.volume
        grid = grid_for(volume, shape, spacing, like, anchor)
        chosen, stages = as_anti_aliasing(anti_aliasing), as_chain(transform, volume.ndim)
        kind = result_kind(dtype, volume, self.filter, out, fill)
        if chosen:
            require_no_transform(stages)
            with self.in_use():  # a closed field is refused
                pass
            own = self.filter, self.boundary, self.device, self.precision
            return _in(kind, _into(_coarser(volume, *own, grid, chosen, evaluator, fetch, fill, progress), out), self.filter)
        chain = Chain(stages, grid, self.device)
        width = 0 if kind is None or kind == self.coefficients.kind else kind.itemsize
        data = self._on_grid(*chain.to_indices(volume), grid.shape, evaluator, fetch, fill, progress, out, chain, width)
        return _in(kind, volume.placed(data, grid), self.filter)

    def magnify(
        self, factor: int = 2, *, evaluator: EvaluatorName = "auto", fetch: FetchName = "auto", progress: Progress | None = None
    ) -> Volume:
        """The volume with `factor` times the samples along each axis, the given ones among them (section 4.3).

        Sample ``j`` of the result lies at ``j / factor`` of the given ones, so every `factor`-th is one of them. The last
        ones lie past the last given one, within its voxel or under the boundary rule.

        Parameters
        ----------
        factor : int
            At least 1.
        evaluator, fetch, progress
            As in a call.

        Returns
        -------
        Volume of float32, or of float64 as in a call; labels drawn by "nearest" keep their type

        Raises
        ------
        OptionError
            `factor` is no whole number of at least 1; `evaluator` or `fetch` is an unknown name; the field is closed.
        DeviceError
            As in a call.
        OutOfMemoryError
            The device has no room for the result.
        """
        volume, d = self.volume, self.volume.ndim
        factor = whole("factor", factor, minimum=1)
        shape = tuple(factor * n for n in volume.shape)
        memory.require_addressable("a result", shape)
        data = self._on_grid(np.eye(d) / factor, np.zeros(d), shape, evaluator, fetch, None, progress)
        finer = replace(volume, data=data, spacing=tuple(s / factor for s in volume.spacing))
        return _in(result_kind(None, volume, self.filter, None, None), finer, self.filter)

    def _on_grid(
        self,
        matrix: NDArray[np.float64],
        offset: NDArray[np.float64],
        shape: tuple[int, ...],
        evaluator: str,
        fetch: str,
        fill: float | None,
        progress: Progress | None,
        out: Any = None,
        chain: Chain | None = None,
        converted: int = 0,
    ) -> Reals:
        with self.in_use():
            device, made, given = self.device, self.coefficients, Given(fill_value(fill))
            target = None if out is None else as_output(out, shape)
            chosen = self._evaluator(evaluator, fetch)
            device.buffers.require_room(np.dtype(made.kind).itemsize * math.prod(shape), held=True)
            memory.require(self._result_bytes(math.prod(shape), 0, out) + converted * math.prod(shape), _results(shape))
            result = target if self._writes(target) else np.empty(shape, made.kind)
            first, second = _halves(progress) if self.gaps else (progress, None)
            with device.buffers.lent(result, write=True) as buffer:
                if chain is not None and chain.stages:
                    last = Transform(matrix, offset, np.eye(len(offset)))
                    sample_grid(made, chosen, last, (1, *shape)[-3:], buffer, given, first, chain=chain)
                else:
                    resample_coefficients(made, chosen, matrix, offset, (1, *shape)[-3:], buffer, given, first)
            final = given.in_units_of_data(made, result, 0)
            if self.gaps:
                share = self.gaps._on_grid(
                    matrix, offset, shape, "taps", "buffer", None if fill is None else 0.0, second, chain=chain
                )
                final[share > self.missing.most] = np.nan
            return _put(final, target)

    def _result_bytes(self, count: int, derivative: int, out: Any) -> int:
        """What so many results take while they are made: float64 ones beside those of kernels, and the share of missing ones."""
        own = np.dtype(self.coefficients.kind).itemsize if out is None else 0
        return count * (own + 8 * self.coefficients.stored.alters(derivative) + 5 * (self.gaps is not None))

    def _evaluator(self, evaluator: str, fetch: str) -> Evaluator:
        """The one that is named, or suits the device: images hold float32 alone."""
        if self.precision == "single":
            return choose_evaluator(self.device, self.filter, evaluator, fetch)
        if fetch == "image":
            raise OptionError("fetch must be 'buffer' or 'auto' where precision is 'double': images hold float32; got 'image'")
        return choose_evaluator(self.device, self.filter, evaluator, "buffer")


def result_kind(dtype: DTypeLike | None, volume: Volume, row: Filter, out: Any, fill: float | None) -> np.dtype[Any] | None:
    """The type that results are brought to; None: that in which they are computed."""
    fill = fill_value(fill)
    if names_beyond(53, volume, row):  # results would name no region, or another
        low, high = volume.limits
        raise DataError(
            f"labels must be whole numbers up to 2**53 to be resampled, which float64 holds; got {low} to {high}: {RENUMBER}"
        )
    if dtype is None:
        labels = row.support == 1 and volume.is_labels
        return volume.data.dtype if labels and out is None and (fill is None or not np.isnan(fill)) else None
    if out is not None:
        raise OptionError(f"resample takes dtype or out, whose type is that of the results; got {dtype!r} and out")
    kind = as_kind(dtype, volume.data.dtype)
    if fill is not None and kind.kind != "f" and np.isnan(fill):
        raise OptionError(f"fill must be a number that {kind} holds; got {fill!r}")
    return kind


def _in(kind: np.dtype[Any] | None, made: Volume, row: Filter) -> Volume:
    """A result in a type; it is no label map where labels were blended."""
    data = made.data if kind is None else in_kind(made.data, kind)
    blended = row.support > 1 and made.labels not in (None, False)
    return made if data is made.data and not blended else replace(made, data=data, labels=None if blended else made.labels)


def _into(volume: Volume, out: Any) -> Volume:
    """A volume whose data are a view of `out`, if that is given."""
    return volume if out is None else replace(volume, data=_put(volume.data, as_output(out, volume.shape)))


def between(volume: Volume, grid: Volume) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Matrix and offset from the indices of a grid, x first, to those of a volume."""
    inverse = volume.world_to_index_matrix
    return inverse @ grid.index_to_world_matrix, inverse @ (np.asarray(grid.origin) - np.asarray(volume.origin))


def beyond(
    matrix: NDArray[np.float64], offset: NDArray[np.float64], shape: tuple[int, ...], results: tuple[int, ...], boundary: Boundary
) -> list[NDArray[np.bool_]]:
    """Which points of a grid along a volume's axes lie past its domain, along each axis of its array."""
    found = []
    for axis, (n, m) in enumerate(zip(shape[::-1], results[::-1], strict=True)):
        x = offset[axis] + matrix[axis, axis] * np.arange(m)
        found.append((x < -boundary.edge) | (x > n - 1 + boundary.edge))
    return found[::-1]


def _coarser(
    volume: Volume,
    filter: Filter,
    boundary: Boundary,
    device: Device,
    precision: Precision,
    grid: Volume,
    chosen: AntiAliasing,
    evaluator: EvaluatorName,
    fetch: FetchName,
    fill: float | None,
    progress: Progress | None,
) -> Volume:
    """A volume on another grid without the aliases of what that cannot hold."""
    (matrix, offset), kind = between(volume, grid), precision_kind(precision)
    if chosen == "gaussian":
        smooth = low_passed(volume, steps_along(matrix), boundary, kind, device)
        with Field(smooth, filter, boundary, device, precision=precision) as field:
            return field.resample(like=grid, evaluator=evaluator, fetch=fetch, fill=fill, progress=progress)
    data = nearest_spline(volume, filter, boundary, kind, device, matrix, offset, grid.shape, progress)
    if (outside := fill_value(fill)) is not None:
        for axis, past in enumerate(beyond(matrix, offset, volume.shape, grid.shape, boundary)):
            np.moveaxis(data, axis, 0)[past] = outside
    return volume.placed(data, grid)


# -- a Field, or what one is made of -----------------------------------------------------------------------------


def as_field(
    volume: Volume | ArrayLike | Field,
    filter: str | Filter | None = None,
    boundary: str | Boundary | None = None,
    device: Device | str | int | None = None,
    precision: Precision | None = None,
    nan: str | Missing | None = None,
) -> Field:
    """A Field as it is, or a new one of a volume.

    Parameters
    ----------
    volume : Volume, array-like or Field
    filter, boundary, device, precision, nan
        As of `Field`; None is its default, or, where a Field is given, what that has.

    Raises
    ------
    OptionError
        A Field is given together with another filter, boundary, device, precision or treatment of missing samples than its own.
    DataError, DeviceError, OutOfMemoryError
        As `Field` raises them.
    """
    if not isinstance(volume, Field):
        return Field(
            volume,
            filter,
            DEFAULT_BOUNDARY if boundary is None else boundary,
            device,
            precision=precision,
            nan="error" if nan is None else nan,
        )
    present = volume.coefficients.volume
    for what, own, same, name in (
        ("filter", volume.filter.name, filter is None or settled(filter, present) == volume.filter, filter),
        ("boundary", volume.boundary.name, boundary is None or as_boundary(boundary) == volume.boundary, boundary),
        ("device", volume.device.name, device is None or as_device(device) is volume.device, device),
        ("precision", volume.precision, precision is None or precision == volume.precision, precision),
        ("nan", volume.missing.rule, nan is None or nan in (volume.missing, volume.missing.rule), nan),
    ):
        if not same:
            raise OptionError(
                f"the field was made with {what} {own!r}, which cannot be changed to {getattr(name, 'name', name)!r}; "
                f"leave {what} out, or make another Field"
            )
    return volume


@contextmanager
def opened(
    volume: Volume | ArrayLike | Field,
    filter: str | Filter | None = None,
    boundary: str | Boundary | None = None,
    device: Device | str | int | None = None,
    precision: Precision | None = None,
    nan: str | Missing | None = None,
    *,
    results: tuple[int, ...] = (),
) -> Iterator[Field]:
    """`as_field` for the time of a block: a Field that was made for it is closed at its end, one that was given is not.

    There must be room for coefficients and `results` of this shape together, before the former are made.
    """
    if not isinstance(volume, Field) and results:
        volume = as_volume(volume)
        require_both(volume.size, filter, boundary, device, precision, results)
    field = as_field(volume, filter, boundary, device, precision, nan)
    try:
        yield field
    finally:
        if field is not volume:
            field.close()


def require_both(
    size: tuple[int, ...],
    filter: str | Filter | None,
    boundary: str | Boundary | None,
    device: Device | str | int | None,
    precision: Precision | None,
    results: tuple[int, ...],
) -> None:
    """Raise `OutOfMemoryError` if there is no room for the coefficients of so many samples and results of this shape together."""
    kind = precision_kind(precision or "single")
    made = bytes_of(
        size,
        as_filter(DEFAULT_FILTER if filter is None else filter),
        as_boundary(DEFAULT_BOUNDARY if boundary is None else boundary),
        kind,
    )
    own = np.dtype(kind).itemsize * math.prod(results)
    shared = as_device(device).kind == "cpu"  # else coefficients lie in the device's memory
    memory.require(own + made * shared, f"{_results(results)}{' and the coefficients' * shared}")


def _results(shape: tuple[int, ...]) -> str:
    return f"a result of {' × '.join(map(str, shape))} numbers"


# -- functions -------------------------------------------------------------------------------------------------------


@lazily("volume", dask=False, instead=True)
def sample(
    volume: Volume | ArrayLike | Field,
    points: ArrayLike,
    filter: str | Filter | None = None,
    boundary: str | Boundary | None = None,
    derivative: int = 0,
    *,
    frame: Frame = "LPS",
    evaluator: EvaluatorName = "auto",
    fetch: FetchName = "auto",
    fill: float | None = None,
    device: Device | str | int | None = None,
    precision: Precision | None = None,
    nan: str | Missing | None = None,
    progress: Progress | None = None,
    out: Any = None,
) -> Reals:
    """The reconstructed function, its gradient or its Hessian at points of the world (eqs 8 and 9 of the paper).

    A volume is prefiltered at every call; make a `Field` to sample one often.

    Parameters
    ----------
    volume : Volume, array-like, Field, LazyVolume or BrickedField
        2-D or 3-D samples; an array has spacing 1 and origin 0. Those of a LazyVolume are read by bricks, as by `BrickedField`, and
        so is a volume whose coefficients there is no room for, where no other option is given than that knows: values differ by
        less than 10⁻⁶ of the samples' range then.
    points : array-like, shape (..., d)
        World positions (x, y) or (x, y, z). A position that is not finite gives NaN.
    filter : str or Filter, optional
        A name in `clvol.filters()`, or a filter of your own; default "bspline3", "nearest" for labels (`Volume.is_labels`), or that
        of the Field.
    boundary : str or Boundary, optional
        "mirror", "reflect", "wrap", …: see `clvol.boundaries`; default "mirror", or that of the Field.
    derivative : {0, 1, 2}
        0 for values, 1 for gradients, 2 for Hessians: the exact derivatives of the function that derivative 0 gives, per
        world unit (almost everywhere, where it has kinks or jumps).
    frame, evaluator, fetch, fill, progress, out
        As in a call of `Field`.
    device : Device, str or int, optional
        See `as_device`; default that of the Field, if one is given.
    precision : {"single", "double"}, optional
        As of `Field`; default "single", or that of the Field.
    nan : {"error", "propagate", "local"} or Missing, optional
        What becomes of samples that are NaN or infinite: see `clvol.Missing`; default "error", or that of the Field.

    Returns
    -------
    ndarray of float32, shape (...), (..., d) or (..., d, d)
        float64 where the samples lie far from zero (values alone), or are very large or small: see the notes of `Field`.

    Raises
    ------
    OptionError
        `derivative` is not 0, 1 or 2; a Field is given with another filter, boundary, device, precision or nan than its own; or
        as of a call of `Field`.
    DataError, DeviceError, OutOfMemoryError
        As `Field` and a call of it raise them.
    """
    derivative = whole("derivative", derivative, minimum=0, maximum=2)
    if not isinstance(volume, Field):
        volume = as_volume(volume)
        array = _in_world(_points(points, volume.ndim), frame, volume)  # before the volume is prefiltered
        if out is not None:
            as_output(out, array.shape[:-1] + (volume.ndim,) * derivative)
        results = () if out is not None else array.shape[:-1] + (volume.ndim,) * derivative
    else:
        results = ()
    with opened(volume, filter, boundary, device, precision, nan, results=results) as field:
        at = (field.__call__, field.gradient, field.hessian)[derivative]
        return at(points, frame=frame, evaluator=evaluator, fetch=fetch, fill=fill, progress=progress, out=out)


@lazily("volume", instead=True)
def resample(
    volume: Volume | ArrayLike | Field,
    shape: Sequence[int] | None = None,
    spacing: Sequence[float] | float | None = None,
    like: Volume | Volumes | ArrayLike | None = None,
    filter: str | Filter | None = None,
    boundary: str | Boundary | None = None,
    *,
    anchor: Anchor = "center",
    transform: Transforms | None = None,
    anti_aliasing: AntiAliasing | bool = False,
    dtype: DTypeLike | None = None,
    evaluator: EvaluatorName = "auto",
    fetch: FetchName = "auto",
    fill: float | None = None,
    device: Device | str | int | None = None,
    precision: Precision | None = None,
    nan: str | Missing | None = None,
    progress: Progress | None = None,
    out: Any = None,
) -> Volume:
    """The volume on another grid; give exactly one of `shape`, `spacing` and `like`.

    Parameters
    ----------
    volume : Volume, array-like, Field, LazyVolume or BrickedField
        2-D or 3-D samples; an array has spacing 1 and origin 0. One of dask gives one of dask: see `clvol.dask.resample`. A
        LazyVolume is read by bricks, as in `sample`.
    shape, spacing, like, anchor, transform, anti_aliasing, dtype, fill
        As in `Field.resample`; without `anti_aliasing` larger voxels bring aliases of what is finer. With it no sample may be NaN.
    filter, boundary, device, nan
        As in `sample`.
    precision : {"single", "double"}, optional
        As in `sample`, but "double" for a `dtype` that holds more than float32 does, where the device can.
    evaluator, fetch, progress, out
        As in `Field.resample`.

    Returns
    -------
    Volume of float32, or of float64 as `sample` gives it, or of `dtype`

    Raises
    ------
    OptionError
        A Field is given with another filter, boundary, device, precision or nan than its own; or as of `Field.resample`.
    GeometryError
        As `Field.resample` raises it.
    DataError, DeviceError, OutOfMemoryError
        As `Field` and `Field.resample` raise them.
    """
    if not isinstance(volume, Field):
        volume = as_volume(volume)
        grid = grid_for(volume, shape, spacing, like, anchor)  # before the volume is prefiltered
        if out is not None:
            as_output(out, grid.shape)
        transform = as_chain(transform, volume.ndim)
        row = filter_for(volume, filter, DEFAULT_FILTER)
        kind = result_kind(dtype, volume, row, out, fill)
        if precision is None and kind is not None and wide(kind) and (device := as_device(device)).has_double:
            precision = "double"
        if chosen := as_anti_aliasing(anti_aliasing):
            require_no_transform(transform)
            own = row, as_boundary(boundary or DEFAULT_BOUNDARY), as_device(device), precision or "single"
            return _in(kind, _into(_coarser(volume, *own, grid, chosen, evaluator, fetch, fill, progress), out), row)
        results = grid.shape if out is None else ()
    else:
        results = ()
    with opened(volume, filter, boundary, device, precision, nan, results=results) as field:
        return field.resample(
            shape,
            spacing,
            like,
            anchor=anchor,
            transform=transform,
            anti_aliasing=anti_aliasing,
            dtype=dtype,
            evaluator=evaluator,
            fetch=fetch,
            fill=fill,
            progress=progress,
            out=out,
        )


@lazily("volume", instead=True)
def magnify(
    volume: Volume | ArrayLike | Field,
    factor: int = 2,
    filter: str | Filter | None = None,
    boundary: str | Boundary | None = None,
    *,
    evaluator: EvaluatorName = "auto",
    fetch: FetchName = "auto",
    device: Device | str | int | None = None,
    precision: Precision | None = None,
    nan: str | Missing | None = None,
    progress: Progress | None = None,
) -> Volume:
    """The volume with `factor` times the samples along each axis, the given ones among them (section 4.3).

    Parameters
    ----------
    volume : Volume, array-like, Field, LazyVolume or BrickedField
        2-D or 3-D samples; an array has spacing 1 and origin 0. One of dask gives one of dask: see `clvol.dask.magnify`. A
        LazyVolume is read by bricks, as in `sample`.
    factor : int
        At least 1; see `Field.magnify` for where the new samples lie.
    filter, boundary, device, precision, nan
        As in `sample`.
    evaluator, fetch, progress
        As in a call of `Field`.

    Returns
    -------
    Volume of float32, or of float64 as `sample` gives it

    Raises
    ------
    OptionError
        A Field is given with another filter, boundary, device, precision or nan than its own; or as of `Field.magnify`.
    DataError, DeviceError, OutOfMemoryError
        As `Field` and `Field.magnify` raise them.
    """
    factor = whole("factor", factor, minimum=1)
    volume = volume if isinstance(volume, Field) else as_volume(volume)
    results = tuple(factor * n for n in (volume.volume if isinstance(volume, Field) else volume).shape)
    with opened(volume, filter, boundary, device, precision, nan, results=results) as field:
        return field.magnify(factor, evaluator=evaluator, fetch=fetch, progress=progress)


@lazily("data")
def prefilter(
    data: ArrayLike,
    filter: str | Filter = DEFAULT_FILTER,
    boundary: str | Boundary = DEFAULT_BOUNDARY,
    device: Device | str | int | None = None,
    *,
    precision: Precision = "single",
) -> Reals:
    """Spline coefficients of samples (section 4.2 of the paper).

    Parameters
    ----------
    data : Volume or array-like, shape (nx,), (ny, nx) or (nz, ny, nx)
        Samples of any integer or floating dtype. An array of dask gives one of dask: see `clvol.dask.prefilter`.
    filter : str or Filter
        One that needs no prefilter gives the samples back; a hybrid gives those of the filter that magnifies.
    boundary : str or Boundary
        "mirror", "reflect", "wrap", …; those of padded samples are cut back to the given ones.
    device : Device, str or int, optional
        See `as_device`.
    precision : {"single", "double"}
        As of `Field`.

    Returns
    -------
    ndarray of float32, the shape of `data`
        The control points r of eq. (11), for every axis, in units of the data; float64 as `sample` gives it.

    Raises
    ------
    DataError
        `data` are no regular array of real numbers with 1 to 3 axes, are empty, or hold a value that is NaN, infinite or
        too large for float64.
    OptionError
        `filter`, `boundary` or `device` is the name of none.
    DeviceError
        There is no OpenCL device, or it cannot be used.
    OutOfMemoryError
        The device has no room for the coefficients.
    """
    array, _ = read_array(data, placed=False)  # coefficients have no geometry
    line = array.ndim == 1
    volume = Volume(array[None] if line else array)
    chosen, boundary, kind, device = as_filter(filter), as_boundary(boundary), precision_kind(precision), as_device(device)
    require_both(array.shape[::-1], chosen, boundary, device, precision, array.shape)
    chosen = settled(chosen.magnified_by or chosen, volume)
    if line:
        volume.require_finite()
        stored = Stored.of(volume, chosen, boundary) if kind == np.float32 else AS_THEY_ARE
        made = Coefficients(Lattice(array.shape), chosen, boundary, device, stored, kind)
        made.fill(array)
    else:
        made = coefficients_of(volume, chosen, boundary, device, kind)
    with made, device.buffers.mapped(made.buffer, made.shape, write=False, kind=kind) as held:
        own = np.array(held[made.inner]).reshape(array.shape)
        return made.stored.values(own, _gain(chosen) ** array.ndim)


def _gain(filter: Filter) -> float:
    """The coefficients of samples that are all 1, along one axis."""
    return 1 / float(filter.samples[0] + 2 * filter.samples[1:].sum()) if filter.prefilter else 1.0


def _halves(progress: Progress | None) -> tuple[Progress, Progress] | tuple[None, None]:
    """For the first and the second half of the work."""
    if progress is None:
        return None, None
    return lambda done: progress(done / 2), lambda done: progress((1 + done) / 2)


# -- arguments -------------------------------------------------------------------------------------------------------


def as_points(points: ArrayLike, frame: Frame, volume: Volume) -> NDArray[np.generic]:
    """Points of a frame in a volume's world, of any type; those that seem to be in another order cause a `ClvolWarning`."""
    array = _in_world(_points(points, volume.ndim), frame, volume)
    _tell_reversed(array.reshape(-1, volume.ndim), volume)
    return array


def _points(points: ArrayLike, d: int) -> NDArray[np.generic]:
    """`points` as an array, if they are real numbers of shape (..., d)."""
    array = as_array(points, "points", OptionError, f"numbers of shape (..., {d})")
    if array.dtype.kind not in "biuf" or array.ndim == 0 or array.shape[-1] != d:
        raise OptionError(f"points must be numbers of shape (..., {d}); got {array.dtype} of shape {array.shape}")
    return array


def _in_world(points: NDArray[np.generic], frame: Frame, volume: Volume) -> NDArray[np.generic]:
    """Points of a frame in the volume's world: those of its own as they are, of any type."""
    return points if frame == "LPS" else in_frame(np.asarray(points, np.float64), frame, volume.space)


def _tell_reversed(points: NDArray[np.generic], volume: Volume) -> None:
    """Warn of points that lie outside the volume and would not, if their coordinates were in the order of the array's axes."""
    some = np.asarray(points[:: max(1, len(points) // _LOOKED_AT)], np.float64)
    if not len(some) or not np.isfinite(some).all():
        return
    low, high = -0.5, np.asarray(volume.size) - 0.5

    def inside(at: NDArray[np.float64]) -> NDArray[np.bool_]:
        index = volume.world_to_index(at)
        return np.asarray(((index >= low) & (index <= high)).all(-1))

    outside = ~inside(some)
    if 2 * np.count_nonzero(outside) > len(some) and inside(some[outside][:, ::-1]).all():
        names = "(x, y)" if volume.ndim == 2 else "(x, y, z)"
        low, high = (end.round(3).tolist() for end in (volume.corners.min(0), volume.corners.max(0)))
        warn(
            f"points are {names} in world units; most of these lie outside the volume, which reaches from {low} to {high}, "
            f"such as {some[outside][0].tolist()}; reversed, all lie in it"
        )


def _put(results: Reals, target: NDArray[Any] | None) -> Reals:
    """Results in the array that is to hold them, if there is one; they may lie in its memory already."""
    if target is None:
        return results
    if not np.may_share_memory(results, target):
        target[...] = results
    return target


def precision_kind(precision: str) -> type[np.generic]:
    """The type of numbers for "single" or "double"."""
    if precision not in _PRECISIONS:
        raise one_of("precision", precision, _PRECISIONS)
    return _PRECISIONS[precision]


def _precision_for(volume: Volume, row: Filter) -> Precision:
    """Labels that float32 does not hold are taken in float64; all else in float32."""
    return "double" if names_beyond(24, volume, row) else "single"


def names_beyond(bits: int, volume: Volume, row: Filter) -> bool:
    """Whether labels, which this filter leaves as they are, need more bits than a floating type has."""
    if row.support > 1 or volume.data.dtype.kind not in "iu" or volume.data.dtype.itemsize <= bits // 8 or not volume.is_labels:
        return False
    return max(abs(int(v)) for v in volume.limits) > 1 << bits


def require_no_transform(stages: Sequence[object]) -> None:
    """Refuse a low-pass before transforms, which do not make voxels larger alike everywhere."""
    if stages:
        raise OptionError("resample takes transform or anti_aliasing, not both: low-pass the volume first, by Volume.gaussian")


def fill_value(fill: float | None) -> float | None:
    """A real number, NaN and infinities included, or None."""
    if fill is not None and (isinstance(fill, (bool, str)) or not isinstance(fill, (int, float, np.number))):
        raise OptionError(f"fill must be a number or None; got {fill!r}")
    return None if fill is None else float(fill)


def grid_for(
    volume: Volume,
    shape: Sequence[int] | None,
    spacing: Sequence[float] | float | None,
    like: Volume | Volumes | ArrayLike | None,
    anchor: str = "center",
) -> Volume:
    """The grid that one of the three describes: a Volume whose samples take no memory."""
    d = volume.ndim
    if anchor not in get_args(Anchor):
        raise one_of("anchor", anchor, get_args(Anchor))
    if sum(v is not None for v in (shape, spacing, like)) != 1:
        raise OptionError("resample takes exactly one of shape, spacing and like")
    if like is not None:
        if anchor != "center":
            raise OptionError(f"anchor is for shape and spacing, and like has an origin of its own; got {anchor!r}")
        grid = as_grid(like)
        if grid.ndim != d:
            raise OptionError(f"like must have {d} axes, as the volume has; got {grid!r}")
        return grid
    extent = np.asarray(volume.size) * np.asarray(volume.spacing)
    if shape is not None:
        if d == 3 and volume.shape[2] <= _CHANNELS and np.shape(shape) == (2,):
            raise OptionError(
                f"shape must be 3 whole numbers, as the volume has {d} axes; got {shape!r}: "
                "for images in colour there is clvol.images.resample"
            )
        size = np.asarray(_sizes(shape, d)[::-1])
        step = extent / size
    else:
        try:
            step = np.broadcast_to(np.asarray(spacing, dtype=np.float64), (d,))
        except (TypeError, ValueError):
            raise OptionError(f"spacing must be a number, or {d} of them; got {spacing!r}") from None
        if not np.isfinite(step).all() or (step <= 0).any():
            raise OptionError(f"spacing must be positive and finite; got {spacing!r}")
        wanted = np.maximum(1, np.round(extent / step))
        if wanted.max() > np.iinfo(np.int32).max:
            raise OptionError(f"spacing {spacing!r} would need {wanted.max():.3g} samples along an axis")
        size = wanted.astype(np.int64)
    origin = volume.center - volume.direction @ (step * (size - 1) / 2) if anchor == "center" else volume.origin
    sizes = tuple(int(n) for n in size)
    return Volume(np.broadcast_to(np.float32(0), sizes[::-1]), tuple(step), tuple(origin), volume.direction, volume.units)


def _sizes(shape: Sequence[int], d: int) -> tuple[int, ...]:
    try:
        sizes = tuple(int(n) for n in shape)
    except (TypeError, ValueError, OverflowError):
        sizes = ()
    if len(sizes) != d or min(sizes) < 1 or any(n != m for n, m in zip(sizes, shape, strict=True)):
        raise OptionError(f"shape must be {d} whole numbers of at least 1; got {shape!r}")
    memory.require_addressable("a result", sizes)
    return sizes
