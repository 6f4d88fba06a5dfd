"""Several volumes in one picture, from files: other media, and what colours one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Group, Parameter

import clvol
from clvol.base.errors import OptionError
from clvol.cli.inline import inline_options, parts_of
from clvol.cli.options import Input, Look
from clvol.filter.boundary import chosen_boundary
from clvol.interfaces.movie import places_of
from clvol.interop.dispatch import is_in_parts
from clvol.scene.scene import channels
from clvol.scene.transfer import FACTORS, WORDS
from clvol.volume.provenance import note

__all__ = ["Others"]

_OF_MEDIUM = (
    *("preset", "window", "cmap", "opacity", "transfer", *(name.replace("_", "-") for name in FACTORS), "filter", "boundary"),
    *("clip", "clip-plane", "clip-corner", "surfaces", "smooth", "mask", "where"),
)
_OF_FIRST = ("transfer", *WORDS, *FACTORS, "filter", "boundary")  # options of a picture that are of the first medium


@Parameter(name="*", group=Group("Other volumes in the picture", sort_key=3))
@dataclass
class Others:
    """Volumes of other files, which are where their files say. How SOURCE looks is not for them, options of the mode are."""

    with_: Annotated[
        tuple[str, ...],
        Parameter(
            name="--with",
            help="One in and around SOURCE: FILE, and how it is shown, as FILE,preset=stat-map or "
            f"FILE,cmap=hot,window=40/400,clip-plane=0/0/1/0/0/20. Words are {', '.join(_OF_MEDIUM)}; numbers have / between them; "
            "smooth=true draws labels with smooth boundaries; mask is a file of labels, of which where names those that show it. "
            "May be repeated.",
            show_default=False,
        ),
    ] = ()
    colors: Annotated[
        str | None, Parameter(help="One that colours the matter and surfaces of SOURCE: FILE, as of --with.", show_default=False)
    ] = None
    all_channels: Annotated[bool, Parameter(negative="", help="All channels of SOURCE, each in its colour.")] = False
    mix: Annotated[
        Literal["add", "over"],
        Parameter(help="How projections go together: their colours add up, or each covers the next ones as far as it is bright."),
    ] = "add"

    def first(self, reader: Input) -> Input:
        """How the volume is read from which looks are chosen."""
        return replace(reader, channel="0") if self.all_channels and reader.channel is None else reader

    def drawn(
        self,
        volumes: Sequence[Any],
        options: dict[str, Any],
        source: str | Path,
        reader: Input,
        read: Callable[[str], Any],
        *,
        plays: bool = False,
    ) -> list[Any]:
        """Scenes of volumes and these, which `read` reads; the volumes themselves if there are no others.

        The first medium takes what is its own out of `options` of the pictures. With all channels there is one scene, or, if it
        `plays`, one for each time of the source.
        """
        if self == Others():
            return list(volumes)
        own = {name: options.pop(name) for name in _OF_FIRST if name in options}
        others = [_medium(text, read) for text in self.with_]
        if self.all_channels:
            scenes = self._channels(source, reader, own, plays=plays)
        else:
            by = None if self.colors is None else _medium(self.colors, read, whole=True)
            scenes = [(clvol.Medium(volume, color_by=by, **own),) for volume in volumes]
        if self.mix != Others.mix and len(scenes[0]) + len(others) < 2:
            raise OptionError(f"--mix is for several media: give --with or --all-channels; got {self.mix!r} and one medium")
        return [clvol.Scene((*media, *others), mix=self.mix) for media in scenes]

    def _channels(self, source: str | Path, reader: Input, own: dict[str, Any], *, plays: bool) -> list[tuple[clvol.Medium, ...]]:
        """The channels of a file, at each time."""
        how = {name: own.pop(name) for name in ("filter", "boundary") if name in own}
        if str(source).startswith("phantom:"):
            raise OptionError(f"--all-channels is for files; {source} has one")
        if reader.is_changed:
            raise OptionError("--all-channels takes no --fill-nan, for samples that are NaN are left out, and no choice of labels")
        if reader.channel is not None or self.colors is not None or own:
            raise OptionError("--all-channels have colours of their own: leave out --channel, --colors, --preset and the like")
        volumes = reader.read_all(source)
        scenes = [channels(volumes, at, **how) for at in (places_of(volumes.leading) if plays else [{}])]
        for number, medium in enumerate(scenes[0]):
            note(medium.volume, source, {**reader.noted(), "channel": number})
        return scenes


def _medium(text: str, read: Callable[[str], Any], *, whole: bool = False) -> clvol.Medium:
    """The medium in "FILE,name=value,..."."""
    source, *words = (text,) if Path(text).exists() else parts_of(text)
    given = inline_options(words, source, _OF_MEDIUM)
    look = Look(**{one.name: given.pop(one.name) for one in fields(Look) if one.name in given})
    if "mask" in given:
        given["mask"] = _whole(read(given["mask"]))
    if cuts := look.cuts():
        given["clip"] = cuts
    volume = read(source)
    own = look.words() if look.transfer is None else {"transfer": look.function(volume)}
    return clvol.Medium(
        _whole(volume) if whole else volume, boundary=chosen_boundary(look.boundary), **own, **look.factors(), **given
    )


def _whole(volume: Any) -> Any:
    return volume.whole() if is_in_parts(volume) else volume
