"""The checks of ``clvol doctor``: is OpenCL usable, which runtime is used and why, and which extras are installed."""

from __future__ import annotations

import ctypes
import os
import re
import sys
from collections.abc import Callable, Iterator
from importlib.metadata import PackageNotFoundError, metadata, requires, version
from typing import NamedTuple

import numpy as np

import clvol
from clvol.base.errors import DeviceError
from clvol.device import Device, as_device, devices, probe
from clvol.device.opencl import INSTALL, kept_out
from clvol.device.runtimes import intel

__all__ = ["Check", "extras", "opencl"]

_USES = {
    "medical": "DICOM, NRRD, MetaImage, MGH; writing NIfTI",
    "microscopy": "TIFF stacks, Zarr",
    "hdf5": "HDF5, netCDF-4, Imaris",
    "s3": "stores at s3:// and https://",
    "vtk": "VTK files compressed with LZ4",
    "mesh": "meshes of surfaces, and their files",
    "bioio": "microscope vendors' files",
    "figures": "figures and reports",
    "movie": "movies as mp4 and webm",
    "view": "the viewer, in a browser and in notebooks",
    "desktop": "the viewer in a window",
    "xarray": "labelled arrays",
    "dask": "arrays larger than memory, clusters",
    "torch": "gradients of tensors",
    "jax": "gradients of JAX arrays",
    "nnunet": "nnU-Net's resampling",
    "monai": "MONAI's transforms",
    "torchio": "TorchIO's transforms",
    "nitransforms": "NiTransforms' chains of transforms",
    "napari": "napari's layers",
    "bench": "benchmarks against other libraries",
}
_TOOLS = ("pocl", "intel", "test", "dev", "docs")  # not needed to use clvol; the first two show up as devices


class Check(NamedTuple):
    """One check and its result."""

    check: str
    ok: bool
    detail: str  # what was found, or what to do


def opencl() -> Iterator[Check]:
    """Checks of what computing needs; each needs the ones before it. clvol is usable if the last is ``ok``. Never raises."""
    probe.forget()
    for what, look in (
        ("an OpenCL device", _found),
        ("the one that is used", _used),
        ("it builds kernels", _builds),
        ("it computes right values", _parity),
    ):
        done = _tried(what, look)
        yield done
        if not done.ok:
            return


def extras() -> Iterator[Check]:
    """Optional checks: Intel's runtime if it is installed but not found, and each extra of the package."""
    silent = _silent_intel()
    if silent:
        yield Check("Intel's runtime (optional)", False, silent)
    try:
        extras = metadata("clvol").get_all("Provides-Extra") or []
    except PackageNotFoundError:  # on the path, but not installed
        return
    for extra in extras:
        if extra in _TOOLS:
            continue
        there, missing = [], []
        for name in _packages(extra):
            try:
                there.append(f"{name} {version(name)}")
            except PackageNotFoundError:
                missing.append(name)
        uses = _USES.get(extra, "")
        what = [f"for {uses}: " if uses else "", f'pip install "clvol[{extra}]"', f" (brings {', '.join(missing)})"]
        detail = "".join(what) if missing else ", ".join(there) + (f": {uses}" if uses else "")
        yield Check(f"{extra} (optional)", not missing, detail)


def _tried(what: str, look: Callable[[], str]) -> Check:
    try:
        return Check(what, True, look())
    except Exception as error:  # whatever is wrong, the user wants to know
        return Check(what, False, " ".join(str(error).split()) or type(error).__name__)


def _named(device: Device) -> str:
    return f"{device.name} ({device.platform})"


def _found() -> str:
    names = [_named(device) for device in devices()]
    out = [f"{library} is left out: a trial of it {why}" for library, why in kept_out().items()]
    if not names:
        raise DeviceError("; ".join(["none was found", *out]) + f". {INSTALL}")
    return "; ".join([", ".join(names), *out])


def _used() -> str:
    """Which device is used by default, and why."""
    device, found = as_device(), devices()
    if os.environ.get("CLVOL_DEVICE"):
        why = f"CLVOL_DEVICE is {os.environ['CLVOL_DEVICE']}"
    elif len(found) == 1:
        why = "the only one"
    elif device.kind != "cpu":
        why = "GPUs come first"
    elif device.is_pocl:
        why = "the fastest on this processor, and it can link its kernels here"
    else:
        why = next((other.fault for other in found if other.fault), "the first one")
    return f"{_named(device)}: {why}"


def _builds() -> str:
    device = as_device()
    device.require_usable()
    return " ".join(filter(None, (device.name, device.compiled_for)))


def _parity() -> str:
    from clvol import reference

    points = np.random.default_rng(0).uniform(0, 8, (1000, 3))
    volume = clvol.Volume(np.random.default_rng(1).standard_normal((9, 9, 9)))
    error = float(np.abs(clvol.sample(volume, points) - reference.sample(volume, points, "bspline3")).max())
    if not error < 1e-4:
        raise DeviceError(f"this device computes wrong values: off by {error:.2g}")
    return f"largest difference from the reference {error:.1e}"


def _silent_intel() -> str:
    """Why Intel's runtime is installed but shows no device; "" if it shows one, or is not installed."""
    runtime = intel.library()
    try:
        if runtime is None or any("intel" in device.platform.lower() and device.kind == "cpu" for device in devices()):
            return ""
        ctypes.CDLL(str(runtime))
    except DeviceError:  # reported by another check
        return ""
    except OSError as error:
        return f'{runtime} does not load ({error}): pip install "clvol[intel]" brings what it needs'
    why = "by an administrator's shell" if sys.platform == "win32" else "by OCL_ICD_VENDORS"
    return f"{runtime} is kept out {why}, or cannot run on this processor"


def _packages(extra: str) -> list[str]:
    """Distributions that an extra installs, directly or through other extras."""
    found: dict[str, None] = {}
    for line in requires("clvol") or []:
        if not re.search(rf"""extra *== *['"]{re.escape(extra)}['"]""", line):
            continue
        name = re.match(r"[\w.-]+", line)
        inner = re.match(r"clvol\[([\w,.-]+)\]", line)
        names = [p for e in inner[1].split(",") for p in _packages(e)] if inner else [name[0]] if name else []
        found |= dict.fromkeys(names)
    return list(found)
