"""Inconsistent files: each is rejected with a clvol error, quickly and with little memory, and is never filled up."""

from __future__ import annotations

import base64
import functools
import gzip
import io
import json
import logging
import logging.config
import os
import re
import struct
import subprocess
import sys
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clvol
from clvol import formats
from clvol.base.errors import FormatError
from clvol.volume.volume import Volume

SECONDS, MIB = 5.0, 200
DATA = np.arange(1, 61, dtype=np.uint16).reshape(3, 4, 5)
BYTES = bytes(range(24))

Maker = Callable[[Path], object]
"""Writes a file, or a folder, at a path."""


# -- makers of sound files, whose arguments spoil them -------------------------------------------------


def content(data: bytes) -> Maker:
    return lambda path: path.write_bytes(data)


def nifti(pair: bool = False, **fields: tuple[int, str, Any]) -> bytes:
    """Header of 4×3×2 bytes with fields written at offsets; and the samples, unless it is a pair."""
    head = bytearray(352)
    sound: dict[str, tuple[int, str, Any]] = {
        "length": (0, "i", (348,)),
        "dim": (40, "8h", (3, 4, 3, 2, 1, 1, 1, 1)),
        "type": (70, "2h", (2, 8)),
        "pixdim": (76, "8f", (1,) * 8),
        "start": (108, "f", (0 if pair else 352,)),
        "magic": (344, "4s", (b"ni1\0" if pair else b"n+1\0",)),
    }
    for offset, kind, values in (sound | fields).values():
        struct.pack_into("<" + kind, head, offset, *values)
    return bytes(head) if pair else bytes(head) + BYTES


def mgh(shape: tuple[int, ...] = (4, 3, 2, 1), kind: int = 0, data: bytes = BYTES) -> bytes:
    return struct.pack(">7i", 1, *shape, kind, 0) + bytes(256) + data


def damaged_gzip(data: bytes, at: int = -8) -> bytes:
    """Gzip with a wrong checksum."""
    packed = bytearray(gzip.compress(data, mtime=0))
    packed[at] ^= 1
    return bytes(packed)


@functools.cache
def bomb(megabytes: int) -> bytes:
    """Gzip of zeros, from one compressed member repeated."""
    return gzip.compress(bytes(100 << 20)) * (megabytes // 100)


def noise(size: int) -> bytes:
    return np.random.default_rng(0).bytes(size)


def npy(shape: object, kind: str = "|u1", data: bytes = BYTES) -> bytes:
    head = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}".encode() + b"\n"
    return b"\x93NUMPY\x01\0" + struct.pack("<H", len(head)) + head + data


def npz(*members: tuple[str, bytes], spoil: Callable[[bytearray], object] = lambda _: None, kind: int = 0) -> Maker:
    def make(path: Path) -> None:
        stream = io.BytesIO()
        with zipfile.ZipFile(stream, "w", kind) as archive:
            for name, data in members:
                archive.writestr(name, data)
        packed = bytearray(stream.getvalue())
        spoil(packed)
        path.write_bytes(packed)

    return make


def sizes_of_the_archive(size: int) -> Callable[[bytearray], object]:
    """Set the size of the last member in the directory of a ZIP file."""
    return lambda packed: struct.pack_into("<I", packed, packed.rindex(b"PK\x01\x02") + 24, size)


def tiff(*fields: tuple[int, int], data: np.ndarray = DATA, which: int = 0, **options: Any) -> Maker:
    """A one-directory file with the first value of some fields replaced."""

    def make(path: Path) -> None:
        import tifffile

        tifffile.imwrite(path, data, **{"photometric": "minisblack", "metadata": None} | options)
        whole = bytearray(path.read_bytes())
        with tifffile.TiffFile(path) as file:
            places = {tag.code: (tag.offset, tag.dtype) for tag in file.pages[which].tags}
        for code, value in fields:
            if code in places:
                struct.pack_into(
                    "<HII" if value > 65535 else "<HIH", whole, places[code][0] + 2, 4 if value > 65535 else 3, 1, value
                )
        path.write_bytes(whole)

    return make


def next_directory(target: int) -> Maker:
    """Set the last page's successor."""

    def make(path: Path) -> None:
        import tifffile

        tiff()(path)
        with tifffile.TiffFile(path) as file:
            page = file.pages[2]
            at = page.offset + 2 + 12 * len(page.tags)
            first = file.pages[0].offset
        whole = bytearray(path.read_bytes())
        struct.pack_into("<I", whole, at, target or first)
        path.write_bytes(whole)

    return make


