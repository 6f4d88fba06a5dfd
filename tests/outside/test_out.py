"""Output arrays: of any strides, NumPy or PyTorch, or rejected before anything is computed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray
from scipy import ndimage

import clvol
from clvol.base.errors import OptionError
from clvol.device import Device
from clvol.device.buffers import Buffers

Array = NDArray[Any]
DATA = np.random.default_rng(0).uniform(-1, 1, (9, 10, 11))
POINTS = np.random.default_rng(1).uniform(1, 7, (6, 5, 3))
VALUES = ndimage.map_coordinates(DATA, POINTS[..., ::-1].reshape(-1, 3).T, order=3, mode="mirror").reshape(6, 5)


def slopes(derivative: int) -> Array:
    """Of the cubic spline, by fourth-order differences of SciPy's."""
    coefficients = ndimage.spline_filter(DATA, mode="mirror")

    def at(p: Array) -> Array:
        flat = p[..., ::-1].reshape(-1, 3).T
        return np.asarray(ndimage.map_coordinates(coefficients, flat, order=3, mode="mirror", prefilter=False)).reshape(
            p.shape[:-1]
        )

    h = 1e-3
    steps = h * np.eye(3)
    if derivative == 1:
        return np.stack(
            [(8 * (at(POINTS + s) - at(POINTS - s)) - at(POINTS + 2 * s) + at(POINTS - 2 * s)) / (12 * h) for s in steps], -1
        )
    each = [
        [(at(POINTS + s + t) - at(POINTS + s - t) - at(POINTS - s + t) + at(POINTS - s - t)) / (4 * h * h) for t in steps]
        for s in steps
    ]
    return np.moveaxis(np.array(each), (0, 1), (-2, -1))


LAYOUTS = {
    "contiguous": lambda shape, kind: np.full(shape, -9, kind),
    "strided": lambda shape, kind: np.full([2 * n for n in shape], -9, kind)[tuple(slice(None, None, 2) for _ in shape)],
    "reversed": lambda shape, kind: np.full(shape, -9, kind)[::-1],
    "Fortran's": lambda shape, kind: np.full(shape, -9, kind, order="F"),
    "the other byte order": lambda shape, kind: np.full(shape, -9, np.dtype(kind).newbyteorder()),
}


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("kind", ["f4", "f8"])
@pytest.mark.parametrize("precision", ["single", "double"])
def test_values_and_grids(device: Device, layout: str, kind: str, precision: Any) -> None:
    tolerance = 1e-12 if (kind, precision) == ("f8", "double") else 2e-6
    with clvol.Field(DATA, device=device, precision=precision) as field:
        out = LAYOUTS[layout](VALUES.shape, kind)
        assert field(POINTS, out=out) is out
        assert_allclose(out, VALUES, rtol=0, atol=tolerance)
        for name in ("gradient", "hessian"):
            expected = getattr(field, name)(POINTS)
            out = LAYOUTS[layout](expected.shape, kind)
            assert getattr(field, name)(POINTS, out=out) is out
            assert_allclose(out, expected, rtol=1e-6)
        grid = LAYOUTS[layout]((9, 20, 22), kind)
        volume = field.resample((9, 20, 22), out=grid)
        assert np.shares_memory(volume.data, grid)
        at = np.meshgrid(np.arange(9), np.arange(20) / 2 - 0.25, np.arange(22) / 2 - 0.25, indexing="ij")
        assert_allclose(grid, ndimage.map_coordinates(DATA, at, order=3, mode="mirror"), rtol=0, atol=tolerance)


def test_functions_that_use_a_temporary_field(device: Device) -> None:
    for derivative, expected in ((0, VALUES), (1, slopes(1)), (2, slopes(2))):
        out = np.empty(expected.shape)
        assert clvol.sample(DATA, POINTS, derivative=derivative, out=out, device=device, precision="double") is out
        assert_allclose(out, expected, rtol=0, atol=(1e-12, 1e-9, 1e-3)[derivative])
    grid = np.empty((9, 20, 11), np.float32)
    clvol.resample(DATA, (9, 20, 11), out=grid, device=device)
    assert_allclose(grid, clvol.resample(DATA, (9, 20, 11), device=device).data, rtol=0, atol=0)


