"""Images of PyVista, VTK, ITK, napari, xarray, Zarr and dask: samples and their positions match each library."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

import clvol
from clvol.base import memory
from clvol.base.errors import DataError, GeometryError, OutOfMemoryError
from clvol.device import Device
from clvol.volume.volumes import as_grid

Array = NDArray[Any]
SHAPE = (4, 5, 6)
TURNED = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, -1.0]])


def samples(shape: tuple[int, ...] = SHAPE) -> Array:
    return np.random.default_rng(3).uniform(-1, 1, shape).astype(np.float32)


def indices(shape: Sequence[int] = SHAPE) -> Array:
    """(x, y, z) of every sample, in the order of the array."""
    grid = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), -1).reshape(-1, len(shape))
    return np.asarray(grid[:, ::-1], np.float64)


def require_at(volume: clvol.Volume, places: Array) -> None:
    """Require the sample of each index at its position."""
    found = volume.index_to_world(indices(volume.shape))
    assert_allclose(found, places, rtol=0, atol=1e-9 * np.abs(places).max())
    back = volume.world_to_index(places)
    assert_allclose(back, indices(volume.shape), rtol=0, atol=1e-6)


# -- PyVista and VTK -------------------------------------------------------------------------------------------------


def pyvista_image(**more: Any) -> Any:
    pyvista = pytest.importorskip("pyvista")
    image = pyvista.ImageData(dimensions=SHAPE[::-1], spacing=(0.5, 2, 3), origin=(7, -8, 9), **more)
    image.direction_matrix = TURNED
    return image


def test_pyvista_point_data(device: Device) -> None:
    image = pyvista_image()
    data = samples()
    image.point_data["density"] = data.ravel()
    volume = clvol.Volume(image)
    assert volume.name == "density"
    assert_array_equal(volume.data, data)
    assert np.shares_memory(volume.data, image.point_data["density"])
    require_at(volume, image.points)
    # a ramp in the world, by PyVista's coordinates, is the same ramp by ours
    image.point_data["density"] = image.points @ [1.0, 2.0, -3.0]
    inner = clvol.Volume(image).center + np.array([[0, 0, 0], [0.2, 0.3, -0.4]])
    ramp = clvol.sample(image, inner, filter="linear", device=device)
    assert_allclose(ramp, inner @ [1.0, 2.0, -3.0], rtol=1e-4)


def test_pyvista_cell_data_are_at_cell_centres() -> None:
    image = pyvista_image(offset=(3, 4, 5))
    image.cell_data["mass"] = np.arange(image.n_cells)
    volume = clvol.Volume(image)
    assert volume.shape == (3, 4, 5)
    require_at(volume, image.cell_centers().points)
    assert_array_equal(volume.data.ravel(), image["mass"])


def test_the_active_array_is_used() -> None:
    image = pyvista_image()
    image.point_data["a"] = samples().ravel()
    image.point_data["b"] = 2 * samples().ravel()
    image.cell_data["c"] = np.arange(image.n_cells)
    for name in ("a", "b", "c"):
        image.set_active_scalars(name)
        assert clvol.Volume(image).name == name
    image.set_active_scalars(None)
    with pytest.raises(DataError, match=r"active scalars.*its arrays are a, b, c"):
        clvol.Volume(image)


def test_plain_vtk() -> None:
    common = pytest.importorskip("vtkmodules.vtkCommonDataModel")
    support = pytest.importorskip("vtkmodules.util.numpy_support")
    image, data = common.vtkImageData(), samples()
    image.SetExtent(2, 7, -1, 3, 0, 3)
    image.SetSpacing(0.5, 2, 3)
    image.SetOrigin(7, -8, 9)
    image.SetDirectionMatrix(*TURNED.ravel())
    array = support.numpy_to_vtk(data.ravel(), deep=True)
    array.SetName("one")
    image.GetPointData().AddArray(array)  # the only one, and not active
    volume = clvol.Volume(image)
    assert_array_equal(volume.data, data)
    require_at(volume, np.array([image.GetPoint(i) for i in range(data.size)]))
    del image, array
    assert_array_equal(volume.data, data)  # the memory is kept


def test_components_are_channels() -> None:
    image = pyvista_image()
    image.point_data["v"] = np.arange(360.0).reshape(120, 3)
    with pytest.raises(DataError, match=r"one volume; got an image of 3 channels: take one as clvol\.Volumes\(image\)\[k\]"):
        clvol.render(image)
    parts = clvol.Volumes(image)
    assert parts.leading.vector
    assert_array_equal(parts[1].data.ravel(), np.arange(360.0).reshape(120, 3)[:, 1])
    require_at(parts[2], image.points)
    image.point_data["rgb"] = np.zeros((120, 3), np.uint8)
    image.set_active_scalars("rgb")
    assert clvol.Volumes(image).leading.rgb


def test_other_vtk_objects_are_rejected() -> None:
    pyvista = pytest.importorskip("pyvista")
    with pytest.raises(DataError, match=r"must be image data, a uniform grid; got PolyData: resample it"):
        clvol.render(pyvista.Sphere())
    with pytest.raises(DataError, match="its arrays are none"):
        clvol.Volume(pyvista.ImageData(dimensions=(3, 3, 3)))


# -- ITK -------------------------------------------------------------------------------------------------------------


def itk_image(data: Array, **more: Any) -> Any:
    itk = pytest.importorskip("itk")
    if not hasattr(itk, "image_from_array"):
        pytest.skip("another package that is called itk")
    image = itk.image_from_array(np.ascontiguousarray(data), **more)
    d = int(image.GetImageDimension())
    image.SetSpacing([0.5, 2.0, 3.0, 4.0][:d])
    image.SetOrigin([7.0, -8.0, 9.0, 0.0][:d])
    direction = np.eye(d)
    direction[:3, :3] = TURNED
    image.SetDirection(direction)
    return image


def itk_places(image: Any, shape: tuple[int, ...] = SHAPE) -> Array:
    return np.array([list(image.TransformIndexToPhysicalPoint([int(i) for i in index])) for index in indices(shape)])


def test_itk_images(device: Device) -> None:
    data = samples()
    image = itk_image(data)
    volume = clvol.Volume(image)
    assert (volume.units, volume.space) == ("mm", "LPS")
    places = itk_places(image)
    require_at(volume, places)
    assert_allclose(clvol.sample(image, places, filter="linear", device=device), data.ravel(), atol=1e-6)
    del image
    assert_array_equal(volume.data, data)


def test_an_itk_image_region() -> None:
    itk = pytest.importorskip("itk")
    image = itk_image(samples())
    region = itk.ImageRegion[3]()
    region.SetIndex([1, 2, 0])
    region.SetSize([3, 2, 4])
    cut = type(image).New()
    cut.SetRegions(region)
    cut.SetSpacing(image.GetSpacing())
    cut.SetOrigin(image.GetOrigin())
    cut.SetDirection(image.GetDirection())
    with pytest.raises(DataError, match="must be loaded; its buffer is empty"):
        clvol.Volume(type(image).New())
    cut.Allocate()
    cut.FillBuffer(3.0)
    volume = clvol.Volume(cut)
    assert volume.size == (3, 2, 4)
    assert_allclose(volume.origin, list(image.TransformIndexToPhysicalPoint([1, 2, 0])))


def test_itk_vectors_and_times() -> None:
    data = samples((*SHAPE, 3))
    image = itk_image(data, is_vector=True)
    with pytest.raises(DataError, match=r"3 channels"):
        clvol.Volume(image)
    parts = clvol.Volumes(image)
    assert parts.leading.vector
    assert_array_equal(parts[2].data, data[..., 2])
    require_at(parts[0], itk_places(image))
    colors = clvol.Volumes(itk_image((255 * np.abs(data)).astype(np.uint8), is_vector=True))
    assert colors.leading.rgb
    times = samples((2, *SHAPE)).astype(np.uint8)
    frames = clvol.Volumes(itk_image(times))
    assert_array_equal(np.asarray(frames), times)
    require_at(frames[1], itk_places(itk_image(samples())))
    assert as_grid(itk_image(times)).shape == SHAPE


# -- xarray ----------------------------------------------------------------------------------------------------------


def labelled(**coords: Any) -> Any:
    xarray = pytest.importorskip("xarray")
    return xarray.DataArray(samples(), coords, ("z", "y", "x"), name="rho")


def test_xarray_coordinates(device: Device) -> None:
    x, y, z = 10 + 0.5 * np.arange(6), 4.0 - np.arange(5), np.float32(0.1) * np.arange(4, dtype=np.float32)
    array = labelled(x=x, y=y, z=z)
    volume = clvol.Volume(array)
    assert volume.name == "rho"
    assert np.shares_memory(volume.data, array.values)
    zs, ys, xs = np.meshgrid(z, y, x, indexing="ij")
    places = np.stack([xs, ys, zs], -1).reshape(-1, 3)
    assert_allclose(volume.index_to_world(indices()), places, rtol=0, atol=1e-6)
    assert_allclose(clvol.sample(array, places, filter="linear", device=device), samples().ravel(), atol=1e-5)
    part = array.isel(x=slice(2, None), z=slice(None, None, -1))
    assert_allclose(clvol.Volume(part).origin, (11, 4, 0.3), atol=1e-6)


def test_units_and_missing_coordinates() -> None:
    xarray = pytest.importorskip("xarray")
    um = {"units": "micrometer"}
    array = labelled(**{k: xarray.DataArray(np.arange(n), dims=k, attrs=um) for k, n in zip("zyx", SHAPE, strict=True)})
    assert clvol.Volume(array).units == "um"
    array = array.assign_coords(z=xarray.DataArray(np.arange(4), dims="z", attrs={"units": "mm"}))
    with pytest.raises(GeometryError, match="in one unit of length"):
        clvol.Volume(array)
    plain = clvol.Volume(labelled())
    assert (plain.spacing, plain.origin, plain.units) == ((1, 1, 1), (0, 0, 0), "")
    times = clvol.Volume(
        labelled(z=np.array(["2020-01-01", "2020-01-03", "2021-01-01", "2021-02-01"], "M8[ns]"), x=2 * np.arange(6))
    )
    assert times.spacing == (2, 1, 1)


@pytest.mark.parametrize(
    ("dims", "names"),
    [
        ("xyz", ("z", "y", "x")),
        ("yzx", ("depth", "lat", "lon")),
        ("xyz", ("height", "latitude", "longitude")),
        ("zxy", ("z", "row", "column")),
        ("yxz", ("sheet", "y", "x")),
        ("xzy", ("sheet", "line", "x")),  # unknown names keep their order
    ],
)
def test_dimensions_have_any_order(dims: str, names: tuple[str, ...], device: Device) -> None:
    """Samples and places are those of xarray's own transposition, [z, y, x]."""
    places = {"x": 10 + 0.5 * np.arange(6), "y": 4.0 - np.arange(5), "z": 3 * np.arange(4)}
    array = labelled(**places).rename(dict(zip("zyx", names, strict=True)))
    turned = array.transpose(*(dict(zip("zyx", names, strict=True))[axis] for axis in dims))
    volume, expected = clvol.Volume(turned), clvol.Volume(labelled(**places))
    assert_array_equal(volume.data, samples())
    assert (volume.spacing, volume.origin) == (expected.spacing, expected.origin) == ((0.5, 1, 3), (10, 4, 0))
    assert_array_equal(volume.direction, np.diag([1, -1, 1]))
    assert as_grid(turned).shape == SHAPE
    assert_allclose(clvol.sample(turned, [[11, 2, 3]], device=device), clvol.sample(expected, [[11, 2, 3]], device=device))
    lazy = clvol.LazyVolume(turned)
    assert_array_equal(lazy.read((0, 0, 0), (6, 5, 4)).data, samples())
    assert_array_equal(lazy.grid.index_to_world_matrix, expected.index_to_world_matrix)
    assert clvol.LazyVolume(turned, spacing=(1, 2, 3)).spacing == (1, 2, 3)
    several = turned.expand_dims(time=2, axis=3)
    assert_array_equal(np.asarray(clvol.Volumes(several)), np.stack([samples()] * 2))
    assert_array_equal(clvol.resize(turned, turned.shape), turned.values)  # of arrays, not of places


