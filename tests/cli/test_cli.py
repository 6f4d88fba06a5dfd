from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from typing import Any, Self

import imageio.v3 as iio
import numpy as np
import pytest
import tifffile
import zarr
from rich.console import Console

import clvol
from clvol import cli
from clvol.base import checks
from clvol.cli.options import Input
from clvol.cli.root import app
from clvol.device import Device
from clvol.scene.look import look

pytestmark = pytest.mark.usefixtures("device", "_in_folder")
SPHERE = "phantom:sphere:8"
SMALL = ("--size", "16", "12")
Command = Callable[..., "Result"]


@pytest.fixture
def _in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


class Result:
    def __init__(self, code: int, out: str, err: str) -> None:
        self.code, self.out, self.err = code, out, err

    @property
    def json(self) -> Any:
        assert self.code == 0, self.err
        return json.loads(self.out)

    def fails(self, code: int, *words: str) -> None:
        """Require one line on standard error that contains `words`, no standard output, and no file."""
        assert self.code == code, self.err
        assert self.out == ""
        assert self.err.startswith("clvol: ")
        assert self.err.count("\n") == 1
        assert self.err.endswith("\n")
        for word in words:
            assert word in self.err


@pytest.fixture
def clvol_command(capsys: pytest.CaptureFixture[str]) -> Command:
    def run(*arguments: object) -> Result:
        code = 0
        try:
            cli.main([str(a) for a in arguments])
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else int(end.code is not None)
        out, err = capsys.readouterr()
        return Result(code, out, err)

    return run


def subprocess_of(*arguments: object, code: str = "", **environment: str) -> subprocess.CompletedProcess[str]:
    """Run the command in its own process, after the statements in `code`."""
    script = f"{code}\nfrom clvol.cli import main\nmain()"
    return subprocess.run(
        [sys.executable, "-c", script, *map(str, arguments)],
        capture_output=True,
        encoding="utf-8",
        timeout=60,
        check=False,
        env={**os.environ, **environment},
    )


def files() -> list[str]:
    return sorted(p.name for p in Path.cwd().iterdir())


# -- render ---------------------------------------------------------------------------------------------------


def test_render_reports_its_smoothing(clvol_command: Command, tmp_path: Path) -> None:
    noisy = clvol.phantoms.sphere(32).data + np.random.default_rng(0).normal(0, 0.2, (32, 32, 32))
    np.save(tmp_path / "noisy.npy", noisy.astype(np.float32))
    done = clvol_command("render", "noisy.npy", "-o", "a.png", *SMALL)
    assert re.search(r"filter: bspline3, λ = [\d.]+ \(white noise, σ = 0\.[12]\d*\)", done.out)
    assert "filter: bspline3\n" in clvol_command("render", "noisy.npy", "-o", "a.png", "--mode", "mip", *SMALL).out
    assert (
        "filter: bspline3, λ = 0.5\n"
        in clvol_command("render", "noisy.npy", "-o", "a.png", "--filter", "bspline3(0.5)", *SMALL).out
    )
    drawn = json.loads(clvol_command("render", "noisy.npy", "-o", "a.png", "--json", *SMALL).out)["filter"]
    assert drawn == clvol.Renderer(noisy.astype(np.float32)).filter.name


def test_render_writes_the_picture_of_the_function(clvol_command: Command) -> None:
    done = clvol_command("render", SPHERE, "-o", "a.png", *SMALL)
    assert (done.code, done.err) == (0, "")
    assert done.out == "output: a.png\nsize: 16 12\nfilter: bspline3\nmode: composite\nwindow: 0 2.25\n"
    expected = clvol.show.picture.to_bytes(clvol.render(clvol.phantoms.sphere(8), size=(16, 12)))
    np.testing.assert_array_equal(iio.imread("a.png"), expected[..., :3])
    assert files() == ["a.png"]


def test_render_passes_every_option_on(clvol_command: Command) -> None:
    options = (
        "--mode isosurface --boundary wrap --rays 2 --isovalue -0.25 --color red --background #102030 "
        "--gradient central --azimuth -40 --elevation 10 --zoom 1.5 --projection orthographic --evaluator taps "
        "--fetch buffer --filter mitchell"
    )
    done = clvol_command("render", SPHERE, "--output", "a.png", *SMALL, *options.split(), "--json").json
    assert done == {"output": "a.png", "size": [16, 12], "filter": "mitchell", "mode": "isosurface", "isovalue": -0.25}
    camera = clvol.Camera.orbit(-40, 10, zoom=1.5, projection="orthographic")
    picture = clvol.render(
        clvol.phantoms.sphere(8),
        camera,
        "isosurface",
        filter="mitchell",
        boundary="wrap",
        size=(16, 12),
        rays=2,
        isovalue=-0.25,
        color="red",
        background="#102030",
        gradient="central",
    )
    np.testing.assert_array_equal(iio.imread("a.png"), clvol.show.picture.to_bytes(picture)[..., :3])


def test_words_of_the_command_line_control_no_terminal(clvol_command: Command) -> None:
    assert 'unknown command "bo\\x1b[31mgus"' in clvol_command("bo\x1b[31mgus").err
    assert "unknown option --fil\\x1b[31mter" in clvol_command("render", SPHERE, "-o", "a.png", "--fil\x1b[31mter", "1").err


def test_options_that_change_nothing_are_refused(clvol_command: Command) -> None:
    surface = ("--mode", "isosurface", "--isovalue", "-0.25")
    refused = clvol_command("render", SPHERE, "-o", "a.png", *SMALL, *surface, "--step", "0.3")
    assert "--step changes nothing in isosurface: surfaces are exact, and take no samples" in refused.err
    refused = clvol_command("compare", SPHERE, "--table", "a.csv", "--cmap", "gray", "--isovalue", "-0.25")
    assert "--cmap, --isovalue changes nothing in a table of errors" in refused.err


def test_options_of_modes_that_are_words(clvol_command: Command) -> None:
    options = (*SMALL, "--mode", "isosurface", "--isovalue", "-0.25")
    assert clvol_command("render", SPHERE, "--output", "a.png", *options, "--method", "stepped").code == 0
    drawn = clvol.render(clvol.phantoms.sphere(8), None, clvol.Isosurface(-0.25, method="stepped"), size=(16, 12))
    np.testing.assert_array_equal(iio.imread("a.png"), clvol.show.picture.to_bytes(drawn)[..., :3])
    wrong = clvol_command("render", SPHERE, "--output", "b.png", *options, "--method", "fast")
    assert wrong.code == 1
    assert "method must be one of exact, stepped; got 'fast'" in wrong.err


def test_levels_in_standard_deviations(clvol_command: Command) -> None:
    data = clvol.phantoms.sphere(8).data.astype(np.float64)
    for text, level in (("1sigma", data.mean() + data.std()), ("-0.5σ", data.mean() - 0.5 * data.std())):
        assert clvol_command("render", SPHERE, "-o", "a.png", *SMALL, "--mode", "isosurface", f"--isovalue={text}").code == 0
        drawn = clvol.render(clvol.phantoms.sphere(8), mode="isosurface", isovalue=level, size=(16, 12))
        np.testing.assert_array_equal(iio.imread("a.png"), clvol.show.picture.to_bytes(drawn)[..., :3])


def test_render_reports_and_draws_the_samples_evaluated(clvol_command: Command) -> None:
    options = (*SMALL, "--mode", "isosurface", "--isovalue", "-0.25")
    told = clvol_command("render", SPHERE, "-o", "a.png", *options, "--heat-map", "heat.png", "--verbose", "--json").json
    assert told["heat_map"] == "heat.png"
    assert told["seconds_to_hold"] > 0
    assert told["seconds_to_draw"] > 0
    visited = clvol.render(clvol.phantoms.sphere(8), mode="isosurface", isovalue=-0.25, size=(16, 12), outputs="visited")
    assert told["samples_visited"] == pytest.approx(np.nanmean(visited), abs=1e-4)
    np.testing.assert_array_equal(iio.imread("heat.png"), clvol.show.picture.to_bytes(clvol.show.picture.heat(visited)))
    assert files() == ["a.png", "heat.png"]
    clvol_command("render", SPHERE, "-o", "b.png", *options, "--heat-map", "heat.gif").fails(1, "heat.gif")
    assert "b.png" not in files()


def test_render_reports_and_draws_the_surface_uncertainty(clvol_command: Command) -> None:
    options = (*SMALL, "--mode", "isosurface", "--isovalue", "-0.25", "--filter", "bspline3")
    told = clvol_command("render", SPHERE, "-o", "a.png", *options, "--uncertainty", "within.png", "--json").json
    assert told["uncertainty"] == "within.png"
    look = {"mode": "isosurface", "isovalue": -0.25, "size": (16, 12)}
    stated = clvol.render(clvol.phantoms.sphere(8), filter="bspline3", outputs="uncertainty", **look)
    assert told["surface"] == clvol.march.uncertainty.in_words(stated)
    title = "the true surface lies within ± (95 %)"
    np.testing.assert_array_equal(iio.imread("within.png"), clvol.show.picture.heat_with_scale(stated[..., 0], "", title))
    clvol_command("render", SPHERE, "-o", "b.png", *SMALL, "--uncertainty", "b2.png").fails(1, "mode must be isosurface")
    assert files() == ["a.png", "within.png"]


@pytest.mark.parametrize("mode", ["composite", "isosurface", "mip", "minip", "mean"])
def test_render_supports_every_mode(clvol_command: Command, mode: str) -> None:
    assert clvol_command("render", SPHERE, "-o", "a.png", *SMALL, "--mode", mode, "--json").json["mode"] == mode
    assert iio.imread("a.png").shape == (12, 16, 3)


def test_opacity_takes_pairs_and_negative_values(clvol_command: Command) -> None:
    options = ("--opacity", "-1", "0", "0.5", "0.25", "--cmap", "viridis", "--value-range", "-1", "0.8", "--no-shading")
    assert clvol_command("render", SPHERE, "-o", "a.png", *SMALL, *options).code == 0
    spread = clvol.TransferFunction.from_cmap("viridis", (-1, 0.8))
    transfer = replace(look(clvol.phantoms.sphere(8), "composite", opacity=((-1, 0), (0.5, 0.25))), colors=spread.colors)
    picture = clvol.render(clvol.phantoms.sphere(8), size=(16, 12), transfer=transfer, shading=False)
    np.testing.assert_array_equal(iio.imread("a.png"), clvol.show.picture.to_bytes(picture)[..., :3])
    clvol_command("render", SPHERE, "-o", "b.png", "--opacity", "1", "0", "2").fails(1, "pairs", "got 3 numbers")
    assert files() == ["a.png"]


def test_a_colour_map_alone_keeps_the_automatic_opacity(clvol_command: Command) -> None:
    for name, mode in (("a.png", "composite"), ("b.png", "mip")):
        assert clvol_command("render", SPHERE, "-o", name, *SMALL, "--cmap", "magma", "--mode", mode).code == 0
        assert np.ptp(iio.imread(name).astype(int), axis=2).max() > 20  # colours


def test_background_none_is_transparent(clvol_command: Command) -> None:
    assert clvol_command("render", SPHERE, "-o", "a.png", *SMALL, "--mode", "isosurface", "--background", "none").code == 0
    opacity = iio.imread("a.png")[..., 3]
    assert opacity[0, 0] == 0
    assert opacity[6, 8] == 255


