"""Reconstruction filters: their table, their responses, and the boundary rules.

No module here knows about volumes.
"""
