"""Batches of pictures: output names, isolated failures, and the same pictures on a cluster."""

from __future__ import annotations

import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import imageio.v3 as iio
import numpy as np
import pytest

import clvol
from clvol.base.errors import FormatError, OptionError
from clvol.device import Device
from clvol.interfaces import batches
from clvol.volume.volumes import Leading


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("batch")
    paths = [folder / name for name in ("a.nrrd", "b.nii.gz", "damaged.nrrd")]
    for i, path in enumerate(paths[:2]):
        clvol.write(clvol.phantoms.marschner_lobb(20 + 4 * i), path)
    paths[2].write_bytes(paths[0].read_bytes()[:300])
    return paths


def test_pictures_match_render_and_failures_are_isolated(files: list[Path], tmp_path: Path) -> None:
    told: list[float] = []
    cameras = clvol.Camera.turntable(3, 30, azimuth=10)
    drawn = clvol.batch(
        files, cameras, tmp_path / "{name}" / "{frame:03}.png", mode="mip", size=(40, 30), filter="linear", progress=told.append
    )
    assert len(drawn) == 9
    assert told[-1] == 1
    assert len(told) == 9
    assert [one.path.relative_to(tmp_path).as_posix() for one in drawn[:4]] == ["a/000.png", "a/001.png", "a/002.png", "b/000.png"]
    assert all(isinstance(one.error, FormatError) and not one.path.exists() for one in drawn[6:])
    assert not any(one.error for one in drawn[:6])
    for one in drawn[:6]:
        wanted = clvol.render(clvol.read(one.source), cameras[one.frame], "mip", filter="linear", size=(40, 30))
        clvol.save(wanted, tmp_path / "wanted.png")
        np.testing.assert_array_equal(iio.imread(one.path), iio.imread(tmp_path / "wanted.png"))


def test_ambiguous_names_are_rejected(files: list[Path], tmp_path: Path) -> None:
    for output in ("{name}.png", "all.png"):
        with pytest.raises(OptionError, match="output must give each picture a different name"):
            clvol.batch(files[:2], clvol.Camera.turntable(2), tmp_path / output, size=(8, 8))
    for output in ("{nam}.png", "{0}.png", "{name", "{name.x}.png"):
        with pytest.raises(OptionError, match="output must be a pattern with"):
            clvol.batch(files[0], None, tmp_path / output, size=(8, 8))
    assert not list(tmp_path.iterdir())


def test_options_may_depend_on_the_volume(files: list[Path], tmp_path: Path) -> None:
    def look(volume: clvol.Volume) -> dict[str, float]:
        return {"isovalue": float(np.median(volume.data))}

    (one,) = clvol.batch(files[0], None, tmp_path / "{name}.png", look=look, mode="isosurface", size=(32, 32))
    volume = clvol.read(files[0])
    clvol.save(clvol.render(volume, mode="isosurface", size=(32, 32), **look(volume)), tmp_path / "wanted.png")
    np.testing.assert_array_equal(iio.imread(one.path), iio.imread(tmp_path / "wanted.png"))


