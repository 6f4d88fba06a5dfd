"""Pictures again, from what their files say: to the bit in every mode; and files that are foreign, old, damaged, or of others."""

from __future__ import annotations

import copy
import json
import pickle
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import imageio.v3 as iio
import numpy as np
import pytest
from PIL.PngImagePlugin import PngInfo

import clvol
from clvol.base import serial
from clvol.base.errors import ClvolWarning, DataError, FormatError, OptionError
from clvol.cli import main
from clvol.device import Device
from clvol.interfaces.again import render_again
from clvol.march.recipe import CLASSES, Recipe
from clvol.show.picture import read_recipe

SIZE = (48, 36)


def run(*arguments: str) -> int:
    """The shell's exit status."""
    with pytest.raises(SystemExit) as done:
        main(arguments)
    return int(done.value.code or 0)


CASES: dict[str, dict[str, Any]] = {
    "composite": {},
    "isosurface": {"mode": "isosurface", "isovalue": "1sigma", "color": "red"},
    "stepped": {"mode": clvol.Isosurface(method="stepped", tolerance=0.01), "step": 0.7},
    "mip": {"mode": "mip", "cmap": "viridis"},
    "attenuated": {"mode": "attenuated", "attenuation": 3.3},
    "minip": {"mode": "minip", "filter": "lanczos3"},
    "mean": {"mode": "mean", "background": None},
    "unshaded": {"shading": False, "rays": 4, "pixel_filter": "mitchell"},
    "central": {"gradient": "central", "boundary": "constant(3)", "filter": "bspline3(0.3)"},
    "lights": {"lights": clvol.Light((1, 2, 3), (0.3, 0.9, 0.1)), "material": clvol.Material(0.1, 0.7, 0.3, 7.5)},
    "clip": {"clip": ((-np.inf, 0.1, -9), (5.5, np.inf, 4)), "camera": clvol.Camera.look_at((30, 40, 50), fov=24.7)},
    "cuts": {"clip": [clvol.Plane((1, -1, 0.3), (2, 3, 4)), clvol.Corner((0, 0, -np.inf), (9, 9, 4)), ((-9, 0, 0), (9, 99, 99))]},
    "cap": {"mode": "isosurface", "clip": clvol.Plane((1, -1, 0.3), (2, 3, 4)), "cap": "red"},
    "words": {"preset": "mr-default", "window": (0.4, 0.3), "opacity": 0.7, "theme": "print"},
    "orthographic": {"camera": clvol.Camera.orbit(12.3, 45.6, projection="orthographic", zoom=1.7)},
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With a file of a volume, noisy, so that the filter smooths, and not at the world's axes."""
    path = tmp_path_factory.mktemp("again")
    made = clvol.phantoms.marschner_lobb(14)
    noisy = made.data + np.random.default_rng(1).normal(0, 0.05, made.shape).astype(np.float32)
    turned = np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]])
    clvol.write(clvol.Volume(noisy.astype(np.float32), (0.7, 0.9, 1.1), (-3, 1, 2), turned, units="mm"), path / "volume.nrrd")
    return path


@pytest.mark.one_in(3)
@pytest.mark.parametrize("mode", ["composite", "isosurface", "mip"])
def test_several_media_are_the_same_to_the_bit(folder: Path, mode: str, device: Device) -> None:
    clvol.write(clvol.phantoms.sphere(12), folder / "ball.nrrd")
    red = clvol.TransferFunction(((0, "red"),), ((0.2, 0), (0.7, 0.4)))
    own = [clvol.Corner((0, 0, 0), (9, 9, 9)), ((-9, -9, -9), (9, 9, 8))]
    media = clvol.Medium(clvol.read(folder / "ball.nrrd"), red), clvol.Medium(clvol.read(folder / "volume.nrrd"), clip=own)
    first = clvol.render(clvol.Scene(media, clip=clvol.Plane((0, 0, 1), (0, 0, 9))), mode=mode, size=SIZE, device=device)
    path = first.save(folder / "several.png")
    np.testing.assert_array_equal(render_again(path, device=device), first)
    assert render_again(path, size=(20, 20), device=device).shape == (20, 20, 4)
    with pytest.raises(OptionError, match="shows 2: leave it out"):
        render_again(path, media[0].volume)
    clvol.write(clvol.phantoms.sphere(14), folder / "ball.nrrd")
    with pytest.raises(DataError, match=r"ball\.nrrd has changed since"):
        render_again(path)


