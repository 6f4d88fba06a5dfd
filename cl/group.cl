// LANES points at once: transforms, cells and weights are worked out for all of them in vectors, sums over rows of
// taps point by point, and what is left along x in vectors again.
//
// A point in the domain is always one of a group, be it alone, and a point outside always comes after, alone: what a
// point gives does not depend on its neighbours. Where some groups lie is worked out before any of them is sampled, so
// that the one does not wait for the other.

#define GROUPS 4   // whose cells are worked out together

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
// The first of each point's taps among the coefficients, and the fractions past it. Bit i of `outer` is set if
// point i is outside the domain: then its cell is any.
typedef struct { union { long4 halves[2]; long each[LANES]; } first; real tx, ty, tz; int outer; } group_cell_t;

// Up to LANES points from the n-th, and the last one again.
INLINE group_t group_of(source_t source, int n, int count)
{
    group_t p;
#if LATTICE
    p.x = to_coords(source.i + n + (mask)(0, 1, 2, 3, 4, 5, 6, 7));
    p.y = to_coords((mask)(source.j));
    p.z = to_coords((mask)(source.k));
#else
    global const POINT *points = source + DIMENSIONS * n;
    typedef PASTE(POINT, 4) point4;
    typedef point4 point4_at __attribute__((aligned(4)));
    union { point4 four[2 * DIMENSIONS]; POINT each[LANES * DIMENSIONS]; } u;
    if (count >= LANES) {
#pragma unroll
        for (int i = 0; i < 2 * DIMENSIONS; ++i)
            u.four[i] = *(global const point4_at *)(points + 4 * i);
    } else {
#pragma unroll
        for (int i = 0; i < LANES * DIMENSIONS; ++i)
            u.each[i] = points[at_most(i / DIMENSIONS, count - 1) * DIMENSIONS + i % DIMENSIONS];
    }
#define COMPONENT(i, axis) u.each[DIMENSIONS * (i) + axis]
#define ALONG(axis, i) \
    COORDS(((point4)(COMPONENT(i, axis), COMPONENT(i + 1, axis), COMPONENT(i + 2, axis), COMPONENT(i + 3, axis))))
    p.x.low = ALONG(0, 0); p.x.high = ALONG(0, 4);
    p.y.low = ALONG(1, 0); p.y.high = ALONG(1, 4);
#if DIMENSIONS == 3
    p.z.low = ALONG(2, 0); p.z.high = ALONG(2, 4);
#else
    p.z = to_coords(NONE);
#endif
#undef ALONG
#undef COMPONENT
#endif
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
INLINE group_cell_t group_cells(group_t p, constant coord *m, int4 size, int4 extent)
{
    group_cell_t c;
    group_t at;
    at.x = group_index(p, m, m[9]);
    at.y = group_index(p, m + 3, m[10]);
    mask4 low = within_axis(at.x.low, size.x) & within_axis(at.y.low, size.y);
    mask4 high = within_axis(at.x.high, size.x) & within_axis(at.y.high, size.y);
#if DIMENSIONS == 3
    at.z = group_index(p, m + 6, m[11]);
    low &= within_axis(at.z.low, size.z);
    high &= within_axis(at.z.high, size.z);
#endif
    const mask4 both = low & high;
    c.outer = 0;
    if (!(both.x & both.y & both.z & both.w)) {
        const inside_u inside = { { low, high } };
        for (int i = 0; i < LANES; ++i)
            c.outer |= !inside.each[i] << i;
#define BRING(axis) axis.low = low ? axis.low : 0, axis.high = high ? axis.high : 0
        BRING(at.x);
        BRING(at.y);
#if DIMENSIONS == 3
        BRING(at.z);
#endif
#undef BRING
    }
    const mask x = group_axis(at.x, extent.w, &c.tx);
    mask row = group_axis(at.y, extent.w, &c.ty);
#if DIMENSIONS == 3
    row += group_axis(at.z, extent.w, &c.tz) * extent.y;
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

// Results of up to LANES points.
INLINE void group_into(VOLUME_PARAMS, const group_cell_t *cells, int count, constant coord *w, global float *restrict results)
{
    typedef real real_at_t __attribute__((aligned(4)));
    union { real all[COMPONENTS]; float each[COMPONENTS * LANES]; } u;
#if DERIVATIVE == 0
    u.all[0] = group_value(VOLUME, cells);
#else
    const real3 g = group_gradient(VOLUME, cells);
#pragma unroll
    for (int k = 0; k < DIMENSIONS; ++k) {
        lanes_u along;
        along.all = GRID_SCALE * ((float)w[k] * g.x + (float)w[3 + k] * g.y + (float)w[6 + k] * g.z);
#pragma unroll
        for (int i = 0; i < LANES; ++i)
            u.each[DIMENSIONS * i + k] = along.each[i];
    }
#endif
    if (count >= LANES) {
#pragma unroll
        for (int i = 0; i < COMPONENTS; ++i)
            *(global real_at_t *)(results + i * LANES) = u.all[i];
    } else
        for (int i = 0; i < count * COMPONENTS; ++i)
            results[i] = u.each[i];
}

INLINE void run_into(VOLUME_PARAMS, source_t source, int count, const int4 size, const int4 period,
                     constant coord *transform, const float fill, global float *results)
{
    group_cell_t cells[GROUPS];
    for (int first = 0; first < count; first += GROUPS * LANES) {
        const int end = at_most(first + GROUPS * LANES, count);
        int outer = 0;
#pragma unroll 1
        for (int i = first, g = 0; i < end; i += LANES, ++g) {
            cells[g] = group_cells(group_of(source, i, end - i), transform, size, extent);
            outer |= cells[g].outer;
        }
#pragma unroll 1
        for (int i = first, g = 0; i < end; i += LANES, ++g)
            group_into(VOLUME, &cells[g], end - i, transform + 12, results + COMPONENTS * i);
        if (outer)
            for (int i = first; i < end; ++i)
                if (cells[(i - first) / LANES].outer >> (i - first) % LANES & 1)
                    outer_into(VOLUME, index_of(point_of(source, i), transform), size, period, transform + 12, fill,
                               results + COMPONENTS * i);
    }
}
