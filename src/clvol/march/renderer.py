"""`Renderer` and `render`: pictures of scenes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, Unpack, cast, overload

from clvol.base.checks import number, suggests_options
from clvol.base.errors import OptionError
from clvol.base.kept import Kept
from clvol.base.progress import part_of, require_callback, watched
from clvol.march.choose import source_of
from clvol.march.empty import warn_if_empty
from clvol.march.options import OUTPUTS, Fineness, Output, PictureOptions, RendererOptions, as_outputs, chosen_mode, require_room
from clvol.march.recipe import staged
from clvol.march.refine import Asked
from clvol.march.source import ByBricks, Source, moving
from clvol.march.tolerance import refined, with_step
from clvol.march.uncertainty import noise_of
from clvol.scene.mode import DEFAULT_MODE, Mode, as_mode

if TYPE_CHECKING:  # clusters need dask
    from numpy.typing import ArrayLike

    from clvol.base.progress import Progress
    from clvol.bricks.field import BrickedField
    from clvol.dask.cluster import ClusterLike
    from clvol.device import Device
    from clvol.filter.boundary import Boundary
    from clvol.filter.filter import Filter
    from clvol.march.options import Merge, RefineOptions, RenderOptions
    from clvol.march.refine import Refined
    from clvol.march.source import Drawable
    from clvol.scene.camera import Camera
    from clvol.scene.scene import Scene
    from clvol.show.picture import Picture
    from clvol.spline.field import Field
    from clvol.volume.volume import Volume

__all__ = ["OUTPUTS", "Output", "Renderer", "render"]


@suggests_options
class Renderer:
    """A scene whose volume is resident on a device, to be drawn many times. Leaving its ``with`` block frees the device's memory.

    Parameters
    ----------
    scene : Scene, Medium, Volume, Volumes, LazyVolume, Field, BrickedField or array-like, 3-D
        What to draw; of Volumes all channels. A Field's coefficients are used as they are, and outlive the renderer. A
        LazyVolume is read by bricks (`BrickedField`), and so is a volume whose coefficients do not fit on the device.
    filter, boundary : str, Filter, Boundary, optional
        How a volume is reconstructed between its samples; a medium, a scene or a field has its own. By default the boundary is
        "mirror", in mode "regions" "nearest"; the filter "bspline3(auto)", which smooths the noise that it finds; "bspline3" in
        modes that show extremes, such as "mip"; and "nearest" for labels (see `filter_of`).
    device : Device, str or int, optional
        See `as_device`.
    memory : int, optional
        Bytes that bricks may take: see `BrickedField`, which has its own if one is given.
    mask : array-like of bool or LazyVolume of bool, shape of the volume, optional
        True where a sample is missing, as where it is NaN or infinite. Missing samples are transparent: see the notes of `Missing`.
    cluster : distributed.Client, str or int, optional
        Processes that draw together, by bricks: those of a dask client, of the scheduler at an address, or n of this machine.
        Each reads bricks from where the volume was opened, within `memory`, and uses a GPU of its own if its host has several.
    merge : {"order", "tree"}
        How rays go through the bricks of a cluster. "order": front to back, from process to process; the picture is that of one
        process with the same bricks, bit for bit. "tree": through all at once, merged in pairs, which waits for nobody but cannot
        know what is hidden: equal within 1e-6, and within `termination` where matter stops the light.

    Raises
    ------
    OptionError
        An unknown name; a volume without three axes; `filter` or `boundary` beside a scene or a medium; another filter, boundary
        or device than a field's beside the field; a field that is closed or of double precision.
    GeometryError
        The spacings differ by a factor of more than 10⁶, or lie outside 10⁻³⁰ to 10³⁰, or an axis has more than 2¹⁸ samples.
    DataError
        No sample is finite; or one is too large: for float64, or a label by "nearest" for float32.
    DeviceError
        There is no device, or it cannot hold the volume (`OutOfMemoryError`).
    ClusterError
        No scheduler answers, it has no workers, or these have another version of clvol.

    Examples
    --------
    >>> import clvol
    >>> with clvol.Renderer(clvol.phantoms.marschner_lobb(24)) as renderer:  # prefiltered once
    ...     turn = [renderer.render(clvol.Camera.orbit(azimuth), "mip", size=(48, 48)) for azimuth in (0, 120, 240)]
    >>> len(turn), turn[0].shape
    (3, (48, 48, 4))
    """

    def __init__(
        self,
        scene: Drawable | Source,
        filter: str | Filter | None = None,
        boundary: str | Boundary | None = None,
        device: Device | str | int | None = None,
        *,
        memory: int | None = None,
        mask: ArrayLike | None = None,
        cluster: ClusterLike | None = None,
        merge: Merge = "order",
    ) -> None:
        source = scene
        if not isinstance(source, Source):
            source = source_of(source, filter, boundary, device, memory=memory, mask=mask, cluster=cluster, merge=merge)
        self._source, self._lease, self._modes = source, source.lease, Kept[Mode]()
        self.scene: Scene = source.scene
        self.field: Field | BrickedField = source.field
        self.device: Device = source.field.device

    @property
    def volume(self) -> Volume:
        """The medium's volume."""
        return self.scene.media[0].volume

    @property
    def levels(self) -> tuple[BrickedField, ...]:
        """The functions of the lower resolutions of a LazyVolume that pictures were made of."""
        return self._source.levels()

    def field_of_level(self, level: int) -> BrickedField:
        """The function of a level of a `LazyVolume`; the finest is 0. Bricks are read when their values are asked for.

        Raises
        ------
        OptionError
            The renderer draws no `LazyVolume`, or is closed, or there is no such level.
        """
        if not isinstance(self._source, ByBricks):
            raise OptionError("field_of_level takes a renderer of a volume that is read by bricks")
        with self._lease.held():
            return self._source.function(as_mode(DEFAULT_MODE), level)

    @property
    def filter(self) -> Filter:
        """How the medium is reconstructed, with its smoothing as it was settled for the volume."""
        return self.field.filter

    @property
    def shown(self) -> Field | BrickedField:
        """What the last picture was made of: `field`, that of modes which show extremes, or that of a lower resolution."""
        return self._source.shown

    def filter_of(self, mode: str | Mode) -> Filter:
        """The filter of pictures in a mode: `filter`, unless none was given and the mode shows extremes, which stay as they are."""
        return self._source.filter_of(as_mode(mode))

    def close(self) -> None:
        """Free the device's memory, except that of a Field which was given.

        Pictures that are being made, by other threads or by the caller of a callback that closes the renderer, are completed first.
        """
        self._lease.close()

    def __reduce__(self) -> tuple[Any, ...]:
        """A pickle holds the scene, or the field that was given; another process makes the coefficients anew.

        Of a cluster it holds the address, or the number of processes that was given.
        """
        with self._lease.held():
            arguments, keywords = self._source.recipe()
        return partial(type(self), **keywords) if keywords else type(self), arguments

    def __repr__(self) -> str:
        return f"<Renderer of {self.field!r}>"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    @overload
    def render(self, camera: Camera | None = ..., mode: str | Mode = ..., size: tuple[int, int] = ..., step: float | None = ..., *,
               outputs: Output = ..., progress: Progress | None = ...,
               **options: Unpack[PictureOptions]) -> Picture: ...  # fmt: skip

    @overload
    def render(self, camera: Camera | None = ..., mode: str | Mode = ..., size: tuple[int, int] = ..., step: float | None = ..., *,
               outputs: list[Output] | tuple[Output, ...], progress: Progress | None = ...,
               **options: Unpack[PictureOptions]) -> dict[str, Picture]: ...  # fmt: skip

    def render(
        self,
        camera: Camera | None = None,
        mode: str | Mode = DEFAULT_MODE,
        size: tuple[int, int] = (512, 512),
        step: float | None = None,
        *,
        outputs: Output | Sequence[Output] = "rgba",
        progress: Progress | None = None,
        **options: Unpack[PictureOptions],
    ) -> Picture | dict[str, Picture]:
        """One picture.

        Parameters
        ----------
        camera : Camera, optional
            Default `Camera.orbit()`, fitted to the volume; thin stacks of images are seen from above, elevation 55 to 90.
        mode : str or Mode
            "composite", "isosurface", "mip", "minip", "mean", ...: see `clvol.modes`.
        size : (width, height)
            In pixels.
        step : float
            Most voxels between samples of a ray: by default 0.5, or what a `tolerance` allows. Exact surfaces take no samples.
        outputs : str or sequence of str
            Of "rgba", "depth", "normal", "position", "visited", "value", "pose", "uncertainty"; several give a dictionary. Depth is
            the world distance from the eye along the ray (orthographic: from its plane), inf where there is nothing; normals face
            the viewer, also on faces of cuts; positions are in the world. All are of the ray through the pixel's middle: in
            "composite" where half of the light is stopped, in projections at the extreme, of sums nowhere. "visited" is the share
            of a ray's samples that was evaluated, "value" what projections show; "pose" is of `Integral`. "uncertainty", of
            "isosurface" alone, bounds the distance of the true surface, and the angle of its normal in degrees: see the notes.
        progress : callable, optional
            Called with the fraction done.
        **options
            Those of `clvol.march.options.PictureOptions`, which describes them (`transfer`, `cmap`, `lights`, `clip`, `rays`, ...),
            and those of the mode, such as ``isovalue`` of "isosurface": see its class.

        Returns
        -------
        Picture, an ndarray of float32, shape (height, width, 4), or a dictionary
            Red, green, blue in sRGB, not premultiplied, and opacity, in 0..1; row 0 is the top. Notebooks show it; it has `save`
            and `show`. Depth, visited and value have shape (height, width), normals and positions 3 numbers,
            uncertainty 2; NaN where there is nothing. Positions are float64, exact to float32 as seen from the volume's centre.

        Raises
        ------
        OptionError
            An option that the mode lacks or that changes nothing, an unknown name, or a value that is not allowed: `size` beyond
            1 to 32768, `step` of more than 2²⁰ samples a ray, `rays` beyond 1 to 4096, 5 lights; or the renderer is closed.
        GeometryError
            The camera stands on its target or further away than 10²⁰ mean spacings, `clip` is no box, or a picture spans more than
            2¹⁸ voxels from the volume's centre to its own corners (fov near 180°, zoom near 0, or very unequal spacings), where
            float32 would miss the rays; 16 times as many in a volume that is thin along the view.
        DeviceError
            The device failed, or cannot do what its `limits` ask for: images, or paired fetches from a sampler that interpolates.
        OutOfMemoryError
            The device has no room for the picture, the pyramid of minima and maxima, or the samples copied for "uncertainty".

        Warns
        -----
        ClvolWarning
            Nothing is seen, or all samples look the same; or, after ten seconds, the picture will take a minute more.

        Notes
        -----
        "uncertainty" bounds 95 % of the errors: 1.96 times the root of the expected mean square, from what the filter does between
        samples and from the noise (see `clvol.march.uncertainty`). It is of first order, and too small where noise alone makes
        surfaces, and where smoothing or sparse samples lost a detail.
        """
        wanted = as_outputs(outputs)
        chosen = self._modes.of(lambda: chosen_mode(mode, options, wanted, scene=self.scene), mode, options, wanted)
        self.device.require_usable()
        with self._source.in_use():
            require_callback("progress", progress)
            self._source.require_heard(chosen, options, wanted)
            noise = noise_of(self.volume, options.get("sigma")) if "uncertainty" in wanted else None
            fine = Fineness.of(chosen, size, step, options)
            require_room(fine.size, wanted, edges=fine.rays == "auto")
            uncertainty = self._source.uncertainty(chosen) if noise else None
            shown = watched("the picture", progress)
            stage = with_step(staged(self._source, camera, chosen, fine, options, step), self._source, part_of(shown, 0, 0))
            pictures = self._source.draw(moving(self._source, stage.drawn, wanted), stage.fine, wanted != ("rgba",), shown)
            if "rgba" in wanted or chosen.shows != "integral":  # an integral of 0 is an answer, not an empty picture
                warn_if_empty(stage.drawn, fine, self._source, options, pictures["rgba"])
            if uncertainty is not None and noise is not None:
                central = stage.look.central or not self._source.filter_of(chosen).has_gradient
                pictures["uncertainty"] = uncertainty(pictures["position"], noise, central=central)
            made = stage.finished(pictures, wanted, self._source)
            return made[wanted[0]] if isinstance(outputs, str) else made

    def refine(
        self,
        camera: Camera | None = None,
        mode: str | Mode = DEFAULT_MODE,
        size: tuple[int, int] = (512, 512),
        step: float | None = None,
        *,
        seconds: float = 0.05,
        cancelled: Callable[[], bool] | None = None,
        progress: Progress | None = None,
        **options: Unpack[RefineOptions],
    ) -> Iterator[Refined]:
        """Pictures that become finer: the first soon, the last equal to that of `render`, bit for bit.

        The first has as few pixels as `seconds` asks for: the renderer measures and remembers how long pictures take, so that a
        moving camera gets one picture after the other in time. Where pixels would become too few, "composite" and "mean" take
        longer steps too. Then follow one or two finer ones, if the whole picture takes much longer; the one with one ray a pixel;
        and the one with its other rays. All show the same part of the world: scale them to `size`.

        Of a `LazyVolume` they are whole pictures of its levels, the coarsest first, however long these take; `cancelled` is called
        after each brick, and on a cluster after each area of a picture.

        Parameters
        ----------
        camera, mode, size, step, **options
            As for `render`; pictures are of colours alone, so there are no `outputs` and no `sigma`. Furniture (`axes`, ...) takes
            matplotlib longer than a moving picture has, and stands around the last one alone.
        seconds : float
            Time to the first picture. It takes longer where the smallest picture does, where kernels are
            built first, and where something is computed for the first time: a volume's histogram, its pyramid, for "isosurface"
            the cells where a new isovalue may lie (0.04 s for 256³ samples on two cores).
        cancelled : callable, optional
            Called every few milliseconds, by the thread that iterates; must be quick. Once it returns True the iterator ends,
            without the last picture. What was begun for the first time is completed before.
        progress : callable, optional
            Called with the fraction of the last picture that is done; it may stay at 0 while those before it are drawn.

        Yields
        ------
        Refined
            A `Picture` that says whether it is the last, its step, and how long the iterator worked for it. Each is a new array.

        Raises
        ------
        OptionError, GeometryError, DeviceError, OutOfMemoryError
            As by `render`: of options when it is called, of the camera's place with the first picture. If the renderer is closed,
            a picture that another thread is making is completed, and the next one refused.

        Notes
        -----
        Nothing is drawn between one picture and the request for the next, and the renderer can then be closed. Stop iterating
        whenever a picture is good enough. Several threads may refine with one renderer; each waits for the others' launches.

        Examples
        --------
        >>> import clvol
        >>> renderer = clvol.Renderer(clvol.phantoms.marschner_lobb(32))
        >>> for picture in renderer.refine(clvol.Camera.orbit(40, 10), "mip", (200, 150), seconds=0.02):
        ...     last = picture  # show it, scaled to 200 × 150
        >>> last.final, last.shape
        (True, (150, 200, 4))
        """
        began = time.perf_counter()
        refused = [name for name in ("outputs", "sigma") if name in options]
        if refused and (refused != ["outputs"] or options["outputs"] != "rgba"):  # type: ignore[typeddict-item]  # it has none
            raise OptionError(f"refine gives colours alone: leave out {' and '.join(refused)}, or use render")
        chosen = self._modes.of(lambda: chosen_mode(mode, options), mode, options)
        seconds = number("seconds", seconds, above=0)
        require_callback("cancelled", cancelled)
        require_callback("progress", progress)
        self.device.require_usable()
        with self._source.in_use():
            self._source.require_heard(chosen, options)
            fine = Fineness.of(chosen, size, step, options)
            require_room(fine.size, ("rgba",), edges=fine.rays == "auto")
            stage = staged(self._source, camera, chosen, fine, options, step)
            return refined(stage, self._source, Asked(seconds, cancelled, progress, began))


