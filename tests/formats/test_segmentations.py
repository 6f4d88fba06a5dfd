"""Segmentations of 3D Slicer (``.seg.nrrd``), by hand as it writes them, and by SimpleITK."""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clvol
from clvol.base.errors import FormatError, OptionError

sitk = pytest.importorskip("SimpleITK")

LABELS = np.zeros((4, 5, 6), np.uint8)
LABELS[1:3, 1:3, 1:3] = 1
LABELS[:, 4] = 7
NAMES = {1: "liver: left lobe", 7: "Herz – ä"}
COLORS = {1: (0.5, 0.25, 1.0), 7: (0.0, 1.0, 0.125)}
HEAD = (
    "NRRD0004\n# Complete NRRD file format specification at:\ntype: unsigned char\ndimension: {rank}\n"
    "space: left-posterior-superior\nsizes: {sizes}\nspace directions: {none}(1,0,0) (0,2,0) (0,0,3)\nkinds: {kinds}\n"
    "encoding: gzip\nspace origin: (4,5,6)\n"
)


def segment(n: int, label: int | None, name: str, color: Any, layer: int | None = 0) -> str:
    fields = {"Color": " ".join(map(str, color)), "Extent": "0 5 0 4 0 3", "ID": f"Segment_{n}", "Name": name, "Tags": "a:b|"}
    fields |= {"LabelValue": str(label)} if label is not None else {}
    fields |= {"Layer": str(layer)} if layer is not None else {}
    return "".join(f"Segment{n}_{key}:={value}\n" for key, value in fields.items())


def written(path: Path, layers: Any, *segments: str) -> Path:
    """A file of one layer [z, y, x], or of several [layer, z, y, x], which are the fastest axis."""
    several = np.ndim(layers) == 4
    sizes = " ".join(map(str, (*layers.shape[:1], *layers.shape[:0:-1]) if several else layers.shape[::-1]))
    kinds = "list domain domain domain" if several else "domain domain domain"
    head = HEAD.format(rank=np.ndim(layers), sizes=sizes, kinds=kinds, none="none " if several else "")
    stored = np.moveaxis(layers, 0, -1) if several else layers
    path.write_bytes(head.encode() + "".join(segments).encode() + b"\n" + gzip.compress(stored.tobytes()))
    return path


def test_one_layer_is_labels(tmp_path: Path) -> None:
    texts = [segment(n, label, NAMES[label], COLORS[label]) for n, label in enumerate(NAMES)]
    volume = clvol.read(written(tmp_path / "v.seg.nrrd", LABELS, *texts))
    np.testing.assert_array_equal(volume.data, LABELS)
    assert (volume.labels, volume.is_labels) == (NAMES, True)
    assert (volume.spacing, volume.origin, volume.space) == ((1, 2, 3), (4, 5, 6), "LPS")
    assert volume.header["segments"][1] == {"id": "Segment_1", "name": NAMES[7], "label": 7, "layer": 0, "color": COLORS[7]}


def test_colours_are_those_of_the_file(tmp_path: Path) -> None:
    """In the look of labels, also after the volume was written and read again."""
    texts = [segment(n, label, NAMES[label], COLORS[label]) for n, label in enumerate(NAMES)]
    volume = clvol.read(written(tmp_path / "v.seg.nrrd", LABELS, *texts))
    clvol.write(volume, tmp_path / "v.npz")
    for one in (volume, clvol.read(tmp_path / "v.npz")):
        look = clvol.TransferFunction.preset("labels", one)
        np.testing.assert_allclose(look([1.0, 7.0])[:, :3], list(COLORS.values()))
    other = clvol.Volume(LABELS, labels=NAMES)
    assert not np.allclose(clvol.TransferFunction.preset("labels", other)([1.0])[0, :3], COLORS[1])


def test_layers_are_a_channel_for_each_segment(tmp_path: Path) -> None:
    """Two segments of one layer, and one that overlaps both."""
    over = (np.indices(LABELS.shape).sum(0) % 2).astype(np.uint8) * 3
    texts = [segment(0, 1, "a", COLORS[1]), segment(1, 3, "over", (1, 0, 0), 1), segment(2, 7, "b", COLORS[7])]
    path = written(tmp_path / "v.seg.nrrd", np.stack([LABELS, over]), *texts)
    volumes = clvol.read_all(path)
    assert volumes.names == ("a", "over", "b")
    assert [volume.color for volume in volumes] == [COLORS[1], (1, 0, 0), COLORS[7]]
    np.testing.assert_array_equal(volumes, np.stack([LABELS == 1, over == 3, LABELS == 7]))
    one = clvol.read(path, channel="over")
    np.testing.assert_array_equal(one.data, over == 3)
    assert (one.name, one.spacing, one.origin) == ("over", (1, 2, 3), (4, 5, 6))
    with pytest.raises(OptionError, match=r"0 to 2, of 0 \(a\), 1 \(over\), 2 \(b\)"):
        clvol.read(path, channel="c")


def test_old_files_have_a_layer_for_each_segment(tmp_path: Path) -> None:
    masks = np.stack([LABELS == 1, LABELS == 7]).astype(np.uint8)
    texts = [segment(n, None, name, COLORS[1], None) for n, name in enumerate("ab")]
    volumes = clvol.read_all(written(tmp_path / "v.seg.nrrd", masks, *texts))
    assert volumes.names == ("a", "b")
    np.testing.assert_array_equal(volumes, masks)


def test_of_simpleitk(tmp_path: Path) -> None:
    """Uncompressed, which is read in parts too."""
    image = sitk.GetImageFromArray(LABELS)
    for n, label in enumerate(NAMES):
        for key, value in (("ID", f"s{n}"), ("Name", str(label)), ("LabelValue", str(label)), ("Layer", "0"), ("Color", "1 0 0")):
            image.SetMetaData(f"Segment{n}_{key}", value)
    sitk.WriteImage(image, tmp_path / "v.seg.nrrd")
    for volume in (clvol.read(tmp_path / "v.seg.nrrd"), clvol.open(tmp_path / "v.seg.nrrd").whole()):
        np.testing.assert_array_equal(volume.data, LABELS)
        assert volume.labels == {1: "1", 7: "7"}


@pytest.mark.parametrize(
    "text",
    [segment(0, 1, "a", (1, 0)), segment(0, 1, "a", ("x", 0, 0)), segment(0, 1, "a", (1, 0, 0), 5), segment(0, -1, "a", (1, 0, 0))],
)
def test_damaged_segments_are_rejected(tmp_path: Path, text: str) -> None:
    with pytest.raises(FormatError):
        clvol.read(written(tmp_path / "v.seg.nrrd", LABELS, text))
