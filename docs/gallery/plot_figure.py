"""
A figure with colour bar and scale bar
======================================

One word each draws what a figure needs around a picture; the file of a PDF has it as lines and letters. The grid of the axes lies
behind the volume, which is a field of two poles, half transparent.
"""

import numpy as np

import clvol

x, y, z = np.meshgrid(*[np.linspace(-2, 2, 64)] * 3, indexing="ij")
field = sum(sign / np.sqrt((x - at) ** 2 + y**2 + z**2 + 0.2) for at, sign in ((-0.9, 1), (0.9, 0.6)))
volume = clvol.Volume(field.T.astype(np.float32), spacing=(0.5, 0.5, 0.5), origin=(-16, -16, -16), units="um", name="potential")
transfer = clvol.TransferFunction.from_cmap("viridis", (0.6, 2.4), [(0.6, 0), (0.9, 0.02), (1.5, 0.1), (2.4, 0.8)])
camera = clvol.Camera.orbit(30, 25, projection="orthographic")
around = {"color_bar": True, "scale_bar": True, "axes": True, "cube": True, "title": "Two poles", "theme": "print"}
picture = clvol.render(volume, camera, size=(720, 560), transfer=transfer, **around)

# %%
# The poles as one file, without a server, which browsers draw by WebGL2, with nothing around them: drag to turn them.
page = clvol.save_html(volume, "figure.html", camera, transfer=transfer)
