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
_KEPT = 4  # tables, each of a medium


class Behind:
    """Numbers that follow others in a table, on the device once a picture needs them."""

    def __init__(self, numbers: Sequence[NDArray[np.float32]]) -> None:
        self.numbers = tuple(numbers)
        self._uploaded: dict[tuple[bytes, tuple[Behind, ...]], Any] = {}

    @property
    def size(self) -> int:
        """How many numbers, in whole rows."""
        count = sum(int(one.size) for one in self.numbers)
        return count + -count % ROW

    def table(self, first: NDArray[np.float32], between: tuple[Behind, ...], device: Device) -> Any:
        """A buffer of a table, what else follows it, and these; the last few are kept: a moving camera changes no table."""
        key = first.tobytes(), between
        if key not in self._uploaded:
            parts = [(first,), *(one.numbers for one in (*between, self))]
            rows = [
                array.ravel() for part in parts for array in (*part, np.zeros(-sum(one.size for one in part) % ROW, np.float32))
            ]
            if len(self._uploaded) >= _KEPT:
                self._uploaded.pop(next(iter(self._uploaded)))
            self._uploaded[key] = device.buffers.upload(np.concatenate(rows))
        return self._uploaded[key]

    def __getstate__(self) -> dict[str, Any]:
        return vars(self) | {"_uploaded": {}}
