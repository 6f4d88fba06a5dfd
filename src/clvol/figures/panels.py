"""The paper's Figure 6, and the same comparison of any volume: filters side by side, with errors where the truth is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clvol import phantoms
from clvol.analysis import EXACT_SINC, sinc_volume
from clvol.analysis.angle import mean_angle
from clvol.analysis.comparison import as_compared
from clvol.analysis.dirichlet import periodic
from clvol.base.checks import whole
from clvol.base.errors import OptionError
from clvol.base.progress import Progress, part_of
from clvol.device import Device
from clvol.figures.style import LETTERS, Drawing, title
from clvol.filter.boundary import DEFAULT_BOUNDARY, Boundary
from clvol.filter.filter import Filter
from clvol.filter.table import as_filter
from clvol.march.options import WORDS, PanelOptions, step_times, transfer_of, unheard
from clvol.march.renderer import Renderer
from clvol.reference.march.exact import draw_function
from clvol.scene.camera import Camera
from clvol.scene.clip import as_clip
from clvol.scene.fit import fitted, usual_camera
from clvol.scene.light import Light, Material
from clvol.scene.mode import DEFAULT_MODE, as_mode, every_option, require_heard
from clvol.scene.transfer import TransferFunction
from clvol.show.picture import grid, heat, labelled, to_bytes
from clvol.spline.field import sample
from clvol.volume.volume import Volume, as_volume

__all__ = [
    "BOX",
    "CAMERA",
    "FIGURE_6",
    "ISOVALUE",
    "LIGHTS",
    "LOOK",
    "MATERIAL",
    "PANELS",
    "SHADED",
    "SIX",
    "SURFACE",
    "Panel",
    "compare",
    "draw",
    "exact",
    "figure6",
    "fixed",
    "for_filter",
    "settled",
    "shading_gradients",
]

SIX = ("sinc4n", "nearest", "bspline3-approx", "linear", "mitchell", "bspline3")
"""The six reconstructions of the paper as filters of the table; the sinc is cut at four samples, with weights that sum to one."""

FIGURE_6 = (EXACT_SINC, *SIX[1:])
"""a) to f) of the paper's Figures 4 to 6: the sinc is exact."""

PANELS = (*FIGURE_6, "sinc")
"""The panels of Figure 6, with the practical sinc too, cut at four samples, whose weights do not sum to one."""

_FINER = 4  # magnification for the exact sinc
_WORST = 0.4  # difference of shade with the brightest colour
# a good view of the Marschner-Lobb function, in every figure
ISOVALUE = 0.5
BOX = ((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0))
CAMERA = Camera.orbit(20, 52, zoom=1.27, fit="volume")  # the same for all samplings
LIGHTS = (Light((-0.6, -0.35, 0.75)), Light((0.8, 0.5, 0.35), (0.36, 0.42, 0.52)))  # the second where the first does not reach
MATERIAL = Material(ambient=0.16, diffuse=0.84, specular=0.12, shininess=25)
SURFACE = (0.86, 0.86, 0.84)
SHADED: dict[str, Any] = {"color": SURFACE, "lights": LIGHTS, "material": MATERIAL}
LOOK = {**SHADED, "isovalue": ISOVALUE, "clip": BOX}
BACKGROUND = (0.16, 0.18, 0.22)
_INK = (235, 235, 235)
_POINTS = 200_000
_SEED = 1999


@dataclass(frozen=True)
class Panel:
    """One picture of a comparison and its errors.

    Attributes
    ----------
    filter : str
        The filter's name; "exact" for the function itself.
    picture : ndarray
        RGBA, float32.
    rms : float or None
        Root mean square error of the values at random points within 0.8 of the centre.
    angle : float or None
        Mean angle in degrees between the reconstruction's gradient and the true one (`clvol.analysis.mean_angle`), at
        the visible points of the true surface; None if there are none.
    residual : float or None
        For the exact sinc: its largest difference from the rendered function, at 2000 random points.
    letter : str
        The panel's letter in the figure, or empty.
    error : ndarray or None
        Difference of shade from the true picture, shape (height, width), if that is known.
    """

    filter: str
    picture: NDArray[np.float32]
    rms: float | None = None
    angle: float | None = None
    residual: float | None = None
    letter: str = ""
    error: NDArray[np.float32] | None = None

    @property
    def label(self) -> str:
        # Pillow's default font has no Greek letters
        heading = (f"{self.letter})  " if self.letter else "") + title(self.filter).replace("λ", "lambda")
        heading += "" if self.residual is None else f" to about {self.residual:.0e}"
        measured = [] if self.rms is None else [f"RMS error {self.rms:.4f}"]
        measured += [] if self.angle is None else [f"normals {self.angle:.1f}°"]
        return f"{heading}\n{'   '.join(measured)}"  # always two lines, so that all labels have one height

    def numbers(self) -> dict[str, Any]:
        """For programs: everything except pictures and the letter."""
        return {key: value for key, value in asdict(self).items() if key not in ("picture", "error", "letter")}


