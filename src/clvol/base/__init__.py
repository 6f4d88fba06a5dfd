"""What every wing stands on: errors, checks of arguments, memory, files, numbers. NumPy only.

No module here knows what a volume or a device is.
"""
