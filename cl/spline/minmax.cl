// Kernels: the min-max pyramid: bounds of the reconstructed function in blocks of cells.
//
// In a cell the function is a polynomial along each axis. Its Bernstein coefficients there, the control points, are weighted
// sums of the cell's taps (minmax.py derives the weights for any filter), and the function lies in their convex hull (section
// 4.1 of the paper). The possible error of the evaluation in float32 is added on both sides.
//
// A cell is named by its first tap among the stored coefficients. A block is BLOCK cells along each axis.
//
// Set by the host: LANES, cells along x at a time, 8; BLOCK; TAPS; HULL, 1: by control points, 0: by the extremes of the taps and
// the largest sums of weights, or if NAMES, the extremes themselves of the names among the taps but the SPARED outer ones on each
// side, which others always outvote; CONTROLS, control points along an axis of a cell; SHARED, whether the last is the next
// cell's first; BERNSTEIN, a row of weights for each; SUM_LOW and SUM_HIGH, of a point's weights; LEBESGUE, the sum of their
// magnitudes; PAD_SIZE, relative to the largest magnitude of a tap, PAD_SPREAD, relative to the range of the taps, and PAD_TINY,
// the error from subnormal numbers (zeros are exact).

#include "base/platform.cl"
#include "spline/sides.cl"

#define EDGE (BLOCK + TAPS - 1)              // taps along the edge of a block

INLINE void widen(float *low, float *high, float tap_min, float tap_max)
{
    const float size = MAX(tap_max, -tap_min);
    float pad = PAD_SIZE * size + PAD_SPREAD * (tap_max - tap_min);
    if (size > 0.0f)
        pad += PAD_TINY;
    *low -= pad;
    *high += pad;
    if (!(pad < 1e30f)) {                    // so large that the sums may have overflowed
        *low = -INFINITY;
        *high = INFINITY;
    }
}

// -- sides: for each cell, whether the function there may have one of some values, and whether it is above the first -

typedef union { float8 all; float each[8]; } values_u;

INLINE int holds_any(const values_u *values, const int count, const float low, const float high)
{
    int some = 0;
    for (int k = 0; k < count; ++k)
        some |= !(low > values->each[k] || high < values->each[k]);
    return some;
}

// A number (may hold, is above) for each brick, of a bit for each cell. From those of block (bx, by, bz), `along` of them along x.
INLINE void store_bricks(global ulong2 *sides, const ulong2 *bricks, const int4 blocks, const int bx, const int by, const int bz,
                         const int along)
{
    const int nx = blocks.x * BRICKS, ny = blocks.y * BRICKS;
    for (int z = 0; z < BRICKS; ++z)
        for (int y = 0; y < BRICKS; ++y)
            for (int x = 0; x < along && bx * BRICKS + x < nx; ++x)
                sides[((size_t)(bz * BRICKS + z) * ny + by * BRICKS + y) * nx + bx * BRICKS + x] = bricks[(z * BRICKS + y) * along + x];
}

// -- bounds ------------------------------------------------------------------------------------------------------

#if HULL

#define ROWS (SHARED ? CONTROLS - 1 : CONTROLS)   // new ones for each cell
#define POINTS (BLOCK * ROWS + SHARED)            // along the edge of a block

constant float bernstein[CONTROLS][TAPS] = BERNSTEIN;

// One control point from TAPS values; weights of 0 cost nothing.
#define CONTROL(target, row, value)                          \
    {                                                        \
        target = (float8)(0.0f);                             \
        _Pragma("unroll") for (int i_ = 0; i_ < TAPS; ++i_)  \
            if (bernstein[row][i_] != 0.0f)                  \
                target = madd((float8)(bernstein[row][i_]), value, target); \
    }

// Control points along x and y of LANES cells along x, and all along y, for each slice of their taps.
typedef float8 lines_t[EDGE][POINTS][CONTROLS];

