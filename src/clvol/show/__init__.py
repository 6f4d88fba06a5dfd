"""Pictures as arrays, files and movies, and thumbnails for notebooks.

No module here renders a volume.
"""
