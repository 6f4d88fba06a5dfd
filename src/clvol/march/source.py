"""What a renderer draws: a function in memory, or by bricks, in this process or on a cluster. `clvol.march.choose` asks which."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from clvol.base.checks import whole
from clvol.base.errors import ChunkError, MissingSampleError, OptionError
from clvol.base.kept import Kept, Once, Same
from clvol.base.progress import part_of
from clvol.base.srgb import on
from clvol.bricks.continued import continued
from clvol.bricks.field import BrickedField, BrickedLabels
from clvol.bricks.source import LazyVolume
from clvol.filter.table import PICTURE_FILTER, as_filter
from clvol.march import launch
from clvol.march.bricks import STEPPED_AT_MOST, BrickedDrawing, level_of, level_within
from clvol.march.colored import Other
from clvol.march.frame import Frame, Subject
from clvol.march.function import regions_of, row_for, single
from clvol.march.gaps import Gaps
from clvol.march.media import Bricked
from clvol.march.mixed import mixed, nearest
from clvol.march.refine import Rate, Refinement, Wanted, refined_by_levels
from clvol.march.shadow import Body, Matter, Shadows
from clvol.march.uncertainty import Uncertainty
from clvol.scene.mode import CURVATURES, colored_by, moved, outlined, virtual_samples
from clvol.scene.scene import Medium, Scene
from clvol.spline.evaluator import DIRECT, choose_evaluator, require_direct
from clvol.spline.field import Field
from clvol.spline.lease import Lease
from clvol.spline.minmax import MinMax
from clvol.spline.regions import Regions, region_boundary, region_filter, require_labels
from clvol.volume.smoothing import filter_for
from clvol.volume.volume import Volume
from clvol.volume.volumes import Volumes

if TYPE_CHECKING:  # clusters need dask
    from clvol.base.progress import Progress
    from clvol.filter.filter import Filter
    from clvol.march.cluster import Workers
    from clvol.march.options import Fineness, RefineOptions, ResolvedLook
    from clvol.march.refine import Asked, Refined
    from clvol.march.shadow import Lit
    from clvol.scene.camera import Viewpoint
    from clvol.scene.mode import Mode
    from clvol.spline.evaluator import Evaluator

__all__ = ["ByBricks", "Drawable", "InMemory", "Several", "Source", "moving"]

Drawable: TypeAlias = Scene | Medium | Volume | Volumes | LazyVolume | Field | BrickedField | ArrayLike
"""Inputs of a `Renderer`."""
Pictures: TypeAlias = dict[str, launch.Picture]
Lighting: TypeAlias = "Callable[[ResolvedLook], Lit | None]"
"""What is left of the lights of a look, among all matter of the picture, if it has shadows or occlusion."""

_KEPT = 4  # functions that colour others
_BITS = 8.0  # least bits of the sampler's fraction for pictures: what texture units have
_CLOSED = "the renderer was closed, and its coefficients were released; make a new one"


class Source(ABC):
    """The function of a scene's medium, from which pictures are made.

    Looks are chosen from the samples of `preview`. Of `arguments` another process makes the source: a renderer's input, filter and
    boundary; or just a field.
    """

    by_bricks: ClassVar[bool] = False

    def __init__(self, scene: Scene, field: Field | BrickedField, preview: Volume, arguments: tuple[Any, ...]) -> None:
        self.scene, self.field, self.preview, self.arguments = scene, field, preview, arguments
        self.shown = field
        self.lease = Lease(_CLOSED)
        self._lock = threading.RLock()  # a signal handler may re-enter
        self.looks: Kept[ResolvedLook] = Kept(4)  # they hold what pictures need, such as shadows
        self.lease.frees(self.looks.clear)
        self._unsmoothed: Any = None
        self._levels: dict[tuple[int, str, bool], BrickedField] = {}
        self._colored: dict[tuple[Any, ...], Other] = {}
        self._shadows = Shadows(field.device)
        self.lease.frees(self._shadows.release)
        self._owned = arguments[0] is not field
        if self._owned:
            self.lease.frees(field.close)

    @contextmanager
    def in_use(self) -> Iterator[None]:
        """A context in which nothing is freed."""
        with self.lease.held(), self.field.in_use():
            yield

    @property
    def _free(self) -> bool:
        """Whether modes choose the filter, since none was given."""
        return self.scene.media[0].filter is None

    def filter_of(self, mode: Mode) -> Filter:
        """The filter of pictures in a mode."""
        medium = self.scene.media[0]
        if mode.regions:
            return region_filter(medium.filter or mode.picture_filter)
        if not medium.smooth and (not self._free or mode.picture_filter == PICTURE_FILTER):
            return self.field.filter
        return filter_for(medium.volume, None, mode.picture_filter)  # one that is given is that of smooth boundaries

    def require_heard(self, mode: Mode, options: RefineOptions, outputs: Collection[str] = ("rgba",)) -> None:
        """Raise `OptionError` if an option of a picture changes nothing for this function, or an output does not exist."""
        medium = self.scene.media[0]
        mode = medium.shown_in(mode)
        if mode.regions and (what := self._no_regions()):
            by = "smooth=True" if medium.smooth else f"mode {mode.name!r}"
            raise OptionError(f"{by} draws one label map, all of whose samples are labels; got {what}")
        if "gradient" in options and medium.smooth:
            raise OptionError("gradient changes nothing with smooth=True: boundaries have that of their filter; leave it out")
        row = self.filter_of(mode)
        if "gradient" in options and not row.has_gradient:
            raise OptionError(f"gradient changes nothing with {row.name}, which has no slopes; leave it out")
        if (colored := colored_by(mode)) in CURVATURES and row.continuity < 1:
            raise OptionError(f"color_by {colored} takes a filter with continuous slopes, such as bspline3; got {row.name}")
        if outlined(mode) and row.continuity < 1:
            raise OptionError(f"outline takes a filter with continuous slopes, such as bspline3; got {row.name}")
        if virtual_samples(mode) and (not row.has_gradient or options.get("gradient") == "central"):
            how = row.name if not row.has_gradient else "central differences"
            raise OptionError(f"virtual takes a filter with slopes, such as bspline3, and its own gradient; got {how}")
        if options.get("lod", "auto") != "auto" and not self.sizes:
            raise OptionError("lod changes nothing for a volume of one size; leave it out, or store several by clvol.pyramid")
        if "value" in outputs and mode.shows in ("matter", "surface"):
            raise OptionError(f'the output "value" is of projections, such as mip and integral; got {mode.name!r}')

    def _no_regions(self) -> str:
        """What of it keeps the regions of labels from being drawn; "" if nothing does."""
        return "a medium with color_by" if self.scene.media[0].color_by is not None else ""

    @abstractmethod
    def part(self, medium: Medium) -> OneMedium:
        """The source of one of the scene's media."""

    def _lit(self, look: ResolvedLook) -> Lit | None:
        """What is left of the lights of a look and of others beside it, if it has shadows or occlusion."""
        scene = look.swept
        if not (look.mode.shaded and (scene.shadow or scene.occlusion)):
            return None
        looks = look, *look.others
        volumes = [one.scene.media[0].volume for one in looks]
        casting = [one for one in looks if not one.mode.regions]  # regions let all light through
        return self._shadows.of(scene, volumes, lambda edge: [self.part(one.scene.media[0]).body(one, edge) for one in casting])

    @property
    def limits(self) -> tuple[float, float] | None:
        """The smallest and the largest sample; None where these are estimated."""
        return self.scene.media[0].volume.value_range

    @property
    def sizes(self) -> bool:
        """Whether there are several resolutions to choose from."""
        return False

    def levels(self) -> tuple[BrickedField, ...]:
        """The functions of lower resolutions that were drawn."""
        return tuple(self._levels.values())

    def recipe(self) -> tuple[tuple[Any, ...], dict[str, Any]]:
        """Arguments and keywords with which another process makes the renderer."""
        return (*self.arguments, self.field.device) if self._owned else self.arguments, {}

    @abstractmethod
    def function(self, mode: Mode, level: int = 0) -> Field | BrickedField:
        """The function that pictures of a mode show, for a level of the volume; the finest is 0."""

    @abstractmethod
    def draw(self, look: ResolvedLook, fine: Fineness, guides: bool, progress: Progress | None) -> Pictures:
        """The picture of a look, and its guides if they are wanted."""

    @abstractmethod
    def refine(self, look: ResolvedLook, fine: Fineness, asked: Asked) -> Iterator[Refined]:
        """Pictures that become finer."""

    @abstractmethod
    def uncertainty(self, mode: Mode) -> Uncertainty:
        """The errors of surfaces, computed on first use."""


