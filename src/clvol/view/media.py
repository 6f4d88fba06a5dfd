"""The media of a scene that is viewed: what a state changes of them, and their description for clients."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from clvol.base.errors import OptionError
from clvol.scene.joint import TransferFunction2D
from clvol.scene.look import seen_through
from clvol.scene.mode import as_mode
from clvol.scene.scene import Medium
from clvol.scene.transfer import FACTORS, TransferFunction, is_curve
from clvol.view.state import MediumState, State

__all__ = ["changes", "described", "names", "of_state", "require", "ungraded"]


def of_state(media: Sequence[Medium], state: State) -> tuple[Medium, ...]:
    """The media as a state shows them; of the first it has only whether it is seen."""
    if state.media:
        media = [replace(medium, **changes(medium, own)) for medium, own in zip(media, state.media, strict=True)]
    return tuple(media if as_mode(state.mode, state.options).grades else map(_ungraded, media))


def _ungraded(medium: Medium) -> Medium:
    """The same without what modes without matter lack."""
    none: dict[str, Any] = dict.fromkeys(FACTORS)
    return replace(medium, transfer=ungraded(medium.transfer), **none)


def ungraded(transfer: TransferFunction | None) -> TransferFunction | None:
    """A function without the factors of its opacity, which modes without matter lack, as they do one of gradients: None."""
    none: dict[str, Any] = dict.fromkeys(FACTORS)
    return None if transfer is None or isinstance(transfer, TransferFunction2D) else replace(transfer, **none)


def changes(medium: Medium, shown: MediumState) -> dict[str, Any]:
    """What a state changes of a medium, by the names of `Medium`."""
    given = {name: value for name, value in vars(shown).items() if value is not None}
    transfer, cmap, opacity = medium.transfer, given.get("cmap"), given.get("opacity")
    if transfer is None and opacity is not None and is_curve(medium.opacity):
        given["opacity"] = [(value, min(1.0, opacity * one)) for value, one in medium.opacity]  # type: ignore[union-attr]  # pairs
    if transfer is None or (cmap is None and opacity is None):
        return given
    if cmap is not None:
        if isinstance(transfer, TransferFunction2D):
            raise OptionError(f"cmap changes nothing of a medium with a TransferFunction2D, whose shapes have colors; got {cmap!r}")
        transfer = replace(transfer, colors=TransferFunction.from_cmap(cmap, transfer.value_range).colors)
    if opacity is not None:
        transfer = seen_through(transfer, opacity)
    return {name: value for name, value in given.items() if name == "visible"} | {"transfer": transfer}


def require(media: Sequence[Medium], state: State) -> None:
    """`OptionError` unless a state has none or all of these media, and of the first, which is edited itself, no colours."""
    if state.media and len(state.media) != len(media):
        raise OptionError(f"media must be left out, or one for each of the scene's {len(media)}; got {len(state.media)}")
    if state.media and (state.media[0].cmap is not None or state.media[0].opacity is not None):
        raise OptionError("media must have no cmap and opacity for the first: those of the state are its own")
    of_state(media, state)


def names(media: Sequence[Medium]) -> list[str]:
    """What people know them by."""
    return [medium.volume.name or f"medium {number}" for number, medium in enumerate(media, 1)]


def described(media: Sequence[Medium]) -> list[dict[str, Any]]:
    """For a panel: each medium's name, how it is seen if a state leaves it open, and whether it takes other colours."""
    return [_described(medium, name, number) for number, (medium, name) in enumerate(zip(media, names(media), strict=True), 1)]


def _described(medium: Medium, name: str, number: int) -> dict[str, Any]:
    return {
        "name": name,
        "visible": bool(medium.visible),
        "edited": number > 1 and medium.surfaces is None and not isinstance(medium.transfer, TransferFunction2D),
        "cmap": medium.cmap,
        "opacity": None if medium.opacity is None or is_curve(medium.opacity) else float(medium.opacity),  # type: ignore[arg-type]  # one
    }
