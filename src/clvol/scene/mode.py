"""Render modes: a class here, a file in ``cl/modes/``, a function in `clvol.reference.march`.

A mode's options are its fields: `Renderer.render` takes them as keywords, the command line as flags. An option of another
mode raises an error that names it, and so does one that changes nothing in the mode (`Mode.unheard`).
"""

from __future__ import annotations

import inspect
import itertools
import math
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray

from clvol.base.checks import did_you_mean, number, one_of, whole
from clvol.base.color import color_of
from clvol.base.errors import DataError, OptionError
from clvol.base.scaling import share_of
from clvol.base.shown import Named
from clvol.base.srgb import as_light
from clvol.base.uniform import FLOAT, INT, Block, Values
from clvol.filter.table import DEFAULT_FILTER, PICTURE_FILTER, REGION_FILTER, as_filter
from clvol.scene.preset import diverging
from clvol.scene.transfer import TransferFunction
from clvol.volume.histogram import Projection, clims_of, integrals_of, isovalue_of, matter_of, spread_of
from clvol.volume.stored import AS_THEY_ARE, Stored
from clvol.volume.volume import Volume

__all__ = [
    "BY_DISTANCE",
    "BY_LABEL",
    "CURVATURES",
    "DEFAULT_MODE",
    "MOST_VIRTUAL",
    "Attenuated",
    "Composite",
    "Integral",
    "Isosurface",
    "Mean",
    "Minip",
    "Mip",
    "Mode",
    "ModeTable",
    "Regions",
    "Surfaces",
    "as_mode",
    "colored_by",
    "every_option",
    "heard_options",
    "in_linear_light",
    "mode_options",
    "modes",
    "moved",
    "moves",
    "opacities_of",
    "outlined",
    "require_heard",
    "tolerance_of",
    "virtual_samples",
    "without_tolerance",
]

DEFAULT_MODE = "composite"
_WORD = re.compile("[a-z][a-z0-9_]{0,63}")
_FILE = re.compile(f"modes/{_WORD.pattern}[.]cl")
_FIELD = re.compile("[A-Za-z_][A-Za-z0-9_]{0,63}")
_SIGMAS = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(?:sigma|σ)\s*", re.IGNORECASE | re.ASCII)
_REMEMBERED = 10  # numbers of state, of the last two samples
_MOST_FIELDS = 64  # largest number of fields in a ray's state
_MOST_SURFACES = 8
_GAUSSIAN = "gaussian curvature"
CURVATURES = ("k1", "k2", "mean curvature", _GAUSSIAN)
"""What surfaces may be coloured by, in the order of curvature.cl ..."""
BY_DISTANCE = "distance"
"""... and by how far away they are."""
BY_LABEL = "label"
"""What colours surfaces of labels, unless they are given a colour."""
_LOOKS: dict[str, Any] = {"cap": INT, "cap_color": (FLOAT, 3), "outline": FLOAT, "curvature": INT}  # of modes that show surfaces
_BENT = 1 / 8  # the curvature of the strongest colours, times the spacing
_BONE, _RED = (0.93, 0.87, 0.76), (0.80, 0.25, 0.20)
_SHOWN = ("matter", "surface", "max", "min", "mean", "integral")
_AIR = -1000.0  # Hounsfield units
_LARGEST = 1e36  # integrals
_RESIDUE = 2.0**-24  # a share of the largest value that a sum in float32 does not have
_ROUNDING = 2.0**-14  # a share of values that bounds of blocks may be off by, of cubic splines
_SOUGHT = ("largest", "smallest", "any")


