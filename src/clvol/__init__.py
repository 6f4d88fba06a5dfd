"""Volume rendering and reconstruction with B-splines, on OpenCL."""
