"""Arguments that `clvol.ndimage` rejects: SciPy's exception and clvol's own, a message with the rule, nothing written."""

from __future__ import annotations

import inspect
import subprocess
import sys
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy import LowLevelCallable
from scipy import ndimage as scipy_ndimage

import clvol
from clvol import ndimage
from clvol.base.errors import (
    AxisError,
    ClvolError,
    DataError,
    DtypeError,
    NotFiniteError,
    OptionError,
    OptionTypeError,
    OutOfMemoryError,
    RefusedError,
    UnsupportedError,
)
from clvol.device import Device

A = np.arange(12.0).reshape(3, 4)
EYE = np.eye(2)
POINTS = np.ones((2, 5))
CALLS: dict[str, tuple[Any, ...]] = {
    "spline_filter1d": (),
    "spline_filter": (),
    "map_coordinates": (POINTS,),
    "affine_transform": (EYE,),
    "zoom": (2,),
    "shift": (0.5,),
    "rotate": (30,),
    "geometric_transform": (lambda index: index,),
}


def both(name: str, *arguments: Any, **options: Any) -> tuple[Exception, Exception | None]:
    """What clvol raises, and what SciPy raises, if anything."""
    with pytest.raises(ClvolError) as ours:
        getattr(ndimage, name)(*arguments, **options)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            getattr(scipy_ndimage, name)(*arguments, **options)
        except Exception as theirs:
            return ours.value, theirs
    return ours.value, None


def agree(expected: type[Exception], says: str, name: str, *arguments: Any, **options: Any) -> None:
    """Require that both reject it with the same exception; clvol states the rule and the value."""
    ours, theirs = both(name, *arguments, **options)
    assert type(ours) is expected
    assert theirs is not None, "SciPy takes it"
    assert isinstance(
        ours, type(theirs) if type(theirs).__module__ in ("builtins", "numpy.exceptions") else type(theirs).__mro__[1]
    )
    assert says in str(ours)
    assert "; got " in str(ours)


def refuse(expected: type[Exception], says: str, name: str, *arguments: Any, **options: Any) -> None:
    """Require that clvol rejects what SciPy computes."""
    ours, theirs = both(name, *arguments, **options)
    assert type(ours) is expected
    assert theirs is None, theirs
    assert says in str(ours)
    assert "; got " in str(ours)


@pytest.mark.parametrize("name", CALLS)
def test_signatures_are_scipys(name: str) -> None:
    ours, theirs = inspect.signature(getattr(ndimage, name)), inspect.signature(getattr(scipy_ndimage, name))
    known = list(ours.parameters.values())[: len(theirs.parameters)]
    assert [(one.name, one.default, one.kind) for one in known] == [(p.name, p.default, p.kind) for p in theirs.parameters.values()]
    more = list(ours.parameters.values())[len(theirs.parameters) :]
    assert all(one.kind is one.KEYWORD_ONLY for one in more)
    assert {"precision", "device", "nan", "progress"} <= {one.name for one in more}


@pytest.mark.parametrize("name", CALLS)
def test_orders_and_modes(name: str) -> None:
    if name != "rotate":  # which looks at its plane first
        for order in (-1, 6):
            agree(RefusedError, "order must be a whole number from", name, A, *CALLS[name], order=order)
        for order in ("3", None, 2.5, 3.0):
            agree(OptionTypeError, "order must be a whole number from", name, A, *CALLS[name], order=order)
    for mode in ("edge", None, 3, ["mirror", "mirror"]):
        agree(RefusedError, "mode must be one of mirror, reflect", name, A, *CALLS[name], mode=mode)


def test_the_filter_has_no_order_below_two() -> None:
    agree(RefusedError, "from 2 to 5", "spline_filter", A, 1)


@pytest.mark.parametrize("name", CALLS)
@pytest.mark.parametrize("dtype", ["O", "U3", "M8[D]", "m8[s]", "g", "G", "V4"])
def test_types_of_samples(name: str, dtype: str) -> None:
    data = np.zeros((3, 4), dtype)
    agree(DtypeError, "input must be an array of bool, integers", name, data, *CALLS[name], order=3)


@pytest.mark.one_in(8)
@pytest.mark.parametrize("name", CALLS)
def test_masked_samples(name: str) -> None:
    refuse(DataError, "input must have no masked samples", name, np.ma.masked_greater(A, 5), *CALLS[name])
    unmasked = getattr(ndimage, name)(np.ma.masked_greater(A, 50), *CALLS[name], order=3)
    np.testing.assert_array_equal(unmasked, getattr(ndimage, name)(A, *CALLS[name], order=3))


