"""Motion correction of a 4-D series: each image is aligned with the first by a cubic, rigid transformation, in threads.

    python examples/scipy_series.py --with scipy
    python examples/scipy_series.py --with clvol

The series is a phantom of a head that nods and turns, sampled at its position at each time, with noise.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np
from _scipy import Array, head, options_for, save, timed

SIZE = 19.0  # centimetres, of the field of view
Move = tuple[Array, Array]


def motion(frames: int, shape: tuple[int, ...]) -> list[Move]:
    """For each image the matrix and the offset from indices of the first image to its own."""
    generator = np.random.default_rng(3)
    angles = np.cumsum(generator.normal(0, 0.012, (frames, 3)), 0)
    shifts = np.cumsum(generator.normal(0, 0.3, (frames, 3)), 0)
    angles[0] = shifts[0] = 0
    middle = (np.asarray(shape) - 1) / 2
    moves = []
    for (a, b, c), shift in zip(angles, shifts, strict=True):
        about_z = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
        about_y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
        about_x = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
        matrix = about_z @ about_y @ about_x
        moves.append((matrix, middle - matrix @ middle + shift))
    return moves


def series_of(moves: list[Move], shape: tuple[int, ...]) -> Array:
    """The phantom in each position, shape (time, z, y, x)."""
    generator = np.random.default_rng(4)
    index = np.indices(shape).reshape(3, -1)
    centre = (np.asarray(shape)[:, None] - 1) / 2
    images = []
    for matrix, offset in moves:
        at = (np.linalg.solve(matrix, index - offset[:, None]) - centre) * (SIZE / max(shape))
        images.append((head(*at).reshape(shape) + generator.normal(0, 0.01, shape)).astype(np.float32))
    return np.stack(images)


def corrected(series: Array, moves: list[Move], ndimage: Any) -> dict[str, Array]:
    """Every image aligned with the first."""
    result = np.empty_like(series)

    def back(number: int) -> None:
        ndimage.affine_transform(series[number], *moves[number], output=result[number], order=3, mode="nearest")

    with ThreadPoolExecutor() as pool:
        list(pool.map(back, range(len(series))))
    return {"series": result}


def main() -> None:
    parser = options_for(__doc__, "series.png")
    parser.add_argument("--pixels", type=int, default=80, help="of a slice, in each direction")
    parser.add_argument("--frames", type=int, default=12, help="images of the series")
    options = parser.parse_args()
    shape = (options.pixels, options.pixels, options.pixels)
    moves = motion(options.frames, shape)
    series = series_of(moves, shape)
    print(f"{options.frames} images of {' × '.join(map(str, shape))}")
    result = timed(options.module, partial(corrected, series, moves))["series"]
    inner = (slice(None), *(slice(n // 8, n - n // 8) for n in shape))
    before, after = series.std(0), result.std(0)
    print(f"standard deviation over time: {before[inner[1:]].mean():.4f} before, {after[inner[1:]].mean():.4f} after; noise 0.0100")
    middle = shape[0] // 2
    save([panel[::-1] for panel in (series[0][middle], 5 * before[middle], 5 * after[middle])], options.output, 4)


if __name__ == "__main__":
    main()
