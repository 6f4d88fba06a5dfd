"""Figure 1 of the paper: where reconstruction happens in volume rendering, for one real ray.

A ray passes among the samples; values are reconstructed wherever it needs them, classified, shaded and accumulated to a pixel.

    python examples/figure1.py --output figure1.png
"""

from __future__ import annotations

from _script import make, options_for


def main() -> None:
    options = options_for(__doc__, "figure1.png")
    options.add_argument("--samples", type=int, default=21, help="of the function along each axis")
    options.add_argument("--pixels", type=int, default=400, help="width of the picture")
    make("1", options)


if __name__ == "__main__":
    main()
