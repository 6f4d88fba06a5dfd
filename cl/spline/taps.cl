// Rows of taps blended along y and z, for one point or for two whose rows lie side by side in a vector.
//
// Set before: SIDE, 1 or 2; 1 if not, and 2 for rows of four alone.

#include "spline/fetch.cl"

#if DIMENSIONS == 3
#define SLICES TAPS
#else
#define SLICES 1
#endif

#ifndef SIDE
#define SIDE 1
#endif

#if SIDE == 1
typedef row_t rows_t;
typedef float weight_t;
typedef cursor_t cursors_t;
#define FETCH_ROWS(c, i, j) fetch_row(VOLUME, c, i, j)
#define NEXT_SLICES(c) c = next_slice(VOLUME, c)
#else
typedef float8 rows_t, weight_t;
typedef struct { cursor_t low, high; } cursors_t;
#define FETCH_ROWS(c, i, j) (rows_t)(fetch_row(VOLUME, (c).low, i, j), fetch_row(VOLUME, (c).high, i, j))
#define NEXT_SLICES(c) (c).low = next_slice(VOLUME, (c).low), (c).high = next_slice(VOLUME, (c).high)
#endif

INLINE rows_t blend_rows(VOLUME_PARAMS, cursors_t slice, int first, const weight_t wy[TAPS], const weight_t wz[SLICES])
{
    rows_t sum = (rows_t)(0.0f);
    UNROLL_TAPS
    for (int k = 0; k < SLICES; ++k) {
        rows_t plane = (rows_t)(0.0f);
#pragma unroll
        for (int j = 0; j < TAPS; ++j)
            plane = madd(wy[j], FETCH_ROWS(slice, first, j), plane);
        sum = madd(wz[k], plane, sum);
        NEXT_SLICES(slice);
    }
    return sum;
}

// The same, and with slopes instead of weights along y, and along z.
typedef struct { rows_t sum, sum_y, sum_z; } slopes_t;

INLINE slopes_t blend_slopes(VOLUME_PARAMS, cursors_t slice, int first, const weight_t wy[TAPS], const weight_t sy[TAPS],
                             const weight_t wz[SLICES], const weight_t sz[SLICES])
{
    slopes_t s = { (rows_t)(0.0f), (rows_t)(0.0f), (rows_t)(0.0f) };
    UNROLL_TAPS
    for (int k = 0; k < SLICES; ++k) {
        rows_t plane = (rows_t)(0.0f), plane_y = plane;
#pragma unroll
        for (int j = 0; j < TAPS; ++j) {
            const rows_t rows = FETCH_ROWS(slice, first, j);
            plane = madd(wy[j], rows, plane);
            plane_y = madd(sy[j], rows, plane_y);
        }
        s.sum = madd(wz[k], plane, s.sum);
        s.sum_y = madd(wz[k], plane_y, s.sum_y);
        s.sum_z = madd(sz[k], plane, s.sum_z);
        NEXT_SLICES(slice);
    }
    return s;
}
