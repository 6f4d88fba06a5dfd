"""The xarray accessor, compared with xarray's own linear interpolation and SciPy's splines."""

from __future__ import annotations

import tracemalloc
from datetime import timedelta
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray
from scipy import ndimage
from scipy.interpolate import make_interp_spline

from clvol.base.errors import DataError, GeometryError, OptionError

xarray = pytest.importorskip("xarray")
pytest.importorskip("clvol.xarray")  # it registers the accessor

Array = NDArray[Any]
SAME: dict[str, Any] = {"rtol": 0, "atol": 1e-12}


def cube() -> Any:
    """Time, descending latitude and longitude, with auxiliary coordinates."""
    rng = np.random.default_rng(0)
    coords = {
        "t": np.arange(4.0),
        "y": 8 - 2 * np.arange(5.0),
        "x": 3 + 0.1 * np.arange(6.0),
        "area": (("y", "x"), rng.random((5, 6)), {"units": "m2"}),
        "name": ("t", list("abcd")),
        "number": ("x", np.arange(6)),
    }
    return xarray.DataArray(rng.random((4, 5, 6)), coords, ("t", "y", "x"), "depth", {"units": "m"})


def along(dims: Any, *values: Any, **coords: Any) -> Any:
    return xarray.DataArray(np.squeeze(values), coords, dims)


RNG = np.random.default_rng(1)
INDEXERS: dict[str, dict[str, Any]] = {
    "a grid along one": {"x": [3.05, 3.2, 9.0]},
    "a number": {"x": 3.123},
    "numbers": {"x": 3.123, "y": 1.0, "t": 0.5},
    "a grid along all": {"t": [0, 2.5], "y": [3, 1, 0.5], "x": [3.3]},
    "a tuple": {"x": ("station", [3.1, 3.2])},
    "points": {"x": along("z", [3.1, 3.22, 3.4]), "y": along("z", [0.5, 1, 2])},
    "points with coordinates": {"x": along("z", [3.1, 3.22], z=[5, 6]), "y": along("z", [0.5, 1], z=[5, 6])},
    "points and a grid": {"x": along("z", [3.1, 3.22]), "y": along("z", [0.5, 1]), "t": [1.5, 2.5]},
    "two axes for one": {"x": xarray.DataArray(3 + 0.4 * RNG.random((2, 3)), {"a": [10, 20]}, ("a", "b")), "t": 1.5},
    "along a dimension of the array": {"x": along("t", [3.05, 3.1, 3.2, 3.3])},
    "a chain": {
        "x": along("z", [3.1, 3.3]),
        "y": along("w", [0.5, 1, 4]),
        "t": xarray.DataArray(RNG.random((2, 3)), dims=("z", "w")),
    },
    "out of range": {"x": [2.9, 3, 3.5, 3.6, np.nan], "y": [-0.1, 0, 8, 8.1]},
}


@pytest.mark.parametrize("name", INDEXERS)
@pytest.mark.parametrize("lazy", [False, True], ids=["in memory", "dask"])
def test_linear_interpolation_matches_xarray(name: str, lazy: bool) -> None:
    data, indexers = cube(), INDEXERS[name]
    expected = data.interp(indexers)
    if lazy:
        pytest.importorskip("dask.array")
        data = data.drop_vars("name").chunk({"t": 3, "y": 2, "x": 4})
    got = data.clvol.interp(indexers, filter="linear")
    assert (got.dims, got.name, got.attrs, got.dtype) == (expected.dims, "depth", {"units": "m"}, np.float64)
    assert_allclose(got.values, expected.values, **SAME)
    if not lazy:
        xarray.testing.assert_identical(got.coords.to_dataset(), expected.coords.to_dataset())


def scipy_spline(data: Array, at: Any, order: int, mode: str) -> Array:
    """SciPy's spline; "reflect" by padding, for SciPy's own is inaccurate on short axes."""
    pad = 60 if mode == "reflect" else 0
    return np.asarray(ndimage.map_coordinates(np.pad(data, pad, "symmetric"), np.add(at, pad), order=order, mode=mode))


