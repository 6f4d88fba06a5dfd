"""Meshes: closed forms, PyVista and trimesh as witnesses, and where the values equal samples."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

import clvol
from clvol import cli
from clvol.base.errors import ClvolWarning, DataError, FormatError, MissingDependencyError, OptionError, OutOfMemoryError
from clvol.bricks.field import as_lazy
from clvol.interfaces.mesh import MESHES
from clvol.reference import sample

trimesh = pytest.importorskip("trimesh")
pytestmark = pytest.mark.usefixtures("device")

TURNED = np.array([[0.6, 0, 0.8], [0.8, 0, -0.6], [0, 1, 0]])
PLACED: dict[str, Any] = {"spacing": (1, 2, 0.5), "origin": (100, -20, 7), "direction": TURNED}


def quadric(coefficients: tuple[float, float, float], level: float, size: int = 17) -> clvol.Volume:
    """Samples of level - a x² - b y² - c z², which cubic splines reproduce except near the boundary."""
    z, y, x = np.mgrid[-1 : 1 : size * 1j, -1 : 1 : size * 1j, -1 : 1 : size * 1j]
    a, b, c = coefficients
    spacing = 2 / (size - 1)
    return clvol.Volume(level - a * x**2 - b * y**2 - c * z**2, (spacing,) * 3, (-1, -1, -1))


def away(made: clvol.Mesh, volume: clvol.Volume, isovalue: float, filter: str) -> NDArray[np.float64]:
    """How far vertices are from the surface, to first order, as a fraction of the spacing."""
    slope = np.linalg.norm(sample(volume, made.vertices, filter, derivative=1), axis=1)
    return np.abs(sample(volume, made.vertices, filter) - isovalue) / slope / min(volume.spacing)


@pytest.mark.parametrize("mirrored", [False, True])
def test_vertices_of_a_ball_lie_on_the_spline_wherever_the_grid_is(mirrored: bool) -> None:
    ball = clvol.phantoms.sphere(20).data
    turned = TURNED * [-1 if mirrored else 1, 1, 1]
    volume = clvol.Volume(ball, **PLACED | {"direction": turned})
    made = clvol.mesh(volume, 0.4, filter="bspline3")
    assert away(made, volume, 0.4, "bspline3").max() < 1e-5
    assert made.is_closed
    outside = trimesh.Trimesh(made.vertices, made.faces, process=False)
    assert outside.is_watertight
    assert outside.is_winding_consistent
    assert made.volume == pytest.approx(outside.volume)
    assert made.volume > 0  # triangles face lower values
    assert made.area == pytest.approx(outside.area)
    assert_allclose(np.linalg.norm(made.normals, axis=1), 1, atol=1e-6)
    assert (np.einsum("ij,ij->i", made.normals, outside.vertex_normals) > 0.9).all()
    plain = clvol.mesh(clvol.Volume(ball), 0.4, filter="bspline3")
    assert made.volume == pytest.approx(plain.volume, rel=2e-3)  # 1 · 2 · ½


def test_area_and_volume_of_a_torus_converge_to_the_closed_forms() -> None:
    errors = []
    for size in (24, 48):
        z, y, x = np.mgrid[-1 : 1 : size * 1j, -1 : 1 : size * 1j, -1 : 1 : size * 1j]
        volume = clvol.Volume(-np.hypot(np.hypot(x, y) - 0.6, z), (2 / (size - 1),) * 3)
        made = clvol.mesh(volume, -0.25, filter="bspline3")
        errors.append((made.area / (4 * np.pi**2 * 0.6 * 0.25) - 1, made.volume / (2 * np.pi**2 * 0.6 * 0.25**2) - 1))
        assert trimesh.Trimesh(made.vertices, made.faces, process=False).euler_number == 0
    assert np.abs(errors[1]).max() < 5e-3
    assert (np.abs(errors[1]) < 0.35 * np.abs(errors[0])).all()  # a quarter: chords


@pytest.mark.parametrize(
    ("shape", "level", "truth"),
    [
        ((1, 1, 1), 0.09, lambda x, _: (np.full_like(x, 1 / 0.3), np.full_like(x, 1 / 0.09))),  # mean, Gauss of a sphere
        ((1, 1, 0), 0.09, lambda x, _: (np.full_like(x, 0.5 / 0.3), np.zeros_like(x))),  # a cylinder
        ((1, -1, 0), 0.04, lambda x, y: ((-(x**2) + y**2) / (2 * (x**2 + y**2) ** 1.5), np.zeros_like(x))),  # a hyperbola's
    ],
    ids=["sphere", "cylinder", "hyperbola"],
)
def test_curvatures_are_those_of_closed_forms(shape: Any, level: float, truth: Any) -> None:
    volume = quadric(shape, level, 33)
    made = clvol.mesh(clvol.Field(volume, "bspline3", precision="double"), 0.0, curvature=True, closed=False)
    assert made.curvature is not None
    inner = (np.abs(made.vertices) < 0.4).all(1)
    assert inner.sum() > 100
    mean, gauss = truth(*made.vertices[inner, :2].T)
    found = made.curvature[inner].astype(float)
    assert_allclose(found.mean(1), mean, atol=1e-4)
    assert_allclose(found.prod(1), gauss, atol=4e-4)


def test_no_hole_is_left_where_values_equal_samples() -> None:
    random = np.random.default_rng(5)
    for _ in range(40):
        samples = random.integers(0, 4, random.integers(1, 7, 3)).astype(np.float32)
        row, boundary = random.choice(["linear", "bspline3"]), random.choice(["mirror", "zero"])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ClvolWarning)  # some are empty
            made = clvol.mesh(samples, float(random.integers(0, 4)), filter=row, boundary=boundary)
        assert made.is_closed
        assert not len(made.faces) or trimesh.Trimesh(made.vertices, made.faces, process=False).is_watertight
        assert np.isfinite(made.vertices).all()
        assert_allclose(np.linalg.norm(made.normals, axis=1), 1, atol=1e-5)


def test_a_surface_is_closed_by_the_faces_of_the_domain() -> None:
    full = clvol.Volume(np.ones((4, 5, 6), np.float32), (1, 2, 3))
    made = clvol.mesh(full, 0.5, filter="bspline3", curvature=True)
    assert_allclose(made.vertices.min(0), [-0.5, -1, -1.5])
    assert_allclose(made.vertices.max(0), [5.5, 9, 10.5])
    assert made.volume == pytest.approx(4 * 5 * 6 * 6, rel=0.01)
    assert made.curvature is not None
    assert np.isnan(made.curvature).all()
    half = clvol.Volume(np.arange(8.0)[:, None, None] * np.ones((8, 8, 8)))
    both = [clvol.mesh(half, 3.25, filter="bspline3", closed=closed) for closed in (True, False)]
    assert [one.is_closed for one in both] == [True, False]
    assert both[1].area == pytest.approx(8 * 8, rel=1e-6)
    assert both[0].volume == pytest.approx(8 * 8 * (7.5 - 3.25), rel=0.01)
    with pytest.raises(OptionError, match="closed=True"):
        both[1].volume  # noqa: B018
    with pytest.warns(ClvolWarning, match="empty: no surface of 0.5, where values are from 1 to 1"):
        assert not len(clvol.mesh(full, 0.5, closed=False).faces)


def test_decimated_vertices_lie_on_the_surface_again() -> None:
    made = clvol.mesh(quadric((1, 1, 1), 0.09, 33), 0.0, faces=300, filter="bspline3")
    assert 250 < len(made.faces) <= 300
    assert made.is_closed
    assert_allclose(np.linalg.norm(made.vertices, axis=1), 0.3, atol=1e-6)


def test_missing_samples_leave_a_hole() -> None:
    samples = clvol.phantoms.sphere(16).data.copy()
    samples[6:10, 6:10, 12:] = np.nan
    with pytest.raises(DataError):
        clvol.mesh(samples, 0.4)
    made = clvol.mesh(samples, 0.4, nan="local", filter="linear")
    assert made.is_closed  # along what is missing
    assert np.isfinite(made.vertices).all()
    assert made.volume < clvol.mesh(clvol.phantoms.sphere(16).data, 0.4, filter="linear").volume


def test_the_mesh_is_that_of_the_picture_and_of_bricks() -> None:
    volume = clvol.phantoms.sphere(24)
    made, by_bricks = clvol.mesh(volume), clvol.mesh(as_lazy(volume))
    assert np.array_equal(made.faces, by_bricks.faces)
    assert_allclose(by_bricks.vertices, made.vertices, atol=1e-5)
    camera = clvol.Camera.orbit(20, 30, projection="orthographic")
    with clvol.Renderer(volume) as renderer:
        seen = renderer.render(camera, "isosurface", (24, 24), outputs="position", rays=1)
        assert clvol.mesh(renderer.field, clvol.volume.histogram.isovalue_of(volume)[0]).vertices.shape == made.vertices.shape
    hits = seen[np.isfinite(seen).all(-1)]
    _, nearest = made.to_pyvista().find_closest_cell(hits, return_closest_point=True)
    assert len(hits) > 50
    assert np.linalg.norm(nearest - hits, axis=1).max() < 0.1 * volume.spacing[0]  # chords


def test_files_hold_the_mesh(tmp_path: Path) -> None:
    pyvista = pytest.importorskip("pyvista")
    volume = clvol.Volume(clvol.phantoms.sphere(12).data, space="LPS")
    made = clvol.mesh(volume, 0.4, curvature=True)
    for suffix in MESHES:
        path = made.save(tmp_path / f"ball{suffix}")
        found = pyvista.read(path) if suffix != ".glb" else pyvista.wrap(trimesh.load(path, force="mesh"))
        corners = found.points[found.regular_faces] if found.n_cells else None
        assert_allclose(np.sort(corners.reshape(-1, 9), 0), np.sort(made.vertices[made.faces].reshape(-1, 9), 0), atol=1e-5)
    again = trimesh.load(tmp_path / "ball.ply", process=False)
    assert_allclose(again.vertex_normals, made.normals, atol=1e-6)
    assert "property float k1" in (tmp_path / "ball.ply").read_bytes()[:600].decode("ascii", "replace").replace("double", "float")
    ras = trimesh.load(made.save(tmp_path / "ras.ply", frame="RAS"), process=False)
    assert_allclose(ras.vertices, made.vertices * [-1, -1, 1], atol=1e-6)
    shown = made.to_pyvista()
    assert shown.is_manifold
    assert_allclose(shown["k1"], made.curvature[:, 0])  # type: ignore[index]  # it was asked for
    assert shown.volume == pytest.approx(made.volume, rel=1e-6)


def test_what_is_no_mesh_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ball = clvol.phantoms.sphere(8)
    cases: list[tuple[Any, dict[str, Any], type[Exception], str]] = [
        (np.zeros((5, 5)), {}, OptionError, "3 axes; got shape \\(5, 5\\)"),
        (ball, {"only": [1]}, OptionError, "only is for labels"),
        (ball, {"faces": 3}, OptionError, "faces"),
        (ball, {"closed": "no"}, OptionError, "closed"),
        (ball, {"close": False}, OptionError, "close is no option of mesh \\(did you mean closed\\?\\)"),
        (ball, {"filter": "bogus"}, OptionError, "bogus"),
        (ball, {"isovalue": "much"}, OptionError, "isovalue"),
    ]
    for volume, options, error, words in cases:
        with pytest.raises(error, match=words):
            clvol.mesh(volume, **options)
    made = clvol.mesh(ball, 0.4)
    (tmp_path / "old.stl").write_text("old")
    with pytest.raises(FormatError, match="meshes are written as"):
        made.save(tmp_path / "a.blend")
    with pytest.raises(OptionError, match="RAS"):
        made.save(tmp_path / "old.stl", frame="RAS")  # a phantom is no patient
    assert (tmp_path / "old.stl").read_text() == "old"
    with pytest.warns(ClvolWarning), pytest.raises(OptionError, match="must have a triangle"):
        clvol.mesh(ball, 7.0).save(tmp_path / "nothing.stl")
    monkeypatch.setattr("clvol.base.memory._SMALL", 0)
    monkeypatch.setattr("clvol.interfaces.mesh._PER_VERTEX", 1 << 40)
    with pytest.raises(OutOfMemoryError, match=r"a mesh of about \d+ triangles"):
        clvol.mesh(ball, 0.4)
    monkeypatch.undo()
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(MissingDependencyError, match="clvol\\[mesh\\]"):
        made.save(tmp_path / "old.stl")
    monkeypatch.setitem(sys.modules, "vtkmodules.vtkFiltersCore", None)
    with pytest.raises(MissingDependencyError, match="clvol\\[mesh\\]"):
        clvol.mesh(ball, 0.4)
    assert [path.name for path in tmp_path.iterdir()] == ["old.stl"]


def test_the_shell_writes_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        cli.main(["mesh", "phantom:sphere:16", "-o", str(tmp_path / "a.ply"), "--isovalue", "1sigma", "--curvature", "--json"])
    assert '"volume"' in capsys.readouterr().out
    assert len(trimesh.load(tmp_path / "a.ply").faces) > 100
    with pytest.raises(SystemExit, match="1"):
        cli.main(["mesh", "phantom:sphere:16", "-o", str(tmp_path / "a.stl"), "--curvature"])
    assert "--curvature is kept by .ply alone" in capsys.readouterr().err
