"""A small corpus of valid files for each format, created by other libraries on demand."""

from __future__ import annotations

import gzip
import io
import struct
import tempfile
import warnings
import zipfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.dicom import element, sequence

__all__ = ["CORPORA", "Sample"]

AFFINE = np.array([[-0.5, 0, 0, 10], [0, 0.75, 0, -20], [0, 0, 2.5, 30], [0, 0, 0, 1]])
SPACING, ORIGIN = (0.5, 0.75, 2.5), (10.0, -20.0, 30.0)


@dataclass(frozen=True)
class Sample:
    """A sound file, or the files of a folder.

    Parameters
    ----------
    files : mapping of str to bytes
        By their names in the folder that they are put into.
    entry : str
        Which of them is read; "": the folder.
    options : mapping
        Of `clvol.read`.
    checked : bool
        Whether checksums cover every byte: whatever is accepted must be the data as they were.
    """

    files: Mapping[str, bytes]
    entry: str
    options: Mapping[str, Any] = field(default_factory=dict)
    checked: bool = False


def one(name: str, content: bytes, checked: bool = False, **options: Any) -> Sample:
    """A sample of one file."""
    return Sample({name: content}, name, options, checked)


def data(dtype: str, shape: tuple[int, ...] = (3, 4, 5)) -> NDArray[Any]:
    """Distinct samples without NaN."""
    values = np.arange(1, np.prod(shape) + 1).reshape(shape)
    return (values % 2 if dtype == "bool" else values * 7).astype(dtype)


def _written(save: Callable[[Path], object], *names: str) -> dict[str, bytes]:
    """The files that `save` writes, by name; it gets the first of `names`."""
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings(action="ignore"):
        root = Path(folder)
        save(root / names[0])
        return {file.relative_to(root).as_posix(): file.read_bytes() for file in sorted(root.rglob("*")) if file.is_file()}


def _npy() -> Iterator[Sample]:
    for dtype, shape in (("uint8", (3, 4, 5)), (">i2", (4, 5)), ("float32", (2, 3, 4)), ("bool", (2, 3, 4)), ("u2", (2, 2, 3, 4))):
        stream = io.BytesIO()
        np.save(stream, data(dtype, shape))
        yield one("v.npy", stream.getvalue())
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.asfortranarray(data("float64")), version=(2, 0))
    yield one("v.npy", stream.getvalue())


def _npz() -> Iterator[Sample]:
    import clvol

    for save in (np.savez, np.savez_compressed):
        stream = io.BytesIO()
        save(stream, data=data("int16"), spacing=SPACING, origin=ORIGIN, direction=np.eye(3), units="mm")
        yield one("v.npz", stream.getvalue())
    full = clvol.Volume(data("uint8"), SPACING, units="um", name="cells", clim=(1, 5), labels={7: "seven"}, header={"a": [1]})
    yield Sample(_written(lambda path: clvol.write(full, path), "v.npz"), "v.npz")


def _nifti_images() -> Iterator[tuple[str, Any]]:
    import nibabel

    image = nibabel.Nifti1Image(data("int16").T, AFFINE)
    image.header.set_xyzt_units("mm", "sec")
    yield "1", image
    scaled = nibabel.Nifti1Image(data("uint8").T, None)
    scaled.header["scl_slope"], scaled.header["scl_inter"] = 2, 1
    scaled.header["pixdim"][1:4] = SPACING
    yield "1", scaled
    series = nibabel.Nifti1Image(data("float32", (2, 3, 4, 5)).T, AFFINE)
    series.set_qform(AFFINE, 1)
    series.set_sform(None, 0)
    yield "1", series
    yield "2", nibabel.Nifti2Image(data("float64").T, AFFINE)
    yield "1", nibabel.Nifti1Image(data("int32").T, AFFINE, nibabel.Nifti1Header(endianness=">"))


def _nii() -> Iterator[Sample]:
    for _, image in _nifti_images():
        yield one("v.nii", image.to_bytes())


def _nii_gz() -> Iterator[Sample]:
    for _, image in _nifti_images():
        yield one("v.nii.gz", gzip.compress(image.to_bytes(), mtime=0))


def _pair() -> Iterator[Sample]:
    import nibabel

    for version, image in _nifti_images():
        kind = nibabel.Nifti1Pair if version == "1" else nibabel.Nifti2Pair
        pair = kind(np.asanyarray(image.dataobj.get_unscaled()) if hasattr(image.dataobj, "get_unscaled") else image.dataobj,
                    image.affine, image.header)  # fmt: skip
        yield Sample(_written(lambda path, pair=pair: pair.to_filename(path), "v.img"), "v.hdr")