def children(path: Path) -> None:
    """A page that is its own child."""
    tiff(data=DATA[0], software="x" * 9)(path)
    at_tag(path, 305, 4, 1, 330)


def ome(old: str, new: str) -> Maker:
    def make(path: Path) -> None:
        import tifffile

        tifffile.imwrite(path, DATA, ome=True, photometric="minisblack", metadata={"axes": "ZYX"})
        with tifffile.TiffFile(path) as file:
            text = file.ome_metadata
        assert old in text
        tifffile.tiffcomment(path, text.replace(old, new, 1).encode())

    return make


LAUGHS = "".join(f'<!ENTITY {chr(98 + i)} "{("&" + chr(97 + i) + ";") * 10}">' for i in range(9))
ENTITIES = f'<!DOCTYPE l [<!ENTITY a "lol">{LAUGHS}]>'
OTHER_FILE = '<TiffData><UUID FileName="{}">urn:uuid:1</UUID></TiffData><TiffData'


def hdf5(fill: Callable[[Any], object], spoil: Callable[[bytearray], object] = lambda _: None) -> Maker:
    def make(path: Path) -> None:
        import h5py

        with h5py.File(path, "w") as file:
            fill(file)
        whole = bytearray(path.read_bytes())
        spoil(whole)
        path.write_bytes(whole)

    return make


def short_chunk(file: Any) -> None:
    """An uncompressed chunk that is truncated."""
    array = file.create_dataset("a", (3, 4, 5), "u1", chunks=(3, 4, 5))
    array.id.write_direct_chunk((0, 0, 0), bytes(40))


def virtual(file: Any) -> None:
    import h5py

    layout = h5py.VirtualLayout(DATA.shape, DATA.dtype)
    layout[:] = h5py.VirtualSource("/etc/other.h5", "data", DATA.shape)
    file.create_virtual_dataset("data", layout)


def links(file: Any) -> None:
    import h5py

    file["round"] = h5py.SoftLink("/round")
    file["away"] = h5py.ExternalLink("other.h5", "/data")


def imaris(file: Any) -> None:
    import h5py

    file.create_group("DataSetInfo/Image")
    file["DataSet"] = h5py.ExternalLink("other.ims", "/DataSet")


def zarr(spoil: Callable[[Path, list[Path]], object] = lambda *_: None, **options: Any) -> Maker:
    """A chunked array; `spoil` gets its folder and files."""

    def make(path: Path) -> None:
        import zarr

        array = zarr.create_array(str(path), shape=DATA.shape, dtype=DATA.dtype, **{"chunks": (2, 2, 2)} | options)
        array[:] = DATA
        spoil(path, sorted((path / "c").rglob("[0-9]")) and sorted(file for file in (path / "c").rglob("*") if file.is_file()))

    return make


def cut(_: Path, chunks: list[Path]) -> None:
    chunks[-1].write_bytes(chunks[-1].read_bytes()[:-3])


def empty(_: Path, chunks: list[Path]) -> None:
    chunks[-1].write_bytes(b"")


def instead(what: Callable[[Path], object]) -> Callable[[Path, list[Path]], object]:
    def spoil(_: Path, chunks: list[Path]) -> None:
        chunks[-1].unlink()
        what(chunks[-1])

    return spoil


def said(**fields: Any) -> Callable[[Path, list[Path]], object]:
    def spoil(path: Path, _: list[Path]) -> None:
        about = json.loads((path / "zarr.json").read_text())
        (path / "zarr.json").write_text(json.dumps(about | fields))

    return spoil


def ome_zarr(where: str, factor: float = 1.0) -> Maker:
    def make(path: Path) -> None:
        import zarr

        group = zarr.open_group(str(path), mode="w")
        group.create_array("0", shape=DATA.shape, dtype=DATA.dtype)[:] = DATA
        scale = [{"type": "scale", "scale": [1.0, factor, 1.0]}]
        axes = [{"name": name, "type": "space"} for name in "zyx"]
        datasets = [{"path": where, "coordinateTransformations": scale}]
        group.attrs["ome"] = {"version": "0.5", "multiscales": [{"axes": axes, "datasets": datasets}]}

    return make


