"""Every filter, derivative, mode and route by the kernels of a device, beside the reference in NumPy (float64).

    python -m bench.parity

prints a line of JSON for each route and work, as soon as it is done. `bench.gpu` and `bench.runtimes` make tables of them.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import ClvolError
from clvol.device import Device, as_device
from clvol.filter.table import filters
from clvol.march.frame import BY_PLANES, BY_RAYS
from clvol.march.renderer import Renderer
from clvol.scene.mode import modes
from tests.march import agreement as pictures
from tests.spline import agreement as points

__all__ = ["ROUTES", "WORKS", "Row", "planned", "rows"]

ROUTES: dict[str, dict[str, Any]] = {
    "taps": {"evaluator": "taps", "fetch": "buffer", "tile": BY_RAYS},
    "paired, images": {"evaluator": "paired", "fetch": "image", "tile": BY_RAYS},
    "planes": {"evaluator": "taps", "fetch": "buffer", "tile": BY_PLANES},  # rays of a work-item share the plane under them
}
DERIVATIVES = ("value", "gradient", "curvature")
MODES = tuple(name for name, mode in modes().items() if not mode.regions)
WORKS = (*DERIVATIVES, *MODES)


@dataclass
class Row:
    """What the filters err by in one work by one route, of the filter that comes nearest to what it may err by.

    Attributes
    ----------
    count : int
        Filters that were compared.
    worst : str
        That filter.
    most, rms, tolerance : float
        Of points in units of the greatest coefficient, and for derivatives of the reciprocal spacing and its square; of pictures
        in those of colours, over the pixels in which rounding may not decide.
    failed : list of str
        Filters that differ by more, or that the runtime could not do, and why.
    seconds : float
        Building the kernels included.
    """

    route: str
    work: str
    count: int = 0
    worst: str = ""
    most: float = 0.0
    rms: float = 0.0
    tolerance: float = 1.0
    failed: list[str] = field(default_factory=list)
    seconds: float = 0.0

    def add(self, name: str, compared: Callable[[], tuple[NDArray[Any], float]]) -> None:
        """Count the differences of a filter, and what they may be."""
        self.count += 1
        try:
            difference, tolerance = compared()
        except (AssertionError, ClvolError) as error:
            self.failed.append(f"{name}: {error}")
            return
        most, rms = float(difference.max()), float(np.sqrt(np.mean(difference**2)))
        if not most <= tolerance:
            self.failed.append(f"{name}: {most:.2g}")
        if not self.worst or not most / tolerance <= self.most / self.tolerance:
            self.worst, self.most, self.rms, self.tolerance = name, most, rms, tolerance


def planned(device: Device) -> Iterator[tuple[str, str]]:
    """Routes and works of a device."""
    for route, ways in ROUTES.items():
        if ways["fetch"] != "image" or (device.has_images and device.sampler_bits):
            for work in WORKS:
                if work in MODES or ways["tile"] != BY_PLANES:  # points have no planes
                    yield route, work


def rows(device: Device, *, whole: bool = True) -> Iterator[Row]:
    """All of them: points by every filter, pictures by every filter in every mode.

    Pictures by the routes that the device would not take (if not `whole`: by every route) meet every mode with two filters, and
    every filter with some mode.
    """
    usual = "planes" if device.kind == "cpu" else "taps"  # a texture unit of few bits would not say much of the kernels
    for route, work in planned(device):
        begun, row, ways, i = time.perf_counter(), Row(route, work), ROUTES[route], WORKS.index(work)
        names = [name for name, kind in filters().items() if ways["evaluator"] == "taps" or kind.pairable(0)]
        if work in MODES and not (whole and route == usual):
            some = {"linear", "bspline3", *names[i % len(MODES) :: len(MODES)]}
            names = [name for name in names if name in some]
        for name in names:
            row.add(name, partial(_picture, device, name, work, ways) if work in MODES else partial(_points, device, name, i, ways))
        row.seconds = time.perf_counter() - begun
        yield row


def _points(device: Device, name: str, derivative: int, ways: dict[str, Any]) -> tuple[NDArray[Any], float]:
    volume, path = points.volume_of((5, 6, 7)), (ways["evaluator"], ways["fetch"])
    at = volume.index_to_world(points.points_of(volume))
    return points.errors(device, volume, at, name, "mirror", derivative, path), points.allowed(device, name, path, derivative)


def _picture(device: Device, name: str, mode: str, ways: dict[str, Any]) -> tuple[NDArray[Any], float]:
    allowed = pictures.allowance(name, mode, device, ways)
    with Renderer(pictures.block(), name, device=device) as renderer:
        got, want = pictures.both(renderer, pictures.CAMERA, mode, ways=ways)
    pictures.compare(got, want, allowed)  # depths, places and normals too
    difference = np.sort(np.abs(got["rgba"] - want["rgba"]).max(-1), axis=None)
    return difference[: difference.size - int(allowed.pixels * difference.size)], allowed.rgba


def main() -> None:
    """Print them, without the pictures that take most time."""
    device = as_device()
    driver, version = (str(getattr(device.handle, name)).strip() for name in ("driver_version", "version"))
    print(json.dumps({"device": device.name, "platform": device.platform, "driver": driver, "version": version}), flush=True)
    for row in rows(device, whole=False):
        print(json.dumps(asdict(row)), flush=True)


if __name__ == "__main__":
    main()
