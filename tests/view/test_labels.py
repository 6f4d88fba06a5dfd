"""Hidden labels in a view: absent from pictures and copied programs, and rejected where there are none."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import clvol
from clvol import Volume
from clvol.base.errors import OptionError, OutOfMemoryError
from clvol.device import Device
from clvol.scene.preset import label_color
from clvol.show.picture import to_bytes
from clvol.view import State, View, from_toml, from_url, section
from clvol.view.catalog import Which
from clvol.view.resident import Resident
from clvol.view.state import LabelState
from tests.view.clients import Client

AT_REST = SIZE = 96, 72
NAMES = {1: "left ball", 2: "right ball"}


def balls() -> NDArray[np.uint8]:
    """Touching balls of label 1 and 2, on an empty background."""
    z, y, x = np.mgrid[:24, :24, :40]
    data = np.zeros(z.shape, np.uint8)
    for number, middle in ((1, 13), (2, 27)):
        data[(x - middle) ** 2 + (y - 12) ** 2 + (z - 12) ** 2 < 64] = number
    return data


@pytest.fixture(scope="module")
def volume() -> Volume:
    return Volume(balls(), spacing=(1, 1.1, 1.2), labels=NAMES)


def copied(client: Client, volume: Volume) -> NDArray[np.uint8]:
    space: dict[str, Any] = {"volume": volume}
    exec(client.session.python(), space)
    return to_bytes(space["picture"])[..., :3]


@pytest.mark.one_in(6)
@pytest.mark.parametrize(
    "look",
    [
        {},
        {"mode": "isosurface"},
        {"mode": "mip"},
        {"mode": "mean"},
        {"filter": "linear"},
        {"preset": "labels"},
        {"transfer.points": [[0.5, [1, 0, 0], 0.0], [1, [1, 0, 0], 0.5], [2, [0, 0, 1], 0.9]]},
        {"layout": "slice", "active": "z"},
        {"layout": "slice", "active": "y", "window": [1, 2]},
    ],
    ids=lambda look: "-".join(map(str, look)) or "default",
)
@pytest.mark.parametrize("labels", [{"hidden": [2]}, {"shown": [1]}], ids=lambda labels: "".join(labels))
def test_hidden_labels_are_background(
    client: Client, volume: Volume, device: Device, labels: dict[str, Any], look: dict[str, Any]
) -> None:
    pane = look.get("active", "3d")
    if look:
        client.set(**look)
        client.still(pane)
        client.forget()
    client.set(labels=labels)
    _, shown = client.still(pane)
    data = balls()
    data[data == 2] = 0
    state = client.session.state
    erased = View(Volume(data, spacing=(1, 1.1, 1.2), labels=NAMES), device=device)
    erased.state = State.from_json(state.json() | {"labels": None})
    other = Client(erased)
    other.resize(*SIZE)
    _, expected = other.still(pane)
    other.close()
    erased.close()
    assert np.array_equal(shown, expected)
    assert shown.any()
    assert np.array_equal(shown[..., :3], copied(client, volume))
    assert from_url(client.session.url()) == state
    assert from_toml(client.session.toml()) == state
    assert "labels are seen" in client.session.toml()
    assert not client.of("status")


@pytest.mark.parametrize("pane", ["3d", "z"])
def test_other_colours_and_opacities_are_those_of_the_table(client: Client, volume: Volume, device: Device, pane: str) -> None:
    """In pictures, slices and copied programs; hidden labels stay hidden."""
    if pane != "3d":
        client.set(layout="slice", active=pane)
        client.still(pane)
        client.forget()
    client.set(label_colors={"1": [0, 0, 1]}, label_opacities={"1": 0.25}, labels={"hidden": [2]})
    _, shown = client.still(pane)
    state = client.session.state
    given = View(clvol.labels.with_table(volume, {1: (None, "blue", 0.25)}), device=device)
    given.state = State.from_json(state.json() | {"label_colors": {}, "label_opacities": {}})
    other = Client(given)
    other.resize(*SIZE)
    _, expected = other.still(pane)
    other.close()
    given.close()
    assert np.array_equal(shown, expected)
    assert shown[..., 2].max() > 2 * shown[..., 0].max()
    assert np.array_equal(shown[..., :3], copied(client, volume))
    assert from_url(client.session.url()) == from_toml(client.session.toml()) == state
    assert "colours and opacities of labels" in client.session.toml()
    client.set(label_colors={"9": [0, 0, 1]})
    told, _ = client.wait(lambda m: m["type"] == "status" and m["kind"] == "error")
    assert "labels must be some of the volume's; got 9" in told["text"]


def test_the_other_ball_stays_in_place(client: Client, volume: Volume, device: Device) -> None:
    """By pixel colours and by the centres of both balls."""
    pictures = {}
    for word, labels in (("both", None), ("one", {"shown": [1]}), ("two", {"hidden": [1]}), ("none", {"shown": []})):
        client.forget()
        client.set(labels=labels, mode="composite", **{"options.shading": False})
        pictures[word] = client.still()[1][..., :3].astype(int)
    middle = [np.argwhere(pictures[word].any(-1)).mean(0) for word in ("one", "two")]
    both = np.argwhere(pictures["both"].any(-1)).mean(0)
    assert middle[0][1] < both[1] < middle[1][1]  # +x is on the right
    assert not pictures["none"].any()
    for word, number in (("one", 1), ("two", 2)):
        lit = pictures[word].sum(-1) > 200
        assert np.abs(np.median(pictures[word][lit], 0) - 255 * np.array(label_color(number))).max() < 6
    either = pictures["one"].any(-1) | pictures["two"].any(-1)
    assert np.array_equal(either, pictures["both"].any(-1))
    cut = section(volume, volume.center, (1, 0, 0), (0, 1, 0), (0.5, 0.5), (80, 60), device=device)
    assert {tuple(c) for c in np.round(cut[..., :3].reshape(-1, 3), 4)} == {
        (0, 0, 0),
        *(tuple(np.round(np.float32(label_color(n)), 4)) for n in (1, 2)),
    }


def test_the_camera_stays_and_undo_reverts(client: Client, view: View) -> None:
    before = client.session.state
    placed = view.resident.placed(before, SIZE[0] / SIZE[1])
    client.set(labels={"hidden": [2, 2]})
    client.still()
    state = client.session.state
    assert state.labels is not None
    assert state.labels.hidden == (2,)
    now = view.resident.placed(state, SIZE[0] / SIZE[1])
    assert (now.target, now.radius) == (placed.target, placed.radius)
    client.session.receive({"type": "do", "what": "undo", "id": 1})
    client.wait(lambda m: m["type"] == "reply" and m["id"] == 1)
    assert client.session.state == before
    client.session.receive({"type": "do", "what": "redo", "id": 2})
    client.wait(lambda m: m["type"] == "reply" and m["id"] == 2)
    assert client.session.state == state
    client.set(labels={"hidden": []})
    client.session.receive({"type": "do", "what": "fit", "id": 3})
    client.wait(lambda m: m["type"] == "reply" and m["id"] == 3)
    assert client.session.state == before


def test_the_edited_function_covers_all_labels(view: View, client: Client) -> None:
    before = view.resident.effective(client.session.state)["transfer"]
    client.set(labels={"shown": [2]})
    client.still()
    assert view.resident.effective(client.session.state)["transfer"] == before
    drawn = view.resident.transfer(client.session.state)([0, 2])
    assert np.array_equal(drawn, view.resident.transfer(State())([0, 2]))


def test_slices_beside_regions_have_their_boundaries(client: Client, volume: Volume) -> None:
    """Smooth ones, as copied programs draw them; what is picked there is what is seen."""
    client.set(layout="slice", active="z")
    nearest = client.still("z")[1]
    client.forget()
    client.set(mode="regions")
    shown = client.still("z")[1]
    assert 0.005 < (shown != nearest).any(-1).mean() < 0.1
    program = client.session.python()
    assert "smooth=True" in program
    assert "\nboundary =" not in client.session.toml()  # else flags would draw others than the viewer
    assert np.array_equal(shown[..., :3], copied(client, volume))
    colors = {0: (0, 0, 0), **{n: tuple(to_bytes(np.float32([[label_color(n)]]))[0, 0].tolist()) for n in (1, 2)}}
    for number, (y, x) in enumerate(np.argwhere((shown != nearest).any(-1))[::40]):
        client.session.receive({"type": "do", "what": "pick", "id": number, "pane": "z", "x": x + 0.5, "y": y + 0.5})
        reply, _ = client.wait(lambda m, number=number: m["type"] == "reply" and m["id"] == number)  # type: ignore[misc]
        assert colors[reply["value"]] == tuple(shown[y, x, :3].tolist())


def test_regions_are_picked_by_their_names(client: Client) -> None:
    """On their smooth boundary, where the B-spline of the labels themselves is between them."""
    client.set(mode="regions")
    client.still()
    at = {"what": "pick", "x": 0.62 * SIZE[0], "y": SIZE[1] / 2}
    client.session.receive({"type": "do", "id": 1, **at})
    found, _ = client.wait(lambda m: m["type"] == "reply" and m["id"] == 1)
    assert (found["value"], found["label"], found["gradient"]) == (2, "right ball", None)


def test_hidden_labels_cannot_be_picked(client: Client) -> None:
    at = {"what": "pick", "x": 0.62 * SIZE[0], "y": SIZE[1] / 2}
    client.session.receive({"type": "do", "id": 1, **at})
    found, _ = client.wait(lambda m: m["type"] == "reply" and m["id"] == 1)
    assert found["label"] == "right ball"
    client.set(labels={"hidden": [2]})
    client.session.receive({"type": "do", "id": 2, **at})
    found, _ = client.wait(lambda m: m["type"] == "reply" and m["id"] == 2)
    assert found["position"] is None


def test_a_label_is_picked_if_the_volume_does_not_fit_on_the_device(
    volume: Volume, device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The renderer then reads its samples by bricks."""

    def refuse(*_: Any) -> Any:
        raise OutOfMemoryError("out of memory")

    monkeypatch.setattr("clvol.march.source.single", refuse)
    view = View(volume, device=device)
    client = Client(view)
    client.resize(*SIZE)
    client.still()
    client.session.receive({"type": "do", "what": "pick", "id": 1, "x": 0.62 * SIZE[0], "y": SIZE[1] / 2})
    found, _ = client.wait(lambda m: m["type"] == "reply" and m["id"] == 1)
    assert "error" not in found
    assert found["label"] == "right ball"
    client.close()
    view.close()


