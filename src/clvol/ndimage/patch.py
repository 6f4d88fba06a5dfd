"""The functions of `clvol.ndimage` in SciPy's place, for programs that cannot be changed."""

from __future__ import annotations

import builtins
import functools
import inspect
import sys
import threading
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from types import ModuleType, TracebackType
from typing import Any

import numpy as np

from clvol.base.errors import ClvolError, MissingDependencyError, OptionError, RefusedError
from clvol.interop.dispatch import is_lazy
from clvol.ndimage import interpolation
from clvol.ndimage.small import calls_by_scipy, count, originals

__all__ = ["Report", "patched", "run"]

_NAMES = tuple(interpolation.__all__)
_LAZY = {  # what packages import lazily and calls the functions
    "skimage": ("transform.resize", "measure.profile_line", "registration.phase_cross_correlation", "registration.optical_flow_ilk")
}
_ABSENT = object()
_in_force = threading.Lock()


class Report:
    """Which calls of SciPy's functions clvol took, and which not.

    Attributes
    ----------
    taken : Counter of str
        By function, the calls that clvol took.
    small : Counter of str
        By function, those of them that were so small that clvol had SciPy compute them.
    not_taken : Counter of str
        By function, the calls that it refused, those that went to SciPy among them.
    reasons : dict of str to Counter of str
        By function, the rules that they broke.
    """

    def __init__(self) -> None:
        self.taken: Counter[str] = Counter()
        self.small: Counter[str] = Counter()
        self.not_taken: Counter[str] = Counter()
        self.reasons: dict[str, Counter[str]] = {}
        self._lock = threading.Lock()

    def __str__(self) -> str:
        names = [name for name in _NAMES if self.taken[name] or self.not_taken[name]]
        if not names:
            return "clvol.ndimage: no call of SciPy's interpolation was made"
        lines = [f"{'clvol.ndimage':20}{'taken':>8}{'small':>8}{'not taken':>11}"]
        for name in names:
            lines.append(f"{name:20}{self.taken[name]:>8}{self.small[name]:>8}{self.not_taken[name]:>11}")
            lines += [f"    {count} x {reason}" for reason, count in self.reasons.get(name, Counter()).items()]
        return "\n".join(lines)

    def _took(self, name: str, small: bool) -> None:
        with self._lock:
            self.taken[name] += 1
            self.small[name] += small

    def _left(self, name: str, reason: str) -> bool:
        """Count a call that was not taken; return whether it is the first for this reason."""
        with self._lock:
            self.not_taken[name] += 1
            reasons = self.reasons.setdefault(name, Counter())
            reasons[reason] += 1
            return reasons[reason] == 1


@contextmanager
def patched(*packages: str, fallback: bool = False, verbose: bool = False) -> Iterator[Report]:
    """Puts `clvol.ndimage` into SciPy's place, within a ``with`` block.

    Parameters
    ----------
    *packages : str
        Whose calls are taken. "scipy" (also if none is named) replaces the functions in `scipy.ndimage` itself, and so for
        everybody who looks them up there, as scikit-image does. Any other name stands for the modules of this package that are
        loaded: there `scipy.ndimage`, and functions of it that were imported by name, are replaced, for no one else.
        ``"__main__"`` is the script itself.
    fallback : bool
        Whether calls that clvol refuses go to SciPy, with one warning for each function and reason. By default they raise.
    verbose : bool
        Whether each call, and in the end the report, is printed to the standard error stream.

    Yields
    ------
    Report
        Counts the calls.

    Raises
    ------
    RefusedError
        A patch is in force already, in this thread or in another one.
    OptionError
        A package is not a name.
    MissingDependencyError
        A package cannot be imported.

    Warns
    -----
    UserWarning
        With `fallback`, for the first call of a function that clvol refuses for a reason and SciPy computes.

    Notes
    -----
    What is replaced is replaced in the whole process: calls from other threads are taken too, and counted in the same report.
    Other processes, started before or after, know nothing of it. On exit everything is put back, after errors too; functions
    that were imported by name within the block, or kept in another place, call SciPy from then on.

    Examples
    --------
    >>> with clvol.ndimage.patched("scipy", fallback=True) as report:
    ...     skimage.transform.resize(image, (64, 64, 64), order=3)
    >>> print(report)
    """
    named = _checked(packages or ("scipy",))
    if not _in_force.acquire(blocking=False):
        raise RefusedError("patched() must not be within another patched(), of any thread; got one while another is in force")
    try:
        report = Report()
        patch = _Patch(report, bool(fallback), bool(verbose))
        count(True)
        try:
            for name in named:
                patch.enter(name)
            yield report
        finally:
            patch.leave()
            count(False)
        if verbose:
            print(report, file=sys.stderr)
    finally:
        _in_force.release()


