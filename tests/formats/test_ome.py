"""OME-Zarr metadata, from dictionaries alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clvol.base.errors import FormatError
from clvol.formats.zarr import ome

AXES = [{"name": "c", "type": "channel"}, *({"name": name, "type": "space", "unit": "micrometer"} for name in "zyx")]


def image(*steps: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {"axes": AXES, "datasets": [{"path": "0", "coordinateTransformations": list(steps)}], **more}


def test_transformations_are_composed_with_the_levels_first() -> None:
    scale, shift = {"type": "scale", "scale": [1, 2, 3, 4]}, {"type": "translation", "translation": [0, 1, 1, 1]}
    twice = [{"type": "scale", "scale": [1, 2, 2, 2]}, {"type": "identity"}]
    assert ome.placed("a", image(scale, shift), 0, 4) == ([1, 2, 3, 4], [0, 1, 1, 1])
    assert ome.placed("a", image(scale, shift, coordinateTransformations=twice), 0, 4) == ([1, 4, 6, 8], [0, 2, 2, 2])
    assert ome.placed("a", {"datasets": [{"path": "0"}]}, 0, 3) == ([1, 1, 1], [0, 0, 0])


@pytest.mark.parametrize(
    ("step", "message"),
    [
        ({"type": "affine", "affine": []}, "a must place its axes by a scale and a translation of 4 numbers"),
        ({"type": "scale", "scale": [1, 2]}, "4 numbers"),
        ({"type": "scale", "path": "elsewhere"}, "4 numbers"),
        ({"type": "scale", "scale": [1, 1, 1, -1]}, "a must have scales that are positive"),
    ],
)
def test_other_transformations_are_rejected(step: dict[str, Any], message: str) -> None:
    with pytest.raises(FormatError, match=message):
        ome.placed("a", image(step), 0, 4)


@pytest.mark.parametrize("key", ["ome", ""])
def test_axes_channels_and_geometry(key: str) -> None:
    """Version 0.5 nests them under its own key."""
    channels = [
        {"label": "DAPI", "color": "0000FF", "window": {"start": 0, "end": 100}},
        {"label": "GFP", "color": "#00ff00aa", "window": {"start": 5, "end": float("inf")}},
        {"color": "green"},
    ]
    about: dict[str, Any] = {"omero": {"channels": channels}}
    multiscales = image({"type": "scale", "scale": [1, 2, 0.5, 0.25]}, {"type": "translation", "translation": [0, 6, 5, 4]})
    layout, leading, known = ome.described("a", {key: about} if key else about, multiscales, 0, (3, 4, 5, 6))
    assert layout.axes == ("channel", "z", "y", "x")
    assert leading.names == {"channel": ("DAPI", "GFP", "")}
    assert leading.colors == ((0, 0, 1), (0, 1, 0), None)
    assert leading.clims == ((0, 100), None, None)
    assert (list(known["spacing"]), list(known["origin"]), known["units"]) == ([0.25, 0.5, 2], [4, 5, 6], "um")
    assert known["space"] == "image"


def test_a_channel_without_an_axis_describes_the_volume() -> None:
    about = {"omero": {"channels": [{"label": "DAPI", "color": "0000FF"}]}}
    known = ome.described("a", about, {"axes": AXES[1:], "datasets": [{"path": "0"}]}, 0, (4, 5, 6))[2]
    assert (known["name"], known["color"]) == ("DAPI", (0, 0, 1))


def test_versions_without_axes_use_the_last_of_tczyx() -> None:
    layout = ome.described("a", {}, {"datasets": [{"path": "0"}]}, 0, (2, 4, 5, 6))[0]
    assert layout.axes == ("channel", "z", "y", "x")


def test_a_pyramid_of_clvol_has_a_direction() -> None:
    turned = [[0, 1, 0], [1, 0, 0], [0, 0, -1]]
    about = {"clvol": {"space": "LPS", "direction": turned}}
    placed = {"type": "translation", "translation": [3, 2, 1]}
    multiscales = {"axes": AXES[1:], "datasets": [{"path": "0", "coordinateTransformations": [placed]}]}
    known = ome.described("a", about, multiscales, 0, (4, 5, 6))[2]
    assert known["space"] == "LPS"
    np.testing.assert_array_equal(known["direction"], turned)
    assert known["origin"] == [2, 1, -3]


def test_labels_are_named_by_their_properties() -> None:
    properties = [{"label-value": 1, "name": "nucleus"}, {"label-value": 2, "class": "membrane"}, {"label-value": 3}, {"name": "x"}]
    for about in ({"image-label": {"properties": properties}}, {"ome": {"image-label": {"properties": properties}}}):
        assert ome.labels_of(about) == {1: ("nucleus",), 2: ("membrane",)}
    assert ome.labels_of({}) == {}
