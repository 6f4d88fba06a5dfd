"""
Slices at any angle
===================

A slice shows the function between the samples in a plane of any direction; a slab shows the mean or an extreme over its thickness.
Left a slice along the axis of a coil, right the maximum of a slab about it, which holds the whole turns.
"""

import numpy as np

import clvol

t = np.linspace(-1, 1, 400)
middle, axis, a, b = np.full(3, 32.0), np.array([2, 1, 2]) / 3, np.array([1, -2, 0]) / 5**0.5, np.array([4, 2, -5]) / 45**0.5
coil = middle + 24 * t[:, None] * axis + 9 * (np.cos(16 * t)[:, None] * a + np.sin(16 * t)[:, None] * b)
wire = np.zeros((64, 64, 64), np.float32)
np.add.at(wire, tuple(np.rint(coil).astype(int).T[::-1]), 1)
volume = clvol.Volume(wire).gaussian(1.5)

plane = clvol.Plane(normal=b, point=middle)
options = {"up": axis, "spacing": 0.18, "size": (280, 320), "center": middle, "cmap": "magma"}
picture = np.hstack([clvol.slice(volume, plane, **options), clvol.slice(volume, plane, thickness=24, mode="mip", **options)])
