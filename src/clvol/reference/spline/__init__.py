"""The function between the samples: filters, boundaries, prefilter, values at points and on lattices."""
