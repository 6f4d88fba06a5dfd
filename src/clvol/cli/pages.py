"""The command that writes pages: export."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from cyclopts import Parameter

import clvol
from clvol.cli import speech
from clvol.cli.options import DeviceName, FilterName, Input, Json, Look, ModeOptions, Output, Source, Whole, own_options
from clvol.cli.root import PICTURES, command
from clvol.filter.boundary import chosen_boundary

__all__ = ["export"]


@Parameter(name="*")
@dataclass
class Page:
    """What a page holds."""

    filter: Annotated[
        FilterName | None, Parameter(help="As of 'clvol render': bspline3, bspline3-approx, linear or nearest.", show_default=False)
    ] = None
    most: Annotated[
        Whole | None,
        Parameter(
            help="The most samples along an axis: a volume with more is reduced, without aliases. [default: as it is, up to 508]",
            show_default=False,
        ),
    ] = None
    title: Annotated[str, Parameter(help="A heading.", show_default=False)] = ""
    metadata: Annotated[bool, Parameter(negative="", help="List the volume's name and header on the page.")] = False
    device: DeviceName = None


@command(PICTURES)
def export(
    source: Source,
    /,
    *,
    output: Output,
    page: Page | None = None,
    input: Input | None = None,
    look: Look | None = None,
    own: ModeOptions | None = None,
    json: Json = False,
) -> None:
    """Write a picture that turns: one file of HTML, which any browser opens, without a server or a network.

    It holds the whole volume, as 16-bit coefficients of the spline, and draws that itself. Names and headers are not in it unless
    --metadata asks for them.
    """
    speech.require_writable(output, (".html",), "pages")
    look, given = look or Look(), vars(page or Page())
    options = own_options(look, own)
    volume = (input or Input()).read(source)
    with speech.progress("writing", json), look.limited(given["device"]):
        options |= look.options(volume) | {"boundary": chosen_boundary(look.boundary)}
        clvol.save_html(volume, output, **given, **options)
    speech.say(json, {"output": str(output), "bytes": output.stat().st_size, "mode": look.mode})
