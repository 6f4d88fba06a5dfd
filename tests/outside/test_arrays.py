"""Arrays of other libraries, in and out: by protocol, without a copy, or rejected with the rule."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray
from scipy import ndimage

import clvol
from clvol.base.arrays import as_array, as_output
from clvol.base.errors import DataError, OptionError
from clvol.device import Device

Array = NDArray[Any]


def torch() -> Any:
    return pytest.importorskip("torch")


class Interface:
    """Speaks `__array_interface__` alone."""

    def __init__(self, array: Array) -> None:
        self.kept = array
        self.__array_interface__ = array.__array_interface__


class Converted:
    """Speaks `__array__` alone."""

    def __init__(self, array: Array) -> None:
        self.kept = array

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        return self.kept if dtype is None else self.kept.astype(dtype)


class Exchanged:
    """Speaks DLPack alone."""

    def __init__(self, array: Array, place: tuple[int, int] = (1, 0)) -> None:
        self.kept, self.place = array, place

    def __dlpack_device__(self) -> tuple[int, int]:
        return self.place

    def __dlpack__(self, **options: Any) -> Any:
        return self.kept.__dlpack__(**options)


class OnDevice:
    """Like CuPy's arrays: conversion raises a `TypeError`."""

    __cuda_array_interface__: dict[str, Any] = {}  # noqa: RUF012  # a property there

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        raise TypeError("Implicit conversion to a NumPy array is not allowed.")


OnDevice.__module__ = "cupy._core.core"

READERS: dict[str, Callable[[Array], Any]] = {
    "interface": Interface,
    "converted": Converted,
    "dlpack": Exchanged,
    "buffer": memoryview,
    "torch": lambda a: torch().from_numpy(a),
    "torch, with a gradient": lambda a: torch().from_numpy(a).requires_grad_(),
    "xarray": lambda a: pytest.importorskip("xarray").DataArray(a),
}


def samples() -> Array:
    return np.random.default_rng(0).uniform(-1, 1, (7, 8, 9))


def places() -> Array:
    return np.random.default_rng(1).uniform(1, 5, (20, 3))


def truth(data: Array, points: Array) -> Array:
    return np.asarray(ndimage.map_coordinates(data, points[:, ::-1].T, np.float64, 3, "mirror"))


# -- in --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", READERS)
def test_any_protocol_is_read_and_nothing_is_copied(kind: str) -> None:
    data = samples()
    read = as_array(READERS[kind](data))
    assert_array_equal(read, data)
    assert np.shares_memory(read, data)
    assert np.shares_memory(clvol.Volume(READERS[kind](data)).data, data)


@pytest.mark.parametrize("kind", READERS)
def test_samples_and_points_of_any_kind(device: Device, kind: str) -> None:
    wrap, data, points = READERS[kind], samples(), places()
    assert_allclose(clvol.sample(wrap(data), wrap(points), device=device), truth(data, points), rtol=0, atol=2e-6)
    larger = clvol.resample(wrap(data), (7, 8, 18), device=device).data
    assert_array_equal(larger, clvol.resample(data, (7, 8, 18), device=device).data)
    assert_allclose(clvol.prefilter(wrap(data), device=device), ndimage.spline_filter(data, mode="mirror"), rtol=0, atol=1e-5)
    plane = clvol.images.resample(wrap(data[0].copy()), (8, 18), device=device)
    assert_array_equal(plane, clvol.images.resample(data[0], (8, 18), device=device))
    volume = clvol.Volume(data, (0.5, 1, 2))
    assert_allclose(volume.world_to_index(wrap(points)), points / (0.5, 1, 2), rtol=1e-15)


@pytest.mark.parametrize("kind", READERS)
def test_ndimage_functions_accept_them(kind: str) -> None:
    wrap, data, points = READERS[kind], samples(), places()
    got = clvol.ndimage.map_coordinates(wrap(data), wrap(np.ascontiguousarray(points[:, ::-1].T)), mode="mirror")
    assert_allclose(got, truth(data, points), rtol=0, atol=1e-12)


def test_ndimage_functions_write_into_them(device: Device) -> None:
    data = samples()
    expected = ndimage.shift(data, 0.3, mode="mirror")
    for wrap in (Converted, Interface, lambda a: torch().from_numpy(a)):
        memory = np.zeros(data.shape)
        clvol.ndimage.shift(data, 0.3, wrap(memory), mode="mirror", device=device)
        assert_allclose(memory, expected, rtol=0, atol=1e-12)
    with pytest.raises(TypeError, match="of which NumPy makes a copy"):
        clvol.ndimage.shift(data, 0.3, data.tolist(), device=device)
    for kind, (make, message) in REFUSED.items():
        if kind != "torch" or torch():
            with pytest.raises(DataError, match="input must lie in the host's memory; got a .*" + message):
                clvol.ndimage.shift(make(), 0.3)


