"""DICOM against pydicom's pixels, nibabel's and dcm2niix's geometry, and against what the standard says of files made here."""

from __future__ import annotations

import gzip
import subprocess
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clvol import ClvolWarning, DataError, FormatError, formats, read, read_all

pydicom = pytest.importorskip("pydicom")
pixels = pytest.importorskip("pydicom.pixels")
pytest.importorskip("SimpleITK")

Dataset, Sequence = pydicom.Dataset, pydicom.Sequence
CT, MR, ENHANCED, DOSE = (f"1.2.840.10008.5.1.4.1.1.{kind}" for kind in ("2", "4", "4.1", "481.2"))
SEGMENTATION, NUCLEAR, CAPTURE = (f"1.2.840.10008.5.1.4.1.1.{kind}" for kind in ("66.4", "20", "7.2"))
LITTLE, BIG, DEFLATED = (f"1.2.840.10008.1.2.{kind}" for kind in ("1", "2", "1.99"))
SHAPE = (3, 4)


def item(**elements: Any) -> Any:
    made = Dataset()
    for name, value in elements.items():
        setattr(made, name, Sequence(value) if isinstance(value, list) and value and isinstance(value[0], Dataset) else value)
    return made


def save(path: Path, data: np.ndarray, syntax: str = LITTLE, kind: str = CT, **elements: Any) -> Path:
    """A file of samples [y, x] or [frame, y, x]; elements that are None are left out."""
    big = syntax == BIG
    known: dict[str, Any] = {
        "SOPClassUID": kind,
        "SOPInstanceUID": f"1.2.{abs(hash(path.name))}",
        "Modality": "CT",
        "SeriesInstanceUID": "1.2.3",
        "StudyInstanceUID": "1.2",
        "Rows": data.shape[-2],
        "Columns": data.shape[-1],
        "SamplesPerPixel": 1,
        "PhotometricInterpretation": "MONOCHROME2",
        "BitsAllocated": 8 * data.dtype.itemsize,
        "BitsStored": 8 * data.dtype.itemsize,
        "HighBit": 8 * data.dtype.itemsize - 1,
        "PixelRepresentation": int(data.dtype.kind == "i"),
        "ImagePositionPatient": [0, 0, 0],
        "ImageOrientationPatient": [1, 0, 0, 0, 1, 0],
        "PixelSpacing": [0.5, 0.25],
    }
    if data.ndim == 3:
        known["NumberOfFrames"] = len(data)
    made = item(**{name: value for name, value in (known | elements).items() if value is not None})
    made.file_meta = pydicom.dataset.FileMetaDataset()
    made.file_meta.TransferSyntaxUID = syntax
    made.file_meta.MediaStorageSOPClassUID, made.file_meta.MediaStorageSOPInstanceUID = kind, made.SOPInstanceUID
    content = data.astype(data.dtype.newbyteorder(">" if big else "<")).tobytes()
    made.PixelData = content + bytes(len(content) % 2)
    made["PixelData"].VR = "OW"
    path.parent.mkdir(parents=True, exist_ok=True)
    made.save_as(path, enforce_file_format=True)
    return path


def stack(folder: Path, count: int = 3, each: Any = lambda _: {}, dtype: str = "int16", **elements: Any) -> np.ndarray:
    """Files of one slice each, 2 mm apart; `each` gives the elements of number k."""
    data = np.arange(count * 12, dtype=dtype).reshape(count, *SHAPE)
    for k in range(count):
        save(folder / f"{k}.dcm", data[k], **{"ImagePositionPatient": [0, 0, 2 * k], "InstanceNumber": k + 1} | elements | each(k))
    return data


def frames(count: int, each: Any, shared: list[Any] = []) -> dict[str, Any]:  # noqa: B006  # never changed
    """Functional groups of an enhanced object."""
    common = item(
        PixelMeasuresSequence=[item(PixelSpacing=[0.5, 0.25], SliceThickness=2)],
        PlaneOrientationSequence=[item(ImageOrientationPatient=[1, 0, 0, 0, 1, 0])],
    )
    for one in shared:
        common.update(one)
    own = [item(**each(k)) for k in range(count)]
    return {
        "SharedFunctionalGroupsSequence": [common],
        "PerFrameFunctionalGroupsSequence": own,
        **dict.fromkeys(("ImagePositionPatient", "ImageOrientationPatient", "PixelSpacing")),
    }