@dataclass(frozen=True)
class Mode:
    """A way to compute a pixel from the samples along its ray.

    Attributes
    ----------
    name : str
        Its name in the table; its kernel file is ``modes/<name>.cl``.
    description : str
        What it shows, for listings.
    state_fields : int
        Numbers of state that kernels carry along each ray.
    endpoints : bool
        Whether its rays include the points where they enter and leave the volume: sampling modes then take two
        more samples, a thousandth of a step inside.
    skips : bool
        Whether some values can be irrelevant to it, so that space is skipped.
    capped : bool
        Whether it shows something on the faces of a cut.
    finished_there : bool
        Whether its kernel computes the colour at the end of a ray from the coefficients there.
    picture_filter : str
        Default filter of its pictures. It smooths noise, except in modes that show extremes: smoothing lowers
        those of thin vessels.
    shows : {"matter", "surface", "max", "min", "mean", "integral"}
        What a pixel shows of a ray's samples: all of them, by opacity; the first crossing of the isovalue, `surface`; or a
        projection, which the default transfer function shows from black to white. An "integral" is no value of the data.
    seeks : {"largest", "smallest", "any"}
        Which values decide its pixels. Bricks that may contain them come first in the access order; "any": front to back.
    ramp : float
        The share of that range over which it does.
    regions : bool
        Whether it shows the smooth regions of labels: the value of a place is the label of its region.
    grades : bool
        Whether opacity may depend on more than the value: on the gradient, and on curvature.
    """

    name: ClassVar[str]
    description: ClassVar[str]
    state_fields: ClassVar[int]
    endpoints: ClassVar[bool] = False
    skips: ClassVar[bool] = True
    capped: ClassVar[bool] = False
    finished_there: ClassVar[bool] = False
    picture_filter: ClassVar[str] = PICTURE_FILTER
    shows: ClassVar[Literal["matter", "surface"] | Projection] = "max"
    seeks: ClassVar[Literal["largest", "smallest", "any"]] = "any"
    ramp: ClassVar[float] = 1.0
    regions: ClassVar[bool] = False
    grades: ClassVar[bool] = False
    BLOCK: ClassVar[Block] = Block("mode_block")

    @property
    def file(self) -> str:
        """The kernel file."""
        return f"modes/{self.name}.cl"

    @property
    def stretches(self) -> bool:
        """Whether its kernel processes intervals of rays, not samples; `step` then has no effect."""
        return False

    @property
    def shaded(self) -> bool:
        """Whether it uses gradient shading."""
        return bool(getattr(self, "shading", False))

    @property
    def isovalues(self) -> tuple[float, ...]:
        """Those of a settled mode's surfaces, in ascending order; none for modes that show no surface."""
        return ()

    @property
    def unheard(self) -> Mapping[str, str]:
        """Options, of pictures and its own, that change no colour of its pictures, each with the reason."""
        of_shading = ("material", "lights", "shadow", "shadow_rays", "occlusion", "gradient")
        found = {} if self.shaded else dict.fromkeys(of_shading, "nothing is shaded")
        if self.shaded and not (self.shows == "surface" and self.stretches):
            found["shadow_rays"] = "rays are of exact surfaces, of modes isosurface and surfaces"
        if not self.grades:
            found |= dict.fromkeys(("gradient_opacity", "curvature_opacity"), "they are of matter, in composite")
        lit = self.shaded or self.shows == "matter"
        return found if lit else {**found, "linear_light": "colours are those of single values"}

    def interval_matters(self, low: float, high: float, transfer: TransferFunction) -> bool:  # noqa: ARG002  # most cannot decide
        """Whether values from `low` to `high`, in units of the data, can affect a picture; if not, bricks are skipped."""
        return True

    def between_samples(self, *, guides: bool) -> str:  # noqa: ARG002  # most modes use single samples
        """The part of its pictures that depends on pairs of neighbouring samples, in words; "" if none.

        The margin of a brick is limited, which limits the step. `guides`: depth, normals and positions are rendered.
        """
        return ""

    def unmergeable(self, *, guides: bool, smooth: bool) -> str:  # noqa: ARG002  # most modes can merge
        """The part of its pictures that merging of separately rendered ray intervals would change, and why; "" if none.

        `smooth`: the filter blends neighbouring samples; only "nearest" does not.
        """
        return ""

    def settled(self, volume: Volume) -> Self:  # noqa: ARG002  # most modes have no automatic option
        """A copy with all automatic options set for this volume."""
        return self

    def transfer(self, volume: Volume) -> TransferFunction:
        """The default transfer function for this volume.

        Labels have a colour each, but where values are blended or fade along the ray. A projection's range is the volume's own
        (`Volume.clim`), or else from the projections of its samples along the axes; a volume's `clim` is not for means and
        integrals. Curvatures
        are shown from blue, where a surface is hollow, to red, both in full where it bends like a ball of 8 samples; distances in
        viridis.
        """
        if volume.is_labels and self.shows not in ("mean", "integral") and self.ramp == 1:
            return TransferFunction.preset("labels", volume)
        return self.transfer_within(volume, None)

    def transfer_within(self, volume: Volume, clim: tuple[float, float] | None) -> TransferFunction:
        """The same for values, from black to white between `clim`, (low, high), if it is given."""
        if self.shows == "matter":
            return TransferFunction.automatic(volume, clim)
        if isinstance(self, Integral):
            return TransferFunction.ramp(clim or integrals_of(volume, self.height), volume.color or (1.0, 1.0, 1.0))
        if colored_by(self) in CURVATURES:
            most = (_BENT / volume.mean_spacing) ** (2 if colored_by(self) == _GAUSSIAN else 1)
            return TransferFunction.from_cmap("matplotlib:coolwarm", clim or (-most, most))
        if colored_by(self) == BY_DISTANCE:
            return TransferFunction.from_cmap("viridis", clim or (-(most := volume.radius / math.sqrt(3)), most))
        matter = matter_of(volume)
        if self.shows == "surface":  # whose caps are slices: from the background to the brightest
            usual = matter.value(matter.top, -1 if matter.signed else 1), matter.value(matter.top if matter.signed else 0)
            low, high = clim or volume.clim or sorted(usual)
        else:
            low, high = clim or (volume.clim if self.shows != "mean" else None) or clims_of(volume)[self.shows]
        if matter.signed and clim is None and self.shows == "mean":
            return TransferFunction(diverging((low, high), matter.value(0)), ((low, 1.0),))
        color = volume.color or (1.0, 1.0, 1.0)
        if matter.signed and clim is None and self.shows == "min":  # the farther below the background, the brighter
            return TransferFunction(((low, color), (high, (0.0, 0.0, 0.0))), ((low, 1.0),))
        return TransferFunction.ramp((low, share_of(low, high, self.ramp)), color)

    def block(self, volume: Volume, stored: Stored = AS_THEY_ARE) -> Values:  # noqa: ARG002  # most need no volume
        """The block of a settled mode for its kernel, for one volume with values stored as in `stored`."""
        return self.BLOCK()


MOST_VIRTUAL = 16
"""Most virtual samples between two."""


