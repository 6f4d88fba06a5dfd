// Two-sided Blinn-Phong from the gradient: the normal faces the viewer.
//
// Set by the host: SHADOWED, whether matter stops light on its way (lit.cl).

#include "base/math.cl"
#include "base/vector.cl"
#include "frame.cl"
#include "march/sample.cl"
#if SHADOWED
#include "march/lit.cl"
#else
#define BEFORE_MATTER(k, light) (light)
#endif

// The unit normal of a gradient, towards the viewer, that is against the ray. Returns the lanes whose gradient is no longer than
// the rounding error of the function's values, of the size of `value`: it has no direction, and `normal` is meaningless.
INLINE mask flat_or_normal(constant frame_t *frame, real3 gradient, real value, real3 world, real3 *normal)
{
    const real squared = dot3(gradient, gradient), rounding = value * frame->geometry.rounding;
    const mask flat = squared <= rounding * rounding;
    const real facing = dot3(gradient, world);
    *normal = scale3(gradient, choose(facing > 0.0f, (real)(-1.0f), (real)(1.0f)) / square_root(choose(flat, (real)(1.0f), squared)));
    return flat;
}

// color: of the matter at t; gradient: in world directions; value: the function's there.
INLINE color_t shade(const sample_t *sample, color_t color, real3 gradient, real value, real t, mask active)
{
    constant frame_t *frame = sample->frame;
    constant material_block *material = &frame->material;
    const real3 world = sample->ray->world;
    real3 normal;
    const mask flat = flat_or_normal(frame, gradient, value, world, &normal);
#if SHADOWED
    real left[1 + MOST_LIGHTS];
    light_left(left, sample, normal, flat, t, active);
#endif
    real red = BEFORE_MATTER(0, (real)(material->ambient)), green = red, blue = red, shine_red = (real)(0.0f), shine_green = shine_red, shine_blue = shine_red;
    for (int i = 0; i < frame->lights.count; ++i) {
        constant float *light = frame->lights.each + 8 * i;   // direction, 1 for a headlight; colour
        const int headlight = light[3] != 0.0f;
        const real3 to = headlight ? scale3(world, (real)(-1.0f)) : real3_of((real)(light[0]), (real)(light[1]), (real)(light[2]));
        const real lambert = choose(flat, (real)(1.0f), MAX(dot3(normal, to), (real)(0.0f)));
        real half_angle = lambert;   // a headlight's half-way direction is the viewer's
        if (!headlight) {
            const real3 sum = add3(to, scale3(world, (real)(-1.0f)));
            half_angle = MAX(dot3(normal, sum) / square_root(MAX(dot3(sum, sum), (real)(1e-20f))), (real)(0.0f));
        }
        half_angle = choose(flat, (real)(0.0f), half_angle);
        const real diffuse = BEFORE_MATTER(1 + i, material->diffuse * lambert);
        const real highlight = power(half_angle, material->shininess, material->whole_shininess, material->min_shine);
        const real shine = choose(lambert > 0.0f, BEFORE_MATTER(1 + i, material->specular * highlight), (real)(0.0f));
        red += diffuse * light[4]; green += diffuse * light[5]; blue += diffuse * light[6];
        shine_red += shine * light[4]; shine_green += shine * light[5]; shine_blue += shine * light[6];
    }
    color.red = madd(color.red, red, shine_red);
    color.green = madd(color.green, green, shine_green);
    color.blue = madd(color.blue, blue, shine_blue);
    return color;
}
