"""A picture as one file of HTML that draws the true spline by WebGL2, without a server or a network: `save_html`.

`look` says what the page draws, as JSON; `static` has the page, its script and its shaders, which are joined here.
"""

from __future__ import annotations

import base64
import hashlib
import json
import os
import zlib
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any, Unpack

from clvol.base.checks import as_path, flag, instance, suggests_options, whole
from clvol.base.errors import OptionError
from clvol.base.files import require_folder, require_suffix, staged
from clvol.base.html import escape, facts, static
from clvol.interfaces.page.look import look_of, packed, portraits_of, reduced, require_drawable
from clvol.march import recipe
from clvol.march.choose import source_of
from clvol.march.options import FieldOptions, Fineness, LookOptions, ModeOptions, chosen_mode
from clvol.scene.mode import DEFAULT_MODE
from clvol.spline.field import Field

if TYPE_CHECKING:
    from clvol.march.source import Drawable
    from clvol.scene.camera import Camera
    from clvol.scene.mode import Mode
    from clvol.volume.volume import Volume

__all__ = ["HtmlOptions", "save_html"]

_SHADERS = ("function.glsl", "look.glsl", "ray.glsl", "slice.glsl", "probe.glsl")
_PARTS = ("data", "camera", "gl", "main")  # of one script; what is used while a part is read stands in one before it
_LEVEL = 6  # of zlib: 9 takes four times as long, for 2 % less
_SIZE = (512, 512)  # of the picture that an open camera is fitted to


class HtmlOptions(LookOptions, ModeOptions, FieldOptions, total=False):
    """Options of `clvol.save_html`, beside those of `clvol.render`.

    Attributes
    ----------
    title : str
        A heading; by default the page has none, and bears no name of a file or a patient.
    metadata : bool
        Whether the page lists the volume's name and header. By default neither is in the file.
    most : int
        The most samples along an axis, 16 to 2048: a volume with more is reduced first, without aliases. By default none is, and
        one with more than 508 is refused: phones hold no more.
    """

    title: str
    metadata: bool
    most: int | None


@suggests_options
def save_html(
    scene: Drawable,
    path: str | os.PathLike[str],
    camera: Camera | None = None,
    mode: str | Mode = DEFAULT_MODE,
    step: float | None = None,
    **options: Unpack[HtmlOptions],
) -> Path:
    """Write a picture that turns: one file of HTML, which a browser opens from a folder, without a server or a network.

    It draws the function that `clvol.render` draws, not voxels: from the prefiltered coefficients a graphics card interpolates by
    eight linear fetches a sample (Sigg and Hadwiger, 2005), with analytic normals, the exact transfer function, the same lights
    and cuts. The pointer or keys turn, move and zoom it; there are sliders for an isovalue and for a cut, and slices.

    Parameters
    ----------
    scene : Volume, Medium, Scene, Field or array-like, 3-D
        What to draw: one volume in memory, whole, by "bspline3" (with any smoothing), "bspline3-approx", "linear" or "nearest".
    path : path-like
        Ends in ``.html``.
    camera, mode, step
        As of `clvol.render`; the mode is "composite", "isosurface", "surfaces", "mip" or "minip".
    **options
        Those of `HtmlOptions` (`title`, `metadata`, `most`) and the look of `clvol.render`: `transfer`, `preset`, `lights`, ...; of
        `clip` planes and boxes, at most 16 faces in all.

    Returns
    -------
    Path

    Raises
    ------
    OptionError
        The page cannot draw what is asked for, which the message names: another mode or filter, several media, shadows, occlusion,
        opacity by gradients, corners, missing samples, ...; or an axis has too many samples (see `most`).
    FormatError
        `path` has another suffix, or cannot be written.
    ClvolError
        As by `clvol.render`.

    Warns
    -----
    ClvolWarning
        What is shown spans less than 1/256 of the volume's range, so that 16 bits show as steps.

    Notes
    -----
    Coefficients have 16 bits, with one offset and scale for the volume: the error is 2⁻¹⁷ of their range. They are two bytes of a
    texture of format RG8, whose linear interpolation all devices of WebGL2 have; 16-bit integers, and on many phones 32-bit floats,
    are not interpolated, and half floats have 11 bits. Graphics cards weight by 8 bits, which is up to 0.11 % of the range in
    values; roots and normals of surfaces take 64 fetches with float32's weights instead.

    Surfaces are found between samples half a voxel apart: two crossings between two of them are missed. Pixels have one ray.
    Virtual samples are real ones, closer together.

    Examples
    --------
    >>> import clvol
    >>> clvol.save_html(clvol.phantoms.sphere(32), "ball.html", mode="isosurface").name
    'ball.html'
    """
    target = as_path(path)
    given: Any = dict(options)
    suffix = require_suffix(path, (".html",), "pages")
    title, metadata, most = given.pop("title", ""), flag("metadata", given.pop("metadata", False)), given.pop("most", None)
    instance("title", title, str)
    if most is not None:
        scene = reduced(scene, whole("most", most, minimum=16, maximum=2048))
    if foreign := sorted(given.keys() - HtmlOptions.__annotations__):
        raise OptionError(f"a page takes no {' and '.join(foreign)}: leave them out, or draw a picture by clvol.render")
    held = {name: given.pop(name) for name in FieldOptions.__annotations__ if name in given}
    chosen = chosen_mode(mode, given, scene=scene)
    require_folder(target)
    source = source_of(scene, **held, usual=chosen.picture_filter)
    try:
        with source.in_use():
            source.require_heard(chosen, given)
            fine = Fineness.of(chosen, _SIZE, step, given)
            require_drawable(source, chosen, given)
            stage = recipe.staged(source, camera, chosen, fine, given, step)
            field = source.function(stage.look.mode)
            assert isinstance(field, Field)  # or it was refused
            samples, scale = packed(field.coefficients)
            portraits = portraits_of(recipe.look_of(source, camera, chosen, given))
            look = look_of(stage.look, fine.step, field.coefficients, scale, portraits)
            volume = source.scene.media[0].volume
    finally:
        source.lease.close()
    text = _page(look, samples, title, _details(volume) if metadata else "")
    with staged(target, suffix) as file:
        file.write_text(text, encoding="utf-8")
    return target


