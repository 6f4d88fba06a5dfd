"""
Depth, normals, positions
=========================

A picture is one output of several: normals as colours, and the distance from the eye.
"""

import numpy as np

import clvol

volume = clvol.phantoms.box(48)
outputs = clvol.render(volume, mode="isosurface", isovalue=0.5, outputs=["rgba", "normal", "depth"], size=(320, 320), samples=4)
depth = outputs["depth"]
near, far = np.nanmin(depth), depth[np.isfinite(depth)].max()
grey = np.clip((far - depth) / (far - near), 0, 1)
picture = np.hstack([outputs["rgba"][..., :3], np.nan_to_num(outputs["normal"] / 2 + 0.5), np.repeat(grey[..., None], 3, -1)])
