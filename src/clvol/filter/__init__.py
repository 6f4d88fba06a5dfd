"""Reconstruction filters: the table of them, their responses, and the boundary rules.

No module here knows what a volume is.
"""
