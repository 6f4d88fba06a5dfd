"""A sketch while coefficients are computed: a picture of few of the samples, with the same look."""

from __future__ import annotations

from dataclasses import replace

from clvol.filter.filter import Filter
from clvol.march.renderer import Renderer
from clvol.scene.fit import box_around, fitted
from clvol.scene.preset import unit_of
from clvol.show.picture import Picture
from clvol.view.catalog import Which
from clvol.view.panes import camera_of
from clvol.view.renderers import rule_of
from clvol.view.resident import Resident, targeted
from clvol.view.state import WORDS, State
from clvol.volume.evenly import evenly
from clvol.volume.smoothing import filter_for
from clvol.volume.volume import Volume

__all__ = ["Sketch", "thinned", "without_prefilter"]

_EDGE = 192  # pixels: more would not show more of so few samples


class Sketch:
    """Few samples of a volume on the device.

    They are used as coefficients, without a prefilter. Where the state leaves it open, their look follows from them alone: to
    compute it from all samples takes long. The camera is that of the whole volume.
    """

    def __init__(self, resident: Resident, which: Which) -> None:
        self.which = which
        self._whole = resident.catalog.volume_at(which)
        self._few = Resident(thinned(self._whole), device=resident.device, limits=resident.limits, **resident.beside)
        self._renderer: Renderer | None = None
        self._key: tuple[str | None, str, str] | None = None

    def picture(self, state: State, size: tuple[int, int]) -> Picture:
        """A picture of at most `_EDGE` pixels along each edge, with the aspect ratio of `size`."""
        state = replace(state, index={}, labels=None, media=())  # the samples are of these
        few, mode = self._few, self._few.mode(state)
        transfer = few.transfer(state)
        unit = transfer.unit_distance if state.transfer is not None else unit_of(self._whole)
        transfer = replace(transfer, unit_distance=unit or self._whole.mean_spacing)  # that of the samples is wider
        aspect = size[0] / size[1]
        camera = state.furniture.in_view(camera_of(state), *box_around([(self._whole, state.clip)]), aspect)
        camera = targeted(fitted(camera, self._whole, mode, transfer, state.clip, aspect), self._whole)
        if camera.radius is None:
            camera = replace(camera, radius=self._whole.radius)
        given = {
            name: value
            for name, value in few.arguments(state, bare=True).items()
            if name not in (*WORDS, "transfer", "pixel_filter")
        }
        given |= {"camera": camera, "rays": 1} | ({} if "transfer" in mode.unheard else {"transfer": transfer})
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
            self._renderer = Renderer(self._few.volume, without_prefilter(row), rule_of(state.boundary), self._few.device)
            self._key = key
        return self._renderer


def without_prefilter(row: Filter) -> Filter:
    """The same kernel applied to samples instead of coefficients."""
    return replace(row, prefilter=False, smoothing=0.0, length=None) if row.prefilter else row


def thinned(volume: Volume) -> Volume:
    """Every n-th sample of a volume, where it lies."""
    found = evenly(volume)
    spacing = tuple(s * step for s, step in zip(found.grid.spacing, found.steps, strict=True))
    return replace(volume, data=found.data.copy(), spacing=spacing, origin=tuple(found.grid.index_to_world(found.firsts)))
