"""ITK as the truth: values from its own tests, and SimpleITK. ITK's boundary rule is "mirror"."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import clvol
from clvol.device import Device

TOLERANCE = 1e-6  # of the range of the samples
Array = NDArray[np.float64]

# -- itkBSplineInterpolateImageFunctionTest: data given by formulas, positions (x, y, z) in samples, and what ITK expects ----------


def degrees(first: int) -> list[str]:
    return ["nearest", "linear", "bspline2", "bspline3", "bspline4", "bspline5"][first:]


def table(rows: list[tuple[tuple[float, ...], tuple[Any, ...]]], first: int) -> list[Any]:
    """A test for each filter: positions, and the expected values, one per filter from degree `first`."""
    points = [point for point, _ in rows]
    return [pytest.param(name, points, [row[k] for _, row in rows], id=name) for k, name in enumerate(degrees(first))]


def check(device: Device, data: Array, name: str, points: Any, truth: Any, derivative: int = 0, within: float = TOLERANCE) -> None:
    got = clvol.sample(data, points, name, "mirror", derivative, device=device)
    np.testing.assert_allclose(got, truth, rtol=0, atol=within * np.ptp(data))


def test_a_line(device: Device) -> None:
    """36 samples of a cubic polynomial, as an image of one row."""
    i = np.arange(36.0)
    line = 454 - 84.6 * i + 5.2 * i * (i - 1) - 0.1 * i * (i - 1) * (i - 2)
    truth = {1.4: 334.41265437584, 8.9: 18.158173426944, 10.0: 4.0, -0.3: 442.24157192006658}
    check(device, line[None], "bspline3", [(x, 0) for x in truth], list(truth.values()))


PLANE = [
    ((0.1, 0.2), (154.5, 140.14, 151.86429192392, 151.650316034, 151.865916515, 151.882483111)),
    ((3.4, 5.8), (0, 13.84, 22.688125812495, 22.411473093, 22.606968306, 22.908345604)),
    ((4.0, 6.0), (36.2,) * 6),
]


@pytest.mark.parametrize(("name", "points", "truth"), table(PLANE, 0))
def test_an_image(device: Device, name: str, points: Any, truth: Any) -> None:
    data = np.outer([10.3, 7.8, 1.2, -8, -18.3, -28.2, -36.2], [15, 8, 3, 0, -1, 0, 3])
    check(device, data, name, points, truth)


RAMP = [
    ((0.1, 20.1, 28.4), (48.621593795, 48.651173138, 48.656914878, 48.662256571)),
    ((21.58, 34.5, 17.2), (73.280126903, 73.280816965, 73.282780615, 73.285315943)),
    ((10, 20, 12), (42.0,) * 4),
    ((2, 0.3, -0.3), (2.2545584407825165, 2.2722384004239382, 2.2533523347849744, 2.2516795363567588)),
]


@pytest.mark.parametrize("kind", [np.float64, np.uint32])
@pytest.mark.parametrize(("name", "points", "truth"), table(RAMP, 2))
def test_a_volume(device: Device, name: str, points: Any, truth: Any, kind: type) -> None:
    """x + y + z: near the faces "mirror" bends the ramp."""
    data = np.indices((30, 40, 80)).sum(axis=0).astype(kind)
    check(device, data, name, points, truth)


SLOPES = [
    ((25.3, 26.8, 24.5), ((19.345, 5, -24), (19.399, 5, -24), (19.4164, 5, -24), (19.4223, 5, -24))),
    ((21.0, 1.4, 0.6), ((0.875, 4.8873, 98.6607), (0.9, 4.95411, 92.9006), (0.9, 4.9925, 94.5082), (0.900157, 5.0544, 93.8607))),
    ((18, 31, 10), ((-7.525, 5, 34), (-7.2, 5, 33.9999), (-7.2, 5.00044, 33.9976), (-7.19929, 5.00189, 33.9879))),
]


@pytest.mark.one_in(2)
@pytest.mark.parametrize(("name", "points", "truth"), table(SLOPES, 2))
def test_derivatives(device: Device, name: str, points: Any, truth: Any) -> None:
    z, y, x = np.indices((41, 41, 41)) - 20.0
    data = 0.1 * x**4 - 0.5 * x**3 + 2 * x - 43 + 5 * y + 7 - 2 * z**2 - 6 * z + 10
    check(device, data, name, points, truth, derivative=1)


# -- SimpleITK beside clvol ------------------------------------------------------------------------------------------------------


def random_volume(seed: int) -> clvol.Volume:
    dice = np.random.default_rng(seed)
    turn = Rotation.random(random_state=seed).as_matrix()
    return clvol.Volume(dice.normal(100, 50, (19, 24, 21)), (0.7, 1.1, 2.3), (-30, 12, 55), turn, "mm")


def as_image(volume: clvol.Volume) -> Any:
    sitk = pytest.importorskip("SimpleITK")
    image = sitk.GetImageFromArray(np.asarray(volume.data, np.float64))
    image.SetSpacing(volume.spacing)
    image.SetOrigin(volume.origin)
    image.SetDirection(volume.direction.ravel().tolist())
    return image


FILTERS = {"linear": "sitkLinear", "bspline3": "sitkBSpline", **{f"bspline{n}": f"sitkBSpline{n}" for n in (2, 4, 5)}}


@pytest.mark.one_in(6)
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("name", FILTERS)
def test_resampling_onto_a_rotated_grid(device: Device, name: str, seed: int) -> None:
    """Where ITK has a value: in the domain up to the faces, half a voxel past the outer samples, where ITK clamps "linear"."""
    sitk = pytest.importorskip("SimpleITK")
    if not hasattr(sitk, FILTERS[name]):
        pytest.skip(f"this SimpleITK has no {FILTERS[name]}")
    volume, dice = random_volume(seed), np.random.default_rng(100 + seed)
    turn = Rotation.random(random_state=100 + seed).as_matrix()
    middle = volume.center - turn @ (np.array([25, 26, 27]) * 0.9 / 2)
    grid = clvol.Volume(np.zeros((28, 27, 26)), (0.9, 0.9, 0.9), middle + dice.normal(0, 2, 3), turn)
    ours = clvol.resample(volume, like=grid, filter=name, boundary="mirror", device=device).data
    theirs = sitk.GetArrayFromImage(
        sitk.Resample(as_image(volume), as_image(grid), sitk.Transform(), getattr(sitk, FILTERS[name]), 0.0, sitk.sitkFloat64)
    )
    places = volume.world_to_index(grid.index_to_world(np.moveaxis(np.indices(grid.shape)[::-1], 0, -1)))
    margin = 0.0 if name == "linear" else 0.5 - 1e-6
    inside = ((places >= -margin) & (places <= np.array(volume.size) - 1 + margin)).all(axis=-1)
    assert inside.sum() > 5000
    within = 2 * TOLERANCE if name == "bspline5" else TOLERANCE  # its coefficients reach far past the range of noise
    assert np.abs(ours - theirs)[inside].max() <= within * np.ptp(volume.data)


@pytest.mark.parametrize("degree", [2, 3, 4, 5])
def test_coefficients(device: Device, degree: int) -> None:
    sitk = pytest.importorskip("SimpleITK")
    volume = random_volume(9)
    theirs = sitk.GetArrayFromImage(sitk.BSplineDecomposition(as_image(volume), degree))
    ours = clvol.prefilter(volume, f"bspline{degree}", "mirror", device)
    assert np.abs(ours - theirs).max() <= TOLERANCE * np.ptp(theirs)