def vti(
    array: str = "", head: str = "", extent: str = "0 3 0 2 0 1", spacing: str = "1 1 1", tail: str = "", comp: str = ""
) -> Maker:
    """VTK image data of 4×3×2 bytes."""
    text = (
        f'<?xml version="1.0"?>{head}<VTKFile type="ImageData" version="1.0" byte_order="LittleEndian" header_type="UInt64"{comp}>'
        f'<ImageData WholeExtent="{extent}" Origin="0 0 0" Spacing="{spacing}"><Piece Extent="{extent}"><PointData>'
        f"{array or inline(24, BYTES)}</PointData></Piece></ImageData>{tail}</VTKFile>"
    )
    return content(text.encode("latin1"))


def element(words: str, text: str = "") -> str:
    return f'<DataArray type="UInt8" Name="a" {words}>{text}</DataArray>'


def inline(size: int, data: bytes) -> str:
    return element('format="binary"', base64.b64encode(struct.pack("<Q", size) + data).decode())


def packed(blocks: int = 1, size: int = 24, last: int = 0, length: int | None = None, data: bytes = zlib.compress(BYTES)) -> str:
    head = struct.pack("<4Q", blocks, size, last, len(data) if length is None else length)
    return element('format="binary"', base64.b64encode(head).decode() + base64.b64encode(data).decode())


def appended(size: int, data: bytes) -> str:
    return f'<AppendedData encoding="raw">_{(struct.pack("<Q", size) + data).decode("latin1")}</AppendedData>'


ZLIB = ' compressor="vtkZLibDataCompressor"'