def test_several_media_that_are_read_by_bricks_are_again(folder: Path, device: Device) -> None:
    red = clvol.TransferFunction(((0, "red"),), ((0.2, 0), (0.7, 0.4)))
    np.save(folder / "ball.npy", clvol.phantoms.sphere(12).data)
    media = clvol.Medium(clvol.open(folder / "ball.npy"), red), clvol.Medium(clvol.read(folder / "volume.nrrd"))  # type: ignore[arg-type]
    first = clvol.render(clvol.Scene(media), size=SIZE, device=device)
    np.testing.assert_array_equal(render_again(first.save(folder / "several.png"), device=device), first)
    np.save(folder / "ball.npy", clvol.phantoms.sphere(14).data)
    with pytest.raises(DataError, match=r"ball\.npy has changed since"):
        render_again(folder / "several.png")


def test_functions_of_value_and_gradient_are_again_from_the_shell(folder: Path, tmp_path: Path) -> None:
    own = clvol.TransferFunction2D([((0.2, 0.4), (0.01, None), "teal", 0.3)], [((0.3, 0.9), 0.2, (0.25, 0.5, 1), 0.9)])
    path, small = own.save(tmp_path / "own.json"), ("--size", *map(str, SIZE))
    assert clvol.read_transfer(path) == own
    assert json.loads(path.read_text())["boxes"][0][1] == [0.01, None]
    volume, given = str(folder / "volume.nrrd"), ("--transfer", str(path))
    first, again, fourth = (tmp_path / f"{name}.png" for name in ("first", "again", "b-3"))
    assert run("render", volume, "-o", str(first), *small, *given) == 0
    assert run("render", "--from", str(first), "-o", str(again)) == 0
    assert run("movie", volume, "-o", str(tmp_path / "frames"), *small, *given, "--frames", "2") == 0
    assert run("batch", volume, "-o", str(tmp_path / "b-{frame}.png"), *small, *given, "--turn", "2") == 0
    picture = iio.imread(first)
    frames = sorted((tmp_path / "frames").iterdir())
    for other in (again, frames[0], next(tmp_path.glob("b-*0.png"))):
        np.testing.assert_array_equal(iio.imread(other), picture)
    assert np.ptp(picture[..., :3]) > 40
    assert run("render", volume, "-o", str(fourth), *given, "--preset", "ct-bone") == 1
    shades = np.random.default_rng(0).random((6, 7, 4))
    drawn = clvol.render(clvol.read(volume), size=SIZE, transfer=clvol.TransferFunction2D(image=(shades, (0, 1), 0.3)))
    np.testing.assert_array_equal(render_again(drawn.save(first)), drawn)


@pytest.mark.one_in(3)
@pytest.mark.parametrize("case", CASES)
def test_it_is_the_same_to_the_bit(folder: Path, case: str, device: Device) -> None:
    first = clvol.render(clvol.read(folder / "volume.nrrd"), size=SIZE, device=device, **CASES[case])
    path = first.save(folder / f"{case}.png")
    again = render_again(path, device=device)
    np.testing.assert_array_equal(again, first)
    assert again.camera == first.camera
    assert again.options == first.options
    assert (folder / f"{case}.png").read_bytes() == again.save(folder / "again.png").read_bytes()
    assert first.scene is not None
    np.testing.assert_array_equal(clvol.render(first.scene, first.camera, device=device, **first.options), first)