def test_uneven_coordinates_are_rejected_where_positions_matter() -> None:
    array = labelled(x=[0, 1, 2, 3, 5, 6])
    with pytest.raises(GeometryError, match=r"evenly spaced.*those of x are 1 to 2 apart"):
        clvol.render(array)
    assert clvol.resize(array, (4, 5, 12)).shape == (4, 5, 12)


@pytest.mark.parametrize(
    "dims", [("y", "x", "c"), ("time", "y", "x"), ("band", "lat", "lon"), ("lon", "t", "lat"), ("y", "x", "rgb")], ids="-".join
)
def test_times_and_channels_of_xarray_are_not_z(dims: tuple[str, ...]) -> None:
    """Each image is xarray's own selection, transposed to [y, x], at its coordinates."""
    xarray = pytest.importorskip("xarray")
    y, x = (next(d for d in dims if d in names) for names in (("y", "lat"), ("x", "lon")))
    (other,) = set(dims) - {x, y}
    array = xarray.DataArray(np.random.default_rng(0).random((3, 4, 5)), dims=dims)
    array = array.assign_coords({x: 7 + 2.0 * np.arange(array.sizes[x])})
    with pytest.raises(DataError, match="one volume"):
        clvol.Volume(array)
    images = clvol.Volumes(array)
    assert len(images) == array.sizes[other]
    for n, image in enumerate(images):
        np.testing.assert_array_equal(np.squeeze(image.data), array.isel({other: n}).transpose(y, x).values)
        assert (image.spacing[:2], image.origin[:2]) == ((2.0, 1.0), (7.0, 0.0))


