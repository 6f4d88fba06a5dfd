"""Files that a session makes while it goes on drawing: progress, names, cancelling, and its end."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest

import clvol
from clvol.base.errors import OptionError
from clvol.device import Device
from clvol.view import View
from clvol.view.jobs import Cancelled, Jobs, Reins, Task
from tests.view.clients import Client, decoded

SIZE = 40, 30


@pytest.fixture(scope="module")
def view(device: Device) -> Iterator[View]:
    made = View(clvol.phantoms.sphere(24), device=device, mode="isosurface", name="a sphere: n° 1/2.nii.gz")
    yield made
    made.close()


def ask(client: Client, what: str, number: int, **more: Any) -> None:
    client.session.receive({"type": "do", "what": what, "id": number, **more})


def reply(client: Client, number: int) -> tuple[dict[str, Any], bytes | None]:
    return client.wait(lambda m: m["type"] == "reply" and m["id"] == number)


def test_pictures_come_while_a_file_is_made_and_it_can_be_cancelled(view: View) -> None:
    client = Client(view)
    client.resize(*SIZE)
    client.still()
    ask(client, "movie", 1, width=640, height=480, frames=360)
    client.wait(lambda m: m["type"] == "job" and m["id"] == 1 and m["share"] > 0)
    client.forget()
    client.set(mode="mip")
    client.still()
    assert not [m for m in client.of("reply") if m["id"] == 1]
    ask(client, "save_picture", 2)  # which waits for the first
    client.wait(lambda m: m["type"] == "job" and m["id"] == 2)
    ask(client, "cancel", 3, file=1)
    assert reply(client, 1)[0]["cancelled"]
    message, data = reply(client, 2)
    assert message["name"] == "a-sphere-n-1-2.png"
    np.testing.assert_array_equal(decoded(data).shape[:2], SIZE[::-1])
    ask(client, "cancel", 4, file=1)
    assert "no file of request 1" in reply(client, 4)[0]["error"]
    client.wait(lambda m: (m["type"] == "status" and m["text"] == "") or "no file" in m.get("text", ""))
    client.close()
    assert not any(thread.name == "clvol view: files" for thread in threading.enumerate())


@pytest.mark.skipif(find_spec("vtk") is None or find_spec("trimesh") is None, reason="needs vtk and trimesh")
def test_a_mesh_is_that_of_the_picture(view: View) -> None:
    client = Client(view)
    client.set(options__isovalue=0.4, clip={"low": [-1, -1, -1], "high": [1, 1, 0]})
    ask(client, "mesh", 1, format="stl")
    ask(client, "mesh", 2, format="stl", faces=100)
    message, data = reply(client, 1)
    assert message["name"].endswith(".stl")
    assert message["note"] == "it is whole: clip planes cut no mesh"
    row = view.resident.filter_name(client.session.state, None)
    assert message["faces"] == len(clvol.mesh(view.volume, 0.4, filter=row, device=view.resident.device).faces)
    assert data is not None
    assert len(data) == 84 + 50 * message["faces"]
    assert reply(client, 2)[0]["faces"] <= 100
    ask(client, "mesh", 3, format="png")
    assert "format must be one of" in reply(client, 3)[0]["error"]
    client.close()


def test_work_is_given_up_and_done_again_after_a_drag() -> None:
    told = []
    reins = Reins(
        {"id": 1}, Task("drawing", "it.gif", lambda _: ({}, None)), lambda: bool(told) and told[-1] == "dragged", told.append
    )

    def work(progress: Any) -> str:
        progress(0.1)
        told.append("dragged" if "dragged" not in told else "drawn")
        threading.Timer(0.05, told.append, ("let go",)).start()
        progress(0.9)
        return "picture"

    assert reins.alone(work) == "picture"
    assert told[:3] == ["dragged", "let go", "drawn"]
    reins.ended.set()
    with pytest.raises(Cancelled):
        reins.alone(work)


def test_a_failing_file_is_said_and_the_next_one_comes() -> None:
    def broken(_: Reins) -> Any:
        raise OptionError("nothing to write")

    condition = threading.Condition()
    jobs = Jobs(condition)
    for number, work in enumerate((broken, lambda _: ({}, b"data"))):
        jobs.start({"id": number}, Task("making it", "it.png", work))
    done = []
    with condition:
        while len(done) < 2:
            assert condition.wait_for(lambda: len(jobs) > 0, 10)
            done += jobs.take()[1]
    assert done[0].message == {"id": 0, "error": "nothing to write"}
    assert isinstance(done[0].error, OptionError)
    assert done[1].message == {"id": 1, "name": "it.png"}
    assert done[1].data == b"data"
    jobs.join(10)
    assert jobs.doing == ""


def test_files_are_bounded_and_end_with_their_session() -> None:
    begun, ended = threading.Event(), threading.Event()

    def endless(reins: Reins) -> Any:
        begun.set()
        try:
            while True:
                reins.progress(0.5)
                time.sleep(0.001)
        except Cancelled:
            ended.set()
            raise

    jobs = Jobs(threading.Condition())
    for number in range(16):
        jobs.start({"id": number}, Task("drawing", "it.png", endless))
    with pytest.raises(OptionError, match="at most 16 files"):
        jobs.start({"id": 16}, Task("drawing", "it.png", endless))
    assert begun.wait(10)
    jobs.close()
    assert ended.wait(10)
    jobs.join(10)


def test_a_program_that_ends_while_a_file_is_made_ends_well() -> None:
    code = """
import time, clvol
from clvol.view import View
got = []
session = View(clvol.phantoms.sphere(24)).session(lambda message, data: got.append(message))
session.receive({"type": "do", "what": "movie", "id": 1, "width": 640, "height": 480, "frames": 360})
while not any(m["type"] == "job" and m["share"] > 0 for m in got):
    time.sleep(0.01)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8", timeout=120, check=False)
    assert (done.returncode, done.stderr) == (0, "")
