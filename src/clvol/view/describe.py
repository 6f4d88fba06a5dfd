"""The description of a volume that a client gets first: its grid, a histogram, and what a panel offers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from clvol.filter.boundary import boundaries
from clvol.filter.table import filters
from clvol.scene.mode import Mode, mode_options, modes
from clvol.scene.preset import presets
from clvol.view.events import KEYS
from clvol.view.state import plain
from clvol.volume.volume import Volume

__all__ = ["description"]

_BINS = 256
_SAMPLED = 1 << 19  # samples of a histogram
_COLOR_MAPS = (
    "gray", "bone", "hot", "viridis", "magma", "inferno", "plasma", "cividis", "turbo", "coolwarm", "cool", "copper", "pink",
    "twilight", "cubehelix", "rainbow",
)  # fmt: skip
_CHOICES: Mapping[str, list[str]] = {"method": ["exact", "stepped"]}
_RANGES: Mapping[str, list[float]] = {"termination": [0, 0.5], "tolerance": [0, 1], "attenuation": [0, 40]}


def description(volume: Volume, title: str, axes: list[dict[str, Any]], labels: tuple[list[list[Any]], int]) -> dict[str, Any]:
    """The `info` message of a volume; `axes` and `labels` are those of `Catalog`."""
    rows, count = labels
    counts, edges = _histogram(volume)
    return {
        "type": "info",
        "title": title,
        "volume": {
            "shape": list(volume.shape),
            "spacing": list(volume.spacing),
            "units": volume.units,
            "range": list(volume.value_range),
            "dtype": str(volume.data.dtype),
            "space": volume.space,
            "labels": bool(volume.is_labels),
            "bounds": [volume.corners.min(0).tolist(), volume.corners.max(0).tolist()],
            "center": volume.center.tolist(),
        },
        "axes": axes,
        "labels": {"count": count, "rows": rows} if volume.is_labels else None,
        "histogram": {"edges": edges, "counts": counts},
        "modes": {name: _options(mode) for name, mode in modes().items()},
        "filters": [*filters(), "bspline3(auto)"],
        "boundaries": list(boundaries()),
        "presets": list(presets()),
        "colormaps": list(_COLOR_MAPS),
        "keys": dict(KEYS),
    }


def _options(mode: Mode) -> dict[str, Any]:
    says = mode_options(mode)
    return {f.name: _option(getattr(mode, f.name), f.name, says[f.name]) for f in fields(mode)}


def _option(default: Any, name: str, says: str) -> dict[str, Any]:
    kind = "flag" if isinstance(default, bool) else "color" if name == "color" else "choice" if name in _CHOICES else "number"
    option = {"kind": kind, "default": plain(default), "help": says}
    if name in _CHOICES:
        option["choices"] = _CHOICES[name]
    if name in _RANGES:
        option["range"] = _RANGES[name]
    return option


def _histogram(volume: Volume) -> tuple[list[int], list[float]]:
    low, high = volume.value_range
    stride = max(1, round(max(1.0, volume.data.size / _SAMPLED) ** (1 / 3)))
    some = volume.data[::stride, ::stride, ::stride].astype(np.float64).ravel()
    some = some[np.isfinite(some)]
    if not low < high:
        low, high = low - 0.5, high + 0.5
    whole = volume.data.dtype.kind in "biu" and high - low < _BINS
    span = (low - 0.5, high + 0.5) if whole else (low, high)  # a bin per value, centred on it
    bins = round(span[1] - span[0]) if whole else _BINS
    counts, edges = np.histogram(some, bins=bins, range=span)
    return [int(n) for n in counts], [float(e) for e in edges]
