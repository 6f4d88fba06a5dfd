"""Single images and folders of them, and how files and folders are recognised."""

from __future__ import annotations

import warnings
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest
from PIL import Image

import clvol
from clvol import ClvolWarning, formats
from clvol.base.errors import DataError, FormatError, OptionError

DATA = np.random.default_rng(3).integers(0, 60000, (12, 5, 7)).astype(np.uint16)


def fill(folder: Path, name: str = "slice_{}.png", data: np.ndarray = DATA) -> Path:
    for i, samples in enumerate(data):
        iio.imwrite(folder / name.format(i), samples)
    return folder


def test_slices_in_the_natural_order_of_their_names(tmp_path: Path) -> None:
    fill(tmp_path)
    (tmp_path / "notes.txt").write_text("taken on Monday")
    (tmp_path / "._slice_3.png").write_bytes(b"of another program")
    with pytest.warns(ClvolWarning, match=r"12 images \(slice_0\.png to slice_11\.png\).*1 apart: spacing="):
        volume = clvol.read(tmp_path)
    np.testing.assert_array_equal(volume.data, DATA)
    assert (volume.data.dtype, volume.space, volume.spacing) == (np.uint16, "image", (1, 1, 1))
    with warnings.catch_warnings(action="ignore"):
        assert clvol.read(tmp_path, spacing=(1, 1, 3)).spacing == (1, 1, 3)


def test_slices_of_tiff_keep_their_spacing(tmp_path: Path) -> None:
    tifffile = pytest.importorskip("tifffile")
    for i in range(3):
        tifffile.imwrite(tmp_path / f"{i}.tif", DATA[i], imagej=True, resolution=(4, 2), metadata={"unit": "um"})
    with pytest.warns(ClvolWarning, match="3 images"):
        volume = clvol.read(tmp_path)
    np.testing.assert_array_equal(volume.data, DATA[:3])
    assert (volume.spacing, volume.units) == ((0.25, 0.5, 1.0), "um")
    tifffile.imwrite(tmp_path / "1.tif", DATA, photometric="minisblack", metadata={"axes": "ZYX"})
    with pytest.raises(DataError, match=r"1\.tif.*12, 5, 7.*by itself"), warnings.catch_warnings(action="ignore"):
        clvol.read(tmp_path)


LABELS = np.random.default_rng(5).integers(0, 13, (3, 5, 7)).astype(np.uint8)


def paletted(path: Path, indices: np.ndarray, seed: int = 0, count: int = 13) -> None:
    """An image of indices, in colours without order."""
    image = Image.frombytes("P", indices.shape[::-1], indices.tobytes())
    image.putpalette(np.random.default_rng(seed).integers(0, 256, (count, 3)).astype(np.uint8).tobytes())
    image.save(path)


@pytest.mark.parametrize("suffix", [".png", ".bmp"])
@pytest.mark.parametrize("count", [2, 13, 256])
def test_palettes_give_indices(tmp_path: Path, suffix: str, count: int) -> None:
    """As of a TIFF file with the same palette, read by tifffile: labels, whatever their colours. Of few colours, in fewer bits."""
    tifffile = pytest.importorskip("tifffile")
    indices = (LABELS[0].astype(int) * 19 % count).astype(np.uint8)
    paletted(tmp_path / f"v{suffix}", indices, count=count)
    paletted(tmp_path / "v.tif", indices, count=count)
    volume = clvol.read(tmp_path / f"v{suffix}")
    np.testing.assert_array_equal(volume.data, tifffile.imread(tmp_path / "v.tif"))
    np.testing.assert_array_equal(volume.data, clvol.read(tmp_path / "v.tif").data)
    np.testing.assert_array_equal(volume.data, indices)


@pytest.mark.parametrize("suffix", [".png", ".bmp", ".tif"])
def test_folders_of_palettes(tmp_path: Path, suffix: str) -> None:
    """Indices, with a warning where they differ in meaning."""
    for i, indices in enumerate(LABELS):
        paletted(tmp_path / f"{i}{suffix}", indices, count=13 + i)  # more colours, in the same order
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        np.testing.assert_array_equal(clvol.read(tmp_path).data, LABELS)
    assert not any("several palettes" in str(one.message) for one in warned)
    paletted(tmp_path / f"2{suffix}", LABELS[2], seed=1)
    with pytest.warns(ClvolWarning, match=rf"several palettes, 0\{suffix} and 2\{suffix}"):
        clvol.read(tmp_path)


def test_slices_in_colour(tmp_path: Path) -> None:
    data = (DATA[:9] % 256).astype(np.uint8).reshape(3, 5, 7, 3)
    fill(tmp_path, "{}.png", data)
    with warnings.catch_warnings(action="ignore"):
        np.testing.assert_array_equal(clvol.read(tmp_path, channel="blue").data, data[..., 2])
        everything = clvol.read_all(tmp_path)
        np.testing.assert_allclose(clvol.read(tmp_path).data, data @ [0.2126, 0.7152, 0.0722], atol=0.5001)
    np.testing.assert_array_equal(np.asarray(everything), np.moveaxis(data, -1, 0))


