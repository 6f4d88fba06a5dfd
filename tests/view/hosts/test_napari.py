"""napari's dock widget and layer action, driven without a window; skipped where napari is not installed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]

_DRIVEN = """
import json, sys, warnings
warnings.simplefilter("ignore")
import numpy as np
from napari.components import ViewerModel
import clvol
from clvol.view.hosts.napari_widget import RenderWidget, camera_of, picture_of, volume_of
from npe2 import PluginManifest

manifest = PluginManifest.from_file(sys.argv[1])
told = {"widgets": [w.display_name for w in manifest.contributions.widgets]}
told["menus"] = [str(m.command) for m in manifest.contributions.menus["napari/layers/context"]]
from importlib import import_module
told["found"] = all(callable(getattr(import_module(c.python_name.split(":")[0]), c.python_name.split(":")[1]))
                    for c in manifest.contributions.commands)

data = np.zeros((20, 20, 20), "f4")
data[3:7, 3:7, 13:17] = 1  # near (z, y, x) = (5, 5, 15)
viewer = ViewerModel(ndisplay=3)
layer = viewer.add_image(data, name="block")
shown = picture_of(viewer, layer, "mip", 64)[..., :3].sum(-1).astype(float)
y, x = (float((shown * grid).sum() / shown.sum()) for grid in np.mgrid[:64, :64])
told["default view"] = [x > 32, y < 32]  # x runs to the right and y down, as napari shows them
viewer.camera.angles = (30, 40, 50)
camera, mirrored = camera_of(viewer.camera)
told["direction"] = [np.allclose(camera.direction[::-1], viewer.camera.view_direction), mirrored]

# the place on the screen by napari's own directions, orthographic
view, up = (np.array(v, float) for v in (viewer.camera.view_direction, viewer.camera.up_direction))
right = np.cross(view, up) * (1 if mirrored else -1)  # of z, y, x
viewer.camera.perspective = 0
places = np.array([[5, 5, 15], [15, 15, 5], [10, 4, 4]], float)
off = []
for place in places:
    one = np.zeros_like(data); one[tuple(place.astype(int))] = 1
    two = viewer.add_image(one, name="one")
    picture = picture_of(viewer, two, "mip", 256, filter="linear")[..., :3].sum(-1).astype(float)
    viewer.layers.remove(two)
    y, x = (float((picture * grid).sum() / picture.sum()) for grid in np.mgrid[:256, :256])
    off.append([x, y, float((place - 9.5) @ right), float((place - 9.5) @ up)])
told["screen"] = off

widget = RenderWidget(viewer)
viewer.layers.selection.active = layer
widget.mode.value, widget.filter.value, widget.pixels.value = "mip", "linear", 48
widget.button.changed.emit(True)
made = viewer.layers["block by clvol"]
told["made"] = [made.rgb, list(made.data.shape), int(made.data.max()), widget.message.value]
widget.pixels.value = 40
widget.button.changed.emit(True)
told["again"] = [len(viewer.layers), list(viewer.layers["block by clvol"].data.shape)]
viewer.layers.selection.active = made
widget.draw()
told["colours"] = widget.message.value
viewer.layers.selection.clear()
widget.draw()
told["none"] = widget.message.value
series = viewer.add_image(np.stack([0 * data, data, 2 * data]), name="series", scale=(5, 1, 1, 1))
viewer.dims.set_point(0, 10)
told["series"] = float(volume_of(viewer, series).data.max())
print(json.dumps(told))
"""


def test_the_manifest_is_at_its_entry_point() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    package, _, name = project["entry-points"]["napari.manifest"]["clvol"].partition(":")
    assert (ROOT / "src" / package / name).is_file()
    assert {"napari", "desktop"} <= project["optional-dependencies"].keys()


def test_a_widget_draws_the_selected_layer() -> None:
    python = os.environ.get("CLVOL_TEST_NAPARI", sys.executable)
    known = subprocess.run([python, "-c", "import napari, magicgui"], capture_output=True, timeout=60, check=False)
    if known.returncode:
        pytest.skip("napari is not installed")
    done = subprocess.run(
        [python, "-c", _DRIVEN, str(ROOT / "src" / "clvol" / "napari.yaml")],
        capture_output=True, text=True, timeout=200, check=False, env=os.environ | {"QT_QPA_PLATFORM": "offscreen"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout.splitlines()[-1])
    assert told["widgets"] == ["clvol: render"]
    assert told["menus"] == ["clvol.render_layer"]
    assert told["found"]
    assert told["default view"] == [True, True]
    assert told["direction"][0]
    scale = [a / b for x, y, right, up in told["screen"] for a, b in ((x - 127.5, right), (127.5 - y, up)) if abs(b) > 2]
    assert len(scale) >= 4
    assert min(scale) > 0.9 * max(scale) > 0, told["screen"]  # one magnification, and no axis turned
    assert told["made"][:2] == [True, [48, 48, 4]]
    assert told["made"][2] > 100
    assert told["made"][3] == ""
    assert told["again"] == [2, [40, 40, 4]]
    assert told["colours"] == "a layer must have one value a voxel; 'block by clvol' is in colours: split it into channels"
    assert told["none"] == "one layer must be selected, of an image or of labels"
    assert told["series"] == 2
