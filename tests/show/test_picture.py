from __future__ import annotations

from functools import partial
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest

from clvol import FormatError, OptionError
from clvol.show.picture import grid, heat, heat_with_scale, labelled, save, to_bytes
from tests.cases import BAD_COUNTS, BAD_WHOLE

SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".PNG", ".Tif")
SHAPES = ((5, 7), (5, 7, 1), (5, 7, 3), (5, 7, 4), (3, 4), (1, 1, 4), (3, 5, 3))


def smooth(shape: tuple[int, ...]) -> np.ndarray:
    """A picture that JPEG can hold, its opacity between 0.5 and 1."""
    ramp = np.linspace(0.5, 1, shape[0] * shape[1]).reshape(shape[:2])
    return ramp if len(shape) == 2 else np.repeat(ramp[..., None], shape[2], 2)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("shape", SHAPES, ids=str)
@pytest.mark.parametrize("dtype", [np.uint8, np.float32, np.float64])
def test_saved_pictures_read_back(tmp_path: Path, suffix: str, shape: tuple[int, ...], dtype: type) -> None:
    picture = smooth(shape)
    picture = np.rint(picture * 255).astype(dtype) if dtype is np.uint8 else picture.astype(dtype)
    path = tmp_path / f"picture{suffix}"
    assert save(picture, path) == path
    expected = to_bytes(picture).astype(np.float64)
    if shape[2:] == (1,):
        expected = expected[..., 0]
    if shape[2:] == (4,) and suffix.lower() in (".jpg", ".jpeg", ".bmp"):
        expected = np.rint(expected[..., :3] * expected[..., 3:] / 255)
    if shape == (1, 1, 4):
        expected = expected[..., :3] if len(expected.shape) == 3 and expected[..., -1].min() == 255 else expected
    back = iio.imread(path)
    assert back.shape == expected.shape
    assert back.dtype == np.uint8
    assert np.abs(back - expected).max() <= (4 if suffix.startswith(".j") else 0)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_a_wholly_opaque_picture_is_saved_without_opacity(tmp_path: Path) -> None:
    save(np.ones((2, 3, 4), np.float32), tmp_path / "a.png")
    assert iio.imread(tmp_path / "a.png").shape == (2, 3, 3)


def test_values_are_rounded_clipped_and_nan_is_black() -> None:
    values = np.array([[np.nan, -1, 0.0, 0.5, 1.0, 2.0, np.inf, -np.inf]], np.float32)
    assert to_bytes(values).tolist() == [[0, 0, 0, 128, 255, 255, 255, 0]]
    assert to_bytes(values > 0).tolist() == [[0, 0, 0, 255, 255, 255, 255, 0]]


@pytest.mark.parametrize("shape", [(), (3,), (2, 3, 2), (2, 3, 5), (2, 2, 2, 3), (0, 3), (3, 0, 3)], ids=str)
def test_arrays_that_are_not_pictures_are_rejected(shape: tuple[int, ...]) -> None:
    with pytest.raises(OptionError, match=r"a picture has shape"):
        to_bytes(np.zeros(shape, np.float32))


@pytest.mark.parametrize("dtype", [np.int32, np.uint16, np.complex64, object, "U1"], ids=str)
def test_other_dtypes_are_rejected(dtype: type) -> None:
    with pytest.raises(OptionError, match=r"floating values in 0\.\.1, or uint8"):
        to_bytes(np.zeros((2, 2), dtype))


