"""The command `clvol view`: a page in a browser, drawn by this machine."""

from __future__ import annotations

import os
import sys
import threading
import time
import webbrowser
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Group, Parameter

from clvol import phantoms
from clvol.base import html, memory
from clvol.base.errors import ClvolError, FormatError, OptionError, OutOfMemoryError
from clvol.base.printable import printable
from clvol.bricks.source import too_large
from clvol.cli.media import Others
from clvol.cli.options import (
    DeviceName,
    FilterName,
    Furniture,
    Input,
    Look,
    ModeOptions,
    Source,
    Whole,
    bytes_text,
    is_address,
    own_options,
)
from clvol.cli.root import PICTURES, command
from clvol.cli.words import in_the_shell
from clvol.filter.boundary import chosen_boundary
from clvol.formats.guarded.limits import size_of

if TYPE_CHECKING:
    from clvol.view import View
    from clvol.view.finer import Finer
    from clvol.view.hosts.server import Server
    from clvol.volume.volume import Volume
    from clvol.volume.volumes import Volumes

__all__ = ["view"]

_SERVER = Group("The server", sort_key=1)
_GRACE = 0.25  # seconds for an open browser to load the page
_REHEARSED = 32  # samples along each axis
_UNPACKED = 100  # bytes of samples and coefficients per stored byte, at most


