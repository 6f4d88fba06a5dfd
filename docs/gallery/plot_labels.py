"""
Regions of a label map
======================

Labels are names, between which there is nothing: a region is drawn as the surface of its indicator.
"""

import numpy as np

import clvol

box = clvol.phantoms.box(48)
labels = np.where(box.data > 0.5, 1 + (np.arange(48) > 24), 0).astype(np.uint8)  # two halves
regions = box.placed(labels, box)
print("labels:", regions.is_labels)
pictures = [
    clvol.render(regions.indicator(label), mode="isosurface", isovalue=0.5, color=color, size=(320, 320), samples=4)
    for label, color in ((1, "#4c8bf5"), (2, "#f5a14c"))
]
picture = np.hstack(pictures)
