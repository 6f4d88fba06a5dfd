// Kernels: the least and greatest value that the reconstructed function takes in blocks of cells.
//
// In a cell the function is a polynomial along each axis. Its Bernstein coefficients there are weighted sums of the
// cell's taps (bounds.py derives the weights of any filter), and the function lies in their convex hull (section 4.1
// of the paper). What the evaluation in float32 may err by is added on both sides.
//
// A cell is named by its first tap among the stored coefficients; a block is BLOCK cells along each axis.
//
// Set by the host: LANES (cells along x at a time, 8); BLOCK; TAPS; HULL (1: by Bernstein coefficients; 0: by the taps' extremes and the weights' greatest
// sums); CONTROLS, coefficients along an axis of a cell, SHARED (the last is the next cell's first), BERNSTEIN (their
// weights: a row for each); SUM_LOW and SUM_HIGH (of a point's weights), LEBESGUE (of their magnitudes);
// PAD_SIZE, of the taps' greatest magnitude, and PAD_SPREAD, of their range.

#include "base/platform.cl"

#define EDGE (BLOCK + TAPS - 1)              // taps along the edge of a block

INLINE void widen(float *low, float *high, float least, float greatest)
{
    const float size = greatest > -least ? greatest : -least;
    const float pad = PAD_SIZE * size + PAD_SPREAD * (greatest - least);
    *low -= pad;
    *high += pad;
    if (!(pad < 1e30f)) {                    // so large that the sums may have overflowed
        *low = -INFINITY;
        *high = INFINITY;
    }
}

#if HULL

#define ROWS (SHARED ? CONTROLS - 1 : CONTROLS)   // new ones for each cell
#define POINTS (BLOCK * ROWS + SHARED)            // along the edge of a block

constant float bernstein[CONTROLS][TAPS] = BERNSTEIN;

// One control point from TAPS values; weights of nought cost nothing.
#define CONTROL(target, row, value)                          \
    {                                                        \
        target = (float8)(0.0f);                             \
        _Pragma("unroll") for (int i_ = 0; i_ < TAPS; ++i_)  \
            if (bernstein[row][i_] != 0.0f)                  \
                target = madd((float8)(bernstein[row][i_]), value, target); \
    }

kernel void bound_cells(global const float *restrict coefficients, const int4 extent, const int4 blocks, global float2 *bounds)
{
    const int bx = (int)get_global_id(0) * (LANES / BLOCK), by = get_global_id(1), bz = get_global_id(2);
    float8 least = (float8)(INFINITY), greatest = -least;
    float8 low[CONTROLS], high[CONTROLS];     // apart, so that they need not wait for each other
    for (int r = 0; r < CONTROLS; ++r) {
        low[r] = least;
        high[r] = greatest;
    }
    float8 lines[EDGE][POINTS][CONTROLS];     // control points along x and y, for each slice of taps
    for (int k = 0; k < EDGE; ++k) {
        float8 rows[EDGE][CONTROLS];
        const size_t z = MIN(bz * BLOCK + k, extent.z - 1);
        for (int j = 0; j < EDGE; ++j) {
            const size_t y = MIN(by * BLOCK + j, extent.y - 1);
            global const float *p = coefficients + (z * extent.y + y) * extent.x + bx * BLOCK;
            float8 taps[TAPS];
#pragma unroll
            for (int i = 0; i < TAPS; ++i) {
                taps[i] = *(global const float8_at *)(p + i);
                least = MIN(taps[i], least);
                greatest = MAX(taps[i], greatest);
            }
#pragma unroll
            for (int d = 0; d < CONTROLS; ++d)
                CONTROL(rows[j][d], d, taps[i_])
        }
        for (int cell = 0; cell < BLOCK; ++cell)
#pragma unroll
            for (int r = 0; r < CONTROLS; ++r)
                if (r < ROWS || cell == BLOCK - 1)
#pragma unroll
                    for (int d = 0; d < CONTROLS; ++d)
                        CONTROL(lines[k][cell * ROWS + r][d], r, rows[cell + i_][d])
    }
    for (int q = 0; q < POINTS; ++q)
        for (int d = 0; d < CONTROLS; ++d)
            for (int cell = 0; cell < BLOCK; ++cell)
#pragma unroll
                for (int r = 0; r < CONTROLS; ++r)
                    if (r < ROWS || cell == BLOCK - 1) {
                        float8 point;
                        CONTROL(point, r, lines[cell + i_][q][d])
                        low[r] = MIN(point, low[r]);
                        high[r] = MAX(point, high[r]);
                    }
    for (int r = 1; r < CONTROLS; ++r) {
        low[0] = MIN(low[r], low[0]);
        high[0] = MAX(high[r], high[0]);
    }
    union { float8 all; float each[LANES]; } lows = { low[0] }, highs = { high[0] }, leasts = { least }, greatests = { greatest };
    for (int b = 0; b < LANES / BLOCK && bx + b < blocks.x; ++b) {
        float l = INFINITY, h = -INFINITY, s = INFINITY, g = -INFINITY;
        for (int i = b * BLOCK; i < (b + 1) * BLOCK; ++i) {
            l = lows.each[i] < l ? lows.each[i] : l;
            h = highs.each[i] > h ? highs.each[i] : h;
            s = leasts.each[i] < s ? leasts.each[i] : s;
            g = greatests.each[i] > g ? greatests.each[i] : g;
        }
        widen(&l, &h, s, g);
        bounds[((size_t)bz * blocks.y + by) * blocks.x + bx + b] = (float2)(l, h);
    }
}

