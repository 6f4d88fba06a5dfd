"""Zarr: images written by ome-zarr, and arrays written by zarr or xarray."""

from __future__ import annotations

import json
import shutil
import warnings
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clvol
from clvol import ClvolWarning, formats
from clvol.base.errors import ClvolError, DataError, FormatError, GeometryError, MissingDependencyError, OptionError

zarr = pytest.importorskip("zarr")

SHAPE = (2, 3, 4, 8, 8)  # times, channels, slices, rows, columns
DATA = np.arange(np.prod(SHAPE), dtype=np.uint16).reshape(SHAPE)


@pytest.fixture(scope="module", params=["0.4", "0.5"])
def cells(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An image of two levels with labels, written by ome-zarr."""
    with warnings.catch_warnings(action="ignore"):
        pytest.importorskip("ome_zarr")
        from ome_zarr.format import FormatV04, FormatV05
        from ome_zarr.writer import write_image, write_labels

    path = tmp_path_factory.mktemp(f"ome{request.param}") / "cells.zarr"
    about: dict[str, Any] = {"fmt": {"0.4": FormatV04, "0.5": FormatV05}[request.param](), "scale_factors": [2]}
    size = {"z": 2.0, "y": 0.5, "x": 0.25}
    units = dict.fromkeys("zyx", "micrometer")
    channels = [
        {"label": name, "color": color, "window": {"start": 0, "end": end, "min": 0, "max": 65535}, "active": True}
        for name, color, end in (("DAPI", "0000FF", 100), ("GFP", "00FF00", 200), ("Cy5", "FF00FF", 300))
    ]
    with warnings.catch_warnings(action="ignore"):
        write_image(
            DATA, str(path), axes="tczyx", name="cells", scale=size, axes_units=units, omero={"channels": channels}, **about
        )
        properties = [{"label-value": 1, "name": "nucleus"}]
        write_labels(DATA[0, 0] // 100, str(path), "nuclei", axes="zyx", label_metadata={"properties": properties}, **about)
    return path


def test_channels_and_times_of_ome(cells: Path) -> None:
    volume = clvol.read(cells, time=1, channel="GFP")
    np.testing.assert_array_equal(volume.data, DATA[1, 1])
    assert (volume.spacing, volume.units, volume.space) == ((0.25, 0.5, 2.0), "um", "image")
    assert (volume.name, volume.color, volume.clim) == ("GFP", (0, 1, 0), (0, 200))
    np.testing.assert_array_equal(np.asarray(clvol.read_all(cells)), DATA)
    with pytest.warns(ClvolWarning, match=r"cells\.zarr holds 2 times × 3 channels \(DAPI, GFP, Cy5\)"):
        clvol.read(cells)


def test_channels_without_a_window_end_have_no_clim(tmp_path: Path) -> None:
    """They were accepted, and every use of the volumes failed."""
    group = zarr.create_group(tmp_path / "v.zarr")
    group.create_array("0", data=DATA[0, :2])
    place = [{"type": "scale", "scale": [1, 1, 1, 1]}]
    axes = [{"name": name, "type": "channel" if name == "c" else "space"} for name in "czyx"]
    windows = [{"start": 0, "end": float("inf")}, {"start": 0, "end": 9}]
    scales = [{"axes": axes, "datasets": [{"path": "0", "coordinateTransformations": place}]}]
    group.attrs["ome"] = {
        "version": "0.5",
        "multiscales": scales,
        "omero": {"channels": [{"label": str(i), "window": window} for i, window in enumerate(windows)]},
    }
    assert [volume.clim for volume in clvol.read_all(tmp_path / "v.zarr")] == [None, (0, 9)]


def test_arrays_with_far_more_chunks_than_files_are_rejected(tmp_path: Path) -> None:
    """Zarr requests each chunk, which took unlimited time."""
    array = zarr.create_array(tmp_path / "v.zarr", shape=(3, 4, 5 * 10**6), chunks=(3, 4, 5), dtype="uint8")
    array[..., :5] = 1
    with pytest.raises(FormatError, match="times as many chunks as are stored"):
        clvol.read(tmp_path / "v.zarr")


def test_levels_share_their_placement(cells: Path) -> None:
    small = clvol.read(cells, time=1, channel=1, level=1)
    assert small.shape == (4, 4, 4)
    assert small.spacing == (0.5, 1.0, 2.0)
    np.testing.assert_allclose(small.center, clvol.read(cells, time=1, channel=1).center)
    with pytest.raises(OptionError, match="level must be 0 to 1"):
        clvol.read(cells, level=2)


def test_labels_of_ome(cells: Path) -> None:
    assert [one.id for one in formats.series_of(cells)] == [".", "labels/nuclei"]
    labels = clvol.read(cells, series="labels/nuclei")
    np.testing.assert_array_equal(labels.data, DATA[0, 0] // 100)
    assert labels.is_labels
    assert labels.labels == {1: "nucleus"}
    assert clvol.read(cells / "labels" / "nuclei").labels == {1: "nucleus"}
    with pytest.raises(OptionError, match="labels/nuclei"):
        clvol.read(cells, series="membranes")


def test_only_chosen_chunks_are_read(tmp_path: Path) -> None:
    """The others are missing or damaged; a chunk that is not stored has the fill value."""
    array = zarr.create_array(tmp_path / "v.zarr", shape=SHAPE, chunks=(1, 1, 4, 8, 8), dtype="u2", fill_value=7, zarr_format=3)
    array[:] = DATA
    array.attrs["unrelated"] = 1
    folder = tmp_path / "v.zarr" / "c"
    (folder / "0" / "2" / "0" / "0" / "0").write_bytes(b"damaged")
    shutil.rmtree(folder / "1" / "1")
    with warnings.catch_warnings(action="ignore"):
        np.testing.assert_array_equal(clvol.read(tmp_path / "v.zarr", time=1, channel=0).data, DATA[1, 0])
        assert (clvol.read(tmp_path / "v.zarr", time=1, channel=1).data == 7).all()
        with pytest.raises(FormatError, match="cannot read"):
            clvol.read(tmp_path / "v.zarr", time=0, channel=2)


@pytest.mark.parametrize("version", [2, 3])
def test_plain_arrays(tmp_path: Path, version: int) -> None:
    root = zarr.create_group(tmp_path / "v.zarr", zarr_format=version)
    root.create_array("density", data=DATA[0, 0].astype(">f4"))
    assert clvol.read(tmp_path / "v.zarr").name == "density"
    np.testing.assert_array_equal(clvol.read(tmp_path / "v.zarr" / "density").data, DATA[0, 0])
    root.create_array("pressure", data=DATA[0, 1].astype("f8"))
    root.create_array("times", data=np.arange(5.0))
    with pytest.raises(DataError, match=r"2 arrays: 0: density \(float32, 4 × 8 × 8\), 1: pressure .*series="):
        clvol.read(tmp_path / "v.zarr")
    np.testing.assert_array_equal(clvol.read(tmp_path / "v.zarr", series="pressure").data, DATA[0, 1])
    root.create_array("all", data=DATA[0])
    with pytest.warns(ClvolWarning, match=r"3 volumes; volume 0 was read.*taken for volume \(3\), z"):
        np.testing.assert_array_equal(clvol.read(tmp_path / "v.zarr", series="all").data, DATA[0, 0])


def test_arrays_of_xarray(tmp_path: Path) -> None:
    """Names of dimensions, their coordinates and units, scaled samples."""
    xarray = pytest.importorskip("xarray")
    coords = {"time": [0, 1], "z": [5.0, 7.0, 9.0, 11.0], "y": np.linspace(8, 1, 8), "x": np.arange(8) * 250}
    data = xarray.DataArray(DATA[:, 0], coords, ("time", "z", "y", "x"), name="t")
    data.z.attrs["units"] = data.y.attrs["units"] = "um"
    data.x.attrs["units"] = "nm"
    with warnings.catch_warnings(action="ignore"):
        data.to_dataset().to_zarr(tmp_path / "v.zarr", zarr_format=2)
    volume = clvol.read(tmp_path / "v.zarr", time=1)
    np.testing.assert_array_equal(volume.data, DATA[1, 0])
    assert (volume.units, volume.name) == ("nm", "t")
    np.testing.assert_allclose(volume.index_to_world([1, 2, 3]), [250, 6000, 11000])
    uneven = data.assign_coords(z=[0, 1, 3, 9])
    with warnings.catch_warnings(action="ignore"):
        uneven.to_dataset().to_zarr(tmp_path / "w.zarr", zarr_format=2)
    with pytest.raises(GeometryError, match="spacing="):
        clvol.read(tmp_path / "w.zarr", time=0)
    assert clvol.read(tmp_path / "w.zarr", time=0, spacing=(1, 1, 2)).spacing == (1, 1, 2)


@pytest.mark.parametrize("zarr_format", [2, 3])
@pytest.mark.parametrize("dtype", ["f4", "f8", "i2", "packed"])
def test_missing_samples_of_xarray(tmp_path: Path, dtype: str, zarr_format: Any) -> None:
    """Zarr 3 has xarray's ``_FillValue`` of floating samples in base64, Zarr 2 as the array's fill value."""
    xarray = pytest.importorskip("xarray")
    values = np.arange(4 * 5 * 6.0).reshape(4, 5, 6) + 1000
    coding: dict[str, Any] = {"dtype": dtype, "_FillValue": np.dtype(dtype).type(7)} if dtype != "packed" else {}
    if not coding:
        coding = {"dtype": "i2", "_FillValue": np.int16(-7), "scale_factor": 0.5, "add_offset": 900.0}
    values[1:3, 2] = np.nan
    made = xarray.DataArray(values, dims=("z", "y", "x"), name="t").to_dataset()
    with warnings.catch_warnings(action="ignore"):
        made.to_zarr(tmp_path / "v.zarr", zarr_format=zarr_format, encoding={"t": coding}, consolidated=False)
        with xarray.open_zarr(tmp_path / "v.zarr", consolidated=False) as truth:
            expected = truth.t.values
    assert np.isnan(expected).sum() == 12
    np.testing.assert_array_equal(clvol.read(tmp_path / "v.zarr").data, expected)
    lazy = clvol.open(tmp_path / "v.zarr", missing=-5).read((0, 0, 0), (6, 5, 4))
    np.testing.assert_array_equal(lazy, np.nan_to_num(expected, nan=-5))


def test_a_zipped_store(tmp_path: Path) -> None:
    store = zarr.storage.ZipStore(tmp_path / "v.zarr.zip", mode="w")
    zarr.create_array(store, data=DATA[0, 0])
    store.close()
    np.testing.assert_array_equal(clvol.read(tmp_path / "v.zarr.zip").data, DATA[0, 0])
    with zipfile.ZipFile(tmp_path / "v.zarr.zip", "a") as packed, pytest.warns(UserWarning, match="Duplicate name"):
        packed.writestr("zarr.json", packed.read("zarr.json"))  # as zarr does where attributes change
    np.testing.assert_array_equal(clvol.read(tmp_path / "v.zarr.zip").data, DATA[0, 0])
    with zipfile.ZipFile(tmp_path / "folder.zip", "w") as packed:  # as people pack folders
        zarr.create_array(tmp_path / "a.zarr", data=DATA[0, 1])
        for file in (tmp_path / "a.zarr").rglob("*"):
            packed.write(file, file.relative_to(tmp_path))
    np.testing.assert_array_equal(clvol.read(tmp_path / "folder.zip").data, DATA[0, 1])
    with zipfile.ZipFile(tmp_path / "other.zip", "w") as packed:
        packed.writestr("slice.tif", b"")
    with pytest.raises(FormatError, match=r"other\.zip must hold a Zarr array or group; unpack"):
        clvol.read(tmp_path / "other.zip")
    (tmp_path / "w.zip").write_bytes(b"PK" + bytes(99))
    with pytest.raises(FormatError, match="cannot read"):
        clvol.read(tmp_path / "w.zip")


METADATA: dict[str, Any] = {
    "multiscales": [
        {
            "axes": [{"name": axis, "type": "space", "unit": "nanometer"} for axis in "zyx"],
            "datasets": [{"path": "0", "coordinateTransformations": [{"type": "scale", "scale": [4, 3, 2]}]}],
            "coordinateTransformations": [
                {"type": "scale", "scale": [10, 10, 10]},
                {"type": "translation", "translation": [1, 2, 3]},
            ],
        }
    ]
}


def damaged(changes: dict[str, Any]) -> dict[str, Any]:
    copy = json.loads(json.dumps(METADATA))
    copy["multiscales"][0].update(changes)
    return copy


def test_shared_transforms_follow_those_of_the_level(tmp_path: Path) -> None:
    root = zarr.create_group(tmp_path / "v.zarr", zarr_format=2, attributes=METADATA)
    root.create_array("0", data=DATA[0, 0])
    volume = clvol.read(tmp_path / "v.zarr")
    assert (volume.spacing, volume.origin, volume.units) == ((20, 30, 40), (3, 2, 1), "nm")


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"datasets": []}, r"v\.zarr must hold an array for each of its sizes"),
        ({"datasets": [{"path": "1"}]}, r"v\.zarr must hold an array for each of its sizes.*'1'"),
        ({"datasets": [{"path": ""}]}, r"v\.zarr must hold an array for each of its sizes"),
        ({"datasets": [{}]}, r"v\.zarr must hold an array for each of its sizes"),
        ({"axes": [{"name": "z"}, {"name": "y"}]}, "its axes are|must hold"),
        ({"coordinateTransformations": [{"type": "affine", "path": "a"}]}, "scale and a translation.*affine"),
        ({"coordinateTransformations": [{"type": "scale", "scale": [1, 0, 1]}]}, "spacing must be positive"),
    ],
    ids=["no sizes", "gone", "a group", "no path", "axes", "affine", "zero"],
)
def test_damaged_metadata_raise(tmp_path: Path, changes: dict[str, Any], match: str) -> None:
    root = zarr.create_group(tmp_path / "v.zarr", zarr_format=2, attributes=damaged(changes))
    root.create_array("0", data=DATA[0, 0])
    with pytest.raises(ClvolError, match=match):
        clvol.read(tmp_path / "v.zarr")


def test_damaged_stores_raise(tmp_path: Path) -> None:
    (tmp_path / "v.zarr").mkdir()
    for content in ("", "{", "{}", '{"zarr_format": 9}', '{"zarr_format": 3, "node_type": "group", "attributes": {}}'):
        (tmp_path / "v.zarr" / "zarr.json").write_text(content)
        with pytest.raises(ClvolError, match=r"v\.zarr"):
            clvol.read(tmp_path / "v.zarr")


def test_without_zarr(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "zarr.json").write_text("{}")
    monkeypatch.setitem(__import__("sys").modules, "zarr", None)
    with pytest.raises(MissingDependencyError, match=r'pip install "clvol\[microscopy\]"'):
        clvol.read(tmp_path, trusted=True)
