"""Interfaces known from other libraries, and pictures of many volumes.

The functions of `clvol` that stand on everything else.
"""
