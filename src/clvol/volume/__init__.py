"""Samples and where they lie in the world: volumes, series of them, missing samples, noise, transforms.

The only wing in which index space and world space meet.
"""
