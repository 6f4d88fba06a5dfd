"""PyTorch tensors: values compared with SciPy's, gradients with PyTorch's finite differences."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import ndimage

from clvol.base.errors import DataError, OptionError
from clvol.device import Device

torch = pytest.importorskip("torch")
import clvol.torch  # noqa: E402

FAST = {"fast_mode": True, "atol": 1e-6}  # compared with differences along one random direction


def problem(shape: tuple[int, ...] = (4, 5, 6), count: int = 7, kind: Any = torch.float64) -> tuple[Any, Any]:
    """Samples, and points inside and outside the domain, away from jumps of derivatives."""
    rng = np.random.default_rng(0)
    d = min(3, len(shape))
    whole = rng.integers(-3, 8, (count, d))
    points = whole + rng.uniform(0.1, 0.4, (count, d))
    return (
        torch.tensor(rng.normal(size=shape), dtype=kind, requires_grad=True),
        torch.tensor(points, dtype=kind, requires_grad=True),
    )


@pytest.fixture(autouse=True)
def _seeded() -> None:
    torch.manual_seed(0)


def test_values_match_scipy(device: Device) -> None:
    values, points = problem((2, 3, 4, 5, 6), 30)
    got = clvol.torch.sample(values, points.reshape(5, 6, 3), device=device)
    assert got.shape == (2, 3, 5, 6)
    assert got.dtype == torch.float64
    at = points.detach().numpy()[:, ::-1].T
    expected = [[ndimage.map_coordinates(v, at, order=3, mode="mirror") for v in row] for row in values.detach().numpy()]
    assert_allclose(got.detach().numpy().reshape(2, 3, 30), expected, rtol=0, atol=1e-12)
    single = clvol.torch.sample(values.float(), points.float(), device=device)
    assert single.dtype == torch.float32
    assert_allclose(single.detach().numpy(), expected, rtol=0, atol=2e-5)


@pytest.mark.one_in(2)
@pytest.mark.parametrize(
    ("name", "boundary", "shape"),
    [
        ("bspline3", "wrap", (2, 4, 5, 6)),
        ("bspline3", "mirror", (4, 5, 6)),
        ("bspline4", "zero", (4, 5, 6)),
        ("bspline5", "reflect", (4, 5, 6)),
        ("mitchell", "mirror", (4, 5, 6)),
    ],
)
def test_first_and_second_gradients(device: Device, name: str, boundary: str, shape: tuple[int, ...]) -> None:
    values, points = problem(shape)

    def sampled(v: Any, p: Any) -> Any:
        return clvol.torch.sample(v, p, name, boundary, spacing=(0.8, 1.0, 1.3), origin=(0.1, -0.2, 0.3), device=device)

    assert torch.autograd.gradcheck(sampled, (values, points), **FAST)
    assert torch.autograd.gradgradcheck(sampled, (values, points), **FAST)


def test_gradients_in_two_dimensions_entry_by_entry(device: Device) -> None:
    values, _ = problem((5, 6))
    points = torch.tensor([[1.2, 0.3], [-1.4, 2.2], [6.3, 4.7]], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda v, p: clvol.torch.sample(v, p, device=device), (values, points))
    assert torch.autograd.gradgradcheck(lambda v, p: clvol.torch.sample(v, p, device=device), (values, points))


def test_filters_without_second_derivatives(device: Device) -> None:
    values, points = problem()
    assert torch.autograd.gradcheck(lambda v, p: clvol.torch.sample(v, p, "linear", device=device), (values, points), **FAST)


def test_filled_values_have_no_gradient(device: Device) -> None:
    values, _ = problem((5, 6))
    points = torch.tensor([[1.2, 0.3], [-0.6, 2.0], [5.4, 4.4], [np.nan, 1.0]], dtype=torch.float64, requires_grad=True)
    got = clvol.torch.sample(values, points, fill=-7.0, device=device)
    assert got.tolist()[1::2] == [-7, -7]
    expected = ndimage.map_coordinates(values.detach().numpy(), [[0.3, 4.4], [1.2, 5.4]], order=3, mode="mirror")
    assert_allclose(got.detach().numpy()[::2], expected, rtol=0, atol=1e-12)
    got.sum().backward()
    assert torch.isfinite(values.grad).all()
    assert (points.grad[1::2] == 0).all()
    assert (points.grad[::2] != 0).any(1).all()


def test_registration_by_gradients_finds_the_shift(device: Device) -> None:
    z, y, x = np.meshgrid(*[np.linspace(-2, 2, 24)] * 3, indexing="ij")
    blob = torch.tensor(np.exp(-(x**2) - 0.7 * y**2 - 0.5 * z**2 + 0.3 * x * y), dtype=torch.float64)
    true = torch.tensor([0.7, -0.4, 0.25], dtype=torch.float64)
    points = torch.rand(800, 3, dtype=torch.float64) * 15 + 4
    fixed = clvol.torch.sample(blob, points + true, device=device)
    shift = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    optimiser = torch.optim.LBFGS([shift], line_search_fn="strong_wolfe", max_iter=40, tolerance_grad=1e-12, tolerance_change=1e-14)

    def loss() -> Any:
        optimiser.zero_grad()
        error = ((clvol.torch.sample(blob, points + shift, device=device) - fixed) ** 2).mean()
        error.backward()
        return error

    optimiser.step(loss)
    assert_allclose(shift.detach(), true, atol=1e-6)


def test_gradients_are_reproducible(device: Device) -> None:
    values = torch.randn(30, 30, 30, requires_grad=True)
    points = (torch.rand(50_000, 3) * 29).requires_grad_()
    found = []
    for _ in range(2):
        values.grad = points.grad = None
        clvol.torch.sample(values, points, device=device).square().sum().backward()
        found.append((values.grad, points.grad))
    assert torch.equal(found[0][0], found[1][0])
    assert torch.equal(found[0][1], found[1][1])


def test_samples_changed_between_forward_and_backward_are_detected(device: Device) -> None:
    values, points = problem()
    result = clvol.torch.sample(values * 1, points, device=device)
    result.sum().backward()
    changed = values.detach().clone()
    changed.requires_grad_()
    result = clvol.torch.sample(changed, points, device=device)
    with torch.no_grad():
        changed += 1
    with pytest.raises(RuntimeError, match="inplace"):
        result.sum().backward()


def test_mixed_precision_and_no_channels(device: Device) -> None:
    values, points = problem(kind=torch.float32)
    double = points.detach().double().requires_grad_()
    clvol.torch.sample(values, double, device=device).sum().backward()
    assert (values.grad.dtype, double.grad.dtype) == (torch.float32, torch.float64)
    assert clvol.torch.sample(torch.zeros(0, 4, 5, 6), points, device=device).shape == (0, 7)
    plane, point = torch.arange(20.0).reshape(4, 5), torch.tensor([4.0, 2.5])
    options = {"spacing": np.array([2.0, 1.0]), "origin": torch.tensor([0.0, 0.5]), "device": device}
    assert clvol.torch.sample(plane, point, "linear", **options).item() == 12


@pytest.mark.parametrize(
    ("change", "error", "rule"),
    [
        ({"values": np.ones((3, 3))}, OptionError, "values must be a tensor of float32 or float64; got float64"),
        (
            {"values": torch.ones(3, 3, dtype=torch.int32)},
            OptionError,
            "values must be a tensor of float32 or float64; got torch.int32",
        ),
        ({"points": torch.ones(3, 2, dtype=torch.float16)}, OptionError, "points must be a tensor of float32 or float64"),
        ({"points": torch.ones(3, 2, device="meta")}, OptionError, r"points must lie in the host's memory.*tensor\.cpu\(\)"),
        ({"points": torch.ones(3, 4)}, OptionError, r"points must have shape \(\.\.\., 2\) or \(\.\.\., 3\); got \(3, 4\)"),
        ({"points": torch.ones(())}, OptionError, "points must have shape"),
        ({"points": torch.ones(3, 3)}, OptionError, "values must have at least the 3 axes"),
        ({"filter": "hybrid"}, OptionError, "got the hybrid"),
        ({"filter": "bspline3(auto)"}, OptionError, "no volume decides on"),
        ({"boundary": "constant"}, OptionError, "extends coefficients"),
        ({"spacing": (1, 2, 3)}, ValueError, "spacing"),
        ({"spacing": "fine"}, OptionError, "spacing or origin must be a finite number; got 'fine'"),
        ({"fill": "none"}, OptionError, "fill must be a number or None; got 'none'"),
        ({"values": torch.full((3, 3), np.nan)}, DataError, "finite"),
    ],
    ids=lambda v: next(iter(v)) if isinstance(v, dict) else "",
)
def test_arguments_that_are_rejected(change: dict[str, Any], error: type[Exception], rule: str) -> None:
    arguments: dict[str, Any] = {"values": torch.ones(4, 5), "points": torch.ones(3, 2)} | change
    with pytest.raises(error, match=rule):
        clvol.torch.sample(**arguments)


def test_importing_needs_no_pytorch() -> None:
    code = "import clvol.torch, sys; assert 'torch' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_radiographs_are_differentiated_by_the_pose(device: Device) -> None:
    with clvol.Radiograph(clvol.phantoms.marschner_lobb(16), size=(12, 10), device=device) as radiograph:
        pose = torch.tensor([0.02, 0.0, -0.01, 0.02, 0.0, 0.01], dtype=torch.float64, requires_grad=True)
        weights = torch.linspace(0, 1, 120, dtype=torch.float64).reshape(10, 12)
        picture = clvol.torch.radiograph(pose, radiograph)
        (picture * weights).sum().backward()
        _, slopes = radiograph.gradient(pose.detach().numpy())
        assert_allclose(pose.grad, np.einsum("yx,yxk->k", weights.numpy(), slopes), rtol=1e-6)
        assert_allclose(clvol.torch.radiograph(pose.detach(), radiograph), picture.detach())
        with pytest.raises(OptionError, match="float32 or float64"):
            clvol.torch.radiograph(pose.detach().int(), radiograph)