def png(width: int = 5, height: int = 4, depth: int = 8, spoil: Callable[[bytearray], object] = lambda _: None) -> bytes:
    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    rows = zlib.compress((b"\0" + bytes(5)) * 4)
    head = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, 0, 0, 0, 0))
    whole = bytearray(b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", rows) + chunk(b"IEND", b""))
    spoil(whole)
    return bytes(whole)


def folder(**files: Maker | bytes) -> Maker:
    """A folder of files; an underscore in a name stands for its dot."""

    def make(path: Path) -> None:
        path.mkdir()
        for name, file in files.items():
            (content(file) if isinstance(file, bytes) else file)(path / name.replace("_", "."))

    return make


def pair(data: bytes | Maker, **fields: Any) -> Maker:
    def make(path: Path) -> None:
        path.write_bytes(nifti(pair=True, **fields))
        (content(data) if isinstance(data, bytes) else data)(path.with_suffix(".img"))

    return make


def link(target: str) -> Maker:
    return lambda path: path.symlink_to(target)


def at(offset: int, kind: str, *values: Any) -> Callable[[bytearray], object]:
    return lambda whole: struct.pack_into(kind, whole, offset if offset >= 0 else len(whole) + offset, *values)


HUGE = 2**31 - 1
POSIX = os.name == "posix"

HOSTILE: dict[str, tuple[Maker, str]] = {
    # NumPy
    "trailing.npy": (content(npy((2, 3, 4)) + b"x"), "24 bytes.*found 25"),
    "cut.npy": (content(npy((2, 3, 4), data=BYTES[:-1])), "24 bytes.*found 23"),
    "minus.npy": (content(npy((-2, -3, 4))), "cannot read|axes|sample"),
    "nested.npy": (content(npy("(" * 3000 + ")" * 3000)), "cannot read"),
    "long-header.npy": (content(b"\x93NUMPY\x02\0" + struct.pack("<I", 2**32 - 1) + bytes(99)), "header of up to"),
    "version-9.npy": (content(b"\x93NUMPY\x09\0" + bytes(99)), "version"),
    "checksum.npz": (npz(("data.npy", npy((2, 3, 4))), spoil=lambda whole: at(whole.index(BYTES), "B", 9)(whole)), "CRC"),
    "bomb.npz": (npz(("data.npy", npy((1, 1, 24))), spoil=sizes_of_the_archive(2**32 - 2)), "two sizes"),
    "deflate-bomb.npz": (npz(("data.npy", npy((9, 9, 9))), kind=8, spoil=sizes_of_the_archive(2**32 - 2)), "Limits.expansion"),
    "bzip2.npz": (npz(("data.npy", npy((2, 3, 4))), kind=zipfile.ZIP_BZIP2), "packed by deflate"),
    "same-names.npz": (npz(("data.npy", npy((2, 3, 4))), ("data.npy", npy((4, 3, 2)))), "different names"),
    "nan.npz": (npz(("data.npy", npy((2, 3, 4))), ("spacing.npy", npy((3,), "<f8", struct.pack("<3d", 1, np.nan, 1)))), "finite"),
    "pickle.npz": (npz(("data.npy", npy((2, 3, 4), "|O"))), "dtype object"),
    # NIfTI and FreeSurfer
    "far-checksum.nii.gz": (content(damaged_gzip(nifti() + noise(3 << 20))), "24 bytes.*found 25"),
    "checksum.nii.gz": (content(damaged_gzip(nifti())), "CRC"),
    "length.nii.gz": (content(damaged_gzip(nifti(), -4)), "length"),
    "second-member.nii.gz": (content(gzip.compress(nifti()[:200]) + damaged_gzip(nifti()[200:])), "CRC"),
    "garbage.nii.gz": (content(gzip.compress(nifti()) + b"garbage"), "gzip"),
    "more.nii": (content(nifti() + b"more"), "24 bytes.*found 28"),
    "bomb-behind.nii.gz": (content(gzip.compress(nifti()) + bomb(10_000)), "24 bytes.*found 25"),
    "bomb.nii.gz": (
        content(gzip.compress(nifti(dim=(40, "8h", (3, 32000, 32000, 10, 1, 1, 1, 1)))) + bomb(10_000)),
        "Limits.expansion.*its header says 10240000000",
    ),
    "absurd.nii.gz": (content(gzip.compress(nifti(dim=(40, "8h", (7, *(32767,) * 7))))), "bytes of samples"),
    "small-lie.nii.gz": (
        content(gzip.compress(nifti(dim=(40, "8h", (3, 900, 900, 900, 1, 1, 1, 1))))),
        "729000000 bytes.*found 24",
    ),
    "in-the-header.nii": (content(nifti(start=(108, "f", (100,)))), "at byte 352 or later"),
    "placed-nan.nii": (content(nifti(code=(254, "h", (1,)), rows=(280, "f", (float("nan"),)))), "finite"),
    "spacing-nan.nii": (content(nifti(pixdim=(76, "8f", (1, float("nan"), *(1,) * 6)))), "finite"),
    "short.hdr": (pair(BYTES[:-1]), "24 bytes.*found 23"),
    "long.hdr": (pair(BYTES * 2), "24 bytes.*found 48"),
    "header-length.hdr": (pair(BYTES, length=(0, "i", (349,))), "it is not"),
    "far-checksum.mgz": (content(damaged_gzip(mgh(data=BYTES + noise(3 << 20)))), "CRC"),
    "bomb-behind.mgz": (content(gzip.compress(mgh()) + bomb(10_000)), "up to"),
    "bomb.mgz": (content(gzip.compress(mgh((HUGE, 3, 2, 1))) + bomb(10_000)), "its header says"),
    "absurd.mgh": (content(mgh((HUGE, HUGE, HUGE, HUGE))), "Limits.expansion"),
    "minus.mgh": (content(mgh((-4, -3, 2, 1))), "at least one sample"),
    "type-9.mgh": (content(mgh(kind=9)), "type 9"),
    # TIFF
    "bits-1.tif": (tiff((258, 1)), "bytes of samples in each strip"),
    "bits-8.tif": (tiff((258, 8)), "bytes of samples in each strip"),
    "bits-8-packed.tif": (tiff((258, 8), compression="zlib"), "bytes of samples in each strip"),
    "bits-of-another-page.ome.tif": (tiff((258, 8), which=1, ome=True, metadata={"axes": "ZYX"}), "one shape and type"),
    "floats-of-another-page.ome.tif": (
        tiff((339, 1), which=2, data=DATA.view(np.int16), ome=True, metadata={"axes": "ZYX"}),
        "one shape and type",
    ),
    "narrow.tif": (tiff((256, 4)), "bytes of samples in each strip"),
    "narrow-packed.tif": (tiff((256, 4), compression="zlib"), "bytes of samples in each strip"),
    "wide.tif": (tiff((256, HUGE), (257, HUGE)), "StripByteCounts|strips or tiles"),
    "wide-packed.tif": (tiff((256, HUGE), (257, HUGE), (278, HUGE), compression="zlib"), "Limits.expansion"),
    "strips.tif": (tiff((278, 1)), "StripByteCounts|4 strips or tiles"),
    "round.tif": (next_directory(0), "reached twice"),
    "past.tif": (next_directory(10**9), "before its end"),
    "children.tif": (children, "reached twice"),
    "count.tif": (lambda path: (tiff()(path), at_tag(path, 273, 4, 2**32 - 1)), "past its end"),
    "type.ome.tif": (ome('Type="uint16"', 'Type="float"'), "uint16; it says float"),
    "nan.ome.tif": (ome('SizeX="5"', 'SizeX="5" PhysicalSizeX="nan" PhysicalSizeY="1" PhysicalSizeZ="1"'), "finite"),
    "laughs.ome.tif": (ome("<OME", ENTITIES + "<OME"), "declarations"),
    "elsewhere.ome.tif": (ome("<TiffData", OTHER_FILE.format("../elsewhere.tif")), "beside it"),
    "elsewhere-by-number.ome.tif": (ome("<TiffData", OTHER_FILE.format("..&#47;elsewhere.tif")), "beside it"),
    "absolute.ome.tif": (ome("<TiffData", OTHER_FILE.format("/etc/passwd")), "beside it"),
    "missing.ome.tif": (ome('SizeZ="3"', 'SizeZ="4"'), "missing"),
    # HDF5
    "external.h5": (hdf5(lambda file: file.create_dataset("a", (2, 3, 4), "u1", external=[("/etc/passwd", 0, 24)])), "other files"),
    "virtual.h5": (hdf5(virtual), "other files"),
    "links.h5": (hdf5(links), r"holds none; /away leads to /data in other\.h5"),
    "empty.h5": (hdf5(lambda file: file.create_dataset("a", (2, 3, 4), "u1")), "none were ever written"),
    "absurd.h5": (
        hdf5(lambda file: file.create_dataset("a", (HUGE, HUGE, 9), "u1", chunks=(1, 1, 9)).__setitem__((0, 0), 1)),
        "its header says",
    ),
    "absurd-chunk.h5": (
        hdf5(lambda file: file.create_dataset("a", (9, 9, 9), "u1", chunks=(1, 1, 2**31), maxshape=(9, 9, None), compression=9)),
        "none were ever|its header says",
    ),
    "chunk.h5": (hdf5(short_chunk), "60 bytes of samples in each chunk"),
    "checksum.h5": (
        hdf5(
            lambda file: file.create_dataset("a", data=DATA, chunks=(3, 4, 5), fletcher32=True),
            lambda whole: at(whole.index(DATA.tobytes()), "B", 99)(whole),
        ),
        "cannot read",
    ),
    "cut.h5": (lambda path: (hdf5(lambda file: file.create_dataset("a", data=DATA))(path), os.truncate(path, 2000)), "cannot read"),
    "link.ims": (hdf5(imaris), "a link to other.ims"),
    # Zarr
    "cut.zarr": (zarr(cut), "cannot read"),
    "cut-plain.zarr": (zarr(cut, compressors=None), "cannot read"),
    "empty-chunk.zarr": (zarr(empty), "is empty"),
    "empty-shard.zarr": (zarr(empty, chunks=(1, 2, 2), shards=(2, 2, 2)), "is empty"),
    "folder-for-a-chunk.zarr": (zarr(instead(lambda path: path.mkdir())), "files of its own"),
    "absurd.zarr": (zarr(said(shape=[10**6] * 3)), "its header says"),
    "minus.zarr": (zarr(said(shape=[-3, 4, 5])), "cannot read"),
    "kind.zarr": (zarr(said(data_type="object")), "cannot read"),
    "up.zarr": (ome_zarr("../cut.zarr"), "cannot read"),
    "nan.zarr": (ome_zarr("0", float("nan")), "finite"),
    "bomb.zarr.zip": (npz(("zarr.json", b"{}"), kind=8, spoil=sizes_of_the_archive(2**32 - 2)), "Limits.expansion"),
    "nothing.zip": (npz(("../zarr.txt", b"{}")), "Zarr array or group"),
    # VTK
    "short.vti": (vti(inline(24, BYTES[:7])), "17 bytes too early"),
    "less.vti": (vti(inline(10, BYTES)), "its header says 10"),
    "absurd.vti": (vti(inline(2**62, BYTES)), "its header says"),
    "no-base64.vti": (vti(inline(24, BYTES).replace("AQID", "A*ID")), "base64"),
    "more.vti": (vti(inline(24, BYTES + b"more")), "there are more"),
    "words.vti": (vti(element('format="ascii"', "999 " * 24)), "999"),
    "blocks.vti": (vti(packed(blocks=2**60), comp=ZLIB), "its header says"),
    "block-size.vti": (vti(packed(size=2**60), comp=ZLIB), "its header says"),
    "packed-size.vti": (vti(packed(length=2**60), comp=ZLIB), "too early"),
    "checksum.vti": (vti(packed(data=zlib.compress(BYTES)[:-1] + b"x"), comp=ZLIB), "data check"),
    "bomb.vti": (vti(packed(data=zlib.compress(bytes(100 << 20))), comp=ZLIB), "one has others"),
    "offset.vti": (vti(element('format="appended" offset="-8"'), tail=appended(24, BYTES)), "appended within the file"),
    "far.vti": (vti(element('format="appended" offset="999"'), tail=appended(24, BYTES)), "appended within the file"),
    "cut.vti": (vti(element('format="appended" offset="0"'), tail=appended(24, BYTES[:-1])), "1 bytes too early"),
    "components.vti": (vti(element('NumberOfComponents="-3" format="ascii"', "1")), "components"),
    "extent.vti": (vti(extent=f"0 {HUGE - 1} 0 {HUGE - 1} 0 1"), "Limits.expansion"),
    "nan.vti": (vti(spacing="nan 1 1"), "finite numbers .*Spacing"),
    "laughs.vti": (vti(head=ENTITIES), "declarations"),
    "entity.vti": (vti(head='<!DOCTYPE l [<!ENTITY x SYSTEM "file:///etc/passwd">]>'), "declarations"),
    # images
    "wide.png": (content(png(HUGE, HUGE)), "cannot read"),
    "bomb.png": (content(png(30000, 30000)), "cannot read"),
    "large.png": (content(png(12000, 12000, 16)), "cannot read"),
    "checksum.png": (content(png(spoil=at(45, "B", 77))), "cannot read"),
    "cut.png": (content(png()[:-20]), "cannot read"),
    "rows.png": (content(png(height=140)), "must hold 840 bytes of unpacked rows; found 24"),
    "shapes": (folder(a_png=png(), b_png=(lambda path: png_of(path, (3, 3)))), "one shape"),
    "kinds": (folder(a_png=png(), b_bmp=b""), "one kind"),
}

if POSIX:
    HOSTILE |= {
        "zero.npy": (link("/dev/zero"), "neither a file nor a folder"),
        "zero.tif": (link("/dev/zero"), "neither a file nor a folder"),
        "pipe.nii": (os.mkfifo, "neither a file nor a folder"),
        "pipe.h5": (os.mkfifo, "neither a file nor a folder"),
        "round.npy": (link("round.npy"), "no such file|cannot read"),
        "folder.npy": (Path.mkdir, "must hold"),
        "no-samples.hdr": (pair(link("/dev/zero")), "not there"),
        "pipe-for-a-chunk.zarr": (zarr(instead(os.mkfifo)), "files of its own"),
        "zero-for-a-chunk.zarr": (zarr(instead(link("/dev/zero"))), "files of its own"),
        "away-for-a-chunk.zarr": (zarr(instead(link("/etc/passwd"))), "files of its own"),
        "pipe-for-an-attribute.zarr": (
            lambda path: (zarr()(path), (path / "zarr.json").unlink(), os.mkfifo(path / "zarr.json")),
            "a folder must hold",
        ),
        "pipe.ome.tif": (
            lambda path: (os.mkfifo(path.with_name("pipe")), ome("<TiffData", OTHER_FILE.format("pipe"))(path)),
            "beside it",
        ),
        "lost-slice": (folder(a_png=png(), b_png=link("nowhere.png"), c_png=png()), "a slice would be missing"),
        "pipe-slice": (folder(a_png=png(), b_png=os.mkfifo), "a slice would be missing"),
    }


def at_tag(path: Path, code: int, kind: int, count: int, becomes: int | None = None) -> None:
    """Replace type and count of a field of the first directory, and optionally its code."""
    import tifffile

    whole = bytearray(path.read_bytes())
    with tifffile.TiffFile(path) as file:
        place = next(tag.offset for tag in file.pages[0].tags if tag.code == code)
    struct.pack_into("<HHI", whole, place, becomes or code, kind, count)
    if becomes:
        struct.pack_into("<I", whole, place + 8, 8)
    path.write_bytes(whole)


def png_of(path: Path, shape: tuple[int, int]) -> None:
    import imageio.v3 as iio

    iio.imwrite(path, np.zeros(shape, np.uint8))


# -- all of them in one other process, which must live to tell --------------------------------------------

CHILD = """
import json, sys, time, warnings
from pathlib import Path
import numpy as np
import clvol
from clvol.base.errors import ClvolError

try:
    import resource
    resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))
except ImportError:
    pass

def memory(what):
    try:
        return next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith(what)) >> 10
    except OSError:
        return 0

def forget_the_peak():
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        pass

warnings.simplefilter("ignore")
for folder in map(Path, sys.argv[1:]):
    for path in sorted(folder.iterdir()):
        print(json.dumps([path.name, "died", "", 0, 0]), flush=True)
        forget_the_peak()
        before, start = memory("VmRSS"), time.perf_counter()
        try:
            outcome = ["read", np.asarray(clvol.read(path).data).ravel().tolist()]
        except ClvolError as error:
            outcome = [type(error).__name__, str(error)]
        except BaseException as error:
            outcome = ["escaped", repr(error)]
        print(json.dumps([path.name, *outcome, time.perf_counter() - start, memory("VmHWM") - before]), flush=True)
"""

SOUND: dict[str, Maker] = {
    "a.npy": content(npy((2, 3, 4))),
    "a.npz": npz(("data.npy", npy((2, 3, 4))), kind=8),
    "a.nii": content(nifti()),
    "a.nii.gz": content(gzip.compress(nifti())),
    "members.nii.gz": content(gzip.compress(nifti()[:200]) + gzip.compress(nifti()[200:])),
    "a.hdr": pair(BYTES),
    "a.mgh": content(mgh()),
    "a.mgz": content(gzip.compress(mgh(data=BYTES + bytes(20)))),
    "a.tif": tiff(),
    "packed.tif": tiff(compression="zlib"),
    "a.ome.tif": ome("<OME", "<OME"),
    "a.h5": hdf5(lambda file: file.create_dataset("a", data=DATA)),
    "a.zarr": zarr(),
    "shards.zarr": zarr(chunks=(1, 2, 2), shards=(2, 2, 2)),
    "ome.zarr": ome_zarr("0"),
    "a.vti": vti(),
    "packed.vti": vti(packed(), comp=ZLIB),
    "appended.vti": vti(element('format="appended" offset="0"'), tail=appended(24, BYTES)),
    "a.png": content(png()),
    "slices": folder(a_png=png(), b_png=png()),
}


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[str, Any, float, int]]:
    """The outcome of reading each file; "died" if it crashed the process. Valid ones come first: they import libraries."""
    for module in ("tifffile", "imagecodecs", "h5py", "zarr", "nibabel"):
        pytest.importorskip(module)
    root = tmp_path_factory.mktemp("hostile")
    for name, makers in (("1", SOUND), ("2", {name: maker for name, (maker, _) in HOSTILE.items()})):
        (root / name).mkdir()
        for file, maker in makers.items():
            maker(root / name / file)
    (root / "2" / "pipe").unlink(missing_ok=True)
    if POSIX:
        os.mkfifo(root / "2" / "pipe")
    run = subprocess.run(
        [sys.executable, "-c", CHILD, str(root / "1"), str(root / "2")], capture_output=True, text=True, timeout=120, check=False
    )
    told = {name: tuple(rest) for name, *rest in map(json.loads, run.stdout.splitlines())}
    assert told, run.stderr
    return told  # type: ignore[return-value]  # as many as CHILD prints


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files_are_rejected(outcomes: dict[str, tuple[str, Any, float, int]], name: str) -> None:
    assert name in outcomes, f"the process ended before, at {list(outcomes)[-1]}"
    kind, message, seconds, mib = outcomes[name]
    assert kind in ("FormatError", "ChunkError", "DataError", "GeometryError"), (kind, message)
    assert re.search(HOSTILE[name][1], message), message
    assert seconds < SECONDS
    assert mib < MIB