@pytest.mark.parametrize("name", CALLS)
def test_ragged_samples(name: str) -> None:
    agree(DataError, "input must be an array of numbers", name, [[1], [2, 3]], *CALLS[name])


@pytest.mark.parametrize("name", ["zoom", "shift", "affine_transform", "geometric_transform", "map_coordinates"])
def test_a_number_is_not_an_array(name: str) -> None:
    agree(RefusedError, "must have at least one axis", name, np.float64(3), *CALLS[name])
    agree(AxisError, "axis must be one of the array's 0", "spline_filter1d", np.float64(3))


@pytest.mark.parametrize("name", CALLS)
def test_outputs(name: str) -> None:
    arguments = CALLS[name]
    shape = getattr(ndimage, name)(A, *arguments).shape
    if name != "affine_transform":  # whose result takes its shape from there
        agree(RefusedError, "output must have the shape of the result", name, A, *arguments, output=np.zeros((2, 2, 2)))
    agree(RefusedError, "output must be bool, integers", name, A, *arguments, output=np.zeros(shape, complex))
    agree(RefusedError, "output must be bool, integers", name, A, *arguments, output=np.zeros(shape, object))
    agree(RefusedError, "output must be bool, integers", name, A, *arguments, output=np.longdouble)
    agree(RefusedError, "output must be bool, integers", name, A, *arguments, output=complex)
    agree(RefusedError, "output must be a numeric dtype", name, A, *arguments, output="bool")
    agree(OptionTypeError, "output must be an array or a dtype", name, A, *arguments, output="no such type")
    agree(RefusedError, "output must be complex64 or complex128", name, A + 1j, *arguments, output=np.zeros(shape))
    agree(RefusedError, "output must be complex64 or complex128", name, A + 1j, *arguments, output="f")
    fixed = np.zeros(shape)
    fixed.flags.writeable = False
    agree(OptionError, "output must be an array that can be written to", name, A, *arguments, output=fixed)


@pytest.mark.parametrize("name", CALLS)
def test_a_real_type_is_promoted_for_complex_samples(name: str) -> None:
    with pytest.warns(UserWarning, match="promoting specified output dtype to complex") as told:
        result = getattr(ndimage, name)(A + 1j, *CALLS[name], output=np.float32)
    assert result.dtype == np.complex64
    assert told[0].filename == __file__


@pytest.mark.parametrize("name", [one for one in CALLS if not one.startswith("spline")])
def test_cval(name: str) -> None:
    for cval in ("a", None, 1j, [1, 2]):
        agree(OptionTypeError, "cval must be a real number", name, A, *CALLS[name], cval=cval)
    agree(NotFiniteError, "cval must be a number that float64 can hold", name, A, *CALLS[name], cval=10**400)


@pytest.mark.parametrize("name", CALLS)
def test_options_that_scipy_does_not_have(name: str) -> None:
    function: Callable[..., Any] = getattr(ndimage, name)
    with pytest.raises(OptionError, match="precision must be one of single, double, None; got 'half'"):
        function(A, *CALLS[name], precision="half")
    with pytest.raises(OptionError, match="nan must be one of propagate, error, local; got 'skip'"):
        function(A, *CALLS[name], nan="skip")
    with pytest.raises(ClvolError, match="; got"):
        function(A, *CALLS[name], device="no such device")
    hurt = np.array(A, np.complex64)
    hurt[1, 2] = np.nan
    with pytest.raises(DataError, match=r"all samples must be finite; got .*nan.* at \(1, 2\)"):
        function(hurt, *CALLS[name], nan="error")


def test_axes_of_the_filter() -> None:
    agree(AxisError, "axis must be one of the array's 2, from -2 to 1; got 5", "spline_filter1d", A, 3, 5)
    agree(AxisError, "got -3", "spline_filter1d", A, 3, -3)
    for axis in (1.0, "a", None):
        agree(OptionTypeError, "axis must be a whole number", "spline_filter1d", A, 3, axis)


def test_factors_and_shifts() -> None:
    for name in ("zoom", "shift"):
        for wrong in ("2", None, 1j, [2, "a"], [[2], [2]]):
            agree(OptionTypeError, f"{name} must be a real number, or one for each axis", name, A, wrong)
        agree(RefusedError, f"{name} must be a number, or one for each of the 2 axes", name, A, [2])
    agree(NotFiniteError, "zoom must be finite; got inf", "zoom", A, np.inf)
    agree(NotFiniteError, "zoom must be finite; got nan", "zoom", A, np.nan)
    for value in (np.inf, -np.inf, np.nan):
        refuse(NotFiniteError, "shift must be finite", "shift", A, (0, value))
    agree(OptionError, "zoom must be at least 0", "zoom", A, -1)


