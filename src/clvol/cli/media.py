"""Several volumes in one picture, from files: other media, and what colours one."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Group, Parameter

import clvol
from clvol.base.checks import did_you_mean
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
_NEXT = re.compile(r",(?=[a-z_]+=)")


@Parameter(name="*", group=Group("Other volumes in the picture", sort_key=3))
@dataclass
class Others:
    """Volumes of other files, which are where their files say. How SOURCE looks is not for them, options of the mode are."""

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
        read: Callable[[str], Any],
        **how: Any,
    ) -> clvol.Scene:
        """The scene of a volume and these, which `read` reads; `how` it is reconstructed."""
        others = [_medium(text, read) for text in self.with_]
        if self.all_channels:
            if str(source).startswith("phantom:"):
                raise OptionError(f"--all-channels is for files; {source} has one")
            if reader.fill_nan is not None:
                raise OptionError("--all-channels takes no --fill-nan: samples that are NaN are left out")
            if reader.channel is not None or self.colors is not None or transfer is not None:
                raise OptionError("--all-channels have colours of their own: leave out --channel, --colors, --preset and the like")
            return clvol.Scene((*_channels(source, reader, how), *others))
        by = None if self.colors is None else _medium(self.colors, read, whole=True)
        first = clvol.Medium(volume, transfer, color_by=by, **how)  # type: ignore[arg-type]  # it converts
        return clvol.Scene((first, *others))


def _channels(source: str | Path, reader: Input, how: dict[str, Any]) -> tuple[clvol.Medium, ...]:
    media = channels(reader.read_all(source), **how)
    for number, medium in enumerate(media):
        note(medium.volume, source, {**reader.noted(), "channel": number})
    return media


def _medium(text: str, read: Callable[[str], Any], *, whole: bool = False) -> clvol.Medium:
    """The medium in "FILE,name=value,..."."""
    source, *words = (text,) if Path(text).exists() else _NEXT.split(text)
    given: dict[str, Any] = {}
    for word in words:
        name, _, value = word.partition("=")
        if name not in _WORDS:
            raise OptionError(f"{name} is no option of {source}{did_you_mean(name, _WORDS)}; it may have {', '.join(_WORDS)}")
        try:
            given[name] = _WORDS[name](value)
        except ValueError:
            rule = "center/width" if name == "window" else "a number"
            raise OptionError(f"{name} of {source} must be {rule}; got {value!r}") from None
    volume = read(source)
    return clvol.Medium(volume.whole() if whole and is_in_parts(volume) else volume, **given)