@pytest.mark.one_in(4)
@pytest.mark.parametrize(
    ("boundary", "mode"), [("mirror", "mirror"), ("reflect", "reflect"), ("wrap", "grid-wrap"), ("nearest", "nearest")]
)
@pytest.mark.parametrize(("name", "order"), [("linear", 1), ("bspline2", 2), ("bspline3", 3), ("bspline4", 4), ("bspline5", 5)])
def test_splines_match_scipy(name: str, order: int, boundary: str, mode: str) -> None:
    data = cube()
    y, x = [7.5, 0.3], [3.03, 3.21, 3.47]
    at = np.meshgrid((8 - np.array(y)) / 2, (np.array(x) - 3) / 0.1, indexing="ij")
    expected = [scipy_spline(frame, at, order, mode) for frame in data.values]
    assert_allclose(data.clvol.interp(y=y, x=x, filter=name, boundary=boundary).values, expected, **SAME)
    points = data.clvol.interp(y=along("p", [7.5, 0.3, 4]), x=along("p", x), filter=name, boundary=boundary)
    there = np.array([[0.25, 3.85, 2], (np.array(x) - 3) / 0.1])
    assert_allclose(points.values, [scipy_spline(frame, there, order, mode) for frame in data.values], **SAME)


def test_beyond_the_outer_samples() -> None:
    data = cube()
    assert np.isnan(data.clvol.interp(x=[2.99, 3.51]).values).all()
    assert (data.clvol.interp(x=[2.99, 3.51], fill=-1).values == -1).all()
    expected = ndimage.map_coordinates(data.values[0, 0], [[-3.0, 9.5]], order=3, mode="mirror")
    assert_allclose(data[0, 0].clvol.interp(x=[2.7, 3.95], fill=None).values, expected, **SAME)
    expected = ndimage.map_coordinates(data.values[0, 0], [[-3.0, 9.5]], order=3, mode="grid-wrap")
    assert_allclose(data[0, 0].clvol.interp(x=[2.7, 3.95], boundary="wrap", fill=None).values, expected, **SAME)
    assert_allclose(data.clvol.interp(x=data.x, y=data.y).values, data.values, **SAME)


def test_datetimes() -> None:
    t = np.datetime64("2001-01-01", "ns") + np.arange(12) * np.timedelta64(6, "h")
    values = np.random.default_rng(0).random(12)
    data = xarray.DataArray(values, {"time": t}, "time")
    expected = ndimage.map_coordinates(values, [[1.5, 7 + 1 / 6]], order=3, mode="mirror")
    texts = ["2001-01-01T09", "2001-01-02T19"]
    for new in (texts, np.array(texts, "M8[s]"), xarray.DataArray(np.array(texts, "M8[ns]"), dims="time")):
        got = data.clvol.interp(time=new)
        assert_allclose(got.values, expected, **SAME)
        assert_array_equal(got.time.values, np.array(texts, "M8[ns]"))
    assert_allclose(
        data.interp(time=np.array(texts, "M8[ns]")).values, data.clvol.interp(time=texts, filter="linear").values, **SAME
    )
    for step in (np.timedelta64(3, "h"), timedelta(hours=3)):
        finer = data.clvol.regrid(spacing={"time": step})
        assert finer.time.values[0] == np.datetime64("2000-12-31T22:30")
        assert finer.sizes["time"] == 24
    with pytest.raises(OptionError, match=r"spacing along 'time' must be a timedelta, .*; got 3$"):
        data.clvol.regrid(spacing={"time": 3})
    with pytest.raises(OptionError, match="'time' must be datetimes"):
        data.clvol.interp(time=["noon"])
    with pytest.raises(OptionError, match="'x' must be numbers"):
        cube().clvol.interp(x=["noon"])
    away = data.assign_coords(time=t - t[0])
    assert_allclose(away.clvol.interp(time=[np.timedelta64(9, "h"), np.timedelta64(43, "h")]).values, expected, **SAME)


def test_coordinates_of_float32_are_uniform_enough() -> None:
    lon = np.arange(0, 360, 0.25, dtype=np.float32)[:40] + np.float32(300.1)
    values = np.random.default_rng(0).random(40)
    data = xarray.DataArray(values, {"lon": lon}, "lon")
    assert_allclose(data.clvol.interp(lon=lon).values, values, **SAME)
    assert_allclose(data.clvol.interp(lon=lon[1:] - 0.1, filter="linear"), data.interp(lon=lon[1:] - 0.1), **SAME)