@pytest.mark.parametrize(
    ("labels", "says"),
    [
        ({"hidden": [7]}, "labels must be some of the volume's; got 7, which it has not"),
        ({"shown": [0]}, "got 0, which it has not"),  # the background is none
        ({"hidden": list(range(1_000_000))}, "up to 2048 whole numbers; got 1000000 of them"),
        ({"hidden": ["1"]}, "each of labels.hidden must be a whole number"),
    ],
)
def test_unknown_labels_are_rejected(client: Client, labels: Any, says: str) -> None:
    before = client.session.state
    client.set(labels=labels)
    told, _ = client.wait(lambda m: m["type"] == "status" and m["kind"] == "error")
    assert says in told["text"]
    assert len(told["text"]) < 400
    assert client.session.state == before
    again, _ = client.wait(lambda m: m["type"] == "state")  # a page has shown the change already
    assert State.from_json(again["state"]) == before
    assert "effective" in again
    client.forget()
    client.set(labels={"hidden": [1]})
    client.still()


def test_a_volume_without_labels_has_none_to_hide(device: Device) -> None:
    view = View(clvol.phantoms.sphere(24), device=device)
    client = Client(view)
    info, _ = client.wait(lambda m: m["type"] == "info")
    assert info["labels"] is None
    client.set(labels={"hidden": [1]})
    told, _ = client.wait(lambda m: m["type"] == "status" and m["kind"] == "error")
    assert "labels must be left out, for the volume is no label map" in told["text"]
    client.close()
    with pytest.raises(OptionError, match="no label map"):
        view.session(lambda *_: None, State().changed({"labels": {"shown": [1]}}))
    view.close()


