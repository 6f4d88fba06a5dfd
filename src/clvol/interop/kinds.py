"""What the modules of `clvol.interop` share: how a library's images are read, and the terms in which volumes are written."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clvol.base.axes import AXES, meaning
from clvol.base.errors import DataError

if TYPE_CHECKING:
    from clvol.volume.volumes import Leading

__all__ = ["Content", "Kind", "channels_and_frames", "held_as", "interleaved", "leading_axes", "leading_counts"]

Content: TypeAlias = tuple[NDArray[Any], dict[str, Any]]
"""Samples [z, y, x], and those keyword arguments of `Volume` that their source knows: spacing, origin, direction, units, ...
Of several volumes, samples [..., z, y, x], and the arguments of `Leading` under the key "leading"."""


class Kind(NamedTuple):
    """How a library's images are read. The library is not imported to recognize them: they are what has their methods.

    Attributes
    ----------
    matches : callable
        Whether an object is one of the library's. It may be none of its images, which `describe` refuses.
    describe : callable
        The arguments of `Volume` that it knows; those of `Leading` under the key "leading".
    shape : callable
        Samples along z, y, x, or y, x.
    samples : callable
        The array [..., z, y, x].
    """

    matches: Callable[[Any], bool]
    describe: Callable[[Any], dict[str, Any]]
    shape: Callable[[Any], tuple[int, ...]]
    samples: Callable[[Any], NDArray[Any]]


_WIDER = {"bool": "uint8", "float16": "float32"}  # the next type that holds every value


def held_as(data: NDArray[Any], dtypes: Iterable[str], error: Callable[[str], Exception] = DataError) -> NDArray[Any]:
    """`data` in native byte order and C order, as one of `dtypes` that holds every value; else `error` of the rule is raised."""
    name = data.dtype.name
    name = name if name in dtypes else _WIDER.get(name, name)
    if name not in dtypes:
        raise error(f"samples must be {', '.join(dtypes)} here; got {data.dtype}: convert them or write .npz")
    return np.ascontiguousarray(data, dtype=name)


def leading_counts(about: Mapping[str, Any]) -> tuple[int, ...]:
    """The counts of the leading axes, if there are any."""
    return tuple(about["leading"]["counts"]) if "leading" in about else ()


def interleaved(
    channels: int, dtype: np.dtype[Any], d: int, axes: tuple[str, ...] = (), counts: tuple[int, ...] = ()
) -> dict[str, Any]:
    """Arguments of `Leading` for several values per voxel of which only their number and their type are known.

    Three or four bytes are a colour, as many floating numbers as the image has axes a vector, and all else channels.
    """
    rgb = dtype == np.uint8 and channels in (3, 4)
    vector = dtype.kind == "f" and channels == d
    return {"axes": (*axes, "channel"), "counts": (*counts, channels), "rgb": rgb, "vector": vector}


def leading_axes(names: Sequence[str], counts: Sequence[int], what: str) -> tuple[tuple[str, ...], tuple[int, ...]]:
    """What leading axes count, by their names, and how many.

    Raises
    ------
    DataError
        Two of them count the same.
    """
    axes = tuple(axis if (axis := meaning(name)) in AXES else "volume" for name in names)
    if len(set(axes)) != len(axes):
        raise DataError(f"{what} must have axes before z, y and x that are told apart (time, channel); got {tuple(names)}")
    return axes, tuple(int(n) for n in counts)


def channels_and_frames(leading: Leading | None, what: str) -> tuple[int | None, int | None]:
    """Which of the leading axes is that of channels, and which is the other one.

    Raises
    ------
    DataError
        There are more, for which `what` has no room.
    """
    if leading is None:
        return None, None
    others = [n for n, axis in enumerate(leading.axes) if axis != "channel"]
    if len(others) > 1:
        raise DataError(f"{what} must have no leading axis but channels and one other; got {leading}: choose with pick")
    return (leading.axes.index("channel") if "channel" in leading.axes else None), (others[0] if others else None)
