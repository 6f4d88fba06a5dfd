"""``clvol doctor``: whether OpenCL works here."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import clvol
from clvol.cli.options import Json
from clvol.cli.root import SETUP, command
from clvol.cli.speech import one_line, print_json
from clvol.errors import DeviceError

__all__ = ["doctor"]


@command(SETUP)
def doctor(*, json: Json = False) -> None:
    """Find out whether OpenCL is usable here, and what to install if it is not."""
    import numpy as np

    from clvol.device import as_device

    checks: list[dict[str, Any]] = []

    def check(what: str, action: Callable[[], str]) -> bool:
        try:
            result, good = action(), True
        except Exception as error:  # whatever is wrong here is what the user wants to know
            result, good = one_line(error), False
        checks.append({"check": what, "ok": good, "detail": result})
        return good

    def found() -> str:
        names = [f"{d.name} ({d.platform})" for d in clvol.devices()]
        if not names:
            raise DeviceError(
                "none was found. Without a GPU, on Linux x86-64: pip install clvol[pocl]; "
                "with one: install its vendor's OpenCL driver"
            )
        return ", ".join(names)

    def builds() -> str:
        device = as_device()
        device.require_usable()
        return device.name

    def parity() -> str:
        points = np.random.default_rng(0).uniform(0, 8, (1000, 3))
        volume = clvol.Volume(np.random.default_rng(1).standard_normal((9, 9, 9)))
        from clvol import reference

        error = float(np.abs(clvol.sample(volume, points) - reference.sample(volume, points, "bspline3")).max())
        if not error < 1e-4:
            raise DeviceError(f"this device computes wrong values: off by {error:.2g}")
        return f"largest difference from the reference {error:.1e}"

    ready = check("an OpenCL device", found)
    ready = ready and check("it builds kernels", builds)
    ready = ready and check("it computes right values", parity)
    for extra, module, what in (
        ("medical", "SimpleITK", "NRRD, MetaImage, DICOM, writing NIfTI"),
        ("microscopy", "tifffile", "TIFF stacks"),
        ("figures", "matplotlib", "figures and reports"),
    ):
        import importlib.util

        there = importlib.util.find_spec(module) is not None
        detail = what if there else f"for {what}: pip install clvol[{extra}]"
        checks.append({"check": f"{module} (optional)", "ok": there, "detail": detail})
    if json:
        print_json({"usable": ready, "checks": checks})
    else:
        for c in checks:
            print(f"{'ok' if c['ok'] else '--'}  {c['check']}: {c['detail']}")
    if not ready:
        raise SystemExit(1)
