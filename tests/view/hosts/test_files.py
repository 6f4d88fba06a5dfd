"""Files as layers: only from one folder and from pages that are let in; nothing of what was sent stays."""

from __future__ import annotations

import gzip
import io
import struct
import tempfile
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clvol
from clvol.base.errors import OptionError
from clvol.device import Device
from clvol.view import View
from tests.formats.test_hostile_files import bomb, nifti
from tests.view.browser import Browser, open_browser, why_none
from tests.view.hosts.test_server import Visitor, visit

pytest.importorskip("aiohttp", reason="needs aiohttp")
from clvol.view.hosts.outbox import Limits
from clvol.view.hosts.server import Serving, serve

AS_FILE = {"Content-Type": "application/octet-stream"}
BALL = clvol.phantoms.sphere(16)
PARTS = clvol.Volume((np.indices((16, 16, 16))[2] > 7).astype(np.uint8), BALL.spacing, BALL.origin, labels={1: "right"})


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """With volumes, what is none, and a link that leads out."""
    temporary, inside = tmp_path / "temporary", tmp_path / "data"
    for one in (temporary, inside / "deeper", inside / ".hidden", tmp_path / "outside"):
        one.mkdir(parents=True)
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    clvol.write(PARTS, inside / "parts.nii.gz")
    for place in ("deeper", ".hidden", "../outside"):
        clvol.write(BALL, inside / place / "ball.npz")
    (inside / "notes.txt").write_text("no volume")
    (inside / "broken.nii").write_bytes(b"no volume either")
    (inside / "link.npz").symlink_to(tmp_path / "outside" / "ball.npz")
    return inside


@pytest.fixture
def served(folder: Path, device: Device) -> Iterator[tuple[Serving, View]]:  # noqa: ARG001  # sessions use the default one
    view = View(BALL)
    with serve(view, folder=folder, limits=Limits(upload=1 << 20)) as server:
        yield server, view
    view.close()


async def post(visitor: Visitor, path: str, data: bytes = b"", **options: Any) -> tuple[int, str]:
    async with visitor.http.post(visitor.base + path, data=data, **options) as answer:
        return answer.status, await answer.text()


def left(folder: Path) -> list[Path]:
    return list((folder.parent / "temporary").iterdir())


def test_files_of_the_folder_are_listed_and_shown(served: tuple[Serving, View]) -> None:
    server, view = served

    async def work(visitor: Visitor) -> None:
        await visitor.enter()
        async with visitor.http.get(visitor.base + "files") as answer:
            found = await answer.json()
        assert found == {"folder": "data", "files": ["broken.nii", "parts.nii.gz", "deeper/ball.npz"], "recent": []}
        for name in ("parts.nii.gz", "deeper/ball.npz"):
            assert (await post(visitor, f"open?name={name}"))[0] == 200
        async with visitor.http.get(visitor.base + "files") as answer:
            assert (await answer.json())["recent"] == ["deeper/ball.npz", "parts.nii.gz"]

    visit(server, work)
    assert [one.volume.name for one in view.layers][1:] == ["parts.nii.gz", "ball.npz"]
    assert view.layers[1].volume.is_labels


def test_nothing_else_is_opened(served: tuple[Serving, View], folder: Path) -> None:
    server, view = served
    outside = folder.parent / "outside" / "ball.npz"

    async def work(visitor: Visitor) -> None:
        await visitor.enter()
        for name in (
            str(outside), "../outside/ball.npz", "deeper/../../outside/ball.npz", "link.npz", ".hidden/ball.npz", "notes.txt", "",
            "deeper", "..%5Coutside", "parts.nii.gz%00", "x" * 3000 + ".npy", "~/ball.npz",
        ):  # fmt: skip
            status, said = await post(visitor, f"open?name={name}")
            assert (status, "no such volume" in said) == (404, True), name
        status, said = await post(visitor, "open?name=broken.nii")
        assert status == 422
        assert "NIfTI" in said

    visit(server, work)
    assert len(view.layers) == 1