@pytest.mark.parametrize("other", ["shape", "dtype", "kind", "damaged"])
def test_slices_of_different_shapes(tmp_path: Path, other: str) -> None:
    fill(tmp_path)
    path = tmp_path / "slice_4.png"
    if other == "kind":
        iio.imwrite(tmp_path / "thumbnail.jpg", np.zeros((5, 7), np.uint8))
    elif other == "damaged":
        path.write_bytes(path.read_bytes()[:80])
    else:
        iio.imwrite(path, DATA[4, 1:] if other == "shape" else DATA[4].astype(np.uint8))
    match = {
        "shape": r"one shape and dtype.*slice_0\.png: \(5, 7\).*slice_4\.png: \(4, 7\)",
        "dtype": "uint16 and .*uint8",
        "kind": r"one kind; found 12 \.png, 1 \.jpg",
        "damaged": "cannot read",
    }[other]
    with pytest.raises((DataError, FormatError), match=match), warnings.catch_warnings(action="ignore"):
        clvol.read(tmp_path)


def test_one_image(tmp_path: Path) -> None:
    iio.imwrite(tmp_path / "grey.png", DATA[0])
    image = clvol.read(tmp_path / "grey.png")
    np.testing.assert_array_equal(image.data, DATA[0])
    colours = (DATA[:9] % 256).astype(np.uint8).reshape(3, 5, 7, 3)[0]
    iio.imwrite(tmp_path / "c.png", colours)
    np.testing.assert_array_equal(clvol.read(tmp_path / "c.png", channel="red").data, colours[..., 0])
    with pytest.raises(OptionError, match=r"red.*luminance"):
        clvol.read(tmp_path / "c.png", channel="DAPI")
    pillow = pytest.importorskip("PIL.Image")
    pillow.fromarray(np.full((5, 7, 3), 255, np.uint8)).convert("CMYK").save(tmp_path / "k.jpg")  # no ink is white
    assert clvol.read(tmp_path / "k.jpg").data.min() > 250


@pytest.mark.parametrize("content", [b"", b"this is not a picture", b"\x89PNG\r\n\x1a\n" + bytes(50)])
def test_files_that_are_not_images(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "v.png").write_bytes(content)
    with pytest.raises(FormatError, match=r"cannot read .*v\.png"):
        clvol.read(tmp_path / "v.png")


@pytest.mark.parametrize("at", [18, 22], ids=["width", "height"])
def test_bmp_samples_beyond_the_end_are_rejected_before_allocation(tmp_path: Path, at: int) -> None:
    """Pillow allocates them first: hundreds of megabytes, some of which stayed allocated."""
    file = tmp_path / "v.bmp"
    iio.imwrite(file, DATA[0].astype(np.uint8))
    content = bytearray(file.read_bytes())
    content[at : at + 4] = (1 << 24).to_bytes(4, "little")
    file.write_bytes(content)
    with pytest.raises(FormatError, match="its samples end at byte"):
        clvol.read(file)


def test_jpeg_segments_must_be_contiguous(tmp_path: Path) -> None:
    """Padding before a segment, restarts, several scans and data behind the image are valid."""
    picture = np.add.outer(np.arange(64), np.arange(64)).astype(np.uint8)
    sound = {"progressive": {"progressive": True}, "restarts": {"restart_marker_blocks": 2}, "colours": {"subsampling": 2}}
    for name, options in sound.items():
        data = np.stack([picture] * 3, axis=-1) if name == "colours" else picture
        iio.imwrite(tmp_path / f"{name}.jpg", data, **options)
        clvol.read_all(tmp_path / f"{name}.jpg")
    content = (tmp_path / "restarts.jpg").read_bytes()
    table = content.index(b"\xff\xdb")
    filled = content[:table] + b"\xff\xff" + content[table:] + b"behind"
    (tmp_path / "filled.jpg").write_bytes(filled)
    np.testing.assert_array_equal(clvol.read(tmp_path / "filled.jpg").data, clvol.read(tmp_path / "restarts.jpg").data)
    for damaged in (content[:table] + b"x" + content[table:], content[:-2], content[: len(content) // 2]):
        (tmp_path / "damaged.jpg").write_bytes(damaged)
        with pytest.raises(FormatError, match=r"damaged"):
            clvol.read(tmp_path / "damaged.jpg")


def test_a_folder_without_images_lists_its_contents(tmp_path: Path) -> None:
    for name in ("a.txt", "b.txt", "c.csv"):
        (tmp_path / name).write_text("1")
    for name in ("red", "green"):
        (tmp_path / name).mkdir()
    with pytest.raises(
        FormatError,
        match=r"DICOM files, itself.*below it, image slices.*Zarr.*2 files \.txt, 1 file \.csv, 2 folders \(green, red\)",
    ):
        clvol.read(tmp_path)
    with pytest.raises(FormatError, match="this one holds nothing"):
        clvol.read(tmp_path / "red")


def test_an_unknown_suffix_lists_the_formats(tmp_path: Path) -> None:
    (tmp_path / "v.txt").write_text("1 2 3")
    with pytest.raises(
        FormatError, match=r"v\.txt: its suffix must be one of \.npy .*\.nii\.gz .*\.czi .*a folder may hold DICOM.*Zarr"
    ):
        clvol.read(tmp_path / "v.txt")
    with pytest.raises(FormatError, match=r"only read; written are \.npy") as caught:
        formats.write(DATA, tmp_path / "v.png")
    assert ".czi" not in str(caught.value)
