"""How a device evaluates a filter: by direct taps or by paired fetches, from a buffer or from an image."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from clvol.base.checks import one_of
from clvol.base.errors import DeviceError, OptionError

if TYPE_CHECKING:
    from clvol.device import Device
    from clvol.filter.filter import Filter

__all__ = ["DIRECT", "SAMPLE_BITS", "Evaluator", "choose_evaluator", "require_direct"]


SAMPLE_BITS = 20.0
"""Least bits of a sampler's fraction for which "auto" chooses it."""

_PAIRED = ("paired", "eight-fetch")


class Evaluator(NamedTuple):
    """How a kernel evaluates the function.

    Parameters
    ----------
    paired : bool
        Whether one linear fetch serves two taps along each axis (Sigg and Hadwiger, GPU Gems 2, chapter 20). Four taps
        an axis take 8 fetches in 3-D and 4 in 2-D, hence "eight-fetch" as another name; six taps take 27 in 3-D.
    image : bool
        Whether coefficients are read from an image, not from a buffer.
    """

    paired: bool
    image: bool

    def __str__(self) -> str:
        return f"{'paired' if self.paired else 'taps'} from {'an image' if self.image else 'a buffer'}"


DIRECT = Evaluator(paired=False, image=False)
"""Direct taps from a buffer, which suit a CPU."""


def _require_names(evaluator: str, fetch: str) -> None:
    """Raise `OptionError` for an unknown evaluator or fetch."""
    if evaluator not in ("auto", "taps", *_PAIRED):
        raise one_of("evaluator", evaluator, ("auto", "taps", *_PAIRED))
    if fetch not in ("auto", "buffer", "image"):
        raise one_of("fetch", fetch, ("auto", "buffer", "image"))


def require_direct(device: Device, what: str) -> None:
    """Raise `OptionError` if the device's limits name another evaluator than `DIRECT`; `what` is read by it: "bricks are"."""
    limits = device.limits
    _require_names(limits.evaluator, limits.fetch)
    if limits.fetch == "image" or limits.evaluator not in ("auto", "taps"):
        raise OptionError(f"{what} read by direct taps from buffers; got evaluator {limits.evaluator!r} and fetch {limits.fetch!r}")


def choose_evaluator(device: Device, filter: Filter, *, bits: float = SAMPLE_BITS, double: bool = False) -> Evaluator:
    """The evaluator that the device's limits name, else the one that suits the device and the filter.

    CPUs sample images in software, so they use direct taps from a buffer. Other devices use paired fetches from the texture unit
    if it was measured to interpolate with at least `bits` bits. ``with device.limited(evaluator="taps", fetch="buffer"):`` forces
    a choice; but a filter whose weights change sign within a pair of taps is evaluated by direct taps, and images hold no float64
    (`double`).
    """
    evaluator, fetch = device.limits.evaluator, device.limits.fetch
    _require_names(evaluator, fetch)
    if double and fetch == "image":
        raise OptionError("fetch must be 'buffer' or 'auto' where precision is 'double': images hold float32; got 'image'")
    if fetch == "image" and not device.has_images:
        raise DeviceError(f"fetch='image' needs 3-D float images; {device.name} has none: use fetch='buffer'")
    image = fetch == "image"
    textures = device.kind != "cpu" and fetch != "buffer" and evaluator != "taps"
    if fetch == "auto" and textures and not double:
        image = filter.pairable(0) and device.has_images and device.sampler_bits >= bits
    paired = evaluator in _PAIRED or (evaluator == "auto" and image and device.kind != "cpu")
    paired = paired and filter.pairable(0)
    if paired and image and device.sampler_bits == 0:
        raise DeviceError(f"{device.name} does not interpolate float images; use evaluator='taps' or fetch='buffer'")
    return Evaluator(paired, image)