@pytest.mark.parametrize("name", ["a.gif", "a", ".png", "a.png.txt", "a.npy"])
def test_unknown_suffixes_leave_no_file(tmp_path: Path, name: str) -> None:
    with pytest.raises(FormatError, match=r"pictures are written as \.png"):
        save(np.zeros((2, 2)), tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_does_not_exist_is_named(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=r"missing"):
        save(np.zeros((2, 2)), tmp_path / "missing" / "a.png")
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(FormatError, match=r"it is a folder"):
        save(np.zeros((2, 2)), tmp_path / "folder.png")
    assert [p.name for p in tmp_path.iterdir()] == ["folder.png"]


@pytest.mark.parametrize("error", [OSError("no space"), KeyboardInterrupt(), ValueError("odd")], ids=repr)
def test_a_failed_write_leaves_the_old_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
    path = tmp_path / "a.png"
    save(np.zeros((2, 2)), path)
    before = path.read_bytes()

    def fail(file: Path, _: object) -> None:
        with file.open("wb") as stream:
            stream.write(b"half")
        raise error

    monkeypatch.setattr(Path, "write_bytes", fail)
    with pytest.raises(KeyboardInterrupt if isinstance(error, KeyboardInterrupt) else FormatError):
        save(np.ones((2, 2)), path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.png"]


@pytest.mark.parametrize("shape", [(60, 80), (60, 80, 1), (60, 80, 3), (60, 80, 4)], ids=str)
def test_a_label_is_a_band_below_the_picture(shape: tuple[int, ...]) -> None:
    picture = np.full(shape, 0.2, np.float32)
    if shape[2:] == (4,):
        picture[..., 3] = 1
    sheet = labelled(picture, "one\ntwo")
    assert sheet.dtype == np.uint8
    assert sheet.shape[1:] == (80, 3)
    assert (sheet[:60] == 51).all()
    assert sheet[60:].max() > 150  # the letters
    assert labelled(picture, "one").shape[0] < sheet.shape[0]
    assert (labelled(picture, " ")[60:] == sheet[60, 0]).all()


def test_transparency_is_black_in_a_labelled_picture() -> None:
    picture = np.ones((9, 9, 4), np.float32)
    picture[:, :4, 3] = 0
    picture[:, 4:, 3] = 0.5
    sheet = labelled(picture, "x")
    assert (sheet[:9, :4] == 0).all()
    assert (sheet[:9, 4:] == 128).all()


@pytest.mark.parametrize("channels", [(), (1,), (3,), (4,)], ids=str)
def test_a_grid_is_filled_row_by_row(channels: tuple[int, ...]) -> None:
    pictures = [np.full((3, 5, *channels), 10 * (i + 1), np.uint8) for i in range(5)]
    sheet = grid(pictures, columns=3, gap=2)
    assert sheet.shape == (3 + 2 + 3, 5 * 3 + 2 * 2, *channels)
    for i in range(5):
        y, x = i // 3 * 5, i % 3 * 7
        assert (sheet[y : y + 3, x : x + 5] == 10 * (i + 1)).all()
    assert (sheet[3:5] == 0).all()
    assert (sheet[5:, 14:] == 0).all()


def test_a_grid_of_floating_pictures_has_eight_bits() -> None:
    assert grid([np.ones((2, 2, 3), np.float32)], 1).tolist() == np.full((2, 2, 3), 255).tolist()


def test_empty_and_mixed_grids_are_rejected() -> None:
    with pytest.raises(OptionError, match=r"one or more pictures of one shape; got \[\]"):
        grid([], 3)
    with pytest.raises(OptionError, match=r"one shape"):
        grid([np.zeros((2, 2)), np.zeros((2, 3))], 3)
    with pytest.raises(OptionError, match=r"columns of a grid must be a whole number, at least 1; got 0"):
        grid([np.zeros((2, 2))], 0)


@pytest.mark.parametrize(
    "call",
    [
        lambda: save(np.zeros((2, 2)), 3),
        lambda: save(np.zeros((2, 2)), None),
        lambda: save(np.zeros((2, 2)), b"a.png"),
        lambda: save("a", "a.png"),
        lambda: save([[1.0], [1.0, 2.0]], "a.png"),
        lambda: save(None, "a.png"),
        lambda: labelled(np.zeros((2, 2)), 3),
        lambda: grid(3, 1),
        *(partial(grid, [np.zeros((2, 2))], columns) for columns in BAD_COUNTS),
        *(partial(grid, [np.zeros((2, 2))], 1, gap) for gap in (-1, *BAD_WHOLE)),
    ],
)
def test_wrong_types_are_rejected(call) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(OptionError):
        call()


def test_heat_rises_from_black_to_white_and_marks_missing_values() -> None:
    colors = heat([[0.0, 0.25, 0.5, 0.75, 1.0, 7.0, np.nan]])
    assert colors.shape == (1, 7, 3)
    brightness = colors[0, :5].sum(-1)
    assert (np.diff(brightness) > 0.2).all()
    assert brightness[0] < 0.05
    np.testing.assert_array_equal(colors[0, 4], colors[0, 5])
    assert colors[0, 6].argmax() == 2


def test_a_heat_map_has_its_scale_below() -> None:
    values = np.linspace(0, 0.019, 60 * 240).reshape(60, 240)
    values[0, 0] = np.nan
    picture = heat_with_scale(values, "mm", "within")
    assert picture.dtype == np.uint8
    assert picture.shape[1:] == (240, 3)
    assert picture.shape[0] > 60
    np.testing.assert_array_equal(picture[:60], to_bytes(heat(values / 0.02)))  # the next round number
    bar = picture[68, 20:-20].astype(int).sum(-1)
    assert (np.diff(bar) > -3).all()  # from black on the left to pale yellow on the right
    assert bar[-1] - bar[0] > 500
    assert (heat_with_scale(values, "mm", "within", top=1.0)[:60] == to_bytes(heat(values))).all()


@pytest.mark.parametrize(
    ("most", "top"), [(1.0, 1.0), (1.01, 2.0), (2.2, 5.0), (0.051, 0.1), (99.0, 100.0), (3e-7, 5e-7), (0.0, 1.0), (np.nan, 1.0)]
)
def test_scales_end_at_round_numbers(most: float, top: float) -> None:
    np.testing.assert_array_equal(heat_with_scale(np.full((4, 48), most))[:4], to_bytes(heat(np.full((4, 48), most / top))))


@pytest.mark.parametrize("values", [np.zeros(3), np.zeros((2, 2, 2)), np.zeros((0, 4))], ids=str)
def test_a_heat_map_needs_two_dimensions(values: np.ndarray) -> None:
    with pytest.raises(OptionError, match=r"shape \(height, width\)"):
        heat_with_scale(values)
