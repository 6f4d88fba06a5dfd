"""What the automatic look of a volume follows from, computed once from all of its samples and kept beside them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from clvol.base.errors import FormatError
from clvol.base.scaling import exponent_of
from clvol.noise import Noise, estimate
from clvol.volume.evenly import places_of
from clvol.volume.histogram import Matter, Projection, clims_of, labels_in, matter_of, remember, spread_in
from clvol.volume.smoothing import Smoothing, choice, remember_smoothing
from clvol.volume.volume import Volume

__all__ = ["VERSION", "Statistics"]

VERSION = 2
"""Of what `json` gives; others are not read."""

Part: TypeAlias = tuple[tuple[slice, ...], NDArray[Any]]
"""Some samples [z, y, x], and their place in the whole."""

_DEGREES = range(2, 10)  # of splines that smooth
_MOST_LABELS = 1 << 22


@dataclass(frozen=True)
class _Sampled:
    """What the estimates read of a volume: slices of its samples."""

    data: Any
    value_range: tuple[float, float]
    noise: Noise
    ndim: int = 3


@dataclass(frozen=True)
class Statistics:
    """What is found in all samples of a volume.

    Parameters
    ----------
    value_range : (float, float)
        The smallest and the largest sample.
    matter : Matter, optional
        This and what follows is of values, and not of labels.
    clims : mapping
        Black and white of each projection.
    noise : Noise, optional
        Without its spectrum.
    smoothing : mapping
        By the degree of the spline.
    spread : (float, float), optional
        Mean and standard deviation.
    labels : (float, ndarray), optional
        Of labels: the background, and all that occur, in ascending order.
    samples : array-like, optional
        Evenly spaced ones (`clvol.volume.evenly`), [z, y, x]; read when they are needed.
    """

    value_range: tuple[float, float]
    matter: Matter | None = None
    clims: Mapping[Projection, tuple[float, float]] = field(default_factory=dict)
    noise: Noise | None = None
    smoothing: Mapping[int, Smoothing] = field(default_factory=dict)
    spread: tuple[float, float] | None = None
    labels: tuple[float, NDArray[np.float64]] | None = None
    samples: Any = field(default=None, compare=False)

    @classmethod
    def of(cls, data: Any, value_range: tuple[float, float], parts: Iterable[Part], *, labels: bool = False) -> Statistics:
        """Of finite samples [z, y, x] that are read by slices; the same as of a volume in memory.

        `parts` are all of them, each with its place in the whole, and come only once.
        """
        places = tuple(places_of(data.shape))
        samples = np.empty([len(range(*place.indices(n))) for place, n in zip(places, data.shape, strict=True)], data.dtype)
        seen = _collected(parts, places, samples)
        if labels:
            return cls(value_range, labels=labels_in(seen, value_range, data.dtype), samples=samples)
        spread = spread_in(seen, exponent_of(*map(float, value_range)))
        noise = estimate(data)
        sampled = cast(Volume, _Sampled(data, value_range, noise))
        chosen = {degree: choice(sampled, degree) for degree in _DEGREES}
        found = matter_of.__wrapped__(sampled), clims_of.__wrapped__(sampled)  # type: ignore[attr-defined]  # of `wraps`
        return cls(value_range, *found, replace(noise, spectrum=None), chosen, spread, samples=samples)  # type: ignore[arg-type]  # as `Noise` has it

    def known_to(self, volume: Volume) -> Volume:
        """The volume, of fewer samples, with these in place of its own."""
        vars(volume).update(limits=self.value_range, value_range=self.value_range)
        if self.labels is not None:
            remember(volume, label_numbers=self.labels)
        if self.matter is not None:
            vars(volume).update(noise=self.noise)
            remember(volume, matter_of=self.matter, clims_of=dict(self.clims))
            remember_smoothing(volume, self.smoothing)
        if self.spread is not None:
            remember(volume, spread_of=self.spread)
        return volume

    def json(self) -> dict[str, Any]:
        """A value for JSON, about 2 KiB; without the samples."""
        about: dict[str, Any] = {"version": VERSION, "value_range": self.value_range}
        if self.labels is not None:
            background, numbers = self.labels
            return about | {"labels": {"background": background, "runs": _runs(numbers)}}
        assert self.matter is not None
        return about | {
            "matter": asdict(self.matter),
            "clims": dict(self.clims),
            "noise": {name: value for name, value in vars(self.noise).items() if name != "spectrum"},
            "smoothing": {str(degree): asdict(one) for degree, one in self.smoothing.items()},
            "spread": self.spread,
        }

    @classmethod
    def from_json(cls, given: Mapping[str, Any], samples: Any = None) -> Statistics | None:
        """What `json` gave; None of another version. `FormatError` if it is something else."""
        if given.get("version") != VERSION:
            return None
        try:
            made = _labels_of(given) if "labels" in given else _values_of(given)
        except (KeyError, TypeError, ValueError, AttributeError, MemoryError) as error:
            raise FormatError(f"the statistics of the samples must be those that clvol.pyramid wrote: {error!r}") from error
        return replace(made, samples=samples)


def _collected(parts: Iterable[Part], places: tuple[slice, ...], samples: NDArray[Any]) -> Iterator[NDArray[Any]]:
    """The parts, of which each leaves its samples at `places` of the whole."""
    for box, part in parts:
        target, own = [], []
        for place, one in zip(places, box, strict=True):
            before = max(0, -(-(one.start - place.start) // place.step))
            first = place.start + before * place.step - one.start
            count = len(range(first, one.stop - one.start, place.step))
            target.append(slice(before, before + count))
            own.append(slice(first, None, place.step))
        samples[tuple(target)] = part[tuple(own)]
        yield part


def _runs(numbers: NDArray[np.float64]) -> list[list[float]]:
    """First and last of successive whole numbers."""
    ends = np.flatnonzero(np.diff(numbers) != 1)
    firsts, lasts = np.concatenate([[0], ends + 1]), np.concatenate([ends, [len(numbers) - 1]])
    return np.stack([numbers[firsts], numbers[lasts]], axis=1).tolist()  # type: ignore[no-any-return]


def _labels_of(given: Mapping[str, Any]) -> Statistics:
    low, high = map(float, given["value_range"])
    runs = np.asarray(given["labels"]["runs"], np.float64).reshape(-1, 2)
    background = float(given["labels"]["background"])
    if not (np.isfinite([low, high, background, *runs.ravel()]).all() and (runs[:, 0] <= runs[:, 1]).all() and len(runs)):
        raise ValueError("runs of labels must be finite and in ascending order")
    if (runs[:, 1] - runs[:, 0]).sum() > _MOST_LABELS:
        raise ValueError(f"labels must be at most {_MOST_LABELS}")
    numbers = np.concatenate([np.arange(first, last + 1) for first, last in runs])
    return Statistics((low, high), labels=(background, numbers))


def _values_of(given: Mapping[str, Any]) -> Statistics:
    low, high = map(float, given["value_range"])
    noise: dict[str, Any] = {name: tuple(v) if isinstance(v, list) else v for name, v in given["noise"].items()}
    smoothing = {int(degree): Smoothing(**(one | {"values": tuple(one["values"])})) for degree, one in given["smoothing"].items()}
    mean, deviation = map(float, given["spread"])
    made = Statistics(
        (low, high),
        Matter(**given["matter"]),
        {name: (float(a), float(b)) for name, (a, b) in given["clims"].items()},
        Noise(**noise),
        smoothing,
        (mean, deviation),
    )
    assert made.matter is not None
    assert made.noise is not None
    ends = [end for ends in made.clims.values() for end in ends]
    numbers = [low, high, mean, deviation, *ends, made.matter.isovalue, made.noise.sigma]
    if not (np.isfinite(numbers).all() and made.clims.keys() == {"max", "min", "mean"} and smoothing.keys() == {*_DEGREES}):
        raise ValueError("numbers must be finite, and none may be missing")
    return made
