"""Levelling the horizon of a photograph: rotation by some degrees, three colours together.

    python examples/scipy_photograph.py --with scipy
    python examples/scipy_photograph.py --with clvol

The photograph is synthetic: mountains over a lake in the evening, 8 bits, with film grain.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from _scipy import Array, options_for, save, timed

TILT = 4.0  # degrees


def photograph(height: int, width: int) -> Array:
    """Mountains over a lake, with a tilted camera; uint8, shape (height, width, 3)."""
    generator = np.random.default_rng(7)
    j, i = np.mgrid[:height, :width]
    tilt = np.radians(TILT)
    u, v = (i - width / 2) / height, (j - height / 2) / height
    u, v = np.cos(tilt) * u + np.sin(tilt) * v, np.cos(tilt) * v - np.sin(tilt) * u
    lake = v > 0.14
    ripples = 0.004 * np.sin(900 * (v - 0.14) / (0.25 + np.abs(v))) * lake
    w = np.where(lake, 0.28 - v, v) + ripples  # what the lake mirrors

    def mixed(low: Array, high: tuple[float, float, float], share: Array) -> Array:
        return np.asarray(low + share[..., None] * (np.asarray(high) - low))

    sky = mixed(np.full((height, width, 3), (0.16, 0.27, 0.52)), (0.99, 0.71, 0.42), np.clip((w + 0.5) / 0.62, 0, 1) ** 1.4)
    distance = np.hypot(u - 0.28, w + 0.05)
    picture = mixed(sky, (1.0, 0.96, 0.82), np.exp(-((distance / 0.09) ** 2)) * 0.6 + (distance < 0.035) * 0.4)
    for number, (base, rise, color) in enumerate(((0.02, 0.16, (0.44, 0.42, 0.53)), (0.07, 0.11, (0.24, 0.26, 0.36)))):
        ridge = np.full(u.shape, base)
        for octave in range(8):
            phase = generator.uniform(0, 6.3, 2)
            wave = np.abs(np.sin(2.3 * 1.9**octave * u + phase[0])) + np.sin(1.3 * 2.1**octave * u + phase[1])
            ridge = ridge - rise * 0.5**octave * 0.5 * wave
        below = np.clip((w - ridge) * height / 1.5, 0, 1)
        snow = np.clip(1 - (w - ridge) / 0.045 + 0.8 * np.sin(90 * u + 40 * w), 0, 1) * (number == 0) * 0.7
        slope = mixed(np.broadcast_to(np.asarray(color), picture.shape), (0.93, 0.85, 0.86), snow)
        picture = picture + below[..., None] * (slope - picture)
    trees = 0.115 + 0.02 * np.sin(7 * u) - 0.022 * np.abs(np.sin(140 * u + 3 * np.sin(11 * u))) ** 3
    picture = picture + np.clip((w - trees) * height / 1.5, 0, 1)[..., None] * (np.array([0.07, 0.10, 0.11]) - picture)
    picture = np.where(lake[..., None], picture * (0.78, 0.83, 0.90), picture)
    grain = generator.normal(0, 0.012, (height, width, 1))
    return np.asarray(np.round(255 * np.clip(picture + grain, 0, 1)), np.uint8)


def straightened(image: Array, ndimage: Any) -> dict[str, Array]:
    """The image rotated back."""
    return {"photograph": ndimage.rotate(image, TILT, axes=(0, 1), reshape=False, order=3, mode="mirror")}


def main() -> None:
    parser = options_for(__doc__, "photograph.png")
    parser.add_argument("--height", type=int, default=800, help="pixels; the width is half as much again")
    options = parser.parse_args()
    image = photograph(options.height, options.height * 3 // 2)
    print(f"{image.shape}, {image.dtype}, turned by {TILT:g}°")
    results = timed(options.module, partial(straightened, image))
    save([image / 255, results["photograph"] / 255], options.output)


if __name__ == "__main__":
    main()
