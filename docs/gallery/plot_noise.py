"""Noisy data
==========

A ball in noise: interpolated, and by a smoothing spline whose strength follows from the estimated noise.
"""

import numpy as np

import clvol

ball = clvol.phantoms.sphere(40)
noisy = ball.placed(ball.data + np.random.default_rng(0).normal(0, 0.05, ball.shape).astype(np.float32), ball)
print("noise:", round(noisy.noise.sigma, 3), "of which was added: 0.05")
pictures = []
for name in ("bspline3", "bspline3(auto)"):
    with clvol.Renderer(noisy, name) as renderer:
        pictures.append(renderer.render(mode="isosurface", isovalue=0.5, size=(360, 360), rays=4))
        print(renderer.filter.name)
picture = np.hstack(pictures)

# %%
# The smooth one as one file, without a server, which browsers draw by WebGL2: drag to turn it.
page = clvol.save_html(noisy, "noise.html", mode="isosurface", filter="bspline3(auto)", isovalue=0.5)
