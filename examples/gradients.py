"""Gradient errors: renders by six filters, below each the angle of its normals to the true ones in colour.

Surfaces are lit by gradients, so this is what is seen of an error.

    python examples/gradients.py --output gradients.png
"""

from __future__ import annotations

import argparse

import clvol
from clvol.figures import draw


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--output", default="gradients.png", help="the figure to write: .png, .svg, .pdf")
    arguments.add_argument("--samples", type=int, default=41, help="of the function along each axis")
    arguments.add_argument("--pixels", type=int, default=320, help="width and height of a picture")
    options = arguments.parse_args()

    try:
        drawing = draw("gradients", samples=options.samples, pixels=options.pixels)
        output = drawing.save(options.output)
    except clvol.ClvolError as error:
        raise SystemExit(f"{type(error).__name__}: {error}") from None
    print(*drawing.lines, sep="\n")
    print(output)


if __name__ == "__main__":
    main()