def test_xarray_with_four_dimensions() -> None:
    xarray = pytest.importorskip("xarray")
    data = samples((2, 3, *SHAPE))
    array = xarray.DataArray(data, {"x": 2.0 * np.arange(6)}, ("time", "c", "z", "y", "x"))
    volumes = clvol.Volumes(array)
    assert volumes.axes == ("time", "channel")
    assert volumes.grid.spacing == (2, 1, 1)
    assert_array_equal(volumes.pick(time=1, channel=2).data, data[1, 2])
    with pytest.raises(DataError, match="one volume; got an image of 2 times × 3 channels"):
        clvol.Volume(array)
    with pytest.raises(DataError, match="told apart"):
        clvol.Volumes(array.rename(time="a", c="b"))
    frames = clvol.Volumes(array[:, 0, 0])
    assert (frames.axes, frames.grid.shape, frames.grid.spacing) == (("time",), (5, 6), (2, 1))
    frames = clvol.Volumes(array[:, 0, 0].rename(time="a"))  # as any array of three axes
    assert (frames.axes, frames.grid.shape) == (("volume",), (5, 6))


# -- arrays that are not in memory -------------------------------------------------------------------------------------


def test_zarr_and_dask_arrays(device: Device) -> None:
    zarr, dask = pytest.importorskip("zarr"), pytest.importorskip("dask.array")
    data = samples((12, 12, 12))
    stored = zarr.array(data, chunks=(5, 6, 7))
    for lazy in (stored, dask.from_array(data, chunks=5), dask.from_array(stored)):
        volume = clvol.Volume(lazy)
        assert_array_equal(volume.data, data)
        assert volume.spacing == (1, 1, 1)
        picture = clvol.render(lazy, mode="mip", size=(16, 16), device=device)
        assert_array_equal(picture, clvol.render(data, mode="mip", size=(16, 16), device=device))
    with pytest.raises(DataError, match=r"a Group of zarr: give one of its arrays, or read it with clvol\.read"):
        clvol.Volume(zarr.group())
    unknown = dask.from_array(data, chunks=5)
    with pytest.raises(DataError, match="known shape"):
        clvol.Volume(unknown[unknown[:, 0, 0] > 0])