def _mgh_images() -> Iterator[Any]:
    import nibabel

    for dtype, shape in (("uint8", (3, 4, 5)), ("float32", (2, 3, 4, 5)), ("int16", (3, 4, 5)), ("int32", (3, 4, 5))):
        yield nibabel.freesurfer.MGHImage(data(dtype, shape).T, AFFINE.astype(np.float32))


def _mgh() -> Iterator[Sample]:
    for image in _mgh_images():
        yield one("v.mgh", image.to_bytes())


def _mgz() -> Iterator[Sample]:
    for image in _mgh_images():
        yield one("v.mgz", gzip.compress(image.to_bytes(), mtime=0))


def _sitk(dtype: str, shape: tuple[int, ...] = (3, 4, 5), vector: bool = False) -> Any:
    import SimpleITK as sitk

    image = sitk.GetImageFromArray(data(dtype, shape), isVector=vector)
    image.SetSpacing((*SPACING, 1.0)[: image.GetDimension()])
    image.SetOrigin((*ORIGIN, 0.0)[: image.GetDimension()])
    return image


def _of_itk(suffix: str, sidecar: bool) -> Iterator[Sample]:
    import SimpleITK as sitk

    kinds = [("int16", (3, 4, 5), False), ("float32", (4, 5), False), ("uint8", (3, 4, 5), False), ("uint8", (3, 4, 5, 3), True)]
    for dtype, shape, vector in kinds:
        for packed in (False, True):
            if packed and (vector or shape == (4, 5)):
                continue
            image = _sitk(dtype, shape, vector)
            files = _written(lambda path, image=image, packed=packed: sitk.WriteImage(image, str(path), packed), f"v{suffix}")
            assert (len(files) > 1) == sidecar
            yield Sample(files, f"v{suffix}")


def _nrrd() -> Iterator[Sample]:
    yield from _of_itk(".nrrd", sidecar=False)
    head = (
        "NRRD0001\n# by hand\ncontent: a box\ntype: unsigned short\ndimension: 3\nsizes: 5 4 3\nspacings: 0.5 0.75 2.5\n"
        "axis mins: 1 2 3\nkinds: domain domain domain\nendian: big\nencoding: raw\nbyte skip: 4\nkey:=value\n\n"
    )
    yield one("v.nrrd", head.encode() + b"skip" + data(">u2").tobytes())


def _nhdr() -> Iterator[Sample]:
    yield from _of_itk(".nhdr", sidecar=True)


def _mha() -> Iterator[Sample]:
    yield from _of_itk(".mha", sidecar=False)
    head = (
        "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = True\nTransformMatrix = 0 1 0 1 0 0 0 0 -1\n"
        "Offset = 1 2 3\nElementSpacing = 0.5 0.75 2.5\nDimSize = 5 4 3\nElementToIntensityFunctionSlope = 2\n"
        "ElementToIntensityFunctionOffset = -1\nElementType = MET_USHORT\nElementDataFile = LOCAL\n"
    )
    yield one("v.mha", head.encode() + data(">u2").tobytes())


def _mhd() -> Iterator[Sample]:
    yield from _of_itk(".mhd", sidecar=True)


def _dicom() -> Iterator[Sample]:
    import SimpleITK as sitk

    def save(path: Path, transfer: bool = False) -> None:
        volume = data("int16", (3, 8, 9))
        writer = sitk.ImageFileWriter()
        writer.KeepOriginalImageUIDOn()
        writer.SetUseCompression(transfer)
        for k in range(3):
            image = sitk.GetImageFromArray(volume[k : k + 1])
            image.SetSpacing(SPACING)
            tags = {"0008|0060": "CT", "0020|000e": "1.2.3", "0020|000d": "1.2", "0008|0018": f"1.2.3.{k}", "0020|0052": "1.2.4"}
            tags |= {"0020|0032": f"10\\-20\\{30 + 2.5 * k:g}", "0020|0037": "1\\0\\0\\0\\1\\0", "0020|0013": str(k)}
            tags |= {"0008|0012": "20260101", "0008|0013": "120000", "0028|1052": "-5", "0028|1053": "2"}
            for tag, value in tags.items():
                image.SetMetaData(tag, value)
            writer.SetFileName(str(path.with_name(f"{k}.dcm")))
            writer.Execute(image)

    files = _written(save, "x")
    yield Sample(files, "")
    yield one("v.dcm", files["0.dcm"])
    yield one("v.dcm", _written(lambda path: save(path, transfer=True), "x")["0.dcm"])
    yield one("v.dcm", _enhanced(data("uint16", (4, 3, 5))))