#else

// f = m sum(w) + sum(w (c - m)), with m the middle of the taps c and w their weights.
kernel void bound_cells(global const float *restrict coefficients, const int4 extent, const int4 blocks, global float2 *bounds)
{
    const int bx = get_global_id(0), by = get_global_id(1), bz = get_global_id(2);
    float least = INFINITY, greatest = -INFINITY;
    for (int k = 0; k < EDGE; ++k)
        for (int j = 0; j < EDGE; ++j) {
            const size_t z = MIN(bz * BLOCK + k, extent.z - 1), y = MIN(by * BLOCK + j, extent.y - 1);
            global const float *p = coefficients + (z * extent.y + y) * extent.x;
            for (int i = 0; i < EDGE; ++i) {
                const float c = p[MIN(bx * BLOCK + i, extent.x - 1)];
                least = c < least ? c : least;
                greatest = c > greatest ? c : greatest;
            }
        }
    const float middle = 0.5f * least + 0.5f * greatest, reach = LEBESGUE * (0.5f * greatest - 0.5f * least);
    float low = middle * (middle > 0.0f ? SUM_LOW : SUM_HIGH) - reach, high = middle * (middle > 0.0f ? SUM_HIGH : SUM_LOW) + reach;
    widen(&low, &high, least, greatest);
    bounds[((size_t)bz * blocks.y + by) * blocks.x + bx] = (float2)(low, high);
}

#endif

// Two blocks along each axis make one of the next level. Levels: blocks along x, y and z, and where they begin.
kernel void bound_blocks(global float2 *bounds, const int4 finer, const int4 coarser)
{
    const int x = get_global_id(0), y = get_global_id(1), z = get_global_id(2);
    float2 hull = (float2)(INFINITY, -INFINITY);
    for (int k = 2 * z; k < MIN(2 * z + 2, finer.z); ++k)
        for (int j = 2 * y; j < MIN(2 * y + 2, finer.y); ++j)
            for (int i = 2 * x; i < MIN(2 * x + 2, finer.x); ++i) {
                const float2 b = bounds[finer.w + ((size_t)k * finer.y + j) * finer.x + i];
                hull.x = b.x < hull.x ? b.x : hull.x;
                hull.y = b.y > hull.y ? b.y : hull.y;
            }
    bounds[coarser.w + ((size_t)z * coarser.y + y) * coarser.x + x] = hull;
}
