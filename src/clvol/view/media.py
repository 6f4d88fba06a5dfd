"""The media of a scene that is viewed: what a state changes of them, and their description for clients."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from clvol.base.errors import OptionError
from clvol.march import slices
from clvol.march.options import covering
from clvol.scene.joint import TransferFunction2D
from clvol.scene.look import seen_through
from clvol.scene.mode import as_mode
from clvol.scene.scene import Medium
from clvol.scene.transfer import FACTORS, TransferFunction, is_curve
from clvol.view.state import MediumState, State

__all__ = ["changes", "described", "fitted", "named", "of_state", "over_slices", "require", "slice_words", "ungraded"]

_UNSEEN = TransferFunction(((0.0, (0.0, 0.0, 0.0)),), ((0.0, 0.0),))


def of_state(media: Sequence[Medium], state: State) -> tuple[Medium, ...]:
    """The media as a state shows them; of the first it has only whether it is seen."""
    if state.media:  # which may be from before the last layer came
        shown = (*state.media, *[MediumState()] * len(media))
        media = [replace(medium, **changes(medium, own)) for medium, own in zip(media, shown, strict=False)]
    return tuple(media if as_mode(state.mode, state.options).grades else map(_ungraded, media))


def over_slices(media: Sequence[Medium], state: State) -> list[tuple[int, TransferFunction]]:
    """The numbers of the media that slices show over the first, and what they look like there."""
    shown = list(enumerate(of_state(media, replace(state, mode="composite", options={}))))[1:]
    return [(number, slices.over_slices(medium)) for number, medium in shown if medium.visible and not medium.surfaces]


def slice_words(media: Sequence[Medium], state: State) -> dict[str, Any]:
    """Words of `section` for the colours of a slice of the first medium."""
    if media and state.media and state.media[0].visible is False:
        return {"transfer": _UNSEEN}
    words: dict[str, Any] = {"window": state.slice_window, "cmap": state.cmap}
    words = {name: value for name, value in words.items() if value is not None}
    return {"transfer": state.transfer} if as_mode(state.mode).regions and state.transfer and not words else words


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
    given = {name: value for name, value in vars(shown).items() if value is not None and name != "name"}
    transfer, opacity = medium.transfer, given.get("opacity")
    if transfer is None:
        if opacity is not None and is_curve(medium.opacity):
            given["opacity"] = [(value, min(1.0, opacity * one)) for value, one in medium.opacity]  # type: ignore[union-attr]  # pairs
        return given
    words = [name for name in ("cmap", "window") if name in given]
    if isinstance(transfer, TransferFunction2D):
        if words:
            raise OptionError(f"{words[0]} changes nothing of a medium with a TransferFunction2D; got {given[words[0]]!r}")
    elif words:
        transfer = _looked(transfer, given.get("cmap"), given.get("window"))
    if opacity is not None:
        transfer = seen_through(transfer, opacity)
    seen = {name: value for name, value in given.items() if name == "visible"}
    return seen if transfer is medium.transfer else seen | {"transfer": transfer}


def _looked(transfer: TransferFunction, cmap: str | None, window: tuple[float, float] | None) -> TransferFunction:
    """A function with the colours of a map, and its values moved into a window."""
    if cmap is not None:
        transfer = replace(transfer, colors=TransferFunction.from_cmap(cmap, transfer.value_range).colors)
    if window is None:
        return transfer
    (low, high), (center, width) = transfer.value_range, window
    scale = width / ((high - low) or 1.0)

    def moved(points: Sequence[tuple[float, Any]]) -> tuple[tuple[float, Any], ...]:
        return tuple((center + (value - (low + high) / 2) * scale, what) for value, what in points)

    return replace(transfer, colors=moved(transfer.colors), opacities=moved(transfer.opacities))


def require(media: Sequence[Medium], state: State) -> None:
    """`OptionError` unless a state has none or all of these media, and of the first, which is edited itself, no look."""
    if state.media and len(state.media) != len(media):
        raise OptionError(f"media must be left out, or one for each of the scene's {len(media)}; got {len(state.media)}")
    looks = ("cmap", "opacity", "window")
    if state.media and any(getattr(state.media[0], name) is not None for name in looks):
        raise OptionError(f"media must have no {', '.join(looks)} for the first: those of the state are its own")
    of_state(media, state)


def named(names: Sequence[str], state: State) -> State:
    """A state of these media, each with its name."""
    if len(state.media) != len(names):
        return state
    return replace(state, media=tuple(replace(one, name=name) for one, name in zip(state.media, names, strict=True)))


def fitted(media: Sequence[Medium], names: Sequence[str], state: State) -> tuple[State, str]:
    """A state that may be of other layers, as far as it is of these; and what is left out, in words.

    The first is the first; others are found by their names, or, without, by their places.
    """
    found: dict[int, MediumState] = {}
    lost: list[str] = []
    for place, one in enumerate(state.media):
        free = [k for k in range(min(place, 1), len(media)) if k not in found]
        like = free if not place else [k for k in free if (k == place if one.name is None else names[k] == one.name)]
        try:
            if like:
                changes(media[like[0]], one)
                found[like[0]] = one
            elif place:
                lost.append(f"no layer {one.name or place + 1}")
            elif one.visible is False:
                lost.append(f"{names[0]} is alone, and seen")
        except OptionError as error:
            lost.append(f"{names[like[0]]}: {error}")
    own = [found.get(k, MediumState()) for k in range(len(media))] if found else []
    return named(names, replace(state, media=tuple(own))), "; ".join(lost) and f"not restored: {'; '.join(lost)}"


def described(media: Sequence[Medium], names: Sequence[str]) -> list[dict[str, Any]]:
    """For a panel: each medium's name, how it is seen if a state leaves it open, and whether it takes other colours.

    A view of one medium lists none, but has its name.
    """
    return [_described(medium, name, number) for number, (medium, name) in enumerate(zip(media, names, strict=False), 1)]


def _described(medium: Medium, name: str, number: int) -> dict[str, Any]:
    return {
        "name": name,
        "visible": bool(medium.visible),
        "edited": number > 1 and medium.surfaces is None and not isinstance(medium.transfer, TransferFunction2D),
        "cmap": medium.cmap,
        "window": list(_window_of(medium)),
        "opacity": None if medium.opacity is None or is_curve(medium.opacity) else float(medium.opacity),  # type: ignore[arg-type]  # one
    }


def _window_of(medium: Medium) -> tuple[float, float]:
    """Which values it tells apart, where a state leaves it open."""
    if medium.transfer is None and medium.window is not None:
        return medium.window
    ends = (
        (medium.transfer or covering(medium.volume, medium.words)).value_range if not medium.surfaces else medium.volume.value_range
    )
    low, high = map(float, ends)
    return low / 2 + high / 2, (high - low) or 1.0