def test_matrices() -> None:
    name = "affine_transform"
    for wrong in (np.eye(4), [1, 2, 3]):
        agree(RefusedError, "matrix must have a row for each of the 2 axes of input", name, A, wrong)
    for wrong in (1, [], np.zeros((2, 2, 2)), np.zeros((0, 2))):
        agree(RefusedError, "matrix must have one or two axes, and not be empty", name, A, wrong)
    for shape in ((5,), (2, 3, 4)):
        agree(RefusedError, "matrix must have a column for each", name, A, EYE, output_shape=shape)
    agree(OptionTypeError, "matrix must be real numbers", name, A, [["a", "b"], ["c", "d"]])
    refuse(OptionTypeError, "matrix must be real numbers", name, A, EYE * 1j)
    agree(
        OptionError,
        "the last row of a homogeneous matrix must be [0, 0, 1]; got [5.0, 2.0, 1.0]",
        name,
        A,
        [*np.eye(3)[:2], [5, 2, 1]],
    )
    for value in (np.nan, np.inf):
        refuse(NotFiniteError, "matrix must be finite", name, A, [[1, value], [0, 1]])
        refuse(NotFiniteError, "offset must be finite", name, A, EYE, value)
    agree(RefusedError, "offset must be a number, or one for each of the 2 axes", name, A, EYE, [1])
    agree(OptionTypeError, "offset must be a real number", name, A, EYE, 1j)
    # of one axis, with a result of another number of axes, SciPy reads beyond its arrays
    with pytest.raises(RefusedError, match="matrix must have a column for each of the 1 axes of the result"):
        ndimage.affine_transform(A, [1, 1], output_shape=(3,))


@pytest.mark.parametrize("name", ["affine_transform", "geometric_transform"])
def test_shapes(name: str) -> None:
    arguments = CALLS[name]
    for wrong in (5, (2.5, 3), "ab"):
        agree(OptionTypeError, "output_shape must be whole numbers", name, A, *arguments, output_shape=wrong)
    agree(OptionError, "output_shape must be whole numbers of at least 0", name, A, *arguments, output_shape=(-1, 2))
    agree(RefusedError, "must have at least one axis", name, A, *arguments, output_shape=())
    agree(RefusedError, "output must have the shape", name, A, *arguments, output_shape=(9, 9), output=np.zeros((3, 4)))


def test_results_that_are_too_large() -> None:
    agree(OutOfMemoryError, "out of memory: a result of 10000000 × 10000000 samples", "affine_transform", A, EYE, 0, (10**7, 10**7))
    for name, arguments in (("affine_transform", (A, EYE, 0, (10**12, 10**12))), ("zoom", (A, 1e9))):
        ours, theirs = both(name, *arguments)
        assert type(ours) is OutOfMemoryError
        assert isinstance(theirs, (ValueError, MemoryError))
        assert "the result must have a size that can be addressed; got " in str(ours)


def test_coordinates() -> None:
    name = "map_coordinates"
    agree(RefusedError, "coordinates must be given for 2 axes", name, A, np.zeros((3, 5)))
    for wrong in (np.zeros(2), 5):
        agree(RefusedError, "coordinates must have an axis for the input's axes and at least one more", name, A, wrong)
    agree(OptionTypeError, "coordinates must be real numbers; got complex128", name, A, POINTS * 1j)
    for dtype in ("O", "U1", "m8[s]", "g"):
        agree(RefusedError, "coordinates must be bool, integers", name, A, POINTS.astype(dtype))
    agree(OptionError, "coordinates must be an array of real numbers", name, A, [[1], [1, 2]])
    refuse(
        UnsupportedError,
        "points must have coordinates along at most 3 axes of input; got 4",
        name,
        np.ones((2, 2, 2, 2)),
        np.zeros((4, 3)),
    )
    with pytest.raises(AxisError, match="axis must be one of the array's 2, from -2 to 1; got 2"):
        ndimage.map_coordinates(A, POINTS, axes=(0, 2))
    with pytest.raises(OptionError, match="axes must be different axes"):
        ndimage.map_coordinates(A, POINTS, axes=(0, -2))


def test_planes_and_angles() -> None:
    agree(OptionError, "input must have at least two axes", "rotate", A[0], 30)
    for axes in ((0, 1, 2), (0,)):
        agree(OptionError, "axes must be exactly two axes", "rotate", A, 30, axes)
    agree(OptionError, "axes must be whole numbers", "rotate", A, 30, (0, 0.5))
    agree(OptionError, "axes must be two different ones of the 2 axes of input", "rotate", A, 30, (0, 5))
    refuse(OptionError, "axes must be two different ones", "rotate", A, 30, (1, 1))
    for wrong in (0, (None, 1)):
        agree(OptionTypeError, "axes must be", "rotate", A, 30, wrong)
    for angle in ("a", None, 1j):
        agree(OptionTypeError, "angle must be a real number", "rotate", A, angle)
    agree(NotFiniteError, "angle must be finite", "rotate", A, np.nan)
    refuse(NotFiniteError, "angle must be finite", "rotate", A, np.inf)


