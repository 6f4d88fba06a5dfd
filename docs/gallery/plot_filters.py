"""
What a filter does
==================

The same 30³ samples by the filter of most programs and by the interpolating cubic B-spline, with the same camera and light.
"""

import numpy as np

import clvol

volume = clvol.phantoms.marschner_lobb(30)
camera = clvol.Camera.orbit(20, 60)
pictures = [
    clvol.render(clvol.Scene(clvol.Medium(volume, filter=name)), camera, "isosurface", isovalue=0.5, size=(320, 320), samples=4)
    for name in ("linear", "catmull-rom", "bspline3")
]
picture = np.hstack(pictures)