@pytest.mark.parametrize("suffix", ["jpg", "tif", "bmp", "PNG"])
def test_render_writes_by_suffix(clvol_command: Command, suffix: str) -> None:
    assert clvol_command("render", SPHERE, "-o", f"a.{suffix}", *SMALL).code == 0
    assert iio.imread(f"a.{suffix}").shape == (12, 16, 3)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("phantom:bogus",), ("phantom must be one of", "sphere", "'bogus'")),
        (("phantom:sphere:x",), ("size of a phantom", "'x'")),
        ((SPHERE, "--shape", "1", "2", "3"), ("--shape is for files; give a phantom's size as phantom:NAME:SIZE",)),
        (("missing.npy",), ("missing.npy", "no such file")),
        (("folder",), ("folder",)),
        ((SPHERE, "--filter", "bogus"), ("filter must be one of", "bspline3", "'bogus'")),
        ((SPHERE, "--mode", "bogus"), ("mode must be one of", "minip", "'bogus'")),
        ((SPHERE, "--boundary", "bogus"), ("boundary must be one of", "mirror", "'bogus'")),
        ((SPHERE, "--cmap", "bogus"), ("'bogus'",)),
        ((SPHERE, "--color", "bogus", "--mode", "isosurface"), ("color", "'bogus'")),
        ((SPHERE, "--background", "bogus"), ("background", "'bogus'")),
        ((SPHERE, "--device", "bogus"), ("device must be one of", "'bogus'")),
        ((SPHERE, "--step", "0"), ("step must be a finite number, greater than 0", "0.0")),
        ((SPHERE, "--step", "nan"), ("step must be a finite number",)),
        ((SPHERE, "--rays", "0"), ("rays",)),
        ((SPHERE, "--size", "0", "4"), ("width must be a whole number", "got 0")),
        ((SPHERE, "--zoom", "-1"), ("zoom must be a finite number",)),
        ((SPHERE, "--isovalue", "inf", "--mode", "isosurface"), ("isovalue must be a finite number",)),
        ((SPHERE, "--spacing", "1", "0", "1"), ("spacing must be positive",)),
        (("phantom:sphere:99999",), ("out of memory",)),
        ((SPHERE, "-o", "a.gif"), (".png, .jpg", "'a.gif'")),
        ((SPHERE, "-o", "a"), (".png, .jpg", "'a'")),
        ((SPHERE, "-o", "missing/a.png"), ("the folder missing does not exist",)),
    ],
    ids=lambda x: " ".join(x[-2:]) if isinstance(x, tuple) else None,
)
def test_a_users_error_is_one_line(clvol_command: Command, options: tuple[str, ...], words: tuple[str, ...]) -> None:
    Path("folder").mkdir()
    output = () if "-o" in options else ("-o", "a.png")
    clvol_command("render", *options, *output).fails(1, *words)
    assert files() == ["folder"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ("bogus",),
            (
                '"bogus"',
                "compare, completion, convert, devices, doctor, export, figure, filters, info",
                "resample, slice, view: see 'clvol --help'",
            ),
        ),
        (("rendr", SPHERE), ("(did you mean render?)",)),
        (("completion", "csh"), ("bash", "fish")),
        (("render",), ("--output", "'clvol render --help'")),
        (("resample",), ("SOURCE", "'clvol resample --help'")),
        (("render", SPHERE), ("--output",)),
        (("render", SPHERE, "-o", "a.png", "--bogus", "1"), ("--bogus",)),
        (("render", SPHERE, "-o", "a.png", "--size", "16"), ("--size", "2")),
        (("render", SPHERE, "-o", "a.png", "--size", "a", "b"), ("--size", '"a"')),
        (("render", SPHERE, "-o", "a.png", "--projection", "bogus"), ("--projection", "orthographic")),
        (("render", SPHERE, "-o", "a.png", "--evaluator", "bogus"), ("--evaluator", "eight-fetch")),
        (("render", SPHERE, "-o", "a.png", "more"), ("more",)),
        (("resample", SPHERE, "-o", "a.npz", "--magnify", "1.5"), ("--magnify", "1.5")),
        (("resample", SPHERE, "-o", "a.npz", "--to-shape", "4", "4.2", "4"), ("--to-shape", "4.2")),
        (("render", SPHERE, "-o", "a.png", "--size", "16.5", "12"), ("--size", "16.5")),
        (("info",), ("SOURCE",)),
        (("figure6", "--pixels", "many"), ("--pixels",)),
        (("resample", SPHERE, "-o", "a.npz", "--magnify", "2", "--nan", "bogus"), ("--nan", "propagate")),
        (("devices", "more"), ("more",)),
        (("render", SPHERE, "-o", "a.png", "--iso", "5"), ("unknown option --iso (did you mean --isovalue?); see",)),
        (("render", SPHERE, "-o", "a.png", "--iso=5"), ("unknown option --iso (did you mean --isovalue?)",)),
        (("render", SPHERE, "-o", "a.png", "--colormap", "gray"), ("(did you mean --cmap?)",)),
        (("render", SPHERE, "-o", "a.png", "--width", "5"), ("(did you mean --size WIDTH HEIGHT?)",)),
        (("render", SPHERE, "-o", "a.png", "--alpha", "5"), ("(did you mean --opacity?)",)),
        (("resample", SPHERE, "-o", "a.npz", "--voxel-size", "5"), ("(did you mean --to-spacing?)",)),
        (("render", SPHERE, "--out", "a.png"), ("unknown option --out (did you mean --output?)",)),
        (("render", SPHERE), ("'clvol render' needs --output (or -o): the file to write",)),
        (("render", SPHERE, "-o"), ("--output takes a value: the file to write; got none",)),
        (("render", SPHERE, "-o", "a.png", "--clip", "1", "2", "3", "4", "5"), ("--clip takes 6 values: ", "; got 1 2 3 4 5;")),
        (
            ("render", SPHERE, "-o", "a.png", "--size", "400x300"),
            ("--size takes 2 values: width and height in pixels; got 400x300;",),
        ),
        (("show", "a.nii"), ('unknown command "show" (did you mean view?)',)),
        (("scan.nii.gz",), ("a command must come before scan.nii.gz: 'clvol view scan.nii.gz'",)),
        ((SPHERE,), (f"'clvol render {SPHERE} -o picture.png'",)),
        (("s3://bucket/a.zarr",), ("'clvol info s3://bucket/a.zarr'",)),
    ],
    ids=lambda x: " ".join(x) if isinstance(x, tuple) else None,
)
def test_a_wrong_command_line_exits_with_2(clvol_command: Command, arguments: tuple[str, ...], words: tuple[str, ...]) -> None:
    clvol_command(*arguments).fails(2, *words)
    assert files() == []


