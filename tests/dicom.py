"""Elements of DICOM files, for tests."""

from __future__ import annotations

import struct

__all__ = ["element", "sequence"]


def element(tag: int, kind: str, value: str | bytes) -> bytes:
    """One element of an explicit, little-endian file."""
    group, number = tag >> 16, tag & 0xFFFF
    content = value.encode() if isinstance(value, str) else value
    content += (b"\0" if kind == "UI" else b" ") * (len(content) % 2)
    if kind in ("OB", "OW", "SQ"):
        return struct.pack("<HH2sHI", group, number, kind.encode(), 0, len(content)) + content
    return struct.pack("<HH2sH", group, number, kind.encode(), len(content)) + content


def sequence(tag: int, *items: bytes) -> bytes:
    """A sequence of items, each a list of elements."""
    return element(tag, "SQ", b"".join(struct.pack("<HHI", 0xFFFE, 0xE000, len(item)) + item for item in items))
