// Kernels: the function or its derivatives at given points, or on a grid of points.
//
// What makes them fast on a CPU, where a work-item takes RUN points, LANES at a time (point_lanes.cl):
//
// | what                                                   | where          |
// |--------------------------------------------------------|----------------|
// | positions, cells and weights of LANES points in vectors | point_lanes.cl |
// | rows of four taps of two points side by side (SIDE 2)   | taps.cl        |
// | the boundary rule is not needed inside the domain       | coefficients.cl |
// | points outside are moved inside, and sampled as others  | outside.cl     |
// | unordered points are sorted first                       | sort.cl        |
//
// Set by the host: DERIVATIVE, 0, 1 or 2; WITH_VALUE (outside.cl); LANES, points that are computed at once, 1 or 8; FEW, whether an
// int can count the coefficients; RUN, points of a work-item; and what is included.

#include "base/platform.cl"
#include "spline/filter.cl"
#if LANES > 1 && ROW == 4
#define SIDE 2
#endif
#include "spline/taps.cl"
#include "spline/pairs.cl"
#include "spline/outside.cl"
#if LANES == 1 && FUNCTIONS > 1
#include "spline/components.cl"
#endif

// -- results of `count` points ----------------------------------------------------------------------------

#if LANES == 1

// One result, in world units. w: the rows of world_to_index, so index_j = sum_i w[3 j + i] world_i.
INLINE void to_world(scalar value, gradient_t g, hessian_t h, constant coord *w, global scalar *result)
{
    const scalar s = GRID_SCALE;
    (void)s;   // values need none
#if DERIVATIVE == 0
    result[0] = value;
#elif DERIVATIVE == 1
#if WITH_VALUE
    result[0] = value;
#endif
    for (int i = 0; i < DIMENSIONS; ++i)
        result[WITH_VALUE + i] = s * ((scalar)w[i] * g.x + (scalar)w[3 + i] * g.y + (scalar)w[6 + i] * g.z);
#else
    for (int i = 0; i < DIMENSIONS; ++i) {
        const scalar a = w[i], b = w[3 + i], c = w[6 + i];
        const scalar rx = a * h.xx + b * h.xy + c * h.xz, ry = a * h.xy + b * h.yy + c * h.yz,
                     rz = a * h.xz + b * h.yz + c * h.zz;
        for (int j = 0; j < DIMENSIONS; ++j)
            result[i * DIMENSIONS + j] = s * s * (rx * (scalar)w[j] + ry * (scalar)w[3 + j] + rz * (scalar)w[6 + j]);
    }
#endif
}

INLINE void sample_into(COEFFICIENTS coefficients, const int4 extent, position_t at, const int4 size, const int4 period,
                        constant coord *w, const scalar2 given, global scalar *result)
{
    scalar value = 0.0f;
    gradient_t g = { 0.0f, 0.0f, 0.0f };
    hessian_t h = { 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f };
    along_t along = { 1, 1, 1 };
    if (!within_volume(at, size)) {
        const int kind = bring(&at, size, period, &along);
        if (kind != SAMPLED) {
            value_into(kind, given, result);
            return;
        }
    }
    const cell_t c = locate_inner(at.x, at.y, at.z, extent.w);
    for (int f = 0; f < FUNCTIONS; ++f) {
#if FUNCTIONS > 1
        sample_component(coefficients, extent, c, f, &value, &g, &h);
#elif DERIVATIVE == 0
        value = sample_value(coefficients, extent, c);
#elif DERIVATIVE == 1
        g = sample_gradient(coefficients, extent, c, &value);
#else
        h = taps_hessian(coefficients, extent, c);
#endif
#if DERIVATIVE == 1
        g.x *= along.x, g.y *= along.y, g.z *= along.z;
#elif DERIVATIVE == 2
        h.xx *= along.x * along.x, h.yy *= along.y * along.y, h.zz *= along.z * along.z;
        h.xy *= along.x * along.y, h.xz *= along.x * along.z, h.yz *= along.y * along.z;
#endif
        to_world(value, g, h, w, result + f * OF_EACH);
    }
}

INLINE void run_into(COEFFICIENTS coefficients, const int4 extent, source_t source, int count, const int4 size, const int4 period,
                     constant coord *transform, const scalar2 given, global scalar *results)
{
    for (int i = 0; i < count; ++i)
        sample_into(coefficients, extent, index_of(point_of(source, i), transform), size, period, transform + 12, given,
                    results + COMPONENTS * place_of(source, i));
}

#else

#include "spline/point_lanes.cl"

#endif

// -- kernels: a work-item takes RUN points ----------------------------------------------------------------

// given: see value_into.

#if !ON_GRID

kernel void sample_points(COEFFICIENTS coefficients, const int4 extent, const int4 size, const int4 period,
                          constant coord *transform, global const POINT *points, const ulong planes, const ulong count, const scalar2 given,
                          global scalar *results)
{
    const source_t source = { points, get_global_id(0) * RUN, planes };
    if (source.first < count)
        run_into(coefficients, extent, source, count - source.first < RUN ? count - source.first : RUN, size, period, transform,
                 given, results);
}

#else

// grid: the number of points along x and y, and the first row and slice of this launch. rows: how many a work-item takes, and where
// they end. base: the point that `results` begin with.
kernel void sample_grid(COEFFICIENTS coefficients, const int4 extent, const int4 size, const int4 period,
                        constant coord *transform, const int4 grid, const int2 rows, const ulong base, const scalar2 given,
                        global scalar *results CHAIN_ARGUMENTS)
{
    const int first = (int)get_global_id(1) * rows.x + grid.z;
    source_t source = { get_global_id(0) * RUN, first, (int)get_global_id(2) + grid.w, 0 CHAIN_GIVEN };
#if DIMENSIONS < 3 && !FETCH_IMAGE   // each slice has coefficients of its own
    coefficients += source.k * ((size_t)extent.x * extent.y);
#endif
    if (source.i >= grid.x)
        return;
    for (; source.j < MIN(first + rows.x, rows.y); ++source.j) {
        source.first = ((size_t)source.k * grid.y + source.j) * grid.x + source.i - base;
        run_into(coefficients, extent, source, MIN(RUN, grid.x - source.i), size, period, transform, given, results);
    }
}

#endif
