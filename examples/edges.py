"""Clouds and caves: a cube with hard edges, sampled directly, after an ideal low-pass, and after a Gaussian one.

The artefacts around it are the paper's clouds, those in its faces the paper's caves (section 3).

    python examples/edges.py --output edges.png
"""

from __future__ import annotations

from _script import make, options_for


def main() -> None:
    options = options_for(__doc__, "edges.png")
    options.add_argument("--samples", type=int, default=40, help="along each axis of the box, twice as wide as the cube")
    options.add_argument("--pixels", type=int, default=300, help="width of each picture")
    make("edges", options)


if __name__ == "__main__":
    main()