def _enhanced(frames: NDArray[Any]) -> bytes:
    """A multi-frame CT, as section C.7.6.16 of the standard defines it."""
    kind = "1.2.840.10008.5.1.4.1.1.2.1"
    shared = sequence(0x00209116, element(0x00200037, "DS", "1\\0\\0\\0\\1\\0"))
    shared += sequence(0x00289110, element(0x00180050, "DS", "2.5") + element(0x00280030, "DS", "0.75\\0.5"))
    places = [sequence(0x00209113, element(0x00200032, "DS", f"1\\2\\{2.5 * k:g}")) for k in range(len(frames))]
    meta = element(0x00020001, "OB", b"\0\1") + element(0x00020002, "UI", kind) + element(0x00020003, "UI", "1.2.3.4")
    meta += element(0x00020010, "UI", "1.2.840.10008.1.2.1") + element(0x00020012, "UI", "1.2.3")
    body = element(0x00080016, "UI", kind) + element(0x00080018, "UI", "1.2.3.4") + element(0x00080060, "CS", "CT")
    body += element(0x0020000D, "UI", "1.2") + element(0x0020000E, "UI", "1.2.5")
    body += element(0x00280002, "US", struct.pack("<H", 1)) + element(0x00280004, "CS", "MONOCHROME2")
    body += element(0x00280008, "IS", str(len(frames)))
    for tag, value in zip((0x10, 0x11, 0x100, 0x101, 0x102, 0x103), (*frames.shape[1:], 16, 16, 15, 0), strict=True):
        body += element(0x00280000 | tag, "US", struct.pack("<H", value))
    body += sequence(0x52009229, shared) + sequence(0x52009230, *places)
    body += element(0x7FE00010, "OW", frames.astype("<u2").tobytes())
    return bytes(128) + b"DICM" + element(0x00020000, "UL", struct.pack("<I", len(meta))) + meta + body


def _tiff() -> Iterator[Sample]:
    import tifffile

    def saved(array: NDArray[Any], **options: Any) -> bytes:
        stream = io.BytesIO()
        tifffile.imwrite(stream, array, **{"metadata": None, "datetime": False, "software": False} | options)
        return stream.getvalue()

    grey: dict[str, Any] = {"photometric": "minisblack"}
    yield one("v.tif", saved(data("uint16"), **grey))
    yield one("v.tif", saved(data("float32"), **grey, byteorder=">", bigtiff=True))
    yield one("v.tif", saved(data("uint8", (2, 32, 48)), **grey, tile=(16, 16)))
    yield one("v.tif", saved(data("uint8", (6, 7, 3)), photometric="rgb"))
    yield one("v.tif", saved(data("uint16"), **grey, resolution=(2, 2), metadata={"axes": "ZYX", "spacing": 2.5}, imagej=True))
    size = {"PhysicalSizeX": 0.25, "PhysicalSizeY": 0.5, "PhysicalSizeZ": 2.0, "UUID": "urn:uuid:0"}
    ome: dict[str, Any] = {"metadata": {"axes": "CZYX", "Channel": {"Name": ["a", "b"]}, **size}, "ome": True}
    yield one("v.ome.tif", saved(data("uint16", (2, 3, 4, 5)), **grey, **ome))


def _tiff_packed() -> Iterator[Sample]:
    import tifffile

    for compression, predictor in (("zlib", False), ("lzw", True), ("packbits", False), ("zstd", False), ("lzma", False)):
        stream = io.BytesIO()
        options: dict[str, Any] = {"compression": compression, "predictor": predictor, "metadata": None, "software": False}
        tifffile.imwrite(stream, data("uint16", (2, 12, 13)), photometric="minisblack", rowsperstrip=5, **options)
        yield one("v.tif", stream.getvalue())


def _picture(suffix: str) -> Iterator[Sample]:
    from PIL import Image

    arrays: list[NDArray[Any]] = [data("uint8", (6, 7)), data("uint8", (6, 7, 3)), data("uint16", (6, 7))]
    for array in arrays if suffix == ".png" else arrays[:2]:
        stream = io.BytesIO()
        Image.fromarray(array).save(stream, {".jpg": "jpeg"}.get(suffix, suffix[1:]))
        yield one(f"v{suffix}", stream.getvalue())
        if array.ndim == 2 and array.dtype == np.uint8:
            yield Sample({f"{k}{suffix}": stream.getvalue() for k in (9, 10, 11)}, "")


