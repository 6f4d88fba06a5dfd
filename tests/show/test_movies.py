"""Movie files, and the command that creates them."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image, ImageSequence

import clvol
from clvol import cli
from clvol.base.errors import MissingDependencyError, OptionError
from clvol.dask.cluster import as_cluster
from clvol.interfaces.batches import Shot, frames
from clvol.show import movies
from clvol.show.picture import to_bytes

HAS_ENCODER = find_spec("imageio_ffmpeg") is not None
needs_encoder = pytest.mark.skipif(not HAS_ENCODER, reason="imageio-ffmpeg is not installed")
FORMS = ["gif", "webp", "zip", pytest.param("mp4", marks=needs_encoder), pytest.param("webm", marks=needs_encoder)]
COMMAND = ("movie", "phantom:marschner-lobb:24", "--size", "48", "40", "--mode", "isosurface")


def bars(count: int, width: int = 48, height: int = 32) -> Iterator[NDArray[np.uint8]]:
    """A red bar on blue that moves to the right."""
    for i in range(count):
        picture = np.zeros((height, width, 4), np.uint8)
        picture[...] = (0, 0, 200, 255)
        picture[:, 8 * i : 8 * i + 8] = (200, 0, 0, 255)
        yield picture


def frames_of(path: Path) -> list[NDArray[np.uint8]]:
    if path.suffix == ".zip":
        with zipfile.ZipFile(path) as archive:
            return [np.asarray(Image.open(io.BytesIO(archive.read(name))).convert("RGB")) for name in archive.namelist()]
    if path.suffix in (".gif", ".webp"):
        return [np.asarray(frame.convert("RGB")) for frame in ImageSequence.Iterator(Image.open(path))]
    import imageio_ffmpeg

    reader = imageio_ffmpeg.read_frames(str(path))
    width, height = next(reader)["size"]
    return [np.frombuffer(frame, np.uint8).reshape(height, width, 3) for frame in reader]


@pytest.mark.parametrize("form", FORMS)
def test_frames_are_read_back_in_order(form: str, tmp_path: Path) -> None:
    path = tmp_path / f"a.{form}"
    movies.write(bars(5), path, form, 20)
    made = frames_of(path)
    assert len(made) == 5
    for frame, want in zip(made, bars(5), strict=True):
        assert np.abs(frame.astype(int) - want[..., :3]).mean() < 12  # colours of videos are half as fine, and packed
    assert movies.packed(bars(5), form, 20) == path.read_bytes()


@needs_encoder
@pytest.mark.parametrize("form", ["mp4", "webm"])
def test_videos_of_odd_size_lose_a_pixel_and_keep_their_colours(form: str, tmp_path: Path) -> None:
    path = tmp_path / f"a.{form}"
    flat = np.full((33, 49, 3), (200, 60, 20), np.uint8)
    movies.write([flat] * 3, path, form)
    for frame in frames_of(path):
        assert frame.shape == (32, 48, 3)
        assert np.abs(frame.astype(int) - flat[0, 0]).max() <= 8


@pytest.mark.parametrize("form", movies.FORMATS)
def test_a_movie_needs_frames(form: str, tmp_path: Path) -> None:
    if form in ("mp4", "webm"):
        pytest.importorskip("imageio_ffmpeg")
    with pytest.raises(OptionError, match="pictures must be at least one; got none"):
        movies.write([], tmp_path / "movie", form)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("form", [*movies.FORMATS, movies.FOLDER])
def test_pictures_are_of_one_size(form: str, tmp_path: Path) -> None:
    if form in ("mp4", "webm"):
        pytest.importorskip("imageio_ffmpeg")
    sizes = [next(bars(1)), next(bars(1, width=56)), next(bars(1))]
    with pytest.raises(OptionError, match="pictures must be of one size, 48 × 32; got 56 × 32 at number 1"):
        movies.write(sizes, tmp_path if form == movies.FOLDER else tmp_path / "movie", form)


def test_transparency_is_black_in_videos_and_kept_in_a_zip(tmp_path: Path) -> None:
    half = np.full((4, 6, 4), (200, 100, 50, 128), np.uint8)
    movies.write([half, half], tmp_path / "a.gif", "gif")
    assert np.abs(frames_of(tmp_path / "a.gif")[0].astype(int) - (100, 50, 25)).max() <= 1
    movies.write([half], tmp_path / "a.zip", "zip")
    with zipfile.ZipFile(tmp_path / "a.zip") as archive:
        np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(archive.read("0000.png")))), half)


def test_without_an_encoder_the_error_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(movies.importlib.util, "find_spec", lambda _: None)  # type: ignore[attr-defined]
    for form in ("mp4", "webm"):
        with pytest.raises(MissingDependencyError, match=r'pip install "clvol\[movie\]"'):
            movies.require_encoder(form)
    movies.require_encoder("gif")
    with pytest.raises(OptionError, match="format must be one of gif, webp, mp4, webm, zip; got 'avi'"):
        movies.require_encoder("avi")


# -- the command ---------------------------------------------------------------------------------------------------


@pytest.mark.one_in(2)
@pytest.mark.usefixtures("device")
@pytest.mark.parametrize("form", FORMS)
def test_the_command(form: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, again = tmp_path / f"a.{form}", tmp_path / f"b.{form}"
    for file in (path, again):
        with pytest.raises(SystemExit) as end:
            cli.main([*COMMAND, "-o", str(file), "--frames", "4", "--azimuth", "10"])
        assert end.value.code == 0
    assert path.read_bytes() == again.read_bytes()
    assert "frames: 4" in capsys.readouterr().out
    made = frames_of(path)
    assert len(made) == 4
    if form == "zip":  # pictures of render, a quarter of a turn apart
        volume = clvol.phantoms.marschner_lobb(24)
        for i, frame in enumerate(made):
            want = clvol.render(volume, clvol.Camera.orbit(10 + 90 * i, 20), "isosurface", size=(48, 40))
            np.testing.assert_array_equal(frame, to_bytes(want)[..., :3])
    assert sorted(os.listdir(tmp_path)) == [path.name, again.name]  # noqa: PTH208  # names


def test_a_cluster_makes_the_same_movie(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One task per picture, in order, with few pending."""
    pytest.importorskip("distributed")
    volume, cameras, told = clvol.phantoms.marschner_lobb(24), clvol.Camera.turntable(9), list[float]()
    shots = [Shot(volume, {"camera": camera}) for camera in cameras]
    alone = [picture.copy() for picture in frames(shots, mode="mip", size=(30, 20))]
    with as_cluster(2) as cluster:
        submit, asked = cluster.submit, []
        cluster.submit = lambda *a, **k: asked.append(a[0]) or submit(*a, **k)  # type: ignore[func-returns-value, method-assign]
        for number, picture in enumerate(frames(shots, cluster=cluster, progress=told.append, mode="mip", size=(30, 20))):
            np.testing.assert_array_equal(picture, alone[number])
            assert len(asked) <= number + 4
        assert told == [(i + 1) / 9 for i in range(9)]
        coming = frames([*shots, Shot(volume)], cluster=cluster, mode="mip", size=(30, 20))
        next(coming)
        coming.close()  # unrequested frames are not rendered
        with pytest.raises(OptionError, match="lod"):
            list(frames(shots, cluster=cluster, lod=-1))
        made = []
        for more in ([], ["--scheduler", cluster.address]):
            with pytest.raises(SystemExit) as end:
                cli.main([*COMMAND, "-o", str(tmp_path / "a.gif"), "--frames", "5", *more])
            assert end.value.code == 0
            made.append(((tmp_path / "a.gif").read_bytes(), capsys.readouterr().out))
        assert made[0] == made[1]


