"""A viewer without any GUI library: events go in, states follow, frames come out; hosts carry them.

>>> view = clvol.view.View(clvol.read("scan.nii.gz"), mode="isosurface")
>>> session = view.session(send)            # send(message, data) is called from the session's thread
>>> session.receive({"type": "event", "event": {"event_type": "resize", "width": 512, "height": 512, "ratio": 1}})

`state` holds what is shown, `events` what a pointer does to it, `protocol` the messages, `session` the thread that draws, `code` a
state's text. `hosts` show it: a page from a server, notebooks, windows, terminals, napari.
"""

from __future__ import annotations

import threading
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Unpack

from clvol.base.errors import ClvolError, MissingDependencyError
from clvol.filter.table import as_filter
from clvol.interfaces.page import save_html
from clvol.march.renderer import Renderer
from clvol.march.slices import section
from clvol.show.picture import Picture, to_png
from clvol.view import code
from clvol.view.audience import Pick
from clvol.view.code import from_toml, from_url
from clvol.view.layers import Layers
from clvol.view.links import link
from clvol.view.marks import measured
from clvol.view.panes import PaneSize
from clvol.view.renderers import rule_of
from clvol.view.resident import Resident
from clvol.view.session import Session
from clvol.view.sketch import without_prefilter
from clvol.view.state import Mark, State
from clvol.view.watched import Watched

if TYPE_CHECKING:
    import os
    from collections.abc import Mapping
    from pathlib import Path

    from clvol.device import Device
    from clvol.march.options import ViewOptions
    from clvol.view.finer import Finer
    from clvol.view.hosts.server import Serving
    from clvol.view.opening import Viewable
    from clvol.view.protocol import Send
    from clvol.volume.volume import Volume

__all__ = [
    "Layers",
    "Mark",
    "Pick",
    "Session",
    "State",
    "View",
    "Watched",
    "from_toml",
    "from_url",
    "link",
    "measured",
    "section",
    "show",
]

_SMALL = 64  # pixels along the edges of a picture that nobody sees


