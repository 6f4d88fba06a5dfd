"""The image of the Dockerfile, without Docker: its commands are parsed and run here."""

from __future__ import annotations

import json
import os
import re
import select
import shlex
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import tomllib
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FILE = ROOT / "Dockerfile"


def instructions() -> list[tuple[str, str]]:
    """(name, arguments) of each, without comments, lines joined."""
    text = re.sub(r"(?m)^\s*#.*\n", "", FILE.read_text(encoding="utf-8")).replace("\\\n", " ")
    return [(line.split(None, 1)[0], " ".join(line.split(None, 1)[1].split())) for line in text.splitlines() if line.strip()]


def started() -> list[str]:
    found = dict(instructions())
    return [*json.loads(found["ENTRYPOINT"]), *json.loads(found["CMD"])]


def the_installation() -> str:
    (line,) = [rest for name, rest in instructions() if name == "RUN" and rest.startswith("pip ")]
    return line


def the_picture() -> list[str]:
    (line,) = [rest for name, rest in instructions() if name == "RUN" and rest.startswith("clvol ")]
    return shlex.split(line)


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def test_it_is_short_slim_and_does_not_run_as_root() -> None:
    found = instructions()
    assert len(found) <= 16
    assert found[0] == ("FROM", "python:3.12-slim-bookworm")
    names = [name for name, _ in found]
    user = names.index("USER")
    assert found[user][1] not in ("root", "0")
    assert names.index("CMD") > user
    assert names.index("ENTRYPOINT") > user
    assert f"useradd --create-home --home-dir /clvol --uid 1000 {found[user][1]}" in [
        rest for name, rest in found[:user] if name == "RUN"
    ]
    assert "RUN" in names[user:]  # the picture is drawn by the user
    assert not re.search(r"libgl|libegl|xvfb|x11|mesa|sudo", FILE.read_text(encoding="utf-8"), re.IGNORECASE)
    assert started()[:2] == ["clvol", "view"]
    assert dict(found)["EXPOSE"] == started()[started().index("--port") + 1]


def test_only_required_packages_are_installed() -> None:
    (line,) = [rest for name, rest in instructions() if name == "RUN" and "apt-get" in rest]
    steps = [step.strip() for step in line.split("&&")]
    assert steps[0] == "apt-get update"
    assert steps[1] == "apt-get install --yes --no-install-recommends binutils gcc libc6-dev"
    assert steps[2] == "rm -rf /var/lib/apt/lists/*"  # in the same layer
    ci = (ROOT / ".ci" / "run").read_text(encoding="utf-8") if (ROOT / ".ci" / "run").exists() else ""
    assert not ci or "binutils gcc libc6-dev" in ci  # what the tests of a clean machine install


def test_all_build_inputs_are_copied() -> None:
    copied = [rest.split() for name, rest in instructions() if name == "COPY"]
    sources = {source for *few, _ in copied for source in few}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert all((ROOT / source).exists() for source in sources)
    assert {"pyproject.toml", "src", "cl", project["project"]["readme"], *project["project"]["license-files"]} <= sources
    extras = re.search(r"\[([a-z,]+)\]", the_installation())
    assert extras
    assert set(extras[1].split(",")) <= project["project"]["optional-dependencies"].keys()


@pytest.mark.thorough
def test_its_commands_run(tmp_path: Path) -> None:
    environment = os.environ | {"HOME": str(tmp_path)}
    require_commands([sys.executable, "-m", "clvol"], tmp_path, environment)


@pytest.mark.thorough
def test_its_commands_run_in_a_fresh_installation_by_a_user_without_rights() -> None:
    """All except Debian's apt packages, which must be installed already."""
    for tool in ("ld", "gcc"):
        if shutil.which(tool) is None:
            pytest.skip(f"{tool} is not installed")
    folder = Path(tempfile.mkdtemp(prefix="clvol-image-"))
    try:
        folder.chmod(0o755)
        for _, rest in ((name, rest) for name, rest in instructions() if name == "COPY"):
            *sources, target = rest.split()
            there = folder / target.removeprefix("/")
            for source in sources:
                if (ROOT / source).is_dir():
                    shutil.copytree(ROOT / source, there, ignore=shutil.ignore_patterns("__pycache__"))
                else:
                    there.mkdir(parents=True, exist_ok=True)
                    shutil.copy(ROOT / source, there)
        subprocess.run([str(interpreter()), "-m", "venv", str(folder / "venv")], check=True, timeout=120)
        python = folder / "venv" / "bin" / "python"
        words = shlex.split(the_installation().replace("/opt/clvol", str(folder / "opt" / "clvol")))
        subprocess.run([str(python), "-m", *words, "--quiet"], check=True, timeout=900)
        home = folder / "home"
        home.mkdir()
        nobody = 65534 if os.getuid() == 0 and reachable(python) else None
        if nobody is not None:
            os.chown(home, nobody, nobody)
        environment = {"HOME": str(home), "PATH": f"{python.parent}:/usr/bin:/bin", "TMPDIR": str(home)}
        require_commands(["clvol"], home, environment, nobody, str(python.parent))
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def interpreter() -> Path:
    """A Python that other users may run, if there is one: Debian's, if this one is in a home."""
    own = Path(sys.executable).resolve()
    fits = "import ensurepip, sys; sys.exit(sys.version_info < (3, 11))"
    for python in (own, Path("/usr/bin/python3")):
        if not python.exists() or not reachable(python):
            continue
        if subprocess.run([str(python), "-c", fits], capture_output=True, timeout=60, check=False).returncode == 0:
            return python
    return own


def reachable(python: Path) -> bool:
    """Whether other users may run it: its interpreter may be in a home."""
    return all(parent.stat().st_mode & 0o001 for parent in python.resolve().parents)


def require_commands(program: list[str], home: Path, environment: dict[str, str], user: int | None = None, where: str = "") -> None:
    """Run the commands after USER and require their results: a picture, and a page."""
    program = [f"{where}/{program[0]}"] if where else program
    picture = the_picture()
    subprocess.run([*program, *picture[1:]], cwd=home, env=environment, check=True, timeout=300, user=user)
    assert (home / picture[-1]).read_bytes()[:4] == b"\x89PNG"
    words, port = started()[1:], free_port()
    words[words.index("--port") + 1] = str(port)
    with subprocess.Popen(
        [*program, *words], cwd=home, env=environment, user=user, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as server:
        try:
            assert server.stdout is not None
            address = next(addresses(server.stdout.fileno()))
            assert f":{port}" in address
            local = re.sub(r"//[^/:]+:", "//127.0.0.1:", address)
            browser = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())  # the token becomes a cookie
            with browser.open(local, timeout=30) as page:
                assert "<script" in page.read().decode()
            with pytest.raises(urllib.error.HTTPError):  # without its token
                urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=30)
        finally:
            server.terminate()
            server.wait(30)


def addresses(stream: int) -> Iterator[str]:
    """The addresses that the command prints."""
    end, text = time.monotonic() + 60, ""
    while time.monotonic() < end:
        if select.select([stream], [], [], 0.5)[0]:
            some = os.read(stream, 4096).decode()
            if not some:
                break
            text += some
            if found := re.search(r"http://\S+(?=\s)", text):
                yield found[0]
    raise AssertionError(f"no address came: {text!r}")
