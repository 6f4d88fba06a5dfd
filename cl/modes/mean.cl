// The mean along the ray, coloured by the transfer function: samples are weighted by the lengths of their stretches. It has no
// depth.

#include "march/sample.cl"
#include "transfer/ramp.cl"

typedef struct { real sum, steps; } state_t;

#define REACH 0.0f
#define ANY_ORDER 0
#define PROMISE(low, high) 0.0f

INLINE void begin(state_t *s) { s->sum = s->steps = (real)(0.0f); }

INLINE mask finished(const state_t *s, constant frame_t *frame) { return NONE; }

INLINE int matters(const state_t *s, constant frame_t *frame, global const float4 *table, float low, float high, real t, mask active)
{
    return 1;   // every sample counts
}

// The step of a ray: that of its planes, or its own. A part of it that has one sample, in its middle, counts in steps as all others do.
INLINE real whole_step(constant frame_t *frame, const ray_t *ray)
{
    constant planes_block *planes = &frame->planes;
    const real across = magnitude(axis_of(ray->direction, planes->axis));
    const real planar = planes->spacing / choose(ray->planar, across, (real)(1.0f));
    const real own = choose(ray->planar, planar, planes->stride / square_root(dot3(ray->direction, ray->direction)));
    return choose(ray->alone, own, ray->step);
}

INLINE mask gather(state_t *s, COEFFICIENTS coefficients, const sample_t *sample, real t, real value, mask active)
{
    const ray_t *ray = sample->ray;
    real steps = (real)(1.0f), before, behind;
    int uneven = stretch_of(ray, sample->number, t, active, &before, &behind);
#if MISSING
    stretch_to_edges(sample->missing, sample->frame, ray, t, active, &before, &behind);
    uneven = 1;
#endif
    if (uneven)
        steps = (before + behind) / whole_step(sample->frame, ray);
    s->sum = choose(active, madd(steps, value, s->sum), s->sum);
    s->steps = choose(active, s->steps + steps, s->steps);
    return NONE;
}

INLINE void merge(state_t *front, const state_t *back)
{
    front->sum += back->sum;
    front->steps += back->steps;
}

INLINE real place_of(const state_t *s) { return NOWHERE; }

#define VALUE_OF(s, sample) choose((s)->steps > 0.0f, (s)->sum / (s)->steps, (real)(NAN))

INLINE color_t finish(const state_t *s, COEFFICIENTS coefficients, const sample_t *sample)
{
    const mask some = s->steps > 0.0f;
    color_t color = classify(&sample->frame->transfer, sample->table, s->sum / choose(some, s->steps, (real)(1.0f)));
    color.opacity = choose(some, (real)(1.0f), (real)(0.0f));
    return color;
}
