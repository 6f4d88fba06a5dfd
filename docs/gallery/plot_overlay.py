"""
A statistical map on a head
===========================

Two media on different grids: a head, and the map of a test statistic with voxels twice as large, turned by 15°. Each has a transfer
function and a filter of its own, and their extinctions add at common samples. A plane opens the head, and shows the slice of both.
"""

import numpy as np
from scipy.ndimage import gaussian_filter

import clvol

z, y, x = np.mgrid[-80:90:86j, -95:95:96j, -76:76:77j]  # mm
radius = np.sqrt((x / 68) ** 2 + (y / 85) ** 2 + (z / 76) ** 2)
folds = 0.05 * np.sin(x / 5 + np.sin(z / 9)) * np.sin(y / 6 + 1) + 0.04 * np.sin(z / 5 + x / 11)
signal = np.zeros(z.shape)
for where, value in (
    (radius < 1, 300),
    (radius < 0.93, 60),
    (radius < 0.86, 90),
    (radius < 0.8 + folds, 520),
    (radius < 0.66 + folds, 760),
):
    signal[where] = value
head = clvol.Volume(
    signal + np.random.default_rng(2).normal(0, 8, z.shape), (2, 2, 2), (-76, -95, -80), units="mm", space="LPS"
).gaussian(1.6)

turned = np.array([[np.cos(0.26), -np.sin(0.26), 0], [np.sin(0.26), np.cos(0.26), 0], [0, 0, 1]])
k, j, i = np.mgrid[:40, :44, :36]
origin = np.array([-50.0, -95.0, -70.0])
p = (np.stack([i, j, k], -1) * 4) @ turned.T + origin
noise = gaussian_filter(np.random.default_rng(0).normal(size=k.shape), 1.5)
t = 0.9 * noise / noise.std()
for sign, at, width in ((1, (-22, 28, 30), 15), (1, (30, 25, 22), 12), (-1, (5, -40, 36), 14)):
    t += sign * 8 * np.exp(-(((p - at) / width) ** 2).sum(-1) / 2)
t *= np.sqrt((p[..., 0] / 60) ** 2 + (p[..., 1] / 76) ** 2 + (p[..., 2] / 68) ** 2) < 1  # within the brain
test = clvol.Volume(t, (4, 4, 4), origin, turned, units="mm", space="LPS")

gray = clvol.TransferFunction([(150, "black"), (800, "white")], [(230, 0), (420, 0.06), (800, 0.12)])
hot_and_cold = clvol.TransferFunction(
    [(-8, "cyan"), (-3, "blue"), (3, "red"), (8, "yellow")], [(-5, 0.6), (-3, 0), (3, 0), (5, 0.6)]
)
scene = clvol.Scene([clvol.Medium(head, gray), clvol.Medium(test, hot_and_cold, filter="bspline3")])
camera = clvol.Camera.orbit(-35, 35)
cut = clvol.Plane(normal=(0, 0, 1), point=(0, 0, 28))
picture = np.hstack(
    [clvol.render(scene, camera, size=(360, 360), rays=4), clvol.render(scene, camera, size=(360, 360), rays=4, clip=cut)]
)
