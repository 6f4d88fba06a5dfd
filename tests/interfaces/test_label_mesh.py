"""Meshes of labels: closed forms, trimesh as a witness of what is closed, and the reference of where regions meet."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

import clvol
from clvol import cli
from clvol.base import memory
from clvol.base.errors import ClvolWarning, DataError, OptionError, OutOfMemoryError
from clvol.bricks.field import as_lazy
from clvol.interfaces import triangles
from clvol.interfaces.mesh import MESHES
from clvol.reference import labels_between

trimesh = pytest.importorskip("trimesh")
pytestmark = pytest.mark.usefixtures("device")


def touching(shape: tuple[int, int, int] = (20, 24, 32)) -> clvol.Volume:
    """Two balls that touch."""
    z, y, x = np.mgrid[tuple(slice(n) for n in shape)]
    data = np.zeros(shape, np.uint8)
    for label, centre in ((3, 9.3), (7, 21.3)):
        data[(x - centre) ** 2 + (y - 11.6) ** 2 + (z - 9.7) ** 2 < 36] = label
    return clvol.Volume(data, labels={3: "left", 7: "right"}, space="LPS")


def between_two(made: clvol.Mesh) -> NDArray[np.bool_]:
    """Vertices between two labels, not on the domain's faces."""
    assert made.labels is not None
    some = np.zeros((len(made.vertices), 1 + int(made.labels.max())), bool)
    some[made.faces, made.labels[:, :1]] = some[made.faces, made.labels[:, 1:]] = True
    outer = np.zeros(len(made.vertices), bool)
    outer[made.faces[made.labels[:, 1] < 0]] = True
    return np.asarray((some.sum(1) == 2) & ~outer)


def test_the_outer_surface_has_its_own_normals_where_a_boundary_meets_it() -> None:
    data = np.zeros((8, 8, 12), np.uint8)
    data[:4, :, :6], data[:4, :, 6:] = 1, 2  # side by side under a plane
    made = clvol.mesh(clvol.Volume(data, labels=True), closed=False)
    for one in (made, made.of(1), made.of(2)):
        assert one.labels is not None
        top = np.unique(one.faces[one.labels[:, 1] == 0])
        assert one.normals[top, 2].min() > 0.96  # where three labels meet the surface has a shallow groove
    assert_allclose(np.abs(made.normals[:, 0]).max(), 1)  # the boundary itself


def test_every_label_is_closed_and_its_vertices_lie_where_two_are_equal() -> None:
    random = np.random.default_rng(5)
    for n in range(24):
        row = ["linear", "bspline5-approx"][n % 2]
        data = random.integers(0, random.integers(2, 7), random.integers(1, 8, 3)).astype(np.uint8)
        turned = np.linalg.qr(random.normal(size=(3, 3)))[0]  # some mirrored
        volume = clvol.Volume(data, tuple(random.uniform(0.5, 2, 3)), direction=turned, labels=True)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ClvolWarning)  # some labels are lost
            made = clvol.mesh(volume, only=np.unique(data), filter=row)
        assert made.is_closed
        assert made.labels is not None
        assert_allclose(np.linalg.norm(made.normals, axis=1), 1, atol=1e-5)
        each = [made.of(label) for label in made.names]
        for one in each:
            witness = trimesh.Trimesh(one.vertices, one.faces, process=False)
            assert witness.is_watertight
            assert witness.is_winding_consistent
            assert one.volume == pytest.approx(witness.volume)
            assert one.volume > 0
        assert sum(one.volume for one in each) == pytest.approx(made.volume)  # neither gaps nor overlaps
        assert made.volume == pytest.approx(np.prod(np.array(volume.size) * volume.spacing))
        two = between_two(made)
        pairs = np.full((len(made.vertices), 2), -1)
        pairs[made.faces] = made.labels[:, None]
        values, slopes = labels_between(volume, made.vertices[two], pairs[two], row)
        steep = np.linalg.norm(slopes, axis=1)
        assert (np.abs(values) < np.maximum(1e-5 * steep * min(volume.spacing), 1e-6)).all()


