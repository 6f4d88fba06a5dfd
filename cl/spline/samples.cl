// Kernel: samples of any type into the place of coefficients.
//
// Set by the host: SAMPLE, their type.

#include "base/platform.cl"

#if SAMPLE_DOUBLE
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
#endif

// Rows of `count` samples along id 0, slices along id 1; the first is stored at `origin`, the next `pitch` and `area` on.
kernel void copy_samples(global const SAMPLE *restrict samples, global float *restrict coefficients, const ulong origin,
                         const int count, const ulong pitch, const ulong area)
{
    const size_t j = get_global_id(0), k = get_global_id(1);
    global const SAMPLE *from = samples + (k * get_global_size(0) + j) * count;
    global float *to = coefficients + origin + k * area + j * pitch;
    for (int i = 0; i < count; ++i)
        to[i] = from[i];
}