def test_nothing_is_rendered_for_an_impossible_output(clvol_command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("render", "resample", "magnify", "read"):
        monkeypatch.setattr(clvol, name, None)
    for command in (("render", SPHERE), ("compare", SPHERE), ("figure6",), ("figure", "6")):
        clvol_command(*command, "-o", "a.npy").fails(1, ".png", "'a.npy'")
        clvol_command(*command, "-o", "missing/a.png").fails(1, "missing")
    clvol_command("resample", SPHERE, "-o", "a.png", "--magnify", "2").fails(1, ".npz", "'a.png'")
    clvol_command("resample", SPHERE, "-o", "missing/a.npz", "--magnify", "2").fails(1, "missing")
    assert files() == []


def test_a_failed_picture_leaves_the_old_one(clvol_command: Command) -> None:
    Path("a.png").write_bytes(b"old")
    clvol_command("render", SPHERE, "-o", "a.png", "--step", "-1").fails(1, "step")
    assert Path("a.png").read_bytes() == b"old"
    assert files() == ["a.png"]


# -- inputs ---------------------------------------------------------------------------------------------------


def test_raw_files_need_a_shape_and_a_type(clvol_command: Command) -> None:
    data = np.arange(4 * 5 * 6, dtype=">u2").reshape(4, 5, 6)
    data.tofile("a.raw")
    arguments = ("--shape", "4", "5", "6", "--dtype", ">u2", "--spacing", "1", "2", "3")
    told = clvol_command("info", "a.raw", *arguments, "--json").json
    assert (told["shape"], told["spacing"], told["value_range"]) == ([4, 5, 6], [1, 2, 3], [0, 119])
    assert clvol_command("render", "a.raw", *arguments, "-o", "a.png", *SMALL).code == 0
    expected = clvol.render(clvol.Volume(data, (1, 2, 3)), size=(16, 12))
    np.testing.assert_array_equal(iio.imread("a.png"), clvol.show.picture.to_bytes(expected)[..., :3])
    clvol_command("info", "a.raw").fails(1, "shape", "dtype")
    clvol_command("info", "a.raw", "--shape", "4", "5", "7", "--dtype", "uint16").fails(1, "280 bytes", "240")
    clvol_command("info", "a.raw", "--shape", "4", "5", "6", "--dtype", "bogus").fails(1, "'bogus'")


def test_nan_is_left_out_or_filled(clvol_command: Command) -> None:
    data = np.array(clvol.phantoms.sphere(8).data)
    data[1, 2, 3], data[0, 0, 0] = np.nan, np.inf
    np.save("a.npy", data)
    assert clvol_command("render", "a.npy", "-o", "b.png", *SMALL).code == 0
    out = clvol.show.picture.to_bytes(clvol.render(data, size=(16, 12)))[..., :3]
    np.testing.assert_array_equal(iio.imread("b.png"), out)
    np.save("none.npy", np.full((3, 3, 3), np.nan))
    clvol_command("render", "none.npy", "-o", "none.png", *SMALL).fails(1, "no sample of the volume is finite")
    assert files() == ["a.npy", "b.png", "none.npy"]
    assert clvol_command("render", "a.npy", "-o", "a.png", *SMALL, "--fill-nan", "-0.5").code == 0
    assert clvol_command("render", "a.npy", "-o", "c.png", *SMALL, "--fill-nan", "smoothly").code == 0
    expected = clvol.render(clvol.Volume(data).filled(-0.5), size=(16, 12))
    np.testing.assert_array_equal(iio.imread("a.png"), clvol.show.picture.to_bytes(expected)[..., :3])
    clvol_command("render", "a.npy", "-o", "b.png", "--fill-nan", "nan").fails(1, "finite")


@pytest.mark.parametrize("name", ["a.npy", "a.npz", "a.nii", "a.nii.gz", "a.nrrd", "a.nhdr", "a.mha", "a.mhd", "a.tif"])
def test_info_describes_every_kind_of_file(clvol_command: Command, name: str) -> None:
    if name.startswith(("a.n", "a.m")) and not name.startswith("a.np"):
        pytest.importorskip("SimpleITK")
    if name.endswith("tif"):
        pytest.importorskip("tifffile")
    spacing = (1.0, 1.0, 1.0) if name == "a.npy" else (0.5, 0.5, 2.0)
    volume = clvol.Volume(np.arange(24, dtype=np.int16).reshape(2, 3, 4), spacing, units="" if name == "a.npy" else "mm")
    clvol.write(volume, name)
    told = clvol_command("info", name, "--json").json
    assert told == {
        "holds": {},
        "name": "",
        "shape": [2, 3, 4],
        "dtype": "int16",
        "spacing": list(spacing),
        "origin": [0, 0, 0],
        "direction": np.eye(3).tolist(),
        "units": volume.units,
        "space": clvol.read(name).space,
        "value_range": [0, 23],
        "clim": None,
        "labels": False,
        "finite": True,
        "bytes": 48,
        "noise": "none",
        "sigma": 0.0,
        "smoothing": [0.0, 0.0, 0.0],
        "reason": "no noise",
        "isovalue": pytest.approx(clvol.Isosurface().settled(volume).isovalue),
        "isovalue_reason": clvol.volume.histogram.isovalue_of(volume)[1],
        "header": dict(clvol.read(name).header),
    }
    lines = clvol_command("info", name).out.splitlines()
    assert lines[0] == "shape: 2 3 4"
    assert "direction: 1 0 0, 0 1 0, 0 0 1" in lines
    assert ("units: mm" in lines) == bool(volume.units)
    assert "finite: yes" in lines


def test_info_describes_a_dicom_folder(clvol_command: Command) -> None:
    sitk = pytest.importorskip("SimpleITK")
    Path("series").mkdir()
    for z in range(3):
        image = sitk.GetImageFromArray(np.full((1, 4, 5), z, np.int16))
        image.SetSpacing((1, 1, 2))
        for tag, value in (
            ("0020|000e", "1.2.3.4"),
            ("0020|000d", "1.2.3"),
            ("0008|0018", f"1.2.3.4.{z + 1}"),
            ("0020|0013", str(z)),
            ("0020|0032", f"0\\0\\{2 * z}"),
            ("0020|0037", "1\\0\\0\\0\\1\\0"),
            ("0008|0060", "MR"),
        ):
            image.SetMetaData(tag, value)
        writer = sitk.ImageFileWriter()
        writer.KeepOriginalImageUIDOn()
        writer.SetFileName(f"series/{z}.dcm")
        writer.Execute(image)
    told = clvol_command("info", "series", "--json").json
    assert (told["shape"], told["value_range"], told["spacing"]) == ([3, 4, 5], [0, 2], [1, 1, 2])


def test_info_describes_images_phantoms_and_nan(clvol_command: Command) -> None:
    np.save("image.npy", np.zeros((3, 4), np.uint8))
    assert clvol_command("info", "image.npy", "--json").json["shape"] == [3, 4]
    assert clvol_command("info", "phantom:box:3,4,5", "--spacing", "1", "2", "3", "--json").json["spacing"] == [1, 2, 3]
    assert clvol_command("info", "phantom:marschner-lobb", "--json").json["shape"] == [41, 41, 41]
    np.save("some.npy", np.array([[[1, np.nan, 3]]]))
    told = clvol_command("info", "some.npy", "--json").json
    assert (told["finite"], told["value_range"], told["noise"]) == (False, [1, 3], "none")
    np.save("none.npy", np.full((2, 2, 2), np.nan, np.float32))
    told = clvol_command("info", "none.npy", "--json").json
    assert (told["finite"], told["value_range"]) == (False, None)
    assert (told["noise"], told["sigma"], told["smoothing"]) == (None, None, None)
    assert "value range: none\nfinite: no\n" in clvol_command("info", "none.npy").out
    assert clvol_command("info", "none.npy", "--fill-nan", "2", "--json").json["value_range"] == [2, 2]


def test_info_reports_noise_and_the_automatic_smoothing(clvol_command: Command) -> None:
    np.save("noisy.npy", clvol.phantoms.sphere(32).data + 0.1 * np.random.default_rng(0).normal(size=(32, 32, 32)))
    told = clvol_command("info", "noisy.npy", "--json").json
    assert told["noise"] == "white"
    assert told["sigma"] == pytest.approx(0.1, rel=0.1)
    assert min(told["smoothing"]) > 0.1
    assert "reason: white noise, σ = 0.0" in clvol_command("info", "noisy.npy").out
    assert clvol_command("info", "phantom:box", "--json").json["noise"] == "binary"


def test_info_reports_the_range_of_values_far_from_zero(clvol_command: Command) -> None:
    for name, data, text in (
        ("whole", np.array([[2**40 - 700, 2**40 + 4321]]), "1099511627076 1099511632097"),
        ("wide", np.array([[2**63 + 1, 2**64 - 1]], np.uint64), f"{2**63 + 1} {2**64 - 1}"),
        ("pressure", np.array([[101_324.8125, 101_325.0625]]), "101324.8125 101325.0625"),
        ("pi", np.array([[-3.14159265, 3.14159265]]), "-3.14159 3.14159"),
        ("truth", np.array([[False, True]]), "0 1"),
        ("most", np.array([[-1.7e308, 1.7e308]]), "-1.7e+308 1.7e+308"),
        ("least", np.array([[0.5, 0.5]]), "0.5 0.5"),
    ):
        np.save(f"{name}.npy", data)
        assert f"value range: {text}\n" in clvol_command("info", f"{name}.npy").out
    assert clvol_command("info", "whole.npy", "--json").json["value_range"] == [2**40 - 700, 2**40 + 4321]


def test_info_of_a_file_that_is_not_a_volume_is_one_line(clvol_command: Command) -> None:
    Path("a.npy").write_bytes(b"not an array")
    clvol_command("info", "a.npy").fails(1, "a.npy")
    Path("a.txt").write_text("text")
    clvol_command("info", "a.txt").fails(1, ".nii.gz", "a.txt")
    np.save("b.npy", np.zeros((2,) * 8))
    clvol_command("info", "b.npy").fails(1, "b.npy")


# -- several volumes in a file --------------------------------------------------------------------------------


@pytest.fixture
def cells(_in_folder: None) -> np.ndarray:
    """Written as cells.ome.tif: 3 times of 2 channels with different values."""
    tifffile = pytest.importorskip("tifffile")
    data = np.random.default_rng(0).integers(0, 9, (3, 2, 4, 5, 6)) + 10 * np.arange(6).reshape(3, 2, 1, 1, 1)
    about = {"axes": "TZCYX", "Channel": {"Name": ["DAPI", "GFP"]}}
    tifffile.imwrite("cells.ome.tif", data.swapaxes(1, 2).astype(np.uint8), metadata=about)
    return data


def test_one_of_several_volumes_is_chosen(clvol_command: Command, cells: np.ndarray) -> None:
    for options, place in (
        (("--time", "2", "--channel", "GFP"), (2, 1)),
        (("--time", "1", "--channel", "1"), (1, 1)),
        (("--volume", "4"), (2, 0)),
    ):
        done = clvol_command("convert", "cells.ome.tif", "-o", "a.npz", *options, "--json")
        assert (done.json["shape"], done.err) == ([4, 5, 6], "")
        np.testing.assert_array_equal(clvol.read("a.npz").data, cells[place])
    clvol_command("convert", "cells.ome.tif", "-o", "b.npz", "--channel", "DPI").fails(1, "--channel must be 0 to 1, of 0 (DAPI)")
    clvol_command("convert", "cells.ome.tif", "-o", "b.npz", "--time", "3").fails(
        1, "--time must be 0 to 2", "holds 3 times; got 3"
    )
    clvol_command("convert", "cells.ome.tif", "-o", "b.npz", "--volume", "1.5").fails(2, "--volume", "1.5")
    clvol_command("render", "cells.ome.tif", "-o", "b.png", "--volume", "all").fails(1, "--volume all is for resample and convert")
    assert files() == ["a.npz", "cells.ome.tif"]


@pytest.mark.usefixtures("cells")
def test_a_note_states_the_volume_chosen(clvol_command: Command) -> None:
    done = clvol_command("convert", "cells.ome.tif", "-o", "a.npz")
    assert (done.code, done.err) == (
        0,
        "clvol: note: cells.ome.tif holds 3 times × 2 channels (DAPI, GFP); time 0, channel 0 (DAPI) was read: "
        "choose by --time or --channel\n",
    )
    told = clvol_command("info", "cells.ome.tif", "--json")
    assert told.err == ""  # it is what info says
    assert told.json["holds"] == {"time": 3, "channel": [{"name": "DAPI"}, {"name": "GFP"}]}
    out = clvol_command("info", "cells.ome.tif", "--channel", "GFP").out
    assert "holds: 3 times × 2 channels (DAPI, GFP)\nchannels: 0 DAPI; 1 GFP\nname: GFP\n" in out
    assert "\nspace: image: a stack of images" in out


def test_a_pyramid_of_a_file(clvol_command: Command) -> None:
    """Written, listed, opened again; errors use the shell's options, and then nothing is written."""
    pytest.importorskip("zarr")
    clvol.write(clvol.Volume(np.random.default_rng(0).random((40, 50, 60), np.float32), spacing=(2, 2, 2)), "v.npz")
    done = clvol_command("pyramid", "v.npz", "-o", "v.zarr", "--chunks", "16", "16", "16", "--filter", "linear", "--json").json
    assert done == {"output": "v.zarr", "levels": [[40, 50, 60], [20, 25, 30], [10, 13, 15]], "bounds": "linear, mirror"}
    assert clvol.open("v.zarr").levels[1].spacing == (8, 8, 8)
    listed = clvol_command("info", "v.zarr")
    assert "levels: 40 × 50 × 60, 20 × 25 × 30, 10 × 13 × 15" in listed.out
    assert "bounds: linear, mirror" in listed.out
    assert "levels" not in clvol_command("info", "v.npz").out
    clvol_command("pyramid", "v.npz", "-o", "v.zarr").fails(1, "is there already; --overwrite replaces it")
    clvol_command("pyramid", "v.npz", "-o", "v.zarr", "--overwrite", "--levels", "1", "--no-bounds")
    assert clvol.open("v.zarr").bounds is None
    clvol_command("pyramid", "v.npz", "-o", "w.tif").fails(1, "pyramids are written as .zarr")
    clvol_command("pyramid", "v.npz", "-o", "s3://a/w.zarr").fails(1, "pyramids are written to a folder", "got s3://a/w.zarr")
    clvol_command("pyramid", "v.npz", "-o", "w.zarr", "--memory", "much").fails(1, "--memory must be", "800M or 4G; got 'much'")
    clvol_command("pyramid", "v.npz", "-o", "w.zarr", "--memory", "50M").fails(1, "--memory must be more than 96 MiB; got 50 MiB")
    clvol_command("pyramid", "v.npz", "-o", "w.zarr", "--levels", "0").fails(1, "--levels must be")
    clvol_command("pyramid", "phantom:sphere:20", "-o", "p.zarr", "--method", "average", "--ome", "0.4")
    assert clvol.open("p.zarr").shape == (20, 20, 20)
    assert sorted(path.name for path in Path().iterdir()) == ["p.zarr", "v.npz", "v.zarr"]


@pytest.fixture
def ball(_in_folder: None) -> clvol.Volume:
    """A small ball in the corner of a large empty volume, stored in ball.zarr at three resolutions."""
    pytest.importorskip("zarr")
    z, y, x = np.ogrid[:72, :72, :72]
    data = np.clip(200 - 4 * ((x - 18) ** 2 + (y - 18) ** 2 + (z - 18) ** 2), 0, None).astype(np.uint8)
    volume = clvol.Volume(data, spacing=(2, 2, 2), units="mm")
    clvol.pyramid(volume, "ball.zarr", filter="linear", chunks=24, levels=3)
    return volume


@pytest.mark.usefixtures("ball")
def test_a_multi_resolution_store_is_rendered_by_bricks(clvol_command: Command) -> None:
    own = ("render", "ball.zarr", "-o", "a.png", *SMALL, "--fit", "volume", "--mode", "isosurface")
    done = clvol_command(*own, "--memory", "1M", "--lod", "0", "--json").json
    assert {name: done[name] for name in ("filter", "level", "level_shape", "bricks")} == {
        "filter": "linear",
        "level": 0,
        "level_shape": [72, 72, 72],
        "bricks": 27,
    }
    assert 0 < done["bricks_read"] < 9  # those around the ball alone
    camera = clvol.Camera.orbit(30, 20, fit="volume")
    expected = clvol.render(clvol.open("ball.zarr"), camera, "isosurface", size=(16, 12), lod=0)
    np.testing.assert_array_equal(iio.imread("a.png"), clvol.show.picture.to_bytes(expected)[..., :3])
    told = clvol_command(*own).out  # a picture of 16 × 12 pixels does not need all samples
    assert "filter: linear\nmode: isosurface\nlevel: 2, 18 × 18 × 18\nbricks: 1 read, of 1\n" in told
    clvol_command(*own, "--memory", "1K").fails(1, "--memory must be at least", "a brick of 32³ samples takes; got 1024")
    clvol_command(*own, "--memory", "much").fails(1, "--memory must be", "800M or 4G; got 'much'")
    clvol_command(*own, "--lod", "-1").fails(1, "--lod must be a finite number, at least 0; got -1.0")


@pytest.mark.parametrize(
    "options",
    [("--level", "0"), ("--evaluator", "paired"), ("--mode", "isosurface", "--uncertainty", "u.png", "--filter", "bspline3")],
)
@pytest.mark.usefixtures("ball")
def test_outputs_that_bricks_lack_are_rendered_from_all_samples(clvol_command: Command, options: tuple[str, ...]) -> None:
    assert "bricks" not in clvol_command("render", "ball.zarr", "-o", "a.png", *SMALL, *options, "--json").json


@pytest.mark.parametrize("options", [("--by-bricks",), ("--by-bricks", "--mode", "mip")])
def test_any_volume_is_rendered_by_bricks_on_request(clvol_command: Command, options: tuple[str, ...]) -> None:
    drawn = {}
    for name, own in (("whole.png", [o for o in options if o != "--by-bricks"]), ("bricks.png", options)):
        told = clvol_command("render", "phantom:sphere:20", "-o", name, *SMALL, "--filter", "linear", *own)
        assert (told.code, told.err) == (0, "")
        assert ("bricks: 1 read, of 1" in told.out) is (own is options)
        drawn[name] = iio.imread(name)
    np.testing.assert_array_equal(drawn["whole.png"], drawn["bricks.png"])


def test_a_volume_that_does_not_fit_is_rendered_by_bricks(
    clvol_command: Command, ball: clvol.Volume, monkeypatch: pytest.MonkeyPatch
) -> None:
    np.save("ball.npy", ball.data)
    own = ("render", "ball.npy", "-o", "a.png", *SMALL, "--filter", "linear", "--json")
    assert "bricks" not in clvol_command(*own).json
    assert "bricks" not in clvol_command(*own, "--memory", "2M").json  # it takes 1.8
    assert clvol_command(*own, "--memory", "1M").json["bricks"] == 27
    monkeypatch.setattr("clvol.base.memory.available", lambda: 3 << 20)
    assert clvol_command(*own).json["bricks_read"] > 0


def test_info_reads_few_samples_of_a_large_volume(
    clvol_command: Command, ball: clvol.Volume, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = clvol_command("info", "ball.zarr")
    assert (told.code, told.err) == (0, "")
    assert "shape: 72 72 72\ndtype: uint8\nspacing: 2 2 2\n" in told.out
    assert "\nvalue range: 0 200\n" in told.out
    assert "\nlevels: 72 × 72 × 72, 36 × 36 × 36, 18 × 18 × 18\nbounds: linear, mirror, samples of 0 200\n" in told.out
    clvol.pyramid(ball, "plain.zarr", bounds=False, chunks=24)
    assert "\nvalue range: 0 200\n" in clvol_command("info", "plain.zarr").out
    attributes = zarr.open_group("plain.zarr").attrs
    attributes["clvol"] = {name: value for name, value in attributes["clvol"].items() if name != "statistics"}  # as others write
    monkeypatch.setattr("clvol.bricks.source._PREVIEWED", 20_000)
    monkeypatch.setattr("clvol.bricks.source._PART", 24)
    asked = []
    as_is = clvol.LazyVolume.as_is

    def read(volume: clvol.LazyVolume, place: Any) -> Any:
        asked.append((volume.shape, tuple(one.stop for one in place)))
        return as_is(volume, place)

    monkeypatch.setattr(clvol.LazyVolume, "as_is", read)
    told = clvol_command("info", "plain.zarr")
    assert re.search(r"\nvalue range: \d+ \d+ \(estimated\)\n", told.out)
    assert "\nbounds: none\n" in told.out
    assert clvol_command("info", "plain.zarr", "--json").json["value_range_estimated"] is True
    assert {*asked} == {((72, 72, 72), (48, 48, 48)), ((18, 18, 18), (18, 18, 18))}


def test_view_uses_a_level_that_fits(clvol_command: Command, ball: clvol.Volume, monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[Any] = []
    monkeypatch.setattr("clvol.view.hosts.terminal.show_in_terminal", shown.append)
    monkeypatch.setattr("clvol.base.memory.available", lambda: 1 << 20)
    done = clvol_command("view", "ball.zarr", "--terminal")
    assert done.err == (
        "clvol: note: ball.zarr takes 1.78 MiB with its coefficients; in memory is level 1, of 36 × 36 × 36 samples: bricks of "
        "finer ones are read where a picture at rest shows more\n"
    )
    assert (shown[0].volume.shape, shown[0].volume.spacing) == ((36, 36, 36), (4, 4, 4))
    assert shown[0].resident.source == "clvol.read('ball.zarr', level=1)"
    assert (shown[0].resident.finer.source, shown[0].resident.finer.level) == ("clvol.open('ball.zarr')", 1)
    np.save("ball.npy", ball.data)
    clvol_command("view", "ball.npy", "--terminal").fails(
        1, "must fit into the 1 MiB", "it takes 1.78 MiB", "'clvol pyramid ball.npy"
    )
    monkeypatch.setattr("clvol.base.memory.available", lambda: 2 << 20)  # which held it before there were smaller sizes, too
    assert clvol_command("view", "ball.npy", "--terminal").err == ""
    assert shown[-1].volume.shape == (72, 72, 72)


def test_remote_stores_are_rendered_listed_and_read(
    clvol_command: Command, ball: clvol.Volume, monkeypatch: pytest.MonkeyPatch
) -> None:
    fsspec = pytest.importorskip("fsspec")
    fsspec.filesystem("memory").put("ball.zarr", "/far/ball.zarr", recursive=True)
    there = "memory://far/ball.zarr"
    done = clvol_command("render", there, "-o", "a.png", *SMALL, "--lod", "0", "--json").json
    assert (done["level"], done["bricks_read"]) == (0, 1)
    assert "\nlevels: 72 × 72 × 72, " in clvol_command("info", there).out
    assert clvol_command("convert", there, "-o", "near.npz").code == 0
    np.testing.assert_array_equal(clvol.read("near.npz").data, ball.data)
    shown: list[Any] = []
    monkeypatch.setattr("clvol.view.hosts.terminal.show_in_terminal", shown.append)
    assert clvol_command("view", there, "--level", "1", "--terminal").err == ""
    assert shown[0].resident.source == "clvol.open('memory://far/ball.zarr', level=1).whole()"
    assert eval(shown[0].resident.source, {"clvol": clvol}).shape == shown[0].volume.shape == (36, 36, 36)
    clvol_command("convert", there, "-o", "b.npz", "--fill-nan", "smoothly").fails(1, "--fill-nan smoothly is for files")
    clvol_command("render", "memory://far/none.zarr", "-o", "b.png").fails(1, "memory://far/none.zarr")


@pytest.mark.parametrize("options", [(), ("--by-bricks",)])
def test_missing_samples_of_a_store_are_transparent_or_filled(clvol_command: Command, options: tuple[str, ...]) -> None:
    zarr = pytest.importorskip("zarr")
    data = np.random.default_rng(0).random((12, 12, 12), np.float32)
    data[5, 6, 7] = np.nan
    zarr.save("nan.zarr", data)
    own = ("render", "nan.zarr", "-o", "a.png", *SMALL, *options)
    assert clvol_command(*own).code == 0  # they are transparent
    assert clvol_command(*own, "--fill-nan", "0.5").code == 0
    assert clvol_command(*own, "--fill-nan", "smoothly").code == 0


def test_all_volumes_of_a_file_are_converted_and_resampled(clvol_command: Command, cells: np.ndarray) -> None:
    done = clvol_command("convert", "cells.ome.tif", "-o", "all.npz", "--volume", "all", "--json").json
    assert (done["shape"], done["dtype"]) == ([3, 2, 4, 5, 6], "uint8")
    found = clvol.read_all("all.npz")
    np.testing.assert_array_equal(np.asarray(found), cells)
    assert found.leading.names["channel"] == ("DAPI", "GFP")
    options = ("--volume", "all", "--time", "1", "--to-shape", "2", "5", "6", "--filter", "linear", "--to-dtype", "same")
    assert clvol_command("resample", "cells.ome.tif", "-o", "less.npz", *options, "--json").json["shape"] == [2, 2, 5, 6]
    less = np.asarray(clvol.read_all("less.npz"))
    assert less.dtype == np.uint8
    for channel in range(2):
        wanted = clvol.resample(clvol.Volume(cells[1, channel].astype(np.uint8)), (2, 5, 6), filter="linear", dtype="uint8")
        np.testing.assert_array_equal(less[channel], wanted.data)


def test_several_images_are_listed(clvol_command: Command) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File("a.h5", "w") as file:
        file["first"], file["deep/second"] = np.zeros((2, 3, 4)), np.ones((4, 3, 2), np.uint8)
    told = clvol_command("info", "a.h5", "--json").json
    assert [(row["id"], row["shape"]) for row in told["series"]] == [("deep/second", [4, 3, 2]), ("first", [2, 3, 4])]
    lines = clvol_command("info", "a.h5").out.splitlines()
    assert lines[0] == "a.h5 holds 2 images; choose one by --series"
    assert lines[2].split()[:3] == ["0", "deep/second", "4"]
    assert clvol_command("info", "a.h5", "--series", "first", "--json").json["shape"] == [2, 3, 4]


def test_info_reports_the_display_settings_of_a_file(clvol_command: Command) -> None:
    nibabel = pytest.importorskip("nibabel")
    image = nibabel.Nifti1Image(np.arange(60, dtype=np.int16).reshape(3, 4, 5), np.eye(4))
    image.header["cal_min"], image.header["cal_max"] = 10, 50
    nibabel.save(image, "a.nii")
    out = clvol_command("info", "a.nii").out
    assert "\nclim: 10 to 50 (--window 30 40)\n" in out
    assert "\nspace: LPS: a patient: x points to the left, y to the back, z to the head (nibabel's RAS flips x and y)\n" in out
    assert "sform_code" in out
    value, why = clvol.volume.histogram.isovalue_of(clvol.read("a.nii"))
    assert f"\nisovalue: {value:.6g}, {why}\n" in out
    clvol.write(clvol.Volume(np.eye(6, dtype=np.uint8)[None].repeat(6, 0), labels={1: "liver"}), "labels.npz")
    assert "\nlabels: 1 liver\n" in clvol_command("info", "labels.npz").out


# -- compare and figure 6 -------------------------------------------------------------------------------------


def test_compare_draws_the_requested_filters(clvol_command: Command) -> None:
    options = ("--pixels", "16", "--boundary", "wrap", "--filters", "linear", "bc(0, 1/2)", "--isovalue", "0.3")
    done = clvol_command("compare", SPHERE, "-o", "a.png", *options, "--json").json
    assert done == {"output": "a.png", "filters": ["linear", "bc(0, 1/2)"], "mode": "isosurface"}
    camera = clvol.Camera.orbit(30, 20)
    tile = clvol.render(
        clvol.phantoms.sphere(8), camera, "isosurface", filter="linear", boundary="wrap", size=(16, 16), isovalue=0.3
    )
    np.testing.assert_array_equal(iio.imread("a.png")[:16, :16], clvol.show.picture.to_bytes(tile)[..., :3])


def test_compare_always_draws_surfaces(clvol_command: Command) -> None:
    few = ("compare", SPHERE, "-o", "a.png", "--pixels", "8", "--filters", "linear", "--json")
    assert clvol_command(*few).json["mode"] == "isosurface"
    assert clvol_command(*few, "--zoom", "2").json["mode"] == "isosurface"
    assert clvol_command(*few, "--mode", "mip").json["mode"] == "mip"


def test_compare_accepts_the_six_of_the_figure(clvol_command: Command) -> None:
    done = clvol_command("compare", "phantom:marschner-lobb:8", "-o", "a.png", "--pixels", "8", "--json").json
    assert done["filters"] == list(clvol.figures.SIX)
    assert iio.imread("a.png").shape[1] == 3 * 8 + 2 * 4
    assert clvol_command("compare", SPHERE, "-o", "b.png", "--pixels", "8").out.splitlines()[1].startswith("filters: sinc4n ")


def test_compare_lists_the_known_filters(clvol_command: Command) -> None:
    clvol_command("compare", SPHERE, "-o", "a.png", "--filters", "linear", "bogus").fails(1, "bspline3-approx", "'bogus'")
    clvol_command("compare", SPHERE, "-o", "a.png", "--pixels", "0").fails(1, "pixels")
    assert files() == []


def test_compare_writes_a_table_of_errors(clvol_command: Command) -> None:
    clvol.write(clvol.phantoms.sphere(20), "scan.npz")
    names = ("linear", "bspline3", "exact-sinc")
    few = ("compare", "scan.npz", "--filters", *names, "--boundary", "reflect")
    told = clvol_command(*few, "--table", "a.json", "--json").json
    wanted = clvol.analysis.compare(clvol.read("scan.npz"), names, boundary="reflect", timing=False)
    assert told["filters"] == list(names)
    assert (told["table"], told["against"]) == ("a.json", wanted.against)
    assert json.loads(Path("a.json").read_text(encoding="utf-8")) == told["errors"]
    for row, known in zip(told["errors"], wanted, strict=True):
        assert (row["filter"], row["rms"]) == (known.filter, pytest.approx(known.rms))
        assert (row["seconds"] is None) == (row["filter"] == "exact-sinc")
    done = clvol_command(*few, "--table", "a.md", "-o", "a.png", "--pixels", "8")
    assert done.code == 0
    assert done.out.startswith("filter ")
    assert "\nexact-sinc " in done.out
    assert "\ntable: a.md\n" in done.out
    assert Path("a.md").read_text(encoding="utf-8").startswith("| filter | RMS error |")
    assert files() == ["a.json", "a.md", "a.png", "scan.npz"]


def test_compare_writes_errors_of_the_other_experiments(clvol_command: Command) -> None:
    clvol.write(clvol.phantoms.marschner_lobb(24), "scan.npz")
    volume, names = clvol.read("scan.npz"), ("linear", "bspline3")
    few = ("compare", "scan.npz", "--filters", *names)
    told = clvol_command(*few, "--expected", "e.json", "--left-out", "l.csv", "--turned", "t.md", "--json").json
    assert (told["expected"], told["left_out"], told["turned"]) == ("e.json", "l.csv", "t.md")
    assert told["expected_errors"] == clvol.analysis.predict(volume, names).records()
    assert told["left_out_errors"] == clvol.analysis.leave_out(volume, names).records()
    assert told["turned_errors"] == clvol.analysis.rotations(volume, names).records()
    assert json.loads(Path("e.json").read_text(encoding="utf-8")) == told["expected_errors"]
    assert Path("l.csv").read_text(encoding="utf-8").startswith("filter,x,y,z\nlinear,")
    assert Path("t.md").read_text(encoding="utf-8").startswith("| filter | RMS error |")
    assert clvol_command(*few, "--turned", "b.csv").out.startswith("filter ")
    clvol_command(*few, "--turned", "none/b.csv").fails(1, "none does not exist")
    clvol_command(*few, "--expected", "b.xls").fails(1, "tables are written as .csv, .json, .md", "'b.xls'")
    assert files() == ["b.csv", "e.json", "l.csv", "scan.npz", "t.md"]


def test_compare_rejects_a_bad_table(clvol_command: Command) -> None:
    clvol_command("compare", SPHERE).fails(
        1, "give --output, a picture, or a table of errors (--table, --expected, --left-out, --t"
    )
    clvol_command("compare", SPHERE, "--table", "a.xls").fails(1, "tables are written as .csv, .json, .md", "'a.xls'")
    clvol_command("compare", SPHERE, "--table", "none/a.csv").fails(1, "none does not exist")
    clvol_command("compare", SPHERE, "--table", "a.csv", "--filters", "bogus").fails(1, "'bogus'")
    sinc = ("--filters", "exact-sinc", "--boundary", "zero")
    clvol_command("compare", SPHERE, "--table", "a.csv", *sinc).fails(1, "boundary must be mirror, reflect or wrap")
    assert files() == []


def test_figure6_prints_its_errors(clvol_command: Command) -> None:
    done = clvol_command("figure6", "--samples", "12", "--pixels", "16")
    assert done.code == 0
    *lines, output = done.out.splitlines()
    assert output == "output: figure6.png"
    assert len(lines) == 7
    assert lines[-2].startswith("f)  B-spline interpolation: RMS error 0.")
    assert lines[-2].endswith("°")
    assert files() == ["figure6.png"]
    told = clvol_command("figure6", "--samples", "12", "--pixels", "16", "-o", "b.png", "--json").json
    assert told["output"] == "b.png"
    assert [p["filter"] for p in told["panels"]] == [*clvol.figures.FIGURE_6, "sinc", "exact"]
    assert all(p["rms"] > 0 and p["angle"] > 0 for p in told["panels"][:-1])
    assert told["panels"][-1] == {"filter": "exact", "rms": None, "angle": None, "residual": None}
    assert told["panels"][0]["residual"] > 0
    for option in (("--pixels", "0"), ("--samples", "1")):
        clvol_command("figure6", *option).fails(1, option[1])


def test_figure_6_is_the_same_by_either_name(clvol_command: Command) -> None:
    small = ("--samples", "8", "--pixels", "12", "--json")
    one, other = clvol_command("figure6", *small), clvol_command("figure", "6", *small, "-o", "b.png")
    assert one.json["panels"] == other.json["panels"]
    np.testing.assert_array_equal(iio.imread("figure6.png"), iio.imread("b.png"))


def test_figure_draws_prints_and_names_its_file(clvol_command: Command) -> None:
    done = clvol_command("figure", "2")
    assert (done.code, done.err) == (0, "")
    assert done.out.splitlines()[-1] == "output: figure2.png"
    assert "B-spline interpolation: error up to 0.014 below π/2" in done.out
    told = clvol_command("figure", "impulse", "-o", "a.svg", "--filters", "linear", "mitchell", "--json").json
    assert [p["filter"] for p in told["panels"]] == ["linear", "mitchell"]
    clvol.write(clvol.phantoms.sphere(9), "scan.npz")
    told = clvol_command("figure", "4", "-o", "a.pdf", "--filters", "linear", "--samples", "9", "--scan", "scan.npz", "--json").json
    assert told["panels"][-1]["input"] == "scan, low-passed"
    assert files() == ["a.pdf", "a.svg", "figure2.png", "scan.npz"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("7",), ("figure must be one of 1, 2, 3", "'7'")),
        (("2", "--pixels", "9"), ("figure 2 takes --filters; got --pixels",)),
        (("6", "--scan", "a.npz"), ("figure 6 takes --samples, --pixels, --filters, --device; got --scan",)),
        (("2", "-o", "a.gif"), ("figures are written as", ".svg")),
        (("6", "-o", "a.gif"), ("pictures are written as", ".png")),
        (("2", "-o", "none/a.png"), ("does not exist",)),
        (("2", "--filters", "bogus"), ("'bogus'",)),
        (("3", "--scan", "missing.npz"), ("missing.npz",)),
        (("5", "--samples", "2"), ("samples",)),
    ],
    ids=" ".join,
)
def test_figure_reports_errors(clvol_command: Command, arguments: tuple[str, ...], words: tuple[str, ...]) -> None:
    clvol_command("figure", *arguments).fails(1, *words)
    assert files() == []


def test_without_matplotlib_figures_and_reports_name_the_extra() -> None:
    code = "import sys; sys.modules['matplotlib'] = None"
    for arguments in (("figure", "2"), ("report", SPHERE, "-o", "report")):
        done = subprocess_of(*arguments, code=code)
        assert (done.returncode, done.stdout) == (1, "")
        assert done.stderr == 'clvol: figures need matplotlib, which is not installed: pip install "clvol[figures]"\n'
    done = subprocess_of("figure", "6", "--samples", "6", "--pixels", "8", "--filters", "linear", code=code)
    assert done.returncode == 0, done.stderr
    assert files() == ["figure6.png"]


# -- report ---------------------------------------------------------------------------------------------------


def test_report_writes_a_page_and_prints_its_advice(clvol_command: Command) -> None:
    small = ("--filters", "linear", "bspline3", "--pixels", "16")
    done = clvol_command("report", "phantom:box:12", "-o", "out", *small, "--mode", "mip", "--azimuth", "10")
    assert (done.code, done.err) == (0, "")
    output, chosen, said = done.out.splitlines()
    assert output == f"output: {Path('out', 'index.html')}"
    assert chosen.removeprefix("filter: ") in ("linear", "bspline3")
    assert said.startswith("advice: For these data use ")
    page = Path("out/index.html").read_text(encoding="utf-8")
    assert "Which filter for phantom:box:12?" in page
    assert "Mode mip" in page
    clvol.write(clvol.phantoms.sphere(8), "scan.npz")
    told = clvol_command("report", Path.cwd() / "scan.npz", "-o", "a.html", *small, "--json").json
    assert told["output"] == "a.html"
    assert [row["filter"] for row in told["errors"]] == ["linear", "bspline3", "exact-sinc"]
    assert all(row["rms"] > 0 for row in told["errors"])
    assert " samples of the volume low-passed by a Gaussian of standard deviation 1 sample, drawn from every sec" in told["against"]
    assert [row["filter"] for row in told["expected"]] == [row["filter"] for row in told["errors"]]
    assert {row["filter"] for row in told["left_out"]} < {row["filter"] for row in told["errors"]}
    assert "Which filter for scan.npz?" in Path("a.html").read_text(encoding="utf-8")  # not where it lay
    assert files() == ["a.html", "out", "scan.npz"]


def test_report_reports_errors(clvol_command: Command) -> None:
    clvol_command("report", SPHERE, "-o", "none/out").fails(1, "none does not exist")
    if Path("/proc/self").is_dir():
        clvol_command("report", "missing.npz", "-o", "/proc/report").fails(1, "cannot write /proc/report")  # before it is read
    clvol_command("report", SPHERE, "-o", "out", "--filters", "bogus").fails(1, "'bogus'")
    clvol_command("report", SPHERE, "-o", "out", "--pixels", "2").fails(1, "pixels")
    clvol_command("report", "missing.npz", "-o", "out").fails(1, "missing.npz")
    data = np.zeros((6, 6, 6))
    data[0, 0, 0] = np.nan
    np.save("nan.npy", data)
    clvol_command("report", "nan.npy", "-o", "out").fails(1, "finite")
    assert files() == ["nan.npy"]


# -- resample -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (("--magnify", "2"), lambda v: clvol.magnify(v, 2)),
        (("--to-shape", "5", "6", "7"), lambda v: clvol.resample(v, shape=(5, 6, 7))),
        (("--to-spacing", "0.5", "0.4", "0.3"), lambda v: clvol.resample(v, spacing=(0.5, 0.4, 0.3))),
        (("--like", "like.npz", "--fill", "9"), lambda v: clvol.resample(v, like=clvol.read("like.npz"), fill=9)),
        (("--like", "phantom:box:6"), lambda v: clvol.resample(v, like=clvol.phantoms.box(6))),
        (("--magnify", "2", "--filter", "linear", "--boundary", "wrap"), lambda v: clvol.magnify(v, 2, "linear", "wrap")),
        (("--magnify", "2", "--boundary", "constant(5)"), lambda v: clvol.magnify(v, 2, boundary="constant(5)")),
    ],
    ids=lambda x: " ".join(x) if isinstance(x, tuple) else None,
)
def test_resample_writes_the_result_of_the_function(
    clvol_command: Command, options: tuple[str, ...], expected: Callable[[clvol.Volume], clvol.Volume]
) -> None:
    clvol.write(clvol.Volume(np.zeros((3, 4, 5)), (0.3, 0.2, 0.1), (-1, -2, 0.5)), "like.npz")
    done = clvol_command("resample", SPHERE, "-o", "a.npz", *options, "--json").json
    result, wanted = clvol.read("a.npz"), expected(clvol.phantoms.sphere(8))
    np.testing.assert_array_equal(result.data, wanted.data)
    assert result.data.dtype == np.float32
    assert (result.spacing, result.origin) == (wanted.spacing, wanted.origin)
    assert done == {"output": "a.npz", "shape": list(wanted.shape), "spacing": list(wanted.spacing)}