@command(PICTURES)
def view(
    source: Source,
    /,
    *,
    filter: Annotated[FilterName | None, Parameter(show_default=False)] = None,
    device: DeviceName = None,
    terminal: Annotated[bool, Parameter(negative="")] = False,
    desktop: Annotated[bool, Parameter(negative="")] = False,
    serve: Annotated[bool, Parameter(negative="", group=_SERVER)] = False,
    port: Annotated[Whole, Parameter(group=_SERVER)] = 0,
    host: Annotated[str, Parameter(group=_SERVER)] = "127.0.0.1",
    root_path: Annotated[str, Parameter(group=_SERVER)] = "",
    allow_host: Annotated[tuple[str, ...], Parameter(group=_SERVER)] = (),
    allow_frame: Annotated[tuple[str, ...], Parameter(group=_SERVER)] = (),
    certificate: Annotated[Path | None, Parameter(group=_SERVER)] = None,
    key: Annotated[Path | None, Parameter(group=_SERVER)] = None,
    idle: Annotated[float, Parameter(group=_SERVER)] = 30.0,
    clients: Annotated[Whole, Parameter(group=_SERVER)] = 8,
    input: Input | None = None,
    look: Look | None = None,
    own: ModeOptions | None = None,
    furniture: Furniture | None = None,
    others: Others | None = None,
) -> None:
    """Show a volume in a browser: turn it, cut it, change its colours. Ctrl-C ends it.

    The printed address contains a token: whoever has the address can look. If the volume is stored in several sizes, the largest
    one that fits, with its coefficients, into half of the available memory is resident; a picture at rest that shows more detail
    reads finer sizes by bricks. If a file with several times or channels is small beside that memory, all are read and the panel
    chooses; else only the one chosen here. Beside other volumes it is one, of which no finer size is read; the panel is of SOURCE.

    Parameters
    ----------
    filter
        How it is reconstructed between its samples; see 'clvol filters'. [default: bspline3(auto), which smooths the noise that it
        finds; bspline3 in modes that show extremes, such as mip]
    terminal
        Show it in this terminal, in 24-bit colours; arrow keys turn it, q quits. Without a keyboard it prints one still picture.
    desktop
        Show it in a separate window, by Qt (pip install "clvol[desktop]").
    serve
        Do not open a browser here: the page is for another machine.
    port
        The port of the server; 0 takes a free one.
    host
        Address to listen on. Any but that of this machine itself makes the page reachable for others.
    root_path
        Path under which a proxy serves the page, such as /user/ada/clvol.
    allow_host
        Host name by which a proxy serves the page, such as hub.example.org; may be repeated.
    allow_frame
        Site that may show the page in a frame, such as https://hub.example.org; may be repeated.
    certificate
        PEM file with the certificate for https; it may contain the key.
    key
        PEM file with the key of the certificate.
    idle
        Minutes without a message until a page is disconnected and its memory freed.
    clients
        The most pages open at once.
    """
    look = look or Look()
    options = own_options(look, own, shown=False, colored=others is not None and others.colors is not None)
    options |= furniture.options() if furniture else {}
    reader = input or Input()
    name = str(source)
    if not (name.startswith("phantom:") or is_address(name) or Path(name).exists()):
        raise FormatError(f"cannot read {source}: there is no such file or folder")
    if not idle > 0:
        raise OptionError(f"--idle must be above 0; got {idle:g}")

    wanted = partial(_wanted, others, reader, name, filter, device, look, options)
    if terminal or desktop:
        if terminal + desktop + serve > 1:
            raise OptionError("give one of --terminal, --desktop and --serve")
        if desktop:
            from clvol.view.hosts.desktop import require_display, show_on_desktop

            require_display()  # before the volume is read
            show_on_desktop(wanted())
        else:
            from clvol.view.hosts.terminal import show_in_terminal

            show_in_terminal(wanted())
        return
    made: Future[View] = Future()  # started before the server is imported, which takes as long as reading a small file

    def make() -> None:
        try:
            made.set_result(wanted())
        except BaseException as error:
            made.set_exception(error)

    reading = threading.Thread(target=make, name="clvol: reading", daemon=True)
    reading.start()
    from clvol.view.hosts.server import Limits, Server, run, said

    server = Server(
        made.result,
        host=host,
        port=port,
        names=allow_host,
        root_path=root_path,
        frame_ancestors=allow_frame,
        certificate=certificate,
        key=key,
        limits=Limits(clients=clients, idle=60 * idle),
        doing=f"reading {Path(name).name}",
        folder=Path(name).absolute().parent if Path(name).exists() else None,
    )

    def failed(error: BaseException) -> bool:
        """Print the error, which the page shows too; a wrong command line ends the command instead."""
        if isinstance(error, OptionError):
            return False
        words = in_the_shell(error, ["view"]) if isinstance(error, ClvolError) else said(error)
        print(f"clvol: {printable(words)}", file=sys.stderr, flush=True)
        return True

    def rehearse() -> None:
        """Build kernels while the file is read."""
        shown = replace(look, preset=None, clip=None, clip_plane=(), clip_corner=())  # these may not suit another volume
        with suppress(Exception):  # errors are reported with the volume, or on each page
            _made((phantoms.marschner_lobb(_REHEARSED), None, None), name, filter, device, shown, options).rehearse()

    def prepare() -> None:
        """Prepare the first picture while the browser starts."""
        try:
            view = made.result()
            until = time.monotonic() + _GRACE
            while not server.clients and time.monotonic() < until:
                time.sleep(_GRACE / 16)
            if not server.clients:  # the session of an open page gets to its first picture sooner in its own order
                view.prepare()
        except Exception as error:  # errors of the file are reported already; those of the device, by each page too
            if made.exception() is None:
                failed(error)

    def ready(server: Server) -> None:
        print(server.url, flush=True)
        if server.public:
            safe = "" if certificate is not None else " It is not encrypted: give --certificate, or put a proxy in front."
            _note(f"other machines reach this page, at {server.elsewhere}; whoever has the address can look.{safe}")
        if not serve:
            _open(server.ticket())
        threading.Thread(target=rehearse, name="clvol: rehearsal", daemon=True).start()
        threading.Thread(target=prepare, name="clvol: first picture", daemon=True).start()

    why = run(server, ready, failed)
    if isinstance(why, OptionError):
        raise why
    _leave(1 if why is not None else 0, reading)


