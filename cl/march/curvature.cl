// Curvatures of the isosurfaces that rays meet, from the exact first and second derivatives.
//
// On the tangent plane the surface bends by -H / |g|, with the Hessian H and the gradient g: positive where it bends away from lower
// values, as that of a bright ball does (1 / radius). Its eigenvalues are the principal curvatures.
//
// Set by the host: CURVED, which of them is shown: 1 the larger one, 2 the smaller one, 3 their mean, 4 their product.

#include "march/sample.cl"

// The second derivative along u and v, in the unit of geometry->gradient.
typedef struct { real xx, yy, zz, xy, xz, yz; } bends_t;

INLINE real bend_along(const bends_t *h, const real3 u, const real3 v)
{
    const real3 w = real3_of(madd(h->xx, v.x, madd(h->xy, v.y, h->xz * v.z)), madd(h->xy, v.x, madd(h->yy, v.y, h->yz * v.z)),
                             madd(h->xz, v.x, madd(h->yz, v.y, h->zz * v.z)));
    return dot3(u, w);
}

INLINE real3 cross3(const real3 a, const real3 b)
{
    return real3_of(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}

// Per unit length of the world; 0 where the gradient is.
OUT_OF_LINE real curvature_at(COEFFICIENTS coefficients, const sample_t *sample, const real t, const mask active)
{
    constant geometry_block *geometry = &sample->frame->geometry;
    const real3 p = at3(sample->ray->origin, sample->ray->direction, t);
    const lanes_u x = { p.x }, y = { p.y }, z = { p.z };
    const lane_masks_u wanted = { active };
    lanes_u gx = { (real)(0.0f) }, gy = gx, gz = gx, xx = gx, yy = gx, zz = gx, xy = gx, xz = gx, yz = gx;
    for (int i = 0; i < LANES; ++i)
        if (wanted.each[i]) {
            const cell_t c = locate_stored(sample, x.each[i], y.each[i], z.each[i]);
            float value;
            const gradient_t g = taps_gradient(coefficients, sample->extent, c, &value);
            const hessian_t h = taps_hessian(coefficients, sample->extent, c);
            gx.each[i] = g.x; gy.each[i] = g.y; gz.each[i] = g.z;
            xx.each[i] = h.xx; yy.each[i] = h.yy; zz.each[i] = h.zz;
            xy.each[i] = h.xy; xz.each[i] = h.xz; yz.each[i] = h.yz;
        }
    const bends_t h = { xx.all, yy.all, zz.all, xy.all, xz.all, yz.all };
    const real3 g = transpose3(geometry->gradient, real3_of(gx.all, gy.all, gz.all));
    const real squared = dot3(g, g);
    const mask flat = squared == 0.0f;
    const real per_length = 1.0f / square_root(choose(flat, (real)(1.0f), squared));
    const real3 normal = scale3(g, per_length);
    const real ax = magnitude(normal.x), ay = magnitude(normal.y), az = magnitude(normal.z);
    const mask is_x = (ax <= ay) & (ax <= az), is_y = !is_x & (ay <= az);
    const real one = (real)(1.0f), none = (real)(0.0f);
    real3 u = cross3(normal, real3_of(choose(is_x, one, none), choose(is_y, one, none), choose(is_x | is_y, none, one)));
    u = scale3(u, 1.0f / square_root(MAX(dot3(u, u), (real)(1e-20f))));
    const real3 v = cross3(normal, u);
    // these directions in samples, times the unit of gradients: gradient is that unit times the inverse of index_to_world * unit
    const real3 ui = matrix3(geometry->gradient, u), vi = matrix3(geometry->gradient, v);
    const float first = geometry->gradient[0] * geometry->index_to_world[0] + geometry->gradient[1] * geometry->index_to_world[3] +
                        geometry->gradient[2] * geometry->index_to_world[6];
    const real per = per_length * (float)GRID_SCALE / (first * geometry->unit);
    const real a = bend_along(&h, ui, ui) * -per, b = bend_along(&h, ui, vi) * -per, c = bend_along(&h, vi, vi) * -per;
    const real mean = 0.5f * (a + c), apart = 0.5f * (a - c);
#if CURVED == 1
    const real shown = mean + square_root(madd(apart, apart, b * b));
#elif CURVED == 2
    const real shown = mean - square_root(madd(apart, apart, b * b));
#elif CURVED == 3
    const real shown = mean;
#else
    const real shown = a * c - b * b;
#endif
    return choose(flat, none, shown);
}