@pytest.mark.parametrize("name", SOUND)
def test_their_originals_are_read(outcomes: dict[str, tuple[str, Any, float, int]], name: str) -> None:
    kind, samples, *_ = outcomes[name]
    assert kind == "read", samples
    assert samples in (list(BYTES), DATA.ravel().tolist(), [0] * 20, [0] * 40)


# -- 1,000 failing reads leave the process as it was --------------------------------------------------------

AGAIN = """
import gc, os, sys, warnings
from pathlib import Path
import clvol
from clvol.base.errors import ClvolError

def held():
    gc.collect()
    status = dict(line.split(":", 1) for line in open("/proc/self/status"))
    return len(os.listdir("/proc/self/fd")), int(status["VmRSS"].split()[0]) >> 10

warnings.simplefilter("ignore")
paths = [path for path in sorted(Path(sys.argv[1]).iterdir()) if path.name in sys.argv[3:]]
for times in (3, int(sys.argv[2])):  # first a few, which import libraries
    before = held()
    for path in paths:
        for _ in range(times):
            try:
                clvol.read(path, trusted=True)
                print("read", path.name)
            except ClvolError:
                pass
after = held()
print(after[0] - before[0], after[1] - before[1])
"""

OF_EACH = (
    *("cut.npy", "checksum.npz", "same-names.npz", "checksum.nii.gz", "short.hdr", "type-9.mgh", "far-checksum.mgz"),
    *("bits-8-packed.tif", "round.tif", "missing.ome.tif", "checksum.h5", "external.h5", "link.ims", "cut.zarr"),
    *("no-base64.vti", "checksum.vti", "checksum.png", "shapes"),
)


