"""
Three shells, one in another
============================

Surfaces of three values at once, each with a colour and an opacity. A ray meets every one of them where the function has the value,
in order, however thin the shell; on the right a corner is cut away, and what that opens is closed by a face with the values.
"""

import numpy as np

import clvol

z, y, x = np.mgrid[-1:1:80j, -1:1:80j, -1:1:80j]
centers = [(-0.42, 0.0, -0.2), (0.42, 0.1, -0.15), (0.0, -0.1, 0.45)]
field = sum(np.exp(-4.5 * ((x - cx) ** 2 + (y - cy) ** 2 + (z - cz) ** 2)) for cx, cy, cz in centers)
potential = clvol.Volume(field.astype(np.float32), spacing=(2 / 79,) * 3, origin=(-1, -1, -1))

shells = [(0.25, "#4c78a8", 0.25), (0.55, "#f2b134", 0.35), (0.85, "#d1495b", 1)]
camera = clvol.Camera.orbit(25, 25)
look = {"mode": "surfaces", "surfaces": shells, "size": (360, 360), "background": "white"}
whole = clvol.render(potential, camera, **look)
corner = clvol.Corner((0, -np.inf, 0), (np.inf, 0, np.inf))
cut = clvol.render(potential, camera, clip=corner, cap=True, cmap="viridis", **look)
picture = np.hstack([whole, cut])

# %%
# The shells as one file, without a server, which browsers draw by WebGL2: drag to turn them.
page = clvol.save_html(potential, "shells.html", camera, mode="surfaces", surfaces=shells, background="white")
