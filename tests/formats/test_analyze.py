"""Analyze 7.5 and SPM's variants of it, written by nibabel, against nibabel."""

from __future__ import annotations

import gzip
import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clvol
from clvol.base.errors import FormatError

nibabel = pytest.importorskip("nibabel")

DATA = np.random.default_rng(0).integers(-100, 100, (6, 5, 4))  # x, y, z


def require_nibabels(path: Path, shape: tuple[int, ...]) -> Any:
    image = nibabel.load(path)
    truth = np.asarray(image.dataobj).reshape(shape).T
    volumes = clvol.read_all(path)
    np.testing.assert_array_equal(np.asarray(volumes).reshape(truth.shape), truth)
    for index in itertools.product(*((0, n - 1) for n in volumes.grid.size)):
        ras = image.affine @ (*index, 1)
        np.testing.assert_allclose(volumes.grid.index_to_world(index) * (-1, -1, 1), ras[:3], rtol=1e-6)
    lazy = clvol.open(path, volume=len(volumes) - 1)
    np.testing.assert_array_equal(lazy.read((0, 0, 0), lazy.size), volumes[-1].data)
    return volumes


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("dtype", ["u1", "i2", "i4", "f4", "f8"])
def test_samples_of_every_type(tmp_path: Path, dtype: str, order: str) -> None:
    image = nibabel.AnalyzeImage(DATA.astype(dtype), None, nibabel.AnalyzeImage.header_class(endianness=order))
    image.set_data_dtype(dtype)
    image.header["pixdim"][1:4] = (2, 3, 4)
    image.to_filename(tmp_path / "v.hdr")
    assert require_nibabels(tmp_path / "v.hdr", DATA.shape).grid.data.dtype == np.dtype(dtype)
    assert clvol.read(tmp_path / "v.img").spacing == (2, 3, 4)


@pytest.mark.parametrize("origin", [(0, 0, 0), (2, 3, 1)])
def test_scale_and_origin_of_spm(tmp_path: Path, origin: tuple[int, ...]) -> None:
    """With SPM's scale, and its origin, counted from 1."""
    image = nibabel.Spm99AnalyzeImage(DATA / 7, None)
    image.set_data_dtype("i2")
    image.header["origin"][:3] = origin
    image.header["pixdim"][1:4] = (2, 3, 4)
    image.to_filename(tmp_path / "v.hdr")
    require_nibabels(tmp_path / "v.hdr", DATA.shape)


def test_matrix_beside_it(tmp_path: Path) -> None:
    """SPM's .mat file places a volume obliquely."""
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = turn * (2, 3, 4), (7, 8, 9)
    nibabel.Spm99AnalyzeImage(DATA.astype("i2"), affine).to_filename(tmp_path / "v.img")
    assert (tmp_path / "v.mat").exists()
    require_nibabels(tmp_path / "v.hdr", DATA.shape)


@pytest.mark.parametrize("kind", ["AnalyzeImage", "Spm99AnalyzeImage", "Nifti1Pair", "Nifti2Pair"])
@pytest.mark.parametrize("ends", [(".hdr.gz", ".img.gz"), (".hdr", ".img.gz"), (".hdr.gz", ".img"), (".HDR", ".IMG.gz")])
def test_packed_pairs(tmp_path: Path, kind: str, ends: tuple[str, str]) -> None:
    """Either file may be packed by gzip; nibabel reads both or neither."""
    series = np.stack([DATA, DATA + 1], -1).astype(">i2")
    image = getattr(nibabel, kind)(series, np.diag([-2, 3, 4, 1]) if "mat" in dict(getattr(nibabel, kind).files_types) else None)
    image.to_filename(tmp_path / "truth.img")
    for end in (*ends, *([".mat"] if (tmp_path / "truth.mat").exists() else [])):
        content = (tmp_path / f"truth{end[:4].lower()}").read_bytes()
        (tmp_path / f"v{end}").write_bytes(gzip.compress(content) if end.endswith(".gz") else content)
    truth = require_nibabels(tmp_path / "truth.img", series.shape)
    for end in ends:
        volumes = clvol.read_all(tmp_path / f"v{end}")
        np.testing.assert_array_equal(volumes, truth)
        assert (volumes.grid.spacing, volumes.grid.origin) == (truth.grid.spacing, truth.grid.origin)
        if ends[1] == ".img":  # samples can be read on demand
            lazy = clvol.open(tmp_path / f"v{end}", volume=1)
            np.testing.assert_array_equal(lazy.read((1, 2, 0), (5, 5, 3)), truth[1].data[:3, 2:5, 1:5])
    content = (tmp_path / f"v{ends[1]}").read_bytes()
    (tmp_path / f"v{ends[1]}").write_bytes(content[:-9])
    with pytest.raises(FormatError, match=r"480 bytes|Compressed file ended|end-of-stream"):
        clvol.read_all(tmp_path / f"v{ends[0]}")
    (tmp_path / f"v{ends[1]}").unlink()
    with pytest.raises(FormatError, match="beside it, which is not there"):
        clvol.read(tmp_path / f"v{ends[0]}")


def test_several_volumes_and_colours(tmp_path: Path) -> None:
    series = np.stack([DATA, DATA + 1, DATA + 2], -1).astype("i2")
    nibabel.AnalyzeImage(series, None).to_filename(tmp_path / "v.hdr")
    assert require_nibabels(tmp_path / "v.hdr", series.shape).axes == ("volume",)
    colours = np.random.default_rng(1).integers(0, 255, (*DATA.shape, 3), np.uint8)
    image = nibabel.AnalyzeImage(colours.view([(name, "u1") for name in "RGB"])[..., 0], None)
    image.set_data_dtype(image.dataobj.dtype)
    image.to_filename(tmp_path / "c.hdr")
    volumes = clvol.read_all(tmp_path / "c.hdr")
    assert volumes.names == ("red", "green", "blue")
    np.testing.assert_array_equal(volumes, colours.T)


def test_damaged_files_raise(tmp_path: Path) -> None:
    nibabel.AnalyzeImage(DATA.astype("i2"), None).to_filename(tmp_path / "v.hdr")
    header, samples = (tmp_path / "v.hdr").read_bytes(), (tmp_path / "v.img").read_bytes()
    (tmp_path / "v.img").write_bytes(samples[:-1])
    with pytest.raises(FormatError, match=r"v\.img must hold 240 bytes"):
        clvol.read(tmp_path / "v.hdr")
    (tmp_path / "v.img").unlink()
    with pytest.raises(FormatError):
        clvol.read(tmp_path / "v.hdr")
    (tmp_path / "v.img").write_bytes(samples)
    for damaged in (header[:-9], header[:70] + b"\xff\xff" + header[72:], header[:40] + b"\xff\x7f" + header[42:]):
        (tmp_path / "v.hdr").write_bytes(damaged)
        with pytest.raises(FormatError):
            clvol.read(tmp_path / "v.hdr")


def test_other_files_beside_a_header(tmp_path: Path) -> None:
    """They are not its samples."""
    nibabel.AnalyzeImage(DATA.astype("i2"), None).to_filename(tmp_path / "v.hdr")
    (tmp_path / "v.old").write_bytes(b"1 2 3")
    with pytest.raises(FormatError, match="suffix must be one of"):
        clvol.read(tmp_path / "v.old")
