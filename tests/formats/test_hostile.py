"""Hostile files of formats that native code reads: each is rejected with a typed error, quickly, and with little memory.

Each table names a file's fault; its valid twin is read, so that nothing else is wrong.
"""

from __future__ import annotations

import gzip
import os
import re
import struct
import sys
import time
import zlib
from pathlib import Path

import numpy as np
import pytest

from clvol import formats
from clvol.base.errors import ClvolError, FormatError
from clvol.formats.guarded import worker

pytest.importorskip("SimpleITK")

SECONDS, MEGABYTES = 5, 200
BYTES = bytes(range(24))
MHA = """\
ObjectType = Image
NDims = 3
BinaryData = True
BinaryDataByteOrderMSB = False
TransformMatrix = 1 0 0 0 1 0 0 0 1
Offset = 0 0 0
ElementSpacing = 1 1 1
DimSize = 4 3 2
ElementType = MET_UCHAR
ElementDataFile = LOCAL
"""
NRRD = "NRRD0004\ntype: uchar\ndimension: 3\nsizes: 4 3 2\nencoding: raw\n"


def mha(old: str, new: str, data: bytes = BYTES) -> bytes:
    assert old in MHA
    return MHA.replace(old, new, 1).encode() + data


def nrrd(*lines: str, data: bytes = BYTES, old: str = "", new: str = "") -> bytes:
    return (NRRD.replace(old, new, 1) + "".join(f"{line}\n" for line in lines) + "\n").encode() + data


def packed(data: bytes, *, size: int | None = None) -> bytes:
    return mha("NDims", f"CompressedData = True\nCompressedDataSize = {len(data) if size is None else size}\nNDims", data)


def element(group: int, number: int, kind: str, value: bytes, length: int | None = None) -> bytes:
    """A DICOM element, explicit and little-endian; `length` overrides the true length."""
    value += b"" if len(value) % 2 == 0 else b"\0" if kind == "UI" else b" "
    said = len(value) if length is None else length
    long = kind in ("OB", "OW", "SQ", "UN", "UT")
    return (
        struct.pack("<HH2s", group, number, kind.encode())
        + struct.pack("<HI" if long else "<H", *((0, said) if long else (said,)))
        + value
    )


def dicom(
    *,
    syntax: str = "1.2.840.10008.1.2.1",
    rows: int = 4,
    columns: int = 6,
    bits: int = 16,
    frames: str = "",
    between: bytes = b"",
    photometric: bytes = b"MONOCHROME2",
    pixels: bytes | None = None,
    length: int | None = None,
) -> bytes:
    u16 = struct.Struct("<H").pack
    samples = np.arange(24, dtype="<u2").tobytes() if pixels is None else pixels
    meta = element(2, 2, "UI", b"1.2.840.10008.5.1.4.1.1.2") + element(2, 3, "UI", b"1.2.3") + element(2, 16, "UI", syntax.encode())
    return b"".join(
        [
            bytes(128) + b"DICM",
            element(2, 0, "UL", struct.pack("<I", len(meta))) + meta,
            element(8, 0x16, "UI", b"1.2.840.10008.5.1.4.1.1.2") + element(8, 0x18, "UI", b"1.2.3") + element(8, 0x60, "CS", b"CT"),
            element(0x20, 0x0D, "UI", b"1.2.3.4") + element(0x20, 0x0E, "UI", b"1.2.3.5"),
            element(0x20, 0x32, "DS", b"0\\0\\0") + element(0x20, 0x37, "DS", b"1\\0\\0\\0\\1\\0"),
            element(0x28, 2, "US", u16(1)) + element(0x28, 4, "CS", photometric),
            element(0x28, 8, "IS", frames.encode()) if frames else b"",
            element(0x28, 0x10, "US", u16(rows)) + element(0x28, 0x11, "US", u16(columns)) + element(0x28, 0x30, "DS", b"1\\1"),
            element(0x28, 0x100, "US", u16(bits))
            + element(0x28, 0x101, "US", u16(bits))
            + element(0x28, 0x102, "US", u16(bits - 1)),
            element(0x28, 0x103, "US", u16(0)) + between,
            element(0x7FE0, 0x10, "OW", samples, length),
        ]
    )


COMPRESSED = b"\xfe\xff\x00\xe0" + bytes(4) + b"\xfe\xff\x00\xe0\x10\0\0\0" + bytes(16) + b"\xfe\xff\xdd\xe0" + bytes(4)
BOMB = gzip.compress(bytes(1 << 24))

