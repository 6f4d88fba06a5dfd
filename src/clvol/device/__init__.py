"""OpenCL devices: choosing one, its memory, its programs and its launches.

Importing this loads no OpenCL: the runtime is looked for when a device is first needed.
"""

from __future__ import annotations

from clvol.device.choose import as_device, devices
from clvol.device.device import Device
from clvol.device.launches import Limits, Tile

__all__ = ["Device", "Limits", "Tile", "as_device", "devices"]
