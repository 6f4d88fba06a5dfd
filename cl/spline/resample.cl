// Kernel: the function on a grid whose axes are the volume's: sums of taps first along z, then y, then x.
//
// | what makes it fast                                              | where           |
// |-----------------------------------------------------------------|-----------------|
// | taps along one axis at a time: 3 TAPS for a point, not TAPS^3   | resample_axes   |
// | along x eight rows at once, a column of them in a vector        | resample_rows   |
// | BLOCK rows share what was summed along z                        | resample_axes   |
//
// Set by the host: TAPS; DIMENSIONS; BLOCK, rows computed at once, a multiple of 8. The host also computes the coefficients of each
// column, row and slice of the grid, and their weights (coefficients.py, axis_taps).

#include "base/platform.cl"
#include "base/transpose.cl"

// One row, `width` long (a multiple of 8), as a weighted sum of rows that lie `apart`.
INLINE void sum_rows_into(global scalar *restrict row, global const scalar *restrict rows, const size_t apart,
                      global const int *restrict place, global const scalar *restrict weight, const int width)
{
    for (int i = 0; i < width; i += LANES) {
        scalar8 sum = (scalar8)(0.0f);
        UNROLL_TAPS
        for (int t = 0; t < TAPS; ++t)
            sum = madd((scalar8)(weight[t]), *(global const scalar8_at *)(rows + place[t] * apart + i), sum);
        *(global scalar8_at *)(row + i) = sum;
    }
}

// Up to eight rows of the grid from rows of coefficients.
INLINE void resample_rows(global scalar *restrict result, global const scalar *restrict rows, const size_t apart,
                          global const int *restrict y_place, global const scalar *restrict y_weight,
                          global const int *restrict x_place, global const scalar *restrict x_weight,
                          const int count, const int points, const int width, global scalar *restrict scratch)
{
    global scalar *lines = scratch, *columns = scratch + LANES * width;
    scalar8 v[LANES];
    for (int r = 0; r < LANES; ++r) {
        const size_t row = MIN(r, count - 1) * TAPS;
        sum_rows_into(lines + r * width, rows, apart, y_place + row, y_weight + row, width);
    }
    for (int i = 0; i < width; i += LANES) {
        load_columns(v, lines + i, width, LANES);
#pragma unroll
        for (int n = 0; n < LANES; ++n)
            *(global scalar8_at *)(columns + (i + n) * LANES) = v[n];
    }
    for (int i = 0; i < points; i += LANES) {
#pragma unroll
        for (int n = 0; n < LANES; ++n) {
            v[n] = (scalar8)(0.0f);
            UNROLL_TAPS
            for (int t = 0; t < TAPS; ++t) {
                const int tap = (i + n) * TAPS + t;
                v[n] = madd((scalar8)(x_weight[tap]), *(global const scalar8_at *)(columns + x_place[tap]), v[n]);
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

// A work-item makes some of `units` in turn, each BLOCK rows of one slice of the grid. Slices of the same rows follow each
// other: neighbours come from much the same coefficients, which are then still in the cache.
//
// grid: points along x, y and z; and where those along y begin in `places` and `weights`, which hold TAPS numbers for each
// column (of whole vectors; places times LANES), row and slice. blocks: which of the `used` rows of coefficients a block is
// made from: the first, and how many; in 3-D places of rows count among these. scratch: `room` for each work-item.
kernel void resample_axes(global const scalar *restrict coefficients, const int left, const ulong pitch,
                          const ulong area, const int width, global const int *restrict places, global const scalar *restrict weights,
                          global const int2 *restrict blocks, global const int *restrict used, const int4 grid,
                          const int first, const int units, global scalar *restrict scratch, const ulong room,
                          global scalar *restrict results)
{
    const size_t item = get_global_id(0), items = get_global_size(0);
    const size_t along_y = grid.w;
#if DIMENSIONS == 3
    const size_t along_z = along_y + (size_t)grid.y * TAPS;
#endif
    global scalar *mine = scratch + item * room;
    coefficients += left;
    const int end = first + units * (item + 1) / items;
    for (int unit = first + units * item / items; unit < end; ++unit) {
        const int block = unit / grid.z, k = unit % grid.z;
#if DIMENSIONS == 3
        const size_t slice = along_z + k * TAPS, apart = width;
        global scalar *rows = mine + 2 * LANES * width;
        for (int j = 0; j < blocks[block].y; ++j)
            sum_rows_into(rows + j * apart, coefficients + used[blocks[block].x + j] * pitch, area, places + slice,
                      weights + slice, width);
#else
        const size_t apart = pitch;
        global const scalar *rows = coefficients + k * area;   // each slice has coefficients of its own
#endif
        for (int j = block * BLOCK; j < MIN((block + 1) * BLOCK, grid.y); j += LANES)
            resample_rows(results + ((size_t)k * grid.y + j) * grid.x, rows, apart,
                          places + along_y + j * TAPS, weights + along_y + j * TAPS, places, weights,
                          MIN(LANES, grid.y - j), grid.x, width, mine);
    }
}
