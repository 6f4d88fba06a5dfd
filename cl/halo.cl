// Kernel: fills what lies around the coefficients by the boundary rule, so that sampling inside the
// volume's domain never asks it again.

#include "common.cl"
#include "boundary.cl"

// One work-item for each stored coefficient; size and period count coefficients.
kernel void fill_halo(global float *coefficients, const int4 extent, const int4 size, const int4 period)
{
    const int halo = extent.w, halo_z = size.z > 1 || extent.z > 1 ? halo : 0;
    const int x = (int)get_global_id(0) - halo, y = (int)get_global_id(1) - halo, z = (int)get_global_id(2) - halo_z;
    if (x >= 0 && x < size.x && y >= 0 && y < size.y && z >= 0 && z < size.z)
        return;
    const int i = boundary_index(x, 0, size.x, period.x), j = boundary_index(y, 0, size.y, period.y),
              k = halo_z ? boundary_index(z, 0, size.z, period.z) : 0;
    const size_t row = extent.x, slice = row * extent.y;
    coefficients[(z + halo_z) * slice + (y + halo) * row + x + halo] =
        i == MISSING || j == MISSING || k == MISSING ? 0.0f
            : coefficients[(k + halo_z) * slice + (j + halo) * row + i + halo];
}