def at(z: float) -> dict[str, Any]:
    return {"PlanePositionSequence": [item(ImagePositionPatient=[0, 0, z])]}


# -- other projects' files ---------------------------------------------------------------------------------------


def test_files_of_pydicom_have_its_pixels() -> None:
    """Its own test files: compressed in eleven ways, big-endian, deflated, damaged; with the values that each header gives."""
    compared = 0
    for path in sorted((Path(pydicom.__file__).parent / "data").rglob("*")):
        if path.is_dir() or (path.read_bytes()[128:132] != b"DICM" and path.suffix != ".dcm"):
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                header = pydicom.dcmread(path, force=True)
                expected = pixels.pixel_array(header)
            except Exception:
                continue  # no pixels, or none that pydicom decodes
            if header.PhotometricInterpretation == "PALETTE COLOR":
                expected = pixels.apply_color_lut(expected, header)[..., :3]
            expected = pixels.apply_modality_lut(expected, header) * float(header.get("DoseGridScaling", 1))
            found = np.asarray(read_all(path))
        if found.shape[-3] != 1 and "NumberOfFrames" not in header:
            pytest.fail(f"{path.name}: {found.shape}")
        coloured = expected.ndim > 2 and expected.shape[-1] == 3
        expected = (
            np.moveaxis(expected, -1, -3)
            if coloured and found.ndim != 4
            else np.moveaxis(expected, -1, 0)
            if coloured
            else expected
        )
        np.testing.assert_allclose(np.squeeze(found), np.squeeze(expected), rtol=1e-12, err_msg=path.name)
        compared += 1
    assert compared >= 85  # Pillow before 11 decodes fewer


@pytest.mark.parametrize("name", ["siemens_dwi_0.dcm.gz", "siemens_dwi_1000.dcm.gz"])
def test_a_mosaic_is_taken_apart(tmp_path: Path, name: str) -> None:
    wrappers = pytest.importorskip("nibabel.nicom.dicomwrappers")
    packed = Path(wrappers.__file__).parent / "tests" / "data" / name
    if not packed.exists():
        pytest.skip("nibabel was installed without its test files")
    path = tmp_path / "v.dcm"
    path.write_bytes(gzip.decompress(packed.read_bytes()))
    truth = wrappers.wrapper_from_data(pydicom.dcmread(path))
    volume = read(path)
    np.testing.assert_array_equal(volume.data, truth.get_data().transpose(2, 0, 1))
    np.testing.assert_allclose(volume.index_to_world([0, 0, 0]), truth.affine[:3, 3], atol=1e-4)
    for index in ([1, 0, 0], [0, 1, 0], [0, 0, 5]):  # nibabel's first index runs along the rows' columns
        swapped = [index[1], index[0], index[2]]
        np.testing.assert_allclose(volume.index_to_world(index), truth.affine[:3, :3] @ swapped + truth.affine[:3, 3], atol=1e-3)


def test_a_mosaic_without_its_header_is_refused(tmp_path: Path) -> None:
    save(tmp_path / "v.dcm", np.zeros((8, 8), np.int16), kind=MR, ImageType=["ORIGINAL", "PRIMARY", "M", "ND", "MOSAIC"])
    with pytest.raises(FormatError, match="mosaic"):
        read(tmp_path / "v.dcm")


@pytest.mark.parametrize("name", ["0.dcm", "1.dcm"])
def test_a_mosaic_that_does_not_divide_is_refused(name: str) -> None:
    path = Path(pytest.importorskip("nibabel.nicom").__file__).parent / "tests" / "data" / name
    if not path.exists():
        pytest.skip("nibabel was installed without its test files")
    with pytest.raises(FormatError, match=r"mosaic of 48 slices.* multiples of 7; it has 256 and 256"):
        read(path)


