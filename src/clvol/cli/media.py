"""Several volumes in one picture, from files: other media, and what colours one."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

from cyclopts import Group, Parameter

import clvol
from clvol.base.errors import OptionError
from clvol.cli.options import Input
from clvol.interop.dispatch import is_in_parts
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

    def scene(
        self, volume: clvol.Volume | clvol.LazyVolume, filter: Any, boundary: str, transfer: clvol.TransferFunction | None
    ) -> clvol.Scene:
        """The scene of a volume and these."""
        by = None if self.colors is None else _medium(self.colors, whole=True)
        first = clvol.Medium(volume, transfer, filter=filter, boundary=boundary, color_by=by)  # type: ignore[arg-type]  # it converts
        return clvol.Scene((first, *map(_medium, self.with_)))


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