def test_what_made_it_has_nothing_left_open(folder: Path) -> None:
    volume = clvol.read(folder / "volume.nrrd")
    made = clvol.render(volume, size=SIZE)
    assert made.scene is not None
    assert made.camera is not None
    (medium,) = made.scene.media
    assert medium.volume is volume
    assert medium.transfer is not None
    assert medium.filter is not None
    assert medium.filter.settled
    assert made.camera.radius is not None
    assert made.options["size"] == SIZE
    surface = clvol.render(volume, mode="isosurface", size=SIZE)
    assert isinstance(surface.options["mode"].isovalue, float)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("several", [False, True])
def test_a_volume_that_is_read_by_bricks_is_again(tmp_path: Path, several: bool) -> None:
    pytest.importorskip("zarr")
    noisy = clvol.phantoms.marschner_lobb(40).data + np.random.default_rng(0).normal(0, 0.05, (40,) * 3).astype(np.float32)
    clvol.pyramid(clvol.Volume(noisy), tmp_path / "a.zarr", chunks=(16, 16, 16), levels=2 if several else 1, bounds=several)
    for number, own in enumerate(({}, {"mode": "mip"}, {"mode": "isosurface", "isovalue": 0.5}, {"lod": 3.0} if several else {})):
        first = clvol.render(clvol.open(tmp_path / "a.zarr"), size=(30, 30), **own)  # type: ignore[call-overload]
        path = first.save(tmp_path / f"{number}.png")
        np.testing.assert_array_equal(render_again(path), first)


def test_everything_around_it_is_again(folder: Path) -> None:
    pytest.importorskip("matplotlib")
    given: dict[str, Any] = dict.fromkeys(("color_bar", "scale_bar", "axes", "box", "cube"), True)
    first = clvol.render(clvol.read(folder / "volume.nrrd"), size=(90, 80), title='a "title"\nµ', time_stamp=1.5, **given)
    np.testing.assert_array_equal(render_again(first.save(folder / "around.png")), first)


def test_the_last_picture_that_becomes_finer_says_it_too(folder: Path) -> None:
    with clvol.Renderer(clvol.read(folder / "volume.nrrd")) as renderer:
        *_, last = renderer.refine(size=SIZE)
        again = render_again(last.save(folder / "refined.png"))
        np.testing.assert_array_equal(again, last)
        assert again.camera == renderer.render(size=SIZE).camera == last.camera


def test_how_it_was_read_is_known(tmp_path: Path) -> None:
    data = np.arange(24**3 * 2, dtype=">u2").reshape(2, 24, 24, 24) % 997
    data.tofile(tmp_path / "a.raw")
    volume = clvol.read(tmp_path / "a.raw", shape=(24, 24, 24), dtype=">u2", offset=24**3 * 2, spacing=(1, 2, 3))
    first = clvol.render(volume, size=SIZE, mode="mip")
    np.testing.assert_array_equal(render_again(first.save(tmp_path / "a.png")), first)
    known = json.loads(read_recipe(tmp_path / "a.png"))["Recipe"]["scene"]["Scene"]["media"][0]["Medium"]["volume"]["Volume"]
    assert known["source"]["dict"]["path"] == "a.raw"  # and no folder of this machine
    assert "trusted" not in known["source"]["dict"]


def test_a_folder_may_move_as_a_whole(folder: Path, tmp_path: Path) -> None:
    (folder / "figures").mkdir()
    first = clvol.render(clvol.read(folder / "volume.nrrd"), size=SIZE)
    first.save(folder / "figures" / "a.png")
    shutil.copytree(folder, tmp_path / "moved")
    np.testing.assert_array_equal(render_again(tmp_path / "moved" / "figures" / "a.png"), first)