def test_geometry_is_that_of_dcm2niix(tmp_path: Path) -> None:
    nibabel, dcm2niix = pytest.importorskip("nibabel"), pytest.importorskip("dcm2niix")
    turn = [0.8, 0.6, 0, 0, 0, -1]
    normal = np.cross(turn[:3], turn[3:])
    data = np.random.default_rng(1).integers(0, 1000, (5, 16, 20)).astype(np.int16)
    for k in range(5):
        place = (np.array([10, -20, 30]) + 1.5 * k * normal).tolist()
        about: dict[str, Any] = {
            "ImageOrientationPatient": turn,
            "ImagePositionPatient": place,
            "InstanceNumber": 5 - k,
            "SliceThickness": 1.5,
        }
        about |= {
            "Modality": "MR",
            "RescaleSlope": 2,
            "RescaleIntercept": -5,
            "ImageType": ["ORIGINAL", "PRIMARY"],
            "SeriesNumber": 1,
        }
        save(tmp_path / "in" / f"{k}.dcm", data[k], kind=MR, **about)
    (tmp_path / "out").mkdir()
    subprocess.run([dcm2niix.bin, "-o", tmp_path / "out", "-f", "v", tmp_path / "in"], check=True, capture_output=True)
    truth = nibabel.load(next((tmp_path / "out").glob("v*.nii")))
    theirs, ours = read(tmp_path / "out" / Path(truth.get_filename()).name), read(tmp_path / "in")
    back = theirs.world_to_index(
        ours.index_to_world([3, 4, 2]) * [-1, -1, 1] if theirs.space != ours.space else ours.index_to_world([3, 4, 2])
    )
    i, j, k = np.rint(back).astype(int)
    np.testing.assert_allclose(back, (i, j, k), atol=1e-3)
    assert theirs.data[k, j, i] == ours.data[2, 4, 3] == 2 * data[2, 4, 3] - 5


# -- each slice by its own header ----------------------------------------------------------------------------------


@pytest.mark.parametrize("slopes", [(1, 0.5, 0.25), (1, 2000, 2)])
def test_each_slice_has_its_own_slope(tmp_path: Path, slopes: tuple[float, ...]) -> None:
    data = stack(tmp_path, each=lambda k: {"RescaleSlope": slopes[k], "RescaleIntercept": -k})
    np.testing.assert_array_equal(read(tmp_path).data, data * np.reshape(slopes, (3, 1, 1)) - np.arange(3)[:, None, None])


def test_signed_and_unsigned_slices(tmp_path: Path) -> None:
    save(tmp_path / "0.dcm", np.full(SHAPE, 60000, np.uint16))
    save(tmp_path / "1.dcm", np.full(SHAPE, -5, np.int16), ImagePositionPatient=[0, 0, 1])
    assert read(tmp_path).data[:, 0, 0].tolist() == [60000, -5]


@pytest.mark.parametrize(
    ("odd", "said"),
    [
        ({"PixelSpacing": [0.7, 0.7]}, r"one spacing.* 0\.5 × 0\.25 and 2\.dcm 0\.7 × 0\.7"),
        ({"Rows": 4, "Columns": 3}, r"one size and colour; 0\.dcm and 2\.dcm"),
        ({"ImagePositionPatient": None}, r"where each slice lies; 2\.dcm does not"),
        ({"ImagePositionPatient": [0, 0, 2]}, r"several images of some places.*[12]\.dcm and [12]\.dcm"),
        ({"ImagePositionPatient": [0, 0, 7]}, r"evenly spaced.*2 to 5 mm apart"),
        ({"ImagePositionPatient": [1.2, 0, 3.6]}, r"on a line; they lie 2 mm apart, but 1\.dcm lies 0\.632\d+ mm beside the line"),
    ],
)
def test_a_slice_that_does_not_belong_is_named(tmp_path: Path, odd: dict[str, Any], said: str) -> None:
    stack(tmp_path, each=lambda k: odd if k == 2 else {})
    with pytest.raises(FormatError, match=said):
        read(tmp_path)


# -- each frame by its own words -------------------------------------------------------------------------------------


