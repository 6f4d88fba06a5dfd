// Kernels: the function and its derivatives at given points, or on a lattice of points.
//
// Set by the host: DERIVATIVE (0, 1 or 2), FILL, LANES (points that are computed at once, 1 or 8), RUN (how many points
// a work-item takes), and what is included.

#include "base/platform.cl"
#include "spline/filter.cl"
#include "spline/boundary.cl"
#if LANES > 1 && ROW == 4   // rows of two points side by side in a vector
#define SIDE 2
#endif
#include "spline/taps.cl"
#include "spline/pairs.cl"
#include "spline/cell.cl"
#include "spline/position.cl"

#if DERIVATIVE == 0
#define COMPONENTS 1
#elif DERIVATIVE == 1
#define COMPONENTS DIMENSIONS
#else
#define COMPONENTS (DIMENSIONS * DIMENSIONS)
#endif

// -- outside the domain ------------------------------------------------------------------------------------

// Outside the domain every tap asks the boundary rule for its place: slow, right everywhere.
INLINE float outer_blend(VOLUME_PARAMS, cell_t cell, int4 period,
                         const float *wx, const float *wy, const float *wz)
{
    const int halo = extent.w;
    float sum = 0.0f;
    for (int k = 0; k < SLICES; ++k) {
#if DIMENSIONS == 3
        const int z = boundary_index(cell.z + k - halo, halo, extent.z - halo, period.z);
#else
        const int z = -halo;   // the only slice
#endif
        for (int j = 0; j < TAPS; ++j) {
            const int y = boundary_index(cell.y + j - halo, halo, extent.y - halo, period.y);
            float line = 0.0f;
            for (int i = 0; i < TAPS; ++i) {
                const int x = boundary_index(cell.x + i - halo, halo, extent.x - halo, period.x);
                if (x != MISSING && y != MISSING && z != MISSING)
                    line = madd(wx[i], fetch_one(VOLUME, x + halo, y + halo, z + halo), line);
            }
            sum = madd(wz[k] * wy[j], line, sum);
        }
    }
    return sum;
}

INLINE void axis_weights(float t, float w[3][WEIGHTS])
{
    unpack_weights(t, w[0]);
    unpack_slopes(t, w[1]);
    unpack_bends(t, w[2]);
}

// One blend for each component, with the weights, slopes or second derivatives that it takes.
INLINE void outer_sample(VOLUME_PARAMS, cell_t c, int4 period, float *value, gradient_t *g, hessian_t *h)
{
    float x[3][WEIGHTS], y[3][WEIGHTS], z[3][WEIGHTS];
    axis_weights(c.tx, x);
    axis_weights(c.ty, y);
#if DIMENSIONS == 3
    axis_weights(c.tz, z);
#else
    z[0][0] = 1.0f; z[1][0] = 0.0f; z[2][0] = 0.0f;
#endif
#define OUTER(i, j, k) outer_blend(VOLUME, c, period, x[i], y[j], z[k])
#if DERIVATIVE == 0
    *value = OUTER(0, 0, 0);
#elif DERIVATIVE == 1
    g->x = OUTER(1, 0, 0); g->y = OUTER(0, 1, 0); g->z = OUTER(0, 0, 1);
#else
    h->xx = OUTER(2, 0, 0); h->yy = OUTER(0, 2, 0); h->zz = OUTER(0, 0, 2);
    h->xy = OUTER(1, 1, 0); h->xz = OUTER(1, 0, 1); h->yz = OUTER(0, 1, 1);
#endif
}

// One result, in world units. w: see outer_into.
INLINE void to_world(float value, gradient_t g, hessian_t h, constant coord *w, global float *result)
{
    const float s = GRID_SCALE;
#if DERIVATIVE == 0
    result[0] = value;
#elif DERIVATIVE == 1
    for (int i = 0; i < DIMENSIONS; ++i)
        result[i] = s * ((float)w[i] * g.x + (float)w[3 + i] * g.y + (float)w[6 + i] * g.z);
#else
    for (int i = 0; i < DIMENSIONS; ++i) {
        const float a = w[i], b = w[3 + i], c = w[6 + i];
        const float rx = a * h.xx + b * h.xy + c * h.xz, ry = a * h.xy + b * h.yy + c * h.yz,
                    rz = a * h.xz + b * h.yz + c * h.zz;
        for (int j = 0; j < DIMENSIONS; ++j)
            result[i * DIMENSIONS + j] = s * s * (rx * (float)w[j] + ry * (float)w[3 + j] + rz * (float)w[6 + j]);
    }
#endif
}

