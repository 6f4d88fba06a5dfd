// Kernel: the function on a lattice whose axes are the volume's, first along z, then y, then x.
//
// Set by the host: TAPS, DIMENSIONS and BLOCK (rows made at once, a multiple of 8). Which coefficients make a slice, a
// row and a column of the lattice, and with what weights, is worked out there too, axis by axis (spline.py, _axis_taps).

#include "base/platform.cl"
#include "base/transpose.cl"

// One row, `width` long (a multiple of 8), as a sum over rows that lie `apart`.
INLINE void blend_row(global float *restrict blend, global const float *restrict rows, const size_t apart,
                      global const int *restrict place, global const float *restrict weight, const int width)
{
    for (int i = 0; i < width; i += LANES) {
        float8 sum = (float8)(0.0f);
        UNROLL_TAPS
        for (int t = 0; t < TAPS; ++t)
            sum = madd((float8)(weight[t]), *(global const float8_at *)(rows + place[t] * apart + i), sum);
        *(global float8_at *)(blend + i) = sum;
    }
}

// Up to eight rows of the lattice from rows of coefficients.
INLINE void resample_rows(global float *restrict result, global const float *restrict rows, const size_t apart,
                          global const int *restrict y_place, global const float *restrict y_weight,
                          global const int *restrict x_place, global const float *restrict x_weight,
                          const int count, const int points, const int width, global float *restrict scratch)
{
    global float *lines = scratch, *columns = scratch + LANES * width;
    float8 v[LANES];
    for (int r = 0; r < LANES; ++r) {
        const size_t row = MIN(r, count - 1) * TAPS;
        blend_row(lines + r * width, rows, apart, y_place + row, y_weight + row, width);
    }
    for (int i = 0; i < width; i += LANES) {
        load_columns(v, lines + i, width, LANES);
#pragma unroll
        for (int n = 0; n < LANES; ++n)
            *(global float8_at *)(columns + (i + n) * LANES) = v[n];
    }
    for (int i = 0; i < points; i += LANES) {
#pragma unroll
        for (int n = 0; n < LANES; ++n) {
            v[n] = (float8)(0.0f);
            UNROLL_TAPS
            for (int t = 0; t < TAPS; ++t) {
                const int tap = (i + n) * TAPS + t;
                v[n] = madd((float8)(x_weight[tap]), *(global const float8_at *)(columns + x_place[tap]), v[n]);
            }
        }
        if (i + LANES <= points)
            store_columns(v, result + i, points, count);
        else {
            store_columns(v, lines, LANES, LANES);
            for (int r = 0; r < count; ++r)
                for (int n = i; n < points; ++n)
                    result[r * (size_t)points + n] = lines[r * LANES + n - i];
        }
    }
}

// A work-item makes some of `units` in turn, each BLOCK rows of one slice of the lattice; those of a block of rows
// follow each other, for neighbouring slices come from much the same coefficients, which then are still in the cache.
//
// lattice: points along x, y and z, and where those along y begin in places and weights: TAPS for each column (of whole
// vectors; places times LANES), row and slice. blocks: which of `used` rows of
// coefficients a block is made from, the first and how many; in 3-D places of rows count among these. scratch: `room` for
// each work-item.
kernel void resample_axes(global const float *restrict coefficients, const int left, const ulong pitch,
                          const ulong area, const int width, global const int *restrict places, global const float *restrict weights,
                          global const int2 *restrict blocks, global const int *restrict used, const int4 lattice,
                          const int first, const int units, global float *restrict scratch, const ulong room,
                          global float *restrict results)
{
    const size_t item = get_global_id(0), items = get_global_size(0);
    const size_t along_y = lattice.w, along_z = along_y + (size_t)lattice.y * TAPS;
    global float *mine = scratch + item * room;
    coefficients += left;
    const int end = first + units * (item + 1) / items;
    for (int unit = first + units * item / items; unit < end; ++unit) {
        const int block = unit / lattice.z, k = unit % lattice.z;
#if DIMENSIONS == 3
        const size_t slice = along_z + k * TAPS, apart = width;
        global float *rows = mine + 2 * LANES * width;
        for (int j = 0; j < blocks[block].y; ++j)
            blend_row(rows + j * apart, coefficients + used[blocks[block].x + j] * pitch, area, places + slice,
                      weights + slice, width);
#else
        const size_t apart = pitch;
        global const float *rows = coefficients;
#endif
        for (int j = block * BLOCK; j < MIN((block + 1) * BLOCK, lattice.y); j += LANES)
            resample_rows(results + ((size_t)k * lattice.y + j) * lattice.x, rows, apart,
                          places + along_y + j * TAPS, weights + along_y + j * TAPS, places, weights,
                          MIN(LANES, lattice.y - j), lattice.x, width, mine);
    }
}
