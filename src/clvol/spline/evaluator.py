"""How a device evaluates a filter: direct taps or pairs of taps, from a buffer or from an image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from clvol.checks import one_of
from clvol.device import Device
from clvol.errors import DeviceError
from clvol.filter import Filter

__all__ = ["SAMPLE_BITS", "Evaluator", "EvaluatorName", "FetchName", "choose_evaluator"]

EvaluatorName = Literal["auto", "taps", "eight-fetch"]
FetchName = Literal["auto", "buffer", "image"]

SAMPLE_BITS = 20.0  # of a sampler's fraction, before `sample` and `resample` trust it of themselves


@dataclass(frozen=True)
class Evaluator:
    """How a kernel gets at the function: pairs of taps by linear fetches or not, an image or a buffer."""

    eight_fetch: bool
    image: bool

    def __str__(self) -> str:
        return f"{'eight-fetch' if self.eight_fetch else 'taps'} from {'an image' if self.image else 'a buffer'}"


def choose_evaluator(
    device: Device, filter: Filter, evaluator: str = "auto", fetch: str = "auto", *, bits: float = SAMPLE_BITS
) -> Evaluator:
    """The path to use on a device: as asked, else the one that suits it.

    Processors read buffers by direct taps: they sample images in software. On other devices pairs of
    taps come from the texture unit, if it was measured to interpolate with at least `bits` bits.

    Raises
    ------
    OptionError
        An unknown name.
    DeviceError
        ``fetch="image"`` on a device that has no float images, or whose sampler does not interpolate.
    """
    if evaluator not in ("auto", "taps", "eight-fetch"):
        raise one_of("evaluator", evaluator, ("auto", "taps", "eight-fetch"))
    if fetch not in ("auto", "buffer", "image"):
        raise one_of("fetch", fetch, ("auto", "buffer", "image"))
    if fetch == "image" and not device.has_images:
        raise DeviceError(f"fetch='image' needs 3-D float images; {device.name} has none: use fetch='buffer'")
    image = fetch == "image"
    textures = device.kind != "cpu" and fetch != "buffer" and evaluator != "taps"
    if fetch == "auto" and textures:
        image = filter.pairable(0) and device.has_images and device.sampler_bits >= bits
    eight = evaluator == "eight-fetch" or (evaluator == "auto" and image and device.kind != "cpu")
    eight = eight and filter.pairable(0)
    if eight and image and device.sampler_bits == 0:
        raise DeviceError(f"{device.name} does not interpolate float images; use evaluator='taps' or fetch='buffer'")
    return Evaluator(eight, image)