class View(Watched):
    """A volume to look at, in as many sessions as there are clients; they share its coefficients, not what they show.

    `state` is what is shown, `on_change` and `on_pick` tell of it (`Watched`); `link` has several views turn together.

    Options are checked at once, and the device is asked at the first picture. The resident level of a `LazyVolume` is read at once.

    Parameters
    ----------
    scene : Volume, LazyVolume, Volumes, Scene, Medium, Field or array-like, 3-D
        Of a `LazyVolume` the largest level is resident that fits, with its coefficients, into half of the memory that is available;
        a picture at rest whose pixels are finer is drawn by bricks. Of several volumes one is shown at a time, which the panel
        chooses. Of a scene of several media the panel, slices and picks are of the first; the others are drawn with it.
    device : Device, str or int, optional
    source : str, optional
        Python text by which copied programs get the volume, such as ``clvol.read("scan.nii.gz")``; of several, such as
        ``clvol.read_all("cells.tif")``.
    name : str, optional
        Of the page; by default the volume's.
    finer : Finer, optional
        All levels of the stored volume of which `scene` is one.
    limits : mapping, optional
        Limits of the device while it draws, as of `Device.limited`.
    **options
        As for `clvol.render`, except `size`, `outputs`, `sigma` and `progress`: what is shown first. `layout` is "3d", "slice" or
        "linked": the volume, one slice, or the volume and three slices, with which scans of patients open.

    Raises
    ------
    OptionError
        An unknown option, or a value that is not allowed.
    DataError
        The data are no volume, or cannot be read.
    OutOfMemoryError
        A `LazyVolume` has no level that fits.
    """

    def __init__(
        self,
        scene: Viewable,
        *,
        device: Device | str | int | None = None,
        source: str | None = None,
        name: str | None = None,
        finer: Finer | None = None,
        limits: Mapping[str, Any] | None = None,
        **options: Unpack[ViewOptions],
    ) -> None:
        self.resident = Resident(scene, device=device, source=source, name=name, finer=finer, limits=limits, **options)
        """What its sessions share."""

    @property
    def volume(self) -> Volume:
        """The volume that is shown first."""
        return self.resident.volume

    @property
    def layers(self) -> Layers:
        """The media that it shows: others are added and removed while clients look."""
        return self.resident.layers

    def close(self) -> None:
        """Free the device's memory; a later picture takes it again."""
        self.resident.close()

    def serve(self, **options: Any) -> Serving:
        """Show it in a browser: a page of a server in a thread of this process.

        Parameters
        ----------
        **options
            Those of `clvol.view.hosts.server.Server`: `host`, `port`, `names`, `root_path`, ...

        Returns
        -------
        Serving
            Its `url` has the token that lets a browser in; `close()`, or the end of a ``with`` block, ends it.

        Raises
        ------
        MissingDependencyError
            aiohttp is not installed.
        OptionError
            The port is taken, or an option is not allowed.
        """
        from clvol.view.hosts.server import serve

        return serve(self, **options)

    def session(self, send: Send, state: State | None = None) -> Session:
        """A client's session: see `Session`."""
        return Session(self.resident, send, state)

    def picture(self, size: tuple[int, int] = (512, 512)) -> Picture:
        """The final picture of `state`."""
        resident, state = self.resident, self.state
        wanted = resident.finer_picture(state, PaneSize(*map(float, size)), "3d", size)
        if wanted is not None and resident.finer is not None:
            drawn = resident.finer.drawn(wanted, self.volume, lambda: False)
            assert drawn is not None  # nobody stops it
            return drawn
        with resident.renderers.renderer(*resident.catalog.key(state)) as renderer:
            picture: Picture = renderer.render(size=size, **resident.arguments(state))
        return picture

    def prepare(self) -> None:
        """Compute what a first picture needs and, at the same time, what a page shows beside it.

        Raises
        ------
        ClvolError
            As for `picture`.
        """

        def describe() -> None:
            with suppress(Exception):  # whoever asks for it gets the error
                self.resident.info()
                self.resident.effective(self.state)

        thread = threading.Thread(target=describe, name="clvol view: facts", daemon=True)
        thread.start()
        self.picture((_SMALL, _SMALL))
        thread.join()

    def rehearse(self) -> None:
        """Draw the volume small, without its prefilter, to build kernels for other volumes.

        Kernels that take longest to load or to build depend on no volume, so a small one builds what another will need that is
        still being read. The prefilter's do depend on it, if it has noise.
        """
        resident, state = self.resident, self.state
        row = as_filter(state.filter or resident.mode(state).picture_filter)
        plain = Renderer(self.volume, without_prefilter(row), rule_of(state.boundary), resident.device)
        with plain as renderer, renderer.device.limited(**resident.limits):
            renderer.render(size=(_SMALL, _SMALL), **resident.arguments(replace(state, media=())))

    def save_html(self, path: str | os.PathLike[str], **options: Any) -> Path:
        """Write `state` as one file of HTML, which turns in a browser without a server: see `clvol.save_html`.

        Parameters
        ----------
        path : path-like
            Ends in ``.html``.
        **options
            `title`, `metadata` and `most` of `clvol.save_html`.

        Returns
        -------
        Path

        Raises
        ------
        ClvolError
            As by `clvol.save_html`, such as of what a page cannot draw.
        """
        resident, state = self.resident, self.state
        with resident.renderers.renderer(*resident.catalog.key(state)) as renderer:
            return save_html(renderer.scene, path, device=renderer.device, **{**resident.arguments(state), **options})

    def python(self, size: tuple[int, int] = (512, 512)) -> str:
        """A program that draws `picture(size)`, bit for bit."""
        return code.python(self.resident, self.state, "3d", PaneSize(*map(float, size)), size)

    def widget(self) -> Any:
        """A widget of notebooks: see `clvol.view.hosts.notebook.Widget` (``pip install "clvol[view]"``)."""
        from clvol.view.hosts.notebook import Widget

        return Widget(self)

    def _repr_mimebundle_(self, **_: Any) -> Any:
        """For notebooks: the viewer, or a still picture where there is no anywidget."""
        try:
            return self.widget()._repr_mimebundle_()
        except MissingDependencyError as missing:
            plain = f"{self!r}\n{missing}"
        try:
            return {"image/png": to_png(self.picture()), "text/plain": plain}
        except ClvolError as error:  # no device, for example
            return {"text/plain": f"{plain}\n{error}"}


def show(view: View) -> None:
    """Show a view below the cell of a notebook: see `clvol.view.hosts.notebook.show`."""
    from clvol.view.hosts import notebook

    notebook.show(view)
