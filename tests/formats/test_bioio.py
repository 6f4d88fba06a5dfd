"""Microscope vendors' files: a CZI file written by Zeiss' library, and the message if a reader is missing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clvol
from clvol import formats
from clvol.base.errors import FormatError, MissingDependencyError
from clvol.formats import bioio

DATA = np.arange(2 * 3 * 4 * 16 * 20, dtype=np.uint16).reshape(2, 3, 4, 16, 20)


@pytest.fixture(scope="module")
def czi(tmp_path_factory: pytest.TempPathFactory) -> Path:
    writer = pytest.importorskip("pylibCZIrw.czi")
    pytest.importorskip("bioio_czi")
    path = tmp_path_factory.mktemp("czi") / "cells.czi"
    with writer.create_czi(str(path)) as file:
        for t, c, z in np.ndindex(2, 3, 4):
            file.write(data=DATA[t, c, z][..., None], plane={"T": t, "C": c, "Z": z})
        names = {0: "DAPI", 1: "GFP", 2: "Cy5"}
        file.write_metadata("cells", channel_names=names, scale_x=0.25e-6, scale_y=0.5e-6, scale_z=2e-6)
    return path


def test_channels_and_times_of_czi(czi: Path) -> None:
    volume = clvol.read(czi, time=1, channel="GFP")
    np.testing.assert_array_equal(volume.data, DATA[1, 1])
    np.testing.assert_allclose(volume.spacing, (0.25, 0.5, 2.0))
    assert (volume.units, volume.name, volume.space) == ("um", "GFP", "image")
    assert clvol.read_all(czi).axes == ("time", "channel")
    assert [one.shape for one in formats.series_of(czi)] == [DATA.shape]


@pytest.mark.usefixtures("czi")  # which skips where the writer or the reader is missing
def test_colours_of_czi(tmp_path: Path) -> None:
    """Zeiss' documentation of the pixel types: the file has blue, green, red."""
    from pylibCZIrw import czi as writer

    blue_first = np.random.default_rng(0).integers(0, 255, (16, 20, 3), np.uint8)
    with writer.create_czi(str(tmp_path / "v.czi")) as file:
        file.write(data=blue_first, plane={"T": 0, "C": 0, "Z": 0})
        file.write_metadata("colours")
    everything = clvol.read_all(tmp_path / "v.czi")
    assert everything.names == ("red", "green", "blue")
    np.testing.assert_array_equal(np.asarray(everything), np.moveaxis(blue_first[..., ::-1], -1, 0))
    np.testing.assert_array_equal(clvol.read(tmp_path / "v.czi", channel="blue").data, blue_first[..., 0])


def test_damaged_czi(czi: Path, tmp_path: Path) -> None:
    content = czi.read_bytes()
    for part in (b"", b"1 2 3", content[:3000]):
        (tmp_path / "v.czi").write_bytes(part)
        with pytest.raises(FormatError, match=r"v\.czi is damaged or unusual, says bioio-czi: "):
            clvol.read(tmp_path / "v.czi")


@pytest.mark.parametrize(
    ("suffix", "command"),
    [(".czi", r'"clvol\[bioio\]"$'), (".lif", r'"clvol\[bioio\]" bioio-lif'), (".ND2", "bioio-nd2"), (".vsi", "bioio-bioformats")],
)
def test_missing_readers_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str, command: str) -> None:
    found = bioio.find_spec

    def hidden(name: str) -> Any:
        return None if name.startswith("bioio") else found(name)

    monkeypatch.setattr(bioio, "find_spec", hidden)
    (tmp_path / f"v{suffix}").write_bytes(b"")
    with pytest.raises(MissingDependencyError, match=rf"{suffix.lower()} files need bioio.*pip install .*{command}"):
        clvol.read(tmp_path / f"v{suffix}", trusted=True)