@dataclass(frozen=True)
class Composite(Mode):
    """Emission and absorption, front to back.

    Parameters
    ----------
    shading : bool
        Gradient shading of the matter.
    termination : float
        A ray ends when its transmittance falls to this value, at least 0 and less than 1. The error of colours is at
        most this times the brightest colour behind.
    cap : bool, optional
        Whether the faces of a cut (`clip`) show the slice: the colours of the values there, unlit, as opaque as matter of 16 unit
        distances. By default where matter is lit (`shading`): light has no meaning on such a face, and shows the noise.
    virtual : int, optional
        Virtual samples between two of `step`, 0 to 16. By default 0, and as many as narrow bands of opacity need where `step` and
        `tolerance` are left out, if there can be some. With 0 each sample stands for its stretch of the ray, with one value and one
        light. Else matter is that of the virtual ones: their values are Hermite's, from the values and slopes at both samples, and
        their gradients lie on the parabola through those of the last three, so that thin shells are smooth with any step. Of one
        volume in memory, with a filter that has a gradient.
    tolerance : float, optional
        In place of `step`: how far a picture may be from that of the finest steps, above 0 and at most 1, as the root of the mean
        square of the differences of its colours (0..1, as they are shown) where it shows matter. Small pictures of the same view
        tell how long steps may be, from 1 voxel to 1/64; a picture's `recipe` has the step. It is an estimate: see
        `clvol.march.tolerance`.

    References
    ----------
    - M. Levoy, "Display of surfaces from volume data", IEEE Computer Graphics and Applications 8(3), 1988, 29–37: reference
      [7] of the paper.
    - N. Max, "Optical models for direct volume rendering", IEEE Transactions on Visualization and Computer Graphics 1(2),
      1995, 99–108.
    """

    shading: bool = True
    termination: float = 1e-3
    cap: bool | None = None
    virtual: int | None = None
    tolerance: float | None = None

    name: ClassVar[str] = "composite"
    description: ClassVar[str] = "emission and absorption, front to back"
    grades: ClassVar[bool] = True
    state_fields: ClassVar[int] = 6
    shows: ClassVar[Literal["matter", "surface"] | Projection] = "matter"
    BLOCK: ClassVar[Block] = Block("mode_block", termination=FLOAT, cap=INT, between=INT)

    def __post_init__(self) -> None:
        _set(self, shading=_switch("shading", self.shading))
        _set(self, termination=number("termination", self.termination, minimum=0, below=1))
        if self.cap is not None:
            _set(self, cap=_switch("cap", self.cap))
        _set(self, capped=self.shading if self.cap is None else self.cap)
        virtual: object = self.virtual  # shells and viewers have floats for all numbers of modes
        if isinstance(virtual, float) and virtual.is_integer():
            virtual = int(virtual)
        if virtual is not None:
            _set(self, virtual=whole("virtual", virtual, minimum=0, maximum=MOST_VIRTUAL))
        if self.tolerance is not None:
            _set(self, tolerance=number("tolerance", self.tolerance, above=0, maximum=1))
        if self.virtual:
            _set(self, endpoints=True, state_fields=type(self).state_fields + _REMEMBERED)

    def interval_matters(self, low: float, high: float, transfer: TransferFunction) -> bool:
        return transfer.opacity_within(low, high) > 0

    def between_samples(self, *, guides: bool) -> str:
        return "the depth and normals of matter" if guides else ""

    def unmergeable(self, *, guides: bool, smooth: bool) -> str:  # noqa: ARG002
        return "the depth and normals of matter, which depend on transmittance" if guides else ""

    def block(self, volume: Volume, stored: Stored = AS_THEY_ARE) -> Values:  # noqa: ARG002
        return self.BLOCK(termination=self.termination, cap=self.capped, between=self.virtual or 0)


@dataclass(frozen=True)
class _OfSurfaces(Mode):
    """What modes have in common that show isosurfaces: caps, and colours by curvature."""

    endpoints: ClassVar[bool] = True
    shows: ClassVar[Literal["matter", "surface"] | Projection] = "surface"

    def in_linear_light(self) -> Self:
        """The same, settled, with colours of its own that are light (`clvol.base.srgb.as_light`)."""
        looks: dict[str, Any] = {"cap": cap if isinstance(cap := getattr(self, "cap", False), bool) else _light(cap)}
        return replace(self, **looks)

    def interval_matters(self, low: float, high: float, transfer: TransferFunction) -> bool:  # noqa: ARG002
        values = self.isovalues  # settled
        return any(low <= value <= high for value in values) or (self.capped and high >= values[0])

    def _set_looks(self, shading: object, cap: object, color_by: str | None, outline: float) -> None:
        """Set what their constructors are given."""
        cap = _cap(cap)
        _set(self, outline=number("outline", outline, minimum=0, maximum=100))
        _set(self, shading=_switch("shading", shading), cap=cap, capped=cap is not False, color_by=_color_by(color_by, cap))


