"""The comparison of Figure 6 on a real scan: the same surface by six filters, and by the default.

    python examples/real_scan.py SCAN --output scan.png [--isovalue V] [--zoom Z]

SCAN is a file that `clvol.read` can read (NIfTI; NRRD and MetaImage need clvol[medical]).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import clvol
from clvol.figures import SIX, compare


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("scan", help="a volume file")
    arguments.add_argument("--output", default="scan.png", help="the picture to write; a second one ends in -default")
    arguments.add_argument("--isovalue", type=float, help="of the surface; default: parts the histogram in two")
    arguments.add_argument("--azimuth", type=float, default=30.0)
    arguments.add_argument("--elevation", type=float, default=20.0)
    arguments.add_argument("--zoom", type=float, default=1.2)
    arguments.add_argument("--pixels", type=int, default=384, help="width and height of a panel")
    options = arguments.parse_args()

    try:
        volume = clvol.read(options.scan)
        camera = clvol.Camera.orbit(options.azimuth, options.elevation, zoom=options.zoom)
        _, sheet = compare(volume, SIX, options.pixels, camera=camera, isovalue=options.isovalue, rays=2)
        output = clvol.save(sheet, options.output)
        picture = clvol.render(volume, camera)
        default = clvol.save(picture, Path(output).with_stem(f"{output.stem}-default"))
    except clvol.ClvolError as error:
        raise SystemExit(f"{type(error).__name__}: {error}") from None
    print(output)
    print(default)


if __name__ == "__main__":
    main()
