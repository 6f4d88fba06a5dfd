"""Volumes beyond 4 GiB and 2³⁰ samples are correct in their last corner: no index overflows."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import clvol
from clvol.base import memory
from clvol.device import Device

GIB = 1 << 30
LARGE = (1090, 1070, 1080)  # of bytes, and 4.7 GiB of coefficients
CORNER = 40  # samples along each axis: a prefilter forgets what lies further in
INNER = 12  # of these, what is compared
SHEAR = np.array([[1, 1e-3, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])

pytestmark = [pytest.mark.thorough, pytest.mark.skipif(sys.maxsize < 1 << 33, reason="needs 64-bit addresses")]


def need(gib: float) -> None:
    if memory.available() < gib * GIB:
        pytest.skip(f"needs {gib} GiB of memory; {memory.available() / GIB:.1f} are available")


def room(device: Device, gib: float) -> None:
    """In one buffer; PoCL checks free memory at its start."""
    if device.largest < gib * GIB:
        pytest.skip(f"needs a buffer of {gib} GiB; the device allows {device.largest / GIB:.1f}")


def corner() -> NDArray[np.uint8]:
    """Smooth: rays that graze noise may miss it by rounding."""
    z, y, x = np.indices((CORNER,) * 3)
    return np.rint(127 + 100 * np.sin(z / 3) * np.cos(y / 4) * np.sin(x / 5)).astype(np.uint8)


def test_a_large_volume_matches_its_corner_alone(device: Device) -> None:
    need(9)
    room(device, 4.8)
    data = np.zeros(LARGE, np.uint8)  # sparse, except the corner
    data[-CORNER:, -CORNER:, -CORNER:] = corner()
    small = clvol.Volume(corner(), origin=tuple(float(n - CORNER) for n in LARGE[::-1]))
    low = np.array([n - INNER for n in LARGE[::-1]], np.float64)
    high = np.array([n - 1.0 for n in LARGE[::-1]])
    points = low + np.random.default_rng(1).random((500, 3)) * (high - low)
    grid = clvol.Volume(np.broadcast_to(np.float32(0), (30, 30, 30)), (0.37,) * 3, tuple(low))
    camera = clvol.Camera(position=tuple(high + 40), target=tuple((low + high) / 2), up=(0, 0, 1))
    seen = {"mode": "isosurface", "isovalue": 128, "size": (48, 48), "rays": 1, "clip": (tuple(low), tuple(high))}
    answers = []
    for volume in (clvol.Volume(data), small):
        with clvol.Renderer(volume, "bspline3", device=device) as renderer:
            field = renderer.field
            if volume is not small:
                assert field.nbytes > 4 * GIB
            answers.append(
                (
                    field(points),
                    field.gradient(points),
                    field.hessian(points),
                    field.resample(like=grid).data,
                    field.resample(like=grid, transform=SHEAR).data,
                    np.asarray(renderer.render(camera, **seen)),  # type: ignore[call-overload]  # of these words
                )
            )
    *numbers, (drawn, expected) = zip(*answers, strict=True)
    for large, alone in numbers:
        np.testing.assert_allclose(large, alone, atol=1e-3 * np.abs(alone).max())  # float32 positions are coarser far out
    assert expected.std() > 0.05  # not empty
    assert (np.abs(drawn - expected) > 0.01).mean() < 0.005  # rays on the edges of surfaces


def test_a_result_beyond_4_gib_is_correct_at_its_end(device: Device) -> None:
    need(6)
    room(device, 4.4)
    volume = clvol.Volume(np.random.default_rng(0).random((6, 7, 8), dtype=np.float32))
    shape = (8, 12_000, 12_000)
    with clvol.Field(volume, device=device) as field:
        made = field.resample(shape)
        ends = [np.arange(n - 5, n) for n in shape]
        axes = [(at + 0.5) * (m / n) - 0.5 for at, m, n in zip(ends, volume.shape, shape, strict=True)]
        points = np.stack(np.meshgrid(*axes, indexing="ij")[::-1], -1)
        np.testing.assert_allclose(made.data[-5:, -5:, -5:], field(points), atol=2e-6)


def test_files_beyond_4_gib_keep_their_last_sample(tmp_path: Path) -> None:
    """Sparse files: zeros take no disk space."""
    need(6)
    shape, itemsize = (1030, 2048, 2048), 1  # 4.02 GiB
    raw = tmp_path / "large.raw"
    with raw.open("wb") as stream:
        stream.seek(shape[0] * shape[1] * shape[2] * itemsize - 1)
        stream.write(b"\x07")
    read = clvol.read(raw, shape=shape, dtype="uint8")
    assert read.shape == shape
    assert (read.data[-1, -1, -1], read.data[-1, -1, -2]) == (7, 0)
    del read
    npy = tmp_path / "large.npy"
    mapped = np.lib.format.open_memmap(npy, "w+", np.uint8, shape)
    mapped[-1, -1, -1] = 9
    mapped.flush()
    del mapped
    assert clvol.read(npy).data[-1, -1, -1] == 9