def test_resample_omits_results_that_missing_samples_touch(clvol_command: Command) -> None:
    data = np.ones((8, 9, 10), np.float32)
    data[3, 3, 3] = np.nan
    clvol.write(clvol.Volume(data), "gap.npz")
    clvol_command("resample", "gap.npz", "-o", "a.npz", "--magnify", "2").fails(1, "samples must be finite")
    assert clvol_command("resample", "gap.npz", "-o", "a.npz", "--magnify", "2", "--nan", "local").code == 0
    assert np.isnan(clvol.read("a.npz").data).sum() == 7**3  # a cubic reaches less than two samples on each side


def test_labels_have_a_table_and_are_chosen_by_their_names(clvol_command: Command) -> None:
    data = np.array([[[0, 1, 2, 7]]], np.uint8).repeat(3, 1)
    clvol.write(clvol.Volume(data, labels={7: "spleen"}), "labels.npz")
    Path("table.txt").write_text("1 liver 255 0 0 0\n2 skin 0 0 255 51\n", encoding="utf-8")
    words = ("labels.npz", "--labels", "table.txt", "-o", "some.npz", "--only-labels")
    assert clvol_command("convert", *words, "skin", "7", "1", "--without-labels", "liver").code == 0
    some = clvol.read("some.npz")
    assert some.data[0, 0].tolist() == [0, 0, 2, 7]
    assert some.labels == clvol.labels.LabelTable({1: ("liver", "red", 1), 2: ("skin", "blue", 0.8), 7: "spleen"})
    clvol_command("convert", *words, "skim").fails(1, "did you mean skin?")
    clvol_command("info", "labels.npz", "--labels", "labels.npz").fails(1, "labels.npz must be a table of labels")
    assert "\nlabels: 1 liver, 2 skin, 7 spleen\n" in clvol_command("info", "some.npz").out
    assert (
        Input(labels=Path("t.txt"), only_labels=("skin", "7")).python("a.nrrd")
        == "clvol.labels.only(clvol.read('a.nrrd', labels='t.txt'), ['skin', 7])"
    )


