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
typedef struct { lane_masks_u x, y, z; real tx, ty, tz; } group_cell_t;

// Points as they lie in memory, `count` of them and the last one again.
INLINE group_t group_at(global const POINT *points, int count)
{
    typedef PASTE(POINT, 4) point4;
#define LANE(i, axis) points[DIMENSIONS * at_most(i, count - 1) + axis]
#define ALONG(axis, i) COORDS(((point4)(LANE(i, axis), LANE(i + 1, axis), LANE(i + 2, axis), LANE(i + 3, axis))))
    group_t p;
    p.x.low = ALONG(0, 0); p.x.high = ALONG(0, 4);
    p.y.low = ALONG(1, 0); p.y.high = ALONG(1, 4);
#if DIMENSIONS == 3
    p.z.low = ALONG(2, 0); p.z.high = ALONG(2, 4);
#else
    p.z = to_coords(NONE);
#endif
#undef ALONG
#undef LANE
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

INLINE group_cell_t group_cells(group_t p, int halo)
{
    group_cell_t c;
    c.x.all = group_axis(p.x, halo, &c.tx);
    c.y.all = group_axis(p.y, halo, &c.ty);
#if DIMENSIONS == 3
    c.z.all = group_axis(p.z, halo, &c.tz);
#else
    c.z.all = NONE;
    c.tz = (real)(0.0f);
#endif
    return c;
}

#define LANE_WEIGHTS(w, i) ((const float *)(w) + (i))   // of sample i; they lie LANES apart

#if DERIVATIVE == 0

INLINE real group_value(VOLUME_PARAMS, const group_cell_t *c)
{
    real wx[TAPS], wy[TAPS], wz[TAPS], taps[WEIGHTS];
    row_u rows[CHUNKS][LANES];
    lane_weights(c->tx, wx);
    lane_weights(c->ty, wy);
    SLICE(lane_weights, c->tz, wz, (real)(1.0f));
#pragma unroll 1
    for (int i = 0; i < LANES; ++i) {
        const cursor_t first = cursor_at(VOLUME, c->x.each[i], c->y.each[i], c->z.each[i]);
#pragma unroll
        for (int h = 0; h < CHUNKS; ++h)
            rows[h][i].row = blend_rows(VOLUME, first, h, LANE_WEIGHTS(wy, i), LANE_WEIGHTS(wz, i), LANES);
    }
#pragma unroll
    for (int h = 0; h < CHUNKS; ++h)
        lane_taps(rows[h], taps + h * ROW);
    return lane_dot(taps, wx);
}

#else

// Per stored coefficient.
INLINE real3 group_gradient(VOLUME_PARAMS, const group_cell_t *c)
{
    real wx[TAPS], sx[TAPS], wy[TAPS], sy[TAPS], wz[TAPS], sz[TAPS], taps[WEIGHTS];
    row_u rows[3][CHUNKS][LANES];
    lane_weights(c->tx, wx);
    lane_slopes(c->tx, sx);
    lane_weights(c->ty, wy);
    lane_slopes(c->ty, sy);
    SLICE(lane_weights, c->tz, wz, (real)(1.0f));
    SLICE(lane_slopes, c->tz, sz, (real)(0.0f));
#pragma unroll 1
    for (int i = 0; i < LANES; ++i) {
        const cursor_t first = cursor_at(VOLUME, c->x.each[i], c->y.each[i], c->z.each[i]);
#pragma unroll
        for (int h = 0; h < CHUNKS; ++h) {
            const slopes_t s = blend_slopes(VOLUME, first, h, LANE_WEIGHTS(wy, i), LANE_WEIGHTS(sy, i),
                                            LANE_WEIGHTS(wz, i), LANE_WEIGHTS(sz, i), LANES);
            rows[0][h][i].row = s.sum;
            rows[1][h][i].row = s.sum_y;
            rows[2][h][i].row = s.sum_z;
        }
    }
    real g[3];
#pragma unroll
    for (int axis = 0; axis < 3; ++axis) {
#pragma unroll
        for (int h = 0; h < CHUNKS; ++h)
            lane_taps(rows[axis][h], taps + h * ROW);
        g[axis] = lane_dot(taps, axis == 0 ? sx : wx);
    }
    return real3_of(g[0], g[1], g[2]);
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
    const group_cell_t cells = group_cells(inner, extent.w);
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