def test_coordinates_that_are_rejected() -> None:
    data = cube()
    for values, rule in (
        ([3, 3, 3, 3, 3, 3], "'x' must ascend or descend"),
        ([3, 4, 5, np.nan, 7, 8], "'x' must ascend or descend"),
        ([3, 4, 5, 4.5, 7, 8], "'x' must ascend or descend"),
        (list("abcdef"), "'x' must be numbers or datetime64; got dtype <U1"),
    ):
        with pytest.raises(GeometryError, match=rule):
            data.assign_coords(x=values).clvol.interp(x=[3.2])
    uneven = data.assign_coords(x=[3, 3.1, 3.2, 3.3, 3.4, 3.51])
    with pytest.raises(GeometryError, match=r"'x' must be uniform for regrid, .*; it is off by up to 0\.\d+ steps: give new"):
        uneven.clvol.regrid({"x": 4})
    with pytest.raises(OptionError, match=r"boundary is of dimensions with uniform coordinates, and x are uneven.*'wrap'"):
        uneven.clvol.interp(x=3.2, boundary="wrap")


def test_arguments_that_are_rejected() -> None:
    data = cube()
    four = data.expand_dims(w=np.arange(5.0))
    for call, rule in (
        (lambda: data.clvol.interp(q=1), "dimension .* must be one of t, y, x; got 'q'"),
        (lambda: data.clvol.interp(x=3.1, filter="mitchell"), "filter must be one of .*bspline3.*; got 'mitchell'"),
        (lambda: data.clvol.interp(x=3.1, boundary="zero"), "boundary must be one of mirror, reflect, wrap, nearest; got 'zero'"),
        (lambda: data.clvol.interp(x=3.1, precision="half"), "precision must be one of single, double; got 'half'"),
        (lambda: data.clvol.interp(x=3.1, nan="skip"), "nan must be one of propagate, error, local; got 'skip'"),
        (lambda: data.chunk().clvol.interp(x=3.1, nan="local"), 'for an array of dask, .*; got "local"'),
        (lambda: data.clvol.interp({"x": 3.1}, y=2), "as a mapping or as keywords, not both"),
        (lambda: data.clvol.interp("x"), "coords must be a mapping from dimensions to coordinates; got 'x'"),
        (lambda: data.clvol.interp(x=3.1, fill="extrapolate"), "fill must be a number or None; got 'extrapolate'"),
        (lambda: data.clvol.interp(x=[[3.1]]), r"'x' with several axes must be a DataArray.*\(1, 1\)"),
        (lambda: data.clvol.interp(x=np.nan, fill=None), "must be finite where fill is None"),
        (lambda: data.clvol.regrid(), "exactly one of shape and spacing"),
        (lambda: data.clvol.regrid([4]), "each a mapping from dimensions"),
        (lambda: data.clvol.regrid({"x": 4}, {"x": 4}), "exactly one of shape and spacing"),
        (lambda: data.clvol.regrid({"x": 0}), "shape along 'x' must be a whole number"),
        (lambda: data.clvol.regrid(spacing={"x": -1}), "spacing along 'x' must be a finite number, greater than 0"),
        (lambda: four.clvol.interp({d: along("p", [1.0, 2.0]) for d in four.dims}), "at most 3 dimensions; got w, t, y, x"),
    ):
        with pytest.raises(OptionError, match=rule):
            call()
    with pytest.raises(DataError, match="samples must be numbers; got dtype bool"):
        (data > 0.5).clvol.interp(x=3.1)


def test_missing_samples_matter_only_nearby() -> None:
    values = np.random.default_rng(0).random(200)
    values[150] = np.nan
    data = xarray.DataArray(values, {"x": np.arange(200)}, "x")
    assert_allclose(data.clvol.interp(x=[3.5]), ndimage.map_coordinates(values[:100], [[3.5]], mode="mirror"), **SAME)
    with pytest.raises(DataError, match=r"samples must be finite.*fillna"):
        data.clvol.interp(x=[140.5])


def test_results_in_which_a_missing_sample_has_weight_are_missing() -> None:
    rng = np.random.default_rng(0)
    y, x = np.cumsum(rng.uniform(0.5, 2, 40)), np.arange(30.0)
    values = np.sin(y / 9)[:, None] * np.cos(x / 5)
    holed = values.copy()
    holed[20, 11] = np.nan
    whole, data = (xarray.DataArray(one, {"y": y, "x": x}, ("y", "x")) for one in (values, holed))
    new = {"y": (y[1:] + y[:-1]) / 2, "x": x[:-1] + 0.5}
    got, expected = data.clvol.interp(new, nan="local").values, whole.clvol.interp(new).values
    known = ~np.isnan(got)
    lost = np.argwhere(~known)
    assert (lost.min(0).tolist(), lost.max(0).tolist(), len(lost)) == ([18, 9], [21, 12], 16)
    assert_allclose(got[known], expected[known], rtol=0, atol=1e-4)
    at = {dim: along("p", new[dim][[18, 19, 21, 22]]) for dim in ("y", "x")}
    at["x"] = along("p", [9.5, 8.5, 12.5, 12.5])
    assert np.isnan(data.clvol.interp(at, nan="local").values).tolist() == [True, False, True, False]
    assert np.isnan(data.clvol.interp(x=3.5, nan="propagate").values).nonzero()[0].tolist() == [20]
    assert not np.isnan(whole.clvol.interp(new, nan="local").values).any()
    both = (data + 2j * data).clvol.interp(new, nan="local").values
    assert_array_equal(np.isnan(both), ~known)
    assert_allclose(both[known], (1 + 2j) * got[known], **SAME)
    with pytest.raises(DataError, match=r'samples must be finite.*nan= be "local" or "propagate"'):
        data.clvol.interp(new)


