"""Error against sampling rate: on doubly logarithmic axes a line, whose slope is the filter's order.

Gradients converge with one order less.

    python examples/convergence.py --output convergence.png
"""

from __future__ import annotations

import argparse

import clvol
from clvol.figures import draw


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--output", default="convergence.png", help="the figure to write: .png, .svg, .pdf")
    arguments.add_argument("--points", type=int, default=20000, help="random positions that are compared")
    options = arguments.parse_args()

    try:
        drawing = draw("convergence", points=options.points)
        output = drawing.save(options.output)
    except clvol.ClvolError as error:
        raise SystemExit(f"{type(error).__name__}: {error}") from None
    print(*drawing.lines, sep="\n")
    print(output)


if __name__ == "__main__":
    main()
