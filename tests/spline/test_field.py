"""The public API for sampling and resampling, of volumes and of a `Field`."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from typing import Any

import numpy as np
import pytest

from clvol import reference
from clvol.base.errors import ClvolError, DataError, DeviceError, OptionError
from clvol.device import Device
from clvol.filter.filter import Filter
from clvol.filter.make import bspline
from clvol.filter.table import as_filter, register_filter
from clvol.phantoms import marschner_lobb, marschner_lobb_function, marschner_lobb_gradient
from clvol.spline.evaluator import Evaluator, choose_evaluator
from clvol.spline.field import Field, as_field, magnify, prefilter, resample, sample
from clvol.volume.stored import Stored
from clvol.volume.volume import Volume
from tests.cases import DEGREES, RMSE

ROTATION = np.linalg.qr(np.random.default_rng(7).normal(size=(3, 3)))[0]


def random_volume(shape: tuple[int, ...] = (5, 6, 7)) -> Volume:
    d = len(shape)
    data = np.random.default_rng(0).normal(size=shape).astype(np.float32)
    return Volume(data, (0.7, 1.3, 2.1)[:d], (3.0, -5.0, 7.0)[:d], ROTATION if d == 3 else None, "mm")


# -- known facts at the start of the project ---------------------------------------------------------------

POINTS = np.random.default_rng(0).uniform(-0.8, 0.8, (200_000, 3))


@pytest.mark.one_in(2)
@pytest.mark.parametrize("name", RMSE)
def test_error_on_marschner_lobb(device: Device, name: str) -> None:
    got = sample(marschner_lobb(), POINTS, name, device=device)
    assert np.sqrt(np.mean((got - marschner_lobb_function(POINTS)) ** 2)) == pytest.approx(RMSE[name], rel=0.02)


@pytest.mark.parametrize("name", DEGREES)
def test_gradient_angle_on_marschner_lobb(device: Device, name: str) -> None:
    got, true = sample(marschner_lobb(), POINTS, name, derivative=1, device=device), marschner_lobb_gradient(POINTS)
    cosine = (got * true).sum(-1) / np.linalg.norm(got, axis=-1) / np.linalg.norm(true, axis=-1)
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean() == pytest.approx(DEGREES[name], abs=0.5)


# -- sampling ----------------------------------------------------------------------------------------------------


def test_shapes_and_kinds_of_points(device: Device) -> None:
    volume = random_volume()
    point = volume.center
    alone = sample(volume, point, device=device)
    assert alone.shape == ()
    for shape in ((0,), (3,), (2, 0, 4), (2, 3, 4)):
        many = np.broadcast_to(point, (*shape, 3))
        for derivative in (0, 1, 2):
            got = sample(volume, many, derivative=derivative, device=device)
            assert got.shape == shape + (3,) * derivative
            assert got.dtype == np.float32
    assert sample(volume, point.tolist(), device=device) == alone
    assert sample(volume, np.asfortranarray(np.tile(point, (5, 1))), device=device) == pytest.approx([float(alone)] * 5)
    for kind in (">f8", "f4", ">f4", "f2", "i4", ">i2", "u1", "?"):
        ones = np.ones((4, 3), kind)
        np.testing.assert_allclose(sample(volume, ones, device=device), sample(volume, [[1.0] * 3], device=device)[0], rtol=1e-5)


def test_array_has_spacing_1_and_origin_0(device: Device) -> None:
    data = np.arange(12.0).reshape(3, 4)
    assert sample(data, [[1, 2]], "linear", device=device).tolist() == [9]
    assert sample(data, [[1.5, 1.5]], "linear", device=device).tolist() == [7.5]
    assert sample(data, [[1.5, 1.5]], "linear", derivative=1, device=device).tolist() == [[1, 4]]


def test_hessian_is_symmetric_and_the_derivative_of_the_gradient(device: Device) -> None:
    volume, h = random_volume(), 1e-2
    points = volume.index_to_world(np.random.default_rng(1).uniform(0, 4, (50, 3)))
    hessian = sample(volume, points, "bspline5", derivative=2, device=device)
    np.testing.assert_allclose(hessian, hessian.swapaxes(1, 2), atol=1e-4)
    numeric = np.stack(
        [
            (
                sample(volume, points + h * e, "bspline5", derivative=1, device=device)
                - sample(volume, points - h * e, "bspline5", derivative=1, device=device)
            )
            / (2 * h)
            for e in np.eye(3)
        ],
        -1,
    )
    np.testing.assert_allclose(hessian, numeric, atol=0.01 * np.abs(hessian).max())


def test_fill_applies_only_outside_the_domain(device: Device) -> None:
    volume = Volume(np.ones((4, 5, 6)))
    points = [[-0.49, 0, 0], [-0.51, 0, 0], [5.49, 4.49, 3.49], [5.51, 4, 3], [0, 4.51, 0], [0, 0, -0.51], [np.nan, 0, 0]]
    got = sample(volume, points, "linear", fill=-7, device=device)
    np.testing.assert_allclose(got, [1, -7, 1, -7, -7, -7, np.nan])
    assert np.isnan(sample(volume, [[9.0, 9, 9]], fill=np.nan, device=device)).all()
    assert (sample(volume, [[9.0, 9, 9]], derivative=1, fill=3, device=device) == 3).all()


def test_progress_reaches_one(device: Device) -> None:
    seen: list[float] = []
    sample(np.ones((3, 3)), np.zeros((10, 2)), progress=seen.append, device=device)
    assert seen[-1] == 1
    seen.clear()
    resample(np.ones((3, 3)), (5, 5), progress=seen.append, device=device)
    assert seen[-1] == 1


def test_a_rotated_polynomial_is_reproduced(device: Device) -> None:
    """A cubic in world space, sampled on an oblique grid: the cubic spline reproduces it away from the edges."""

    def cubic(p: np.ndarray) -> np.ndarray:
        x, y, z = (p / 20).T
        return np.asarray(1 + x - 2 * y**2 + x * y * z + z**3 - 0.5 * x**2 * z).T

    grid = Volume(np.zeros((40, 40, 40)), (1.0, 0.8, 1.2), (1.0, 2.0, 3.0), ROTATION)
    z, y, x = np.indices(grid.shape)
    volume = Volume(cubic(grid.index_to_world(np.stack([x, y, z], -1))), grid.spacing, grid.origin, grid.direction)
    points = grid.index_to_world(np.random.default_rng(0).uniform(15, 24, (500, 3)))
    largest = np.abs(volume.data).max()
    np.testing.assert_allclose(sample(volume, points, device=device), cubic(points), rtol=0, atol=1e-5 * largest)
    assert np.abs(sample(volume, points, "mitchell", device=device) - cubic(points)).max() > 1e-4


@pytest.mark.usefixtures("own_table")
def test_registered_filter_runs(device: Device) -> None:
    register_filter(bspline(7))
    volume = random_volume()
    points = volume.index_to_world(np.random.default_rng(1).uniform(0, 4, (50, 3)))
    wanted = reference.sample(volume, points, "bspline7")
    np.testing.assert_allclose(
        sample(volume, points, "bspline7", device=device),
        wanted,
        rtol=0,
        atol=1e-6 * np.abs(reference.prefilter(volume.data, "bspline7")).max(),
    )


def test_threads_get_the_same_results(device: Device) -> None:
    volume = random_volume()
    points = volume.index_to_world(np.random.default_rng(1).uniform(0, 4, (20_000, 3)))
    wanted, wrong = sample(volume, points, device=device), []

    def work() -> None:
        for _ in range(5):
            if not np.array_equal(sample(volume, points, device=device), wanted):
                wrong.append(1)

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


# -- other grids -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["bspline3", "linear", "hybrid"])
@pytest.mark.parametrize("shape", [(5, 6, 7), (6, 7)])
def test_resample_and_magnify_match_the_reference(device: Device, shape: tuple[int, ...], name: str) -> None:
    volume, d = random_volume(shape), len(shape)
    like = Volume(np.zeros((4, 3, 5)[:d]), (1.1, 0.9, 1.7)[:d], (2.0, -4.0, 8.0)[:d], None, "cm")
    cases: list[dict[str, Any]] = [
        {"shape": (9, 4, 8)[:d]},
        {"shape": (1,) * d},
        {"spacing": (1.0, 0.8, 3.0)[:d]},
        {"spacing": 1.7},
        {"spacing": 100.0},
        {"like": like},
    ]
    largest = np.abs(reference.prefilter(volume.data, name)).max()
    for case in cases:
        got, wanted = (f(volume, filter=name, boundary="reflect", **case) for f in (resample, reference.resample))
        compare(got, wanted, 5e-6 * largest)
        assert got.units == ("cm" if "like" in case else "mm")
    for factor in (1, 2, 3):
        got, wanted = (f(volume, factor, name, "wrap") for f in (magnify, reference.magnify))
        compare(got, wanted, 5e-6 * largest)
        if name != "hybrid":
            every = (slice(None, None, factor),) * d
            np.testing.assert_allclose(got.data[every], volume.data, rtol=0, atol=5e-6 * largest)
    assert device is not None


def compare(got: Volume, wanted: Volume, atol: float) -> None:
    assert got.data.dtype == np.float32
    assert got.shape == wanted.shape
    np.testing.assert_allclose(got.spacing, wanted.spacing)
    np.testing.assert_allclose(got.origin, wanted.origin, atol=1e-12)
    np.testing.assert_allclose(got.direction, wanted.direction)
    np.testing.assert_allclose(got.data, wanted.data, rtol=0, atol=atol)


def test_resample_keeps_the_domain(device: Device) -> None:
    volume = random_volume()
    np.testing.assert_allclose(resample(volume, (10, 3, 14), device=device).corners, volume.corners)
    coarse = resample(volume, spacing=1.0, device=device)
    np.testing.assert_allclose(coarse.center, volume.center)
    assert coarse.spacing == (1, 1, 1)


def test_resample_fills(device: Device) -> None:
    like = Volume(np.zeros((3, 3)), origin=(-2.0, 0.0))
    assert resample(np.ones((3, 3)), like=like, filter="linear", fill=9, device=device).data.tolist() == [[9, 9, 1]] * 3


# -- which path ----------------------------------------------------------------------------------------------------


def test_choice_of_path(device: Device) -> None:
    cubic, mitchell = as_filter("bspline3"), as_filter("mitchell")

    def chosen(row: Filter, evaluator: Any = "auto", fetch: Any = "auto", *, double: bool = False) -> Evaluator:
        with device.limited(evaluator=evaluator, fetch=fetch):
            return choose_evaluator(device, row, double=double)

    assert chosen(cubic, "taps", "buffer") == Evaluator(False, False)
    for name in ("paired", "eight-fetch"):
        assert chosen(cubic, name, "buffer") == Evaluator(True, False)
    assert chosen(mitchell, "paired", "buffer") == Evaluator(False, False)  # its weights change sign
    assert chosen(cubic, double=True) == Evaluator(False, False)
    if device.kind == "cpu":
        assert chosen(cubic) == Evaluator(False, False)
    if device.has_images:
        assert chosen(cubic, "taps", "image") == Evaluator(False, True)
        assert str(Evaluator(True, True)) == "paired from an image"
    for evaluator, fetch in (("none", "auto"), ("auto", "none"), (None, "auto")):
        with pytest.raises(OptionError, match="must be one of auto"):
            chosen(cubic, evaluator, fetch)
    with pytest.raises(OptionError, match="images hold float32"):
        chosen(cubic, fetch="image", double=True)


def test_sampler_is_measured(device: Device) -> None:
    if not device.has_images:
        assert device.sampler_bits == 0
        return
    if device.is_pocl:
        assert device.sampler_bits > 20


# -- bad input -----------------------------------------------------------------------------------------------------

GOOD = np.ones((3, 4))
BAD_SAMPLE: list[tuple[dict[str, Any], type[ClvolError]]] = [
    ({"points": [[1.0, 2.0, 3.0]]}, OptionError),
    ({"points": 3.0}, OptionError),
    ({"points": []}, OptionError),
    ({"points": [["a", "b"]]}, OptionError),
    ({"points": [[1j, 1]]}, OptionError),
    ({"derivative": 3}, OptionError),
    ({"derivative": -1}, OptionError),
    ({"derivative": None}, OptionError),
    ({"filter": "none"}, OptionError),
    ({"filter": 3}, OptionError),
    ({"boundary": "none"}, OptionError),
    ({"device": "none"}, OptionError),
    ({"volume": np.ones(3)}, DataError),
    ({"volume": np.ones((1, 1, 1, 1))}, DataError),
    ({"volume": []}, DataError),
    ({"volume": np.ones((0, 3))}, DataError),
    ({"volume": [["a"]]}, DataError),
    ({"volume": [[np.nan]]}, DataError),
    ({"volume": [[np.inf]]}, DataError),
    ({"volume": [[1j]]}, DataError),
]


@pytest.mark.parametrize(("change", "error"), BAD_SAMPLE, ids=[str(c)[:40] for c, _ in BAD_SAMPLE])
def test_bad_input_of_sample(device: Device, change: dict[str, Any], error: type[ClvolError]) -> None:
    with pytest.raises(error):
        sample(**{"volume": GOOD, "points": [[1.0, 2.0]], "device": device, **change})


BAD_RESAMPLE: list[dict[str, Any]] = [
    {},
    {"shape": (2, 2), "spacing": 1},
    {"shape": (2,)},
    {"shape": (2, 2, 2)},
    {"shape": (0, 2)},
    {"shape": (2, -1)},
    {"shape": (2.5, 2)},
    {"shape": 3},
    {"shape": "ab"},
    {"spacing": 0},
    {"spacing": -1.0},
    {"spacing": np.nan},
    {"spacing": (1, 1, 1)},
    {"spacing": "a"},
    {"spacing": 1e-12},
    {"like": Volume(np.ones((2, 2, 2)))},
    {"like": np.ones((2, 3, 4))},
    {"shape": (2, 2), "filter": "none"},
    {"shape": (2, 2), "boundary": 3},
]


@pytest.mark.parametrize("case", BAD_RESAMPLE, ids=[str(c)[:40] for c in BAD_RESAMPLE])
def test_bad_input_of_resample(device: Device, case: dict[str, Any]) -> None:
    with pytest.raises(OptionError):
        resample(GOOD, device=device, **case)


def test_an_excessive_grid_is_rejected_before_allocation(device: Device) -> None:
    with pytest.raises(DeviceError, match="MiB"):
        resample(GOOD, (2**20, 2**20), device=device)


def test_bad_input_of_magnify(device: Device) -> None:
    for factor in (0, -1, 1.5, "2", None, True):
        with pytest.raises(OptionError, match="factor must be"):
            magnify(GOOD, factor, device=device)  # type: ignore[arg-type]


def test_nan_is_detected_and_located(device: Device) -> None:
    data = np.ones((3, 4, 5))
    data[1, 2, 3] = np.nan
    with pytest.raises(DataError, match=r"1 NaN and 0 infinite, the first at index \[1, 2, 3\]"):
        sample(data, [[0.0, 0, 0]], device=device)
    assert sample(Volume(data).filled(1), [[0.0, 0, 0]], device=device) == pytest.approx([1], abs=1e-6)


# -- without OpenCL ------------------------------------------------------------------------------------------------

WITHOUT_OPENCL = """
import sys
sys.modules["pyopencl"] = None  # importing it raises ImportError
import numpy as np
import clvol, clvol.filter.filter, clvol.filter.boundary, clvol.filter.response
import clvol.volume.volume, clvol.reference, clvol.phantoms
from clvol import reference
volume = clvol.phantoms.marschner_lobb(9)
assert clvol.filters()["bspline3"].order == 4
assert clvol.filter.response.frequency_response("hybrid", 0.0) == 1
assert reference.sample(volume, [[0.0, 0, 0]]).shape == (1,)
assert reference.prefilter(volume.data).shape == (9, 9, 9)
assert clvol.filter.boundary.as_boundary("wrap").index(-1, 5) == 4
for call in (lambda: clvol.sample(volume, [[0.0, 0, 0]]), lambda: clvol.prefilter([1.0])):
    try:
        call()
    except clvol.base.errors.DeviceError as error:
        assert "pyopencl cannot be imported" in str(error), error
    else:
        raise SystemExit("no DeviceError")