def test_a_volume_that_moved_or_changed_is_said(folder: Path, tmp_path: Path) -> None:
    shutil.copy(folder / "volume.nrrd", tmp_path / "a.nrrd")
    volume = clvol.read(tmp_path / "a.nrrd")
    first = clvol.render(volume, size=SIZE)
    path = first.save(tmp_path / "a.png")
    (tmp_path / "a.nrrd").rename(tmp_path / "b.nrrd")
    with pytest.raises(FormatError, match=r"shows a\.nrrd, which is not there any more .*: give the volume"):
        render_again(path)
    np.testing.assert_array_equal(render_again(path, clvol.read(tmp_path / "b.nrrd")), first)
    other = volume.data.copy()
    other[3, 4, 5] += 0.25
    clvol.write(replace(volume, data=other), tmp_path / "a.nrrd")
    with pytest.raises(DataError, match=r"a\.nrrd has changed since .*a\.png was made of it"):
        render_again(path)
    with pytest.warns(ClvolWarning, match="was made of another volume, or of other samples"):
        assert render_again(path, clvol.read(tmp_path / "a.nrrd")).shape == first.shape


def test_a_volume_that_was_made_in_python_must_be_given(tmp_path: Path) -> None:
    volume = clvol.Volume(clvol.phantoms.marschner_lobb(12).data)
    first = clvol.render(volume, size=SIZE)
    path = first.save(tmp_path / "a.png")
    with pytest.raises(FormatError, match="shows a volume that was made in Python"):
        render_again(path)
    np.testing.assert_array_equal(render_again(path, volume), first)
    read = clvol.phantoms.by_name("marschner-lobb:12")
    part = clvol.render(read.crop((0, 0, 0), (11, 12, 12)), size=SIZE)  # a part is no file's volume
    with pytest.raises(FormatError, match="shows a volume that was made in Python"):
        render_again(part.save(tmp_path / "b.png"))


def test_a_file_that_was_changed_is_said(tmp_path: Path) -> None:
    first = clvol.render(clvol.phantoms.by_name("marschner-lobb:12"), size=SIZE)
    changed = first.copy()
    changed[:4, :5] = 1
    with pytest.warns(ClvolWarning, match=r"not that of .* to the bit: 20 of 1728 pixels differ, by up to 255"):
        render_again(changed.save(tmp_path / "a.png"))
    assert render_again(first.save(tmp_path / "b.png"), size=(20, 10)).shape == (10, 20, 4)


def _png(path: Path, text: str | None) -> Path:
    info = PngInfo()
    if text is not None:
        info.add_text("clvol", text)
    iio.imwrite(path, np.zeros((4, 5, 3), np.uint8), plugin="pillow", pnginfo=info)
    return path


def _changed(text: str, *keys: str, value: Any) -> str:
    """The text with one entry of it, by its keys, replaced."""
    plain = json.loads(text)
    place = plain
    for key in keys[:-1]:
        place = place[int(key)] if isinstance(place, list) else place[key]
    place[keys[-1]] = value
    return json.dumps(plain)


SCENE = ("Recipe", "scene", "Scene")
BROKEN: dict[str, tuple[tuple[str, ...], Any, str]] = {
    "old": (("version",), 0, "its version must be 1; got 0, made by clvol"),
    "new": (("version",), 2, "its version must be 1; got 2"),
    "true": (("version",), True, "its version must be 1; got True"),
    "class": (("Recipe", "camera"), {"system": {"command": "touch hacked"}}, "holds a 'system', which this version does not know"),
    "reduce": (("Recipe", "camera"), {"Volume": {"__reduce__": 1}}, "KeyError"),
    "field": (("Recipe", "camera", "Camera", "roll"), 3, "its Camera has roll, which this version does not know"),
    "value": (("Recipe", "camera", "Camera", "fov"), 300, "fov must be a finite number"),
    "kind": (("Recipe", "camera"), 7, "camera must be a Camera; got 7"),
    "mode": (("Recipe", "mode"), {"Camera": {}}, "mode must be a Mode"),
    "background": ((*SCENE, "background"), "no colour", "background must be"),
    "media": ((*SCENE, "media"), [], "1 to 8 media; got 0"),
    "list": (("Recipe",), [1, 2], "AttributeError"),
    "limits": (("Recipe", "limits"), {"dict": {"memory": "1"}}, "limits must be evaluator and fetch"),
    "fraction": (("Recipe", "step"), {"fraction": "1/0"}, "ZeroDivisionError"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_text_that_is_not_right_is_refused_in_words(name: str, tmp_path: Path) -> None:
    text = read_recipe(clvol.render(clvol.phantoms.by_name("marschner-lobb:8"), size=(9, 8)).save(tmp_path / "a.png"))
    keys, value, words = BROKEN[name]
    path = _png(tmp_path / "b.png", _changed(text, *keys, value=value))
    with pytest.raises(FormatError, match="does not say in a way that can be read what made it: .*" + words):
        render_again(path)
    assert {one.name for one in tmp_path.iterdir()} == {"a.png", "b.png"}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "does not say what made it: it must be a PNG file of a picture by clvol.render"),
        ("", "JSONDecodeError"),
        ("{}", "its version must be 1; got None"),
        ("[1]", "TypeError|AttributeError"),
        ("[" * 100_000, "nested too deeply"),
        ('{"version": 1, "Recipe": NaN}', "NaN, which is not JSON"),
        ('{"version": 1, "Camera": {}}', "it is no recipe of a picture"),
        ("x" * (serial.LONGEST + 1), "at most 1048576 characters"),
    ],
    ids=range(8),
)
def test_foreign_texts_are_refused_in_words(text: str | None, words: str, tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=words):
        render_again(_png(tmp_path / "a.png", text))