def _read(reader: Input, name: str, device: str | None = None) -> tuple[Volume | Volumes, str | None, Finer | None]:
    """What to show, the call in Python that reads it, and, if only a smaller size fits into memory, the finer ones."""
    if not is_address(name) and _is_small(name):
        return *_all(reader, name), None
    lazy = reader.by_parts(name, too_large)
    if lazy is None:
        return reader.read(name), reader.python(name), None
    from clvol.bricks.source import needed_by
    from clvol.view.finer import Finer, resident_level

    sizes = (lazy, *lazy.levels)
    try:
        level = resident_level(lazy)
    except OutOfMemoryError:
        smaller = "its smallest size" if lazy.levels else "it"
        raise OutOfMemoryError(
            f"out of memory: the volume of a view must fit into the {bytes_text(memory.available())} that are available, "
            f"with its coefficients; {smaller} takes {bytes_text(needed_by(sizes[-1]))}: 'clvol pyramid {name} -o NAME.zarr' makes "
            "smaller sizes, one of which 'clvol view' keeps in memory; 'clvol render' draws by bricks"
        ) from None
    finer = None
    if level:
        _note(
            f"{name} takes {bytes_text(needed_by(lazy))} with its coefficients; in memory is level "
            f"{(reader.level or 0) + level}, of {html.numbers(sizes[level].shape)} samples: bricks of finer ones are read where "
            "a picture at rest shows more"
        )
        finer = Finer(lazy, level, reader.python_opened(name), device)
        reader = replace(reader, level=(reader.level or 0) + level)
    return sizes[level].whole() if is_address(name) else reader.read(name), reader.python(name), finer


def _all(reader: Input, name: str) -> tuple[Volume | Volumes, str | None]:
    """All volumes of a small file on one grid; along axes for which an index was given, only that one."""
    if name.startswith("phantom:") or reader.volume is not None or reader.is_changed or reader.leading(name).total == 1:
        return reader.read(name), reader.python(name)
    found = reader.read_all(name)
    if len(found) == 1:  # an index was given for each axis
        return found.first, reader.python(name)
    python = reader.python(name)
    return found, None if python is None else python.replace("clvol.read(", "clvol.read_all(", 1)


def _is_small(name: str) -> bool:
    """Whether a file surely fits into memory, even if compressed. (Opening it to find out takes half a second.)"""
    if name.startswith("phantom:"):
        return True
    stored, _ = size_of(Path(name))
    return stored is not None and _UNPACKED * stored < memory.available()


def _made(
    found: tuple[Volume | Volumes, str | None, Finer | None],
    name: str,
    filter: str | None,
    device: str | None,
    look: Look,
    own: dict[str, Any],
) -> View:
    """The view of what `_read` found."""
    from clvol.view import View
    from clvol.volume.volumes import Volumes

    scene, source, finer = found
    volume = scene.first if isinstance(scene, Volumes) else scene
    shown = (volume.name if scene is volume else "") or Path(name).name
    options = look.named(volume) | own | {"filter": filter, "boundary": chosen_boundary(look.boundary)}
    return View(scene, device=device, source=source, name=shown, finer=finer, limits=look.limits(), **options)


def _wanted(
    others: Others | None, reader: Input, name: str, filter: str | None, device: str | None, look: Look, own: dict[str, Any]
) -> View:
    """The view that the command line asks for, of one volume or of several media."""
    from clvol.view import View

    if others is None:
        return _made(_read(reader, name, device), name, filter, device, look, own)
    volume = others.first(reader).open(name)
    options = look.named(volume.preview()) | own | {"filter": filter, "boundary": chosen_boundary(look.boundary)}
    (scene,) = others.drawn([volume], options, name, reader, Input().open)
    return View(scene, device=device, name=Path(name).name, limits=look.limits(), **options)


def _open(url: str) -> None:
    """Open the desktop's browser, in a thread: some browsers block."""
    if sys.platform not in ("win32", "darwin") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        _note("there is no desktop here: open the address in a browser, with --port and a tunnel from another machine")
        return

    def work() -> None:
        if not webbrowser.open(url):
            _note("no browser was found: open the address by hand")

    threading.Thread(target=work, name="clvol: browser", daemon=True).start()


def _note(text: str) -> None:
    print(f"clvol: note: {text}", file=sys.stderr, flush=True)


def _leave(code: int, reading: threading.Thread) -> None:
    """Exit now if another thread still reads or draws: Python would shut down under it."""
    reading.join(0.2)
    if any(thread.name.startswith("clvol") for thread in threading.enumerate()):
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    raise SystemExit(code)
