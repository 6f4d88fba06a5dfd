"""Figure 2 of the paper: frequency responses of direct B-spline interpolation, eq. (17), and of the hybrid, eq. (18).

Trilinear interpolation and Mitchell's filter are drawn for comparison.

    python examples/figure2.py --output figure2.png
"""

from __future__ import annotations

from _script import make, options_for


def main() -> None:
    options = options_for(__doc__, "figure2.png")
    make("2", options)


if __name__ == "__main__":
    main()
