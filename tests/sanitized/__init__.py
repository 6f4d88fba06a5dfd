"""The kernels, sanitized by clang, on the host: `runtime` in the place of OpenCL, and what runs on it."""
