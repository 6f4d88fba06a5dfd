// Kernel: the function on a grid whose axes are the volume's. What makes it fast, and what the host sets: rows.cl.

#include "spline/rows.cl"

// Up to eight rows of the grid from rows of coefficients.
INLINE void resample_rows(global scalar *restrict result, global const scalar *restrict rows, const size_t apart,
                          global const int *restrict y_place, global const scalar *restrict y_weight,
                          global const int *restrict x_place, global const scalar *restrict x_weight,
                          const int count, const int points, const int width, global scalar *restrict scratch)
{
    global scalar *lines = scratch, *columns = scratch + LANES * width;
    scalar8 v[LANES];
    sum_to_columns(columns, rows, apart, y_place, y_weight, count, width, lines);
    for (int i = 0; i < points; i += LANES) {
        sum_columns(v, columns, i, x_place, x_weight);
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
    const size_t along_y = grid.w, along_z = along_y + (size_t)grid.y * TAPS;
    global scalar *mine = scratch + item * room;
    coefficients += left;
    const int end = first + units * (item + 1) / items;
    for (int unit = first + units * item / items; unit < end; ++unit) {
        const int block = unit / grid.z, k = unit % grid.z;
        const size_t apart = DIMENSIONS == 3 ? width : pitch;
        global const scalar *rows = sum_slices(mine + 2 * LANES * width, coefficients, pitch, area, k, blocks[block], used,
                                               places + along_z, weights + along_z, width);
        for (int j = block * BLOCK; j < MIN((block + 1) * BLOCK, grid.y); j += LANES)
            resample_rows(results + ((size_t)k * grid.y + j) * grid.x, rows, apart,
                          places + along_y + j * TAPS, weights + along_y + j * TAPS, places, weights,
                          MIN(LANES, grid.y - j), grid.x, width, mine);
    }
}
