"""The command itself, to which the modules beside it add theirs."""

from __future__ import annotations

from importlib.metadata import version

from cyclopts import App, Group, Parameter

__all__ = ["DATA", "FILTERS", "PICTURES", "SETUP", "app"]

PICTURES = Group("Pictures", sort_key=1)
DATA = Group("Data", sort_key=2)
FILTERS = Group("Filters and looks", sort_key=3)
SETUP = Group("Set-up", sort_key=4)

_EXAMPLES = """
Examples:

clvol info head.nii.gz

clvol render head.nii.gz -o head.png

clvol render chest/ -o bones.png --preset ct-bone

clvol render cells.ome.tif -o nuclei.png --channel DAPI --mode mip

clvol render tooth.nhdr -o tooth.png --mode isosurface --threshold 900

clvol resample head.nii.gz -o fine.nii.gz --to-spacing 0.5 0.5 0.5

clvol completion bash tells how to have names completed by the Tab key; 'clvol COMMAND --help' says more of each.
"""

app = App(
    name="clvol",
    help="Volume rendering and reconstruction with B-splines, on OpenCL.",
    help_epilogue=_EXAMPLES,
    version=lambda: version("clvol"),
    default_parameter=Parameter(negative_iterable=()),
    suppress_keyboard_interrupt=False,
)
