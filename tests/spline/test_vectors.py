"""Several components on one grid: the functions of Field, sampled together; curl, divergence and streamlines of closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import clvol
from clvol.base.errors import DataError, GeometryError, OptionError
from clvol.device import Device
from clvol.spline import points as points_module
from clvol.spline import vectors as vectors_module


def rotation(device: Device, n: int = 33) -> clvol.VectorField:
    """A rigid rotation about the middle of a volume of n³ samples, at (0, 0, 0)."""
    half = n // 2
    z, y, x = np.mgrid[-half : half + 1, -half : half + 1, -half : half + 1].astype("f4")
    origin = (-half,) * 3
    parts = [clvol.Volume(part, origin=origin) for part in (-y, x, np.zeros_like(z))]
    return clvol.VectorField(parts, device=device)


@pytest.mark.one_in(2)
@pytest.mark.parametrize(
    ("shape", "row", "boundary", "precision"),
    [
        ((8, 9, 10, 3), "bspline3", "mirror", "single"),
        ((8, 9, 2), "bspline5", "zero", "double"),
        ((6, 7, 8, 5), "linear", "wrap", "single"),
    ],
)
def test_each_component_is_the_function_of_a_field(
    device: Device, monkeypatch: pytest.MonkeyPatch, shape: tuple[int, ...], row: str, boundary: str, precision: Any
) -> None:
    rng = np.random.default_rng(0)
    samples, d = rng.normal(size=shape), len(shape) - 1
    points = rng.uniform(-3, 12, (7, 100, d)).astype("f4")
    points[0, 0, 0] = np.nan
    with clvol.VectorField(samples, row, boundary, device, precision=precision) as vectors:
        fields = [clvol.Field(samples[..., i], row, boundary, device, precision=precision) for i in range(shape[-1])]
        found = [f(points) for f in (vectors, vectors.jacobian, vectors.hessian)]
        alone = [np.stack([f(points) for f in each], 2) for each in zip(*[(f, f.gradient, f.hessian) for f in fields], strict=True)]
        assert [each.shape[2:] for each in found] == [(shape[-1],) + (d,) * order for order in range(3)]
        assert_array_equal(vectors(points[1, :3]), found[0][1, :3])
        if row == "linear":  # five in groups of four and one
            with monkeypatch.context() as patched:
                patched.setattr(vectors_module, "_TOGETHER", 4)
                with clvol.VectorField(samples, row, boundary, device) as grouped:
                    assert_array_equal(grouped.jacobian(points), found[1])
        few = vectors(points, fill=-7)
        assert_array_equal(few, np.stack([f(points, fill=-7) for f in fields], 2))
        for order in (0, 1) if d == 3 and row == "bspline3" else ():
            with monkeypatch.context() as patched:  # as a GPU does it, one point at a time
                patched.setattr(points_module, "_in_lanes", lambda *_: False)
                each = (vectors, vectors.jacobian)[order](points)
                assert_allclose(each, alone[order], rtol=0, atol=2e-6)
    if device.kind == "cpu":
        assert_array_equal(found[0], alone[0])
        assert_array_equal(found[1], alone[1])
    for got, expected in zip(found, alone, strict=True):
        assert_allclose(got, expected, rtol=0, atol=1e-13 if precision == "double" else 1e-5)


def test_a_beltrami_flow_is_its_own_curl(device: Device) -> None:
    n = 32
    z, y, x = np.meshgrid(*[2 * np.pi * np.arange(n) / n] * 3, indexing="ij")
    parts = np.sin(z) + np.cos(y), np.sin(x) + np.cos(z), np.sin(y) + np.cos(x)  # Arnold, Beltrami and Childress
    points = np.random.default_rng(1).uniform(0, 2 * np.pi, (500, 3))
    with clvol.VectorField(
        [clvol.Volume(part, (2 * np.pi / n,) * 3) for part in parts], "bspline5", "wrap", device, precision="double"
    ) as flow:
        assert_allclose(flow.curl(points), flow(points), rtol=0, atol=2e-6)
        assert_allclose(flow.divergence(points), 0, rtol=0, atol=2e-6)


def test_curl_in_the_plane_and_in_a_turned_grid(device: Device) -> None:
    y, x = np.mgrid[0.0:8, 0.0:9]
    turned = clvol.Volume(x - y, (0.5, 2.0), (1, 1), [[0, -1], [1, 0]])
    at = turned.index_to_world(np.stack([x, y], -1))
    linear = np.array([[0.3, -2.0], [1.0, 0.2]])
    moved = at @ linear.T
    parts = [clvol.Volume(moved[..., i], turned.spacing, turned.origin, turned.direction) for i in range(2)]
    middle = turned.index_to_world([[3.2, 4.1]])
    with clvol.VectorField(parts, "linear", device=device) as field:
        assert_allclose(field.jacobian(middle)[0], linear, atol=1e-5)
        assert_allclose(field.curl(middle), [3], atol=1e-5)
        assert_allclose(field.divergence(middle), [0.5], atol=1e-5)


def test_streamlines_of_a_rotation_are_circles(device: Device) -> None:
    seeds = [(6.0, 0, 0), (40, 0, 0), (0, 0, 0), (3, 4, 2)]  # the second is outside, the third does not move
    with rotation(device) as field:
        lines = field.streamlines(seeds, length=6 * np.pi, direction="forward")
        assert (np.diff(lines.starts)[[1, 2]] == 0).all()
        for number in (0, 3):
            line = lines[number]
            assert_allclose(np.hypot(line[:, 0], line[:, 1]), np.hypot(*seeds[number][:2]), atol=1e-5)
            assert_allclose(line[:, 2], seeds[number][2], atol=1e-5)
            assert_allclose(line[0], seeds[number])
        assert_allclose(lines[0][-1], (-6, 0, 0), atol=1e-4)
        assert_allclose(lines.vectors, lines.points[:, [1, 0, 2]] * (-1, 1, 0), atol=1e-4)
        fixed = field.streamlines(seeds[:1], step=0.25, length=5)[0]
        assert len(fixed) == 41
        turns = np.unwrap(np.arctan2(fixed[:, 1], fixed[:, 0]))
        assert_allclose(turns, np.linspace(-5, 5, 41) / 6, atol=1e-6)
        leaving = field.streamlines([(12.0, 12, 0)])[0]  # the domain, at both ends
        assert_allclose(np.abs(leaving[[0, -1]]).max(1), 16.5, atol=2e-3)
        assert np.abs(leaving).max() <= 16.5


def test_streamlines_as_polylines_of_pyvista(device: Device) -> None:
    pytest.importorskip("pyvista")
    with rotation(device, 9) as field:
        lines = field.streamlines([(2.0, 0, 0), (9, 0, 0), (0, 3, 1)], length=3)
    made = lines.to_pyvista()
    assert made.n_lines == 2
    assert_allclose(made.get_cell(1).points, lines[2])
    assert_allclose(made["vectors"], lines.vectors)


def test_arguments_that_are_rejected(device: Device) -> None:
    with pytest.raises(DataError, match=r"components must be real numbers of shape \(ny, nx, n\)"):
        clvol.VectorField(np.ones((3, 3)), device=device)
    with pytest.raises(DataError, match="finite"):
        clvol.VectorField(np.full((3, 3, 2), np.nan), device=device)
    with pytest.raises(GeometryError, match="grid"):
        clvol.VectorField([clvol.Volume(np.ones((3, 3))), clvol.Volume(np.ones((3, 3)), (2, 2))], device=device)
    with clvol.VectorField(np.ones((3, 3, 3, 2)), device=device) as two:
        for wrong in (two.divergence, two.curl, two.streamlines):
            with pytest.raises(OptionError, match="as many components as axes, 3; got 2"):
                wrong(np.ones((1, 3)))
    with rotation(device, 5) as field:
        with pytest.raises(OptionError, match="direction must be"):
            field.streamlines([(1, 0, 0)], direction="up")  # type: ignore[arg-type]
        with pytest.raises(OptionError, match="step must be"):
            field.streamlines([(1, 0, 0)], step=0)
    with pytest.raises(OptionError, match="closed"):
        field((0, 0, 0))