// Those of block (bx, by, bz) and the next along x; and the extremes of the taps.
INLINE void control_lines(lines_t lines, global const float *restrict coefficients, const int4 extent, const int4 first, const int bx, const int by,
                          const int bz, float8 *tap_min, float8 *tap_max)
{
    *tap_min = (float8)(INFINITY);
    *tap_max = -*tap_min;
    for (int k = 0; k < EDGE; ++k) {
        float8 rows[EDGE][CONTROLS];
        const size_t z = MIN(first.z + bz * BLOCK + k, extent.z - 1);
        for (int j = 0; j < EDGE; ++j) {
            const size_t y = MIN(first.y + by * BLOCK + j, extent.y - 1);
            global const float *p = coefficients + (z * extent.y + y) * extent.x + first.x + bx * BLOCK;
            float8 taps[TAPS];
#pragma unroll
            for (int i = 0; i < TAPS; ++i) {
                taps[i] = *(global const scalar8_at *)(p + i);
                *tap_min = MIN(taps[i], *tap_min);
                *tap_max = MAX(taps[i], *tap_max);
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
}

kernel void minmax_cells(global const float *restrict coefficients, const int4 extent, const int4 first, const int4 blocks,
                         global float2 *bounds)
{
    const int bx = (int)get_global_id(0) * (LANES / BLOCK), by = get_global_id(1), bz = (int)get_global_id(2) + blocks.w;
    float8 tap_min, tap_max, low[CONTROLS], high[CONTROLS];     // separate accumulators, so that they need not wait for each other
    for (int r = 0; r < CONTROLS; ++r) {
        low[r] = (float8)(INFINITY);
        high[r] = -low[r];
    }
    lines_t lines;
    control_lines(lines, coefficients, extent, first, bx, by, bz, &tap_min, &tap_max);
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
    union { float8 all; float each[LANES]; } lows = { low[0] }, highs = { high[0] }, tap_mins = { tap_min }, tap_maxs = { tap_max };
    for (int b = 0; b < LANES / BLOCK && bx + b < blocks.x; ++b) {
        float l = INFINITY, h = -INFINITY, s = INFINITY, g = -INFINITY;
        for (int i = b * BLOCK; i < (b + 1) * BLOCK; ++i) {
            l = MIN(lows.each[i], l);
            h = MAX(highs.each[i], h);
            s = MIN(tap_mins.each[i], s);
            g = MAX(tap_maxs.each[i], g);
        }
        widen(&l, &h, s, g);
        bounds[((size_t)bz * blocks.y + by) * blocks.x + bx + b] = (float2)(l, h);
    }
}

// The same for each single cell: whether the function may have one of `count` values there, and whether it is above the first. A brick
// is SIDES_EDGE cells along each axis.
kernel void side_cells(global const float *restrict coefficients, const int4 extent, const int4 first, const int4 blocks,
                       global const float2 *bounds, const float8 sought, const int count, global ulong2 *sides)
{
    const int bx = (int)get_global_id(0) * (LANES / BLOCK), by = get_global_id(1), bz = (int)get_global_id(2) + blocks.w;
    const values_u values = { sought };
    float low = INFINITY, high = -INFINITY;
    for (int b = 0; b < LANES / BLOCK && bx + b < blocks.x; ++b) {
        const float2 bound = bounds[((size_t)bz * blocks.y + by) * blocks.x + bx + b];
        low = MIN(bound.x, low);
        high = MAX(bound.y, high);
    }
    ulong2 bricks[BRICKS][BRICKS][LANES / SIDES_EDGE];
    for (int i = 0; i < BRICKS * BRICKS * (LANES / SIDES_EDGE); ++i)
        (&bricks[0][0][0])[i] = (ulong2)(0, low > values.each[0] ? ALL_CELLS : 0);
    if (holds_any(&values, count, low, high)) {
        float8 tap_min, tap_max;
        lines_t lines;
        control_lines(lines, coefficients, extent, first, bx, by, bz, &tap_min, &tap_max);
        union { float8 all; float each[LANES]; } tap_mins = { tap_min }, tap_maxs = { tap_max };
        for (int i = 1; i < LANES; ++i) {
            tap_mins.each[0] = MIN(tap_mins.each[i], tap_mins.each[0]);
            tap_maxs.each[0] = MAX(tap_maxs.each[i], tap_maxs.each[0]);
        }
        for (int i = 0; i < BRICKS * BRICKS * (LANES / SIDES_EDGE); ++i)
            (&bricks[0][0][0])[i] = (ulong2)(0, 0);
        for (int z = 0; z < BLOCK; ++z) {
            float8 lows[POINTS], highs[POINTS];     // of the control points of a layer of cells, line by line
            for (int q = 0; q < POINTS; ++q) {
                lows[q] = (float8)(INFINITY);
                highs[q] = -lows[q];
                for (int d = 0; d < CONTROLS; ++d)
#pragma unroll
                    for (int r = 0; r < CONTROLS; ++r) {
                        float8 point;
                        CONTROL(point, r, lines[z + i_][q][d])
                        lows[q] = MIN(point, lows[q]);
                        highs[q] = MAX(point, highs[q]);
                    }
            }
            for (int y = 0; y < BLOCK; ++y) {
                union { float8 all; float each[LANES]; } l = { lows[y * ROWS] }, h = { highs[y * ROWS] };
                for (int r = 1; r < CONTROLS; ++r) {
                    l.all = MIN(lows[y * ROWS + r], l.all);
                    h.all = MAX(highs[y * ROWS + r], h.all);
                }
                for (int i = 0; i < LANES; ++i) {
                    widen(&l.each[i], &h.each[i], tap_mins.each[0], tap_maxs.each[0]);
                    const ulong bit = (ulong)1 << BIT_OF(i, y, z), above = l.each[i] > values.each[0];
                    const int held = holds_any(&values, count, l.each[i], h.each[i]);
                    bricks[z / SIDES_EDGE][y / SIDES_EDGE][i / SIDES_EDGE] |= (ulong2)(held ? bit : 0, above ? bit : 0);
                }
            }
        }
    }
    store_bricks(sides, &bricks[0][0][0], blocks, bx, by, bz, LANES / SIDES_EDGE);
}

#else

// f = m sum(w) + sum(w (c - m)), with m the middle of the taps c and w their weights.
kernel void minmax_cells(global const float *restrict coefficients, const int4 extent, const int4 first, const int4 blocks,
                         global float2 *bounds)
{
    const int bx = get_global_id(0), by = get_global_id(1), bz = (int)get_global_id(2) + blocks.w;
    float tap_min = INFINITY, tap_max = -INFINITY;
    for (int k = SPARED; k < EDGE - SPARED; ++k)
        for (int j = SPARED; j < EDGE - SPARED; ++j) {
            const size_t z = MIN(first.z + bz * BLOCK + k, extent.z - 1), y = MIN(first.y + by * BLOCK + j, extent.y - 1);
            global const float *p = coefficients + (z * extent.y + y) * extent.x;
            for (int i = SPARED; i < EDGE - SPARED; ++i) {
                const float c = p[MIN(first.x + bx * BLOCK + i, extent.x - 1)];
                tap_min = MIN(c, tap_min);
                tap_max = MAX(c, tap_max);
            }
        }
#if NAMES
    bounds[((size_t)bz * blocks.y + by) * blocks.x + bx] = (float2)(tap_min, tap_max);
#else
    const float middle = 0.5f * tap_min + 0.5f * tap_max, reach = LEBESGUE * (0.5f * tap_max - 0.5f * tap_min);
    float low = middle * (middle > 0.0f ? SUM_LOW : SUM_HIGH) - reach, high = middle * (middle > 0.0f ? SUM_HIGH : SUM_LOW) + reach;
    widen(&low, &high, tap_min, tap_max);
    bounds[((size_t)bz * blocks.y + by) * blocks.x + bx] = (float2)(low, high);
#endif
}

#if NAMES

// Whether the taps but the spared ones of a cell, counted from `first`, have different names.
INLINE int differ_in_cell(global const float *restrict coefficients, const int4 extent, const int4 first, const int x, const int y, const int z)
{
    const size_t pitch = extent.x, area = pitch * extent.y;
    int cells[3] = { first.x + x, first.y + y, first.z + z };
    const int last[3] = { extent.x - TAPS, extent.y - TAPS, extent.z - TAPS };
    for (int n = 0; n < 3; ++n)
        cells[n] = MIN(cells[n], last[n]) + SPARED;   // there are none behind the last, but in its block
    global const float *core = coefficients + cells[2] * area + cells[1] * pitch + cells[0];
    int differ = 0;
    for (int k = 0; k < TAPS - 2 * SPARED && !differ; ++k)
        for (int j = 0; j < TAPS - 2 * SPARED; ++j)
            for (int i = 0; i < TAPS - 2 * SPARED; ++i)
                differ |= core[k * area + j * pitch + i] != *core;
    return differ;
}

// Whether a cell may hold several names.
kernel void side_cells(global const float *restrict coefficients, const int4 extent, const int4 first, const int4 blocks,
                       global const float2 *bounds, const float8 sought, const int count, global ulong2 *sides)
{
    const int bx = get_global_id(0), by = get_global_id(1), bz = (int)get_global_id(2) + blocks.w;
    const float2 bound = bounds[((size_t)bz * blocks.y + by) * blocks.x + bx];
    ulong2 bricks[BRICKS][BRICKS][BRICKS];
    for (int i = 0; i < BRICKS * BRICKS * BRICKS; ++i)
        (&bricks[0][0][0])[i] = (ulong2)(0, 0);
    for (int z = 0; bound.x != bound.y && z < BLOCK; ++z)
        for (int y = 0; y < BLOCK; ++y)
            for (int x = 0; x < BLOCK; ++x)
                if (differ_in_cell(coefficients, extent, first, bx * BLOCK + x, by * BLOCK + y, bz * BLOCK + z))
                    bricks[z / SIDES_EDGE][y / SIDES_EDGE][x / SIDES_EDGE].x |= (ulong)1 << BIT_OF(x, y, z);
    store_bricks(sides, &bricks[0][0][0], blocks, bx, by, bz, BRICKS);
}

#else

// No tighter than whole blocks.
kernel void side_cells(global const float *restrict coefficients, const int4 extent, const int4 first, const int4 blocks,
                       global const float2 *bounds, const float8 sought, const int count, global ulong2 *sides)
{
    const int bx = get_global_id(0), by = get_global_id(1), bz = (int)get_global_id(2) + blocks.w;
    const float2 bound = bounds[((size_t)bz * blocks.y + by) * blocks.x + bx];
    const values_u values = { sought };
    const int above = bound.x > values.each[0], held = holds_any(&values, count, bound.x, bound.y);
    ulong2 bricks[BRICKS][BRICKS][BRICKS];
    for (int i = 0; i < BRICKS * BRICKS * BRICKS; ++i)
        (&bricks[0][0][0])[i] = (ulong2)(held ? ALL_CELLS : 0, above ? ALL_CELLS : 0);
    store_bricks(sides, &bricks[0][0][0], blocks, bx, by, bz, BRICKS);
}

#endif
#endif

// Two blocks along each axis make one of the next level, a row of it for each work-item. Levels: blocks along x, y and z, and where
// they begin.
kernel void minmax_blocks(global float2 *bounds, const int4 finer, const int4 coarser)
{
    const int y = get_global_id(0), z = get_global_id(1);
    for (int x = 0; x < coarser.x; ++x) {
        float2 hull = (float2)(INFINITY, -INFINITY);
        for (int k = 2 * z; k < MIN(2 * z + 2, finer.z); ++k)
            for (int j = 2 * y; j < MIN(2 * y + 2, finer.y); ++j)
                for (int i = 2 * x; i < MIN(2 * x + 2, finer.x); ++i) {
                    const float2 b = bounds[finer.w + ((size_t)k * finer.y + j) * finer.x + i];
                    hull.x = MIN(b.x, hull.x);
                    hull.y = MAX(b.y, hull.y);
                }
        bounds[coarser.w + ((size_t)z * coarser.y + y) * coarser.x + x] = hull;
    }
}