def test_what_a_page_sends_is_shown_and_does_not_stay(served: tuple[Serving, View], folder: Path) -> None:
    server, view = served
    data = (folder / "parts.nii.gz").read_bytes()

    async def work(visitor: Visitor) -> None:
        await visitor.enter()
        assert (await post(visitor, "upload?name=parts.nii.gz", data, headers=AS_FILE))[0] == 200
        for path, body, headers, status, says in (
            ("upload?name=broken.nii", b"no volume", AS_FILE, 422, "NIfTI"),
            ("upload?name=parts.txt", data, AS_FILE, 400, "must be plain"),
            ("upload?name=../parts.nii.gz", data, AS_FILE, 400, "must be plain"),
            ("upload?name=.parts.nii.gz", data, AS_FILE, 400, "must be plain"),
            ("upload?name=-parts.nii.gz", data, AS_FILE, 400, "must be plain"),
            ("upload", data, AS_FILE, 400, "must be plain"),
            ("upload?name=parts.nii.gz", data, {"Content-Type": "text/plain"}, 415, "must be sent as"),
            ("upload?name=parts.nii.gz", data, AS_FILE | {"Content-Encoding": "gzip"}, 415, "without a coding"),
            ("upload?name=parts.raw", data, AS_FILE, 400, "must be plain"),
            ("upload?name=parts.nii.gz", bytes((1 << 20) + 1), AS_FILE, 413, "at most 1 MiB"),
            ("upload?name=image.npy", npy(np.zeros((4, 4))), AS_FILE, 422, ""),
        ):
            got, said = await post(visitor, path, body, headers=headers)
            assert (got, says in said) == (status, True), (path, got, said)

        async def pieces() -> Any:
            yield data

        async with visitor.http.post(visitor.base + "upload?name=parts.nii.gz", data=pieces(), headers=AS_FILE) as answer:
            assert answer.status == 411

    visit(server, work)
    assert len(view.layers) == 2
    assert left(folder) == []
    assert view.layers.sources == ("clvol.Medium(clvol.read('parts.nii.gz'), opacity=0.5)",)


def npy(data: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, data)
    return stream.getvalue()


def test_errors_tell_the_name_that_was_sent(served: tuple[Serving, View], folder: Path) -> None:
    server, _ = served

    async def work(visitor: Visitor) -> None:
        await visitor.enter()
        for name in ("broken.nii.gz", "broken.npz"):
            status, said = await post(visitor, f"upload?name={name}", b"no volume", headers=AS_FILE)
            assert (status, name in said, str(folder.parent) in said or "clvol-" in said) == (422, True, False), said

    visit(server, work)


def test_what_unpacks_to_far_more_is_refused_unread(served: tuple[Serving, View], folder: Path) -> None:
    server, view = served
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("data.npy", bytes(1 << 20))
    listed = archive.getvalue().replace(struct.pack("<I", 1 << 20), struct.pack("<I", (1 << 32) - 2))  # what its members take
    packed = gzip.compress(nifti(dim=(40, "8h", (3, 5000, 5000, 4000, 1, 1, 1, 1)))) + bomb(1000)

    async def work(visitor: Visitor) -> None:
        await visitor.enter()
        for name, data, size in (("bomb.nii.gz", packed, 100_000_000_000), ("bomb.npz", listed, (1 << 32) - 2)):
            status, said = await post(visitor, f"upload?name={name}", data, headers=AS_FILE)
            assert (status, said.endswith(f"says {size} bytes\n"), "1000 times" in said) == (422, True, True), said

    visit(server, work)
    assert len(view.layers) == 1
    assert left(folder) == []


