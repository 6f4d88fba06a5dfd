"""Interpolation between slices: errors against their distance, and a plane across slices that are 3 pixels apart.

For a scan, slices are omitted and reconstructed from the others.

    python examples/slices.py --output slices.png [--scan SCAN]
"""

from __future__ import annotations

from _script import make, options_for


def main() -> None:
    options = options_for(__doc__, "slices.png")
    options.add_argument("--samples", type=int, default=61, help="of the function along each axis of a slice")
    options.add_argument("--scan", help="a volume file: leave out slices of it, too")
    make("slices", options)


if __name__ == "__main__":
    main()
