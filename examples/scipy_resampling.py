"""Resampling a scan and its labels to another spacing, as before training nnU-Net: cubic for values, linear for each label.

    python examples/scipy_resampling.py --with scipy
    python examples/scipy_resampling.py --with clvol

The scan is a phantom of a head with noise, in thick slices.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from _scipy import Array, head, options_for, save, timed

SIZE = 19.0  # centimetres, of the field of view


def scan(pixels: int) -> tuple[Array, Array]:
    """Samples and labels (0 outside, 1 cortex, 2 white matter), both of shape (z, y, x)."""
    shape = (7 * pixels // 16, pixels, pixels)  # thick slices
    z, y, x = np.meshgrid(*(np.linspace(-SIZE / 2, SIZE / 2, n) for n in shape), indexing="ij")
    truth = head(z, y, x)
    inside = (z / 6.2) ** 2 + (y / 7.6) ** 2 + (x / 6.0) ** 2 < 1
    labels = np.where(inside, np.where(truth > 0.7, 2, 1), 0)
    noisy = truth + np.random.default_rng(0).normal(0, 0.03, shape)
    return noisy.astype(np.float32), labels.astype(np.uint8)


def resampled(values: Array, labels: Array, factors: Array, ndimage: Any) -> dict[str, Array]:
    """Values and labels on the new grid."""
    cubic = ndimage.zoom(values, factors, order=3, mode="nearest", grid_mode=True)
    chosen = np.zeros(cubic.shape, np.uint8)
    for label in (1, 2):
        share = ndimage.zoom((labels == label).astype(np.float32), factors, order=1, mode="nearest", grid_mode=True)
        chosen[share > 0.5] = label
    return {"values": cubic, "labels": chosen}


def main() -> None:
    parser = options_for(__doc__, "resampling.png")
    parser.add_argument("--pixels", type=int, default=128, help="of a slice, in each direction")
    options = parser.parse_args()
    values, labels = scan(options.pixels)
    shape = np.full(3, 9 * options.pixels // 8)
    millimetres = [" × ".join(f"{10 * SIZE / n:.1f}" for n in size) for size in (values.shape, shape)]
    print(f"{' × '.join(map(str, values.shape))} samples of {millimetres[0]} mm to {millimetres[1]} mm")
    results = timed(options.module, partial(resampled, values, labels, shape / values.shape))
    old = [np.arange(m) * n // m for n, m in zip(values.shape, shape.tolist(), strict=True)]  # the original voxels
    middle = shape[2] // 2
    panels = [values[np.ix_(*old)][..., middle], results["values"][..., middle], results["labels"][..., middle] / 2]
    save([panel[::-1] for panel in panels], options.output, 3)


if __name__ == "__main__":
    main()
