"""The same work by other programs: every entry of `TASKS` prepares a `Peer`, whose `run` is timed.

Preparation is outside of the time as far as the peer allows: points in its own arrays, coefficients unless they are the work,
textures, normals. Peers are an extra (``pip install "clvol[bench]"``); one that is missing or does not work here is omitted, with
the reason.
"""

from __future__ import annotations

import importlib
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

import clvol

__all__ = ["TASKS", "Grid", "Peer", "Points", "Shot", "itk_resampled", "missing", "of", "renderer_of_opengl", "torch_grid"]

Array = NDArray[Any]


@dataclass(frozen=True)
class Peer:
    """Somebody else's way to do a piece of work.

    Attributes
    ----------
    run : callable
        Does it once and returns the result.
    scale : float
        What its time is to be multiplied with, where it does a part of the work only.
    """

    run: Callable[[], Any]
    scale: float = 1.0


@dataclass(frozen=True)
class Points:
    """Where to sample, and what: positions (x, y, z) in samples.

    Attributes
    ----------
    data, coefficients : ndarray, shape (nz, ny, nx)
        The samples and their cubic B-spline coefficients.
    at : ndarray of float32, shape (N, 3)
        The positions.
    lattice : tuple, optional
        If they are a lattice: its size (i, j, k), `i` the fastest, and the matrix of shape (3, 4) from (i, j, k, 1) to
        positions.
    """

    data: Array
    coefficients: Array
    at: Array
    lattice: tuple[tuple[int, int, int], Array] | None = None


@dataclass(frozen=True)
class Grid:
    """A resampling from array to array, the prefilter included, as `scipy.ndimage.affine_transform` has it.

    Attributes
    ----------
    data : ndarray of float32, shape (n, n) or (n, n, n)
        The samples.
    matrix, offset : ndarray
        From places of the result to those of `data`; a diagonal matrix keeps the outer samples in place.
    m : int
        Samples of the result along each axis.
    """

    data: Array
    matrix: Array
    offset: Array
    m: int


@dataclass(frozen=True)
class Shot:
    """A picture to be made.

    Attributes
    ----------
    data : ndarray, shape (n, n, n)
        Samples one unit apart.
    mode : str
        "isosurface", "mip" or "composite", the latter two with `transfer`.
    """

    data: Array
    camera: clvol.Camera
    mode: str
    size: tuple[int, int]
    step: float
    transfer: clvol.TransferFunction
    isovalue: float = 0.0
    color: tuple[float, float, float] = (0.93, 0.87, 0.76)


def of(task: str, work: Any) -> dict[str, Peer]:
    """The available peers for a task, prepared."""
    found = {}
    for name, (needs, prepare) in TASKS[task].items():
        if needs is None or needs not in missing():
            peer = prepare(work)
            if peer is not None:
                found[name] = peer
    return found


@lru_cache(maxsize=1)
def missing() -> dict[str, str]:
    """Unavailable peers, and why; each is tried in its own process, since some would crash it."""
    tried = {}
    for name, program in _TRIALS.items():
        try:
            trial = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=False)
        except subprocess.TimeoutExpired:
            tried[name] = "a trial took more than two minutes"
            continue
        if trial.returncode:
            tried[name] = (trial.stderr.strip().splitlines() or [f"a trial ended with status {trial.returncode}"])[-1]
    return tried


_TRIALS = {
    "VTK": "import vtk",
    "VTK drawing": (
        "import vtk; window = vtk.vtkRenderWindow(); window.SetOffScreenRendering(1); window.SetSize(8, 8); window.Render(); "
        "assert window.SupportsOpenGL(), 'no OpenGL: ' + window.GetOpenGLSupportMessage()"
    ),
    "SimpleITK": "import SimpleITK",
    "drjit": "import drjit as dr; from drjit.llvm import Float; assert dr.sum(dr.arange(Float, 9))[0] == 36",
    "numba": "import numba",
    "splineops": "import splineops",
    "torch": "import torch",
}


