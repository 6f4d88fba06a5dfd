"""
Streamlines
===========

Lines along a flow in which vortices meet, from 60 seeds: a Dormand-Prince method follows the spline through the samples. The tubes
are a surface of the distance to the lines, coloured by the speed.
"""

import numpy as np
from scipy.spatial import cKDTree

import clvol

n = 32
z, y, x = np.meshgrid(*[2 * np.pi * np.arange(n) / n] * 3, indexing="ij")
parts = [np.sin(z) + 0.6 * np.cos(y), 0.8 * np.sin(x) + np.cos(z), 0.6 * np.sin(y) + 0.8 * np.cos(x)]
spacing = (2 * np.pi / n,) * 3
flow = clvol.VectorField([clvol.Volume(part, spacing) for part in parts], "bspline5", "wrap")
seeds = np.random.default_rng(2).uniform(0.3, 5.8, (60, 3))
lines = flow.streamlines(seeds, length=2.5)

grid = np.stack(np.meshgrid(*[np.linspace(0, 6.1, 72)] * 3, indexing="ij")[::-1], -1)
away = cKDTree(np.concatenate(list(lines))).query(grid.reshape(-1, 3), distance_upper_bound=0.4)[0].reshape(grid.shape[:-1])
step = (6.1 / 71,) * 3
tubes = clvol.Volume(np.minimum(away, 0.4).astype(np.float32), step)
speed = clvol.Volume(np.linalg.norm(flow(grid.reshape(-1, 3)), axis=-1).reshape(away.shape).astype(np.float32), step, name="speed")

low, high = speed.value_range
painted = clvol.Medium(tubes, color_by=clvol.Medium(speed, clvol.TransferFunction.from_cmap("plasma", (low, high), 1.0)))
camera = clvol.Camera.orbit(35, 20)
picture = clvol.render(painted, camera, mode="isosurface", isovalue=0.09, color_bar=True, size=(640, 520))
