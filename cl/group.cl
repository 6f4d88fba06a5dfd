// LANES points at once: transforms, cells and weights are worked out for all of them in vectors, sums over rows of
// taps point by point, and what is left along x in vectors again.
//
// A point in the domain is always one of a group, alone too, and a point outside never: what a point gives does not
// depend on its neighbours.

#include "lanes.cl"

// Positions along an axis: of lanes 0 to 3, and of lanes 4 to 7. (Of doubles, eight are wider than most registers.)
#if COORD_DOUBLE
typedef double4 coord4;
typedef long4 mask4;
typedef union { mask4 halves[2]; long each[LANES]; } inside_u;
#else
typedef float4 coord4;
typedef int4 mask4;
typedef union { mask4 halves[2]; int each[LANES]; } inside_u;
#endif
typedef struct { coord4 low, high; } coords_t;
typedef union { coords_t all; coord each[LANES]; } coords_u;

#ifdef __clang__
#define CONVERT(v, kind) __builtin_convertvector(v, kind##4)
#else
#define CONVERT(v, kind) convert_##kind##4(v)
#endif

#if COORD_DOUBLE
#define COORDS(v) CONVERT(v, double)
#else
#define COORDS(v) CONVERT(v, float)
#endif

INLINE coords_t to_coords(mask i)
{
    const coords_t c = { COORDS(i.lo), COORDS(i.hi) };
    return c;
}

typedef struct { coords_t x, y, z; } group_t;
typedef struct { union { long4 halves[2]; long each[LANES]; } first; real tx, ty, tz; } group_cell_t;

// Points as they lie in memory, `count` of them and the last one again.
INLINE group_t group_at(global const POINT *points, int count)
{
    typedef PASTE(POINT, 4) point4;
    typedef point4 point4_at __attribute__((aligned(4)));
    union { point4 four[2 * DIMENSIONS]; POINT each[LANES * DIMENSIONS]; } u;
    if (count == LANES) {
#pragma unroll
        for (int i = 0; i < 2 * DIMENSIONS; ++i)
            u.four[i] = *(global const point4_at *)(points + 4 * i);
    } else {
#pragma unroll
        for (int i = 0; i < LANES * DIMENSIONS; ++i)
            u.each[i] = points[at_most(i / DIMENSIONS, count - 1) * DIMENSIONS + i % DIMENSIONS];
    }
#define ALONG(axis, i) COORDS(((point4)(u.each[DIMENSIONS * i + axis], u.each[DIMENSIONS * (i + 1) + axis], u.each[DIMENSIONS * (i + 2) + axis], u.each[DIMENSIONS * (i + 3) + axis])))
    group_t p;
    p.x.low = ALONG(0, 0); p.x.high = ALONG(0, 4);
    p.y.low = ALONG(1, 0); p.y.high = ALONG(1, 4);
#if DIMENSIONS == 3
    p.z.low = ALONG(2, 0); p.z.high = ALONG(2, 4);
#else
    p.z = to_coords(NONE);
#endif
#undef ALONG
    return p;
}

// One row of the transform.
INLINE coords_t group_index(group_t p, constant coord *m, coord offset)
{
    coords_t c;
#if DIMENSIONS == 3
    c.low = madd(m[0], p.x.low, madd(m[1], p.y.low, madd(m[2], p.z.low, offset)));
    c.high = madd(m[0], p.x.high, madd(m[1], p.y.high, madd(m[2], p.z.high, offset)));
#else
    c.low = madd(m[0], p.x.low, madd(m[1], p.y.low, offset));
    c.high = madd(m[0], p.x.high, madd(m[1], p.y.high, offset));
#endif
    return c;
}

INLINE mask4 within_axis(coord4 x, int size)
{
    return x >= (coord)-0.5f & x <= size - (coord)0.5f;   // nothing that is not finite is inside
}

INLINE int any_of(mask4 m)
{
    return (m.x | m.y | m.z | m.w) != 0;
}

