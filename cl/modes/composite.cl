// Emission and absorption, front to back; opacity is that of the ray's own step.

#include "march/sample.cl"
#include "transfer/ramp.cl"
#include "march/light.cl"

typedef struct { real red, green, blue, transmittance, depth; } state_t;

#define REACH 0.0f
#define ANY_ORDER 0
#define PROMISE(low, high) 0.0f

INLINE void begin(state_t *s)
{
    s->red = s->green = s->blue = (real)(0.0f);
    s->transmittance = (real)(1.0f);
    s->depth = NOWHERE;
}

INLINE mask finished(const state_t *s, constant frame_t *frame) { return s->transmittance <= frame->mode.termination; }

INLINE int matters(const state_t *s, constant frame_t *frame, global const float4 *table, float low, float high, real t, mask active)
{
    return !transparent(frame, table, low, high);
}

INLINE mask gather(state_t *s, COEFFICIENTS coefficients, const sample_t *sample, real t, real value, mask active)
{
    constant frame_t *frame = sample->frame;
    color_t color = classify(frame, sample->table, value);
    const mask seen = active & (color.opacity > 0.0f);
    if (!any_lane(seen))
        return NONE;
    if (SHADED)
        color = shade(frame, color, gradient_here(coefficients, sample, t, seen), value, sample->ray->world);
    const real thickness = sample->ray->step * frame->transfer.per_unit_distance;
    const real opacity = choose(seen, opacity_of(color.opacity, thickness), (real)(0.0f));
    const real share = s->transmittance * opacity;
    s->red = choose(seen, madd(share, color.red, s->red), s->red);
    s->green = choose(seen, madd(share, color.green, s->green), s->green);
    s->blue = choose(seen, madd(share, color.blue, s->blue), s->blue);
    s->transmittance -= share;
    s->depth = choose((s->transmittance <= 0.5f) & (s->depth == NOWHERE), t, s->depth);   // half of the light is stopped
    return finished(s, frame);
}

// The depth is exact if one stretch stops half of the light by itself; the other's light is not known where it is marched.
INLINE void merge(state_t *front, const state_t *back)
{
    front->red = madd(front->transmittance, back->red, front->red);
    front->green = madd(front->transmittance, back->green, front->green);
    front->blue = madd(front->transmittance, back->blue, front->blue);
    front->transmittance *= back->transmittance;
    front->depth = choose(front->depth < NOWHERE, front->depth, back->depth);
}

INLINE color_t finish(const state_t *s, COEFFICIENTS coefficients, const sample_t *sample, real *t)
{
    const real opacity = 1.0f - s->transmittance, per_opacity = 1.0f / MAX(opacity, (real)(1e-20f));
    color_t color = { s->red * per_opacity, s->green * per_opacity, s->blue * per_opacity, opacity };
    *t = s->depth;
    return color;
}
