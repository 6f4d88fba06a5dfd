"""Names and texts of files, written where control characters would do harm: terminals, comments, pages."""

from __future__ import annotations

import re

__all__ = ["printable"]

# control characters, line separators, signs that reverse what follows, halves of characters
_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")


def printable(text: str) -> str:
    r"""The text on one line, with an escape such as ``\x1b`` or ``\n`` in place of each character that controls others."""
    return _CONTROL.sub(lambda found: found[0].encode("unicode_escape").decode("ascii"), text)