print("fine")
"""


def test_everything_but_the_device_works_without_pyopencl() -> None:
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_OPENCL], capture_output=True, text=True, timeout=120, check=False, env={**os.environ}
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "fine"


def test_prefilter_preserves_ones(device: Device) -> None:
    for rule in ("mirror", "reflect", "wrap"):
        np.testing.assert_allclose(prefilter(np.ones((4, 5, 6)), boundary=rule, device=device), 1, atol=1e-6)


# -- regressions -----------------------------------------------------------------------------------------


def test_prefilter_of_volumes_and_images(device: Device) -> None:
    data = random_volume().data
    want = prefilter(data, device=device)
    np.testing.assert_array_equal(prefilter(random_volume(), device=device), want)
    sitk = pytest.importorskip("SimpleITK")
    np.testing.assert_array_equal(prefilter(sitk.GetImageFromArray(data), device=device), want)
    nibabel = pytest.importorskip("nibabel")
    np.testing.assert_array_equal(prefilter(nibabel.Nifti1Image(data.T, np.eye(4)), device=device), want)


@pytest.mark.one_in(3)
@pytest.mark.parametrize("filter", ["bspline3", "sinc(8)", "hybrid"])
def test_launches_are_short_and_do_not_affect_results(device: Device, filter: str) -> None:
    """Grids and points are the same however few points a launch takes."""
    image, volume = random_volume((9, 11)), random_volume()
    points = np.random.default_rng(0).uniform(0, 4, (3000, 3))
    want = (
        resample(image, (40, 70), filter=filter, device=device).data,
        resample(volume, (12, 13, 40), filter=filter, device=device).data,
        sample(volume, points, filter, device=device),
    )
    done: list[float] = []
    with device.limited(launch_taps=1):
        got = resample(image, (40, 70), filter=filter, device=device, progress=done.append)
        np.testing.assert_array_equal(got.data, want[0])
        assert len(done) >= 3
        assert done[-1] == 1
        np.testing.assert_array_equal(resample(volume, (12, 13, 40), filter=filter, device=device).data, want[1])
        np.testing.assert_array_equal(sample(volume, points, filter, device=device), want[2])


@pytest.mark.parametrize(
    "bad", [{"derivative": 1.5}, {"derivative": None}, {"fill": "a"}, {"fill": [1, 2]}, {"points": [[1], [2, 3]]}]
)
def test_arguments_of_wrong_types(device: Device, bad: dict[str, Any]) -> None:
    with pytest.raises(OptionError):
        sample(**{"volume": random_volume(), "points": [[0, 0, 0]], "device": device, **bad})


def test_fill_with_nan(device: Device) -> None:
    assert np.isnan(sample(random_volume(), [[1e3, 0, 0]], fill=np.nan, device=device)).all()


def test_resample_of_a_colour_image_names_the_right_function() -> None:
    for channels in (3, 4):
        with pytest.raises(OptionError, match=r"3 whole numbers.*got \(16, 16\): .* there is clvol\.images\.resample"):
            resample(np.zeros((8, 8, channels)), shape=(16, 16))
    with pytest.raises(OptionError, match=r"shape must be 3 whole numbers of at least 1; got \(16, 16\)$"):
        resample(np.zeros((8, 8, 8)), shape=(16, 16))


# -- Field ---------------------------------------------------------------------------------------------------------

FIELD_SHAPES = [(5, 6, 7), (6, 7), (1, 1, 1), (1, 1)]


@pytest.mark.one_in(12)
@pytest.mark.parametrize("name", ["bspline3", "hybrid", "mitchell"])
@pytest.mark.parametrize("shape", FIELD_SHAPES)
def test_a_field_matches_the_functions_and_the_reference(device: Device, shape: tuple[int, ...], name: str) -> None:
    volume, d = random_volume(shape), len(shape)
    points = volume.index_to_world(np.random.default_rng(1).uniform(-1, 6.3, (4, 25, d)))
    largest = np.abs(reference.prefilter(volume.data, name, "reflect")).max()
    with Field(volume, name, "reflect", device) as field:
        for derivative, at in enumerate((field, field.gradient, field.hessian)):
            got = at(points)
            assert got.shape == (4, 25) + (d,) * derivative
            np.testing.assert_array_equal(got, sample(volume, points, name, "reflect", derivative, device=device))
            np.testing.assert_array_equal(got, sample(field, points, derivative=derivative))
            wanted = reference.sample(volume, points, name, "reflect", derivative)
            np.testing.assert_allclose(got, wanted, rtol=0, atol=2e-5 * largest / 0.7**derivative)
            with device.limited(evaluator="paired"):
                paired = at(points)
            with device.limited(evaluator="eight-fetch"):
                np.testing.assert_array_equal(at(points), paired)
        size = (9, 4, 8)[:d]
        for ours, theirs in (
            (field.resample(size), resample(volume, size, filter=name, boundary="reflect", device=device)),
            (resample(field, spacing=1.3), resample(volume, spacing=1.3, filter=name, boundary="reflect", device=device)),
            (field.magnify(3), magnify(volume, 3, name, "reflect", device=device)),
            (magnify(field), magnify(volume, 2, name, "reflect", device=device)),
        ):
            compare(ours, theirs, 0)


def test_a_field_keeps_its_coefficients(device: Device) -> None:
    volume = random_volume()
    points = volume.index_to_world(np.random.default_rng(1).uniform(-1, 6, (30, 3)))
    field = Field(volume, "bspline5", "wrap", device)
    held, buffer = field.coefficients, field.coefficients.buffer
    for call in (field, field.gradient, field.hessian, lambda p: sample(field, p), lambda _: field.magnify(2)):
        call(points)
        assert field.coefficients is held
        assert held.buffer is buffer
    assert (field.volume, field.filter.name, field.boundary.name) == (volume, "bspline5", "wrap")
    assert field.device is device
    assert field.nbytes >= 4 * volume.data.size
    assert "5 × 6 × 7" in repr(field)
    assert "bspline5, wrap" in repr(field)
    field.close()


def test_a_closed_field_is_an_error(device: Device) -> None:
    volume = random_volume()
    field = Field(volume, device=device)
    values = field([[1.0, 2, 3]])
    field.close()
    field.close()
    assert values.shape == (1,)
    assert (field.closed, field.nbytes) == (True, 0)
    assert "closed" in repr(field)
    calls = (field, field.gradient, field.hessian, lambda p: sample(field, p), lambda _: field.magnify(2))
    for call in (*calls, lambda _: field.resample((2, 2, 2))):
        with pytest.raises(OptionError, match="its coefficients were released; make a new one"):
            call([[1.0, 2, 3]])


def test_a_field_rejects_other_settings(device: Device) -> None:
    with Field(random_volume(), "bspline2", "reflect", device) as field:
        assert as_field(field) is field
        assert as_field(field, "bspline2", "reflect", device) is field
        assert as_field(field, as_filter("bspline2")) is field
        for other in ({"filter": "linear"}, {"boundary": "wrap"}, {"filter": bspline(3)}):
            with pytest.raises(OptionError, match=f"the field was made with {next(iter(other))} '"):
                sample(field, [[0.0, 0, 0]], **other)
            with pytest.raises(OptionError, match="or make another Field"):
                magnify(field, 2, **other)
        with pytest.raises(OptionError):
            resample(field, (2, 2, 2), filter="none")
        assert not field.closed


def test_fields_of_invalid_samples_are_rejected(device: Device) -> None:
    for bad in ([[np.nan, 1.0]], [[np.inf, 1.0]], [[1j]], [], np.ones(3)):
        with pytest.raises(DataError):
            Field(bad, device=device)
    for options in ({"filter": "none"}, {"boundary": "none"}, {"device": "none"}):
        with pytest.raises(OptionError):
            Field(GOOD, **{"device": device, **options})


@pytest.mark.parametrize("dtype", [">f4", ">f8", "<i2", ">u2", "u1", "?"])
def test_fields_of_any_dtype(device: Device, dtype: str) -> None:
    data = np.random.default_rng(0).integers(0, 2 if dtype == "?" else 100, (4, 5, 6)).astype(dtype)
    data.setflags(write=False)
    with Field(data, device=device) as field:
        wanted = sample(data.astype(np.float32), [[1.3, 2.1, 0.4]], device=device)
        np.testing.assert_array_equal(field([[1.3, 2.1, 0.4]]), wanted)
        np.testing.assert_array_equal(field(np.array([[1.3, 2.1, 0.4]], ">f8")), wanted)


def test_threads_share_a_field(device: Device) -> None:
    volume = random_volume()
    points = volume.index_to_world(np.random.default_rng(1).uniform(0, 4, (20_000, 3)))
    wrong = []
    with Field(volume, device=device) as field:
        wanted = field(points)

        def work() -> None:
            wrong.extend(1 for _ in range(5) if not np.array_equal(field(points), wanted))

        threads = [threading.Thread(target=work) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert not wrong


def test_rows_are_padded_with_zeros(device: Device) -> None:
    """Vectors read past the last row: the padding is zero, whatever the memory contained."""
    with Field(random_volume(), device=device) as field:
        stored = np.full(field.nbytes // 4, np.nan, np.float32)
        device.buffers.download(field.coefficients.buffer, stored)
        assert not stored[-8:].any()


def test_unscaled_samples_are_copied_at_once(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """One NumPy call for a volume of any layout, not slice by slice through the conversion."""
    data = np.random.default_rng(8).random((5, 6, 7))
    want = prefilter(data, "linear", device=device)
    monkeypatch.setattr(Stored, "samples", lambda *_: pytest.fail("samples were mapped one slice at a time"))
    for layout in (np.asfortranarray(data), np.repeat(data, 2, 0)[::2], data.astype(">f8"), data[:, ::-1][:, ::-1]):
        np.testing.assert_array_equal(prefilter(layout, "linear", device=device), want)


def test_an_unknown_keyword_is_answered_with_the_option_that_it_resembles() -> None:
    volume = np.zeros((2, 2, 2), np.float32)
    with pytest.raises(TypeError, match=r"unexpected keyword argument 'bondary'.*[Dd]id you mean '?boundary'?"):
        Field(volume, bondary="wrap")  # type: ignore[call-arg]  # that is the question
    with pytest.raises(TypeError, match=r"unexpected keyword argument 'shap'.*[Dd]id you mean '?shape'?"):
        resample(volume, shap=(3, 3, 3))  # type: ignore[call-arg]  # that is the question


def test_another_option_of_the_same_name_is_said_to_be_another(device: Device) -> None:
    """ "made with device 'X', which cannot be changed to 'X'" told nothing."""
    with Field(random_volume(), as_filter("linear"), device=device) as field:
        for what, other in (("device", Device(device.handle)), ("filter", Filter("linear", ((1.0,),)))):
            with pytest.raises(
                OptionError, match=f"made with {what} '(.*)', which cannot be changed to another {what} of that name;"
            ):
                as_field(field, **{what: other})
        with pytest.raises(OptionError, match="cannot be changed to 'bspline3'"):
            as_field(field, "bspline3")
