"""In napari: a dock widget and a layer action that draw the selected layer as it is seen (``pip install "clvol[napari]"``)."""

from __future__ import annotations

from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import MissingDependencyError, OptionError
from clvol.filter.table import filters
from clvol.march.options import RenderOptions
from clvol.march.renderer import render
from clvol.scene.camera import Camera
from clvol.scene.mode import DEFAULT_MODE, modes
from clvol.scene.preset import presets
from clvol.show.picture import to_bytes
from clvol.volume.volume import Volume
from clvol.volume.volumes import Volumes

try:
    from magicgui import widgets
except ImportError as missing:
    raise MissingDependencyError('clvol in napari needs napari and magicgui: pip install "clvol[napari]"') from missing

__all__ = ["RenderWidget", "camera_of", "picture_of", "render_selected", "volume_of"]

_AUTO = "(default)"
_SIZE = 512
_MOST = 4096


class RenderWidget(widgets.Container):  # type: ignore[misc]  # magicgui has no types
    """The dock widget: draws the selected layer as napari's camera sees it into an RGB layer."""

    def __init__(self, napari_viewer: Any) -> None:
        self._viewer = napari_viewer
        self.mode = widgets.ComboBox(label="mode", choices=list(modes()), value=DEFAULT_MODE)
        self.filter = widgets.ComboBox(label="filter", choices=[_AUTO, *(f.name for f in filters().values())], value=_AUTO)
        self.preset = widgets.ComboBox(label="preset", choices=[_AUTO, *presets()], value=_AUTO)
        self.pixels = widgets.SpinBox(label="pixels", value=_SIZE, min=16, max=_MOST)
        self.button = widgets.PushButton(text="Render")
        self.message = widgets.Label(value="")
        super().__init__(widgets=[self.mode, self.filter, self.preset, self.pixels, self.button, self.message])
        self.button.changed.connect(self.draw)

    def draw(self) -> None:
        """Draw it; errors are shown below the button."""
        options = {"filter": self.filter.value, "preset": self.preset.value}
        try:
            _show(self._viewer, self.mode.value, self.pixels.value, **{k: v for k, v in options.items() if v != _AUTO})
        except Exception as error:  # users see the widget, not a terminal
            self.message.value = str(error)
        else:
            self.message.value = ""


def render_selected() -> None:
    """The action of the layer menu: draw the selected layer in the default mode."""
    import napari

    viewer = napari.current_viewer()
    if viewer is None:
        raise OptionError("there must be a viewer of napari; there is none")
    _show(viewer, DEFAULT_MODE, _SIZE)


def picture_of(
    viewer: Any, layer: Any, mode: str = DEFAULT_MODE, pixels: int = _SIZE, **options: Unpack[RenderOptions]
) -> NDArray[np.uint8]:
    """A picture of a layer, square, as the viewer's camera sees it, fitted to the layer; options are those of `clvol.render`."""
    camera, mirrored = camera_of(viewer.camera)
    picture = to_bytes(render(volume_of(viewer, layer), camera=camera, mode=mode, size=(pixels, pixels), **options))
    return np.ascontiguousarray(picture[:, ::-1]) if mirrored else picture


def camera_of(camera: Any) -> tuple[Camera, bool]:
    """A camera with the direction of napari's, and whether its pictures are mirrored.

    Since version 0.6 napari's z, y, x are right-handed by default; that world is the mirror image of x, y, z.
    """
    direction, up = (tuple(float(v) for v in vector[::-1]) for vector in (camera.view_direction, camera.up_direction))
    handed = getattr(camera, "handedness", "left")
    fov = float(camera.perspective)
    flat = not 1 <= fov < 175
    found = Camera(
        direction=direction,  # type: ignore[arg-type]  # of three
        up=up,  # type: ignore[arg-type]
        upright=False,
        fit="volume",  # the whole layer, as steady as in the viewer
        projection="orthographic" if flat else "perspective",
        fov=30.0 if flat else fov,
    )
    return found, str(getattr(handed, "value", handed)) == "right"


def volume_of(viewer: Any, layer: Any) -> Volume:
    """The layer's volume; of several the one that the viewer's sliders select."""
    if getattr(layer, "rgb", False):
        raise OptionError(f"a layer must have one value a voxel; {layer.name!r} is in colours: split it into channels")
    if layer.ndim < 3:
        raise OptionError(f"a layer must have three axes to be rendered; {layer.name!r} has {layer.ndim}")
    if layer.ndim == 3:
        return Volume(layer)
    volumes = Volumes(layer)
    counts = volumes.leading.counts
    at = layer.world_to_data(tuple(viewer.dims.point)[-layer.ndim :])[: len(counts)]
    place = tuple(min(max(round(float(x)), 0), n - 1) for x, n in zip(at, counts, strict=True))
    return volumes[int(np.ravel_multi_index(place, counts))]


def _show(viewer: Any, mode: str, pixels: int, **options: Unpack[RenderOptions]) -> None:
    """Put the picture of the selected layer into another layer, or replace that of the last time."""
    layer = viewer.layers.selection.active
    if layer is None:
        raise OptionError("one layer must be selected, of an image or of labels")
    picture = picture_of(viewer, layer, mode, pixels, **options)
    name = f"{layer.name} by clvol"
    if name in viewer.layers:
        viewer.layers[name].data = picture
    else:
        viewer.add_image(picture, rgb=True, name=name)
        viewer.layers.selection.active = layer  # so that the next picture shows it again
