"""Error against time a sample, all filters on one plot: which filter should I use?

Nothing is both faster and better than what lies on the line.

    python examples/cost.py --output cost.png
"""

from __future__ import annotations

import argparse

import clvol
from clvol.figures import draw


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--output", default="cost.png", help="the figure to write: .png, .svg, .pdf")
    arguments.add_argument("--samples", type=int, default=41, help="of the function along each axis")
    arguments.add_argument("--points", type=int, default=20000, help="random positions that are compared")
    options = arguments.parse_args()

    try:
        drawing = draw("cost", samples=options.samples, points=options.points)
        output = drawing.save(options.output)
    except clvol.ClvolError as error:
        raise SystemExit(f"{type(error).__name__}: {error}") from None
    print(*drawing.lines, sep="\n")
    print(output)


if __name__ == "__main__":
    main()
