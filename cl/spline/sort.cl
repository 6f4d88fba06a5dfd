// Kernels: counting sort of points by the brick of the volume that contains them, so that successive points share cache lines. A
// work-item takes a stretch of the points.
//
// Set by the host: DIMENSIONS; BRICKS, their largest number; LANES, 8; and the defines of the included files.

#include "base/platform.cl"
#include "base/math.cl"
#include "base/vector.cl"
#include "base/transpose.cl"
#include "spline/position.cl"
#include "spline/position_lanes.cl"

INLINE size_t stretch(ulong count, size_t item) { return count * item / get_global_size(0); }

INLINE mask bricks_along(coords_t x, int size, int bits)
{
    const coord4 last = (coord4)(size - 1), none = (coord4)(0);
    x.low = x.low > none ? x.low < last ? x.low : last : none;   // NaN goes to the first brick
    x.high = x.high > none ? x.high < last ? x.high : last : none;
    return (mask)(CONVERT(x.low, int4), CONVERT(x.high, int4)) >> bits;
}

// grid: bricks along x and y, and the logarithm of their edge. counts: points of each stretch in each brick.
kernel void count_bricks(constant coord *transform, const int4 size, const int4 grid, global const POINT *points,
                         const ulong planes, const ulong count, global ushort *bricks, global uint *counts)
{
    const size_t item = get_global_id(0), end = stretch(count, item + 1);
    source_t source = { points, stretch(count, item), planes };
    uint points_in[BRICKS];
    for (int i = 0; i < BRICKS; ++i)
        points_in[i] = 0;
    for (; source.first < end; source.first += LANES) {
        const int some = end - source.first < LANES ? end - source.first : LANES;
        const positions_t at = indices_of(points_of(source, 0, some), transform);
        lane_masks_u brick;
        brick.all = bricks_along(at.y, size.y, grid.z);
#if DIMENSIONS == 3
        brick.all += bricks_along(at.z, size.z, grid.z) * grid.y;
#endif
        brick.all = brick.all * grid.x + bricks_along(at.x, size.x, grid.z);
        for (int i = 0; i < some; ++i) {
            bricks[source.first + i] = brick.each[i];
            ++points_in[brick.each[i]];
        }
    }
    for (int i = 0; i < BRICKS; ++i)
        counts[item * BRICKS + i] = points_in[i];
}

// starts: where the first point of each stretch in each brick goes. Results: x, y, z and the place in `points`.
kernel void sort_points(global const POINT *points, const ulong planes, const ulong count, global const ushort *bricks,
                        global const uint *starts, global POINT *sorted)
{
    typedef PASTE(POINT, 4) point4;
    const size_t item = get_global_id(0), end = stretch(count, item + 1);
    uint next[BRICKS];
    for (int i = 0; i < BRICKS; ++i)
        next[i] = starts[item * BRICKS + i];
    for (size_t i = stretch(count, item); i < end; ++i) {
        const source_t source = { points, i, planes };
        const position_t p = point_of(source, 0);
        const point4 record = { p.x, p.y, p.z, AS_PLACE(i) };
        ((global point4 *)sorted)[next[bricks[i]]++] = record;
    }
}
