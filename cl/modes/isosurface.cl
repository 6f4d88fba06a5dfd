// The first surface of one value: the first root of the function along the ray, whatever the step.

#include "march/surface.cl"
#include "march/walk.cl"

typedef walk_t state_t;

#define STRETCHES 1
#define REACH 1.0f   // a stretch goes on to where the next begins
#define ANY_ORDER 0
#define PROMISE(low, high) 0.0f

INLINE void begin(state_t *s)
{
    s->hit = NOWHERE;
    s->side = (real)(0.0f);
}

INLINE mask finished(const state_t *s, constant frame_t *frame) { return s->hit < NOWHERE; }

INLINE int matters(const state_t *s, constant frame_t *frame, global const float4 *table, float low, float high, real t, mask active)
{
    return !(low > frame->mode.isovalue || high < frame->mode.isovalue);
}

INLINE mask gather_stretch(state_t *s, COEFFICIENTS coefficients, const sample_t *sample, global const float2 *minmax,
                           real from, real to, mask active)
{
    return walk_rays(s, coefficients, sample, minmax, sample->frame->mode.isovalue, from, to, active);
}

// Both stretches look at the whole of the cell between them.
INLINE void merge(state_t *front, const state_t *back)
{
    front->hit = choose(front->hit < NOWHERE, front->hit, back->hit);
    front->side = choose(back->side == 0.0f, front->side, back->side);
}

INLINE color_t finish(const state_t *s, COEFFICIENTS coefficients, const sample_t *sample, real *t)
{
    *t = s->hit;
    return surface_color(coefficients, sample, s->hit);
}
