"""
Cut open
========

A box of world coordinates cuts the volume; the faces of the cut show what lies inside, at their exact place. Colours
that jump show bands of the value, and without shading they are seen as they are.
"""

import numpy as np

import clvol

volume = clvol.phantoms.sphere(48)
edges = np.linspace(0.1, 0.9, 9)
shades = ("#2f4b7c", "#f1e4c8", "#a05195", "#f1e4c8", "#d45087", "#f1e4c8", "#f95d6a", "#f1e4c8", "#ffa600")
colors = [point for edge, shade in zip(edges, shades, strict=True) for point in ((edge, shade), (edge + 0.1, shade))]
transfer = clvol.TransferFunction(colors, ((0.25, 0), (0.25, 1)))
camera = clvol.Camera.orbit(35, 25)
half = (-1, 0, -1), (1, 1, 1)
picture = clvol.render(volume, camera, transfer=transfer, clip=half, shading=False, rays=4)

# %%
# The same scene as one file, without a server, which browsers draw by WebGL2: drag to turn it.
page = clvol.save_html(volume, "clip.html", camera=camera, transfer=transfer, clip=half, shading=False)
