// LANES points at once: positions, cells and weights are computed in vectors, rows of taps are summed point by point, and the
// remaining sum along x is in vectors again.
//
// A point is always computed with LANES - 1 others, even if these are copies of it: its result does not depend on its neighbours.
// AHEAD vectors of points are located before any of them is sampled, so that sampling does not wait for it.

#define AHEAD 4

#include "base/vector.cl"
#include "base/transpose.cl"
#include "spline/cell.cl"
#include "spline/filter.cl"
#include "spline/position_lanes.cl"

// The first of each point's taps among the coefficients, and the fractions past it. Bit i of `valued` is set if point i is not
// sampled, but has a value of its own; its cell is meaningless. along: the signs of derivatives.
typedef struct {
#if FEW
    lane_masks_u first;
#else
    union { long4 halves[2]; long each[LANES]; } first;
#endif
    real tx, ty, tz;
    int valued;
#if DERIVATIVE
    struct { real x, y, z; } along;
#endif
} cells_t;

INLINE mask4 within_axis(coord4 x, int size)
{
    return x >= -(coord)(EDGE) & x <= size - 1 + (coord)(EDGE);   // NaN and infinities are not
}

typedef union { coords_t all; coord each[LANES]; } lane_coords_u;

// Whether all points outside have the same value, so that they need no tests: with FILL 2 that of the rule (outside.cl).
#define ONE_VALUE (BOUNDARY == CONSTANT && FILL == 2 && !DERIVATIVE)

#if ONE_VALUE
INLINE void bring_lanes(positions_t *at, const mask4 low, const mask4 high, const int4 size, const int4 period, cells_t *c)
{
    const union { mask4 halves[2]; mask_each each[LANES]; } inside = { { low, high } };
    for (int i = 0; i < LANES; ++i)
        c->valued |= !inside.each[i] << i;
#define BRING(axis) at->axis.low = low ? at->axis.low : 0, at->axis.high = high ? at->axis.high : 0
    BRING(x);
    BRING(y);
    BRING(z);
#undef BRING
}
#else
// Point by point, for those that lie outside.
OUT_OF_LINE void bring_lanes(positions_t *at, const mask4 low, const mask4 high, const int4 size, const int4 period, cells_t *c)
{
    lane_coords_u x, y, z;
    x.all = at->x; y.all = at->y; z.all = at->z;
    for (int i = 0; i < LANES; ++i) {
        position_t p = { x.each[i], y.each[i], z.each[i] };
        along_t along = { 1, 1, 1 };
        if (!within_volume(p, size)) {
            if (bring(&p, size, period, &along) != SAMPLED) {
                c->valued |= 1 << i;
                p.x = p.y = p.z = 0;
            }
            x.each[i] = p.x; y.each[i] = p.y; z.each[i] = p.z;
        }
#if DERIVATIVE
        ((private scalar *)&c->along.x)[i] = along.x;
        ((private scalar *)&c->along.y)[i] = along.y;
        ((private scalar *)&c->along.z)[i] = along.z;
#endif
    }
    at->x = x.all; at->y = y.all; at->z = z.all;
}
#endif

// As locate_inner and offset_of. The host ensures that an int can count the rows.
INLINE cells_t locate_points(positions_t p, constant coord *m, int4 size, int4 period, int4 extent)
{
    cells_t c;
    positions_t at = indices_of(p, m);
    mask4 low = within_axis(at.x.low, size.x), high = within_axis(at.x.high, size.x);
#if DIMENSIONS >= 2
    low &= within_axis(at.y.low, size.y);
    high &= within_axis(at.y.high, size.y);
#endif
#if DIMENSIONS == 3
    low &= within_axis(at.z.low, size.z);
    high &= within_axis(at.z.high, size.z);
#endif
    const mask4 both = low & high;
    c.valued = 0;
#if DERIVATIVE
    c.along.x = c.along.y = c.along.z = (real)(1.0f);
#endif
    if (!(both.x & both.y & both.z & both.w))
        bring_lanes(&at, low, high, size, period, &c);
    const mask x = locate_inner_lanes(at.x, extent.w, &c.tx);
#if DIMENSIONS >= 2
    mask row = locate_inner_lanes(at.y, extent.w, &c.ty);
#else
    mask row = NONE;
    c.ty = (real)(0.0f);
#endif
#if DIMENSIONS == 3
    row += locate_inner_lanes(at.z, extent.w, &c.tz) * extent.y;
#else
    c.tz = (real)(0.0f);
#endif
#if FEW
    c.first.all = row * extent.x + x * APART;
#else
    c.first.halves[0] = CONVERT(row.lo, long4) * (long)extent.x + CONVERT(x.lo * APART, long4);
    c.first.halves[1] = CONVERT(row.hi, long4) * (long)extent.x + CONVERT(x.hi * APART, long4);
#endif
    return c;
}