def test_mappings() -> None:
    name = "geometric_transform"
    for wrong in (3, None):
        agree(RefusedError, "mapping must be a function", name, A, wrong)
    for answer in ((1,), 1, ("a", 1), (1j, 1)):
        agree(
            OptionTypeError,
            "mapping must return 2 real numbers, one for each axis of input",
            name,
            A,
            lambda _, answer=answer: answer,
        )
    for extra in (5, None, [1]):
        agree(RefusedError, "extra_arguments must be a tuple", name, A, lambda i: i, extra_arguments=extra)
    agree(RefusedError, "extra_keywords must be a dict", name, A, lambda i: i, extra_keywords=5)
    refuse(UnsupportedError, "points must have coordinates along at most 3 axes", name, np.ones((2, 2, 2, 2)), lambda i: i)
    import ctypes

    in_c = LowLevelCallable(ctypes.CFUNCTYPE(ctypes.c_int)(lambda: 1), signature="int (npy_intp *, double *, int, int, void *)")
    with pytest.raises(UnsupportedError, match=r"mapping must be a function of Python here; got a scipy\.LowLevelCallable"):
        ndimage.geometric_transform(A, in_c)  # type: ignore[arg-type]


def test_a_matrix_that_mixes_five_axes() -> None:
    data, matrix = np.ones((2,) * 5), np.eye(5)
    matrix[0, 1] = matrix[1, 2] = matrix[2, 3] = 0.5
    refuse(UnsupportedError, "a matrix must not mix more than 3 axes of input with each other", "affine_transform", data, matrix)


def test_arrays_without_samples() -> None:
    with pytest.raises(DataError, match='input must have samples where mode is not "constant"'):
        ndimage.map_coordinates(np.ones((0, 4)), POINTS, mode="mirror")


def test_errors_of_a_mapping_propagate_and_nothing_is_written(device: Device) -> None:
    output = np.full((3, 4), 77.0)

    def mapping(index: tuple[int, ...]) -> tuple[int, ...]:
        if index == (2, 3):
            raise KeyboardInterrupt
        return index

    with pytest.raises(KeyboardInterrupt):
        ndimage.geometric_transform(A, mapping, output=output, device=device)
    assert (output == 77).all()


@pytest.mark.parametrize("name", CALLS)
def test_nothing_is_written_on_an_error(name: str) -> None:
    shape = getattr(ndimage, name)(A, *CALLS[name]).shape
    output = np.full(shape, 77.0)
    wrong: list[dict[str, Any]] = [{"mode": "edge"}, {"precision": "half"}, {"nan": "skip"}, {"device": "no such device"}]
    if not name.startswith("spline"):
        wrong += [{"cval": "a"}]
    for options in wrong:
        with pytest.raises(ClvolError):
            getattr(ndimage, name)(A, *CALLS[name], output=output, **options)
    hurt = A.copy()
    hurt[-1, -1] = np.inf
    with pytest.raises(DataError):
        getattr(ndimage, name)(hurt, *CALLS[name], output=output, nan="error")
    assert (output == 77).all()


def test_other_names_are_scipys_own() -> None:
    assert ndimage.gaussian_filter is scipy_ndimage.gaussian_filter
    assert clvol.ndimage.label is scipy_ndimage.label
    assert set(scipy_ndimage.__all__) <= set(dir(ndimage))
    assert all(getattr(ndimage, name) is not getattr(scipy_ndimage, name) for name in CALLS)
    with pytest.raises(AttributeError, match=r"module 'clvol\.ndimage' has no attribute 'no_such_name'"):
        ndimage.no_such_name  # noqa: B018


def test_an_interrupt_keeps_the_memory_of_running_kernels() -> None:
    """In a separate process: a kernel that writes to freed memory would crash it."""
    script = """
import numpy as np
from clvol import ndimage
from clvol.spline.coefficients import Coefficients

data = np.ones((160, 160, 160))
halo = Coefficients.fill_halo

def interrupted(*_):
    raise KeyboardInterrupt

Coefficients.fill_halo = interrupted  # called while the prefilter is at work
for _ in range(4):
    try:
        ndimage.zoom(data, 0.1, order=5, mode="mirror")
    except KeyboardInterrupt:
        pass
Coefficients.fill_halo = halo
print(round(float(ndimage.zoom(data, 0.1, order=5, mode="mirror").max()), 9))
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "1.0\n"), done.stderr[-500:]
