"""The command line of the figure examples: draw the figure, write it, print its numbers."""

from __future__ import annotations

import argparse

import clvol
from clvol.figures import draw


def options_for(text: str | None, output: str) -> argparse.ArgumentParser:
    """A parser of ``--output`` alone."""
    parser = argparse.ArgumentParser(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", default=output, help="the figure to write: .png, .svg, .pdf")
    return parser


def make(name: str, parser: argparse.ArgumentParser) -> None:
    """Draw a figure of `clvol.figures.FIGURES`: all options but the output are its own; a scan is a file name."""
    options = vars(parser.parse_args())
    output = options.pop("output")
    try:
        if options.get("scan") is not None:
            options["scan"] = clvol.read(options["scan"])
        drawing = draw(name, **options)
        written = drawing.save(output)
    except clvol.ClvolError as error:
        raise SystemExit(f"{type(error).__name__}: {error}") from None
    print(*drawing.lines, sep="\n")
    print(written)
