"""Argument checks and warnings. Each check returns the value in its proper type, or raises an error that states the rule."""

from __future__ import annotations

import difflib
import inspect
import math
import os
import re
import sys
import threading
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from functools import wraps
from numbers import Integral, Real
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

from clvol.base.errors import ClvolError, ClvolWarning, OptionError, OutOfMemoryError

__all__ = [
    "as_object",
    "as_path",
    "did_you_mean",
    "enough_memory",
    "flag",
    "if_image",
    "instance",
    "meant_by",
    "number",
    "one_of",
    "require_known",
    "require_room",
    "several",
    "suggests_options",
    "warn",
    "warned",
    "warned_once",
    "whole",
]

Called = TypeVar("Called", bound=Callable[..., Any])

_WORDS = {
    "opacity": "alpha transparency",
    "background": "bg bgcolor background_color backgroundcolor",
    "cmap": "colormap colourmap color_map colour_map palette lut colortable",
    "color": "colour",
    "value_range": "clim vmin vmax range",
    "window=(center, width), or the clim of the volume": "clim vmin vmax contrast wl ww window_level",
    "clip": "crop bbox roi box subvolume",
    "isovalue": "iso isolevel iso_value iso_level level_set surface",
    "azimuth": "angle rotate rotation yaw",
    "elevation": "tilt pitch",
    "filter": "interpolation interpolator interp kernel spline",
    "boundary": "extend padding extrapolation edge_mode",
    "size=(width, height)": "width height w h resolution res imsize figsize image_size",
    "step": "sampling step_size stepsize sample_distance sampling_rate",
    "rays": "supersampling antialiasing anti_aliasing aa spp samples_per_pixel",
    "device": "gpu platform backend",
    "output": "out outfile out_file save filename dest",
    "to_spacing": "spacing_out out_spacing voxel_size voxelsize resolution res",
    "to_shape": "out_shape output_shape new_shape dimensions",
    "magnify": "scale factor zoom_factor upsample",
    "to_dtype": "out_dtype output_dtype type",
    "spacing": "voxel_size voxelsize pixel_size pixelsize",
    "dtype": "type datatype",
    "byte_order": "endian endianness",
    "offset": "skip header_size",
    "like": "reference ref target",
    "overwrite": "force",
    "memory": "ram mem budget memory_limit max_memory",
    "compressor": "compression codec",
    "chunks": "chunk chunk_size chunksize",
    "levels": "depth nlevels scales",
    "time": "timepoint t",
    "channel": "ch",
    "seconds": "duration length",
    "fps": "framerate frame_rate rate",
    "fill": "cval fill_value",
    "fill_nan": "nan_value missing",
    "workers": "jobs nprocs processes threads",
    "terminal": "tty ascii",
    "projection": "camera_type parallel ortho orthographic",
    "method": "downsampling",
    "render": "draw plot screenshot image",
    "view": "show open display gui",
    "resample": "rescale zoom resize interpolate",
    "movie": "video animate animation",
    "info": "stats header describe",
}
"""Our names, and what other programs call the same."""

_here = threading.local()
_MAX_SAMPLES = 1 << 36  # samples; no machine holds the float64 positions of more


def instance(what: str, value: object, *kinds: type) -> None:
    """Raise `OptionError` unless `value` is an instance of one of `kinds`; the message names the first."""
    if not isinstance(value, kinds):
        raise OptionError(f"{what} must be a {kinds[0].__name__}; got {value!r}")


def flag(what: str, value: object) -> bool:
    """`value` as a bool, if it is a bool or an integer; else `OptionError`."""
    if not isinstance(value, (bool, np.bool_, int)):
        raise OptionError(f"{what} must be True or False; got {value!r}")
    return bool(value)


def one_of(what: str, value: object, allowed: Iterable[str]) -> OptionError:
    """The error for an unknown name: states the rule, the allowed names and the given value."""
    return OptionError(f"{what} must be one of {', '.join(allowed)}; got {value!r}")


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """The known name that is meant by an unknown one, as the end of a message: another program's word, or a similar one."""
    meant = meant_by(name, known)
    return f" (did you mean {meant}?)" if meant else ""


def meant_by(name: str, known: Iterable[str]) -> str:
    """The known name that another program's word stands for, perhaps with a value; else one that resembles it; else ""."""
    known = list(known)
    for ours, words in _WORDS.items():
        if name.lower() in words.split() and re.split(r"\W", ours)[0] in known:
            return ours
    return next(iter(difflib.get_close_matches(name, known, 1)), "")


def as_object(what: str, value: object, known: Collection[str]) -> dict[str, Any]:
    """A mapping all of whose keys are known, as an object of JSON; else `OptionError`."""
    if not isinstance(value, Mapping):
        raise OptionError(f"{what} must be an object of JSON; got {value!r:.200}")
    for key in value:
        if key not in known:
            raise OptionError(f"{what}.{key!s:.60} is no field; {what} has {', '.join(sorted(known))}")
    return dict(value)


def require_known(function: str, options: Mapping[str, object], known: Iterable[str]) -> None:
    """Raise `OptionError` for an option that a function has not."""
    known = list(known)
    for name in options:
        if name not in known:
            raise OptionError(f"{name} is no option of {function}{did_you_mean(name, known)}; it has {', '.join(known)}")


def suggests_options(function: Called) -> Called:
    """Decorate a function, or a class, to suggest the option that an unknown keyword resembles, as Python does from 3.13 on."""
    if isinstance(function, type):
        function.__init__ = suggests_options(function.__init__)  # type: ignore[misc]  # of this class
        return function

    @wraps(function)
    def suggesting(*arguments: Any, **options: Any) -> Any:
        try:
            return function(*arguments, **options)
        except TypeError as error:
            unknown = re.search(r"unexpected keyword argument '(\w+)'$", str(error))
            known = inspect.signature(function).parameters
            if unknown is None or unknown[1] in known or unknown[1] not in options:  # not of this call
                raise
            raise TypeError(f"{error}{did_you_mean(unknown[1], known)}") from None

    return cast(Called, suggesting)