def test_resample_keeps_labels_with_smooth_boundaries(clvol_command: Command) -> None:
    samples = np.repeat(np.array([[[0, 300]]], np.int16), [7, 1], 2).repeat(6, 0).repeat(5, 1)  # mirrored it is lost
    labels = clvol.Volume(samples, labels=True)
    clvol.write(labels, "labels.npz")
    options = ("labels.npz", "-o", "a.npz", "--smooth")
    assert clvol_command("resample", *options, "--to-shape", "7", "8", "9").code == 0
    np.testing.assert_array_equal(clvol.read("a.npz").data, clvol.resample(labels, (7, 8, 9), smooth=True).data)
    clvol_command("resample", *options, "--magnify", "2").fails(1, "--smooth", "got --magnify")


def test_resample_takes_exactly_one_grid(clvol_command: Command) -> None:
    clvol_command("resample", SPHERE, "-o", "a.npz").fails(1, "--to-shape, --to-spacing, --like, --magnify", "got none")
    both = ("--magnify", "2", "--to-shape", "3", "3", "3")
    clvol_command("resample", SPHERE, "-o", "a.npz", *both).fails(1, "got --to-shape, --magnify")
    assert files() == []


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (("--magnify", "0"), "factor"),
        (("--to-shape", "0", "1", "1"), "--to-shape must"),
        (("--to-spacing", "0", "1", "1"), "--to-spacing must"),
        (("--to-spacing", "1", "1", "1", "--to-dtype", "bogus"), "--to-dtype must"),
        (("--like", "missing.npz"), "missing.npz"),
        (("--magnify", "2", "--filter", "bogus"), "'bogus'"),
        (("--magnify", "2", "--boundary", "bogus"), "'bogus'"),
    ],
    ids=lambda x: " ".join(x) if isinstance(x, tuple) else None,
)
def test_resample_reports_errors(clvol_command: Command, options: tuple[str, ...], word: str) -> None:
    clvol_command("resample", SPHERE, "-o", "a.npz", *options).fails(1, word)
    assert files() == []