// Rows of samples i and, if there are two side by side, i + 4: where they begin, and their weights.
#if SIDE == 2
#define UNROLL_LANES _Pragma("unroll")
INLINE weight_t spread(real w, int i)
{
    return i == 0 ? EACH_0(w) : i == 1 ? EACH_1(w) : i == 2 ? EACH_2(w) : EACH_3(w);
}
INLINE cursors_t cursors_at(COEFFICIENTS coefficients, const int4 extent, const cells_t *c, int i)
{
    const cursors_t at = { coefficients + c->first.each[i], coefficients + c->first.each[i + 4] };
    return at;
}
#else
#define UNROLL_LANES _Pragma("unroll 1")
INLINE cursors_t cursors_at(COEFFICIENTS coefficients, const int4 extent, const cells_t *c, int i)
{
    return coefficients + c->first.each[i];
}
#endif

#if SIDE == 2
#define SPREAD_TAP(from, tap, i) spread(from[tap], i)
#else
#define SPREAD_TAP(from, tap, i) ((const private scalar *)from)[(tap) * LANES + (i)]
#endif
#define SPREAD(count, to, from, i)                         \
    _Pragma("unroll") for (int tap = 0; tap < count; ++tap) \
        to[tap] = SPREAD_TAP(from, tap, i);

// A row of the taps of all functions: tap k of function f is number k * APART + f. Storage has room for what is read past it.
#define ALL_CHUNKS ((TAPS * APART + ROW - 1) / ROW)
#define ALL_TAPS (ALL_CHUNKS * ROW)

// Sums of rows to a vector for each tap.
INLINE void rows_to_taps(const rows_t rows[ALL_CHUNKS][LANES / SIDE], real taps[ALL_TAPS])
{
#pragma unroll
    for (int h = 0; h < ALL_CHUNKS; ++h) {
#if SIDE == 2
        transpose_fourths(rows[h], taps + h * ROW);
#else
        lane_taps(rows[h], taps + h * ROW);
#endif
    }
}

// As lane_dot, of function f.
INLINE real component_dot(const real taps[ALL_TAPS], const real w[TAPS], int f)
{
    real sum = w[0] * taps[f];
#pragma unroll
    for (int k = 1; k < TAPS; ++k)
        sum = madd(w[k], taps[k * APART + f], sum);
    return sum;
}

#if DERIVATIVE == 0

INLINE void lanes_value(COEFFICIENTS coefficients, const int4 extent, const cells_t *c, real values[FUNCTIONS])
{
    real wx[TAPS], wy[TAPS], wz[TAPS], taps[ALL_TAPS];
    rows_t rows[ALL_CHUNKS][LANES / SIDE];
    lane_weights(c->tx, wx);
    LINE(lane_weights, c->ty, wy, (real)(1.0f));
    SLICE(lane_weights, c->tz, wz, (real)(1.0f));
    UNROLL_LANES
    for (int i = 0; i < LANES / SIDE; ++i) {
        const cursors_t first = cursors_at(coefficients, extent, c, i);
        weight_t y[LINES], z[SLICES];
        SPREAD(LINES, y, wy, i)
        SPREAD(SLICES, z, wz, i)
#pragma unroll
        for (int h = 0; h < ALL_CHUNKS; ++h)
            rows[h][i] = sum_rows(coefficients, extent, first, h * ROW, y, z);
    }
    rows_to_taps(rows, taps);
#pragma unroll
    for (int f = 0; f < FUNCTIONS; ++f)
        values[f] = component_dot(taps, wx, f);
}

#else