def test_of_thousands_of_labels_some_are_listed_and_all_are_found(device: Device) -> None:
    data = np.arange(5000, dtype=np.uint16).reshape(10, 20, 25).repeat(2, 2)
    view = View(Volume(data, labels={4321: "Hippocampus, left", 17: "right hippocampus"}), device=device)
    client = Client(view)
    info, _ = client.wait(lambda m: m["type"] == "info")
    assert info["labels"]["count"] == 4999
    assert [row[0] for row in info["labels"]["rows"]] == list(range(1, 201))
    assert info["labels"]["rows"][16] == [17, "right hippocampus", list(label_color(17)), 1.0]

    def found(words: Any) -> dict[str, Any]:
        client.session.receive({"type": "do", "what": "labels", "id": str(words)[:9], "words": words})
        return client.wait(lambda m: m["type"] == "reply" and m["id"] == str(words)[:9])[0]

    assert [row[0] for row in found(" hippoCAMPUS ")["rows"]] == [17, 4321]
    assert [row[0] for row in found("432")["rows"][:3]] == [432, 1432, 2432]
    assert (found("9")["count"], len(found("9")["rows"])) == (1355, 200)
    assert found("no such") | {"id": 0} == {"type": "reply", "id": 0, "what": "labels", "rows": [], "count": 0}
    for wrong in (3, "x" * 1000):
        assert "a text of up to 200 characters" in found(wrong)["error"]
    client.set(labels={"shown": [4321]})
    client.resize(*SIZE)
    _, picture = client.still()
    assert picture.any()
    client.close()
    view.close()


