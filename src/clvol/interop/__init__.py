"""Objects of other libraries: arrays and tensors, and images with all that they say of themselves. One file a library."""