// Per stored coefficient.
INLINE void lanes_gradient(COEFFICIENTS coefficients, const int4 extent, const cells_t *c, real *value, real3 g[FUNCTIONS])
{
    real wx[TAPS], sx[TAPS], wy[TAPS], sy[TAPS], wz[TAPS], sz[TAPS], taps[ALL_TAPS];
    rows_t rows[3][ALL_CHUNKS][LANES / SIDE];
    lane_weights(c->tx, wx);
    lane_slopes(c->tx, sx);
    LINE(lane_weights, c->ty, wy, (real)(1.0f));
    LINE(lane_slopes, c->ty, sy, (real)(0.0f));
    SLICE(lane_weights, c->tz, wz, (real)(1.0f));
    SLICE(lane_slopes, c->tz, sz, (real)(0.0f));
    UNROLL_LANES
    for (int i = 0; i < LANES / SIDE; ++i) {
        const cursors_t first = cursors_at(coefficients, extent, c, i);
        weight_t y[LINES], by[LINES], z[SLICES], bz[SLICES];
        SPREAD(LINES, y, wy, i)
        SPREAD(LINES, by, sy, i)
        SPREAD(SLICES, z, wz, i)
        SPREAD(SLICES, bz, sz, i)
#pragma unroll
        for (int h = 0; h < ALL_CHUNKS; ++h) {
            const slopes_t s = sum_slopes(coefficients, extent, first, h * ROW, y, by, z, bz);
            rows[0][h][i] = s.sum;
            rows[1][h][i] = s.sum_y;
            rows[2][h][i] = s.sum_z;
        }
    }
#define OF_ALL(axis, weights)           \
    _Pragma("unroll") for (int f = 0; f < FUNCTIONS; ++f) \
        g[f].axis = component_dot(taps, weights, f);
    rows_to_taps(rows[0], taps);
    OF_ALL(x, sx)
#if WITH_VALUE
    *value = component_dot(taps, wx, 0);
#endif
    rows_to_taps(rows[1], taps);
    OF_ALL(y, wx)
    rows_to_taps(rows[2], taps);
    OF_ALL(z, wx)
#undef OF_ALL
}

#endif

// Results of up to LANES points from the n-th.
INLINE void lanes_into(COEFFICIENTS coefficients, const int4 extent, const cells_t *cells, source_t source, int n, int count,
                       constant coord *w, global scalar *results)
{
    lanes_u found[COMPONENTS];
#if DERIVATIVE == 0
    real values[FUNCTIONS];
    lanes_value(coefficients, extent, cells, values);
#pragma unroll
    for (int f = 0; f < FUNCTIONS; ++f)
        found[f].all = values[f];
#else
    real3 slopes[FUNCTIONS];
    lanes_gradient(coefficients, extent, cells, &found[0].all, slopes);
#pragma unroll
    for (int f = 0; f < FUNCTIONS; ++f) {
        real3 g = slopes[f];
        g.x *= cells->along.x, g.y *= cells->along.y, g.z *= cells->along.z;
#pragma unroll
        for (int k = 0; k < DIMENSIONS; ++k)
            found[f * OF_EACH + WITH_VALUE + k].all =
                GRID_SCALE * ((scalar)w[k] * g.x + (scalar)w[3 + k] * g.y + (scalar)w[6 + k] * g.z);
    }
#endif
#if !SORTED && COMPONENTS == 1
    if (count >= LANES) {
        *(global real_at *)(results + place_of(source, n)) = found[0].all;
        return;
    }
#endif
    for (int i = 0; i < MIN(LANES, count); ++i) {
        global scalar *result = results + COMPONENTS * place_of(source, n + i);
#pragma unroll
        for (int k = 0; k < COMPONENTS; ++k)
            result[k] = found[k].each[i];
    }
}

INLINE void run_into(COEFFICIENTS coefficients, const int4 extent, source_t source, int count, const int4 size, const int4 period,
                     constant coord *transform, const scalar2 given, global scalar *results)
{
    cells_t cells[AHEAD];
    for (int first = 0; first < count; first += AHEAD * LANES) {
        const int end = MIN(first + AHEAD * LANES, count);
        int valued = 0;
#pragma unroll 1
        for (int i = first, n = 0; i < end; i += LANES, ++n) {
            cells[n] = locate_points(points_of(source, i, end - i), transform, size, period, extent);
            valued |= cells[n].valued;
        }
#pragma unroll 1
        for (int i = first, n = 0; i < end; i += LANES, ++n)
            if (cells[n].valued != (1 << LANES) - 1)
                lanes_into(coefficients, extent, &cells[n], source, i, end - i, transform + 12, results);
        if (valued)
            for (int i = first; i < end; ++i)
                if (cells[(i - first) / LANES].valued >> (i - first) % LANES & 1) {
                    int kind = VALUED;
#if !ONE_VALUE
                    position_t at = index_of(point_of(source, i), transform);
                    along_t along;
                    kind = bring(&at, size, period, &along);
#endif
                    value_into(kind, given, results + COMPONENTS * place_of(source, i));
                }
    }
}