@pytest.mark.parametrize("syntax", [LITTLE, BIG, DEFLATED])
def test_frames_have_their_own_slopes_and_places(tmp_path: Path, syntax: str) -> None:
    data, slopes = np.arange(36, dtype=np.uint16).reshape(3, *SHAPE), (1, 0.5, 4)

    def each(k: int) -> dict[str, Any]:
        private = item(ImagePositionPatient=[9, 9, 9])  # as Philips' scanners copy positions
        group = at(2 * k) | {
            "PixelValueTransformationSequence": [item(RescaleSlope=slopes[k], RescaleIntercept=1, RescaleType="US")]
        }
        made = item(**group)
        made.private_block(0x2005, "Philips MR Imaging DD 005", create=True).add_new(0x0F, "SQ", Sequence([private]))
        return {element.keyword or element.tag: element.value for element in made if element.keyword} | {"_": made}

    groups = frames(3, lambda k: {name: value for name, value in each(k).items() if name != "_"})
    for k, group in enumerate(groups["PerFrameFunctionalGroupsSequence"]):
        group.update(each(k)["_"])
    volume = read(save(tmp_path / "v.dcm", data, syntax, ENHANCED, Modality="MR", **groups))
    np.testing.assert_array_equal(volume.data, data * np.reshape(slopes, (3, 1, 1)) + 1)
    assert volume.spacing == (0.25, 0.5, 2)


def test_doses_are_scaled_and_placed(tmp_path: Path) -> None:
    data = np.arange(36, dtype=np.uint32).reshape(3, *SHAPE) * 100_000
    about: dict[str, Any] = {"Modality": "RTDOSE", "DoseGridScaling": 1e-3, "FrameIncrementPointer": 0x3004000C}
    volume = read(save(tmp_path / "v.dcm", data, BIG, DOSE, GridFrameOffsetVector=[0, 2.5, 5], **about))
    np.testing.assert_allclose(volume.data, data * 1e-3, rtol=1e-15)
    assert volume.spacing == (0.25, 0.5, 2.5)
    with pytest.raises(FormatError, match=r"2\.5 to 5 mm apart"):
        read(save(tmp_path / "v.dcm", data, kind=DOSE, GridFrameOffsetVector=[0, 2.5, 7.5], **about))


def test_nuclear_slices_lie_where_their_detector_says(tmp_path: Path) -> None:
    data = np.arange(36, dtype=np.uint16).reshape(3, *SHAPE)
    detector = item(ImagePositionPatient=[1, 2, 30], ImageOrientationPatient=[1, 0, 0, 0, 1, 0])
    about: dict[str, Any] = {
        "SliceVector": [1, 2, 3],
        "SpacingBetweenSlices": -4,
        "FrameIncrementPointer": 0x00540080,
        "Modality": "NM",
    }
    none: dict[str, Any] = dict.fromkeys(("ImagePositionPatient", "ImageOrientationPatient"))
    volume = read(save(tmp_path / "v.dcm", data, kind=NUCLEAR, DetectorInformationSequence=[detector], **about, **none))
    np.testing.assert_allclose(volume.index_to_world([0, 0, 2]), (1, 2, 22))


# -- what samples mean -------------------------------------------------------------------------------------------------


def test_inverted_pictures_keep_their_values_and_window(tmp_path: Path) -> None:
    about: dict[str, Any] = {"RescaleSlope": 0.5, "RescaleIntercept": 5, "WindowCenter": 100, "WindowWidth": 50}
    volume = read(
        save(
            tmp_path / "v.dcm",
            np.full(SHAPE, 150, np.uint16),
            PhotometricInterpretation="MONOCHROME1",
            BitsStored=12,
            HighBit=11,
            **about,
        )
    )
    assert (volume.data[0, 0, 0], volume.clim, volume.header["photometric"]) == (80, (75, 125), "MONOCHROME1")


def test_lookup_tables_of_the_modality(tmp_path: Path) -> None:
    table = item(LUTDescriptor=[4, 0, 16], LUTData=np.array([10, 500, 30, 7], "<u2").tobytes(), ModalityLUTType="US")
    data = np.array([[0, 1, 2], [3, 2, 1]], np.uint16)
    volume = read(save(tmp_path / "v.dcm", data, ModalityLUTSequence=[table]))
    assert volume.data[0].tolist() == [[10, 500, 30], [7, 30, 500]]


@pytest.mark.parametrize(
    ("elements", "spacing"),
    [
        ({"PixelSpacing": None, "ImagerPixelSpacing": [0.2, 0.1]}, (0.1, 0.2)),
        ({"PixelSpacing": [0.3, 0.3], "ImagerPixelSpacing": [0.2, 0.1]}, (0.3, 0.3)),
        ({"PixelSpacing": None, "NominalScannedPixelSpacing": [0.4, 0.4]}, (0.4, 0.4)),
        (
            {
                "PixelSpacing": None,
                "SequenceOfUltrasoundRegions": [
                    item(PhysicalUnitsXDirection=3, PhysicalUnitsYDirection=3, PhysicalDeltaX=0.01, PhysicalDeltaY=0.02)
                ],
            },
            (0.1, 0.2),
        ),
    ],
)
def test_spacing_stands_in_many_places(tmp_path: Path, elements: dict[str, Any], spacing: tuple[float, float]) -> None:
    np.testing.assert_allclose(read(save(tmp_path / "v.dcm", np.zeros(SHAPE, np.int16), **elements)).spacing[:2], spacing)