def read_again(folder: Path, times: int) -> tuple[int, int]:
    """Descriptors and MiB by which a process grows when it repeatedly fails to read one file of each format."""
    if not Path("/proc/self/status").exists():
        pytest.skip("what a process holds is told by Linux")
    for module in ("tifffile", "imagecodecs", "h5py", "zarr", "nibabel"):
        pytest.importorskip(module)
    for name in OF_EACH:
        HOSTILE[name][0](folder / name)
    run = subprocess.run(
        [sys.executable, "-c", AGAIN, str(folder), str(times), *OF_EACH], capture_output=True, text=True, timeout=900, check=False
    )
    assert re.fullmatch(r"-?\d+ -?\d+\n", run.stdout), run.stdout + run.stderr
    descriptors, mib = map(int, run.stdout.split())
    return descriptors, mib


def test_failing_reads_leak_nothing(tmp_path: Path) -> None:
    descriptors, mib = read_again(tmp_path, 4)
    assert (descriptors, mib < 8) == (0, True), mib


@pytest.mark.thorough
def test_1000_failing_reads_leak_nothing(tmp_path: Path) -> None:
    descriptors, mib = read_again(tmp_path, 1000)
    assert (descriptors, mib < 16) == (0, True), mib


# -- damage is found however a program logs ----------------------------------------------------------------