// As locate_inner_axis.
INLINE mask group_axis(coords_t x, int halo, real *t)
{
    const coord4 low = x.low * GRID_SCALE + ((coord)halo - (coord)LEFT), high = x.high * GRID_SCALE + ((coord)halo - (coord)LEFT);
    const mask base = (mask)(CONVERT(low, int), CONVERT(high, int));
    const coords_t whole = to_coords(base);
    *t = (real)(CONVERT(low - whole.low, float), CONVERT(high - whole.high, float));
    return base;
}

// As locate_inner and offset_of. The host sees to it that rows can be counted in an int.
INLINE group_cell_t group_cells(group_t p, const int4 extent)
{
    group_cell_t c;
    const mask x = group_axis(p.x, extent.w, &c.tx);
    mask row = group_axis(p.y, extent.w, &c.ty);
#if DIMENSIONS == 3
    row += group_axis(p.z, extent.w, &c.tz) * extent.y;
#else
    c.tz = (real)(0.0f);
#endif
    c.first.halves[0] = CONVERT(row.lo, long) * (long)extent.x + CONVERT(x.lo, long);
    c.first.halves[1] = CONVERT(row.hi, long) * (long)extent.x + CONVERT(x.hi, long);
    return c;
}

// Rows of samples i and, if there are two side by side, i + 4: where they begin, and their weights.
#if SIDE == 2
#define UNROLL_LANES _Pragma("unroll")
INLINE weight_t spread(real w, int i)
{
    return i == 0 ? w.s00004444 : i == 1 ? w.s11115555 : i == 2 ? w.s22226666 : w.s33337777;
}
INLINE cursors_t cursors_at(VOLUME_PARAMS, const group_cell_t *c, int i)
{
    const cursors_t at = { coefficients + c->first.each[i], coefficients + c->first.each[i + 4] };
    return at;
}
#else
#define UNROLL_LANES _Pragma("unroll 1")
INLINE weight_t spread(real w, int i)
{
    lanes_u lanes;
    lanes.all = w;
    return lanes.each[i];
}
INLINE cursors_t cursors_at(VOLUME_PARAMS, const group_cell_t *c, int i)
{
    return coefficients + c->first.each[i];
}
#endif

#define SPREAD(count, to, from, i)                         \
    _Pragma("unroll") for (int tap = 0; tap < count; ++tap) \
        to[tap] = spread(from[tap], i);

// Sums of rows to a vector for each tap.
INLINE void group_taps(const rows_t rows[CHUNKS][LANES / SIDE], real taps[WEIGHTS])
{
#pragma unroll
    for (int h = 0; h < CHUNKS; ++h) {
#if SIDE == 2
        transpose_fourths(rows[h], taps + h * ROW);
#else
        lane_taps(rows[h], taps + h * ROW);
#endif
    }
}

#if DERIVATIVE == 0

INLINE real group_value(VOLUME_PARAMS, const group_cell_t *c)
{
    real wx[TAPS], wy[TAPS], wz[TAPS], taps[WEIGHTS];
    rows_t rows[CHUNKS][LANES / SIDE];
    lane_weights(c->tx, wx);
    lane_weights(c->ty, wy);
    SLICE(lane_weights, c->tz, wz, (real)(1.0f));
    UNROLL_LANES
    for (int i = 0; i < LANES / SIDE; ++i) {
        const cursors_t first = cursors_at(VOLUME, c, i);
        weight_t y[TAPS], z[SLICES];
        SPREAD(TAPS, y, wy, i)
        SPREAD(SLICES, z, wz, i)
#pragma unroll
        for (int h = 0; h < CHUNKS; ++h)
            rows[h][i] = blend_rows(VOLUME, first, h * ROW, y, z);
    }
    group_taps(rows, taps);
    return lane_dot(taps, wx);
}

#else

