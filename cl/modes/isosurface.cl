// The first isosurface: the first root of the function along the ray, for any step.

#include "march/surface.cl"

typedef struct { real hit, side; } state_t;

#define STRETCHES 1
#define LAYERED 0
#define SURFACES(frame) 1
#define SOUGHT(frame, k) (frame)->mode.isovalue
#define REACH 1.0f   // a stretch extends to where the next begins
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

// Both stretches search the whole cell between them.
INLINE void merge(state_t *front, const state_t *back)
{
    front->hit = choose(front->hit < NOWHERE, front->hit, back->hit);
    front->side = choose(back->side == 0.0f, front->side, back->side);
}

#define CAPPED ((real)(3.0f))   // side of rays that ended at a cap
#define ON_FACE(state) ((state)->side == CAPPED)
#define AWAITS_LIGHT(state) (((state)->hit < NOWHERE) & ((state)->side != CAPPED))
#define VALUE_THERE(frame, state) ((real)((frame)->mode.isovalue))
#define LIGHT_BEHIND(state) choose((state)->hit < NOWHERE, (real)(0.0f), (real)(1.0f))
#define RESTARTS 1

INLINE void restart(state_t *s, mask active) { s->side = choose(active, (real)(0.0f), s->side); }

INLINE mask gather_face(state_t *s, COEFFICIENTS coefficients, const sample_t *sample, real value, mask active)
{
    const mask met = meets_cap(sample, value, active);
    s->hit = choose(met, sample->ray->enter, s->hit);
    s->side = choose(met, CAPPED, s->side);
    return met;
}

INLINE real place_of(const state_t *s) { return s->hit; }

INLINE color_t finish(const state_t *s, COEFFICIENTS coefficients, const sample_t *sample)
{
    return surface_color(coefficients, sample, s->hit, s->side == CAPPED);
}