# -- scipy: one thread --------------------------------------------------------------------------------------


def _scipy_prefilter(data: Array) -> Peer:
    return Peer(lambda: ndimage.spline_filter(data, 3, output=np.float32, mode="mirror"))


def _scipy_sample(work: Points) -> Peer:
    few = work.at[: 1 << 20]  # slow, proportional to the size
    turned = np.ascontiguousarray(few[:, ::-1].T)
    return Peer(
        lambda: ndimage.map_coordinates(work.coefficients, turned, np.float32, 3, "mirror", prefilter=False),
        len(work.at) / len(few),
    )


def _scipy_magnify(data: Array) -> Peer:
    n = np.asarray(data.shape)

    def run() -> Array:
        coefficients = ndimage.spline_filter(data, 3, output=np.float32, mode="mirror")
        return ndimage.affine_transform(
            coefficients, np.full(3, 0.5), output_shape=tuple(2 * n), output=np.float32, mode="mirror", prefilter=False
        )

    return Peer(run)


def _scipy_grid(work: Grid) -> Peer:
    shape = (work.m,) * work.data.ndim
    matrix = np.diag(work.matrix) if _along_axes(work.matrix) else work.matrix
    return Peer(lambda: ndimage.affine_transform(work.data, matrix, work.offset, shape, mode="mirror"))


def _along_axes(matrix: Array) -> bool:
    return np.array_equal(matrix, np.diag(np.diag(matrix)))


# -- VTK: threads of its own --------------------------------------------------------------------------------


@lru_cache(maxsize=1)
def _vtk() -> Any:
    vtk = importlib.import_module("vtk")
    vtk.vtkLogger.SetStderrVerbosity(vtk.vtkLogger.VERBOSITY_OFF)  # it reports every display that it does not find
    vtk.vtkSMPTools.SetBackend("STDThread")
    return vtk


def _vtk_image(data: Array) -> Any:
    support = importlib.import_module("vtk.util.numpy_support")
    image = _vtk().vtkImageData()
    image.SetDimensions(*data.shape[::-1])
    image.GetPointData().SetScalars(support.numpy_to_vtk(data.ravel()))
    image.array = data  # which VTK does not copy
    return image


def _vtk_array(image: Any) -> Array:
    support = importlib.import_module("vtk.util.numpy_support")
    return np.asarray(support.vtk_to_numpy(image.GetPointData().GetScalars())).reshape(image.GetDimensions()[::-1])


def _vtk_update(step: Any, source: Any | None = None) -> Array:
    (source or step).Modified()
    step.Update()
    return _vtk_array(step.GetOutput())


def _vtk_coefficients(data: Array) -> Any:
    step = _vtk().vtkImageBSplineCoefficients()
    step.SetInputData(_vtk_image(data))
    step.SetBorderModeToMirror()
    step.SetOutputScalarTypeToFloat()
    return step


def _vtk_reslice(size: tuple[int, ...], matrix: Array) -> Any:
    vtk = _vtk()
    spline = vtk.vtkImageBSplineInterpolator()
    spline.SetSplineDegree(3)
    spline.SetBorderModeToMirror()
    step = vtk.vtkImageReslice()
    step.SetInterpolator(spline)
    step.SetOutputExtent(0, size[0] - 1, 0, size[1] - 1, 0, size[2] - 1)
    if _along_axes(matrix[:, :3]):
        step.SetOutputSpacing(*np.diag(matrix[:, :3]))  # it is faster along the axes
        step.SetOutputOrigin(*matrix[:, 3])
    else:
        step.SetOutputSpacing(1, 1, 1)
        step.SetOutputOrigin(0, 0, 0)
        transform = vtk.vtkTransform()
        transform.SetMatrix([*matrix.ravel(), 0, 0, 0, 1])
        step.SetResliceTransform(transform)
    return step


