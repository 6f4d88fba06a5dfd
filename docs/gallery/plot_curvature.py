"""
The curvature of a surface
==========================

How a surface bends, from the second derivatives of the spline itself and not from the triangles of a mesh: on the left its mean
curvature, on the right the Gaussian one, which is negative on saddles.
"""

import numpy as np

import clvol

z, y, x = np.mgrid[-1.3:1.3:72j, -1.3:1.3:72j, -1.3:1.3:72j]
genus = (x**2 * (1 - x**2) - y**2) ** 2 + 0.5 * z**2  # less than a constant in a double torus
double_torus = clvol.Volume((-genus).astype(np.float32), (2.6 / 71,) * 3, (-1.3, -1.3, -1.3))

camera = clvol.Camera.orbit(20, 60)
look = {"mode": "isosurface", "isovalue": -0.03, "size": (400, 300), "background": "white"}
mean = clvol.render(double_torus, camera, color_by="mean curvature", window=(0, 16), **look)
gauss = clvol.render(double_torus, camera, color_by="gaussian curvature", window=(0, 60), cmap="PiYG", **look)
picture = np.hstack([mean, gauss])
