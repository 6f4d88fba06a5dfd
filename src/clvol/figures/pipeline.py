"""Figure 1 of the paper: where reconstruction happens in volume rendering, as one real ray sees it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clvol import phantoms, reference
from clvol.base.arrays import Array
from clvol.base.checks import whole
from clvol.device import Device
from clvol.figures.style import GREY, INK, LINE, Drawing, colour, label_ends, new_figure, placed, show, styled, title
from clvol.filter.boundary import DEFAULT_BOUNDARY, as_boundary
from clvol.filter.table import as_filter
from clvol.march.pixels import DEFAULT_PIXEL_FILTER
from clvol.march.planes import Planes
from clvol.march.renderer import Renderer
from clvol.reference.march.march import camera_rays, flat_below, pixel_rays, shade
from clvol.scene.camera import Camera
from clvol.scene.light import HEADLIGHT, Material
from clvol.scene.transfer import TransferFunction
from clvol.volume.stored import Stored
from clvol.volume.volume import Volume

__all__ = ["Ray", "draw", "follow"]

_WAVES = 2.5  # of the Marschner-Lobb function: few enough for visible samples
_CAMERA = Camera.orbit(18, 0, projection="orthographic", zoom=2.05, fit="volume")
_TRANSFER = TransferFunction(
    ((0.30, (0.17, 0.42, 0.69)), (0.48, (0.87, 0.54, 0.24)), (0.62, (0.97, 0.93, 0.84))),
    ((0.0, 0.0), (0.42, 0.0), (0.50, 0.16), (0.62, 0.30)),
)
_STEP = 0.5
_PROFILE = 1201
_FEWER = 10  # pixels of the picture for each pixel of the coarse ones
_RAYS, _MANY = (1, 16), 1024  # rays for each pixel; the last as the truth
_LEAST_WIDTH = 300  # pixels; width of a picture in the file


@dataclass(frozen=True)
class Ray:
    """One ray, sample by sample."""

    t: Array  # world distances from the entry into the volume, (N,)
    points: Array  # (N, 3)
    values: Array  # reconstructed, (N,)
    colors: Array  # classified and lit, (N, 3)
    opacities: Array  # of one step, (N,)
    colour: Array  # accumulated up to and with each sample, (N, 3)
    opacity: Array  # likewise, (N,)
    start: Array  # of the ray, where it enters
    direction: Array  # unit
    length: float  # inside


def follow(volume: Volume, filter: str, size: tuple[int, int], pixel: tuple[int, int]) -> Ray:
    """The ray of a pixel (x, y) of the figure's picture, by the documentation of `clvol.render`."""
    view, (width, height) = _CAMERA.view(volume, size[0] / size[1]), size
    rays = camera_rays(volume, view, (width, height))
    i = pixel[1] * width + pixel[0]
    origin, direction, enter, leave = rays.origin[i], rays.direction[i], rays.enter[i], rays.leave[i]
    planes = Planes(volume, view, width / height, _STEP)
    slope = volume.world_to_index_matrix @ direction
    along, first = slope[planes.axis], volume.world_to_index(origin)[planes.axis]
    t = np.sort((-0.5 + (np.arange(planes.count) + 0.5) * planes.spacing - first) / along)
    t = t[(t >= enter) & (t <= leave)]
    points = origin + t[:, None] * direction
    values = reference.sample(volume, points, filter)
    gradient = reference.sample(volume, points, filter, derivative=1)
    classified = _TRANSFER(values)
    offset = Stored.of(volume, as_filter(filter), as_boundary(DEFAULT_BOUNDARY)).offset  # kernels round values minus this
    unit = float(np.mean(volume.spacing))
    directions = np.broadcast_to(direction, points.shape)
    lit = shade(gradient, classified[:, :3], directions, Material(), (HEADLIGHT,), flat_below(volume, values - offset))
    opacities = 1 - (1 - classified[:, 3]) ** (planes.spacing / abs(along) / unit)
    after = np.cumprod(1 - opacities)
    before = np.concatenate([[1.0], after[:-1]])
    gathered = np.cumsum((before * opacities)[:, None] * lit, axis=0)
    return Ray(
        t - enter,
        points,
        values,
        np.clip(lit, 0, 1),
        opacities,
        gathered,
        1 - after,
        origin + enter * direction,
        direction,
        float(leave - enter),
    )


