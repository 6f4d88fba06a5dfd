"""MetaImage files with an intensity function, value = slope × sample + offset, and a unit of length."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import clvol
from clvol.base.errors import FormatError

pytest.importorskip("SimpleITK")

SAMPLES = np.arange(24, dtype=np.uint8).reshape(2, 3, 4)


def metaimage(path: Path, *lines: str, file: str = "LOCAL", data: np.ndarray = SAMPLES) -> Path:
    fields = ["ObjectType = Image", "NDims = 3", "BinaryData = True", "BinaryDataByteOrderMSB = False", *lines]
    fields += ["ElementSpacing = 1 2 3", "DimSize = 4 3 2", "ElementType = MET_UCHAR", f"ElementDataFile = {file}"]
    text = "".join(f"{line}\n" for line in fields).encode()
    if file == "LOCAL":
        path.write_bytes(text + data.tobytes())
    else:
        path.write_bytes(text)
        path.with_name(file).write_bytes(data.tobytes())
    return path


@pytest.mark.parametrize("suffix", [".mha", ".mhd"])
@pytest.mark.parametrize(("slope", "offset"), [(2, 5), (1, -1024), (0.1, 0), (1e-20, 0), (-1, 255), (1e-3, 101325)])
def test_the_intensity_function_is_applied(tmp_path: Path, slope: float, offset: float, suffix: str) -> None:
    """ITK ignores these fields."""
    lines = (f"ElementToIntensityFunctionSlope = {slope}", f"ElementToIntensityFunctionOffset = {offset}")
    read = clvol.read(metaimage(tmp_path / f"v{suffix}", *lines, file="LOCAL" if suffix == ".mha" else "v.raw"))
    np.testing.assert_array_equal(read.data, slope * SAMPLES.astype(np.float64) + offset)
    assert read.data.dtype == np.float64
    assert read.spacing == (1, 2, 3)


def test_an_incomplete_intensity_function(tmp_path: Path) -> None:
    read = clvol.read(metaimage(tmp_path / "a.mha", "ElementToIntensityFunctionSlope = 3"))
    np.testing.assert_array_equal(read.data, 3.0 * SAMPLES)
    read = clvol.read(metaimage(tmp_path / "b.mha", "ElementToIntensityFunctionOffset = 3"))
    np.testing.assert_array_equal(read.data, 3.0 + SAMPLES)


def test_the_identity_keeps_the_samples(tmp_path: Path) -> None:
    lines = ("ElementToIntensityFunctionSlope = 1", "ElementToIntensityFunctionOffset = 0")
    read = clvol.read(metaimage(tmp_path / "v.mha", *lines))
    np.testing.assert_array_equal(read.data, SAMPLES)
    assert read.data.dtype == np.uint8


@pytest.mark.parametrize("line", ["Slope = 0", "Slope = nan", "Slope = x", "Slope = 1 2", "Offset = inf", "Offset ="])
def test_an_invalid_intensity_function_is_an_error(tmp_path: Path, line: str) -> None:
    with pytest.raises(FormatError, match=r"ElementToIntensityFunction|finite numbers|a slope that is not 0"):
        clvol.read(metaimage(tmp_path / "v.mha", f"ElementToIntensityFunction{line}"))


@pytest.mark.parametrize(("field", "units"), [("um", "um"), ("mm", "mm"), ("cm", "cm"), ("?", "mm")])
def test_units(tmp_path: Path, field: str, units: str) -> None:
    read = clvol.read(metaimage(tmp_path / "v.mha", f"DistanceUnits = {field}"))
    assert (read.units, read.spacing) == (units, (1, 2, 3))


def test_unknown_units_are_an_error(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="DistanceUnits"):
        clvol.read(metaimage(tmp_path / "v.mha", "DistanceUnits = furlong"))


@pytest.mark.parametrize("neighbour", ["v", "v.raw", "v.raw.gz", "v.zraw", "v.mha", "data.raw"])
def test_files_of_similar_names_are_ignored(tmp_path: Path, neighbour: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The samples come from the file that the header names, in the header's folder, not the working directory."""
    path = metaimage(tmp_path / "v.mhd", file="v.bin")
    (tmp_path / neighbour).write_bytes((SAMPLES + 100).tobytes())
    (tmp_path / "current").mkdir()
    (tmp_path / "current" / "v.bin").write_bytes((SAMPLES + 200).tobytes())
    monkeypatch.chdir(tmp_path / "current")
    np.testing.assert_array_equal(clvol.read(path).data, SAMPLES)
    header = "NRRD0004\ntype: uchar\ndimension: 3\nsizes: 4 3 2\nencoding: raw\ndata file: v.bin\n"
    (tmp_path / "v.nhdr").write_text(header)
    np.testing.assert_array_equal(clvol.read(tmp_path / "v.nhdr").data, SAMPLES)
