"""What the automatic look of a volume follows from, computed once from all of its samples and kept beside them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, cast

import numpy as np

from clvol.base.errors import FormatError
from clvol.noise import Noise, estimate
from clvol.volume.histogram import Matter, Projection, clims_of, matter_of, remember
from clvol.volume.smoothing import Smoothing, choice, remember_smoothing
from clvol.volume.volume import Volume

__all__ = ["VERSION", "Statistics"]

VERSION = 1
"""Of what `json` gives; others are not read."""

_DEGREES = range(2, 10)  # of splines that smooth


@dataclass(frozen=True)
class _Sampled:
    """What the estimates read of a volume: slices of its samples."""

    data: Any
    value_range: tuple[float, float]
    noise: Noise
    ndim: int = 3


@dataclass(frozen=True)
class Statistics:
    """What is found in a volume's histogram and noise.

    Parameters
    ----------
    value_range : (float, float)
        The smallest and the largest sample.
    matter : Matter
    clims : mapping
        Black and white of each projection.
    noise : Noise
        Without its spectrum.
    smoothing : mapping
        By the degree of the spline.
    """

    value_range: tuple[float, float]
    matter: Matter
    clims: Mapping[Projection, tuple[float, float]]
    noise: Noise
    smoothing: Mapping[int, Smoothing]

    @classmethod
    def of(cls, data: Any, value_range: tuple[float, float]) -> Statistics:
        """Of finite samples [z, y, x] that are read by slices; the same as of a volume in memory."""
        noise = estimate(data)
        sampled = cast(Volume, _Sampled(data, value_range, noise))
        chosen = {degree: choice(sampled, degree) for degree in _DEGREES}
        found = matter_of.__wrapped__(sampled), clims_of.__wrapped__(sampled)  # type: ignore[attr-defined]  # of `wraps`
        return cls(value_range, *found, replace(noise, spectrum=None), chosen)  # type: ignore[arg-type]  # as `Noise` has it

    def known_to(self, volume: Volume) -> Volume:
        """The volume, of fewer samples, with these in place of its own."""
        vars(volume).update(limits=self.value_range, value_range=self.value_range, noise=self.noise)
        remember(volume, self.matter, dict(self.clims))
        remember_smoothing(volume, self.smoothing)
        return volume

    def json(self) -> dict[str, Any]:
        """A value for JSON, about 2 KiB."""
        noise = {name: value for name, value in vars(self.noise).items() if name != "spectrum"}
        return {
            "version": VERSION,
            "value_range": self.value_range,
            "matter": asdict(self.matter),
            "clims": dict(self.clims),
            "noise": noise,
            "smoothing": {str(degree): asdict(one) for degree, one in self.smoothing.items()},
        }

    @classmethod
    def from_json(cls, given: Mapping[str, Any]) -> Statistics | None:
        """What `json` gave; None of another version. `FormatError` if it is something else."""
        if given.get("version") != VERSION:
            return None
        try:
            low, high = map(float, given["value_range"])
            noise: dict[str, Any] = {name: tuple(v) if isinstance(v, list) else v for name, v in given["noise"].items()}
            smoothing = {
                int(degree): Smoothing(**(one | {"values": tuple(one["values"])})) for degree, one in given["smoothing"].items()
            }
            made = cls(
                (low, high),
                Matter(**given["matter"]),
                {name: (float(a), float(b)) for name, (a, b) in given["clims"].items()},
                Noise(**noise),
                smoothing,
            )
            numbers = [low, high, *(end for ends in made.clims.values() for end in ends), made.matter.isovalue, made.noise.sigma]
            if not (
                np.isfinite(numbers).all() and made.clims.keys() == {"max", "min", "mean"} and made.smoothing.keys() == {*_DEGREES}
            ):
                raise ValueError("numbers must be finite, and none may be missing")
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise FormatError(f"the statistics of the samples must be those that clvol.pyramid wrote: {error!r}") from error
        return made