def _vtk_prefilter(data: Array) -> Peer:
    step = _vtk_coefficients(data)
    return Peer(lambda: _vtk_update(step))


def _vtk_sample(work: Points) -> Peer | None:
    if work.lattice is None:
        return None
    step = _vtk_reslice(*work.lattice)
    step.SetInputData(_vtk_image(work.coefficients))
    return Peer(lambda: _vtk_update(step).ravel())


def _vtk_magnify(data: Array) -> Peer:
    source = _vtk_coefficients(data)
    step = _vtk_reslice(tuple(2 * n for n in data.shape[::-1]), np.eye(3, 4) / 2)
    step.SetInputConnection(source.GetOutputPort())
    return Peer(lambda: _vtk_update(step, source))


def _vtk_frame(mapper: str) -> Callable[[Shot], Peer | None]:
    def prepare(shot: Shot) -> Peer | None:
        vtk = _vtk()
        on_cpu = mapper == "vtkFixedPointVolumeRayCastMapper"
        if on_cpu and shot.mode == "isosurface":  # it does not support it
            return None
        volume, draws = vtk.vtkVolume(), getattr(vtk, mapper)()
        draws.SetInputData(_vtk_image(shot.data))
        draws.SetAutoAdjustSampleDistances(False)
        draws.SetSampleDistance(shot.step)
        if on_cpu:
            draws.SetInteractiveSampleDistance(shot.step)
        look = volume.GetProperty()
        colors, opacities = vtk.vtkColorTransferFunction(), vtk.vtkPiecewiseFunction()
        for value, color in shot.transfer.colors:
            colors.AddRGBPoint(value, *color)
        for value, opacity in shot.transfer.opacities:
            opacities.AddPoint(value, opacity)
        if shot.mode == "isosurface":
            colors.RemoveAllPoints()
            colors.AddRGBPoint(shot.isovalue, *shot.color)
            opacities.RemoveAllPoints()
            opacities.AddPoint(shot.isovalue, 1.0)
            draws.SetBlendModeToIsoSurface()
            look.GetIsoSurfaceValues().SetValue(0, shot.isovalue)
        elif shot.mode == "mip":
            draws.SetBlendModeToMaximumIntensity()
        look.SetColor(colors)
        look.SetScalarOpacity(opacities)
        look.SetScalarOpacityUnitDistance(shot.transfer.unit_distance or 1.0)
        look.SetInterpolationTypeToLinear()
        material = clvol.Material()
        look.SetShade(shot.mode != "mip")
        look.SetAmbient(material.ambient)
        look.SetDiffuse(material.diffuse)
        look.SetSpecular(material.specular)
        look.SetSpecularPower(material.shininess)
        volume.SetMapper(draws)
        stage, window = vtk.vtkRenderer(), vtk.vtkRenderWindow()
        stage.AddVolume(volume)
        stage.SetBackground(0, 0, 0)
        window.SetOffScreenRendering(1)
        window.SetMultiSamples(0)
        window.SetSize(*shot.size)
        window.AddRenderer(stage)
        view, middle = shot.camera.view(clvol.Volume(shot.data), shot.size[0] / shot.size[1]), np.asarray(shot.data.shape[::-1]) / 2
        camera = stage.GetActiveCamera()
        camera.SetPosition(*view.eye)
        camera.SetFocalPoint(*(view.eye + view.forward))
        camera.SetViewUp(*view.up)
        camera.SetViewAngle(2 * np.degrees(np.arctan(view.half_height)))
        far = float(np.linalg.norm(view.eye - middle)) + float(np.linalg.norm(middle))
        camera.SetClippingRange(far / 1000, 2 * far)
        pixels = vtk.vtkUnsignedCharArray()
        support = importlib.import_module("vtk.util.numpy_support")

        def run() -> Array:
            window.Render()
            window.GetRGBACharPixelData(0, 0, shot.size[0] - 1, shot.size[1] - 1, 0, pixels)
            picture = np.asarray(support.vtk_to_numpy(pixels)).reshape(shot.size[1], shot.size[0], 4)[::-1].astype(np.float32) / 255
            picture[..., 3] = 1
            return picture

        return Peer(run)

    return prepare


