"""Error against time per sample, all filters on one plot: which filter should I use?

No filter is both faster and better than those on the line.

    python examples/cost.py --output cost.png
"""

from __future__ import annotations

from _script import make, options_for


def main() -> None:
    options = options_for(__doc__, "cost.png")
    options.add_argument("--samples", type=int, default=41, help="of the function along each axis")
    options.add_argument("--points", type=int, default=20000, help="random positions that are compared")
    make("cost", options)


if __name__ == "__main__":
    main()
