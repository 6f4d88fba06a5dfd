"""A scan before and after smoothing: by linear interpolation, interpolated, and with lambda from the data.

The reasons for lambda are printed, and shown below the picture.

    python examples/smoothing.py scan.nhdr --output smoothing.png
"""

from __future__ import annotations

import argparse

import clvol
from clvol.figures import compare

FILTERS = ("linear", "bspline3", "bspline3(auto)")


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("input", help="a volume file")
    arguments.add_argument("--output", default="smoothing.png", help="the picture to write")
    arguments.add_argument("--isovalue", type=float, help="default: Otsu's threshold")
    arguments.add_argument("--azimuth", type=float, default=30.0)
    arguments.add_argument("--elevation", type=float, default=20.0)
    arguments.add_argument("--zoom", type=float, default=1.2)
    arguments.add_argument("--pixels", type=int, default=420, help="width and height of a panel")
    options = arguments.parse_args()

    try:
        camera = clvol.Camera.orbit(options.azimuth, options.elevation, zoom=options.zoom)
        look = {"camera": camera, "mode": "isosurface", "isovalue": options.isovalue, "rays": 4}
        panels, sheet = compare(clvol.read(options.input), FILTERS, options.pixels, **look)
        output = clvol.save(sheet, options.output)
    except clvol.ClvolError as error:
        raise SystemExit(f"{type(error).__name__}: {error}") from None
    print(*(panel.filter for panel in panels), sep="\n")
    print(output)


if __name__ == "__main__":
    main()
