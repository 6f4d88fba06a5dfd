"""Samples that a mask excludes are as good as NaN wherever a volume is shown, and a view shows what can be read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import clvol
from clvol.base.errors import ClvolWarning, DataError, OptionError
from clvol.device import Device
from clvol.view import View

Z, Y, X = np.mgrid[-1:1:14j, -1:1:14j, -1:1:14j]
WHOLE = (200 * np.exp(-2 * (X**2 + Y**2 + Z**2))).astype(np.uint8)
MASK = (X > 0.3) & (Z > -0.2)
CUT = np.where(MASK, np.nan, WHOLE.astype(np.float32))
SIZE: dict[str, Any] = {"size": (40, 40)}


def bytes_of_batch(volume: Any, folder: Path, **options: Any) -> bytes:
    (done,) = clvol.batch(volume, clvol.Camera.orbit(fit="volume"), folder / "picture.png", **SIZE, **options)
    assert done.error is None
    return done.path.read_bytes()


def bytes_of_movie(volume: Any, folder: Path, **options: Any) -> bytes:
    return clvol.movie(volume, folder / "movie.zip", frames=2, **SIZE, **options).path.read_bytes()


SHOWN: dict[str, Any] = {
    "slice": lambda volume, _, **options: clvol.slice(volume, "y", **SIZE, **options),
    "section": lambda volume, _, **options: clvol.view.section(
        volume, (6, 6, 6), (1, 0, 0), (0, 0, 1), (0.4, 0.4), (40, 40), **options
    ),
    "slab": lambda volume, _, **options: clvol.slice(volume, "y", thickness=3, mode="mip", **SIZE, **options),
    "orthogonal": lambda volume, _, **options: clvol.orthogonal(volume, **SIZE, **options),
    "batch": bytes_of_batch,
    "movie": bytes_of_movie,
    "view": lambda volume, _, **options: View(volume, mode="mip", **options).picture((40, 40)),
    "mesh": lambda volume, _, **options: clvol.mesh(volume, 90.0, **({"nan": "local"} | options)).vertices,
}


@pytest.mark.parametrize("what", SHOWN)
def test_a_mask_is_as_good_as_nan(what: str, device: Device, tmp_path: Path) -> None:  # noqa: ARG001
    (tmp_path / "masked").mkdir()
    want = SHOWN[what](CUT, tmp_path)
    assert_array_equal(np.asarray(SHOWN[what](WHOLE, tmp_path / "masked", mask=MASK)), np.asarray(want))
    if what not in ("mesh", "batch"):  # which refuse it, or give it to each picture
        with pytest.raises(DataError, match="mask"):
            SHOWN[what](WHOLE, tmp_path / "masked", mask=MASK[1:])


class Parts:
    """An array that is read by parts, of which one is damaged if that is said."""

    def __init__(self, data: Any, damaged: bool = False) -> None:
        self._data, self._damaged = data, damaged
        self.shape, self.dtype, self.chunks = data.shape, data.dtype, (7, 7, 7)

    def __getitem__(self, place: Any) -> Any:
        if self._damaged and place[0].stop > 7 and place[2].stop > 7:
            raise clvol.base.errors.ChunkError("cannot read chunk 1/1/1 of a.zarr: it is damaged")
        return self._data[place]


def test_a_view_shows_what_can_be_read(device: Device) -> None:  # noqa: ARG001
    want = View(CUT, mode="mip").picture((24, 24))
    assert_array_equal(View(clvol.LazyVolume(Parts(CUT)), mode="mip").picture((24, 24)), want)
    assert_array_equal(View(clvol.LazyVolume(Parts(WHOLE)), mode="mip", mask=MASK).picture((24, 24)), want)
    with pytest.warns(ClvolWarning, match="cannot read chunk 1/1/1 of a.zarr"):
        lacking = View(clvol.LazyVolume(Parts(WHOLE, damaged=True)), mode="mip")
    assert np.isnan(lacking.volume.data[8, 8, 8])
    assert lacking.picture((24, 24))[..., :3].max() > 0.5


def test_a_mask_is_of_one_volume() -> None:
    with pytest.raises(OptionError, match="mask takes one volume"):
        View(clvol.Volumes([clvol.Volume(WHOLE)] * 2), mask=MASK)
