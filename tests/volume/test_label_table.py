"""The table of labels: rows, text files of other programs, and what is drawn by it."""

from __future__ import annotations

import copy
import pickle
from pathlib import Path

import numpy as np
import pytest

import clvol
from clvol import TransferFunction, Volume, labels
from clvol.base.errors import ClvolWarning, FormatError, OptionError
from clvol.labels import LabelTable
from clvol.volume.histogram import label_numbers

FREESURFER = """#$Id: FreeSurferColorLUT.txt $
#No. Label Name:                            R   G   B   A

0   Unknown                                 0   0   0   0
17  Left-Hippocampus                        220 216 20  0   1
1035 ctx-lh-insula                          255 192 32  51
"""
SLICER = """# Color table file organs.ctbl
# 3 values
0 Background 0 0 0 0
17 Left-Hippocampus 220 216 20 255
1035 insula 255 192 32 204
"""
ITK_SNAP = """################################################
# ITK-SnAP Label Description File
# IDX   -R-  -G-  -B-  -A--  VIS MSH  LABEL
################################################
    0     0    0    0        0  0  0    "Clear Label"
   17   220  216   20        1  1  1    "Left-Hippocampus"
 1035   255  192   32      0.8  1  0    "left insula"
    9     1    2    3        1  0  1    "hidden"
"""
DATA = np.array([[[0, 0, 1, 2, 7]]], np.uint16)


