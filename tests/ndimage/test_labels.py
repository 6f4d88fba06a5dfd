from __future__ import annotations

from typing import Any

import dask.array as da
import numpy as np
import pytest
from scipy import ndimage as scipy_ndimage

import clvol
from clvol import ndimage

LABELS = np.random.default_rng(0).integers(0, 5, (14, 13, 12)).astype(np.int16)
POINTS = np.random.default_rng(1).uniform(-3, 15, (3, 500))
CALLS = {
    "zoom": lambda module, data, **options: module.zoom(data, 1.7, **options),
    "rotate": lambda module, data, **options: module.rotate(data, 30, (0, 2), **options),
    "map_coordinates": lambda module, data, **options: module.map_coordinates(data, POINTS, **options),
}


@pytest.mark.parametrize(("name", "mode"), [("zoom", "constant"), ("rotate", "grid-wrap"), ("map_coordinates", "reflect")])
def test_labels_are_those_of_one_hot_splines_also_by_blocks(name: str, mode: str) -> None:
    def of(module: Any, data: Any, **options: Any) -> Any:
        return CALLS[name](module, data, mode=mode, **options)

    one_hot = np.stack(
        [of(scipy_ndimage, (n == LABELS).astype(float), order=5, prefilter=False, cval=float(n == 3)) for n in range(5)]
    )
    ordered = np.sort(one_hot, axis=0)
    got = of(ndimage, LABELS, order="labels", cval=3)
    assert got.dtype == LABELS.dtype
    assert not ((got != one_hot.argmax(0)) & (ordered[-1] - ordered[-2] > 1e-5)).any()
    blocks = da.from_array(LABELS, chunks=(5, 6, 7))
    assert (of(ndimage, blocks, order="labels", cval=3).compute() == got).all()
    if name == "zoom":
        finer = clvol.resample(LABELS, (25, 17, 13), smooth=True, fill=9).data
        assert (clvol.resample(blocks, (25, 17, 13), smooth=True, fill=9).compute() == finer).all()


def test_lines_and_positions_that_are_nowhere() -> None:
    line = np.array([0, 0, 0, 7, 7, 7], np.uint8)
    assert ndimage.zoom(line, 2, order="labels").tolist() == [0] * 6 + [7] * 6
    assert ndimage.map_coordinates(line, [[1.0, np.nan, 4.0]], order="labels", cval=3).tolist() == [0, 3, 7]


@pytest.mark.parametrize(
    ("data", "options", "says"),
    [
        (LABELS + 0.5, {}, "whole numbers"),
        (LABELS.astype(complex), {}, "whole numbers"),
        (LABELS, {"cval": 0.5}, "whole number"),
        (LABELS, {"precision": "double"}, "for values"),
        (LABELS, {"anti_aliasing": True}, "for values"),
        (np.zeros((2, 3, 4, 5), np.uint8), {}, "three|3"),
        (clvol.LazyVolume(LABELS), {}, "order='labels'"),
    ],
)
def test_bad_input(data: Any, options: dict[str, Any], says: str) -> None:
    with pytest.raises((clvol.OptionError, clvol.DataError), match=says):
        ndimage.zoom(data, 2, order="labels", **options)
