"""Gradient errors: renders by six filters; below each the angle of its normals to the true ones in colour.

Surfaces are shaded by gradients, so these errors are visible.

    python examples/gradients.py --output gradients.png
"""

from __future__ import annotations

from _script import make, options_for


def main() -> None:
    options = options_for(__doc__, "gradients.png")
    options.add_argument("--samples", type=int, default=41, help="of the function along each axis")
    options.add_argument("--pixels", type=int, default=240, help="width and height of a picture")
    make("gradients", options)


if __name__ == "__main__":
    main()
