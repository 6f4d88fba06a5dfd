"""
An image, magnified
===================

Grey and colour images by the same filters: a zone plate, four times as large, linear and cubic.
"""

import numpy as np

from clvol import images

at = np.linspace(-1, 1, 96)
plate = 0.5 + 0.5 * np.cos(60 * (at**2 + at[:, None] ** 2))
picture = np.hstack([images.zoom(plate, 4, name) for name in ("linear", "bspline3")])
