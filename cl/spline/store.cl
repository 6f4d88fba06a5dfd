// Kernel: copies results to an array of any type and layout.
//
// Set by the host: RESULT, the type of the array; WHOLE: 0 for floating point; 1 for integers, with halves rounded away from zero; 2
// for booleans, whether the magnitude is at least 1. scipy.ndimage does the same.

#include "base/platform.cl"

INLINE RESULT stored(scalar value, const scalar low, const scalar high)
{
#if WHOLE == 1
    value += value > 0 ? (scalar)0.5f : (scalar)-0.5f;
#elif WHOLE == 2
    value = value < 0 ? -value : value;
#endif
#if WHOLE
    value = value > low ? value < high ? value : high : low;   // NaN becomes `low`
#endif
    return (RESULT)value;
}

// Rows of `count` results along id 0, `pitch` apart, and slices along id 1, `area` apart, to the `first` place of the array and
// those `strides` apart along x, y and z. slices, bundle: as in copy_samples. low, high: of whole numbers.
kernel void store_results(global const scalar *restrict results, const ulong origin, const ulong pitch, const ulong area,
                          const int count, const int slices, const int bundle, global RESULT *restrict array, const long first,
                          const long4 strides, const scalar low, const scalar high)
{
    const size_t j = get_global_id(0), k = get_global_id(1) * bundle;
    global const scalar *from = results + (origin + k * area + j * pitch);
    global RESULT *to = array + (first + (long)k * strides.z + (long)j * strides.y);
    const int some = MIN(bundle, slices - (int)k);
    if (bundle > 1)
        for (int i = 0; i < count; ++i)
            for (int b = 0; b < some; ++b)
                to[i * strides.x + b * strides.z] = stored(from[b * area + i], low, high);
    else if (strides.x == 1)
        for (int i = 0; i < count; ++i)
            to[i] = stored(from[i], low, high);
    else
        for (int i = 0; i < count; ++i)
            to[i * strides.x] = stored(from[i], low, high);
}
