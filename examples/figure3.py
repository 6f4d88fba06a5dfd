"""Figure 3 of the paper: an object by direct B-spline interpolation and by the hybrid, their difference, their frame times.

Trilinear interpolation is drawn beside them.

    python examples/figure3.py --output figure3.png [--scan SCAN]
"""

from __future__ import annotations

from _script import make, options_for


def main() -> None:
    options = options_for(__doc__, "figure3.png")
    options.add_argument("--samples", type=int, default=41, help="of the function along each axis")
    options.add_argument("--pixels", type=int, default=300, help="width of the picture")
    options.add_argument("--scan", help="a volume file: draw it in place of the function")
    make("3", options)


if __name__ == "__main__":
    main()