def test_balls_that_touch_are_nearer_the_truth_than_samples() -> None:
    volume = touching()
    made = clvol.mesh(volume)
    assert made.names == {3: "left", 7: "right"}
    assert made.of("left").volume + made.of(7).volume == pytest.approx(made.volume)
    assert made.volume == pytest.approx(2 * 4 / 3 * np.pi * 6**3, rel=0.06)
    two = between_two(made)
    distances = np.stack([np.linalg.norm(made.vertices[two] - [x, 11.6, 9.7], axis=1) - 6 for x in (9.3, 21.3)])
    assert np.sqrt((np.abs(distances).min(0) ** 2).mean()) < 0.13  # of a staircase 0.29
    left = made.of("left")
    outwards = left.vertices - [9.3, 11.6, 9.7]
    away = outwards[:, 0] < 3  # from where they touch
    cosines = (left.normals * outwards).sum(1) / np.linalg.norm(outwards, axis=1)
    assert np.sqrt((np.degrees(np.arccos(cosines[away].clip(-1, 1))) ** 2).mean()) < 8
    assert made.labels is not None
    assert set(map(tuple, np.unique(made.labels, axis=0).tolist())) == {(3, 0), (3, 7), (7, 0)}
    right = made.of("right")
    assert right.labels is not None
    assert set(np.unique(right.labels[:, 1])) == {0, 3}
    middle = right.vertices.mean(0)
    assert ((right.normals * (right.vertices - middle)).sum(1) > 0).mean() > 0.97  # out of it, also towards the other
    alone = clvol.mesh(volume, only=["right"])
    assert set(map(tuple, alone.vertices.tolist())) == set(map(tuple, right.vertices.tolist()))
    assert alone.area == pytest.approx(right.area, abs=1e-9)


def test_the_faces_of_the_domain_close_it() -> None:
    halves = clvol.Volume(np.repeat([[[1, 1, 1, 2, 2]]], 4, 0).repeat(4, 1), (1, 2, 3), labels=True)
    made = clvol.mesh(halves, only=[1, 2])
    assert made.labels is not None
    assert set(map(tuple, np.unique(made.labels, axis=0).tolist())) == {(1, -1), (1, 2), (2, -1)}
    assert [made.of(k).volume for k in (1, 2)] == pytest.approx([3 * 16 * 6, 2 * 16 * 6])
    assert_allclose([made.vertices.min(0), made.vertices.max(0)], [[-0.5, -1, -1.5], [4.5, 7, 10.5]])
    cut = clvol.mesh(halves, only=[1, 2], closed=False)
    assert not cut.is_closed
    assert cut.area == pytest.approx(8 * 12)
    assert_allclose(cut.normals, [[1, 0, 0]] * len(cut.normals), atol=1e-6)


def test_files_hold_labels_with_names_and_colors(tmp_path: Path) -> None:
    made = clvol.mesh(touching((20, 24, 30)))
    assert made.labels is not None
    scene = trimesh.load(made.save(tmp_path / "a.glb"))
    assert set(scene.geometry) == {"left", "right"}
    assert_allclose(scene.geometry["left"].visual.vertex_colors[0, :3] / 255, made.colors[3], atol=1 / 255)
    lines = made.save(tmp_path / "a.obj").read_text().splitlines()
    assert [line for line in lines if line.startswith("o ")] == ["o left", "o right"]
    first = [float(number) for number in next(line for line in lines if line.startswith("v ")).split()[1:]]
    assert_allclose(first, [*made.of(3).vertices[0], *made.colors[3]], atol=1 / 255)
    assert sum(line.startswith("f ") for line in lines) == sum(len(made.of(k).faces) for k in made.names)
    ply = trimesh.load(made.save(tmp_path / "a.ply"), process=False)
    assert_allclose(ply.visual.face_colors[0, :3] / 255, made.colors[int(made.labels[0, 0])], atol=1 / 255)
    assert (np.ravel(ply.metadata["_ply_raw"]["face"]["data"]["front"]) == made.labels[:, 1]).all()
    with pytest.raises(OptionError, match=r"save each mesh\.of\(label\)"):
        made.save(tmp_path / "a.stl")
    assert trimesh.load(made.of("left").save(tmp_path / "left.stl")).is_watertight
    shown = made.to_pyvista()
    assert (shown.cell_data["label"] == made.labels[:, 0]).all()
    assert set(MESHES) == {".stl", ".ply", ".obj", ".glb"}


