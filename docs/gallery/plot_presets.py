"""
Presets
=======

A preset is a look for one kind of data, by name. Those of computed tomography are in Hounsfield units: here a limb of
fat, muscle, two bones and two vessels.
"""

import numpy as np

import clvol

z, y, x = np.mgrid[-40:40:48j, -40:40:64j, -40:40:64j]  # mm
tissues = [(0, 0, 34, -100), (0, 0, 30, 50), (-9, 5, 7, 800), (10, 5, 6, 800), (0, -12, 3, 350), (18, -10, 2.5, 350)]
hu = np.full(z.shape, -1000.0)
for center_x, center_y, radius, value in tissues:
    waist = radius * (1 - 0.15 * np.cos(z / 25))
    hu[np.hypot(x - center_x, y - center_y) < waist] = value
limb = clvol.Volume(hu, (80 / 63, 80 / 63, 80 / 47), (-40, -40, -40), units="mm", space="LPS").gaussian(1.8)

names = "ct-skin", "ct-soft-tissue", "ct-bone", "ct-angiography"
pictures = [clvol.render(limb, preset=name, size=(320, 320), rays=4) for name in names]
picture = np.vstack([np.hstack(pictures[:2]), np.hstack(pictures[2:])])

# %%
# The bones as one file, without a server, which browsers draw by WebGL2: drag to turn it.
page = clvol.save_html(limb, "presets.html", preset="ct-bone")
