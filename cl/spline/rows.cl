// The function on rows of a grid whose axes are the volume's: sums of taps first along z, then y, then x.
//
// | what makes it fast                                              | where           |
// |-----------------------------------------------------------------|-----------------|
// | taps along one axis at a time: 3 TAPS for a point, not TAPS^3   | sum_slices      |
// | along x eight rows at once, a column of them in a vector        | sum_columns     |
// | BLOCK rows share what was summed along z                        | sum_slices      |
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

// The rows of coefficients that a block of rows of slice `k` is made from: in 3-D sums along z, `width` apart; else the slice's own.
//
// used: which rows of coefficients: `used_rows.y` from the first of `used_rows` on; in 3-D places of rows count among these.
INLINE global const scalar *sum_slices(global scalar *restrict sums, global const scalar *restrict coefficients, const size_t pitch,
                                       const size_t area, const int k, const int2 used_rows, global const int *restrict used,
                                       global const int *restrict z_place, global const scalar *restrict z_weight, const int width)
{
#if DIMENSIONS == 3
    for (int j = 0; j < used_rows.y; ++j)
        sum_rows_into(sums + j * (size_t)width, coefficients + used[used_rows.x + j] * pitch, area, z_place + k * TAPS,
                      z_weight + k * TAPS, width);
    return sums;
#else
    return coefficients + k * area;
#endif
}

// Up to eight rows summed along y, as columns of eight; `lines` is scratch.
INLINE void sum_to_columns(global scalar *restrict columns, global const scalar *restrict rows, const size_t apart,
                           global const int *restrict y_place, global const scalar *restrict y_weight, const int count,
                           const int width, global scalar *restrict lines)
{
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
}

// Eight points along x of eight rows, from column `i` of the grid on.
INLINE void sum_columns(scalar8 v[LANES], global const scalar *restrict columns, const int i, global const int *restrict x_place,
                        global const scalar *restrict x_weight)
{
#pragma unroll
    for (int n = 0; n < LANES; ++n) {
        v[n] = (scalar8)(0.0f);
        UNROLL_TAPS
        for (int t = 0; t < TAPS; ++t) {
            const int tap = (i + n) * TAPS + t;
            v[n] = madd((scalar8)(x_weight[tap]), *(global const scalar8_at *)(columns + x_place[tap]), v[n]);
        }
    }
}