@pytest.mark.usefixtures("device")
@pytest.mark.parametrize(
    ("options", "code", "says"),
    [
        (["-o", "a.avi"], 1, "movies are written as .gif, .webp, .mp4, .webm, .zip, or PNG files into a folder (no suffix)"),
        (["-o", "no/a.gif"], 1, "does not exist"),
        (["-o", "a.gif", "--frames", "1"], 1, "frames"),
        (["-o", "a.gif", "--seconds", "0"], 1, "seconds"),
        (["-o", "a.gif", "--fps", "-3"], 1, "fps"),
        (["-o", "a.gif", "--turns", "nan"], 1, "turns"),
        (["-o", "a.gif", "--isovalue", "3", "--mode", "mip"], 1, "isovalue"),
        (["-o", "a.gif", "--workers", "2", "--scheduler", "tcp://127.0.0.1:9"], 1, "give --scheduler or --workers; got both"),
        (["-o", "a.gif", "--scheduler", "tcp://127.0.0.1:9"], 1, "no scheduler answers at tcp://127.0.0.1:9: "),
    ],
    ids=str,
)
def test_invalid_movies_are_rejected(
    options: list[str], code: int, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as end:
        cli.main(["movie", "phantom:sphere:8", *options])
    assert end.value.code == code
    assert says in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.name != "posix", reason="signals as POSIX has them")
