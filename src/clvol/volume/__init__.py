"""Samples and their placement in the world: volumes, series, missing samples, smoothing, transforms.

Only this wing converts between index space and world space.
"""
