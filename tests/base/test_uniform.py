"""Parameter blocks: one declaration, two layouts that agree."""

from __future__ import annotations

import re

import numpy as np
import pytest

from clvol.base.uniform import FLOAT, INT, Block
from clvol.device import Device
from clvol.march.frame import frame_block
from clvol.scene.mode import modes

INNER = Block("inner_block", a=FLOAT, b=(INT, 3))
OUTER = Block("outer_block", first=(FLOAT, 2), inner=INNER, last=INT)

READER = """
#include "outer.cl"
kernel void read_block(constant outer_block *block, global float *numbers)
{
    numbers[0] = block->first[0]; numbers[1] = block->first[1];
    numbers[2] = block->inner.a; numbers[3] = block->inner.b[2];
    numbers[4] = block->last; numbers[5] = sizeof(outer_block);
}
"""


def test_a_block_has_the_layout_of_its_struct(device: Device) -> None:
    values = OUTER(first=(1.5, 2.5), inner=INNER(a=3.5, b=(4, 5, 6)), last=7)
    kernel = device.build("read.cl", {}, None, {"read.cl": READER, "outer.cl": OUTER.declaration()}).kernel("read_block")
    numbers = np.empty(6, np.float32)
    with device.buffers.lent(numbers, write=True) as buffer:
        kernel(device.queue, (1,), None, device.buffers.upload(values[None]), buffer)
    np.testing.assert_array_equal(numbers, [1.5, 2.5, 3.5, 6, 7, OUTER.dtype.itemsize])


def test_every_field_needs_a_value_and_no_other() -> None:
    for wrong in ({}, {"a": 1}, {"a": 1, "b": 0, "c": 2}):
        with pytest.raises(TypeError, match="inner_block has the fields a, b; got"):
            INNER(**wrong)
    np.testing.assert_array_equal(INNER(a=1, b=2)["b"], [2, 2, 2])


def test_a_block_without_fields_can_be_declared() -> None:
    empty = Block("empty_block")
    assert "unused" in empty.declaration()
    assert empty().dtype == empty.dtype
    with pytest.raises(TypeError):
        empty(a=1)


@pytest.mark.parametrize("mode", modes())
def test_the_block_of_a_picture_has_the_layout_of_numpy(mode: str) -> None:
    block, declaration = frame_block(modes()[mode].BLOCK)
    sizes = {"float": 4, "int": 4}
    for members, name in re.findall(r"typedef struct \{\n(.*?)\} (\w+);", declaration, re.DOTALL):
        assert name not in sizes
        declared = re.findall(r"^    (\w+) \w+(?:\[(\d+)\])?;$", members, re.MULTILINE)
        sizes[name] = sum(sizes[kind] * int(count or 1) for kind, count in declared)
    assert list(sizes)[-1] == "frame_t"
    assert sizes["frame_t"] == block.dtype.itemsize