def figure6(
    size: int = 40,
    pixels: int = 512,
    filters: Sequence[str | Filter] = PANELS,
    *,
    camera: Camera = CAMERA,
    rays: int = 4,
    step: float = 0.25,
    device: Device | str | int | None = None,
    progress: Progress | None = None,
) -> tuple[list[Panel], NDArray[np.uint8]]:
    """Figure 6 of the paper: `size` cubed samples of the Marschner-Lobb function, reconstructed by each filter.

    Parameters
    ----------
    size : int
        Samples along each axis of [-1, 1]³.
    pixels : int
        Width and height of each panel.
    filters : sequence of str or Filter
        One panel each, and below it the difference of its shade to the truth; the exact function is added at the end.
        "exact-sinc" is the exact sinc: the samples are magnified by the FFT and drawn through `bspline3`, and the panel
        says how far that is from exact.
    camera, rays, step, device, progress
        As for `Renderer.render`.

    Returns
    -------
    panels : list of Panel
    sheet : ndarray of uint8, shape (height, width, 3)
        All panels, labelled with their errors.
    """
    whole("pixels", pixels, 1)
    chosen = as_compared(filters, len(LETTERS))
    volume = phantoms.marschner_lobb(size)
    surface, picture = exact(volume, camera, pixels, rays)
    points = np.random.default_rng(_SEED).uniform(-0.8, 0.8, (_POINTS, 3))
    truth, normals = phantoms.marschner_lobb_function(points), phantoms.marschner_lobb_gradient(surface)
    panels = []
    for i, row in enumerate(chosen):
        report = part_of(progress, (i + 1) / (len(chosen) + 1), (i + 2) / (len(chosen) + 1))  # the exact picture was the first part
        drawn_volume, through, finer, residual = _through(volume, row, DEFAULT_BOUNDARY)
        with Renderer(drawn_volume, through, device=device) as renderer:
            drawn = renderer.render(
                fixed(camera, volume, drawn_volume),
                "isosurface",
                (pixels, pixels),
                step * finer,
                background=BACKGROUND,
                rays=rays,
                progress=report,
                **LOOK,
            )
            name = row if isinstance(row, str) else renderer.filter.name  # with settled smoothing
        values = sample(drawn_volume, points, through, device=device)
        rms = float(np.sqrt(np.mean((values - truth) ** 2)))
        angle = mean_angle(shading_gradients(drawn_volume, surface, through, device), normals, faces=True) if surface.size else None
        error = np.abs(drawn - picture)[..., :3].mean(-1)
        panels.append(Panel(name, drawn, rms, angle, residual, LETTERS[i], error))
    panels.append(Panel("exact", picture))
    below = [_key(pixels) if p.error is None else to_bytes(heat(p.error / _WORST)) for p in panels]
    tiles = [labelled(np.concatenate([to_bytes(p.picture[..., :3]), b]), p.label) for p, b in zip(panels, below, strict=True)]
    return panels, grid(tiles, columns=min(4, len(tiles)))