@dataclass(frozen=True)
class Isosurface(_OfSurfaces):
    """The first isosurface along the ray, shaded.

    Parameters
    ----------
    isovalue : float or str, optional
        The value of the surface; by default Otsu's threshold of the histogram, but never within the step at the
        edge of a mask. "3sigma" (or "3σ", "-1.5 sigma") is the mean of all finite samples plus 3 of their standard
        deviations, as maps of electron microscopy and crystallography are shown; of a volume larger than memory, of those of
        its `LazyVolume.preview`.
    color : three numbers or a name
        Colour of the surface: red, green and blue in 0..1, a name or a hex code. Labels have those of the transfer function, unless
        there is another here.
    shading : bool
        Gradient shading of the surface.
    method : {"exact", "stepped"}
        "exact": the first crossing of the isovalue by the function, a polynomial along the ray in every cell; `step` has no
        effect. "stepped": the first two neighbouring samples on both sides of the isovalue, and a root between
        them; misses a surface that the ray enters and leaves between two samples. Both take
        about the same time with most filters; with "lanczos" and "sinc", whose pieces have degree 12, "exact" takes 9 to 19 times
        as long.
    tolerance : float
        For "stepped": tolerance of the function at the surface, relative to the difference between the two samples
        around it, 0 to 1. That of "composite" is of a picture's colours.
    cap : bool, three numbers or a name
        Closes what a cut (`clip`) opens, where values are not below the isovalue, with an unlit face. True: it shows the slice,
        in the colours of the transfer function, which `window` and `cmap` choose. A colour: it has that.
    color_by : {"k1", "k2", "mean curvature", "gaussian curvature", "distance"}, optional
        Colours the surface by its curvature, from the exact derivatives of the function: the larger or the smaller principal one,
        their mean or their product, per world unit (squared). It is positive where the surface bends as that of a bright ball.
        `transfer`, `window` and `cmap` are then those of curvatures. "distance": by how far behind the middle of the volume it is,
        along the ray, in world units; negative in front of it. "label" stands for the colours of labels. Another volume
        colours a medium: `Medium.color_by`.
    outline : float
        Thickness in pixels of a dark line along its rim as it is seen, also in front of other parts of it; from its exact curvature
        along the ray (Kindlmann et al., 2003), so that it is as thick everywhere. 0: none.

    References
    ----------
    - G. Kindlmann, R. Whitaker, T. Tasdizen and T. Möller, "Curvature-based transfer functions for direct volume rendering:
      methods and applications", IEEE Visualization 2003, 513–520.

    Examples
    --------
    >>> import clvol
    >>> ball = clvol.phantoms.sphere(24)
    >>> picture = clvol.render(ball, mode=clvol.Isosurface(isovalue=0.5, color="bisque"), size=(48, 48))
    >>> same = clvol.render(ball, mode="isosurface", isovalue=0.5, color="bisque", size=(48, 48))
    """

    isovalue: float | str | None = None
    color: Sequence[float] | str = _BONE
    shading: bool = True
    method: Literal["exact", "stepped"] = "exact"
    tolerance: float = 1e-4
    cap: bool | Sequence[float] | str = False
    color_by: Literal["k1", "k2", "mean curvature", "gaussian curvature", "distance", "label"] | None = None
    outline: float = 0.0

    name: ClassVar[str] = "isosurface"
    description: ClassVar[str] = "the first isosurface along the ray, shaded"
    state_fields: ClassVar[int] = 2
    finished_there: ClassVar[bool] = True
    BLOCK: ClassVar[Block] = Block("mode_block", isovalue=FLOAT, tolerance=FLOAT, color=(FLOAT, 3), **_LOOKS)

    def __post_init__(self) -> None:
        if isinstance(self.isovalue, str):
            _sigmas(self.isovalue)
        elif self.isovalue is not None:
            _set(self, isovalue=number("isovalue", self.isovalue))
        _set(self, color=color_of("color", self.color))
        self._set_looks(self.shading, self.cap, self.color_by, self.outline)
        _set(self, tolerance=number("tolerance", self.tolerance, minimum=0, maximum=1))
        if not isinstance(self.method, str) or self.method not in ("exact", "stepped"):
            raise one_of("method", self.method, ("exact", "stepped"))
        if self.method == "stepped":
            _set(self, state_fields=4)  # with the last sample

    @property
    def file(self) -> str:
        return "modes/isosurface.cl" if self.method == "exact" else "modes/stepped.cl"

    @property
    def stretches(self) -> bool:
        return self.method == "exact"

    @property
    def isovalues(self) -> tuple[float, ...]:
        return (self.isovalue,) if isinstance(self.isovalue, float) else ()

    def in_linear_light(self) -> Self:
        return replace(super().in_linear_light(), color=_light(self.color))

    @property
    def unheard(self) -> Mapping[str, str]:
        exact = {"tolerance": 'method="exact" needs none'} if self.method == "exact" else {}
        own = {"color": "color_by chooses the colours"} if self.color_by else {}
        return {**super().unheard, **_uncolored(self.cap, self.color_by), **exact, **own}

    def between_samples(self, *, guides: bool) -> str:  # noqa: ARG002
        return "" if self.stretches else "stepped surfaces"

    def unmergeable(self, *, guides: bool, smooth: bool) -> str:  # noqa: ARG002
        between = not (self.stretches and smooth)
        return "surfaces of method 'stepped' or between labels, which are between two samples" if between else ""

    def settled(self, volume: Volume) -> Self:
        value = isovalue_of(volume)[0] if self.isovalue is None else _isovalue(self.isovalue, volume)
        if self.color_by == BY_LABEL and not volume.is_labels:
            raise OptionError(f'color_by="{BY_LABEL}" takes a volume of labels; got one of other samples')
        own = volume.is_labels and self.color == _BONE and self.color_by is None
        return replace(self, isovalue=value, color_by="label" if own else self.color_by)

    def block(self, volume: Volume, stored: Stored = AS_THEY_ARE) -> Values:  # noqa: ARG002
        (surface,) = (stored(value) for value in self.isovalues)  # settled
        looks = _looks_block(self.cap, self.color_by, self.outline)
        return self.BLOCK(isovalue=surface, tolerance=self.tolerance, color=self.color, **looks)


