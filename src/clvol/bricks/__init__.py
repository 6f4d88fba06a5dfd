"""Volumes that are larger than memory, and their function brick by brick.

Bricks of coefficients are resident for as long as a budget of memory allows.
"""