def test_resample_loses_nothing_silently(clvol_command: Command) -> None:
    clvol_command("resample", SPHERE, "-o", "a.npy", "--magnify", "2").fails(1, "spacing", ".npz")
    clvol_command("resample", SPHERE, "-o", "a.raw", "--magnify", "2").fails(1, ".npz", "'a.raw'")
    assert files() == []


# -- what there is --------------------------------------------------------------------------------------------


def test_filters_are_listed(clvol_command: Command) -> None:
    lines = clvol_command("filters").out.splitlines()
    assert lines[0].split()[:3] == ["filter", "support", "degree"]
    assert [line.split()[0] for line in lines[1:]] == [row[0] for row in clvol.filters().rows()]
    assert all(line == line.rstrip() for line in lines)
    rows = {row["filter"]: row for row in clvol_command("filters", "--json").json}
    assert (rows["bspline3"]["poles"], rows["bspline3"]["continuity"]) == ("-0.2679", "C2")
    assert set(rows) >= {"nearest", "linear", "bspline5", "mitchell", "sinc", "hybrid"}


def test_devices_are_listed(clvol_command: Command, device: Device) -> None:
    rows = clvol_command("devices", "--json").json
    assert device.name in [row["name"] for row in rows]
    assert [row["number"] for row in rows] == list(range(len(rows)))
    assert all(row["kind"] in ("cpu", "gpu", "accelerator") and row["memory_mib"] > 0 for row in rows)
    assert device.name in clvol_command("devices").out
    assert clvol_command("render", SPHERE, "-o", "a.png", *SMALL, "--device", rows[0]["number"]).code == 0


def test_doctor_approves_this_machine(clvol_command: Command, device: Device) -> None:
    told = clvol_command("doctor", "--json").json
    assert told["usable"] is True
    assert [c["ok"] for c in told["checks"][:3]] == [True] * 3
    assert device.name in told["checks"][0]["detail"]
    assert device.compiled_for in told["checks"][2]["detail"]
    done = clvol_command("doctor")
    assert done.code == 0
    assert "ok  it computes right values: " in done.out


NO_PLATFORM = """
import pyopencl
def none(): raise pyopencl.LogicError("clGetPlatformIDs failed: PLATFORM_NOT_FOUND_KHR")
pyopencl.get_platforms = none
"""
NO_PYOPENCL = (
    "import sys; sys.modules['pyopencl'] = None"  # its wheel brings a loader that finds PoCL whatever the environment says
)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("code", [NO_PLATFORM, NO_PYOPENCL], ids=["no platform", "no pyopencl"])
def test_without_opencl_doctor_says_what_to_install(code: str) -> None:
    done = subprocess_of("doctor", code=code, OCL_ICD_VENDORS=os.devnull)
    assert (done.returncode, done.stderr) == (1, "")
    assert done.stdout.splitlines()[-1].startswith("--  an OpenCL device: ")  # below the extras, where it is seen
    assert 'pip install "clvol[pocl]"' in done.stdout
    assert "driver" in done.stdout
    assert "it builds kernels" not in done.stdout
    told = subprocess_of("doctor", "--json", code=code)
    assert told.returncode == 1
    assert json.loads(told.stdout)["usable"] is False
    failed = subprocess_of("render", SPHERE, "-o", "a.png", code=code)
    Result(failed.returncode, failed.stdout, failed.stderr).fails(1, 'pip install "clvol[pocl]"')
    # one process for the other commands, each of which ends it
    each = """
import sys
from clvol import cli
for line in ("devices", "devices --json", "filters", "info phantom:sphere:8"):
    try:
        cli.main(line.split())
    except SystemExit as end:
        print("ended", line, end.code, file=sys.stderr)
sys.exit()"""
    done = subprocess_of(code=code + each)
    ends = [line for line in done.stderr.splitlines() if line.startswith("ended ")]
    assert ends == ["ended devices 1", "ended devices --json 1", "ended filters 0", "ended info phantom:sphere:8 0"]
    assert done.stderr.count('pip install "clvol[pocl]"') == 2
    assert files() == []


