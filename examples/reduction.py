"""Fewer samples: a zone plate decimated, after a Gaussian and by least squares, and errors of all three against the factor.

python examples/reduction.py --output reduction.png
"""

from __future__ import annotations

from _script import make, options_for


def main() -> None:
    options = options_for(__doc__, "reduction.png")
    options.add_argument("--samples", type=int, default=64, help="of the volumes along each axis")
    make("reduction", options)


if __name__ == "__main__":
    main()