def disabled() -> None:
    logging.disable(logging.CRITICAL)


def configured() -> None:
    logging.getLogger("tifffile")
    logging.config.dictConfig({"version": 1})  # which switches off the loggers that there are


@pytest.fixture
def logs_as_before() -> Iterator[None]:
    logger, root = logging.getLogger("tifffile"), logging.getLogger()
    kept = [(one, one.disabled) for one in logging.Logger.manager.loggerDict.values() if isinstance(one, logging.Logger)]
    handlers = root.handlers[:]
    yield
    logging.disable(logging.NOTSET)
    root.handlers[:] = handlers
    for one, off in kept:
        one.disabled = off
    logger.disabled = False


@pytest.mark.usefixtures("logs_as_before")
@pytest.mark.parametrize("silence", [disabled, configured])
def test_logging_does_not_matter(tmp_path: Path, silence: Callable[[], None]) -> None:
    """ImageJ's metadata announce more slices than pages: tifffile logs it, and reads one page."""
    tifffile = pytest.importorskip("tifffile")
    text = "ImageJ=1.54f\nimages=24\nslices=4\nframes=6\nhyperstack=true\n"
    tifffile.imwrite(tmp_path / "v.tif", DATA, description=text, metadata=None, photometric="minisblack", rowsperstrip=2)
    silence()
    with pytest.raises(FormatError, match=r"damaged or unusual.*ImageJ"):
        clvol.read(tmp_path / "v.tif")


def test_tifffiles_logs_reach_the_program(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    tifffile = pytest.importorskip("tifffile")
    formats.write(Volume(DATA), tmp_path / "v.tif")
    formats.read(tmp_path / "v.tif")
    logging.getLogger("tifffile").warning("heard")
    assert caplog.messages == ["heard"]
    assert logging.getLogger("tifffile") is tifffile.tifffile.logger()