HOSTILE: dict[str, tuple[bytes, type[ClvolError], str]] = {
    # numbers that ITK misreads, or hangs on
    "matrix-1e308.mha": (mha("1 0 0 0 1 0 0 0 1", "1 0 0 1e308 1 0 0 0 1"), FormatError, "9 finite numbers up to 1e.30"),
    "matrix-7.mha": (mha("1 0 0 0 1 0 0 0 1", "7 0 0 0 1 0 0 0 1"), FormatError, "direction cosines"),
    "matrix-0.mha": (mha("1 0 0 0 1 0 0 0 1", "0 0 0 0 0 0 0 0 0"), FormatError, "determinant is 0"),
    "matrix-flat.mha": (mha("1 0 0 0 1 0 0 0 1", "1 0 0 1 0 0 0 0 1"), FormatError, "determinant is 0"),
    "offset-inf.mha": (mha("Offset = 0", "Offset = inf"), FormatError, "'Offset'; got 'inf 0 0'"),
    "spacing-0.mha": (mha("ElementSpacing = 1", "ElementSpacing = 0"), FormatError, "spacing"),
    "spacing-comma.mha": (mha("ElementSpacing = 1", "ElementSpacing = 0,5"), FormatError, "'0,5 1 1'"),
    "spacing-hex.mha": (mha("ElementSpacing = 1", "ElementSpacing = 0x1"), FormatError, "'0x1 1 1'"),
    "slope-1e999.mha": (mha("NDims", "ElementToIntensityFunctionSlope = 1e999\nNDims"), FormatError, "finite"),
    "flag.mha": (mha("NDims", "CompressedData = yes\nNDims"), FormatError, "True or False for 'CompressedData'; got 'yes'"),
    "flag-empty.mha": (mha("BinaryData = True", "BinaryData ="), FormatError, "True or False"),
    "x9.nrrd": (nrrd("spacings: 0.5x9 1 1"), FormatError, "3 finite numbers or nan.*'0.5x9 1 1'"),
    "comma.nrrd": (nrrd("spacings: 1,5 1 1"), FormatError, "'1,5 1 1'"),
    "inf.nrrd": (nrrd("spacings: inf 1 1"), FormatError, "'inf 1 1'"),
    "1e308.nrrd": (nrrd("spacings: 1e308 1 1"), FormatError, "up to 1e.30"),
    "two-spacings.nrrd": (nrrd("spacings: 1 1"), FormatError, "3 finite numbers"),
    "thickness.nrrd": (nrrd("thicknesses: nan 1 x"), FormatError, "'thicknesses'"),
    "mins.nrrd": (nrrd("axis mins: 0 0 -inf"), FormatError, "'axis mins'"),
    "maxs.nrrd": (nrrd("axis maxs: 0 0 0 0"), FormatError, "'axis maxs'"),
    "old-min.nrrd": (nrrd("old min: 1 2"), FormatError, "'old min'"),
    "directions.nrrd": (nrrd("space: LPS", "space directions: (1,0,0) (0,1;5,0) (0,0,1)"), FormatError, "'space directions'"),
    "directions-comma.nrrd": (nrrd("space: LPS", "space directions: (1,0,0) (0,1,5,0) (0,0,1)"), FormatError, "of one space"),
    "directions-1e308.nrrd": (nrrd("space: LPS", "space directions: (1e308,0,0) (0,1,0) (0,0,1)"), FormatError, "up to 1e.30"),
    "directions-two.nrrd": (nrrd("space: LPS", "space directions: (1,0,0) (0,1,0)"), FormatError, "3 vectors.*got 2"),
    "directions-open.nrrd": (nrrd("space: LPS", "space directions: (1,0,0) (0,1,0) (0,0,1"), FormatError, "vectors such as"),
    "directions-flat.nrrd": (nrrd("space: LPS", "space directions: (1,0,0) (1,0,0) (0,0,1)"), FormatError, "cannot read"),
    "origin.nrrd": (nrrd("space: LPS", "space origin: (0,nan,1e31)"), FormatError, "'space origin'"),
    "frame.nrrd": (nrrd("space: LPS", "measurement frame: (1,0,0) (0,1,0) (0,0,inf)"), FormatError, "'measurement frame'"),
    # surplus or missing samples
    "surplus.mha": (MHA.encode() + BYTES + b"x", FormatError, "24 bytes of samples.*found 25"),
    "size-too-small.mha": (mha("4 3 2", "4 3 1"), FormatError, "12 bytes of samples.*found 24"),
    "surplus.nrrd": (nrrd(data=BYTES + b"x"), FormatError, "24 bytes of samples.*found 25"),
    "surplus-after-gzip.nrrd": (nrrd(old="raw", new="gzip", data=gzip.compress(BYTES) + b"x"), FormatError, "cannot read|gzip"),
    "surplus-in-gzip.nrrd": (nrrd(old="raw", new="gzip", data=gzip.compress(BYTES * 2)), FormatError, "24 bytes"),
    "checksum.nrrd": (nrrd(old="raw", new="gzip", data=gzip.compress(BYTES)[:-8] + bytes(8)), FormatError, "CRC"),
    "surplus-after-zlib.mha": (packed(zlib.compress(BYTES)) + b"x", FormatError, "compressed bytes; found"),
    "surplus-in-zlib.mha": (packed(zlib.compress(BYTES) + b"xy"), FormatError, "2 bytes follow them"),
    "checksum.mha": (packed(zlib.compress(BYTES)[:-4] + bytes(4)), FormatError, "incorrect data check"),
    "bomb.nrrd": (nrrd(old="raw", new="gzip", data=BOMB), FormatError, "24 bytes"),
    "bomb.mha": (packed(zlib.compress(bytes(1 << 24))), FormatError, "24 bytes"),
    "expansion.nrrd": (nrrd(old="raw", new="gzip", data=BOMB).replace(b"4 3 2", b"4096 4096 999"), FormatError, "bytes of samples"),
    # samples elsewhere
    "itself.mhd": (mha("LOCAL", "itself.mhd"), FormatError, "names itself"),
    "itself.nhdr": (nrrd("data file: ./itself.nhdr", data=b""), FormatError, "names itself"),
    "above.mhd": (mha("LOCAL", "../outside.raw", b""), FormatError, "own folder or below.*trusted=True"),
    "above.nhdr": (nrrd("data file: ../outside.raw", data=b""), FormatError, "own folder or below"),
    "around.nhdr": (nrrd("data file: sub/../../outside.raw", data=b""), FormatError, "own folder or below|not there"),
    "link.mhd": (mha("LOCAL", "link.raw", b""), FormatError, "own folder or below"),
    "list.nhdr": (nrrd("data file: LIST 2", "v.raw", data=b""), FormatError, "names the file 'v.raw'.* not there"),
    "list-outside.nhdr": (nrrd("data file: LIST", "../outside.raw", data=b""), FormatError, "own folder or below|not there"),
    "list-outside.mhd": (mha("LOCAL", "LIST\n../outside.raw", b""), FormatError, "own folder or below|not there"),
    "list-of-none.mhd": (mha("LOCAL", "LIST", b""), FormatError, "must name one to"),
    "pattern-outside.mhd": (mha("LOCAL", "../outside%d.raw 0 0 1", b""), FormatError, "own folder or below|not there"),
    "pattern.mhd": (mha("LOCAL", "%s%n%n.raw 0 0 1", b""), FormatError, "slice%03d.raw FIRST LAST STEP"),
    "pattern-of-many.mhd": (mha("LOCAL", "%d.raw 0 999999999 1", b""), FormatError, "slice%03d.raw FIRST LAST STEP"),
    "pattern-backwards.nhdr": (nrrd("data file: %d.raw 5 1 1", data=b""), FormatError, "slice%03d.raw FIRST LAST STEP"),
    "pattern-without-end.mhd": (mha("LOCAL", "s%03d.raw 1 2", b""), FormatError, "slice%03d.raw FIRST LAST STEP"),
    "pattern-wide.nhdr": (nrrd("data file: %0999999999d.raw 1 1 1", data=b""), FormatError, "slice%03d.raw FIRST LAST STEP"),
    "pipe.nhdr": (nrrd("data file: pipe.raw", data=b""), FormatError, "not there"),
    "folder.nhdr": (nrrd("data file: .", data=b""), FormatError, "not there"),
    "zero.mhd": (mha("LOCAL", "/dev/zero", b""), FormatError, "not there"),
    # DICOM
    "element-4-gb.dcm": (dicom(between=element(0x29, 0x10, "OB", b"", 0xFFFFFFF0)), FormatError, "damaged or cut short"),
    "element-60-kb.dcm": (dicom(between=element(0x29, 0x10, "LO", b"", 60_000)), FormatError, "damaged or cut short"),
    "pixels-4-gb.dcm": (dicom(length=0xFFFFFFF0), FormatError, "damaged or cut short"),
    "rows.dcm": (dicom(rows=65535, columns=65535), FormatError, "says 8589672450 bytes"),
    "frames.dcm": (dicom(frames="2147483647"), FormatError, "says 103079215056 bytes"),
    "bits.dcm": (dicom(bits=32), FormatError, "48 vs 96 bytes"),
    "photometric.dcm": (dicom(photometric=b"M\0\0OCHROME2"), FormatError, "Photometric Interpretation"),
    "packed-absurdly.dcm": (
        dicom(syntax="1.2.840.10008.1.2.4.90", rows=65535, columns=65535, pixels=COMPRESSED, length=0xFFFFFFFF),
        FormatError,
        "at most 1000 times as large",
    ),
    "packed-nonsense.dcm": (
        dicom(syntax="1.2.840.10008.1.2.4.90", pixels=COMPRESSED, length=0xFFFFFFFF), FormatError, "cannot read"
    ),
    "sequences.dcm": (
        dicom(between=(element(0x40, 0x275, "SQ", b"", 0xFFFFFFFF) + b"\xfe\xff\x00\xe0\xff\xff\xff\xff") * 2000),
        FormatError,
        "recursion depth",
    ),
}  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    worker._end_all()  # idle ones have read larger files for other tests
    inner = tmp_path_factory.mktemp("hostile") / "inner"
    inner.mkdir()
    (inner.parent / "outside.raw").write_bytes(BYTES)
    (inner / "sub").mkdir()
    for name, (content, _, _) in HOSTILE.items():
        (inner / name).write_bytes(content)
    if sys.platform != "win32":
        (inner / "link.raw").symlink_to(inner.parent / "outside.raw")
        os.mkfifo(inner / "pipe.raw")
    return inner


