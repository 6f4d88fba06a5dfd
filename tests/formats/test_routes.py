"""Files that other libraries read: the error names the way to a volume, and that way works."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clvol
from clvol.base.errors import FormatError

DATA = np.arange(60, dtype=np.int16).reshape(3, 4, 5)


def nibabels(path: Path) -> None:
    nibabel = pytest.importorskip("nibabel")
    nibabel.save((nibabel.Nifti1Pair if ".img" in path.name else nibabel.Nifti1Image)(DATA.T, np.eye(4)), path)


def itks(path: Path) -> None:
    sitk = pytest.importorskip("SimpleITK")
    sitk.WriteImage(sitk.GetImageFromArray(DATA), path)


def pieces(path: Path) -> None:
    """Image data of VTK in several files."""
    pv = pytest.importorskip("pyvista")
    grid = pv.ImageData(dimensions=(5, 4, 3))
    grid["a"] = DATA.ravel()
    grid.save(path.with_name("piece.vti"))
    extent = "0 4 0 3 0 2"
    path.write_text(
        f'<VTKFile type="PImageData" byte_order="LittleEndian"><PImageData WholeExtent="{extent}" Origin="0 0 0" Spacing="1 1 1">'
        f'<PPointData Scalars="a"><PDataArray type="Int16" Name="a"/></PPointData><Piece Extent="{extent}" Source="piece.vti"/>'
        "</PImageData></VTKFile>"
    )


def rectilinear(path: Path) -> None:
    pv = pytest.importorskip("pyvista")
    grid = pv.ImageData(dimensions=(5, 4, 3))
    grid["a"] = DATA.ravel()
    grid.cast_to_rectilinear_grid().save(path)


ROUTES: dict[str, Any] = {
    ".nii.bz2": (nibabels, "clvol.Volume(nibabel.load(path))"),
    ".img.bz2": (nibabels, "clvol.Volume(nibabel.load(path))"),
    ".gipl": (itks, "clvol.Volume(SimpleITK.ReadImage(path))"),
    ".pvti": (pieces, "clvol.Volume(pyvista.read(path))"),
    ".vtr": (rectilinear, "clvol.Volume(pyvista.ImageData(...).sample(pyvista.read(path)))"),
}


@pytest.mark.parametrize("suffix", ROUTES)
def test_the_error_names_a_way_that_works(tmp_path: Path, suffix: str) -> None:
    write, way = ROUTES[suffix]
    path = tmp_path / f"v{suffix}"
    write(path)
    with pytest.raises(FormatError) as error:
        clvol.read(path)
    assert str(error.value).endswith(f": {way} reads this one")
    libraries: dict[str, Any] = {"clvol": clvol, "path": path}
    for name in ("nibabel", "pyvista", "SimpleITK"):
        if f"{name}." in way:
            libraries[name] = pytest.importorskip(name)
    volume = eval(way.replace("(...)", "(dimensions=(5, 4, 3))").replace("clvol.Volume", ""), libraries)
    if suffix == ".vtr":
        volume.set_active_scalars("a")
    np.testing.assert_array_equal(clvol.Volume(volume).data, DATA)


@pytest.mark.parametrize("name", ["phantom_EPI_asc_CLEAR_2_1.PAR", "phantom_EPI_asc_CLEAR_2_1.REC", "example4d+orig.HEAD"])
def test_files_of_scanners(name: str) -> None:
    nibabel = pytest.importorskip("nibabel")
    path = Path(nibabel.__file__).parent / "tests" / "data" / name
    if not path.exists():
        pytest.skip("this nibabel comes without its samples")
    with pytest.raises(FormatError, match=r"clvol\.Volume\(nibabel\.load\(path\)\) reads this one"):
        clvol.read(path)
    assert len(clvol.Volumes(nibabel.load(path.with_suffix(".PAR") if name.endswith("REC") else path))) > 1
