// The function outside the volume's domain, where every tap's place comes from the boundary rule: slow, and right everywhere.
// It stays out of the loops over points.
//
// Set by the host: DERIVATIVE, 0, 1 or 2; FILL, whether the result outside is `fill` and not what the rule gives.

#include "spline/boundary.cl"
#include "spline/cell.cl"
#include "spline/taps.cl"
#include "spline/position.cl"

#if DERIVATIVE == 0
#define COMPONENTS 1
#elif DERIVATIVE == 1
#define COMPONENTS DIMENSIONS
#else
#define COMPONENTS (DIMENSIONS * DIMENSIONS)
#endif

// A sum of taps whose places all come from the boundary rule.
INLINE float outer_sum(COEFFICIENTS coefficients, const int4 extent, cell_t cell, int4 period,
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
                    line = madd(wx[i], fetch_one(coefficients, extent, x + halo, y + halo, z + halo), line);
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

// A sum for each component, with the weights or their derivatives that it takes.
INLINE void outer_sample(COEFFICIENTS coefficients, const int4 extent, cell_t c, int4 period, float *value, gradient_t *g, hessian_t *h)
{
    float x[3][WEIGHTS], y[3][WEIGHTS], z[3][WEIGHTS];
    axis_weights(c.tx, x);
    axis_weights(c.ty, y);
#if DIMENSIONS == 3
    axis_weights(c.tz, z);
#else
    z[0][0] = 1.0f; z[1][0] = 0.0f; z[2][0] = 0.0f;
#endif
#define OUTER(i, j, k) outer_sum(coefficients, extent, c, period, x[i], y[j], z[k])
    if (DERIVATIVE == 0)
        *value = OUTER(0, 0, 0);
    if (DERIVATIVE == 1) {
        g->x = OUTER(1, 0, 0); g->y = OUTER(0, 1, 0); g->z = OUTER(0, 0, 1);
    }
    if (DERIVATIVE == 2) {
        h->xx = OUTER(2, 0, 0); h->yy = OUTER(0, 2, 0); h->zz = OUTER(0, 0, 2);
        h->xy = OUTER(1, 1, 0); h->xz = OUTER(1, 0, 1); h->yz = OUTER(0, 1, 1);
    }
#undef OUTER
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
OUT_OF_LINE void outer_into(COEFFICIENTS coefficients, const int4 extent, position_t at, int4 size, int4 period, constant coord *w, const float fill,
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
    outer_sample(coefficients, extent, locate(at.x, at.y, at.z, extent.w), period, &value, &g, &h);
    to_world(value, g, h, w, result);
}
