"""
What a filter does
==================

The same 41³ samples through what most programs take (linear), two cubics without a prefilter, and the interpolating
cubic B-spline (below, right).
"""

import numpy as np

import clvol

volume = clvol.phantoms.marschner_lobb(41)
camera = clvol.Camera.orbit(20, 60)
pictures = [
    clvol.render(volume, camera, "isosurface", filter=name, isovalue=0.5, size=(320, 320), rays=4)
    for name in ("linear", "mitchell", "catmull-rom", "bspline3")
]
picture = np.vstack([np.hstack(pictures[:2]), np.hstack(pictures[2:])])

# %%
# The last one as one file, without a server, which browsers draw by WebGL2: drag to turn it.
page = clvol.save_html(volume, "filters.html", camera, "isosurface", filter="bspline3", isovalue=0.5)
