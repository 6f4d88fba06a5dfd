// Kernel: fills what lies around the coefficients by the boundary rule, so that sampling inside the
// volume's domain never asks it again.

#include "base/platform.cl"

// One stored row for each work-item. places: where the coefficient is stored that stands for each stored column, then
// row, then slice; -1 if it is zero. size: coefficients proper along x.
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
        if (x == extent.w && source == row)
            x += size;
        row[x] = places[x] < 0 ? 0.0f : source[places[x]];
    }
}
