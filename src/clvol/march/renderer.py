"""Pictures of scenes: what holds them on a device and draws them."""

from __future__ import annotations

import inspect
import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from types import EllipsisType, TracebackType
from typing import TYPE_CHECKING, Any, Literal, Self, TypeAlias, get_args, overload

import numpy as np
from numpy.typing import ArrayLike

from clvol.base import memory
from clvol.base.checks import instance, number, one_of, whole
from clvol.base.errors import DataError, OptionError, OutOfMemoryError
from clvol.bricks.field import BrickedField
from clvol.bricks.source import LazyVolume, budget_for
from clvol.device import Device
from clvol.filter.boundary import Boundary
from clvol.filter.filter import Filter
from clvol.filter.table import PICTURE_FILTER, as_filter
from clvol.march import launch
from clvol.march.bricks import STEPPED_AT_MOST, BrickedDrawing, level_of
from clvol.march.frame import Subject
from clvol.march.pixels import DEFAULT_PIXEL_FILTER, as_pixel_filter
from clvol.march.refine import Rates, Refined, Wanted, refined, refined_by_levels
from clvol.march.uncertainty import Uncertainty
from clvol.noise import Noise
from clvol.scene.camera import Camera
from clvol.scene.light import Light, Material
from clvol.scene.look import look
from clvol.scene.mode import DEFAULT_MODE, Composite, Isosurface, Mode, as_mode
from clvol.scene.scene import Box, Medium, Scene, as_scene
from clvol.scene.transfer import TransferFunction
from clvol.show.picture import Picture, as_pictures
from clvol.spline.evaluator import DIRECT, Evaluator, EvaluatorName, FetchName, choose_evaluator, require_names
from clvol.spline.field import Field, as_field
from clvol.spline.lease import Lease
from clvol.spline.minmax import MinMax
from clvol.spline.points import Progress
from clvol.volume.smoothing import filter_for
from clvol.volume.stored import RENUMBER, names_beyond
from clvol.volume.volume import Volume, as_volume

if TYPE_CHECKING:  # clusters need dask
    from clvol.dask.cluster import Cluster, ClusterLike
    from clvol.march.cluster import Merge, Shared

__all__ = ["OUTPUTS", "Output", "Renderer", "render"]

Output: TypeAlias = Literal["rgba", "depth", "normal", "position", "visited", "uncertainty"]

OUTPUTS: tuple[Output, ...] = ("rgba", "depth", "normal", "position", "visited")
"""Of every mode."""
_ALL_OUTPUTS = get_args(Output)
_BITS = 8.0  # of the sampler's fraction, before pictures are made by it: what texture units have
_MAX_SIZE = 1 << 15
_CLOSED = "the renderer was closed, and its coefficients were released; make a new one"


