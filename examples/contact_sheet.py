"""Every volume of a folder, and every phantom, with clvol's defaults; beside it PyVista, if installed.

    python examples/contact_sheet.py [FOLDER] --output sheet.png

One row per volume: composite, isosurface and maximum. Below each picture is the fraction of lit pixels and their mean
luminance, 0 to 255. PyVista's pictures are `add_volume` and `add_mesh(contour())` with its own defaults.
"""

from __future__ import annotations

import argparse
import contextlib
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import clvol
from clvol.show.picture import grid, labelled, to_bytes

Pixels = NDArray[np.uint8]

MODES = ("composite", "isosurface", "mip")
PEERS = ("volume", "contour")
LIT = 8  # of 255: the visible difference from the background
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # Rec. 709


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("folder", nargs="?", type=Path, help="volume files, and folders of DICOM")
    arguments.add_argument("--output", default="sheet.png", help="the picture to write")
    arguments.add_argument("--pixels", type=int, default=256, help="width and height of a picture")
    arguments.add_argument("--no-peers", action="store_true", help="without PyVista")
    options = arguments.parse_args()
    if options.folder is not None and not options.folder.is_dir():
        arguments.error(f"there is no folder {options.folder}")

    try:
        rows = [
            [labelled(picture, f"{name}\n{column}, {said(picture)}") for column, picture in pictures(volume, options)]
            for name, volume in volumes(options.folder)
        ]
        width = max(map(len, rows))
        print(clvol.save(grid([tile for row in rows for tile in row], width), options.output))
    except clvol.ClvolError as error:
        raise SystemExit(f"{type(error).__name__}: {error}") from None


def volumes(folder: Path | None) -> Iterator[tuple[str, clvol.Volume]]:
    """The volumes of all readable files, and the phantoms, by name."""
    for path in sorted(folder.iterdir()) if folder is not None else []:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", clvol.ClvolWarning)  # which of several volumes is shown
            try:
                volume = clvol.read(path)
            except clvol.ClvolError as error:
                print(f"left out {path.name}: {error}")
                continue
        if volume.ndim != 3:
            print(f"left out {path.name}: an image, shape {volume.shape}")
            continue
        yield path.name, volume
    for name in clvol.phantoms.names():
        yield name, clvol.phantoms.by_name(name)


def pictures(volume: clvol.Volume, options: argparse.Namespace) -> Iterator[tuple[str, Pixels]]:
    """A volume in each mode, and by PyVista if it is installed."""
    size = (options.pixels, options.pixels)
    for mode in MODES:
        yield mode, to_bytes(clvol.render(volume, mode=mode, size=size)[..., :3])
    if options.no_peers:
        return
    with contextlib.suppress(ImportError):
        import pyvista

        yield from ((f"PyVista {kind}", peer(pyvista, volume, kind, size)) for kind in PEERS)


def peer(pyvista: Any, volume: clvol.Volume, kind: str, size: tuple[int, int]) -> Pixels:
    """PyVista's picture of the same samples; its defaults, without the colour bar."""
    image = pyvista.ImageData(dimensions=volume.size, spacing=volume.spacing)
    native = volume.data.dtype.newbyteorder("=")
    image["values"] = np.ascontiguousarray(volume.data, native).ravel()
    plotter = pyvista.Plotter(off_screen=True, window_size=size)
    if kind == "volume":
        plotter.add_volume(image, show_scalar_bar=False)
    else:
        surfaces = image.contour()
        if surfaces.n_points:
            plotter.add_mesh(surfaces, show_scalar_bar=False)
    picture = np.asarray(plotter.screenshot(None, return_img=True), np.uint8)
    plotter.close()
    return picture


def said(picture: Pixels) -> str:
    """The fraction of a picture that differs from its corner, and its brightness."""
    luminance = picture.astype(np.float64) @ LUMINANCE
    lit = np.abs(picture.astype(np.float64) - picture[0, 0]).max(-1) > LIT
    return f"{100 * lit.mean():.0f} % lit, luminance {luminance[lit].mean() if lit.any() else 0:.0f}"


if __name__ == "__main__":
    main()