class Seen(NamedTuple):
    """A look of a function, for a frame."""

    subject: Subject
    field: Field | BrickedField
    bricks: BrickedField | None  # the same, if its bricks are resident one at a time


class OneMedium(Source):
    """The function of a single medium."""

    coarsest: int = 0
    """The number of its lowest resolution; the finest is 0."""

    def part(self, medium: Medium) -> OneMedium:  # noqa: ARG002  # it has one
        return self

    def draw(self, look: ResolvedLook, fine: Fineness, guides: bool, progress: Progress | None) -> Pictures:
        level = self.level(fine, look.view(fine.size)) if self.by_bricks else 0
        return self.drawn(look, fine, level, guides, self._lit, progress)

    def regions(self) -> Regions:
        """The smooth regions of its labels, which slices show; they are freed with the source."""
        raise OptionError(
            "smooth boundaries of labels on slices are of a volume in memory: a LazyVolume gives it by whole(), and smooth=False "
            "shows its samples; got one that is read by bricks"
        )

    def level(self, fine: Fineness, view: Viewpoint) -> int:  # noqa: ARG002  # volumes in memory have one
        """The level whose voxels are about as fine as the picture's pixels."""
        return 0

    @abstractmethod
    def seen(self, look: ResolvedLook, fine: Fineness, level: int, guides: bool, lit: Lighting) -> Seen:
        """A look of a level, in this light."""

    @abstractmethod
    def drawn(
        self, look: ResolvedLook, fine: Fineness, level: int, guides: bool, lit: Lighting, progress: Progress | None
    ) -> Pictures:
        """The picture of a look of a level, in this light."""

    @abstractmethod
    def body(self, look: ResolvedLook, edge: float) -> Body:
        """What stops light of a look; of several resolutions the coarsest whose voxels are at most so long, if there is one."""

    def _other(self, look: ResolvedLook) -> Other | None:
        """The function that colours the medium of a look, if one does; those of a few looks are kept."""
        by = look.scene.media[0].color_by
        if by is None or by.filter is None:  # it is settled
            return None
        key = by.volume, by.filter, by.boundary
        with self._lock:
            if key not in self._colored:
                if len(self._colored) >= _KEPT:
                    self._colored.clear()
                with single(*key, self.field.device) as field:
                    self._colored[key] = Other.of(field)
            return self._colored[key]

    def leave_out(self) -> bool:
        """Take the function for one that lacks samples; False if that is known, or cannot be."""
        return False


