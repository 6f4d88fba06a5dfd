"""Figure 2 of the paper: frequency responses of direct B-spline interpolation, eq. (17), and of the hybrid, eq. (18).

Beside them those of trilinear interpolation and of Mitchell's filter, against which the hybrid is to be judged.

    python examples/figure2.py --output figure2.png
"""

from __future__ import annotations

import argparse

import clvol
from clvol.figures import draw


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--output", default="figure2.png", help="the figure to write: .png, .svg, .pdf")
    options = arguments.parse_args()

    try:
        drawing = draw("2")
        output = drawing.save(options.output)
    except clvol.ClvolError as error:
        raise SystemExit(f"{type(error).__name__}: {error}") from None
    print(*drawing.lines, sep="\n")
    print(output)


if __name__ == "__main__":
    main()