def peaks() -> int:
    """The peak memory of a reading process, in MB."""
    found = [0]
    for one in list(worker._all):
        status = Path(f"/proc/{one._process.pid}/status")
        if status.exists():
            found += [int(line.split()[1]) // 1024 for line in status.read_text().splitlines() if line.startswith("VmHWM")]
    return max(found)


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files_are_rejected(folder: Path, name: str) -> None:
    if sys.platform == "win32" and name in ("link.mhd", "pipe.nhdr"):
        pytest.skip("no links and pipes")
    _, kind, text = HOSTILE[name]
    start = time.monotonic()
    with pytest.raises(kind) as told:
        formats.read(folder / name)
    assert time.monotonic() - start < SECONDS + 5 * (not worker._idle)  # a process may have been started
    assert re.search(text, str(told.value)), told.value
    assert peaks() < MEGABYTES


# in a sequence of unknown type there are no types, whatever the syntax of the file
ENDS = bytes.fromhex("feff0de000000000 feffdde000000000")  # of an item, and of its sequence
ITEM_OF_ITS_OWN = bytes.fromhex("feff00e0ffffffff 4300011004000000") + b"abcd" + ENDS

SOUND: dict[str, bytes] = {
    "v.mha": MHA.encode() + BYTES,
    "packed.mha": packed(zlib.compress(BYTES)),
    "end.mha": mha("NDims", "HeaderSize = -1\nNDims", b"any" + BYTES),
    "below.mhd": mha("LOCAL", "sub/v.raw", b""),
    "v.nrrd": nrrd(),
    "packed.nrrd": nrrd(old="raw", new="gzip", data=gzip.compress(BYTES)),
    "end.nrrd": nrrd("byte skip: -1", data=b"any" + BYTES),
    "all.nrrd": nrrd(
        "space: LPS", "space directions: (1, 0, 0) (0,1.,0)  (0,0,+1e0)", "space origin: (.5,-1,2)",
        "measurement frame: (1,0,0) (0,1,0) (0,0,1)", "old min: -3.4e5", "thicknesses: nan 1 NaN",
    ),
    "mins.nrrd": nrrd("axis mins: 0 0 -1", "axis maxs: 4 3 1e0"),
    "below.nhdr": nrrd("data file: sub/v.raw", data=b""),
    "v.dcm": dicom(),
    "unknown-sequence.dcm": dicom(between=element(0x43, 0x1099, "UN", ITEM_OF_ITS_OWN, 0xFFFFFFFF)),
    "filled-up.dcm": dicom() + bytes(2),
}  # fmt: skip


@pytest.mark.parametrize("name", SOUND)
def test_their_valid_twins_are_read(tmp_path: Path, name: str) -> None:
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "v.raw").write_bytes(BYTES)
    (tmp_path / name).write_bytes(SOUND[name])
    np.testing.assert_array_equal(formats.read(tmp_path / name).data.ravel(), np.arange(24))


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="Linux lists what a process has open")
def test_a_reserved_gzip_flag_leaves_nothing_open(tmp_path: Path) -> None:
    """Python ignores it; SimpleITK rejects it, and does not close the file."""
    samples = bytearray(gzip.compress(BYTES))
    samples[3] |= 0x20
    (tmp_path / "v.raw.gz").write_bytes(samples)
    (tmp_path / "v.nhdr").write_bytes(nrrd("data file: v.raw.gz", data=b"", old="raw", new="gzip"))
    before = len(os.listdir("/proc/self/fd"))  # noqa: PTH208  # no descriptor of its own stays
    for _ in range(3):
        with pytest.raises(FormatError):
            formats.read(tmp_path / "v.nhdr", trusted=True)
    assert len(os.listdir("/proc/self/fd")) == before  # noqa: PTH208


def test_trusted_samples_may_lie_anywhere(folder: Path) -> None:
    for name in ("above.mhd", "above.nhdr", "link.mhd"):
        if name != "link.mhd" or sys.platform != "win32":
            np.testing.assert_array_equal(formats.read(folder / name, trusted=True).data.ravel(), np.arange(24))