class InMemory(OneMedium):
    """A function whose coefficients are all on the device."""

    field: Field

    def __init__(self, scene: Scene, field: Field, preview: Volume, arguments: tuple[Any, ...]) -> None:
        super().__init__(scene, field, preview, arguments)
        self.pyramids: dict[tuple[Filter, Evaluator, bool, bool], MinMax] = {}
        self.lease.frees(partial(_released, self.pyramids))
        self._gaps = None if field.gaps is None else Gaps(field.gaps.volume.data, field.device)
        if self._gaps is not None:
            self.lease.frees(self._gaps.release)
        self._uncertainty: Uncertainty | None = None
        self._regions: Regions | None = None
        self._rates: dict[tuple[Any, ...], Rate] = {}
        self._frames: Once[Frame] = Once(1)
        self.lease.frees(self._frames.clear)

    def function(self, mode: Mode, level: int = 0) -> Field:
        whole("level", level, 0, 0)
        row, rule = self.filter_of(mode), self.field.boundary
        if mode.regions:
            rule = region_boundary(self.scene.media[0].boundary)
        if (row, rule) == (self.field.filter, self.field.boundary):
            return self.field
        with self._lock:
            if self._unsmoothed is None:
                self._unsmoothed = single(self.scene.media[0].volume, row, rule, self.field.device)
                self.lease.frees(self._unsmoothed.close)
            made: Field = self._unsmoothed
            return made

    def regions(self) -> Regions:
        with self._lock:
            if self._regions is None:
                (medium,) = self.scene.media
                self._regions = regions_of(medium.volume, medium.filter, region_boundary(medium.boundary), self.field.device)
                self.lease.frees(self._regions.release)
            return self._regions

    def drawn(
        self, look: ResolvedLook, fine: Fineness, level: int, guides: bool, lit: Lighting, progress: Progress | None
    ) -> Pictures:
        seen = self.seen(look, fine, level, guides, lit)
        subject = seen.subject
        key = Same(subject.look), *subject.parts, fine.size, fine.step, guides
        frame = self._frames(key, lambda: subject.frame(fine.size, fine.step, guides=guides))
        pictures = launch.draw(frame, fine.rays, fine.filter, progress)
        self.shown = seen.field
        return pictures

    def refine(self, look: ResolvedLook, fine: Fineness, asked: Asked) -> Iterator[Refined]:
        wanted = Wanted(self.seen(look, fine, 0, False, self._lit).subject, fine.size, fine.step, fine.rays, fine.filter)
        return Refinement(wanted, asked, self._rates).pictures(self.in_use)

    def seen(self, look: ResolvedLook, fine: Fineness, level: int, guides: bool, lit: Lighting) -> Seen:  # noqa: ARG002
        """A look of the function, with its pyramid of minima and maxima where space is skipped."""
        field, names = self.function(look.mode), look.mode.regions
        if names:
            require_direct(field.device, "regions of labels are")
            require_labels(look.scene.media[0].volume)
        evaluator = DIRECT if names else choose_evaluator(field.device, field.filter, bits=_BITS)
        slopes = look.transfer.graded & 5 > 0 and not look.central and field.filter.has_gradient
        pyramid = self._pyramid(field, evaluator, names, slopes) if look.skipping and look.mode.skips else None
        own = look.of_values(field.coefficients.volume)
        parts = field.coefficients, pyramid, evaluator, self._gaps, self._other(look), lit(look)
        return Seen(Subject(own, *parts), field, None)

    def body(self, look: ResolvedLook, edge: float) -> Body:  # noqa: ARG002
        return Body.of(self.function(look.mode).coefficients, Matter.of(look), self._gaps)

    def _pyramid(self, field: Field, evaluator: Evaluator, names: bool, slopes: bool) -> MinMax:
        with self._lock:
            plain, steep = ((field.filter, evaluator, names, which) for which in (False, True))
            key = steep if slopes or steep in self.pyramids else plain
            if key not in self.pyramids:
                self.pyramids[key] = MinMax(field.coefficients, evaluator, names=names, slopes=slopes)
            if key == steep and self.pyramids.pop(plain, None) is not None:
                self.looks.clear()  # the plain one goes with the last picture which is drawn with it: this has all that it has
            return self.pyramids[key]

    def uncertainty(self, mode: Mode) -> Uncertainty:
        field = self.function(mode)
        if mode.shows != "surface" or not mode.finished_there:  # at one place of a ray
            raise OptionError(f'the output "uncertainty" is of one surface: mode must be isosurface; got {mode.name!r}')
        if not field.filter.has_gradient:
            raise OptionError(f'the output "uncertainty" needs a filter that has slopes; got {field.filter.name!r}')
        if mode.capped:
            raise OptionError('the output "uncertainty" is of surfaces, and a cap is none: cap must be False')
        with self._lock:
            if self._uncertainty is None:
                self._uncertainty = Uncertainty(field)
                self.lease.frees(self._uncertainty.release)
            return self._uncertainty


