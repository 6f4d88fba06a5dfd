"""
A head cut open
===============

A corner or a half is cut away, and the faces of the cut show the slice: the values there in the colours of the transfer
function, unlit, so that noise is no relief. A surface is closed by a cap of the values. The camera stays where it is.
"""

import numpy as np

import clvol

z, y, x = np.mgrid[-90:90:100j, -100:100:110j, -82:82:90j]  # mm
radius = np.sqrt((x / 72) ** 2 + (y / 88) ** 2 + (z / 80) ** 2)
nose = np.hypot(x / 11, (z + 14) / 18) + np.abs((y + 80) / 14) ** 3
folds = 0.03 * np.sin(x / 4) * np.sin(y / 5 + 1) + 0.03 * np.sin(z / 4 + x / 9)
hu = np.full(z.shape, -1000.0)
for where, value in (
    ((radius < 1) | (nose < 1), 30),  # skin and muscle
    (radius < 0.93, 900),  # skull
    (radius < 0.86, 8),  # fluid
    (radius < 0.81 + folds, 46),  # cortex
    (radius < 0.72 + folds, 30),  # white matter
    ((np.hypot((abs(x) - 14 - y**2 / 300) / 7, (z - 8) / 10) + (y / 36) ** 2 < 1), 6),  # ventricles
    (((x - 34) / 13) ** 2 + ((y + 8) / 15) ** 2 + ((z - 26) / 13) ** 2 < 1, 66),  # a bleeding
):
    hu[where] = value
hu += np.random.default_rng(1).normal(0, 12, hu.shape)
head = clvol.Volume(hu, (164 / 89, 200 / 109, 180 / 99), (-82, -100, -90), units="mm", space="LPS").gaussian(1.8)

skin = "#c98d6f"
gray = clvol.TransferFunction([(-999, skin), (-60, skin), (0, "black"), (75, "white")], [(-700, 0), (-300, 0.6)])
camera = clvol.Camera.orbit(38, 30)
octant = clvol.Corner(low=(2, -999, 8), high=(999, 2, 999))
half = clvol.Plane(normal=(0.5, -1, 0.3), point=(0, -14, 0))
pictures = [
    clvol.render(head, camera, transfer=gray, clip=octant, size=(360, 360), rays=4),
    clvol.render(
        head, camera, "isosurface", isovalue=-300, color=skin, cap=True, transfer=gray, clip=half, size=(360, 360), rays=4
    ),
]
picture = np.hstack(pictures)

# %%
# The half as one file, without a server, which browsers draw by WebGL2: drag to turn it.
page = clvol.save_html(head, "cut_open.html", camera, "isosurface", isovalue=-300, color=skin, cap=True, transfer=gray, clip=half)
