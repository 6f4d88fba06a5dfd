"""The function between the samples in float64: kernels, boundaries, prefilter, points and grids."""