def _released(pyramids: dict[Any, MinMax]) -> None:
    for pyramid in pyramids.values():
        pyramid.release()


class ByBricks(OneMedium):
    """A function whose bricks are on the device one at a time."""

    by_bricks: ClassVar[bool] = True
    field: BrickedField

    def _no_regions(self) -> str:
        return super()._no_regions() or ("" if self.field.volume.where is None else "one that lacks samples")

    def __init__(
        self, scene: Scene, field: BrickedField, preview: Volume, arguments: tuple[Any, ...], workers: Workers | None = None
    ) -> None:
        super().__init__(scene, field, preview, arguments)
        self._workers = workers
        if workers is not None:
            self.lease.frees(workers.close)

    def recipe(self) -> tuple[tuple[Any, ...], dict[str, Any]]:
        if self._workers is not None:
            return (*self.arguments, self._workers.device), self._workers.keywords
        arguments, _ = super().recipe()
        return arguments, {"memory": self.field.memory} if self._owned else {}

    @property
    def limits(self) -> tuple[float, float] | None:
        return None if self.field.volume.estimated else super().limits

    @property
    def sizes(self) -> bool:
        return bool(self.field.volume.levels)

    def function(self, mode: Mode, level: int = 0) -> BrickedField:
        level = whole("level", level, 0, len(self.field.volume.levels))
        with self._lock:
            finest = self._finest(mode)
            if not level:
                return finest
            coarser = finest.volume.levels[level - 1]
            row = row_for(coarser, None) if self._free and mode.picture_filter == PICTURE_FILTER else finest.filter
            key = level, "" if row is None else as_filter(row).name, mode.regions
            if key not in self._levels:
                made = type(finest)(coarser, row, finest.boundary, finest.device, beside=finest)  # which has one budget with it
                self._levels[key] = made if self._workers is None else self._workers.shared_out(made)
                self.lease.frees(self._levels[key].close)
            return self._levels[key]

    def _finest(self, mode: Mode) -> BrickedField:
        field, row = self.field, self.filter_of(mode)
        kind = BrickedLabels if mode.regions else BrickedField
        if row == field.filter and type(field) is kind:
            return field
        if self._unsmoothed is None:
            rule = region_boundary(self.scene.media[0].boundary) if mode.regions else field.boundary
            self._unsmoothed = kind(field.volume, row, rule, field.device, edge=field.edge, beside=field)
            self.lease.frees(self._unsmoothed.close)
        made: BrickedField = self._unsmoothed
        return made

    @property
    def coarsest(self) -> int:  # type: ignore[override]  # of what is read
        return len(self.field.volume.levels)

    def level(self, fine: Fineness, view: Viewpoint) -> int:
        return level_of(self.field.volume, view, fine.size, fine.lod)

    def drawn(
        self, look: ResolvedLook, fine: Fineness, level: int, guides: bool, lit: Lighting, progress: Progress | None
    ) -> Pictures:
        try:
            return self._drawn(look, fine, level, guides, lit, progress)
        except (ChunkError, MissingSampleError):  # only its bricks showed that samples are missing
            if look.mode.regions or not self.leave_out():  # nothing stands for a label
                raise
            return self._drawn(look, fine, level, guides, lit, progress)

    def leave_out(self) -> bool:
        with self._lock:
            field = self.field
            if field.volume.where is not None or field.volume.missing is not None:
                return False
            own = field.filter, field.boundary, field.device
            made = BrickedField(continued(field.volume), *own, at_once=self._workers is None, beside=field)
            self.field = made if self._workers is None else self._workers.shared_out(made)
            self.lease.frees(self.field.close)
            self._unsmoothed, self._levels = None, {}
            return True

    def body(self, look: ResolvedLook, edge: float) -> Body:
        if self.field.volume.where is not None:
            raise OptionError(
                "shadow and occlusion must be left out for bricks that lack samples: LazyVolume.whole() has them with shadows"
            )
        field = self.function(look.mode, level_within(self.field.volume, edge))

        made = field.coefficients

        def write(grid: Volume, buffer: Any) -> None:
            values = field.resample(like=grid, dtype=np.float32).data if self._workers is None else self._workers.on(field, grid)
            with made.device.buffers.mapped(buffer, grid.shape, write=True) as stored:
                stored[...] = made.stored.samples(values)

        return Body(Matter.of(look), made, write)

    def seen(self, look: ResolvedLook, fine: Fineness, level: int, guides: bool, lit: Lighting) -> Seen:
        require_direct(self.field.device, "bricks are")
        if virtual_samples(look.mode):
            raise OptionError("virtual must be 0 for a volume that is read by bricks: LazyVolume.whole() has such samples")
        if look.sends_rays:
            raise OptionError("shadow_rays must be left out for a volume that is read by bricks: LazyVolume.whole() has them")
        field = self.function(look.mode, level)
        between = look.mode.between_samples(guides=guides)
        if between and fine.step > STEPPED_AT_MOST:
            raise OptionError(
                f"step must be at most {STEPPED_AT_MOST:g} for {between} of a volume that is read by bricks; got {fine.step:g}"
            )
        own = look.of_level(field.coefficients.volume, field.boundary)
        gaps = None if field.volume.where is None else Gaps(field.volume.where, field.device)
        return Seen(Subject(own, field.coefficients, None, DIRECT, gaps, self._other(look), lit(look)), field, field)

    def _drawn(
        self, look: ResolvedLook, fine: Fineness, level: int, guides: bool, lit: Lighting, progress: Progress | None
    ) -> Pictures:
        subject, _, field = self.seen(look, fine, level, guides, lit)
        assert field is not None
        with field.in_use():
            frame, view = subject.frame(fine.size, fine.step, guides=guides), subject.look.view(fine.size)
            make = BrickedDrawing if self._workers is None else self._workers.drawing
            drawing = make(frame, fine.rays, fine.filter, field, view, skipping=look.skipping)
            made = launch.drawn(drawing, fine.rays, progress)
            self.shown = field
            return made

    def refine(self, look: ResolvedLook, fine: Fineness, asked: Asked) -> Iterator[Refined]:
        def draw(level: int, report: Progress) -> launch.Picture:
            return self.drawn(look, fine, level, False, self._lit, report)["rgba"]

        levels = range(self.coarsest, self.level(fine, look.view(fine.size)) - 1, -1)
        return refined_by_levels(draw, levels, fine.step, asked, self.in_use)

    def uncertainty(self, mode: Mode) -> Uncertainty:  # noqa: ARG002
        raise OptionError('the output "uncertainty" takes a volume that is in memory; got one that is read by bricks')


