"""Transfer functions in JSON, as files and a viewer's states have them: what `TransferFunction.json` gives."""

from __future__ import annotations

import json
import os
from typing import Any

from clvol.base.checks import as_object, as_path, number
from clvol.base.errors import ClvolError, FormatError, OptionError
from clvol.scene.joint import TransferFunction2D
from clvol.scene.transfer import FACTORS, TransferFunction

__all__ = ["read_transfer", "transfer_of"]

_LARGEST = 1 << 25  # bytes of a file
_SHARED = {"unit_distance", *FACTORS}
_JOINT = {"boxes", "arches", "image"}


def read_transfer(path: str | os.PathLike[str]) -> TransferFunction:
    """Read a transfer function from a file of `TransferFunction.save`, or of the viewer.

    Parameters
    ----------
    path : path-like
        A file of JSON: ``{"points": [[value, [red, green, blue], opacity], ...]}``, or
        ``{"boxes": [[[value, value], [gradient, gradient], color, opacity], ...], "arches": [...]}``, in which null is no upper
        limit; either may have "unit_distance", "gradient_opacity" and "curvature_opacity".

    Returns
    -------
    TransferFunction
        Or `TransferFunction2D`, if it has shapes or an image.

    Raises
    ------
    FormatError
        The file cannot be read, or holds anything else.

    Examples
    --------
    >>> import clvol
    >>> path = clvol.TransferFunction2D([((0.2, 0.8), (0.05, None), "gold", 0.6)]).save("edges.json")
    >>> edges = clvol.read_transfer(path)
    """
    path = as_path(path)
    try:
        size = path.stat().st_size
        value = json.loads(path.read_text(encoding="utf-8-sig")) if size <= _LARGEST else None
    except (OSError, ValueError, RecursionError) as error:
        raise FormatError(f"{path} must be a transfer function in JSON: {error}") from error
    if size > _LARGEST:
        raise FormatError(f"{path} must be a transfer function in JSON, of up to {_LARGEST} bytes; it has {size}")
    try:
        return transfer_of("transfer", value)
    except OptionError as error:
        raise FormatError(f"{path}: {error}") from error


def transfer_of(what: str, value: object) -> TransferFunction:
    """The function that a value of JSON describes; `OptionError` if it describes none."""
    given = as_object(what, value, _SHARED | (_JOINT if isinstance(value, dict) and _JOINT & value.keys() else {"points"}))
    parts = () if given.keys() & _JOINT else _apart(f"{what}.points", given.pop("points", None))
    try:
        return TransferFunction(*parts, **given) if parts else TransferFunction2D(**given)
    except ClvolError as error:
        raise OptionError(f"{what}: {error}") from None


def _apart(what: str, points: Any) -> tuple[Any, ...]:
    """Colours and opacities of points."""
    rule = f"{what} must be one or more of [value, [r, g, b], opacity]"
    if not isinstance(points, (list, tuple)) or not points:
        raise OptionError(f"{rule}; got {points!r:.200}")
    for point in points:
        if not isinstance(point, (list, tuple)) or len(point) != 3:
            raise OptionError(f"{rule}; got {point!r:.200}")
    seen = [(at, number(f"an opacity of {what}", opacity, minimum=0, maximum=1)) for at, _, opacity in points]
    return [(at, color) for at, color, _ in points], seen
