"""
Four channels of a microscope
=============================

Channels of one grid, each in a colour of its own: as projections that add up, and as matter, whose extinctions add, through
membranes that are thin.
"""

import numpy as np
from scipy.ndimage import gaussian_filter

import clvol
from clvol.volume.volumes import Leading

rng = np.random.default_rng(4)
z, y, x = np.mgrid[:48, :120, :120]
centers = rng.uniform((14, 18, 18), (34, 102, 102), (14, 3))
away = np.min([np.sqrt(((z - c) * 1.6) ** 2 + (y - b) ** 2 + (x - a) ** 2) for c, b, a in centers], axis=0)
texture = gaussian_filter(rng.normal(size=away.shape), 1.2)
nuclei = 1100 * (away < 8) * (1 + 2 * texture)
membranes = 500 * np.exp(-(((away - 13) / 1.2) ** 2))
fibres = 4000 * np.maximum(gaussian_filter(rng.normal(size=away.shape), (1, 1, 5)) - 0.09, 0) * (away < 12)
spots = np.zeros(away.shape)
spots[tuple(rng.integers((4, 4, 4), (44, 116, 116), (160, 3)).T)] = 25_000
stained = [nuclei, membranes, fibres, gaussian_filter(spots, 1.1)]
counts = rng.poisson(np.maximum([gaussian_filter(one, 0.8) for one in stained], 0) + 40).astype(np.uint16)
names = ("DNA", "membrane", "actin", "vesicles")
leading = Leading(("channel",), (4,), {"channel": names}, colors=((0.3, 0.45, 1.0), "magenta", "lime", "yellow"))
cells = clvol.Volumes(counts, leading=leading, spacing=(0.2, 0.2, 0.32), units="um")

camera = clvol.Camera.orbit(20, 55)
media = [
    clvol.Medium(cells[name], clvol.TransferFunction([(0, color)], [(low, 0), (high, opacity)]))
    for name, color, (low, high), opacity in zip(
        names, cells.colors, ((200, 800), (150, 500), (90, 300), (150, 500)), (0.4, 0.03, 0.4, 0.6), strict=True
    )
]
pictures = [
    clvol.render(cells, camera, "mip", size=(360, 300), rays=4),
    clvol.render(clvol.Scene(media), camera, size=(360, 300), rays=4),
]
picture = np.hstack(pictures)