# -- SimpleITK: threads of its own ----------------------------------------------------------------------------


def _itk() -> Any:
    return importlib.import_module("SimpleITK")


def itk_resampled(image: Any, size: tuple[int, ...], matrix: Array, interpolator: Any) -> Array:
    """An image at the positions ``matrix @ (x, y, z, 1)`` of a grid of a size (x, y, z)."""
    itk = _itk()
    transform = itk.AffineTransform(3)
    transform.SetMatrix(matrix[:, :3].ravel().tolist())
    transform.SetTranslation(matrix[:, 3].tolist())
    result = itk.Resample(image, size, transform, interpolator, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0), np.eye(3).ravel().tolist())
    return np.asarray(itk.GetArrayFromImage(result))


def _itk_prefilter(data: Array) -> Peer:
    itk, image = _itk(), _itk().GetImageFromArray(data)
    return Peer(lambda: np.asarray(itk.GetArrayFromImage(itk.BSplineDecomposition(image, 3))))


def _itk_sample(work: Points) -> Peer | None:
    if work.lattice is None:
        return None
    image, (size, matrix) = _itk().GetImageFromArray(work.coefficients), work.lattice
    return Peer(lambda: itk_resampled(image, size, matrix, _itk().sitkBSplineResamplerOrder3).ravel())


def _itk_magnify(data: Array) -> Peer:
    image, size = _itk().GetImageFromArray(data), tuple(2 * n for n in data.shape[::-1])
    return Peer(lambda: itk_resampled(image, size, np.eye(3, 4) / 2, _itk().sitkBSpline3))


# -- drjit: compiles what it is told by LLVM, threads of its own -------------------------------------------------


def _drjit(work: Points, call: str) -> Peer:
    dr, llvm = importlib.import_module("drjit"), importlib.import_module("drjit.llvm")
    linear = call == "eval"
    texture = llvm.Texture3f(llvm.TensorXf((work.data if linear else work.coefficients)[..., None]), wrap_mode=dr.WrapMode.Mirror)
    shape = np.asarray(work.data.shape[::-1])
    at = llvm.Array3f(np.ascontiguousarray(((work.at + 0.5) / shape).T, np.float32))
    dr.eval(at)

    def run() -> Array:
        found = getattr(texture, call)(at)
        if call == "eval_cubic_grad":
            found = found[1][0] / llvm.Array3f(*shape.tolist())  # the gradient of the first channel, in samples
        dr.eval(found)
        dr.sync_thread()
        return np.asarray(found[0].numpy() if call != "eval_cubic_grad" else found.numpy().T)

    return Peer(run)


# -- splineops: one thread, but `resize` -----------------------------------------------------------------------


def _splineops_sample(work: Points) -> Peer:
    few = work.at[: 1 << 17]  # slow, proportional to the size
    axes = tuple(np.arange(n, dtype=np.float32) for n in work.data.shape)
    spline = importlib.import_module("splineops.spline_interpolation").TensorSpline(work.data, axes, "bspline3", "mirror")
    at = tuple(np.ascontiguousarray(few[:, ::-1].T))
    return Peer(lambda: spline(at, grid=False), len(work.at) / len(few))


def _splineops_grid(work: Grid) -> Peer:
    if _along_axes(work.matrix):
        resize, size = importlib.import_module("splineops.resize").resize, (work.m,) * work.data.ndim
        return Peer(lambda: resize(work.data, output_size=size, method="cubic"))
    turn = importlib.import_module("splineops.affine").affine_transform
    return Peer(lambda: turn(work.data, work.matrix, work.offset, mode="mirror"))