def _hdf5() -> Iterator[Sample]:
    import h5py

    def saved(libver: str, **options: Any) -> bytes:
        stream = io.BytesIO()
        with h5py.File(stream, "w", libver=libver) as file:
            array = file.create_dataset("a/cells", data=data("uint16", (4, 8, 9)), **options)
            array.attrs["element_size_um"] = (2.0, 0.5, 0.25)
        return stream.getvalue()

    yield one("v.h5", saved("earliest"))
    yield one("v.h5", saved("earliest", chunks=(2, 4, 9), compression="gzip", shuffle=True))
    yield one("v.h5", saved("latest", chunks=(2, 4, 9), fletcher32=True), checked=True)
    yield one("v.h5", saved("latest", chunks=(2, 4, 9), compression="lzf", scaleoffset=None))


def _netcdf() -> Iterator[Sample]:
    """Dimension scales, a fill value and a scale factor, as in netCDF-4."""
    import h5py

    stream = io.BytesIO()
    with h5py.File(stream, "w") as file:
        array = file.create_dataset("t", data=data("int16"))
        array.attrs.update({"scale_factor": 2.0, "add_offset": 1.0, "_FillValue": np.int16(7), "units": "K"})
        for i, (name, step) in enumerate((("z", 2.0), ("y", 0.5), ("x", 0.25))):
            line = file.create_dataset(name, data=step * np.arange(array.shape[i]))
            line.make_scale(name)
            line.attrs["units"] = "mm"
            array.dims[i].attach_scale(line)
    yield one("v.nc", stream.getvalue())


def _imaris() -> Iterator[Sample]:
    import h5py

    def letters(text: str) -> NDArray[Any]:
        return np.frombuffer(text.encode(), "S1")

    stream = io.BytesIO()
    with h5py.File(stream, "w") as file:
        for t, c in np.ndindex(2, 2):
            group = file.create_group(f"DataSet/ResolutionLevel 0/TimePoint {t}/Channel {c}")
            for axis, n in zip("ZYX", (3, 4, 5), strict=True):
                group.attrs[f"ImageSize{axis}"] = letters(str(n))
            padded = np.zeros((4, 4, 8), np.uint8)
            padded[:3, :, :5] = data("uint8") + t + c
            group.create_dataset("Data", data=padded, chunks=(4, 4, 8), compression="gzip" if c else None)
        about = file.create_group("DataSetInfo/Image")
        for i, (low, high) in enumerate(((0, 2.5), (0, 2), (0, 6))):
            about.attrs[f"ExtMin{i}"], about.attrs[f"ExtMax{i}"] = letters(str(low)), letters(str(high))
        about.attrs["Unit"] = letters("um")
        for c, name in enumerate(("DAPI", "GFP")):
            channel = file.create_group(f"DataSetInfo/Channel {c}")
            channel.attrs.update({"Name": letters(name), "Color": letters("0 1 0"), "ColorRange": letters("0 255")})
    yield one("v.ims", stream.getvalue())


def _vti() -> Iterator[Sample]:
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonDataModel import vtkImageData
    from vtkmodules.vtkIOXML import vtkXMLImageDataWriter

    modes = (("Ascii", "None"), ("Binary", "None"), ("Appended", "ZLib"), ("Appended", "None"), ("Appended", "LZ4"))
    for (mode, compressor), dtype in zip(modes, ("int16", "float32", "uint16", "float64", "uint8"), strict=True):
        image = vtkImageData()
        image.SetExtent(0, 4, 0, 3, 0, 2)
        image.SetSpacing(*SPACING)
        image.SetOrigin(*ORIGIN)
        array = numpy_to_vtk(data(dtype).ravel(), deep=True)
        array.SetName("density")
        image.GetPointData().SetScalars(array)
        writer = vtkXMLImageDataWriter()
        getattr(writer, f"SetDataModeTo{mode}")()
        getattr(writer, f"SetCompressorTypeTo{compressor}")()
        if mode == "Appended" and compressor == "None":
            writer.EncodeAppendedDataOff()
        writer.SetInputData(image)
        writer.WriteToOutputStringOn()
        assert writer.Write()
        text = writer.GetOutputString()
        content = text.encode("utf-8", "surrogateescape") if isinstance(text, str) else bytes(text)
        if mode == "Appended" and compressor == "None":  # raw bytes are no text
            content = _written(lambda path, writer=writer: _to_file(writer, path), "v.vti")["v.vti"]
        yield one("v.vti", content)


