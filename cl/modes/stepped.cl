// The isosurface at the first crossing between two samples, refined on the continuous function. A pair of crossings between the
// same two samples is missed.

#include "march/surface.cl"

typedef struct { real before, before_t, hit; mask started; } state_t;

#define REACH 1.0f   // a crossing lies between two samples
#define ANY_ORDER 0
#define PROMISE(low, high) 0.0f

INLINE void begin(state_t *s)
{
    s->before = s->before_t = (real)(0.0f);
    s->hit = NOWHERE;
    s->started = NONE;
}

INLINE mask finished(const state_t *s, constant frame_t *frame) { return s->hit < NOWHERE; }

// Regula falsi that halves the value of an end that stays (Illinois), and bisects every third time:
// until the function is within the tolerance of the isovalue, or the interval cannot be halved.
INLINE real refine(COEFFICIENTS coefficients, const sample_t *sample, real near, real near_value, real far, real far_value, mask active)
{
    const float isovalue = sample->frame->mode.isovalue;
    const real tolerance = sample->frame->mode.tolerance * magnitude(far_value - near_value);
    real t = far, best = far;
    mask last_was_near = NONE, last_was_far = NONE;
    for (int i = 1; i < 80 && any_lane(active); ++i) {
        const real middle = 0.5f * (near + far);
        const real cut = near - near_value * (far - near) / (far_value - near_value);
        const mask between = (cut > near) & (cut < far);
        t = i % 3 == 0 ? middle : choose(between, cut, middle);
        const real value = value_at(coefficients, sample, t, active) - isovalue;
        const mask is_near = (value < 0.0f) == (near_value < 0.0f);
        far_value = choose(is_near & last_was_near, 0.5f * far_value, far_value);
        near_value = choose((!is_near) & last_was_far, 0.5f * near_value, near_value);
        near = choose(is_near, t, near);
        near_value = choose(is_near, value, near_value);
        far = choose(is_near, far, t);
        far_value = choose(is_near, far_value, value);
        last_was_near = is_near;
        last_was_far = !is_near;
        // where the function jumps, the far side of the jump: every pixel is shaded from the same side
        const mask near_enough = magnitude(value) <= tolerance;
        best = choose(active, choose(near_enough, t, far), best);
        active = active & !near_enough & (0.5f * (near + far) > near) & (0.5f * (near + far) < far);
    }
    return best;
}

INLINE int matters(const state_t *s, constant frame_t *frame, global const float4 *table, float low, float high, real t, mask active)
{
    return !(low > frame->mode.isovalue || high < frame->mode.isovalue);
}

INLINE mask gather(state_t *s, COEFFICIENTS coefficients, const sample_t *sample, real t, real value, mask active)
{
    const real difference = value - sample->frame->mode.isovalue;
    mask crossed = active & s->started & ((difference < 0.0f) != (s->before < 0.0f));
    if (any_lane(crossed)) {
        const real hit = refine(coefficients, sample, s->before_t, s->before, t, difference, crossed);
#if MISSING
        crossed &= !missing_at(sample->missing, sample->frame, sample->ray, hit, crossed);
#endif
        s->hit = choose(crossed, hit, s->hit);
    }
    s->before = choose(active, difference, s->before);
    s->before_t = choose(active, t, s->before_t);
    s->started = s->started | active;
    return crossed;
}

// A stretch begins with the last sample of the one before (REACH), so that each crossing is within one.
INLINE void merge(state_t *front, const state_t *back)
{
    front->hit = choose(front->hit < NOWHERE, front->hit, back->hit);
    front->before = choose(back->started, back->before, front->before);
    front->before_t = choose(back->started, back->before_t, front->before_t);
    front->started = front->started | back->started;
}

#define CAPPED NOWHERE   // t of the sample before, where rays ended at a cap
#define ON_FACE(state) ((state)->before_t == CAPPED)
#define RESTARTS 1

INLINE void restart(state_t *s, mask active) { s->started = s->started & !active; }

INLINE mask gather_face(state_t *s, COEFFICIENTS coefficients, const sample_t *sample, real value, mask active)
{
    const mask met = meets_cap(sample, value, active);
    s->hit = choose(met, sample->ray->enter, s->hit);
    s->before_t = choose(met, CAPPED, s->before_t);
    return met;
}

INLINE real place_of(const state_t *s) { return s->hit; }

INLINE color_t finish(const state_t *s, COEFFICIENTS coefficients, const sample_t *sample)
{
    return surface_color(coefficients, sample, s->hit, s->before_t == CAPPED);
}
