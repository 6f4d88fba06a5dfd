"""
A surface
=========

The surface where the function takes one value, here that of Marschner and Lobb, from 41³ samples.
"""

import clvol

volume = clvol.phantoms.marschner_lobb(41)
picture = clvol.render(volume, clvol.Camera.orbit(20, 50), "isosurface", isovalue=0.5, rays=4)