@dataclass(frozen=True)
class Surfaces(_OfSurfaces):
    """Several isosurfaces inside each other, translucent or not: every crossing along the ray, in order.

    Each is exact, as by `Isosurface`, so that thin shells have both of their sides; `step` has no effect. A surface stops its share
    of light at each crossing, from whichever side and at whichever angle.

    Parameters
    ----------
    surfaces : sequence of (value, color, opacity) or str, optional
        1 to 8 surfaces: the isovalue, a number or as "3sigma" of `Isosurface`; red, green and blue in 0..1, a name or a hex code;
        and the opacity, which is the share of light that each crossing stops, 0 to 1, by default 1. As text the same:
        ``"300:bisque:0.3,1200:white"``. By default two: that of `Isosurface`, translucent, and one halfway from there to the
        brightest matter.
    shading : bool
        Gradient shading of the surfaces.
    cap : bool, three numbers or a name
        Closes what a cut (`clip`) opens, where values are not below the lowest isovalue, with an unlit, opaque face. True: it shows
        the slice, in the colours of the transfer function, which `window` and `cmap` choose. A colour: it has that.
    color_by : {"k1", "k2", "mean curvature", "gaussian curvature", "distance"}, optional
        Colours all surfaces by their curvature or distance instead, as of `Isosurface`; opacities stay.
    outline : float
        Thickness in pixels of a dark line along their rims as they are seen, also in front of other parts of them; from their exact
        curvature along the ray (Kindlmann et al., 2003), so that it is as thick everywhere. 0: none.

    Examples
    --------
    >>> import clvol
    >>> volume = clvol.phantoms.marschner_lobb(40)
    >>> picture = clvol.render(volume, mode="surfaces", surfaces=[(0.3, "bisque", 0.4), (0.6, "firebrick", 1)], size=(64, 64))
    """

    surfaces: Sequence[tuple[float | str, Sequence[float] | str, float]] | str | None = None
    shading: bool = True
    cap: bool | Sequence[float] | str = False
    color_by: Literal["k1", "k2", "mean curvature", "gaussian curvature", "distance"] | None = None
    outline: float = 0.0

    name: ClassVar[str] = "surfaces"
    description: ClassVar[str] = "several translucent isosurfaces inside each other, shaded"
    state_fields: ClassVar[int] = 8
    stretches: ClassVar[bool] = True
    BLOCK: ClassVar[Block] = Block(
        "mode_block", isovalue=FLOAT, count=INT, isovalues=(FLOAT, _MOST_SURFACES), colors=(FLOAT, 4 * _MOST_SURFACES), **_LOOKS
    )

    def __post_init__(self) -> None:
        if self.surfaces is not None:
            _set(self, surfaces=_surfaces(self.surfaces))
        self._set_looks(self.shading, self.cap, self.color_by, self.outline)
        if self.color_by == BY_LABEL:
            raise one_of("color_by", self.color_by, (*CURVATURES, BY_DISTANCE))

    @property
    def isovalues(self) -> tuple[float, ...]:
        values = [surface[0] for surface in self.surfaces or ()]
        numbers = tuple(value for value in values if isinstance(value, float))
        return numbers if len(numbers) == len(values) else ()

    def in_linear_light(self) -> Self:
        assert isinstance(self.surfaces, tuple)  # settled
        surfaces = [(value, _light(color), opacity) for value, color, opacity in self.surfaces]
        return replace(super().in_linear_light(), surfaces=surfaces)

    @property
    def unheard(self) -> Mapping[str, str]:
        found = {**super().unheard, **_uncolored(self.cap, self.color_by)}
        found.pop("linear_light", None)  # unlit surfaces are still seen through each other
        return found

    def between_samples(self, *, guides: bool) -> str:
        return "the depth and normals of translucent surfaces" if guides else ""

    def unmergeable(self, *, guides: bool, smooth: bool) -> str:
        between = "" if smooth else "surfaces of a function that jumps, which are between two samples"
        return "the depth and normals of surfaces, which depend on transmittance" if guides else between

    def settled(self, volume: Volume) -> Self:
        if volume.is_labels:
            raise OptionError("surfaces are of a function, and labels are names: draw them by mode 'isosurface' or 'composite'")
        if self.surfaces is None:
            outer, top = isovalue_of(volume)[0], matter_of(volume)
            inner = (outer + top.value(top.top)) / 2
            return replace(self, surfaces=((outer, _BONE, 0.3), (inner, _RED, 1.0))[: 1 + (inner != outer)])
        assert isinstance(self.surfaces, tuple)  # not text
        known = sorted((_isovalue(value, volume), *look) for value, *look in self.surfaces)
        for one, other in itertools.pairwise(known):
            if one[0] == other[0]:
                raise OptionError(f"surfaces must have different isovalues; got {one[0]:g} twice")
        return replace(self, surfaces=tuple(known))

    def block(self, volume: Volume, stored: Stored = AS_THEY_ARE) -> Values:  # noqa: ARG002
        values, colors = np.zeros(_MOST_SURFACES, np.float32), np.zeros((_MOST_SURFACES, 4), np.float32)
        assert isinstance(self.surfaces, tuple)  # settled
        for k, (value, color, opacity) in enumerate(self.surfaces):
            values[k], colors[k] = stored(value), (*color, opacity)
        looks = _looks_block(self.cap, self.color_by, self.outline)
        return self.BLOCK(isovalue=values[0], count=len(self.surfaces), isovalues=values, colors=colors.ravel(), **looks)


@dataclass(frozen=True)
class Regions(Mode):
    """The regions of labels with smooth boundaries, shaded: every region that a ray enters, in order.

    The indicator of a label is 1 at its samples and 0 at others. A B-spline without a prefilter makes of each a smooth
    function, and a place belongs to the label whose function is largest there, or of equal ones to the smallest. No indicator
    is stored, so that there may be thousands of labels. Where a ray enters a region, it shows the colour of the transfer
    function for its label and stops the share of light that is its opacity there; opaque by default, except the background.
    Regions that are transparent are passed through. Where the volume or a cut begins inside a region, its face is unlit.

    Whatever is two samples thick is seen, though smaller. Of what is one thick, plates are, by a weight of 66/120 with the
    default, "bspline5-approx"; rods (.30) and single samples (.17) are lost to one other label that has the rest, also with
    ``filter="bspline3-approx"`` (.44, .30); ``filter="linear"`` keeps all.

    Parameters
    ----------
    shading : bool
        Light on the boundaries, by the gradient of the difference between the functions of the labels on both sides.

    Examples
    --------
    >>> import clvol
    >>> import numpy as np
    >>> z, y, x = np.indices((24, 24, 24)) - 11.5
    >>> labels = np.where(x**2 + y**2 + z**2 < 81, np.where(x < 0, 1, 2), 0).astype(np.uint8)
    >>> picture = clvol.render(clvol.Volume(labels, labels=True), mode="regions", size=(64, 64))
    """

    shading: bool = True

    name: ClassVar[str] = "regions"
    description: ClassVar[str] = "regions of labels with smooth boundaries, shaded"
    state_fields: ClassVar[int] = 9
    endpoints: ClassVar[bool] = True
    capped: ClassVar[bool] = True
    picture_filter: ClassVar[str] = REGION_FILTER
    shows: ClassVar[Literal["matter", "surface"] | Projection] = "matter"
    regions: ClassVar[bool] = True

    def __post_init__(self) -> None:
        _set(self, shading=_switch("shading", self.shading))

    @property
    def unheard(self) -> Mapping[str, str]:
        dark = dict.fromkeys(("shadow", "occlusion"), "regions of labels let all light through")
        return {"gradient": "boundaries have the gradient of their filter", **dark, **super().unheard}

    def interval_matters(self, low: float, high: float, transfer: TransferFunction) -> bool:
        return transfer.opacity_within(low, high) > 0

    def between_samples(self, *, guides: bool) -> str:  # noqa: ARG002
        return "boundaries of regions"

    def unmergeable(self, *, guides: bool, smooth: bool) -> str:  # noqa: ARG002
        return "boundaries of regions, which are between two samples"

    def settled(self, volume: Volume) -> Self:
        if not volume.is_labels:
            raise OptionError(
                "mode 'regions' takes labels, like smooth=True of a medium, and these samples look like none; "
                "Volume(..., labels=True) says that they are"
            )
        return self