# -- uneven coordinates ----------------------------------------------------------------------------------------------


def uneven(n: int, seed: int, low: float = 0.3) -> Array:
    return np.cumsum(np.random.default_rng(seed).uniform(low, 2, n))


@pytest.mark.one_in(6)
@pytest.mark.parametrize(("name", "order"), [("bspline2", 2), ("bspline3", 3), ("bspline5", 5)])
@pytest.mark.parametrize("lazy", [False, True], ids=["in memory", "dask"])
def test_uneven_splines_match_scipy(name: str, order: int, lazy: bool) -> None:
    rng = np.random.default_rng(0)
    t, z, x = uneven(90, 1), 40 - uneven(20, 2), np.arange(9.0)
    values = rng.random((90, 20, 9))
    at = {"t": rng.uniform(t[0], t[-1], 25), "z": rng.uniform(z[-1], z[0], 25), "x": rng.uniform(0, 8, 25)}
    smooth = make_interp_spline(t, values, order)(at["t"])[:, ::-1]
    smooth = make_interp_spline(z[::-1], smooth, order, axis=1)(at["z"])
    data = xarray.DataArray(values, {"t": t, "z": z, "x": x}, ("t", "z", "x"))
    if lazy:
        pytest.importorskip("dask.array")
        data = data.chunk({"t": 20, "z": 6, "x": 3})
    assert_allclose(data.clvol.interp(t=at["t"], z=at["z"], filter=name).values, smooth, rtol=0, atol=1e-11)
    points = {dim: along("p", p) for dim, p in at.items()}
    rows = smooth[np.arange(25), np.arange(25)]
    few = data.clvol.interp(t=points["t"], z=points["z"], filter=name).transpose("p", "x")
    assert_allclose(few.values, rows, rtol=0, atol=1e-11)
    for boundary, mode in (("mirror", "mirror"), ("wrap", "grid-wrap"), ("nearest", "nearest")):
        all_ = [scipy_spline(row, [[p]], order, mode)[0] for row, p in zip(rows, at["x"], strict=True)]
        got = data.clvol.interp(points, filter=name, boundary=boundary)
        assert_allclose(got.values, all_, rtol=0, atol=1e-11)


@pytest.mark.parametrize("name", ["nearest", "linear"])
def test_uneven_linear_and_nearest_match_xarray(name: str) -> None:
    data = cube().assign_coords(x=3 + uneven(6, 0), y=-uneven(5, 1))
    new = {"x": np.linspace(*data.x.values[[0, -1]], 23), "y": along("p", [-1.0, -2.1, -4])}
    assert_allclose(data.clvol.interp(new, filter=name).values, data.interp(new, method=name).values, **SAME)


def test_uneven_cubic_matches_xarray() -> None:
    data = cube().assign_coords(x=3 + uneven(6, 0))
    new = np.linspace(*data.x.values[[0, -1]], 13)
    assert_allclose(data.clvol.interp(x=new).values, data.interp(x=new, method="cubic").values, **SAME)
    three = data[..., [0, 1, 3]]  # the parabola
    x, at = three.x.values, float(three.x[1]) + 0.1
    weights = [(at - x[j]) * (at - x[k]) / ((x[i] - x[j]) * (x[i] - x[k])) for i, j, k in ((0, 1, 2), (1, 0, 2), (2, 0, 1))]
    assert_allclose(three.clvol.interp(x=at).values, three.values @ weights, **SAME)
    assert_allclose(
        three.clvol.interp(x=along("p", [at, at]), t=along("p", [1.0, 2.0])).values[1], three.values[2] @ weights, **SAME
    )


