"""
Soft light
==========

A head from CT, a bonsai and a confocal stack in the light of a studio: a warm lamp that stands still, a cool and weak one, shadow,
occlusion and linear light. All volumes are computed here; ``clvol.read("scan.nii.gz")`` goes in place of one.
"""

import numpy as np

import clvol

rng = np.random.default_rng(4)


def from_azimuth(azimuth, elevation, color):
    """A light that shines from where a camera of this azimuth and elevation stands."""
    a, e = np.radians([azimuth, elevation])
    return clvol.Light((np.sin(a) * np.cos(e), -np.cos(a) * np.cos(e), np.sin(e)), color)


def shown(volume, azimuth, elevation, **look):
    """A picture in soft light."""
    lamp, sky = (from_azimuth(azimuth - 50, 45, (1, 0.95, 0.87)), from_azimuth(azimuth + 60, 10, (0.1, 0.12, 0.17)))
    light = {"lights": [lamp, sky, clvol.Light(None, (0.1, 0.1, 0.11))]}
    light |= {"shadow": 0.9, "occlusion": 1, "linear_light": True}
    return clvol.render(volume, clvol.Camera.orbit(azimuth, elevation), size=(420, 420), rays=4, **light, **look)


# %%
# The head: bone as CT shows it, cut open above the ears, and in it the brain and its vessels, three media of a scene. Folds are
# where noise of one size of detail is zero, and vessels walk over the brain.

z, y, x = np.mgrid[-92:108:101j, -104:112:109j, -84:84:85j]  # mm


def ball(at, radii):
    """Below 1 within an ellipsoid."""
    return np.sqrt(sum(((p - q) / r) ** 2 for p, q, r in zip((x, y, z), at, radii, strict=True)))


def joined(*distances, sharp):
    """The distance within any of them, round where they meet."""
    return -np.log(sum(np.exp(-sharp * d) for d in distances)) / sharp


def within(distance, edge):
    """1 within a distance of 1, 0 outside."""
    return np.clip((1 - distance) / edge + 0.5, 0, 1)


def scanned(data, blur):
    return clvol.Volume(data, (2, 2, 2), (-84, -104, -92), units="mm", space="LPS").gaussian(blur)


def grain(size):
    data = scanned(rng.normal(size=x.shape), size).data
    return data / data.std()


case = joined(ball((0, 12, 32), (68, 88, 68)), ball((0, -20, -22), (48, 62, 56)), ball((0, 40, -8), (60, 56, 46)), sharp=5)
bone = scanned(-1000 + 2400 * within(case, 0.06) * (1 - within(case / 0.91, 0.06)) + rng.normal(0, 12, x.shape), 2.2)
sides = [
    ball((side * u, 8 - v, w), radii)
    for side in (-1, 1)
    for u, v, w, radii in ((21, 0, 34, (39, 74, 54)), (32, 2, 6, (26, 52, 32)))
]
detail = grain(4.4) - 0.8 * grain(7)
folds = np.exp(-((detail / (0.3 * detail.std())) ** 2))
cortex = joined(*sides, sharp=10) + 0.13 * folds + 0.35 * np.exp(-((x / 3) ** 2)) * (z > 2)
brain = scanned(100 * within(np.minimum(cortex, ball((0, 52, -14), (46, 30, 24))), 0.14), 1.5)
blood = np.zeros(x.shape)


def walk(at, way, steps, radius):
    """A vessel over the brain, and those that leave it."""
    middle, radii = np.array([np.sign(at[0]) * 21, 8, 30]), np.array([40, 75, 57])
    for left in range(steps, 0, -1):
        unit = (at - middle) / radii / np.linalg.norm((at - middle) / radii)
        out = unit / radii / np.linalg.norm(unit / radii)
        way = way + rng.normal(0, 0.16, 3)
        way -= out * (way @ out)
        way /= np.linalg.norm(way)
        at = middle + radii * unit + 1.5 * way
        low = np.maximum((at - (-84, -104, -92)) / 2 - 2, 0).astype(int)
        near = tuple(slice(n, n + 6) for n in low[::-1])
        apart = np.sqrt((x[near] - at[0]) ** 2 + (y[near] - at[1]) ** 2 + (z[near] - at[2]) ** 2)
        blood[near] = np.maximum(blood[near], 100 * np.clip((radius - apart) / 2 + 0.5, 0, 1))
        if radius > 0.9 and rng.random() < 0.03:
            walk(at, way + 0.8 * rng.choice((-1, 1)) * np.cross(out, way), left // 2, 0.8 * radius)


for side, turn in [(side, turn) for side in (-1, 1) for turn in np.radians((-75, -35, 5, 45))]:
    walk(np.array([side * (21 + 40 * np.cos(turn)), 8 + 75 * np.sin(turn), 20]), np.array([0, rng.normal(0, 0.3), 1]), 70, 1.4)
ivory = clvol.TransferFunction([(0, "#cdb89a"), (900, "#efe3cb")], [(100, 0), (350, 0.95)])
rose = clvol.TransferFunction([(20, "#8f3f3b"), (60, "#d98f82"), (95, "#f2c4b4")], [(28, 0), (60, 0.9)])
red = clvol.TransferFunction([(0, "#8e1216")], [(25, 0), (55, 0.95)])
matte, wet = clvol.Material(0.28, 0.72, 0.06, 20), clvol.Material(0.28, 0.72, 0.22, 30)
skull = clvol.Medium(bone, ivory, clip=clvol.Corner((-999, -999, 26), (999, 999, 999)), material=matte)
study = clvol.Scene([skull, clvol.Medium(brain, rose, material=wet), clvol.Medium(scanned(blood, 0.7), red, material=wet)])
portrait = shown(study, 140, 38, background="#15181f")

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
tree = shown(clvol.Volume(grid).gaussian(0.7), 35, 20, background="#cfd3d2", material=matte)

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
nuclei = shown(
    cells,
    25,
    42,
    transfer=clvol.TransferFunction(blue, [(1400, 0), (2400, 0.4), (4500, 0.8)]),
    background="#070a12",
    material=matte,
)
picture = np.hstack([portrait, tree, nuclei])
