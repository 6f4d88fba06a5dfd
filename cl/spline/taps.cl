// Value, gradient and Hessian by direct taps: rows of taps are summed along y and z, and the resulting row is dotted with the
// weights along x.
//
// SIDE, set before this file is included, is the number of points summed at once. With 2, for rows of four taps, the rows of
// two points lie side by side in a vector of eight: point_lanes.cl. It is 1 if it was not set.
//
// Set by the host: DIMENSIONS, 1, 2 or 3, besides what is included.

#include "spline/cell.cl"
#include "spline/fetch.cl"

// Rows and slices of taps; and their weights, where the only one has weight `flat`.
#if DIMENSIONS >= 2
#define LINES TAPS
#define LINE(unpack, t, w, flat) unpack(t, w)
#else
#define LINES 1
#define LINE(unpack, t, w, flat) ((w)[0] = (flat))
#endif
#if DIMENSIONS == 3
#define SLICES TAPS
#define SLICE(unpack, t, w, flat) unpack(t, w)
#else
#define SLICES 1
#define SLICE(unpack, t, w, flat) ((w)[0] = (flat))
#endif

#ifndef SIDE
#define SIDE 1
#endif

// -- rows of one point, or of two side by side -------------------------------------------------------------------

#if SIDE == 1

typedef row_t rows_t;
typedef scalar weight_t;
typedef cursor_t cursors_t;

INLINE rows_t fetch_rows(COEFFICIENTS coefficients, const int4 extent, cursors_t c, int i, int j)
{
    return fetch_row(coefficients, extent, c, i, j);
}

INLINE cursors_t next_slices(COEFFICIENTS coefficients, const int4 extent, cursors_t c)
{
    return next_slice(coefficients, extent, c);
}

#else

typedef scalar8 rows_t, weight_t;
typedef struct { cursor_t low, high; } cursors_t;

INLINE rows_t fetch_rows(COEFFICIENTS coefficients, const int4 extent, cursors_t c, int i, int j)
{
    return (rows_t)(fetch_row(coefficients, extent, c.low, i, j), fetch_row(coefficients, extent, c.high, i, j));
}

INLINE cursors_t next_slices(COEFFICIENTS coefficients, const int4 extent, cursors_t c)
{
    const cursors_t next = { next_slice(coefficients, extent, c.low), next_slice(coefficients, extent, c.high) };
    return next;
}

#endif

INLINE rows_t sum_rows(COEFFICIENTS coefficients, const int4 extent, cursors_t slice, int first, const weight_t wy[LINES],
                       const weight_t wz[SLICES])
{
    rows_t sum = (rows_t)(0.0f);
    UNROLL_TAPS
    for (int k = 0; k < SLICES; ++k) {
        rows_t plane = (rows_t)(0.0f);
#pragma unroll
        for (int j = 0; j < LINES; ++j)
            plane = madd(wy[j], fetch_rows(coefficients, extent, slice, first, j), plane);
        sum = madd(wz[k], plane, sum);
        slice = next_slices(coefficients, extent, slice);
    }
    return sum;
}

// The same, and the sums with derivatives of the weights along y, and along z.
typedef struct { rows_t sum, sum_y, sum_z; } slopes_t;

INLINE slopes_t sum_slopes(COEFFICIENTS coefficients, const int4 extent, cursors_t slice, int first, const weight_t wy[LINES],
                           const weight_t sy[LINES], const weight_t wz[SLICES], const weight_t sz[SLICES])
{
    slopes_t s = { (rows_t)(0.0f), (rows_t)(0.0f), (rows_t)(0.0f) };
    UNROLL_TAPS
    for (int k = 0; k < SLICES; ++k) {
        rows_t plane = (rows_t)(0.0f), plane_y = plane;
#pragma unroll
        for (int j = 0; j < LINES; ++j) {
            const rows_t rows = fetch_rows(coefficients, extent, slice, first, j);
            plane = madd(wy[j], rows, plane);
            plane_y = madd(sy[j], rows, plane_y);
        }
        s.sum = madd(wz[k], plane, s.sum);
        s.sum_y = madd(wz[k], plane_y, s.sum_y);
        s.sum_z = madd(sz[k], plane, s.sum_z);
        slice = next_slices(coefficients, extent, slice);
    }
    return s;
}

// -- one point -------------------------------------------------------------------------------------------------

typedef struct { scalar x, y, z; } gradient_t;
typedef struct { scalar xx, yy, zz, xy, xz, yz; } hessian_t;

