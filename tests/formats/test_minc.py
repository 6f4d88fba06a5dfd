"""MINC 1 and 2: files of nibabel's package, and some made here, against nibabel."""

from __future__ import annotations

import itertools
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clvol
from clvol.base.errors import DataError, FormatError, GeometryError

h5py = pytest.importorskip("h5py")
nibabel = pytest.importorskip("nibabel")

SAMPLES = Path(nibabel.__file__).parent / "tests" / "data"
DATA = np.random.default_rng(0).integers(-300, 300, (3, 4, 5)).astype(np.int16)


def written(path: Path, data: Any, axes: tuple[str, ...], ends: Any = (0.0, 1.0), along: int = 0, **attributes: Any) -> Path:
    """A file of MINC 2 with these axes; `ends` are image-min and image-max, along the first axes."""
    with h5py.File(path, "w") as file:
        root = file.create_group("minc-2.0")
        image = root.create_dataset("image/0/image", data=data)
        image.attrs["dimorder"] = np.bytes_(",".join(axes))
        image.attrs["valid_range"] = (-200.0, 250.0)
        for end, values in zip(("min", "max"), ends, strict=True):
            one = root.create_dataset(f"image/0/image-{end}", data=values)
            if along:
                one.attrs["dimorder"] = np.bytes_(",".join(axes[:along]))
        for k, axis in enumerate(axes):
            about = root.create_dataset(f"dimensions/{axis}", data=0).attrs
            about.update({"spacing": np.bytes_("regular__"), "step": (2.0, -3.0, 0.5, 4.0)[k], "start": 10.0 * k - 7})
            if "direction" in attributes and axis.endswith("space"):
                about["direction_cosines"] = attributes["direction"][:, "xyz".index(axis[0])]
    return path


def require_nibabels(path: Path) -> None:
    """Values, and places of all corners, are those of nibabel, whose world is RAS."""
    with warnings.catch_warnings(action="ignore"):
        image = nibabel.load(path)
    truth = np.asarray(image.dataobj)
    volumes = clvol.read_all(path)
    np.testing.assert_allclose(np.asarray(volumes).reshape(truth.shape), truth, rtol=1e-12, atol=1e-12 * np.abs(truth).max())
    grid = volumes.grid
    for index in itertools.product(*((0, n - 1) for n in grid.shape)):
        ras = image.affine @ (*index, 1)
        np.testing.assert_allclose(grid.index_to_world(index[::-1]) * (-1, -1, 1), ras[:3], atol=1e-9)
    choice = {} if len(volumes) == 1 else {"volume": 1}
    lazy = clvol.open(path, **choice)
    np.testing.assert_array_equal(lazy.read((0, 0, 0), lazy.size), volumes[choice.get("volume", 0)].data)


@pytest.mark.parametrize("path", sorted(SAMPLES.glob("*.mnc")), ids=lambda path: path.name)
def test_files_of_nibabel(path: Path) -> None:
    require_nibabels(path)


@pytest.mark.parametrize("along", [0, 1, 2])
@pytest.mark.parametrize("axes", [("zspace", "yspace", "xspace"), ("xspace", "zspace", "yspace")])
def test_oblique_and_scaled(tmp_path: Path, axes: tuple[str, ...], along: int) -> None:
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    low = np.random.default_rng(2).normal(size=DATA.shape[:along])
    require_nibabels(written(tmp_path / "v.mnc", DATA, axes, (low, low + 5), along, direction=turn))


def test_times_and_vectors(tmp_path: Path) -> None:
    series = np.stack([DATA, DATA + 1])
    require_nibabels(written(tmp_path / "v.mnc", series, ("time", "zspace", "yspace", "xspace")))
    assert clvol.read_all(tmp_path / "v.mnc").axes == ("time",)
    colours = np.stack([DATA, DATA + 1, DATA + 2], -1).astype("f4")
    volumes = clvol.read_all(written(tmp_path / "c.mnc", colours, ("zspace", "yspace", "xspace", "vector_dimension")))
    assert volumes.axes == ("channel",)
    np.testing.assert_array_equal(volumes, np.moveaxis(colours, -1, 0))


def test_labels_stay_whole(tmp_path: Path) -> None:
    """Where stored numbers are the values, their type is kept."""
    path = written(tmp_path / "v.mnc", DATA.astype("u1"), ("zspace", "yspace", "xspace"), (0.0, 255.0))
    with h5py.File(path, "a") as file:
        file["minc-2.0/image/0/image"].attrs["valid_range"] = (0.0, 255.0)
    assert clvol.read(path).data.dtype == np.uint8
    require_nibabels(path)


@pytest.mark.parametrize("name", ["v.h5", "v", "v.mnc.old"])
def test_under_any_name(tmp_path: Path, name: str) -> None:
    """As HDF5 it would lose its geometry."""
    written(tmp_path / "v.mnc", DATA, ("zspace", "yspace", "xspace")).rename(tmp_path / name)
    assert clvol.read(tmp_path / name).spacing == (0.5, 3, 2)


def test_others_are_rejected(tmp_path: Path) -> None:
    axes = ("zspace", "yspace", "xspace")
    path = written(tmp_path / "v.mnc", DATA, axes)
    with h5py.File(path, "a") as file:
        file["minc-2.0/dimensions/zspace"].attrs["spacing"] = np.bytes_("irregular")
    with pytest.raises(GeometryError, match="along zspace are irregular"):
        clvol.read(path)
    with pytest.raises(DataError, match="must have the axes xspace"):
        clvol.read(written(tmp_path / "w.mnc", DATA, ("zfrequency", "yspace", "xspace")))
    with pytest.raises(FormatError, match="image-min and image-max"):
        clvol.read(written(tmp_path / "x.mnc", DATA, axes, (np.zeros(9), np.ones(9))))
    with h5py.File(path, "a") as file:
        del file["minc-2.0/image/0/image"]
        file["minc-2.0/image/0/image"] = h5py.ExternalLink("other.h5", "a")
    with pytest.raises(FormatError, match="must hold 'image' itself"):
        clvol.read(path)
