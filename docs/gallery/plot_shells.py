"""
Three shells, one in another
============================

Bands of opacity show surfaces of three values at once. They are narrower than what values change by between two samples of a ray at
the default step, which clvol says, with the step that shows them whole: on the left and on the right the same bands.
"""

import warnings

import numpy as np

import clvol

z, y, x = np.mgrid[-1:1:80j, -1:1:80j, -1:1:80j]
centers = [(-0.42, 0.0, -0.2), (0.42, 0.1, -0.15), (0.0, -0.1, 0.45)]
field = sum(np.exp(-4.5 * ((x - cx) ** 2 + (y - cy) ** 2 + (z - cz) ** 2)) for cx, cy, cz in centers)
potential = clvol.Volume(field.astype(np.float32), spacing=(2 / 79,) * 3, origin=(-1, -1, -1))

shells = ((0.25, "#4c78a8", 0.10), (0.55, "#f2b134", 0.20), (0.85, "#d1495b", 0.95))
width = 0.006
opacities, colors = [], []
for value, color, opacity in shells:
    opacities += [(value - width, 0), (value, opacity), (value + width, 0)]
    colors += [(value - width, color), (value + width, color)]
transfer = clvol.TransferFunction(colors, opacities, unit_distance=potential.mean_spacing / 8)

camera = clvol.Camera.orbit(25, 25)
with warnings.catch_warnings():
    warnings.simplefilter("ignore", clvol.ClvolWarning)  # it says that the bands are stippled
    stippled = clvol.render(potential, camera, size=(360, 360), transfer=transfer, background="white")
whole = clvol.render(potential, camera, size=(360, 360), transfer=transfer, background="white", step=0.05)
picture = np.hstack([stippled, whole])
