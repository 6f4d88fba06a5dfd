"""SciPy's interpolation of arrays, on OpenCL."""
