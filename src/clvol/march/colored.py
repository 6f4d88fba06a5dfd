"""What colours a medium by another function than its own (`Medium.color_by`): the host side of colored.cl.

The other function is evaluated at places of matter that is seen, and of surfaces; its numbers follow those of the medium's transfer
function in the kernels' table.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import OutOfMemoryError
from clvol.base.uniform import FLOAT, INT, Block
from clvol.filter.table import as_filter
from clvol.march.behind import ROW, Behind
from clvol.scene.transfer import TransferFunction

if TYPE_CHECKING:
    from clvol.base.uniform import Values
    from clvol.filter.filter import Filter
    from clvol.scene.scene import Medium
    from clvol.spline.field import Field
    from clvol.volume.stored import Stored

__all__ = ["COLORED", "Other", "colors_of"]

_MOST = 1 << 31  # numbers that kernels count

FUNCTION = Block(
    "function_block", taps=INT, degree=INT, polynomials=INT, coefficients=INT, halo=INT, stored=(INT, 3), scale=FLOAT, left=FLOAT
)
COLORED = Block(
    "colored_block",
    transfer=TransferFunction.BLOCK,
    table=INT,
    to=(FLOAT, 12),
    low=(FLOAT, 3),
    high=(FLOAT, 3),
    some_missing=INT,
    function=FUNCTION,
    missing=FUNCTION,
)


class Other(Behind):
    """A function that colours another: its values as stored, and it and where its samples are missing in the kernels' layout."""

    def __init__(self, stored: Stored, layouts: tuple[_Layout, ...]) -> None:
        super().__init__([layout.numbers for layout in layouts])
        self.stored, self.layouts = stored, layouts

    @classmethod
    def of(cls, field: Field) -> Other:
        """That of a field, which need not stay open."""
        made, device = field.coefficients, field.device
        with device.buffers.mapped(made.buffer, made.shape, write=False) as held:
            function = _laid_out(made.filter, np.array(held, np.float32), int(made.extent[3]))
        if field.gaps is None:
            return cls(made.stored, (function,))
        absent = np.pad(field.gaps.volume.data.astype(np.float32), 1, mode="edge")
        between = as_filter("nearest" if made.filter.support == 1 else "linear")
        return cls(made.stored, (function, _laid_out(between, absent, 1)))


class _Layout(NamedTuple):
    """A function's block, in which places count from its polynomials, and its numbers."""

    block: dict[str, Any]
    numbers: NDArray[np.float32]


def _laid_out(row: Filter, coefficients: NDArray[np.float32], halo: int) -> _Layout:
    block = {
        "taps": row.support,
        "degree": row.degree,
        "coefficients": row.matrix.size,
        "halo": halo,
        "stored": coefficients.shape[::-1],
        "scale": row.scale,
        "left": row.support / 2 - 1,
    }
    return _Layout(block, np.concatenate([row.matrix.astype(np.float32).ravel(), coefficients.ravel()]))


def colors_of(medium: Medium, other: Other, table: NDArray[np.float32], *, linear: bool) -> tuple[Values, NDArray[np.float32]]:
    """The block of a medium's colours by another function; and the table of its own transfer function, followed by the other's.

    `linear`: of colours in linear light. `OutOfMemoryError` if kernels cannot count so many numbers.
    """
    by = medium.color_by
    assert by is not None
    assert by.transfer is not None  # settled
    pad, own = -table.size % ROW, by.transfer.table(other.stored, linear=linear)
    both = np.concatenate([table, np.zeros(pad, np.float32), own, np.zeros(-own.size % ROW, np.float32)])
    blocks, begin = [], both.size
    for layout in other.layouts:
        blocks.append(FUNCTION(**layout.block | {"polynomials": begin, "coefficients": begin + layout.block["coefficients"]}))
        begin += layout.numbers.size
        if begin >= _MOST:
            raise OutOfMemoryError(f"out of memory: color_by takes fewer than {_MOST} samples; got {by.volume.data.size}")
    grid = by.volume
    start = grid.world_to_index_matrix @ (np.asarray(medium.volume.origin) - np.asarray(grid.origin))
    low, high = by.domain
    values = COLORED(
        transfer=by.transfer.block(1.0, other.stored, linear=linear),
        table=(table.size + pad) // ROW,
        to=[*(grid.world_to_index_matrix @ medium.volume.index_to_world_matrix).ravel(), *start],
        low=low,
        high=high,
        some_missing=len(blocks) > 1,
        function=blocks[0],
        missing=blocks[-1],
    )
    return values, both