@pytest.mark.parametrize("kind", ["zarr", "dask", "xarray"])
def test_arrays_that_do_not_fit_are_rejected_before_reading(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    shape = (1 << 14,) * 3
    if kind == "zarr":
        zarr = pytest.importorskip("zarr")
        huge: Any = zarr.create_array({}, shape=shape, chunks=(1 << 10,) * 3, dtype="f4")
    else:
        huge = pytest.importorskip("dask.array").zeros(shape, chunks=1 << 10, dtype="f4")
        huge = pytest.importorskip("xarray").DataArray(huge) if kind == "xarray" else huge
    monkeypatch.setattr(memory, "_rooms", lambda: [memory.Room(8 << 30, "the test's limit")])
    monkeypatch.setattr(memory, "_answer", None)
    with pytest.raises(OutOfMemoryError, match=rf"reading an array of {kind} .*whole must fit .*the test's limit"):
        clvol.render(huge)


# -- napari ------------------------------------------------------------------------------------------------------------

_IN_NAPARI = """
import json, sys, warnings
warnings.simplefilter("ignore")
import numpy as np
import clvol
from clvol.base.errors import ClvolError
from napari.layers import Image, Labels, Points

def at(layer, volume):
    index = np.stack(np.meshgrid(*map(np.arange, volume.shape), indexing="ij"), -1).reshape(-1, volume.ndim)
    lead = (0,) * (layer.ndim - volume.ndim)
    places = np.array([layer.data_to_world((*lead, *i)) for i in index])[:, len(lead):][:, ::-1]
    return float(np.abs(volume.index_to_world(index[:, ::-1]) - places).max())

def refused(source):
    try:
        clvol.Volume(source)
    except ClvolError as error:
        return f"{type(error).__name__}: {error}"
    return "taken"

data = np.random.default_rng(0).uniform(0, 9, (4, 5, 6)).astype("f4")
um = ("um",) * 3
turned = Image(data, scale=(2, 1, 0.5), translate=(1, 2, 3), rotate=[10, 20, 30], shear=[0.1, 0.2, 0.3], units=um,
               affine=np.diag([2, 2, 2, 1.0]), colormap="green", contrast_limits=(1, 8), name="cells")
plain = Image(data, scale=(2, 1, 0.5), translate=(1, 2, 3), colormap="viridis")
levels = Image([data, data[::2, ::2, ::2]], multiscale=True, scale=(3, 1, 1), contrast_limits=(0, 1))
series = Image(np.zeros((2, 4, 5, 6)), scale=(7, 2, 1, 1), axis_labels=("t", "z", "y", "x"))
rgb = Image(np.zeros((4, 5, 6, 3), "u1"), rgb=True)
t, v, l = clvol.Volume(turned), clvol.Volume(plain), clvol.Volume(Labels(data.astype(int)))
told = {
    "off": [at(turned, t), at(plain, v), at(levels, clvol.Volume(levels)), at(series, clvol.Volumes(series)[1])],
    "same": bool((t.data == data).all() and (clvol.Volume(levels).data == data).all()),
    "turned": [t.units, t.space, t.name, t.color, t.clim], "plain": [v.spacing, v.origin, v.color, v.units],
    "labels": [l.labels, l.clim], "axes": clvol.Volumes(series).axes,
    "rgb": refused(rgb), "rgb volumes": clvol.Volumes(rgb).leading.rgb, "points": refused(Points(np.zeros((1, 3)))),
    "units": refused(Image(data, units=("mm", "um", "um"))),
}
print(json.dumps(told))
"""


def napari_python() -> str:
    """A Python that has napari: this one, or that of CLVOL_TEST_NAPARI."""
    python = os.environ.get("CLVOL_TEST_NAPARI", sys.executable)
    if subprocess.run([python, "-c", "import napari.layers"], capture_output=True, timeout=60, check=False).returncode:
        pytest.skip("napari is not installed")
    return python


def test_napari_layers() -> None:
    done = subprocess.run(
        [napari_python(), "-c", _IN_NAPARI], capture_output=True, text=True, timeout=120, check=False, env=dict(os.environ)
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout.splitlines()[-1])
    assert max(told["off"]) < 1e-9
    assert told["same"]
    assert told["turned"] == ["um", "image", "cells", [0, 1, 0], [1, 8]]
    assert told["plain"] == [[0.5, 1, 2], [3, 2, 1], None, ""]
    assert told["labels"] == [True, None]
    assert told["axes"] == ["time"]
    assert told["rgb"].startswith("DataError: data must be one volume; got an image of 3 channels")
    assert told["rgb volumes"] is True
    assert told["points"] == "DataError: a layer of napari must be one of Image or Labels; got Points"
    assert told["units"].startswith("GeometryError: all axes must be in one unit of length; got millimeter, micrometer, micrometer")


# -- what they share -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("make", [pyvista_image, lambda: itk_image(samples())], ids=["pyvista", "itk"])
def test_pictures_match_those_of_equal_volumes(device: Device, make: Callable[[], Any]) -> None:
    image = make()
    if hasattr(image, "point_data"):
        image.point_data["density"] = samples().ravel()
    space = "LPS" if not hasattr(image, "point_data") else ""
    volume = clvol.Volume(samples(), (0.5, 2, 3), (7, -8, 9), TURNED, space=space)
    picture = clvol.render(image, mode="mip", size=(24, 24), device=device)
    assert_array_equal(picture, clvol.render(volume, mode="mip", size=(24, 24), device=device))
    assert picture[..., :3].max() > 0.1
