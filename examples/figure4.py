"""Figure 4 of the paper: mean square errors of the six reconstructions, in 2-D and in 3-D, on several inputs.

Functions are compared where they are known; the photograph, the box and a scan of yours are given by every second sample.

    python examples/figure4.py --output figure4.png [--scan SCAN]
"""

from __future__ import annotations

import argparse

import clvol
from clvol.figures import draw


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--output", default="figure4.png", help="the figure to write: .png, .svg, .pdf")
    arguments.add_argument("--samples", type=int, default=41, help="of the function along each axis")
    arguments.add_argument("--scan", help="a volume file: one more input")
    options = arguments.parse_args()

    try:
        drawing = draw("4", samples=options.samples, scan=clvol.read(options.scan) if options.scan else None)
        output = drawing.save(options.output)
    except clvol.ClvolError as error:
        raise SystemExit(f"{type(error).__name__}: {error}") from None
    print(*drawing.lines, sep="\n")
    print(output)


if __name__ == "__main__":
    main()
