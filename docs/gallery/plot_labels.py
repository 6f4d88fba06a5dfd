"""Regions of a label map
======================

Labels are names, with nothing in between: each is rendered in its own colour, and never blended with another.
A single one is rendered as the smooth surface of its indicator.
"""

import numpy as np

import clvol

box = clvol.phantoms.box(48)
z, y, x = np.indices(box.shape) > 24
labels = box.placed(np.where(box.data > 0.5, 1 + x + 2 * z, 0).astype(np.uint8), box)  # four regions
print("labels:", labels.is_labels)
camera = clvol.Camera.orbit(30, 20, fit="volume", zoom=1.8)
one = clvol.render(labels.indicator(2), camera, "isosurface", isovalue=0.5, rays=4)
picture = np.hstack([clvol.render(labels, camera, rays=4), one])

# %%
# The regions as one file, without a server, which browsers draw by WebGL2: drag to turn them.
page = clvol.save_html(labels, "labels.html", camera)
