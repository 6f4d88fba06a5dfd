"""Previews above the progress bar: the file is the same, and the terminal is restored."""

from __future__ import annotations

import io
import os
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from clvol.cli import _preview as preview
from clvol.cli._preview import Preview, Screen, console

pytestmark = pytest.mark.usefixtures("device")
TERMINAL = {"TERM": "xterm-256color", "COLORTERM": "truecolor", "COLUMNS": "60", "LINES": "20", "PYTHONIOENCODING": "utf-8"}
# any wait triggers a preview, and no device is fast enough for the final picture to come first
EAGER = """
from clvol.cli import _preview as preview, pictures
preview._WORTH = preview._SURE = -1.0
pictures._FIRST = 0.001
"""
DRAWN = "▀"


@pytest.fixture(autouse=True)
def _in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def terminal_of(width: int = 60, height: int = 20, colors: str = "truecolor") -> Console:
    file = io.TextIOWrapper(io.BytesIO(), "utf-8")
    return Console(file=file, force_terminal=True, color_system=colors, width=width, height=height, legacy_windows=False)  # type: ignore[arg-type]


def written(terminal: Console) -> str:
    terminal.file.flush()
    return terminal.file.buffer.getvalue().decode()  # type: ignore[attr-defined, no-any-return]


def on_a_terminal(*arguments: str, code: str = EAGER, **environment: str) -> tuple[str, str]:
    """The command's output to standard error, a terminal, and to standard output, which is none."""
    import pty

    ours, theirs = pty.openpty()
    script = f"{code}\nfrom clvol.cli import main\nmain()"
    process = subprocess.Popen(
        [sys.executable, "-c", script, *arguments],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=theirs, env=os.environ | TERMINAL | environment,
    )  # fmt: skip
    os.close(theirs)
    parts: list[bytes] = []

    def read() -> None:
        while True:
            try:
                some = os.read(ours, 1 << 16)
            except OSError:  # on Linux, when the other end is closed
                return
            if not some:
                return
            parts.append(some)

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    out, _ = process.communicate(timeout=120)
    reader.join(20)
    os.close(ours)
    assert process.returncode == 0, b"".join(parts)
    return b"".join(parts).decode(), out.decode()


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals of POSIX")
@pytest.mark.one_in(2)
@pytest.mark.parametrize("look", [("--mode", "isosurface"), ("--background", "none")], ids=str)
def test_the_file_is_the_same_without_a_preview(look: tuple[str, ...]) -> None:
    command = ("render", "phantom:marschner-lobb:40", "--size", "400", "300", *look)
    shown, out = on_a_terminal(*command, "-o", "with.png")
    plain, plain_out = on_a_terminal(*command, "-o", "without.png", "--no-preview")
    assert shown.count("▀") > 200
    assert "▀" not in plain
    assert "rendering" in plain
    assert Path("with.png").read_bytes() == Path("without.png").read_bytes()
    assert out.replace("with.png", "") == plain_out.replace("without.png", "")
    # the previous output is erased line by line, and the cursor restored
    _, _, end = shown.rpartition("▀")
    assert end.count("\x1b[2K") >= 16
    assert "\x1b[?25h" in end


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals of POSIX")
@pytest.mark.one_in(2)
@pytest.mark.parametrize(
    ("more", "environment"),
    [
        ((), {"TERM": "dumb"}),
        ((), {"NO_COLOR": "1"}),
        ((), {"LINES": "8"}),
        (("--verbose",), {}),
        (("--by-bricks",), {}),
        (("--json",), {}),
    ],
    ids=str,
)
def test_only_a_bar_where_pictures_cannot_be_shown(more: tuple[str, ...], environment: dict[str, str]) -> None:
    shown, out = on_a_terminal("render", "phantom:sphere:8", "-o", "a.png", "--size", "16", "12", *more, **environment)
    assert "▀" not in shown
    assert ("rendering" in shown) == ("--json" not in more and environment.get("TERM") != "dumb")  # where rich draws no bar
    assert "a.png" in out


def test_a_quick_picture_shows_no_preview(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr("clvol.cli._preview.time.perf_counter", lambda: now[0])
    picture = np.ones((30, 40, 4), np.float32)

    def shown_after(steps: list[tuple[float, float]]) -> bool:
        terminal = terminal_of()
        with Preview("rendering", terminal) as bar:
            bar.show(picture)
            for seconds, done in steps:
                now[0] += seconds
                bar(done)
        return DRAWN in written(terminal)

    assert not shown_after([(0.0, 0.0), (0.5, 0.5), (0.5, 1.0)])
    assert not shown_after([(0.0, 0.0), (0.1, 0.01), (0.9, 1.0)])  # nothing is sure yet
    assert shown_after([(0.0, 0.0), (0.5, 0.1)])
    terminal = terminal_of()
    with Preview("rendering", terminal) as bar:  # the previews take long
        bar.show(picture)
        now[0] += 3
        bar.show(picture)
    assert DRAWN in written(terminal)


@pytest.mark.parametrize("size", [(300, 200), (20, 400), (400, 3), (1, 1)], ids=str)
def test_the_preview_fills_the_available_lines(size: tuple[int, int]) -> None:
    width, height = size
    picture = np.zeros((height, width, 4), np.float32)
    picture[..., 0], picture[..., 3] = 1, 0.5
    terminal = terminal_of(60, 20)
    lines = terminal.render_lines(Screen(picture), pad=False)
    wide, high = len("".join(s.text for s in lines[0])), 2 * len(lines)
    assert wide <= 59
    assert high <= 32
    assert wide == 59 or high == 32 or max(size) == 400
    assert abs(wide / high - width / height) <= max(width / height, 1) * 2 / min(wide, high) + 2
    styles = {s.style for line in lines for s in line if "▀" in s.text}
    assert {str(style) for style in styles} == {"#800000 on #800000"}  # over black


@pytest.mark.parametrize(
    ("given", "fits"),
    [
        ({}, True),
        ({"width": 20}, False),
        ({"height": 9}, False),
        ({"color_system": "256"}, True),
        ({"color_system": "standard"}, False),
    ],
    ids=str,
)
def test_supported_terminals(given: dict[str, object], fits: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    found = terminal_of()
    kind = {"width": 60, "height": 20, "color_system": "truecolor"} | given
    made = Console(file=found.file, force_terminal=True, legacy_windows=False, **kind)  # type: ignore[arg-type]
    monkeypatch.setattr(preview, "Console", lambda **_: made)
    assert (console() is made) == fits


@pytest.mark.skipif(os.name != "posix", reason="signals as POSIX has them")
def test_an_error_restores_the_terminal() -> None:
    stopped = (
        EAGER
        + """
from clvol.march.renderer import Renderer
refine = Renderer.refine
def once(self, *args, **options):
    for picture in refine(self, *args, **options):
        yield picture
        yield picture
        raise KeyboardInterrupt
Renderer.refine = once
import clvol.cli, sys
try:
    clvol.cli.main()
except SystemExit as end:
    assert end.code == 130, end
    sys.exit(0)
"""
    )
    shown, _ = on_a_terminal("render", "phantom:marschner-lobb:40", "-o", "a.png", code=stopped)
    assert "▀" in shown
    assert "\x1b[?25h" in shown.rpartition("▀")[2]
    assert shown.endswith("clvol: interrupted\r\n")
    assert not Path("a.png").exists()