def test_kernels_write_contiguous_arrays_themselves(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    written = []
    lent = Buffers.lent

    def noted(self: Buffers, array: Array, *, write: bool) -> Any:
        if write:
            written.append(array)
        return lent(self, array, write=write)

    with clvol.Field(DATA.astype(np.float32), device=device) as field:
        points = np.tile(np.float32(POINTS.reshape(-1, 3)), (20, 1))  # more than a plan's
        out, grid = np.empty(600, np.float32), np.empty((9, 20, 11), np.float32)
        field(points)
        monkeypatch.setattr(Buffers, "lent", noted)
        field(points, out=out)
        assert [np.shares_memory(array, out) for array in written] == [True]
        written.clear()
        field.resample((9, 20, 11), out=grid)
        assert [np.shares_memory(array, grid) for array in written] == [True]


def test_pytorch_tensors(device: Device) -> None:
    torch = pytest.importorskip("torch")
    with clvol.Field(DATA, device=device) as field:
        for out in (torch.zeros(6, 5), torch.zeros(5, 6).T, torch.zeros(6, 10, dtype=torch.float64)[:, ::2]):
            assert field(torch.from_numpy(POINTS), out=out) is out
            assert_allclose(out.numpy(), VALUES, rtol=0, atol=2e-6)
        grid = torch.zeros(9, 20, 11)
        assert_allclose(field.resample((9, 20, 11), out=grid).data, grid.numpy(), rtol=0, atol=0)
        assert grid.abs().sum() > 0


def test_scaled_and_shifted_data(device: Device) -> None:
    far = DATA + 101_325
    for kind, tolerance in (("f8", 1e-5), ("f4", 0.01)):
        out = np.empty(VALUES.shape, kind)
        clvol.sample(far, POINTS, out=out, device=device)
        assert_allclose(out, VALUES + 101_325, rtol=0, atol=tolerance)


def test_points_may_be_overwritten(device: Device) -> None:
    for kind in ("f4", "f8"):
        points = POINTS.reshape(-1, 3).astype(kind)
        with clvol.Field(DATA, device=device) as field:
            expected = field.gradient(points.copy())
            field.gradient(points, out=points)
        assert_allclose(points, expected, rtol=1e-6)


def test_no_points_at_all(device: Device) -> None:
    out = np.empty((0, 3), np.float32)
    assert clvol.sample(DATA, np.empty((0, 3)), derivative=1, out=out, device=device) is out


def test_invalid_outputs_are_rejected_before_any_computation(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    fixed = np.zeros((6, 5))
    fixed.flags.writeable = False
    with clvol.Field(DATA, device=device) as field:
        monkeypatch.setattr(Device, "build", lambda *_: pytest.fail("a kernel was built"))
        monkeypatch.setattr(Buffers, "allocate", lambda *_: pytest.fail("memory was allocated"))
        for out, rule in (
            (np.zeros((5, 6)), r"out must have shape \(6, 5\); got \(5, 6\)"),
            (np.zeros((6, 5), np.int64), "out must be float32 or float64; got int64"),
            (np.zeros((6, 5), np.complex64), "out must be float32 or float64"),
            (fixed, "read-only"),
            ([[0.0] * 5] * 6, "of which NumPy makes a copy"),
        ):
            with pytest.raises(OptionError, match=rule):
                field(POINTS, out=out)
            with pytest.raises(OptionError, match=rule):
                clvol.sample(DATA, POINTS, out=out, device=device)
        with pytest.raises(OptionError, match=r"out must have shape \(6, 5, 3\)"):
            field.gradient(POINTS, out=np.zeros((6, 5)))
        with pytest.raises(OptionError, match=r"out must have shape \(6, 5, 3, 3\)"):
            clvol.sample(DATA, POINTS, derivative=2, out=np.zeros((6, 5)), device=device)
        for call in (field.resample, lambda shape, out: clvol.resample(DATA, shape, out=out, device=device)):
            with pytest.raises(OptionError, match=r"out must have shape \(9, 9, 9\)"):
                call((9, 9, 9), out=np.zeros((9, 9, 10)))
