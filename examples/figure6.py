"""Figure 6 of the paper: the Marschner-Lobb function sampled 40³ and reconstructed by six filters.

The sinc is exact: the samples are magnified by the FFT and rendered through a spline, and the panel states how far that is from
exact. The function itself is rendered beside them, without samples. Each panel gives the root mean square error of its values
and the mean angle between its normals and the true ones.

    python examples/figure6.py --output figure6.png
"""

from __future__ import annotations

import argparse
import time

import clvol
from clvol.figures import figure6


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--output", default="figure6.png", help="the picture to write")
    arguments.add_argument("--samples", type=int, default=40, help="of the function along each axis")
    arguments.add_argument("--pixels", type=int, default=512, help="width and height of a panel")
    options = arguments.parse_args()

    started = time.perf_counter()
    try:
        panels, sheet = figure6(options.samples, options.pixels)
        output = clvol.save(sheet, options.output)
    except clvol.ClvolError as error:
        raise SystemExit(f"{type(error).__name__}: {error}") from None
    for panel in panels[:-1]:
        print(panel.label.replace("\n", ": "))
    print(f"{output} in {time.perf_counter() - started:.1f} s")


if __name__ == "__main__":
    main()