@dataclass(frozen=True)
class _Opaque(Mode):
    """A projection, whose pixels show the colour of one value and are opaque."""

    @property
    def unheard(self) -> Mapping[str, str]:
        return {**super().unheard, "opacity": "its pixels are opaque"}


@dataclass(frozen=True)
class Mip(_Opaque):
    """The maximum along the ray."""

    name: ClassVar[str] = "mip"
    picture_filter: ClassVar[str] = DEFAULT_FILTER
    description: ClassVar[str] = "the maximum along the ray"
    state_fields: ClassVar[int] = 2
    seeks: ClassVar[Literal["largest", "smallest", "any"]] = "largest"


@dataclass(frozen=True)
class Attenuated(_Opaque):
    """The maximum along the ray of values that fade with depth, so that near matter stands out.

    Parameters
    ----------
    attenuation : float
        How fast values fade, 0 to 40: a value above the smallest value of the transfer function is scaled by
        exp(-attenuation d), where d is 0 at the front of the volume's bounding sphere and 1 at its back. 0 is "mip".
    """

    attenuation: float = 2.0

    name: ClassVar[str] = "attenuated"
    picture_filter: ClassVar[str] = DEFAULT_FILTER
    description: ClassVar[str] = "the maximum along the ray, dimmed by depth"
    state_fields: ClassVar[int] = 2
    ramp: ClassVar[float] = 0.5  # even the nearest values fade
    BLOCK: ClassVar[Block] = Block("mode_block", fade=FLOAT, front=FLOAT)

    def __post_init__(self) -> None:
        _set(self, attenuation=number("attenuation", self.attenuation, minimum=0, maximum=40))

    def block(self, volume: Volume, stored: Stored = AS_THEY_ARE) -> Values:  # noqa: ARG002
        front = volume.radius / volume.mean_spacing  # distance before the volume's centre, in the unit of kernels
        return self.BLOCK(fade=-self.attenuation * math.log2(math.e) / (2 * front), front=front)


@dataclass(frozen=True)
class Minip(_Opaque):
    """The minimum along the ray."""

    name: ClassVar[str] = "minip"
    picture_filter: ClassVar[str] = DEFAULT_FILTER
    description: ClassVar[str] = "the minimum along the ray"
    state_fields: ClassVar[int] = 2
    seeks: ClassVar[Literal["largest", "smallest", "any"]] = "smallest"
    shows: ClassVar[Literal["matter", "surface"] | Projection] = "min"


@dataclass(frozen=True)
class Mean(_Opaque):
    """The mean along the ray, as in an x-ray image."""

    name: ClassVar[str] = "mean"
    description: ClassVar[str] = "the mean along the ray, as in an x-ray image"
    state_fields: ClassVar[int] = 2
    skips: ClassVar[bool] = False
    shows: ClassVar[Literal["matter", "surface"] | Projection] = "mean"


@dataclass(frozen=True)
class Integral(_Opaque):
    """The line integral along the ray: a digitally reconstructed radiograph.

    Its unit is that of the data times that of lengths. Missing samples, and what is cut away, count nothing. The transfer function
    is of integrals; by default 0 is black.

    The output "value" has the integrals as numbers, 0 where a ray misses the volume. "pose", (height, width, 6), has their
    derivatives as the volume moves, while the camera stays: by a translation along x, y and z of the world, and by a rotation about
    x, y and z through the volume's centre, in radians (`Radiograph`). It is of volumes in memory that are whole, without cuts.

    Parameters
    ----------
    mu_water : float, optional
        The linear attenuation of water, per world unit (0.0193 per mm at 70 keV): values are Hounsfield units, of which the
        linear attenuation ``mu_water * (1 + HU / 1000)``, and at least 0, is integrated. The result is the absorbance, -log of the
        share of the rays that gets through. By default values are integrated as they are.

    Examples
    --------
    >>> import clvol
    >>> ball = clvol.phantoms.sphere(64)
    >>> picture, thickness = clvol.render(ball, mode="integral", size=(64, 64), outputs=["rgba", "value"]).values()
    """

    mu_water: float | None = None

    name: ClassVar[str] = "integral"
    description: ClassVar[str] = "the line integral along the ray, as in a radiograph"
    state_fields: ClassVar[int] = 1
    shows: ClassVar[Literal["matter", "surface"] | Projection] = "integral"
    BLOCK: ClassVar[Block] = Block("mode_block", zero=FLOAT, least=FLOAT, scale=FLOAT, clamped=INT)

    def __post_init__(self) -> None:
        if self.mu_water is not None:
            _set(self, mu_water=number("mu_water", self.mu_water, above=0))

    @property
    def unheard(self) -> Mapping[str, str]:
        return {**super().unheard, "preset": "integrals are no values of the data"}

    def height(self, values: NDArray[Any]) -> NDArray[np.float64]:
        """What is integrated, of values."""
        values = np.asarray(values, np.float64)
        return values if self.mu_water is None else self.mu_water * np.maximum(1 - values / _AIR, 0)

    def interval_matters(self, low: float, high: float, transfer: TransferFunction) -> bool:  # noqa: ARG002
        return (low, high) != (0, 0) if self.mu_water is None else high > _AIR

    def settled(self, volume: Volume) -> Self:
        if volume.is_labels and self.mu_water is not None:
            raise OptionError(
                "mu_water takes Hounsfield units, and labels are names; leave it out, or give Volume(..., labels=False)"
            )
        if not 2 * volume.radius * max(map(abs, volume.value_range)) <= _LARGEST:
            raise DataError(f"integrals must be within ±{_LARGEST:g}, as float32 has them; samples are from {volume.value_range}")
        return self

    def block(self, volume: Volume, stored: Stored = AS_THEY_ARE) -> Values:
        zero, per_value = (0.0, 1.0) if self.mu_water is None else (_AIR, self.mu_water / -_AIR)
        scale = math.ldexp(per_value * volume.mean_spacing, stored.exponent)
        own, largest = float(stored(zero)), float(np.abs(stored(volume.value_range)).max())
        least = _RESIDUE * largest if self.mu_water is None else _ROUNDING * abs(own)
        return self.BLOCK(zero=own, least=least, scale=scale, clamped=self.mu_water is not None)