def test_cubic_polynomials_are_exact_on_uneven_axes_and_beyond() -> None:
    y, x = uneven(70, 0, low=0.01), uneven(5, 1)
    data = xarray.DataArray(np.polyval([1e-3, 0, -0.1, 1], y)[:, None] * np.polyval([2, 1, 0, -3], x), {"y": y, "x": x}, ("y", "x"))
    new = {"y": np.linspace(-1, y[-1] + 1, 99), "x": np.linspace(x[0] - 0.5, x[-1] + 0.5, 7)}
    expected = np.polyval([1e-3, 0, -0.1, 1], new["y"])[:, None] * np.polyval([2, 1, 0, -3], new["x"])
    assert_allclose(data.clvol.interp(new, fill=None).values, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


def test_uneven_splines_are_of_order_four_up_to_the_ends() -> None:
    errors = []
    for n in (40, 80, 160):
        x = np.linspace(0.2, 1, n) ** 2
        data, new = xarray.DataArray(np.exp(2 * x), {"x": x}, "x"), np.linspace(x[0], x[-1], 999)
        errors.append(np.abs(data.clvol.interp(x=new).values - np.exp(2 * new)).max())
    assert np.log2(np.divide(errors[:-1], errors[1:])).min() > 3.7


def test_steps_may_differ_by_orders_of_magnitude() -> None:
    steps = 10 ** np.random.default_rng(0).uniform(-3, 0, 600)
    x, values = np.cumsum(steps), np.random.default_rng(1).random(600)
    new = np.linspace(x[0], x[-1], 500)
    expected = make_interp_spline(x, values)(new)
    got = xarray.DataArray(values, {"x": x}, "x").clvol.interp(x=new).values
    assert_allclose(got, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    months = np.arange("2001-01", "2003-01", dtype="M8[M]").astype("M8[ns]")
    data = xarray.DataArray(values[:24], {"time": months}, "time")
    days = (months - months[0]) / np.timedelta64(1, "D")
    expected = make_interp_spline(days, values[:24])([45.5])
    assert_allclose(data.clvol.interp(time=["2001-02-15T12"]).values, expected, **SAME)


def test_more_dimensions_than_kernels_support() -> None:
    values = np.random.default_rng(0).random((5, 6, 4, 7))
    data = xarray.DataArray(values, dims=list("abcd"))
    new = {"a": [0.5, 3.2], "b": [1.1], "c": [0.3, 2.9], "d": [0, 5.5, 2.5]}
    expected = ndimage.map_coordinates(values, np.meshgrid(*new.values(), indexing="ij"), order=3, mode="mirror")
    assert_allclose(data.clvol.interp(new).values, expected, **SAME)


@pytest.mark.parametrize(
    ("kind", "result"),
    [("f4", "f4"), ("f2", "f4"), ("f8", "f8"), ("i2", "f8"), ("u1", "f8"), (">f4", "f4"), ("c16", "c16"), ("c8", "c8")],
)
def test_types(kind: str, result: str) -> None:
    rng = np.random.default_rng(0)
    values = (100 * rng.random((6, 7)) + (100j * rng.random((6, 7)) if kind[0] == "c" else 0)).astype(kind)
    got = xarray.DataArray(values, dims=("y", "x")).clvol.interp(x=[1.5, 2.25], y=[0.5])
    assert got.dtype == np.dtype(result)
    wide = values.astype("c16" if kind[0] == "c" else "f8")
    expected = ndimage.map_coordinates(wide, np.meshgrid([0.5], [1.5, 2.25], indexing="ij"), order=3, mode="mirror")
    assert_allclose(got, expected, rtol=0, atol=1e-10 if result in ("f8", "c16") else 1e-3)


def test_datasets() -> None:
    data = cube()
    both = xarray.Dataset(
        {
            "depth": data,
            "depth_at_start": data[0].drop_vars(["t", "name"]),
            "times": ("t", np.arange(4)),
            "flag": ("x", np.arange(6) > 2),
        },
        attrs={"source": "a model"},
    )
    got = both.clvol.interp(x=[3.11, 3.26], y=2.5)
    expected = both.interp(x=[3.11, 3.26], y=2.5)
    assert (list(got), got.attrs) == (list(expected), {"source": "a model"})
    xarray.testing.assert_identical(got[["times", "flag"]], expected[["times", "flag"]])
    xarray.testing.assert_equal(got["depth"], data.clvol.interp(x=[3.11, 3.26], y=2.5))
    assert_allclose(got["depth_at_start"], got["depth"][0], **SAME)


def test_another_grid_of_the_same_domain() -> None:
    data = cube()
    got = data.clvol.regrid(shape={"x": 12, "y": 3})
    assert_allclose(got.x, 2.95 + 0.05 * (np.arange(12) + 0.5))
    assert_allclose(got.y, 9 - 10 / 3 * (np.arange(3) + 0.5))
    at = np.meshgrid((np.arange(3) + 0.5) * 5 / 3 - 0.5, (np.arange(12) + 0.5) / 2 - 0.5, indexing="ij")
    assert_allclose(got.values, [ndimage.map_coordinates(frame, at, order=3, mode="mirror") for frame in data.values], **SAME)
    same = data.clvol.regrid(spacing={"x": 0.05})
    assert_allclose(same.x, got.x)
    assert_allclose(data.clvol.regrid(spacing={"y": 2}).values, data.values, **SAME)


# -- large arrays ----------------------------------------------------------------------------------------------------


def test_one_point_reads_only_its_neighbourhood() -> None:
    values = np.random.default_rng(0).random((288, 71, 73))
    data = xarray.DataArray(values, dims=("z", "y", "x"))
    point = {"z": 100.3, "y": 33.7, "x": 40.2}
    data.clvol.interp(point)
    tracemalloc.start()
    got = float(data.clvol.interp(point))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert_allclose(got, ndimage.map_coordinates(values, [[100.3], [33.7], [40.2]], order=3, mode="mirror")[0], **SAME)
    assert peak < values.nbytes


@pytest.mark.one_in(6)
@pytest.mark.parametrize("kind", ["f8", "f4"])
@pytest.mark.parametrize("name", ["linear", "bspline3", "bspline5"])
def test_dask_blocks_match_the_whole_array(name: str, kind: str) -> None:
    pytest.importorskip("dask.array")
    rng = np.random.default_rng(0)
    values = rng.uniform(-1, 1, (3, 150, 160)).astype(kind)
    data = xarray.DataArray(values, {"y": np.arange(150.0), "x": 16 - 0.1 * np.arange(160)}, ("t", "y", "x"))
    blocks = data.chunk({"t": 1, "y": 40, "x": 50})
    grid = {"y": np.linspace(-1, 150, 211), "x": np.sort(rng.uniform(0.1, 16, 33))}
    points = {dim: xarray.DataArray(rng.choice(new, (4, 9)), dims=("p", "q")) for dim, new in grid.items()}
    for new in (grid, points):
        lazy = blocks.clvol.interp(new, filter=name)
        assert lazy.chunks[0] == (1, 1, 1)
        assert lazy.dtype == kind
        assert_allclose(lazy.values, data.clvol.interp(new, filter=name).values, rtol=0, atol=1e-12 if kind == "f8" else 2e-6)
    wrapped = blocks.clvol.regrid(shape={"x": 320}, filter=name, boundary="wrap")
    assert max(wrapped.chunks[2]) <= 50
    whole = data.clvol.regrid(shape={"x": 320}, filter=name, boundary="wrap")
    assert_allclose(wrapped.values, whole.values, rtol=0, atol=1e-12 if kind == "f8" else 2e-6)


def test_nothing_is_computed_before_compute() -> None:
    dask = pytest.importorskip("dask")
    array = pytest.importorskip("dask.array")

    def fail(*_: Any) -> Array:
        raise AssertionError("a block was computed")

    source = array.zeros((64, 64), chunks=16).map_blocks(fail, dtype=np.float64, meta=np.empty((0, 0)))
    data = xarray.DataArray(source, dims=("y", "x"))
    lazy = [
        data.clvol.interp(y=[1.5, 40.2]),
        data.clvol.regrid({"x": 128}),
        data.clvol.interp(y=along("p", [1, 2]), x=along("p", [1, 2])),
    ]
    assert all(dask.is_dask_collection(one.data) for one in lazy)
    with pytest.raises(AssertionError, match="a block was computed"):
        lazy[0].compute()


def test_a_block_depends_only_on_its_neighbours() -> None:
    array = pytest.importorskip("dask.array")
    read = []

    def block(block_info: Any = None) -> Array:
        read.append(block_info[None]["chunk-location"])
        return np.ones((32,))

    source = array.map_blocks(block, chunks=((32,) * 40,), dtype=np.float64, meta=np.empty(0))
    data = xarray.DataArray(source, dims="x")
    assert_allclose(data.clvol.interp(x=[610.5, 611.5]).values, 1, **SAME)
    assert sorted(read) == [(18,), (19,)]  # samples 583 to 639
