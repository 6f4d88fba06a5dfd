"""What a picture is to show: media, lights, camera, mode, transfer function, presets.

No module here needs a device.
"""
