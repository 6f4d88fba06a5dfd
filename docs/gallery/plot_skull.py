"""
A brain in a skull
==================

Two scans of one head on grids of their own: a skull from CT, cut open alone (``Medium(clip=...)``), and the brain from MR, which
stays whole. Each medium has its transfer function, and says in words or in full what it shows.
"""

import numpy as np

import clvol

z, y, x = np.mgrid[-95:90:110j, -100:100:120j, -82:82:100j]  # mm
radius = np.sqrt((x / 74) ** 2 + (y / 90) ** 2 + ((z + 4) / 82) ** 2)
jaw = np.sqrt((x / 48) ** 2 + ((y + 44) / 46) ** 2 + ((z + 62) / 34) ** 2)
eyes = np.sqrt(((abs(x) - 31) / 17) ** 2 + ((y + 90) / 15) ** 2 + ((z + 18) / 15) ** 2)
nose = np.sqrt((x / 12) ** 2 + ((y + 92) / 16) ** 2 + ((z + 42) / 16) ** 2)


def inside(distance, width=0.04):
    """1 where a distance is below 1, 0 above, with an edge as smooth as a scanner's."""
    return np.clip((1 - distance) / width + 0.5, 0, 1)


bone = np.maximum(inside(radius), inside(jaw)) * (1 - np.maximum(inside(radius / 0.9), inside(jaw / 0.78)))
bone *= (1 - inside(eyes, 0.2)) * (1 - inside(nose, 0.2))
hu = -1000 + 1900 * bone + 1020 * np.maximum(inside(radius / 0.9), inside(jaw / 0.78))
hu += np.random.default_rng(1).normal(0, 20, hu.shape)
skull = clvol.Volume(hu, (164 / 99, 200 / 119, 185 / 109), (-82, -100, -95), units="mm", space="LPS").gaussian(1.2)

c, b, a = np.mgrid[-72:78:2.0, -80:82:2.0, -66:68:2.0]
inner = np.sqrt((a / 62) ** 2 + (b / 77) ** 2 + (c / 69) ** 2)
folds = 0.035 * np.sin(a / 3 + 1.5 * np.sin(c / 9)) * np.sin(b / 4 + np.sin(a / 8)) + 0.03 * np.sin(c / 3.5 + b / 9)
cleft = 0.12 * np.exp(-((a / 2.5) ** 2)) * (c > 5)
signal = np.where(inner < 0.97 + folds - cleft, 620.0, 40.0)
signal[inner < 0.86 + folds] = 760
brain = clvol.Volume(
    signal + np.random.default_rng(2).normal(0, 12, c.shape), (2, 2, 2), (-66, -80, -72), units="mm", space="LPS"
).gaussian(1.4)

skull_cap = clvol.Medium(skull, preset="ct-bone", clip=clvol.Corner((-999, -20, 2), (999, 999, 999)))
cortex = clvol.TransferFunction([(300, "#b5736a"), (620, "#e2a79b"), (780, "#f6d9cf")], [(260, 0), (420, 0.9)])
scene = clvol.Scene([skull_cap, clvol.Medium(brain, cortex)])
picture = np.hstack([clvol.render(scene, clvol.Camera.orbit(azimuth, 22), size=(360, 360), rays=4) for azimuth in (-35, 130)])