class Renderer:
    """A scene whose volumes are resident on a device, to be drawn many times.

    Parameters
    ----------
    scene : Scene, Medium, Volume, LazyVolume, Field, BrickedField or array-like, 3-D
        What to draw. A Field's coefficients are used as they are, and stay when the renderer is closed. A LazyVolume is read brick
        by brick (`BrickedField`, which takes a budget of memory), and so is a volume whose coefficients the device has no room for.
    filter, boundary : str, Filter, Boundary, optional
        How a volume is reconstructed between its samples, where `scene` is no more than a volume. By default the boundary is
        "mirror", and the filter "bspline3(auto)", which takes from the volume how much noise there is to smooth, or "bspline3" in
        modes that show extremes, such as "mip", and "nearest" for labels (`filter_of` says which). A medium or a field says so
        itself.
    device : Device, str or int, optional
        See `as_device`.
    budget : int, optional
        Bytes that bricks may take, where a volume is read by bricks: as of `BrickedField`, whose default it has. A BrickedField has
        its own.
    cluster : distributed.Client, str or int, optional
        Processes that draw together, by bricks: those of a client of dask, of the scheduler at an address, or so many of this
        machine. Each reads some of the bricks, from where the volume was opened, and has the budget for them; of several GPUs of a
        host each has another. A volume in memory is sent to them. A pickle has the address of the scheduler, at which whoever loads
        it connects anew, or the number of processes, which are started for it.
    merge : {"order", "tree"}
        How rays go through the bricks of a cluster. "order": front to back, from process to process; the picture is that of one
        process with the same bricks, to the last bit. "tree": through all at once, merged two by two, which waits for nobody but
        does not know what is hidden: equal within 1e-6, and within `termination` where matter stops the light.

    Raises
    ------
    OptionError
        No filter, boundary or device has this name, the volume does not have three axes, `filter` or `boundary` are given
        beside a scene or a medium, another filter, boundary or device than a field's beside it, or the field is
        closed or of double precision.
    GeometryError
        The spacings differ by a factor of more than 10⁶, or lie outside 10⁻³⁰ to 10³⁰, or an axis has more than 2¹⁸ samples.
        (Whether spacings that differ by less are too unequal depends on the view: `render`.)
    DataError
        A sample is NaN, infinite, or too large for float64; or a label, drawn by "nearest", is too large for float32.
    DeviceError
        There is no device, or it cannot hold the volume (`OutOfMemoryError`).
    ClusterError
        No scheduler answers, it has no workers, or these have another version of clvol.

    Notes
    -----
    A context manager: leaving it frees the device's memory.
    """

    def __init__(
        self,
        scene: Scene | Medium | Volume | LazyVolume | Field | BrickedField | ArrayLike,
        filter: str | Filter | None = None,
        boundary: str | Boundary | None = None,
        device: Device | str | int | None = None,
        *,
        budget: int | None = None,
        cluster: ClusterLike | None = None,
        merge: Merge = "order",
    ) -> None:
        if merge not in ("order", "tree"):
            raise one_of("merge", merge, ("order", "tree"))
        if merge != "order" and cluster is None:
            raise OptionError(f"merge says how a cluster puts rays together; got {merge!r} and no cluster")
        if cluster is not None and isinstance(scene, (Field, BrickedField)):
            raise OptionError("cluster takes a volume, of which its processes make fields; got a field of this process")
        given = {name: value for name, value in (("filter", filter), ("boundary", boundary)) if value is not None}
        self._own = own = not isinstance(scene, (Field, BrickedField))
        self._looked: Volume | None = None
        self._lazy = isinstance(scene, LazyVolume)
        bricked: BrickedField | None = None
        if isinstance(scene, (LazyVolume, BrickedField)):
            bricked = _bricked(scene, filter, boundary, device, budget, at_once=cluster is None)
            self._looked = bricked.volume.sketch()
            own_filter = bricked.filter if filter is not None or isinstance(scene, BrickedField) else None
            scene = Medium(bricked.coefficients.volume, filter=own_filter, boundary=bricked.boundary)
        elif isinstance(scene, Field):
            as_field(scene, filter, boundary, device)  # which refuses other options
            given_field = scene
            if given_field.gaps is not None:
                raise OptionError(
                    "rendering takes a field without gaps; this one has missing samples: replace them with Volume.filled(), or "
                    'keep them filled with nan=Missing("local", most=1)'
                )
            if scene.closed:
                raise OptionError("the field was closed, and its coefficients were released; make a new one")
            scene = Medium(scene.coefficients.volume, filter=scene.filter, boundary=scene.boundary)
        elif not isinstance(scene, (Scene, Medium)):
            scene = Medium(scene, **given)  # type: ignore[arg-type]  # __post_init__ converts
        elif given:
            raise OptionError(f"{' and '.join(given)} must be left to the medium of a scene; got {given}")
        self.scene = as_scene(scene)
        (medium,) = self.scene.media
        field: Field | BrickedField
        if bricked is not None:
            field = bricked
        elif cluster is not None:
            row = filter_for(medium.volume, medium.filter, PICTURE_FILTER)
            field = BrickedField(medium.volume, row, medium.boundary, device, budget=budget, at_once=False)
            self._looked = medium.volume
        elif own:
            row = filter_for(medium.volume, medium.filter, PICTURE_FILTER)
            try:
                field = _single(medium.volume, row, medium.boundary, device)
            except OutOfMemoryError:  # of a buffer, perhaps, which is less than the memory
                field = BrickedField(medium.volume, row, medium.boundary, device, budget=budget)
                self._looked = medium.volume
        elif given_field.precision != "single":
            raise OptionError(f"rendering takes a field of single precision; got one of {given_field.precision} precision")
        else:
            field = given_field
        self.field = self._shown = field
        self.device = field.device
        self._levels: dict[tuple[int, str], BrickedField] = {}
        self._unsmoothed: Field | BrickedField | None = None
        self._minmax: dict[tuple[Filter, Evaluator], MinMax] = {}
        self._uncertainty: Uncertainty | None = None
        self._rates = Rates()
        self._lock = threading.RLock()  # a handler of signals may come back here
        self._lease = Lease(_CLOSED)
        if own:
            self._lease.frees(field.close)
        self._merge: Merge = merge
        self._asked_device, self._asked_budget = device, budget
        self._shared: dict[int, Shared] = {}
        self._cluster: Cluster | None = None
        self._processes = cluster if isinstance(cluster, int) else None
        if cluster is not None:
            from clvol.dask.cluster import as_cluster
            from clvol.march.cluster import shared_out

            self._cluster = as_cluster(cluster)
            assert isinstance(field, BrickedField)
            self.field = self._shown = shared_out(field, len(self._cluster.workers))
            self._lease.frees(self.field.close)
            self._lease.frees(partial(_left, self._cluster, self._shared, owned=self._cluster is not cluster))

    @property
    def volume(self) -> Volume:
        """Of the medium."""
        return self.scene.media[0].volume

    @property
    def levels(self) -> tuple[BrickedField, ...]:
        """The fields of those lower resolutions of a LazyVolume that pictures were made of."""
        return tuple(self._levels.values())

    def field_of_level(self, level: int) -> BrickedField:
        """The function of a level of a `LazyVolume`, which is read where it is asked for; the finest is 0.

        Raises
        ------
        OptionError
            The renderer is of no `LazyVolume`, or is closed, or this has no such level.
        """
        field = self.field
        if not isinstance(field, BrickedField):
            raise OptionError("field_of_level takes a renderer of a volume that is read by bricks")
        level = whole("level", level, 0, len(field.volume.levels))
        with self._lease.held():
            return self._field_at(as_mode(DEFAULT_MODE), level)

    @property
    def filter(self) -> Filter:
        """How the medium is reconstructed, with its smoothing as it was settled for the volume."""
        return self.field.filter

    @property
    def shown(self) -> Field | BrickedField:
        """What the last picture was made of: `field`, that of modes which show extremes, or that of a lower resolution."""
        return self._shown

    def filter_of(self, mode: str | Mode) -> Filter:
        """The filter of pictures in a mode: `filter`, unless none was given and the mode shows extremes, which stay as they are."""
        chosen = as_mode(mode)
        free = self.scene.media[0].filter is None and chosen.picture_filter != PICTURE_FILTER
        return filter_for(self.volume, None, chosen.picture_filter) if free else self.filter

    def close(self) -> None:
        """Free the device's memory, except that of a Field which was given.

        Pictures that other threads are making, or that whoever calls this from a callback is, are made to their end, and the memory
        is freed then.
        """
        self._lease.close()

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled is the scene, or the field that was given; another process makes its coefficients anew.

        Of a cluster it is the address, or how many processes were asked for.
        """
        with self._lease.held():
            if not self._own:
                return type(self), (self.field,)
            field, (medium,) = self.field, self.scene.media
            if not isinstance(field, BrickedField):
                return type(self), (self.scene, None, None, self.device)
            again = partial(type(self), budget=field.budget)
            device: Device | str | int | None = self.device
            if self._cluster is not None:
                again = partial(
                    type(self), budget=self._asked_budget, cluster=self._processes or self._cluster.address, merge=self._merge
                )
                device = self._asked_device  # each worker finds its own
            if self._lazy:  # whose scene has none of its samples
                return again, (field.volume, medium.filter, medium.boundary, device)
            return again, (self.scene, None, None, device)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    @overload
    def render(
        self,
        camera: Camera | None = ...,
        mode: str | Mode = ...,
        size: tuple[int, int] = ...,
        step: float = ...,
        *,
        transfer: TransferFunction | None = ...,
        preset: str | None = ...,
        window: tuple[float, float] | None = ...,
        cmap: str | None = ...,
        opacity: float | Sequence[tuple[float, float]] | None = ...,
        material: Material | None = ...,
        lights: Light | Sequence[Light] | None = ...,
        background: Sequence[float] | str | EllipsisType | None = ...,
        clip: Box | EllipsisType | None = ...,
        gradient: Literal["analytic", "central"] = ...,
        samples: int | Literal["auto"] = ...,
        pixel_filter: str | Filter = ...,
        skipping: bool = ...,
        evaluator: EvaluatorName = ...,
        fetch: FetchName = ...,
        lod: float | Literal["auto"] = ...,
        outputs: Output = ...,
        sigma: float | None = ...,
        progress: Progress | None = ...,
        **options: Any,
    ) -> Picture: ...

    @overload
    def render(
        self,
        camera: Camera | None = ...,
        mode: str | Mode = ...,
        size: tuple[int, int] = ...,
        step: float = ...,
        *,
        transfer: TransferFunction | None = ...,
        preset: str | None = ...,
        window: tuple[float, float] | None = ...,
        cmap: str | None = ...,
        opacity: float | Sequence[tuple[float, float]] | None = ...,
        material: Material | None = ...,
        lights: Light | Sequence[Light] | None = ...,
        background: Sequence[float] | str | EllipsisType | None = ...,
        clip: Box | EllipsisType | None = ...,
        gradient: Literal["analytic", "central"] = ...,
        samples: int | Literal["auto"] = ...,
        pixel_filter: str | Filter = ...,
        skipping: bool = ...,
        evaluator: EvaluatorName = ...,
        fetch: FetchName = ...,
        lod: float | Literal["auto"] = ...,
        outputs: list[Output] | tuple[Output, ...],
        sigma: float | None = ...,
        progress: Progress | None = ...,
        **options: Any,
    ) -> dict[str, Picture]: ...

    def render(
        self,
        camera: Camera | None = None,
        mode: str | Mode = DEFAULT_MODE,
        size: tuple[int, int] = (512, 512),
        step: float = 0.5,
        *,
        transfer: TransferFunction | None = None,
        preset: str | None = None,
        window: tuple[float, float] | None = None,
        cmap: str | None = None,
        opacity: float | Sequence[tuple[float, float]] | None = None,
        material: Material | None = None,
        lights: Light | Sequence[Light] | None = None,
        background: Sequence[float] | str | EllipsisType | None = ...,
        clip: Box | EllipsisType | None = ...,
        gradient: Literal["analytic", "central"] = "analytic",
        samples: int | Literal["auto"] = "auto",
        pixel_filter: str | Filter = DEFAULT_PIXEL_FILTER,
        skipping: bool = True,
        evaluator: EvaluatorName = "auto",
        fetch: FetchName = "auto",
        lod: float | Literal["auto"] = "auto",
        outputs: Output | Sequence[Output] = "rgba",
        sigma: float | None = None,
        progress: Progress | None = None,
        **options: Any,
    ) -> Picture | dict[str, Picture]:
        """One picture.

        Parameters
        ----------
        camera : Camera, optional
            Default `Camera.orbit()`, fitted to the volume.
        mode : str or Mode
            "composite", "isosurface", "mip", "minip", "mean", ...: see `clvol.modes`.
        size : (width, height)
            In pixels.
        step : float
            The most that a ray advances between samples, in voxels. Exact surfaces take none: see `Isosurface`.
        transfer, material
            Instead of the medium's. A transfer function that neither gives is the mode's: from the histogram for "composite",
            a grey ramp for projections.
        preset, window, cmap, opacity
            Instead of a transfer function, by words: what kind of data it is (`clvol.presets`), the values from black to white as
            (center, width), the name of a colour map, and how opaque: a factor, or pairs of a value and an opacity. Each changes
            what it names of the mode's own look, and may be given with the others, but not beside `transfer`.
        lights, background, clip
            Instead of the scene's: see `Scene`.
        gradient : {"analytic", "central"}
            "analytic" is the exact derivative of the function drawn. "central" takes differences of one voxel
            to either side, as many others do; with `hybrid` one voxel of the magnified grid, half of the volume's.
            `nearest` has no useful derivative and is always shaded by central differences.
        samples : int or "auto"
            Rays a pixel, 1 to 4096. A single one goes through its middle. "auto": one, and in modes that light what they show two
            more in pixels on edges, which differ from a neighbour by more than an eighth of full luminance; they are at most a
            20th of those that are not plain background (on processors a 64th, but for surfaces), which bounds what it costs.
            All other pixels are those of ``samples=1`` to the last bit.
        pixel_filter : str or Filter
            What several rays sample: the picture under this filter of the table, which is as many pixels wide as it has taps.
            "linear" leaves half of the aliasing of "nearest", the pixel's own square, from 16 rays on, and two thirds with fewer,
            and is less sharp; one with negative lobes, such as "mitchell", needs about 64 rays. Filters with a prefilter are
            refused.
        skipping : bool
            Do not look where the function's minimum and maximum say that nothing can be seen. The picture is the same to the
            last bit.
        evaluator, fetch
            As for `clvol.sample`.
        lod : float or "auto"
            Of a `LazyVolume` that has levels: how many pixels a voxel may span, of the level that is drawn, where the volume is
            nearest to the viewer. "auto" is 1; 0 draws the finest level whatever the picture's size. Steps count its voxels.
        outputs : str or sequence of str
            Of "rgba", "depth", "normal", "position", "visited", "uncertainty". Several give a dictionary. Depth is the world
            distance from the eye along the ray (orthographic: from the camera's plane), inf where there is nothing;
            normals face the viewer; NaN where there are none. Positions are in the world. These are of the ray through the
            pixel's middle. In "composite" they are where half of the light
            is stopped, in projections where the extreme lies; "mean" has none. "visited" is the share of a ray's
            samples that was looked at, NaN where it has none. "uncertainty", of "isosurface" alone, says within what of the
            surface that is drawn the true one lies, and within how many degrees of its normal: see the notes.
        sigma : float, optional
            Standard deviation of the samples' noise, in units of the data, for "uncertainty"; it is then taken to be white. By
            default it is estimated, with its spectrum (`Volume.noise`).
        progress : callable, optional
            Called with the fraction done.
        **options
            Those of the mode, such as ``isovalue`` of "isosurface": see its class.

        Returns
        -------
        Picture, an ndarray of float32, shape (height, width, 4), or a dictionary
            Red, green, blue, opacity in 0..1; row 0 is the top. Notebooks show it, and it has `save` and `show`.
            Depth and visited have shape (height, width), normals and
            positions (height, width, 3), uncertainty (height, width, 2): world units and degrees, NaN where nothing was hit.
            Positions are float64: exact to float32 as seen from the volume's centre, however far that is from the world's
            origin.

        Raises
        ------
        OptionError
            An option that the mode does not have, or a value that is not allowed: `size` beyond 1 to 32768 pixels, a `step` that
            is not positive or gives more than 2²⁰ samples a ray, `samples` beyond 1 to 4096, more than 4 lights, an unknown name;
            or the renderer is closed.
        GeometryError
            The camera stands on its target or further away than 10²⁰ mean spacings, `clip` is no box, or a picture spans more
            than 2¹⁸ voxels from the volume's centre to its own corners, because the camera is so wide (fov near 180°, zoom near
            0), or because spacings are so unequal: float32 would miss the rays. It may span 16 times as many where rounding
            moves samples along their rays alone, as in a volume that is thin along the view.
        DeviceError
            The device failed; ``fetch="image"`` on a device without images, or paired fetches from an image whose sampler does
            not interpolate.
        OutOfMemoryError
            The device has no room for the picture, for the pyramid of minima and maxima, or for the copy of the samples that
            "uncertainty" takes.

        Notes
        -----
        "uncertainty" is what 95 % of the errors should lie within: 1.96 times the root of the mean square that is expected of them,
        from what the filter does between samples and from the noise; `clvol.march.uncertainty` says how. It is to first order,
        and knows of no more than the samples hold. Where noise alone makes surfaces, it says too little, and where smoothing
        took away all of a detail, or where the samples were too far apart to hold it. Integers have at least the noise of
        rounding, ``sqrt(1/12)``.
        """
        chosen = as_mode(mode, options, _KEYWORDS)
        self.device.require_usable()
        with self._lease.held(), self.field.in_use():
            if progress is not None and not callable(progress):
                raise OptionError(f"progress must be callable; got {progress!r}")
            wanted = _outputs(outputs)
            sigma = None if sigma is None else number("sigma", sigma, minimum=0)
            words = {"preset": preset, "window": window, "cmap": cmap, "opacity": opacity}
            scene = self._seen(self._transfer(chosen, transfer, words), material, lights, background, clip)
            size, step, rays = _fineness(chosen, size, step, samples)
            pixel_filter, detail = as_pixel_filter(pixel_filter), _pixels_a_voxel(lod)
            _require_picture(size, wanted, edges=rays == "auto")
            uncertain = self._uncertain(self._field_of(chosen), chosen) if "uncertainty" in wanted else None
            subject = self._subject(scene, camera, chosen, gradient, skipping, evaluator, fetch)
            guides, field = wanted != ("rgba",), self._field_of(chosen)
            if isinstance(field, BrickedField):
                level = level_of(field.volume, subject.view(size), size, detail)
                pictures = self._by_bricks(subject, chosen, level, size, step, rays, pixel_filter, guides, skipping, progress)
            else:
                frame = subject.frame(size, step, guides=guides)
                pictures = launch.draw(frame, rays, pixel_filter, progress)
                self._shown = field
            if uncertain is not None:
                pictures["uncertainty"] = uncertain(pictures["position"], self._noise(sigma), central=subject.central)
            shown = as_pictures({name: pictures[name] for name in wanted})
            return shown[wanted[0]] if isinstance(outputs, str) else shown

    def refine(
        self,
        camera: Camera | None = None,
        mode: str | Mode = DEFAULT_MODE,
        size: tuple[int, int] = (512, 512),
        step: float = 0.5,
        *,
        budget: float = 0.05,
        cancelled: Callable[[], bool] | None = None,
        transfer: TransferFunction | None = None,
        preset: str | None = None,
        window: tuple[float, float] | None = None,
        cmap: str | None = None,
        opacity: float | Sequence[tuple[float, float]] | None = None,
        material: Material | None = None,
        lights: Light | Sequence[Light] | None = None,
        background: Sequence[float] | str | EllipsisType | None = ...,
        clip: Box | EllipsisType | None = ...,
        gradient: Literal["analytic", "central"] = "analytic",
        samples: int | Literal["auto"] = "auto",
        pixel_filter: str | Filter = DEFAULT_PIXEL_FILTER,
        skipping: bool = True,
        evaluator: EvaluatorName = "auto",
        fetch: FetchName = "auto",
        lod: float | Literal["auto"] = "auto",
        progress: Progress | None = None,
        **options: Any,
    ) -> Iterator[Refined]:
        """Pictures that become finer: the first soon, the last the one that `render` makes of the same arguments, to the last bit.

        The first has as few pixels as `budget` asks for: how long pictures take is measured, and remembered by the renderer, so
        that a camera that moves has one picture after the other in time. Where pixels would become too few, those of "composite"
        and "mean" have longer steps too. Then come one or two finer ones, if the whole picture takes much longer; then that with
        one ray a pixel; then that with its other rays. All show the same part of the world: scale them to `size`.

        Of a `LazyVolume` they are whole pictures of its levels, the coarsest first, however long these take; `cancelled` is asked
        after each brick, and of a cluster after each area of a picture.

        Parameters
        ----------
        camera, mode, size, step
            As for `render`.
        budget : float
            Seconds within which the first picture is wanted. It takes longer where the budget is less than the smallest picture
            takes, where kernels are built first, and where something is computed for the first time: a volume's histogram, its
            pyramid, for "isosurface" where each new isovalue may lie (0.04 s of 256³ on two cores).
        cancelled : callable, optional
            Asked every few milliseconds whether the pictures are no longer wanted; the iterator then ends, without the last one.
            It must be quick, and is called by the thread that iterates. What was computed for the first time is completed before.
        transfer, preset, window, cmap, opacity, material, lights, background, clip, gradient, samples, pixel_filter, skipping, \
        evaluator, fetch, **options
            As for `render`. Pictures are of colours alone: there are no `outputs`.
        progress : callable, optional
            Called with the fraction of the last picture that is done. Those before it do not count, so it may stay at 0 while they
            are drawn.

        Yields
        ------
        Refined
            A `Picture` which says whether it is the last, by what step it was made, and how long the iterator took until then. Each
            is an array of its own.

        Raises
        ------
        OptionError, GeometryError, DeviceError, OutOfMemoryError
            As by `render`: of options when it is called, of the camera's place with the first picture. The renderer was closed: a
            picture that another thread is making then is made to its end, and the next one refused.

        Notes
        -----
        Nothing is drawn between one picture and the request for the next, and the renderer can then be closed. Whoever has enough
        just stops iterating. Several threads may refine with one renderer; each waits for the launches of the others.

        Examples
        --------
        >>> import clvol
        >>> renderer = clvol.Renderer(clvol.phantoms.marschner_lobb(32))
        >>> for picture in renderer.refine(clvol.Camera.orbit(40, 10), "mip", (200, 150), budget=0.02):
        ...     last = picture  # show it, scaled to 200 × 150
        >>> last.final, last.shape
        (True, (150, 200, 4))
        """
        asked_at = time.perf_counter()
        refused = [name for name in ("outputs", "sigma") if name in options]
        if refused and (refused != ["outputs"] or options["outputs"] != "rgba"):
            raise OptionError(f"refine gives colours alone: leave out {' and '.join(refused)}, or use render")
        chosen = as_mode(mode, {name: value for name, value in options.items() if name != "outputs"}, _KEYWORDS)
        budget = number("budget", budget, above=0)
        if cancelled is not None and not callable(cancelled):
            raise OptionError(f"cancelled must be callable; got {cancelled!r}")
        if progress is not None and not callable(progress):
            raise OptionError(f"progress must be callable; got {progress!r}")
        self.device.require_usable()
        with self._lease.held(), self.field.in_use():
            words = {"preset": preset, "window": window, "cmap": cmap, "opacity": opacity}
            scene = self._seen(self._transfer(chosen, transfer, words), material, lights, background, clip)
            size, step, rays = _fineness(chosen, size, step, samples)
            pixel_filter = as_pixel_filter(pixel_filter)
            _require_picture(size, ("rgba",), edges=rays == "auto")
            subject = self._subject(scene, camera, chosen, gradient, skipping, evaluator, fetch)
            field = self._field_of(chosen)
            if isinstance(field, BrickedField):
                finest = level_of(field.volume, subject.view(size), size, _pixels_a_voxel(lod))

                def draw(level: int, told: Progress) -> Picture:
                    made = self._by_bricks(subject, chosen, level, size, step, rays, pixel_filter, False, skipping, told)
                    return as_pictures(made)["rgba"]

                return refined_by_levels(draw, len(field.volume.levels), finest, step, cancelled, self._drawing, asked_at, progress)
        return refined(
            Wanted(subject, size, step, rays, pixel_filter),
            budget,
            cancelled,
            self._rates,
            self._drawing,
            time.perf_counter() - asked_at,
            progress,
        )

    def _by_bricks(
        self,
        subject: Subject,
        mode: Mode,
        level: int,
        size: tuple[int, int],
        step: float,
        rays: int | Literal["auto"],
        pixel_filter: Filter,
        guides: bool,
        skipping: bool,
        progress: Progress | None,
    ) -> dict[str, Any]:
        """The picture of a level of a volume that is read brick by brick; the whole volume is level 0."""
        field = self._field_at(mode, level)
        stepped = isinstance(mode, Isosurface) and not mode.stretches
        if step > STEPPED_AT_MOST and (stepped or (guides and isinstance(mode, Composite))):
            what = "stepped surfaces" if stepped else "the depth and normals of matter"
            raise OptionError(
                f"step must be at most {STEPPED_AT_MOST:g} for {what} of a volume that is read by bricks; got {step:g}"
            )
        with field.in_use():
            own = subject.of(field.coefficients, field.boundary)
            frame = own.frame(size, step, guides=guides)
            drawing: BrickedDrawing
            if self._cluster is None:
                drawing = BrickedDrawing(frame, rays, pixel_filter, field, own.view(size), skipping=skipping)
            else:
                from clvol.march.cluster import ClusterDrawing

                shared = self._share(self._cluster, field)
                drawing = ClusterDrawing(frame, rays, pixel_filter, shared, own.view(size), skipping=skipping, merge=self._merge)
            made = launch.drawn(drawing, rays, progress)
            self._shown = field
            return made

    def _share(self, cluster: Cluster, field: BrickedField) -> Shared:
        """Who of the cluster has which bricks of a field; anew when other workers are there."""
        from clvol.march.cluster import Shared

        with self._lock:
            found = self._shared.get(id(field))
            if found is None:
                choice = self._asked_device
                found = Shared(cluster, field, choice.name if isinstance(choice, Device) else choice, self._asked_budget)
                self._shared[id(field)] = found
            elif found.workers != cluster.workers:
                found.share()
            return found

    def _field_at(self, mode: Mode, level: int) -> BrickedField:
        """The field of a level; all of them have one budget."""
        base = self._field_of(mode)
        assert isinstance(base, BrickedField)
        with self._lock:
            field = base
            if level:
                coarser = base.volume.levels[level - 1]
                free = self.scene.media[0].filter is None and mode.picture_filter == PICTURE_FILTER
                row = _usual(coarser) if free else base.filter
                key = level, "" if row is None else as_filter(row).name
                if key not in self._levels:
                    made = BrickedField(coarser, row, base.boundary, base.device, beside=base)
                    if self._cluster is not None:
                        from clvol.march.cluster import shared_out

                        made = shared_out(made, len(self._cluster.workers))
                    self._levels[key] = made
                    self._lease.frees(self._levels[key].close)
                field = self._levels[key]
            return field

    @contextmanager
    def _drawing(self) -> Iterator[None]:
        """The time in which something is drawn."""
        with self._lease.held(), self.field.in_use():
            yield

    def _transfer(self, mode: Mode, transfer: TransferFunction | None, words: Mapping[str, Any]) -> TransferFunction | None:
        """The transfer function that is given, by itself or by words, if any is."""
        given = [name for name, value in words.items() if value is not None]
        if given and transfer is not None:
            raise OptionError(f"transfer must be left out where {' and '.join(given)} say what it is; got both")
        return look(self._looked or self.volume, mode, **words) if given else transfer

    def _subject(
        self,
        scene: Scene,
        camera: Camera | None,
        mode: Mode,
        gradient: str,
        skipping: bool,
        evaluator: EvaluatorName,
        fetch: FetchName,
    ) -> Subject:
        """What is to be seen of a scene, with all on the device that is needed for it."""
        camera = Camera.orbit() if camera is None else camera
        instance("camera", camera, Camera)
        instance("skipping", skipping, bool, np.bool_)
        require_names(evaluator, fetch)
        if gradient not in ("analytic", "central"):
            raise one_of("gradient", gradient, ("analytic", "central"))
        field, looked = self._field_of(mode), self._looked or self.volume
        if isinstance(field, BrickedField) and (fetch == "image" or evaluator not in ("auto", "taps")):
            raise OptionError(f"bricks are read by direct taps from buffers; got evaluator {evaluator!r} and fetch {fetch!r}")
        way = DIRECT if isinstance(field, BrickedField) else _evaluator(field, evaluator, fetch)
        subject = Subject(
            scene,
            field.coefficients,
            self._pyramid(field, way) if skipping and mode.skips and isinstance(field, Field) else None,
            camera,
            mode.settled(looked),
            scene.media[0].transfer or mode.transfer(looked),
            way,
            gradient == "central" or not field.filter.has_gradient,
        )
        return subject if self._looked is None else subject.seen_as(self._looked)

    def _seen(
        self,
        transfer: TransferFunction | None,
        material: Material | None,
        lights: Light | Sequence[Light] | None,
        background: Sequence[float] | str | EllipsisType | None,
        clip: Box | EllipsisType | None,
    ) -> Scene:
        """The scene with what is given instead of its own."""
        scene, (medium,) = self.scene, self.scene.media
        if transfer is not None or material is not None:
            medium = Medium(
                medium.volume,
                medium.transfer if transfer is None else transfer,
                medium.material if material is None else material,
                medium.filter,
                medium.boundary,
            )
        return Scene(
            (medium,),
            scene.lights if lights is None else lights,  # type: ignore[arg-type]  # __post_init__ converts
            scene.background if background is ... else background,  # type: ignore[arg-type]
            scene.clip if clip is ... else clip,
        )

    def _field_of(self, mode: Mode) -> Field | BrickedField:
        """What pictures of a mode show; that of modes which show extremes is made for the first of them."""
        row = self.filter_of(mode)
        if row == self.filter:
            return self.field
        with self._lock:
            if self._unsmoothed is None:
                own = self.field
                if isinstance(own, BrickedField):
                    self._unsmoothed = BrickedField(own.volume, row, own.boundary, own.device, edge=own.edge, beside=own)
                else:
                    self._unsmoothed = _single(self.volume, row, own.boundary, self.device)
                self._lease.frees(self._unsmoothed.close)
            return self._unsmoothed

    def _uncertain(self, field: Field | BrickedField, mode: Mode) -> Uncertainty:
        """The errors of surfaces, made ready for the first picture."""
        if isinstance(field, BrickedField):
            raise OptionError('the output "uncertainty" takes a volume that is in memory; got one that is read by bricks')
        if not isinstance(mode, Isosurface):
            raise OptionError(f'the output "uncertainty" is of surfaces: mode must be isosurface; got {mode.name!r}')
        if not field.filter.has_gradient:
            raise OptionError(f'the output "uncertainty" needs a filter that has slopes; got {field.filter.name!r}')
        with self._lock:
            if self._uncertainty is None:
                self._uncertainty = Uncertainty(field)
                self._lease.frees(self._uncertainty.release)
            return self._uncertainty

    def _noise(self, sigma: float | None) -> Noise:
        """Of the samples: white where its standard deviation is given; integers were rounded."""
        noise = self.volume.noise if sigma is None else Noise(sigma, "white")
        rounding = math.sqrt(1 / 12) if self.volume.data.dtype.kind in "iu" else 0.0
        return noise if noise.sigma >= rounding else Noise(rounding, "white")

    def _pyramid(self, field: Field, evaluator: Evaluator) -> MinMax:
        """Minima and maxima, computed for the first picture."""
        with self._lock:
            key = field.filter, evaluator
            if key not in self._minmax:
                self._minmax[key] = MinMax(field.coefficients, evaluator)
                self._lease.frees(self._minmax[key].release)
            return self._minmax[key]


_KEYWORDS = tuple(name for name in inspect.signature(Renderer.render).parameters if name not in ("self", "options"))


@overload
def render(
    scene: Scene | Medium | Volume | LazyVolume | Field | BrickedField | ArrayLike,
    camera: Camera | None = ...,
    mode: str | Mode = ...,
    filter: str | Filter | None = ...,
    boundary: str | Boundary | None = ...,
    size: tuple[int, int] = ...,
    step: float = ...,
    *,
    device: Device | str | int | None = ...,
    outputs: Output = ...,
    **options: Any,
) -> Picture: ...


@overload
def render(
    scene: Scene | Medium | Volume | LazyVolume | Field | BrickedField | ArrayLike,
    camera: Camera | None = ...,
    mode: str | Mode = ...,
    filter: str | Filter | None = ...,
    boundary: str | Boundary | None = ...,
    size: tuple[int, int] = ...,
    step: float = ...,
    *,
    device: Device | str | int | None = ...,
    outputs: list[Output] | tuple[Output, ...],
    **options: Any,
) -> dict[str, Picture]: ...


def render(
    scene: Scene | Medium | Volume | LazyVolume | Field | BrickedField | ArrayLike,
    camera: Camera | None = None,
    mode: str | Mode = DEFAULT_MODE,
    filter: str | Filter | None = None,
    boundary: str | Boundary | None = None,
    size: tuple[int, int] = (512, 512),
    step: float = 0.5,
    *,
    device: Device | str | int | None = None,
    outputs: Output | Sequence[Output] = "rgba",
    **options: Any,
) -> Picture | dict[str, Picture]:
    """One picture of a volume or a scene; `Renderer` is the same for many pictures of one scene.

    Parameters and errors are those of `Renderer` and of `Renderer.render`.

    Returns
    -------
    Picture, an ndarray of float32, shape (height, width, 4)
        Red, green, blue and opacity in 0..1, or a dictionary for several `outputs`.
    """
    held = {name: options.pop(name) for name in ("budget", "cluster", "merge") if name in options}
    chosen = as_mode(mode, {name: value for name, value in options.items() if name not in _KEYWORDS}, _KEYWORDS)  # before any work,
    as_pixel_filter(options.get("pixel_filter", DEFAULT_PIXEL_FILTER))  # and so is this
    free = filter is None and not isinstance(scene, (Scene, Medium, Field, BrickedField, LazyVolume))
    if free:
        scene = as_volume(scene)  # type: ignore[arg-type]  # what is left
    _require_picture(_size(size), _outputs(outputs), edges=False)
    row = filter
    if isinstance(scene, LazyVolume):
        budget_for(scene, held.get("budget"))  # before anything is read
        row = row_for(scene, filter, chosen.picture_filter)
    elif free:
        row = filter_for(scene, None, chosen.picture_filter)  # type: ignore[arg-type]  # it is a volume then
    with Renderer(scene, row, boundary, device, **held) as renderer:
        return renderer.render(camera, mode, size, step, outputs=outputs, **options)  # type: ignore[arg-type]  # either


def row_for(volume: LazyVolume, filter: str | Filter | None, usual: str = PICTURE_FILTER) -> str | Filter | None:
    """The filter of all sizes of a volume in one picture; None: that of its bounds."""
    if filter is not None or volume.bounds is not None:
        return filter
    return filter_for(volume.part(), None, usual)


def _bricked(
    scene: LazyVolume | BrickedField,
    filter: str | Filter | None,
    boundary: str | Boundary | None,
    device: Device | str | int | None,
    budget: int | None,
    *,
    at_once: bool = True,
) -> BrickedField:
    """What pictures are made of that are made by bricks; of a volume a new one."""
    if isinstance(scene, BrickedField):
        if filter is not None or boundary is not None or device is not None or budget is not None:
            raise OptionError("filter, boundary, device and budget must be left to the field; got them beside it")
        if scene.closed:
            raise OptionError("the field was closed, and its coefficients were released; make a new one")
        return scene
    budget_for(scene, budget)  # before anything is read
    row = _usual(scene) if filter is None else filter
    return BrickedField(scene, row, boundary, device, budget=budget, at_once=at_once)


def _left(cluster: Cluster, shared: dict[int, Shared], *, owned: bool) -> None:
    """A cluster is left, whose workers keep nothing."""
    for one in shared.values():
        one.forget()
    if owned:
        cluster.close()


def _usual(volume: LazyVolume) -> str | None:
    """The filter of pictures where none is given; None: that of the volume's bounds."""
    return PICTURE_FILTER if volume.bounds is None else None