def test_what_is_no_mesh_of_labels_is_refused() -> None:
    volume = touching()
    cases: list[tuple[Any, dict[str, Any], type[Exception], str]] = [
        (volume, {"only": [4]}, OptionError, "must be one that occurs: 0, 3, 7; got 4"),
        (volume, {"only": ["rigt"]}, OptionError, r"did you mean right\?"),
        (volume, {"only": []}, OptionError, "only must be labels"),
        (volume, {"faces": 100}, OptionError, "faces is for values"),
        (volume, {"isovalue": 3.0}, OptionError, "isovalue is for values"),
        (volume, {"curvature": True}, OptionError, "curvature is for values"),
        (volume, {"filter": "bspline3"}, OptionError, "bspline5-approx"),
        (as_lazy(volume), {}, OptionError, r"whole\(\)"),
        (clvol.Volume(volume.data + 0.5, labels=True), {}, DataError, "whole numbers"),
        (clvol.Volume(volume.data.astype(np.int64) << 52, labels=True), {}, OptionError, r"2\*\*53"),
        (clvol.Volume(volume.data.astype(np.uint64) << 61, labels=True), {}, OptionError, r"2\*\*53"),
    ]
    for given, options, error, words in cases:
        with pytest.raises(error, match=words):
            clvol.mesh(given, **options)
    with pytest.raises(OptionError, match="got one of an isovalue"):
        clvol.mesh(clvol.phantoms.sphere(8), 0.4).of(1)
    alone = np.zeros((5, 5, 5), np.uint8)
    with pytest.warns(ClvolWarning, match="no label was chosen"):
        empty = clvol.mesh(clvol.Volume(alone, labels=True))
    assert not len(empty.faces)
    alone[2, 2, 2] = 1
    with pytest.warns(ClvolWarning, match="no surface of 1: too small"):
        assert not clvol.mesh(clvol.Volume(alone, labels=True)).names
    assert clvol.mesh(clvol.Volume(alone, labels=True), filter="linear").is_closed


def test_how_many_triangles_there_will_be_is_told_or_refused_before(monkeypatch: pytest.MonkeyPatch) -> None:
    ways: list[tuple[Any, ...]] = [(touching(),), (clvol.phantoms.sphere(12), 0.5)]
    monkeypatch.setattr(triangles, "_MANY", 10)
    for given in ways:
        with pytest.warns(ClvolWarning, match=r"the mesh has about \d+ triangles, and takes up to"):
            clvol.mesh(*given)
    monkeypatch.setattr(memory, "require", refuse)
    for given in ways:
        with pytest.raises(OutOfMemoryError, match=r"a mesh of about \d+ triangles"):
            clvol.mesh(*given)


def refuse(nbytes: int, what: str) -> None:
    """As `clvol.base.memory.require` where no mesh fits."""
    if "triangles" in what:
        raise OutOfMemoryError(f"{what} of {nbytes} bytes")


def test_the_shell_writes_labels(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    clvol.write(touching(), tmp_path / "two.npz")
    with pytest.raises(SystemExit, match="0"):
        cli.main(["mesh", str(tmp_path / "two.npz"), "-o", str(tmp_path / "a.glb"), "--only", "3", "right", "--json"])
    assert '"labels"' in capsys.readouterr().out
    assert len(trimesh.load(tmp_path / "a.glb").geometry) == 2
    with pytest.raises(SystemExit, match="1"):
        cli.main(["mesh", str(tmp_path / "two.npz"), "-o", str(tmp_path / "a.stl"), "--isovalue", "3"])
    assert "--isovalue is for values" in capsys.readouterr().err
