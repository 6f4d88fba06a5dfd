"""Several volumes on one grid: the frames of a series, the channels of a microscope, the components of a vector."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol.base import memory
from clvol.base.axes import AXES
from clvol.base.checks import instance, one_of, whole
from clvol.base.color import channel_colors, color_of
from clvol.base.errors import DataError, GeometryError, OptionError
from clvol.base.rounding import wide
from clvol.interop.images import is_image, read_grid, read_several
from clvol.interop.itk import to_simpleitk
from clvol.interop.nibabel import to_nibabel
from clvol.interop.xarray_images import to_xarray
from clvol.volume.samples import array_of
from clvol.volume.volume import Volume, as_volume, clim_of

__all__ = ["COMPUTED", "Leading", "Volumes", "as_grid"]

COMPUTED = ("magnitude", "luminance")
"""Channels computed from all others: of vectors, and of red, green and blue."""

_DIGITS = 18  # longest number given as text
_LUMINANCE = (0.2126, 0.7152, 0.0722)  # Rec. 709
_COLORS = (("red", (1.0, 0.0, 0.0)), ("green", (0.0, 1.0, 0.0)), ("blue", (0.0, 0.0, 1.0)), ("alpha", None))
_ABOUT = ("spacing", "origin", "direction", "units", "space", "color", "clim", "labels", "header")
_OFF = 1e-3  # of a sample's spacing, by which volumes of one grid may lie apart


@dataclass(frozen=True)
class Leading:
    """The axes before z, y and x: their meanings, and metadata of each volume from the source.

    Parameters
    ----------
    axes : tuple of str
        Each one of `AXES`, slowest first.
    counts : tuple of int
        Number of volumes along each axis.
    names : mapping of str to tuple of str
        Per axis, if known, a name for each place along it, such as channel names.
    colors : tuple of colours or None
        Of the channels; empty: none has one.
    clims : tuple of pairs or None
        Of the channels, likewise.
    vector : bool
        Whether the channels are the components of a vector: they are named x, y and z, and there is a channel "magnitude".
    rgb : bool
        Whether they are red, green, blue (and alpha) of a picture: they have names and colours, and there is a channel "luminance".
    """

    axes: tuple[str, ...] = ()
    counts: tuple[int, ...] = ()
    names: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    colors: tuple[tuple[float, float, float] | None, ...] = ()
    clims: tuple[tuple[float, float] | None, ...] = ()
    vector: bool = False
    rgb: bool = False

    def __post_init__(self) -> None:
        for axis in self.axes:
            if axis not in AXES:
                raise one_of("an axis before z, y and x", axis, AXES)
        if len(set(self.axes)) != len(self.axes) or len(self.axes) != len(self.counts):
            raise OptionError(f"axes must be different, and as many as there are counts; got {self.axes} and {self.counts}")
        if (self.rgb or self.vector) and "channel" in self.axes and "channel" not in self.names:
            self._name_channels(self.counts[self.axes.index("channel")])
        for axis, names in self.names.items():
            if axis not in self.axes or len(names) != self.counts[self.axes.index(axis)]:
                raise OptionError(f"names must be one for each place along one of {self.axes}; got {axis}: {names}")
        channels = self.counts[self.axes.index("channel")] if "channel" in self.axes else 0
        for what in ("colors", "clims"):
            given = getattr(self, what)
            if given and len(given) != channels:
                raise OptionError(f"{what} must be one for each of {channels} channels; got {len(given)}")
        object.__setattr__(self, "colors", tuple(None if c is None else color_of("a channel's color", c) for c in self.colors))
        clims = tuple(None if c is None else clim_of("a channel's clim", c) for c in self.clims)
        object.__setattr__(self, "clims", clims)
        object.__setattr__(self, "counts", tuple(whole("each count", n, 1) for n in self.counts))

    @classmethod
    def of_rgb(cls, channels: int, axes: tuple[str, ...] = (), counts: tuple[int, ...] = ()) -> Leading:
        """Three or four channels of a colour picture, as the last of these axes."""
        return cls((*axes, "channel"), (*counts, channels), rgb=True)

    def _name_channels(self, count: int) -> None:
        """Name the channels of colours, and of vectors of up to three components."""
        if self.rgb and count <= len(_COLORS):
            names, colors = zip(*_COLORS[:count], strict=True)
            object.__setattr__(self, "colors", self.colors or colors)
            object.__setattr__(self, "names", {**self.names, "channel": names})
        elif self.vector and count <= 3:
            object.__setattr__(self, "names", {**self.names, "channel": tuple("xyz"[:count])})

    @property
    def total(self) -> int:
        """Number of volumes."""
        return math.prod(self.counts)

    @property
    def computed(self) -> str:
        """The computed channel: "magnitude", "luminance", or "" if there is none."""
        return "magnitude" if self.vector else "luminance" if self.rgb else ""

    def first(self, axis: str) -> int | str:
        """The default place along an axis: 0, or the computed channel."""
        return (self.computed if axis == "channel" else "") or 0

    def place(self, axis: str, choice: int | str, source: str = "the volume") -> int:
        """The place of a number or a name along an axis; `OptionError` states their count and names."""
        count, names = self.counts[self.axes.index(axis)], self.names.get(axis, ())
        if isinstance(choice, str):
            if choice in names:
                return names.index(choice)
            if not choice.isdecimal() or len(choice) > _DIGITS:  # the command line gives numbers as text
                raise OptionError(f"{axis} must be {self._choices(axis)}; got {choice!r}")
            choice = int(choice)
        number = whole(axis, choice)
        if not 0 <= number < count:
            plural = "place" if axis == "position" else axis
            plural += "s" * (count > 1)
            raise OptionError(f"{axis} must be {self._choices(axis)}, because {source} holds {count} {plural}; got {number}")
        return number

    def about(self, place: Sequence[int]) -> dict[str, Any]:
        """The known arguments of `Volume` for the volume at `place`, one index per axis."""
        known: dict[str, Any] = {}
        parts = [self.names[axis][i] for axis, i in zip(self.axes, place, strict=True) if axis in self.names]
        if any(parts):
            known["name"] = ", ".join(part for part in parts if part)
        if "channel" in self.axes:
            channel = place[self.axes.index("channel")]
            for key, values in (("color", self.colors), ("clim", self.clims)):
                if values and values[channel] is not None:
                    known[key] = values[channel]
        return known

    def without(self, *dropped: str) -> Leading:
        """A copy without these axes."""
        kept = [i for i, axis in enumerate(self.axes) if axis not in dropped]
        gone = "channel" in dropped
        return Leading(
            tuple(self.axes[i] for i in kept),
            tuple(self.counts[i] for i in kept),
            {axis: names for axis, names in self.names.items() if axis not in dropped},
            () if gone else self.colors,
            () if gone else self.clims,
            self.vector and not gone,
            self.rgb and not gone,
        )

    def combined(self, data: NDArray[Any], axis: int) -> NDArray[Any]:
        """Compute the combined channel of samples whose channels are along `axis`: vector magnitude, or luminance (Rec. 709).

        Luminance keeps an integer dtype, rounded; magnitudes are float32, or float64 for samples wider than 16 bits.
        """
        kind = np.float64 if wide(data.dtype) else np.float32
        channels = np.moveaxis(data, axis, 0)
        memory.require(3 * np.dtype(kind).itemsize * channels[0].size, f"the {self.computed or 'sum'} of {len(channels)} channels")
        total = np.zeros(channels.shape[1:], kind)
        if self.vector:
            for channel in channels:  # one at a time, to avoid a floating-point copy of all
                total += np.square(channel, dtype=kind)
            return np.sqrt(total, out=total)
        for weight, channel in zip(_LUMINANCE, channels, strict=False):  # without alpha
            total += channel.astype(kind) * kind(weight)
        return np.rint(total).astype(data.dtype) if data.dtype.kind in "iu" else total

    def _choices(self, axis: str) -> str:
        count, names = self.counts[self.axes.index(axis)], self.names.get(axis, ())
        choices = [f"{n} ({name})" if name else str(n) for n, name in enumerate(names)]
        if axis == "channel" and self.computed:
            choices.append(self.computed)
        span = f"0 to {count - 1}" if count > 1 else "0"
        return f"{span}, of {', '.join(choices)}" if choices and len(choices) <= 16 else span

    def __str__(self) -> str:
        """In words: "100 times × 2 channels (DAPI, GFP)"."""
        parts = []
        for axis, n in zip(self.axes, self.counts, strict=True):
            names = ", ".join(name for name in self.names.get(axis, ()) if name)
            parts.append(f"{n} {axis}{'s' if n != 1 else ''}{f' ({names})' if names and n <= 16 else ''}")
        return " × ".join(parts) or "1 volume"


class Volumes(Sequence[Volume]):
    """Volumes on one grid, in one array: frames, channels, components.

    A sequence of `Volume`: ``volumes[3]``, ``volumes["DAPI"]``, ``volumes.pick(time=0, channel=1)``, ``for frame in volumes``;
    ``np.asarray(volumes)`` is the array, with the axes `axes` before z, y and x. `clvol.read_all` returns one;
    `clvol.resample_series` and `clvol.write` accept one.

    Parameters
    ----------
    data : array-like, shape (..., nz, ny, nx) or (..., ny, nx), or sequence of Volume
        Samples with one or more leading axes, viewed, not copied; or a list of volumes of one grid and dtype, or of images that
        hold such. Images of SimpleITK and nibabel give their geometry and what their axes count: a fourth axis is time or
        volumes, values of a voxel are channels.
    spacing, origin, direction, units, space, clim, labels, header : optional
        As of `Volume`.
    leading : Leading, optional
        Meaning of the leading axes; default: one axis, "volume".

    Raises
    ------
    DataError
        There is no volume, there are too few axes, or the shapes of the volumes differ.
    GeometryError
        The volumes are on different grids.
    OptionError
        `leading` does not match the samples, or a geometry is given in addition to that of the volumes.

    Examples
    --------
    >>> import clvol, numpy as np
    >>> frames = clvol.Volumes([clvol.Volume(np.full((4, 5, 6), t, np.float32)) for t in range(3)])
    >>> len(frames), np.asarray(frames).shape
    (3, (3, 4, 5, 6))
    """

    def __init__(self, data: ArrayLike | Sequence[Volume], *, leading: Leading | None = None, **about: Any) -> None:
        if isinstance(data, (list, tuple)) and not data:
            raise DataError("data must hold at least one volume; got none")
        if isinstance(data, (list, tuple)) and any(isinstance(volume, Volume) or is_image(volume) for volume in data):
            if about:
                raise OptionError(f"volumes already have a geometry; got {', '.join(about)} as well")
            volumes = [as_volume(volume) for volume in data]
            first = volumes[0]
            for volume in volumes[1:]:
                _require_same_grid(first, volume)
            memory.require(sum(volume.data.nbytes for volume in volumes), f"{len(volumes)} volumes in one array")
            array = np.stack([volume.data for volume in volumes])
            about = {name: getattr(first, name) for name in _ABOUT}
            for name in ("color", "clim"):
                if len({getattr(volume, name) for volume in volumes}) > 1:
                    del about[name]  # it differs between volumes
            if leading is None:
                names = tuple(volume.name for volume in volumes)
                leading = Leading(("volume",), (len(volumes),), {"volume": names} if any(names) else {})
        else:
            array, known = read_several(data)
            counted = known.pop("leading", None)
            if counted is not None:
                leading = leading or Leading(**counted)
            elif known and leading is None:  # an image of one volume: its first axis is not a leading axis
                array = array[None]
            about = known | about
        if leading is None:
            leading = Leading(("volume",), array.shape[:1])
        instance("leading", leading, Leading)
        n = len(leading.axes)
        if n == 0 or array.shape[:n] != leading.counts:
            raise OptionError(f"leading must count the first axes of the samples, of shape {array.shape}; got {leading.counts}")
        if array.ndim - n not in (2, 3):
            raise DataError(f"data must have 2 or 3 axes behind {', '.join(leading.axes)}; got shape {array.shape}")
        self.leading = leading
        self._array = array.view()
        self._array.flags.writeable = False
        self._first = Volume(self._array[(0,) * n], **about)

    def __getstate__(self) -> dict[str, Any]:
        """For pickles and copies: the samples once, and the metadata of the grid."""
        about = {one.name: getattr(self._first, one.name) for one in fields(Volume) if one.name != "data"}
        return {"leading": self.leading, "array": self._array, "about": about}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        self.leading = state["leading"]
        self._array = state["array"].view()
        self._array.flags.writeable = False
        self._first = Volume(self._array[(0,) * len(self.leading.axes)], **state["about"])

    @property
    def axes(self) -> tuple[str, ...]:
        """Meanings of the leading axes, slowest first: "volume", "time", "position" or "channel"."""
        return self.leading.axes

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the array: the counts of the leading axes, then (nz, ny, nx) or (ny, nx)."""
        return self._array.shape

    @property
    def colors(self) -> tuple[tuple[float, float, float], ...]:
        """The colour of each channel, in 0..1: the file's, else distinct ones; empty without an axis "channel".

        Examples
        --------
        >>> import numpy as np
        >>> from clvol.volume.volumes import Leading
        >>> leading = Leading(("channel",), (3,), colors=(None, "lime", None))
        >>> clvol.Volumes(np.zeros((3, 4, 5, 6)), leading=leading).colors
        ((1.0, 0.0, 1.0), (0.0, 1.0, 0.0), (0.0, 1.0, 1.0))
        """
        channels = self.leading.counts[self.axes.index("channel")] if "channel" in self.axes else 0
        return channel_colors(channels, self.leading.colors)

    @property
    def grid(self) -> Volume:
        """The first volume, whose grid all others share."""
        return self[0]

    @property
    def first(self) -> Volume:
        """The volume that `clvol.read` returns for such a file: place 0 of each axis, or the computed channel."""
        return self.pick(**{axis: self.leading.first(axis) for axis in self.axes})

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the volumes, "" if unknown."""
        return tuple(self._about(i).get("name", "") for i in range(len(self)))

    def __len__(self) -> int:
        return self.leading.total

    @overload
    def __getitem__(self, index: int | str) -> Volume: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[Volume]: ...

    def __getitem__(self, index: int | slice | str) -> Volume | Sequence[Volume]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        if isinstance(index, str):
            if index not in self.names or self.names.count(index) > 1:  # the error of `pick` lists the choices, or the missing axes
                return self.pick(channel=index) if "channel" in self.axes else self.pick(**{self.axes[-1]: index})
            index = self.names.index(index)
        number = range(len(self))[index]  # raises IndexError, as for sequences
        place = np.unravel_index(number, self.leading.counts)
        return self._volume(self._array[place], self._about(number))

    def __iter__(self) -> Iterator[Volume]:
        return (self[i] for i in range(len(self)))

    def pick(self, **places: int | str) -> Volume:
        """The volume at one place along each axis, ``volumes.pick(time=0, channel="DAPI")``; axes of length 1 are optional.

        ``channel="magnitude"`` for vectors and ``channel="luminance"`` for colours are computed.

        Raises
        ------
        OptionError
            An axis is unknown, a place is out of range, or an axis with several places is missing.
        """
        index: list[Any] = []
        for axis, count in zip(self.axes, self.leading.counts, strict=True):
            choice = places.pop(axis, 0 if count == 1 else None)
            if choice is None:
                raise OptionError(f"{axis} must be given, because there are {self.leading}")
            if axis == "channel" and choice and choice == self.leading.computed:
                index.append(slice(None))
            else:
                index.append(self.leading.place(axis, choice))
        if places:
            raise OptionError(f"axes are {', '.join(self.axes)}; got {', '.join(places)}")
        if slice(None) not in index:
            return self[int(np.ravel_multi_index(index, self.leading.counts))]
        at = index.index(slice(None))
        combined = self.leading.combined(self._array[tuple(index)], 0)
        rest = self.leading.without("channel")
        return self._volume(combined, rest.about(index[:at] + index[at + 1 :]) | {"name": self.leading.computed})

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return array_of(self._array, dtype, copy)

    def to_sitk(self) -> Any:
        """A SimpleITK image: channels become the components of voxels, and another axis becomes the fourth.

        Raises
        ------
        DataError, GeometryError, MissingDependencyError
            As `Volume.to_sitk`; and more leading axes than channels and one other.
        """
        return to_simpleitk(self._array, self._first, self.leading)

    def to_nibabel(self) -> Any:
        """A nibabel image (NIfTI): the fourth axis is time (or volumes), the fifth channels; 8-bit colours stay colours.

        Raises
        ------
        DataError, GeometryError, MissingDependencyError
            As `Volume.to_nibabel`; and more leading axes than channels and one other.
        """
        return to_nibabel(self._array, self._first, self.leading)

    def to_xarray(self) -> Any:
        """A DataArray whose first dimensions are `axes`, with channel names as coordinates; see `Volume.to_xarray`.

        Raises
        ------
        MissingDependencyError
            xarray is not installed.
        """
        return to_xarray(self._array, self._first, self.leading)

    def __repr__(self) -> str:
        return f"Volumes({self.leading}, of {self.grid!r})"

    def _repr_html_(self) -> str:
        """For notebooks: the middle slices of the first few volumes, and facts about all."""
        from clvol.show.thumbnail import html_of_volumes

        return html_of_volumes(self)

    def _about(self, number: int) -> dict[str, Any]:
        return self.leading.about([int(i) for i in np.unravel_index(number, self.leading.counts)])

    def _volume(self, data: NDArray[Any], about: dict[str, Any]) -> Volume:
        return replace(self._first, data=data, **about)


def as_grid(like: Volume | Volumes | ArrayLike) -> Volume:
    """A volume with the grid of `like`: the volume itself, or the shared grid of several volumes or of an image of several."""
    if isinstance(like, Volumes):
        return like.grid
    if isinstance(like, Volume):
        return like
    data, about = read_grid(like)
    return Volume(data, **about)


def _require_same_grid(first: Volume, other: Volume) -> None:
    if other.shape != first.shape:
        raise DataError(f"volumes must have one shape; got {first.shape} and {other.shape}")
    apart = np.abs(first.corners - other.corners).max()
    if len({first.units, other.units} - {""}) > 1 or not apart <= _OFF * min(first.spacing):
        raise GeometryError(
            f"volumes must be on one grid; got {first!r} and {other!r}: clvol.resample(..., like=) puts them on one grid"
        )
