"""Errors against the level of noise, on two phantoms whose values and normals are known, by all filters of the paper and by
smoothing splines; what part of the noise's variance each filter lets through; responses from interpolation to approximation.

    python examples/noise.py --output noise.png
"""

from __future__ import annotations

from _script import make, options_for


def main() -> None:
    options = options_for(__doc__, "noise.png")
    options.add_argument("--samples", type=int, default=41, help="of the phantoms along each axis")
    options.add_argument("--points", type=int, default=20_000, help="random positions at which values are compared")
    make("noise", options)


if __name__ == "__main__":
    main()