# -- PyTorch: bicubics by Keys' kernel, a = -3/4, without a prefilter; threads of its own ------------------------


def _torch() -> tuple[Any, Any]:
    return importlib.import_module("torch"), importlib.import_module("torch.nn.functional")


def torch_grid(matrix: Array, offset: Array, n: int) -> Callable[[], Any]:
    """PyTorch's positions for a cube or a square of n samples along each axis, which range from -1 to 1."""
    torch, functional = _torch()
    half, axes = (n - 1) / 2, len(matrix)
    shift = (matrix @ np.full(axes, half) + offset) / half - 1
    table = torch.from_numpy(np.column_stack([matrix[::-1, ::-1], shift[::-1]]).astype(np.float32))[None]
    return lambda: functional.affine_grid(table, (1, 1, *(n,) * axes), align_corners=True)


def _torch_tricubic(data: Array) -> Callable[[Any], Any]:
    """Tricubic values at positions (..., (x, y, z)) in samples: those of four bicubics by the same kernel, as it has none.

    A point has slices of its own, so that they are one image, below each other, with the rows that a kernel needs beside them.
    """
    torch, functional = _torch()
    tall = functional.pad(torch.from_numpy(data)[None], (0, 0, 2, 2), "replicate").reshape(1, 1, -1, data.shape[2])
    scale = torch.tensor([data.shape[2] - 1, tall.shape[2] - 1]) / 2
    beside, a = torch.arange(-1, 3), -0.75

    def run(at: Any) -> Any:
        below = at[..., 2].floor()
        far = (at[..., 2] - below - beside.view(-1, *(1,) * below.ndim)).abs()
        inner, outer = ((a + 2) * far - (a + 3)) * far**2 + 1, ((far - 5) * far + 8) * a * far - 4 * a
        slices = (below + beside.view(-1, *(1,) * below.ndim)).clamp(0, len(data) - 1)
        rows = slices * (data.shape[1] + 4) + at[..., 1] + 2
        grid = torch.stack([at[..., 0].expand(rows.shape), rows], -1) / scale - 1
        found = functional.grid_sample(
            tall.expand(4, -1, -1, -1), grid.view(4, 1, -1, 2), mode="bicubic", padding_mode="border", align_corners=True
        )
        return (found.view(far.shape) * torch.where(far < 1, inner, outer)).sum(0)

    return run


def _torch_sample(work: Points) -> Peer:
    tricubic, at = _torch_tricubic(work.data), _torch()[0].from_numpy(work.at)
    return Peer(lambda: np.asarray(tricubic(at).numpy()))


def _torch_grid_sample(work: Grid) -> Peer:
    (torch, functional), n = _torch(), len(work.data)
    tensor = torch.from_numpy(work.data)[None, None]
    grid = torch_grid(work.matrix, work.offset, n)

    def image() -> Array:
        found = functional.grid_sample(tensor, grid(), mode="bicubic", padding_mode="reflection", align_corners=True)
        return np.asarray(found[0, 0].numpy())

    def volume() -> Array:
        return np.asarray(_torch_tricubic(work.data)((grid()[0] + 1) * ((n - 1) / 2)).numpy())

    return Peer(image if work.data.ndim == 2 else volume)


def _torch_grid(work: Grid) -> Peer:
    if not _along_axes(work.matrix):
        return _torch_grid_sample(work)
    (torch, functional), m = _torch(), work.m
    options = {"mode": "bicubic", "align_corners": True}
    tensor = torch.from_numpy(work.data.reshape(1, -1, *work.data.shape[-2:]))

    def run() -> Array:
        found = functional.interpolate(tensor, (m, m), **options)
        if work.data.ndim == 3:  # then across the slices
            found = functional.interpolate(found.view(1, 1, -1, m * m), (m, m * m), **options)
        return np.asarray(found.view((m,) * work.data.ndim).numpy())

    return Peer(run)