@pytest.mark.parametrize("text", [FREESURFER, SLICER, SLICER.split("\n", 2)[2], ITK_SNAP.replace("\n", "\r\n")])
def test_files_of_other_programs_say_names_colours_and_opacities(tmp_path: Path, text: str) -> None:
    path = tmp_path / "any.name"
    path.write_bytes(text.encode())
    table = labels.table(path)
    assert table[17] == "Left-Hippocampus"
    assert table.colors[17] == (220 / 255, 216 / 255, 20 / 255)
    assert (table.opacities[17], table.opacities[1035]) == (1, pytest.approx(0.8))
    assert table.opacities.get(9, 0) == 0
    assert table[1035].endswith("insula")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("1 liver 1 2 3 0\n2 spleen 1 2\n", "line 2: a row must be number name R G B A.*got '2 spleen 1 2'"),
        ("1 liver 1 2 256 0\n", "line 1: red, green and blue must be 0 to 255"),
        ("1 liver 1 2 3 256\n", "line 1: the number behind a colour must be 0 to 255"),
        ("# no\n1 a 1 2 3 0\n\n1 b 1 2 3 0\n", "line 4: a label must have one row; line 2 has another one of 1"),
        ('1 1 2 3 1 1 1 "a"\n2 1 2 3 9 1 1 "b"\n', "line 2: opacity must be 0 to 1"),
        ('1 1 2 3 1 1 1 "a"\n2 b 1 2 3 0\n', "line 2: a row must be, as those above, number R G B A VIS MSH"),
        ("# nothing\n", "it has no row"),
        ("\udcff", "a text in UTF-8"),
    ],
)
def test_a_file_that_is_no_table_is_rejected_with_its_line(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "table.txt"
    path.write_bytes(text.encode(errors="surrogateescape"))
    with pytest.raises(FormatError, match=says):
        labels.table(path)


def test_no_file() -> None:
    with pytest.raises(FormatError, match=r"none\.txt must be a table of labels"):
        labels.table("none.txt")


def test_rows_are_those_of_the_one_on_top_where_it_says_something() -> None:
    table = LabelTable({1: ("liver", "red", 0.5), 2: "skin"})
    assert table == {1: "liver", 2: "skin"}
    over = LabelTable({2: (None, [0, 0, 1], 0.25), 3: ("bone", None)}).over(table)
    assert over == LabelTable({1: ("liver", (1, 0, 0), 0.5), 2: ("skin", "blue", 0.25), 3: "bone"})
    assert over != LabelTable(dict(over))
    assert pickle.loads(pickle.dumps(over)) == copy.copy(over) == LabelTable(over.rows) == over


@pytest.mark.parametrize(
    "rows",
    [{1: 5}, {1: ("a", "red", 0.5, 1)}, {1: ("a", "red", 1.5)}, {1: ("a", (1, 2, 3))}, {"1": "a"}, {1: ("a", "no colour")}, [1]],
)
def test_rows_that_are_none(rows: object) -> None:
    with pytest.raises(OptionError, match="label"):
        LabelTable(rows)  # type: ignore[arg-type]


def test_pictures_have_the_colours_and_opacities_of_the_table() -> None:
    """Rows of labels that do not occur are kept and not drawn; labels without one have distinct colours, which is said."""
    volume = Volume(
        DATA, labels={1: ("liver", (1, 0.5, 0)), 7: ("skin", "blue", 0.25), 99: ("none", "red", 0.5), 0: ("air", "red")}
    )
    with pytest.warns(ClvolWarning, match="no color for 1 of those that occur: 2;"):
        look = TransferFunction.preset("labels", volume)
    np.testing.assert_allclose(look([1, 7, 0])[:, 3], [1, 0.25, 0])
    np.testing.assert_allclose(look([1, 7])[:, :3], [(1, 0.5, 0), (0, 0, 1)])
    np.testing.assert_allclose(look([2])[0], (*TransferFunction.preset("labels", Volume(DATA, labels=True))([2])[0, :3], 1))
    assert look.value_range == (-0.5, 7.5)
    assert volume.labels[99] == "none"  # type: ignore[index]


def test_a_table_goes_over_that_of_the_volume_without_another_look_at_its_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    volume = Volume(DATA, labels={1: "liver", 7: "skin"}, spacing=(1, 2, 3))
    label_numbers(volume)
    monkeypatch.setattr("clvol.volume.histogram.labels_in", lambda *_: pytest.fail("all samples were gone through again"))
    red = labels.with_table(volume, {1: (None, "red")})
    assert np.shares_memory(red.data, volume.data)
    assert (red.labels, red.spacing, volume.labels) == ({1: "liver", 7: "skin"}, (1, 2, 3), LabelTable({1: "liver", 7: "skin"}))
    assert TransferFunction.preset("labels", red)([1])[0, :3].tolist() == [1, 0, 0]
    assert labels.with_table(Volume(np.zeros((2, 2, 2))), {1: "a"}).is_labels


def test_labels_are_chosen_by_their_names() -> None:
    volume = Volume(DATA, labels={1: "liver", 2: "twin", 7: "twin", 99: "none"})
    assert labels.only(volume, ["liver", 7]).data.tolist() == [[[0, 0, 1, 0, 7]]]
    assert labels.without(volume, "liver").data.tolist() == [[[0, 0, 0, 2, 7]]]
    assert not labels.only(volume, ["none"]).data.any()
    with pytest.raises(OptionError, match=r"no label has this name \(did you mean liver\?\); got 'livre'"):
        labels.only(volume, ["livre"])
    with pytest.raises(OptionError, match=r"a name must be that of one label.* 'twin' is of 2, 7"):
        labels.without(volume, ["twin"])


def test_files_are_read_with_a_table(tmp_path: Path) -> None:
    """What the table leaves open is as the file says; all of it is written again."""
    clvol.write(Volume(DATA, labels={1: "liver", 2: ("skin", "red", 0.5)}), tmp_path / "v.npz")
    (tmp_path / "t.txt").write_text('1 0 255 0 0.5 1 1 "Leber"\n', encoding="utf-8")
    volume = clvol.read(tmp_path / "v.npz", labels=tmp_path / "t.txt")
    expected = LabelTable({1: ("Leber", (0, 1, 0), 0.5), 2: ("skin", "red", 0.5)})
    assert volume.labels == expected
    clvol.write(volume, tmp_path / "w.npz")
    assert clvol.read(tmp_path / "w.npz").labels == expected
    assert clvol.read_all(tmp_path / "v.npz", labels={2: "Haut"}).first.labels == LabelTable({1: "liver", 2: ("Haut", "red", 0.5)})
    clvol.write(Volume(np.repeat(DATA, 3, 1)), tmp_path / "v.nrrd")
    lazy = clvol.open(tmp_path / "v.nrrd", labels=tmp_path / "t.txt", spacing=(1, 1, 2))
    assert (lazy.grid.labels, lazy.is_labels, lazy.spacing) == ({1: "Leber"}, True, (1, 1, 2))
    assert pickle.loads(pickle.dumps(lazy)).grid.labels == lazy.grid.labels
    assert clvol.read(tmp_path / "v.nrrd", labels=False).is_labels is False
