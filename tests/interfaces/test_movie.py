"""Movies: series that play with one look, key frames, how long they take, and what is refused."""

from __future__ import annotations

import os
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

import clvol
from clvol import cli
from clvol.base.errors import ClvolError, ClvolWarning, DataError, FormatError, OptionError
from clvol.bricks.field import as_lazy
from clvol.show.picture import to_bytes
from clvol.volume.histogram import isovalue_of
from clvol.volume.volumes import Leading

pytestmark = pytest.mark.usefixtures("device")

SMALL: dict[str, Any] = {"size": (32, 24), "filter": "bspline3"}
STILL = clvol.Camera.orbit(20, 30, fit="volume")


def blobs(count: int = 3, size: int = 16) -> list[clvol.Volume]:
    """A ball that moves through the volume and becomes brighter."""
    z, y, x = np.mgrid[0:size, 0:size, 0:size]
    made = []
    for i in range(count):
        at = size * (0.3 + 0.4 * i / max(1, count - 1))
        away = (x - at) ** 2 + (y - at) ** 2 + (z - size / 2) ** 2
        made.append(clvol.Volume((100 * (1 + i) * np.exp(-away / 8)).astype(np.float32), spacing=(1, 1, 1.5)))
    return made


def pictures(folder: Path) -> list[NDArray[np.uint8]]:
    names = sorted(os.listdir(folder))  # noqa: PTH208  # names
    assert names == [f"{i:04d}.png" for i in range(len(names))]
    return [np.asarray(Image.open(folder / name).convert("RGB")) for name in names]


def rgb(picture: Any) -> NDArray[np.uint8]:
    return to_bytes(picture)[..., :3]


def test_a_warning_comes_once_a_film(tmp_path: Path) -> None:
    """That colours are off by more than the tolerance: by how much differs from picture to picture."""
    with pytest.warns(ClvolWarning, match="tolerance 1e-09 is not reached") as warned:
        clvol.movie(blobs(2, 6), tmp_path / "film", tolerance=1e-9, camera=STILL, rays=1, size=(6, 6))
    assert len(warned) == 1


@pytest.mark.parametrize("lazy", [False, True])
@pytest.mark.parametrize("mode", ["composite", "isosurface", "mip"])
def test_a_series_plays_with_one_range(mode: str, lazy: bool, tmp_path: Path) -> None:
    """The frames are `render`'s of each time with the range, or the isovalue, of all times together, to the bit."""
    series = blobs()
    shown = [as_lazy(one) for one in series] if lazy else series
    made = clvol.movie(shown, tmp_path / "film", mode=mode, camera=STILL, **SMALL)
    assert (made.frames, made.times, made.fps) == (3, 3, 1.0)
    together = clvol.Volume(np.concatenate([one.data for one in series]), spacing=series[0].spacing)
    own: dict[str, Any] = {"transfer": clvol.scene.look.look(together, mode)}
    if mode == "isosurface":
        own = {"isovalue": isovalue_of(together)[0]}
    for one, frame in zip(shown, pictures(tmp_path / "film"), strict=True):
        want = clvol.render(one, STILL, mode, SMALL["size"], filter="bspline3", **own)
        np.testing.assert_array_equal(frame, rgb(want))
    alone = [rgb(clvol.render(one, STILL, mode, SMALL["size"], filter="bspline3")) for one in shown]
    assert any((a != b).any() for a, b in zip(alone, pictures(tmp_path / "film"), strict=True))  # each by itself differs


def test_words_of_a_look_are_those_of_the_series(tmp_path: Path) -> None:
    series = blobs()
    clvol.movie(series, tmp_path / "film", mode="mip", camera=STILL, window=(100, 200), cmap="magma", **SMALL)
    for one, frame in zip(series, pictures(tmp_path / "film"), strict=True):
        want = clvol.render(one, STILL, "mip", SMALL["size"], filter="bspline3", window=(100, 200), cmap="magma")
        np.testing.assert_array_equal(frame, rgb(want))


