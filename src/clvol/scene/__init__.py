"""The content of a picture: media, lights, camera, mode, transfer function, presets.

No module here needs a device.
"""
