"""The parameters of one picture: everything that its kernels read, computed in float64."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import OptionError
from clvol.base.kept import Once
from clvol.base.srgb import as_light
from clvol.base.uniform import FLOAT, INT, Block, copied
from clvol.device import Tile
from clvol.filter.filter import MAX_TAPS
from clvol.march.behind import ROW
from clvol.march.colored import COLORED, colors_of
from clvol.march.gaps import GAPS, gaps_block
from clvol.march.planes import SEGMENT, SLAB, Planes
from clvol.march.rails import RAILS, Rails
from clvol.march.shadow import CAST, LIT, cast_block
from clvol.scene.camera import Viewpoint
from clvol.scene.clip import CLIP, clip_block
from clvol.scene.factor import FACTORS, factors_block
from clvol.scene.joint import JOINT, joint_block
from clvol.scene.light import LIGHTS, Material, lights_block
from clvol.scene.mode import BY_DISTANCE, BY_LABEL, CURVATURES, colored_by, in_linear_light, moves, outlined, virtual_samples
from clvol.scene.scene import Medium
from clvol.scene.transfer import TransferFunction
from clvol.spline.build import along_defines, spared_taps
from clvol.spline.evaluator import DIRECT
from clvol.spline.minmax import BLOCK, MINMAX, minmax_block
from clvol.volume.stored import AS_THEY_ARE

if TYPE_CHECKING:
    from clvol.base.progress import Progress
    from clvol.base.uniform import Values
    from clvol.device import Device
    from clvol.device.program import Program
    from clvol.march.colored import Other
    from clvol.march.gaps import Gaps
    from clvol.march.options import ResolvedLook
    from clvol.march.shadow import Lit
    from clvol.scene.mode import Mode
    from clvol.spline.coefficients import Coefficients, Whole
    from clvol.spline.evaluator import Evaluator
    from clvol.spline.minmax import MinMax

__all__ = ["BY_PLANES", "BY_RAYS", "PICTURE", "WINDOW", "Frame", "Subject", "frame_block", "tile_of"]

BY_RAYS = Tile(1, 1, 1, shared=False)  # for GPUs, and if coefficients are not read as rows of a buffer
BY_PLANES = Tile(16, 16, 8, shared=True)  # for CPUs

_CONSTANTS = 8  # arguments in constant memory, at least
_STRETCHES = 2.0, 4 * SEGMENT  # voxels; step and segments of modes that search between samples

PICTURE = Block(
    "picture_block",
    offset=(FLOAT, 2),
    background=(FLOAT, 3),
    behind=(FLOAT, 3),  # the background as light
    weight=FLOAT,
    width=INT,
    height=INT,
    kept_from=(INT, 2),  # the pixels whose states and listed places are in buffers
    kept=(INT, 2),
    opaque=INT,
    linear=INT,  # colours are light
    listed=INT,
    **{"pass": INT, "last_pass": INT},
)

WINDOW = Block(  # the resident part of a volume that is read by bricks: window.cl
    "window_block",
    low=(FLOAT, 3),
    high=(FLOAT, 3),
    cells_from=(INT, 3),
    cells_to=(INT, 3),
    stored_from=(INT, 3),
    stored_to=(INT, 3),
    blocks_from=(INT, 3),
    whole=(INT, 3),
    margin=FLOAT,
)


@lru_cache
def frame_block(mode: Block) -> tuple[Block, str]:
    """The parameter block of a picture, and its declaration for the kernels."""
    block = Block(
        "frame_t",
        camera=Viewpoint.BLOCK,
        geometry=Medium.BLOCK,
        clip=CLIP,
        planes=Planes.BLOCK,
        rails=RAILS,
        transfer=TransferFunction.BLOCK,
        factors=FACTORS,
        joint=JOINT,
        material=Material.BLOCK,
        lights=LIGHTS,
        colored=COLORED,
        lit=LIT,
        cast=CAST,
        mode=mode,
        minmax=MINMAX,
        window=WINDOW,
        gaps=GAPS,
        picture=PICTURE,
    )
    return block, "// generated\n" + block.declaration()


@dataclass(frozen=True)
class Frame:
    """The parameters of a picture on a device."""

    coefficients: Coefficients | Whole
    minmax: MinMax | None  # if empty space is skipped
    gaps: Gaps | None  # if samples are missing
    sides: Any  # a buffer for the mode's isovalues, if it searches stretches and empty space is skipped
    mode: Mode  # settled for the medium's volume
    transfer: TransferFunction
    evaluator: Evaluator
    planes: Planes
    tile: Tile  # the rays of a work-item
    central: bool  # gradients are central differences
    labels: bool  # values are labels, whose differences are meaningless
    guides: bool  # are wanted too
    values: Values  # the parameter block
    table: NDArray[np.float32]  # the transfer function's nodes or pieces, and those of what else has colours
    other: Other | None = None  # another function, whose numbers follow
    lit: Lit | None = None  # what is left of lights, whose numbers follow
    casts: bool = False  # rays to lights find shadows
    media: tuple[Frame, ...] = ()  # of several media in one picture, of which this is the first, but all of their domain
    several: bool = False  # whether samples lie on planes that several media share
    margin: float = 0.0  # the rounding error of positions in samples, at most ...
    stride: float = 0.0  # ... and the most of them that a ray advances at a step
    once: Once[Any] = field(default_factory=Once, init=False, repr=False, compare=False)  # what its drawings have in common

    @property
    def device(self) -> Device:
        return self.coefficients.device

    def uploaded_table(self) -> Any:
        """The table on the device, and behind it the numbers of what else has colours."""
        *between, last = [one for one in (self.other, self.lit) if one is not None] or (None,)
        return self.device.buffers.upload(self.table) if last is None else last.table(self.table, tuple(between), self.device)

    @property
    def sought(self) -> tuple[float, ...] | None:
        """The stored values whose sides cells are on, or () for regions, which are all sought; None if modes do not ask."""
        if self.mode.regions:
            return ()
        return tuple(float(self.coefficients.stored(v)) for v in self.mode.isovalues) if self.mode.stretches else None

    @property
    def moves(self) -> bool:
        """Whether its kernels write how integrals change as the volume moves, in place of normals and positions."""
        return moves(self.mode)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        picture = self.values["picture"]
        return int(picture["width"]), int(picture["height"])

    def sampled(self, offset: NDArray[np.float64], weight: float, number: int, passes: int) -> Frame:
        """The frame for ray `number` of each pixel, at `offset` from its corner, with this weight."""
        return self._set(offset=offset, weight=weight, last_pass=passes - 1, **{"pass": number})

    def of_rays(self, width: int, height: int) -> Frame:
        """The frame of a list of rays through this picture, one for each pixel of another, with premultiplied colours."""
        size = width, height
        return self._set(listed=True, width=width, height=height, last_pass=1, kept=size)

    def kept(self, x: int, y: int, width: int, height: int) -> Frame:
        """The same frame, with states only for an area of whole tiles."""
        return self._set(kept_from=(x, y), kept=(width, height))

    def _set(self, **changes: Any) -> Frame:
        """A copy with changes in its picture's block, and in those of its media."""
        values = copied(self.values)
        for name, value in changes.items():
            values["picture"][name] = value
        return replace(self, values=values, media=tuple(medium._set(**changes) for medium in self.media))

    @property
    def together(self) -> bool:
        """Whether one program draws all media at once: on processors, for functions of one kind.

        Each has a constant argument, and so has the picture; OpenCL promises eight.
        """
        first, *others = self.media
        return (
            self.device.kind == "cpu"
            and not first.evaluator.image
            and len(self.media) < _CONSTANTS
            and all(
                one.mode.file == self.mode.file and one.defines(added=True) == first.defines(added=True) for one in (first, *others)
            )
        )

    def program(self, name: str, *, windowed: bool = False, added: bool = False, media: int = 0) -> Program:
        """A kernel file of the ray loop, specialised for this frame.

        `windowed`: for one brick of the volume at a time; `added`: samples are added to those of other media, `media` of them at
        once.
        """
        return self.once((name, windowed, added, media), lambda: self._built(name, windowed, added, media))  # type: ignore[no-any-return]

    def _built(self, name: str, windowed: bool, added: bool, media: int) -> Program:
        _, declaration = frame_block(self.mode.BLOCK)
        defines = self.defines(windowed=windowed, added=added) | ({"MEDIA": media} if media else {})
        return self.device.build(name, defines, {"mode.cl": self.mode.file}, {"frame.cl": declaration})

    def defines(self, *, windowed: bool = False, added: bool = False) -> dict[str, Any]:
        """The `#define`s of its programs."""
        tile, mode = self.tile, self.mode
        return {
            **self.coefficients.defines(self.evaluator),
            "LANES": tile.lanes,
            "TILE_WIDTH": tile.width,
            "TILE_HEIGHT": tile.height,
            "PLANES": int(tile.shared and not mode.regions),
            "ENDPOINTS": int(mode.endpoints),
            "SHADED": int(mode.shaded),
            "STATE_FIELDS": mode.state_fields,
            "CENTRAL": int(self.central),
            "LABELS": 3 if mode.regions else int(self.labels) * (2 if mode.shows == "surface" else 1),
            "GUIDES": int(self.guides),
            "BLOCK": BLOCK * self.coefficients.filter.scale,
            "SLAB": SLAB,
            "FINISHED_THERE": int(mode.finished_there),
            "GRADED": self.transfer.graded,
            "WINDOWED": int(windowed),
            "SEVERAL": int(self.several),
            "ADDED": int(added),
            "MISSING": int(self.gaps is not None),
            "CURVED": int((colored := colored_by(mode)) in CURVATURES),
            "OUTLINED": int(outlined(mode)),
            "BY_LABEL": int(colored == BY_LABEL and self.labels),
            "BY_DISTANCE": int(colored == BY_DISTANCE),
            "COLORED": int(self.other is not None),
            **({} if self.other is None else {"MOST_TAPS": MAX_TAPS}),
            **({} if self.lit is None else {"SHADOWED": self.lit.rows}),
            **({"CAST": 1} if self.casts else {}),
            **({"BETWEEN": 1} if virtual_samples(mode) else {}),
            "COORD_DOUBLE": 0,
            **({"SPARED": spared_taps(self.coefficients.filter)} if mode.regions else {}),
            **(along_defines(self.coefficients.filter) if mode.stretches else {}),
        }


