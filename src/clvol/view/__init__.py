"""A viewer without any GUI library: events go in, states follow, frames come out; hosts carry them.

>>> view = clvol.view.View(clvol.read("scan.nii.gz"), mode="isosurface")
>>> session = view.session(send)            # send(message, data) is called from the session's thread
>>> session.receive({"type": "event", "event": {"event_type": "resize", "width": 512, "height": 512, "ratio": 1}})

`state` holds what is shown, `events` what a pointer does to it, `session` the thread that draws it, `code` its text. Hosts are
beside it: a page from a server, notebooks, windows.
"""

from __future__ import annotations

import threading
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from clvol.base.errors import ClvolError, MissingDependencyError
from clvol.filter.table import as_filter
from clvol.march.renderer import Renderer
from clvol.show.picture import Picture, to_png
from clvol.view import code
from clvol.view.code import from_toml, from_url
from clvol.view.panes import PaneSize
from clvol.view.resident import Resident
from clvol.view.session import Session
from clvol.view.sketch import without_prefilter
from clvol.view.slices import section
from clvol.view.state import State

if TYPE_CHECKING:
    from clvol.view.server import Serving

__all__ = ["Session", "State", "View", "from_toml", "from_url", "section", "show"]

_SMALL = 64  # pixels along the edges of a picture that nobody sees


class View(Resident):
    """A volume to look at, in as many sessions as there are clients; they share its coefficients, not what they show.

    It is light: options are checked at once, and the device is asked at the first picture. Of a `LazyVolume` the size that is at
    hand is read at once.

    Parameters
    ----------
    scene : Volume, LazyVolume, Volumes, Scene, Medium, Field or array-like, 3-D
        Of a `LazyVolume` the largest size is at hand that fits into half of the memory that is available, with its coefficients; a
        picture at rest whose pixels are finer is drawn by bricks. Of several volumes one is shown at a time, which the panel
        chooses.
    device : Device, str or int, optional
    source : str, optional
        Python text by which copied programs get the volume, such as ``clvol.read("scan.nii.gz")``; of several, such as
        ``clvol.read_all("cells.tif")``.
    title : str, optional
        For people; by default the volume's name.
    finer : Finer, optional
        All sizes of what is stored, where `scene` is one that was read of it.
    limits : mapping, optional
        Limits of the device while it draws, as of `Device.limited`.
    **options
        As for `clvol.render`, but `size`, `outputs`, `sigma` and `progress`: what is shown first.

    Raises
    ------
    OptionError
        An unknown option, or a value that is not allowed.
    DataError
        The data are no volume, or cannot be read.
    OutOfMemoryError
        A `LazyVolume` has no size that fits.
    """

    @property
    def state(self) -> State:
        """What new sessions show first."""
        return self.initial

    @state.setter
    def state(self, state: State) -> None:
        self.require(state)
        self.initial = state

    def serve(self, **options: Any) -> Serving:
        """Show it in a browser: a page of a server in a thread of this process.

        Parameters
        ----------
        **options
            Those of `clvol.view.server.Server`: `host`, `port`, `names`, `root_path`, ...

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
        from clvol.view.server import serve

        return serve(self, **options)

    def session(self, send: Any, state: State | None = None) -> Session:
        """A client's session: see `Session`."""
        return Session(self, send, state)

    def picture(self, size: tuple[int, int] = (512, 512)) -> Picture:
        """The still picture of the first state."""
        finer = self.finer_than_at_hand(self.initial, PaneSize(*map(float, size)), "3d", size)
        if finer is not None and self.finer is not None:
            drawn = self.finer.drawn(finer, self.volume, lambda: False)
            assert drawn is not None  # nobody stops it
            return drawn
        with self.renderer(self.initial.filter, self.initial.boundary, self.which(self.initial)) as renderer:
            made: Picture = renderer.render(size=size, **self.arguments(self.initial))
        return made

    def prepare(self) -> None:
        """Have at hand what a first picture takes, and what a page tells beside it: found out side by side.

        Raises
        ------
        ClvolError
            As for `picture`.
        """

        def known() -> None:
            with suppress(Exception):  # whoever asks for it is told
                self.info()
                self.effective(self.initial)

        told = threading.Thread(target=known, name="clvol view: facts", daemon=True)
        told.start()
        self.picture((_SMALL, _SMALL))
        told.join()

    def rehearse(self) -> None:
        """Draw the volume small, without its prefilter, and forget the picture: what is left are kernels for other volumes.

        Kernels that take longest to load or to build depend on no volume, so a small one rehearses what another will need that
        is still being read. The prefilter's do depend on it, if it has noise.
        """
        row = as_filter(self.initial.filter or self.mode(self.initial).picture_filter)
        plain = Renderer(self.volume, without_prefilter(row), self.initial.boundary, self.device)
        with plain as renderer, renderer.device.limited(**self.limits):
            renderer.render(size=(_SMALL, _SMALL), **self.arguments(self.initial))

    def python(self, size: tuple[int, int] = (512, 512)) -> str:
        """A program that draws `picture(size)`, bit for bit."""
        return code.python(self, self.initial, "3d", PaneSize(*map(float, size)), size)

    def widget(self) -> Any:
        """A widget of notebooks: see `clvol.view.notebook.Widget` (``pip install clvol[view]``)."""
        from clvol.view.notebook import Widget

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
    """Show a view below the cell of a notebook: see `clvol.view.notebook.show`."""
    from clvol.view import notebook

    notebook.show(view)
