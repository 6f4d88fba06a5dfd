"""Numbers that follow a transfer function's in the kernels' table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from clvol.device import Device

__all__ = ["ROW", "Behind"]

ROW = 4
"""Numbers in a row of a table: each of `Behind` begins with a row."""


class Behind:
    """Numbers that follow others in a table, on the device once a picture needs them."""

    def __init__(self, numbers: Sequence[NDArray[np.float32]]) -> None:
        self.numbers = tuple(numbers)
        self._uploaded: tuple[bytes, tuple[Behind, ...], Any] = b"", (), None

    @property
    def size(self) -> int:
        """How many numbers, in whole rows."""
        count = sum(int(one.size) for one in self.numbers)
        return count + -count % ROW

    def table(self, first: NDArray[np.float32], between: tuple[Behind, ...], device: Device) -> Any:
        """A buffer of a table, what else follows it, and these; the last is kept, since a camera that moves changes no table."""
        key = first.tobytes()
        if self._uploaded[:2] != (key, between):
            parts = [(first,), *(one.numbers for one in (*between, self))]
            rows = [
                array.ravel() for part in parts for array in (*part, np.zeros(-sum(one.size for one in part) % ROW, np.float32))
            ]
            self._uploaded = key, between, device.buffers.upload(np.concatenate(rows))
        return self._uploaded[2]

    def __getstate__(self) -> dict[str, Any]:
        return vars(self) | {"_uploaded": (b"", (), None)}
