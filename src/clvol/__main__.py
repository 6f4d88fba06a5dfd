"""``python -m clvol``: the command."""

from __future__ import annotations

from clvol.cli import main

if __name__ == "__main__":
    main()