@dataclass(frozen=True)
class _Moved(Integral):
    """The same, and how it changes as the volume moves."""

    state_fields: ClassVar[int] = 7

    @property
    def file(self) -> str:
        return "modes/moved.cl"


def moved(mode: Mode) -> Mode:
    """A settled mode, an `Integral`, whose kernel also writes how it changes as the volume moves."""
    assert isinstance(mode, Integral)
    return _Moved(mode.mu_water)


def moves(mode: Mode) -> bool:
    """Whether its kernel writes how values change as the volume moves, in place of normals and positions."""
    return isinstance(mode, _Moved)


_TABLE: dict[str, type[Mode]] = {
    mode.name: mode for mode in (Composite, Isosurface, Surfaces, Regions, Mip, Attenuated, Minip, Mean, Integral)
}


class ModeTable(Named[Mode]):
    """Modes by name, shown as a table."""

    HEADER = ("mode", "what it shows", "options")

    def rows(self) -> list[tuple[str, ...]]:
        """One tuple of strings per mode, in the order of `HEADER`."""
        return [(name, mode.description, ", ".join(_option_names(mode))) for name, mode in self.items()]


def modes() -> ModeTable:
    """The modes by name, with default options; their descriptions when shown.

    Examples
    --------
    >>> import clvol
    >>> sorted(clvol.modes())[:3]
    ['attenuated', 'composite', 'integral']
    """
    return ModeTable({name: mode() for name, mode in _TABLE.items()})


def colored_by(mode: Mode) -> str:
    """What colours the surfaces of a mode, if not colours of their own: one of `CURVATURES`, `BY_DISTANCE`, `BY_LABEL`, or ""."""
    return getattr(mode, "color_by", None) or ""


def virtual_samples(mode: Mode) -> int:
    """How many there are between two samples of a ray, if matter is theirs; else 0."""
    return int(getattr(mode, "virtual", 0) or 0)


def tolerance_of(mode: Mode) -> float | None:
    """How far the colours of matter may be from those of the finest steps, if that is to choose the step."""
    return mode.tolerance if isinstance(mode, Composite) else None


def without_tolerance(mode: Mode) -> Mode:
    """The same with steps that are given."""
    return replace(mode, tolerance=None) if isinstance(mode, Composite) else mode


def outlined(mode: Mode) -> bool:
    """Whether the surfaces of a mode have outlines."""
    return getattr(mode, "outline", 0.0) > 0


def in_linear_light(mode: Mode) -> Mode:
    """A settled mode, with colours of its own, if it has any, that are light."""
    return mode.in_linear_light() if isinstance(mode, _OfSurfaces) else mode


def opacities_of(mode: Mode) -> tuple[float, ...]:
    """The share of light that each surface of a settled mode stops, in the order of its isovalues."""
    surfaces = getattr(mode, "surfaces", None)
    return tuple(float(surface[2]) for surface in surfaces) if surfaces else (1.0,) * len(mode.isovalues)


def every_option() -> set[str]:
    """The names of the options of all modes."""
    return {name for mode in _TABLE.values() for name in _option_names(mode)}


def mode_options(mode: Mode | type[Mode]) -> dict[str, str]:
    """The options of a mode, each with its description."""
    doc = inspect.getdoc(mode if isinstance(mode, type) else type(mode)) or ""
    return {name: _described(doc, name) for name in _option_names(mode)}


def as_mode(choice: str | Mode | type[Mode], options: Mapping[str, Any] | None = None, others: Iterable[str] = ()) -> Mode:
    """The mode of a name, a class or an instance, with these options; `others` are further options of the caller.

    `OptionError` if the name is unknown, the mode has no such option or it changes nothing, the value of an option is not allowed,
    or a class lacks an attribute that modes must define.
    """
    made = _made(choice, options or {}, others)
    changed = {field.name for field in fields(made) if getattr(made, field.name) != field.default}
    require_heard(made, made.unheard.keys() & {*(options or {}), *changed})
    return made


def heard_options(choice: str | Mode | type[Mode], options: Mapping[str, Any]) -> dict[str, Any]:
    """The options of a mode without those that change nothing beside the others."""
    unheard = _made(choice, options, ()).unheard
    return {name: value for name, value in options.items() if name not in unheard}


def require_heard(mode: Mode, unheard: Collection[str], reasons: Mapping[str, str] | None = None) -> None:
    """Raise `OptionError` if options are given that change nothing in a mode; `reasons` are the mode's unless given."""
    for name in sorted(unheard):
        raise OptionError(f"{name} changes nothing in {mode.name}: {(reasons or mode.unheard)[name]}; leave it out")


# -- inner -------------------------------------------------------------------------------------------------


def _made(choice: str | Mode | type[Mode], options: Mapping[str, Any], others: Iterable[str]) -> Mode:
    """The mode with these options, whether or not they change something."""
    if isinstance(choice, type) and issubclass(choice, Mode):
        choice = choice()
    if not isinstance(choice, Mode):
        if not isinstance(choice, str) or choice not in _TABLE:
            raise one_of("mode", choice, _TABLE)
        choice = _TABLE[choice]()
    _require_sound(choice)
    known = _option_names(choice)
    for name in options:
        if name not in known:
            having = [other for other, mode in _TABLE.items() if name in _option_names(mode)]
            hint = f", but of {_listed(having)}" if having else did_you_mean(name, [*known, *others])
            raise OptionError(f"{name} is no option of {choice.name}{hint}; {choice.name} has {', '.join(known) or 'none'}")
    return replace(choice, **options)


