"""The command that writes pages: export."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter

import clvol
from clvol.cli import speech
from clvol.cli.options import DeviceName, FilterName, Input, Json, Look, ModeOptions, Output, Source, Whole, own_options
from clvol.cli.root import PICTURES, command
from clvol.filter.boundary import chosen_boundary

__all__ = ["export"]


@command(PICTURES)
def export(
    source: Source,
    /,
    *,
    output: Output,
    filter: Annotated[FilterName | None, Parameter(show_default=False)] = None,
    most: Annotated[Whole | None, Parameter(show_default=False)] = None,
    title: str = "",
    metadata: Annotated[bool, Parameter(negative="")] = False,
    device: DeviceName = None,
    input: Input | None = None,
    look: Look | None = None,
    own: ModeOptions | None = None,
    json: Json = False,
) -> None:
    """Write a picture that turns: one file of HTML, which any browser opens, without a server or a network.

    It holds the whole volume, as 16-bit coefficients of the spline, and draws that itself. Names and headers are not in it unless
    --metadata asks for them.

    Parameters
    ----------
    filter
        As of 'clvol render': bspline3 with any smoothing, bspline3-approx, linear or nearest.
    most
        The most samples along an axis: a volume with more is reduced, without aliases. [default: as it is, up to 508]
    title
        A heading.
    metadata
        List the volume's name and header on the page.
    """
    speech.require_writable(output, (".html",), "pages")
    look, reader = look or Look(), input or Input()
    options = own_options(look, own)
    volume = reader.read(source)
    with speech.progress("writing", json), look.limited(device):
        options |= look.options(volume) | {"filter": filter, "boundary": chosen_boundary(look.boundary), "device": device}
        clvol.save_html(volume, output, title=title, metadata=metadata, most=most, **options)
    speech.say(json, {"output": str(output), "bytes": output.stat().st_size, "mode": look.mode})