// Per stored coefficient.
INLINE real3 group_gradient(VOLUME_PARAMS, const group_cell_t *c)
{
    real wx[TAPS], sx[TAPS], wy[TAPS], sy[TAPS], wz[TAPS], sz[TAPS], taps[WEIGHTS];
    rows_t rows[3][CHUNKS][LANES / SIDE];
    lane_weights(c->tx, wx);
    lane_slopes(c->tx, sx);
    lane_weights(c->ty, wy);
    lane_slopes(c->ty, sy);
    SLICE(lane_weights, c->tz, wz, (real)(1.0f));
    SLICE(lane_slopes, c->tz, sz, (real)(0.0f));
    UNROLL_LANES
    for (int i = 0; i < LANES / SIDE; ++i) {
        const cursors_t first = cursors_at(VOLUME, c, i);
        weight_t y[TAPS], by[TAPS], z[SLICES], bz[SLICES];
        SPREAD(TAPS, y, wy, i)
        SPREAD(TAPS, by, sy, i)
        SPREAD(SLICES, z, wz, i)
        SPREAD(SLICES, bz, sz, i)
#pragma unroll
        for (int h = 0; h < CHUNKS; ++h) {
            const slopes_t s = blend_slopes(VOLUME, first, h * ROW, y, by, z, bz);
            rows[0][h][i] = s.sum;
            rows[1][h][i] = s.sum_y;
            rows[2][h][i] = s.sum_z;
        }
    }
    real3 g;
    group_taps(rows[0], taps);
    g.x = lane_dot(taps, sx);
    group_taps(rows[1], taps);
    g.y = lane_dot(taps, wx);
    group_taps(rows[2], taps);
    g.z = lane_dot(taps, wx);
    return g;
}

#endif

// Results of the first `count` of a group of points: transform, w and fill as in outer_into.
INLINE void group_into(VOLUME_PARAMS, group_t p, int count, int4 size, int4 period, constant coord *m, const float fill,
                       global float *restrict results)
{
    typedef real real_at_t __attribute__((aligned(4)));
    group_t at;
    at.x = group_index(p, m, m[9]);
    at.y = group_index(p, m + 3, m[10]);
    mask4 low = within_axis(at.x.low, size.x) & within_axis(at.y.low, size.y);
    mask4 high = within_axis(at.x.high, size.x) & within_axis(at.y.high, size.y);
#if DIMENSIONS == 3
    at.z = group_index(p, m + 6, m[11]);
    low &= within_axis(at.z.low, size.z);
    high &= within_axis(at.z.high, size.z);
#else
    at.z = to_coords(NONE);
#endif
    const int outer = any_of(~(low & high));
    group_t inner = at;
    if (outer) {   // those points lie anywhere, and come after
#define BRING(axis) inner.axis.low = low ? at.axis.low : 0; inner.axis.high = high ? at.axis.high : 0
        BRING(x);
        BRING(y);
        BRING(z);
#undef BRING
    }
    const group_cell_t cells = group_cells(inner, extent);
#if DERIVATIVE == 0
    lanes_u value;
    value.all = group_value(VOLUME, &cells);
    if (count == LANES)
        *(global real_at_t *)results = value.all;
    else
        for (int i = 0; i < count; ++i)
            results[i] = value.each[i];
#else
    const real3 g = group_gradient(VOLUME, &cells);
    lanes_u along[DIMENSIONS];
#pragma unroll
    for (int i = 0; i < DIMENSIONS; ++i)
        along[i].all = GRID_SCALE * ((float)m[12 + i] * g.x + (float)m[15 + i] * g.y + (float)m[18 + i] * g.z);
    for (int i = 0; i < count; ++i)
#pragma unroll
        for (int k = 0; k < DIMENSIONS; ++k)
            results[DIMENSIONS * i + k] = along[k].each[i];
#endif
    if (outer) {
        inside_u inside;
        coords_u x, y, z;
        inside.halves[0] = low; inside.halves[1] = high;
        x.all = at.x; y.all = at.y; z.all = at.z;
        for (int i = 0; i < count; ++i)
            if (!inside.each[i])
                outer_into(VOLUME, x.each[i], y.each[i], z.each[i], size, period, m + 12, fill, results + COMPONENTS * i);
    }
}