def _to_file(writer: Any, path: Path) -> None:
    writer.WriteToOutputStringOff()
    writer.SetFileName(str(path))
    assert writer.Write()


def _zarr_folders() -> Iterator[dict[str, bytes]]:
    import numcodecs
    import zarr

    def plain(path: Path) -> None:
        array = zarr.create_array(path, shape=(3, 4, 5), chunks=(2, 4, 5), dtype="uint16", compressors=None, dimension_names="zyx")
        array[:] = data("uint16")

    def checked(path: Path) -> None:
        codecs = [zarr.codecs.GzipCodec(), zarr.codecs.Crc32cCodec()]
        array = zarr.create_array(path, shape=(3, 4, 5), chunks=(3, 2, 5), dtype="float32", compressors=codecs)
        array[:] = data("float32")

    def old(path: Path) -> None:
        about: dict[str, Any] = {"compressors": numcodecs.Zlib(), "zarr_format": 2, "order": "F"}
        array = zarr.create_array(path, shape=(3, 4, 5), chunks=(2, 2, 5), dtype=">i2", **about)
        array[:] = data(">i2")

    def image(path: Path) -> None:
        group = zarr.create_group(path)
        array = group.create_array("0", shape=(2, 3, 4, 5), chunks=(1, 3, 4, 5), dtype="uint8", compressors=zarr.codecs.ZstdCodec())
        array[:] = data("uint8", (2, 3, 4, 5))
        axes = [{"name": "c", "type": "channel"}, *({"name": n, "type": "space", "unit": "micrometer"} for n in "zyx")]
        place = [{"type": "scale", "scale": [1, 2.5, 0.75, 0.5]}]
        scales = [{"axes": axes, "datasets": [{"path": "0", "coordinateTransformations": place}]}]
        channels = [{"label": n, "color": "00FF00", "window": {"start": 0, "end": 9}} for n in ("a", "b")]
        group.attrs["ome"] = {"version": "0.5", "multiscales": scales, "omero": {"channels": channels}}

    for save in (plain, checked, old, image):
        yield _written(save, "v.zarr")


def _zarr() -> Iterator[Sample]:
    for files in _zarr_folders():
        yield Sample(files, "v.zarr")


def _zarr_zip() -> Iterator[Sample]:
    for files in _zarr_folders():
        yield one("v.zarr.zip", zipped({name.removeprefix("v.zarr/"): content for name, content in files.items()}))


