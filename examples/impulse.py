"""Impulse responses: each filter's reconstruction of one sample among zeros, over the sinc.

The prefilter and the hybrid's magnification are part of it.

    python examples/impulse.py --output impulse.png
"""

from __future__ import annotations

from _script import make, options_for


def main() -> None:
    options = options_for(__doc__, "impulse.png")
    make("impulse", options)


if __name__ == "__main__":
    main()