def _key(pixels: int) -> NDArray[np.uint8]:
    """The colour scale of the errors, in the space below the true picture."""
    from PIL import Image, ImageDraw, ImageFont

    size, bar = max(9, pixels // 24), max(1, pixels // 16)
    scale = np.zeros((pixels, pixels, 3), np.float32)
    left, top, width = pixels // 8, (pixels - bar) // 2, max(1, 3 * pixels // 4)
    scale[top : top + bar, left : left + width] = heat(np.linspace(0, 1, width)[None])
    image = Image.fromarray(to_bytes(scale))
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(size)
    draw.text((pixels / 2, top - size), "difference of shade to the function itself", fill=_INK, font=font, anchor="mm")
    for share in (0, 0.5, 1):
        draw.text((left + share * width, top + bar + size), f"{share * _WORST:g}", fill=_INK, font=font, anchor="mm")
    return np.asarray(image)


def compare(
    volume: Volume | ArrayLike,
    filters: Sequence[str | Filter] = SIX,
    pixels: int = 384,
    boundary: str | Boundary = DEFAULT_BOUNDARY,
    *,
    max_samples: int = 1 << 20,
    device: Device | str | int | None = None,
    progress: Progress | None = None,
    **options: Unpack[PanelOptions],
) -> tuple[list[Panel], NDArray[np.uint8]]:
    """The same picture of a volume by each filter; `options` are those of `Renderer.render`.

    "exact-sinc" is drawn as in Figure 6, of at most `max_samples` samples since it takes 64 times their memory. It ends up
    to three eighths of a sample sooner than the others.

    Returns
    -------
    panels : list of Panel
        Without errors, since the truth is not known.
    sheet : ndarray of uint8, shape (height, width, 3)
        All panels, labelled, in rows of three or four.
    """
    whole("pixels", pixels, 1)
    chosen, volume = as_compared(filters), as_volume(volume)
    if EXACT_SINC in chosen:
        periodic(boundary)
        if volume.data.size > max_samples:
            raise OptionError(f"{EXACT_SINC!r} is drawn of at most {max_samples} samples; got {volume.data.size}")
    look = settled(volume, {"mode": "isosurface", **options})
    camera, step = look.pop("camera"), look.pop("step", None)
    panels = []
    for i, row in enumerate(chosen):
        drawn_volume, through, finer, residual = _through(volume, row, boundary)
        with Renderer(drawn_volume, through, boundary, device) as renderer:
            view = camera if drawn_volume is volume else fixed(camera, volume, drawn_volume)
            drawn = renderer.render(
                view,
                size=(pixels, pixels),
                step=step_times(step, finer, look["mode"]),
                progress=part_of(progress, i / len(chosen), (i + 1) / len(chosen)),
                **for_filter(look, renderer.filter),
            )
            name = row if isinstance(row, str) else renderer.filter.name  # as above
        panels.append(Panel(name, drawn, residual=residual))
    columns = min(len(panels), 3 if len(panels) % 3 == 0 else 4)
    return panels, grid([labelled(p.picture, p.label.rstrip()) for p in panels], columns=columns)


def draw(
    samples: int = 40,
    pixels: int = 512,
    filters: Sequence[str | Filter] = PANELS,
    device: Device | str | int | None = None,
    progress: Progress | None = None,
) -> Drawing:
    """Figure 6 of the paper as a drawing: `figure6` with `samples`³ of the function."""
    panels, sheet = figure6(samples, pixels, filters, device=device, progress=progress)
    lines = [p.label.replace("\n", ": ") for p in panels if p.rms is not None]
    return Drawing(sheet, [p.numbers() for p in panels], lines)


def settled(volume: Volume, options: dict[str, Any]) -> dict[str, Any]:
    """Options of `Renderer.render` for pictures of a volume and of others derived from it, with all defaults resolved."""
    look = dict(options)
    own = {name: look.pop(name) for name in every_option() & look.keys()}
    mode = look["mode"] = as_mode(look.get("mode", DEFAULT_MODE), own).settled(volume)
    reasons = unheard(mode, look)
    require_heard(mode, reasons, reasons)
    look["transfer"] = transfer = transfer_of(volume, mode, look) or mode.transfer(volume)
    for word in WORDS:
        look.pop(word, None)
    if isinstance(transfer, TransferFunction):  # an error otherwise, by `render`
        clip = None if look.get("clip") is None else as_clip(look["clip"])
        look["camera"] = fitted(look.get("camera") or usual_camera(volume), volume, mode, transfer, clip)
        look["transfer"] = replace(transfer, unit_distance=transfer.unit_distance or volume.mean_spacing)
    if "transfer" in mode.unheard:
        del look["transfer"]
    return look


def for_filter(look: dict[str, Any], filter: Filter) -> dict[str, Any]:
    """The options of `settled` that change pictures of a filter: one without slopes has no choice of gradient."""
    return {name: value for name, value in look.items() if name != "gradient" or filter.has_gradient}


def _through(volume: Volume, row: str | Filter, boundary: str | Boundary) -> tuple[Volume, Filter, int, float | None]:
    """The volume and the filter to render a filter or the exact sinc, the magnification, and the distance from the exact sinc."""
    if isinstance(row, Filter):
        return volume, row, 1, None
    exact = sinc_volume(volume, _FINER, boundary=boundary)
    return exact.volume, as_filter(exact.filter), _FINER, exact.maximum


def fixed(camera: Camera, volume: Volume, other: Volume) -> Camera:
    """A camera that shows the same part of another volume as `camera`, fitted to `volume`, shows of this one."""
    view = camera.view(volume)
    eye = tuple(map(float, view.eye))
    here = Camera.look_at(
        eye, tuple(view.eye + view.forward), tuple(map(float, view.up)), projection=camera.projection, fov=camera.fov
    )
    return here.zoomed(here.view(other).half_height / view.half_height)


def shading_gradients(
    volume: Volume,
    points: NDArray[np.float64],
    filter: Filter,
    device: Device | str | int | None = None,
    gradient: Literal["analytic", "central"] = "analytic",
) -> NDArray[np.float64]:
    """The gradient for shading: analytic, or central differences if requested or if the filter has no gradient."""
    if gradient == "analytic" and filter.has_gradient:
        return sample(volume, points, filter, derivative=1, device=device).astype(np.float64)
    columns = []
    for axis in range(3):
        length = volume.spacing[axis] / filter.scale
        ahead, behind = (sample(volume, points + s * volume.direction[:, axis], filter, device=device) for s in (length, -length))
        columns.append((ahead.astype(np.float64) - behind) / (2 * length))
    return np.stack(columns, -1) @ volume.direction.T


# -- the exact function, drawn without any samples --------------------------------------------------------


def exact(
    volume: Volume, camera: Camera, pixels: int, rays: int, background: tuple[float, float, float] = BACKGROUND
) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """The visible points of the true surface, (N, 3), and the picture."""
    function, gradient = phantoms.marschner_lobb_function, phantoms.marschner_lobb_gradient
    view, size = camera.view(volume), (pixels, pixels)
    return draw_function(function, gradient, volume, view, size, background=background, rays=rays, **LOOK)
