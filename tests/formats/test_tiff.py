"""TIFF files written by tifffile, as microscope programs do: channels, times, several images, several levels."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clvol
from clvol import ClvolWarning, Volume, Volumes, formats
from clvol.base.errors import DataError, FormatError, GeometryError, OptionError
from clvol.volume.volumes import Leading

tifffile = pytest.importorskip("tifffile")

SHAPE = (2, 3, 4, 5, 6)  # times, channels, slices, rows, columns
DATA = np.arange(np.prod(SHAPE), dtype=np.uint16).reshape(SHAPE)
MICROMETRES = {"PhysicalSizeX": 0.25, "PhysicalSizeY": 0.5, "PhysicalSizeZ": 2.0}
RED, LIME, MAGENTA = -16776961, 16711935, -16711681  # as OME has them: RGBA in a signed number


@pytest.fixture
def ome(tmp_path: Path) -> Path:
    channels = {"Name": ["DAPI", "GFP", "Cy5"], "Color": [RED, LIME, MAGENTA]}
    path = tmp_path / "cells.ome.tif"
    tifffile.imwrite(path, DATA, ome=True, photometric="minisblack", metadata={"axes": "TCZYX", "Channel": channels, **MICROMETRES})
    return path


def test_channels_and_times_of_ome(ome: Path) -> None:
    volume = clvol.read(ome, time=1, channel="GFP")
    np.testing.assert_array_equal(volume.data, DATA[1, 1])
    assert (volume.spacing, volume.units, volume.space) == ((0.25, 0.5, 2.0), "um", "image")
    assert (volume.name, volume.color) == ("GFP", (0.0, 1.0, 0.0))
    assert clvol.read(ome, time=0, channel=2).color == (1.0, 0.0, 1.0)
    everything = clvol.read_all(ome)
    np.testing.assert_array_equal(np.asarray(everything), DATA)
    assert everything.axes == ("time", "channel")
    assert clvol.read_all(ome, time=1).names == ("DAPI", "GFP", "Cy5")
    assert [(v.name, v.color) for v in clvol.read_all(ome, channel="GFP")] == [("GFP", (0.0, 1.0, 0.0))] * 2


def test_the_first_volume_is_read_with_a_warning_that_lists_all(ome: Path) -> None:
    with pytest.warns(ClvolWarning, match=r"2 times × 3 channels \(DAPI, GFP, Cy5\).*time 0, channel 0 \(DAPI\)") as told:
        volume = clvol.read(ome)
    assert told[0].filename == __file__
    np.testing.assert_array_equal(volume.data, DATA[0, 0])
    with pytest.raises(OptionError, match=r"0 to 2, of 0 \(DAPI\), 1 \(GFP\), 2 \(Cy5\).*3 channels"):
        clvol.read(ome, channel=3, time=0)


def test_only_chosen_pages_are_decoded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "v.ome.tif"
    tifffile.imwrite(path, DATA, ome=True, photometric="minisblack", metadata={"axes": "TCZYX"}, compression="zlib")
    asked: list[int] = []
    whole = tifffile.TiffFile.asarray

    def asarray(self: Any, key: Any = None, **options: Any) -> Any:
        asked.extend(key)
        return whole(self, key, **options)

    monkeypatch.setattr(tifffile.TiffFile, "asarray", asarray)
    clvol.read(path, time=1, channel=1, trusted=True)
    # pages in the order of the axes T, C, Z
    assert asked == [16, 17, 18, 19]


def test_an_intact_time_of_a_damaged_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "v.ome.tif"
    options = {"photometric": "minisblack", "metadata": {"axes": "TCZYX"}, "compression": "zlib"}
    tifffile.imwrite(path, DATA, ome=True, **options)
    with tifffile.TiffFile(path) as file:
        start, length = (one[0] for one in (file.pages[23].dataoffsets, file.pages[23].databytecounts))
    content = bytearray(path.read_bytes())
    content[start : start + length] = bytes(length)
    path.write_bytes(content)
    np.testing.assert_array_equal(clvol.read(path, time=0, channel=0).data, DATA[0, 0])
    with pytest.raises(FormatError, match="cannot read"):
        clvol.read(path, time=1, channel=2)


def test_channels_of_imagej(tmp_path: Path) -> None:
    path = tmp_path / "v.tif"
    ramp = np.arange(256, dtype=np.uint8)
    tables = [np.stack([ramp, 0 * ramp, ramp]), np.stack([0 * ramp, ramp, 0 * ramp]), np.stack([ramp[::-1], ramp, ramp])]
    labels = [f"c:{c + 1}/3 z:{z + 1}/4 t:{t + 1}/2 - {name}" for t in range(2) for z in range(4) for c, name in enumerate("abc")]
    metadata = {"axes": "TZCYX", "spacing": 3.0, "unit": "um", "LUTs": tables, "Labels": labels, "Ranges": (0, 10, 5, 20, 7, 7.5)}
    tifffile.imwrite(path, DATA.swapaxes(1, 2), imagej=True, resolution=(4.0, 2.0), metadata=metadata)
    volumes = clvol.read_all(path, time=1)
    np.testing.assert_array_equal(np.asarray(volumes), DATA[1])
    assert volumes.grid.spacing == (0.25, 0.5, 3.0)
    assert volumes.names == ("a", "b", "c")
    assert [v.color for v in volumes] == [(1, 0, 1), (0, 1, 0), None]  # the third is no ramp from black
    assert [v.clim for v in volumes] == [(0, 10), (5, 20), (7, 7.5)]


@pytest.mark.parametrize(
    ("text", "spacing", "units", "warned"),
    [
        ("unit=um\nyunit=um\nzunit=nm\nspacing=2000", (0.5, 0.25, 2), "um", False),
        ("unit=\\u00B5m\nyunit=mm\nspacing=2", (0.5, 250, 2), "um", False),
        ("unit=nm\nzunit=micron\nspacing=-2", (0.5, 0.25, 2000), "nm", False),
        ("unit=pixel\nzunit=um\nspacing=3", (0.5, 0.25, 3), "", True),
        ("zunit=um\nspacing=3", (0.5, 0.25, 3), "", True),
        ("unit=um\nzunit=sec\nspacing=3", (0.5, 0.25, 3), "", True),
        ("unit=um", (0.5, 0.25, 1), "um", False),
    ],
)
def test_units_of_imagej(tmp_path: Path, text: str, spacing: tuple[float, ...], units: str, warned: bool) -> None:
    """Each axis has a unit of its own, by default that of x; what cannot be converted is said."""
    data = DATA[0, 0]
    text = f"ImageJ=1.54f\nimages=4\nslices=4\n{text}\n"
    about: dict[str, Any] = {"photometric": "minisblack", "resolution": (2, 4)}
    tifffile.imwrite(tmp_path / "v.tif", data, description=text, metadata=None, **about)
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        volume = clvol.read(tmp_path / "v.tif")
    np.testing.assert_allclose(volume.spacing, spacing, rtol=1e-12)
    assert volume.units == units
    assert ["axes of different units" in str(one.message) for one in found] == [True] * warned


def changed(path: Path, old: str, new: str) -> None:
    content = path.read_bytes()
    assert content.count(old.encode()) == 1
    assert len(old) == len(new)
    path.write_bytes(content.replace(old.encode(), new.encode()))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"XYZCT"', '"XYZC "', r"the OME-XML of cells\.ome\.tif must give a DimensionOrder of the letters XYZCT; found 'XYZC '"),
        ('SizeX="6"', 'SizeX="f"', r"the OME-XML of cells\.ome\.tif must give a whole number of at least 1 for SizeX; found 'f'"),
        ('SizeZ="4"', 'SizeZ="4<', r"the OME-XML of cells\.ome\.tif must be well.* column"),
        (f'Color="{LIME}"', 'Color="0x00FF00"', "must give a whole number for Color of a Channel; found '0x00FF00'"),
        ('SizeZ="4"', 'SizeQ="4"', r"the OME-XML of cells\.ome\.tif must give a whole number of at least 1 for SizeZ; found ''"),
        ('PhysicalSizeX="0.25"', 'PhysicalSizeX="f.25"', "PhysicalSizeX must be a positive finite number; found 'f.25'; spacing="),
        ('PhysicalSizeX="0.25"', 'PhysicalSizeX="0.00"', "PhysicalSizeX must be a positive finite number; found '0.00'; spacing="),
    ],
)
def test_what_is_wrong_in_ome_is_named(ome: Path, old: str, new: str, message: str) -> None:
    changed(ome, old, new)
    with pytest.raises((FormatError, GeometryError), match=message):
        clvol.read(ome, channel=0, time=0)
    if "spacing=" in message:
        assert clvol.read(ome, channel=0, time=0, spacing=(1, 2, 3)).spacing == (1, 2, 3)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("slices=4", "slices=f", r"ImageJ's text in v\.tif must give a whole number of at least 1 for slices; found 'f'"),
        ("spacing=3.0", "spacing=f.0", r"spacing must be a positive finite number; found 'f\.0'; spacing="),
        ("max=119.0", "max=f19.0", r"ImageJ's text in v\.tif must give a number for min and max; found 'f19\.0'"),
    ],
)
def test_what_is_wrong_in_imagej_is_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    about: dict[str, Any] = {"axes": "ZYX", "spacing": 3.0, "unit": "um", "min": 0.0, "max": 119.0}
    tifffile.imwrite(tmp_path / "v.tif", DATA[0, 0], imagej=True, resolution=(4.0, 2.0), metadata=about)
    changed(tmp_path / "v.tif", old, new)
    with pytest.raises((FormatError, GeometryError), match=message):
        clvol.read(tmp_path / "v.tif")


@pytest.mark.parametrize(("name", "about"), [("strip", {"rowsperstrip": 8}), ("tile", {"tile": (16, 16)})])
def test_the_damaged_strip_or_tile_is_named(tmp_path: Path, name: str, about: dict[str, Any]) -> None:
    data = np.random.default_rng(0).integers(0, 255, (3, 32, 32)).astype(np.uint8)
    path = tmp_path / "v.tif"
    tifffile.imwrite(path, data, photometric="minisblack", compression="zlib", **about)
    with tifffile.TiffFile(path) as file:
        at = file.pages[1].dataoffsets[2]
    content = bytearray(path.read_bytes())
    content[at + 20 : at + 60] = bytes(40)
    path.write_bytes(content)
    for read in (clvol.read, lambda path: clvol.open(path).read((0, 0, 0), (32, 32, 3))):
        with pytest.raises(FormatError, match=rf"cannot read {name} 2 of page 1 of v\.tif: it is damaged, its codec says: "):
            read(path)


def test_signed_samples_of_imagej(tmp_path: Path) -> None:
    """ImageJ stores them unsigned, with a calibration that maps them back."""
    data = np.array([[-1000, 0], [3000, 32767]], np.int16)
    text = "ImageJ=1.54f\nmin=31768.0\nmax=35768.0\ncf=0\nc0=-32768.0\nc1=1.0\nvunit=Gray Value\n"
    stored = (data.astype(np.int32) + 32768).astype(np.uint16)
    tifffile.imwrite(tmp_path / "v.tif", stored, description=text, metadata=None, photometric="minisblack")
    volume = clvol.read(tmp_path / "v.tif")
    np.testing.assert_array_equal(volume.data, data)
    assert volume.clim == (-1000, 3000)


def test_a_virtual_stack_of_imagej(tmp_path: Path) -> None:
    """One page describes all; samples are contiguous. ImageJ writes stacks beyond 4 GB this way."""
    text = "ImageJ=1.54f\nimages=24\nchannels=3\nslices=4\nframes=2\nhyperstack=true\n"
    path = tmp_path / "v.tif"
    stored = DATA.swapaxes(1, 2).astype(">u2").copy()
    tifffile.imwrite(path, stored[0, 0, 0], description=text, metadata=None, photometric="minisblack", byteorder=">")
    with tifffile.TiffFile(path) as file:
        assert file.pages[0].dataoffsets[0] + 60 == path.stat().st_size
    path.write_bytes(path.read_bytes()[:-60] + stored.tobytes())
    np.testing.assert_array_equal(clvol.read(path, time=1, channel=2).data, DATA[1, 2])
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(FormatError, match=r"cannot read|damaged|must hold"):
        clvol.read(path, time=1, channel=2)


@pytest.mark.parametrize("planar", ["contig", "separate"])
def test_colours(tmp_path: Path, planar: str) -> None:
    data = np.random.default_rng(1).integers(0, 255, (5, 7, 8, 3), np.uint8)
    stored = data if planar == "contig" else np.moveaxis(data, -1, 1).copy()
    tifffile.imwrite(tmp_path / "v.tif", stored, photometric="rgb", planarconfig=planar, metadata=None)
    with pytest.warns(ClvolWarning, match="5 pages"):
        assert clvol.read(tmp_path / "v.tif", channel="green").data.tolist() == data[..., 1].tolist()
    with warnings.catch_warnings(action="ignore"):
        grey = clvol.read(tmp_path / "v.tif")
        assert clvol.read_all(tmp_path / "v.tif").leading.rgb
    np.testing.assert_allclose(grey.data, data @ [0.2126, 0.7152, 0.0722], atol=0.5001)
    assert grey.name == "luminance"


def test_pages_without_metadata_are_slices(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "v.tif", DATA[0, 0], photometric="minisblack", metadata=None)
    with pytest.warns(ClvolWarning, match=r"v\.tif: it does not say what its 4 pages are.*slices, 1 apart: spacing="):
        np.testing.assert_array_equal(clvol.read(tmp_path / "v.tif").data, DATA[0, 0])
    tifffile.imwrite(tmp_path / "w.tif", DATA[0], photometric="minisblack")  # axes QQYX
    with pytest.warns(ClvolWarning, match=r"3 volumes; volume 0 was read.*taken for volume \(3\), z \(4\), y \(5\), x \(6\)"):
        np.testing.assert_array_equal(clvol.read(tmp_path / "w.tif").data, DATA[0, 0])


def test_choosing_a_channel_names_the_pages(tmp_path: Path) -> None:
    """Also where each channel has slices, and in arrays without axis names."""
    tifffile.imwrite(tmp_path / "v.tif", DATA[0, :, 0], photometric="minisblack", metadata=None)
    with warnings.catch_warnings(action="error"):
        np.testing.assert_array_equal(clvol.read(tmp_path / "v.tif", channel=2).data, DATA[0, 2, 0])
    with pytest.raises(OptionError, match=r"time must be 0 to 2, because v\.tif holds 3 times"):
        clvol.read(tmp_path / "v.tif", time=3)
    tifffile.imwrite(tmp_path / "w.tif", DATA[0], photometric="minisblack")
    with pytest.warns(ClvolWarning, match=r"taken for channel \(3\), z \(4\)"):
        np.testing.assert_array_equal(clvol.read(tmp_path / "w.tif", channel=2).data, DATA[0, 2])


def test_several_images(tmp_path: Path) -> None:
    path = tmp_path / "v.ome.tif"
    with tifffile.TiffWriter(path, ome=True) as file:
        for i, name in enumerate(("left", "right")):
            about = {"axes": "ZYX", "Name": name, "PhysicalSizeX": 1 + i, "PhysicalSizeY": 1, "PhysicalSizeZ": 1}
            file.write(DATA[0, i, : 3 + i], photometric="minisblack", metadata=about)
    with pytest.warns(ClvolWarning, match=r"2 images: 0: left \(ZYX, 3 × 5 × 6\), 1: right .*series="):
        np.testing.assert_array_equal(clvol.read(path).data, DATA[0, 0, :3])
    for choice in ("right", 1, "1"):
        volume = clvol.read(path, series=choice)
        np.testing.assert_array_equal(volume.data, DATA[0, 1])
        assert (volume.spacing, volume.name) == ((2, 1, 1), "right")
    assert [(one.id, one.shape) for one in formats.series_of(path)] == [("left", (3, 5, 6)), ("right", (4, 5, 6))]
    with pytest.raises(OptionError, match=r"one of the 2 images of v\.ome\.tif.*left.*right.*got 'up'"):
        clvol.read(path, series="up")


def test_several_levels(tmp_path: Path) -> None:
    """A sample of a level covers the region around it."""
    path = tmp_path / "v.ome.tif"
    full = np.arange(2 * 32 * 48, dtype=np.uint16).reshape(2, 32, 48)
    half = full.reshape(2, 16, 2, 24, 2).mean((2, 4)).astype(np.uint16)
    with tifffile.TiffWriter(path, ome=True) as file:
        file.write(full, subifds=1, photometric="minisblack", metadata={"axes": "ZYX", **MICROMETRES}, tile=(16, 16))
        file.write(half, subfiletype=1, photometric="minisblack", tile=(16, 16))
    np.testing.assert_array_equal(clvol.read(path).data, full)
    small = clvol.read(path, level=1)
    np.testing.assert_array_equal(small.data, half)
    assert (small.spacing, small.origin) == ((0.5, 1.0, 2.0), (0.125, 0.25, 0.0))
    np.testing.assert_allclose(small.center, clvol.read(path).center)
    with pytest.raises(OptionError, match=r"level must be 0 to 1.*2 × 16 × 24; got 2"):
        clvol.read(path, level=2)


@pytest.mark.parametrize("order", ["TC", "CT"])
def test_writing_several(tmp_path: Path, order: str) -> None:
    axes = {"TC": ("time", "channel"), "CT": ("channel", "time")}[order]
    data = DATA if order == "TC" else DATA.swapaxes(0, 1)
    colors = ((1.0, 0.0, 0.0), None, (0.0, 0.2, 1.0))
    leading = Leading(axes, data.shape[:2], {"channel": ("DAPI", "GFP", "Cy5")}, colors)
    clvol.write(Volumes(data, leading=leading, spacing=(0.25, 0.5, 2), units="um"), tmp_path / "v.ome.tif")
    with tifffile.TiffFile(tmp_path / "v.ome.tif") as file:
        assert file.series[0].axes == "TCZYX"
        np.testing.assert_array_equal(file.asarray(), DATA)
        xml = file.ome_metadata
    for said in ('Name="DAPI"', f'Color="{RED}"', 'Color="-1"', 'PhysicalSizeZ="2.0"', 'PhysicalSizeXUnit="µm"'):
        assert said in xml
    read = clvol.read(tmp_path / "v.ome.tif", time=1, channel="Cy5")
    assert (read.color, read.units) == (colors[2], "um")


def test_writing_colours_and_one_volume(tmp_path: Path) -> None:
    data = np.random.default_rng(1).integers(0, 255, (3, 5, 7, 8), np.uint8)
    clvol.write(Volumes(data, leading=Leading.of_rgb(3)), tmp_path / "rgb.tif")
    with tifffile.TiffFile(tmp_path / "rgb.tif") as file:
        assert (file.series[0].axes, file.pages[0].photometric.name) == ("ZYXS", "RGB")
        np.testing.assert_array_equal(file.asarray(), np.moveaxis(data, 0, -1))
    assert clvol.read_all(tmp_path / "rgb.tif").names == ("red", "green", "blue")
    clvol.write(Volume(DATA[0, 0], name="GFP", color=(0, 1, 0)), tmp_path / "one.tif")
    read = clvol.read(tmp_path / "one.tif")
    assert (read.name, read.color, read.shape) == ("GFP", (0, 1, 0), (4, 5, 6))
    positions = Leading(("position",), (3,))
    with pytest.raises(FormatError, match="times and channels; got 3 positions"):
        clvol.write(Volumes(DATA[0], leading=positions), tmp_path / "p.tif")


def test_complex_samples_are_rejected(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "v.tif", np.zeros((3, 4), np.complex64))
    with pytest.raises(DataError, match="real numbers; got dtype complex64"):
        clvol.read(tmp_path / "v.tif")