class _Patch:
    def __init__(self, report: Report, fallback: bool, verbose: bool) -> None:
        from scipy import ndimage

        self.report, self.fallback, self.verbose = report, fallback, verbose
        self.ndimage = ndimage
        self.on = True
        self.originals = {name: originals()[name] for name in _NAMES}
        self.ours = {name: self.taking(name) for name in _NAMES}
        self.namespace = _Namespace("scipy.ndimage", ndimage.__doc__)
        vars(self.namespace).update(self.ours)
        self.before: list[tuple[ModuleType, str, Any]] = []

    def taking(self, name: str) -> Callable[..., Any]:
        """A function in the place of SciPy's."""
        original, ours = self.originals[name], getattr(interpolation, name)

        @functools.wraps(ours)
        def replacement(*arguments: Any, **options: Any) -> Any:
            if not self.on:
                return original(*arguments, **options)
            start, before = time.perf_counter(), calls_by_scipy()
            try:  # arrays of dask are computed, as SciPy does
                computed = {key: _computed(value) for key, value in options.items()}
                result = ours(*map(_computed, arguments), **computed)
            except (ClvolError, TypeError) as error:
                if not isinstance(error, ClvolError) and _binds(ours, arguments, options):
                    raise  # not about the arguments: of the user's mapping, say
                reason = str(error).partition("; got")[0]
                if not self.fallback:
                    self.report._left(name, reason)
                    self.say(name, arguments, options, f"refused: {error}")
                    raise
                refused = str(error)
            else:
                small = calls_by_scipy() > before
                self.report._took(name, small)
                how = "small, by SciPy" if small else "taken"
                self.say(name, arguments, options, f"{how}, {1e3 * (time.perf_counter() - start):.1f} ms")
                return result
            result = original(*arguments, **options)  # which may refuse it too
            self.say(name, arguments, options, f"by SciPy: {refused}")
            if self.report._left(name, reason):
                warnings.warn(f"{name} was computed by SciPy, not by clvol: {refused}", UserWarning, stacklevel=2)
            return result

        return replacement

    def say(self, name: str, arguments: Sequence[Any], options: dict[str, Any], what: str) -> None:
        if self.verbose:
            data = np.asarray(arguments[0] if arguments else options.get("input"))
            print(f"clvol.ndimage: {name} of {data.dtype} {data.shape} {what}", file=sys.stderr)

    def enter(self, package: str) -> None:
        """Replace what modules of a package call."""
        if package == "scipy":
            former = sys.modules.get("scipy.ndimage.interpolation")  # deprecated, and still there
            for module in (self.ndimage, former) if former else (self.ndimage,):
                for name, function in self.ours.items():
                    self.put(module, name, function)
            return
        swap = {id(self.originals[name]): self.ours[name] for name in _NAMES} | {id(self.ndimage): self.namespace}
        for module in _modules(package):
            for name, value in list(vars(module).items()):
                if id(value) in swap:
                    self.put(module, name, swap[id(value)])

    def put(self, module: ModuleType, name: str, value: Any) -> None:
        self.before.append((module, name, vars(module).get(name, _ABSENT)))
        setattr(module, name, value)

    def leave(self) -> None:
        """Put everything back, also what was imported meanwhile."""
        self.on = False
        for module, name, value in reversed(self.before):
            if value is _ABSENT:
                delattr(module, name)
            else:
                setattr(module, name, value)
        swap: dict[int, Any] = {id(self.ours[name]): self.originals[name] for name in _NAMES}
        swap[id(self.namespace)] = self.ndimage
        for module in list(sys.modules.values()):
            if module is not self.namespace and isinstance(module, ModuleType):
                for name, value in list(vars(module).items()):
                    if id(value) in swap:
                        setattr(module, name, swap[id(value)])


class _Namespace(ModuleType):
    """`scipy.ndimage` with other functions in it."""

    def __getattr__(self, name: str) -> Any:
        from scipy import ndimage

        return getattr(ndimage, name)


def run(script: str, arguments: Sequence[str], *, fallback: bool = False, verbose: bool = False) -> None:
    """Run a script as ``python script *arguments`` would, with `scipy.ndimage` patched.

    What it raises is printed, with a traceback that begins in the script, and raised again.
    """
    source = Path(script).read_bytes()
    file = str(Path(script).absolute())
    main = ModuleType("__main__")
    main.__file__ = file
    main.__builtins__ = builtins  # type: ignore[attr-defined]  # as in every module
    sys.modules["__main__"] = main
    sys.argv[:] = [script, *arguments]
    if not sys.flags.safe_path:
        sys.path[0] = str(Path(script).resolve().parent)
    try:
        with patched("scipy", fallback=fallback, verbose=verbose):
            exec(compile(source, file, "exec", dont_inherit=True), main.__dict__)
    except SystemExit:
        raise
    except BaseException as error:
        sys.excepthook(type(error), error, error.with_traceback(_within(file, error.__traceback__)).__traceback__)
        sys.excepthook = lambda *_: None  # it is printed; Python sets the exit status
        raise


def _within(file: str, trace: TracebackType | None) -> TracebackType | None:
    """The part of a traceback that begins in the script; None for a script that does not compile."""
    while trace is not None and trace.tb_frame.f_code.co_filename != file:
        trace = trace.tb_next
    return trace


def _checked(packages: Iterable[object]) -> list[str]:
    names = []
    for package in packages:
        if not isinstance(package, str) or not package:
            raise OptionError(f"packages must be names of packages; got {package!r}")
        try:
            import_module(package)
            for lazy in _LAZY.get(package, ()):
                module, _, name = lazy.rpartition(".")
                getattr(import_module(f"{package}.{module}"), name)
        except ImportError as error:
            raise MissingDependencyError(f"packages must be such as can be imported; got {package!r}: {error}") from error
        names.append(package)
    return names


def _modules(package: str) -> list[ModuleType]:
    return [
        module
        for name, module in list(sys.modules.items())
        if (name == package or name.startswith(f"{package}.")) and isinstance(module, ModuleType)
    ]


def _computed(argument: Any) -> Any:
    """An argument; what is an array of dask, in memory."""
    return np.asarray(argument) if is_lazy(argument) else argument


def _binds(function: Callable[..., Any], arguments: Sequence[Any], options: dict[str, Any]) -> bool:
    try:
        inspect.signature(function).bind(*arguments, **options)
    except TypeError:
        return False
    return True
