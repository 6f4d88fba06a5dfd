"""What single OpenCL runtimes need: where Intel's is found, where PoCL builds, and which processor it builds for."""