def test_only_pages_that_are_let_in_may_open_and_send(served: tuple[Serving, View], folder: Path) -> None:
    server, view = served
    data, token = (folder / "parts.nii.gz").read_bytes(), server.url.partition("?")[2]

    async def work(visitor: Visitor) -> None:
        paths = "upload?name=parts.nii.gz", "open?name=parts.nii.gz"
        for path in paths:  # without the secret, also with the token
            for more in ("", f"&{token}"):
                assert (await post(visitor, path + more, data, headers=AS_FILE))[0] == 403
        assert await visitor.status("files") == 403
        await visitor.enter()
        for path in paths:
            for header in ({"Origin": "http://evil.example"}, {"Host": "evil.example"}, {"Sec-Fetch-Site": "cross-site"}):
                assert (await post(visitor, path, data, headers=AS_FILE | header))[0] == 403, header
            async with visitor.http.put(visitor.base + path, data=data, headers=AS_FILE) as answer:
                assert answer.status == 405

    visit(server, work)
    assert len(view.layers) == 1


def test_without_a_folder_nothing_is_listed(device: Device, folder: Path) -> None:  # noqa: ARG001
    async def work(visitor: Visitor) -> None:
        await visitor.enter()
        async with visitor.http.get(visitor.base + "files") as answer:
            assert (await answer.json())["files"] == []
        assert (await post(visitor, "open?name=parts.nii.gz"))[0] == 404

    with serve(View(BALL)) as server:
        visit(server, work)
    with pytest.raises(OptionError, match="folder must be a folder"):
        serve(View(BALL), folder=folder / "parts.nii.gz")


@pytest.fixture
def browser() -> Iterator[Browser]:
    with open_browser(700, 700) as found:
        yield found


DROP = """const files = new DataTransfer();
    files.items.add(new File([Uint8Array.from(arguments[0])], arguments[1]));
    const drop = new DragEvent("drop", { dataTransfer: files, bubbles: true, cancelable: true });
    document.querySelector(".clvol-pane").dispatchEvent(drop);"""


@pytest.mark.skipif(bool(why_none()), reason=why_none())
def test_the_page_does_not_send_what_is_too_large(browser: Browser, served: tuple[Serving, View]) -> None:
    server, _ = served
    browser.open(server.url)
    browser.wait("document.querySelector('.clvol-pane[data-frame]')", 60)
    browser.js("window.fetch = () => document.title = 'sent'")
    browser.js(DROP.replace("Uint8Array.from(arguments[0])", "new Uint8Array(3 << 20)"), None, "large.nii")
    browser.wait("document.querySelector('.clvol-status').textContent.startsWith('large.nii')")
    assert browser.js("return document.querySelector('.clvol-status').textContent") == (
        "large.nii has 3 MiB; a file that is sent may have up to 1 MiB: put it into the folder of clvol, and open it from there"
    )
    assert browser.js("return document.title") != "sent"


@pytest.mark.skipif(bool(why_none()), reason=why_none())
def test_a_file_is_dropped_on_the_page_and_removed_again(browser: Browser, served: tuple[Serving, View], folder: Path) -> None:
    server, view = served
    final = "document.querySelector('.clvol-pane[data-frame]')?.dataset.final === 'true'"
    rows = "[...document.querySelectorAll('.clvol-layers li')].map((row) => row.querySelector('label').textContent)"
    browser.open(server.url)
    browser.wait(final, 60)
    browser.js(DROP, list((folder / "parts.nii.gz").read_bytes()), "parts.nii.gz")
    browser.wait(f"{rows}[1] === 'parts.nii.gz'")
    browser.wait(final, 60)
    browser.js("document.querySelector('.clvol-open').click()")
    browser.wait("document.querySelectorAll('.clvol-opening option').length === 3")
    browser.js(
        """const list = document.querySelector('.clvol-opening select');
        list.value = 'deeper/ball.npz';
        list.dispatchEvent(new MouseEvent('dblclick'));"""
    )
    browser.wait(f"{rows}.length === 3")
    browser.wait("document.querySelector('.clvol-opening optgroup').label === 'Recent'")
    browser.js("document.querySelector('.clvol-layers button').click()")
    browser.wait(f"{rows}.length === 2")
    assert [one.volume.name for one in view.layers][1:] == ["ball.npz"]
    assert browser.console() == []
