"""
Six modes
=========

One volume in every mode. A mode's options are its fields, and `clvol.render` takes them by name.
"""

import numpy as np

import clvol

volume = clvol.phantoms.marschner_lobb(41)
pictures = [clvol.render(volume, mode=mode, size=(256, 256)) for mode in clvol.modes()]
picture = np.vstack([np.hstack(pictures[:3]), np.hstack(pictures[3:])])
print(*clvol.modes(), sep=", ")
