// Two-sided Blinn-Phong from the gradient: the normal faces the viewer.
//
// Set by the host: SHADOWED, whether matter stops light on its way (lit.cl); CAST, whether surfaces do (cast.cl).

#include "base/math.cl"
#include "base/vector.cl"
#include "frame.cl"
#include "march/sample.cl"

#define MOST_LIGHTS 4
#if SHADOWED
#include "march/lit.cl"
#else
#define BEFORE_MATTER(k, light) (light)
#endif
#if CAST
#define TOWARD(i) madd((real)(frame->cast.weight), sample->left[i] - 1.0f, (real)(1.0f))   // before surfaces, directed light number i
#else
#define TOWARD(i) ((real)(1.0f))
#endif

// The unit normal of a gradient, towards the viewer, that is against the ray, and its cosine to the viewer. Returns the lanes whose
// gradient is no longer than the rounding error of the function's values, of the size of `value`: it has no direction, and both are 0.
INLINE mask flat_or_normal(constant frame_t *frame, real3 gradient, real value, real3 world, real3 *normal, real *facing)
{
    const real squared = dot3(gradient, gradient), rounding = value * frame->geometry.rounding;
    const mask flat = squared <= rounding * rounding;
    const real per_length = choose(flat, (real)(0.0f), inverse_root(MIN(MAX(squared, (real)(1e-37f)), (real)(1e37f))));
    const real along = dot3(gradient, world);
    *normal = scale3(gradient, choose(along > 0.0f, -per_length, per_length));
    *facing = magnitude(along) * per_length;
    return flat;
}

typedef struct { real3 diffuse, shine; } reflected_t;

// Adds the light of this colour, of which so much is `left`, given the cosines of the normal to it and to the direction half-way between
// it and the viewer. `least`: the smallest cosine that counts as one.
INLINE void reflect(reflected_t *sum, constant material_block *material, constant float *color, const real left, const real lambert,
                    const real half_angle, const real least)
{
    const real3 tint = real3_of((real)(color[0]), (real)(color[1]), (real)(color[2]));
    const real highlight = power(half_angle, material->shininess, material->whole_shininess, material->min_shine);
    sum->diffuse = at3(sum->diffuse, tint, left * (material->diffuse * MAX(lambert, least)));
    sum->shine = at3(sum->shine, tint, choose(lambert > 0.0f, left * (material->specular * highlight), (real)(0.0f)));
}

// color: of the matter at t; gradient: in world directions; value: the function's there.
INLINE color_t shade(const sample_t *sample, color_t color, real3 gradient, real value, real t, mask active)
{
    constant frame_t *frame = sample->frame;
    constant material_block *material = &frame->material;
    const real3 world = sample->ray->world;
    real3 normal;
    real facing;
    const mask flat = flat_or_normal(frame, gradient, value, world, &normal, &facing);
    const real least = choose(flat, (real)(1.0f), (real)(0.0f));
#if SHADOWED
    real left[1 + MOST_LIGHTS];
    light_left(left, sample, normal, flat, t, active);
#endif
    const real ambient = BEFORE_MATTER(0, (real)(material->ambient));
    reflected_t sum = { { ambient, ambient, ambient }, { (real)(0.0f), (real)(0.0f), (real)(0.0f) } };
    for (int i = 0; i < frame->lights.directed; ++i) {
        constant float *light = frame->lights.each + 7 * i;   // direction, colour, number
        const real3 to = real3_of((real)(light[0]), (real)(light[1]), (real)(light[2]));
        const real3 between = add3(to, scale3(world, (real)(-1.0f)));
        const real lambert = dot3(normal, to), per_length = inverse_root(MAX(dot3(between, between), (real)(1e-20f)));
        reflect(&sum, material, light + 3, BEFORE_MATTER((int)light[6], TOWARD(i)), lambert, (lambert + facing) * per_length, least);
    }
    if (frame->lights.headlight)   // half-way to the viewer is where the viewer is
        reflect(&sum, material, frame->lights.ahead, BEFORE_MATTER(frame->lights.headlight, (real)(1.0f)), facing, facing, least);
    color.red = madd(color.red, sum.diffuse.x, sum.shine.x);
    color.green = madd(color.green, sum.diffuse.y, sum.shine.y);
    color.blue = madd(color.blue, sum.diffuse.z, sum.shine.z);
    return color;
}