def zipped(files: Mapping[str, bytes], method: int = zipfile.ZIP_STORED) -> bytes:
    """A reproducible archive."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as archive:
        for name, content in files.items():
            archive.writestr(zipfile.ZipInfo(name), content)
    return stream.getvalue()


def _czi() -> Iterator[Sample]:
    from pylibCZIrw import czi

    def save(path: Path, options: str | None) -> None:
        with czi.create_czi(str(path), **({"compression_options": options} if options else {})) as file:
            for c, z in np.ndindex(2, 3):
                file.write(data=data("uint16", (8, 9))[..., None] + c + z, plane={"T": 0, "C": c, "Z": z})
            file.write_metadata("cells", channel_names={0: "a", 1: "b"}, scale_x=0.25e-6, scale_y=0.5e-6, scale_z=2e-6)

    for options in (None, "zstd1:"):
        yield Sample(_written(lambda path, options=options: save(path, options), "v.czi"), "v.czi")


def _mrc() -> Iterator[Sample]:
    """Byte orders, axes in another order, an extended header."""
    for order, kind, mode, axes, extended in (
        ("<", "i1", 0, (1, 2, 3), 0),
        (">", "f4", 2, (3, 1, 2), 8),
        ("<", "u2", 6, (2, 1, 3), 0),
    ):
        head = bytearray(1024)
        counts = (5, 4, 3, mode, 1, 2, 3, 5, 4, 3)
        head[:40] = struct.pack(f"{order}10i", *counts)
        head[40:64] = struct.pack(f"{order}6f", 2.5, 3, 7.5, 90, 90, 90 if mode else 100)
        head[64:76], head[92:96] = struct.pack(f"{order}3i", *axes), struct.pack(f"{order}i", extended)
        head[208:216] = b"MAP " + (b"DD" if order == "<" else b"\x11\x11") + bytes(2)
        yield one("v.mrc", bytes(head) + bytes(extended) + data(f"{order}{kind}").tobytes())


def _netcdf_3() -> Iterator[Sample]:
    from scipy.io import netcdf_file

    def save(path: Path, records: bool) -> None:
        with netcdf_file(path, "w") as file:
            for name, n, step in (("z", 3, 2.0), ("y", 4, 0.5), ("x", 5, 0.25)):
                file.createDimension(name, None if records and name == "z" else n)
                file.createVariable(name, "f8", (name,))[:] = step * np.arange(n)
            heat = file.createVariable("heat", "h", ("z", "y", "x"))
            heat[:] = data("int16")
            heat.scale_factor, heat.units = 2.0, "K"

    for records in (False, True):
        yield Sample(_written(lambda path, records=records: save(path, records), "v.nc"), "v.nc")


def _minc() -> Iterator[Sample]:
    import h5py

    stream = io.BytesIO()
    with h5py.File(stream, "w") as file:
        image = file.create_dataset("minc-2.0/image/0/image", data=data("int16"))
        image.attrs.update({"dimorder": np.bytes_("zspace,yspace,xspace"), "valid_range": (0.0, 500.0)})
        for end in ("min", "max"):
            file[f"minc-2.0/image/0/image-{end}"] = np.arange(3.0) + 9 * (end == "max")
        for axis, step in (("zspace", 2.0), ("yspace", -1.0), ("xspace", 0.5)):
            file.create_dataset(f"minc-2.0/dimensions/{axis}", data=0).attrs.update({"step": step, "start": 1.0})
    yield one("v.mnc", stream.getvalue())


def _analyze() -> Iterator[Sample]:
    import nibabel

    for kind, order in (("int16", "<"), ("float32", ">")):
        image = nibabel.Spm99AnalyzeImage(data(kind).T, None, nibabel.Spm99AnalyzeHeader(endianness=order))
        image.set_data_dtype(kind)
        image.header["pixdim"][1:4] = SPACING
        files = _written(lambda path, image=image: image.to_filename(path), "v.img")
        yield Sample({name: content for name, content in files.items() if not name.endswith(".mat")}, "v.hdr")


def _vtk() -> Iterator[Sample]:
    head = (
        "# vtk DataFile Version 3.0\nby hand\n{}\nDATASET STRUCTURED_POINTS\nDIMENSIONS 5 4 3\nSPACING 0.5 0.75 2.5\n"
        "ORIGIN 10 -20 30\nPOINT_DATA 60\nSCALARS heat {} 1\nLOOKUP_TABLE default\n"
    )
    yield one("v.vtk", head.format("BINARY", "float").encode() + data(">f4").tobytes() + b"\n")
    yield one("v.vtk", (head.format("ASCII", "short") + " ".join(map(str, data("int16").ravel())) + "\n").encode())


def _raw() -> Iterator[Sample]:
    yield one("v.raw", data("uint16").tobytes(), shape=(3, 4, 5), dtype="uint16", byte_order="little")
    yield one("v.raw", b"head" + data(">f4", (4, 5)).tobytes(), shape=(4, 5), dtype=">f4", offset=4)
    yield one("v.raw", data("bool").tobytes(), shape=(3, 4, 5), dtype="bool")


CORPORA: Mapping[str, Callable[[], Iterator[Sample]]] = {
    "npy": _npy,
    "npz": _npz,
    "nii": _nii,
    "nii.gz": _nii_gz,
    "hdr": _pair,
    "mgh": _mgh,
    "mgz": _mgz,
    "nrrd": _nrrd,
    "nhdr": _nhdr,
    "mha": _mha,
    "mhd": _mhd,
    "dcm": _dicom,
    "tiff": _tiff,
    "tiff-packed": _tiff_packed,
    "png": lambda: _picture(".png"),
    "jpg": lambda: _picture(".jpg"),
    "bmp": lambda: _picture(".bmp"),
    "h5": _hdf5,
    "nc": _netcdf,
    "ims": _imaris,
    "vti": _vti,
    "zarr": _zarr,
    "zarr.zip": _zarr_zip,
    "czi": _czi,
    "raw": _raw,
    "mrc": _mrc,
    "nc3": _netcdf_3,
    "mnc": _minc,
    "img": _analyze,
    "vtk": _vtk,
}
"""How the corpus of each format is made; it raises `ImportError` where a library is missing."""
