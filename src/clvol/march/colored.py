"""What colours a medium by another function than its own (`Medium.color_by`): the host side of colored.cl.

The other function is evaluated at places of matter that is seen, and of surfaces; its numbers follow those of the medium's transfer
function in the kernels' table.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clvol.base.uniform import FLOAT, INT, Block
from clvol.filter.table import as_filter
from clvol.scene.transfer import TransferFunction

if TYPE_CHECKING:
    from clvol.base.uniform import Values
    from clvol.filter.filter import Filter
    from clvol.scene.scene import Medium
    from clvol.spline.field import Field
    from clvol.volume.stored import Stored

__all__ = ["COLORED", "Colors", "Other", "colors_of"]

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


class Colors(NamedTuple):
    """The block for kernels, and what follows the numbers of the medium's own transfer function."""

    values: Values
    numbers: NDArray[np.float32]


class Other(NamedTuple):
    """A function that colours another: its values as stored, and it and where its samples are missing in the kernels' layout."""

    stored: Stored
    function: _Layout
    missing: _Layout | None

    @classmethod
    def of(cls, field: Field) -> Other:
        """That of a field, which need not stay open."""
        made, device = field.coefficients, field.device
        with device.buffers.mapped(made.buffer, made.shape, write=False) as held:
            function = _laid_out(made.filter, np.array(held, np.float32), int(made.extent[3]))
        if field.gaps is None:
            return cls(made.stored, function, None)
        absent = np.pad(field.gaps.volume.data.astype(np.float32), 1, mode="edge")
        return cls(made.stored, function, _laid_out(as_filter("nearest" if made.filter.support == 1 else "linear"), absent, 1))


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


def colors_of(medium: Medium, other: Other, table: int) -> Colors:
    """The colours of a medium by another function; its own transfer function has so many numbers in the table."""
    by = medium.color_by
    assert by is not None
    assert by.transfer is not None  # settled
    shown, pad = by.transfer.table(other.stored), -table % 4
    layouts = [other.function, *([] if other.missing is None else [other.missing])]
    blocks, begin = [], table + pad + shown.size
    for layout in layouts:
        blocks.append(FUNCTION(**layout.block | {"polynomials": begin, "coefficients": begin + layout.block["coefficients"]}))
        begin += layout.numbers.size
    grid = by.volume
    start = grid.world_to_index_matrix @ (np.asarray(medium.volume.origin) - np.asarray(grid.origin))
    low, high = by.domain
    values = COLORED(
        transfer=by.transfer.block(1.0, other.stored),
        table=(table + pad) // 4,
        to=[*(grid.world_to_index_matrix @ medium.volume.index_to_world_matrix).ravel(), *start],
        low=low,
        high=high,
        some_missing=other.missing is not None,
        function=blocks[0],
        missing=blocks[-1],
    )
    return Colors(values, np.concatenate([np.zeros(pad, np.float32), shown, *(layout.numbers for layout in layouts)]))
