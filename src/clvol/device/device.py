"""A device to compute on: its buffers, its programs, and how work on it is split."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from clvol.device.buffers import Buffers, float_format
from clvol.device.driver import Driver, Once
from clvol.device.launches import Launches, Limits
from clvol.device.opencl import opencl
from clvol.device.program import Defines, Program
from clvol.device.programs import Programs

__all__ = ["Device"]

_SAMPLER_POSITIONS = 4097
_LIMITS = Limits()


class Device(Driver):
    """An OpenCL device with its context, queue, buffers and programs; one object for each device of a process.

    Use `as_device` to get one. Buffers, programs and renderers hold the device they were created on.

    Attributes
    ----------
    buffers : Buffers
    launches : Launches
    programs : Programs
    """

    def __init__(self, handle: Any) -> None:
        super().__init__(handle)
        self.launches = Launches(self)
        self.buffers = Buffers(self, self.launches)
        self.programs = Programs(self, self.launches)
        self._limited = threading.local()

    @Once
    def has_images(self) -> bool:
        """Whether volumes can be stored as images and read with the linear sampler.

        PoCL on CUDA and some AMD devices have no images; a few drivers lack the float format.
        """
        if not self.handle.image_support:
            return False
        cl = opencl()
        with self.errors:
            formats = cl.get_supported_image_formats(self.context, cl.mem_flags.READ_ONLY, cl.mem_object_type.IMAGE3D)
        return float_format() in formats

    @Once
    def sampler_bits(self) -> float:
        """Bits of the linear sampler's fraction, measured once; 0 if it does not interpolate.

        Texture units of GPUs have 8; samplers in software have 20 or more.
        """
        if not self.has_images:
            return 0.0
        measured = np.empty(_SAMPLER_POSITIONS, np.float32)
        ramp = self.buffers.image_of(self.buffers.upload(np.tile(np.array([0, 1], np.float32), (2, 2, 1))), (2, 2, 2))
        with self.buffers.lent(measured, write=True) as values, self.errors:
            kernel = self.build("base/sampler.cl", {"COORD_DOUBLE": 0}).kernel("sample_ramp")
            kernel(self.queue, measured.shape, None, ramp, np.float32(1 / (_SAMPLER_POSITIONS - 1)), values)
        error = float(np.abs(measured - np.linspace(0, 1, _SAMPLER_POSITIONS)).max())
        return 0.0 if error > 0.1 else float(-np.log2(2 * max(error, 2.0**-25)))

    def build(
        self, name: str, defines: Defines, replacements: Mapping[str, str] | None = None, generated: Mapping[str, str] | None = None
    ) -> Program:
        """The program of one kernel file, see `Programs.build`."""
        return self.programs.build(name, defines, replacements, generated)

    @property
    def limits(self) -> Limits:
        """How this thread's work on the device is split."""
        return getattr(self._limited, "limits", _LIMITS)

    @contextmanager
    def limited(self, **changes: Any) -> Iterator[None]:
        """Other `limits` for this thread, for the duration of a block."""
        before = self.limits
        self._limited.limits = replace(before, **changes)
        try:
            yield
        finally:
            self._limited.limits = before

    def finish(self) -> None:
        """Wait for all launches, see `Launches.finish`."""
        self.launches.finish()

    def _end(self) -> None:
        """At the end of the process: a runtime does not survive it while it compiles."""
        if self.forked:
            return
        try:
            self.programs.wait()
            self.launches.end()
        except KeyboardInterrupt:
            os._exit(130)  # an interrupted user does not wait
