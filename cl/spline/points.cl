// Kernels: the function or its derivatives at given points, or on a grid of points.
//
// What makes them fast on a processor, where a work-item takes RUN points, LANES at a time (point_lanes.cl):
//
// | what                                                   | where          |
// |--------------------------------------------------------|----------------|
// | positions, cells and weights of LANES points in vectors | point_lanes.cl |
// | rows of four taps of two points side by side (SIDE 2)   | taps.cl        |
// | the boundary rule is not needed inside the domain       | coefficients.cl |
// | points in no order are sorted first                     | sort.cl        |
//
// Set by the host: DERIVATIVE, 0, 1 or 2; LANES, points that are computed at once, 1 or 8; RUN, points of a work-item; and
// what is included.

#include "base/platform.cl"
#include "spline/filter.cl"
#if LANES > 1 && ROW == 4
#define SIDE 2
#endif
#include "spline/taps.cl"
#include "spline/pairs.cl"
#include "spline/position.cl"
#include "spline/outside.cl"

// -- results of `count` points ----------------------------------------------------------------------------

#if LANES == 1

INLINE void sample_into(COEFFICIENTS coefficients, const int4 extent, position_t at, const int4 size, const int4 period, constant coord *w, const float fill,
                        global float *result)
{
    float value = 0.0f;
    gradient_t g = { 0.0f, 0.0f, 0.0f };
    hessian_t h = { 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f };
    const int inside = at.x >= -0.5f && at.x <= size.x - 0.5f && at.y >= -0.5f && at.y <= size.y - 0.5f
        && at.z >= -0.5f && at.z <= size.z - 0.5f;   // z is 0 in 2-D; NaN and infinities are not inside
    if (!inside) {
        outer_into(coefficients, extent, at, size, period, w, fill, result);
        return;
    }
    const cell_t c = locate_inner(at.x, at.y, at.z, extent.w);
#if DERIVATIVE == 0
    value = sample_value(coefficients, extent, c);
#elif DERIVATIVE == 1
    g = sample_gradient(coefficients, extent, c, &value);
#else
    h = taps_hessian(coefficients, extent, c);
#endif
    to_world(value, g, h, w, result);
}

INLINE void run_into(COEFFICIENTS coefficients, const int4 extent, source_t source, int count, const int4 size, const int4 period,
                     constant coord *transform, const float fill, global float *results)
{
    for (int i = 0; i < count; ++i)
        sample_into(coefficients, extent, index_of(point_of(source, i), transform), size, period, transform + 12, fill,
                    results + COMPONENTS * place_of(source, i));
}

#else

#include "spline/point_lanes.cl"

#endif

// -- kernels: a work-item takes RUN points ----------------------------------------------------------------

#if !ON_GRID

kernel void sample_points(COEFFICIENTS coefficients, const int4 extent, const int4 size, const int4 period, constant coord *transform,
                          global const POINT *points, const ulong count, const float fill, global float *results)
{
    const source_t source = { points, get_global_id(0) * RUN };
    if (source.first < count)
        run_into(coefficients, extent, source, count - source.first < RUN ? count - source.first : RUN, size, period, transform, fill, results);
}

#else

// grid: the number of points along x and y, and the first row and slice of this launch.
kernel void sample_grid(COEFFICIENTS coefficients, const int4 extent, const int4 size, const int4 period, constant coord *transform,
                           const int4 grid, const float fill, global float *results CHAIN_ARGUMENTS)
{
    source_t source = { get_global_id(0) * RUN, (int)get_global_id(1) + grid.z, (int)get_global_id(2) + grid.w, 0 CHAIN_GIVEN };
    source.first = ((size_t)source.k * grid.y + source.j) * grid.x + source.i;
    if (source.i < grid.x && source.j < grid.y)
        run_into(coefficients, extent, source, MIN(RUN, grid.x - source.i), size, period, transform, fill, results);
}

#endif