def _listed(names: Sequence[str]) -> str:
    """Names in a sentence: "a, b and c"."""
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))


def _option_names(mode: Mode | type[Mode]) -> list[str]:
    return [field.name for field in fields(mode)]


def _require_sound(mode: Mode) -> None:
    """Check a custom mode, because parts of its class become source code."""
    for name in ("name", "state_fields"):
        if not hasattr(mode, name):
            raise OptionError(f"a mode must have a name and state_fields; {type(mode).__name__} has no {name}")
    for what, text, rule in (("name", mode.name, _WORD), ("file", mode.file, _FILE)):
        if not isinstance(text, str) or not rule.fullmatch(text):
            raise OptionError(f"a mode's {what} must be lowercase letters, digits and _ (its file modes/<name>.cl); got {text!r}")
    if mode.name in _TABLE and not isinstance(mode, _TABLE[mode.name]):
        raise OptionError(f"a mode named {mode.name!r} must be a {_TABLE[mode.name].__name__}, whose kernel it has; got {mode!r}")
    whole("a mode's state_fields", mode.state_fields, 0, _MOST_FIELDS)
    for what in ("endpoints", "skips", "finished_there", "stretches", "shaded"):
        _switch(f"a mode's {what}", getattr(mode, what))
    for what, value, allowed in (("shows", mode.shows, _SHOWN), ("seeks", mode.seeks, _SOUGHT)):
        if value not in allowed:
            raise one_of(f"what a mode {what}", value, allowed)
    number("a mode's ramp", mode.ramp, above=0)
    as_filter(mode.picture_filter)
    block = mode.BLOCK
    if not isinstance(block, Block) or block.name != Mode.BLOCK.name or not all(map(_FIELD.fullmatch, block.fields)):
        raise OptionError(f"a mode's BLOCK must be a {Mode.BLOCK.name!r} whose fields have names of C; got {block!r}")


def _set(mode: Mode, **values: Any) -> None:
    """Set fields of a frozen mode."""
    for name, value in values.items():
        object.__setattr__(mode, name, value)


def _sigmas(text: str) -> float:
    """The number in "3sigma"."""
    match = _SIGMAS.fullmatch(text)
    if match is None:
        raise OptionError(f"an isovalue must be a number, or standard deviations above the mean as '3sigma'; got {text[:80]!r}")
    return number("isovalue", float(match[1]))


def _isovalue(given: float | str, volume: Volume) -> float:
    """An isovalue as a number."""
    if not isinstance(given, str):
        return given
    mean, deviation = spread_of(volume)
    return mean + _sigmas(given) * deviation


def _surfaces(given: object) -> tuple[tuple[float | str, tuple[float, ...], float], ...]:
    """Surfaces as (isovalue, colour, opacity), the isovalue as text only if it depends on the volume."""
    rule = "(value, color, opacity), or text as '300:bisque:0.3,1200:white'"
    if isinstance(given, str):
        given = [tuple(part.strip() for part in item.split(":")) for item in given.split(",")]
    if not isinstance(given, Sequence) or not 1 <= len(given) <= _MOST_SURFACES:
        raise OptionError(f"surfaces must be 1 to {_MOST_SURFACES} of {rule}; got {given!r}")
    made = []
    for one in given:
        if not isinstance(one, Sequence) or isinstance(one, str) or len(one) not in (2, 3):
            raise OptionError(f"a surface must be {rule}; got {one!r}")
        value, color, opacity = (*one, 1)[:3]
        if isinstance(value, str) and not _is_number(value):
            _sigmas(value)
        else:
            value = number("a surface's isovalue", float(value) if isinstance(value, str) else value)
        shown = float(opacity) if isinstance(opacity, str) and _is_number(opacity) else opacity
        made.append((value, color_of("a surface's color", color), number("a surface's opacity", shown, minimum=0, maximum=1)))
    return tuple(made)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _cap(given: object) -> bool | tuple[float, float, float]:
    return bool(given) if isinstance(given, (bool, np.bool_)) else color_of("cap", given)  # type: ignore[arg-type]  # it checks


def _light(color: Any) -> tuple[float, float, float]:
    red, green, blue = as_light(color).tolist()
    return red, green, blue


def _looks_block(cap: bool | Sequence[float] | str, color_by: str | None, outline: float) -> dict[str, Any]:
    kind, color = (int(cap), 0.0) if isinstance(cap, bool) else (2, cap)
    curvature = CURVATURES.index(color_by) if color_by in CURVATURES else 0
    return {"cap": kind, "cap_color": color, "outline": outline, "curvature": curvature}


def _uncolored(cap: object, color_by: str | None) -> dict[str, str]:
    """Options that choose colours of values, which surfaces do not show."""
    shown = () if color_by else ("transfer", "window", "cmap", "color_bar")
    colors = () if cap is True else (*shown, "preset")
    return dict.fromkeys((*colors, "opacity"), "surfaces have colours of their own")


def _color_by(given: str | None, cap: object) -> str | None:
    """What surfaces are coloured by; "none", as shells and panels say it, is None."""
    if given is None or given == "none":
        return None
    if not isinstance(given, str):
        raise OptionError(
            f"color_by of a mode is a word; another volume colours a medium: Medium(..., color_by=...); got {given!r:.80}"
        )
    if given not in (*CURVATURES, BY_DISTANCE, BY_LABEL):
        raise one_of("color_by", given, (*CURVATURES, BY_DISTANCE))
    if cap is True and given != BY_LABEL:
        raise OptionError(f"cap=True shows values, and color_by {given}, by one transfer function: give the cap a color")
    return given


def _switch(what: str, value: object) -> bool:
    if not isinstance(value, (bool, np.bool_)):
        raise OptionError(f"{what} must be True or False; got {value!r}")
    return bool(value)


def _described(doc: str, name: str) -> str:
    """The description of a parameter in a docstring, on one line."""
    match = re.search(rf"^{name} : .*\n((?:    .*\n?)+)", doc, re.MULTILINE)
    return " ".join(match[1].split()) if match else ""
