"""How far off
===========

How far the true surface may be from the rendered one, at each place: the error of the filter, and the noise that it
passes.
"""

import numpy as np

import clvol

volume = clvol.phantoms.marschner_lobb(41)
noise = np.random.default_rng(0).normal(0, 0.02, volume.shape).astype(np.float32)
noisy = volume.placed(volume.data + noise, volume)
outputs = clvol.render(noisy, clvol.Camera.orbit(20, 50), "isosurface", isovalue=0.5, outputs=["rgba", "uncertainty"])
picture = outputs["uncertainty"]  # a heat map, with its scale
