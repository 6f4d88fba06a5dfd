// One of FUNCTIONS functions whose coefficients lie next to each other: a row along x begins with the first coefficient of each.
// For one point; point_lanes.cl samples all functions of LANES points together.

#include "spline/taps.cl"

// The tap sum of function f, with weights or their derivatives along each axis.
INLINE scalar component_sum(COEFFICIENTS coefficients, const int4 extent, cell_t c, int f, const scalar wx[WEIGHTS],
                            const scalar wy[WEIGHTS], const scalar wz[WEIGHTS])
{
    COEFFICIENTS first = coefficients + (offset_of(extent, c.x * APART, c.y, c.z) + f);
    scalar sum = 0.0f;
    for (int k = 0; k < SLICES; ++k) {
        scalar plane = 0.0f;
        for (int j = 0; j < LINES; ++j) {
            scalar row = 0.0f;
#pragma unroll
            for (int i = 0; i < TAPS; ++i)
                row = madd(wx[i], first[((size_t)k * extent.y + j) * extent.x + i * APART], row);
            plane = madd(wy[j], row, plane);
        }
        sum = madd(wz[k], plane, sum);
    }
    return sum;
}

// What DERIVATIVE asks for, of function f; the others are left as they are.
INLINE void sample_component(COEFFICIENTS coefficients, const int4 extent, cell_t c, int f, scalar *value, gradient_t *g, hessian_t *h)
{
    scalar wx[WEIGHTS], wy[WEIGHTS], wz[WEIGHTS];
#define SUM(x, y, z) component_sum(coefficients, extent, c, f, x, y, z)
    unpack_weights(c.tx, wx);
    LINE(unpack_weights, c.ty, wy, 1.0f);
    SLICE(unpack_weights, c.tz, wz, 1.0f);
#if DERIVATIVE == 0
    *value = SUM(wx, wy, wz);
#else
    scalar sx[WEIGHTS], sy[WEIGHTS], sz[WEIGHTS];
    unpack_slopes(c.tx, sx);
    LINE(unpack_slopes, c.ty, sy, 0.0f);
    SLICE(unpack_slopes, c.tz, sz, 0.0f);
#if DERIVATIVE == 1
    g->x = SUM(sx, wy, wz);
    g->y = SUM(wx, sy, wz);
    g->z = SUM(wx, wy, sz);
#else
    scalar bx[WEIGHTS], by[WEIGHTS], bz[WEIGHTS];
    unpack_bends(c.tx, bx);
    LINE(unpack_bends, c.ty, by, 0.0f);
    SLICE(unpack_bends, c.tz, bz, 0.0f);
    h->xx = SUM(bx, wy, wz);
    h->yy = SUM(wx, by, wz);
    h->zz = SUM(wx, wy, bz);
    h->xy = SUM(sx, sy, wz);
    h->xz = SUM(sx, wy, sz);
    h->yz = SUM(wx, sy, sz);
#endif
#endif
#undef SUM
}