def test_an_open_camera_sees_all_times(tmp_path: Path) -> None:
    """It stands still, nothing touches the border, and it is nearer than one that sees the whole volume."""
    made = clvol.movie(blobs(5), tmp_path / "film", mode="mip", size=(64, 64))
    frames = [frame.max(-1) for frame in pictures(made.path)]
    lit = np.max(frames, axis=0) > 12
    assert not lit[[0, -1]].any()
    assert not lit[:, [0, -1]].any()
    middles = [np.argwhere(frame > 0.5 * frame.max()).mean(0) for frame in frames]
    steps = np.diff(middles, axis=0)
    assert np.ptp(steps, axis=0).max() < 1.5  # of equal length, as in the world, but for perspective
    clvol.movie(blobs(5), tmp_path / "far", mode="mip", size=(64, 64), camera=clvol.Camera.orbit(fit="volume"))
    far = np.max([frame.max(-1) for frame in pictures(tmp_path / "far")], axis=0) > 12
    assert lit.sum() > 1.5 * far.sum()


@pytest.mark.parametrize("form", ["4-D array", "Volumes", "nifti"])
def test_a_series_is_found_in_arrays_and_files(form: str, tmp_path: Path) -> None:
    series = blobs()
    data = np.stack([one.data for one in series])
    source: Any = data
    if form != "4-D array":
        source = clvol.Volumes(data, spacing=series[0].spacing, leading=Leading(("time",), (3,)))
    if form == "nifti":
        pytest.importorskip("nibabel")
        clvol.write(source, tmp_path / "a.nii.gz")
        source = tmp_path / "a.nii.gz"
    want = [one if form != "4-D array" else clvol.Volume(one.data) for one in series]
    clvol.movie(source, tmp_path / "film", mode="mip", camera=STILL, window=(100, 200), **SMALL)
    for one, frame in zip(want, pictures(tmp_path / "film"), strict=True):
        grid = one if form != "nifti" else clvol.read(source, time=0)
        placed = clvol.Volume(one.data, grid.spacing, grid.origin, grid.direction, space=grid.space)
        picture = clvol.render(placed, STILL, "mip", SMALL["size"], filter="bspline3", window=(100, 200))
        np.testing.assert_array_equal(frame, rgb(picture))


def test_channels_of_a_series_play_together(tmp_path: Path) -> None:
    """Each picture is `render`'s of the channels of its time; where no file says their ranges, these are of all times."""
    data = np.stack([np.stack([one.data, one.data[:, ::-1] / 2]) for one in blobs()])
    known = {"leading": Leading(("time", "channel"), (3, 2), clims=((0, 300), (0, 150)))}
    assert clvol.movie(clvol.Volumes(data, **known), tmp_path / "film", mode="mip", camera=STILL, **SMALL).times == 3
    each = [clvol.Volumes(part, leading=Leading(("channel",), (2,), clims=((0, 300), (0, 150)))) for part in data]
    for one, frame in zip(each, pictures(tmp_path / "film"), strict=True):
        np.testing.assert_array_equal(frame, rgb(clvol.render(one, STILL, "mip", SMALL["size"], filter="bspline3")))
    both = clvol.Volumes(data, leading=Leading(("time", "channel"), (3, 2)))
    clvol.movie(both, tmp_path / "open", mode="mip", camera=STILL, **SMALL)
    brightest = [frame.max() for frame in pictures(tmp_path / "open")]
    assert brightest[0] < 0.5 * brightest[2]
    clvol.write(both, path := tmp_path / "a.ome.tif")
    with pytest.warns(clvol.ClvolWarning, match="3 times × 2 channels.*; the movie shows channel 0"):
        assert clvol.movie(path, tmp_path / "first", mode="mip", **SMALL).times == 3
    clvol.movie(clvol.read_all(path), tmp_path / "read", mode="mip", camera=STILL, **SMALL)
    words = ["--all-channels", "--mode", "mip", "--size", "32", "24", "--azimuth", "20", "--elevation", "30", "--fit", "volume"]
    with pytest.raises(SystemExit):
        cli.main(["movie", str(path), *words, "--filter", "bspline3", "-o", str(tmp_path / "shell")])
    for one, other in zip(pictures(tmp_path / "read"), pictures(tmp_path / "shell"), strict=True):
        np.testing.assert_array_equal(one, other)
    with pytest.raises(OptionError, match="filter must be left to the medium of a scene"):
        clvol.movie([clvol.Scene(one) for one in each], tmp_path / "scenes", mode="mip", **SMALL)


