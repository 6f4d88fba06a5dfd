"""
How far off
===========

Within what of a drawn surface the true one lies, place by place: what the filter does to the samples, and what it makes of their noise.
"""

import numpy as np

import clvol
from clvol.picture import heat_with_scale

volume = clvol.phantoms.marschner_lobb(41)
noise = np.random.default_rng(0).normal(0, 0.02, volume.shape).astype(np.float32)
noisy = volume.placed(volume.data + noise, volume)
outputs = clvol.render(noisy, clvol.Camera.orbit(20, 50), "isosurface", isovalue=0.5, outputs=["rgba", "uncertainty"])
picture = heat_with_scale(outputs["uncertainty"][..., 0], title="the true surface lies within (95 %)")
