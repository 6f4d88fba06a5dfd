"""The kernels, sanitized by clang, on the host: `runtime` replaces OpenCL; the rest runs on it."""
