"""NRRD and MetaImage whose samples are in several files, or are text, against SimpleITK."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

import clvol
from clvol.base.errors import FormatError

sitk = pytest.importorskip("SimpleITK")

DATA = np.arange(60, dtype="<i2").reshape(3, 4, 5) * 7 - 99
NRRD = "NRRD0004\ntype: short\ndimension: 3\nsizes: 5 4 3\nendian: little\nencoding: {}\nspacings: 1 2 3\n"
META = (
    "ObjectType = Image\nNDims = 3\nBinaryData = {}\nBinaryDataByteOrderMSB = False\nElementSpacing = 1 2 3\nOffset = 4 5 6\n"
    "DimSize = 5 4 3\nElementType = MET_SHORT\nElementDataFile = "
)
NAMES = "s001.part\ns002.part\ns003.part\n"


def slices(folder: Path, encoding: str = "raw") -> None:
    """A file for each slice."""
    for number, part in enumerate(DATA, 1):
        raw = part.tobytes()
        text = "\n".join(" ".join(map(str, row)) for row in part).encode() + b"\n"
        content = {"raw": raw, "gzip": gzip.compress(raw), "ascii": text}[encoding]
        (folder / f"s{number:03d}.part").write_bytes(content)


def require_itks(path: Path) -> None:
    image, volume = sitk.ReadImage(path), clvol.read(path)
    np.testing.assert_array_equal(volume.data, sitk.GetArrayFromImage(image))
    np.testing.assert_array_equal(volume.data, DATA)
    assert (volume.spacing, volume.origin) == (image.GetSpacing(), image.GetOrigin())


@pytest.mark.parametrize("encoding", ["raw", "gzip", "ascii"])
@pytest.mark.parametrize("files", [f"LIST\n{NAMES}", f"LIST 2\n{NAMES}", "s%03d.part 1 3 1\n", "./s00%d.part 1 3 1 2\n"])
def test_nrrd_of_several_files(tmp_path: Path, files: str, encoding: str) -> None:
    slices(tmp_path, encoding)
    (tmp_path / "v.nhdr").write_text(NRRD.format(encoding) + f"data file: {files}")
    require_itks(tmp_path / "v.nhdr")


@pytest.mark.parametrize("files", [f"LIST\n{NAMES}", f"LIST 2D\n{NAMES}", "s%03d.part 1 3 1\n"])
@pytest.mark.parametrize("binary", [True, False])
def test_metaimage_of_several_files(tmp_path: Path, files: str, binary: bool) -> None:
    slices(tmp_path, "raw" if binary else "ascii")
    (tmp_path / "v.mhd").write_text(META.format(binary) + files)
    require_itks(tmp_path / "v.mhd")


def test_order_of_the_files_is_that_of_the_header(tmp_path: Path) -> None:
    slices(tmp_path)
    (tmp_path / "v.nhdr").write_text(NRRD.format("raw") + "data file: s%03d.part 3 1 -1\n")
    np.testing.assert_array_equal(clvol.read(tmp_path / "v.nhdr").data, DATA[::-1])
    np.testing.assert_array_equal(clvol.read(tmp_path / "v.nhdr").data, sitk.GetArrayFromImage(sitk.ReadImage(tmp_path / "v.nhdr")))


@pytest.mark.parametrize("separator", [" ", "\n", ", "])
@pytest.mark.parametrize("name", ["ascii", "text", "txt"])
def test_nrrd_of_text(tmp_path: Path, name: str, separator: str) -> None:
    (tmp_path / "v.nrrd").write_text(
        NRRD.format(name).replace("endian: little\n", "") + "\n" + separator.join(map(str, DATA.ravel()))
    )
    require_itks(tmp_path / "v.nrrd")


def test_metaimage_of_text(tmp_path: Path) -> None:
    text = " ".join(map(str, DATA.ravel()))
    (tmp_path / "v.mha").write_text(META.format(False) + f"LOCAL\n{text}\n")
    require_itks(tmp_path / "v.mha")
    (tmp_path / "v.txt").write_text(text + "\n")
    (tmp_path / "v.mhd").write_text(META.format(False) + "v.txt\n")
    require_itks(tmp_path / "v.mhd")


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda words: words[:-1], "must hold 60 numbers in its text; found 59"),
        (lambda words: [*words, "5"], "must hold 60 numbers in its text; found 61"),
        (lambda words: [*words[1:], "70000"], "must hold numbers of int16 in its text; they reach from"),
        (lambda words: [*words[1:], "1.5"], "must hold numbers of int16 in its text"),
        (lambda words: [*words[1:], "x"], "must hold numbers of int16 in its text"),
    ],
)
def test_text_that_is_not_the_samples_is_rejected(tmp_path: Path, change, match: str) -> None:  # type: ignore[no-untyped-def]
    """ITK reads what is missing from anywhere, and 70000 as 4464."""
    text = " ".join(change([str(value) for value in DATA.ravel()]))
    (tmp_path / "v.nrrd").write_text(NRRD.format("ascii") + "\n" + text)
    (tmp_path / "v.mha").write_text(META.format(False) + f"LOCAL\n{text}\n")
    for name in ("v.nrrd", "v.mha"):
        with pytest.raises(FormatError, match=match):
            clvol.read(tmp_path / name)


def test_files_of_wrong_length_or_elsewhere_are_rejected(tmp_path: Path) -> None:
    slices(tmp_path)
    (tmp_path / "s002.part").write_bytes(DATA[1].tobytes()[:-1])
    headers = {"v.nhdr": NRRD.format("raw") + "data file: ", "v.mhd": META.format(True)}
    for name, header in headers.items():
        (tmp_path / name).write_text(header + "s%03d.part 1 3 1\n")
        with pytest.raises(FormatError, match=r"s002\.part must hold 40 bytes"):
            clvol.read(tmp_path / name)
        (tmp_path / name).write_text(header + "s%03d.part 1 2 1\n")
        with pytest.raises(FormatError, match=r"must hold 60 bytes|s002\.part must hold"):
            clvol.read(tmp_path / name)
    slices(tmp_path)
    (tmp_path / "below").mkdir()
    for name, header in headers.items():
        (tmp_path / "below" / name).write_text(header + "../s%03d.part 1 3 1\n")
        with pytest.raises(FormatError, match="own folder or below"):
            clvol.read(tmp_path / "below" / name)
        np.testing.assert_array_equal(clvol.read(tmp_path / "below" / name, trusted=True).data, DATA)


def test_they_are_read_whole(tmp_path: Path) -> None:
    slices(tmp_path)
    (tmp_path / "v.nhdr").write_text(NRRD.format("raw") + "data file: s%03d.part 1 3 1\n")
    with pytest.raises(FormatError, match=r"clvol\.read reads it whole"):
        clvol.open(tmp_path / "v.nhdr")