def test_labels_are_hidden_once_without_blocking_others(volume: Volume, device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    resident = Resident(volume, device=device)
    begun, go_on, calls = threading.Event(), threading.Event(), []
    without = clvol.labels.without

    def slow(*given: Any) -> Volume:
        calls.append(given)
        begun.set()
        assert go_on.wait(30)
        return without(*given)

    monkeypatch.setattr("clvol.labels.without", slow)
    hidden, found = State(labels=LabelState(hidden=(2,))), []
    threads = [threading.Thread(target=lambda: found.append(resident.catalog.volume_of(hidden)), daemon=True) for _ in range(3)]
    for thread in threads:
        thread.start()
    assert begun.wait(30)

    def others() -> None:
        assert not resident.catalog.known(resident.catalog.which(hidden))
        assert not resident.catalog.known(resident.catalog.which(State()))
        assert resident.catalog.volume_of(State()) is volume
        assert set(np.unique(resident.catalog.volume_of(State(labels=LabelState(shown=(2,)))).data)) == {0, 2}
        resident.catalog.require(hidden)
        told.append(resident.catalog.labels(hidden)[1])

    told: list[int] = []
    other = threading.Thread(target=others, daemon=True)
    other.start()
    other.join(20)
    assert told == [2]
    go_on.set()
    for thread in threads:
        thread.join(30)
    assert len(calls) == 1
    assert len(found) == 3
    assert all(one is found[0] for one in found)
    resident.close()


def test_hiding_is_retried_after_a_lack_of_memory(volume: Volume, device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    resident, hidden = Resident(volume, device=device), State(labels=LabelState(hidden=(2,)))

    def refuse(*_: Any) -> Any:
        raise OutOfMemoryError("out of memory")

    with monkeypatch.context() as patch:
        patch.setattr("clvol.labels.without", refuse)
        with pytest.raises(OutOfMemoryError):
            resident.catalog.volume_of(hidden)
    assert set(np.unique(resident.catalog.volume_of(hidden).data)) == {0, 1}
    resident.close()


def test_labels_are_scanned_once(view: View, client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not at each message: there may be a million."""
    view.resident.catalog.require(State(labels=LabelState(hidden=(1,))))
    monkeypatch.setattr("clvol.labels.numbers_of", lambda _: pytest.fail("all labels were gone through again"))
    view.resident.catalog.require(State(labels=LabelState(hidden=(2,))))
    assert [row[0] for row in view.resident.catalog.labels(State(), "ball")[0]] == [1, 2]
    texts = view.resident.catalog._listing(Which())._texts
    assert view.resident.catalog.labels(State(), "RIGHT")[1] == 1
    assert view.resident.catalog._listing(Which())._texts is texts
    client.set(labels={"hidden": [1]})
    client.wait(lambda m: m["type"] == "state" and m["state"]["labels"])
    asked: list[State] = []
    monkeypatch.setattr(view.resident.catalog, "require", asked.append)
    client.session.receive({"type": "set", "changes": {"step": 0.7}, "live": True})
    client.wait(lambda m: m["type"] == "state" and m["state"]["step"] == 0.7)
    assert not asked
    client.set(labels={"hidden": [2]})
    client.wait(lambda m: m["type"] == "state" and m["state"]["labels"] == {"hidden": [2]})
    assert len(asked) == 1


def test_labels_that_a_search_finds(device: Device) -> None:
    data = np.array([[[0, -1, 1, 12, 112, 12]]], np.int16).repeat(3, 1).repeat(3, 0)
    resident = Resident(Volume(data, labels={1: "Straße 12", 5: "nowhere"}), device=device)
    for words, numbers in {
        "": [-1, 1, 12, 112],
        "12": [12, 1, 112],
        " STRASSE": [1],
        "-1": [-1],
        "-": [-1],
        "5": [],
        "nowhere": [],
        "9" * 200: [],
        "-0": [],
    }.items():
        rows, count = resident.catalog.labels(State(), words)
        assert ([row[0] for row in rows], count) == (numbers, len(numbers))
    resident.close()


def test_few_sets_of_labels_are_cached(view: View, client: Client) -> None:
    for chosen in ([1], [2], [1, 2], []):
        for how in ("shown", "hidden"):
            client.forget()
            client.set(labels={how: chosen}, mode="composite" if chosen else "mip")
            client.still()
    own = [which for which in view.resident.catalog._views if which.labels is not None]
    held = {key[2] for key in view.resident.renderers._entries if key[2].labels is not None}
    assert len({*own, *held}) <= 4