def draw(samples: int = 21, pixels: int = 400, filter: str = "bspline3", device: Device | str | int | None = None) -> Drawing:
    """Figure 1: a ray through a volume, the function along it, how that becomes a pixel, and how rays become a picture.

    Parameters
    ----------
    samples : int
        Of the function along each axis.
    pixels : int
        Width of the picture; the last panels show one of a tenth of them.
    filter : str
        Filter of the picture.
    device
        As for `clvol.render`.
    """
    pixels = whole("pixels", pixels, 8)
    volume = phantoms.marschner_lobb(samples, f_m=_WAVES)
    size = (pixels, round(0.55 * pixels))
    pixel = (round(0.45 * size[0]), round(0.42 * size[1]))
    few = (-(-size[0] // _FEWER), -(-size[1] // _FEWER))
    look: dict[str, Any] = {"step": _STEP, "transfer": _TRANSFER, "lights": HEADLIGHT, "background": (1.0, 1.0, 1.0)}
    with Renderer(volume, filter, device=device) as renderer:
        picture = renderer.render(_CAMERA, "composite", size, **look)
        coarse = {rays: renderer.render(_CAMERA, "composite", few, rays=rays, **look)[..., :3] for rays in (*_RAYS, _MANY)}
    ray = follow(volume, filter, size, pixel)
    aliases = {rays: float(np.sqrt(np.mean((coarse[rays] - coarse[_MANY]) ** 2))) for rays in _RAYS}
    times = -(-_LEAST_WIDTH // size[0])
    width, height = times * size[0], times * size[1]
    with styled():
        figure = new_figure(11.5, 6.3 + (height + 4 * LINE) / 150)
        top = figure.subfigures(2, 1, squeeze=False, height_ratios=(6.3, (height + 4 * LINE) / 150))[0, 0]
        left, right = top.subfigures(1, 2, squeeze=False, width_ratios=(1, 1.5))[0]
        cut = left.subplots()
        profile, classified, gathered = right.subplots(3, 1, sharex=True, height_ratios=(2.1, 1, 1))
        room = (round(11.5 * 150) - 3 * width) // 4
        shown, *others = [placed(figure, room + i * (width + room), round(6.3 * 150) + 2 * LINE, width, height) for i in range(3)]
        _cut(cut, volume, ray, filter)
        _profile(profile, volume, ray, filter)
        _classified(classified, ray)
        _gathered(gathered, ray)
        show(shown, picture[..., :3], "5  the pixel of this ray")
        final = np.clip(ray.colour[-1] + 1 - ray.opacity[-1], 0, 1)
        shown.plot(*pixel, "s", markersize=9, markerfacecolor=final, markeredgecolor=INK, markeredgewidth=1.2)
        red, green, blue = final
        shown.annotate(
            f"red {red:.2f}\ngreen {green:.2f}\nblue {blue:.2f}",
            pixel,
            (0.02, 0.75),
            textcoords="axes fraction",
            color=INK,
            fontsize=8.5,
            arrowprops={"arrowstyle": "-", "color": INK, "linewidth": 0.8},
        )
        for axes, rays in zip(others, _RAYS, strict=True):
            words = "one ray a pixel" if rays == 1 else f"{rays} rays a pixel"
            show(axes, coarse[rays], f"6  the picture from {words}", f"RMS aliasing {aliases[rays]:.4f}")
            _rays(axes, tuple(p // _FEWER for p in pixel), rays)
    made = [float(v) for v in picture[pixel[1], pixel[0], :3]]
    numbers = [
        {
            "pixel": list(pixel),
            "samples": int(ray.t.size),
            "color": [float(v) for v in final],
            "rendered": made,
            "opacity": float(ray.opacity[-1]),
            "aliasing": {str(rays): error for rays, error in aliases.items()},
        }
    ]
    line = f"{ray.t.size} samples along the ray of pixel {pixel[0]}, {pixel[1]} gather {100 * ray.opacity[-1]:.0f} % opacity"
    more = [f"{few[0]} x {few[1]} pixels of {r} rays each: RMS error {e:.4f} to {_MANY} rays each" for r, e in aliases.items()]
    return Drawing(figure, numbers, [line, *more])


def _rays(axes: Any, pixel: tuple[int, ...], count: int) -> None:
    """The positions of a pixel's rays, and their weights under the pixel filter."""
    from matplotlib.patches import Rectangle

    for (x, y), weight in pixel_rays(count, DEFAULT_PIXEL_FILTER):
        if weight:
            axes.plot(
                pixel[0] - 0.5 + x, pixel[1] - 0.5 + y, "o", color=INK, markersize=1.2 + 2 * np.sqrt(weight), markeredgewidth=0
            )
    axes.add_patch(Rectangle((pixel[0] - 0.5, pixel[1] - 0.5), 1, 1, fill=False, edgecolor=INK, linewidth=1))


def _cut(axes: Any, volume: Volume, ray: Ray, filter: str) -> None:
    """The plane of the ray: samples, the function between them, the ray."""
    z = float(ray.start[2])
    fine = np.linspace(-1, 1, 241)
    x, y = np.meshgrid(fine, fine)
    plane = reference.sample(volume, np.stack([x, y, np.full_like(x, z)], -1), filter)
    low, high = float(plane.min()), float(plane.max())
    axes.imshow(plane, extent=(-1, 1, -1, 1), origin="lower", cmap="Greys", vmin=low, vmax=high + 0.8 * (high - low))
    slice_ = int(np.clip(np.rint(volume.world_to_index((0, 0, z))[2]), 0, volume.shape[0] - 1))
    at = volume.index_to_world(np.stack(np.meshgrid(*(np.arange(n) for n in volume.size), indexing="ij"), -1)[:, :, slice_])
    values = volume.data[slice_].T
    axes.scatter(at[..., 0], at[..., 1], c=values, s=13, cmap="Greys", vmin=low, vmax=high, edgecolors=GREY, linewidths=0.5)
    ends = ray.start + np.array([[-0.2], [ray.length + 0.2]]) * ray.direction
    axes.annotate("", ends[1, :2], ends[0, :2], arrowprops={"arrowstyle": "-|>", "color": colour(filter), "linewidth": 1.4})
    axes.plot(ray.points[:, 0], ray.points[:, 1], ".", color=colour(filter), markersize=4.5, zorder=5)
    axes.set(xlim=(-1.2, 1.2), ylim=(-1.3, 1.3), aspect="equal")
    axes.set_title("1  samples (circles), and a ray among them", fontsize=9.5)
    axes.grid(visible=False)
    axes.set_axis_off()


def _profile(axes: Any, volume: Volume, ray: Ray, filter: str) -> None:
    t = np.linspace(0, ray.length, _PROFILE)
    points = ray.start + t[:, None] * ray.direction
    truth = phantoms.marschner_lobb_function(points, f_m=_WAVES)
    axes.plot(t, truth, color="#cfcfcf", linewidth=5, solid_capstyle="butt")
    ends = [("the function", truth, GREY)]
    for name in dict.fromkeys(("nearest", "linear", filter)):
        values = reference.sample(volume, points, name)
        bold = name == filter
        axes.plot(t, values, color=colour(name), linewidth=1.8 if bold else 1.0, zorder=3 if bold else 2)
        ends.append((title(name), values, colour(name)))
    axes.plot(ray.t, ray.values, "o", color=colour(filter), markersize=3.6, zorder=4)
    axes.set(xlim=(0, ray.length), ylabel="value")
    axes.set_title("2  reconstruction: the value wherever the ray needs one (dots)", fontsize=9.5)
    label_ends(axes, [(text, ray.length, float(values[-1]), shade) for text, values, shade in ends], 0.075)


def _classified(axes: Any, ray: Ray) -> None:
    width = float(np.diff(ray.t).mean()) if ray.t.size > 1 else ray.length
    axes.bar(ray.t, ray.opacities, width, color=ray.colors, edgecolor="#8a8a8a", linewidth=0.3)
    axes.set(ylabel="opacity\nof a step", ylim=(0, 1.15 * max(float(ray.opacities.max()), 1e-3)))
    axes.set_title("3  classification and shading: colour and opacity of each sample", fontsize=9.5)


def _gathered(axes: Any, ray: Ray) -> None:
    axes.plot(ray.t, ray.opacity, color=INK, linewidth=1.6)
    cover = np.where(ray.opacity > 0, ray.opacity, 1)[:, None]
    strip = np.clip(ray.colour / cover, 0, 1) * ray.opacity[:, None] + (1 - ray.opacity[:, None])
    edges = np.concatenate([[0.0], (ray.t[1:] + ray.t[:-1]) / 2, [ray.length]])
    axes.bar(edges[:-1], np.ones(ray.t.size), np.diff(edges), align="edge", color=strip, linewidth=0, zorder=0)
    axes.set(ylim=(0, 1), ylabel="accumulated\nopacity", xlabel="distance along the ray, world units")
    axes.set_title("4  accumulation, front to back: the colour so far, over white", fontsize=9.5)
    axes.grid(visible=False)
