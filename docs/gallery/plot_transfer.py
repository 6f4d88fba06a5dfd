"""
A transfer function
===================

Colours and opacities, each piecewise linear in the value: two jumps make a shell opaque, and leave the rest like glass.
"""

import clvol

volume = clvol.phantoms.sphere(64)
transfer = clvol.TransferFunction(
    colors=((0.2, "#3b4cc0"), (0.5, "#dddddd"), (0.9, "#b40426")),
    opacities=((0.2, 0), (0.25, 0.03), (0.60, 0.03), (0.60, 0.6), (0.66, 0.6), (0.66, 0)),
)
picture = clvol.render(volume, transfer=transfer, clip=((-1, -1, -1), (1, 0.2, 1)), background="white")

# %%
# The same scene as one file, without a server, which browsers draw by WebGL2: drag to turn it.
page = clvol.save_html(volume, "transfer.html", transfer=transfer, clip=((-1, -1, -1), (1, 0.2, 1)), background="white")