def test_files_that_are_no_png_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"no picture")
    iio.imwrite(tmp_path / "b.jpg", np.zeros((4, 4, 3), np.uint8))
    whole = clvol.render(clvol.phantoms.by_name("marschner-lobb:8"), size=SIZE).save(tmp_path / "c.png").read_bytes()
    (tmp_path / "d.png").write_bytes(whole[: len(whole) // 3])
    for name in ("a.png", "b.jpg", "d.png"):
        with pytest.raises(FormatError, match=r"must be a PNG file that clvol wrote|does not say"):
            render_again(tmp_path / name)
    with pytest.raises(FormatError, match="there is no such file"):
        render_again(tmp_path / "e.png")


def test_an_address_is_not_opened_by_itself(tmp_path: Path) -> None:
    text = read_recipe(clvol.render(clvol.phantoms.by_name("marschner-lobb:8"), size=SIZE).save(tmp_path / "a.png"))
    text = text.replace("phantom:marschner-lobb:8", "https://example.org/a.zarr")
    with pytest.raises(FormatError, match="no address in a picture is opened by itself"):
        render_again(_png(tmp_path / "b.png", text))


def test_parts_and_numbers_do_not_say_it(folder: Path, tmp_path: Path) -> None:
    made = clvol.render(clvol.read(folder / "volume.nrrd"), size=SIZE)
    assert made[...].camera == made.copy().camera == copy.deepcopy(made).camera == made.camera
    for part in (made[:20], made[::-1], made[:, 3:9]):
        assert part.camera is None
        assert part.options == {}
    clvol.save(np.array(made), tmp_path / "a.png")
    with pytest.raises(FormatError, match="does not say what made it"):
        read_recipe(tmp_path / "a.png")


def test_a_pickle_holds_no_samples(folder: Path, tmp_path: Path) -> None:
    volume = clvol.read(folder / "volume.nrrd")
    made = clvol.render(volume, size=(4, 3))
    pickled = pickle.dumps(made)
    assert len(pickled) < volume.nbytes
    back = pickle.loads(pickled)
    assert back.camera == made.camera
    assert back.scene is not None
    assert not back.scene.media[0].volume.data.any()
    np.testing.assert_array_equal(render_again(back.save(tmp_path / "a.png")), made)


def test_a_mode_of_your_own_has_no_text(tmp_path: Path) -> None:
    class Own(clvol.Mip):
        pass

    made = clvol.render(clvol.phantoms.by_name("marschner-lobb:8"), mode=Own(), size=SIZE)
    assert isinstance(made.options["mode"], Own)
    with pytest.raises(FormatError, match="does not say what made it"):
        render_again(made.save(tmp_path / "a.png"))
    assert pickle.loads(pickle.dumps(made)).camera is None


def test_numbers_come_back_to_the_last_bit() -> None:
    numbers = np.random.default_rng(0).normal(size=(50, 3))
    for x, y, z in numbers.tolist():
        for value in (clvol.Light((x, y, z)), clvol.Camera(position=(x, y, z), fov=abs(x) + 1, zoom=abs(y) + 1e-9)):
            assert serial.from_text(serial.to_text(value, CLASSES, {}), CLASSES, {}) == value
    for name in ("bspline3", "lanczos3", "mitchell", "bspline5(0.1,0.2,0.3)", "hybrid"):
        row = clvol.filters()[name] if name in clvol.filters() else clvol.filter.table.as_filter(name)
        assert serial.from_text(serial.to_text(row, CLASSES, {}), CLASSES, {}) == row


def test_every_class_of_a_scene_can_be_written() -> None:
    """A dataclass that others add to the scene's modules needs no code here."""
    wanted = {"Scene", "Medium", "Camera", "Light", "Material", "TransferFunction", "Filter", "Boundary", "Composite", "Isosurface"}
    assert wanted <= CLASSES.keys()
    assert all(mode.__name__ in CLASSES for mode in map(type, clvol.modes().values()))
    with pytest.raises(OptionError, match="only clvol's own objects can be written as text; got a object"):
        serial.to_text(clvol.Camera(), {"Camera": clvol.Camera}, {}) and serial.to_text(object(), {}, {})


def test_the_shell_draws_it_again(tmp_path: Path, capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    pytest.importorskip("matplotlib")
    first, again = str(tmp_path / "a.png"), str(tmp_path / "b.png")
    around = [
        "--color-bar",
        "--scale-bar",
        "--axes",
        "--box",
        "--cube",
        "--title",
        "a title",
        "--time-stamp",
        "now",
        "--theme",
        "print",
    ]
    assert run("render", str(folder / "volume.nrrd"), "-o", first, "--size", "120", "90", *around) == 0
    assert run("render", "--from", first, "-o", again) == 0
    assert Path(first).read_bytes() == Path(again).read_bytes()
    assert run("render", "--from", first, "-o", again, "--size", "60", "50") == 0
    assert iio.imread(again).shape == (50, 60, 3)
    assert run("render", "phantom:marschner-lobb:14", "-o", str(tmp_path / "c.png"), "--by-bricks", "--size", "30", "30") == 0
    assert run("render", "--from", str(tmp_path / "c.png"), "-o", again) == 0
    assert (tmp_path / "c.png").read_bytes() == Path(again).read_bytes()
    capsys.readouterr()
    for arguments, words in (
        (["--from", first, "--zoom", "2"], "--from says all that a picture shows: leave out other options; got some of look"),
        (["--from", first, "--title", "other"], "got some of around it"),
        (["--from", first, "--time", "2"], "need SOURCE"),
        ([], "give SOURCE, a volume, or --from"),
        (["phantom:sphere:12", "--mode", "isosurface", "--color-bar"], "--color-bar changes nothing in isosurface"),
        (["phantom:sphere:12", "--letters"], "letters changes nothing"),
    ):
        assert run("render", *arguments, "-o", again) != 0
        assert words in " ".join(capsys.readouterr().err.split())
    assert Recipe.of_text(read_recipe(first)).furniture is not None


def test_the_shell_writes_pdf_and_movies_with_it(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    phantom, small = "phantom:sphere:12", ["--size", "40", "30"]
    assert run("render", phantom, "-o", str(tmp_path / "a.pdf"), *small, "--scale-bar") == 0
    assert (tmp_path / "a.pdf").read_bytes().startswith(b"%PDF")
    assert run("movie", phantom, "-o", str(tmp_path / "a.zip"), *small, "--frames", "2", "--time-stamp", "now") == 0
    assert run("batch", phantom, "-o", str(tmp_path / "b.png"), *small, "--title", "b") == 0
    plain = clvol.render(clvol.phantoms.by_name("sphere:12"), size=(40, 30))
    assert (iio.imread(tmp_path / "b.png") != np.rint(np.asarray(plain)[..., :3] * 255)).any()
