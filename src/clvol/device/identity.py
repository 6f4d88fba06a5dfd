"""What a device reports about itself; every quirk that needs no context is a named predicate here."""

from __future__ import annotations

from functools import cached_property
from typing import Any

from clvol.device.opencl import opencl

__all__ = ["Identity"]


class Identity:
    """Name, kind and capabilities of an OpenCL device."""

    def __init__(self, handle: Any) -> None:
        self.handle = handle

    def __repr__(self) -> str:
        return f"<Device {self.name!r} on {self.platform!r}>"

    @cached_property
    def name(self) -> str:
        return str(self.handle.name).strip()

    @cached_property
    def platform(self) -> str:
        return str(self.handle.platform.name).strip()

    @cached_property
    def kind(self) -> str:
        """Kind of device: "cpu", "gpu" or "accelerator"."""
        kinds = opencl().device_type
        return "cpu" if self.handle.type & kinds.CPU else "gpu" if self.handle.type & kinds.GPU else "accelerator"

    @property
    def is_pocl(self) -> bool:
        return "portable computing language" in self.platform.lower()

    @cached_property
    def has_double(self) -> bool:
        return "cl_khr_fp64" in str(self.handle.extensions)

    @property
    def shares_memory(self) -> bool:
        """Whether mapped buffers are host memory."""
        return bool(self.handle.host_unified_memory)

    @cached_property
    def units(self) -> int:
        """Number of compute units: the cores of a processor."""
        return int(self.handle.max_compute_units)

    @property
    def largest(self) -> int:
        """Size of the largest buffer, in bytes."""
        return int(self.handle.max_mem_alloc_size)

    @property
    def total(self) -> int:
        """Size of the device's memory, in bytes."""
        return int(self.handle.global_mem_size)

    @cached_property
    def image_limit(self) -> int:
        """Largest extent of a 3-D image along any axis."""
        h = self.handle
        return int(min(h.image3d_max_width, h.image3d_max_height, h.image3d_max_depth))

    def alone(self, dimensions: int) -> tuple[int, ...] | None:
        """Work-group size: one work-item on a processor; elsewhere the runtime chooses.

        PoCL compiles a kernel for each work-group size, and would choose another one for almost every global size.
        """
        return (1,) * dimensions if self.kind == "cpu" else None