def test_a_cluster_renders_the_same(files: list[Path], tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    options = {"mode": "mip", "size": (40, 30), "filter": "linear"}
    alone = clvol.batch(files, clvol.Camera.turntable(2), tmp_path / "one-{name}-{frame}.png", **options)
    many = clvol.batch(files, clvol.Camera.turntable(2), tmp_path / "many-{name}-{frame}.png", cluster=2, **options)
    assert [type(one.error) for one in many] == [type(one.error) for one in alone]
    for one, other in zip(alone[:4], many[:4], strict=True):
        np.testing.assert_array_equal(iio.imread(one.path), iio.imread(other.path))


def test_the_samples_of_a_volume_are_sent_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not with each picture: a small volume by the scheduler, a large one to all workers, a mapped file by name."""
    distributed = pytest.importorskip("distributed")
    from clvol.dask.cluster import as_cluster

    np.save(tmp_path / "a.npy", clvol.phantoms.marschner_lobb(24).data)
    sources = [clvol.phantoms.marschner_lobb(20), clvol.LazyVolume(clvol.phantoms.marschner_lobb(22).data)]
    sources.append(clvol.LazyVolume(np.load(tmp_path / "a.npy", mmap_mode="r")))
    sources.append(clvol.Scene([sources[0], clvol.Medium(sources[2], cmap="hot")]))
    with as_cluster(1) as cluster:
        submit, sent = cluster.submit, list[int]()

        def counted(function: Any, *arguments: Any, **options: Any) -> Any:
            sent.append(sum(len(pickle.dumps(one)) for one in arguments if not isinstance(one, distributed.Future)))
            return submit(function, *arguments, **options)

        monkeypatch.setattr(cluster, "submit", counted)
        for large in (8 << 20, 1 << 10):
            monkeypatch.setattr("clvol.dask.cluster._LARGE", large)
            drawn = clvol.batch(
                sources, clvol.Camera.turntable(3), tmp_path / "{number}-{frame}.png", cluster=cluster, mode="mip", size=(8, 8)
            )
            assert not [one.error for one in drawn if one.error]
    assert len(sent) == 24
    assert max(sent) < 2000


def test_a_changed_file_is_read_again(files: list[Path], tmp_path: Path) -> None:
    """Workers keep nothing between batches."""
    pytest.importorskip("distributed")
    from clvol.dask.cluster import as_cluster

    path = tmp_path / "one.nrrd"
    with as_cluster(1) as cluster:
        for source in files[:2]:
            clvol.write(clvol.read(source), path)
            (one,) = clvol.batch(path, None, tmp_path / "{name}.png", cluster=cluster, mode="mip", size=(32, 32))
            clvol.save(clvol.render(clvol.read(source), mode="mip", size=(32, 32)), tmp_path / "wanted.png")
            np.testing.assert_array_equal(iio.imread(one.path), iio.imread(tmp_path / "wanted.png"))


def test_volumes_are_read_by_bricks_as_in_render(files: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Multi-resolution or too large volumes, unless an option needs all samples."""
    pytest.importorskip("zarr")
    store = tmp_path / "a.zarr"
    clvol.pyramid(clvol.phantoms.marschner_lobb(48), store, levels=2)
    for how, options, kind in (
        ({}, {}, clvol.LazyVolume),
        ({"level": 0}, {}, clvol.Volume),
        ({}, {"limits": {"evaluator": "paired"}}, clvol.Volume),
        ({}, {"limits": {"fetch": "image"}}, clvol.Volume),
        ({}, {"options": {"outputs": "uncertainty"}}, clvol.Volume),
        (clvol.read, {}, clvol.Volume),
    ):
        asked = batches._Request(how, None, **{"options": {}, "limits": {}, **options})
        assert type(asked.read(str(store))) is kind
    plain = batches._Request({}, None, {}, {})
    assert type(plain.read(str(files[0]))) is clvol.Volume
    monkeypatch.setattr("clvol.base.memory.available", lambda: 1 << 15)
    assert type(plain.read(str(files[0]))) is clvol.LazyVolume
    monkeypatch.undo()
    (one,) = clvol.batch(store, None, tmp_path / "{name}.png", mode="mip", size=(20, 20))
    clvol.save(clvol.render(clvol.open(store), mode="mip", size=(20, 20)), tmp_path / "wanted.png")
    np.testing.assert_array_equal(iio.imread(one.path), iio.imread(tmp_path / "wanted.png"))


def test_a_batch_uses_the_filter_of_its_mode(tmp_path: Path) -> None:
    """As in 'clvol render', also for volumes read by bricks, and for several."""
    ball = clvol.phantoms.marschner_lobb(24)
    both = clvol.Volumes([ball, ball], leading=Leading(("channel",), (2,)))
    for volume in (
        ball,
        clvol.LazyVolume(ball.data, ball.spacing, ball.origin),
        clvol.Scene([ball, ball.crop((0, 0, 0), (24, 24, 12))]),
        both,
    ):
        (one,) = clvol.batch(volume, None, tmp_path / "made.png", size=(20, 20), look=lambda _: {"mode": "mip"})
        clvol.save(clvol.render(volume, mode="mip", size=(20, 20)), tmp_path / "wanted.png")
        np.testing.assert_array_equal(iio.imread(one.path), iio.imread(tmp_path / "wanted.png"))


def test_limits_of_the_rendering_process_apply(tmp_path: Path, device: Device) -> None:
    ball = clvol.phantoms.marschner_lobb(24)
    limits = {"evaluator": "paired", "fetch": "buffer"}
    (one,) = clvol.batch(ball, None, tmp_path / "made.png", size=(20, 20), mode="mip", limits=limits)
    (picture,) = batches.frames([batches.Shot(ball)], size=(20, 20), mode="mip", limits=limits)
    with device.limited(**limits):
        wanted = clvol.render(ball, mode="mip", size=(20, 20), device=device)
    np.testing.assert_array_equal(picture, wanted)
    clvol.save(wanted, tmp_path / "wanted.png")
    np.testing.assert_array_equal(iio.imread(one.path), iio.imread(tmp_path / "wanted.png"))


def asked(path: str) -> clvol.Volume:
    """A file whose reading uses the cluster."""
    import dask.array

    data = clvol.read(path).data
    return clvol.Volume(dask.array.from_array(data, chunks=8).map_blocks(np.flip).map_blocks(np.flip).compute())


def test_reading_may_use_the_cluster(files: list[Path], tmp_path: Path) -> None:
    """Its task secedes meanwhile, and so do those that wait behind it."""
    pytest.importorskip("distributed")
    drawn = clvol.batch(
        files[:2], clvol.Camera.turntable(3), tmp_path / "{name}-{frame}.png", cluster=1, reading=asked, mode="mip", size=(20, 20)
    )
    assert not [one.error for one in drawn if one.error]


def test_invalid_sources_are_rejected(tmp_path: Path) -> None:
    for wrong in (5, [None], np.zeros(3)):
        with pytest.raises(clvol.ClvolError):
            clvol.batch(wrong, None, tmp_path / "{number}.png")


def test_the_command(files: list[Path], tmp_path: Path) -> None:
    """Its exit status, and a message that names the file, report a failure."""
    command = [sys.executable, "-m", "clvol", "batch", *map(str, files), "-o", str(tmp_path / "{name}-{frame}.png"), "--turn", "2"]
    options = ["--mode", "mip", "--size", "40", "40", "--workers", "2"]
    done = subprocess.run([*command, *options], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "damaged.nrrd: " in done.stdout
    assert len(list(tmp_path.glob("*.png"))) == 4


@pytest.mark.parametrize("wrong", [0, -3, 2.5, True, "4", None])
def test_a_turntable_needs_at_least_one_picture(wrong: Any) -> None:
    with pytest.raises(OptionError, match=r"frames must be a whole number, at least 1; got"):
        clvol.Camera.turntable(wrong)
    with pytest.raises(OptionError, match="cameras must be one or more; got none"):
        clvol.batch(np.zeros((3, 3, 3)), [])
