"""
Depth, normals, positions
=========================

A picture is one output of several: the normals (x, y, z as red, green, blue), the distance from the eye, and where in
the world each ray met the surface. All are arrays of numbers; ``shown`` gives them colours.
"""

import numpy as np

import clvol

volume = clvol.phantoms.box(48)
outputs = clvol.render(
    volume, mode="isosurface", isovalue=0.5, outputs=["rgba", "normal", "depth", "position"], size=(320, 320), background=None
)
pictures = [output.shown() for output in outputs.values()]
picture = np.vstack([np.hstack(pictures[:2]), np.hstack(pictures[2:])])

# %%
# The surface as one file, without a server, which browsers draw by WebGL2: drag to turn it.
page = clvol.save_html(volume, "depth.html", mode="isosurface", isovalue=0.5)
