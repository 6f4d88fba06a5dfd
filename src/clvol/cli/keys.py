"""Key frames of movies, as MOMENT:name=value,name=value: each word is an option of the command, from that moment on."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import clvol
from clvol.base.errors import OptionError
from clvol.cli.inline import inline_options, parts_of
from clvol.cli.options import Furniture, Look, opacity_points
from clvol.scene.keyframes import Keyframes
from clvol.scene.mode import every_option
from clvol.scene.transfer import FACTORS, WORDS

__all__ = ["Keys"]

_CAMERA = ("azimuth", "elevation", "zoom", "projection", "fit")
_CUTS = ("clip", "clip_plane", "clip_corner")
_OF_MOVIE = ("boundary", "evaluator", "fetch", "value_range", "transfer")  # the same in all pictures
_QUARTER = 90.0  # degrees: no key frame is further, so that the shortest turn is the one that was asked for


class Keys:
    """What the command line says of moments; `OptionError` if that is nothing that changes."""

    def __init__(self, texts: Sequence[str]) -> None:
        of_look = [one.name for kind in (Look, Furniture) for one in fields(kind) if one.name not in _OF_MOVIE]
        names = [name.replace("_", "-") for name in (*of_look, *sorted(every_option()), "threshold")]
        self._at: dict[float, dict[str, Any]] = {}
        for text in texts:
            moment, _, rest = text.partition(":")
            try:
                at = float(moment)
            except ValueError:
                raise OptionError(
                    "--key must be MOMENT:NAME=VALUE,NAME=VALUE, a moment from 0, the first picture, to 1, the last; got "
                    f"{moment.partition('=')[0]!r} in place of MOMENT"
                ) from None
            self._at[at] = self._at.get(at, {}) | inline_options(parts_of(rest), f"--key {moment}", names)

    def frames(self, look: Look, volume: clvol.Volume) -> dict[float, dict[str, Any]] | None:
        """The key frames of `clvol.movie`; what they leave open of a camera or of cuts is as in a look."""
        if not self._at:
            return None
        found = {at: {name: v for name, v in said.items() if name not in _CAMERA + _CUTS} for at, said in self._at.items()}
        for options in found.values():
            for name in {"opacity", *FACTORS} & options.keys():
                options[name] = opacity_points(name, options[name])
            if options.get("background") == "none":
                options["background"] = None
        for at, seen in self._looks(_CAMERA, look):
            found.setdefault(at, {})["camera"] = seen.camera(volume)
        for at, seen in self._looks(_CUTS, look):
            found[at]["clip"] = seen.cuts()
        return found

    def _looks(self, names: Sequence[str], look: Look) -> list[tuple[float, Look]]:
        """The looks at the moments that name one of several words, and at as many between them as a turn of the camera needs."""
        said = {at: {name: words[name] for name in names if name in words} for at, words in self._at.items()}
        if not any(said.values()):
            return []
        keys = Keyframes({at: words for at, words in said.items() if words})
        looks = {at: replace(look, **keys.options(at)) for at in keys.at}
        for (a, first), (b, last) in itertools.pairwise(list(looks.items())):
            count = math.ceil(abs(last.turned[0] - first.turned[0]) / _QUARTER)
            for at in (a + (b - a) * i / count for i in range(1, count)):
                looks[at] = replace(look, **keys.options(at))
        return sorted(looks.items(), key=lambda one: one[0])

    def beside(self, options: dict[str, Any], look: Look, *, several: bool) -> dict[str, Any]:
        """The options beside the key frames, without what these name and have from the look, of one medium or of several."""
        named = {name for words in self._at.values() for name in words}
        if several and (fixed := named.intersection(WORDS)):
            raise OptionError(
                f"--key changes no {' and '.join(sorted(fixed))} beside other volumes: it is the same in all pictures"
            )
        gone: set[str] = {name for name in ("mode", "step") if name in named and getattr(look, name) == getattr(Look, name)}
        for word in named.intersection((*_CAMERA, *_CUTS)):
            if getattr(look, word) != getattr(Look, word):
                raise OptionError(f"--{word.replace('_', '-')} must be given in key frames or beside them; got both")
        gone |= {name for name, words in (("camera", _CAMERA), ("clip", _CUTS)) if named.intersection(words)}
        return {name: value for name, value in options.items() if name not in gone}