def test_doctor_detects_a_device_with_wrong_results(clvol_command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clvol, "sample", lambda _, points: np.zeros(len(points)))
    done = clvol_command("doctor")
    assert done.code == 1
    assert "--  it computes right values: this device computes wrong values: off by" in done.out
    monkeypatch.setattr(clvol, "sample", lambda *_: 1 / 0)  # errors are reported, not raised
    assert "--  it computes right values: division by zero" in clvol_command("doctor").out


def test_doctor_lists_extras(clvol_command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    def version(name: str) -> str:
        raise PackageNotFoundError(name)

    monkeypatch.setattr("clvol.cli._doctor.version", version)
    done = clvol_command("doctor")
    assert done.code == 0  # they are optional
    assert 'pip install "clvol[medical]"' in done.out
    assert 'pip install "clvol[microscopy]"' in done.out
    assert 'pip install "clvol[figures]"' in done.out
    lines = [line for line in done.out.splitlines() if "(optional)" in line]
    assert [line for line in lines if "(optional): for " not in line] == []  # each says what for


def test_presets_are_listed(clvol_command: Command) -> None:
    assert [row["preset"] for row in clvol_command("presets", "--json").json] == list(clvol.presets())
    assert "ct-bone " in clvol_command("presets").out


# -- the words of the shell -----------------------------------------------------------------------------------


def test_the_look_options_reach_render(clvol_command: Command) -> None:
    volume, options = clvol.phantoms.sphere(8), (*SMALL, "--filter", "bspline3")

    def drawn(*look: str, **arguments: Any) -> None:
        assert clvol_command("render", SPHERE, "-o", "a.png", *options, *look).code == 0
        picture = clvol.render(volume, filter="bspline3", size=(16, 12), **arguments)
        np.testing.assert_array_equal(iio.imread("a.png"), clvol.show.picture.to_bytes(picture)[..., :3])

    drawn("--window", "0", "1.5", transfer=look(volume, "composite", window=(0, 1.5)))
    drawn("--preset", "mr-default", "--opacity", "0.5", transfer=look(volume, "composite", preset="mr-default", opacity=0.5))
    drawn("--opacity", "-1", "0", "1", "1", transfer=look(volume, "composite", opacity=((-1, 0), (1, 1))))
    drawn("--mode", "isosurface", "--threshold", "0.25", mode="isosurface", isovalue=0.25)
    drawn("--clip", "-1", "-1", "-1", "0", "1", "1", clip=((-1, -1, -1), (0, 1, 1)))
    half, other, octant = (
        clvol.Plane((0, -1, 0), (0, -0.2, 0)),
        clvol.Plane((1, 0, 0.5), (0, 0, 0)),
        clvol.Corner((0, 0, 0), [np.inf] * 3),
    )
    first = ("--clip-plane", "0", "-1", "0", "0", "-0.2", "0")
    more = ("--clip-plane", "1", "0", "0.5", "0", "0", "0", "--clip-corner", "0", "0", "0", "inf", "inf", "inf")
    drawn(*first, *more, clip=[half, other, octant])
    for word, cap in (("values", True), ("none", False), ("red", "red")):
        drawn(*first, "--mode", "isosurface", "--cap", word, clip=half, mode="isosurface", cap=cap)
    drawn("--fit", "volume", camera=clvol.Camera.orbit(fit="volume"))
    clvol_command("render", SPHERE, "-o", "b.png", "--preset", "bogus").fails(1, "--preset must be one of ct-bone", "'bogus'")


def test_errors_and_notes_name_the_shells_options(clvol_command: Command) -> None:
    np.save("gap.npy", np.array([[[1, np.nan, 3]]]))
    clvol_command("resample", "gap.npy", "-o", "a.npz", "--to-shape", "1", "1", "3").fails(
        1, "clvol: samples must be finite", "with --fill-nan VALUE"
    )
    np.zeros(24, np.uint8).tofile("a.raw")
    clvol_command("info", "a.raw").fails(1, "give --shape NZ NY NX and --dtype\n")
    for option, value, words in (
        ("--step", "0", "clvol: --step must be a finite number"),
        ("--window", "1 0", "clvol: --window must be two finite numbers"),
        ("--isovalue", "1", "clvol: --isovalue is no option of composite, but of isosurface"),
        ("--filter", "cubik", "clvol: --filter must be one of nearest (box, bspline0)"),
        ("--pixel-filter", "bspline3", "clvol: --pixel-filter must"),
    ):
        clvol_command("render", SPHERE, "-o", "a.png", option, *value.split()).fails(1, words)
    clvol_command("resample", SPHERE, "-o", "a.npz", "--to-shape", "0", "1", "1").fails(1, "shape")
    done = clvol_command("render", SPHERE, "-o", "a.png", *SMALL, "--preset", "ct-bone")
    assert done.code == 0
    assert done.err.startswith("clvol: note: preset 'ct-bone' is in Hounsfield units")
    assert done.err.endswith("--window CENTER WIDTH sets the range\n")


@pytest.mark.one_in(3)
@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_scripts_are_valid(clvol_command: Command, shell: str) -> None:
    script = clvol_command("completion", shell).out
    for word in ("render", "resample", "--channel", "--threshold", "eight-fetch"):
        assert word in script
    assert "figure6" not in script
    if shutil.which(shell) is not None:
        subprocess.run(
            [shell, "-n", "-c" if shell == "fish" else "-s", *([script] if shell == "fish" else [])],
            input=script,
            check=True,
            encoding="utf-8",
            timeout=60,
        )


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")
def test_the_tab_key_completes_commands_and_options(clvol_command: Command) -> None:
    script = clvol_command("completion", "bash").out
    asked = (
        ("re",),
        ("figure", "6", "--sc"),
        ("render", "a.nii", "--thr"),
        ("resample", "a.nii", "--anchor", "o"),
        ("render", "sca"),
    )
    Path("scan.nii").touch()
    for words in asked:
        line = " ".join(words)
        script += f'\nCOMP_WORDS=(clvol {line}); COMP_CWORD={len(words)}; COMPREPLY=(); _clvol; echo "${{COMPREPLY[@]}}"'
    done = subprocess.run(["bash", "--norc", "-s"], input=script, capture_output=True, encoding="utf-8", timeout=60, check=True)
    found = [sorted(line.split()) for line in done.stdout.splitlines()]
    assert found == [["render", "report", "resample"], ["--scan"], ["--threshold"], ["origin"], ["scan.nii"]]


@pytest.mark.parametrize(
    ("words", "some"),
    [
        (("render", "a.nii", "--mode"), {"mip", "composite"}),
        (("render", "a.nii", "--filter"), {"bspline3(auto)", "cubic", "lanczos3"}),
        (("compare", "a.nii", "--filters", "linear"), {"mitchell"}),
        (("report", "a.nii", "--preset"), {"ct-bone"}),
        (("render", "a.nii", "--cmap"), {"viridis"}),
        (("resample", "a.nii", "--boundary"), {"wrap"}),
        (("figure",), {"6", "cost"}),
    ],
    ids=lambda x: " ".join(x) if isinstance(x, tuple) else "",
)
def test_the_tab_key_completes_names(clvol_command: Command, words: tuple[str, ...], some: set[str]) -> None:
    lines = clvol_command("__complete", *words, "").out.splitlines()
    assert some <= {line.partition("\t")[0] for line in lines}


# -- manners --------------------------------------------------------------------------------------------------


COMMANDS = (
    "render",
    "slice",
    "orthogonal",
    "export",
    "movie",
    "compare",
    "figure",
    "report",
    "info",
    "resample",
    "convert",
    "mesh",
    "pyramid",
    "filters",
    "presets",
    "devices",
    "doctor",
)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help(clvol_command: Command, command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    done = clvol_command(command, "--help")
    assert (done.code, done.err) == (0, "")
    assert f"Usage: clvol {command}" in done.out
    assert "--json" in done.out
    assert "--no-json" not in done.out
    assert "--empty" not in done.out
    lines = [line.strip("│ *") for line in done.out.splitlines() if line.startswith("│")]
    described = [line.split("  ") for line in lines if line.startswith("-")]
    assert described
    for row in described:
        assert [cell for cell in row[1:] if cell.strip() and not cell.strip().startswith("[")], row  # each option has words
    assert command in clvol_command("--help").out


def test_the_version_is_printed(clvol_command: Command) -> None:
    assert clvol_command("--version").out.strip() == clvol.__version__


def test_help_states_the_defaults_of_each_command(clvol_command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(app, "console", Console(width=200))  # the first help of a process keeps its console
    assert "[default: composite]" in clvol_command("render", "--help").out
    assert "[default: isosurface]" in clvol_command("compare", "--help").out
    assert "[default: the six of Figure 6]" in clvol_command("compare", "--help").out


@pytest.mark.parametrize("width", [30, 40, 80, 200])
def test_tables_fit_narrow_terminals(clvol_command: Command, monkeypatch: pytest.MonkeyPatch, width: int) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", str(width))
    out = clvol_command("filters").out
    assert max(map(len, out.splitlines())) <= width
    for row in clvol.filters().rows():
        assert row[0] in out
    assert out.startswith("filter nearest\n  support: 1\n" if width < 80 else "filter  ")
    assert len(out.splitlines()) < 45 or width < 80


def test_exit_codes_and_streams_of_a_process_of_its_own() -> None:
    done = subprocess_of("render", SPHERE, "-o", "a.png", *SMALL, "--json")
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout)["output"] == "a.png"
    for code, arguments in ((1, ("render", "missing.npy", "-o", "b.png")), (2, ("bogus",))):
        failed = subprocess_of(*arguments)
        Result(failed.returncode, failed.stdout, failed.stderr).fails(code)
    assert files() == ["a.png"]


def test_a_terminal_without_a_degree_sign_gets_the_numbers() -> None:
    done = subprocess_of("figure6", "--samples", "6", "--pixels", "8", PYTHONIOENCODING="ascii")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines()[0].endswith("?")


# buffered output, as users have it, whatever the test machine's settings
BUFFERED = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}


def test_a_closed_pipe_is_not_an_error() -> None:
    if os.name != "posix":
        pytest.skip("pipes as POSIX has them")
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(
        [sys.executable, "-m", "clvol", "filters"],
        stdout=write,
        env=BUFFERED,
        stderr=subprocess.PIPE,
        encoding="utf-8",
        timeout=60,
        check=False,
    )
    os.close(write)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_a_full_disk_is_one_line() -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "clvol", "filters"],
            stdout=full,
            env=BUFFERED,
            stderr=subprocess.PIPE,
            encoding="utf-8",
            timeout=60,
            check=False,
        )
    assert done.returncode == 1
    assert done.stderr.startswith("clvol: ")
    assert "Traceback" not in done.stderr