def _pixels_a_voxel(lod: object) -> float:
    """How many pixels a voxel may span."""
    return 1.0 if isinstance(lod, str) and lod == "auto" else number("lod", lod, minimum=0)


def _evaluator(field: Field, evaluator: str, fetch: str) -> Evaluator:
    """The one that is named, else the one that the device's limits name or that suits it."""
    named = {"evaluator": evaluator, "fetch": fetch}
    with field.device.limited(**{name: value for name, value in named.items() if value != "auto"}):
        return choose_evaluator(field.device, field.filter, bits=_BITS)


def _single(volume: Volume, row: Filter, boundary: Boundary, device: Device | str | int | None) -> Field:
    """What kernels of pictures read: float32, which must tell labels apart."""
    if names_beyond(24, volume, row):
        low, high = volume.limits
        raise DataError(
            f"labels must be whole numbers that float32 holds to be drawn, up to 2**24; got {low} to {high}: {RENUMBER}"
        )
    return Field(volume, row, boundary, device, precision="single")


def _outputs(outputs: object) -> tuple[str, ...]:
    if not isinstance(outputs, (str, Sequence)) or not outputs:
        raise one_of("outputs", outputs, _ALL_OUTPUTS)
    wanted = (outputs,) if isinstance(outputs, str) else tuple(outputs)
    for name in wanted:
        if name not in _ALL_OUTPUTS:
            raise one_of("outputs", name, _ALL_OUTPUTS)
    return wanted


def _require_picture(size: tuple[int, int], outputs: tuple[str, ...], *, edges: bool) -> None:
    """Raise `OutOfMemoryError` if there is no room for a picture, its guides, and what its edges are found by."""
    width, height = size
    each = 16 + 56 * (outputs != ("rgba",)) + 32 * ("uncertainty" in outputs) + 28 * edges
    memory.require(width * height * each, f"a picture of {width} × {height} pixels")


def _fineness(
    mode: Mode, size: tuple[int, int], step: float, samples: int | Literal["auto"]
) -> tuple[tuple[int, int], float, int | Literal["auto"]]:
    """Size, step and rays a pixel, checked; on edges there are more rays only where a mode lights what it shows."""
    if samples != "auto":
        samples = whole("samples", samples, minimum=1, maximum=4096)
    elif not mode.shaded:
        samples = 1
    return _size(size), number("step", step, above=0), samples


def _size(size: tuple[int, int]) -> tuple[int, int]:
    try:
        width, height = size
    except (TypeError, ValueError):
        raise OptionError(f"size must be (width, height) in pixels; got {size!r}") from None
    return whole("width", width, minimum=1, maximum=_MAX_SIZE), whole("height", height, minimum=1, maximum=_MAX_SIZE)
