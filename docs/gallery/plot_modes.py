"""
Modes
=====

What a ray shows: emission and absorption, with light and without; the first surface; the maximum, also dimmed by depth;
the mean. (``minip``, the minimum, is for what is dark in bright matter, such as airways.) The options of a mode are
arguments of ``render``.
"""

import numpy as np

import clvol

random = np.random.default_rng(1)
z, y, x = np.mgrid[-1:1:48j, -1:1:48j, -1:1:48j]
blobs = np.zeros(z.shape, np.float32)
for a, b, c in random.uniform(-0.65, 0.65, (14, 3)):
    blobs += np.exp(-((z - a) ** 2 + (y - b) ** 2 + (x - c) ** 2) / 0.04)
volume = clvol.Volume(blobs, (2 / 47,) * 3, (-1, -1, -1))

looks = [{"mode": mode} for mode in ("composite", "isosurface", "mip", "attenuated", "mean")]
looks.insert(1, {"mode": "composite", "shading": False})
pictures = [clvol.render(volume, size=(256, 256), **look) for look in looks]
picture = np.vstack([np.hstack(pictures[:3]), np.hstack(pictures[3:])])

# %%
# The first one as one file, without a server, which browsers draw by WebGL2: drag to turn it.
page = clvol.save_html(volume, "modes.html")