def test_a_progress_bar_appears_only_on_a_terminal(clvol_command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    assert clvol_command("render", SPHERE, "-o", "a.png", *SMALL).err == ""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    told: list[float] = []

    class Bar:
        def __init__(self, **_: object) -> None: ...
        def __enter__(self) -> Self:
            return self

        def __exit__(self, *_: object) -> None: ...
        def add_task(self, what: str, total: float) -> int:
            assert (what, total) == ("rendering", 1.0)
            return 7

        def update(self, task: int, completed: float) -> None:
            assert task == 7
            told.append(completed)

    monkeypatch.setattr("rich.progress.Progress", Bar)
    assert clvol_command("render", SPHERE, "-o", "a.png", *SMALL).code == 0
    assert told[-1] == pytest.approx(1)
    told.clear()
    assert clvol_command("render", SPHERE, "-o", "a.png", *SMALL, "--json").json["output"] == "a.png"
    assert told == []


@pytest.mark.skipif(os.name != "posix", reason="signals as POSIX has them")
def test_an_interrupt_ends_a_long_render_soon_and_leaves_nothing() -> None:
    # reports when the first tile is done; an earlier interrupt would test something else
    code = """
from clvol.march.renderer import Renderer
render = Renderer.render
def told(self, *args, progress, **options):
    return render(self, *args, progress=lambda done: print("tile", flush=True), **options)
Renderer.render = told
from clvol.cli import main
main(["render", "phantom:sphere:64", "-o", "a.png", "--size", "4000", "4000", "--rays", "4096", "--filter", "bspline5"])
"""
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, encoding="utf-8")
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "tile\n"
        started = time.perf_counter()
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=20)
        waited = time.perf_counter() - started
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        process.wait()
    assert process.returncode == 130
    assert err == "clvol: interrupted\n"
    assert waited < 3  # about a second on an idle machine
    assert files() == []


@pytest.mark.parametrize("name", ["²", "①", "½", "9" * 5000, "-1"])
def test_digits_that_are_not_a_number_are_not_a_device(clvol_command: Command, name: str) -> None:
    clvol_command("render", SPHERE, "-o", "a.png", *SMALL, f"--device={name}").fails(1, "device must be one of")


def test_numbers_of_thousands_of_digits_are_rejected(clvol_command: Command) -> None:
    np.save("a.npy", np.zeros((2, 3, 4, 5), np.float32))
    clvol_command("info", "a.npy", "--channel", "9" * 5000).fails(1, "channel")
    clvol_command("render", f"phantom:sphere:{'9' * 5000}", "-o", "a.png").fails(1, "size of a phantom")


def test_colours_without_numbers_are_rejected(clvol_command: Command) -> None:
    clvol_command("render", SPHERE, "-o", "a.png", "--mode", "isosurface", "--color", "1.2.3 4 5").fails(1, "color")


def test_words_of_other_programs_stand_for_options_that_exist() -> None:
    ours = {re.split(r"\W", name)[0] for name in checks._WORDS}
    commands = [name for name in app if not name.startswith("-")]
    flags = {
        flag.lstrip("-").replace("-", "_")
        for name in commands
        for one in app[name].assemble_argument_collection()
        for flag in one.names
    }
    assert ours <= flags | set(commands)
    assert checks.meant_by("iso", ["isovalue", "step"]) == "isovalue"
    assert checks.meant_by("iso", ["step"]) == ""


def test_one_corrupt_chunk_leaves_the_others(clvol_command: Command) -> None:
    """`info` and `render` of a small store stopped at it, with --clip and --fill-nan too; truth: the samples that were stored."""
    z, y, x = np.ogrid[:96, :96, :96]
    data = (1000 * np.exp(-((z - 48) ** 2 + (y - 48) ** 2 + (x - 48) ** 2) / 800)).astype(np.uint16)
    zarr.create_array("v.zarr", data=data, chunks=(32, 32, 32))
    Path("v.zarr/c/0/0/1").write_bytes(b"damaged")
    about = clvol_command("info", "v.zarr", "--json").json
    assert about["value_range"] == [0, int(data.max())]
    assert len(about["damaged"]) == 1
    assert "c/0/0/1" in about["damaged"][0]
    assert "damaged: " in clvol_command("info", "v.zarr").out
    seen = ("render", "v.zarr", *SMALL, "--mode", "mip", "-o", "v.png")
    clipped = clvol_command(*seen, "--clip", "70", "70", "70", "95", "95", "95")
    assert clipped.code == 0, clipped.err
    assert clipped.err.count("c/0/0/1") == 1
    assert iio.imread("v.png").max() > 0
    filled = clvol_command(*seen, "--fill-nan", "0")
    assert filled.code == 0, filled.err
    assert filled.err.count("c/0/0/1") == 1
    assert clvol_command("convert", "v.zarr", "-o", "v.npz", "--fill-nan", "0").code == 0
    expected = data.copy()
    expected[:32, :32, 32:64] = 0
    assert np.array_equal(clvol.read("v.npz").data, expected)
    assert clvol_command("convert", "v.zarr", "-o", "smooth.npz", "--fill-nan", "smoothly").code == 0
    smooth = clvol.read("smooth.npz").data
    assert np.array_equal(smooth[32:], data[32:])
    assert np.abs(smooth - data).max() < 0.2 * data.max()  # and not 1000, the brightest that was damaged


def test_volumes_of_other_files_are_in_the_picture_and_color_it(clvol_command: Command) -> None:
    """The picture that Python draws of the same scene, which is drawn again from what the file says."""
    for name, size in (("a", 14), ("b", 10)):
        clvol.write(clvol.phantoms.sphere(size), f"{name},1.nrrd")
    draw = ("render", "a,1.nrrd", "--output", "p.png", *SMALL)
    clvol_command(*draw, "--with", "b,1.nrrd,preset=ct-bone,opacity=0.5,filter=linear", "--opacity", "0.1")
    shown = iio.imread("p.png")
    first, other = clvol.read("a,1.nrrd"), clvol.Medium(clvol.read("b,1.nrrd"), preset="ct-bone", opacity=0.5, filter="linear")
    media = clvol.Medium(first, opacity=0.1), other
    clvol.render(clvol.Scene(media), size=(16, 12)).save("q.png")
    np.testing.assert_array_equal(iio.imread("q.png"), shown)
    surface = ("--mode", "isosurface", "--colors", "b,1.nrrd,cmap=hot", "--color-bar")
    assert clvol_command(*draw, *surface).code == 0
    assert clvol_command("render", "--from", "p.png", "--output", "q.png").code == 0
    np.testing.assert_array_equal(iio.imread("q.png"), iio.imread("p.png"))
    tifffile.imwrite("c.ome.tif", np.stack([first.data, first.data[::-1]]).astype(np.float32), metadata={"axes": "CZYX"}, ome=True)
    channels = ("render", "c.ome.tif", "--output", "p.png", *SMALL, "--mode", "mip")
    assert clvol_command(*channels, "--all-channels").code == 0
    assert clvol_command("view", "c.ome.tif", "--all-channels", "--terminal").code == 0
    clvol.render(clvol.read_all("c.ome.tif"), mode="mip", size=(16, 12)).save("q.png")
    np.testing.assert_array_equal(iio.imread("q.png"), iio.imread("p.png"))
    assert clvol_command("render", "--from", "p.png", "--output", "q.png").code == 0
    np.testing.assert_array_equal(iio.imread("q.png"), iio.imread("p.png"))
    clvol_command(*channels, "--all-channels", "--cmap", "hot").fails(1, "--all-channels have colours of their own")
    clvol_command(*channels, "--all-channels", "--by-bricks").fails(1, "--all-channels are read whole")
    clvol_command(*draw, "--with", "b,1.nrrd,presets=ct-bone").fails(1, "presets is no option of b,1.nrrd", "preset")
    assert clvol_command(*draw, "--with", SPHERE, "--window", "0.5", "0.1", "--json").json["window"] == pytest.approx([0.5, 0.1])
    clvol_command(*draw, "--with", "b,1.nrrd,window=3").fails(1, "window of b,1.nrrd must be number/number; got '3'")
    clvol_command(*draw, "--with", "b,1.nrrd,opacity=x").fails(1, "b,1.nrrd: Invalid value for --opacity")
    clvol_command(*draw, "--mix", "over", "--mode", "mip").fails(1, "--mix is for several media", "got 'over' and one medium")
    clvol_command(*draw, "--mode", "mip", "--colors", "b,1.nrrd").fails(1, "color_by of a medium changes nothing in mip")


def test_cuts_surfaces_and_masks_of_other_volumes(clvol_command: Command) -> None:
    """As `clvol.Medium` has them, in the words of the shell; and every command draws the same scene."""
    ball = clvol.phantoms.sphere(14)
    labels = np.random.default_rng(3).integers(0, 4, (3, 3, 3)).astype(np.uint8)[np.ix_(*3 * [np.arange(14) // 5])]
    named = replace(ball, data=labels)
    clvol.write(ball, "a.nrrd")
    clvol.write(named, "labels.nrrd")
    clvol.write(named, "organs.nrrd")
    words = "a.nrrd,mask=labels.nrrd,where=2,clip-plane=0/0/1/0/0/0.4,clip-plane=0/-1/0/0/-0.5/0,surfaces=0.5:tan:0.4,0.2:red:0.1"
    others = ("a.nrrd", "--with", words, "--with", "organs.nrrd,smooth=true,opacity=0.3", "--opacity", "0.1")
    cuts = [clvol.Plane((0, 0, 1), (0, 0, 0.4)), clvol.Plane((0, -1, 0), (0, -0.5, 0))]
    part = clvol.Medium(ball, mask=labels, where=2, clip=cuts, surfaces=[(0.5, "tan", 0.4), (0.2, "red", 0.1)])
    smooth = clvol.Medium(named, smooth=True, opacity=0.3)
    want = clvol.render(clvol.Scene([clvol.Medium(ball, opacity=0.1), part, smooth]), size=(16, 12))
    want.save("want.png")
    shown = iio.imread("want.png")[..., :3]
    assert clvol_command("render", *others, *SMALL, "-o", "p.png").code == 0
    assert clvol_command("batch", *others, *SMALL, "-o", "{name}.png").code == 0
    assert clvol_command("movie", *others, *SMALL, "--frames", "2", "-o", "film").code == 0
    assert clvol_command("render", "--from", "p.png", "-o", "again.png").code == 0
    for name in ("p.png", "a.png", "film/0000.png", "again.png"):
        np.testing.assert_array_equal(iio.imread(name)[..., :3], shown, err_msg=name)
    assert clvol_command("orthogonal", *others, "--size", "36", "28", "-o", "p.png").code == 0
    np.testing.assert_array_equal(iio.imread("p.png")[:12, 20:, :3], shown)
    clvol.write(replace(ball, data=labels[..., ::-1]), "labels.nrrd")
    clvol_command("render", "--from", "again.png", "-o", "q.png").fails(1, "a.nrrd or its mask labels.nrrd has changed")
    over = ("a.nrrd", "--with", "a.nrrd,cmap=hot,opacity=0/0/0.5/1,boundary=reflect", "--mode", "mip", "--mix", "over")
    assert clvol_command("render", *over, *SMALL, "-o", "p.png").code == 0
    hot = clvol.Medium(ball, cmap="hot", opacity=[(0, 0), (0.5, 1)], boundary="reflect")
    clvol.render(clvol.Scene([ball, hot], mix="over"), mode="mip", size=(16, 12)).save("want.png")
    np.testing.assert_array_equal(iio.imread("p.png"), iio.imread("want.png"))
    assert clvol_command("view", *others, "--terminal").code == 0
