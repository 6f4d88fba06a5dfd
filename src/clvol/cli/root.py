"""The command itself, to which the other modules add their subcommands."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from cyclopts import App, Group, Parameter

__all__ = ["DATA", "FILTERS", "PICTURES", "SETUP", "app", "command"]

PICTURES = Group("Pictures", sort_key=1)
DATA = Group("Data", sort_key=2)
FILTERS = Group("Filters and looks", sort_key=3)
SETUP = Group("Set-up", sort_key=4)

_EXAMPLES = (
    "clvol info head.nii.gz",
    "clvol render head.nii.gz -o head.png",
    "clvol view head.nii.gz",
    "clvol render chest/ -o bones.png --preset ct-bone",
    "clvol render cells.ome.tif -o nuclei.png --channel DAPI --mode mip",
    "clvol render tooth.nhdr -o tooth.png --mode isosurface --threshold 900",
    "clvol pyramid brain.tif -o brain.zarr",
    "clvol resample head.nii.gz -o fine.nii.gz --to-spacing 0.5 0.5 0.5",
)
_BREAK = "  \n"  # a line break in Markdown
_EPILOGUE = f"""Examples:{_BREAK}{_BREAK.join(_EXAMPLES)}

'clvol COMMAND --help' describes each; 'clvol completion --help' says how to set up the Tab key.
"""


def _version() -> str:
    from importlib.metadata import version  # slow to import, and rarely needed

    return version("clvol")


app = App(
    name="clvol",
    help="Volume rendering and reconstruction with B-splines, on OpenCL.",
    help_epilogue=_EPILOGUE,
    version=_version,
    default_parameter=Parameter(negative_iterable=()),
    suppress_keyboard_interrupt=False,
)


def command(group: Group, *, show: bool = True) -> Callable[[Any], Any]:
    """A decorator that makes a function a command of a group; only the help of ``clvol`` has examples."""
    return app.command(group=group, show=show, help_epilogue="")
