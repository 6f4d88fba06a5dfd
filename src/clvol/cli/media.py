"""Several volumes in one picture, from files: other media, and what colours one."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Group, Parameter

import clvol
from clvol.base.errors import OptionError
from clvol.cli.options import Input
from clvol.interop.dispatch import is_in_parts
from clvol.scene.scene import channels
from clvol.volume.provenance import note

__all__ = ["Others"]


def _window(text: str) -> tuple[float, float]:
    center, width = text.split("/")
    return float(center), float(width)


_WORDS: dict[str, Callable[[str], Any]] = {"preset": str, "window": _window, "cmap": str, "opacity": float, "filter": str}
_NEXT = re.compile(rf",(?=(?:{'|'.join(_WORDS)})=)")


@Parameter(name="*", group=Group("Other volumes in the picture", sort_key=3))
@dataclass
class Others:
    """Volumes of other files, which are where their files say; options of how SOURCE looks are not for them."""

    with_: Annotated[
        tuple[str, ...],
        Parameter(
            name="--with",
            help="One in and around SOURCE: FILE, and how it is shown, as FILE,preset=stat-map or "
            "FILE,cmap=hot,window=40/400,opacity=0.5,filter=linear. May be repeated.",
            show_default=False,
        ),
    ] = ()
    colors: Annotated[
        str | None, Parameter(help="One that colours the matter and surfaces of SOURCE: FILE, as of --with.", show_default=False)
    ] = None

    all_channels: Annotated[bool, Parameter(negative="", help="All channels of SOURCE, each in its colour.")] = False

    def first(self, reader: Input) -> Input:
        """How the volume is read from which looks are chosen."""
        return replace(reader, channel="0") if self.all_channels and reader.channel is None else reader

    def scene(
        self,
        volume: clvol.Volume | clvol.LazyVolume,
        transfer: clvol.TransferFunction | None,
        source: str | Path,
        reader: Input,
        **how: Any,
    ) -> clvol.Scene:
        """The scene of a volume and these; `how` it is reconstructed."""
        others = map(_medium, self.with_)
        if self.all_channels:
            if reader.channel is not None or self.colors is not None or transfer is not None:
                raise OptionError("--all-channels have colours of their own: leave out --channel, --colors, --preset and the like")
            return clvol.Scene((*_channels(source, reader, how), *others))
        by = None if self.colors is None else _medium(self.colors, whole=True)
        first = clvol.Medium(volume, transfer, color_by=by, **how)  # type: ignore[arg-type]  # it converts
        return clvol.Scene((first, *others))


def _channels(source: str | Path, reader: Input, how: dict[str, Any]) -> tuple[clvol.Medium, ...]:
    media = channels(reader.read_all(source), **how)
    for number, medium in enumerate(media):
        note(medium.volume, source, {**reader.noted(), "channel": number})
    return media


def _medium(text: str, *, whole: bool = False) -> clvol.Medium:
    """The medium in "FILE,name=value,..."."""
    source, *words = _NEXT.split(text)
    given: dict[str, Any] = {}
    for word in words:
        name, _, value = word.partition("=")
        try:
            given[name] = _WORDS[name](value)
        except ValueError:
            rule = "center/width" if name == "window" else "a number"
            raise OptionError(f"{name} of {source} must be {rule}; got {value!r}") from None
    volume: Any = Input().intact(source)
    note(volume, source, {})
    return clvol.Medium(volume.whole() if whole and is_in_parts(volume) else volume, **given)
