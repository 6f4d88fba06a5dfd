"""
A surface in the colours of another volume
==========================================

A folded surface, coloured by a map with a grid of its own: only what is significant covers it, as on a cortex. Both are exact at
each hit, the surface and the map.
"""

import numpy as np

import clvol

# %%
# The map is coarse, and ends inside of the picture; it covers the surface where it is beyond 3.5.
z, y, x = np.mgrid[-1:1:96j, -1:1:96j, -1:1:96j]
folds = 0.06 * np.sin(14 * x + 3 * np.sin(5 * y)) * np.cos(11 * y + 4 * np.sin(4 * z))
cortex = clvol.Volume(1 - np.sqrt(x**2 + (y / 0.85) ** 2 + (z / 0.8) ** 2) + folds)
w, v, u = np.mgrid[-1:1:32j, -1:1:32j, -1:1:32j]
warm = 8 * np.exp(-12 * ((u - 0.5) ** 2 + (v + 0.4) ** 2 + (w - 0.3) ** 2))
cold = 7 * np.exp(-9 * ((u + 0.2) ** 2 + (v + 0.7) ** 2 + w**2))
t = clvol.Volume(warm - cold, spacing=(95 / 31,) * 3, name="t")

# %%
# Its look is that of any medium; the bar shows its colours.
painted = clvol.Medium(cortex, color_by=clvol.Medium(t, preset="stat-map"))
camera = clvol.Camera.orbit(azimuth=0, elevation=20)
picture = clvol.render(painted, camera, mode="isosurface", isovalue=0.25, color="bisque", color_bar=True, size=(640, 520))