# -- numba: plain.py, all cores --------------------------------------------------------------------------------


def _plain(name: str) -> Any:
    return getattr(importlib.import_module("bench.plain"), name)


def _numba_points(name: str, what: str = "coefficients") -> Callable[[Points], Peer]:
    def prepare(work: Points) -> Peer:
        function, data = _plain(name), getattr(work, what)
        return Peer(lambda: function(data, work.at))

    return prepare


def _numba_volume(name: str) -> Callable[[Array], Peer]:
    def prepare(data: Array) -> Peer:
        function = _plain(name)
        return Peer(lambda: function(data))

    return prepare


def _numba_frame(shot: Shot) -> Peer | None:
    if shot.mode != "isosurface":
        return None
    coefficients, function = _plain("prefilter")(shot.data), _plain("isosurface")
    width, height = shot.size
    view = shot.camera.view(clvol.Volume(shot.data), width / height)
    across, down = view.right * view.half_height * width / height, -view.up * view.half_height
    vectors = [np.asarray(v, np.float32) for v in (view.eye, view.forward - across - down, 2 * across / width, 2 * down / height)]
    isovalue, step, color = np.float32(shot.isovalue), np.float32(shot.step), np.asarray(shot.color, np.float32)
    return Peer(lambda: function(coefficients, *vectors, width, height, isovalue, step, color))


# What can be compared: for each task the peers' names in the results, what each needs (see `missing`), and how it is
# prepared, which gives None where the peer has no such thing.
Prepare = Callable[[Any], Peer | None]
TASKS: dict[str, dict[str, tuple[str | None, Prepare]]] = {
    "prefilter": {
        "scipy": (None, _scipy_prefilter),
        "VTK": ("VTK", _vtk_prefilter),
        "SimpleITK": ("SimpleITK", _itk_prefilter),
        "numba": ("numba", _numba_volume("prefilter")),
    },
    "sample": {
        "scipy": (None, _scipy_sample),
        "VTK": ("VTK", _vtk_sample),
        "SimpleITK": ("SimpleITK", _itk_sample),
        "drjit": ("drjit", lambda work: _drjit(work, "eval_cubic")),
        "numba": ("numba", _numba_points("sample")),
        "splineops": ("splineops", _splineops_sample),
        "torch, tricubic": ("torch", _torch_sample),
        "drjit, trilinear": ("drjit", lambda work: _drjit(work, "eval")),
        "numba, trilinear": ("numba", _numba_points("sample_linear", "data")),
    },
    "gradient": {
        "drjit": ("drjit", lambda work: _drjit(work, "eval_cubic_grad")),
        "numba": ("numba", _numba_points("sample_gradient")),
    },
    "magnify": {
        "scipy": (None, _scipy_magnify),
        "VTK": ("VTK", _vtk_magnify),
        "SimpleITK": ("SimpleITK", _itk_magnify),
        "numba": ("numba", _numba_volume("magnify")),
    },
    "grid": {"SciPy": (None, _scipy_grid), "splineops": ("splineops", _splineops_grid), "PyTorch": ("torch", _torch_grid)},
    "frame": {
        "VTK ray cast, trilinear": ("VTK drawing", _vtk_frame("vtkFixedPointVolumeRayCastMapper")),
        "VTK OpenGL, trilinear": ("VTK drawing", _vtk_frame("vtkOpenGLGPUVolumeRayCastMapper")),
        "numba": ("numba", _numba_frame),
    },
}


def renderer_of_opengl() -> str | None:
    """The OpenGL renderer of VTK's mappers, such as "llvmpipe"."""
    if "VTK drawing" in missing():
        return None
    window = _vtk().vtkRenderWindow()
    window.SetOffScreenRendering(1)
    window.SetSize(8, 8)
    window.Render()
    lines: Iterator[str] = iter(window.ReportCapabilities().splitlines())
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("OpenGL renderer")), None)