def test_spacing_with_nulls_between(tmp_path: Path) -> None:
    path = save(tmp_path / "v.dcm", np.zeros(SHAPE, np.int16), PixelSpacing=["0.25", "0.25"])
    for wrong in (b"0.2\\\0\\0.2 ", b"0.2\\0\\0.2 "):
        path.write_bytes(path.read_bytes().replace(b"0.25\\0.25 ", wrong.ljust(10)))
        np.testing.assert_allclose(read(path).spacing[:2], 0.2)
        path = save(path, np.zeros(SHAPE, np.int16), PixelSpacing=["0.25", "0.25"])


def test_a_film_has_times_not_slices(tmp_path: Path) -> None:
    path = save(
        tmp_path / "v.dcm", np.zeros((4, *SHAPE), np.uint8), kind=CAPTURE, FrameTime="69.47", FrameIncrementPointer=0x00181063
    )
    film = read_all(path)
    assert (film.axes, film.shape, film.grid.header["time_step"]) == (("time",), (4, 1, *SHAPE), 69.47)


def test_floating_samples_stay_floating(tmp_path: Path) -> None:
    made = pydicom.dcmread(save(tmp_path / "v.dcm", np.zeros(SHAPE, np.uint16)))
    for name in ("PixelData", "BitsStored", "HighBit", "PixelRepresentation"):
        del made[name]
    values = np.linspace(-3.5, 0.75, 12).reshape(SHAPE)
    for dtype, element in (("f4", "FloatPixelData"), ("f8", "DoubleFloatPixelData")):
        made.BitsAllocated = 8 * np.dtype(dtype).itemsize
        setattr(made, element, values.astype(dtype).tobytes())
        made.save_as(tmp_path / f"{dtype}.dcm")
        volume = read(tmp_path / f"{dtype}.dcm")
        np.testing.assert_array_equal(volume.data[0], values.astype(dtype))
        assert volume.data.dtype == dtype
        del made[element]


def test_a_table_beside_a_slope_wraps_nothing(tmp_path: Path) -> None:
    table = item(LUTDescriptor=[4, 0, 16], LUTData=np.array([10, 500, 30, 7], "<u2").tobytes(), ModalityLUTType="US")
    save(tmp_path / "0.dcm", np.ones(SHAPE, np.uint16), ModalityLUTSequence=[table])
    save(tmp_path / "1.dcm", np.full(SHAPE, 3000, np.uint16), ImagePositionPatient=[0, 0, 2], RescaleSlope=-1.5, RescaleIntercept=0)
    assert read(tmp_path).data[:, 0, 0].tolist() == [500, -4500]


def test_more_bits_than_the_header_says_wrap_nothing(tmp_path: Path) -> None:
    """As JPEG 2000 decodes them; native samples are masked, as pydicom masks them."""
    data = np.full((64, 64), 30000, np.uint16)
    made = pydicom.dcmread(save(tmp_path / "v.dcm", data, RescaleSlope=1, RescaleIntercept=-1024))
    made.compress("1.2.840.10008.1.2.5")
    made.BitsStored, made.HighBit = 12, 11
    made.save_as(tmp_path / "v.dcm")
    expected = pixels.apply_modality_lut(pixels.pixel_array(pydicom.dcmread(tmp_path / "v.dcm")), made)
    np.testing.assert_array_equal(read(tmp_path / "v.dcm").data[0], expected)


