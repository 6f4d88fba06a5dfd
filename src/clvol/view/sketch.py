"""What is shown of a volume while the coefficients of all its samples are made: a picture of a few of them, of the same look."""

from __future__ import annotations

from dataclasses import replace

from clvol.filter.filter import Filter
from clvol.march.renderer import Renderer
from clvol.scene.fit import fitted, spread
from clvol.scene.palette import unit_of
from clvol.show.picture import Picture
from clvol.view.panes import camera_of
from clvol.view.resident import Resident, Which, targeted
from clvol.view.state import State
from clvol.volume.smoothing import filter_for
from clvol.volume.volume import Volume

__all__ = ["Sketch", "thinned", "without_prefilter"]

_SAMPLES = 64  # along each axis
_EDGE = 192  # pixels: more would show no more of so few samples


class Sketch:
    """A few samples of one of the volumes that are looked at, on the device.

    They are taken for coefficients, so that there is nothing to solve. How they look follows from them alone, where the state
    leaves it open: of all samples that takes long to find out. Where they lie in the picture is the whole volume's affair.
    """

    def __init__(self, resident: Resident, which: Which) -> None:
        self.which = which
        self._whole = resident.volume_at(which)
        self._few = Resident(thinned(self._whole), device=resident.device, limits=resident.limits, **resident.beside)
        self._renderer: Renderer | None = None
        self._key: tuple[str | None, str, str] | None = None

    def picture(self, state: State, size: tuple[int, int]) -> Picture:
        """One of at most `_EDGE` pixels along each edge, of the shape of `size`."""
        state = replace(state, index={}, labels=None)  # which are in the samples
        few, mode = self._few, self._few.mode(state)
        transfer = few.transfer(state)
        unit = transfer.unit_distance if state.transfer is not None else unit_of(self._whole)
        transfer = replace(transfer, unit_distance=unit or self._whole.mean_spacing)  # the samples' own is wider
        camera = targeted(fitted(camera_of(state), self._whole, mode, transfer, state.clip, size[0] / size[1]), self._whole)
        if camera.radius is None:
            camera = replace(camera, radius=self._whole.radius)
        words = ("preset", "window", "cmap", "opacity")
        given = {name: value for name, value in few.arguments(state).items() if name not in words}
        given |= {"camera": camera, "transfer": transfer, "samples": 1}
        shrink = min(1.0, _EDGE / max(size))
        width, height = (max(1, round(shrink * n)) for n in size)
        renderer = self._drawn_by(state)
        with renderer.device.limited(**few.limits):
            drawn: Picture = renderer.render(size=(width, height), **given)
        return drawn

    def _drawn_by(self, state: State) -> Renderer:
        key = state.filter, state.boundary, state.mode
        if self._renderer is None or self._key != key:
            row = filter_for(self._few.volume, state.filter, self._few.mode(state).picture_filter)
            self._renderer = Renderer(self._few.volume, without_prefilter(row), state.boundary, self._few.device)
            self._key = key
        return self._renderer


def without_prefilter(row: Filter) -> Filter:
    """The filter's own kernel, which takes samples for coefficients."""
    return replace(row, prefilter=False, smoothing=0.0, length=None) if row.prefilter else row


def thinned(volume: Volume) -> Volume:
    """Every so many of a volume's samples, where they lie."""
    some, firsts, steps = spread(volume, _SAMPLES)
    spacing = tuple(s * step for s, step in zip(volume.spacing, steps, strict=True))
    return replace(volume, data=some.copy(), spacing=spacing, origin=tuple(volume.index_to_world(firsts)))