# -- how long, and what turns --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("times", "given", "frames", "fps"),
    [
        (1, {"seconds": 0.2}, 5, 25),
        (1, {"frames": 4}, 4, 25),
        (1, {"frames": 4, "seconds": 2}, 4, 2),
        (1, {"seconds": 2, "fps": 2}, 4, 2),
        (3, {}, 3, 1),
        (3, {"fps": 12}, 3, 12),
        (3, {"seconds": 2}, 3, 1.5),
        (3, {"seconds": 2, "fps": 3}, 6, 3),
        (10, {}, 10, 2),
        (3, {"turns": 1, "seconds": 0.2}, 5, 25),
    ],
)
def test_how_many_pictures_there_are(times: int, given: dict[str, Any], frames: int, fps: float, tmp_path: Path) -> None:
    series = blobs(times, 8)
    made = clvol.movie(series if times > 1 else series[0], tmp_path / "a.webp", mode="mip", size=(8, 8), **given)
    assert (made.frames, made.times) == (frames, times)
    assert made.fps == pytest.approx(fps, rel=5e-3)  # in thousandths of a second


def test_a_series_may_turn_and_repeat_its_times(tmp_path: Path) -> None:
    series = blobs()
    clvol.movie(series, tmp_path / "film", mode="mip", camera=STILL, window=(100, 200), turns=-0.5, frames=6, **SMALL)
    for i, frame in enumerate(pictures(tmp_path / "film")):
        camera = clvol.Camera.orbit(20 - 30 * i, 30, fit="volume")
        want = clvol.render(series[i // 2], camera, "mip", SMALL["size"], filter="bspline3", window=(100, 200))
        assert np.abs(frame.astype(int) - rgb(want)).max() <= 1


def test_a_placed_camera_turns_about_its_target(tmp_path: Path) -> None:
    (ball,) = blobs(1)
    center = ball.center
    eye = center + np.array([0, -60, 10.0])
    clvol.movie(ball, tmp_path / "film", mode="mip", camera=clvol.Camera.look_at(tuple(eye)), frames=4, **SMALL)
    for i, frame in enumerate(pictures(tmp_path / "film")):
        x, y = [(0, -60), (60, 0), (0, 60), (-60, 0)][i]
        camera = clvol.Camera.look_at(tuple(center + np.array([x, y, 10.0])))
        want = clvol.render(ball, camera, "mip", SMALL["size"], filter="bspline3")
        assert np.abs(frame.astype(int) - rgb(want)).max() <= 1


# -- key frames ----------------------------------------------------------------------------------------------------


def test_key_frames_change_options_linearly(tmp_path: Path) -> None:
    (ball,) = blobs(1)
    low, high = ball.corners.min(0), ball.corners.max(0)
    closed = np.array([high[0], high[1], (low[2] + high[2]) / 2])
    keys: dict[float, dict[str, Any]] = {
        0: {"isovalue": 20, "clip": (tuple(low), tuple(high)), "background": "black"},
        0.5: {"isovalue": 60.0},
        1: {"clip": (tuple(low), tuple(closed)), "background": (0, 0, 1)},
    }
    clvol.movie(ball, tmp_path / "film", keys, mode="isosurface", camera=STILL, frames=5, **SMALL)
    for i, frame in enumerate(pictures(tmp_path / "film")):
        share = i / 4
        clip = (tuple(low), tuple((1 - share) * high + share * closed))
        want = clvol.render(
            ball, STILL, "isosurface", SMALL["size"], filter="bspline3", isovalue=min(20 + 80 * share, 60), clip=clip,
            background=(0, 0, share),
        )  # fmt: skip
        np.testing.assert_array_equal(frame, rgb(want))


def test_key_frames_of_windows_opacities_and_modes(tmp_path: Path) -> None:
    series = blobs(2)
    keys: dict[float, dict[str, Any]] = {0: {"window": (50, 100), "mode": "mip"}, 1: {"window": (150, 300), "mode": "mean"}}
    clvol.movie(series, tmp_path / "film", keys, camera=STILL, frames=4, **SMALL)
    for i, frame in enumerate(pictures(tmp_path / "film")):
        window = (50 + 100 * i / 3, 100 + 200 * i / 3)
        want = clvol.render(series[i // 2], STILL, "mip" if i < 3 else "mean", SMALL["size"], filter="bspline3", window=window)
        np.testing.assert_array_equal(frame, rgb(want))


def test_key_frames_of_the_camera(tmp_path: Path) -> None:
    (ball,) = blobs(1)
    first, last = (clvol.Camera.orbit(a, 20, fit="volume", zoom=z) for a, z in ((0, 1), (80, 3)))
    clvol.movie(ball, tmp_path / "film", {0: {"camera": first}, 1: {"camera": last}}, mode="mip", frames=3, **SMALL)
    for i, frame in enumerate(pictures(tmp_path / "film")):
        camera = clvol.Camera.orbit(40 * i, 20, fit="volume", zoom=1 + i)
        want = clvol.render(ball, camera, "mip", SMALL["size"], filter="bspline3")
        assert np.abs(frame.astype(int) - rgb(want)).max() <= 1


# -- files ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["a.gif", "a.webp", "a.zip", "a.mp4", "a.webm", "a"])
def test_an_error_leaves_nothing(name: str, tmp_path: Path) -> None:
    if name.endswith(("mp4", "webm")):
        pytest.importorskip("imageio_ffmpeg")
    told: list[float] = []

    def stop(done: float) -> None:
        told.append(done)
        if done > 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        clvol.movie(blobs(1)[0], tmp_path / name, frames=4, mode="mip", progress=stop, **SMALL)
    assert all(a <= b for a, b in pairwise(told))
    assert list(tmp_path.iterdir()) == []


def test_a_folder_must_be_new_or_empty(tmp_path: Path) -> None:
    folder = tmp_path / "frames"
    folder.mkdir()
    clvol.movie(blobs(2), folder, mode="mip", **SMALL)
    assert len(pictures(folder)) == 2
    with pytest.raises(FormatError, match="it must be a new folder, or an empty one"):
        clvol.movie(blobs(2), folder, mode="mip", **SMALL)
    assert [one.name for one in tmp_path.iterdir()] == ["frames"]


def test_progress_ends_at_one(tmp_path: Path) -> None:
    told: list[float] = []
    clvol.movie(blobs(3), tmp_path / "a.gif", mode="mip", progress=told.append, **SMALL)
    assert told[-1] == 1


@pytest.mark.parametrize(
    ("given", "error", "says"),
    [
        ({"frames": 0}, OptionError, "frames must be a whole number, at least 2 and at most 10000; got 0"),
        ({"frames": 2.5}, OptionError, "frames must be a whole number"),
        ({"seconds": 0}, OptionError, "seconds"),
        ({"seconds": 0.01}, OptionError, "a movie must have 2 to 10000 pictures"),
        ({"fps": 0}, OptionError, "fps"),
        ({"turns": float("nan")}, OptionError, "turns"),
        ({"outputs": "depth"}, OptionError, "outputs of a movie must be 'rgba'"),
        ({"isovalue": 3}, OptionError, "isovalue is no option of mip"),
        ({"frame": 3}, OptionError, "frame is no option of mip"),
        ({"size": (20000, 8)}, OptionError, "webp must be 1 to 16383 pixels wide and high"),
        ({"keyframes": {}}, OptionError, "keyframes must map moments"),
        ({"keyframes": {0: 3}}, OptionError, "keyframes must map moments"),
        ({"keyframes": {2: {"window": (1, 2)}}}, OptionError, "a moment of keyframes must be a finite number"),
        ({"keyframes": {0: {"isovalue": 3}}}, OptionError, "isovalue is no option of mip"),
        ({"keyframes": {0: {"size": (3, 3)}}}, OptionError, "size must be the same in all pictures"),
        ({"keyframes": {0: {"filter": "linear"}}}, OptionError, "filter must be the same in all pictures"),
        ({"keyframes": {0: {"fps": 3}}}, OptionError, "fps is of the whole movie"),
        ({"keyframes": {0: {"mode": "mip"}}}, OptionError, "mode must be given in key frames or beside them; got both"),
        ({"keyframes": {0: {"camera": STILL}}, "turns": 1}, OptionError, "turns must be left out where key frames have a camera"),
        ({"keyframes": {0: {"window": (1, 2)}, 1: {"window": None}}}, OptionError, "window of key frames must be of one kind"),
        (
            {"keyframes": {0: {"camera": STILL}, 1: {"camera": clvol.Camera.look_at((9, 9, 9), (0, 0, 0))}}},
            OptionError,
            "cameras of key frames must have one fit",
        ),
    ],
    ids=str,
)
def test_invalid_movies_are_refused(given: dict[str, Any], error: type[ClvolError], says: str, tmp_path: Path) -> None:
    with pytest.raises(error, match=says):
        clvol.movie(blobs(1)[0], tmp_path / "a.webp", **({"mode": "mip", **SMALL} | given))
    assert list(tmp_path.iterdir()) == []


def test_volumes_of_a_series_have_one_shape(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"one shape; got \(8, 8, 8\) and \(9, 9, 9\)"):
        clvol.movie([blobs(1, 8)[0], blobs(1, 9)[0]], tmp_path / "a.gif")
    with pytest.raises(DataError, match="at least one volume; got none"):
        clvol.movie([], tmp_path / "a.gif")
    with pytest.raises(OptionError, match="reading is for a path"):
        clvol.movie(blobs(1)[0], tmp_path / "a.gif", reading={"time": 0})


# -- in the shell --------------------------------------------------------------------------------------------------


def test_the_command_plays_times(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A 4-D file plays; --time chooses one that turns; --turns does both."""
    pytest.importorskip("nibabel")
    series = clvol.Volumes(np.stack([one.data for one in blobs()]), leading=Leading(("time",), (3,)))
    path = tmp_path / "a.nii.gz"
    clvol.write(series, path)
    words = [str(path), "--size", "32", "24", "--mode", "mip", "--filter", "bspline3", "--fit", "volume", "--window", "100", "200"]
    for more, volumes, angles in (
        ([], (0, 1, 2), (0, 0, 0)),
        (["--time", "1", "--frames", "3"], (1, 1, 1), (0, 120, 240)),
        (["--turns", "1", "--frames", "6"], (0, 0, 1, 1, 2, 2), (0, 60, 120, 180, 240, 300)),
    ):
        folder = tmp_path / "-".join(["film", *more])
        with pytest.raises(SystemExit) as end:
            cli.main(["movie", *words, "-o", str(folder), *more])
        assert end.value.code == 0
        said = capsys.readouterr()
        assert ("times: 3" in said.out) == (len(set(volumes)) == 3)
        assert said.err == ""
        for frame, volume, angle in zip(pictures(folder), volumes, angles, strict=True):
            camera = clvol.Camera.orbit(30 + angle, 20, fit="volume")
            want = clvol.render(clvol.read(path, time=volume), camera, "mip", SMALL["size"], filter="bspline3", window=(100, 200))
            assert np.abs(frame.astype(int) - rgb(want)).max() <= 1


def test_the_command_takes_key_frames(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Words of one option may stand at moments of their own; a full turn is one; what is not said is as beside the keys."""
    (ball,) = blobs(1)
    clvol.write(ball, path := tmp_path / "a.nrrd")
    words = ["movie", str(path), "--size", "32", "24", "--filter", "bspline3", "--mode", "isosurface", "--fit", "volume"]
    keys = ["--key", "0:isovalue=20,azimuth=0,clip-plane=0/0/1/0/0/20", "--key", "0.5:background=blue", "--key"]
    keys += ["1:isovalue=60,azimuth=360,zoom=2,clip-plane=0/0/1/0/0/12", "--elevation", "10", "--frames", "5"]

    def run(*arguments: str) -> tuple[Any, str]:
        with pytest.raises(SystemExit) as end:
            cli.main([*words, *arguments])
        return end.value.code, capsys.readouterr().err

    assert run("-o", str(tmp_path / "film"), *keys) == (0, "")
    for i, frame in enumerate(pictures(tmp_path / "film")):
        camera = clvol.Camera.orbit(90 * i, 10, fit="volume", zoom=2)
        cut = clvol.Plane((0, 0, 1), (0, 0, 20 - 2 * i))
        seen: dict[str, Any] = {"isovalue": 20 + 10 * i, "clip": cut, "background": "blue"}
        want = clvol.render(ball, camera, "isosurface", SMALL["size"], filter="bspline3", **seen)
        assert np.abs(frame.astype(int) - rgb(want)).max() <= 1
    for given, says in (
        (["0:isovalu=3"], "isovalu is no option of --key 0 (did you mean isovalue?)"),
        (["0:evaluator=taps"], "evaluator is no option of --key 0"),
        (["isovalue=3"], "--key must be MOMENT:NAME=VALUE,NAME=VALUE, a moment from 0"),
        (["2:isovalue=3"], "a moment of keyframes must be a finite number, at least 0 and at most 1; got 2"),
        (["0:isovalue=3", "--isovalue", "4"], "--isovalue must be given in key frames or beside them; got both"),
        (["0:zoom=3", "--turns", "1"], "--turns must be left out where key frames have a camera"),
        (["0:clip=1/2/3"], "clip of --key 0 must be number/number/number/number/number/number; got '1/2/3'"),
        (["0:cmap=hot", "--with", str(path)], "--key changes no cmap beside other volumes"),
    ):
        code, error = run("-o", str(tmp_path / "refused"), "--key", *given)
        assert code == 1
        assert says in error


def test_a_scene_turns(tmp_path: Path) -> None:
    """Each picture is that of its camera; key frames cut it open."""
    ball = clvol.phantoms.sphere(12)
    scene = clvol.Scene([clvol.Medium(ball, opacity=0.2), clvol.Medium(ball, surfaces="0.2:tan:0.5")])
    made = clvol.movie(scene, tmp_path / "frames", frames=2, size=(24, 20))
    first, second = (np.asarray(Image.open(file)) for file in sorted(made.path.iterdir()))
    for picture, azimuth in ((first, 30), (second, 210)):
        want = clvol.render(scene, clvol.Camera.orbit(azimuth, 20), size=(24, 20))
        assert np.abs(picture[..., :3].astype(int) - to_bytes(want)[..., :3]).max() <= 1
    keys = {at: {"clip": clvol.Plane((1, 0, 0), (x, 0, 0))} for at, x in ((0, 0.9), (1, 0.0))}
    assert clvol.movie(scene, tmp_path / "cut.gif", keys, frames=2, size=(24, 20)).frames == 2
