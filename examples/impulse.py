"""Impulse responses: what each filter makes of one sample among zeros, over the sinc.

The prefilter and the hybrid's magnification are part of it.

    python examples/impulse.py --output impulse.png
"""

from __future__ import annotations

import argparse

import clvol
from clvol.figures import draw


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--output", default="impulse.png", help="the figure to write: .png, .svg, .pdf")
    options = arguments.parse_args()

    try:
        drawing = draw("impulse")
        output = drawing.save(options.output)
    except clvol.ClvolError as error:
        raise SystemExit(f"{type(error).__name__}: {error}") from None
    print(*drawing.lines, sep="\n")
    print(output)


if __name__ == "__main__":
    main()
