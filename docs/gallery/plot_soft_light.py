"""
Soft light
==========

A head from CT, a bonsai and a confocal stack in the light of a studio: a warm lamp that stands still, a cool and weak one, shadow,
occlusion and linear light. The three volumes are computed here; ``clvol.read("scan.nii.gz")`` goes in their place.
"""

import numpy as np

import clvol

rng = np.random.default_rng(4)


def from_azimuth(azimuth, elevation, color):
    """A light that shines from where a camera of this azimuth and elevation stands."""
    a, e = np.radians([azimuth, elevation])
    return clvol.Light((np.sin(a) * np.cos(e), -np.cos(a) * np.cos(e), np.sin(e)), color)


def shown(volume, azimuth, elevation, **look):
    lamp, sky = (from_azimuth(azimuth - 50, 45, (1, 0.95, 0.87)), from_azimuth(azimuth + 60, 10, (0.1, 0.12, 0.17)))
    light = {"lights": [lamp, sky, clvol.Light(None, (0.1, 0.1, 0.11))], "material": clvol.Material(0.28, 0.72, 0.06, 20)}
    light |= {"shadow": 0.9, "occlusion": 1, "linear_light": True}
    return clvol.render(volume, clvol.Camera.orbit(azimuth, elevation), size=(420, 420), rays=4, **light, **look)


# %%
# The head: translucent skin on bone, at isovalues in Hounsfield units. Thick slices are smoothed by about half of their distance.

z, y, x = np.mgrid[-110:110:88j, -100:100:80j, -85:85:68j]  # mm


def ball(at, radii):
    """Below 1 within an ellipsoid."""
    return np.sqrt(sum(((p - q) / r) ** 2 for p, q, r in zip((x, y, z), at, radii, strict=True)))


def joined(*distances):
    """The distance within any of them, round where they meet."""
    return -np.log(sum(np.exp(-9 * d) for d in distances)) / 9


def within(distance, edge=0.05):
    """1 within a distance of 1, 0 outside."""
    return np.clip((1 - distance) / edge + 0.5, 0, 1)


def both(side, *place):
    """An ellipsoid on the left, and one on the right."""
    return np.minimum(ball((-side, *place[:2]), place[2:]), ball((side, *place[:2]), place[2:]))


skull = joined(ball((0, 10, 32), (66, 86, 66)), ball((0, -26, -26), (47, 58, 62)))
hollow = np.minimum(both(66, -36, 8, 13, 30, 24), both(23, -82, 2, 15, 26, 13))  # temples and eyes
hollow = np.minimum(hollow, np.minimum(ball((0, -86, -26), (9, 24, 14)), ball((0, -84, -56), (25, 20, 2.5))))  # nose and mouth
hollow = np.minimum(hollow, both(50, -10, -40, 10, 20, 26))  # behind the jaw
bone = within(skull) * (1 - within(joined(skull / 0.88, ball((0, 0, -46), (26, 62, 44))))) * (1 - within(hollow, 0.15))
neck = np.maximum(np.hypot(x / 44, (y - 18) / 46), abs(z + 75) / 60)
face = joined(ball((0, 10, 32), (71, 91, 71)), ball((0, -28, -28), (54, 64, 68)), neck, ball((0, -90, -24), (11, 18, 17)))
skin = within(np.minimum(face, both(70, 12, -6, 10, 14, 24)))
spine = within(np.maximum(np.hypot(x / 15, (y - 24) / 15), abs(z + 70) / 40) + 0.12 * np.cos(z / 3))
hu = -1000 + 1040 * skin + 1200 * np.maximum(bone, spine) + rng.normal(0, 15, x.shape)
head = clvol.Volume(hu, (170 / 67, 200 / 79, 220 / 87), (-85, -100, -110), units="mm", space="LPS").gaussian(2)
surfaces = [(-250, "#d9a184", 0.2), (300, "#f1e6cf", 1)]
portrait = shown(head, 25, 8, mode="surfaces", surfaces=surfaces, background="#15181f")

