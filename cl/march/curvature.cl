// Curvatures of the isosurfaces that rays meet, from the exact first and second derivatives, and the outlines that follow from them.
//
// On the tangent plane the surface bends by -H / |g|, with the Hessian H and the gradient g: positive where it bends away from lower
// values, as that of a bright ball does (1 / radius). Its eigenvalues are the principal curvatures.
//
// mode_block.curvature says which of them is shown.

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

// How a surface bends; meaningless where there is no gradient.
typedef struct { bends_t bends; real3 normal; real per; mask flat; } shape_t;

OUT_OF_LINE shape_t shape_at(COEFFICIENTS coefficients, const sample_t *sample, const real t, const mask active)
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
    // directions in samples, times the unit of gradients: gradient is that unit times the inverse of index_to_world * unit
    const float first = geometry->gradient[0] * geometry->index_to_world[0] + geometry->gradient[1] * geometry->index_to_world[3] +
                        geometry->gradient[2] * geometry->index_to_world[6];
    const shape_t shape = { h, scale3(g, per_length), per_length * (float)GRID_SCALE / (first * geometry->unit), flat };
    return shape;
}

// How much it bends along tangents u and v, per unit length of the world.
INLINE real bent_along(const shape_t *shape, constant frame_t *frame, const real3 u, const real3 v)
{
    constant float *to_samples = frame->geometry.gradient;
    return bend_along(&shape->bends, matrix3(to_samples, u), matrix3(to_samples, v)) * -shape->per;
}

// The mean of the principal curvatures, half of their difference, and their product, per unit length of the world.
typedef struct { real mean, apart, product; } bent_t;

INLINE bent_t bent_of(const shape_t *shape, constant frame_t *frame)
{
    const real3 normal = shape->normal;
    const real ax = magnitude(normal.x), ay = magnitude(normal.y), az = magnitude(normal.z);
    const mask is_x = (ax <= ay) & (ax <= az), is_y = !is_x & (ay <= az);
    const real one = (real)(1.0f), none = (real)(0.0f);
    real3 u = cross3(normal, real3_of(choose(is_x, one, none), choose(is_y, one, none), choose(is_x | is_y, none, one)));
    u = scale3(u, 1.0f / square_root(MAX(dot3(u, u), (real)(1e-20f))));
    const real3 v = cross3(normal, u);
    const real a = bent_along(shape, frame, u, u), b = bent_along(shape, frame, u, v), c = bent_along(shape, frame, v, v);
    const real apart = 0.5f * (a - c);
    const bent_t bent = { 0.5f * (a + c), square_root(madd(apart, apart, b * b)), a * c - b * b };
    return bent;
}

// The larger magnitude of the two; 0 where the gradient is.
INLINE real most_bent(const shape_t *shape, constant frame_t *frame)
{
    const bent_t bent = bent_of(shape, frame);
    return choose(shape->flat, (real)(0.0f), magnitude(bent.mean) + bent.apart);
}

#if CURVED

enum { LARGER, SMALLER, MEAN, PRODUCT };

// 0 where the gradient is.
INLINE real curvature_of(const shape_t *shape, constant frame_t *frame)
{
    const bent_t bent = bent_of(shape, frame);
    const int which = frame->mode.curvature;
    const real shown = which == LARGER ? bent.mean + bent.apart
                     : which == SMALLER ? bent.mean - bent.apart
                     : which == MEAN ? bent.mean
                                     : bent.product;
    return choose(shape->flat, (real)(0.0f), shown);
}

#endif

#if OUTLINED

// How far a surface turns away from the viewer at t, from 0 to 1 in the outline: where its rim is no further away, in the picture, than
// the outline is thick. There the surface is taken for a circle of its curvature along the ray, of which the ray meets the rim at a
// right angle to the normal.
INLINE real outline_of(const shape_t *shape, const sample_t *sample, const real t)
{
    constant frame_t *frame = sample->frame;
    constant camera_block *camera = &frame->camera;
    const real3 world = sample->ray->world;
    const real facing = dot3(shape->normal, world);
    const real3 tangent = add3(world, scale3(shape->normal, -facing));
    const real squared = dot3(tangent, tangent);
    const real bent = choose(facing > 0.0f, (real)(1.0f), (real)(-1.0f)) * bent_along(shape, frame, tangent, tangent) /
                      MAX(squared, (real)(1e-12f));
    // a pixel's width at this place: rays of neighbouring pixels are as far apart
    const float level = camera->ahead;
    const real along = camera->orthographic | (level == 0.0f) ? (real)(0.0f) : t * level / sample->ray->ahead;
    const real3 across = real3_of(madd(along, camera->direction_u[0], (real)(camera->origin_u[0])),
                                  madd(along, camera->direction_u[1], (real)(camera->origin_u[1])),
                                  madd(along, camera->direction_u[2], (real)(camera->origin_u[2])));
    const real3 apart = scale3(matrix3(frame->geometry.index_to_world, across), (real)(frame->geometry.unit));
    const real pixel = square_root(dot3(apart, apart));
    const real inside = facing * facing / (1.0f + square_root(squared));   // of the radius, from the rim
    const real pixels = inside / MAX(bent * pixel, (real)(1e-20f));
    const real shown = MIN(MAX((frame->mode.outline + 0.5f) - pixels, (real)(0.0f)), (real)(1.0f));
    return choose(shape->flat | (bent <= 0.0f), (real)(0.0f), shown);
}

#endif