# -- which frames make a volume ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("element", "values", "axis"),
    [
        ("TemporalPositionIdentifier", (1, 2), "time"),
        ("EchoTime", (4.6, 9.2), "volume"),
        ("AcquisitionNumber", (1, 2), "volume"),
        ("DiffusionBValue", (0.0, 1000.0), "volume"),
        ("TriggerTime", (10, 35), "time"),
        ("FlipAngle", (5.0, 25.0), "volume"),
        ("ContentTime", ("101500", "101530"), "time"),
        ("ImageType", (["ORIGINAL", "PRIMARY", "M"], ["ORIGINAL", "PRIMARY", "P"]), "volume"),
    ],
)
@pytest.mark.filterwarnings("error::clvol.ClvolWarning")
def test_images_of_one_place_are_told_apart(tmp_path: Path, element: str, values: tuple[Any, ...], axis: str) -> None:
    """Their numbers run the other way in every second place, as on scanners that interleave."""

    def each(k: int) -> dict[str, Any]:
        place, image = divmod(k, 2)
        number = 2 * place + (image if place % 2 else 1 - image)
        return {"ImagePositionPatient": [0, 0, 2 * place], element: values[image], "InstanceNumber": number}

    data = stack(tmp_path, 6, each, kind=MR)
    every = read_all(tmp_path)
    assert every.axes == (axis,)
    np.testing.assert_array_equal(every, data.reshape(3, 2, *SHAPE).swapaxes(0, 1))
    assert (
        str(values[1][2] if element == "ImageType" else f"{values[1]:g}" if isinstance(values[1], (int, float)) else values[1])
        in every.names[1]
    )


@pytest.mark.filterwarnings("error::clvol.ClvolWarning")
def test_gradients_keep_the_order_in_which_they_were_taken(tmp_path: Path) -> None:
    turns = ([0, 0, 1], [1, 0, 0], [0, 1, 0])

    def each(k: int) -> dict[str, Any]:
        image, place = divmod(k, 2)
        about = {"DiffusionBValue": 800.0 if image else 0.0, "DiffusionGradientOrientation": turns[image]}
        return {"ImagePositionPatient": [0, 0, 2 * place], "InstanceNumber": k} | about

    data = stack(tmp_path, 6, each, kind=MR)
    np.testing.assert_array_equal(read_all(tmp_path), data.reshape(3, 2, *SHAPE))


@pytest.mark.filterwarnings("error::clvol.ClvolWarning")
def test_dimension_indices_come_before_instance_numbers(tmp_path: Path) -> None:
    data = np.arange(72, dtype=np.uint16).reshape(6, *SHAPE)
    order = [(0, 1), (1, 0), (0, 0), (2, 1), (1, 1), (2, 0)]  # place and dimension of each frame
    groups = frames(
        6, lambda k: at(2 * order[k][0]) | {"FrameContentSequence": [item(DimensionIndexValues=[order[k][0] + 1, order[k][1] + 1])]}
    )
    every = read_all(save(tmp_path / "v.dcm", data, kind=ENHANCED, Modality="MR", **groups))
    for k, (place, dimension) in enumerate(order):
        np.testing.assert_array_equal(np.asarray(every)[dimension, place], data[k])


@pytest.mark.filterwarnings("error::clvol.ClvolWarning")
def test_several_files_of_frames_are_several_volumes(tmp_path: Path) -> None:
    data = np.arange(72, dtype=np.uint16).reshape(2, 3, *SHAPE)
    for n in range(2):
        save(tmp_path / f"{n}.dcm", data[n], kind=ENHANCED, Modality="MR", **frames(3, lambda k: at(2 * k)))
    np.testing.assert_array_equal(read_all(tmp_path), data)


def test_films_in_a_folder_are_not_jumbled(tmp_path: Path) -> None:
    for n in range(2):
        save(tmp_path / f"{n}.dcm", np.zeros((4, *SHAPE), np.uint8), kind=CAPTURE, ImagePositionPatient=None, FrameTime=40)
    with pytest.raises(FormatError, match=r"2 files of several frames.*read one file"):
        read(tmp_path)


# -- segmentations -------------------------------------------------------------------------------------------------------


def test_segments_whose_frames_share_bytes(tmp_path: Path) -> None:
    masks = np.random.default_rng(1).integers(0, 2, (3, 3, 5)).astype(np.uint8)
    volume = read(segmentation(tmp_path / "v.dcm", masks, [0, 2, 4], [1, 1, 1]))
    np.testing.assert_array_equal(volume.data, masks)