#if SIDE == 1

INLINE scalar taps_value(COEFFICIENTS coefficients, const int4 extent, cell_t c)
{
    const cursor_t first = cursor_at(coefficients, extent, c.x, c.y, c.z);
    scalar wy[WEIGHTS], wz[WEIGHTS], value = 0.0f;
    LINE(unpack_weights, c.ty, wy, 1.0f);
    SLICE(unpack_weights, c.tz, wz, 1.0f);
#pragma unroll
    for (int i = 0; i < CHUNKS; ++i)
        value += row_sum(sum_rows(coefficients, extent, first, i * ROW, wy, wz) * tap_weights(c.tx, i));
    return value;
}

INLINE gradient_t taps_gradient(COEFFICIENTS coefficients, const int4 extent, cell_t c, scalar *value)
{
    const cursor_t first = cursor_at(coefficients, extent, c.x, c.y, c.z);
    scalar wy[WEIGHTS], wz[WEIGHTS], sy[WEIGHTS], sz[WEIGHTS];
    gradient_t g = { 0.0f, 0.0f, 0.0f };
    LINE(unpack_weights, c.ty, wy, 1.0f);
    LINE(unpack_slopes, c.ty, sy, 0.0f);
    SLICE(unpack_weights, c.tz, wz, 1.0f);
    SLICE(unpack_slopes, c.tz, sz, 0.0f);
    *value = 0.0f;
#pragma unroll
    for (int i = 0; i < CHUNKS; ++i) {
        const slopes_t s = sum_slopes(coefficients, extent, first, i * ROW, wy, sy, wz, sz);
        const row_t wx = tap_weights(c.tx, i);
        *value += row_sum(s.sum * wx);
        g.x += row_sum(s.sum * tap_slopes(c.tx, i));
        g.y += row_sum(s.sum_y * wx);
        g.z += row_sum(s.sum_z * wx);
    }
    return g;
}

INLINE hessian_t taps_hessian(COEFFICIENTS coefficients, const int4 extent, cell_t c)
{
    const cursor_t first = cursor_at(coefficients, extent, c.x, c.y, c.z);
    scalar wy[WEIGHTS], wz[WEIGHTS], sy[WEIGHTS], sz[WEIGHTS], by[WEIGHTS], bz[WEIGHTS];
    hessian_t h = { 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f };
    LINE(unpack_weights, c.ty, wy, 1.0f);
    LINE(unpack_slopes, c.ty, sy, 0.0f);
    LINE(unpack_bends, c.ty, by, 0.0f);
    SLICE(unpack_weights, c.tz, wz, 1.0f);
    SLICE(unpack_slopes, c.tz, sz, 0.0f);
    SLICE(unpack_bends, c.tz, bz, 0.0f);
#pragma unroll
    for (int i = 0; i < CHUNKS; ++i) {
        cursor_t slice = first;
        row_t sum = (row_t)(0.0f), sum_y = sum, sum_z = sum, sum_yy = sum, sum_yz = sum, sum_zz = sum;
        UNROLL_TAPS
        for (int k = 0; k < SLICES; ++k, slice = next_slice(coefficients, extent, slice)) {
            row_t plane = (row_t)(0.0f), plane_y = plane, plane_yy = plane;
#pragma unroll
            for (int j = 0; j < LINES; ++j) {
                const row_t row = fetch_row(coefficients, extent, slice, i * ROW, j);
                plane = madd(wy[j], row, plane);
                plane_y = madd(sy[j], row, plane_y);
                plane_yy = madd(by[j], row, plane_yy);
            }
            sum = madd(wz[k], plane, sum);
            sum_y = madd(wz[k], plane_y, sum_y);
            sum_yy = madd(wz[k], plane_yy, sum_yy);
            sum_z = madd(sz[k], plane, sum_z);
            sum_yz = madd(sz[k], plane_y, sum_yz);
            sum_zz = madd(bz[k], plane, sum_zz);
        }
        const row_t wx = tap_weights(c.tx, i), sx = tap_slopes(c.tx, i);
        h.xx += row_sum(sum * tap_bends(c.tx, i));
        h.yy += row_sum(sum_yy * wx);
        h.zz += row_sum(sum_zz * wx);
        h.xy += row_sum(sum_y * sx);
        h.xz += row_sum(sum_z * sx);
        h.yz += row_sum(sum_yz * wx);
    }
    return h;
}

#endif
