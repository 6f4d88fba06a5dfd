"""Figure 5 of the paper: a photograph and a zone plate of few samples, magnified four times by six filters.

The zone plate shows aliasing, the photograph sharpness and ringing.

    python examples/figure5.py --output figure5.png
"""

from __future__ import annotations

from _script import make, options_for


def main() -> None:
    options = options_for(__doc__, "figure5.png")
    options.add_argument("--samples", type=int, default=49, help="of the images along each axis")
    make("5", options)


if __name__ == "__main__":
    main()
