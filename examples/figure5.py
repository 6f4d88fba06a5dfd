"""Figure 5 of the paper: a photograph and a zone plate of few samples, four times as fine by six filters.

The zone plate shows aliasing, the photograph sharpness and ringing.

    python examples/figure5.py --output figure5.png
"""

from __future__ import annotations

import argparse

import clvol
from clvol.figures import draw


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--output", default="figure5.png", help="the figure to write: .png, .svg, .pdf")
    arguments.add_argument("--samples", type=int, default=65, help="of the images along each axis")
    options = arguments.parse_args()

    try:
        drawing = draw("5", samples=options.samples)
        output = drawing.save(options.output)
    except clvol.ClvolError as error:
        raise SystemExit(f"{type(error).__name__}: {error}") from None
    print(*drawing.lines, sep="\n")
    print(output)


if __name__ == "__main__":
    main()