class Several(Source):
    """Functions of several media, each in memory or by bricks, each by the source of its own."""

    def __init__(
        self,
        scene: Scene,
        parts: Sequence[OneMedium],
        arguments: tuple[Any, ...],
        keywords: dict[str, Any],
        begin: Callable[..., launch.Drawing],
    ) -> None:
        """`parts` are in the order of the scene's media; `begin` makes a picture in progress."""
        self.parts = {_reconstructed(medium): part for medium, part in zip(scene.media, parts, strict=True)}
        super().__init__(scene, parts[0].field, parts[0].preview, arguments)
        self._keywords, self._begin, self._owned = keywords, begin, True
        self._rates: dict[tuple[Any, ...], Rate] = {}
        for field in {id(part.field): part.field for part in parts}.values():
            self.lease.frees(field.close)
        for part in {id(part): part for part in parts}.values():
            self.lease.frees(part.lease.close)

    @contextmanager
    def in_use(self) -> Iterator[None]:
        with ExitStack() as held:
            held.enter_context(self.lease.held())
            for part in self.parts.values():
                held.enter_context(part.in_use())
            yield

    @property
    def limits(self) -> tuple[float, float] | None:
        return None

    @property
    def sizes(self) -> bool:
        return any(part.sizes for part in self.parts.values())

    def levels(self) -> tuple[BrickedField, ...]:
        return tuple(level for part in self.parts.values() for level in part.levels())

    def recipe(self) -> tuple[tuple[Any, ...], dict[str, Any]]:
        return self.arguments, self._keywords

    def require_heard(self, mode: Mode, options: RefineOptions, outputs: Collection[str] = ("rgba",)) -> None:
        if mode.regions:
            raise OptionError(
                f"mode {mode.name!r} draws one label map; got a scene of {len(self.scene.media)} media: in composite, "
                "Medium(labels, smooth=True) shows them with others"
            )
        if virtual_samples(mode):
            raise OptionError(
                f"virtual must be 0 in a scene of several media, which have common samples; got {len(self.scene.media)}"
            )
        if options.get("lod", "auto") != "auto" and self.sizes:
            options = {name: value for name, value in options.items() if name != "lod"}  # type: ignore[assignment]  # it has them
        for part in self.parts.values():
            part.require_heard(mode, options)
        if mode.shows == "surface" and not mode.finished_there:
            raise OptionError(f"mode {mode.name!r} draws one medium: surfaces of several would hide each other out of order")
        projected = "depth", "normal", "position", "visited", "value", "pose"
        alone = "visited", "value", "pose"
        without = {"matter": ("normal", *alone), "surface": alone}.get(mode.shows, projected)
        refused = [name for name in outputs if name in without]
        if refused:
            raise OptionError(f"{' and '.join(refused)} of several media in {mode.name} would be of which? Draw one of them")

    def function(self, mode: Mode, level: int = 0) -> Field | BrickedField:
        return self.part(self.scene.media[0]).function(mode, level)

    def draw(self, look: ResolvedLook, fine: Fineness, guides: bool, progress: Progress | None) -> Pictures:
        return self._draw(look, fine, 0, guides, progress)

    def _draw(self, look: ResolvedLook, fine: Fineness, coarsest: int, guides: bool, progress: Progress | None) -> Pictures:
        """The picture; of media in several sizes none is finer than this level, if there is one so coarse."""
        if not look.others:
            return self._drawn_alone(look, fine, coarsest, guides, self._lit, progress)
        try:
            return self._drawn(look, fine, coarsest, guides, progress)
        except (ChunkError, MissingSampleError):  # by bricks, which only then showed that samples are missing
            left_out = [part.leave_out() for part in self.parts.values()]
            if not any(left_out):
                raise
            return self._drawn(look, fine, coarsest, guides, progress)

    def _drawn(self, look: ResolvedLook, fine: Fineness, coarsest: int, guides: bool, progress: Progress | None) -> Pictures:
        camera, view = look.placed(fine.size[0] / fine.size[1]).camera, look.view(fine.size)
        looks = tuple(one.seen_by(camera) for one in (look, *look.others))  # in place, whatever the level of a medium
        surfaces = look.mode.shows == "surface"

        def lit(_: ResolvedLook) -> Lit | None:
            return self._lit(look)

        if (look.unsettled or look.mode).shows == "matter":
            seen = [self._own(one).seen(one, fine, self._level(one, fine, view, coarsest), guides, lit) for one in looks]
            bricks = tuple(one.bricks for one in seen)
            bricked = Bricked(bricks, view, look.skipping) if any(field is not None for field in bricks) else None
            with ExitStack() as held:
                for each in seen:
                    held.enter_context(each.field.in_use())
                frame = _together(seen).frame(fine.size, fine.step, guides=guides)
                return launch.drawn(self._begin(frame, fine.rays, fine.filter, bricked=bricked), fine.rays, progress)
        background = look.scene.background
        pictures = []
        for i, one in enumerate(looks):
            own = replace(one, others=(), scene=replace(one.scene, background=None))
            part = part_of(progress, i / len(looks), (i + 1) / len(looks))
            pictures.append(self._drawn_alone(own, fine, coarsest, guides or surfaces, lit, part))
        together = (
            nearest(pictures, linear=look.linear)
            if surfaces
            else {"rgba": mixed([one["rgba"] for one in pictures], self.scene.mix)}
        )
        return {**together, "rgba": on(background, together["rgba"], linear=look.linear)}

    def refine(self, look: ResolvedLook, fine: Fineness, asked: Asked) -> Iterator[Refined]:
        looks = look, *look.others
        parts = [self._own(one) for one in looks]
        if (look.unsettled or look.mode).shows == "matter" and look.others and not any(part.by_bricks for part in parts):
            seen = [part.seen(one, fine, 0, False, lambda _: self._lit(look)) for part, one in zip(parts, looks, strict=True)]
            subject = _together(seen)
            return Refinement(Wanted(subject, fine.size, fine.step, fine.rays, fine.filter), asked, self._rates).pictures(
                self.in_use
            )

        def draw(level: int, report: Progress) -> launch.Picture:
            return self._draw(look, fine, level, False, report)["rgba"]

        view = look.view(fine.size)
        ends = [(part.level(fine, view), part.coarsest) for part in parts]
        finest, coarsest = min(level for level, _ in ends), max(level for _, level in ends)
        return refined_by_levels(draw, range(coarsest, finest - 1, -1), fine.step, asked, self.in_use)

    def uncertainty(self, mode: Mode) -> Uncertainty:  # noqa: ARG002
        raise OptionError('the output "uncertainty" takes a scene of one medium')

    def part(self, medium: Medium) -> OneMedium:
        return self.parts[_reconstructed(medium)]

    def _own(self, look: ResolvedLook) -> OneMedium:
        return self.part(look.scene.media[0])

    def _level(self, look: ResolvedLook, fine: Fineness, view: Viewpoint, coarsest: int) -> int:
        """The level of a medium, where none is to be finer than one."""
        part = self._own(look)
        return max(part.level(fine, view), min(coarsest, part.coarsest))

    def _drawn_alone(
        self, look: ResolvedLook, fine: Fineness, coarsest: int, guides: bool, lit: Lighting, progress: Progress | None
    ) -> Pictures:
        level = self._level(look, fine, look.view(fine.size), coarsest)
        return self._own(look).drawn(look, fine, level, guides, lit, progress)


def moving(source: Source, look: ResolvedLook, outputs: Collection[str]) -> ResolvedLook:
    """The same look, which has the output "pose" if it is wanted: `OptionError` unless that is known."""
    if "pose" not in outputs:
        return look
    row = source.filter_of(look.mode)
    if look.mode.shows != "integral":
        raise OptionError(f'the output "pose" is of line integrals: mode must be integral; got {look.mode.name!r}')
    if not row.has_gradient or look.central:
        raise OptionError(f'the output "pose" takes a filter with slopes, and its own gradient; got {row.name} or central ones')
    if not isinstance(source.field, Field) or source.field.gaps is not None:
        raise OptionError('the output "pose" takes a volume in memory that lacks no samples')
    if look.clip is not None:
        raise OptionError('the output "pose" is of whole volumes: clip must be None')
    return replace(look, mode=moved(look.mode))


def _together(seen: Sequence[Seen]) -> Subject:
    """Several media in one picture, of which the first leads."""
    first, *others = (one.subject for one in seen)
    return replace(first, others=tuple(others))


def _reconstructed(medium: Medium) -> tuple[Any, ...]:
    """What the function of a medium depends on, whatever its look."""
    return id(medium.volume), *medium.reconstruction
