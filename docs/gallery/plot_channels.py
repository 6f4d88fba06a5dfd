"""
Channels
========

Two channels on one grid, each in its own colour: light adds up, and so do the pictures.
"""

import numpy as np

import clvol

random = np.random.default_rng(3)
z, y, x = np.mgrid[0:16:32j, 0:20:64j, 0:20:64j]  # µm
centers = random.uniform((4, 4, 4), (12, 16, 16), (6, 3))
distance = np.min([np.sqrt((z - a) ** 2 + (y - b) ** 2 + (x - c) ** 2) for a, b, c in centers], axis=0)
nuclei, membranes = np.exp(-((distance / 1.6) ** 4)), np.exp(-(((distance - 2.6) / 0.4) ** 2))
leading = clvol.volumes.Leading(("channel",), (2,), {"channel": ("nuclei", "membranes")}, colors=("#4080ff", "#40ff60"))
counts = random.poisson(100 * np.stack([nuclei, membranes])).astype(np.float32)
cells = clvol.Volumes(counts, spacing=(20 / 63, 20 / 63, 16 / 31), units="µm", space="image", leading=leading)

camera = clvol.Camera.orbit(30, 40, fit="volume", zoom=1.5)
pictures = []
for channel in cells:
    glow = clvol.TransferFunction(((5, "black"), (120, channel.color)))
    pictures.append(clvol.render(channel, camera, "mip", transfer=glow))
picture = np.minimum(sum(pictures), 1)
