"""Pictures as arrays, files and movies, and what objects show of themselves in notebooks.

No module here draws a volume.
"""
