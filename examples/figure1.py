"""Figure 1 of the paper: where reconstruction happens in volume rendering, as one real ray sees it.

A ray runs among the samples; values are reconstructed wherever it asks, classified and lit, and gathered to a pixel.

    python examples/figure1.py --output figure1.png
"""

from __future__ import annotations

import argparse

import clvol
from clvol.figures import draw


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--output", default="figure1.png", help="the figure to write: .png, .svg, .pdf")
    arguments.add_argument("--samples", type=int, default=21, help="of the function along each axis")
    arguments.add_argument("--pixels", type=int, default=240, help="width of the picture")
    options = arguments.parse_args()

    try:
        drawing = draw("1", samples=options.samples, pixels=options.pixels)
        output = drawing.save(options.output)
    except clvol.ClvolError as error:
        raise SystemExit(f"{type(error).__name__}: {error}") from None
    print(*drawing.lines, sep="\n")
    print(output)


if __name__ == "__main__":
    main()