def _page(look: dict[str, Any], samples: bytes, title: str, details: str) -> str:
    """The text of the file."""
    texts = {name: static(__name__, name) for name in ("page.html", "page.css", *_SHADERS)}
    script = static(__name__, *(f"{part}.js" for part in _PARTS))
    policy = {
        "default-src": "'none'",
        "script-src": _hashed(script),
        "style-src": _hashed(texts["page.css"]),
        "img-src": "data:",  # the empty icon
        "base-uri": "'none'",
        "form-action": "'none'",
    }
    return Template(texts["page.html"]).substitute(
        policy="; ".join(f"{name} {value}" for name, value in policy.items()),
        title=escape(title or "clvol"),
        untitled="" if title else " hidden",
        label=escape(f"{title + ': ' if title else ''}a volume in 3-D, {look['mode']}"),
        style=texts["page.css"],
        slices="\n".join(_slice(k, one[0]) for k, one in enumerate(look["slices"])),
        details=details,
        look=json.dumps(look, allow_nan=False).replace("<", "\\u003c"),
        shaders="\n".join(f'<script type="text/plain" id="{name}">{texts[name]}</script>' for name in _SHADERS),
        coefficients=base64.b64encode(zlib.compress(samples, _LEVEL)).decode("ascii"),
        script=script,
    )


def _slice(number: int, name: str) -> str:
    return (
        f'<figure><canvas id="slice-canvas-{number}" role="img" aria-label="{name} slice"></canvas>'
        f'<label>{name} <input id="slice-{number}" type="range" min="0" max="1" step="any" value="0.5"></label></figure>'
    )


def _details(volume: Volume) -> str:
    """What is known of the volume."""
    known = {"name": volume.name, **{str(key): str(value) for key, value in volume.header.items()}}
    size = " × ".join(map(str, volume.size))
    table = facts("", known | {"samples": size, "spacing": " × ".join(f"{v:.6g}" for v in volume.spacing) + f" {volume.units}"})
    return f"<details><summary>About the volume</summary>{table.replace(' style=', ' data-style=')}</details>"


def _hashed(text: str) -> str:
    """What a policy allows: this text alone."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode('ascii')}'"
