"""
Radiograph
==========

A digitally reconstructed radiograph of a computed head: the line integrals of the attenuation, ``mu_water (1 + HU / 1000)``,
along the rays of an x-ray source. They are -log of the share of the rays that gets through.
"""

import numpy as np

import clvol

z, y, x = np.meshgrid(*[np.linspace(-1, 1, 96)] * 3, indexing="ij")
head = (x / 0.62) ** 2 + (y / 0.8) ** 2 + (z / 0.9) ** 2
sinus = np.minimum((abs(x) - 0.16) ** 2, 1) / 0.1**2 + ((y + 0.55) / 0.1) ** 2 + ((z + 0.1) / 0.16) ** 2
hounsfield = np.select([head > 1, sinus < 1, head > 0.85], [-1000, -1000, 900], 40)
hounsfield[(abs(y - 0.55) < 0.1) & (abs(x) < 0.1) & (z < 0)] = 700  # a spine
volume = clvol.Volume(hounsfield.astype(np.float32), spacing=(2, 2, 2), units="mm").gaussian(2)

picture = clvol.render(volume, clvol.Camera.orbit(25, 5, zoom=1.5), "integral", mu_water=0.0193, color_bar=True)
