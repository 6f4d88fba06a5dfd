"""
Lights
======

Up to four lights and a material. A light has a direction, *towards* it, in the world, or relative to the camera with
``frame="camera"``; one without a direction shines from the eye. By default a key, a fill and a headlight move with the
camera.
"""

import clvol

volume = clvol.phantoms.box(48)
lights = [
    clvol.Light((-1, -1, 2), (0.9, 0.85, 0.75)),  # key
    clvol.Light((2, -1, 0), (0.15, 0.2, 0.3)),  # fill
    clvol.Light(None, (0.2, 0.2, 0.2)),  # headlight
]
look = {
    "camera": clvol.Camera.orbit(35, 30),
    "mode": clvol.Isosurface(isovalue=0.5, color="white"),
    "lights": lights,
    "material": clvol.Material(ambient=0.1, diffuse=0.9, specular=0.5, shininess=60),
    "background": "#20242c",
}
picture = clvol.render(volume, **look, rays=4)

# %%
# The same scene as one file, without a server, which browsers draw by WebGL2: drag to turn it.
page = clvol.save_html(volume, "lights.html", **look)