def number(
    what: str,
    value: object,
    *,
    above: float | None = None,
    minimum: float | None = None,
    below: float | None = None,
    maximum: float | None = None,
) -> float:
    """`value` as a float, if it is one finite real number within the bounds; else `OptionError`.

    Accepts real scalars and 0-d arrays of Python and NumPy; booleans and strings are not.
    """
    scalar = _scalar(value)
    try:
        result = float(scalar) if isinstance(scalar, Real) else math.nan
    except OverflowError:  # a whole number or fraction beyond float64
        result = math.inf
    within = (
        math.isfinite(result)
        and (above is None or result > above)
        and (minimum is None or result >= minimum)
        and (below is None or result < below)
        and (maximum is None or result <= maximum)
    )
    if not within:
        bounds = {"greater than": above, "at least": minimum, "less than": below, "at most": maximum}
        raise OptionError(f"{what} must be a finite number{_allowed(bounds)}; got {value!r}")
    return result


def whole(what: str, value: object, minimum: int | None = None, maximum: int | None = None) -> int:
    """`value` as an int, if it is one whole number within the bounds; else `OptionError`.

    Accepts integers of Python and NumPy and 0-d arrays of them, but no booleans or floats.
    """
    scalar = _scalar(value)
    result = int(scalar) if isinstance(scalar, Integral) else None
    if result is None or (minimum is not None and result < minimum) or (maximum is not None and result > maximum):
        bounds = {"at least": minimum, "at most": maximum}
        raise OptionError(f"{what} must be a whole number{_allowed(bounds)}; got {value!r}")
    return result


def if_image(shape: tuple[Any, ...]) -> str:
    """For an image where a volume is needed: where it can go, as the end of a message; else ""."""
    return ": clvol.images resamples, zooms and rotates images" if len(shape) == 2 else ""


def several(what: str, value: object, rule: str, maximum: int | None = None) -> list[Any]:
    """`value` as a list, if it is a sequence of 1 to `maximum` items; else `OptionError`. A string is no sequence here."""
    try:
        result = [] if isinstance(value, (str, bytes)) else list(value)  # type: ignore[call-overload]  # may not be iterable
    except TypeError:
        result = []
    if not result:
        raise OptionError(f"{what} must be {rule}; got {value!r}")
    if maximum is not None and len(result) > maximum:
        raise OptionError(f"{what} must be {rule}, at most {maximum}; got {len(result)}")
    return result


def require_room(what: str, samples: int, value: object) -> None:
    """Raise `OutOfMemoryError` if `value` of the option `what` requests more samples than any machine can hold."""
    if samples > _MAX_SAMPLES:
        raise OutOfMemoryError(f"out of memory: {what} must give at most {_MAX_SAMPLES} samples; got {value!r}")


def warned() -> int:
    """How many times `warn` was called in this thread."""
    return getattr(_here, "warned", 0)


def warn(message: str, kind: str = "") -> None:
    """Warn, pointing at the first caller outside clvol; once of a `kind`, or with a message, in a context of `warned_once`.

    In a context of `heard_by` its listener gets the message instead.
    """
    _here.warned = warned() + 1
    if (hear := _HEARD.get()) is not None:
        hear(message)
        return
    if (told := _TOLD.get()) is not None:
        if (kind or message) in told:
            return
        told.add(kind or message)
    frame, level = sys._getframe(), 1
    while frame.f_back is not None and frame.f_globals.get("__name__", "").startswith("clvol."):
        frame, level = frame.f_back, level + 1
    warnings.warn(message, ClvolWarning, stacklevel=level)


@contextmanager
def warned_once(told: set[str]) -> Iterator[None]:
    """A context for one of several pictures, which repeats no warning that is `told`, and adds its own."""
    token = _TOLD.set(told)
    try:
        yield
    finally:
        _TOLD.reset(token)


@contextmanager
def heard_by(hear: Callable[[str], object]) -> Iterator[None]:
    """A context whose warnings go to a listener: to people who do not see the program's output."""
    token = _HEARD.set(hear)
    try:
        yield
    finally:
        _HEARD.reset(token)


_TOLD: ContextVar[set[str] | None] = ContextVar("_TOLD", default=None)
_HEARD: ContextVar[Callable[[str], object] | None] = ContextVar("_HEARD", default=None)


def as_path(value: object) -> Path:
    """`value` as a path, if it is a string or a path; else `OptionError`."""
    if isinstance(value, (str, os.PathLike)):
        name = os.fspath(value)
        if isinstance(name, str) and "\0" not in name:
            return Path(name)
    raise OptionError(f"path must be a string or a pathlib.Path; got {value!r}")


@contextmanager
def enough_memory(what: str) -> Iterator[None]:
    """Turn a `MemoryError` into an `OutOfMemoryError` that names `what`."""
    try:
        yield
    except ClvolError:
        raise
    except MemoryError as error:
        raise OutOfMemoryError(f"out of memory: {what} must fit into it; got {error or 'no memory'}") from error


def _scalar(value: object) -> object:
    """`value`, or the element of a 0-d array; None for booleans."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    return None if isinstance(value, (bool, np.timedelta64)) else value  # numpy.bool is not registered with `numbers`


def _allowed(bounds: Mapping[str, float | None]) -> str:
    texts = [f"{rule} {bound:.15g}" for rule, bound in bounds.items() if bound is not None]
    return ", " + " and ".join(texts) if texts else ""
