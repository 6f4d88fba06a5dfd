"""
A film of a series
==================

Several volumes play in time: all pictures have one isovalue, or one transfer function, and one place of the camera, chosen from all
volumes. Here two drops meet; six of the film's pictures are shown.
"""

import tempfile
from pathlib import Path

import imageio.v3 as iio
import numpy as np

import clvol

z, y, x = np.meshgrid(*[np.linspace(-1, 1, 40)] * 3, indexing="ij")
apart = [(0.62 * (1 - s) * np.cos(2 * s), 0.62 * (1 - s) * np.sin(2 * s)) for s in np.linspace(0, 1, 24)]
drops = [sum(np.exp(-((x - side * a) ** 2 + y**2 + (z - side * b) ** 2) / 0.09) for side in (-1, 1)) for a, b in apart]

folder = Path(tempfile.mkdtemp()) / "frames"  # or "drops.mp4", "drops.webp", ...
camera = clvol.Camera.orbit(20, 15)
film = clvol.movie(np.stack(drops), folder, mode="isosurface", isovalue=0.5, color="#4fa3d8", camera=camera, size=(240, 180))
pictures = [iio.imread(folder / f"{i:04d}.png") for i in range(0, film.frames, 4)]
picture = np.vstack([np.hstack(pictures[:3]), np.hstack(pictures[3:])])
