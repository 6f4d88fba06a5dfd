// LANES points at once: transforms, cells and weights are worked out for all of them in vectors, sums over rows of
// taps point by point, and what is left along x in vectors again.
//
// A point in the domain is always one of a group, be it alone, and a point outside always comes after, alone: what a
// point gives does not depend on its neighbours. Where some groups lie is worked out before any of them is sampled, so
// that the one does not wait for the other.

#define AHEAD 4   // groups whose cells are worked out before any is sampled

#include "base/math.cl"
#include "base/vector.cl"
#include "base/transpose.cl"
#include "spline/lane_taps.cl"
#include "spline/positions.cl"

// The first of each point's taps among the coefficients, and the fractions past it. Bit i of `outer` is set if
// point i is outside the domain: then its cell is any.
typedef struct { union { long4 halves[2]; long each[LANES]; } first; real tx, ty, tz; int outer; } group_cell_t;

INLINE mask4 within_axis(coord4 x, int size)
{
    return x >= (coord)-0.5f & x <= size - (coord)0.5f;   // nothing that is not finite is inside
}

// As locate_inner_axis.
INLINE mask group_axis(coords_t x, int halo, real *t)
{
    const coord4 low = x.low * GRID_SCALE + ((coord)halo - (coord)LEFT), high = x.high * GRID_SCALE + ((coord)halo - (coord)LEFT);
    const mask base = (mask)(CONVERT(low, int4), CONVERT(high, int4));
    const coords_t whole = to_coords(base);
    *t = (real)(CONVERT(low - whole.low, float4), CONVERT(high - whole.high, float4));
    return base;
}

// As locate_inner and offset_of. The host sees to it that rows can be counted in an int.
INLINE group_cell_t group_cells(group_t p, constant coord *m, int4 size, int4 extent)
{
    group_cell_t c;
    group_t at = group_index(p, m);
    mask4 low = within_axis(at.x.low, size.x) & within_axis(at.y.low, size.y);
    mask4 high = within_axis(at.x.high, size.x) & within_axis(at.y.high, size.y);
#if DIMENSIONS == 3
    low &= within_axis(at.z.low, size.z);
    high &= within_axis(at.z.high, size.z);
#endif
    const mask4 both = low & high;
    c.outer = 0;
    if (!(both.x & both.y & both.z & both.w)) {
        const union { mask4 halves[2]; mask_each each[LANES]; } inside = { { low, high } };
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
    c.first.halves[0] = CONVERT(row.lo, long4) * (long)extent.x + CONVERT(x.lo, long4);
    c.first.halves[1] = CONVERT(row.hi, long4) * (long)extent.x + CONVERT(x.hi, long4);
    return c;
}

// Rows of samples i and, if there are two side by side, i + 4: where they begin, and their weights.
#if SIDE == 2
#define UNROLL_LANES _Pragma("unroll")
INLINE weight_t spread(real w, int i)
{
    return i == 0 ? EACH_0(w) : i == 1 ? EACH_1(w) : i == 2 ? EACH_2(w) : EACH_3(w);
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

// Results of up to LANES points from the n-th.
INLINE void group_into(VOLUME_PARAMS, const group_cell_t *cells, source_t source, int n, int count, constant coord *w,
                       global float *results)
{
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
#if !SORTED
    if (count >= LANES) {
#pragma unroll
        for (int i = 0; i < COMPONENTS; ++i)
            *(global real_at *)(results + COMPONENTS * place_of(source, n) + i * LANES) = u.all[i];
        return;
    }
#endif
    for (int i = 0; i < MIN(LANES, count); ++i)
#pragma unroll
        for (int k = 0; k < COMPONENTS; ++k)
            results[COMPONENTS * place_of(source, n + i) + k] = u.each[COMPONENTS * i + k];
}

INLINE void run_into(VOLUME_PARAMS, source_t source, int count, const int4 size, const int4 period,
                     constant coord *transform, const float fill, global float *results)
{
    group_cell_t cells[AHEAD];
    for (int first = 0; first < count; first += AHEAD * LANES) {
        const int end = MIN(first + AHEAD * LANES, count);
        int outer = 0;
#pragma unroll 1
        for (int i = first, g = 0; i < end; i += LANES, ++g) {
            cells[g] = group_cells(group_of(source, i, end - i), transform, size, extent);
            outer |= cells[g].outer;
        }
#pragma unroll 1
        for (int i = first, g = 0; i < end; i += LANES, ++g)
            group_into(VOLUME, &cells[g], source, i, end - i, transform + 12, results);
        if (outer)
            for (int i = first; i < end; ++i)
                if (cells[(i - first) / LANES].outer >> (i - first) % LANES & 1)
                    outer_into(VOLUME, index_of(point_of(source, i), transform), size, period, transform + 12, fill,
                               results + COMPONENTS * place_of(source, i));
    }
}
