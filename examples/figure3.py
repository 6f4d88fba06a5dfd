"""Figure 3 of the paper: an object by direct B-spline interpolation and by the hybrid, their difference, their frame times.

Trilinear interpolation alone stands beside them.

    python examples/figure3.py --output figure3.png [--scan SCAN]
"""

from __future__ import annotations

import argparse

import clvol
from clvol.figures import draw


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--output", default="figure3.png", help="the figure to write: .png, .svg, .pdf")
    arguments.add_argument("--samples", type=int, default=41, help="of the function along each axis")
    arguments.add_argument("--pixels", type=int, default=400, help="width of the picture")
    arguments.add_argument("--scan", help="a volume file: draw it in place of the function")
    options = arguments.parse_args()

    try:
        drawing = draw("3", samples=options.samples, pixels=options.pixels, scan=clvol.read(options.scan) if options.scan else None)
        output = drawing.save(options.output)
    except clvol.ClvolError as error:
        raise SystemExit(f"{type(error).__name__}: {error}") from None
    print(*drawing.lines, sep="\n")
    print(output)


if __name__ == "__main__":
    main()
