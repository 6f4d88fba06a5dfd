// Kernels: how steep the reconstructed function is in blocks of cells, beside its bounds (minmax.cl).
//
// Along an axis a cell's polynomial has the slope of the polynomial of the differences of its control points, times the degree: so
// each part of the gradient lies in the hull of these differences. The possible error of a gradient in float32 is added on both sides.
//
// Set by the host: what minmax.cl says, with HULL; STEEP_PAD, in pads of the function itself.

#include "spline/minmax.cl"

#if HULL && CONTROLS > 1

#define DEGREE (CONTROLS - 1)

typedef struct { float8 low[3], high[3]; } slopes_t;   // along x, y and z

INLINE void reach_slope(slopes_t *slopes, const int axis, const float8 slope)
{
    slopes->low[axis] = MIN(slope, slopes->low[axis]);
    slopes->high[axis] = MAX(slope, slopes->high[axis]);
}

// The smallest and the largest magnitude of gradients whose parts are in these ranges; `metric` are their products xx, yy, zz and the
// magnitudes of xy, xz and yz.
INLINE float2 magnitudes_of(const float low[3], const float high[3], const float8 metric)
{
    float least[3], most[3], largest = 0.0f;
    for (int axis = 0; axis < 3; ++axis) {
        least[axis] = MAX(MAX(low[axis], -high[axis]), 0.0f);
        most[axis] = MAX(high[axis], -low[axis]);
        largest = MAX(most[axis], largest);
    }
    if (!(largest > 0.0f && largest < 1e38f))
        return largest == 0.0f ? (float2)(0.0f, 0.0f) : (float2)(0.0f, INFINITY);
    for (int axis = 0; axis < 3; ++axis) {   // so that no square overflows, or is too small
        least[axis] /= largest;
        most[axis] /= largest;
    }
    const float aslant = 2.0f * (metric.s3 * most[0] * most[1] + metric.s4 * most[0] * most[2] + metric.s5 * most[1] * most[2]);
    const float lowest = metric.s0 * least[0] * least[0] + metric.s1 * least[1] * least[1] + metric.s2 * least[2] * least[2] - aslant;
    const float highest = metric.s0 * most[0] * most[0] + metric.s1 * most[1] * most[1] + metric.s2 * most[2] * most[2] + aslant;
    return largest * (float2)(0.9999f * sqrt(MAX(lowest, 0.0f)), 1.0001f * sqrt(highest));
}

kernel void slope_cells(global const float *restrict coefficients, const int4 extent, const int4 first, const int4 blocks,
                        global float2 *bounds, const int begin, const float8 metric)
{
    const int bx = (int)get_global_id(0) * (LANES / BLOCK), by = get_global_id(1), bz = (int)get_global_id(2) + blocks.w;
    float8 tap_min, tap_max;
    slopes_t slopes;
    for (int axis = 0; axis < 3; ++axis) {
        slopes.low[axis] = (float8)(INFINITY);
        slopes.high[axis] = -slopes.low[axis];
    }
    lines_t lines;
    control_lines(lines, coefficients, extent, first, bx, by, bz, &tap_min, &tap_max);
    for (int q = 0; q < POINTS; ++q) {
        const int inside = q + 1 < POINTS && (SHARED || (q + 1) % CONTROLS != 0);   // whether the next point is of the same cell
        for (int cell = 0; cell < BLOCK; ++cell) {
            float8 before[CONTROLS];
            for (int d = 0; d < CONTROLS; ++d) {
                float8 points[CONTROLS];
#pragma unroll
                for (int r = 0; r < CONTROLS; ++r) {
                    CONTROL(points[r], r, lines[cell + i_][q][d])
                    if (r > 0)
                        reach_slope(&slopes, 2, points[r] - points[r - 1]);
                    if (d > 0)
                        reach_slope(&slopes, 0, points[r] - before[r]);
                    if (inside) {
                        float8 next;
                        CONTROL(next, r, lines[cell + i_][q + 1][d])
                        reach_slope(&slopes, 1, next - points[r]);
                    }
                }
#pragma unroll
                for (int r = 0; r < CONTROLS; ++r)
                    before[r] = points[r];
            }
        }
    }
    union { float8 all; float each[LANES]; } lows[3], highs[3], tap_mins = { tap_min }, tap_maxs = { tap_max };
    for (int axis = 0; axis < 3; ++axis) {
        lows[axis].all = slopes.low[axis];
        highs[axis].all = slopes.high[axis];
    }
    for (int b = 0; b < LANES / BLOCK && bx + b < blocks.x; ++b) {
        float low[3], high[3], size = 0.0f;
        for (int i = b * BLOCK; i < (b + 1) * BLOCK; ++i)
            size = MAX(MAX(tap_maxs.each[i], -tap_mins.each[i]), size);
        const float pad = size > 0.0f ? STEEP_PAD * (PAD_SIZE * size + PAD_TINY) : 0.0f;
        for (int axis = 0; axis < 3; ++axis) {
            low[axis] = INFINITY;
            high[axis] = -INFINITY;
            for (int i = b * BLOCK; i < (b + 1) * BLOCK; ++i) {
                low[axis] = MIN(lows[axis].each[i], low[axis]);
                high[axis] = MAX(highs[axis].each[i], high[axis]);
            }
            low[axis] = DEGREE * low[axis] - pad;
            high[axis] = DEGREE * high[axis] + pad;
        }
        bounds[begin + ((size_t)bz * blocks.y + by) * blocks.x + bx + b] = magnitudes_of(low, high, metric);
    }
}

#endif