def segmentation(path: Path, masks: np.ndarray, places: list[float], segments: list[int], kind: str = "BINARY") -> Path:
    def each(k: int) -> dict[str, Any]:
        return at(places[k]) | {"SegmentIdentificationSequence": [item(ReferencedSegmentNumber=segments[k])]}

    bits = {"BitsAllocated": 1, "BitsStored": 1, "HighBit": 0} if kind == "BINARY" else {"MaximumFractionalValue": 200}
    named = [item(SegmentNumber=1, SegmentLabel="liver"), item(SegmentNumber=2, SegmentLabel="tumour")]
    about = {"SegmentSequence": named, "SegmentationType": kind, "Modality": "SEG"} | bits | frames(len(masks), each)
    save(path, masks, kind=SEGMENTATION, **about)
    if kind == "BINARY":
        made = pydicom.dcmread(path)
        packed = np.packbits(masks.ravel(), bitorder="little").tobytes()
        made.PixelData = packed + bytes(len(packed) % 2)
        made.save_as(path)
    return path


def test_segments_become_labels(tmp_path: Path) -> None:
    masks = np.zeros((3, *SHAPE), np.uint8)
    masks[0, 0], masks[1, 1], masks[2, 2] = 1, 1, 1
    volume = read(segmentation(tmp_path / "v.dcm", masks, [0, 0, 6], [1, 2, 1]))  # no frames for the empty slices at 2 and 4
    assert (volume.shape, volume.spacing, volume.labels) == ((4, *SHAPE), (0.25, 0.5, 2), {1: "liver", 2: "tumour"})
    assert volume.data[:, :, 0].tolist() == [[1, 2, 0], [0, 0, 0], [0, 0, 0], [0, 0, 1]]


def test_sparse_segments_keep_their_slices(tmp_path: Path) -> None:
    """Slices that touch beside a wide gap are two slices, not one (as in highdicom's own test file)."""
    masks = np.ones((3, *SHAPE), np.uint8)
    volume = read(segmentation(tmp_path / "v.dcm", masks, [0, 2, 200], [1, 2, 1]))
    assert volume.data[:, 0, 0].tolist() == [1, 2, *[0] * 98, 1]


def test_segments_that_overlap_and_fractions_are_channels(tmp_path: Path) -> None:
    masks = np.ones((2, *SHAPE), np.uint8)
    both = read_all(segmentation(tmp_path / "v.dcm", masks, [0, 0], [1, 2]))
    assert (both.axes, both.names, np.asarray(both).sum()) == (("channel",), ("liver", "tumour"), 24)
    parts = read_all(segmentation(tmp_path / "v.dcm", masks * 50, [0, 0], [1, 2], "FRACTIONAL"))
    np.testing.assert_allclose(parts, 0.25)


# -- harmless faults and others --------------------------------------------------------------------------------------------


def test_harmless_faults_are_read_with_a_warning(tmp_path: Path) -> None:
    data = np.arange(12, dtype=np.int16).reshape(SHAPE)
    whole = save(tmp_path / "v.dcm", data).read_bytes()
    for padding in (bytes(100), b" " * 33):
        (tmp_path / "v.dcm").write_bytes(whole + padding)
        with pytest.warns(ClvolWarning, match="padding after its samples"):
            np.testing.assert_array_equal(read(tmp_path / "v.dcm").data[0], data)
    (tmp_path / "v.dcm").write_bytes(whole[132:])
    with pytest.warns(ClvolWarning, match="no preamble"):
        np.testing.assert_array_equal(read(tmp_path / "v.dcm").data[0], data)
    with pytest.warns(ClvolWarning, match=r"v\.dcm: .*(longer|excess|padding)"):
        np.testing.assert_array_equal(read(save(tmp_path / "v.dcm", data, Rows=2)).data[0], data[:2])
    with pytest.warns(ClvolWarning, match="how far apart"):
        assert read(save(tmp_path / "v.dcm", data, PixelSpacing=None)).spacing == (1, 1, 1)


@pytest.mark.parametrize(
    ("elements", "said"),
    [({"SOPClassUID": "1.2.840.10008.5.1.4.1.1.88.11"}, "no pictures"), ({"TotalPixelMatrixColumns": 8}, "tiles")],
)
def test_what_is_no_volume_is_refused(tmp_path: Path, elements: dict[str, Any], said: str) -> None:
    with pytest.raises((FormatError, DataError), match=said):
        read(save(tmp_path / "v.dcm", np.zeros(SHAPE, np.int16), **elements))