// Outside the domain the boundary rule holds, or, if FILL is set, the result is `fill`.
// w: the rows of world_to_index, so index_j = sum_i w[3 j + i] world_i. Results are in world units.
OUT_OF_LINE void outer_into(VOLUME_PARAMS, position_t at, int4 size, int4 period, constant coord *w, const float fill,
                     global float *result)
{
    float value = 0.0f;
    gradient_t g = { 0.0f, 0.0f, 0.0f };
    hessian_t h = { 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f };
    const int finite = at.x - at.x == 0 && at.y - at.y == 0 && at.z - at.z == 0;
    if (!finite || FILL) {
        for (int i = 0; i < COMPONENTS; ++i)
            result[i] = finite ? fill : NAN;
        return;
    }
    at.x = boundary_position(at.x, size.x, period.x);
    at.y = boundary_position(at.y, size.y, period.y);
    at.z = boundary_position(at.z, size.z, period.z);
    outer_sample(VOLUME, locate(at.x, at.y, at.z, extent.w), period, &value, &g, &h);
    to_world(value, g, h, w, result);
}

// -- results of `count` points ----------------------------------------------------------------------------

#if LANES == 1

INLINE void sample_into(VOLUME_PARAMS, position_t at, const int4 size, const int4 period, constant coord *w, const float fill,
                        global float *result)
{
    float value = 0.0f;
    gradient_t g = { 0.0f, 0.0f, 0.0f };
    hessian_t h = { 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f };
    const int inside = at.x >= -0.5f && at.x <= size.x - 0.5f && at.y >= -0.5f && at.y <= size.y - 0.5f
        && at.z >= -0.5f && at.z <= size.z - 0.5f;   // 0 of one slice in 2-D; nothing that is not finite is inside
    if (!inside) {
        outer_into(VOLUME, at, size, period, w, fill, result);
        return;
    }
    const cell_t c = locate_inner(at.x, at.y, at.z, extent.w);
#if DERIVATIVE == 0
    value = sample_value(VOLUME, c);
#elif DERIVATIVE == 1
    g = sample_gradient(VOLUME, c, &value);
#else
    h = taps_hessian(VOLUME, c);
#endif
    to_world(value, g, h, w, result);
}

INLINE void run_into(VOLUME_PARAMS, source_t source, int count, const int4 size, const int4 period,
                     constant coord *transform, const float fill, global float *results)
{
    for (int i = 0; i < count; ++i)
        sample_into(VOLUME, index_of(point_of(source, i), transform), size, period, transform + 12, fill,
                    results + COMPONENTS * place_of(source, i));
}

#else

#include "spline/lanes.cl"

#endif

// -- kernels: a work-item takes RUN points ----------------------------------------------------------------

#if !ON_GRID

kernel void sample_points(VOLUME_PARAMS, const int4 size, const int4 period, constant coord *transform,
                          global const POINT *points, const ulong count, const float fill, global float *results)
{
    const source_t source = { points, get_global_id(0) * RUN };
    if (source.first < count)
        run_into(VOLUME, source, count - source.first < RUN ? count - source.first : RUN, size, period, transform, fill, results);
}

#else

// lattice: the number of points along x and y, and the first row and slice of this launch.
kernel void sample_grid(VOLUME_PARAMS, const int4 size, const int4 period, constant coord *transform,
                           const int4 lattice, const float fill, global float *results)
{
    source_t source = { get_global_id(0) * RUN, (int)get_global_id(1) + lattice.z, (int)get_global_id(2) + lattice.w, 0 };
    source.first = ((size_t)source.k * lattice.y + source.j) * lattice.x + source.i;
    if (source.i < lattice.x && source.j < lattice.y)
        run_into(VOLUME, source, MIN(RUN, lattice.x - source.i), size, period, transform, fill, results);
}

#endif
