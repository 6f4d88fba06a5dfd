"""Layers come and go while clients look: added and removed in Python and by a client, shown everywhere, copied bit for bit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import clvol
from clvol.base.errors import ClvolError, GeometryError, OptionError
from clvol.device import Device
from clvol.show.picture import to_bytes
from clvol.view import View
from clvol.view.panes import camera_of
from clvol.volume.volumes import Leading
from tests.view.clients import Client

Z, Y, X = np.mgrid[-1:1:16j, -1:1:16j, -1:1:16j].astype(np.float32)
BALL = clvol.Volume(1 - np.sqrt(X**2 + Y**2 + Z**2), name="ball")
SPOT = clvol.Volume(np.exp(-8 * ((X - 0.3) ** 2 + Y**2 + Z**2)), name="spot")
PARTS = clvol.Volume((X > 0).astype(np.uint8), labels={1: "right"}, name="parts")
AT_REST = SIZE = 48, 40


@pytest.fixture
def view(device: Device) -> Iterator[View]:
    made = View(BALL, device=device)
    yield made
    made.close()


def names(client: Client) -> list[str]:
    """Of the media that the client was told of last."""
    return [one["name"] for one in client.of("info")[-1]["media"]]


def test_layers_are_drawn_as_a_scene_and_leave_nothing(view: View, device: Device) -> None:
    alone = view.picture(SIZE)
    spot = view.layers.add(SPOT)
    parts = view.layers.add(PARTS, opacity=0.2)
    assert [one.volume.name for one in view.layers] == ["ball", "spot", "parts"]
    assert (len(view.layers), view.layers[1]) == (3, spot)
    assert (spot.cmap, spot.opacity, parts.cmap, parts.opacity) == ("hot", None, None, 0.2)
    scene = clvol.Scene([BALL, spot, parts])
    assert_array_equal(view.picture(SIZE), clvol.render(scene, camera_of(view.state), size=SIZE, device=device))
    view.layers.remove(spot)
    view.layers.remove(1)
    assert_array_equal(view.picture(SIZE), alone)
    assert "others" not in view.python(SIZE)


def test_clients_see_them_at_once_and_their_undo_stays_right(view: View, client: Client) -> None:
    view.layers.add(SPOT)
    client.wait(lambda m: m["type"] == "info" and len(m["media"]) == 2)
    client.still()
    view.layers.add(PARTS)
    client.wait(lambda m: m["type"] == "info" and len(m["media"]) == 3)
    client.set(media=[{}, {"visible": False}, {"opacity": 0.25}])
    client.set(camera__zoom=2.0)
    client.wait(lambda m: m["type"] == "state" and m["state"]["camera"]["zoom"] == 2.0)
    client.forget()
    client.session.receive({"type": "do", "what": "remove_layer", "layer": 1, "id": 5})
    client.wait(lambda m: m["type"] == "info" and len(m["media"]) == 2)
    assert names(client) == ["ball", "parts"]
    client.still()
    assert client.session.state.json()["media"][1:] == [
        {"name": "parts", "visible": None, "window": None, "cmap": None, "opacity": 0.25}
    ]
    for _ in range(2):
        client.session.receive({"type": "do", "what": "undo", "id": 6})
    client.wait(lambda m: m["type"] == "state" and not m["state"]["media"])
    client.session.receive({"type": "do", "what": "remove_layer", "layer": 0, "id": 7})
    assert "must be" in client.wait(lambda m: m["type"] == "reply" and m["id"] == 7)[0]["error"]


def test_a_state_of_other_layers_is_restored_as_far_as_it_fits(view: View, client: Client) -> None:
    def restore(url: str, says: str) -> Any:
        client.session.receive({"type": "do", "what": "restore", "url": url, "id": url})
        assert "error" not in client.wait(lambda m: m["type"] == "reply" and m["id"] == url)[0]
        client.wait(lambda m: m["type"] == "status" and m["text"] == says)
        return client.session.state

    for one in (SPOT, PARTS):
        view.layers.add(one)
    client.wait(lambda m: m["type"] == "info" and len(m["media"]) == 3)
    client.set(mode="mip", media=[{"visible": False}, {"opacity": 0.5, "cmap": "green"}, {"opacity": 0.25}])
    client.wait(lambda m: m["type"] == "state" and m["state"]["mode"] == "mip")
    client.forget()
    address = client.session.url()
    view.layers.remove(1)
    view.layers.add(clvol.Medium(SPOT, clvol.TransferFunction2D.automatic(SPOT)))
    client.wait(lambda m: m["type"] == "info" and [one["name"] for one in m["media"]] == ["ball", "parts", "spot"])
    client.set(mode="mean")
    state = restore(address, "not restored: spot: cmap changes nothing of a medium with a TransferFunction2D; got 'green'")
    assert (state.mode, state.media[0].visible) == ("mip", False)
    assert [(one.name, one.opacity) for one in state.media[1:]] == [("parts", 0.25), ("spot", None)]
    view.layers.remove(2)
    client.set(mode="mean")
    client.wait(lambda m: m["type"] == "status" and m["text"] == "")
    view.layers.remove(1)
    client.session.receive({"type": "set", "changes": state.json(), "whole": True})  # as a page that is connected again
    client.wait(
        lambda m: m["type"] == "status" and m["text"] == "not restored: ball is alone, and seen; no layer parts; no layer spot"
    )
    assert (client.session.state.mode, client.session.state.media) == ("mip", ())


@pytest.mark.parametrize("pane", ["3d", "z"])
def test_a_copy_draws_what_was_added(view: View, client: Client, pane: str, tmp_path: Any) -> None:
    path = tmp_path / "parts.nii.gz"
    clvol.write(PARTS, path)
    view.layers.add(clvol.read(path), source=f"clvol.read({str(path)!r})", opacity=0.3)
    view.layers.add(SPOT, source="clvol.Volume(spot)", cmap="green", window=(0.5, 0.8))
    client.wait(lambda m: m["type"] == "info" and len(m["media"]) == 3)
    client.forget()
    client.set(layout="slice" if pane == "z" else "3d", active=pane, media=[{}, {"opacity": 0.6}, {}])
    _, shown = client.still(pane)
    assert client.session.state.media[1].opacity == 0.6
    held: dict[str, Any] = {"clvol": clvol, "volume": BALL, "spot": SPOT.data}
    exec(client.session.python(), held)
    assert_array_equal(to_bytes(held["picture"])[..., :3], shown)


def test_arrays_channels_and_names(view: View) -> None:
    view.layers.add(SPOT.data, name="of the same grid")
    assert view.layers[1].volume.origin == BALL.origin
    leading = Leading(("channel",), (2,), {"channel": ("DAPI", "GFP")}, colors=("blue", "green"))
    view.layers.add(clvol.Volumes(np.stack([SPOT.data, BALL.data]), leading=leading))
    assert len(view.layers) == 4
    assert [one.cmap for one in view.layers][2:] == [None, None]  # they have colours of their own
    assert view.resident.info()["media"][1]["name"] == "of the same grid"
    unnamed = View(replace(BALL, name=""), name="ball.nii", device=view.resident.device)  # as of a file
    unnamed.layers.add(SPOT)
    assert unnamed.layers.names == ["ball.nii", "spot"]


@pytest.mark.parametrize(
    ("data", "words", "error", "says"),
    [
        (SPOT.data[1:], {}, OptionError, "must have the shape of the first volume"),
        (replace(SPOT, space="LPS"), {}, GeometryError, "one world"),
        (SPOT, {"sharpness": 3}, ClvolError, "sharpness"),
    ],
)
def test_what_does_not_fit_is_refused_and_changes_nothing(
    view: View, data: Any, words: dict[str, Any], error: type[Exception], says: str
) -> None:
    view.layers.add(replace(SPOT, space="image"))
    version = view.layers.version
    with pytest.raises((error, TypeError) if words else error, match=says):
        view.layers.add(data, **words)
    assert (len(view.layers), view.layers.version) == (2, version)


def test_no_more_than_eight(view: View) -> None:
    for _ in range(7):
        view.layers.add(SPOT)
    with pytest.raises(OptionError, match="1 to 8 media"):
        view.layers.add(SPOT)
    for wrong in (0, 8, True, clvol.Medium(SPOT)):
        with pytest.raises(OptionError, match="layer must be one of those added"):
            view.layers.remove(wrong)
