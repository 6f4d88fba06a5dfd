"""Error against sampling rate: on log-log axes a line whose slope is the filter's order.

Gradients converge with one order less.

    python examples/convergence.py --output convergence.png
"""

from __future__ import annotations

from _script import make, options_for


def main() -> None:
    options = options_for(__doc__, "convergence.png")
    options.add_argument("--points", type=int, default=20000, help="random positions that are compared")
    make("convergence", options)


if __name__ == "__main__":
    main()