# %%
# The bonsai: "composite" with its automatic transfer function, on a light background.

grid = np.zeros((112, 112, 112))


def branch(start, direction, length, radius):
    """A branch, and those that grow from it, in samples (x, y, z)."""
    way = np.linspace(0, 1, int(2 * length))[:, None]
    bend = np.sin(np.pi * way) * rng.normal(0, 0.08 * length, 3)
    for at in start + way * length * direction + bend:
        low, high = np.maximum(at - radius - 3, 0).astype(int), np.minimum(at + radius + 4, 112).astype(int)
        c, b, a = np.ogrid[low[2] : high[2], low[1] : high[1], low[0] : high[0]]
        distance = np.sqrt((a - at[0]) ** 2 + (b - at[1]) ** 2 + (c - at[2]) ** 2)
        part = grid[low[2] : high[2], low[1] : high[1], low[0] : high[0]]
        np.maximum(part, 140 * np.clip(radius - distance + 0.5, 0, 1), out=part)
    for _ in range(3 if length > 6 else 0):
        turned = direction + rng.normal(0, 0.75, 3) * (1, 1, 0.45) + (0, 0, 0.1)
        branch(start + length * direction, turned / np.linalg.norm(turned), 0.74 * length, max(0.68 * radius, 1.1))


branch(np.array([52.0, 58, 22]), np.array([0.18, -0.1, 0.98]), 27, 4.5)
c, b, a = np.mgrid[:112, :112, :112]
wide = np.sqrt(((a - 56) / 38) ** 2 + ((b - 56) / 26) ** 2)
pot = np.clip(15 * (0.07 - np.abs(wide - 0.72 - 0.011 * c)) + 0.5, 0, 1) * ((c > 4) & (c < 27))
pot = np.maximum(pot, (wide < 0.75) & (abs(c - 6) < 3))
stones = clvol.Volume(rng.normal(size=grid.shape)).gaussian(1.6).data
soil = (wide < 0.7 + 0.011 * c) & (c > 6) & (c < 21 + 45 * stones)
grid = np.maximum(grid, np.where(soil, 130.0 + 200 * stones, 190 * pot))
tree = shown(clvol.Volume(grid).gaussian(0.7), 35, 20, background="#cfd3d2")

# %%
# The confocal stack: a transfer function from deep blue to white, whose opacity begins above the background of the dye.

c, b, a = np.mgrid[:40, :128, :128]
stack = 900 + 120 * rng.normal(size=a.shape)
texture = clvol.Volume(rng.normal(size=a.shape)).gaussian(1.3).data
for k in range(24):
    center = np.array([14 + 25 * (k % 5), 14 + 25 * (k // 5), 20]) + rng.normal(0, (4, 4, 4))
    radii, turn = rng.uniform((9, 8, 7), (13, 11, 11)), rng.uniform(0, np.pi)
    p, q = a - center[0], b - center[1]
    u, v = p * np.cos(turn) + q * np.sin(turn), q * np.cos(turn) - p * np.sin(turn)
    inside = np.clip((1 - np.sqrt((u / radii[0]) ** 2 + (v / radii[1]) ** 2 + ((c - center[2]) / radii[2]) ** 2)) * 5 + 0.5, 0, 1)
    stack = np.maximum(stack, inside * rng.uniform(2600, 4200) * (1 + 1.2 * texture))
cells = clvol.Volume(stack, (0.26, 0.26, 0.4), units="um").gaussian(0.2)
blue = [(1200, "#123f8c"), (2600, "#4b9be0"), (4000, "#bdeaf5"), (5500, "white")]
nuclei = shown(cells, 25, 42, transfer=clvol.TransferFunction(blue, [(1400, 0), (2400, 0.4), (4500, 0.8)]), background="#070a12")
picture = np.hstack([portrait, tree, nuclei])