def test_read_only_dlpack_arrays() -> None:
    data = samples()
    data.flags.writeable = False
    given = Exchanged(data)
    try:
        np.from_dlpack(given)
    except BufferError:
        pytest.skip("this NumPy does not export them")
    assert np.shares_memory(as_array(given), data)
    with pytest.raises(OptionError, match="read-only"):
        as_output(given, data.shape)


def test_bfloat16_is_read_as_float32() -> None:
    tensor = torch().tensor([[1.0, 2.5], [-3.140625, 2.0**100]], dtype=torch().bfloat16)
    read = as_array(tensor)
    assert read.dtype == np.float32
    assert read.tolist() == [[1.0, 2.5], [-3.140625, 2.0**100]]


def test_other_tensor_layouts() -> None:
    data = samples()
    tensor = torch().from_numpy(data)
    assert_array_equal(as_array(tensor.permute(2, 0, 1)), data.transpose(2, 0, 1))
    assert_array_equal(as_array(torch()._neg_view(tensor)), -data)
    with pytest.raises(DataError, match=r"data must be a regular array of numbers; got .*[Ss]parse"):
        as_array(tensor.to_sparse())


REFUSED: dict[str, tuple[Callable[[], Any], str]] = {
    "CuPy": (OnDevice, r"cupy\._core\.core\.OnDevice on a device: copy it to the host first, array\.get\(\)"),
    "DLPack": (lambda: Exchanged(np.ones((2, 2)), (2, 0)), r"Exchanged on a device: copy it to the host first"),
    "torch": (lambda: torch().ones(2, 2, device="meta"), r"torch\.Tensor on a device: copy it to the host first, tensor\.cpu\(\)"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_device_arrays_are_rejected_with_a_workaround(kind: str) -> None:
    make, message = REFUSED[kind]
    with pytest.raises(DataError, match="data must lie in the host's memory; got a .*" + message):
        clvol.Volume(make())
    with pytest.raises(DataError, match=message):
        clvol.prefilter(make())
    with pytest.raises(DataError, match=message):
        clvol.images.resample(make(), (3, 3))
    with pytest.raises(OptionError, match="points must lie in the host's memory; got a .*" + message):
        clvol.sample(np.ones((3, 3)), make())
    with pytest.raises(OptionError, match="index must lie in the host's memory; got a .*" + message):
        clvol.Volume(np.ones((3, 3))).index_to_world(make())


def test_masked_points_are_rejected() -> None:
    with pytest.raises(OptionError, match=r"points must be .* no masked element"):
        clvol.sample(np.ones((3, 3)), np.ma.array([[1.0, 2.0]], mask=[[True, False]]))


# -- memory to write into --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["interface", "converted", "dlpack", "torch", "xarray"])
@pytest.mark.parametrize("dtype", ["f4", "f8"])
def test_output_may_be_any_memory(kind: str, dtype: str) -> None:
    memory = np.zeros((3, 4), dtype)
    if kind == "dlpack" and not np.from_dlpack(Exchanged(memory)).flags.writeable:
        pytest.skip("this NumPy reads them only")
    as_output(READERS[kind](memory), (3, 4))[...] = 7
    assert (memory == 7).all()


def test_unwritable_output() -> None:
    fixed = np.zeros((3, 4))
    fixed.flags.writeable = False
    for out, rule in (
        (np.zeros((4, 3)), r"shape \(3, 4\); got \(4, 3\)"),
        (np.zeros((3, 4), np.int32), "float32 or float64; got int32"),
        (np.zeros((3, 4), np.complex128), "float32 or float64; got complex128"),
        (np.zeros((3, 4), np.float16), "float32 or float64; got float16"),
        (fixed, "read-only"),
        ([[0.0] * 4] * 3, "of which NumPy makes a copy"),
        (OnDevice(), "host's memory"),
        (np.ma.array(fixed, mask=True), "no masked element"),
    ):
        with pytest.raises(OptionError, match=f"out must .*{rule}"):
            as_output(out, (3, 4))


def test_unwritable_tensors() -> None:
    with pytest.raises(OptionError, match="must not require a gradient"):
        as_output(torch().zeros(3, requires_grad=True), (3,))
    with pytest.raises(OptionError, match="of which NumPy makes a copy"):
        as_output(torch().zeros(3, dtype=torch().bfloat16), (3,))
