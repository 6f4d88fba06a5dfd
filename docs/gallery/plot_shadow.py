"""
Shadow and occlusion
====================

``shadow=`` and ``occlusion=``, 0 to 1: what matter takes from the lights, and from the light all around. It has no noise, and stays
where it is while the camera moves.
"""

import clvol

volume = clvol.phantoms.sphere(64)
picture = clvol.render(volume, clvol.Camera.orbit(35, 30), "isosurface", shadow=0.8, occlusion=0.8, background="#20242c", rays=4)
