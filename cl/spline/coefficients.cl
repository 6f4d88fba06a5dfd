// Kernels: copy samples of any type to where their coefficients will be, and fill the halo around coefficients.
//
// The halo is filled by the boundary rule, so that sampling inside the volume's domain never needs the rule.
//
// Set by the host: SAMPLE, the type of samples.

#include "base/platform.cl"

// Samples from the `first` one on, `strides` apart along x, y and z, to rows `pitch` apart of slices `area` apart, the first of
// them at `origin`; they are multiplied by `gain`. Rows lie along id 0, and `bundle` of the slices at a time along id 1: one is
// copied after the other, or, if there are several, a column of all after the other, for these then lie closer in memory.
kernel void copy_samples(global const SAMPLE *restrict samples, const long first, const long4 strides,
                         global scalar *restrict coefficients, const ulong origin, const int count, const int slices,
                         const int bundle, const ulong pitch, const ulong area, const scalar gain)
{
    const size_t j = get_global_id(0), k = get_global_id(1) * bundle;
    global const SAMPLE *from = samples + (first + (long)k * strides.z + (long)j * strides.y);
    global scalar *to = coefficients + origin + k * area + j * pitch;
    const int some = MIN(bundle, slices - (int)k);
    if (bundle > 1)
        for (int i = 0; i < count; ++i)
            for (int b = 0; b < some; ++b)
                to[b * area + i] = gain * from[i * strides.x + b * strides.z];
    else if (strides.x == 1)
        for (int i = 0; i < count; ++i)
            to[i] = gain * from[i];
    else
        for (int i = 0; i < count; ++i)
            to[i] = gain * from[i * strides.x];
}

// One stored row for each work-item. places: for each stored column, then row, then slice, where the coefficient lies
// that belongs there; -1 if it is `beyond`. first, count: the coefficients along x that stay what they are.
kernel void fill_halo(global scalar *coefficients, const int4 extent, const int first, const int count, global const int *places,
                      const scalar beyond)
{
    const int y = get_global_id(0), z = get_global_id(1);
    const int j = places[extent.x + y], k = places[extent.x + extent.y + z];
    global scalar *row = coefficients + ((size_t)z * extent.y + y) * extent.x;
    if (j < 0 || k < 0) {
        for (int x = 0; x < extent.x; ++x)
            row[x] = beyond;
        return;
    }
    global const scalar *source = coefficients + ((size_t)k * extent.y + j) * extent.x;
    for (int x = 0; x < extent.x; ++x) {
        if (x == first && source == row)
            x += count;
        row[x] = places[x] < 0 ? beyond : source[places[x]];
    }
}

// The coefficients of function f of several, to where they lie next to the others', `apart` from each other.
kernel void interleave(global const scalar *restrict from, global scalar *restrict to, const int apart, const int f)
{
    const size_t i = get_global_id(0);
    to[i * apart + f] = from[i];
}
