"""
A surface
=========

The surface where the function takes one value, here that of Marschner and Lobb, from 41³ samples.
"""

import clvol

volume = clvol.phantoms.marschner_lobb(41)
camera = clvol.Camera.orbit(20, 50)
picture = clvol.render(volume, camera, "isosurface", isovalue=0.5, rays=4)

# %%
# The same scene as one file, without a server, which browsers draw by WebGL2: drag to turn it.
page = clvol.save_html(volume, "surface.html", camera=camera, mode="isosurface", isovalue=0.5)