def test_slices_that_say_where_they_lie_in_other_words(tmp_path: Path) -> None:
    """Blank slopes (they stopped the file), SliceLocation alone (slices lay a thickness apart), one position for all frames."""
    data = stack(tmp_path / "blank", RescaleSlope=None, each=lambda _: {"RescaleSlope": "", "RescaleIntercept": ""})
    np.testing.assert_array_equal(read(tmp_path / "blank").data, data)
    stack(tmp_path / "location", each=lambda k: {"SliceLocation": 7 - 3.0 * k, "ImagePositionPatient": None}, SliceThickness=1)
    with pytest.warns(ClvolWarning, match="placed by their SliceLocation"):
        volume = read(tmp_path / "location")
    np.testing.assert_array_equal(volume.data, data[::-1])
    assert (volume.spacing, volume.origin) == ((0.25, 0.5, 3), (0, 0, 1))
    for n, element in enumerate(("", "InStackPositionNumber")):
        own = [{"FrameContentSequence": [item(**{element: k + 1})]} if element else {} for k in range(3)]
        save(tmp_path / f"{n}.dcm", data, **frames(3, lambda k, own=own: at(7.0) | own[k]))
        with pytest.warns(ClvolWarning, match="3 frames say one position; they were taken for slices, 2 mm apart"):
            volume = read(tmp_path / f"{n}.dcm")
        np.testing.assert_array_equal(volume.data, data)
        assert (volume.spacing, volume.origin) == ((0.25, 0.5, 2), (0, 0, 7))
    times = [{"FrameContentSequence": [item(TemporalPositionIndex=k + 1)]} for k in range(3)]
    save(tmp_path / "times.dcm", data, **frames(3, lambda k: at(7.0) | times[k]))
    assert read_all(tmp_path / "times.dcm").shape == (3, 1, *SHAPE)


# -- folders below the one that is given -------------------------------------------------------------------------


def test_the_only_folder_of_images_below_one_is_read_and_named(tmp_path: Path) -> None:
    disc = tmp_path / "disc"
    data = stack(disc / "study" / "head")
    (disc / "viewer").mkdir()
    (disc / "viewer" / "readme.txt").write_text("no image")
    with pytest.warns(ClvolWarning, match="disc holds no DICOM images itself; the series in study/head was read"):
        assert np.array_equal(read(disc).data, data)
    directory = item(SOPClassUID="1.2.840.10008.1.3.10", SOPInstanceUID="1.2.9")
    directory.file_meta = pydicom.dataset.FileMetaDataset()
    directory.file_meta.TransferSyntaxUID, directory.file_meta.MediaStorageSOPClassUID = LITTLE, directory.SOPClassUID
    directory.file_meta.MediaStorageSOPInstanceUID = directory.SOPInstanceUID
    directory.save_as(disc / "DICOMDIR", enforce_file_format=True)
    assert np.array_equal(read(disc, series=0).data, data)


def test_several_folders_of_images_are_listed_and_one_is_chosen(tmp_path: Path) -> None:
    one = stack(tmp_path / "a" / "ct", SeriesDescription="head")
    other = stack(tmp_path / "b", 4, dtype="uint16", SeriesInstanceUID="1.2.4", Modality="MR")
    stack(tmp_path / "copy" / "ct", SeriesDescription="head")
    with pytest.raises(DataError, match=r"holds 3 series: 0: .*MR, 4 files, in b.*choose one by series=") as error:
        read(tmp_path)
    assert all(f"in {where}" in str(error.value) for where in ("a/ct", "copy/ct"))
    assert [one.id for one in formats.series_of(tmp_path)] == ["1.2.4", "a/ct/1.2.3", "copy/ct/1.2.3"]
    assert np.array_equal(read(tmp_path, series="1.2.4").data, other)
    assert np.array_equal(read(tmp_path, series="a/ct/1.2.3").data, one)


def test_folders_without_images_below_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    with pytest.raises(FormatError, match="a folder must hold DICOM files, itself or in folders below it"):
        read(tmp_path)
    for n in range(501):
        (tmp_path / f"b{n}").mkdir()
    stack(tmp_path / "a", 1)
    with pytest.raises(FormatError, match="at most 500 folders below it"):
        read(tmp_path)
