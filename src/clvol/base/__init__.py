"""Shared foundations: errors, argument checks, memory, files, numbers. Depends on NumPy only.

No module here knows about volumes or devices.
"""