@overload
def render(scene: Drawable, camera: Camera | None = ..., mode: str | Mode = ..., size: tuple[int, int] = ...,
           step: float | None = ..., *, outputs: Output = ..., progress: Progress | None = ...,
           **options: Unpack[RenderOptions]) -> Picture: ...  # fmt: skip


@overload
def render(scene: Drawable, camera: Camera | None = ..., mode: str | Mode = ..., size: tuple[int, int] = ...,
           step: float | None = ..., *, outputs: list[Output] | tuple[Output, ...], progress: Progress | None = ...,
           **options: Unpack[RenderOptions]) -> dict[str, Picture]: ...  # fmt: skip


def render(
    scene: Drawable,
    camera: Camera | None = None,
    mode: str | Mode = DEFAULT_MODE,
    size: tuple[int, int] = (512, 512),
    step: float | None = None,
    *,
    outputs: Output | Sequence[Output] = "rgba",
    progress: Progress | None = None,
    **options: Unpack[RenderOptions],
) -> Picture | dict[str, Picture]:
    """One picture of a volume or a scene; `Renderer` makes many pictures of one scene.

    Parameters
    ----------
    scene, camera, mode, size, step, outputs, progress
        As for `Renderer` and `Renderer.render`.
    **options
        The other options of `Renderer` (`filter`, `boundary`, `device`, `mask`, ...), of `Renderer.render`, and of the mode.

    Returns
    -------
    Picture, an ndarray of float32, shape (height, width, 4)
        Red, green and blue in sRGB, not premultiplied, and opacity, in 0..1, or a dictionary for several `outputs`.

    Raises
    ------
    ClvolError
        As for `Renderer` and `Renderer.render`, and so are warnings.

    Examples
    --------
    >>> import clvol
    >>> picture = clvol.render(clvol.phantoms.sphere(24), clvol.Camera.orbit(30, 20), "isosurface", isovalue=0.5, size=(64, 64))
    """
    held = {name: options.pop(name) for name in RendererOptions.__annotations__ if name in options}  # type: ignore[misc]
    chosen = chosen_mode(mode, options, as_outputs(outputs), scene=scene)  # before any work, and so is what follows
    fine = Fineness.of(chosen, size, step, options)
    require_room(fine.size, as_outputs(outputs), edges=False)
    with Renderer(source_of(scene, **held, usual=chosen.picture_filter)) as renderer:
        return renderer.render(camera, mode, size, step, outputs=outputs, progress=progress, **cast(PictureOptions, options))  # type: ignore[arg-type, misc]  # either
