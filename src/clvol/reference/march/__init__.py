"""Pictures in float64: `march` from samples, `exact` from a function that is known everywhere."""

from clvol.moved import forwarding

_NAMES = ("Rays", "camera_rays", "render", "shade")
__getattr__ = forwarding(
    __name__, dict.fromkeys(_NAMES, "clvol.reference.march.march") | {"lattice": "clvol.reference.march.march:planes_across"}
)
