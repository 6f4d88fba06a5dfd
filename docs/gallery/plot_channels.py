"""
Channels
========

Two channels on one grid, each in its own colour: light adds up, and so do the pictures.
"""

import numpy as np

import clvol

random = np.random.default_rng(3)
z, y, x = np.mgrid[0:16:32j, 0:24:64j, 0:24:64j]  # µm
centers = [(8 + random.normal(), 6 + 12 * i + random.normal(), 6 + 12 * j + random.normal()) for i in range(2) for j in range(2)]
distance = np.min([np.sqrt((z - a) ** 2 + (y - b) ** 2 + (x - c) ** 2) for a, b, c in centers], axis=0)
nuclei, membranes = np.exp(-((distance / 2.2) ** 6)), np.exp(-(((distance - 4.2) / 0.5) ** 2))
leading = clvol.volume.volumes.Leading(("channel",), (2,), {"channel": ("nuclei", "membranes")}, colors=("#4080ff", "#40ff60"))
counts = random.poisson(100 * np.stack([nuclei, membranes])).astype(np.float32)
cells = clvol.Volumes(counts, spacing=(24 / 63, 24 / 63, 16 / 31), units="µm", space="image", leading=leading)

camera = clvol.Camera.orbit(20, 55, fit="volume", zoom=1.3)
picture = np.minimum(sum(clvol.render(channel, camera, "mip") for channel in cells), 1)