@pytest.mark.usefixtures("device")
@pytest.mark.one_in(6)
@pytest.mark.parametrize("form", FORMS)
def test_an_interrupt_leaves_nothing(form: str, tmp_path: Path) -> None:
    code = f"""
from clvol.march.renderer import Renderer
render = Renderer.render
def told(self, *args, **options):
    print("picture", flush=True)
    return render(self, *args, **options)
Renderer.render = told
from clvol.cli import main
main({[*COMMAND, "-o", f"a.{form}", "--frames", "5000"]!r})
"""
    process: subprocess.Popen[Any] = subprocess.Popen(
        [sys.executable, "-c", code], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, encoding="utf-8"
    )
    try:
        assert process.stdout is not None
        for _ in range(3):
            assert process.stdout.readline() == "picture\n"
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()
    assert process.returncode == 130
    assert err.endswith("clvol: interrupted\n")
    assert list(tmp_path.iterdir()) == []


def test_an_interrupt_propagates_even_if_cleanup_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Python's own rmtree closes a folder twice if it is interrupted in between."""

    def interrupted(*_: Any, **__: Any) -> Any:
        raise KeyboardInterrupt
        yield

    def closed_twice(*_: Any, **__: Any) -> None:
        raise OSError(9, "Bad file descriptor")

    monkeypatch.setattr("clvol.interfaces.movie.frames", interrupted)
    monkeypatch.setattr("shutil.rmtree", closed_twice)
    with pytest.raises(SystemExit) as end:
        cli.main([*COMMAND, "-o", str(tmp_path / "a.gif"), "--frames", "5"])
    assert (end.value.code, capsys.readouterr().err) == (130, "clvol: interrupted\n")


@pytest.mark.skipif(os.name != "posix", reason="signals as POSIX has them")
def test_an_interrupt_as_the_encoder_starts_is_not_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Python ignores what is raised while it forks, and `logging` would stay locked."""
    pytest.importorskip("imageio_ffmpeg")
    real, started = subprocess.Popen, []

    def interrupted(*args: Any, **options: Any) -> Any:
        signal.raise_signal(signal.SIGINT)
        started.append(args)  # not reached if the signal interrupts this
        return real(*args, **options)

    monkeypatch.setattr("imageio_ffmpeg._io.subprocess.Popen", interrupted)
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            movies.write([np.zeros((8, 8, 4))] * 2, tmp_path / "a.mp4", "mp4")
    finally:
        signal.signal(signal.SIGINT, handler)
    assert started
