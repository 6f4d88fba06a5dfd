// Kernels: samples of any type to where their coefficients will be; and the halo around coefficients.
//
// The halo holds what the boundary rule says lies past the edge, so that sampling inside the volume's domain never needs
// the rule.
//
// Set by the host: SAMPLE, the type of samples, and SAMPLE_DOUBLE, whether that is double.

#include "base/platform.cl"

#if SAMPLE_DOUBLE
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
#endif

// Rows of `count` samples along id 0, slices along id 1. The first sample goes to `origin`; rows lie `pitch` apart and
// slices `area`.
kernel void copy_samples(global const SAMPLE *restrict samples, global float *restrict coefficients, const ulong origin,
                         const int count, const ulong pitch, const ulong area)
{
    const size_t j = get_global_id(0), k = get_global_id(1);
    global const SAMPLE *from = samples + (k * get_global_size(0) + j) * count;
    global float *to = coefficients + origin + k * area + j * pitch;
    for (int i = 0; i < count; ++i)
        to[i] = from[i];
}

// One stored row for each work-item. places: for each stored column, then row, then slice, where the coefficient lies
// that belongs there; -1 if it is zero. size: coefficients proper along x.
kernel void fill_halo(global float *coefficients, const int4 extent, const int size, global const int *places)
{
    const int y = get_global_id(0), z = get_global_id(1);
    const int j = places[extent.x + y], k = places[extent.x + extent.y + z];
    global float *row = coefficients + ((size_t)z * extent.y + y) * extent.x;
    if (j < 0 || k < 0) {
        for (int x = 0; x < extent.x; ++x)
            row[x] = 0.0f;
        return;
    }
    global const float *source = coefficients + ((size_t)k * extent.y + j) * extent.x;
    for (int x = 0; x < extent.x; ++x) {
        if (x == extent.w && source == row)   // the coefficients themselves
            x += size;
        row[x] = places[x] < 0 ? 0.0f : source[places[x]];
    }
}
