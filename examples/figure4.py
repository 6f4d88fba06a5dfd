"""Figure 4 of the paper: mean square errors of the six reconstructions, in 2-D and in 3-D, on several inputs.

Functions are compared with their known values; the photograph, the box and a scan are reconstructed from every second sample.

    python examples/figure4.py --output figure4.png [--scan SCAN]
"""

from __future__ import annotations

from _script import make, options_for


def main() -> None:
    options = options_for(__doc__, "figure4.png")
    options.add_argument("--samples", type=int, default=41, help="of the function along each axis")
    options.add_argument("--scan", help="a volume file: one more input")
    make("4", options)


if __name__ == "__main__":
    main()
