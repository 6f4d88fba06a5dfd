"""
Cut open
========

A box of world coordinates cuts the volume; its cut faces show what lies inside, at their exact place.
"""

import clvol

volume = clvol.phantoms.marschner_lobb(41)
transfer = clvol.TransferFunction.from_cmap("magma", volume.value_range, 0.8)
picture = clvol.render(volume, clvol.Camera.orbit(30, 30), transfer=transfer, clip=((-1, 0, -1), (1, 1, 1)), samples=4)