class _Still(NamedTuple):
    """What pictures of a look have in common, whatever their size and wherever it is seen from."""

    block: Block
    values: Values
    picture: Values
    table: NDArray[np.float32]
    slope: float  # what kernels multiply gradients by


@dataclass(frozen=True)
class Subject:
    """A look of a resident function: everything for a frame except size and step."""

    look: ResolvedLook
    coefficients: Coefficients | Whole
    minmax: MinMax | None
    evaluator: Evaluator
    gaps: Gaps | None = None
    other: Other | None = None  # what colours it
    lit: Lit | None = None  # what is left of its lights, if it casts shadows
    others: tuple[Subject, ...] = ()  # media of the same picture; the grid of the first one leads

    @property
    def central(self) -> bool:
        """Whether gradients are central differences."""
        return self.look.central or not self.coefficients.filter.has_gradient

    @property
    def mode(self) -> Mode:
        """The mode of the picture: of several media, some may show surfaces in it."""
        return (self.look.unsettled if self.others else None) or self.look.mode

    @property
    def parts(self) -> tuple[Any, ...]:
        """What it is made of beside its look and others."""
        return self.coefficients, self.minmax, self.evaluator, self.gaps, self.other, self.lit

    @property
    def medium(self) -> Medium:
        """The medium of the look."""
        return self.look.scene.media[0]

    def frame(
        self,
        size: tuple[int, int],
        step: float,
        *,
        guides: bool = False,
        aspect: float | None = None,
        progress: Progress | None = None,
    ) -> Frame:
        """The frame for a size.

        `aspect` is ``width / height`` of the displayed picture, if it differs slightly from this one's. `progress` is called
        during long computations, and may raise.
        """
        aspect = size[0] / size[1] if aspect is None else aspect
        look, volume = self.look.placed(aspect), self.medium.volume
        view = look.camera.view(volume, aspect)
        if self.others:
            media = self, *self.others
            rails = Rails.across([one.medium for one in media], view, aspect, step)
            frames = tuple(one._searched(one._frame(size, guides, aspect, view, rails), progress) for one in media)
            plain = look.scene.of_media([replace(self.medium, color_by=None)]) if self.other else look.scene
            unlit = replace(self, look=replace(look, mode=self.mode, scene=plain), lit=None)
            mixed = unlit._frame(size, guides, aspect, view, rails)
            values = copied(mixed.values)
            values["geometry"]["low"], values["geometry"]["high"] = rails.low, rails.high
            values["clip"] = clip_block(look.scene.clip, volume, volume.mean_spacing)
            return replace(mixed, values=values, media=frames)
        rails = Rails.along(volume, Planes(volume, view, aspect, *(_STRETCHES if look.mode.stretches else (step, SEGMENT))))
        return self._searched(replace(self, look=look)._frame(size, guides, aspect, view, rails), progress)

    def _searched(self, made: Frame, progress: Progress | None) -> Frame:
        """A frame with what is known of its cells, if surfaces are searched for in them."""
        if self.minmax is None or (sought := made.sought) is None:
            return made
        return replace(made, sides=self.minmax.sides(sought, progress))

    def _frame(self, size: tuple[int, int], guides: bool, aspect: float, view: Viewpoint, rails: Rails) -> Frame:
        """The frame of this medium alone, with samples on these rails."""
        look, minmax, scene, volume = self.look, self.minmax, self.look.scene, self.medium.volume
        (width, height), unit = size, rails.volume.mean_spacing
        margin = rails.margin(volume, view, aspect)
        still = look.once((*self.parts, unit), lambda: self._still(unit))
        values = still.block.changed(
            still.values,
            camera=view.block(volume, width, height, aspect, rails=rails.volume),
            planes=rails.planes.block(),
            rails=rails.block(volume, view, width, height, aspect),
            lights=lights_block(scene.lights, view),
            minmax=minmax_block(minmax, volume, margin, still.slope),
            cast=cast_block(scene, unit, view.reach(volume, aspect)) if look.sends_rays else np.zeros((), CAST.dtype),
            picture=PICTURE.changed(still.picture, width=width, height=height, kept=size),
        )
        return Frame(
            self.coefficients,
            minmax,
            self.gaps,
            None,
            look.mode,
            look.transfer,
            self.evaluator,
            rails.planes,
            tile_of(self.coefficients.device, self.evaluator),
            self.central,
            volume.is_labels and not self.coefficients.filter.has_gradient,
            guides,
            values,
            still.table,
            other=self.other if self.medium.color_by is not None else None,
            lit=self.lit,
            casts=look.sends_rays,
            several=rails.several,
            margin=margin,
            stride=rails.stride(volume),
        )

    def _still(self, unit: float) -> _Still:
        """What frames of this medium have in common; `unit` is the kernels' unit of length."""
        look, coefficients = self.look, self.coefficients
        scene, mode, stored, medium = look.scene, look.mode, coefficients.stored, self.medium
        volume, transfer, of_shape = medium.volume, look.transfer, colored_by(mode) in (*CURVATURES, BY_DISTANCE)
        shown = AS_THEY_ARE if of_shape or mode.shows == "integral" else stored  # values that colours are of
        if transfer.unit_distance is None:
            transfer = replace(transfer, unit_distance=volume.mean_spacing)
        block, _ = frame_block(mode.BLOCK)
        if transfer.curvature_opacity and coefficients.filter.continuity < 1:
            raise OptionError(
                f"curvature_opacity takes a filter with continuous slopes, such as bspline3; got {coefficients.filter.name}"
            )
        slope = medium.gradient_scale(stored, unit)  # of kernels, for 1 of stored values in the world
        linear = look.linear
        table, colored = look.transfer.table(shown, linear=linear), np.zeros((), COLORED.dtype)
        if medium.color_by is not None:
            assert self.other is not None
            colored, table = colors_of(medium, self.other, table, linear=linear)
        lit = np.zeros((), LIT.dtype)
        if self.lit is not None:
            lit = self.lit.block(look.swept, table.size + -table.size % ROW + (self.other.size if self.other is not None else 0))
        picture = PICTURE(
            offset=0.5,
            background=scene.background or 0.0,
            behind=as_light(scene.background or 0.0) if linear else scene.background or 0.0,
            weight=1.0,
            width=0,
            height=0,
            kept_from=0,
            kept=0,
            opaque=scene.background is not None,
            linear=linear,
            listed=0,
            **{"pass": 0, "last_pass": 0},
        )
        values = block.changed(
            np.zeros((), block.dtype),
            geometry=medium.block(stored, unit),
            clip=clip_block(look.clip, volume, unit),
            transfer=transfer.block(unit, shown, linear=linear),
            factors=factors_block(((transfer.gradient_opacity, slope, stored.exponent), (transfer.curvature_opacity, 1.0, 0))),
            joint=joint_block(transfer, stored, slope, linear=linear),
            colored=colored,
            lit=lit,
            material=medium.material.block(linear=linear),
            mode=(in_linear_light(mode) if linear else mode).block(volume, stored),
            gaps=gaps_block(self.gaps),
        )
        return _Still(block, values, picture, table, slope)

    def placed(self, aspect: float) -> Subject:
        """The same with a fitted camera, if its position was left open."""
        return replace(self, look=self.look.placed(aspect))


def tile_of(device: Device, evaluator: Evaluator) -> Tile:
    """The device's limit, else blended planes for CPUs that read rows of taps from a buffer."""
    if device.limits.tile is not None:
        return Tile(*device.limits.tile)
    return BY_PLANES if device.kind == "cpu" and evaluator == DIRECT else BY_RAYS
